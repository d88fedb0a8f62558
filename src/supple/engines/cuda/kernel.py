"""Compilation and launch of kernels for NVIDIA GPUs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from numba import cuda, njit
from numba.cuda.core import config

THREADS = 128  # of a block
# Inputs are checked to be finite outside the kernels, which may assume it.
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "reassoc"}
_lock = threading.Lock()


def lean(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile arithmetic without arrays as a device function; in Numba's simulator it is compiled for the CPU."""
    options: dict[str, Any] = {"nogil": True, "fastmath": FAST, "forceinline": True, "_nrt": False}
    made: Callable[..., Any] = njit(error_model="numpy", **options)(function)
    return made


def device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a device function that reads arrays."""
    made: Callable[..., Any] = cuda.jit(function, device=True)
    return made


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel at its first call for each set of types, with a cache on disk."""
    try:
        return cuda.jit(function, cache=True)
    except RuntimeError:  # the cache is not writable: compile at every start
        return cuda.jit(function)


def made_kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel made of other functions, which Numba's cache does not support."""
    return cuda.jit(function)


def launched(kernel: Any, blocks: int | tuple[int, ...], threads: int, stream: Any) -> Any:
    """Return a kernel with its grid of blocks and its stream, to be called with its arguments."""
    with _lock:
        kept = config.CUDA_LOW_OCCUPANCY_WARNINGS
        config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # a small array is not worth a warning
        try:
            return kernel[blocks, threads, stream]
        finally:
            config.CUDA_LOW_OCCUPANCY_WARNINGS = kept


def blocks(items: int) -> int:
    """Return the number of blocks of THREADS for some items."""
    return max(1, -(-items // THREADS))
