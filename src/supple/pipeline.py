"""The pipeline, Source → Plan → Engine → Sink: frames stream through an engine, or are sampled in memory."""

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
    SUPPORT,
    Array,
    Certificate,
    Engine,
    EngineError,
    Planes,
    Work,
    frames_needed,
    times_seen,
)
from supple.engines.choice import warn_of_failure
from supple.engines.native import NATIVE, plan_of
from supple.engines.workers import note
from supple.errors import GapWarning, SuppleError

if TYPE_CHECKING:
    from concurrent.futures import Future

Tell = Callable[[str, int, int], None]

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
    engine: Engine,
    *,
    memory: float = math.inf,
    tell: Tell = lambda step, done, total: None,
) -> Done:
    """Process all frames with an engine, and those on which it fails with the native engine.

    Parameters
    ----------
    source : Source
    sink : Sink
    work : Work
    engine : Engine
    memory : float
        The bytes of memory for frames; frames beyond that go to a temporary file.
    tell : function
        Called with ``"plan"`` or ``"warp"``, the number of finished planes and their total; its exceptions end the run.

    Raises
    ------
    SuppleError
        If the source ends too early, there is no room for the temporary file, or the sink refuses a plane.

    Warns
    -----
    DeviceWarning
        If the engine failed.
    """
    count = work.space.count
    if isinstance(source, Arrays) and isinstance(sink, Arrays):
        if work.space.is_identity:
            for target, held in zip(sink.arrays, source.arrays, strict=True):
                target[...] = held
            return Done(Certificate(0.0, 0.0), count)
        frames, outs = ([engine.view(a) for a in some.arrays] for some in (source, sink))
        if all(a is not None for a in (*frames, *outs)):
            try:
                planes = len(sink.arrays[0])
                return Done(sampled(engine, work, frames, outs, lambda done: tell("warp", done, planes)))
            except EngineError as error:
                warn_of_failure(engine, error, 4)
            return run(source, sink, work, NATIVE, memory=memory, tell=tell)
        work = replace(work, layout=replace(work.layout, dtype=engine.working_dtype(work.layout.dtype)))
        if not work.space.is_plain:
            return _converted(source, sink, work, engine, tell)
    plan = make_plan(work, range(count), lambda done: tell("plan", done, count), engine)
    certificate = Certificate(0.0, 0.0)
    buffered = _AHEAD + 1 if sink.aside else 1
    made = stream(work, plan, source.frames(), memory=memory, buffered=buffered, engine=engine)
    with contextlib.closing(made), _writing(sink) as write:
        for z, arrays, known in made:
            write(arrays, z, still=bool(plan.still[z]))
            certificate |= known
            tell("warp", z + 1, count)
    return Done(certificate, int(plan.still.sum()), capacity_of(plan, engine))


def _converted(source: Arrays, sink: Arrays, work: Work, engine: Engine, tell: Tell) -> Done:
    """Sample copies of frames in the engine's type: a composite map may need any of them at any time."""
    frames = [np.ascontiguousarray(array, work.layout.dtype) for array in source.arrays]
    outs = [np.empty(array.shape, work.layout.dtype) for array in sink.arrays]
    certificate = sampled(engine, work, frames, outs, lambda done: tell("warp", done, len(outs[0])))
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


def make_plan(
    work: Work, planes: Sequence[int], tell: Callable[[int], None] = lambda done: None, engine: Engine = NATIVE
) -> Plan:
    """Solve the lattice of every plane to find the frames that it needs.

    ``tell`` is called at intervals with the number of finished planes.
    """
    space, sampling = work.space, work.sampling
    n, count = len(planes), space.count
    first, last = np.array(planes, np.int64), np.array(planes, np.int64)
    still = np.array([space.is_identity if work.items is None else work.items[z].is_identity for z in planes], bool)
    if space.ndim == 3 and not space.is_identity:
        support, slack = SUPPORT[sampling.between], engine.slack(sampling.tolerance)
        earliest, latest = times_seen(sampling.outside, count, sampling.time_filter)
        step = work.layout.step
        for k, z in enumerate(planes):
            plan = plan_of(space, z, sampling.tolerance, step)
            low, high, moved, rate = plan.extent()
            still[k] = plan.identity or moved * 3**0.5 <= sampling.tolerance
            if not still[k]:
                # A chroma sample covers several pixels; and derivatives between nodes may be larger.
                wide = 1.5 * rate * math.hypot(*step, 1)
                beyond = min(wide, LONGEST) / 2 + 1 if sampling.time_filter else 0.0
                early, late = (min(max(t, earliest), latest) for t in (low[2] - slack, high[2] + slack))
                first[k] = math.floor(early - beyond) - support + 1
                last[k] = math.floor(late + beyond) + support
            if k % 64 == 63 or k == n - 1:
                tell(k + 1)
    needed = np.array([frames_needed(a, b, count, sampling.outside) for a, b in zip(first, last, strict=True)])
    keep = np.minimum.accumulate(needed[::-1, 0])[::-1]
    # The timestamp of a frame is known when it has been read.
    read = np.maximum.accumulate(np.maximum(needed[:, 1], planes)) if n else needed[:, 1]
    return Plan(tuple(planes), first, last, still, keep, read, int((read - keep).max()) + 1)


def capacity_of(plan: Plan, engine: Engine) -> int:
    """Return the number of frames held at once, for planes in progress and the next frame to read."""
    lead = engine.lead
    if not lead or not plan.planes:
        return plan.capacity
    n = len(plan.planes)
    ahead, behind = np.minimum(np.arange(n) + 1, n - 1), np.maximum(np.arange(n) - lead, 0)
    return int((plan.read[ahead] - plan.keep[behind]).max()) + 1


def stream(
    work: Work,
    plan: Plan,
    frames: Iterable[Frame],
    *,
    memory: float = math.inf,
    buffered: int = 1,
    engine: Engine = NATIVE,
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
    engine : Engine
        The engine of the planes, for which the plan was made.

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
        capacity = capacity_of(plan, engine)
        shapes = [(capacity, *g.shape, g.channels) for g in layout.groups]

        def full(size: str, folder: str, reason: str) -> str:
            return (
                f"{capacity} frames have to be held at once, {size}, more than the memory allowed, and there is no "
                f"room for them in {folder} ({reason}): allow more memory, or set TMPDIR to another folder"
            )

        window = stack.enter_context(buffers(shapes, layout.dtype, memory, full))
        sets = [[np.empty((*g.shape, g.channels), layout.dtype) for g in layout.groups] for _ in range(buffered)]
        planes = _WithFallback(engine, work, window, stack)
        source = iter(frames)
        reading = stack.enter_context(_reading(source, work, plan, window, aside=engine.lead > 0))
        waiting: deque[tuple[int, object]] = deque()

        def finished() -> tuple[int, list[Array], Certificate]:
            k, begun = waiting.popleft()
            z, outs = plan.planes[k], sets[k % buffered]
            if plan.still[k]:
                for held, out in zip(window, outs, strict=True):
                    out[...] = held[z % len(held)]
                return z, outs, Certificate(0.0, 0.0)
            return z, outs, planes.finish(begun, z, int(plan.first[k]), int(plan.last[k]), outs)

        for k, z in enumerate(plan.planes):
            reading(k)
            begun = None if plan.still[k] else planes.begin(z, int(plan.first[k]), int(plan.last[k]))
            waiting.append((k, begun))
            if len(waiting) > engine.lead:
                yield finished()
        while waiting:
            yield finished()
        for _ in source:
            pass


class _WithFallback:
    """Planes by an engine and, after it fails, by the native one (`supple.engines.base.Planes`)."""

    def __init__(self, engine: Engine, work: Work, window: Sequence[Array], stack: contextlib.ExitStack) -> None:
        self._engine, self._work, self._window, self._stack = engine, work, window, stack
        self._planes: Planes | None = None
        self._spare: Planes | None = None
        self._warned = False
        with self._failing():
            self._planes = stack.enter_context(_opened(engine, work, window))

    def begin(self, z: int, first: int, last: int) -> object:
        if self._planes is not None:
            with self._failing():
                return (self._planes.begin(z, first, last),)  # not None, whatever the engine returns
        return None

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        if self._planes is not None and begun is not None:
            with self._failing():
                known = self._planes.finish(begun[0], z, first, last, outs)
                note(self._engine.name)
                return known
        # No engine is left, or it failed just now.
        if self._spare is None:
            self._spare = self._stack.enter_context(_opened(NATIVE, self._work, self._window))
        note(NATIVE.name)
        return self._spare.finish(None, z, first, last, outs)

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """Warn of a failure once; drop the engine if the device is lost."""
        try:
            yield
        except EngineError as error:
            if error.lost:
                self._planes = None
            if not self._warned:
                warn_of_failure(self._engine, error, 5)
            self._warned = True


def _opened(engine: Engine, work: Work, window: Sequence[Array]) -> contextlib.AbstractContextManager[Planes]:
    """Return a maker of the planes of a stream."""
    if work.items is None:
        return engine.stream(work, window)
    return contextlib.nullcontext(_Alone(engine, work, window))


@dataclass(frozen=True, slots=True, eq=False)
class _Alone:
    """A maker of planes that are each an image with a map of its own (`supple.engines.base.Planes`)."""

    engine: Engine
    work: Work
    window: Sequence[Array]

    def begin(self, z: int, first: int, last: int) -> object:
        return None

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        assert self.work.items is not None
        work, slot = replace(self.work, space=self.work.items[z], items=None), z % len(self.window[0])
        return sampled(self.engine, work, [held[slot : slot + 1] for held in self.window], [out[None] for out in outs])


@contextlib.contextmanager
def _reading(
    source: Iterator[Frame], work: Work, plan: Plan, window: Sequence[Array], *, aside: bool
) -> Iterator[Callable[[int], None]]:
    """Return a function that reads the frames of a plane into their slots; with ``aside``, a thread reads ahead."""
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

    if not aside:
        yield read
        return
    from concurrent.futures import ThreadPoolExecutor

    ahead: Future[None] | None = None

    def fetch(k: int) -> None:
        nonlocal ahead
        (ahead or begun(k)).result()
        ahead = begun(k + 1) if k + 1 < len(plan.planes) else None

    def begun(k: int) -> Future[None]:
        return pool.submit(copy_context().run, read, k)

    with ThreadPoolExecutor(1, "supple-read") as pool:
        yield fetch


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
