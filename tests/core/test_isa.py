"""The core's modules, one for each instruction set: which is chosen, and that they agree."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from supple import _core
from supple._core.cpu import isas
from supple._core.loading import load
from supple.errors import SuppleError
from tests.children import ROOT

BUILT = [name for name in isas() if any(Path(_core.__path__[0]).glob(f"{name}.*"))]

# Points, a plan and what is sampled by it, of an image and of frames; in float64, to be compared.
PROGRAM = """
import sys
import numpy as np
from supple import Deformation, _core
from supple._core.rows import numbers
rng = np.random.default_rng(1)
made = {"isa": np.array(_core.isa)}
for shape in ((70, 90), (6, 40, 50)):
    n = len(shape)
    d = Deformation(shape, border=12.0)
    d = d.grab((30, 20, 3)[:n], by=(6, -4, 1)[:n], radius=12)
    d = d.grab((40, 35, 2)[:n], by=(3, 2, -1)[:n], radius=6, reach=3)
    rows, q = numbers(d.space.table), np.zeros((501, 3))
    q[:, :n] = rng.uniform(-5, 60, (501, n))
    made[f"moved {n}"], made[f"slopes {n}"] = _core.forward(rows, d.space.axes, q, True)
    made[f"points {n}"], made[f"residual {n}"], _ = _core.inverse(d.space.map, q, 1e-9)
    made[f"map {n}"] = d.inverse_map(tolerance=1e-3).astype(np.float64)
    for dtype in ("u1", "f4", "f8"):
        for channels in (1, 3, 4):
            source = rng.integers(0, 256, (*shape, channels))
            source = source.astype(dtype) if dtype == "u1" else (source / 255).astype(dtype)
            for name in ("nearest", "linear", "cubic", "auto"):
                made[f"{dtype} {channels} {name} {n}"] = d.warp(source, filter=name, alpha=False).astype(np.float64)
            lit = d.warp(source, linear_light=True, alpha=False)
            made[f"{dtype} {channels} light {n}"] = lit.astype(np.float64)
np.savez(sys.argv[1], **made)
"""
several = pytest.mark.skipif(len(BUILT) == 1, reason="the core was compiled for one instruction set alone")


def with_isa(isa: str, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    source = str(Path(_core.__path__[0]).parent.parent)
    environment = {**os.environ, "SUPPLE_ISA": isa, "PYTHONPATH": source}
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)


def test_there_is_a_module() -> None:
    assert BUILT
    assert _core.isa in BUILT


@several
def test_all_give_the_same_within_rounding(tmp_path: Path) -> None:
    made = {}
    for isa in BUILT:
        result = with_isa(isa, PROGRAM, str(tmp_path / f"{isa}.npz"))
        assert result.returncode == 0, result.stderr
        made[isa] = dict(np.load(tmp_path / f"{isa}.npz"))
        assert made[isa].pop("isa") == isa
    first = made[BUILT[0]]
    for isa in BUILT[1:]:
        for name, values in made[isa].items():
            off = np.abs(values - first[name])
            if name.startswith(("moved", "slopes", "residual")):
                assert off.max() <= 1e-11, name
            elif name.startswith("points"):
                assert off.max() <= 1e-8, name
            elif name.startswith("map"):
                assert off.max() <= 2e-5, name
            elif "nearest" in name:
                assert (off > 0).mean() < 1e-3, name
            elif name.startswith("u1"):
                assert off.max() <= 1, name
                assert (off > 0).mean() < 0.01, name
            else:  # as far as points are apart, times the slope of noise
                assert off.max() <= 0.02, name
                assert off.mean() <= 1e-4, name


@pytest.mark.parametrize("isa", ["", "v9", "avx2", "V3", "v3 ", "cpu", "../v3"])
def test_a_wrong_name_gets_a_sentence(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_ISA", isa)
    if not isa:
        assert load().__name__.endswith(BUILT[0])
        return
    with pytest.raises(SuppleError) as caught:
        load()
    assert str(caught.value) == f'SUPPLE_ISA="{isa}" cannot be had here; what can: {", ".join(BUILT)}.'


@several
def test_several_live_in_one_process() -> None:
    program = """
import importlib, sys
import numpy as np
names = sys.argv[1:]
modules = [importlib.import_module(f"supple._core.{name}") for name in names]
rows, axes = np.zeros((0, 39)), np.array([[0, 40.0, -1, 1, 0], [0, 30.0, -1, 1, 0], [0, 0.0, 0, 1, 0]])
plans = [m.Plan(m.Map(rows, axes, 2), 31, 41, 0.0, 0.01) for m in modules]
assert len({type(p) for p in plans}) == len(names)
for m, p in zip(modules, plans):
    out = np.empty((31, 41, 2))
    p.points(out)
    assert (out[30, 40] == (40, 30)).all()
    for other in modules:
        if other is m:
            continue
        try:
            other.Plan.points(p, out)
        except TypeError:
            continue
        raise AssertionError("one module took an object of another")
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(_core.__path__[0]).parent.parent)}
    command = [sys.executable, "-c", program, *BUILT]
    result = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert (result.returncode, result.stderr) == (0, "")


def test_a_core_that_is_not_compiled_says_what_to_do() -> None:
    program = """
import sys
sys.modules["supple._core.cpu"] = None
try:
    import supple._core
except ValueError as error:
    print(error)
"""
    result = with_isa("", program)
    assert result.stdout.startswith("Supple's native core is not compiled: run `make core`"), result.stderr


def test_threads_are_asked_for_at_each_call(monkeypatch: pytest.MonkeyPatch) -> None:
    everywhere = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    for asked, n in (("3", 3), ("17", 17), ("0", everywhere), ("-2", everywhere), ("2x", everywhere), ("", everywhere)):
        monkeypatch.setenv("SUPPLE_THREADS", asked)
        assert _core.threads() == n


def test_every_name_has_a_type() -> None:
    stub = ast.parse((ROOT / "src" / "supple" / "_core" / "__init__.pyi").read_text("utf-8"))
    typed = {node.name for node in stub.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    typed |= {
        node.target.id for node in stub.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    # submodules of the package aside
    assert typed == {name for name in vars(_core) if not name.startswith("_")} - {"loading", "cpu", "rows", *isas()}
