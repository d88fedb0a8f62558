"""The choice of an engine, native, GPU or CUDA, by the user's request and the location of the array."""

from __future__ import annotations

import contextlib
import warnings

import numpy as np

from supple.domain import choice, refuse
from supple.engines.base import Engine, EngineError, Work
from supple.engines.native import NATIVE
from supple.engines.wgpu.device import Gpu, open_gpu
from supple.errors import DeviceWarning, SuppleError

# GPU engines are imported only if there is a device, to keep `import supple` fast.

DEVICES = ("auto", "cpu", "gpu", "cuda")


def check_device(device: str, what: str = "") -> None:
    """Raise SuppleError for an unknown device, and for ``"cuda"`` where it cannot be used.

    ``what`` names a kind of work that CUDA devices do not support.

    Raises
    ------
    SuppleError
        The message names the devices that can be used.
    """
    choice("device", device, DEVICES)
    if device == "cuda":
        if what:
            refuse("device", f'"cpu", "gpu" or "auto" for {what}', device)
        _cuda()


def check_host(device: str) -> None:
    """Raise SuppleError for a device that warps by strokes alone."""
    if device == "gpu":
        refuse(
            "device",
            '"cpu", "cuda" or "auto" for fields, affine maps, output grids and sheared volumes, which it does not know',
            device,
        )


def gpu_of(device: str, what: str = "this") -> Gpu | None:
    """Return the GPU for some kind of work, or None for the CPU.

    ``"auto"`` takes a hardware GPU if there is one, never a software one; ``"gpu"`` takes either.

    Raises
    ------
    SuppleError
        If there is no such device, or the device is ``"cuda"``, which does not support this work.
    """
    check_device(device, what)
    if device == "cpu":
        return None
    if device == "gpu":
        return open_gpu()
    with contextlib.suppress(SuppleError):
        return open_gpu(software=False)
    return None


def engine_for(device: str, work: Work) -> Engine:
    """Return the engine for work on host arrays.

    Raises
    ------
    SuppleError
        If the user names a device that does not exist, or does not support this work.
    """
    if device == "cuda":
        cuda = _cuda()
        cuda.check(work)
        return cuda
    if not work.space.is_plain:
        check_host(device)
        return NATIVE
    gpu = gpu_of(device)
    if gpu is None:
        return NATIVE
    from supple.engines.wgpu.engine import Wgpu

    engine = Wgpu(gpu)
    try:
        engine.check(work)
    except SuppleError:
        if device == "gpu":
            raise
        return NATIVE
    return NATIVE if work.is_identity else engine


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


def warn_of_failure(engine: Engine, error: EngineError, stacklevel: int) -> None:
    """Warn that the CPU took over from a device that failed."""
    warnings.warn(f"the CPU did what {engine.name} could not: {error}", DeviceWarning, stacklevel=stacklevel + 1)
