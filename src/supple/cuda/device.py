"""The NVIDIA GPU through its driver: devices, streams, events and memory, and the errors where there is none."""

from __future__ import annotations

import contextlib
import functools
import importlib
import threading
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument

INSTALL = 'pip install "supple[cuda]" for drivers from 580 on, or "supple[cuda12]" from 525 on'
POOL = 1 << 29  # bytes of freed memory that a device keeps for the next warp, at least
OLDEST = 75  # compute capability 7.5: the least that CUDA 13 compiles for

Array = npt.NDArray[Any]


class CudaError(RuntimeError):
    """A failed call of the driver or its compiler."""


FAILURES = CudaError, MemoryError, OSError
"""The error of a GPU that fails, is out of memory, or has no compiled kernel."""


@functools.cache
def driver() -> Any:
    """Return the bindings of NVIDIA's driver; tests replace it by a simulated driver."""
    try:
        return importlib.import_module("cuda.bindings.driver")
    except ImportError:
        raise SuppleError(f"CUDA needs the package cuda-bindings, which is not installed: {INSTALL}") from None


def call(name: str, *arguments: Any) -> Any:
    """Call a function of the driver, and return its results: one, several, or None.

    Raises
    ------
    CudaError
        If it fails; the message has the function and the driver's own name of the error.
    """
    status, *results = getattr(driver(), name)(*arguments)
    if int(status) != 0:
        raise CudaError(f"{name}: {getattr(status, 'name', status)}")
    return results[0] if len(results) == 1 else results or None


@dataclass(frozen=True, slots=True, eq=False)
class CudaDevice:
    """An opened GPU, by its number in CUDA; ``arch`` is its compute capability (90 for 9.0).

    ``context`` is the driver's primary context, which other libraries share.
    """

    number: int
    name: str
    arch: int
    context: Any

    @contextlib.contextmanager
    def current(self) -> Iterator[None]:
        """Make it the current device of this thread."""
        call("cuCtxPushCurrent", self.context)
        try:
            yield
        finally:
            call("cuCtxPopCurrent")

    def stream(self) -> Stream:
        """Return a new stream that does not wait for the default stream."""
        with self.current():
            handle = int(call("cuStreamCreate", int(driver().CUstream_flags.CU_STREAM_NON_BLOCKING)))
        made = Stream(handle)
        weakref.finalize(made, _ended, "cuStreamDestroy", handle)
        return made

    @property
    def free(self) -> int:
        """The free bytes of memory after emptying the pool."""
        with self.current():
            call("cuMemPoolTrimTo", call("cuDeviceGetDefaultMemPool", call("cuDeviceGet", self.number)), 0)
            return int(call("cuMemGetInfo")[0])


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Stream:
    """A stream of a device, whose work is done in order. 0 is the default stream of the device."""

    handle: int

    def synchronize(self) -> None:
        """Wait until all work is done."""
        call("cuStreamSynchronize", self.handle)

    def record(self) -> Event:
        """Return an event at the end of the work so far."""
        handle = int(call("cuEventCreate", int(driver().CUevent_flags.CU_EVENT_DISABLE_TIMING)))
        made = Event(handle)
        weakref.finalize(made, _ended, "cuEventDestroy", handle)
        call("cuEventRecord", handle, self.handle)
        return made

    def wait(self, event: Event) -> None:
        """Make later work wait for an event."""
        call("cuStreamWaitEvent", self.handle, event.handle, 0)


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Event:
    """A place in the work of a stream."""

    handle: int

    def done(self) -> bool:
        """Return whether the work before it is done, without waiting; CudaError if the device failed."""
        status = driver().cuEventQuery(self.handle)[0]
        if int(status) not in (0, int(driver().CUresult.CUDA_ERROR_NOT_READY)):
            raise CudaError(f"cuEventQuery: {getattr(status, 'name', status)}")
        return int(status) == 0

    def synchronize(self) -> None:
        """Wait for the work before it."""
        call("cuEventSynchronize", self.handle)


class Memory:
    """Memory of a device that belongs to a stream: freed after the work that is on the stream at that time."""

    def __init__(self, size: int, stream: Stream) -> None:
        self.size, self.stream = size, stream
        self.pointer = int(call("cuMemAllocAsync", max(size, 16), stream.handle))
        weakref.finalize(self, _ended, "cuMemFreeAsync", self.pointer, stream.handle, held=stream)

    def upload(self, array: Array, start: int = 0) -> None:
        """Copy a contiguous host array to byte ``start``, asynchronously: it must live until the stream is there."""
        if array.nbytes:
            call("cuMemcpyHtoDAsync", self.pointer + start, array.ctypes.data, array.nbytes, self.stream.handle)

    def download(self, array: Array, start: int = 0) -> None:
        """Copy from byte ``start`` to a contiguous host array, asynchronously, when the stream gets there."""
        if array.nbytes:
            call("cuMemcpyDtoHAsync", array.ctypes.data, self.pointer + start, array.nbytes, self.stream.handle)

    def clear(self) -> None:
        """Set all bytes to 0."""
        call("cuMemsetD8Async", self.pointer, 0, self.size, self.stream.handle)


class Pinned:
    """Page-locked host memory, to which devices copy asynchronously: ``bytes`` is the array."""

    def __init__(self, size: int) -> None:
        import ctypes

        pointer = int(call("cuMemHostAlloc", max(size, 1), int(driver().CU_MEMHOSTALLOC_PORTABLE)))
        memory = (ctypes.c_ubyte * size).from_address(pointer)
        self.bytes: npt.NDArray[np.uint8] = np.frombuffer(memoryview(memory), np.uint8)
        weakref.finalize(self, _ended, "cuMemFreeHost", pointer)


def _ended(name: str, *arguments: Any, held: object = None) -> None:
    """Destroy an object of the driver, before ``held`` is released; ignore errors: the driver may be gone at exit."""
    with contextlib.suppress(Exception):
        call(name, *arguments)


_kept: list[tuple[Event, tuple[object, ...]]] = []
"""Objects that must not be freed or reused before an event."""
_lock = threading.Lock()


def keep(stream: Stream, *held: object) -> Event:
    """Keep objects alive until a stream has done its work so far; return the event of that."""
    release_passed()
    event = stream.record()
    with _lock:
        _kept.append((event, held))
    return event


def release_passed() -> None:
    """Release objects kept for events that have passed, or whose GPU has failed."""

    def over(event: Event) -> bool:
        try:
            return event.done()
        except CudaError:  # reported to the waiting caller
            return True

    with _lock:
        _kept[:] = [each for each in _kept if not over(each[0])]


_opened: dict[int, CudaDevice] = {}


def open_device(number: int = 0) -> CudaDevice:
    """Return the GPU with a number, opened.

    Raises
    ------
    SuppleError
        If NVIDIA's packages, the driver or the GPU are missing, or too old; the message names a remedy.
    """
    if number not in _opened:
        _opened[number] = _ready(number)
    return _opened[number]


def _ready(number: int) -> CudaDevice:
    instead = argument("device", "cpu")
    driver()
    try:
        call("cuInit", 0)
        known, count = int(call("cuDriverGetVersion")), int(call("cuDeviceGetCount"))
    except CudaError as error:
        if "NO_DEVICE" not in str(error):
            raise SuppleError(f"NVIDIA's driver does not work ({_short(error)}); {instead} needs none") from None
        count = 0
    except Exception:  # without CUDA's library, the bindings raise their own errors
        raise SuppleError(f"CUDA needs NVIDIA's driver, which is not installed; {instead} needs none") from None
    if not count:
        raise SuppleError(f"no NVIDIA GPU was found: the driver sees none; {instead} needs none")
    needed = toolkit()
    if known < 1000 * needed:
        older = ', or pip install "supple[cuda12]"' if known >= 12000 else ""
        raise SuppleError(
            f"NVIDIA's driver is too old: it knows CUDA {known // 1000}.{known % 1000 // 10}, and what is "
            f"installed needs {needed}: update the driver{older}"
        )
    if number >= count:
        raise SuppleError(f"GPU {number} is not there: CUDA sees {count} of them, counted from 0")
    try:
        device = call("cuDeviceGet", number)
        name = call("cuDeviceGetName", 256, device).split(b"\0")[0].decode(errors="replace")
        about = driver().CUdevice_attribute
        major, minor = (
            int(call("cuDeviceGetAttribute", getattr(about, f"CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_{part}"), device))
            for part in ("MAJOR", "MINOR")
        )
        if 10 * major + minor < OLDEST:
            found = f"its compute capability is {major}.{minor}, and {OLDEST / 10:.1f} is needed"
            raise SuppleError(f"{name} is too old: {found}; {instead} needs no GPU")
        context = call("cuDevicePrimaryCtxRetain", device)
        made = CudaDevice(number, name, 10 * major + minor, context)
        # Otherwise, every synchronization returns free memory to the system, and allocating again takes milliseconds.
        pool = call("cuDeviceGetDefaultMemPool", device)
        kept = driver().CUmemPool_attribute.CU_MEMPOOL_ATTR_RELEASE_THRESHOLD
        if int(call("cuMemPoolGetAttribute", pool, kept)) < POOL:
            call("cuMemPoolSetAttribute", pool, kept, driver().cuuint64_t(POOL))
        made.free  # noqa: B018 - it fails here, and not during a warp
    except RuntimeError as error:  # of the bindings, where the driver lacks a function
        raise SuppleError(f"GPU {number} cannot be opened ({_short(error)}); {instead} needs no GPU") from None
    return made


def _short(error: object) -> str:
    return " ".join(str(error).split())[:150]


def bindings() -> str:
    """Return the version of the installed bindings, which begins with CUDA's; "" if there are none."""
    with contextlib.suppress(PackageNotFoundError):
        return version("cuda-bindings")
    return ""


def toolkit() -> int:
    """Return the installed major version of CUDA; 0 if it is unknown."""
    major = bindings().split(".")[0]
    return int(major) if major.isdigit() else 0
