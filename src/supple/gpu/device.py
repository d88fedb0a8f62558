"""The GPU: its adapter, the limits that are requested, and the error messages where there is none."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import sys
import tempfile
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from supple.errors import SuppleError, argument
from supple.space.checks import choice

# The limits requested of every adapter are those of ordinary GPUs. Larger work is split.
LIMITS: dict[str, int] = {
    "max-bind-groups": 4,
    "max-buffer-size": 256 << 20,
    "max-compute-invocations-per-workgroup": 256,
    "max-compute-workgroup-size-x": 256,
    "max-compute-workgroup-size-y": 256,
    "max-compute-workgroup-size-z": 64,
    "max-compute-workgroup-storage-size": 16384,
    "max-compute-workgroups-per-dimension": 65535,
    "max-storage-buffer-binding-size": 128 << 20,
    "max-storage-buffers-per-shader-stage": 8,
    "max-texture-dimension-2d": 8192,
    "max-texture-dimension-3d": 2048,
    "max-uniform-buffer-binding-size": 64 << 10,
}
_BINDINGS = (1 << 30, 512 << 20, 256 << 20, LIMITS["max-storage-buffer-binding-size"])
"""The binding sizes to request, in bytes; the first that is granted is used."""

_SIZES = ("max-storage-buffer-binding-size", "max-buffer-size")

_KINDS = ("DiscreteGPU", "IntegratedGPU", "VirtualGPU", "Unknown", "CPU")


@dataclass(slots=True, eq=False)
class Gpu:
    """An opened device."""

    name: str  # the adapter's name
    software: bool  # whether the adapter is a software one, on the CPU
    backend: str  # Vulkan, Metal or D3D12
    device: Any = field(repr=False)
    pipelines: dict[Any, Any] = field(repr=False)  # compiled
    lock: Any = field(repr=False)  # held by the one thread that works on the device
    binding: int  # the size of the largest array for a shader, in bytes
    lost: bool = False  # whether the device failed; the next `open_gpu` opens a new one


def _know_types() -> None:
    """Register wgpu's C types with cffi, which would parse them one by one, each time with the whole header.

    Parsing them takes half of the time to open a window. Where cffi's internals differ, nothing changes.
    """
    with contextlib.suppress(Exception):
        import _cffi_backend  # type: ignore[import-untyped]
        from wgpu.backends.wgpu_native import _api
        from wgpu.backends.wgpu_native._ffi import ffi

        names = [name for name in ffi.list_types()[0] if name.startswith("WGPU")]
        names += ["char", "uint8_t", "uint32_t", "intptr_t", "uintptr_t"]
        calls = re.findall(r'^ *@ffi\.callback\(\s*"(void[^"]+)"', Path(_api.__file__).read_text("utf-8"), re.MULTILINE)
        whole = ", ".join([*(f"{name} *" for name in names), *(call.replace("(", "(*)(", 1) for call in calls)])
        pointers = ffi.typeof(f"void(*)({whole})").args
        known = ffi._parsed_types
        for call, kind in zip(calls, pointers[len(names) :], strict=True):
            known.setdefault(call, (kind, True))
        for name, pointer in zip(names, pointers, strict=False):
            array = _cffi_backend.new_array_type(pointer, None)
            pairs = ("", pointer.item), (" *", pointer), (" * ", pointer), ("[]", array), (" []", array)
            for text, kind in pairs:
                known.setdefault(f"{name}{text}", (kind, False))


@functools.cache
def adapters() -> tuple[Any, ...]:
    """Return the adapters of this machine, the fastest kind first."""
    try:
        import wgpu
        from wgpu.backends.wgpu_native import extras
    except (ImportError, OSError, RuntimeError) as error:
        raise SuppleError(f"the GPU needs wgpu, which cannot be loaded ({error}): pip install 'supple[gpu]'") from None
    _know_types()
    # OpenGL lists the same adapters again, with fewer features. The user may have chosen a backend.
    with contextlib.suppress(RuntimeError):
        extras.set_instance_extras(backends=["Vulkan", "Metal", "DX12"])
    # Without a login session, window libraries print a warning if this is not set.
    given = os.environ.get("XDG_RUNTIME_DIR")
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    try:
        found = [a for a in wgpu.gpu.enumerate_adapters_sync() if a.info["backend_type"] != "OpenGL"]
    except Exception as error:  # drivers fail in many ways
        raise SuppleError(f"GPUs cannot be listed ({' '.join(str(error).split())[:100]}): {missing()}") from None
    finally:
        if given is None:
            os.environ.pop("XDG_RUNTIME_DIR", None)
    return tuple(
        sorted(
            found,
            key=lambda a: _KINDS.index(a.info["adapter_type"]) if a.info["adapter_type"] in _KINDS else len(_KINDS),
        )
    )


def missing() -> str:
    """Return the advice on what to install on this system, for messages."""
    if sys.platform == "darwin":
        return "macOS 10.13 or later with Metal is needed"
    if sys.platform == "win32":
        return "a driver with Direct3D 12 or Vulkan is needed, from the maker of the GPU"
    return (
        "a Vulkan driver is needed: that of the GPU, or Mesa's, also for running on the CPU "
        "(Debian and Ubuntu: apt install mesa-vulkan-drivers; Fedora: dnf install mesa-vulkan-drivers)"
    )


_lock = threading.Lock()
_opened: dict[int, Gpu] = {}


DRAWING = ("auto", "cpu", "gpu")
"""The devices that draw volumes."""


def gpu_of(device: str) -> Gpu | None:
    """Return the GPU that draws, or None for the CPU; SuppleError if there is no such device.

    ``"auto"`` takes a hardware GPU if there is one, never a software one; ``"gpu"`` takes either.
    """
    choice("device", device, DRAWING)
    if device == "gpu":
        return open_gpu()
    if device == "auto":
        with contextlib.suppress(SuppleError):
            return open_gpu(software=False)
    return None


def open_gpu(software: bool = True) -> Gpu:
    """Return the device of the fastest adapter, which stays open; without ``software``, only of hardware adapters.

    SuppleError if no adapter works; the message names what to install.
    """
    with _lock:
        reason = ""
        for k, adapter in enumerate(adapters()):
            if adapter.info["adapter_type"] == "CPU" and not software:
                continue
            if k in _opened:
                return _opened[k]
            short = [name for name, wanted in LIMITS.items() if adapter.limits.get(name, wanted) < wanted]
            if short:
                reason = f"{adapter.info['device']} is too small ({short[0]}): "
                continue
            binding = next(size for size in _BINDINGS if all(adapter.limits.get(name, size) >= size for name in _SIZES))
            limits = LIMITS | dict.fromkeys(_SIZES, max(binding, LIMITS["max-buffer-size"]))
            limits["max-storage-buffer-binding-size"] = binding
            try:
                device = adapter.request_device_sync(required_limits=limits)
            except Exception as error:  # drivers fail in many ways
                reason = f"{adapter.info['device']} cannot be opened ({' '.join(str(error).split())[:100]}): "
                continue
            name, kind, backend = (str(adapter.info[key]) for key in ("device", "adapter_type", "backend_type"))
            _opened[k] = Gpu(name, kind == "CPU", backend, device, {}, threading.RLock(), binding)
            return _opened[k]
    raise SuppleError(f"no GPU was found: {reason}{missing()}; {argument('device', 'cpu')} needs none")


_LOST = re.compile(r"\blost\b|\bdevice\b.*\bdestroyed\b", re.IGNORECASE)  # a texture or a buffer may be destroyed, too


def failures() -> tuple[type[Exception], ...]:
    """Return the types of exceptions raised if a device is lost or full, or a driver cannot compile a shader."""
    from wgpu import GPUError

    return (GPUError, MemoryError, RuntimeError, ArithmeticError)


def trouble(gpu: Gpu, error: Exception) -> str:
    """Return an error's text in one short line; a lost device is dropped, and opened again at the next use."""
    from wgpu import GPUValidationError

    text = " ".join(str(error).split())
    # A validation error is a bug, unless the device is lost, which gives one too.
    mistaken = isinstance(error, GPUValidationError) and not _LOST.search(text)
    if not (mistaken or isinstance(error, MemoryError | ArithmeticError)):
        with _lock:
            gpu.lost = True
            for k in [k for k, known in _opened.items() if known is gpu]:
                del _opened[k]
    return text[:120] or "the work does not fit"


def describe() -> list[dict[str, str]]:
    """Return a description of the adapters of this machine; SuppleError if there are none."""
    if not adapters():
        raise SuppleError(f"no GPU was found: {missing()}")
    kinds = {"DiscreteGPU": "a discrete GPU", "IntegratedGPU": "in the processor", "VirtualGPU": "a part of another's"}
    kinds["CPU"] = "a program that runs on the CPU"
    return [
        {
            "name": str(a.info["device"]),
            "kind": kinds.get(a.info["adapter_type"], "of an unknown kind"),
            "backend": str(a.info["backend_type"]),
            "driver": str(a.info["description"]),
        }
        for a in adapters()
    ]
