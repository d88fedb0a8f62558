"""Every kernel of the CUDA engine compiles for a GPU, without one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

if os.environ.get("SUPPLE_TEST_CUDA_COMPILER") != "1":
    pytest.importorskip("numba_cuda")
    pytest.importorskip("cuda.bindings")

from numba import types
from numba.np.numpy_support import from_dtype

from supple.engines.base import OUTSIDE
from supple.engines.cuda import field, fill, lattice, newton, reach
from supple.engines.cuda.colour import BETWEEN, FILTERS, colour
from supple.engines.cuda.sample import Way

CAPABILITY = (8, 0)  # of GPUs that CUDA 12 and 13 both know


def flat(kind: Any) -> Any:
    return types.Array(kind, 1, "C")


F4, F8, I4, I8, U1 = (flat(t) for t in (types.float32, types.float64, types.int32, types.int64, types.uint8))
N, X = types.int64, types.float64

KERNELS = {
    "forward": (field.forward, (F8, I4, N, F8, F8, F8)),
    "forward of float32": (field.forward, (F8, I4, N, F4, F8, F8)),
    "inverse": (newton.inverse, (F8, I4, N, F8, X, F8, F8, I8, U1)),
    "inverse of float32": (newton.inverse, (F8, I4, N, F4, X, F8, F8, I8, U1)),
    "solve": (lattice.solve, (F8, I4, N, I4, I4, N, N, N, F4, F4, I4)),
    "twist": (lattice.twist, (I4, I4, N, F4)),
    "check": (lattice.check, (F8, I4, N, I4, I4, N, N, X, F4, F4, F4, I4)),
    "bound": (reach.bound, (I4, I4, N, N, F4, F4)),
}


@pytest.fixture(autouse=True)
def _no_card_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of kernels are compiled for the GPU at hand: there is none."""
    from numba.cuda import dispatcher

    class Device:
        compute_capability = CAPABILITY

    monkeypatch.setattr(dispatcher, "get_current_device", lambda: Device)


def compiled(kernel: Any, signature: tuple[Any, ...]) -> str:
    from numba import cuda

    code, returned = cuda.compile_ptx(kernel.py_func, signature, cc=CAPABILITY)
    assert returned == types.none
    assert ".entry" in code
    return str(code)


@pytest.mark.parametrize("name", KERNELS)
def test_kernels_of_points_and_nodes(name: str) -> None:
    compiled(*KERNELS[name])


def ways() -> Iterator[tuple[str, Way, Any]]:
    """Each filter, each way between frames and each rule; and each type of samples."""
    for name in FILTERS:
        for between in BETWEEN:
            if name == "nearest" and between in ("linear", "cubic"):
                continue
            if name in ("map", "offsets") and between != "nothing":
                continue
            averages = (False, True) if between in ("linear", "cubic") and name != "nearest" else (False,)
            for average in averages:
                yield f"{name}-{between}-{average}", Way(FILTERS[name], BETWEEN[between], average=average), "f4"
    for rule, number in OUTSIDE.items():
        yield f"linear-{rule}", Way(FILTERS["linear"], BETWEEN["linear"], number), "f4"
        yield f"nearest-{rule}", Way(FILTERS["nearest"], BETWEEN["nearest"], number), "u1"
    mixed = Way(FILTERS["auto"], BETWEEN["cubic"], 2, True, whole=True, alpha=True, light=True)
    yield "all of it", mixed, "u1"
    yield "within reach", Way(FILTERS["auto"], BETWEEN["linear"], limited=True), "f4"
    yield "a map within reach", Way(FILTERS["map"], BETWEEN["nothing"], limited=True), "f4"
    yield "in a ring", Way(FILTERS["cubic"], BETWEEN["linear"], ring=True), "f4"
    yield "a large one", Way(FILTERS["linear"], BETWEEN["linear"], index=np.int64), "f4"
    for kind in ("f2", "f4", "f8", "u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8"):
        number = np.float64 if kind[1] in "48" and kind != "f4" else np.float32
        whole = kind[0] != "f"
        yield f"linear of {kind}", Way(FILTERS["linear"], BETWEEN["nothing"], number=number, whole=whole), kind
        yield f"nearest of {kind}", Way(FILTERS["nearest"], BETWEEN["nothing"], number=number, whole=whole), kind


WAYS = {name: (way, kind) for name, way, kind in ways()}
# How pixels are solved is compiled once for each filter, and for each way that solves otherwise: good and rough cells
# call one function for colours, compiled once, so that those of all other ways are compiled with their good cells.
SOLVED = {f"{name}-nothing-False" for name in FILTERS}
SOLVED |= {"auto-cubic-True", "all of it", "within reach", "a map within reach", "in a ring", "a large one"}


@pytest.mark.parametrize("name", WAYS)
def test_kernels_of_pixels(name: str) -> None:
    way, kind = WAYS[name]
    index = types.int64 if way.index is np.int64 else types.int32
    number = types.float64 if way.number is np.float64 else types.float32
    samples = flat(from_dtype(np.dtype(kind)))
    target = F4 if way.filter in (FILTERS["map"], FILTERS["offsets"]) else samples
    fills = samples if way.filter == FILTERS["nearest"] else flat(number)
    planes, source = types.UniTuple(N, len(fill.PLANES)), types.UniTuple(index, 13)
    how, limits, places = types.UniTuple(index, 3), types.UniTuple(number, 3), types.UniTuple(index, len(fill.TARGET))
    common = (samples, fills, source, how, limits, target, places)
    good, rough = fill.kernels(way)
    code = compiled(good, (F8, I4, I4, I4, I4, F4, F4, planes, *common, I4))
    if name in (
        "linear-linear-False",
        "auto-nothing-False",
    ):  # what most pixels take keeps clear of slow memory and of float64
        assert ".local" not in code
        assert code.count("fma.rn.f64") == 0
    if name in SOLVED:
        compiled(rough, (F8, I4, I4, I4, F4, planes, X, *common, F4, I4))
        assert len(colour(way).overloads) == 1


def test_nothing_of_cuda_is_imported_without_need() -> None:
    code = (
        "import sys, numpy as np, supple; d = supple.Deformation((9, 9)).grab((4, 4), by=(1, 0), radius=4);"
        "d.warp(np.zeros((9, 9))); d.forward((1, 2)); import supple.cuda;"
        "sys.exit(any(m.split('.')[0] in ('numba_cuda', 'cuda') or m.startswith('numba.cuda') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
