"""Frames from a source to a sink: a plan says which are needed when, and they pass through a window of memory."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.core import certificate_of, plan_of, samplings_of
from supple.engine.memory import buffers
from supple.engine.motion import Motion
from supple.engine.sampling import LONGEST, Certificate
from supple.engine.work import Array, Tell, Work, silent
from supple.errors import GapWarning, SuppleError, aside, warn

if TYPE_CHECKING:
    from concurrent.futures import Future

SUPPORT = {"nearest": 1, "linear": 1, "cubic": 2, "flow": 1}
_KEPT = 1 << 27  # bytes of lattices
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


@dataclass(frozen=True, slots=True)
class Done:
    """The result of a run: the map's certificate, and the numbers of copied planes and of frames held at once."""

    certificate: Certificate
    still: int = 0
    held: int = 0


def run(
    source: Source,
    sink: Sink,
    work: Work,
    *,
    memory: float = math.inf,
    tell: Tell = silent,
) -> Done:
    """Warp all frames of a source into a sink.

    Frames beyond ``memory`` bytes go to a temporary file. ``tell`` is called with ``"plan"`` or ``"warp"``, the number
    of finished planes and their total; its exceptions end the run. SuppleError if the source ends too early, there is
    no room for the temporary file, or the sink refuses a plane.
    """
    count = work.space.count
    plan = make_plan(work, range(count), tell)
    certificate = Certificate(0.0, 0.0)
    buffered = _AHEAD + 1 if sink.aside else 1
    frames = iter(source.frames())
    made = stream(work, plan, frames, memory=memory, buffered=buffered)
    with contextlib.closing(made), _writing(sink) as write:
        for z, arrays, known in made:
            write(arrays, z, still=bool(plan.still[z]))
            certificate |= known
            tell("warp", z + 1, count)
        deque(frames, maxlen=0)
    return Done(certificate, int(plan.still.sum()), plan.capacity)


@dataclass(frozen=True, slots=True)
class Plan:
    """The frames needed for each plane of the output, computed before any is read.

    ``planes`` are those to compute, in ascending order. Each samples the frames from ``first`` to ``last``, some
    perhaps outside the clip, and is ``still`` if all displacements are within the tolerance. When it is computed,
    frames before ``keep`` are no longer needed, and all up to ``read`` have been read; ``capacity`` frames are held at
    once. The lattices of the first planes are kept as ``solved``, as many as fit `_KEPT` bytes, until they are used.
    """

    planes: tuple[int, ...]
    first: npt.NDArray[np.int64]
    last: npt.NDArray[np.int64]
    still: npt.NDArray[np.bool_]
    keep: npt.NDArray[np.int64]
    read: npt.NDArray[np.int64]
    capacity: int
    solved: dict[int, _core.Plan]


def make_plan(work: Work, planes: Sequence[int], tell: Tell = silent) -> Plan:
    """Solve the lattice of every plane to find the frames that it needs.

    ``tell`` is called at intervals with ``"plan"``, the number of finished planes and their total.
    """
    space, sampling = work.space, work.sampling
    n, count = len(planes), space.count
    first, last = np.array(planes, np.int64), np.array(planes, np.int64)
    solved: dict[int, _core.Plan] = {}
    still = np.array([space.is_identity if work.items is None else work.items[z].is_identity for z in planes], bool)
    if work.bent is not None:
        still |= [z not in work.bent for z in planes]
    if space.ndim == 3 and not space.is_identity:
        support = SUPPORT[sampling.between_frames]
        # Beyond these times, an edge or a constant continues unchanged.
        past = 3.0 + (LONGEST / 2 if sampling.averages_frames else 0.0)
        earliest, latest = (-1e9, 1e9) if sampling.outside == "reflect" else (-past, count - 1.0 + past)
        step, room = work.layout.step, _KEPT
        for k, z in enumerate(planes):
            if not still[k]:
                plan = plan_of(space, z, sampling.tolerance, step)
                low, high, moved, rate = plan.extent()
                still[k] = plan.identity or moved * 3**0.5 <= sampling.tolerance
            if not still[k]:
                # A chroma sample covers several pixels; and derivatives between nodes may be larger.
                wide = 1.5 * rate * math.hypot(*step, 1)
                beyond = min(wide, LONGEST) / 2 + 1 if sampling.averages_frames else 0.0
                early, late = (min(max(t, earliest), latest) for t in (low[2] - _SLACK, high[2] + _SLACK))
                first[k] = math.floor(early - beyond) - support + 1
                last[k] = math.floor(late + beyond) + support
                room -= plan.nbytes
                if room >= 0:
                    solved[z] = plan
            if k % 64 == 63 or k == n - 1:
                tell("plan", k + 1, n)
    needed = np.array([_frames_needed(a, b, count, sampling.outside) for a, b in zip(first, last, strict=True)])
    keep = np.minimum.accumulate(needed[::-1, 0])[::-1]
    # A plane has the timestamp of its frame, which must have been read, too.
    read = np.maximum.accumulate(np.maximum(needed[:, 1], planes)) if n else needed[:, 1]
    return Plan(tuple(planes), first, last, still, keep, read, int((read - keep).max()) + 1, solved)


def _frames_needed(first: int, last: int, count: int, outside: str) -> tuple[int, int]:
    """Return the range of frames read for a range of times."""
    if outside == "reflect" and (first < 0 or last >= count):
        k = np.arange(max(first, last - 2 * count), last + 1) % (2 * count)
        seen = np.minimum(k, 2 * count - 1 - k)
        return int(seen.min()), int(seen.max())
    return min(max(first, 0), count - 1), min(max(last, 0), count - 1)


def stream(
    work: Work,
    plan: Plan,
    frames: Iterable[Frame],
    *,
    memory: float = math.inf,
    buffered: int = 1,
    first: int = 0,
) -> Generator[tuple[int, list[Array], Certificate], None, None]:
    """Yield planes of the output: the index of each, its samples, and the certificate of its map.

    Frames are read in order, from number ``first`` on, into a window of those that the plan needs at once, with the
    motion between them: in memory, or beyond ``memory`` bytes in a temporary file. The samples are one array (h, w,
    channels) for each group, reused for the next plane, or for a later one if more are ``buffered``. SuppleError if
    there are fewer frames than the plan needs, or no room for the file.
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
        space, step, tolerance = work.space, layout.step, work.sampling.tolerance
        motion = None
        if work.sampling.between_frames == "flow" and space.ndim == 3 and not space.is_identity:
            left = max(memory - sum(frames.nbytes for frames in window), 0)
            (fields,) = stack.enter_context(buffers([Motion.shape_of(work, capacity)], np.float32, left, full))
            motion = Motion(work, window, fields)
        every = plan_of(space, 0, tolerance, step) if space.ndim == 2 and work.items is None else None  # one map
        read = _reading(iter(frames), work, plan, window, first)
        for k, z in enumerate(plan.planes):
            read(k)
            outs, known = sets[k % buffered], Certificate(0.0, 0.0)
            if plan.still[k]:
                for kept, out in zip(window, outs, strict=True):
                    out[...] = kept[z % capacity]
            else:
                space, held, count = work.space if work.items is None else work.items[z], window, work.space.count
                solved = (
                    every or plan.solved.pop(z, None) or plan_of(space, z if space.ndim == 3 else 0, tolerance, step)
                )
                if space.ndim == 2:  # each frame is an image of its own
                    slot = z % capacity
                    held, count = [frame[slot : slot + 1] for frame in window], 1
                moving = None
                if motion is not None:
                    low, high, _, _ = solved.extent()
                    times = math.floor(low[2] + _SLACK), math.ceil(high[2] - _SLACK)
                    if work.sampling.averages_frames:  # cuts are looked for in all frames of an average
                        times = int(plan.first[k]), int(plan.last[k])
                    moving = motion.between(range(*_frames_needed(*times, count, work.sampling.outside)))
                for each in samplings_of(work, held, outs, count, moving=moving):
                    solved.sample(each)
                known = certificate_of(solved, space)
            yield z, outs, known


def _reading(
    source: Iterator[Frame], work: Work, plan: Plan, window: Sequence[Array], have: int
) -> Callable[[int], None]:
    """Return a function that reads the frames of a plane into their slots; the source begins at frame ``have``."""
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
                if averaged and not warned:
                    warned = not all(np.isfinite(slots[number]).all() for number in averaged)
                    if warned:
                        text = f"frame {have} has NaN or infinite samples, which spread as far as the filter reaches"
                        warn(text, GapWarning)
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
        waiting.append(pool.submit(aside(sink.write), arrays, k, still=still))

    with ThreadPoolExecutor(1, "supple-encode") as pool:
        try:
            yield submit
            while waiting:
                waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
