"""How kernels for NVIDIA cards are compiled, and how many threads take what."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import cuda

THREADS = 128  # of a block


def device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of kernels: what reads arrays. What does not is `supple.cpu.kernel.lean`."""
    made: Callable[..., Any] = cuda.jit(function, device=True)
    return made


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for a card, when it is first called with arguments of some types."""
    return cuda.jit(function)


def blocks(items: int) -> int:
    """How many blocks of THREADS so many items take."""
    return max(1, -(-items // THREADS))
