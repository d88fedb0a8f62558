"""Where an array lies, and which devices did the work."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from contextvars import ContextVar

import numpy as np

from supple.errors import SuppleError

CPU = "cpu"
ON_CUDA = (2, 13)
"""DLPack's types of devices: GPU memory, and memory that CUDA shares with the host."""

_noted: ContextVar[dict[str, None] | None] = ContextVar("noted", default=None)


def library_of(value: object) -> str:
    """Return the library of an array that may be on a GPU, "torch", "cupy", "numba" or "other", importing none."""
    for name, kind in (("torch", "Tensor"), ("cupy", "ndarray")):
        library = sys.modules.get(name)
        if library is not None and isinstance(value, getattr(library, kind)):
            return name
    return "numba" if "numba.cuda" in sys.modules and hasattr(value, "__cuda_ndarray__") else "other"


def is_on_device(value: object) -> bool:
    """Return whether a value is, or may be, an array on a CUDA device, without importing any library."""
    if isinstance(value, np.ndarray) or callable(value):
        return False
    try:
        if library_of(value) == "torch":
            return bool(value.is_cuda)  # type: ignore[attr-defined]
        if getattr(value, "__cuda_ndarray__", None) or hasattr(value, "__cuda_array_interface__"):
            return True
        where = getattr(value, "__dlpack_device__", None)
        return where is not None and int(where()[0]) in ON_CUDA
    except (TypeError, ValueError, RuntimeError, BufferError):  # raised by some libraries for arrays of the host
        return False


def check_gradients(value: object, name: str) -> None:
    """Raise SuppleError for a tensor that requires gradients, which this operation does not compute."""
    if getattr(value, "requires_grad", False) is True:
        raise SuppleError(
            f"{name} is a tensor that wants gradients, found requires_grad=True: supple.torch.warp makes them, and "
            "tensor.detach() does without"
        )


def note(name: str) -> None:
    """Record that a device did some of the work."""
    noted = _noted.get()
    if noted is not None:
        noted[name] = None


@contextlib.contextmanager
def workers() -> Iterator[Callable[[], str]]:
    """Record the devices that work for this thread; yield a function that names those so far, in order."""
    noted: dict[str, None] = {}
    token = _noted.set(noted)
    try:
        yield lambda: " and ".join(noted) or CPU
    finally:
        _noted.reset(token)
