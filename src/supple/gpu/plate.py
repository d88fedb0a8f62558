"""Images and frames on a device, drawn into textures for a window."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.folding.strain import Mask
from supple.gpu.buffers import Bound, Kept
from supple.gpu.device import Gpu
from supple.gpu.field import FIELD, constants, domain, packed, packed_mask
from supple.gpu.kernel import PICTURE, READ, TEXTURE, UNIFORM, WRITE, bound, pipeline, room

Floats = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]  # x0, y0, and x1, y1

CELL = 16  # pixels of the window from node to node
BACK = (0.12, 0.12, 0.13)  # the sRGB background
OVERLAYS = {"": 0, "grid": 1, "stretch": 2, "residual": 3, "inversions": 4}
NOWHERE: Box = (math.inf, math.inf, -math.inf, -math.inf)
EVERYWHERE: Box = (-math.inf, -math.inf, math.inf, math.inf)
_NAMES = ("plate", "warm", "blend", *FIELD)
_COMMON = (UNIFORM, UNIFORM, READ, WRITE, READ)

_SETTINGS = np.dtype(
    [
        ("size", "u4", 2),
        ("nodes", "u4", 2),
        ("origin", "f4", 2),
        ("scale", "f4"),
        ("time", "f4"),
        ("source", "u4", 2),
        ("frames", "u4"),
        ("earliest", "u4"),
        ("held", "u4"),
        ("slots", "u4"),
        ("stride", "u4"),
        ("levels", "u4"),
        ("strokes", "u4"),
        ("solved", "u4"),
        ("overlay", "u4"),
        ("every", "f4"),
        ("corner", "f4", 2),
        ("first", "u4", 2),
        ("back", "f4", 4),
        ("step", "f4"),
        ("unused", "u4", 3),
    ]
)


@dataclass(frozen=True, slots=True)
class Sight:
    """The visible part of an image in a window.

    Parameters
    ----------
    origin : (float, float)
        The position of the first pixel, in pixels of the image.
    scale : float
        Pixels of the image from one pixel of the window to the next.
    size : (int, int)
        Columns and rows of the window.
    time : float
        The frame, of a clip.
    solved : bool
        Whether T⁻¹ is solved at every pixel, or, unless something is frozen, interpolated between every 16th: faster,
        for dragging.
    overlay : str
        One of `OVERLAYS`.
    every : float
        Pixels between the lines of a grid.
    back : (float, float, float)
        The sRGB background.
    square : float
        The width of the checkerboard squares behind transparent pixels, in pixels of the window.
    """

    origin: tuple[float, float]
    scale: float
    size: tuple[int, int]
    time: float = 0.0
    solved: bool = True
    overlay: str = ""
    every: float = 32.0
    back: tuple[float, float, float] = BACK
    square: float = 8.0


def _nodes_of(size: tuple[int, int]) -> tuple[int, int]:
    """Return how many columns and rows of nodes T⁻¹ is interpolated between, for a window of columns and rows."""
    columns, rows = (max(1, -(-(n - 1) // CELL)) + 1 for n in size)
    return columns, rows


class _Sheet:
    """The buffers for drawing into one texture, and what is drawn there."""

    def __init__(self, gpu: Gpu, texture: Any) -> None:
        self.gpu, self.texture, self.view = gpu, texture, texture.create_view()
        self.settings, self.domain, self.strokes = Kept(gpu, UNIFORM), Kept(gpu, UNIFORM), Kept(gpu)
        self.mask = Kept(gpu)
        self.bound = Bound()
        self.stale: Box = NOWHERE  # of pixels put since the last draw
        self._table: Any = None
        self._axes: Any = None
        self._freeze: Mask | None = None
        self._settings = np.zeros(1, _SETTINGS)
        self._told: Any = None

    def tell(self, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None, settings: dict[str, Any]) -> bool:
        """Take what to draw; return whether it is as it was at the last draw.

        Tables and masks are told apart by identity.
        """
        same = self._table is table and self._freeze is freeze and self._told == settings
        if same and np.array_equal(self._axes, axes):
            return True
        for name, value in settings.items():
            self._settings[name] = value
        self.domain.hold(domain(axes, freeze))
        self.strokes.hold(packed(table))
        if self._freeze is not freeze or self._table is None:
            self.mask.hold(packed_mask(self.gpu, freeze))
        self._table, self._axes, self._freeze, self._told = table, axes, freeze, settings
        return False

    def held(self, first: tuple[int, int]) -> tuple[Any, ...]:
        """Return the buffers of settings, a domain, strokes and a mask; the first pixel is that to draw."""
        self._settings["first"] = first
        return self.settings.hold(self._settings), self.domain.buffer, self.strokes.buffer, self.mask.buffer


class _Drawn:
    """What is on a device, drawn through strokes into textures."""

    _entry: str  # of the shader
    _kinds: tuple[str | None, ...]
    _chosen: tuple[str, ...]  # the constants that it is compiled for

    def __init__(self, gpu: Gpu, size: tuple[int, int]) -> None:
        self.gpu, self.size = gpu, size
        self._nodes: tuple[int, Any] = (0, None)
        self._sheets: list[_Sheet] = []

    def _held(self, view: Any) -> tuple[Any, ...]:
        """Return the resources after those in common; the view is that of the texture to draw into."""
        raise NotImplementedError

    def _told(self) -> dict[str, Any]:
        """Return settings of what is held."""
        raise NotImplementedError

    def _box(self, sheet: _Sheet, sight: Sight, alike: bool) -> tuple[int, int, int, int]:
        """Return the pixels of the window to draw."""
        return 0, 0, *sight.size

    def draw(
        self,
        sight: Sight,
        table: npt.NDArray[np.void],
        axes: Floats,
        texture: Any,
        encoder: Any = None,
        freeze: Mask | None = None,
    ) -> None:
        """Draw the visible part, warped by strokes, into a texture of format rgba8unorm.

        Parameters
        ----------
        sight : Sight
        table, axes
            The packed strokes (`supple.strokes.pack`) and domain (`Domain.packed`).
        texture : wgpu.GPUTexture
        encoder : wgpu.GPUCommandEncoder, optional
            The encoder to record into; by default, the work is submitted at once.
        freeze : Mask, optional
            The freeze mask that the strokes are subject to.
        """
        gpu, cells = self.gpu, _nodes_of(sight.size)
        if self._nodes[0] < cells[0] * cells[1]:
            self._nodes = cells[0] * cells[1], room(gpu, 48 * cells[0] * cells[1])
        if not table.size:
            freeze = None
        sheet = self._sheet(texture)
        settings = self._settings(sight, cells, table.size)
        x0, y0, x1, y1 = self._box(sheet, sight, sheet.tell(table, axes, freeze, settings))
        sheet.stale = NOWHERE
        if x0 >= x1 or y0 >= y1:
            return
        *told, mask = sheet.held((x0, y0))
        resources = (*told, self._nodes[1], mask, *self._held(sheet.view))
        known = constants(table, freeze)
        chosen = {"BENT": bool(table.size), "SINGLE": not settings["solved"], **known}
        paint, layout = pipeline(gpu, _NAMES, self._entry, self._kinds, {name: chosen[name] for name in self._chosen})
        group = sheet.bound.group(resources, lambda: bound(gpu, layout, resources))
        commands = encoder or gpu.device.create_command_encoder()
        step = commands.begin_compute_pass()
        step.set_bind_group(0, group)
        if table.size:
            step.set_pipeline(pipeline(gpu, _NAMES, "solve", self._kinds, known)[0])
            step.dispatch_workgroups(-(-cells[0] // 8), -(-cells[1] // 8), 1)
        step.set_pipeline(paint)
        step.dispatch_workgroups(-(-(x1 - x0) // 8), -(-(y1 - y0) // 8), 1)
        step.end()
        if encoder is None:
            gpu.device.queue.submit([commands.finish()])

    def _sheet(self, texture: Any) -> _Sheet:
        for sheet in self._sheets:
            if sheet.texture is texture:
                return sheet
        # Those of the warped image, of the original, and of both during a drag.
        self._sheets = [*self._sheets[-3:], _Sheet(self.gpu, texture)]
        return self._sheets[-1]

    def _settings(self, sight: Sight, cells: tuple[int, int], strokes: int) -> dict[str, Any]:
        return {
            "size": sight.size,
            "nodes": cells,
            "origin": sight.origin,
            "scale": sight.scale,
            "time": sight.time,
            "source": self.size,
            "strokes": strokes,
            "solved": sight.solved or sight.overlay in ("residual", "inversions"),
            "overlay": OVERLAYS[sight.overlay],
            "every": sight.every,
            "back": (*sight.back, max(sight.square, 1.0)),
            **self._told(),
        }


class Laid(_Drawn):
    """A part of an image at one size, which is warped already: strokes are for the overlay only."""

    _entry, _kinds, _chosen = "lay", (*_COMMON, None, TEXTURE, PICTURE), ("BENT", "GRABS", "FROZEN", "SINGLE")

    def __init__(self, gpu: Gpu, size: tuple[int, int]) -> None:
        super().__init__(gpu, size)
        self._corner, self._step = (0, 0), 1
        self._texture: Any = None
        self._view: Any = None

    def clear(self, corner: tuple[int, int], size: tuple[int, int], step: int) -> None:
        """Make room for a part: its first pixel, its columns and rows, and the pixels of the image along each side."""
        self._corner, self._step = corner, step
        if self._texture is None or self._texture.size[:2] != size:
            self._texture = self.gpu.device.create_texture(
                size=(*size, 1), format="rgba8unorm", usage="TEXTURE_BINDING|COPY_DST"
            )
            self._view = self._texture.create_view()
        for sheet in self._sheets:
            sheet.stale = EVERYWHERE

    def put(self, corner: tuple[int, int], pixels: npt.NDArray[np.uint8]) -> None:
        """Hold pixels, of shape (rows, columns, 4): sRGB and opacity; the corner is their place in the whole image."""
        height, width = pixels.shape[:2]
        origin = (corner[0] - self._corner[0], corner[1] - self._corner[1], 0)
        self.gpu.device.queue.write_texture(
            {"texture": self._texture, "origin": origin},
            np.ascontiguousarray(pixels),
            {"bytes_per_row": 4 * width, "rows_per_image": height},
            (width, height, 1),
        )
        for sheet in self._sheets:
            x0, y0, x1, y1 = sheet.stale
            x, y = corner
            sheet.stale = min(x0, x), min(y0, y), max(x1, x + width), max(y1, y + height)

    def _box(self, sheet: _Sheet, sight: Sight, alike: bool) -> tuple[int, int, int, int]:
        """Return the pixels of the window that show what was put since the last draw, if all else is as it was."""
        if not alike:
            return 0, 0, *sight.size
        ends = []
        for k, place in enumerate(sheet.stale):
            beyond = -1.5 if k < 2 else 0.5  # a pixel is seen as far as the middles of those beside it
            seen = ((place + beyond + 0.5) * self._step - 0.5 - sight.origin[k % 2]) / sight.scale
            end = min(max(seen + (-2 if k < 2 else 2), 0.0), float(sight.size[k % 2]))  # within a footprint
            ends.append(math.floor(end) if k < 2 else math.ceil(end))
        return ends[0], ends[1], ends[2], ends[3]

    def _held(self, view: Any) -> tuple[Any, ...]:
        return None, view, self._view

    def _told(self) -> dict[str, Any]:
        return {"corner": self._corner, "step": self._step}


class Plate(_Drawn):
    """Frames on a device: one of an image, or a ring of frames of a clip.

    Parameters
    ----------
    gpu : Gpu
    size : (int, int)
        Columns and rows.
    frames : int
        The number of frames of the whole clip.
    slots : int
        The number of frames held at once.

    Raises
    ------
    MemoryError
        If they exceed the largest binding.
    """

    _entry, _kinds, _chosen = "paint", (*_COMMON, READ, TEXTURE), ("BENT", "GRABS", "FROZEN")

    def __init__(self, gpu: Gpu, size: tuple[int, int], frames: int = 1, slots: int = 1) -> None:
        super().__init__(gpu, size)
        self.frames, self.slots = frames, slots
        self.sizes = [size]
        while max(self.sizes[-1]) > 256 and frames == 1:
            width, height = self.sizes[-1]
            self.sizes.append(((width + 1) // 2, (height + 1) // 2))
        self.stride = sum(width * height for width, height in self.sizes)
        if 4 * self.stride * slots > gpu.binding:
            raise MemoryError(f"{4 * self.stride * slots >> 20} MB of pixels are more than a shader takes")
        self.earliest, self.held = 0, 0
        self._pixels = room(gpu, 4 * self.stride * slots)

    @staticmethod
    def most(gpu: Gpu, size: tuple[int, int]) -> int:
        """Return how many frames of a size can be held."""
        return gpu.binding // (4 * size[0] * size[1])

    def put(self, frame: int, pixels: npt.NDArray[np.uint8]) -> None:
        """Hold a frame, of shape (rows, columns, 4): sRGB and opacity. The ring continues from the frames it holds."""
        if not self.earliest <= frame <= self.earliest + self.held:
            self.earliest, self.held = frame, 0
        start = (frame % self.slots) * self.stride * 4
        for width, height in self.sizes:
            level = np.ascontiguousarray(pixels[:height, :width])
            self.gpu.device.queue.write_buffer(self._pixels, start, level.reshape(-1))
            start += level.nbytes
            pixels = halved(level) if (width, height) != self.sizes[-1] else level
        self.held = max(self.held, frame - self.earliest + 1)
        if self.held > self.slots:
            self.earliest, self.held = frame - self.slots + 1, self.slots

    def _held(self, view: Any) -> tuple[Any, ...]:
        return self._pixels, view

    def _told(self) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "earliest": self.earliest,
            "held": max(self.held, 1),
            "slots": self.slots,
            "stride": self.stride,
            "levels": len(self.sizes),
        }


def halved(pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the image at half the size, by averages weighted by opacity."""
    even = np.pad(pixels, [(0, pixels.shape[0] % 2), (0, pixels.shape[1] % 2), (0, 0)], mode="edge").astype(np.uint16)
    four = even[::2, ::2], even[1::2, ::2], even[::2, 1::2], even[1::2, 1::2]
    if (pixels[..., 3] == 255).all():
        return np.asarray((four[0] + four[1] + four[2] + four[3] + 2) // 4, np.uint8)
    weights = [p[..., 3:].astype(np.uint32) for p in four]
    opacity: npt.NDArray[np.uint32] = np.add.reduce(weights)
    colours: npt.NDArray[np.uint32] = np.add.reduce([p[..., :3] * w for p, w in zip(four, weights, strict=True)])
    out = np.empty((*even[::2, ::2].shape[:2], 4), np.uint8)
    out[..., :3] = (colours + opacity // 2) // np.maximum(opacity, 1)
    out[..., 3] = ((opacity + 2) // 4)[..., 0]
    return out
