"""Maps of OpenCV's: what remap makes of them is what is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from supple import SuppleError
from supple.media.transforms import Displacements, read, write
from supple.space.geometry import Grid
from tests import refusals
from tests.media.transforms.mapping import sampled

Array = npt.NDArray[Any]

SHAPE = (37, 53)
ROWS, COLUMNS = np.indices(SHAPE)
X = np.clip(COLUMNS + 3 * np.sin(ROWS / 5) + 0.37, 0, 52).astype(np.float32)
Y = np.clip(ROWS + 2 * np.cos(COLUMNS / 7) - 0.21, 0, 36).astype(np.float32)
RAMP = np.dstack([COLUMNS, ROWS, np.zeros(SHAPE)]).astype(np.float32)


def places(path: Path) -> Array:
    """Return the source positions of a file's map."""
    (field,) = read(path, "opencv")
    assert isinstance(field, Displacements)
    assert field.beyond == "edge"
    assert field.grid.is_same_space(Grid(field.values.shape[:2]))
    height, width = field.grid.shape
    return np.asarray(field.values + np.dstack(np.meshgrid(np.arange(width), np.arange(height))))


def stored(path: Path, **matrices: Array) -> Path:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, matrix in matrices.items():
        file.write(name, matrix)
    file.release()
    return path


def test_arrays_of_positions(tmp_path: Path) -> None:
    both = np.dstack([X, Y])
    np.save(tmp_path / "a.npy", both)
    np.save(tmp_path / "b.npy", np.stack([X, Y]))
    np.save(tmp_path / "c.npy", both.astype(np.float64))
    np.savez(tmp_path / "d.npz", map1=X, map2=Y)
    np.savez(tmp_path / "e.npz", map_y=Y, map_x=X)
    np.savez(tmp_path / "f.npz", whatever=both)
    np.savez(tmp_path / "g.npz", map1=both, map2=np.empty(0))
    for path in sorted(tmp_path.iterdir()):
        np.testing.assert_allclose(places(path), both, atol=1e-6, err_msg=path.name)


@pytest.mark.parametrize("suffix", [".xml", ".yml", ".yaml"])
def test_what_file_storage_writes(suffix: str, tmp_path: Path) -> None:
    both = np.dstack([X, Y])
    np.testing.assert_allclose(places(stored(tmp_path / f"a{suffix}", map1=X, map2=Y)), both, atol=1e-6)
    np.testing.assert_allclose(places(stored(tmp_path / f"b{suffix}", mapx=X, mapy=Y)), both, atol=1e-6)
    np.testing.assert_allclose(places(stored(tmp_path / f"c{suffix}", map=both)), both, atol=1e-6)
    np.testing.assert_allclose(places(stored(tmp_path / f"d{suffix}", x=X.astype("f8"), y=Y)), both, atol=1e-6)
    coarse = cv2.convertMaps(X, Y, cv2.CV_16SC2)
    fixed = stored(tmp_path / f"e{suffix}", map1=coarse[0], map2=coarse[1])
    back = cv2.convertMaps(*coarse, cv2.CV_32FC1)
    np.testing.assert_array_equal(places(fixed), np.dstack(back))


def test_a_ramp_and_an_image_through_remap(tmp_path: Path) -> None:
    x, y = np.rint(X * 32) / 32, np.rint(Y * 32) / 32  # which remap takes without rounding, in every version
    np.savez(tmp_path / "a.npz", map1=x, map2=y)
    options = {"interpolation": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REPLICATE}
    np.testing.assert_allclose(places(tmp_path / "a.npz"), cv2.remap(RAMP, x, y, **options)[..., :2], atol=1e-5)
    image = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (*SHAPE, 3)).astype("f4"), (0, 0), 2)
    seen = sampled(image, read(tmp_path / "a.npz", "opencv"), SHAPE)
    np.testing.assert_allclose(seen, cv2.remap(image, x, y, **options), atol=1e-3)


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".xml", ".yml", ".yaml"])
def test_round_trips(suffix: str, tmp_path: Path) -> None:
    values = np.dstack([X - COLUMNS, Y - ROWS])
    path = tmp_path / f"a{suffix}"
    write(path, [Displacements(values, Grid(SHAPE))])
    np.testing.assert_allclose(places(path), np.dstack([X, Y]), atol=1e-6)
    with pytest.raises(SuppleError, match="exists already"):
        write(path, [Displacements(values, Grid(SHAPE))])
    write(path, [Displacements(values, Grid(SHAPE))], force=True)
    if suffix not in (".npy", ".npz"):
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        maps = [file.getNode(name).mat() for name in ("map1", "map2")]
        np.testing.assert_allclose(np.dstack(maps), places(path), atol=1e-6)
        assert maps[0].dtype == np.float32


def test_what_is_no_map_is_refused(tmp_path: Path) -> None:
    def refused(name: str, match: str, array: Array | None = None, **arrays: Array) -> None:
        path = tmp_path / name
        if array is not None:
            np.save(path, array)
        elif arrays:
            np.savez(path, **arrays)
        assert name in refusals.refused(read, path, "opencv", match=match)

    holes = X.copy()
    holes[3, 4] = np.nan
    refused("a.npy", r"float32 of shape \(37, 53\)", X)
    refused("b.npy", r"complex64 of shape \(37, 53, 2\): give real", np.dstack([X, Y]).astype(np.complex64))
    refused("c.npy", r"shape \(37, 53, 3\)", np.dstack([X, X, Y]))
    refused("d.npy", "two rows or of two planes", np.zeros((2, 5, 2)))
    refused("e.npy", "1 of its 1961 positions is NaN or infinite", np.dstack([holes, Y]))
    refused("f.npy", "no array of NumPy's", np.array([{}], object))
    refused("g.npz", "holds left, right, which do not tell", left=X, right=Y)
    refused("h.npz", r"\(37, 53\) and float32 of shape \(36, 53\)", map1=X, map2=Y[1:])
    refused("i.npz", "map1, map2, x, y, which do not tell", map1=X, map2=Y, x=X, y=Y)
    refused("j.npy", r"shape \(0, 5, 2\)", np.zeros((0, 5, 2)))
    (tmp_path / "k.npy").write_bytes(b"nothing")
    refused("k.npy", "no array of NumPy's, or cut short")
    (tmp_path / "l.npz").write_bytes(b"nothing")
    refused("l.npz", "no archive of NumPy's")
    (tmp_path / "m.npy").write_bytes((tmp_path / "c.npy").read_bytes()[:500])
    refused("m.npy", "cut short")
    (tmp_path / "n.npz").write_bytes((tmp_path / "h.npz").read_bytes()[:500])
    refused("n.npz", "cut short")


def test_damaged_text_is_refused(tmp_path: Path) -> None:
    whole = {suffix: stored(tmp_path / f"a{suffix}", map1=X, map2=Y).read_text() for suffix in (".xml", ".yml")}
    what = "no whole file of matrices"
    for suffix, text, match in [
        (".xml", whole[".xml"][:3000], what),
        (".xml", "<svg/>", what),
        (".xml", whole[".xml"].replace("<rows>37", "<rows>38", 1), what),
        (".xml", whole[".xml"].replace("map", "left"), "left1, left2, which do not tell"),
        (".yml", whole[".yml"][:3000], what),
        (".yml", "map1: 3", "holds nothing"),
    ]:
        path = tmp_path / f"b{suffix}"
        path.write_text(text)
        with pytest.raises(SuppleError, match=match):
            read(path)


def test_what_no_map_holds_is_not_written(tmp_path: Path) -> None:
    values, path = np.zeros((5, 6, 2), np.float32), tmp_path / "a.npy"
    for contents, match in [
        ([], "one field for each file, found nothing"),
        ([np.eye(3)], "found 1 affine map: sample them"),
        ([Displacements(values, Grid((5, 6))), np.eye(3)], "found 1 affine map and 1 field"),
        ([Displacements(np.zeros((4, 5, 6, 3)), Grid((4, 5, 6)))], "maps of pictures, found one of 3 coordinates"),
        ([Displacements(values, Grid((5, 6), 2.0))], "a sample at each pixel"),
        ([Displacements(values, Grid((5, 6)), "bspline")], "interpolation bspline: sample it"),
        ([Displacements(values * np.nan, Grid((5, 6)))], "NaN or infinity"),
    ]:
        with pytest.raises(SuppleError, match=match):
            write(path, contents)
        assert not path.exists()
    wide = Displacements(np.zeros((1, 40_000, 2), np.float32), Grid((1, 40_000)))
    with pytest.raises(SuppleError, match="end at 32767 pixels on a side"):
        write(path, [wide])
    with pytest.raises(SuppleError, match="is of no map of OpenCV's"):
        write(tmp_path / "a.exr", [Displacements(values, Grid((5, 6)))], "opencv")
