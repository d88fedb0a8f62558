"""Frames or slices that are all at hand, in memory or mapped to it: planes side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cpu.band import RUN
from supple.cpu.between import LONGEST
from supple.cpu.kernel import share, threads
from supple.cpu.lattice import SIZE, U
from supple.cpu.sampling import numbers_of
from supple.cpu.slab import linear_slab
from supple.cpu.stack import SUPPORT, slots_of, stack_sampler, times_seen
from supple.cpu.warp import Band, Certificate, Plane, bounds_of, each_band, positions, rounding
from supple.streaming import SLACK, Layout, Sampling, Space, fills_of, grid_of, part_of

Array = npt.NDArray[Any]

SLAB = 2  # planes that are worked on without Python in between
MANY = 16  # planes from which on each is worked on by one core; whatever cores there are, so that all agree


def warp_stack(
    space: Space,
    layout: Layout,
    sampling: Sampling,
    planes: Sequence[int],
    sources: Sequence[Array],
    outs: Sequence[Array],
) -> Iterator[tuple[int, Certificate]]:
    """Warp a clip or a volume whose frames can be read in any order.

    Unlike `supple.streaming.stream`, it needs no plan, as nothing has to be held: each plane finds the frames it needs.

    Parameters
    ----------
    space, layout, sampling
        What to do, with what.
    planes : sequence of int
        Which planes of the output are wanted.
    sources : sequence of arrays
        All frames, one array (T, h, w, channels) for each group: contiguous, of the layout's type.
    outs : sequence of arrays
        Where the planes go, in the order of ``planes``: one array (len(planes), h, w, channels) for each group.

    Yields
    ------
    int
        How many planes are done.
    Certificate
        How exact the map is of those that were done since the last time.
    """
    grid = grid_of(layout)
    step = grid.step if grid else (1, 1)
    samplers = [
        stack_sampler(
            np.asarray(source),
            space.count,
            filter=sampling.filter,
            between_frames=sampling.between,
            average=sampling.time_filter,
            outside=sampling.outside,
            fill=fill,
            alpha=group.alpha,
            light=sampling.light,
            white=layout.white,
        )
        for group, source, fill in zip(layout.groups, sources, fills_of(layout, sampling), strict=True)
    ]
    beyond = (LONGEST / 2 + 1 if sampling.time_filter else 0.0) + SLACK
    support = SUPPORT[sampling.between]
    earliest, latest = times_seen(sampling.outside, space.count, sampling.time_filter)

    def one(k: int) -> Certificate:
        plane = space.solve(planes[k], step)
        if _is_still(plane, sampling.tolerance):
            for source, out in zip(sources, outs, strict=True):
                out[k] = source[planes[k]]
            return Certificate(0.0, plane.evaluations)

        def use(band: Band) -> None:
            times = band.boxes[:, :, 2]
            early, late = (min(max(float(t), earliest), latest) for t in (times.min(), times.max()))
            first, last = math.floor(early - beyond) - support + 1, math.floor(late + beyond) + support
            slots = slots_of(first, last, space.count, sampling.outside, space.count)
            for sample, group, out in zip(samplers, layout.groups, outs, strict=True):
                sample(part_of(band, group, grid), np.asarray(out[k]), first, slots)

        return each_band(plane, sampling.tolerance, use, grid, sampling.time_filter, len(planes) >= MANY)

    if len(planes) >= MANY and _is_plain(space, layout, sampling):
        yield from _slabs(space, layout, sampling, planes, sources[0], outs[0], one)
        return
    together = 8 * threads()
    for start in range(0, len(planes), together):
        chunk = range(start, min(start + together, len(planes)))
        # Of a few planes, the bands are shared instead.
        found = share(one, chunk) if len(planes) >= MANY else [one(k) for k in chunk]
        certificate = Certificate(0.0, 0.0)
        for known in found:
            certificate |= known
        yield chunk.stop, certificate


def _is_plain(space: Space, layout: Layout, sampling: Sampling) -> bool:
    """Whether `supple.cpu.slab` knows what to do."""
    group = layout.groups[0]
    plain = (sampling.filter, sampling.between, sampling.outside) == ("linear", "linear", "edge")
    mixed = group.alpha or sampling.light or sampling.time_filter
    return plain and not mixed and len(layout.groups) == 1 and group.channels == 1 and min(space.shape) > 1


def _slabs(
    space: Space,
    layout: Layout,
    sampling: Sampling,
    planes: Sequence[int],
    source: Array,
    out: Array,
    alone: Callable[[int], Certificate],
) -> Iterator[tuple[int, Certificate]]:
    """The same, a few planes at a time without Python in between."""
    height, width = space.shape
    xs, ys = positions(width, space.axes[0]), positions(height, space.axes[1])
    slack = rounding(min(max(height, width), 2 * RUN * SIZE))
    n = numbers_of(layout.dtype, np.zeros(1), alpha=False, light=False, white=layout.white)
    flat, shape = np.asarray(source).reshape(-1), np.array([space.count, height, width])
    floats = layout.dtype == np.float32 == n.dtype
    wanted, found = np.asarray(planes, np.int64), np.empty((len(planes), 3))

    def slab(start: int) -> None:
        some = slice(start, min(start + SLAB, len(planes)))
        linear_slab(
            space.table, space.axes, wanted[some], xs, ys, sampling.tolerance, slack, flat, shape,
            n.dtype.type(0), n.whole, n.high, floats, np.asarray(out[some]), found[some],
        )  # fmt: skip

    together = SLAB * 16 * threads()  # few ends to wait for
    for start in range(0, len(planes), together):
        end = min(start + together, len(planes))
        share(slab, range(start, end, SLAB))
        certificate = Certificate(float(found[start:end, 0].max()), float(found[start:end, 1].sum()))
        for k in np.flatnonzero(found[start:end, 2]) + start:
            certificate |= alone(int(k))
        yield end, certificate


def _is_still(plane: Plane, tolerance: float) -> bool:
    """Whether nothing on a plane moves by more than the tolerance."""
    seen = float(np.abs(plane.nodes[..., U : U + 3]).max())
    # Bounds of the whole plane are worth their while where the nodes have not settled it.
    return seen * 3**0.5 <= tolerance and bounds_of(plane, tolerance).moved * 3**0.5 <= tolerance
