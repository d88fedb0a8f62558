"""The choice of an engine: the native one, a GPU, or a CUDA device, by what a user asks and where an array lies."""

from __future__ import annotations

import contextlib
import warnings

import numpy as np

from supple.domain import choice, refuse
from supple.engines.base import Engine, EngineError, Work
from supple.engines.native import NATIVE
from supple.engines.wgpu.device import Gpu, open_gpu
from supple.errors import DeviceWarning, SuppleError

# GPU engines are imported once there is a device: `import supple` is to be quick.

DEVICES = ("auto", "cpu", "gpu", "cuda")


def check_device(device: str, what: str = "") -> None:
    """Refuse an unknown device, and ``"cuda"`` where it cannot be used, before any work.

    ``what`` is a kind of work that no CUDA device does.

    Raises
    ------
    SuppleError
        It says what would do.
    """
    choice("device", device, DEVICES)
    if device == "cuda":
        if what:
            refuse("device", f'"cpu", "gpu" or "auto" for {what}', device)
        _cuda()


def gpu_of(device: str, what: str = "this") -> Gpu | None:
    """Return the GPU that is to do some kind of work, or None for the CPU.

    ``"auto"`` takes a hardware GPU where there is one, never a software one; ``"gpu"`` takes either.

    Raises
    ------
    SuppleError
        If there is no such device, or none for ``"gpu"``, or it is ``"cuda"``, which does work of other kinds.
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
    """Return the engine that does some work on arrays of the host.

    Raises
    ------
    SuppleError
        If there is no such device, or it does not do this and the user asks for it.
    """
    choice("device", device, DEVICES)
    if device == "cuda":
        cuda = _cuda()
        cuda.check(work)
        return cuda
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
    return NATIVE if work.space.is_identity else engine


def lies_on_device(value: object) -> bool:
    """Return whether something is an array on a CUDA device; no library is imported to find out."""
    if isinstance(value, np.ndarray) or callable(value):
        return False
    from supple.engines.cuda.arrays import is_on_device

    return is_on_device(value)


def engine_at(value: object) -> Engine:
    """Return the engine that works where an array lies: on its CUDA device, or the native one."""
    return _cuda() if lies_on_device(value) else NATIVE


def _cuda() -> Engine:
    from supple.engines.cuda.engine import open_cuda

    return open_cuda()


def warn_of_failure(engine: Engine, error: EngineError, stacklevel: int) -> None:
    """Warn that the CPU did what a device could not."""
    warnings.warn(f"the CPU did what {engine.name} could not: {error}", DeviceWarning, stacklevel=stacklevel + 1)
