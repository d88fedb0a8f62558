"""STMaps: what OpenImageIO's st_warp makes of them is what is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest

from supple import SuppleError
from supple.media import image
from supple.media.transforms import Displacements, read, write
from supple.space.geometry import Grid
from tests.media.transforms.mapping import mapped, sampled
from tests.refusals import refused

Array = npt.NDArray[Any]

DATA = Path(__file__).parent / "data"
SHAPE, SOURCE = (18, 24), Grid((20, 32))
ROWS, COLUMNS = np.indices(SHAPE)


def exr(path: Path, size: tuple[int, int] | None = None, first: tuple[int, int] = (0, 0), **channels: Array) -> Path:
    """Write an EXR whose display window has a size, and whose data window begins at a pixel."""
    height, width = next(iter(channels.values())).shape
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    last = (first[0] + width - 1, first[1] + height - 1)
    header["dataWindow"] = (np.array(first, np.int32), np.array(last, np.int32))
    whole = size or (width, height)
    header["displayWindow"] = (np.zeros(2, np.int32), np.array(whole, np.int32) - 1)
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


def plain(shape: tuple[int, int] = SHAPE) -> tuple[Array, Array]:
    """Return s and t of a map that changes nothing."""
    rows, columns = np.indices(shape)
    return np.float32((columns + 0.5) / shape[1]), np.float32(1 - (rows + 0.5) / shape[0])


@pytest.mark.parametrize(
    ("name", "within"), [("stmap-float.exr", 1e-5), ("stmap-half.exr", 0.02), ("stmap-uint16.tif", 0.5 * 32 / 65535)]
)
def test_what_st_warp_makes_of_it(name: str, within: float) -> None:
    made = np.load(DATA / "st_warp.npz")
    contents = read(DATA / name, "stmap", source=SOURCE)
    (field,) = contents
    assert isinstance(field, Displacements)
    assert field.values.dtype == np.float32
    assert field.beyond == "edge"
    seen = sampled(made["source"], contents, SHAPE)
    np.testing.assert_allclose(seen, made[Path(name).stem], atol=2e-5)
    at = np.stack([COLUMNS, ROWS], -1) + field.values
    assert np.abs(at - made["places"]).max() < within * 1.001


@pytest.mark.parametrize("suffix", [".exr", ".tif"])
@pytest.mark.parametrize("source", [None, SOURCE])
def test_round_trips(suffix: str, source: Grid | None, tmp_path: Path) -> None:
    x = np.clip(COLUMNS + np.sin(ROWS / 3), 0, 23)
    y = np.clip(ROWS - np.cos(COLUMNS / 4), 0, 17)
    field = Displacements(np.dstack([x - COLUMNS, y - ROWS]), Grid(SHAPE))
    path = tmp_path / f"a{suffix}"
    write(path, [field], "stmap", source=source)
    (again,) = read(path, "stmap", source=source)
    assert isinstance(again, Displacements)
    assert again.grid.is_same_space(field.grid)
    within = 3e-6 if suffix == ".exr" else 0.5 * (32 if source else 24) / 65535 + 1e-6
    assert np.abs(again.values - field.values).max() < within
    with pytest.raises(SuppleError, match="exists already"):
        write(path, [field], "stmap")


def test_a_map_that_changes_nothing_is_as_nuke_has_it(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", [Displacements(np.zeros((*SHAPE, 2)), Grid(SHAPE))])
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        found = {name: channel.pixels.copy() for name, channel in file.channels().items()}
    s, t = plain()
    np.testing.assert_allclose(found["R"], s, atol=1e-7)
    np.testing.assert_allclose(found["G"], t, atol=1e-7)
    assert found["R"].dtype == np.float32
    assert not found["B"].any()


def test_overscan_keeps_its_place(tmp_path: Path) -> None:
    rows, columns = np.mgrid[-3:21, -2:26]
    s, t = np.float32((columns + 1.5) / 24), np.float32(1 - (rows + 0.5) / 18)
    contents = read(exr(tmp_path / "a.exr", (24, 18), (-2, -3), R=s, G=t))
    (field,) = contents
    assert isinstance(field, Displacements)
    assert field.grid.origin == (-2, -3)
    assert field.grid.shape == (24, 28)
    np.testing.assert_allclose(mapped(contents, [[5, 7], [-1.5, 19]]), [[6, 7], [-0.5, 19]], atol=1e-5)


@pytest.mark.parametrize(
    "names",
    [("R", "G", "B"), ("R", "G", "A"), ("s", "t"), ("forward.u", "forward.v"), ("View.Combined.R", "View.Combined.G")],
)
def test_channels_by_their_names(names: tuple[str, ...], tmp_path: Path) -> None:
    s, t = plain()
    planes = [s, t, np.zeros_like(s)]
    channels = {name: planes[i] for i, name in enumerate(names)} | {"depth.Z": s}
    (field,) = read(exr(tmp_path / "a.exr", **channels))
    assert isinstance(field, Displacements)
    assert np.abs(field.values).max() < 1e-5


def test_positions_outside_the_source_are_kept(tmp_path: Path) -> None:
    field = Displacements(np.full((*SHAPE, 2), 30.0), Grid(SHAPE))
    write(tmp_path / "a.exr", [field])
    (again,) = read(tmp_path / "a.exr")
    assert isinstance(again, Displacements)
    np.testing.assert_allclose(again.values, field.values, atol=1e-5)
    with pytest.raises(SuppleError, match=r"432 positions are outside the source, .*: write an EXR"):
        write(tmp_path / "a.tif", [field], "stmap")


def test_what_is_no_stmap_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    s, t = plain()
    holes, part = s.copy(), np.ones_like(s)
    holes[1, 2] = np.nan
    part[3] = 0
    colours = np.random.default_rng(0).integers(0, 255, (*SHAPE, 3), np.uint8)
    image.write(tmp_path / "a.png", colours)
    image.write(tmp_path / "b.tif", colours[..., 0].astype(np.uint16))
    image.write(tmp_path / "c.tif", np.dstack([s, t, s, part]), alpha=True)
    exr(tmp_path / "d.exr", Y=s)
    exr(tmp_path / "e.exr", **{"a.R": s, "a.G": t, "b.R": s, "b.G": t})
    exr(tmp_path / "f.exr", R=s.astype(np.uint32), G=t.astype(np.uint32))
    exr(tmp_path / "g.exr", R=holes, G=t)
    exr(tmp_path / "h.exr", R=s, G=t, A=part)
    (tmp_path / "i.exr").write_bytes((DATA / "stmap-float.exr").read_bytes()[:1500])
    (tmp_path / "j.exr").write_bytes(b"nothing")
    (tmp_path / "k.exr").write_bytes(b"")
    for name, match in [
        ("a.png", "3 channels of uint8: an STMap needs red and green of 16 or 32 bits"),
        ("b.tif", "1 channels of uint16: an STMap needs"),
        ("c.tif", "its opacity changes, at 24 pixels"),
        ("d.exr", "its channels Y hold no pair"),
        ("e.exr", "more than one pair"),
        ("f.exr", "R and G are of uint32: write floats"),
        ("g.exr", "1 of its 432 positions is NaN"),
        ("h.exr", "its opacity changes"),
        ("i.exr", "cut short"),
        ("j.exr", "does not begin as an EXR"),
        ("k.exr", "it is empty"),
        ("m.jpg", "is of no STMap"),
    ]:
        assert name in refused(read, tmp_path / name, "stmap", match=match)
    assert capfd.readouterr() == ("", "")  # OpenEXR writes lines of its own
    with pytest.raises(SuppleError, match="the source is a volume"):
        read(DATA / "stmap-float.exr", source=Grid((4, 5, 6)))
