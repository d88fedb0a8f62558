"""Arrays on a device: buffers, and textures, which drivers read faster and which may be larger."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.device import Gpu

Array = npt.NDArray[Any]

DEEP = 2048  # the most texels along a side of a 3D texture
LEAST = 256  # bytes of the smallest buffer: one item must fit, even of an empty array
_SLAB = 16 << 20  # bytes in one transfer
_FORMATS = {
    ("uint8", 1): "r8uint",
    ("uint8", 4): "rgba8unorm",
    ("uint16", 1): "r16uint",
    ("int8", 1): "r8sint",
    ("int16", 1): "r16sint",
    ("float32", 1): "r32float",
    ("float32", 4): "rgba32float",
    ("float16", 4): "rgba16float",
}


def room(gpu: Gpu, size: int) -> Any:
    """Return a buffer of ``size`` bytes, all 0."""
    return gpu.device.create_buffer(size=max(size, LEAST), usage="UNIFORM|STORAGE|COPY_SRC|COPY_DST")


def upload(gpu: Gpu, array: Array) -> Any:
    """Return a buffer with an array's bytes, which must be whole 32-bit words."""
    buffer, data = room(gpu, array.nbytes), np.ascontiguousarray(array).tobytes()
    if data:
        gpu.device.queue.write_buffer(buffer, 0, data)
    return buffer


@contextlib.contextmanager
def owned(*given: Any) -> Iterator[tuple[Any, ...]]:
    """Yield buffers and textures, and destroy them when the block ends, once the work submitted in it is done."""
    try:
        yield given
    finally:
        for each in given:
            each.destroy()


def download(gpu: Gpu, buffer: Any, dtype: Any, count: int) -> Array:
    """Return the first ``count`` words of a buffer; waits for the work that fills it."""
    return np.frombuffer(gpu.device.queue.read_buffer(buffer, 0, 4 * count), dtype, count)


def wait(gpu: Gpu) -> None:
    """Wait until all submitted work is done."""
    try:
        gpu.device._poll_wait()
    except AttributeError:  # wgpu's own poll: its public alternative (0.32) fails, or takes a buffer each time
        download(gpu, room(gpu, LEAST), np.uint32, 1)


def solid(gpu: Gpu, shape: tuple[int, ...], dtype: Any, channels: int = 1, usage: str = "COPY_DST") -> Any:
    """Return a 3D texture of ``shape`` (layers, rows, texels in a row); MemoryError if there is no room for it.

    Four channels of 8 bits are read as numbers from 0 to 1.
    """
    from wgpu import GPUError

    if max(shape) > DEEP:
        raise MemoryError(f"{max(shape)} samples along a side are more than a texture holds, {DEEP}")
    deep, high, wide = shape
    name, usage = _FORMATS[np.dtype(dtype).name, channels], f"TEXTURE_BINDING|{usage}"
    try:
        return gpu.device.create_texture(size=(wide, high, deep), dimension="3d", format=name, usage=usage)
    except GPUError as error:
        if "memory" not in str(error).lower():
            raise
        raise MemoryError(f"it has no memory left for {wide} x {high} x {deep} samples") from None


def uploaded(gpu: Gpu, samples: Array) -> Any:
    """Return a 3D texture of samples (layers, rows, samples in a row, and optionally four channels)."""
    texture = solid(gpu, samples.shape[:3], samples.dtype, *samples.shape[3:])
    put(gpu, texture, samples)
    return texture


def put(gpu: Gpu, texture: Any, samples: Array) -> None:
    """Upload samples (layers, rows, samples in a row, and optionally channels) to a 3D texture."""
    count, rows, width = samples.shape[:3]
    some = max(1, _SLAB // (samples.nbytes // count))
    for first in range(0, count, some):
        slab = np.ascontiguousarray(samples[first : first + some])
        gpu.device.queue.write_texture(
            {"texture": texture, "origin": (0, 0, first)},
            slab.reshape(-1).view(np.uint8),
            {"bytes_per_row": slab.nbytes // (len(slab) * rows), "rows_per_image": rows},
            (width, rows, len(slab)),
        )
        if some < count:  # uploads keep a copy in memory until they are done; small ones need not wait
            gpu.device.queue.submit([])
            wait(gpu)


def blank(gpu: Gpu, kind: str) -> Any:
    """Return an empty buffer, or an empty texture of numbers from 0 to 1, for a shader's resource of some kind."""
    if kind not in gpu.pipelines:
        if kind.startswith("storage"):
            gpu.pipelines[kind] = room(gpu, LEAST)
        else:
            dimension = kind.removeprefix("texture_")[:2]
            size = (2, 2, 2 if dimension == "3d" else 1)
            gpu.pipelines[kind] = gpu.device.create_texture(
                size=size, dimension=dimension, format="rgba8unorm", usage="TEXTURE_BINDING"
            ).create_view()
    return gpu.pipelines[kind]


class Kept:
    """A reusable buffer: it is written only when its bytes change, and replaced only if it is too small."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu, self._bytes = gpu, b""
        self.buffer: Any = None
        """The buffer of the last array; None at first."""

    def hold(self, array: Array) -> Any:
        """Write an array's bytes to the buffer, if they changed, and return it."""
        data = np.ascontiguousarray(array).tobytes()
        if self.buffer is None or self.buffer.size < len(data):
            self.buffer, self._bytes = room(self._gpu, 1 << (max(len(data), 1) - 1).bit_length()), b""
        if data and data != self._bytes:
            self._gpu.device.queue.write_buffer(self.buffer, 0, data)
            self._bytes = data
        return self.buffer


class Bound:
    """A bind group, rebuilt when one of its resources is replaced."""

    def __init__(self) -> None:
        self._given: dict[str, Any] = {}
        self._group: Any = None

    def group(self, given: Mapping[str, Any], make: Callable[[Mapping[str, Any]], Any]) -> Any:
        """Return the bind group of resources by their names; ``make`` builds it."""
        if given.keys() != self._given.keys() or any(given[name] is not self._given[name] for name in given):
            self._given, self._group = dict(given), make(given)
        return self._group
