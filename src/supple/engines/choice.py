"""The choice of an engine, native or CUDA, by the user's request and the location of the array."""

from __future__ import annotations

import numpy as np

from supple.engines.base import Engine
from supple.engines.native import NATIVE
from supple.space.domain import refuse

# The CUDA engine is imported only if there is a device, to keep `import supple` fast.

DEVICES = ("auto", "cpu", "cuda")
"""The devices that warp."""


def check_device(device: object, what: str = "") -> None:
    """Raise SuppleError for a device that does not warp, and for ``"cuda"`` where it cannot be used.

    ``what`` names a kind of work that CUDA devices do not support.

    Raises
    ------
    SuppleError
        The message names the devices that can be used.
    """
    if not isinstance(device, str) or device not in DEVICES:
        refuse("device", '"cpu", "cuda" (on an NVIDIA GPU) or "auto"', device)
    if device == "cuda":
        if what:
            refuse("device", f'"cpu" or "auto" for {what}', device)
        _cuda()


def engine_for(device: str) -> Engine:
    """Return the engine that warps host arrays.

    Raises
    ------
    SuppleError
        If the user names a device that does not exist, or does not warp.
    """
    check_device(device)
    return _cuda() if device == "cuda" else NATIVE


def lies_on_device(value: object) -> bool:
    """Return whether a value is an array on a CUDA device, without importing any library."""
    if isinstance(value, np.ndarray) or callable(value):
        return False
    from supple.engines.cuda.arrays import is_on_device

    return is_on_device(value)


def engine_at(value: object) -> Engine:
    """Return the engine for the location of an array: its CUDA device, or the native engine."""
    return _cuda() if lies_on_device(value) else NATIVE


def _cuda() -> Engine:
    from supple.engines.cuda.engine import open_cuda

    return open_cuda()
