"""The comparison with other tools: its measures, on known maps, and its run where no other tool is installed."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest

from tests.children import ROOT

FOLDER = ROOT / "benchmarks"
ALONE = """
import sys
sys.path.insert(0, sys.argv[1])
for name in ("cv2", "skimage", "skimage.transform", "SimpleITK"):
    sys.modules[name] = None
sys.argv = ["beside.py", "--quick"]
import beside
sys.exit(beside.main())
"""


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv("SUPPLE_THREADS", os.environ.get("SUPPLE_THREADS", "2"))
    return importlib.import_module("beside")


def bump(beside: ModuleType, by: tuple[float, float]) -> npt.NDArray[np.float64]:
    """A map that shows at (40, 30) what is at (40, 30) - by, and moves less and less around it."""
    q = beside.grid_of((64, 80))
    weight = np.exp(-((q - (40.0, 30.0)) ** 2).sum(axis=-1) / 200)
    return np.asarray(q - weight[..., None] * by)


def test_where_a_point_arrives(beside: ModuleType) -> None:
    stroke = beside.Stroke((36.0, 33.0), (40.0, 30.0), 10.0)
    assert beside.arrival(bump(beside, (4.0, -3.0)), stroke) == pytest.approx([40, 30], abs=1e-6)
    short = beside.arrival(bump(beside, (2.0, -1.5)), stroke)
    assert 1.5 < np.linalg.norm(short - (40, 30)) < 3


def test_folds_are_counted(beside: ModuleType) -> None:
    assert beside.folded(beside.grid_of((20, 30))) == 0
    # The slope of the bump's displacement is at most 1.21 / 20 of its height: from 16.5 pixels on, it folds.
    assert beside.folded(bump(beside, (16.0, 0.0))) == 0
    assert beside.folded(bump(beside, (17.5, 0.0))) > 0
    mirrored = beside.grid_of((20, 30))[:, ::-1]
    assert beside.folded(mirrored) == 19 * 29


def test_the_times_of_the_page_divide_to_its_ratios() -> None:
    text = (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|"]
    headings = [row for row in lines if row[-1] == "× ours"]
    assert [row[-3:] for row in headings] == [["time", "ours, in turn", "× ours"]] * 5
    rows = [row[-3:] for row in lines if row[-1].replace(".", "").isdigit()]
    assert len(rows) == 21
    for theirs, ours, ratio in rows:
        quotient = float(theirs.removesuffix(" ms")) / float(ours.removesuffix(" ms"))
        assert quotient == pytest.approx(float(ratio), rel=0.011)  # of three digits each


def test_it_runs_where_no_other_tool_is_installed() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PATH": ""}
    done = subprocess.run(
        [sys.executable, "-c", ALONE, str(FOLDER)], env=environment, capture_output=True, encoding="utf-8", cwd=ROOT
    )
    assert (done.returncode, done.stderr) == (0, "")
    for line, rows in (("gegl is not installed", 6), ("ImageMagick is", 3), ("scikit-image is", 3), ("OpenCV is", 3)):
        assert done.stdout.count(line) == rows, line
    assert "| SimpleITK | is not installed |" in done.stdout
    assert done.stdout.count("| Supple | 0.00 px | 0 |") == 2
    for table in done.stdout.split("\n## ")[1:]:
        assert len({line.count("|") for line in table.splitlines() if line[:1] == "|"}) == 1, table
