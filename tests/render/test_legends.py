"""Legends of labels: names and colours at the upper left of a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.cli import command
from supple.media import image
from supple.render.labels import LabelColours
from tests.render.test_files import stored

annotate = pytest.importorskip("supple.render.annotate", reason="the extra plot is not installed")

TABLE = "# label name red green blue opacity\n1 left half 255 0 0 255\n4 tumour 0 255 0 255\n9 unseen 0 0 255 0\n"


@pytest.fixture
def here(here: Path) -> Path:
    labels = np.zeros((12, 12, 12), np.uint8)
    labels[3:9, 3:9, 3:6], labels[3:9, 3:9, 6:9], labels[0, 0, 0] = 1, 4, 9
    stored("labels.nii.gz", labels)
    (here / "own.ctbl").write_text(TABLE, encoding="utf-8")
    return here


def test_names_are_those_of_the_file() -> None:
    slicer = LabelColours.from_text(TABLE)
    assert annotate.entries_of(slicer, [1, 4, 9]) == [("left half", (1.0, 0.0, 0.0)), ("tumour", (0.0, 1.0, 0.0))]
    assert "1 left_half 255 0 0 255" in slicer.to_ctbl([1])
    snap = LabelColours.from_text('2 10 20 30 1 1 1 "the brain"')
    assert snap.name(2) == "the brain"
    assert snap.name(3) == "label-3"
    header = {"Segment0_LabelValue": "5", "Segment0_Name": "liver", "Segment0_Color": "1 0 0"}
    assert LabelColours.of_segments(header, [5, 6]).name(5) == "liver"


def test_a_legend_lists_what_is_seen(here: Path) -> None:
    shared = ["render", "labels.nii.gz"]
    usual = ["--transfer", "own.ctbl", "--size", "200x200", "--background", "#000000"]
    assert command([*shared, "a.png", *usual]) == 0
    assert command([*shared, "b.png", *usual, "--legend"]) == 0
    plain, listed = (image.read(f"{name}.png").pixels[..., :3].astype(int) for name in "ab")
    changed = np.abs(plain - listed).max(axis=-1) > 0
    ys, xs = np.nonzero(changed)
    assert 0 < len(ys) < 0.2 * changed.size
    assert ys.max() < 60
    assert xs.min() < 12
    assert (listed[changed] == (255, 0, 0)).all(axis=-1).sum() > 20
    assert (listed[changed] == (0, 255, 0)).all(axis=-1).sum() > 20
    assert not (listed[changed] == (0, 0, 255)).all(axis=-1).any()


def test_a_long_legend_says_how_many_more_there_are() -> None:
    from supple.render.scene import Scene

    scene = Scene(np.ones((4, 4, 4), np.uint8))
    view, empty = scene.view(None, (96, 96)), np.zeros((96, 96, 4), np.uint8)
    many = [(f"label-{k}", (1.0, 0.0, 0.0)) for k in range(100)]
    made = annotate.annotated(empty, view, scene.geometry, legend=many, marks=False)
    rows = np.flatnonzero((made[..., :3] == (255, 0, 0)).all(axis=-1).any(axis=1))
    assert len(rows) > 0
    assert rows.max() < 90  # the last line is words alone
    assert not annotate.annotated(empty, view, scene.geometry, marks=False).any()


def test_values_have_none(here: Path, capsys: Any) -> None:
    stored("values.nii.gz", np.random.default_rng(0).integers(0, 255, (9, 9, 9)).astype(np.int16))
    assert command(["render", "values.nii.gz", "c.png", "--legend", "--size", "100x100"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "--legend lists the labels of a segmentation, and values.nii.gz is rendered by its values" in told
    assert not (here / "c.png").exists()
