"""A simulated driver of NVIDIA: it runs kernels that are compiled for the host, and records all calls.

Its functions are those of ``cuda.bindings.driver`` that the engine calls, with their arguments and results. Work of a
stream is done at once, in the order of the calls; what a real driver would refuse fails here: freed memory, unknown
streams and events, a context that is not current.
"""

from __future__ import annotations

import ctypes
import json
import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from supple.cuda.arrays import CudaArray
from supple.cuda.device import Stream, call, open_device

REAL = os.environ.get("SUPPLE_TEST_CUDA") == "1"
"""Whether there must be a real GPU, on which the tests run."""
SUCCESS, OUT_OF_MEMORY = 0, 2


class Status(int):
    """A result of the driver's, with its name."""

    name = property(lambda self: {0: "CUDA_SUCCESS", 1: "CUDA_ERROR_INVALID_VALUE", 2: "CUDA_ERROR_OUT_OF_MEMORY",
                                  600: "CUDA_ERROR_NOT_READY"}[int(self)])  # fmt: skip


class Driver:
    """One GPU, of compute capability 9.0, with as much memory as it is told to have."""

    CUstream_flags = SimpleNamespace(CU_STREAM_NON_BLOCKING=1)
    CUevent_flags = SimpleNamespace(CU_EVENT_DISABLE_TIMING=2)
    CU_MEMHOSTALLOC_PORTABLE = 1
    CUresult = SimpleNamespace(CUDA_ERROR_NOT_READY=600)
    CUdevice_attribute = SimpleNamespace(
        CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR=75, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR=76
    )
    CUmemPool_attribute = SimpleNamespace(CU_MEMPOOL_ATTR_RELEASE_THRESHOLD=4)
    cuuint64_t = int

    def __init__(self, library: Path, memory: int = 8 << 30) -> None:
        self._run = ctypes.CDLL(str(library)).run
        self._run.restype = ctypes.c_bool
        self.held_back = 0
        self.size, self.fails = memory, ""  # the function that fails the next time
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.memory: dict[int, np.ndarray] = {}
        self.pinned: dict[int, np.ndarray] = {}
        self.streams, self.events, self.modules = {0}, {}, {}
        self._current = threading.local()
        self._next = 1000

    def __getattribute__(self, name: str) -> Any:
        found = object.__getattribute__(self, name)
        if not callable(found) or isinstance(found, type) or not name.startswith("cu"):
            return found

        def called(*arguments: Any) -> Any:
            self.calls.append((name, arguments))
            if self.fails == name:
                self.fails = ""
                return (Status(OUT_OF_MEMORY), *[None] * 3)
            free = {"cuInit", "cuDriverGetVersion", "cuDeviceGetCount", "cuDeviceGet", "cuDeviceGetName"}
            free |= {"cuDeviceGetDefaultMemPool", "cuMemPoolGetAttribute", "cuMemPoolSetAttribute"}
            free |= {"cuDeviceGetAttribute", "cuDevicePrimaryCtxRetain", "cuCtxPushCurrent", "cuMemFreeAsync"}
            free |= {"cuStreamDestroy", "cuEventDestroy", "cuMemFreeHost", "cuEventQuery"}
            if name not in free and not self._contexts():
                raise AssertionError(f"{name} without a current context")
            result = found(*arguments)
            return (Status(SUCCESS), *(() if result is None else result if isinstance(result, tuple) else (result,)))

        return called

    def _contexts(self) -> list[Any]:
        if not hasattr(self._current, "stack"):
            self._current.stack = []
        return self._current.stack

    def _new(self) -> int:
        self._next += 1
        return self._next

    # ---- devices

    def cuInit(self, flags: int) -> None:  # noqa: N802 - the driver's own names
        pass

    def cuDriverGetVersion(self) -> int:  # noqa: N802
        return 13000

    def cuDeviceGetCount(self) -> int:  # noqa: N802
        return 1

    def cuDeviceGet(self, number: int) -> int:  # noqa: N802
        return 0

    def cuDeviceGetName(self, size: int, device: int) -> bytes:  # noqa: N802
        return b"a GPU in memory\0\0"

    def cuDeviceGetAttribute(self, attribute: int, device: int) -> int:  # noqa: N802
        return {75: 9, 76: 0}[attribute]

    def cuDeviceGetDefaultMemPool(self, device: int) -> str:  # noqa: N802
        return "the pool"

    def cuMemPoolGetAttribute(self, pool: str, attribute: int) -> int:  # noqa: N802
        return self.held_back

    def cuMemPoolSetAttribute(self, pool: str, attribute: int, value: int) -> None:  # noqa: N802
        assert (pool, attribute) == ("the pool", 4)
        self.held_back = value

    def cuMemPoolTrimTo(self, pool: str, least: int) -> None:  # noqa: N802
        assert (pool, least) == ("the pool", 0)

    def cuDevicePrimaryCtxRetain(self, device: int) -> str:  # noqa: N802
        return "the context"

    def cuCtxPushCurrent(self, context: Any) -> None:  # noqa: N802
        self._contexts().append(context)

    def cuCtxPopCurrent(self) -> Any:  # noqa: N802
        return self._contexts().pop()

    def cuMemGetInfo(self) -> tuple[int, int]:  # noqa: N802
        return self.size - sum(held.nbytes for held in self.memory.values()), self.size

    # ---- memory

    def _held(self, pointer: int, size: int) -> None:
        """Some memory, all of which must be there."""
        for start, array in self.memory.items():
            if start <= pointer and pointer + size <= start + array.nbytes:
                return
        raise AssertionError(f"{size} bytes at {pointer} are not of the device")

    def cuMemAllocAsync(self, size: int, stream: int) -> int:  # noqa: N802
        assert stream in self.streams
        array = np.full(size + 64, 0xEE, np.uint8)
        pointer = array.ctypes.data + -array.ctypes.data % 64
        self.memory[pointer] = array[pointer - array.ctypes.data :][:size]
        return pointer

    def cuMemFreeAsync(self, pointer: int, stream: int) -> None:  # noqa: N802
        assert stream in self.streams, "memory that outlives its stream"
        self.memory.pop(pointer).fill(0xDD)

    def cuMemHostAlloc(self, size: int, flags: int) -> int:  # noqa: N802
        array = np.zeros(size, np.uint8)
        self.pinned[array.ctypes.data] = array
        return array.ctypes.data

    def cuMemFreeHost(self, pointer: int) -> None:  # noqa: N802
        del self.pinned[pointer]

    def cuMemcpyHtoDAsync(self, to: int, source: int, size: int, stream: int) -> None:  # noqa: N802
        assert stream in self.streams
        self._held(to, size)
        ctypes.memmove(to, source, size)

    def cuMemcpyDtoHAsync(self, to: int, source: int, size: int, stream: int) -> None:  # noqa: N802
        assert stream in self.streams
        self._held(source, size)
        ctypes.memmove(to, source, size)

    def cuMemsetD8Async(self, pointer: int, value: int, size: int, stream: int) -> None:  # noqa: N802
        assert stream in self.streams
        self._held(pointer, size)
        ctypes.memset(pointer, value, size)

    # ---- order

    def cuStreamCreate(self, flags: int) -> int:  # noqa: N802
        self.streams.add(made := self._new())
        return made

    def cuStreamDestroy(self, stream: int) -> None:  # noqa: N802
        self.streams.remove(stream)

    def cuStreamSynchronize(self, stream: int) -> None:  # noqa: N802
        assert stream in self.streams

    def cuStreamWaitEvent(self, stream: int, event: int, flags: int) -> None:  # noqa: N802
        assert stream in self.streams
        assert event in self.events

    def cuEventCreate(self, flags: int) -> int:  # noqa: N802
        self.events[made := self._new()] = None
        return made

    def cuEventRecord(self, event: int, stream: int) -> None:  # noqa: N802
        assert stream in self.streams
        self.events[event] = stream

    def cuEventQuery(self, event: int) -> None:  # noqa: N802
        assert event in self.events

    def cuEventSynchronize(self, event: int) -> None:  # noqa: N802
        assert event in self.events

    def cuEventDestroy(self, event: int) -> None:  # noqa: N802
        del self.events[event]

    # ---- kernels

    def cuModuleLoadData(self, code: bytes) -> int:  # noqa: N802
        self.modules[made := self._new()] = json.loads(code)
        return made

    def cuModuleGetFunction(self, module: int, name: bytes) -> tuple[dict[str, Any]]:  # noqa: N802
        program = self.modules[module]
        assert program["unit"] == name.decode()
        return (program,)

    def cuLaunchKernel(self, program: Any, x: int, y: int, z: int, threads: int, *rest: Any) -> None:  # noqa: N802
        one, other, shared, stream, arguments, extra = rest
        assert (one, other, shared, extra) == (1, 1, 0, 0)
        assert stream in self.streams
        assert 0 < x < 1 << 31
        assert 0 < y < 65536
        assert 0 < z < 65536
        pointer = ctypes.c_void_p.from_address(arguments).value
        grid = (ctypes.c_int * 3)(x, y, z)
        known = self._run(
            program["number"], program["dimensions"], program["sample"].encode(), program["together"],
            program["filter"], grid, threads, ctypes.c_void_p(pointer),
        )  # fmt: skip
        assert known, program


class OnDevice:
    """An array on the GPU, real or played, as a library that nobody knows has it; parts of it share its memory."""

    def __init__(self, array: np.ndarray, memory: Any = None, root: np.ndarray | None = None) -> None:
        self.array, self.root = array, array if root is None else root
        if REAL and memory is None:
            self.root = np.ascontiguousarray(array)
            self.array = self.root
            memory = CudaArray(self.root.shape, self.root.dtype, open_device(), Stream(0))
            memory._memory.upload(self.root)
        self.memory = memory

    def __getitem__(self, part: Any) -> OnDevice:
        return OnDevice(self.array[part], self.memory, self.root)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        about = dict(self.array.__array_interface__)
        start = about["data"][0]
        if self.memory is not None:
            start += self.memory._memory.pointer - self.root.ctypes.data
        read_only = not self.array.flags.writeable
        return {"shape": about["shape"], "strides": about["strides"], "typestr": about["typestr"],
                "data": (start, read_only), "stream": None, "version": 3}  # fmt: skip


def sent(array: np.ndarray) -> OnDevice:
    """An array on the GPU; on the played one, with the strides that it has."""
    with open_device().current():
        return OnDevice(array)


def on_host(array: Any) -> np.ndarray:
    """What is in an array of the GPU: a copy."""
    if isinstance(array, OnDevice) and array.memory is None:
        return array.array.copy()
    if isinstance(array, OnDevice):
        whole = on_host(array.memory)
        offset = array.array.ctypes.data - array.root.ctypes.data
        return np.ndarray(array.array.shape, whole.dtype, whole, offset, array.array.strides).copy()
    about = array.__cuda_array_interface__
    made = np.empty(about["shape"], np.dtype(about["typestr"]))
    with open_device().current():
        call("cuStreamSynchronize", array._memory.stream.handle)
        if made.nbytes:
            call("cuMemcpyDtoHAsync", made.ctypes.data, about["data"][0], made.nbytes, 0)
        call("cuStreamSynchronize", 0)
    return made
