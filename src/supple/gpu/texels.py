"""Arrays on a device as textures, which drivers read faster than buffers, and which may be larger."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.kernel import Array, settle

DEEP = 2048  # texels along a side of a solid
ROW = 2048  # entries in a layer of a table, as in raymarch.wgsl
_SLAB = 16 << 20  # bytes in one transfer
_NAMES = {
    ("uint8", 1): "r8uint",
    ("uint8", 4): "rgba8uint",
    ("uint16", 1): "r16uint",
    ("int8", 1): "r8sint",
    ("int16", 1): "r16sint",
    ("float32", 1): "r32float",
    ("float32", 4): "rgba32float",
    ("float16", 4): "rgba16float",
}


def _texture(gpu: Gpu, size: tuple[int, int, int], name: str, usage: str = "COPY_DST") -> Any:
    from wgpu import GPUError

    try:
        return gpu.device.create_texture(size=size, dimension="3d", format=name, usage=f"TEXTURE_BINDING|{usage}")
    except GPUError as error:
        if "memory" not in str(error).lower():
            raise
        wide, high, deep = size
        raise MemoryError(f"it has no memory left for {wide} x {high} x {deep} samples") from None


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
    return _texture(gpu, (wide, high, deep), name.replace("8uint", "8unorm") if unit else name, usage)


def put_solid(gpu: Gpu, texture: Any, samples: Array) -> None:
    """Upload samples (layers, rows, samples in a row) to a solid."""
    count = len(samples)
    some = max(1, _SLAB // (samples.nbytes // count))
    for first in range(0, count, some):
        _write(gpu, texture, (0, 0, first), samples[first : first + some])
        if some < count:  # small uploads, such as transfer functions for each image, do not wait
            settle(gpu)


def table(gpu: Gpu, rows: Array) -> Any:
    """Return a texture of rows of float32 vectors (rows, entries, 4), cut into layers."""
    count, entries, _ = rows.shape
    wide = min(entries, ROW)
    padded = np.pad(rows.astype(np.float32), ((0, 0), (0, -entries % wide), (0, 0)))
    layers = np.moveaxis(padded.reshape(count, -1, wide, 4), 1, 0)
    made = _texture(gpu, (wide, count, len(layers)), _NAMES["float32", 4])
    put_solid(gpu, made, layers)
    return made


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
