"""Images and frames as the CPU warps them, on a device that draws them: only what changes is warped again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engines.base import Sampling, Space
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.plate import FINE, Laid, Sight, halved, nodes_of
from supple.geometry import Grid
from supple.strain import mask_of
from supple.strokes import STROKE_DTYPE, numbers

Pixels = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]
Box = tuple[int, int, int, int]  # x0, y0, and x1, y1 beyond the last

CELL = 32  # pixels: the core solves cells of this side as a whole
_EDGE = 4  # pixels beyond those that the window shows, for the filter of its last ones
_SMALLEST = 256  # pixels of the longer side of the smallest level


class Levels:
    """An image, (rows, columns, 4), and smaller ones, each half as large as the one before, made when needed."""

    def __init__(self, pixels: Pixels) -> None:
        self.has_alpha = not bool((pixels[..., 3] == 255).all())
        self._made = [(pixels, Grid(pixels.shape[:2]))]

    def at(self, k: int) -> tuple[Pixels, Grid]:
        """Return a level, and the grid of its pixels; 0 is the image itself."""
        while len(self._made) <= k:
            smaller = halved(self._made[-1][0])
            self._made.append((smaller, Grid(smaller.shape[:2])))
        return self._made[k]

    def of(self, scale: float) -> int:
        """Return the level for a window, of whose pixels each covers some of the image: it has at least as many."""
        longest = max(self._made[0][0].shape)
        most = max(math.ceil(math.log2(longest / _SMALLEST)), 0)
        return min(max(math.ceil(math.log2(scale) - 1.0), 0), most)


class Warped:
    """The visible part of an image, warped as `Deformation.warp` does it."""

    def __init__(self, gpu: Gpu, levels: Levels) -> None:
        self._levels = levels
        self._laid = Laid(gpu, levels.at(0)[0].shape[1::-1])
        self._place: tuple[int, Box] | None = None  # the level and the part that are held
        self.shown: Deformation | None = None

    def bring(self, deformation: Deformation, sight: Sight) -> None:
        """Warp the part that a sight shows, as far as it is not there yet."""
        k = self._levels.of(sight.scale)
        source, grid = self._levels.at(k)
        place = k, _visible(sight, k, source.shape)
        stale = x0, y0, x1, y1 = place[1]
        if self.shown is None or place != self._place:
            self._laid.clear((x0, y0), (x1 - x0, y1 - y0), 2**k)
        elif deformation is not self.shown:
            stale = _common(stale, _cells(changed(self.shown.space, deformation.space), k))
        else:
            return
        self._place, self.shown = place, deformation
        x0, y0, x1, y1 = stale
        if x0 >= x1 or y0 >= y1:
            return
        if deformation.is_identity:
            made = source[y0:y1, x0:x1]
        else:
            part = grid.crop((x0, y0), (x1 - x0, y1 - y0))
            space = replace(_reduced(deformation, k, source.shape), grid=part)
            made, _ = warp_array(source, space, _SAMPLING, alpha=self._levels.has_alpha)
        self._laid.put((x0, y0), made)

    def draw(self, sight: Sight, texture: Any, encoder: Any = None) -> None:
        """Draw what was brought, or a coarser image of it, into a texture; see `Plate.draw`."""
        assert self.shown is not None
        _lay(self._laid, self.shown, sight, texture, encoder)


class WarpedFrame:
    """The visible part of a clip's frame, warped as exports are: where a device cannot."""

    def __init__(self, gpu: Gpu, size: tuple[int, int]) -> None:
        self._laid = Laid(gpu, size)
        self._levels: dict[int, Levels] = {}  # of the frames that it is made of
        self._known: tuple[Deformation, float, tuple[int, Box]] | None = None

    def bring(self, deformation: Deformation, sight: Sight, first: int, frames: list[Pixels]) -> None:
        """Warp the part that a sight shows, as far as it is not there yet, from the frames that it is made of."""
        self._levels = {first + i: self._levels.get(first + i) or Levels(frame) for i, frame in enumerate(frames)}
        each = list(self._levels.values())
        k = each[0].of(sight.scale)
        source = np.stack([levels.at(k)[0] for levels in each])
        box = x0, y0, x1, y1 = _visible(sight, k, source.shape[1:])
        if self._known == (deformation, sight.time, (k, box)):
            return
        self._known = deformation, sight.time, (k, box)
        time = int(sight.time) - first
        part = Grid(source.shape[:3]).crop((x0, y0, time), (x1 - x0, y1 - y0, 1))
        space = replace(_reduced(deformation, k, source.shape[1:], first), grid=part, count=len(source))
        made, _ = warp_array(source, space, _BETWEEN, alpha=False)
        self._laid.clear((x0, y0), (x1 - x0, y1 - y0), 2**k)
        self._laid.put((x0, y0), made[0])

    def draw(self, sight: Sight, texture: Any, encoder: Any = None) -> None:
        """Draw what was brought last into a texture, if there is anything; see `Plate.draw`."""
        if self._known is not None:
            _lay(self._laid, self._known[0], sight, texture, encoder)


def _lay(laid: Laid, deformation: Deformation, sight: Sight, texture: Any, encoder: Any) -> None:
    """Draw what is warped already; the strokes are for the overlay."""
    space = deformation.space
    table = space.table if sight.overlay else _PLAIN
    nodes = _solved(deformation, sight) if table.size and space.freeze is not None else None
    laid.draw(sight, table, space.axes, texture, encoder, nodes)


def _solved(deformation: Deformation, sight: Sight) -> npt.NDArray[np.float32]:
    """Return T⁻¹ at the nodes of a window, as `Laid.draw` takes it: what is frozen is known to the CPU alone."""
    columns, rows = nodes_of(sight.size, FINE)
    n, spacing = deformation.ndim, np.array(deformation.domain.spacing)
    targets = np.full((rows, columns, n), float(sight.time))
    for k, count in enumerate((columns, rows)):
        targets[..., k] = (sight.origin[k] + sight.scale * FINE * np.arange(count)).reshape(
            (1, -1) if k == 0 else (-1, 1)
        )
    found = deformation.inverse(targets)
    slopes = np.linalg.inv(deformation.jacobian(found.points)) * (spacing[:, None] / spacing)
    made = np.zeros((rows, columns, 3, 4), np.float32)
    made[..., 0, :n] = (found.points - targets) * spacing
    made[..., 0, 3], made[..., 1, 3] = found.residual * spacing.min(), found.steps
    made[..., 1, :n], made[..., 2, :n] = slopes[..., 0], slopes[..., 1]
    return made


def changed(before: Space, after: Space) -> tuple[Floats, Floats]:
    """Return a box around all points where two maps of strokes differ: the least and the largest x and y, in pixels."""
    if not np.array_equal(before.axes, after.axes) or before.freeze is not after.freeze:
        return np.full(2, -math.inf), np.full(2, math.inf)
    one, other = numbers(before.table), numbers(after.table)
    most = min(len(one), len(other))
    same = _alike(one[:most], other[:most])
    last = _alike(one[::-1][: most - same], other[::-1][: most - same])
    # Rows that act at once are one map.
    while same and any(table["joined"][same : same + 1].any() for table in (before.table, after.table)):
        same -= 1
    while last and after.table["joined"][-last]:
        last -= 1
    differing = np.concatenate([one[same : len(one) - last], other[same : len(other) - last]])
    rows = differing.view(after.table.dtype)[:, 0]
    pivots, reach = rows["pivot"][:, :2], rows["reach"][:, None]
    low, high = (pivots - reach).min(axis=0, initial=math.inf), (pivots + reach).max(axis=0, initial=-math.inf)
    # A later stroke moves what it reaches, within its reach.
    for row in after.table[len(after.table) - last :]:
        pivot, reach = row["pivot"][:2], row["reach"]
        if (low <= pivot + reach).all() and (pivot - reach <= high).all():
            low, high = np.minimum(low, pivot - reach), np.maximum(high, pivot + reach)
    return low, high


def _alike(one: Floats, other: Floats) -> int:
    """Return the number of rows before the first that differs."""
    equal = (one == other).all(axis=1)
    return len(equal) if equal.all() else int(equal.argmin())


def _cells(box: tuple[Floats, Floats], k: int) -> Box:
    """Return the cells of a level that a box of the image touches, and those beside them, which are split as well."""
    ends = []
    for side, more in zip(box, (-1, 2), strict=True):
        places = (((p + 0.5) / 2**k - 0.5) / CELL for p in side.tolist())
        ends += [(math.floor(min(max(p, -2.0), 1 << 20)) + more) * CELL for p in places]
    x0, y0, x1, y1 = (max(end, 0) for end in ends)
    return x0, y0, x1, y1


def _reduced(deformation: Deformation, k: int, shape: tuple[int, ...], first: int = 0) -> Space:
    """Return the map of an image, or of a clip from a frame on, for a level of it."""
    space = deformation.space
    table, axes = space.table.copy(), space.axes.copy()
    inset = np.array([0.5 * (2**k - 1)] * 2 + [first]) * axes[:, 3]  # the centre of the level's first pixel
    table["pivot"] -= inset
    axes[:, :2] -= inset[:, None]
    axes[:2, 3] *= 2**k
    freeze = mask_of(deformation.domain, tuple(inset.tolist()))
    return replace(space, table=table, axes=axes, shape=(shape[0], shape[1]), freeze=freeze)


def _visible(sight: Sight, k: int, shape: tuple[int, ...]) -> Box:
    """Return the part of a level that a sight shows; at least one pixel."""
    found = []
    for start, count, most in zip(sight.origin, sight.size, shape[1::-1], strict=True):
        ends = (start - 0.5 * sight.scale, start + (count - 0.5) * sight.scale)
        low, high = ((end + 0.5) / 2**k - 0.5 for end in ends)
        first = min(max(math.floor(low) - _EDGE, 0), most - 1)
        found.append((first, min(max(math.ceil(high) + _EDGE, first + 1), most)))
    (x0, x1), (y0, y1) = found
    return x0, y0, x1, y1


def _common(one: Box, other: Box) -> Box:
    """Return the intersection of two boxes."""
    return max(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), min(one[3], other[3])


_SAMPLING, _BETWEEN = Sampling.checked(2), Sampling.checked(3)
_PLAIN = np.zeros(0, STROKE_DTYPE)
