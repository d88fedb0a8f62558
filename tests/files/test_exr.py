"""OpenEXR: windows, layers, attributes and types, against files that the package OpenEXR writes and reads."""

from __future__ import annotations

import json
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import supple
from supple.errors import LayerWarning, OutsideWarning, SuppleError
from supple.files import warp_file
from supple.files.options import ClipOptions
from supple.media import image
from supple.media.image import MetadataWarning, exr
from tests.cli.commands import Run

Array = np.ndarray[Any, Any]
Box = tuple[int, int, int, int]

GRAB = supple.Recipe(strokes=[supple.Stroke.grab((20, 20), to=(26, 18), radius=10)])
SHIFT = ("--affine", "1,0,-6,0,1,0", "--filter", "linear")


def window(box: Box) -> tuple[Array, Array]:
    """Return a window of OpenEXR: its first pixel and its last."""
    return np.array(box[:2], np.int32), np.array(box[2:], np.int32)


def boxes(path: Path | str) -> tuple[Box, Box]:
    """Return the data and the display window of a file."""
    with OpenEXR.File(str(path)) as file:
        header = dict(file.header())
    found = [tuple(int(x) for corner in header[key] for x in corner) for key in ("dataWindow", "displayWindow")]
    return found[0], found[1]  # type: ignore[return-value]


def channels(path: Path | str, part: int = 0) -> dict[str, Array]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels(part).items()}


def ramps(box: Box) -> dict[str, Array]:
    """Return RGB that says where a pixel is."""
    y, x = np.mgrid[box[1] : box[3] + 1, box[0] : box[2] + 1]
    return {"R": np.float32(x / 100 + 1), "G": np.float32(y / 80 + 1), "B": np.float32(0 * x + 0.5)}


def save(path: Path | str, data: Box, display: Box, planes: dict[str, Array], **attributes: Any) -> None:
    known = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    with OpenEXR.File({**known, "dataWindow": window(data), "displayWindow": window(display)}, dict(planes)) as file:
        file.write(str(path))


def layered(rows: int, columns: int) -> dict[str, Array]:
    """Return channels of all kinds and types."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:rows, :columns]
    return {
        **{name: rng.random((rows, columns)).astype(np.float16) for name in ("R", "G", "B", "A")},
        **{f"albedo.{name}": (x / np.float32(columns)).astype(np.float16) for name in "RGB"},
        "Z": np.where(x > 20, np.float32(1e6), np.float32(3)) + y.astype(np.float32),
        "N.X": rng.random((rows, columns)).astype(np.float32),
        "N.Y": rng.random((rows, columns)).astype(np.float32),
        "id": (x // 8 * 70_000_001 + y // 8).astype(np.uint32),
        **{f"mask00.{name}": rng.choice(np.float32([1e-20, 0.5, 3e30]), (rows, columns)) for name in "rgba"},
    }


MATTES = {"cryptomatte/0123abc/name": "mask"}


@pytest.mark.parametrize(
    ("data", "display"),
    [
        ((-10, -8, 109, 87), (0, 0, 99, 79)),  # overscan
        ((20, 30, 69, 59), (0, 0, 99, 79)),  # a part
        ((-10, 30, 69, 87), (0, 0, 99, 79)),
        ((100, 200, 199, 279), (110, 205, 180, 270)),  # a display window that does not begin at 0
    ],
)
def test_points_count_from_the_display_window(run: Run, data: Box, display: Box) -> None:
    save("in.exr", data, display, ramps(data))
    assert run("warp", "in.exr", "out.exr", *SHIFT)[0] == 0
    found, kept = boxes("out.exr")
    assert kept == display
    facts = image.info("out.exr")
    size = (display[2] - display[0] + 1, display[3] - display[1] + 1)
    assert (facts["width"], facts["height"]) == size
    assert facts["display_window"] == [*display[:2], *size]
    left, top, *held = image.info("in.exr")["data_window"]  # type: ignore[misc]
    assert (left, top, left + held[0] - 1, top + held[1] - 1) == data
    said = run("info", "in.exr")[1]
    assert f"windows     data {held[0]} x {held[1]} from ({left}, {top}), display {size[0]} x {size[1]} from (" in said
    assert found[0] <= data[0] + 6
    assert found[1::2] == data[1::2]
    canvas = np.zeros((400, 400), np.float32)  # of all x and y from -100
    canvas[data[1] + 100 : data[3] + 101, data[0] + 100 : data[2] + 101] = ramps(data)["R"]
    made = channels("out.exr")["R"]
    for y in (data[1] + 4, data[3] - 4):
        for x in (max(data[0], display[0]) + 10, display[0] + 8, data[2] - 2):
            if found[0] <= x <= found[2]:
                assert made[y - found[1], x - found[0]] == pytest.approx(canvas[y + 100, x - 6 + 100], abs=1e-5)


def test_a_saved_map_is_of_the_display_window(tmp_path: Path) -> None:
    data, display = (-10, -8, 109, 87), (0, 0, 99, 79)
    save(tmp_path / "in.exr", data, display, ramps(data))
    warp_file(tmp_path / "in.exr", tmp_path / "out.exr", GRAB, save_field=tmp_path / "map.npy")
    found = np.load(tmp_path / "map.npy")
    assert found.shape == (80, 100, 2)
    d = supple.Deformation.from_recipe(GRAB.placed([10, 8], (120, 96)), (96, 120))
    np.testing.assert_allclose(found, d.inverse_map()[8:88, 10:110] - [10, 8], atol=0.02)  # twice the tolerance


def test_a_data_window_grows_where_something_leaves_it(tmp_path: Path) -> None:
    planes = {name: np.ones((10, 10), np.float32) for name in "RGBA"}
    save(tmp_path / "in.exr", (15, 15, 24, 24), (0, 0, 59, 39), planes)
    warp_file(tmp_path / "in.exr", tmp_path / "out.exr", GRAB, filter="linear")
    (x0, y0, x1, y1), display = boxes(tmp_path / "out.exr")
    assert display == (0, 0, 59, 39)
    assert (x0, y1) == (15, 24)
    assert 26 < x1 < 40
    assert 4 < y0 < 15
    found, whole = channels(tmp_path / "out.exr")["A"], np.zeros((40, 60), np.float32)
    whole[15:25, 15:25] = 1
    deformation = supple.Deformation((40, 60)).grab((20, 20), to=(26, 18), radius=10)
    true = deformation.warp(whole, filter="linear", clamp=True)
    np.testing.assert_allclose(found, true[y0 : y1 + 1, x0 : x1 + 1], atol=1e-6)


def test_each_channel_keeps_its_type_and_ids_and_depths_are_not_averaged(tmp_path: Path) -> None:
    planes = layered(40, 60)
    save(tmp_path / "in.exr", (0, 0, 59, 39), (0, 0, 59, 39), planes, **MATTES)
    with pytest.warns(
        LayerWarning, match=r"averages would mean nothing: N.X, N.Y, Z, id, mask00.a, mask00.b and 2 more"
    ):
        warp_file(tmp_path / "in.exr", tmp_path / "out.exr", GRAB)
    found = channels(tmp_path / "out.exr")
    deformation = supple.Deformation((40, 60)).grab((20, 20), to=(26, 18), radius=10)
    for name, plane in planes.items():
        assert found[name].dtype == plane.dtype
        exact = name in ("Z", "id", "N.X", "N.Y") or name.startswith("mask")
        true = deformation.warp(plane.astype(np.float64), filter="nearest" if exact else "auto", clamp=not exact)
        np.testing.assert_allclose(found[name], true, rtol=0, atol=0 if exact else 2e-3)
        assert (found[name] != plane).any()


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"])
def test_compression_and_attributes_stay(tmp_path: Path, compression: str) -> None:
    known = getattr(OpenEXR, f"{compression}_COMPRESSION")
    attributes = {
        "owner": "someone", "framesPerSecond": Fraction(24000, 1001),
        "chromaticities": (0.7, 0.3, 0.2, 0.7, 0.1, 0.0, 0.3, 0.3),
        "timeCode": OpenEXR.TimeCode(1, 2, 3, 4, *[False] * 6, *range(1, 9)), "mine": np.eye(4, dtype=np.float32),
        "numbers": [1.0, 2.0], "pixelAspectRatio": 2.0,
    }  # fmt: skip
    tall = {name: plane for name, plane in layered(40, 60).items() if name in "RGBA"}
    save(tmp_path / "in.exr", (0, 0, 59, 39), (0, 0, 59, 39), tall, **{**attributes, "compression": known})
    warp_file(tmp_path / "in.exr", tmp_path / "out.exr", GRAB)
    with OpenEXR.File(str(tmp_path / "in.exr")) as one, OpenEXR.File(str(tmp_path / "out.exr")) as other:
        before, after = ({name: repr(value) for name, value in file.header().items()} for file in (one, other))
        assert other.header()["compression"] == known
    assert before == after


def test_parts_tiles_and_names_of_other_programs(tmp_path: Path) -> None:
    tiles = OpenEXR.TileDescription()
    tiles.xSize, tiles.ySize = 16, 16
    planes = layered(40, 60)
    colour = {f"ViewLayer.Combined.{name}": planes[name] for name in "RGBA"} | {"ViewLayer.AO.R": planes["R"]}
    tiled = {"type": OpenEXR.tiledimage, "tiles": tiles, "compression": OpenEXR.PIZ_COMPRESSION}
    parts = [
        OpenEXR.Part({"compression": OpenEXR.ZIPS_COMPRESSION}, {"Z": planes["Z"]}, name="depth"),
        OpenEXR.Part(tiled, colour, name="rgb"),
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "in.exr"))
    assert image.read(tmp_path / "in.exr").pixels.shape == (40, 60, 4)
    with pytest.warns(LayerWarning, match="nothing: Z"):
        warp_file(tmp_path / "in.exr", tmp_path / "out.exr", GRAB)
    with OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True) as file:
        assert [part.name() for part in file.parts] == ["depth", "rgb"]
        assert [sorted(part.channels) for part in file.parts] == [["Z"], sorted(colour)]
        assert file.parts[1].header["type"] == OpenEXR.tiledimage
        assert file.parts[1].header["compression"] == OpenEXR.PIZ_COMPRESSION


def test_what_is_not_supported_is_named(tmp_path: Path) -> None:
    deep = np.empty((4, 5), object)
    for k in range(20):
        deep.flat[k] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    with OpenEXR.File(header, {"Z": deep}) as file:
        file.write(str(tmp_path / "deep.exr"))
    save(tmp_path / "ids.exr", (0, 0, 3, 3), (0, 0, 3, 3), {"id": np.ones((4, 4), np.uint32)})
    for name, text in (("deep", "it is a deep EXR"), ("ids", "none of its channels holds floats")):
        with pytest.raises(SuppleError, match=text):
            image.read(tmp_path / f"{name}.exr")
    whole = struct.pack("<iB3xii", 0, 0, 1, 1)
    data = (tmp_path / "ids.exr").read_bytes()
    (tmp_path / "yc.exr").write_bytes(data.replace(whole, struct.pack("<iB3xii", 0, 0, 2, 2)))
    with pytest.raises(SuppleError, match=r"its channel id has .* 2 x 2"):
        exr.head_only(tmp_path / "yc.exr")


def test_other_formats_say_what_they_cannot_take_over(tmp_path: Path) -> None:
    save(tmp_path / "in.exr", (0, 0, 69, 39), (0, 0, 59, 39), layered(40, 70), owner="me", **MATTES)
    with pytest.warns(
        MetadataWarning,
        match=r"out.tif: TIFF cannot take .* channels .*, Z and 5 more and the .*, owner and",
    ):
        warp_file(tmp_path / "in.exr", tmp_path / "out.tif", GRAB)
    assert image.read(tmp_path / "out.tif").pixels.shape == (40, 60, 4)
    with pytest.warns(MetadataWarning, match=r"cannot take over the channels"):
        image.write(
            tmp_path / "again.exr", image.read(tmp_path / "in.exr").pixels, like=image.read(tmp_path / "in.exr")
        )


def test_a_part_of_the_grid_is_one_of_the_display_window(run: Run) -> None:
    data, display = (-10, -8, 109, 87), (0, 0, 99, 79)
    save("in.exr", data, display, ramps(data))
    assert run("warp", "in.exr", "out.exr", *SHIFT, "--crop", "0,10,30,20")[0] == 0
    assert boxes("out.exr") == ((0, 0, 29, 19),) * 2
    np.testing.assert_allclose(channels("out.exr")["R"][0, :9], (np.arange(9) - 6) / 100 + 1, atol=1e-5)


def test_saved_recipes_and_reports_are_of_the_display_window(run: Run) -> None:
    data, display = (-10, -8, 109, 87), (0, 0, 99, 79)
    save("in.exr", data, display, ramps(data))
    save("f.0007.exr", data, display, ramps(data))
    grab = ("--grab", "50,40:56,40", "--radius", "12", "--json")
    for source, target in (("in.exr", "out.exr"), ("f.####.exr", "g.####.exr")):
        status, out, _ = run("warp", source, target, *grab, "--save-recipe", "r.json", "--force")
        assert status == 0
        facts = json.loads(out)
        assert (facts["width"], facts["height"]) == (100, 80)
        assert facts["arrivals"][0]["target"] == [56, 40]
        assert json.loads(Path("r.json").read_text())["size"] == [100, 80]
    status, out, _ = run("warp", "f.%04d.exr", "h.%04d.exr", "--grab", "50,40,0:56,40,0", "--radius", "12", "--json")
    assert json.loads(out)["arrivals"][0]["target"] == [56, 40, 0]
    ends = channels("out.exr")["R"], channels("g.0007.exr")["R"]
    np.testing.assert_allclose(*ends, atol=1e-5)


@pytest.mark.parametrize("grab", ["20,20:26,18", "20,20,1:26,18,1"])
def test_a_sequence_keeps_what_its_frames_have(run: Run, grab: str) -> None:
    display = (0, 0, 55, 39)
    frames = []
    for k in range(3):
        data = (-4 + k, -3, 59, 41 + k)
        frames.append(layered(data[3] - data[1] + 1, data[2] - data[0] + 1))
        save(f"f.{1001 + k}.exr", data, display, frames[-1], owner=f"frame {k}", **MATTES,
             compression=(OpenEXR.B44_COMPRESSION, OpenEXR.DWAA_COMPRESSION, OpenEXR.ZIP_COMPRESSION)[k])  # fmt: skip
    status, _, err = run("warp", "f.%04d.exr", "bent/f.%04d.exr", "--grab", grab, "--radius", "10", "--strict")
    assert (status, err.count("\n")) == (0, 1)
    assert "averages would mean nothing: N.X" in err
    for k, planes in enumerate(frames):
        name = f"bent/f.{1001 + k}.exr"
        (x0, y0, x1, y1), kept = boxes(name)
        assert kept == display
        assert x0 <= -4 + k
        assert y0 == -3
        assert x1 == 59
        assert y1 >= 41 + k
        found = channels(name)
        assert {key: plane.dtype for key, plane in found.items()} == {key: plane.dtype for key, plane in planes.items()}
        for key in ("Z", "id", "N.X", *(("N.Y", "mask00.g") if k != 1 else ())):  # DWAA loses some of those
            assert set(np.unique(found[key])) <= {0, *np.unique(planes[key])}
        with OpenEXR.File(name) as file:
            assert file.header()["owner"] == f"frame {k}"
            assert file.header()["compression"].name.startswith(("B44", "DWAA", "ZIP")[k])


def test_frames_that_differ_are_refused(run: Run) -> None:
    box = (0, 0, 55, 39)
    planes = {name: np.ones((40, 56), np.float32) for name in "RGB"}
    save("f.1.exr", box, box, planes)
    save("f.2.exr", box, (0, 0, 50, 39), planes)
    strokes = ("--grab", "20,20:26,18", "--radius", "10")
    assert "has a display window other than" in run("warp", "f.%d.exr", "g.%d.exr", *strokes)[2]
    save("f.2.exr", box, box, {**planes, "A": planes["R"]})
    assert "has channels other than" in run("warp", "f.%d.exr", "g.%d.exr", *strokes)[2]
    save("f.2.exr", box, box, {name: plane.astype(np.float16) for name, plane in planes.items()})
    assert "channels of other types" in run("warp", "f.%d.exr", "g.%d.exr", *strokes)[2]
    assert not Path("g.1.exr").exists()


def test_a_smaller_stmap_is_said(tmp_path: Path) -> None:
    from supple.media.transforms import read

    s, t = (np.full((10, 12), 0.5, np.float32) for _ in range(2))
    save(tmp_path / "map.exr", (3, 2, 14, 11), (0, 0, 23, 17), {"R": s, "G": t})
    with pytest.warns(OutsideWarning, match="map.exr holds 12 x 10 pixels of its 24 x 18: beyond, its edge goes on"):
        (field,) = read(tmp_path / "map.exr")
    assert field.grid.origin == (3, 2)  # type: ignore[union-attr]


def test_films_of_pictures(tmp_path: Path) -> None:
    """Their pixels' aspect is known; colours multiplied by opacity are refused for what they are."""
    box, folder = (0, 0, 63, 47), tmp_path / "in"
    folder.mkdir()
    drag = supple.Recipe(strokes=[supple.Stroke.grab((30, 20, 1), by=(4, 0, 0), radius=8)])
    for k in range(3):
        save(folder / f"rgb.{k}.exr", box, box, ramps(box), pixelAspectRatio=2.0)
        save(folder / f"rgba.{k}.exr", box, box, {**ramps(box), "A": np.ones((48, 64), np.float32)})
    codec = ClipOptions(codec="ffv1")
    with pytest.warns(UserWarning, match="cannot say that pixels are 2 as wide as high"):
        warp_file(folder / "rgb.%d.exr", tmp_path / "o.mkv", drag, clip=codec)
    with pytest.raises(SuppleError, match=r"colours that are multiplied by their opacity \(A\), which films do not"):
        warp_file(folder / "rgba.%d.exr", tmp_path / "a.mkv", drag, clip=codec)
