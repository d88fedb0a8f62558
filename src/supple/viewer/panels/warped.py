"""Images as the CPU warps them, on a device that draws them: only what changes is warped again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import DEFAULT
from supple.engine.work import Space
from supple.folding.strain import mask_of
from supple.gpu.device import Gpu
from supple.gpu.plate import Laid, Sight, halved
from supple.space.geometry import Grid
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
            made, _ = warp_array(source, space, DEFAULT, alpha=self._levels.has_alpha)
        self._laid.put((x0, y0), made)

    def draw(self, sight: Sight, texture: Any, encoder: Any = None) -> None:
        """Draw what was brought, or a coarser image of it, into a texture; see `Plate.draw`."""
        assert self.shown is not None
        space = self.shown.space  # for the overlay
        table = space.table if sight.overlay else _PLAIN
        self._laid.draw(sight, table, space.axes, texture, encoder, space.freeze)


def changed(before: Space, after: Space) -> tuple[Floats, Floats]:
    """Return a box around all points where two maps of strokes differ: the least and the largest x and y, in pixels."""
    if (before.axes != after.axes).any() or before.freeze is not after.freeze:
        return np.full(2, -math.inf), np.full(2, math.inf)
    one, other = numbers(before.table), numbers(after.table)
    most = min(len(one), len(other))
    same = _alike(one[:most], other[:most])
    last = _alike(one[::-1][: most - same], other[::-1][: most - same])
    # Rows that act at once are one map.
    while same and (before.table["joined"][same : same + 1].any() or after.table["joined"][same : same + 1].any()):
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
    differs = (one != other).any(axis=1)
    first = int(differs.argmax()) if len(differs) else 0
    return first if len(differs) and differs[first] else len(differs)


def _cells(box: tuple[Floats, Floats], k: int) -> Box:
    """Return the cells of a level that a box of the image touches, and those beside them, which are split as well."""
    ends = []
    for side, more in zip(box, (-1, 2), strict=True):
        places = (((p + 0.5) / 2**k - 0.5) / CELL for p in side.tolist())
        ends += [(math.floor(min(max(p, -2.0), 1 << 20)) + more) * CELL for p in places]
    x0, y0, x1, y1 = (max(end, 0) for end in ends)
    return x0, y0, x1, y1


def _reduced(deformation: Deformation, k: int, shape: tuple[int, ...]) -> Space:
    """Return the map of an image for a level of it."""
    space = deformation.space
    table, axes = space.table.copy(), space.axes.copy()
    inset = np.array([0.5 * (2**k - 1)] * 2 + [0.0]) * axes[:, 3]  # the centre of the level's first pixel
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


_PLAIN = np.zeros(0, STROKE_DTYPE)
