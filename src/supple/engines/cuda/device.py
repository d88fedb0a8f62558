"""The NVIDIA GPU, and the error messages where there is none."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from supple.errors import SuppleError

INSTALL = 'pip install "supple[cuda12]" or "supple[cuda13]", for drivers from 525 or 580 on'
OLDEST = ((6, 0), (7, 5))  # compute capability, for CUDA 12 and 13: the least that kernels are compiled for


@dataclass(frozen=True, slots=True, eq=False)
class CudaDevice:
    """A GPU that is ready.

    Parameters
    ----------
    number : int
        The number of the device in CUDA.
    name : str
    processors : int
        Streaming multiprocessors.
    context : object
        Numba's context.
    """

    number: int
    name: str
    processors: int
    context: Any

    @contextlib.contextmanager
    def current(self) -> Iterator[None]:
        """Make it the current device of this thread."""
        with self.context:
            yield

    def stream(self) -> Any:
        """Return a new stream that does not synchronize with the default stream, unlike Numba's own."""
        cuda = _numba()
        if simulated():
            return cuda.stream()
        from cuda.bindings import driver

        with self.current():
            status, handle = driver.cuStreamCreate(driver.CUstream_flags.CU_STREAM_NON_BLOCKING.value)
            if status != driver.CUresult.CUDA_SUCCESS:
                raise SuppleError(f"{self.name} has no room for another stream ({status.name})")
            made = cuda.external_stream(int(handle))
        weakref.finalize(made, driver.cuStreamDestroy, handle)
        return made

    @property
    def free(self) -> int:
        """Return the free memory in bytes."""
        with self.current():
            found = _numba().current_context().get_memory_info().free
        return int(min(found, 1 << 62))


def simulated() -> bool:
    """Return whether Numba simulates a GPU, as in tests."""
    from numba.core import config

    return bool(getattr(config, "ENABLE_CUDASIM", 0))


def _numba() -> Any:
    """Return Numba's interface to CUDA; SuppleError if it is missing."""
    if importlib.util.find_spec("numba_cuda") is None:
        raise SuppleError(f"CUDA needs the package numba-cuda, which is not installed: {INSTALL}")
    from numba import cuda

    return cuda


def open_device(number: int = 0) -> CudaDevice:
    """Return the GPU of a number, ready for work.

    Raises
    ------
    SuppleError
        If Numba's package for CUDA, the driver or the GPU is missing, or too old; the message names a remedy.
    """
    cuda = _numba()
    if simulated():
        return CudaDevice(number, "the simulator", 1, cuda.gpus[number])
    return _opened(number)


@functools.lru_cache(maxsize=64)
def _opened(number: int) -> CudaDevice:
    cuda = _numba()
    reason = _broken(cuda)
    if reason:
        raise SuppleError(reason)
    count = len(cuda.gpus)
    if number >= count:
        raise SuppleError(f"GPU {number} is not there: CUDA sees {count} of them, counted from 0")
    device = cuda.gpus[number]._device if hasattr(cuda.gpus[number], "_device") else cuda.gpus[number]
    name = device.name.decode() if isinstance(device.name, bytes) else str(device.name)
    found, oldest = tuple(device.compute_capability), OLDEST[toolkit() >= 13]
    if found < oldest:
        raise SuppleError(
            f"{name} is too old: its compute capability is {found[0]}.{found[1]}, and {oldest[0]}.{oldest[1]} is needed"
            "; device cpu needs no GPU"
        )
    try:
        from numba.cuda.cudadrv import nvvm

        nvvm.NVVM()
    except Exception as error:
        raise SuppleError(f"CUDA's compiler is not there ({_short(error)}): {INSTALL}") from None
    context = cuda.gpus[number]
    with context:  # fails here, and not during a warp
        try:
            cuda.current_context().get_memory_info()
        except Exception as error:  # drivers fail in many ways
            raise SuppleError(f"{name} cannot be opened ({_short(error)}); device cpu needs no GPU") from None
    return CudaDevice(number, name, int(device.MULTIPROCESSOR_COUNT), context)


def failures() -> tuple[type[Exception], ...]:
    """Return the exception types of a GPU that fails, is full, or has no compiled kernel."""
    from numba.cuda.cudadrv import error

    kinds: list[type[Exception]] = [RuntimeError, MemoryError, ArithmeticError, ImportError, OSError]
    kinds += [getattr(error, name) for name in ("CudaDriverError", "NvvmError", "NvrtcError") if hasattr(error, name)]
    with contextlib.suppress(ImportError, AttributeError):
        from cuda.core._utils.cuda_utils import CUDAError

        kinds.append(CUDAError)
    return tuple(kinds)


def _short(error: object) -> str:
    return " ".join(str(error).split())[:150]


def _broken(cuda: Any) -> str:
    """Return the reason why CUDA does not work, in one sentence; "" if it works."""
    from numba.cuda.cudadrv import driver

    try:
        version = driver.driver.get_version()
    except Exception as error:  # an old driver lacks functions
        said = _short(error)
        if "cannot be found" in said or "not found" in said:
            return "CUDA needs NVIDIA's driver, which is not installed; device cpu needs none"
        if "NO_DEVICE" in said or "no CUDA-capable device" in said:
            return "no NVIDIA GPU was found: the driver sees none; device cpu needs none"
        return f"NVIDIA's driver does not work ({said}); device cpu needs none"
    needed = toolkit()
    older = ', or pip install "supple[cuda12]"' if version[0] == 12 else ""
    if needed and tuple(version) < (needed, 0):
        return (
            f"NVIDIA's driver is too old: it knows CUDA {version[0]}.{version[1]}, and what is installed needs {needed}"
            f": update the driver{older}"
        )
    try:
        count = len(cuda.gpus)
    except Exception as error:
        return f"no NVIDIA GPU can be used ({_short(error)}); device cpu needs none"
    return "" if count else "no NVIDIA GPU was found: the driver sees none; device cpu needs none"


def toolkit() -> int:
    """Return the major version of CUDA that is installed for Numba; 0 if unknown."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return int(version("cuda-bindings").split(".")[0])
    except (PackageNotFoundError, ValueError):
        return 0
