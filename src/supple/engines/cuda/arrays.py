"""Arrays on a GPU, of any library: in the form of the kernels, and results in the library of the source."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.domain import refuse
from supple.engines.base import check_gradients
from supple.engines.cuda.device import CudaDevice, open_device, simulated
from supple.errors import SuppleError

_CUDA = (2, 13)  # DLPack's device types: GPU memory, and memory shared with the host


@dataclass(frozen=True, slots=True, eq=False)
class DeviceArray:
    """An array on a GPU.

    Parameters
    ----------
    given : object
        The library's array.
    kind : str
        "torch", "cupy" or "numba": the library of new arrays.
    shape, strides : tuple of int
        In samples.
    dtype : numpy.dtype
    pointer : int
        The address of the first sample.
    gpu : CudaDevice
    stream : object
        Numba's object for the current stream of the library.
    writable : bool
    """

    given: Any
    kind: str
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: np.dtype[Any]
    pointer: int
    gpu: CudaDevice
    stream: Any
    writable: bool = True

    @property
    def ndim(self) -> int:
        """The number of axes."""
        return len(self.shape)

    @property
    def below(self) -> int:
        """The number of samples before the first one in memory, where strides are negative."""
        return sum((n - 1) * -s for n, s in zip(self.shape, self.strides, strict=True) if s < 0)

    @property
    def span(self) -> int:
        """The number of samples from the first to the last in memory."""
        if 0 in self.shape:
            return 0
        return 1 + sum((n - 1) * abs(s) for n, s in zip(self.shape, self.strides, strict=True))

    def flat(self) -> Any:
        """Return the memory of the array, as Numba's array of one axis; it begins ``below`` samples before that."""
        kind = np.dtype(np.uint8) if self.dtype == np.bool_ else self.dtype
        if simulated():
            return _flat_in_simulator(self, kind)
        from numba import cuda

        described = {
            "shape": (self.span,),
            "strides": None,
            "typestr": kind.str,
            "data": (self.pointer - self.below * kind.itemsize, False),
            "version": 3,
        }
        return cuda.from_cuda_array_interface(described, owner=self.given, sync=False)

    def overlaps(self, other: DeviceArray) -> bool:
        """Return whether two arrays may share memory."""
        first, second = (
            (a.pointer - a.below * a.dtype.itemsize, a.pointer + (a.span - a.below) * a.dtype.itemsize)
            for a in (self, other)
        )
        return self.gpu.number == other.gpu.number and first[0] < second[1] and second[0] < first[1]


def is_on_device(value: object) -> bool:
    """Return whether a value is, or may be, an array on a GPU, without importing any library."""
    if isinstance(value, np.ndarray) or callable(value):
        return False
    if _is_tensor(value):
        return bool(value.is_cuda)  # type: ignore[attr-defined]
    try:
        if getattr(value, "__cuda_ndarray__", None) or hasattr(value, "__cuda_array_interface__"):
            return True
    except (RuntimeError, ValueError):  # raised by some libraries for arrays of the host
        return False
    where = getattr(value, "__dlpack_device__", None)
    try:
        return where is not None and int(where()[0]) in _CUDA
    except (TypeError, ValueError, RuntimeError, BufferError):
        return False


def _is_tensor(value: object) -> bool:
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def _is_cupy(value: object) -> bool:
    cupy = sys.modules.get("cupy")
    return cupy is not None and isinstance(value, cupy.ndarray)


def taken(value: Any, name: str) -> DeviceArray:
    """Return an array on a GPU, of any library, as `DeviceArray`.

    Raises
    ------
    SuppleError
        If CUDA cannot be used, or the array is not on a GPU, or of an unknown kind.
    """
    if not is_on_device(value):
        refuse(name, "an array on a GPU", value)
    check_gradients(value, name)
    if simulated():
        open_device()
        return _in_simulator(value)
    kind = "torch" if _is_tensor(value) else "cupy" if _is_cupy(value) else "numba"
    gpu = open_device(_number_of(value, kind))  # before any call that needs the driver
    from cuda.core.utils import StridedMemoryView

    own = kind != "numba" or hasattr(value, "__cuda_ndarray__")
    try:
        with gpu.current():  # some libraries export only arrays on the current device
            view = StridedMemoryView.from_any_interface(value, stream_ptr=-1 if own else 1)
        # Known libraries work in the order of their stream; for others, wait for the default stream.
        if not view.is_device_accessible:
            raise BufferError("its memory is not a GPU's")
        shape = tuple(int(n) for n in view.shape)
        dtype = np.dtype(view.dtype)
    except Exception as error:  # every library has errors of its own
        refuse(
            name, "an array on a GPU, of bool, integers or floats of 16 to 64 bits", " ".join(str(error).split())[:80]
        )
    strides = tuple(view.strides) if view.strides is not None else _dense(shape)
    if int(view.device_id) != gpu.number:
        gpu = open_device(int(view.device_id))
    return DeviceArray(value, kind, shape, tuple(int(s) for s in strides), dtype, int(view.ptr), gpu,
                  stream_of(value, kind, gpu), not view.readonly)  # fmt: skip


def plain(value: Any) -> Any:
    """Return an array of the same library on the same GPU, of any type."""
    if _is_tensor(value):
        return sys.modules["torch"].empty(1, device=value.device)
    return value


def _number_of(value: Any, kind: str) -> int:
    """Return the number of an array's GPU, as far as its library has one."""
    if kind == "torch":
        return int(value.device.index or 0)
    return int(value.device.id) if kind == "cupy" else 0


def _dense(shape: Sequence[int]) -> tuple[int, ...]:
    return tuple(int(np.prod(shape[k + 1 :], dtype=np.int64)) for k in range(len(shape)))


def stream_of(value: Any, kind: str, gpu: CudaDevice) -> Any:
    """Return the current stream of a library."""
    if simulated():
        return 0
    with gpu.current():
        pointer = 0
        if kind == "torch":
            pointer = int(sys.modules["torch"].cuda.current_stream(value.device).cuda_stream)
        elif kind == "cupy":
            with value.device:
                pointer = int(sys.modules["cupy"].cuda.get_current_stream().ptr)
        elif hasattr(value, "__cuda_ndarray__") and value.stream:
            return value.stream
        return known_stream(gpu, pointer)


_streams: dict[tuple[int, int], Any] = {}


def known_stream(gpu: CudaDevice, pointer: int) -> Any:
    """Return Numba's object for a stream, cached, so that prepared launches are found again."""
    from numba import cuda

    key = (gpu.number, pointer)
    if key not in _streams:
        if len(_streams) > 256:
            _streams.clear()
        _streams[key] = cuda.external_stream(pointer) if pointer else cuda.legacy_default_stream()
    return _streams[key]


def as_stream(value: Any, gpu: CudaDevice) -> Any:
    """Return a stream of any library as Numba's; SuppleError if it is not a stream."""
    if simulated() and hasattr(value, "synchronize"):
        return value
    for name in ("cuda_stream", "ptr"):  # PyTorch's, and CuPy's
        if isinstance(getattr(value, name, None), int):
            return known_stream(gpu, getattr(value, name))
    if hasattr(value, "handle") and hasattr(value, "auto_synchronize"):  # Numba's
        return value
    if not hasattr(value, "__cuda_stream__"):
        refuse("stream", "a stream of PyTorch, CuPy or Numba, or left out", value)
    return known_stream(gpu, int(value.__cuda_stream__()[1]))


def made_like(
    source: DeviceArray, shape: Sequence[int], dtype: npt.DTypeLike, *, as_it_lies: bool = False
) -> DeviceArray:
    """Return a new array of the same library and GPU; ``as_it_lies``: with the same strides, for an equal shape."""
    with source.gpu.current():
        return _made_like(source, shape, np.dtype(dtype), as_it_lies)


def _made_like(source: DeviceArray, shape: Sequence[int], kind: np.dtype[Any], as_it_lies: bool) -> DeviceArray:
    if source.kind == "torch":
        torch = sys.modules["torch"]
        if as_it_lies:
            given = torch.empty_like(source.given, memory_format=torch.preserve_format)
        else:
            given = torch.empty(tuple(shape), dtype=getattr(torch, kind.name), device=source.given.device)
    elif source.kind == "cupy":
        cupy = sys.modules["cupy"]
        with source.given.device:
            given = cupy.empty_like(source.given, order="K") if as_it_lies else cupy.empty(tuple(shape), kind)
    else:
        from numba import cuda

        # Bound to a stream only if the source is: arrays bound to the default stream cannot be exported.
        bound = getattr(source.given, "stream", 0) if hasattr(source.given, "__cuda_ndarray__") else 0
        given = cuda.device_array(tuple(shape), kind, stream=bound or 0)
    return taken(given, "the result")


def checked_out(out: Any, source: DeviceArray) -> DeviceArray:
    """Return a user's array for a result; SuppleError if it does not fit the source."""
    wanted = f"an array on the source's GPU, of {source.dtype} and shape {source.shape}, as the source is"
    if not is_on_device(out):
        refuse("out", wanted, out)
    target = taken(out, "out")
    if target.shape != source.shape or target.dtype != source.dtype or target.gpu.number != source.gpu.number:
        refuse("out", wanted, f"{target.dtype} of shape {target.shape} on GPU {target.gpu.number}")
    if not target.writable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    if 0 in (s for s, n in zip(target.strides, target.shape, strict=True) if n > 1):
        raise SuppleError("out must have a place for each sample, found an array that is broadcast")
    if target.overlaps(source):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return target


def contiguous(source: DeviceArray) -> DeviceArray:
    """Return a contiguous copy; SuppleError if the library has none."""
    if source.strides == _dense(source.shape) or source.span <= 1:
        return source
    if source.kind == "torch":
        return taken(source.given.contiguous(), "the array")
    if source.kind == "cupy":
        return taken(sys.modules["cupy"].ascontiguousarray(source.given), "the array")
    raise SuppleError(f"points must lie one after the other in memory, found strides {source.strides}")


def _in_simulator(value: Any) -> DeviceArray:
    array = value._ary if hasattr(value, "_ary") else np.asarray(value)
    strides = tuple(s // array.itemsize for s in array.strides)
    pointer = array.__array_interface__["data"][0]
    return DeviceArray(
        value, "numba", array.shape, strides, array.dtype, pointer, open_device(), 0, array.flags.writeable
    )


def _flat_in_simulator(array: DeviceArray, kind: np.dtype[Any]) -> Any:
    import ctypes

    from numba.cuda.simulator.cudadrv.devicearray import FakeCUDAArray

    size = array.span * kind.itemsize
    memory = (ctypes.c_ubyte * size).from_address(array.pointer - array.below * kind.itemsize)
    return FakeCUDAArray(np.frombuffer(memoryview(memory), kind))
