"""Kernels, compiled by NVRTC from the core's headers, and cached on disk by content and architecture."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import io
import os
import re
import sys
import tempfile
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from supple.cuda.device import CudaDevice, CudaError, Stream, bindings, call

UNITS = ("points", "nodes", "cells", "fill", "rough")
THREADS = 128  # of a block

# The records that kernels take, in the layout of kernels/job.hpp and kernels/points.hpp, which check their sizes.
_SAMPLES = np.dtype([("first", "u8"), ("plane", "i8"), ("row", "i8"), ("column", "i8"), ("channel", "i8")])

JOB = np.dtype(
    [(name, "u8") for name in ("maps", "xs", "ys", "nodes", "leaves", "states", "rough", "checks")]
    + [("source", _SAMPLES), ("out", _SAMPLES), ("fill", "u8"), ("top", "u8")]
    + [(name, "f8") for name in ("tolerance", "white", "high")]
    + [
        (name, "i4")
        for name in (
            "map_count", "planes", "first", "shared", "width", "height", "nx", "ny", "from_x", "from_y", "w", "h",
            "count", "held_from", "channels", "between", "rule", "average", "alpha", "light",
        )
    ]
)  # fmt: skip

SOME = np.dtype(
    [(name, "u8") for name in ("map", "points", "to", "matrices", "residual", "steps", "done", "checks")]
    + [("count", "i8"), ("tolerance", "f8"), ("wide", "i4"), ("back", "i4")]
)

CHECKS = np.dtype([("worst", "f4"), ("rough", "i4"), ("unsolved", "i4"), ("folded", "i4"), ("outside", "i4")])


_structure = cache(np.ctypeslib.as_ctypes_type)


def record(kind: np.dtype[Any], **values: Any) -> Any:
    """Return a pointer to a record, with its fields as ``contents``; other fields are 0; TypeError for unknown ones."""
    if unknown := values.keys() - set(kind.names or ()):  # which ctypes would take for attributes of Python's
        raise TypeError(f"no field of the record: {', '.join(sorted(unknown))}")
    return ctypes.pointer(_structure(kind)(**values))


_HERE = Path(__file__).parent / "kernels"
_CORE = Path(__file__).parents[1] / "_core"
_loaded: dict[tuple[int, Program], Future[Any]] = {}
_lock = threading.Lock()
_compilers = ThreadPoolExecutor(len(UNITS), "supple-nvrtc")


class Program(NamedTuple):
    """A kernel, and what it is specialized for.

    The ``unit`` is one of `UNITS`; ``composed`` says whether the map is a composite, or of strokes alone (None:
    either). For ``fill`` and ``rough`` alone: the C++ types of samples and of their sums; how many channels are summed
    ``together`` (all, 1 or 3, or up to 4); options as in the job; whether the arrays are ``small``, of fewer than 2³¹
    samples; and the number of channels of a ``packed`` source, whose pixels are contiguous, or 0.
    """

    unit: str
    dimensions: int
    composed: bool | None = False
    sample: str = ""
    number: str = ""
    together: int = 1
    filter: int = 0
    between: int = 0
    average: int = 0
    light: int = 0
    small: int = 0
    packed: int = 0

    @property
    def macros(self) -> list[str]:
        """The macros that select it."""
        chosen: dict[str, object] = {"UNIT": UNITS.index(self.unit), "DIM": self.dimensions}
        chosen |= {"JOB_BYTES": JOB.itemsize, "SOME_BYTES": SOME.itemsize}
        if self.composed is not None:
            chosen["COMPOSED"] = int(self.composed)
        if self.sample:
            chosen |= {"SAMPLE": self.sample, "NUMBER": self.number, "TOGETHER": self.together, "CHOSEN": self.filter,
                       "BETWEEN": self.between, "AVERAGE": self.average, "LIGHT": self.light}  # fmt: skip
        chosen |= {name: value for name, value in (("SMALL", int(self.small)), ("PACKED", self.packed)) if value}
        return [f"{name}={value}" for name, value in chosen.items()]


@cache
def sources() -> Mapping[str, str]:
    """Return the source texts of kernels by file name, each after the files that it includes."""
    texts: dict[str, str] = {}

    def add(name: str) -> None:
        path = _HERE / name if (_HERE / name).exists() else _CORE / name
        text = path.read_text(encoding="utf-8")
        for included in re.findall(r'^#include "(.*)"', text, re.MULTILINE):
            if included not in texts:
                add(included)
        # Without includes: NVRTC gets one text of all files, in order, and opens none.
        texts[name] = re.sub(r'^#(include "|pragma once).*', "", text, flags=re.MULTILINE)

    add("kernels.cu")
    return texts


def compiled(program: Program, arch: int, *more: str) -> tuple[bytes, str]:
    """Compile a program for an architecture (90: sm_90); return the machine code and the compiler's messages.

    ``more`` are options of the assembler.

    Raises
    ------
    CudaError
        If the program does not compile.
    """
    said = io.StringIO()
    text = "\n".join(f'#line 1 "{name}"\n{text}' for name, text in sources().items())
    try:
        with _lock:  # the first import loads its modules, and is not thread-safe
            from cuda import core

        options = core.ProgramOptions(
            name=f"{program.unit}.cu", arch=f"sm_{arch}", std="c++20", device_as_default_execution_space=True,
            define_macro=program.macros, ptxas_options=list(more),
        )  # fmt: skip
        made = core.Program(text, "c++", options).compile("cubin", logs=said)
    except Exception as error:  # of NVRTC, or where it is missing
        raise CudaError(f"NVRTC: {error}") from error
    return bytes(made.code), said.getvalue()


def folder() -> Path:
    """Return the folder of compiled programs: SUPPLE_CACHE, or supple/cuda in the user's cache folder."""
    if given := os.environ.get("SUPPLE_CACHE"):
        return Path(given)
    if sys.platform == "win32":
        home = os.environ.get("LOCALAPPDATA") or tempfile.gettempdir()
    else:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if home.startswith("~"):  # a user without a home
        home = tempfile.gettempdir()
    return Path(home, "supple", "cuda")


def kept(program: Program, arch: int) -> bytes:
    """Return the machine code of a program: from the cache, or compiled, and cached if the folder can be written."""
    content = "\n".join([bindings(), str(arch), *program.macros, *sources().values()])
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


def prepare(gpu: CudaDevice, program: Program) -> Future[Any]:
    """Start loading a kernel in a thread; a kernel that must be compiled takes seconds."""
    key = (gpu.number, program)
    with _lock:
        found = _loaded.get(key)
        if found is None:
            found = _loaded[key] = _compilers.submit(_load, gpu, program)
        return found


def _load(gpu: CudaDevice, program: Program) -> Any:
    try:
        code = kept(program, gpu.arch)
        with gpu.current():
            return call("cuModuleGetFunction", call("cuModuleLoadData", code), program.unit.encode())
    except Exception:
        with _lock:
            _loaded.pop((gpu.number, program), None)  # a later call may succeed
        raise


def launch(kernel: Future[Any], job: Any, stream: Stream, x: int, y: int = 1, z: int = 1) -> None:
    """Launch a kernel of `prepare` on a stream of the current device, with one argument: a `record`, which is copied.

    ``x`` is the number of threads with work, in blocks of `THREADS`; ``y`` and ``z`` are numbers of rows and layers of
    blocks.
    """
    arguments = ctypes.addressof(job)  # the driver takes an array of pointers to arguments
    blocks = max(1, -(-x // THREADS))
    call("cuLaunchKernel", kernel.result(), blocks, y, z, THREADS, 1, 1, 0, stream.handle, arguments, 0)
