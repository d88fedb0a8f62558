"""The core's modules, one for each instruction set: which is chosen, and that they agree."""

from __future__ import annotations

import ast
import json
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

BUILT = [name for name in isas() if any(Path(_core.__path__[0]).glob(f"{name}.*"))]

PROGRAM = """
import json
from supple import _core
p = _core.Polynomial([0.1, -1.3, 0.7, 2.9, -3.3])
print(json.dumps([_core.isa, [p.at(i / 7) for i in range(-20, 20)]]))
"""


def with_isa(isa: str, program: str = PROGRAM) -> subprocess.CompletedProcess[str]:
    source = str(Path(_core.__path__[0]).parent.parent)
    environment = {**os.environ, "SUPPLE_ISA": isa, "PYTHONPATH": source}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)


def test_there_is_a_module() -> None:
    assert BUILT
    assert _core.isa in BUILT


@pytest.mark.parametrize("isa", BUILT)
def test_each_gives_the_same_within_rounding(isa: str) -> None:
    result = with_isa(isa)
    assert result.returncode == 0, result.stderr
    name, values = json.loads(result.stdout)
    assert name == isa
    x = np.arange(-20, 20) / 7
    truth = np.polynomial.polynomial.polyval(x, [0.1, -1.3, 0.7, 2.9, -3.3])
    np.testing.assert_allclose(values, truth, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("isa", ["", "v9", "avx2", "V3", "v3 ", "cpu", "../v3"])
def test_a_wrong_name_gets_a_sentence(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_ISA", isa)
    if not isa:
        assert load().__name__.endswith(BUILT[0])
        return
    with pytest.raises(SuppleError) as caught:
        load()
    assert str(caught.value) == f'SUPPLE_ISA="{isa}" cannot be had here; what can: {", ".join(BUILT)}.'


def test_several_live_in_one_process() -> None:
    program = """
import importlib, sys
names = sys.argv[1:]
modules = [importlib.import_module(f"supple._core.{name}") for name in names]
types = [m.Polynomial for m in modules]
assert len(set(types)) == len(names), types
for k, t in enumerate(types):
    assert t([k, 1.0]).at(0.5) == k + 0.5
    try:
        types[k - 1].at(t([1.0]), 2.0)
    except TypeError:
        continue
    assert len(types) == 1, "one module took an object of another"
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
    stub = ast.parse((Path(__file__).parents[2] / "src" / "supple" / "_core" / "__init__.pyi").read_text("utf-8"))
    typed = {node.name for node in stub.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    typed |= {
        node.target.id for node in stub.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    # submodules of the package aside
    assert typed == {name for name in vars(_core) if not name.startswith("_")} - {"loading", "cpu", *isas()}
