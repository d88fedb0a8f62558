"""Clips in memory, and what streaming makes of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import Deformation
from supple.engine.sampling import Sampling
from supple.engine.stream import Plan, make_plan, stream
from supple.engine.work import Group, Layout, Space, Work

Array = npt.NDArray[Any]
SHAPE = (41, 67)
COUNT = 12
PLAIN = Sampling()


def layout_of(
    step: tuple[int, int] = (2, 2),
    offset: tuple[float, float] = (0.0, 0.5),
    dtype: str = "u1",
    white: float = 255,
    shape: tuple[int, int] = SHAPE,
    alpha: bool = False,
) -> Layout:
    """Brightness, perhaps with opacity, and two components of colour on a grid of their own."""
    chroma = (-(-shape[0] // step[1]), -(-shape[1] // step[0]))
    groups = (Group(shape, 1 + alpha, alpha=alpha), Group(chroma, 2, step, offset))
    return Layout(groups, np.dtype(dtype), white)


LAYOUTS = {
    "4:2:0": layout_of(),
    "4:2:0 centred": layout_of(offset=(0.5, 0.5)),
    "4:2:2 of 10 bits": layout_of((2, 1), (0.0, 0.0), "u2", 1023),
    "4:1:1": layout_of((4, 1), (1.5, 0.0)),
    "4:4:0": layout_of((1, 2), (0.0, 0.5)),
    "4:4:4 of 12 bits": Layout((Group(SHAPE, 3),), np.dtype("u2"), 4095),
    "grey of floats": Layout((Group(SHAPE, 1),), np.dtype("f4"), 1.0),
}


def noise(layout: Layout, count: int = COUNT, seed: int = 0) -> list[Array]:
    """A clip of all values: for each group, an array (T, h, w, C)."""
    rng = np.random.default_rng(seed)
    shapes = [(count, *g.shape, g.channels) for g in layout.groups]
    if layout.dtype.kind == "f":
        return [rng.uniform(size=shape).astype(layout.dtype) for shape in shapes]
    return [rng.integers(0, int(layout.white), shape, layout.dtype, endpoint=True) for shape in shapes]


class Clip:
    """Frames as media hand them out, which count what is done with them."""

    def __init__(self, arrays: Sequence[Array], length: int | None = None) -> None:
        self.arrays = arrays
        self.length = len(arrays[0]) if length is None else length
        self.given = 0
        self.copied: list[int] = []
        self.slots: set[int] = set()

    def __iter__(self) -> Iterator[Frame]:
        for k in range(self.length):
            assert k == self.given
            self.given += 1
            yield Frame(self, k)


class Frame:
    def __init__(self, clip: Clip, index: int) -> None:
        self.clip, self.index = clip, index

    def copy_to(self, arrays: Sequence[Array]) -> None:
        assert self.index == self.clip.given - 1  # a decoder's frame is gone when the next one is asked for
        self.clip.copied.append(self.index)
        self.clip.slots.add(arrays[0].__array_interface__["data"][0])
        for to, source in zip(arrays, self.clip.arrays, strict=True):
            assert to.shape == source.shape[1:]
            to[...] = source[self.index]


def streamed(
    space: Space,
    layout: Layout,
    arrays: Sequence[Array],
    sampling: Sampling = PLAIN,
    planes: Sequence[int] | None = None,
    memory: float = math.inf,
) -> tuple[list[Array], Plan, Clip]:
    """All planes of the output, for each group; with what is true of any stream."""
    planes = range(space.count) if planes is None else planes
    plan = make_plan(Work(space, layout, sampling), planes)
    clip = Clip(arrays)
    found: list[list[Array]] = [[] for _ in layout.groups]
    seen = []
    for z, parts, certificate in stream(Work(space, layout, sampling), plan, clip, memory=memory):
        seen.append(z)
        assert certificate.error <= max(sampling.tolerance, 0.01)
        assert clip.given <= plan.read[len(seen) - 1] + 1
        for part, group, out in zip(parts, layout.groups, found, strict=True):
            assert part.shape == (*group.shape, group.channels)
            assert part.dtype == layout.dtype
            out.append(part.copy())
    assert seen == list(planes)
    assert clip.given == max(plan.read) + 1  # no more than is needed
    assert clip.copied == sorted(set(clip.copied))
    assert len(clip.slots) <= plan.capacity
    return [np.stack(out) for out in found], plan, clip


def bent(count: int = COUNT, shape: tuple[int, int] = SHAPE, border: float | None = None) -> Deformation:
    d = Deformation((count, *shape), border=border, on_fold="damp").grab(
        (25, 20, 0.4 * count), by=(9, -6, 3), radius=16, reach=None
    )
    return d.grab((shape[1] - 2, shape[0] - 3, 0.7 * count), by=(4, 5, -2.5), radius=11, reach=None)
