"""Frames that stream through a deformation: what passes between media and engine."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.certificate import Certificate
from supple.errors import SuppleError
from supple.native import LONGEST, SUPPORT, certificate_of, plan_of, sampling_of, slots_of, times_seen
from supple.spill import room_for

if TYPE_CHECKING:
    from concurrent.futures import Future

Array = npt.NDArray[Any]
Tell = Callable[[int], None]

SLACK = 1e-3  # frames


@dataclass(frozen=True, slots=True)
class Group:
    """The components of a frame that share a grid of samples.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of samples.
    channels : int
        How many components. Their samples are arrays of shape (rows, samples, channels).
    step : (int, int)
        Pixels of the frame from one sample to the next, x first: (2, 2) for the chroma of 4:2:0.
    offset : (float, float)
        Where the first sample lies, in pixels of the frame, x first: the siting.
    alpha : bool
        Whether the last channel is opacity.
    """

    shape: tuple[int, int]
    channels: int
    step: tuple[int, int] = (1, 1)
    offset: tuple[float, float] = (0.0, 0.0)
    alpha: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """The layout of a frame.

    Parameters
    ----------
    groups : tuple of Group
        The first has a sample for every pixel of the frame.
    dtype : numpy.dtype
        Of all samples.
    white : float
        The largest value that a sample may have, and that of opaque: 255, 1023, …
    black : tuple of float
        What black is, one value for all components or one for each, in the groups' order.
    """

    groups: tuple[Group, ...]
    dtype: np.dtype[Any]
    white: float
    black: tuple[float, ...] = (0.0,)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame, in pixels."""
        return self.groups[0].shape


class Frame(Protocol):
    """A frame of a clip, as media hand it out."""

    def copy_to(self, arrays: Sequence[Array]) -> None:
        """Copy its samples into one array for each group."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How frames are sampled; see `supple.Deformation.warp`."""

    filter: str = "auto"
    between: str = "linear"
    time_filter: bool = False
    outside: str = "edge"
    fill: tuple[float, ...] = (0.0,)
    light: bool = False
    tolerance: float = 0.01


@dataclass(frozen=True, slots=True)
class Plan:
    """The frames that each plane of the output needs, known before any is read.

    Parameters
    ----------
    planes : tuple of int
        Which planes of the output are wanted, in ascending order.
    first, last : int64 array
        The frames that each of these samples, some perhaps outside the clip.
    still : bool array
        Which of them are their frame, as nothing moves there by more than the tolerance.
    keep, read : int64 array
        When each is made, frames before ``keep`` are done with, and all up to ``read`` have been read.
    capacity : int
        How many frames are held at once.
    """

    planes: tuple[int, ...]
    first: npt.NDArray[np.int64]
    last: npt.NDArray[np.int64]
    still: npt.NDArray[np.bool_]
    keep: npt.NDArray[np.int64]
    read: npt.NDArray[np.int64]
    capacity: int


@dataclass(frozen=True, slots=True)
class Space:
    """The strokes on their domain, as the engine takes them, and the number of frames."""

    table: npt.NDArray[np.void]
    axes: npt.NDArray[np.float64]
    ndim: int
    count: int
    shape: tuple[int, int]

    @property
    def whole(self) -> tuple[int, ...]:
        """The shape of the arrays: of an image, or of all frames."""
        return self.shape if self.ndim == 2 else (self.count, *self.shape)

    def planned(self, step: tuple[int, int]) -> tuple[int, int]:
        """Return rows and columns of a plan, which reaches as far as samples ``step`` pixels apart may lie."""
        height, width = self.shape
        if self.axes[0, 2] >= 0:  # beyond a fixed face, the map goes on as at the face
            return height, width
        return -(-height // step[1]) * step[1], -(-width // step[0]) * step[0]

    def plan(self, z: int, tolerance: float, step: tuple[int, int] = (1, 1)) -> _core.Plan:
        """Solve a plane whose samples are up to ``step`` pixels apart."""
        return plan_of(self.table, self.axes, self.ndim, self.planned(step), float(z), tolerance)


class Maker(Protocol):
    """A maker of planes from the frames in a window, which holds frame k in the slot k modulo its capacity."""

    def begin(self, z: int, first: int, last: int) -> object:
        """Begin a plane that samples the frames ``first`` to ``last``, which are in the window."""

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        """Put what was begun, whose frames are still in the window, into an array for each group."""


class Engine(Protocol):
    """Who makes the planes of a stream."""

    @property
    def lead(self) -> int:
        """How many planes are begun before the first of them is finished; if any, frames are read in a thread."""

    @property
    def slack(self) -> float:
        """By how many frames its source points may lie outside the bounds that a plan knows."""

    def opened(
        self, space: Space, layout: Layout, sampling: Sampling, window: Sequence[Array]
    ) -> contextlib.AbstractContextManager[Maker]:
        """Return what makes planes from a window: for each group, an array (capacity, h, w, channels)."""


@dataclass(frozen=True, slots=True)
class _Ready:
    """The maker whose planes are made when they are to be finished."""

    make: Callable[[int, int, int, Sequence[Array]], Certificate]

    def begin(self, z: int, first: int, last: int) -> object:
        return None

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        return self.make(z, first, last, outs)


@dataclass(frozen=True, slots=True)
class Cpu:
    """The engine that runs everywhere."""

    lead: int = 0
    slack: float = SLACK

    def opened(
        self, space: Space, layout: Layout, sampling: Sampling, window: Sequence[Array]
    ) -> contextlib.AbstractContextManager[Maker]:
        """See `Engine`."""
        return contextlib.nullcontext(_Ready(_maker(space, layout, sampling, window)))


CPU = Cpu()


def make_plan(
    space: Space,
    layout: Layout,
    sampling: Sampling,
    planes: Sequence[int],
    tell: Tell = lambda done: None,
    engine: Engine = CPU,
) -> Plan:
    """Solve the lattice of every plane for the frames that it needs.

    ``tell`` is called with the number of planes done, now and then.
    """
    n = len(planes)
    first, last = np.array(planes, np.int64), np.array(planes, np.int64)
    still = np.full(n, space.table.size == 0)
    if space.ndim == 3 and space.table.size:
        support = SUPPORT[sampling.between]
        earliest, latest = times_seen(sampling.outside, space.count, sampling.time_filter)
        step = step_of(layout)

        for k, z in enumerate(planes):
            plan = space.plan(z, sampling.tolerance, step)
            low, high, moved, rate = plan.extent()
            still[k] = plan.identity or moved * 3**0.5 <= sampling.tolerance
            if not still[k]:
                # A sample of chroma covers several pixels; and rates between nodes may be larger.
                wide = 1.5 * rate * math.hypot(*step, 1)
                beyond = min(wide, LONGEST) / 2 + 1 if sampling.time_filter else 0.0
                # Points are of float32, and may lie a little outside the bounds.
                seen = low[2] - engine.slack, high[2] + engine.slack
                early, late = (min(max(t, earliest), latest) for t in seen)
                first[k] = math.floor(early - beyond) - support + 1
                last[k] = math.floor(late + beyond) + support
            if k % 64 == 63 or k == n - 1:
                tell(k + 1)
    needed = np.array([frames_needed(a, b, space.count, sampling.outside) for a, b in zip(first, last, strict=True)])
    keep = np.minimum.accumulate(needed[::-1, 0])[::-1]
    # A frame's own time is known when it has been read.
    read = np.maximum.accumulate(np.maximum(needed[:, 1], planes)) if n else needed[:, 1]
    return Plan(tuple(planes), first, last, still, keep, read, int((read - keep).max()) + 1)


def frames_needed(first: int, last: int, count: int, outside: str) -> tuple[int, int]:
    """The frames of the clip that stand for a range of times."""
    if outside == "reflect" and (first < 0 or last >= count):
        seen = slots_of(max(first, last - 2 * count), last, count, outside, count)
        return int(seen.min()), int(seen.max())
    return min(max(first, 0), count - 1), min(max(last, 0), count - 1)


def stream(
    space: Space,
    layout: Layout,
    sampling: Sampling,
    plan: Plan,
    frames: Iterable[Frame],
    *,
    memory: float = math.inf,
    buffers: int = 1,
    engine: Engine = CPU,
) -> Iterator[tuple[int, list[Array], Certificate]]:
    """Warp a clip as it is read.

    Parameters
    ----------
    space, layout, sampling, plan
        What to do, with what.
    frames : iterable of Frame
        All frames of the clip in order; it is read to its end.
    memory : float
        How many bytes frames may take in memory; beyond, they go to a temporary file.
    buffers : int
        For how many planes the samples are kept.
    engine : Engine
        Who makes the planes; the one that the plan was made for.

    Yields
    ------
    int
        A plane of the output.
    list of arrays
        Its samples, one array (h, w, channels) for each group, which a later one overwrites: the next, unless there
        are more buffers.
    Certificate
        How exact its map is.

    Raises
    ------
    SuppleError
        If there are fewer frames than the plan needs, or no room for the temporary file.
    """
    with contextlib.ExitStack() as stack:
        capacity = capacity_of(plan, engine)
        shapes = [(capacity, *g.shape, g.channels) for g in layout.groups]
        window = stack.enter_context(room_for(shapes, layout.dtype, memory))
        sets = [[np.empty((*g.shape, g.channels), layout.dtype) for g in layout.groups] for _ in range(buffers)]
        maker = stack.enter_context(engine.opened(space, layout, sampling, window))
        source = iter(frames)
        reading = stack.enter_context(_reading(source, space.count, plan, window, aside=engine.lead > 0))
        waiting: deque[tuple[int, object]] = deque()

        def finished() -> tuple[int, list[Array], Certificate]:
            k, begun = waiting.popleft()
            z, outs = plan.planes[k], sets[k % buffers]
            if plan.still[k]:
                for held, out in zip(window, outs, strict=True):
                    out[...] = held[z % len(held)]
                return z, outs, Certificate(0.0, 0.0)
            return z, outs, maker.finish(begun, z, int(plan.first[k]), int(plan.last[k]), outs)

        for k, z in enumerate(plan.planes):
            reading(k)
            begun = None if plan.still[k] else maker.begin(z, int(plan.first[k]), int(plan.last[k]))
            waiting.append((k, begun))
            if len(waiting) > engine.lead:
                yield finished()
        while waiting:
            yield finished()
        for _ in source:
            pass


def capacity_of(plan: Plan, engine: Engine) -> int:
    """How many frames are held at once: a plane may be finished when others have been begun, and the next is read."""
    lead = engine.lead
    if not lead or not plan.planes:
        return plan.capacity
    n = len(plan.planes)
    ahead, behind = np.minimum(np.arange(n) + 1, n - 1), np.maximum(np.arange(n) - lead, 0)
    return int((plan.read[ahead] - plan.keep[behind]).max()) + 1


@contextlib.contextmanager
def _reading(
    source: Iterator[Frame], count: int, plan: Plan, window: Sequence[Array], *, aside: bool
) -> Iterator[Callable[[int], None]]:
    """Return a function that reads the frames of a plane into their slots; aside, those of the next plane meanwhile."""
    have = 0

    def read(k: int) -> None:
        nonlocal have
        while have <= plan.read[k]:
            frame = next(source, None)
            if frame is None:
                raise SuppleError(f"the clip ends after {have} frames, where {count} were expected")
            if have >= plan.keep[k]:
                frame.copy_to([held[have % len(held)] for held in window])
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


def step_of(layout: Layout) -> tuple[int, int]:
    """Return how many pixels apart the samples lie that lie farthest apart."""
    return max(g.step[0] for g in layout.groups), max(g.step[1] for g in layout.groups)


def fills_of(layout: Layout, sampling: Sampling) -> list[npt.NDArray[np.float64]]:
    """Return the fill values of each group."""
    channels = [g.channels for g in layout.groups]
    values = np.broadcast_to(np.asarray(sampling.fill, np.float64), sum(channels))
    return np.split(values, np.cumsum(channels)[:-1])


def samplings_of(
    space: Space, layout: Layout, sampling: Sampling, frames: Sequence[Array], outs: Sequence[Array], count: int
) -> list[_core.Sampling]:
    """Return what the core does to some frames, (slots, h, w, channels) of each group."""
    return [
        sampling_of(
            held,
            out,
            count,
            filter=sampling.filter,
            between=sampling.between,
            outside=sampling.outside,
            average=sampling.time_filter and sampling.between != "nearest",
            fill=fill,
            alpha=group.alpha,
            light=sampling.light,
            white=layout.white,
            step=group.step,
            offset=group.offset,
        )
        for group, held, fill, out in zip(layout.groups, frames, fills_of(layout, sampling), outs, strict=True)
    ]


def _maker(
    space: Space, layout: Layout, sampling: Sampling, window: Sequence[Array]
) -> Callable[[int, int, int, Sequence[Array]], Certificate]:
    """Return what fills the arrays of a plane from the frames in a window."""
    step = step_of(layout)
    every = space.plan(0, sampling.tolerance, step) if space.ndim == 2 else None

    def make(z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        plan = every or space.plan(z, sampling.tolerance, step)
        frames, count = window, space.count
        if every:  # each frame is an image of its own
            slot = z % len(window[0])
            frames, count = [held[slot : slot + 1] for held in window], 1
        for each in samplings_of(space, layout, sampling, frames, outs, count):
            plan.sample(each)
        return certificate_of(plan)

    return make
