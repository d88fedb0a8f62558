"""Kernels, compiled by NVRTC from the core's headers, and kept on disk by their content and the GPU's architecture."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from supple.engines.cuda.device import CudaDevice, CudaError, Stream, bindings, call
from supple.engines.cuda.layout import JOB, SOME

UNITS = ("points", "nodes", "cells", "fill", "rough")
THREADS = 128  # of a block

_HERE = Path(__file__).parent / "kernels"
_CORE = Path(__file__).parents[2] / "_core"
_loaded: dict[tuple[int, Program], Future[Any]] = {}
_lock = threading.Lock()


@dataclass(frozen=True, slots=True)
class Program:
    """A kernel, and what it is compiled for.

    Parameters
    ----------
    unit : str
        The kernel: one of `UNITS`.
    dimensions : int
        2 or 3.
    composed : bool, optional
        Whether the map is a composite, and not of strokes alone; None: of both kinds.
    sample, number : str
        The types, in C++, of samples, and of their sums; for ``fill`` and ``rough`` alone.
    together : int
        How many channels are summed together: 1 or 4.
    filter : int
    """

    unit: str
    dimensions: int
    composed: bool | None = False
    sample: str = ""
    number: str = ""
    together: int = 1
    filter: int = 0

    @property
    def options(self) -> list[str]:
        """The options of the compiler that choose it."""
        chosen: dict[str, object] = {"UNIT": UNITS.index(self.unit), "DIM": self.dimensions}
        chosen |= {"JOB_BYTES": JOB.itemsize, "SOME_BYTES": SOME.itemsize}
        if self.composed is not None:
            chosen["COMPOSED"] = int(self.composed)
        if self.sample:
            chosen |= {"SAMPLE": self.sample, "NUMBER": self.number}
            chosen |= {"TOGETHER": self.together, "CHOSEN": self.filter}
        return [f"-D{name}={value}" for name, value in chosen.items()]


@cache
def sources() -> tuple[str, Mapping[str, str]]:
    """Return the text of the kernels, and of the headers that they include, by their names."""
    headers = {path.name: path.read_text(encoding="utf-8") for path in sorted(_HERE.glob("*.hpp"))}
    waiting = list(headers.values())
    while waiting:
        for line in waiting.pop().splitlines():
            name = line.removeprefix('#include "').rstrip('"')
            if line.startswith('#include "') and name not in headers:
                headers[name] = (_CORE / name).read_text(encoding="utf-8")
                waiting.append(headers[name])
    return (_HERE / "kernels.cu").read_text(encoding="utf-8"), headers


def compiled(program: Program, arch: int, *more: str) -> tuple[bytes, str]:
    """Compile a program for an architecture (90: sm_90), and return the machine code and what the compiler says.

    Raises
    ------
    CudaError
        If the program does not compile.
    """
    from cuda.bindings import nvrtc

    def done(result: Any) -> Any:
        if int(result[0]) != 0:
            raise CudaError(f"NVRTC: {result[0].name}")
        return result[1] if len(result) > 1 else None

    text, headers = sources()
    options = [f"--gpu-architecture=sm_{arch}", "-default-device", "--std=c++20", *program.options, *more]
    handle = done(
        nvrtc.nvrtcCreateProgram(
            text.encode(), f"{program.unit}.cu".encode(), len(headers),
            [header.encode() for header in headers.values()], [name.encode() for name in headers],
        )
    )  # fmt: skip
    try:
        status = nvrtc.nvrtcCompileProgram(handle, len(options), [option.encode() for option in options])[0]
        # NVRTC writes into what it is given, and Python shares its bytes of length 1 (an empty log has one).
        said = bytearray(done(nvrtc.nvrtcGetProgramLogSize(handle)))
        done(nvrtc.nvrtcGetProgramLog(handle, said))
        log = said.rstrip(b"\0").decode(errors="replace")
        if int(status) != 0:
            raise CudaError(f"NVRTC: {status.name}: {log}")
        code = bytearray(done(nvrtc.nvrtcGetCUBINSize(handle)))
        done(nvrtc.nvrtcGetCUBIN(handle, code))
    finally:
        nvrtc.nvrtcDestroyProgram(handle)
    return bytes(code), log


def folder() -> Path:
    """Return the folder of compiled programs: SUPPLE_CACHE, or supple/cuda in the user's folder of caches."""
    given = os.environ.get("SUPPLE_CACHE")
    if given:
        return Path(given)
    if sys.platform == "win32":
        home = os.environ.get("LOCALAPPDATA") or tempfile.gettempdir()
    else:
        home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home, "supple", "cuda")


def kept(program: Program, arch: int) -> bytes:
    """Return the machine code of a program: from disk, or compiled and kept there, if that can be written."""
    text, headers = sources()
    content = "\n".join([bindings(), str(arch), *program.options, text, *headers.values()])
    path = folder() / f"{program.unit}-sm_{arch}-{hashlib.sha256(content.encode()).hexdigest()[:32]}.cubin"
    with contextlib.suppress(OSError):
        return path.read_bytes()
    code, _ = compiled(program, arch)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(code)
        os.replace(file.name, path)
    return code


@cache
def _compilers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(len(UNITS), "supple-nvrtc")


def prepare(gpu: CudaDevice, program: Program) -> Future[Any]:
    """Begin to load a kernel, beside others; what is compiled first takes seconds."""
    key = (gpu.number, program)
    with _lock:
        if key not in _loaded:
            _loaded[key] = _compilers().submit(_load, gpu, program)
        return _loaded[key]


def _load(gpu: CudaDevice, program: Program) -> Any:
    try:
        code = kept(program, gpu.arch)
        with gpu.current():
            return call("cuModuleGetFunction", call("cuModuleLoadData", code), program.unit.encode())
    except Exception:
        with _lock:
            _loaded.pop((gpu.number, program), None)  # it may succeed the next time
        raise


def launch(kernel: Future[Any], blocks: tuple[int, int, int] | int, job: np.ndarray[Any, Any], stream: Stream) -> None:
    """Launch a kernel on a stream of the current device, with one argument: a record, which is copied.

    Parameters
    ----------
    kernel : Future
        From `prepare`.
    blocks : int or (int, int, int)
        The grid, of blocks of `THREADS`.
    job : array of one record
    stream : Stream
    """
    grid = (blocks, 1, 1) if isinstance(blocks, int) else blocks
    argument = np.array([job.ctypes.data], np.uintp)  # the driver takes an array of pointers to arguments
    call("cuLaunchKernel", kernel.result(), *grid, THREADS, 1, 1, 0, stream.handle, int(argument.ctypes.data), 0)


def blocks(items: int) -> int:
    """Return the number of blocks for some items."""
    return max(1, -(-items // THREADS))
