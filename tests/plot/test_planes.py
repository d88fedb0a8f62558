"""Planes of volumes: where they lie, how they are turned, and plots of what a deformation does to them."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

import supple
from supple import Deformation, Grid, SuppleError
from supple.fields import Placed
from supple.media import volume as media
from supple.plot import planes, volume
from supple.space.affine import Affine

DATA = Path(supple.__file__).parent / "examples" / "data"
HEAD = str(DATA / "head.nii.gz")


@pytest.mark.parametrize("order", list(itertools.permutations(range(3)))[::2])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, -1), (1, -1, -1)])
def test_slices_are_those_of_the_closest_canonical_image(
    tmp_path: Path, order: tuple[int, int, int], signs: tuple[int, int, int]
) -> None:
    """As nibabel turns an image to RAS, whatever the order and the signs of its axes, and though it is tilted."""
    rng = np.random.default_rng(0)
    data = rng.integers(0, 200, (5, 7, 9)).astype(np.uint8)
    tilt = np.linalg.qr(np.eye(3) + 0.2 * rng.normal(size=(3, 3)))[0]
    tilt = tilt * np.sign(np.diag(tilt))
    matrix = tilt @ (np.eye(3)[list(order)].T * signs) @ np.diag([1.5, 2.0, 2.5])
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = matrix, (10, -20, 30)
    picture = nibabel.Nifti1Image(data, affine)
    nibabel.save(picture, tmp_path / "in.nii")
    canonical = np.asarray(nibabel.as_closest_canonical(picture).dataobj)
    opened = media.read(tmp_path / "in.nii")
    for name, cut in (
        ("axial", lambda k: canonical[::-1, ::-1, k].T),  # R at the left, A above
        ("coronal", lambda k: canonical[::-1, k, ::-1].T),
        ("sagittal", lambda k: canonical[k, ::-1, ::-1].T),  # A at the left, S above
    ):
        axis = {"axial": 2, "coronal": 1, "sagittal": 0}[name]
        turned = nibabel.as_closest_canonical(picture).affine
        middle = (np.array(canonical.shape) - 1) / 2
        for k in (0, canonical.shape[axis] - 1):
            middle[axis] = k
            place = (turned @ [*middle, 1])[axis] * (1 if axis == 2 else -1)  # in LPS
            seen = planes.chosen(opened.grid, f"{name}:{place:.9g}")
            np.testing.assert_array_equal(seen.seen(opened.samples), cut(k))
            assert seen.letters == {"axial": tuple("RLAP"), "coronal": tuple("RLSI"), "sagittal": tuple("APSI")}[name]
            assert f"{name} slice" in seen.text
            assert seen.text.endswith(f"{abs(place):.4g} mm")


def test_what_is_no_plane_is_refused() -> None:
    grid = Grid((10, 20, 30), (1.0, 2.0, 3.0), (5.0, 0.0, -9.0))
    for text in ("oblique", "axial:", "axial:top", "coronal:nan"):
        with pytest.raises(SuppleError, match=r"^plane must be "):
            planes.chosen(grid, text)
    with pytest.raises(SuppleError, match=r"axial slices lie from -9 to 18 mm in LPS, found 'axial:20'"):
        planes.chosen(grid, "axial:20")
    assert planes.chosen(grid, "axial:19.4").number == 9
    assert planes.chosen(grid, None).number == 4


def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, d: Deformation, what: str, **options: Any) -> Any:
    made: list[Any] = []
    monkeypatch.setattr(volume, "save", lambda figure, path, force: made.append(figure))
    opened = media.read(HEAD)
    volume.draw_volume(d, what, opened.samples, opened.grid, tmp_path / "p.png", **options)
    return made[0]


def test_a_plot_shows_the_warped_slice_and_its_change_of_volume(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    opened = media.read(HEAD)
    d = Deformation(opened.grid).scale((45, 60, 50), factor=1.5, radius=25)
    made = drawn(monkeypatch, tmp_path, d, "stretch", plane="coronal:5")
    (axes, bar) = made.axes
    k = planes.chosen(opened.grid, "coronal:5")
    below, above = (each.get_array() for each in axes.images)
    np.testing.assert_array_equal(below, k.seen(d.warp(opened.samples, filter="linear", between="linear")))
    index = np.stack(np.indices(opened.grid.shape)[::-1], axis=-1).astype(float)
    part = k.seen(index)
    steps = np.eye(3) * 1e-4
    pairs = [d.inverse(part + e).points - d.inverse(part - e).points for e in steps]
    slopes = np.stack(pairs, axis=-1) / 2e-4
    np.testing.assert_allclose(above, -np.log(np.linalg.det(slopes)), atol=1e-4)
    assert bar.get_ylabel().replace("\n", " ") == "ln(output volume / input volume)"
    assert {text.get_text() for text in axes.texts} == {"R", "L", "S", "I", "20 mm"}
    assert above.max() == pytest.approx(3 * np.log(1.5), abs=0.1)


def test_lines_are_planes_of_the_input(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened = media.read(HEAD)
    d = Deformation(opened.grid).grab((45, 60, 50), by=(0, 5, 3), radius=25)
    made = drawn(monkeypatch, tmp_path, d, "grid")
    (axes,) = made.axes
    assert "axial slice 51 (of 0 to 90), at S 31 mm" in made._suptitle.get_text()
    turned = Placed(Affine([[0.96, 0.28, 0, 40], [-0.28, 0.96, 0, 0], [0, 0.1, 1.2, 8]]))
    made = drawn(monkeypatch, tmp_path, d.behind([turned]), "grid")  # the strokes count, beside an affine map
    assert "axial slice 51 (of 0 to 90)" in made._suptitle.get_text()
    made = drawn(monkeypatch, tmp_path, d.without_strokes().behind([turned]), "grid")
    assert "axial slice 90 (of 0 to 90)" in made._suptitle.get_text()
    made = drawn(monkeypatch, tmp_path, d, "grid", plane="axial:30")
    (axes,) = made.axes
    seen = planes.chosen(opened.grid, "axial:30")
    checked = 0
    for lines in axes.collections:
        for path in lines.get_paths():
            for x, y in path.vertices[::7]:
                column, row = x / seen.steps[0], y / seen.steps[1]
                index = np.empty(3)
                for axis, at, flipped in zip((seen.across, seen.down), (column, row), seen.flipped, strict=True):
                    index[axis] = opened.grid.sizes[axis] - 1 - at if flipped else at
                index[seen.through] = seen.number
                source = d.inverse(index).points * opened.grid.spacing
                off = [abs(source[axis] / 10 - round(source[axis] / 10)) * 10 for axis in (seen.across, seen.down)]
                assert min(off) < 0.1
                checked += 1
    assert checked > 200
