"""The pipeline, Source → Plan → Engine → Sink: frames stream through the native engine, or are sampled in memory."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextvars import copy_context
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from supple.buffers import buffers
from supple.engines.base import (
    LONGEST,
    Array,
    Certificate,
    Engine,
    Work,
)
from supple.engines.native import NATIVE, plan_of
from supple.engines.workers import note
from supple.errors import GapWarning, SuppleError

if TYPE_CHECKING:
    from concurrent.futures import Future

Tell = Callable[[str, int, int], None]

SUPPORT = {"nearest": 1, "linear": 1, "cubic": 2}
_SLACK = 1e-3  # frames: points are of float32, and may lie a little outside of the bounds of a plan
_AHEAD = 2  # planes in the queue of the writer


class Frame(Protocol):
    """A frame of a source."""

    def copy_to(self, arrays: Sequence[Array]) -> None:
        """Copy the samples into one array for each group."""


class Source(Protocol):
    """Frames in order: a clip, an image sequence, or an array."""

    def frames(self) -> Iterable[Frame]:
        """Read all frames in order, to the end."""


class Sink(Protocol):
    """The destination of planes, in order: a clip, an image sequence, or an array."""

    @property
    def aside(self) -> bool:
        """Return whether a thread writes a plane while the next is computed."""

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Write plane k, one array for each group; ``still`` marks an unchanged copy of frame k of the source."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrays:
    """A source and a sink of frames in memory, or mapped to it.

    Parameters
    ----------
    arrays : tuple of arrays
        For each group, all frames: (count, h, w, channels).
    """

    arrays: tuple[Array, ...]
    aside: bool = False

    def frames(self) -> Iterator[_ArrayFrame]:
        """Yield the frames in order."""
        for k in range(len(self.arrays[0])):
            yield _ArrayFrame(tuple(array[k] for array in self.arrays))

    def write(self, arrays: Sequence[Array], k: int, *, still: bool = False) -> None:
        """Store plane k, converted to the type of the array."""
        with np.errstate(over="ignore"):
            for target, made in zip(self.arrays, arrays, strict=True):
                target[k] = made


@dataclass(frozen=True, slots=True, eq=False)
class _ArrayFrame:
    """A frame of arrays that must be converted for the engine."""

    samples: tuple[Array, ...]

    def copy_to(self, arrays: Sequence[Array]) -> None:
        for array, samples in zip(arrays, self.samples, strict=True):
            array[...] = samples


@dataclass(frozen=True, slots=True)
class Done:
    """The result of a run.

    Parameters
    ----------
    certificate : Certificate
        The accuracy of the map of all planes.
    still : int
        The number of unchanged planes, copied from their frame.
    held : int
        The number of frames held at once.
    """

    certificate: Certificate
    still: int = 0
    held: int = 0


def run(
    source: Source,
    sink: Sink,
    work: Work,
    *,
    memory: float = math.inf,
    tell: Tell = lambda step, done, total: None,
) -> Done:
    """Process all frames with the native engine.

    Parameters
    ----------
    source : Source
    sink : Sink
    work : Work
    memory : float
        The bytes of memory for frames; frames beyond that go to a temporary file.
    tell : function
        Called with ``"plan"`` or ``"warp"``, the number of finished planes and their total; its exceptions end the run.

    Raises
    ------
    SuppleError
        If the source ends too early, there is no room for the temporary file, or the sink refuses a plane.
    """
    count = work.space.count
    if isinstance(source, Arrays) and isinstance(sink, Arrays):
        if work.space.is_identity:
            for target, held in zip(sink.arrays, source.arrays, strict=True):
                target[...] = held
            return Done(Certificate(0.0, 0.0), count)
        frames, outs = ([NATIVE.view(a) for a in some.arrays] for some in (source, sink))
        if all(a is not None for a in (*frames, *outs)):
            planes = len(sink.arrays[0])
            return Done(sampled(NATIVE, work, frames, outs, lambda done: tell("warp", done, planes)))
        work = replace(work, layout=replace(work.layout, dtype=NATIVE.working_dtype(work.layout.dtype)))
        if not work.space.is_plain:
            return _converted(source, sink, work, tell)
    plan = make_plan(work, range(count), lambda done: tell("plan", done, count))
    certificate = Certificate(0.0, 0.0)
    buffered = _AHEAD + 1 if sink.aside else 1
    made = stream(work, plan, source.frames(), memory=memory, buffered=buffered)
    with contextlib.closing(made), _writing(sink) as write:
        for z, arrays, known in made:
            write(arrays, z, still=bool(plan.still[z]))
            certificate |= known
            tell("warp", z + 1, count)
    return Done(certificate, int(plan.still.sum()), plan.capacity)


def _converted(source: Arrays, sink: Arrays, work: Work, tell: Tell) -> Done:
    """Sample copies of frames in the engine's type: a composite map may need any of them at any time."""
    frames = [np.ascontiguousarray(array, work.layout.dtype) for array in source.arrays]
    outs = [np.empty(array.shape, work.layout.dtype) for array in sink.arrays]
    certificate = sampled(NATIVE, work, frames, outs, lambda done: tell("warp", done, len(outs[0])))
    with np.errstate(over="ignore"):
        for target, made in zip(sink.arrays, outs, strict=True):
            target[...] = made
    return Done(certificate)


def sampled(
    engine: Engine,
    work: Work,
    frames: Sequence[Any],
    outs: Sequence[Any],
    tell: Callable[[int], None] = lambda done: None,
) -> Certificate:
    """Sample frames in memory with an engine; return the certificate of the map.

    Raises
    ------
    EngineError
        If the engine fails.
    """
    certificate = Certificate(0.0, 0.0)
    with contextlib.closing(engine.warp(work, frames, outs)) as made:
        for done, known in made:
            certificate |= known
            tell(done)
    note(engine.name)
    return certificate


@dataclass(frozen=True, slots=True)
class Plan:
    """The frames needed for each plane of the output, computed before any is read.

    Parameters
    ----------
    planes : tuple of int
        The planes of the output to compute, in ascending order.
    first, last : int64 array
        The range of frames that each plane samples, some perhaps outside the clip.
    still : bool array
        Whether a plane is unchanged: all displacements are within the tolerance.
    keep, read : int64 array
        When a plane is computed, frames before ``keep`` are no longer needed, and all up to ``read`` have been read.
    capacity : int
        The number of frames held at once.
    """

    planes: tuple[int, ...]
    first: npt.NDArray[np.int64]
    last: npt.NDArray[np.int64]
    still: npt.NDArray[np.bool_]
    keep: npt.NDArray[np.int64]
    read: npt.NDArray[np.int64]
    capacity: int


def make_plan(work: Work, planes: Sequence[int], tell: Callable[[int], None] = lambda done: None) -> Plan:
    """Solve the lattice of every plane to find the frames that it needs.

    ``tell`` is called at intervals with the number of finished planes.
    """
    space, sampling = work.space, work.sampling
    n, count = len(planes), space.count
    first, last = np.array(planes, np.int64), np.array(planes, np.int64)
    still = np.array([space.is_identity if work.items is None else work.items[z].is_identity for z in planes], bool)
    if space.ndim == 3 and not space.is_identity:
        support = SUPPORT[sampling.between]
        earliest, latest = _times_seen(sampling.outside, count, sampling.time_filter)
        step = work.layout.step
        for k, z in enumerate(planes):
            plan = plan_of(space, z, sampling.tolerance, step)
            low, high, moved, rate = plan.extent()
            still[k] = plan.identity or moved * 3**0.5 <= sampling.tolerance
            if not still[k]:
                # A chroma sample covers several pixels; and derivatives between nodes may be larger.
                wide = 1.5 * rate * math.hypot(*step, 1)
                beyond = min(wide, LONGEST) / 2 + 1 if sampling.time_filter else 0.0
                early, late = (min(max(t, earliest), latest) for t in (low[2] - _SLACK, high[2] + _SLACK))
                first[k] = math.floor(early - beyond) - support + 1
                last[k] = math.floor(late + beyond) + support
            if k % 64 == 63 or k == n - 1:
                tell(k + 1)
    needed = np.array([_frames_needed(a, b, count, sampling.outside) for a, b in zip(first, last, strict=True)])
    keep = np.minimum.accumulate(needed[::-1, 0])[::-1]
    # The timestamp of a frame is known when it has been read.
    read = np.maximum.accumulate(np.maximum(needed[:, 1], planes)) if n else needed[:, 1]
    return Plan(tuple(planes), first, last, still, keep, read, int((read - keep).max()) + 1)


def _frames_needed(first: int, last: int, count: int, outside: str) -> tuple[int, int]:
    """Return the range of frames read for a range of times."""
    if outside == "reflect" and (first < 0 or last >= count):
        k = np.arange(max(first, last - 2 * count), last + 1) % (2 * count)
        seen = np.minimum(k, 2 * count - 1 - k)
        return int(seen.min()), int(seen.max())
    return min(max(first, 0), count - 1), min(max(last, 0), count - 1)


def _times_seen(outside: str, count: int, average: bool) -> tuple[float, float]:
    """Return the times beyond which an edge or a constant continues unchanged."""
    beyond = 3.0 + (LONGEST / 2 if average else 0.0)
    if outside == "reflect":
        return -1e9, 1e9
    return -beyond, count - 1.0 + beyond


def stream(
    work: Work,
    plan: Plan,
    frames: Iterable[Frame],
    *,
    memory: float = math.inf,
    buffered: int = 1,
) -> Generator[tuple[int, list[Array], Certificate], None, None]:
    """Warp frames in the order in which they are read.

    Parameters
    ----------
    work : Work
    plan : Plan
    frames : iterable of Frame
        All frames of the source in order, read to the end.
    memory : float
        The bytes of memory for frames; frames beyond that go to a temporary file.
    buffered : int
        The number of planes whose samples are kept.

    Yields
    ------
    int
        The index of a plane of the output.
    list of arrays
        Its samples, one array (h, w, channels) for each group. The arrays are reused for the next plane, or for a later
        one if more are buffered.
    Certificate
        The accuracy of its map.

    Raises
    ------
    SuppleError
        If there are fewer frames than the plan needs, or no room for the temporary file.
    """
    layout = work.layout
    with contextlib.ExitStack() as stack:
        capacity = plan.capacity
        shapes = [(capacity, *g.shape, g.channels) for g in layout.groups]

        def full(size: str, folder: str, reason: str) -> str:
            return (
                f"{capacity} frames have to be held at once, {size}, more than the memory allowed, and there is no "
                f"room for them in {folder} ({reason}): allow more memory, or set TMPDIR to another folder"
            )

        window = stack.enter_context(buffers(shapes, layout.dtype, memory, full))
        sets = [[np.empty((*g.shape, g.channels), layout.dtype) for g in layout.groups] for _ in range(buffered)]
        make = NATIVE.stream(work, window)
        source = iter(frames)
        read = _reading(source, work, plan, window)
        for k, z in enumerate(plan.planes):
            read(k)
            outs, known = sets[k % buffered], Certificate(0.0, 0.0)
            if plan.still[k]:
                for held, out in zip(window, outs, strict=True):
                    out[...] = held[z % len(held)]
            else:
                known = make(z, outs)
            yield z, outs, known
        for _ in source:
            pass


def _reading(source: Iterator[Frame], work: Work, plan: Plan, window: Sequence[Array]) -> Callable[[int], None]:
    """Return a function that reads the frames of a plane into their slots."""
    have = 0
    floats = work.layout.dtype.kind == "f" and work.sampling.filter != "nearest"
    averaged = [number for number, group in enumerate(work.layout.groups) if floats and not group.exact]
    warned = False

    def read(k: int) -> None:
        nonlocal have, warned
        while have <= plan.read[k]:
            frame = next(source, None)
            if frame is None:
                raise SuppleError(f"the clip ends after {have} frames, where {work.space.count} were expected")
            if have >= plan.keep[k]:
                slots = [held[have % len(held)] for held in window]
                frame.copy_to(slots)
                # of arrays in memory, warp_array takes them out before
                if averaged and not warned and not isinstance(frame, _ArrayFrame):
                    warned = not all(np.isfinite(slots[number]).all() for number in averaged)
                    if warned:
                        text = f"frame {have} has NaN or infinite samples, which spread as far as the filter reaches"
                        warnings.warn(text, GapWarning, stacklevel=2)
            have += 1

    return read


@contextlib.contextmanager
def _writing(sink: Sink) -> Iterator[Callable[..., None]]:
    """Return a function that writes a plane, in a thread if the sink wants it; errors of the thread are raised here."""
    if not sink.aside:
        yield sink.write
        return
    from concurrent.futures import ThreadPoolExecutor

    waiting: deque[Future[None]] = deque()

    def submit(arrays: Sequence[Array], k: int, *, still: bool) -> None:
        while len(waiting) >= _AHEAD:
            waiting.popleft().result()
        waiting.append(pool.submit(copy_context().run, lambda: sink.write(arrays, k, still=still)))

    with ThreadPoolExecutor(1, "supple-encode") as pool:
        try:
            yield submit
            while waiting:
                waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
