"""A simulated GPU: the kernels are compiled for the host."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import importlib
import json
import os
import shlex
import subprocess
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.cuda import arrays, device, programs, warp
from supple.cuda.device import CudaDevice
from supple.cuda.programs import JOB, SOME, UNITS, Program
from tests.cuda.driver import REAL, Driver
from tools.core import machine_compiler

fcntl: Any = None
with contextlib.suppress(ImportError):  # Windows has none
    fcntl = importlib.import_module("fcntl")

ROOT = Path(__file__).parents[2]
KERNELS = Path(programs.__file__).parent / "kernels"
CORE = ROOT / "src" / "supple" / "_core"


def compiled() -> Path:
    """The kernels as a library of this machine, made anew when their sources have changed.

    SUPPLE_TEST_KERNELS has the compiler's options: with sanitizers, in `make sanitize`. Better ones would take longer
    than they save.
    """
    options = shlex.split(os.environ.get("SUPPLE_TEST_KERNELS", "-O0"))
    compiler = machine_compiler()
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    sources = [Path(__file__).with_name("host.cpp"), *sorted(KERNELS.glob("*")), *sorted(CORE.glob("*.hpp"))]
    defined = [f"-DJOB_BYTES={JOB.itemsize}", f"-DSOME_BYTES={SOME.itemsize}"]
    command = [*compiler.command, "-std=c++20", "-fPIC", "-shared", "-Wno-psabi", *options, *defined]
    command += [f"-I{CORE}", f"-I{KERNELS}", str(sources[0])]
    content = b"".join(path.read_bytes() for path in sources) + " ".join(command).encode()
    target = ROOT / "build" / f"kernels-{hashlib.sha256(content).hexdigest()[:16]}.so"
    target.parent.mkdir(exist_ok=True)
    with open(target.with_suffix(".lock"), "w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)  # one worker makes it for all
        if not target.exists():
            made = target.with_suffix(f".{os.getpid()}")
            alone = {k: v for k, v in os.environ.items() if k != "LD_PRELOAD"}  # of sanitizers
            subprocess.run([*command, "-o", str(made)], check=True, env=alone)
            made.replace(target)
    return target


def coded(program: Program, arch: int) -> bytes:
    """What stands for the machine code of a program."""
    fields = {name: getattr(program, name) for name in ("unit", "dimensions", "sample", "together", "filter")}
    return json.dumps(fields | {"number": UNITS.index(program.unit)}).encode()


class View:
    """An array of the simulated GPU, as cuda.core describes arrays."""

    device_id, is_device_accessible = 0, True

    def __init__(self, value: Any) -> None:
        about = value.__cuda_array_interface__
        self.ptr, self.readonly = about["data"]
        self.shape, self.dtype = about["shape"], np.dtype(about["typestr"])
        strides = about["strides"]
        self.strides = None if strides is None else tuple(s // self.dtype.itemsize for s in strides)


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Print a failure of a real GPU at once: machines that have one may be gone before the end."""
    if REAL and report.failed:
        print(f"\n{report.nodeid}\n{report.longreprtext}", flush=True)


@pytest.fixture(scope="session")
def library() -> Path | None:
    return None if REAL else compiled()


@pytest.fixture
def gpu(library: Path | None, monkeypatch: pytest.MonkeyPatch) -> Iterator[CudaDevice]:
    """A real GPU, where there must be one; or a simulated one, where nothing is left over in the end."""
    if library is None:
        yield device.open_device()
        return
    made = Driver(library)
    monkeypatch.setattr(device, "driver", lambda: made)
    monkeypatch.setattr(device, "_opened", {})
    monkeypatch.setattr(programs, "kept", coded)
    monkeypatch.setattr(programs, "_loaded", {})
    monkeypatch.setattr(arrays, "_viewed", lambda value, kind, gpu: View(value))
    monkeypatch.setattr(warp, "_lattices", OrderedDict())
    monkeypatch.setattr(warp, "_spare", spare := [])
    yield device.open_device()
    warp._lattices.clear()
    device._kept.clear()
    gc.collect()
    spare.clear()
    assert (made.memory, made.pinned, made.events, made.streams) == ({}, {}, {}, {0})


@pytest.fixture
def played(gpu: CudaDevice) -> Driver:
    if REAL:
        pytest.skip("a real driver records nothing")
    return device.driver()
