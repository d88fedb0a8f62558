"""Images and frames on a device, drawn into textures for a window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engine.work import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import constants, domain, packed, packed_mask
from supple.gpu.memory import Bound, Kept, room
from supple.gpu.shader import CELL, module, shader, source

Floats = npt.NDArray[np.float64]

BACK = (0.12, 0.12, 0.13)  # the sRGB background
OVERLAYS = {"": 0, "grid": 1, "stretch": 2, "residual": 3, "inversions": 4}


@dataclass(frozen=True, slots=True)
class Sight:
    """The visible part of an image in a window."""

    origin: tuple[float, float]  # the position of the first pixel, in pixels of the image
    scale: float  # pixels of the image from one pixel of the window to the next
    size: tuple[int, int]  # columns and rows of the window
    time: float = 0.0  # the frame, of a clip
    # Whether T⁻¹ is solved at every pixel, or, unless something is frozen, interpolated between every 16th: faster,
    # for dragging
    solved: bool = True
    overlay: str = ""  # one of `OVERLAYS`
    every: float = 32.0  # pixels between the lines of a grid
    back: tuple[float, float, float] = BACK  # the sRGB background
    square: float = 8.0  # the width of the checkerboard squares behind transparent pixels, in pixels of the window


class _Sheet:
    """The buffers for drawing into one texture, and the inputs of the last draw."""

    def __init__(self, gpu: Gpu, texture: Any) -> None:
        self.gpu, self.texture, self.view = gpu, texture, texture.create_view()
        self.buffers = {name: Kept(gpu) for name in ("settings", "domain", "strokes", "mask")}
        self.bound = Bound()
        self._drawn: tuple[Any, ...] = (None, self, b"")  # ``self`` is unlike any mask, and unlike None

    def update(self, table: npt.NDArray[np.void], axes: Floats, freeze: Mask | None) -> None:
        """Upload changes since the last draw. Identity tells tables and masks apart."""
        before, drawn = self._drawn, (table, freeze, axes.tobytes())
        if before[0] is table and before[1] is freeze and before[2] == drawn[2]:
            return
        self.buffers["domain"].hold(domain(axes, freeze))
        self.buffers["strokes"].hold(packed(table))
        if before[1] is not freeze:
            self.buffers["mask"].hold(packed_mask(self.gpu, freeze))
        self._drawn = drawn


class _Drawn:
    """An image on a device, drawn through strokes into textures."""

    _laid = False

    def __init__(self, gpu: Gpu, size: tuple[int, int]) -> None:
        self.gpu, self.size = gpu, size
        self._nodes: tuple[int, Any] = (0, None)
        self._sheets: list[_Sheet] = []

    def _resources(self) -> dict[str, Any]:
        """Return the image as the shader's resources."""
        raise NotImplementedError

    def _settings(self) -> dict[str, Any]:
        """Return the image's settings for the shader."""
        raise NotImplementedError

    def draw(
        self,
        sight: Sight,
        table: npt.NDArray[np.void],
        axes: Floats,
        texture: Any,
        encoder: Any = None,
        freeze: Mask | None = None,
    ) -> None:
        """Draw the visible part, warped by packed strokes, into a texture of format rgba8unorm.

        It is recorded into the encoder, or submitted at once.
        """
        gpu = self.gpu
        columns, rows = (max(1, -(-(n - 1) // CELL)) + 1 for n in sight.size)  # of nodes
        if self._nodes[0] < columns * rows:
            self._nodes = columns * rows, room(gpu, 48 * columns * rows)
        if not table.size:
            freeze = None
        sheet = self._sheet(texture)
        settings = {
            "size": sight.size,
            "nodes": (columns, rows),
            "origin": sight.origin,
            "scale": sight.scale,
            "frame": sight.time,
            "time": 0.0 if (axes[2, :3] == (0.0, 0.0, 0.0)).all() else sight.time,  # 0 if frames are separate pictures
            "source": self.size,
            "strokes": table.size,
            "overlay": OVERLAYS[sight.overlay],
            "every": sight.every,
            "back": (*sight.back, max(sight.square, 1.0)),
            **self._settings(),
        }
        chosen = constants(table, freeze) | {
            "BENT": bool(table.size),
            "DRAGGED": not sight.solved and sight.overlay not in ("residual", "inversions"),
            "LAID": self._laid,
        }
        sheet.update(table, axes, freeze)
        text = source("plate")
        made = module(gpu, text)
        sheet.buffers["settings"].hold(made.values(settings))
        given = {name: kept.buffer for name, kept in sheet.buffers.items()}
        given |= {"nodes": self._nodes[1], "target_": sheet.view, **self._resources()}
        commands = encoder or gpu.device.create_command_encoder()
        step = commands.begin_compute_pass()
        step.set_bind_group(0, sheet.bound.group(given, made.group))
        if table.size:
            step.set_pipeline(shader(gpu, text, "solve", constants(table, freeze)).pipeline)
            step.dispatch_workgroups(-(-columns // 8), -(-rows // 8), 1)
        step.set_pipeline(shader(gpu, text, "paint", chosen).pipeline)
        step.dispatch_workgroups(-(-sight.size[0] // 8), -(-sight.size[1] // 8), 1)
        step.end()
        if encoder is None:
            gpu.device.queue.submit([commands.finish()])

    def _sheet(self, texture: Any) -> _Sheet:
        for sheet in self._sheets:
            if sheet.texture is texture:
                return sheet
        # At most four are needed: for the warped image, the original, and both of them during a drag.
        self._sheets = [*self._sheets[-3:], _Sheet(self.gpu, texture)]
        return self._sheets[-1]


class Overlay(_Drawn):
    """An overlay on images that are drawn already."""

    _laid = True

    def __init__(self, gpu: Gpu, size: tuple[int, int]) -> None:
        super().__init__(gpu, size)
        self.under: Any = None
        """A view of the texture of the image, which has the size of what is drawn."""

    def _resources(self) -> dict[str, Any]:
        return {"pixels": None, "laid": self.under}

    def _settings(self) -> dict[str, Any]:
        return {"frames": 1, "levels": 1}


class Plate(_Drawn):
    """Frames on a device: one of an image, or a ring of ``slots`` frames of a clip.

    MemoryError if they exceed the largest binding.
    """

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
        """Hold a frame (rows, columns, 4), sRGB and opacity. If it does not follow those held, the ring starts anew."""
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

    def _resources(self) -> dict[str, Any]:
        return {"pixels": self._pixels, "laid": None}

    def _settings(self) -> dict[str, Any]:
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
    if (pixels[..., 3] == 255).all():
        words = (even[::2] + even[1::2]).view(np.uint64)[..., 0]  # the four channels of a pixel
        words = words[:, ::2] + words[:, 1::2] + 0x0002000200020002
        return (words >> 2 & 0x3FFF3FFF3FFF3FFF)[..., None].view(np.uint16).astype(np.uint8)
    four = even[::2, ::2], even[1::2, ::2], even[::2, 1::2], even[1::2, 1::2]
    weights = [p[..., 3:].astype(np.uint32) for p in four]
    opacity: npt.NDArray[np.uint32] = np.add.reduce(weights)
    colours: npt.NDArray[np.uint32] = np.add.reduce([p[..., :3] * w for p, w in zip(four, weights, strict=True)])
    out = np.empty((*even[::2, ::2].shape[:2], 4), np.uint8)
    out[..., :3] = (colours + opacity // 2) // np.maximum(opacity, 1)
    out[..., 3] = ((opacity + 2) // 4)[..., 0]
    return out
