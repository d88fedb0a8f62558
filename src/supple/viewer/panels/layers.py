"""Layers on the planes of a volume: the volume, a fixed one to compare it with, and a segmentation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import Sampling
from supple.errors import SuppleError
from supple.fields import Placed
from supple.files.volumes import background_of, least_of
from supple.media.volume import Volume
from supple.media.volume.data import rescaled
from supple.render.labels import LabelColours, labels_in
from supple.space.geometry import Grid

Array = npt.NDArray[Any]
Pixels = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Registration:
    """A volume on the grid of the window, which is its own or that of a fixed volume, and the maps to it."""

    moving: Volume  # on its own grid
    plain: Deformation  # without strokes, on the grid of the window
    maps: tuple[Placed, ...] = ()
    fixed: Volume | None = None


@dataclass
class Segmentation:
    """Labels over a volume, which move with it."""

    volume: Volume
    colours: LabelColours
    opacity: float = 0.45
    hidden: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.labels = tuple(int(k) for k in labels_in(self.volume.samples))
        self.shades = self.colours.of(self.labels)  # sRGB and opacity (N, 4), from 0 to 1

    @property
    def look(self) -> tuple[object, ...]:
        """Everything that a picture depends on, except the labels."""
        return self.opacity, frozenset(self.hidden)

    def tinted(self, pixels: Pixels, values: Array) -> Pixels:
        """Return a picture (rows, columns, 4) under the colours of labels, (rows, columns)."""
        found, places = np.unique(np.nan_to_num(np.asarray(values, np.float64)).astype(np.int64), return_inverse=True)
        shades = self.colours.of(found)
        shades[[int(k) in self.hidden for k in found], 3] = 0.0
        shades = shades[places.reshape(values.shape)].astype(np.float32)
        part, made = self.opacity * shades[..., 3:], pixels.copy()
        made[..., :3] = np.rint(pixels[..., :3] * (1 - part) + 255 * shades[..., :3] * part)
        return made


class Layer:
    """A volume that is sampled on planes of a grid, bent or not; the last planes are cached."""

    def __init__(self, volume: Volume, registration: Registration | None = None, *, labels: bool = False) -> None:
        self._samples = volume.samples[0] if volume.series else volume.samples
        self._scaling, self._labels, some = volume.scaling, labels, self._samples
        floats = some.dtype.kind == "f"
        self._range = (least_of(some), -least_of(some, -1)) if floats else (some.min(), some.max())
        self._registration, self._own = registration, volume.grid
        self._volume = volume
        self._planes: dict[int, list[tuple[Deformation | None, int, Grid | None, Array]]] = {}  # two of each axis

    @cached_property
    def _fill(self) -> Any:
        """The stored value outside the volume."""
        return self._volume.stored(background_of(self._volume, labels=self._labels))

    def sampled(self, deformation: Deformation | None, axis: int, index: int, grid: Grid | None = None) -> Array:
        """Return slice ``index`` across an axis (x is 0), bent or not: (rows, columns), the slower axis first.

        It is a slice of ``grid``, or by default of the window's grid. The last slices of each axis are cached.
        """
        if deformation is not None and deformation.is_identity:
            deformation = None
        kept = self._planes.setdefault(axis, [])
        for known in kept:
            if known[0] is deformation and known[1:3] == (index, grid):
                kept.sort(key=lambda each: each is known)  # now the last one
                return known[3]
        made = rescaled(self._raw(deformation, axis, index, grid), self._scaling)
        self._planes[axis] = [*kept[-1:], (deformation, index, grid, made)]  # the result, and what it is compared with
        return made

    def _raw(self, deformation: Deformation | None, axis: int, index: int, grid: Grid | None) -> Array:
        known = self._registration
        if deformation is None and grid is None and known is None:
            return np.asarray(np.take(self._samples, index, axis=2 - axis))
        own = self._own if known is None else known.plain.grid
        bent = deformation or (Deformation(own, border=None) if known is None else known.plain)
        where = grid or own
        first, sizes = [0, 0, 0], list(where.sizes)
        first[axis], sizes[axis] = index, 1
        maps = () if known is None else known.maps
        space = bent.behind(maps, own).space_on(where.crop(first, sizes), self._own, check=False)
        sampling = Sampling("nearest" if self._labels else "auto").along_all_axes()
        if grid is not None or known is not None:
            sampling = replace(sampling, outside="constant", fill=self._fill)
        raw: Array = warp_array(self._samples, space, sampling, alpha=False)[0].squeeze(2 - axis)
        if not self._labels:
            np.clip(raw, *self._range, out=raw, where=np.isfinite(raw))  # as exports are clamped
        return raw


def segmentation_of(volume: Volume, table: LabelColours | None) -> Segmentation:
    """Return a volume of labels with the names and colours of a table or, without one, of its header."""
    if volume.components > 1:
        raise SuppleError(f"{volume.name} has {volume.components} components, and labels are of one: give one of them")
    samples = volume.samples[0] if volume.series else volume.samples
    if table is None:
        known = volume.is_segmentation
        table = LabelColours.of_segments(volume.header, labels_in(samples)) if known else LabelColours()
    return Segmentation(volume, table)
