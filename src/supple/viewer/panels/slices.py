"""The planes of a bent volume: sampled as exports are, shaded, and drawn beside the rendering."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import Sampling
from supple.gpu.device import Gpu
from supple.gpu.screen import Screen
from supple.media.volume import Volume
from supple.media.volume.data import rescaled
from supple.render.labels import LabelColours
from supple.viewer.panels.stages import filled
from supple.viewer.tools.planes import RENDERED, Plane
from supple.viewer.tools.volumes import VolumeTools

Array = npt.NDArray[Any]
Pixels = npt.NDArray[np.uint8]
Rows = tuple[int, int, int, int]
"""A rectangle in physical pixels: left, top, columns and rows."""

AT_ONCE = 0.05  # seconds: slower planes wait, in a drag, until the pointer rests
SOFT_TISSUE = (-160.0, 240.0)  # Hounsfield units
_BRIGHTEST = 99.5  # a percentile of the values that are no background
_LOOKED_AT = 1 << 20  # voxels


class Slices:
    """The planes of a volume, of a series the first; labels are not mixed, and have colours of their own."""

    def __init__(
        self, gpu: Gpu, volume: Volume, labels: bool = False, unit: str = "", colours: LabelColours | None = None
    ) -> None:
        self._gpu, self.labels, self.unit = gpu, labels, unit
        self._samples = _first(volume)
        self._scaling, self._names = volume.scaling, _names_in(volume.header)
        self._colours = colours or LabelColours()
        self._range = _range_of(self._samples)
        self._planes: dict[int, list[tuple[Deformation | None, int, Array]]] = {}  # two of each axis
        self._textures: dict[tuple[int, bool], tuple[Any, Array, tuple[float, float]]] = {}
        self._screens: dict[tuple[int, str], Screen] = {}
        self._seconds: dict[int, float] = {}  # what each view took the last time

    def sampled(self, deformation: Deformation | None, axis: int, index: int) -> Array:
        """Return a plane of the volume, bent or not, by its two axes, the slower one first; the last ones are kept."""
        if deformation is not None and deformation.is_identity:
            deformation = None
        kept = self._planes.setdefault(axis, [])
        for known in kept:
            if known[0] is deformation and known[1] == index:
                kept.remove(known)
                kept.append(known)
                return known[2]
        if deformation is None:
            raw = np.take(self._samples, index, axis=2 - axis)
        else:
            first, sizes = [0, 0, 0], list(self._samples.shape[::-1])
            first[axis], sizes[axis] = index, 1
            sampling = Sampling("nearest" if self.labels else "auto").along_all_axes()
            space = deformation.space_on(deformation.grid.crop(first, sizes))
            raw = warp_array(self._samples, space, sampling, alpha=False)[0].squeeze(2 - axis)
            if not self.labels:
                np.clip(raw, *self._range, out=raw, where=np.isfinite(raw))  # as exports are clamped
        made = rescaled(raw, self._scaling)
        self._planes[axis] = [*kept[-1:], (deformation, index, made)]  # the result, and what it is compared with
        return made

    def value(self, deformation: Deformation | None, plane: Plane, point: tuple[float, ...], index: int) -> str:
        """Return the value of the voxel at a point of a plane, with its unit, or the name of a label."""
        rest = sorted((plane.across, plane.down), reverse=True)
        value = self.sampled(deformation, plane.axis, index)[tuple(math.floor(point[k] + 0.5) for k in rest)]
        return self.told(value)

    def told(self, value: Any) -> str:
        """Return a value with its unit, or the name of a label."""
        if self.labels:
            name = self._names.get(int(value)) if np.isfinite(value) else None
            return f"label {value:g}" + (f" ({name})" if name else "")
        if self.unit == "label":  # mixed where labels meet
            return f"label {value:.6g}"
        return f"{value:.6g} {self.unit}".rstrip()

    def update(self, tools: VolumeTools, resting: bool = True) -> None:
        """Sample and shade what is to be seen of the visible planes.

        In a drag, planes other than its own that take long are left until the pointer is ``resting``.
        """
        document = tools.document
        bent = document.base if tools.original else document.deformation
        seen = (bent,) if tools.split is None else (bent, document.base)
        for k in tools.places:
            if k == RENDERED:
                continue
            slow = self._seconds.get(k, 0.0) > AT_ONCE
            if slow and tools.dragging and not resting and k != tools.active and (k, False) in self._textures:
                continue
            plane, begun = tools.planes[k], time.perf_counter()
            for second, each in enumerate(seen):
                made = self.sampled(each, plane.axis, tools.index[plane.axis])
                if self._upload((k, bool(second)), plane, made, tools.sight.window) and not second:
                    self._seconds[k] = time.perf_counter() - begun

    def _upload(self, key: tuple[int, bool], plane: Plane, values: Array, window: tuple[float, float]) -> bool:
        """Upload a plane to the device, if it is not there; return whether it was not."""
        known = self._textures.get(key)
        if known is not None and known[1] is values and known[2] == window:
            return False
        texture = filled(self._gpu, None if known is None else known[0], turned(self.shaded(values, window), plane))
        self._textures[key] = texture, values, window
        return True

    def shaded(self, values: Array, window: tuple[float, float]) -> Pixels:
        """Return values as greys within a window, or labels as colours: (rows, columns, 4)."""
        made = np.full((*values.shape, 4), 255, np.uint8)
        if self.labels:
            found, places = np.unique(np.nan_to_num(np.asarray(values, np.float64)), return_inverse=True)
            made[..., :3] = np.rint(255 * self._colours.of(found)[places.reshape(values.shape), :3])
            return made
        low, high = window
        part = (np.asarray(values, np.float32) - np.float32(low)) * np.float32(255 / max(high - low, 1e-30))
        made[..., :3] = np.clip(np.nan_to_num(part) + 0.5, 0, 255).astype(np.uint8)[..., None]
        return made

    def draw(self, drawing: Any, format: str, tools: VolumeTools, ratio: float, size: tuple[int, int]) -> None:
        """Draw the planes into a render pass of columns and rows."""
        for k in tools.places:
            if k == RENDERED or (k, False) not in self._textures:
                continue
            pane = tools.pane(k)
            view, box = physical(pane.place, ratio, size), [n * ratio for n in pane.box]
            low = [max(view[i], math.floor(box[i])) for i in (0, 1)]
            high = [min(view[i] + view[i + 2], math.ceil(box[i] + box[i + 2])) for i in (0, 1)]
            columns, rows = high[0] - low[0], high[1] - low[1]
            if columns <= 0 or rows <= 0:
                continue
            part = (
                (low[0] - box[0]) / box[2],
                (low[1] - box[1]) / box[3],
                columns / box[2],
                0.0,
                0.0,
                rows / box[3],
            )
            second = self._textures[k, True][0] if tools.split is not None else None
            cut = (view[0] + (tools.split or 0.0) * view[2] - low[0]) / columns
            if (k, format) not in self._screens:
                self._screens[k, format] = Screen(self._gpu, format, "nearest" if self.labels else "linear")
            place = (low[0], low[1], columns, rows)
            self._screens[k, format].draw(drawing, self._textures[k, False][0], second, cut, place, part)


def first_window(volume: Volume, unit: str) -> tuple[float, float]:
    """Return the values that are black and white at first: soft tissue in Hounsfield units, or most of the values."""
    if unit == "HU":
        return SOFT_TISSUE
    samples = _first(volume)
    step = max(1, math.ceil((samples.size / _LOOKED_AT) ** (1 / 3)))
    some = np.asarray(rescaled(samples[::step, ::step, ::step], volume.scaling), np.float64)
    known = some[np.isfinite(some)]
    if not known.size or known.min() == known.max():
        return 0.0, 1.0
    return float(known.min()), float(np.percentile(known[known > known.min()], _BRIGHTEST))


def _first(volume: Volume) -> Array:
    return volume.samples[0] if volume.series else volume.samples


def physical(place: tuple[float, ...], ratio: float, size: tuple[int, int]) -> Rows:
    """Return a rectangle of the canvas in physical pixels."""
    left, top, right, bottom = (
        round(n * ratio) for n in (place[0], place[1], place[0] + place[2], place[1] + place[3])
    )
    left, top = min(left, size[0] - 1), min(top, size[1] - 1)
    return left, top, max(min(right, size[0]) - left, 1), max(min(bottom, size[1]) - top, 1)


def turned(values: Array, plane: Plane) -> Array:
    """Return the array of a plane, the slower axis first, as it is seen: rows downwards, columns to the right."""
    seen = values if plane.down > plane.across else np.swapaxes(values, 0, 1)
    across, down = plane.signs
    return np.ascontiguousarray(seen[::down, ::across])


def _range_of(samples: Array) -> tuple[Any, Any]:
    if samples.dtype.kind != "f":
        return samples.min(), samples.max()
    low, high = np.inf, -np.inf
    for slab in samples:
        known = slab[np.isfinite(slab)]
        if known.size:
            low, high = min(low, known.min()), max(high, known.max())
    return (low, high) if low <= high else (-np.inf, np.inf)


def _names_in(header: Any) -> dict[int, str]:
    """Return the names of labels in the header of a segmentation of 3D Slicer."""
    if not isinstance(header, Mapping):
        return {}
    names = {}
    for key, name in header.items():
        found = re.fullmatch(r"Segment(\d+)_Name", str(key))
        value = str(header.get(f"Segment{found[1]}_LabelValue", "")) if found else ""
        if value.isdigit():
            names[int(value)] = str(name)
    return names
