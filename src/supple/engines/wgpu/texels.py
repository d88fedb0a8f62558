"""Arrays on a device as textures, which drivers read faster than buffers, and which may be larger."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.kernel import Array, settle

SIDE = 8192  # texels along a layer, as in sample.wgsl: a larger frame has several layers
MOST_LAYERS = 256
DEEP = 2048  # texels along a side of a solid
_SLAB = 16 << 20  # bytes in one transfer
_NAMES = {
    ("uint8", 1): "r8uint",
    ("uint8", 2): "rg8uint",
    ("uint8", 4): "rgba8uint",
    ("uint16", 1): "r16uint",
    ("uint16", 2): "rg16uint",
    ("uint16", 4): "rgba16uint",
    ("int8", 1): "r8sint",
    ("int16", 1): "r16sint",
    ("float32", 1): "r32float",
    ("float32", 4): "rgba32float",
    ("float16", 4): "rgba16float",
}


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Textures for consecutive frames.

    Parameters
    ----------
    texture : wgpu.GPUTexture
    view : wgpu.GPUTextureView
        The view of all layers.
    blocks : (int, int)
        Layers of a frame, across and down.
    """

    texture: Any
    view: Any
    blocks: tuple[int, int]

    def destroy(self) -> None:
        """Free the device memory."""
        self.texture.destroy()

    def put(self, gpu: Gpu, slot: int, frame: Array, *, wait: bool = False) -> None:
        """Upload a frame (rows, samples, channels) to a slot, and optionally wait for it."""
        across, down = self.blocks
        for j in range(down):
            for i in range(across):
                block = frame[j * SIDE : (j + 1) * SIDE, i * SIDE : (i + 1) * SIDE]
                some = max(1, _SLAB // max(1, block[0].nbytes))
                for top in range(0, len(block), some):
                    origin = 0, top, (slot * down + j) * across + i
                    _write(gpu, self.texture, origin, block[None, top : top + some])
                    if wait:
                        settle(gpu)


def blocks_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the layers of a frame with these rows and samples in a row, across and down."""
    return -(-shape[1] // SIDE), -(-shape[0] // SIDE)


def texels_of(shape: tuple[int, int]) -> int:
    """Return the texels of a frame's layers, of which the last ones may be partly used."""
    across, down = blocks_of(shape)
    return across * down * min(shape[0], SIDE) * min(shape[1], SIDE)


def layers(gpu: Gpu, shape: tuple[int, int], slots: int, dtype: Any, channels: int) -> Layers:
    """Return textures for frames of some rows and samples in a row; MemoryError if they have too many layers."""
    across, down = blocks_of(shape)
    count = slots * across * down
    if count > MOST_LAYERS:
        raise MemoryError(f"{slots} frames of {shape[1]} by {shape[0]} samples are more than a texture holds")
    size = min(shape[1], SIDE), min(shape[0], SIDE), count
    texture = _texture(gpu, size, _NAMES[np.dtype(dtype).name, channels], "COPY_DST", "2d")
    return Layers(texture, view_of(texture), (across, down))


def _texture(gpu: Gpu, size: tuple[int, int, int], name: str, usage: str, dimension: str) -> Any:
    from wgpu import GPUError

    try:
        return gpu.device.create_texture(size=size, dimension=dimension, format=name, usage=f"TEXTURE_BINDING|{usage}")
    except GPUError as error:
        if "memory" not in str(error).lower():
            raise
        wide, high, deep = size
        raise MemoryError(f"it has no memory left for {wide} x {high} x {deep} samples") from None


def plane_layers(gpu: Gpu, size: tuple[int, int, int]) -> Any:
    """Return a texture of layers of float32 vectors, (width, height, count); MemoryError if there is no room."""
    if max(size[:2]) > SIDE or size[2] > MOST_LAYERS:
        raise MemoryError("a picture of this size is more than a texture holds")
    return _texture(gpu, size, "rgba32float", "COPY_DST", "2d")


def view_of(texture: Any) -> Any:
    """Return the view of all layers, even of a single one."""
    return texture.create_view(dimension="2d-array")


def solid(
    gpu: Gpu, shape: tuple[int, ...], dtype: Any, channels: int = 1, usage: str = "COPY_DST", unit: bool = False
) -> Any:
    """Return a texture of some layers, rows and texels in a row; MemoryError if there is no room for it.

    With ``unit``, four channels of 8 bits are read as numbers from 0 to 1.
    """
    if max(shape) > DEEP:
        raise MemoryError(f"{max(shape)} samples along a side are more than a texture holds, {DEEP}")
    deep, high, wide = shape
    name = _NAMES[np.dtype(dtype).name, channels]
    return _texture(gpu, (wide, high, deep), name.replace("8uint", "8unorm") if unit else name, usage, "3d")


def put_solid(gpu: Gpu, texture: Any, samples: Array) -> None:
    """Upload samples (layers, rows, samples in a row) to a solid."""
    count = len(samples)
    some = max(1, _SLAB // (samples.nbytes // count))
    for first in range(0, count, some):
        _write(gpu, texture, (0, 0, first), samples[first : first + some])
        if some < count:  # small uploads, such as transfer functions for each image, do not wait
            settle(gpu)


def copy_in(gpu: Gpu, buffer: Any, pitch: int, texture: Any, first: int, count: int) -> None:
    """Copy layers of float32 vectors from a buffer, with ``pitch`` vectors in a row, into a texture."""
    width, rows, _ = texture.size
    encoder = gpu.device.create_command_encoder()
    encoder.copy_buffer_to_texture(
        {"buffer": buffer, "bytes_per_row": 16 * pitch, "rows_per_image": rows},
        {"texture": texture, "origin": (0, 0, first)},
        (width, rows, count),
    )
    gpu.device.queue.submit([encoder.finish()])


def _write(gpu: Gpu, texture: Any, origin: tuple[int, int, int], slab: Array) -> None:
    """Upload some layers (layers, rows, samples in a row, and optionally channels)."""
    data = np.ascontiguousarray(slab)
    count, rows, width = data.shape[:3]
    gpu.device.queue.write_texture(
        {"texture": texture, "origin": origin},
        data.reshape(-1).view(np.uint8),
        {"bytes_per_row": data.nbytes // (count * rows), "rows_per_image": rows},
        (width, rows, count),
    )
