"""How kernels for NVIDIA GPUs are compiled and launched, and how many threads take what."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from numba import cuda, njit
from numba.cuda.core import config

THREADS = 128  # of a block
# Inputs are checked to be finite outside the kernels, so that these may assume it.
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "reassoc"}
_lock = threading.Lock()


def lean(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile plain arithmetic, which reads no array, as a part of kernels; in Numba's simulator it runs compiled."""
    options: dict[str, Any] = {"nogil": True, "fastmath": FAST, "forceinline": True, "_nrt": False}
    made: Callable[..., Any] = njit(error_model="numpy", **options)(function)
    return made


def device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of kernels what reads arrays."""
    made: Callable[..., Any] = cuda.jit(function, device=True)
    return made


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for a GPU, when it is first called with arguments of some types, and keep that on disk."""
    try:
        return cuda.jit(function, cache=True)
    except RuntimeError:  # nothing can be written: compile at every start
        return cuda.jit(function)


def made_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that other functions are put into, which Numba does not find again on disk."""
    return cuda.jit(function)


def launched(kernel: Any, blocks: int | tuple[int, ...], threads: int, stream: Any) -> Any:
    """A kernel on a grid of blocks and on a stream, to be called with its arguments."""
    with _lock:
        kept = config.CUDA_LOW_OCCUPANCY_WARNINGS
        config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # small arrays are no fault of whoever has them
        try:
            return kernel[blocks, threads, stream]
        finally:
            config.CUDA_LOW_OCCUPANCY_WARNINGS = kept


def blocks(items: int) -> int:
    """How many blocks of THREADS so many items take."""
    return max(1, -(-items // THREADS))
