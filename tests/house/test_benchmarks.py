"""The benchmarks' pairs, medians and table, by a clock of their own."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.children import ROOT
from tests.effort import soak
from tools.core import machine_compiler

FOLDER = ROOT / "benchmarks"


@pytest.fixture
def measure(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("measure")


class Played:
    """A clock, and work that takes what it says it takes."""

    def __init__(self) -> None:
        self.now, self.calls = 0.0, ""

    def __call__(self, work: object) -> float:
        before = self.now
        work()  # type: ignore[operator]
        return self.now - before

    def work(self, name: str, *seconds: float) -> object:
        left = list(seconds)

        def done() -> None:
            self.calls += name
            self.now += left.pop(0) if len(left) > 1 else left[0]

        return done


def test_pairs_alternate_after_calls_that_do_not_count(measure: ModuleType) -> None:
    clock = Played()
    # What compiles takes a minute, and is not seen; the machine then slows down, and the ratio is what it was.
    ours = clock.work("o", 60.0, 1.0, 1.0, *(0.001 * k for k in range(1, 16)))
    peer = clock.work("p", 60.0, 1.0, 1.0, *(0.002 * k for k in range(1, 16)))
    line = measure.against("a row", ours, peer, clock, 15, 0.5)
    assert clock.calls == "op" * 3 + ("poop" * 8)[:30]
    assert line.ours.median == pytest.approx(0.008)
    assert (line.ours.low, line.ours.high) == (pytest.approx(0.002), pytest.approx(0.014))
    assert (line.value.median, line.value.runs) == (pytest.approx(0.5), 15)
    assert line.ours.longest == pytest.approx(0.015)


@pytest.mark.parametrize(("bar", "word"), [(3.0, "≤ 3 | holds"), (1.9, "≤ 1.9 | **missed**"), (None, " | ")])
def test_a_line_says_whether_its_bar_is_met(measure: ModuleType, bar: float | None, word: str) -> None:
    clock = Played()
    line = measure.took("a row", clock.work("o", 0.002), clock, 5, bar, "and why")
    assert str(line) == f"| a row | 2.00 (2.00–2.00) ms |  |  | {word} | 5 | and why |"
    assert measure.missed([line]) == ("missed" in word)
    assert json.loads(json.dumps(line.told()))["holds"] == (None if bar is None else bar == 3)


def test_cells_of_a_peer_agree(measure: ModuleType) -> None:
    clock = Played()
    # Ours is slower in turn than alone; the medians of a machine that slows down do not divide to the median ratio.
    ours = clock.work("o", 1.0, 1.0, 0.001, 0.002, 0.0025)
    peer = clock.work("p", 1.0, 1.0, 0.2, 0.3, 0.4)
    assert measure.in_turn(peer, ours, clock, 3) == "300 ms | 1.88 ms | 160"
    assert measure.seconds(1.234) == "1.23 s"


@soak("the benchmark of CUDA, without a GPU")
@pytest.mark.skipif(machine_compiler() is None, reason="there is no C++ compiler")
def test_cuda_s_benchmark_runs_without_a_gpu(tmp_path: Path) -> None:
    written = tmp_path / "lines.json"
    words = [sys.executable, str(FOLDER / "cuda_engine.py"), "--dry", "--json", str(written)]
    around = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(words, env=around, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    lines = json.loads(written.read_text(encoding="utf-8"))["lines"]
    assert {tuple(line["bar"].values()) for line in lines} >= {(3,), (0.5,), (0.3,), (5000,), (1,), (5,)}
