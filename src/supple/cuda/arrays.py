"""Arrays on a GPU, of any library: their description for kernels, and new arrays of the source's library."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.cuda.device import CudaDevice, Memory, Stream, open_device
from supple.engine.devices import ON_CUDA, check_gradients, is_on_device, library_of
from supple.errors import SuppleError
from supple.space.checks import refuse


class CudaArray:
    """A result on a GPU for unknown libraries, with the interfaces that these exchange arrays by."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any], gpu: CudaDevice, stream: Stream) -> None:
        self.shape, self.dtype, self._gpu = shape, dtype, gpu
        self._memory = Memory(math.prod(shape) * dtype.itemsize, stream)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {
            "shape": self.shape,
            "strides": None,
            "typestr": self.dtype.str,
            "data": (self._memory.pointer, False),
            "stream": self._memory.stream.handle or 1,
            "version": 3,
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        return ON_CUDA[0], self._gpu.number

    def __dlpack__(self, **options: Any) -> Any:
        from cuda.core import Buffer
        from cuda.core.utils import StridedMemoryView

        self._memory.stream.synchronize()  # for a consumer on any stream
        held = Buffer.from_handle(self._memory.pointer, self._memory.size, owner=self)
        options.pop("stream", None)
        return StridedMemoryView.from_buffer(held, self.shape, dtype=self.dtype).__dlpack__(**options)


@dataclass(frozen=True, slots=True, eq=False)
class DeviceArray:
    """An array on a GPU, as ``given``; ``kind`` is its library: "torch", "cupy", "numba" or "other".

    Strides are in samples, ``pointer`` is the address of the first sample, and ``stream`` the current stream of the
    library.
    """

    given: Any
    kind: str
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: np.dtype[Any]
    pointer: int
    gpu: CudaDevice
    stream: Stream
    writable: bool = True

    @property
    def ndim(self) -> int:
        """The number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """The number of samples."""
        return math.prod(self.shape)

    def samples(self, item: int, coloured: bool) -> tuple[int, ...]:
        """Return the address and the steps of planes, rows, columns and channels, for an item of a batch or for all."""
        strides = self.strides if coloured else (*self.strides, 0)
        each, *steps = (0,) * (5 - len(strides)) + strides
        return self.pointer + item * each * self.dtype.itemsize, *steps

    def overlaps(self, other: DeviceArray) -> bool:
        """Return whether two arrays may share memory."""
        if self.size == 0 or other.size == 0 or self.gpu.number != other.gpu.number:
            return False
        first, second = (a._bounds() for a in (self, other))
        return first[0] < second[1] and second[0] < first[1]

    def _bounds(self) -> tuple[int, int]:
        """Return the addresses of the first byte, and of that after the last."""
        size = self.dtype.itemsize
        steps = [(n - 1) * s * size for n, s in zip(self.shape, self.strides, strict=True)]
        return self.pointer + sum(min(s, 0) for s in steps), self.pointer + sum(max(s, 0) for s in steps) + size


def taken(value: Any, name: str) -> DeviceArray:
    """Return the `DeviceArray` of an array on a GPU, of any library.

    Raises
    ------
    SuppleError
        If CUDA cannot be used, or the array is not on a GPU, or of an unknown kind.
    """
    if not is_on_device(value):
        where = f"{type(value).__name__} of the host, which tensor.cuda() or cupy.asarray copies there"
        refuse(name, "an array on a GPU", value, told=where if hasattr(value, "shape") else "")
    check_gradients(value, name)
    kind = library_of(value)
    # The GPU of the array, if its library names it, is opened before any call that needs the driver.
    named = {"torch": "index", "cupy": "id"}
    gpu = open_device(int(getattr(value.device, named[kind]) or 0) if kind in named else 0)
    try:
        if kind == "torch":  # its own attributes take a tenth of the time
            return DeviceArray(value, kind, tuple(value.shape), value.stride(), _dtype_of(value.dtype),
                               value.data_ptr(), gpu, stream_of(value, kind))  # fmt: skip
        view = _viewed(value, kind, gpu)
        shape = tuple(int(n) for n in view.shape)
        dtype = np.dtype(view.dtype)
    except Exception as error:  # every library has errors of its own
        refuse(
            name, "an array on a GPU, of bool, integers or floats of 16 to 64 bits", " ".join(str(error).split())[:80]
        )
    wrapped = 2**64 // dtype.itemsize  # cuda.core divides negative strides, in bytes, as unsigned numbers
    strides = dense(shape) if view.strides is None else (s - wrapped if s > wrapped // 2 else s for s in view.strides)
    if int(view.device_id) != gpu.number:
        gpu = open_device(int(view.device_id))
    return DeviceArray(value, kind, shape, tuple(int(s) for s in strides), dtype, int(view.ptr), gpu,
                       stream_of(value, kind), not view.readonly)  # fmt: skip


def _viewed(value: Any, kind: str, gpu: CudaDevice) -> Any:
    """Return the shape, strides, type, address and device of an array, as attributes."""
    from cuda.core.utils import StridedMemoryView

    # Known libraries work in stream order; for others, wait until the array is complete.
    with gpu.current():  # some libraries export only arrays on the current device
        view = StridedMemoryView.from_any_interface(value, stream_ptr=1 if kind == "other" else -1)
    if not view.is_device_accessible:
        raise BufferError("its memory is not a GPU's")
    return view


@cache
def _dtype_of(kind: Any) -> np.dtype[Any]:
    """Return PyTorch's type of samples as NumPy's."""
    return np.dtype(str(kind).removeprefix("torch."))


def plain(value: Any) -> Any:
    """Return some array of the same library on the same GPU, to make others like it."""
    return sys.modules["torch"].empty(1, device=value.device) if library_of(value) == "torch" else value


def dense(shape: Sequence[int]) -> tuple[int, ...]:
    """Return the strides of a contiguous array, in samples."""
    return tuple(math.prod(shape[k + 1 :]) for k in range(len(shape)))


def stream_of(value: Any, kind: str) -> Stream:
    """Return the current stream of a library."""
    if kind == "torch":
        return Stream(int(sys.modules["torch"].cuda.current_stream(value.device).cuda_stream))
    if kind == "cupy":
        with value.device:
            return Stream(int(sys.modules["cupy"].cuda.get_current_stream().ptr))
    own = getattr(value, "stream", None) if kind == "numba" else None
    return as_stream(own) if own else Stream(0)


def as_stream(value: Any) -> Stream:
    """Return a stream of any library; SuppleError if it is not a stream."""
    if isinstance(value, Stream):
        return value
    for name in ("cuda_stream", "ptr", "handle"):  # PyTorch's, CuPy's, and Numba's or NVIDIA's own
        known = getattr(value, name, None)
        if known is not None:
            with contextlib.suppress(TypeError, ValueError):
                return Stream(int(getattr(known, "value", known) or 0))
    if not hasattr(value, "__cuda_stream__"):
        refuse("stream", "a stream of PyTorch, CuPy or Numba, or left out", value)
    said = value.__cuda_stream__
    return Stream(int((said() if callable(said) else said)[1]))


def made_like(
    source: DeviceArray, shape: Sequence[int], dtype: npt.DTypeLike, *, as_it_lies: bool = False
) -> DeviceArray:
    """Return a new array of the same library and GPU; ``as_it_lies``: with the same strides, for an equal shape."""
    given, shape, kind = source.given, tuple(shape), np.dtype(dtype)
    library: Any = sys.modules.get({"numba": "numba.cuda"}.get(source.kind, source.kind))
    if source.kind == "torch":
        if as_it_lies:
            return taken(library.empty_like(given), "the result")
        return taken(library.empty(shape, dtype=getattr(library, kind.name), device=given.device), "the result")
    with source.gpu.current(), given.device if source.kind == "cupy" else contextlib.nullcontext():
        if source.kind == "other":
            made = CudaArray(shape, kind, source.gpu, source.stream)
        elif source.kind == "numba":
            # With a stream only if the source has one: Numba cannot export arrays bound to the default stream.
            made = library.device_array(shape, kind, stream=getattr(given, "stream", 0) or 0)
        else:
            made = library.empty_like(given, order="K") if as_it_lies else library.empty(shape, kind)
        return taken(made, "the result")


def checked_out(out: Any, source: DeviceArray, shape: tuple[int, ...]) -> DeviceArray:
    """Return ``out`` as a `DeviceArray`; SuppleError if it does not fit the source, or the result's shape."""
    whose = "source" if shape == source.shape else "grid"
    wanted = f"an array on the source's GPU, of {source.dtype} and shape {shape}, as the {whose} is"
    if not is_on_device(out):
        refuse("out", wanted, out)
    target = taken(out, "out")
    if target.shape != shape or target.dtype != source.dtype or target.gpu.number != source.gpu.number:
        refuse("out", wanted, told=f"{target.dtype} of shape {target.shape} on GPU {target.gpu.number}")
    if not target.writable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    if 0 in (s for s, n in zip(target.strides, target.shape, strict=True) if n > 1):
        raise SuppleError("out must have a place for each sample, found an array that is broadcast")
    if target.overlaps(source):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return target


def contiguous(source: DeviceArray) -> DeviceArray:
    """Return a contiguous copy; SuppleError if the library has none."""
    if source.size <= 1 or source.strides == dense(source.shape):
        return source
    if source.kind == "torch":
        return taken(source.given.contiguous(), "the array")
    if source.kind == "cupy":
        return taken(sys.modules["cupy"].ascontiguousarray(source.given), "the array")
    raise SuppleError(f"points must lie one after the other in memory, found strides {source.strides}")
