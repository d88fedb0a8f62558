"""Arrays on a device as textures: drivers read these faster than buffers, and they may be larger than one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.kernel import Array

SIDE = 8192  # texels of a layer, as sample.wgsl has it: a larger frame has several layers
LAYERS = 256
_NAMES = {
    ("uint8", 1): "r8uint",
    ("uint8", 2): "rg8uint",
    ("uint8", 4): "rgba8uint",
    ("uint16", 1): "r16uint",
    ("uint16", 2): "rg16uint",
    ("uint16", 4): "rgba16uint",
    ("float32", 1): "r32float",
    ("float32", 4): "rgba32float",
}


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Room for some frames, one after the other.

    Parameters
    ----------
    texture : wgpu.GPUTexture
    view : wgpu.GPUTextureView
        Of all of its layers.
    blocks : (int, int)
        Layers of a frame, across and down.
    """

    texture: Any
    view: Any
    blocks: tuple[int, int]

    def destroy(self) -> None:
        """Give the device its memory back."""
        self.texture.destroy()

    def put(self, gpu: Gpu, slot: int, frame: Array) -> None:
        """Put a frame (rows, samples, channels) into a slot."""
        across, down = self.blocks
        for j in range(down):
            for i in range(across):
                block = np.ascontiguousarray(frame[j * SIDE : (j + 1) * SIDE, i * SIDE : (i + 1) * SIDE])
                rows, width = block.shape[:2]
                gpu.device.queue.write_texture(
                    {"texture": self.texture, "origin": (0, 0, (slot * down + j) * across + i)},
                    block.reshape(-1).view(np.uint8),
                    {"bytes_per_row": block.nbytes // rows, "rows_per_image": rows},
                    (width, rows, 1),
                )


def blocks_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Layers of a frame of so many rows and samples in a row, across and down."""
    return -(-shape[1] // SIDE), -(-shape[0] // SIDE)


def layers(gpu: Gpu, shape: tuple[int, int], slots: int, dtype: Any, channels: int) -> Layers:
    """Room for frames of so many rows and samples in a row; MemoryError if they have too many layers."""
    across, down = blocks_of(shape)
    count = slots * across * down
    if count > LAYERS:
        raise MemoryError(f"{slots} frames of {shape[1]} by {shape[0]} samples are more than a texture holds")
    texture = gpu.device.create_texture(
        size=(min(shape[1], SIDE), min(shape[0], SIDE), count),
        format=_NAMES[np.dtype(dtype).name, channels],
        usage="TEXTURE_BINDING|COPY_DST",
    )
    return Layers(texture, view_of(texture), (across, down))


def view_of(texture: Any) -> Any:
    """All of its layers, though there be one only."""
    return texture.create_view(dimension="2d-array")
