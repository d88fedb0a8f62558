"""Meshes that travel with a volume, from file to file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import supple
from supple import Deformation, SuppleError
from supple.cli import command
from supple.errors import VolumeWarning
from supple.files.landmarks import move_points, read_landmarks
from supple.space.geometry import Geometry
from tests.media.meshes import made
from tests.media.meshes.contours import circle, contours, points_of, structures
from tests.media.meshes.made import Floats

DATA = Path(supple.__file__).parent / "examples" / "data"
SHAPE, SPACING = (24, 30, 28), (0.9, 1.1, 1.4)
FLIP = np.array([-1.0, -1.0, 1.0])


def place() -> Geometry:
    a = 0.4
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return Geometry(SPACING, (-11.25, 3.5, 12.125), turn * (1, -1, 1), "RAS")


def bent() -> Deformation:
    strokes = Deformation(SHAPE, spacing=SPACING, border=5.0)
    return strokes.grab((13, 15, 11), to=(17, 13, 13), radius=9).twist((14, 14, 12), angle=0.4, radius=8)


def there(points: Floats) -> Floats:
    """T in RAS, in millimetres, by the voxels of the volume."""
    return place().to_world(bent().forward(place().from_world(points, "RAS")), "RAS")


def ball(radius: float = 6.0) -> Floats:
    x, y, z = place().to_world((14, 14, 12), "RAS")
    return made.surface((float(x), float(y), float(z)), radius)


@pytest.mark.parametrize("kind", ["binary.stl", "in.obj", "text.ply", "binary.vtk", "raw.vtp"])
def test_a_mesh_moves_by_t_and_back(tmp_path: Path, kind: str) -> None:
    source = made.write(tmp_path / kind, ball())
    names = [tmp_path / f"{word}{source.suffix}" for word in ("there", "back")]
    moved = move_points(source, names[0], bent(), place())
    before, after = made.read(source), made.read(names[0])
    assert moved.count == 86
    assert moved.displaced.max() > 3
    assert moved.error.max() < 1e-5
    np.testing.assert_allclose(made.points(after), there(made.points(before)), atol=3e-6)
    assert made.faces(after) == made.faces(before)
    move_points(names[0], names[1], bent(), place(), inverse=True)
    np.testing.assert_allclose(made.points(made.read(names[1])), made.points(before), atol=1e-5)
    if (start := made.normals(before)) is not None and (end := made.normals(made.read(names[1]))) is not None:
        np.testing.assert_allclose(end, start, atol=1e-4)


def test_normals_are_those_of_the_surface_that_moved(tmp_path: Path) -> None:
    source = made.write(tmp_path / "Binary-None.vtp", ball())
    move_points(source, tmp_path / "out.vtp", bent(), place())
    before, found = made.read(source), made.normals(made.read(tmp_path / "out.vtp"))
    points, normals = made.points(before), made.normals(before)
    assert normals is not None
    assert found is not None
    # two tangents of the sphere at each vertex, followed by central differences
    one = np.cross(normals, [0.3, 0.5, 0.8])
    other = np.cross(normals, one)
    across = np.cross(*(there(points + 1e-4 * t) - there(points - 1e-4 * t) for t in (one, other)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(found, across, atol=1e-4)
    assert np.abs(found - normals).max() > 0.1


def test_a_mesh_that_does_not_say_where_it_is(tmp_path: Path) -> None:
    source = made.write(tmp_path / "in.obj", ball())
    text = source.read_text().replace("SPACE=RAS", "")
    source.write_text(text)
    with pytest.raises(SuppleError) as caught:
        move_points(source, tmp_path / "out.obj", bent(), place())
    told = f"cannot place {source}: it does not say what its numbers are: give convention LPS or RAS (millimetres), or"
    assert str(caught.value).startswith(told)
    assert not (tmp_path / "out.obj").exists()
    move_points(source, tmp_path / "ras.obj", bent(), place(), convention="RAS")
    before = made.points(made.read(source))
    np.testing.assert_allclose(made.points(made.read(tmp_path / "ras.obj")), there(before), atol=3e-6)
    flipped = made.surface()
    flipped.GetPoints().Reset()
    for x, y, z in before * FLIP:
        flipped.GetPoints().InsertNextPoint(x, y, z)
    lps = made.write(tmp_path / "lps.obj", flipped)
    lps.write_text(lps.read_text().replace("SPACE=RAS", "SPACE=LPS"))
    move_points(lps, tmp_path / "moved.obj", bent(), place())
    np.testing.assert_allclose(made.points(made.read(tmp_path / "moved.obj")) * FLIP, there(before), atol=1e-5)


def test_meshes_are_no_landmarks(tmp_path: Path) -> None:
    source = made.write(tmp_path / "in.obj", ball())
    with pytest.raises(SuppleError, match=r"the suffix \.obj is of no file of points: give a \.csv"):
        read_landmarks(source, place())
    with pytest.raises(SuppleError, match=r"cannot write .*out.ply: .*in.obj is of another kind: give a name in .obj"):
        move_points(source, tmp_path / "out.ply", bent(), place())


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, y, z = 0.0, 51.0, 53.0
    source = made.write(tmp_path / "skull.ply", made.surface((x, y, z), 10))
    grab = ("--grab", "0,51,53:0,47,50", "--radius", "40", "--world")
    assert command(["points", str(source), str(tmp_path / "out.ply"), "--on", str(DATA / "head.nii.gz"), *grab]) == 0
    assert capsys.readouterr().out.startswith("86 points, moved by up to 4.82 mm; error up to ")
    after = made.points(made.read(tmp_path / "out.ply"))
    assert np.linalg.norm(after - made.points(made.read(source)), axis=1) == pytest.approx(5, abs=0.7)


def test_contours_move_by_t(tmp_path: Path) -> None:
    x, y, z = place().to_world((14, 14, 12), "LPS")
    around = circle(0.0) * (0.2, 0.1, 1) + (x, y, z)
    source = structures(tmp_path / "rs.dcm", around)
    with pytest.warns(VolumeWarning, match=r"^1 of 1 contours of .* leave their planes"):
        moved = move_points(source, tmp_path / "out.dcm", bent(), place())
    start, end = (points_of(contours(path)[0]) for path in (source, tmp_path / "out.dcm"))
    assert moved.count == 24
    np.testing.assert_allclose(end, there(start * FLIP) * FLIP, rtol=0, atol=1e-9)
    assert moved.displaced.max() > 2
