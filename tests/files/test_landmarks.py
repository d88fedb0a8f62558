"""Landmarks: points that travel with what they mark, from file to file."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple import Deformation
from supple.errors import SuppleError, VolumeWarning
from supple.files.landmarks import move_points, read_landmarks
from supple.media.points import check_target, read_points, write_points
from supple.space.geometry import Geometry
from tests.media.landmarks import Floats, fcsv, markup, markups, read
from tests.refusals import refused

SHAPE = (24, 30, 28)
SPACING = (0.9, 1.1, 1.4)


def tilted() -> Geometry:
    a, b = 0.4, -0.3
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    lean = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return Geometry(SPACING, (-71.25, 33.5, 812.125), turn @ lean * (1, -1, 1), "RAS")


def bent(border: float | None = 5.0) -> Deformation:
    made = Deformation(SHAPE, spacing=SPACING, border=border)
    return made.grab((13, 15, 11), to=(17, 13, 13), radius=9).grab((9, 20, 12), by=(-2, 1, -2), radius=7)


def written(kind: str, points: Floats, system: str) -> str:
    if kind == "fcsv":
        return fcsv(points, system)
    if kind == "mrk.json":
        return markups(markup(points, system))
    head = ",".join(("label", *system.lower()))
    return f"{head}\n" + "".join(f"F-{k},{x!r},{y!r},{z!r}\n" for k, (x, y, z) in enumerate(points.tolist()))


@pytest.mark.filterwarnings("ignore::supple.OutsideWarning")
class TestPointsTravel:
    @pytest.mark.parametrize("system", ["LPS", "RAS"])
    @pytest.mark.parametrize("kind", ["csv", "fcsv", "mrk.json"])
    @pytest.mark.parametrize("inverse", [False, True])
    def test_with_a_blob_in_the_volume(self, tmp_path: Path, kind: str, system: str, inverse: bool) -> None:
        geometry, deformation = tilted(), bent()
        seen = np.array([13.0, 15.0, 11.0])
        z, y, x = np.indices(SHAPE)
        source = deformation.inverse(seen).points if inverse else seen
        blob = np.exp(-(((x - source[0]) ** 2 + (y - source[1]) ** 2 + (z - source[2]) ** 2) / 2 / 1.3**2))
        shown = deformation.warp(blob, filter="cubic", tolerance=1e-3)
        centres = [[(axis * v).sum() / v.sum() for axis in (x, y, z)] for v in (blob, shown)]
        start, end = centres[::-1] if inverse else centres
        before = geometry.to_world(start, system)
        (tmp_path / f"in.{kind}").write_text(written(kind, before[None], system))
        moved = move_points(tmp_path / f"in.{kind}", tmp_path / f"out.{kind}", deformation, geometry, inverse=inverse)
        found = read_points(tmp_path / f"out.{kind}")
        assert found.convention == system
        after = geometry.to_world(end, system)
        assert np.linalg.norm(after - before) > 2.5
        assert np.linalg.norm(found.points[0] - after) < 0.5
        assert moved.displaced[0] == pytest.approx(np.linalg.norm(found.points[0] - before), abs=1e-9)

    @pytest.mark.parametrize("kind", ["csv", "fcsv", "mrk.json"])
    def test_there_and_back(self, tmp_path: Path, kind: str) -> None:
        geometry, deformation = tilted(), bent()
        points = geometry.to_world(np.random.default_rng(0).uniform(-3, 31, (50, 3)), "LPS")
        names = [tmp_path / f"{k}.{kind}" for k in range(3)]
        names[0].write_text(written(kind, points, "LPS"))
        there = move_points(names[0], names[1], deformation, geometry)
        back = move_points(names[1], names[2], deformation, geometry, inverse=True)
        np.testing.assert_allclose(read_points(names[2]).points, points, rtol=0, atol=1e-6)
        middle = read_points(names[1]).points
        np.testing.assert_allclose(there.displaced, np.linalg.norm(middle - points, axis=1), atol=1e-9)
        assert there.displaced.max() > 2
        assert (there.count, there.unconverged, back.unconverged) == (50, 0, 0)
        assert max(there.error.max(), back.error.max()) < 1e-8
        index = geometry.from_world(points, "LPS")
        outside = ((index < -0.5) | (index > np.array(SHAPE[::-1]) - 0.5)).any(axis=1)
        assert there.outside == outside.sum() > 0

    def test_outside_is_where_they_come_from(self, tmp_path: Path) -> None:
        deformation = Deformation(SHAPE, border=None).grab((26, 15, 11), by=(4, 0, 0), radius=9)
        (tmp_path / "in.csv").write_text("x,y,z\n26,15,11\n27.4,15,11\n27.6,15,11\n26,-0.6,11\n26,15,99\n")
        with pytest.warns(supple.OutsideWarning, match=r"^3 of 5 points lie outside \(point 3 at \(27.6,"):
            assert move_points(tmp_path / "in.csv", tmp_path / "out.csv", deformation).outside == 3
        again = move_points(tmp_path / "in.csv", tmp_path / "again.csv", deformation)
        assert again.first_outside == "point 3 at (27.6, 15, 11)"
        assert read_points(tmp_path / "out.csv").points[0, 0] == pytest.approx(30)

    def test_what_did_not_converge_is_counted(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "in.csv").write_text("x,y,z\n13,15,11\n9,20,12\n")
        certified = Deformation.certified

        def poor(self: Deformation, points: npt.ArrayLike, *, inverse: bool) -> Any:
            found = certified(self, points, inverse=inverse)
            found.error[0], found.converged[0] = np.inf, False
            return found

        monkeypatch.setattr(Deformation, "certified", poor)
        to = tmp_path / "out.csv"
        with pytest.warns(supple.ToleranceWarning, match="1 of 2 points did not converge"):
            moved = move_points(tmp_path / "in.csv", to, bent(), tilted(), inverse=True, convention="index")
        assert moved.unconverged == 1
        assert moved.error[0] == np.inf > 1e-6 > moved.error[1]

    @pytest.mark.parametrize("convention", [None, "index", "LPS", "RAS"])
    def test_what_a_table_means(self, tmp_path: Path, convention: str | None) -> None:
        geometry, deformation, index = tilted(), bent(), np.array([13.0, 15.0, 11.0])
        place = index if convention in (None, "index") else geometry.to_world(index, convention)
        (tmp_path / "in.csv").write_text("x,y,z\n{!r},{!r},{!r}\n".format(*place.tolist()))
        with contextlib.nullcontext() if convention else pytest.warns(VolumeWarning):
            move_points(tmp_path / "in.csv", tmp_path / "out.csv", deformation, geometry, convention=convention)
        found = read_points(tmp_path / "out.csv").points[0]
        end = deformation.forward(index)
        expected = end if convention in (None, "index") else geometry.to_world(end, convention)
        np.testing.assert_allclose(found, expected, atol=1e-9)

    @pytest.mark.parametrize("head", ["", "# my clicks\n", "who,x (mm),y (mm),z (mm)\n", "who,x_mm,y_mm,z_mm\n"])
    def test_what_a_table_does_not_say_is_not_guessed(self, tmp_path: Path, head: str) -> None:
        (tmp_path / "in.csv").write_text(head + "nose,13,15,11\n")
        source, out = tmp_path / "in.csv", tmp_path / "out.csv"
        assert "does not say what its numbers are: give convention" in refused(
            move_points, source, out, bent(), tilted()
        )
        assert not out.exists()
        move_points(source, out, bent(), tilted(), convention="index")
        move_points(source, out, bent(), Geometry(SPACING), force=True)  # which has no place in space

    def test_names_without_a_unit_are_voxels_with_a_warning(self, tmp_path: Path) -> None:
        (tmp_path / "in.csv").write_text("x,y,z\n13,15,11\n")
        with pytest.warns(VolumeWarning, match=r"x, y and z of .*in.csv are taken for voxels.* convention LPS or RAS"):
            move_points(tmp_path / "in.csv", tmp_path / "out.csv", bent(), tilted())
        for head in ("i,j,k", "x (voxel),y (voxel),z (voxel)", "x_px,y_px,z_px", "# CoordinateSystem = LPS\nx,y,z"):
            (tmp_path / "in.csv").write_text(f"{head}\n13,15,11\n")
            move_points(tmp_path / "in.csv", tmp_path / "out.csv", bent(), tilted(), force=True)

    def test_in_pictures_only_x_and_y_move(self, tmp_path: Path) -> None:
        deformation = Deformation((60, 80), border=None).grab((30, 30), by=(6, 3), radius=15)
        (tmp_path / "in.csv").write_text("30.0,30.0,7,left eye\n")
        moved = move_points(tmp_path / "in.csv", tmp_path / "out.csv", deformation)
        cells = (tmp_path / "out.csv").read_text().strip().split(",")
        assert [float(cell) for cell in cells[:2]] == pytest.approx([36, 33])
        assert cells[2:4] == ["7", "left eye"]
        assert moved.displaced[0] == pytest.approx(45**0.5)

    def test_in_clips_frames_move_too(self, tmp_path: Path) -> None:
        deformation = Deformation((20, 60, 80), border=None).grab((30, 30, 9), by=(6, 3, 2), radius=15)
        (tmp_path / "in.csv").write_text("t;who;x;y\n9;a;30;30\n")
        move_points(tmp_path / "in.csv", tmp_path / "out.csv", deformation)
        found = read_points(tmp_path / "out.csv")
        np.testing.assert_allclose(found.points, [[36, 33, 11]])
        head, row = (tmp_path / "out.csv").read_text().splitlines()
        assert head == "t;who;x;y;error_px"
        assert row.split(";")[1] == "a"

    @pytest.mark.parametrize("kind", ["csv", "fcsv", "mrk.json"])
    @pytest.mark.parametrize("inverse", [False, True])
    def test_without_strokes_no_byte_changes(self, tmp_path: Path, kind: str, inverse: bool) -> None:
        points = np.random.default_rng(0).normal(size=(99, 3)) * 100
        text = written(kind, points, "IJK" if kind == "csv" else "RAS")
        (tmp_path / f"in.{kind}").write_text(text)
        still = Deformation(SHAPE, spacing=SPACING)
        moved = move_points(tmp_path / f"in.{kind}", tmp_path / f"out.{kind}", still, tilted(), inverse=inverse)
        np.testing.assert_array_equal(read_points(tmp_path / f"out.{kind}").points, points)
        if kind == "fcsv":
            assert (tmp_path / f"out.{kind}").read_text() == text
        assert not moved.displaced.any()


class TestVoxels:
    def test_points_are_read_as_voxels_whatever_their_convention(self, tmp_path: Path) -> None:
        geometry, points = tilted(), np.array([[3.0, 4.5, 6.0], [10.0, 2.0, 1.25]])
        for kind, system in (("fcsv", "LPS"), ("mrk.json", "RAS"), ("csv", "RAS")):
            source = tmp_path / f"in.{kind}"
            source.write_text(written(kind, geometry.to_world(points, system), system))
            names, found = read_landmarks(source, geometry)
            assert len(names) == 2
            assert all(names)
            np.testing.assert_allclose(found, points, atol=1e-4)
        (tmp_path / "plain.csv").write_text("i,j,k\n1,2,3\n4,5,6\n")
        names, found = read_landmarks(tmp_path / "plain.csv", geometry)
        assert names == ("1", "2")
        np.testing.assert_array_equal(found, [[1, 2, 3], [4, 5, 6]])

    def test_what_does_not_fit_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "flat.csv").write_text("x,y\n1,2\n")
        with pytest.raises(SuppleError, match=r"flat.csv are of two numbers, and those of a volume have three"):
            read_landmarks(tmp_path / "flat.csv", tilted(), convention="index")
        (tmp_path / "in.fcsv").write_text(fcsv(np.ones((1, 3))))
        with pytest.raises(SuppleError, match=r"cannot place .*in.fcsv: .* the volume does not know where it lies"):
            read_landmarks(tmp_path / "in.fcsv", Geometry())


class TestWhatCannotBeDone:
    def test_other_kinds_and_other_points(self, tmp_path: Path) -> None:
        file = read(tmp_path, "x,y\n1,2\n")
        check_target("a.TSV", "b.csv")
        assert refused(check_target, "a.fcsv", "b.csv") == (
            "cannot write a.fcsv: b.csv is of another kind: give a name in .csv or .tsv or .txt"
        )
        refused(write_points, tmp_path / "out.json", file.points, file)
        for bad in ([[1, 2, 3]], [[1, 2], [3, 4]], [[1, np.nan]]):
            message = refused(write_points, tmp_path / "out.csv", bad, file)
            assert "points must be an array of finite numbers of shape (1, 2), as in" in message
        assert os.listdir(tmp_path) == ["in.csv"]

    def test_points_that_do_not_fit(self, tmp_path: Path) -> None:
        flat = Deformation((60, 80))
        (tmp_path / "in.csv").write_text("x,y\n1,2\n")
        (tmp_path / "in.fcsv").write_text(fcsv(np.ones((1, 3))))
        source, out = tmp_path / "in.csv", tmp_path / "out.csv"
        assert refused(move_points, source, out, bent()) == (
            f"cannot move {source}: it has x and y, and shape {SHAPE} needs a third column"
        )
        assert refused(move_points, source, out, flat, tilted()) == (
            "a geometry is of a volume, and shape (60, 80) has two axes"
        )
        assert refused(move_points, source, out, flat, convention="MNI") == (
            'convention must be "LPS" or "RAS" or "index", found \'MNI\''
        )
        space = "and only volumes have a place in space: give pixels in a table with x and y"
        assert refused(move_points, source, out, flat, convention="RAS") == (
            f"cannot place {source}: it is in RAS, {space}"
        )
        source, out = tmp_path / "in.fcsv", tmp_path / "out.fcsv"
        assert refused(move_points, source, out, flat) == f"cannot place {source}: it is in LPS, {space}"
        assert refused(move_points, source, out, bent(), tilted(), convention="RAS") == (
            f"cannot place {source}: it says that it is in LPS, and RAS was asked for: leave that out"
        )
        refused(move_points, source, tmp_path / "out.csv", bent(), tilted())
        assert sorted(os.listdir(tmp_path)) == ["in.csv", "in.fcsv"]
