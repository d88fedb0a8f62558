"""Volume files as pictures, turns around them, and the command for it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple import cli
from supple.cli import command
from supple.files.jobs import Job
from supple.files.options import VolumeOptions
from supple.files.renders import RenderOptions, default_transfer, render_file
from supple.media import image
from supple.media import volume as media
from supple.render.camera import Camera
from supple.render.labels import LabelColours
from supple.render.transfer import PRESETS
from supple.space.geometry import Geometry

SHAPE = (24, 30, 28)
GRAB = ["--grab", "13,14,11:17,14,11", "--radius", "9"]
RECIPE = supple.Recipe(
    strokes=[supple.Stroke.grab((13, 14, 11), to=(17, 14, 11), radius=9, reach=None)], border=64, on_fold="damp"
)


def head(low: float = 0, high: float = 200) -> npt.NDArray[np.int16]:
    """A ball with a nose, which looks to the front (-y)."""
    z, y, x = np.mgrid[: SHAPE[0], : SHAPE[1], : SHAPE[2]]
    skin = ((x - 13.5) ** 2 + (y - 16) ** 2 + (z - 11.5) ** 2 < 81) | (
        (abs(x - 13.5) < 2) & (abs(z - 11.5) < 2) & (y < 10) & (y > 2)
    )
    bone = (x - 13.5) ** 2 + (y - 16) ** 2 + (z - 11.5) ** 2 < 25
    return np.where(bone, high, np.where(skin, low + 0.6 * (high - low), low)).astype(np.int16)


def stored(path: str, samples: npt.NDArray[Any], *, series: bool = False) -> None:
    geometry = Geometry((1.0, 1.0, 1.2), (5.0, 6.0, 7.0), convention="LPS")
    media.write(path, samples, media.Volume(samples, geometry, series=series))


def test_a_picture(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    stored("in.nii.gz", head())
    assert command(["render", "in.nii.gz", "out.png", "--azimuth", "40", "--size", "60x50", "--json"]) == 0
    facts = json.loads(capfd.readouterr().out)
    assert (facts["width"], facts["height"], facts["minimum"], facts["maximum"]) == (60, 50, 0, 200)
    picture = image.read("out.png")
    assert picture.pixels.shape == (50, 60, 4)
    assert picture.alpha
    assert set(np.unique(picture.pixels[..., 3])) >= {0, 255}
    assert command(["render", "in.nii.gz", "b.jpg", "--background", "#ff0000", "--size", "60x50"]) == 0
    red = image.read("b.jpg").pixels
    assert red.shape == (50, 60, 3)
    assert (red[0, 0] > [240, -1, -1]).all()
    assert (red[0, 0] < [256, 30, 30]).all()


def test_strokes_are_seen(here: Path) -> None:
    stored("in.nii", head())
    pictures = {}
    for name, more in (("plain", []), ("exact", GRAB), ("buffered", GRAB)):
        mode = [] if name == "plain" else ["--mode", name]
        given = ["render", "in.nii", f"{name}.png", *more, *mode, "--size", "64x64", "--border", "6"]
        assert command(given if more else given[:-2]) == 0
        pictures[name] = image.read(f"{name}.png").pixels.astype(float)
    assert np.abs(pictures["buffered"] - pictures["exact"]).mean() < 4
    assert np.abs(pictures["plain"] - pictures["exact"]).mean() > 1

    # What was dragged to the patient's left is seen to the right.
    def middle(p: npt.NDArray[Any]) -> float:
        return float((p[..., 3].sum(axis=0) * np.arange(64)).sum() / p[..., 3].sum())

    assert middle(pictures["exact"]) > middle(pictures["plain"]) + 0.5


def test_world_points(here: Path) -> None:
    stored("in.nii", head())
    start, end = Geometry((1.0, 1.0, 1.2), (5.0, 6.0, 7.0)).to_lps(np.array([[13.0, 14, 11], [17, 14, 11]])) * [
        -1,
        -1,
        1,
    ]
    world = ":".join(",".join(f"{x:.4f}" for x in p) for p in (start, end))
    assert command(["render", "in.nii", "a.png", *GRAB, "--size", "40x40"]) == 0
    given = ["--grab", world, "--radius", "9", "--world"]
    assert command(["render", "in.nii", "b.png", *given, "--size", "40x40"]) == 0
    assert np.abs(image.read("a.png").pixels.astype(int) - image.read("b.png").pixels).max() <= 2


@pytest.mark.parametrize("suffix", [".nii", ".nrrd"])
def test_colours_are_as_opaque_as_their_luminance(here: Path, suffix: str) -> None:
    grey = head().astype(np.uint8)
    stored("grey.nii", np.rint(grey * 0.7152).astype(np.uint8))
    none = np.zeros_like(grey)
    stored(f"green{suffix}", np.stack([none, grey, none], axis=-1))
    half = np.where(np.arange(SHAPE[2]) < 14, 255, 0) * np.ones_like(grey)
    stored(f"clear{suffix}", np.stack([none, grey, none, half.astype(np.uint8)], axis=-1))
    options = RenderOptions(size=(40, 40), transfer="grey", mode="exact", camera=Camera(20, 10), shaded=False)
    seen = {}
    for name in ("grey.nii", f"green{suffix}", f"clear{suffix}"):
        render_file(
            Job(name, "out.png", supple.Recipe(strokes=RECIPE.strokes, border=6.0), force=True), options=options
        )
        seen[name[:5]] = image.read("out.png").pixels.astype(int)
    np.testing.assert_array_equal(seen["green"][..., 3], seen["grey."][..., 3])
    assert seen["green"][..., 1].max() > 120 > 10 > seen["green"][..., ::2].max()
    assert seen["clear"][..., 3].sum() < 0.7 * seen["grey."][..., 3].sum()
    assert seen["clear"][..., 3].max() > 100


def test_a_label_map_has_its_labels_colours_unless_another_transfer_is_asked_for(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    labels = np.zeros(SHAPE, np.int16)
    labels[5:20, 6:25, 5:14], labels[5:20, 6:25, 14:24] = 17, 53
    stored("labels.nii.gz", labels)
    volume = media.read("labels.nii.gz")
    assert default_transfer(volume) == "labels"
    noise = np.random.default_rng(0).integers(1, 2000, SHAPE).astype(np.int16)
    stored("many.nii", noise)
    many = media.read("many.nii")
    assert default_transfer(many) == "mr-head"
    many.header["intent_code"] = 1002
    assert default_transfer(many) == "labels"
    usual = ["--size", "40x40", "--unshaded", "--force"]
    palette = {tuple(np.rint(255 * row).astype(int).tolist()) for row in LabelColours().of([17, 53])}
    Path("t.txt").write_text("0 Unknown 0 0 0 0\n17 a 255 0 0 0\n53 b 0 0 255 0\n")
    for options, wanted in (
        (["--save-transfer", "t.ctbl"], palette),
        (["--transfer", "t.ctbl"], palette),
        (["--transfer", "t.txt"], {(255, 0, 0, 255), (0, 0, 255, 255)}),
        (["--transfer", "t.txt", "--density", "20,60"], {(0, 0, 255, 255)}),
    ):
        assert command(["render", "labels.nii.gz", "a.png", *usual, *options]) == 0
        pixels = image.read("a.png").pixels
        assert {tuple(row) for row in pixels[pixels[..., 3] > 0].tolist()} == wanted, options
    usual.remove("--unshaded")
    assert command(["render", "labels.nii.gz", "a.png", *usual, "--projection", "maximum"]) == 0
    assert (
        capfd.readouterr().err
        == "supple: labels.nii.gz is drawn as a label map, of 2 labels: --transfer grey draws values\n"
    )
    Path("t.ctbl").write_text("53 b 0 0 255 255\n")
    assert command(["render", "labels.nii.gz", "a.png", *usual, "--transfer", "t.ctbl"]) == 0
    assert "labels of labels.nii.gz without a colour are not seen: 17" in capfd.readouterr().err
    stored("half.nii", labels + np.float32(0.5))
    stored("rgb.nii", np.zeros((*SHAPE, 3), np.uint8))
    for arguments, told in (
        (
            ["labels.nii.gz", "b.png", "--save-transfer", "t.json"],
            "t.json: the colours of labels.nii.gz are",
        ),
        (["many.nii", "b.png", "--save-transfer", "u.ctbl"], "u.ctbl: many.nii is no label map"),
        (["half.nii", "b.png", "--transfer", "labels"], "half.nii: the labels must be whole numbers"),
        (["rgb.nii", "b.png", "--transfer", "labels"], "rgb.nii holds colours, and a label map has one number"),
        (["labels.nii.gz", "b.png", "--transfer", "none.ctbl"], "cannot read 'none.ctbl'"),
    ):
        assert command(["render", *arguments]) == 2
        assert told in capfd.readouterr().err
    assert not Path("b.png").exists()


def test_the_examples_of_the_help_bend_the_head_that_comes_along(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    shutil.copy(Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz", "head.nii.gz")
    head = media.read("head.nii.gz").samples
    Path("marks.fcsv").write_text("# CoordinateSystem = RAS\nF1,0,51,53,1,1\n", encoding="utf-8")
    texts = [line for line in cli._EXAMPLES.splitlines() if "head.nii.gz" in line]
    lines = [line.split() for line in texts if "view" not in line]
    assert len(lines) == 5
    for line in lines:
        more = ["--size", "40x40"] if line[1] == "render" else []
        given = ["12" if part == "120" else part for part in line[1:]]
        assert command([*given, *more, "--force"]) == 0, capfd.readouterr().err
        if "--grab" in line:  # in the head, near the skin, where it is seen
            x, y, z = (int(n) for n in line[line.index("--grab") + 1].split(":")[0].split(","))
            assert head[z, y, x] > 30
            assert head[z, y : y + 15, x].min() < 10
    assert (media.read("bent.nii.gz").samples != head).mean() > 0.01
    assert Path("moved.fcsv").read_text(encoding="utf-8") != Path("marks.fcsv").read_text(encoding="utf-8")
    assert capfd.readouterr().err == ""


def test_a_turn_as_a_video(here: Path) -> None:
    stored("in.nii", head())
    even = RenderOptions(turntable=8, size=(42, 52), rate=12.5)
    render_file(Job("in.nii", "turn.mp4"), options=even)
    with av.open("turn.mp4") as clip:
        frames = [f.to_ndarray(format="rgb24") for f in clip.decode(video=0)]
        assert clip.streams.video[0].average_rate == 12.5
    assert len(frames) == 8
    assert frames[0].shape == (42, 52, 3)
    # The nose is in the middle from the front, and beside from the left.
    assert np.abs(frames[0].astype(int) - frames[4]).mean() > 1


@pytest.mark.parametrize("suffix", [".webm", ".gif"])
def test_a_turn_as_a_video_of_any_size(here: Path, suffix: str) -> None:
    stored("in.nii", head())
    known = RenderOptions(turntable=6, size=(41, 51), rate=12, background=(0.2, 0.4, 0.6))
    render_file(Job("in.nii", f"turn{suffix}"), options=known)
    render_file(Job("in.nii", "turn/%d.png"), options=replace(known, rate=None))
    with av.open(f"turn{suffix}") as clip:
        decoded = list(clip.decode(video=0))
    times = np.array([float(f.pts * f.time_base) for f in decoded])
    np.testing.assert_allclose(times, np.arange(6) / 12, atol=0.006)
    for k, frame in enumerate(decoded):
        seen = frame.to_ndarray(format="rgb24")
        wanted = image.read(f"turn/{k}.png").pixels
        assert seen.shape == wanted.shape == (41, 51, 3)
        assert np.abs(seen.astype(int) - wanted).mean() < 3
    if suffix == ".gif":
        assert b"NETSCAPE2.0" in Path("turn.gif").read_bytes()  # it goes round


def test_a_turn_as_pictures(here: Path) -> None:
    stored("in.nii", head())
    known = RenderOptions(turntable=4, size=(40, 40), camera=Camera(10, 20))
    render_file(Job("in.nii", "turn/%02d.png"), options=known)
    assert sorted(p.name for p in Path("turn").iterdir()) == [f"{k:02d}.png" for k in range(4)]
    alone = render_file(Job("in.nii", "one.png"), options=RenderOptions(size=(40, 40), camera=Camera(100, 20)))
    np.testing.assert_array_equal(image.read("turn/01.png").pixels, image.read("one.png").pixels)
    assert alone.turned(Camera(10, 20), 1, 4) == Camera(100, 20)
    with pytest.raises(supple.SuppleError, match="exists already"):
        render_file(Job("in.nii", "turn/%02d.png"), options=known)
    render_file(Job("in.nii", "turn/%02d.png", force=True), options=known)


def test_inversions(here: Path) -> None:
    stored("in.nii", head())
    for mode in ("exact", "buffered"):
        assert command(["render", "in.nii", f"{mode}.png", *GRAB, "--mode", mode, "--what", "inversions"]) == 0
        assert image.read(f"{mode}.png").pixels.shape[2] >= 3


def test_presets_are_guessed() -> None:
    def guess(samples: npt.NDArray[Any], scaling: tuple[float, float] = (1.0, 0.0)) -> str:
        return default_transfer(media.Volume(samples, Geometry(), scaling=scaling))

    assert guess(head(-1000, 900)) == "ct-skin"
    assert guess((head(-1000, 900) + 1024).astype(np.uint16), (1.0, -1024.0)) == "ct-skin"
    assert guess(head()) == "labels"
    assert guess(head() + np.random.default_rng(0).integers(0, 9, SHAPE)) == "mr-head"
    assert guess(np.full((2, 2, 2), np.nan)) == "mr-head"


def test_density_and_transfer(here: Path) -> None:
    stored("in.nii", head(-1000, 900))
    Path("look.json").write_text(PRESETS["ct-bone"].to_json(), encoding="utf-8")
    given = ["render", "in.nii", "--distance", "120"]
    assert command([*given, "skin.png"]) == 0
    assert command([*given, "bone.png", "--transfer", "ct-bone"]) == 0
    assert command([*given, "json.png", "--transfer", "look.json"]) == 0
    assert command([*given, "inside.png", "--density", "500,2000"]) == 0
    seen = {p.stem: (image.read(p).pixels[..., 3] > 128).sum() for p in here.glob("*.png")}
    assert seen["bone"] == seen["json"] < 0.6 * seen["skin"]
    assert seen["inside"] < 0.6 * seen["skin"]


def test_series_and_raw(here: Path) -> None:
    stored("t.nii", np.stack([head(), 0 * head()]), series=True)
    for time, most in ((0, 255), (1, 0)):
        assert command(["render", "t.nii", f"{time}.png", "--time", str(time), "--transfer", "ct-skin"]) == 0
        assert image.read(f"{time}.png").pixels.shape == (512, 512, 4)
        assert most in np.unique(image.read(f"{time}.png").pixels[..., 3]) or time == 1
    Path("x.raw").write_bytes(head().astype("<i2").tobytes())
    shape = ",".join(map(str, SHAPE[::-1]))
    assert command(["render", "x.raw", "raw.png", "--shape", shape, "--dtype", "<i2"]) == 0
    options = VolumeOptions(layout=media.RawLayout(SHAPE[::-1], "<i2"))
    render_file(Job("x.raw", "raw2.png", volume=options))
    np.testing.assert_array_equal(image.read("raw.png").pixels, image.read("raw2.png").pixels)


BAD: list[tuple[list[str], str]] = [
    (["in.nii", "out.txt"], "out.txt"),
    (["in.nii", "out.mp4"], "--turntable"),
    (["in.nii", "out.png", "--turntable", "5"], "is one"),
    (["in.nii", "out.mp4", "--turntable", "1"], "--turntable must be a number of pictures from 2 to"),
    (["in.nii", "out.mp4", "--turntable", "4", "--size", "51x40"], "--size must be even"),
    (["in.nii", "out.mp4", "--turntable", "4", "--size", "51x40"], "found 51x40: give 52x40, or write .webm or .gif"),
    (["in.nii", "out.gif", "--turntable", "4", "--rate", "60"], "--rate must be at most 50"),
    (["in.nii", "out.gif"], "give --turntable"),
    (["in.nii", "out.png", "--transfer", "skull"], "ct-bone"),
    (["in.nii", "out.png", "--transfer", "none.json"], "none.json"),
    (["in.nii", "out.png", "--density", "3"], "LO,HI"),
    (["in.nii", "out.png", "--density", "3,1"], "lower one first"),
    (["in.nii", "out.png", "--clip", "3"], "--clip must be X0:X1,Y0:Y1,Z0:Z1 in voxels, with ends left out"),
    (["in.nii", "out.png", "--clip", "1:2,3,:"], "found '1:2,3,:'"),
    (["in.nii", "out.png", "--clip", ":,a:,:"], "--clip must be X0:X1,Y0:Y1,Z0:Z1"),
    (
        ["in.nii", "out.png", "--clip", ":,20:10,:"],
        "--clip must be from a lower to a higher voxel along each axis, found",
    ),
    (
        ["in.nii", "out.png", "--clip", "-3:,:,:"],
        "--clip must be within the voxels of the volume, 0:27, 0:29, 0:23, found -3:27 along x",
    ),
    (["in.nii", "out.png", "--clip", ":,:,:24"], "found 0:24 along z"),
    (["in.nii", "out.png", "--clip", "nan:,:,:"], "--clip must be numbers of voxels, found 'nan:,:,:'"),
    (["in.nii", "out.png", "--density", "300,400"], "nothing is seen of in.nii: its values go from 0 to 200"),
    (["in.nii", "out.png", "--rate", "12"], "--rate is of a turntable's video, and this is a picture: leave it"),
    (["in.nii", "%d.png", "--turntable", "3", "--rate", "12"], "--rate is of a video, and %d.png names pictures"),
    (["in.nii", "out.png", "--size", "big"], "--size"),
    (["in.nii", "out.png", "--size", "0x5"], "from 1 to"),
    (["in.nii", "out.png", "--background", "red"], "#1a1a1e"),
    (["in.nii", "out.png", "--elevation", "91"], "--elevation must be a number of degrees from -90 to 90"),
    (["in.nii", "out.png", "--azimuth", "left"], "--azimuth"),
    (["in.nii", "out.png", "--step", "0"], "--step must be millimetres from 0.001 to 1e9, found '0'"),
    (["in.nii", "out.png", "--smooth", "99"], "--smooth must be a number of rays along a pixel's side, from 1 to 8"),
    (["in.nii", "out.png", "--up", "0,0,0"], "a direction"),
    (["in.nii", "out.png", "--target", "1,2"], "three numbers"),
    (
        ["in.nii", "out.png", "--target", "13,14,99"],
        "--target must be a voxel of in.nii, from (0, 0, 0) to (27, 29, 23)",
    ),
    (["in.nii", "out.png", "--world"], "there are none"),
    (["in.nii", "out.png", "--what", "inversions", "--turntable", "4"], "leave turntable out"),
    (["in.nii", "out.png", "--what", "inversions", "--background", "#ffffff"], "leave background out"),
    (["in.nii", "out.txt", "--what", "inversions"], "out.txt"),
    (["in.nii", "there.png"], "there.png exists already: choose another name, or --force"),
    (["vectors.nrrd", "out.png"], "3 components of float32, and pictures are of one value or of colours"),
    (["t.nii", "out.png", "--time", "2"], "from 0 to 1"),
    (["photo.png", "out.png"], "photo.png"),
    (["missing.nii", "out.png"], "missing.nii"),
    (["in.nii", "out.png", "--grab", "1,1:2,2", "--radius", "3"], "three numbers"),
    (["in.nii", "no/out.png"], "there is no folder"),
]


@pytest.mark.parametrize(("given", "text"), BAD)
def test_bad_input(here: Path, capfd: pytest.CaptureFixture[str], given: list[str], text: str) -> None:
    stored("in.nii", head())
    stored("t.nii", np.stack([head(), head()]), series=True)
    stored("vectors.nrrd", np.stack([head()] * 3, axis=-1).astype(np.float32))
    image.write("photo.png", np.zeros((9, 9), np.uint8))
    image.write("there.png", np.zeros((9, 9), np.uint8))
    before = {p.name: p.read_bytes() for p in here.iterdir()}
    assert command(["render", *given]) == 2
    out, err = capfd.readouterr()
    assert text in err
    assert err.count("\n") == 1
    assert out == ""
    assert {p.name: p.read_bytes() for p in here.iterdir()} == before


WARNED: list[tuple[list[str], str]] = [
    (
        ["--transfer", "ct-bone"],
        "ct-bone is of Hounsfield units, where air is -1000 and water 0, and the values of",
    ),
    (["--distance", "3"], "the camera stands within what is visible of ct.nii: give another distance or target"),
    (["--distance", "9", "--azimuth", "90", "--clip", ":20,:,:"], ""),
]


@pytest.mark.parametrize(("given", "text"), WARNED)
def test_what_is_odd_is_told(here: Path, capfd: pytest.CaptureFixture[str], given: list[str], text: str) -> None:
    stored("ct.nii", head(0, 900))
    assert command(["render", "ct.nii", "out.png", "--size", "40x40", *given]) == 0
    err = " ".join(capfd.readouterr().err.split())
    assert text in err
    assert err.count("warning") == bool(text)


def test_values_between_two_shades_are_seen(here: Path) -> None:
    """A window of values that is narrower than an entry of the table."""
    samples = head(0, 20000)
    stored("in.nii", samples)
    value = float(samples[11, 16, 6])
    scene = render_file(Job("in.nii", "out.png"), options=RenderOptions(density=(value - 0.2, value + 0.2)))
    assert not scene.is_empty
    assert image.read("out.png").pixels[..., 3].any()


def test_a_transfer_function_appears_with_its_picture(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stored("in.nii", head())

    def full(*_: object, **__: object) -> None:
        raise supple.SuppleError("cannot write out.png: No space left on device")

    monkeypatch.setattr(image, "write", full)
    with pytest.raises(supple.SuppleError, match="No space left"):
        render_file(Job("in.nii", "out.png"), options=RenderOptions("grey", save_transfer="look.json", size=(8, 8)))
    assert [path.name for path in here.iterdir()] == ["in.nii"]


def test_a_recipe_is_not_replaced_by_a_transfer_function(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    head = str(Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz")
    recipe, look = tmp_path / "r.json", tmp_path / "look.json"
    recipe.write_text(before := supple.Recipe().to_json(), encoding="utf-8")
    options = ["--size", "40x40", "--force"]
    assert command(["render", head, str(tmp_path / "a.png"), "--save-transfer", str(recipe), *options]) == 2
    assert "r.json is there, and no transfer function: it is not replaced" in capfd.readouterr().err.replace("\n", " ")
    assert recipe.read_text(encoding="utf-8") == before
    for _ in range(2):
        assert command(["render", head, str(tmp_path / "a.png"), "--save-transfer", str(look), *options]) == 0


def test_soft_edges_of_a_mask_are_no_labels(here: Path) -> None:
    """Though there are few values in large areas."""
    z, y, x = np.indices(SHAPE)
    away = np.sqrt((z - 12) ** 2 + (y - 15) ** 2 + (x - 14) ** 2)
    for top, soft in ((255, 3.0), (100, 1.5), (20, 1.0)):
        mask = np.rint(top * np.clip(0.5 + (9 - away) / soft, 0, 1)).astype(np.uint8)
        assert default_transfer(media.Volume(mask, Geometry())) == "mr-head"
    sharp = np.where(away < 5, 3, np.where(away < 9, 2, np.where(away < 11, 1, 0))).astype(np.uint8)
    assert default_transfer(media.Volume(sharp, Geometry())) == "labels"
