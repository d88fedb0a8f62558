"""Pictures straightened by the command: frames, opacity, headers, recipes, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvips

import supple
from supple.files.recipes import read_recipe
from supple.media import image
from tests.cli.commands import GRAB, Run, noise, one_line, told

KEYSTONE = "6,4:42,6:45,36:3,33"
CORNERS = ((6, 4), (42, 6), (45, 36), (3, 33))


def test_strokes_and_all_of_it_are_one_resampling_as_in_python(run: Run, here: Path) -> None:
    assert run("warp", "in.png", "out.png", *GRAB, "--rotate", "-5", "--keystone", KEYSTONE, "--shear", "2,1")[0] == 0
    d = supple.Deformation((40, 48)).grab((20, 16), to=(23, 18), radius=12)
    expected = d.straighten(rotate=-5, keystone=CORNERS, shear=(2, 1)).warp(image.read("in.png").pixels)
    np.testing.assert_array_equal(image.read("out.png").pixels, expected)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_what_is_empty_is_transparent_where_the_format_has_that_and_else_the_fill(
    run: Run, here: Path, channels: int
) -> None:
    pixels = np.full((40, 48, channels), 200, np.uint8)
    pixels[..., -1] = 255 if channels in (2, 4) else 200
    image.write("grey.png", pixels[..., 0] if channels == 1 else pixels)
    assert run("warp", "grey.png", "pad.png", "--rotate", "20", "--fit", "pad")[0] == 0
    made = image.read("pad.png")
    assert made.alpha
    assert (made.pixels[0, 0] == 0).all()
    middle = made.pixels[made.pixels.shape[0] // 2, made.pixels.shape[1] // 2]
    np.testing.assert_array_equal(middle, [200] * (len(middle) - 1) + [255])
    assert run("warp", "grey.png", "fill.png", "--rotate", "20", "--fit", "keep", "--fill", "255")[0] == 0
    filled = image.read("fill.png")
    assert filled.pixels.shape[:2] == (40, 48)
    assert (filled.pixels[0, 0] == 255).all()
    assert filled.alpha == (channels in (2, 4))
    assert run("warp", "grey.png", "edge.png", "--rotate", "20", "--fit", "keep", "--outside", "edge")[0] == 0
    assert (image.read("edge.png").pixels[0, 0] >= 200).all()  # as asked


def test_a_jpeg_is_filled_with_black_and_keeps_its_size_and_its_profile_right(run: Run, here: Path) -> None:
    photo = pyvips.Image.new_from_array(noise(40, 48)).copy(interpretation="srgb").icc_transform("srgb")
    photo = photo.copy()
    photo.set_type(pyvips.GValue.gint_type, "orientation", 6)
    photo.set_type(pyvips.GValue.gstr_type, "exif-ifd0-Artist", "Somebody")
    photo.set_type(pyvips.GValue.gint_type, "exif-ifd2-PixelXDimension", 48)
    photo.jpegsave("turned.jpg", Q=95)
    assert run("warp", "turned.jpg", "out.jpg", "--rotate", "12", "--fit", "pad")[0] == 0
    made, was = pyvips.Image.new_from_file("out.jpg"), pyvips.Image.new_from_file("turned.jpg")
    width, height = supple.Straighten(12, fit="pad").on((40, 48))[1]  # of the picture as it is shown
    assert (made.width, made.height, made.bands) == (width, height, 3)
    assert made.get_typeof("orientation") == 0 or made.get("orientation") == 1
    assert made.get("icc-profile-data") == was.get("icc-profile-data")
    assert made.get("exif-ifd0-Artist").startswith("Somebody")
    if made.get_typeof("exif-ifd2-PixelXDimension"):
        assert made.get("exif-ifd2-PixelXDimension").startswith(str(width))
    assert np.abs(made.numpy()[0, 0].astype(int)).max() < 12


def test_sizes_are_written_in_two_ways(run: Run, here: Path) -> None:
    for k, size in enumerate(("30,20", "30x20", "30 X 20", "30×20")):
        assert run("warp", "in.png", f"{k}.png", "--scale-to", size)[0] == 0
        assert image.read(f"{k}.png").pixels.shape[:2] == (20, 30)
    (here / "in.raw").write_bytes(bytes(range(120)))
    for k, (shape, size) in enumerate((("6,5,4", "40,30"), ("6x5x4", "40x30"))):
        layout = ("--shape", shape, "--dtype", "uint8")
        assert run("render", "in.raw", f"view-{k}.png", *layout, "--size", size)[0] == 0
        assert image.read(f"view-{k}.png").pixels.shape[:2] == (30, 40)


def test_recipes_keep_it_and_options_change_parts_of_it(run: Run, here: Path) -> None:
    assert run("warp", "in.png", "a.png", *GRAB, "--rotate", "4", "--scale-to", "30", "--save-recipe", "r.json")[0] == 0
    straighten = read_recipe("r.json").straighten
    assert straighten == supple.Straighten(4, scale_to=(30,))
    assert run("warp", "in.png", "b.png", "--recipe", "r.json")[0] == 0
    np.testing.assert_array_equal(image.read("a.png").pixels, image.read("b.png").pixels)
    facts = told(run("warp", "in.png", "c.png", "--recipe", "r.json", "--fit", "pixels", "--fit", "keep", "--json"))
    assert (facts["width"], facts["height"]) == (30, 25)
    assert facts["within"]


def test_parts_and_other_spacings_are_those_of_the_result(run: Run, here: Path) -> None:
    assert run("warp", "in.png", "all.png", "--rotate", "5")[0] == 0
    assert run("warp", "in.png", "part.png", "--rotate", "5", "--crop", "4,3,20,10")[0] == 0
    whole = image.read("all.png").pixels
    np.testing.assert_array_equal(image.read("part.png").pixels, whole[3:13, 4:24])
    assert run("warp", "in.png", "half.png", "--rotate", "5", "--resample", "2")[0] == 0
    assert image.read("half.png").pixels.shape[:2] == tuple((n + 1) // 2 for n in whole.shape[:2])


def test_points_go_where_the_picture_shows_them(run: Run, here: Path) -> None:
    Path("points.csv").write_text("x,y\n20,16\n30,25\n")
    options = ("--rotate", "7", "--keystone", KEYSTONE)
    assert run("points", "points.csv", "moved.csv", "--on", "in.png", *options)[0] == 0
    moved = np.loadtxt("moved.csv", delimiter=",", skiprows=1, usecols=(0, 1))
    expected = supple.Deformation((40, 48)).straighten(rotate=7, keystone=CORNERS).forward([(20, 16), (30, 25)])
    np.testing.assert_allclose(moved, expected, atol=1e-5)
    Path("corner.csv").write_text("x,y\n54,46\n")
    padded = ("--rotate", "20", "--fit", "pad")  # 59 x 55 pixels
    status, _, err = run("points", "corner.csv", "from.csv", "--on", "in.png", *padded, "--inverse")
    assert (status, "outside" in err) == (0, False)
    with_another = ("--rotate", "20", "--reference", "in.png")
    assert "have each a grid" in run("points", "corner.csv", "x.csv", "--on", "in.png", *with_another)[2]
    part = (*options, "--crop", "3,2,20,20")  # whose pixels are counted from its own first one
    assert run("points", "points.csv", "part.csv", "--on", "in.png", *part)[0] == 0
    seen = np.loadtxt("part.csv", delimiter=",", skiprows=1, usecols=(0, 1))
    np.testing.assert_allclose(seen, moved - (3, 2), atol=1e-6)
    assert run("points", "part.csv", "back.csv", "--on", "in.png", *part, "--inverse")[0] == 0
    back = np.loadtxt("back.csv", delimiter=",", skiprows=1, usecols=(0, 1))
    np.testing.assert_allclose(back, [(20, 16), (30, 25)], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--rotate", "x"), "--rotate must be a number of degrees from -360 to 360, found 'x'"),
        (("--rotate", "1000"), "--rotate must be a number of degrees from -360 to 360"),
        (("--shear", "80"), "--shear must be one number of degrees or two"),
        (("--shear", "1,x"), "--shear must be one number of degrees or two, found '1,x'"),
        (("--keystone", "1,2:3,4"), "--keystone must be X,Y:X,Y:X,Y:X,Y"),
        (("--keystone", "42,6:6,4:45,36:3,33"), "--keystone must be four points: top left, top right"),
        (("--keystone", "23,4:25,4:47,39:0,39"), "--keystone must be a frame of less perspective"),
        (("--scale-to", "1.5"), "--scale-to must be a width"),
        ((*GRAB, "--fit", "crop"), "--fit crop is for a picture that is straightened"),
        (("--rotate", "2", "--fit", "crop", "--fit", "pad"), "--fit is given as crop and pad"),
        (("--rotate", "2", "--fit", "stretch"), "--fit is for a recipe"),
        (("--rotate", "2", "--reference", "in.png"), "--reference and a straightened picture have each a grid"),
    ],
)
def test_what_cannot_be_is_one_line(run: Run, here: Path, arguments: tuple[str, ...], said: str) -> None:
    status, _, err = run("warp", "in.png", "out.png", *arguments)
    assert status == 2
    assert said in one_line(err)
    assert not Path("out.png").exists()


@pytest.mark.parametrize(
    ("verb", "source", "target"),
    [("warp", "in.mp4", "out.mp4"), ("warp", "head.nii", "out.nii"), ("warp", "in.zarr", "out.zarr"),
     ("plot", "in.png", "plot.png"), ("plot", "in.mp4", "plot.png")],
)  # fmt: skip
def test_other_media_and_plots_say_that_it_is_for_pictures(
    run: Run, inputs: Path, verb: str, source: str, target: str
) -> None:
    status, _, err = run(verb, str(inputs / source), target, "--rotate", "3")
    assert status == 2
    assert "straighten" in one_line(err)
    assert not Path(target).exists()


def test_info_tells_of_it(run: Run) -> None:
    Path("r.json").write_text(
        '{"supple": 3, "straighten": {"rotate": -2.5, "fit": "pad", "scale_to": [300]}, "strokes": []}'
    )
    assert "  straighten  turn -2.5°; size 300; pad\n" in run("info", "r.json")[1]


def test_the_shape_that_tifffile_notes_is_not_passed_on(run: Run, tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite("in.tif", np.full((60, 80, 3), 9, np.uint8))
    assert run("warp", "in.tif", "out.tif", "--rotate", "10")[0] == 0
    with tifffile.TiffFile("out.tif") as file:
        assert "shape" not in file.pages[0].description
        assert file.series[0].shape == file.pages[0].shape


def test_black_corners_of_a_jpeg_are_said(run: Run, tmp_path: Path) -> None:
    pyvips.Image.black(60, 40, bands=3).copy(interpretation="srgb").jpegsave("in.jpg")
    code, _, err = run("warp", "in.jpg", "out.jpg", "--rotate", "10", "--fit", "pad")
    assert code == 0
    assert "out.jpg holds no opacity, and the empty corners are black: --fill names a colour" in err
    assert run("warp", "in.jpg", "white.jpg", "--rotate", "10", "--fit", "pad", "--fill", "255")[2] == ""
