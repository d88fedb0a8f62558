"""CTs without the table, and greys of a range that metal and what lies outside of a scan do not set."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple.cli import command
from supple.errors import VolumeWarning
from supple.files.jobs import Job
from supple.files.renders import RenderOptions, render_file
from supple.render.appearance import levelled, without_table
from supple.render.scene import Scene
from supple.render.transfer import PRESETS
from tests.render.test_files import stored


def patient(*, legs: bool = False, table: bool = True) -> npt.NDArray[np.int16]:
    """A body, or two legs, on a thin table, in noisy air; HU."""
    z, y, x = np.mgrid[:30, :40, :50]
    made = np.random.default_rng(0).normal(-1000, 20, z.shape)
    for middle in (14, 36) if legs else (25,):
        made[(y - 18) ** 2 + ((x - middle) / (1 if legs else 2)) ** 2 < 81] = 40
    if table:
        made[:, 31, 8:42] = 0
    return made.astype(np.int16)


@pytest.mark.parametrize("legs", [False, True])
def test_a_table_is_left_out_and_legs_are_not(legs: bool) -> None:
    given = patient(legs=legs)
    kept, apart = without_table(given, (10, 10, 10))
    body, table = given == 40, np.zeros(given.shape, np.bool_)
    table[:, 31, 8:42] = True
    np.testing.assert_array_equal(kept[body], given[body])
    assert (kept[table] == -1000).all()
    np.testing.assert_array_equal(kept[~table], given[~table])
    assert apart == pytest.approx(table.sum() / (table | body).sum())
    assert kept.dtype == given.dtype


def test_without_a_table_nothing_is_said_or_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = patient(table=False)
    kept, apart = without_table(given, (10, 10, 10))
    assert apart == 0
    np.testing.assert_array_equal(kept, given)
    assert without_table(np.full((3, 3, 3), -1000, np.int16), (1, 1, 1))[1] == 0
    monkeypatch.chdir(tmp_path)
    stored("ct.nii", given)
    with warnings.catch_warnings(action="error"):
        render_file(Job("ct.nii", "a.png"), options=RenderOptions(transfer="ct-skin", size=(40, 40)))


def test_the_presets_of_ct_leave_it_out_unless_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    stored("ct.nii", patient())
    small = (40, 40)
    with pytest.warns(
        VolumeWarning, match=r"% of what is as dense as skin in ct.nii is thin and lies beside the body.*: table"
    ):
        bare = render_file(Job("ct.nii", "a.png"), options=RenderOptions(transfer="ct-skin", size=small))
    with warnings.catch_warnings(action="error"):
        for k, options in enumerate(({"table": True}, {"largest": True}, {"transfer": "grey"})):
            look = RenderOptions(**{"transfer": "ct-skin", **options}, size=small)
            scene = render_file(Job("ct.nii", f"{k}.png"), look)
            assert (scene.samples[:, 31, 10:40] > -450).all() == (not options.get("largest", False))
    assert (bare.samples[:, 31, 10:40] == -1000).all()
    assert command(["render", "ct.nii", "b.png", "--size", "40x40", "--transfer", "ct-skin"]) == 0
    assert "is left out: --table shows it" in " ".join(capsys.readouterr().err.split())
    assert command(["render", "ct.nii", "c.png", "--size", "40x40", "--transfer", "ct-skin", "--table"]) == 0
    assert "left out" not in capsys.readouterr().err


@pytest.mark.parametrize("beyond", [-1000, -3024])
def test_the_grey_of_tissue_does_not_depend_on_metal_or_on_what_is_outside(beyond: int) -> None:
    given = patient(table=False).astype(np.float32)
    given[:, 17:20, 24:26] = 1200
    plain = given.copy()
    given[15, 18, 20:24] = 3071  # a screw
    given[:, :3, :3] = beyond
    one, other = (Scene(each, transfer="grey") for each in (plain, given))
    tissue, air = (scene.transfer.table(40, 41, 1.0)[0] for scene in (one, other)), other.transfer.table(-1000, -940, 1)
    first, second = tissue
    np.testing.assert_allclose(first, second, rtol=0.02)
    assert first[0] > 0.15  # linear light: a third of the way as sRGB sees it
    assert not air[..., 3].any()


def test_other_transfer_functions_are_as_they_were() -> None:
    samples = patient()
    ends = float(samples.min()), float(samples.max())
    for name, transfer in PRESETS.items():
        assert (levelled(transfer, samples, ends) is transfer) == (name != "grey")
    flat = levelled(PRESETS["grey"], np.zeros((3, 3, 3), np.uint8), (0.0, 0.0))
    assert flat.points[0][0] == pytest.approx(0.06)


def test_no_part_of_a_patient_is_left_out() -> None:
    given = patient(table=False)
    given[10:20, 5:30, 2:5] = 60  # an arm beside the body, 3 cm thick
    given[15, 18, 20:30] = -1000
    given[14:17, 16:21, 22:29] = -1000  # a hollow,
    given[15, 18, 25] = 60  # and in it what touches nothing
    kept, apart = without_table(given, (10, 10, 10))
    assert apart == 0
    np.testing.assert_array_equal(kept, given)


@pytest.mark.parametrize("kind", ["u1", "i1", "u2"])
def test_a_preset_of_ct_for_other_values_draws(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    stored("mr.nii", np.random.default_rng(0).integers(0, 90, (9, 9, 9)).astype(kind))
    assert command(["render", "mr.nii", "a.png", "--size", "40x40", "--transfer", "ct-skin"]) == 0
