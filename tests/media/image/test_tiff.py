"""TIFFs of all layouts: samples, the meaning of channels, and tags come through."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import pyvips

import supple
from supple.errors import GapWarning, SuppleError
from supple.files import warp_file
from supple.media import image
from supple.media.image import MetadataWarning, PageWarning, Picture, info, read, tiff, write
from supple.media.image.display import in_srgb
from tests import effort
from tests.media.image.pictures import noise
from tests.refusals import refused

tifffile = pytest.importorskip("tifffile")

Array = npt.NDArray[Any]
SIZE = (37, 53)
SAME = supple.Deformation(SIZE).affine([[1, 0, 0], [0, 1, 0]])
HALF = supple.Deformation(SIZE).affine([[1, 0, 0.5], [0, 1, 0]])
GRAB = supple.Recipe(strokes=[supple.Stroke.grab((20, 20), to=(24, 20), radius=6)])


def saved(path: Path, pixels: Array, photometric: str = "rgb", *, planar: bool = False, **options: Any) -> Array:
    """Write a TIFF by tifffile; return its samples (H, W[, C])."""
    stored = np.moveaxis(pixels, -1, 0) if planar else pixels
    order = {"planarconfig": "separate" if planar else "contig"} if pixels.ndim == 3 else {}
    tifffile.imwrite(path, stored, photometric=photometric, metadata=None, **order, **options)
    return pixels


def stored(path: Path) -> tuple[Array, Any]:
    """Return the samples (H, W[, C]) in a file, and its first page."""
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        assert all(tag.value is not None for tag in page.tags)  # which reads them
        pixels = page.asarray()
        return (np.moveaxis(pixels, 0, -1) if page.planarconfig == 2 and pixels.ndim == 3 else pixels), page


def same(path: Path) -> tuple[Picture, Array, Any]:
    """Pass a file through an identity that samples; return what was read, and what was written."""
    picture = read(path)
    write(path.with_name("out.tif"), SAME.warp(picture, filter="nearest"), force=True)
    return picture, *stored(path.with_name("out.tif"))


KINDS = [
    *[("rgb", 4, (kind,)) for kind in (0, 1, 2)],
    *[("rgb", 5, extra) for extra in ((0, 0), (2, 0), (0, 2))],
    *[("minisblack", 2, (kind,)) for kind in (0, 2)],
    ("minisblack", 4, (0, 0, 0)),
    ("separated", 4, ()),
    *[("separated", 5, (kind,)) for kind in (0, 2)],
    ("cielab", 3, ()),
    ("icclab", 3, ()),
    ("miniswhite", 2, (0,)),
]
PLACED: dict[str, Any] = {"whole": {}, "strips": {"rowsperstrip": 8}, "tiles": {"tile": (16, 16)}}


@pytest.mark.parametrize(("kind", "dtype", "placed"), effort.pairs(KINDS, ["u1", "u2", "f4", "f8"], list(PLACED)))
def test_planes(tmp_path: Path, kind: tuple[str, int, tuple[int, ...]], dtype: str, placed: str) -> None:
    photometric, channels, extra = kind
    pixels = noise(dtype, *SIZE, channels)
    for planar in (False, True):
        saved(tmp_path / "in.tif", pixels, photometric, planar=planar, extrasamples=extra or None, **PLACED[placed])
        picture, after, page = same(tmp_path / "in.tif")
        assert (picture.extra, picture.alpha) == (extra, extra[-1:] == (2,))
        np.testing.assert_array_equal(after, pixels)
        assert (page.photometric.name.lower(), page.extrasamples) == (photometric, extra)
        assert info(tmp_path / "in.tif")["alpha"] == (2 in extra)


@pytest.mark.parametrize("compression", ["lzw", "zlib", "packbits"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_planes_compressed(tmp_path: Path, compression: str, order: str) -> None:
    for dtype in ("u2", "f4", "f8"):
        predictor = compression != "packbits"
        options = {"compression": compression, "predictor": predictor, "byteorder": order, "bigtiff": dtype == "u2"}
        for layout in ({"rowsperstrip": 10}, {"tile": (16, 32)}):
            pixels = saved(tmp_path / "in.tif", noise(dtype, *SIZE, 3), planar=True, **options, **layout)
            _, after, page = same(tmp_path / "in.tif")
            np.testing.assert_array_equal(after, pixels)
            assert page.compression.name.lower() == {"zlib": "adobe_deflate"}.get(compression, compression)
            assert page.is_tiled == ("tile" in layout)
            assert page.parent.is_bigtiff == (dtype == "u2")
            assert (page.predictor != 1) == (predictor and dtype != "f8")


@pytest.mark.parametrize("bits", [2, 4, 6, 10, 12, 14])
def test_odd_depths_are_spread(tmp_path: Path, bits: int) -> None:
    depth = 8 if bits < 8 else 16
    pixels = noise(f"u{depth // 8}", *SIZE, 3) >> (depth - bits)
    for planar in (False, True):
        saved(tmp_path / "in.tif", pixels, planar=planar, bitspersample=bits)
        picture = read(tmp_path / "in.tif")
        assert picture.bits == bits
        wanted = pixels * ((2**depth - 1) / (2**bits - 1))
        assert np.abs(picture.pixels - wanted).max() <= 1
        np.testing.assert_array_equal(picture.pixels >> (depth - bits), pixels)


def test_white_may_be_zero(tmp_path: Path) -> None:
    for dtype in ("u1", "u2"):
        pixels = saved(tmp_path / "in.tif", noise(dtype, *SIZE), "miniswhite")
        picture, after, page = same(tmp_path / "in.tif")
        np.testing.assert_array_equal(picture.pixels, np.iinfo(dtype).max - pixels)
        np.testing.assert_array_equal(after, pixels)
        assert page.photometric.name == "MINISWHITE"
        write(tmp_path / "out.png", picture, force=True)
        np.testing.assert_array_equal(read(tmp_path / "out.png").pixels, picture.pixels)


@pytest.mark.parametrize("dtype", ["i8", "u8", "c8"])
def test_what_is_not_supported_is_refused_by_name(tmp_path: Path, dtype: str) -> None:
    tifffile.imwrite(tmp_path / "in.tif", np.ones(SIZE, dtype), photometric="minisblack")
    saved(tmp_path / "cfa.tif", noise("u2", *SIZE), "cfa")
    for name, what in (("in.tif", "complex, or integers of 64 bits"), ("cfa.tif", "mosaic of colours")):
        refused(read, tmp_path / name, match=f"not supported .*{what}")


@pytest.mark.parametrize("kind", [0, 1])
def test_neither_data_nor_opacity_that_is_multiplied_already_weights_colours(tmp_path: Path, kind: int) -> None:
    colours, near = noise("u1", *SIZE, 3) // 2, np.zeros(SIZE, np.uint8)
    pixels = saved(tmp_path / "in.tif", np.dstack([colours, near]), extrasamples=[kind])
    made = HALF.warp(read(tmp_path / "in.tif"), filter="linear").pixels
    wanted = (pixels[:, :-1].astype(float) + pixels[:, 1:]) / 2
    assert np.abs(made[:, :-1] - wanted).max() <= 1
    if kind == 0:
        with pytest.raises(SuppleError, match="no channels of data beside the colours: write a TIFF"):
            write(tmp_path / "out.png", read(tmp_path / "in.tif"))


def test_opacity_weights_colours_and_no_data(tmp_path: Path) -> None:
    pixels = np.zeros((*SIZE, 5), np.uint8)
    pixels[:, ::2] = (200, 100, 50, 80, 255)  # red, green, blue, data, opacity
    saved(tmp_path / "in.tif", pixels, extrasamples=[0, 2])
    made = HALF.warp(read(tmp_path / "in.tif"), filter="linear").pixels
    np.testing.assert_array_equal(made[5, 5], (200, 100, 50, 40, 128))


def lab_of(dtype: str, photometric: str) -> Array:
    """Return L* = 46.45, a* = 54.0, b* = 48.03, the sRGB colour (200, 60, 30), as stored."""
    values = np.array([46.45, 54.0, 48.03])
    if dtype == "f4":
        stored = values
    else:
        wide = dtype == "u2"
        middle = (32768 if wide else 128) if photometric == "icclab" else 0
        step = (257 if photometric == "icclab" else 256) if wide else 1
        stored = np.rint([values[0] * (65535 if wide else 255) / 100, *(values[1:] * step + middle)])
    return np.broadcast_to(stored, (*SIZE, 3)).astype(dtype)


@pytest.mark.parametrize(
    ("dtype", "photometric"), [("u1", "cielab"), ("u1", "icclab"), ("u2", "cielab"), ("f4", "cielab")]
)
def test_lab_is_seen_and_stays(tmp_path: Path, dtype: str, photometric: str) -> None:
    saved(tmp_path / "in.tif", lab_of(dtype, photometric), photometric)
    picture = read(tmp_path / "in.tif")
    assert picture.interpretation == "lab"
    assert np.abs(in_srgb(picture).pixels.astype(int) - (200, 60, 30)).max() <= 2
    refused(write, tmp_path / "out.jpg", picture, match="write a TIFF")


def test_an_average_of_lab_goes_through_grey(tmp_path: Path) -> None:
    pixels = np.zeros((*SIZE, 3), np.int8)
    pixels[..., 0], pixels[:, ::2, 1:], pixels[:, 1::2, 1:] = 100, (-20, 10), (20, -10)
    saved(tmp_path / "in.tif", pixels.view(np.uint8), "cielab")
    write(tmp_path / "out.tif", HALF.warp(read(tmp_path / "in.tif"), filter="linear"))
    np.testing.assert_array_equal(stored(tmp_path / "out.tif")[0][5, 5], (100, 0, 0))


def test_cmyk_and_others_as_seen(tmp_path: Path) -> None:
    saved(tmp_path / "cmyk.tif", np.full((*SIZE, 4), (0, 255, 255, 0), np.uint8), "separated")
    seen = in_srgb(read(tmp_path / "cmyk.tif"))
    assert (seen.pixels.shape, seen.alpha) == ((*SIZE, 3), False)
    assert seen.pixels[0, 0, 0] > 180
    assert seen.pixels[0, 0, 1:].max() < 80
    with pytest.raises(SuppleError, match="holds no CMYK colours"):
        write(tmp_path / "out.bmp", read(tmp_path / "cmyk.tif"))
    saved(tmp_path / "multiplied.tif", np.full((*SIZE, 4), (100, 50, 25, 128), np.uint8), extrasamples=[1])
    seen = in_srgb(read(tmp_path / "multiplied.tif"))
    assert seen.alpha
    assert np.abs(seen.pixels[0, 0].astype(int) - (200, 100, 50, 128)).max() <= 1
    saved(tmp_path / "near.tif", np.full((*SIZE, 4), (9, 8, 7, 0), np.uint8), extrasamples=[0])
    np.testing.assert_array_equal(in_srgb(read(tmp_path / "near.tif")).pixels[0, 0], (9, 8, 7))


PLACE = [
    (33550, "d", 3, (0.6, 0.6, 0.0), True),
    (33922, "d", 6, (0, 0, 0, 500000.0, 4000000.0, 0), True),
    (34735, "H", 8, (1, 1, 0, 1, 3072, 0, 1, 32610), True),
    (34737, "s", 0, "UTM|", True),
    (42112, "s", 0, "<GDALMetadata/>", True),
    (50844, "d", 92, tuple(map(float, range(92))), True),
]


@pytest.mark.parametrize("order", ["<", ">"])
def test_georeference_stays_with_its_grid(tmp_path: Path, order: str) -> None:
    source, out = tmp_path / "in.tif", tmp_path / "out.tif"
    saved(source, noise("u2", *SIZE), "minisblack", extratags=PLACE, byteorder=order)
    warp_file(source, out, GRAB)
    tags = stored(out)[1].tags
    for tag, _, _, value, _ in PLACE:
        assert tags[tag].value == value
    with pytest.warns(MetadataWarning, match=r"in\.tif: its georeference is left out, as the grid is another one$"):
        warp_file(source, out, GRAB, force=True, grid=supple.GridOptions(crop=(2, 3, 20, 20)))
    assert not {33550, 33922, 34735, 50844} & set(stored(out)[1].tags.keys())
    with pytest.warns(MetadataWarning, match=r"out\.png: PNG cannot take over the georeference"):
        warp_file(source, tmp_path / "out.png", GRAB)
    saved(source, noise("u2", *SIZE), "minisblack", extratags=[*PLACE, (274, "H", 1, 6, True)])
    with pytest.warns(MetadataWarning, match="the georeference of a turned picture cannot be carried over"):
        read(source)


def test_no_data_is_not_averaged_in_silence(tmp_path: Path) -> None:
    tag = [(42113, "s", 0, "-9999", True)]
    heights = noise("f4", *SIZE)
    heights[18:22, 18:22] = -9999
    saved(tmp_path / "in.tif", heights, "minisblack", extratags=tag)
    with pytest.warns(GapWarning, match=r"16 samples are marked as no data \(-9999\), and their neighbours too"):
        warp_file(tmp_path / "in.tif", tmp_path / "out.tif", GRAB)
    made, page = stored(tmp_path / "out.tif")
    assert page.tags[42113].value == "-9999"
    assert (made == -9999).sum() >= 16
    assert made[made != -9999].min() >= heights[heights != -9999].min()
    saved(tmp_path / "whole.tif", heights.astype("i2"), "minisblack", extratags=tag)
    with pytest.warns(GapWarning, match=r"mixed with others: filter='nearest' keeps them apart$"):
        warp_file(tmp_path / "whole.tif", tmp_path / "out.tif", GRAB, force=True)
    warp_file(tmp_path / "whole.tif", tmp_path / "out.tif", GRAB, force=True, filter="nearest")


def test_a_jpeg_in_a_tiff_stays_one(tmp_path: Path) -> None:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    saved(tmp_path / "in.tif", np.stack([4 * x, 6 * y, 2 * x + y], axis=-1).astype(np.uint8), "rgb", compression="jpeg")
    picture, after, page = same(tmp_path / "in.tif")
    assert page.compression.name == "JPEG"
    assert np.abs(after.astype(int) - picture.pixels).max() <= 4
    write(tmp_path / "exact.tif", picture, lossless=True)
    np.testing.assert_array_equal(stored(tmp_path / "exact.tif")[0], picture.pixels)


def test_fill_of_channels_of_all_kinds(tmp_path: Path) -> None:
    pixels = saved(tmp_path / "in.tif", noise("f4", *SIZE, 5), extrasamples=(2, 0))
    moved = supple.Deformation(SIZE).affine([[1, 0, -10], [0, 1, 0]])
    made = moved.warp(read(tmp_path / "in.tif"), filter="nearest", outside="constant", fill=(1, 2, 3, 0.5, 4))
    np.testing.assert_array_equal(made.pixels[:, 0], np.broadcast_to(np.float32([1, 2, 3, 0.5, 4]), (SIZE[0], 5)))
    np.testing.assert_array_equal(made.pixels[:, 10:], pixels[:, :-10])
    with pytest.raises(SuppleError, match="5 of them"):
        moved.warp(read(tmp_path / "in.tif"), outside="constant", fill=(1, 2, 3, 4))


@pytest.mark.parametrize("marked", [False, True])
def test_pages_that_mean_something_else_are_no_pages(tmp_path: Path, marked: bool) -> None:
    grey = noise("u1", *SIZE)
    with tifffile.TiffWriter(tmp_path / "in.tif") as file:
        if marked:  # as GDAL writes masks
            file.write(grey, photometric="minisblack", metadata=None)
            file.write(grey > 99, photometric="mask", subfiletype=4, metadata=None)
        else:
            for kind in (2, 0):
                four = np.stack([grey] * 4, axis=-1)
                file.write(four, photometric="rgb", extrasamples=(kind,), metadata=None)
    with pytest.warns(PageWarning, match="2 pages, and only one is read"):
        assert read(tmp_path / "in.tif", pages=True).pages == 1


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_no_data_beyond_the_range_marks_nothing(tmp_path: Path) -> None:
    mark = [(42113, 2, 0, "-1.7976931348623157e+308", True)]
    saved(tmp_path / "in.tif", noise("f4", *SIZE), "minisblack", extratags=mark)
    assert np.isfinite(HALF.warp(read(tmp_path / "in.tif")).pixels).all()
    with pytest.warns(MetadataWarning, match="the mark of samples without data"):
        write(tmp_path / "out.exr", read(tmp_path / "in.tif"))


@pytest.mark.parametrize("target", [".tif", ".png"])
def test_numbers_without_a_unit_are_no_resolution(tmp_path: Path, target: str) -> None:
    saved(
        tmp_path / "in.tif", noise("u1", *SIZE), "minisblack", resolution=(300, 150), resolutionunit=1, software=False
    )
    write(tmp_path / f"out{target}", read(tmp_path / "in.tif"))
    assert "resolution" not in read(tmp_path / f"out{target}")._header


def test_a_compression_that_is_not_kept_is_said(tmp_path: Path) -> None:
    ink = np.zeros((32, 64), np.uint8)
    ink[8:16] = 255
    pyvips.Image.new_from_array(ink).tiffsave(str(tmp_path / "fax.tif"), compression="ccittfax4", bitdepth=1)
    with pytest.warns(MetadataWarning, match="cannot take over the compression by CCITT, which becomes deflate"):
        write(tmp_path / "o.tif", read(tmp_path / "fax.tif"))
    assert (read(tmp_path / "o.tif").pixels == ink).all()


def test_bits_in_colours(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "in.tif", noise("uint8", *SIZE, 3) > 127, photometric="rgb")
    seen = tifffile.imread(tmp_path / "in.tif")  # which does not write them as it reads them
    np.testing.assert_array_equal(read(tmp_path / "in.tif").pixels, 255 * seen.astype(np.uint8))


@pytest.mark.parametrize("placed", [{}, {"tile": (64, 32)}])
@pytest.mark.parametrize("compression", ["deflate", "lzw", "none"])
def test_parts_that_are_compressed_at_once_are_one_page(
    tmp_path: Path, placed: dict[str, Any], compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pixels = noise("u2", 700, 50, 3)
    saved(tmp_path / "in.tif", pixels, compression=compression, resolution=(300, 300), **placed)
    files = []
    for least in (1 << 24, 0):
        monkeypatch.setattr(tiff, "_LEAST", least)
        monkeypatch.setattr(image, "threads", lambda: 4)
        write(tmp_path / "out.tif", read(tmp_path / "in.tif"), force=True)
        found, page = stored(tmp_path / "out.tif")
        np.testing.assert_array_equal(found, pixels)
        tags = {tag.name: tag.value for tag in page.tags if not tag.name.endswith("Offsets")}
        with tifffile.TiffFile(tmp_path / "out.tif") as file:
            blocks = [file.filehandle.seek(at) and file.filehandle.read(size)
                      for at, size in zip(page.dataoffsets, page.databytecounts, strict=True)]  # fmt: skip
        files.append((tags, blocks))
    assert files[0] == files[1]
    assert len(files[1][1]) > 4


@pytest.mark.parametrize("placed", [{"rowsperstrip": 7}, {"tile": (32, 48)}])
@pytest.mark.parametrize("form", [{"byteorder": "<"}, {"byteorder": ">"}, {"bigtiff": True}])
def test_shares_of_rows_that_are_decoded_at_once_are_the_picture(
    tmp_path: Path, placed: dict[str, Any], form: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    pixels, path = noise("u2", 701, 53, 3), tmp_path / "in.tif"
    tifffile.imwrite(path, pixels, compression="zlib", photometric="rgb", **placed, **form)
    monkeypatch.setattr(tiff, "_LEAST", 0)
    monkeypatch.setattr(image, "threads", lambda: 2)
    assert len(tiff.Page(path).shares(2)) == 2
    assert tiff.Page(path).shares(16) == []  # of shares of a few strips, the table may be in the entry itself
    np.testing.assert_array_equal(read(path).pixels, pixels)
    data = path.read_bytes()
    with tifffile.TiffFile(path) as file:
        last = file.pages[0].dataoffsets[-1]
    path.write_bytes(data[:last] + bytes(len(data) - last))  # in the last share
    refused(read, path, match=r"in\.tif")
