"""The planes of a bent volume: sampled as exports are, shaded, and drawn beside the rendering."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.gpu.device import Gpu
from supple.gpu.screen import ALL, Screen
from supple.media.volume import Volume
from supple.media.volume.data import rescaled
from supple.render.labels import LabelColours
from supple.space.geometry import Grid
from supple.viewer.panels.layers import Layer, Registration
from supple.viewer.panels.stages import VolumeStage, filled
from supple.viewer.tools.planes import FIXED, RENDERED, Plane
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

    def __init__(self, gpu: Gpu, stage: VolumeStage, labels: bool = False) -> None:
        volume, known, transfer = stage.volume, stage.registration, stage.scene.transfer
        self._gpu, self.labels, self.unit, self.segmentation = gpu, labels, stage.unit, stage.segmentation
        self._colours = transfer if isinstance(transfer, LabelColours) else LabelColours()
        self._bent = Layer(volume if known is None else known.moving, known, labels=labels)
        self._fixed = None if known is None or known.fixed is None else Layer(known.fixed)
        self._over: Layer | None = None
        if stage.segmentation is not None:
            known = known or Registration(volume, Deformation(volume.grid, border=None))
            self._over = Layer(stage.segmentation.volume, known, labels=True)
        self._textures: dict[tuple[int, bool], tuple[Any, tuple[Array, ...], object]] = {}
        self._screens: dict[tuple[int, str], Screen] = {}
        self._grid: Grid | None = None  # along the axes of the patient, if planes are
        self._seconds: dict[int, float] = {}  # what each view took the last time

    def sampled(self, deformation: Deformation | None, axis: int, index: int) -> Array:
        """Return slice ``index`` across an axis, bent or not, as `Layer.sampled` does."""
        return self._bent.sampled(deformation, axis, index, self._grid)

    def value(self, deformation: Deformation | None, plane: Plane, point: tuple[float, ...], index: int) -> str:
        """Return the values of all layers at a point of a plane, in words: with the unit, or the name of a label."""
        rest = sorted((plane.across, plane.down), reverse=True)
        at = tuple(math.floor(point[k] + 0.5) for k in rest)
        said = self.told(self.sampled(deformation, plane.axis, index)[at])
        if self._fixed is not None:
            said += f"   fixed {self._fixed.sampled(None, plane.axis, index, self._grid)[at]:.6g}"
        over = None if self._over is None else self._over.sampled(deformation, plane.axis, index, self._grid)
        if over is not None and self.segmentation is not None and (label := int(over[at])):
            said += f"   {_named(label, self.segmentation.colours)}"
        return said

    def told(self, value: Any) -> str:
        """Return a value with its unit, or the name of a label."""
        if self.labels:
            return _named(value, self._colours)
        if self.unit == "label":  # mixed where labels meet
            return f"label {value:.6g}"
        return f"{value:.6g} {self.unit}".rstrip()

    def update(self, tools: VolumeTools, resting: bool = True) -> None:
        """Sample and shade the visible planes, as far as they have changed.

        In a drag, slow planes other than that of the drag wait until the pointer is ``resting``.
        """
        document, self._grid = tools.document, None if tools.upright is None else tools.upright.grid
        bent = document.base if tools.original else document.deformation
        seen = (bent,) if tools.split is None else (bent, document.base)
        for k in tools.places:
            if k == RENDERED:
                continue
            slow = self._seconds.get(k, 0.0) > AT_ONCE
            if slow and tools.dragging and not resting and k != tools.active and (k, False) in self._textures:
                continue
            pane, begun = tools.pane(k), time.perf_counter()
            plane, index = pane.plane, pane.index[pane.plane.axis]
            for second, each in enumerate(seen if k < FIXED else (None,)):
                if (
                    self._upload((k, bool(second)), tools, plane, self._layers(each, k, plane.axis, index))
                    and not second
                ):
                    self._seconds[k] = time.perf_counter() - begun

    def _layers(self, deformation: Deformation | None, k: int, axis: int, index: int) -> tuple[Array, ...]:
        """Return the layers of a view of a plane: the bent volume or the fixed one, or both, and labels."""
        if k >= FIXED:
            return (self._fixed.sampled(None, axis, index, self._grid),) if self._fixed is not None else ()
        rest = (self._fixed, None), (self._over, deformation)
        others = (layer.sampled(bend, axis, index, self._grid) for layer, bend in rest if layer is not None)
        return (self.sampled(deformation, axis, index), *others)

    def _upload(self, key: tuple[int, bool], tools: VolumeTools, plane: Plane, layers: tuple[Array, ...]) -> bool:
        """Upload a plane to the device, unless it is up to date; return whether it was uploaded."""
        known, compared, over = self._textures.get(key), tools.comparison, self.segmentation
        sight = tools.sight
        look = sight.window, sight.fixed, compared and compared.look, over and over.look
        if known is not None and known[2] == look and all(a is b for a, b in zip(known[1], layers, strict=True)):
            return False
        rest, fixed = list(layers[1:]), key[0] >= FIXED
        made = greys(layers[0], sight.fixed) if fixed else self.shaded(layers[0], sight.window)
        if compared is not None and not fixed:
            rows, columns = sorted((plane.across, plane.down), reverse=True)
            steps = tools.geometry.spacing[rows], tools.geometry.spacing[columns]
            made = compared.compared(made, greys(rest.pop(0), sight.fixed), steps)
        if over is not None and rest:
            made = over.tinted(made, rest[0])
        texture = filled(self._gpu, None if known is None else known[0], turned(made, plane))
        self._textures[key] = texture, layers, look
        return True

    def shaded(self, values: Array, window: tuple[float, float]) -> Pixels:
        """Return values as greys within a window, or labels as colours: (rows, columns, 4)."""
        if not self.labels:
            return greys(values, window)
        made = np.full((*values.shape, 4), 255, np.uint8)
        found, places = np.unique(np.nan_to_num(np.asarray(values, np.float64)), return_inverse=True)
        made[..., :3] = np.rint(255 * self._colours.of(found)[places.reshape(values.shape), :3])
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
            x, y = ((start - corner) / side for start, corner, side in zip(low, box, box[2:], strict=False))
            part = x, y, columns / box[2], 0.0, 0.0, rows / box[3], *ALL[6:]
            second = self._textures[k, True][0] if tools.split is not None and k < FIXED else None
            cut = (view[0] + (tools.split or 0.0) * view[2] - low[0]) / columns
            if (k, format) not in self._screens:
                self._screens[k, format] = Screen(self._gpu, format, "nearest" if self.labels else "linear")
            place = (low[0], low[1], columns, rows)
            self._screens[k, format].draw(drawing, self._textures[k, False][0], second, cut, place, part)


def _named(value: Any, colours: LabelColours) -> str:
    """Return the number of a label, with its name if it has one."""
    name = colours.names.get(int(value)) if np.isfinite(value) else None
    return f"label {value:.10g}" + (f" ({name})" if name else "")


def first_window(volume: Volume, unit: str) -> tuple[float, float]:
    """Return the values that are black and white at first: soft tissue in Hounsfield units, or most of the values."""
    if unit == "HU":
        return SOFT_TISSUE
    samples = volume.samples[0] if volume.series else volume.samples
    step = max(1, math.ceil((samples.size / _LOOKED_AT) ** (1 / 3)))
    some = np.asarray(rescaled(samples[::step, ::step, ::step], volume.scaling), np.float64)
    known = some[np.isfinite(some)]
    if not known.size or known.min() == known.max():
        return 0.0, 1.0
    return float(known.min()), float(np.percentile(known[known > known.min()], _BRIGHTEST))


def greys(values: Array, window: tuple[float, float]) -> Pixels:
    """Return values as greys within a window: (rows, columns, 4)."""
    made, (low, high) = np.full((*values.shape, 4), 255, np.uint8), window
    part = (np.asarray(values, np.float32) - np.float32(low)) * np.float32(255 / max(high - low, 1e-30))
    made[..., :3] = np.clip(np.nan_to_num(part) + 0.5, 0, 255).astype(np.uint8)[..., None]
    return made


def physical(place: tuple[float, ...], ratio: float, size: tuple[int, int]) -> Rows:
    """Return a rectangle of the canvas in physical pixels."""
    left, top, right, bottom = (
        round(n * ratio) for n in (place[0], place[1], place[0] + place[2], place[1] + place[3])
    )
    left, top = min(left, size[0] - 1), min(top, size[1] - 1)
    return left, top, max(min(right, size[0]) - left, 1), max(min(bottom, size[1]) - top, 1)


def turned(values: Array, plane: Plane) -> Array:
    """Return the array of a plane, the slower axis first, oriented as on screen: rows down, columns to the right."""
    seen = values if plane.down > plane.across else np.swapaxes(values, 0, 1)
    across, down = plane.signs
    return np.ascontiguousarray(seen[::down, ::across])
