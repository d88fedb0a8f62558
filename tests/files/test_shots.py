"""Parts of clips: frames that are held, a part that is bent, one frame alone; and how frames are typed."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple import Key, Recipe, Stroke, SuppleError
from supple.files import warp_file
from supple.files.clips import fade_of
from supple.files.options import ClipOptions
from supple.media import image
from tests import clips
from tests.files.clip_files import FLAT, GRAB, GRAB_2D, TIMED, Run, noisy, pictures, refused, stack

WIDE = Recipe(strokes=(Stroke.grab((30, 20, 14), to=(33, 22, 19), radius=14),))
KEYED = Recipe(strokes=(Stroke(at=(30, 20), by=(4, 3), radius=12, keys=(Key(0, at=(30, 20)), Key(29, at=(40, 24)))),))
INTRA = [
    ("ffv1", "yuv420p", "mkv", {"g": "1"}),
    ("prores_ks", "yuv422p10le", "mov", {}),
    ("mjpeg", "yuvj422p", "mov", {}),
    ("dnxhd", "yuv422p", "mov", {"profile": "dnxhr_hq"}),
    ("dnxhd", "yuv422p10le", "mov", {"profile": "dnxhr_hqx"}),
]


def rows(path: str) -> list[Any]:
    return [clips.rows(frame) for frame in clips.decoded(path)]


@pytest.mark.parametrize("recipe", [WIDE, FLAT, KEYED], ids=["timed", "flat", "keyed"])
def test_a_part_is_that_of_the_whole_and_the_rest_is_as_it_was(here: Path, recipe: Recipe) -> None:
    noisy("in.mkv", "yuv420p", 30, options={"g": "1"})
    warp_file("in.mkv", "whole.mkv", recipe)
    made = warp_file("in.mkv", "part.mkv", recipe, frames=(9, 17))
    before, whole, part = rows("in.mkv"), rows("whole.mkv"), rows("part.mkv")
    assert whole[9:18] != before[9:18]
    assert part == before[:9] + whole[9:18] + before[18:]
    assert (made.frames, made.still, made.copied) == (30, 21, 21)


def test_the_command_tells_of_the_frames_that_are_bent(run: Run, here: Path) -> None:
    noisy("in.mkv", "gray", 30, options={"g": "1"})
    Path("r.json").write_text(KEYED.to_json())
    for k, part in enumerate((("--frames", "9-17"), ("--hold", "2"), ("--frame", "12"))):
        status, out, err = run(
            "warp", "in.mkv", f"out{k}.{'png' if k > 1 else 'mkv'}", "--recipe", "r.json", *part, "--json"
        )
        assert (status, err) == (0, "")
        told = json.loads(out)
        assert (told["strokes"], told["frames"]) == (1, 1 if k > 1 else 30)
        assert told["arrivals"][0]["miss"] < 1e-6
        assert told["copied"] == told["still"] >= (21, 4, 0)[k]


@pytest.mark.parametrize("codec", ["ffv1", "libx264"])
@pytest.mark.parametrize("recipe", [WIDE, FLAT, KEYED, replace(WIDE, strokes=())], ids=["timed", "flat", "keyed", "no"])
def test_one_frame_is_that_of_the_whole(here: Path, codec: str, recipe: Recipe) -> None:
    options = {"g": "5", "bf": "2"} if codec == "libx264" else {}
    clips.make("in.mkv", codec, "yuv444p", count=30, smooth=False, options=options)
    warp_file("in.mkv", "whole/%03d.png", recipe)
    for k in (0, 16, 29):
        made = warp_file("in.mkv", "one.png", recipe, frame=k, force=True)
        np.testing.assert_array_equal(image.read("one.png").pixels, image.read(f"whole/{k + 1:03d}.png").pixels)
        assert made.frames == 1


def test_one_frame_decodes_no_more_than_it_needs(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clips.make("in.mkv", "libx264", count=200, smooth=False, options={"g": "10", "bf": "0"})
    decoded = []
    check = supple.media.video.Clip._check
    monkeypatch.setattr(supple.media.video.Clip, "_check", lambda *given: decoded.append(check(*given)))
    local = Recipe(strokes=(Stroke.grab((30, 20, 150), to=(33, 22, 152), radius=4),))
    made = warp_file("in.mkv", "one.png", local, frame=151)
    assert made.held < 20
    assert made.held <= len(decoded) < 40  # and those ahead, in the threads of the decoder


def test_one_frame_of_a_sequence_is_written_as_one_of_these(here: Path) -> None:
    pictures("in", 8, dtype=np.uint16, first=1001)
    warp_file("in/%03d.png", "out/%03d.png", TIMED)
    warp_file("in/%03d.png", "one.png", TIMED, frame=4)
    assert image.read("one.png").pixels.dtype == np.uint16
    np.testing.assert_array_equal(image.read("one.png").pixels, image.read("out/1005.png").pixels)
    warp_file("in", "two.png", FLAT, frame=4)  # a folder, which is a clip then
    assert sorted(os.listdir()) == ["in", "one.png", "out", "two.png"]


@pytest.mark.parametrize(
    ("codec", "pixel_format", "suffix", "options", "recipe"), [*((*row, WIDE) for row in INTRA), (*INTRA[0], FLAT)]
)
def test_held_frames_keep_every_bit_and_their_packets(
    here: Path, codec: str, pixel_format: str, suffix: str, options: dict[str, str], recipe: Recipe
) -> None:
    size = (256, 128) if codec == "dnxhd" else clips.SIZE
    source = clips.make(f"in.{suffix}", codec, pixel_format, count=30, smooth=False, options=options, size=size)
    made = warp_file(source, f"out.{suffix}", recipe, hold=3)
    before, after = (clips.parcels(f"{name}.{suffix}", "video") for name in ("in", "out"))
    copies = [a == b for (a, *_), (b, *_) in zip(before, after, strict=True)]
    assert copies[:3] == copies[27:] == [True] * 3
    assert not any(copies[8:22])
    assert made.copied == made.still >= 6
    a, b = rows(f"in.{suffix}"), rows(f"out.{suffix}")
    assert (a[:3], a[27:]) == (b[:3], b[27:])
    assert a[15] != b[15]


@pytest.mark.parametrize("recipe", [WIDE, replace(WIDE, border=None), replace(WIDE, border=(10, 10, 4))])
def test_strokes_fade_smoothly_towards_held_frames(here: Path, recipe: Recipe) -> None:
    noisy("in.mkv", "gray", 30)
    made = warp_file("in.mkv", "out.mkv", recipe, hold=2)
    d = made.deformation
    at = np.array([(x, y, t) for t in (0.0, 1, 28, 29) for x in (10, 30, 50) for y in (8, 20, 40)])
    np.testing.assert_array_equal(d.forward(at), at)
    assert d.report().margin > 0
    points = np.random.default_rng(1).uniform((0, 0, 0), (63, 47, 29), (500, 3))
    np.testing.assert_allclose(d.forward(d.inverse(points).points), points, atol=1e-5)
    np.testing.assert_allclose(d.forward((30, 20, 14)), (33, 22, 19), atol=1e-6)
    # The displacement is that of strokes under a mask along time: a cubic spline, of which K is a multiple.
    plain = supple.Deformation.from_recipe(replace(recipe, strokes=()), d.grid, time=True)
    weak = Stroke.grab((30, 20, 14), by=(0.5, 0.2, 0.1), radius=14)
    masked = supple.Deformation.from_recipe(replace(recipe, strokes=(weak,), freeze=d.domain.freeze), d.grid, time=True)
    free = plain.add(weak)
    m = fade_of((30, 1, 1), 2, None if recipe.border is None else (3.0 if recipe.border == "auto" else 4.0)).at(
        [[0], [0], points[:, 2]]
    )
    np.testing.assert_allclose(
        masked.forward(points) - points, m.reshape(-1, 1) * (free.forward(points) - points), atol=2e-3
    )


@pytest.mark.parametrize(("count", "hold", "width"), [(30, 2, None), (47, 1, None), (61, 3, 11.5), (60, 2, 20.0)])
def test_a_fade_is_alike_at_both_ends_and_as_wide_as_it_says(count: int, hold: int, width: float | None) -> None:
    m = fade_of((count, 1, 1), hold, width).at([[0], [0], np.arange(count)]).ravel()
    wide = max(4.0, count / 10) if width is None else width
    np.testing.assert_allclose(m, m[::-1], atol=1e-6)
    assert (m[:hold] == 0).all()
    assert m[hold] > 0
    assert (m[hold - 1 + int(np.ceil(wide)) : count // 2] > 1 - 1e-6).all()
    assert m[hold - 2 + int(wide)] < 1
    # A cubic ramp, of which the spline averages three frames as 1 : 4 : 1.
    t = np.clip((np.arange(-1, count // 2 + 1) - hold) / (wide - 2), 0, 1)
    ramp = 3 * t**2 - 2 * t**3
    np.testing.assert_allclose(m[: count // 2], (ramp[:-2] + 4 * ramp[1:-1] + ramp[2:]) / 6, atol=1 / 255)


def test_a_stroke_that_is_held_back_says_so(here: Path) -> None:
    noisy("in.mkv", "gray")
    with pytest.warns(supple.MissWarning, match="short: what is held at the ends of the clip holds it back"):
        warp_file("in.mkv", "out.mkv", TIMED, hold=2)


def test_frames_of_a_fade_are_the_strokes_in_part(here: Path) -> None:
    noisy("in.mkv", "gray", 30)
    parts = fade_of((30, 1, 1), 2).at([[0], [0], np.arange(30)]).ravel()
    assert (parts[:2] == 0).all()
    assert (np.diff(parts[:9]) >= 0).all()
    assert (parts[9:21] == 1).all()
    for recipe in (FLAT, KEYED):
        made = warp_file("in.mkv", "out.mkv", recipe, hold=2, force=True)
        for k in (0, 4, 5, 15):
            now = replace(recipe.at_frame(k), amount=float(parts[k]))
            assert made.deformations[k] == supple.Deformation.from_recipe(now, (48, 64))


def test_held_frames_under_a_freeze_mask(here: Path) -> None:
    noisy("in.mkv", "gray", 30)
    mask = np.zeros((48, 64), bool)
    mask[:, :12] = True
    recipe = replace(WIDE, freeze=supple.Freeze.of(mask))
    d = warp_file("in.mkv", "out.mkv", recipe, hold=2).deformation
    m = recipe.freeze.at([np.arange(64), np.arange(48)])
    both = d.domain.freeze.at([np.arange(64), np.arange(48), np.arange(30)])
    ends = fade_of((30, 1, 1), 2, 3.0).at([[0], [0], np.arange(30)])
    np.testing.assert_allclose(both, ends * m, atol=1 / 255)
    frames, after = stack("in.mkv"), stack("out.mkv")
    np.testing.assert_array_equal(after[:, :, :12], frames[:, :, :12])
    np.testing.assert_array_equal(after[[0, 1, 28, 29]], frames[[0, 1, 28, 29]])
    assert (after[15] != frames[15]).any()


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_files_of_unchanged_pictures_are_copied(here: Path, suffix: str) -> None:
    pictures("in", 14, names=f"{{:03d}}.{suffix}")
    made = warp_file(f"in/%03d.{suffix}", f"out/%03d.{suffix}", TIMED, hold=2)
    same = [
        Path(f"in/{k:03d}.{suffix}").read_bytes() == Path(f"out/{k:03d}.{suffix}").read_bytes() for k in range(1, 15)
    ]
    assert same[:2] == same[-2:] == [True] * 2
    assert made.copied == made.still >= 4
    assert warp_file(f"in/%03d.{suffix}", "other/%03d.bmp", TIMED, hold=2).copied == 0


def test_frames_as_an_artist_types_them(run: Run, here: Path) -> None:
    pictures("in", 30, names="f.{:04d}.png", first=1001)
    grab = ("--radius", "10", "--border", "none")
    assert run("warp", "in/f.%04d.png", "a/f.%04d.png", "--grab", "30,20,3:33,22,8", *grab)[0] == 0
    same = [
        ("--grab", "30,20,1004:33,22,1009", "--first-frame", "1001"),
        ("--grab", "30,20,1004:33,22,1009", "--first-frame", "files"),
        ("--grab", "30,20,00:00:00:03:33,22,00:00:00:08"),
        ("--grab", "30,20,3:33,22,00:00:00:08"),
        ("--grab", "30,20,00:00:00:03:33,22,1009", "--first-frame", "1001"),
    ]
    for k, given in enumerate(same):
        status, _, err = run("warp", "in/f.%04d.png", f"b{k}/f.%04d.png", *given, *grab)
        assert (status, err) == (0, "")
        assert all(Path(f"b{k}", p.name).read_bytes() == p.read_bytes() for p in Path("a").iterdir())
    for frame in (("--frame", "1007", "--first-frame", "files"), ("--frame", "00:00:00:06")):
        assert run("warp", "in/f.%04d.png", "one.png", *frame, *same[2], *grab, "--force")[0] == 0
        np.testing.assert_array_equal(image.read("one.png").pixels, image.read("a/f.1007.png").pixels)
    part = ("--frames", "1005-00:00:00:08", "--first-frame", "1001", "--json")
    status, out, err = run("warp", "in/f.%04d.png", "c/f.%04d.png", *same[0][:2], *grab, *part)
    assert (status, err) == (0, "")
    assert (status, json.loads(out)["still"], json.loads(out)["copied"]) == (0, 25, 25)


def test_timecodes_of_a_clip_that_has_some(run: Run, here: Path) -> None:
    clips.make("in.mov", "libx264", count=30, rate=25, tags={"timecode": "10:00:00:00"})
    status, out, _ = run("info", "in.mov")
    assert status == 0
    assert "timecode    10:00:00:00 to 10:00:01:04" in out
    one = ("warp", "in.mov", "one.png", *GRAB)
    assert run(*one, "--frame", "10:00:00:05")[0] == 0
    assert run("warp", "in.mov", "two.png", *GRAB, "--frame", "5")[0] == 0
    assert Path("one.png").read_bytes() == Path("two.png").read_bytes()
    refused(
        run(*one, "--frame", "00:00:00:05", "--force"),
        "--frame must be from 10:00:00:00 to 10:00:01:04, the frames of in.mov",
    )
    refused(run(*one, "--frame", "10:00:00;05", "--force"), "is no timecode of in.mov, which is of 25 frames a second")
    assert run("plot", "in.mov", "grid.png", *GRAB, "--frame", "10:00:00:05")[0] == 0
    Path("t.csv").write_text("frame,x,y\n10:00:00:00,30,20\n10:00:00:20,40,20\n")
    Path("u.csv").write_text("frame;x;y\n0;30;20\n20;40;20\n")
    for name in ("t", "u"):
        follow = ("--track", f"{name}.csv", "--save-recipe", f"{name}.json")
        assert run("warp", "in.mov", f"{name}.mkv", *GRAB_2D, *follow)[0] == 0
    assert Path("t.json").read_bytes() == Path("u.json").read_bytes()
    text = Path("u.json").read_text()
    assert '"frame": 20' in text
    Path("v.json").write_text(text.replace('"frame": 20', '"frame": "10:00:00:20"'))
    assert run("warp", "in.mov", "v.mkv", "--recipe", "v.json", "--save-recipe", "w.json")[0] == 0
    assert Path("w.json").read_text() == text


def test_a_video_becomes_pictures_from_its_first_frame_on(run: Run, here: Path) -> None:
    noisy("in.mkv", "yuv444p")
    grab = ("--grab", "30,20,1004:33,22,1009", "--radius", "10", "--border", "none", "--first-frame", "1001")
    assert run("warp", "in.mkv", "out/f.####.png", *grab) == (0, "", "")
    assert sorted(os.listdir("out")) == [f"f.{k}.png" for k in range(1001, 1013)]


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (("--frames", "3"), "--frames must be the first and the last frame, A-B (1010-1035, say), found '3'"),
        (("--frames=-1",), "--frames must be the first and the last frame, A-B (1010-1035, say), found '-1'"),
        (("--frames", "7-3"), "--frames 7-3: frame 7 comes after 3: give the earlier one first"),
        (("--frames", "9-5", "--first-frame", "2"), "--frames 9-5: frame 9 comes after 5: give the earlier one first"),
        (("--frames", "3-12"), "--frames must be from 0 to 11, the frames of in.mkv, found 12"),
        (("--frames", "3-14", "--first-frame", "2"), "--frames must be from 2 to 13, the frames of in.mkv, found 14"),
        (("--frames", "3-x"), "--frames must be the number of a frame (0, say) or a timecode (00:00:00:00), found 'x'"),
        (("--frame", "3"), "the suffix .mkv is no image format"),
        (("--frame", "3", "--frames", "2-5"), "--frame writes one frame, and --frames are some"),
        (("--hold", "-1"), "--hold must be a whole number from 0, found '-1'"),
        (("--hold", "6"), "--hold 6 keeps all 12 frames of in.mkv: keep fewer than half"),
        (("--first-frame", "x"), "--first-frame must be a whole number, or files, found 'x'"),
        (("--first-frame", "files"), "in.mkv has no numbers in its names: give --first-frame a number"),
    ],
)
def test_parts_that_are_none_are_refused(run: Run, here: Path, options: tuple[str, ...], wanted: str) -> None:
    noisy("in.mkv", "gray")
    refused(run("warp", "in.mkv", "out.mkv", *GRAB, *options), wanted)
    assert not Path("out.mkv").exists()


def test_parts_are_for_clips(run: Run, here: Path) -> None:
    pictures("in", 1)
    shutil.copy("in/001.png", "in.png")
    refused(run("warp", "in.png", "out.png", *GRAB_2D, "--hold", "2"), "--hold is for clips, and in.png is a picture")
    with pytest.raises(SuppleError, match="frames must be the first and the last frame"):
        warp_file("in/%03d.png", "out.mp4", FLAT, clip=ClipOptions(frames=(3,)))  # type: ignore[arg-type]


def test_messages_of_strokes_have_the_numbers_that_are_typed(run: Run, here: Path) -> None:
    pictures("in", 12, names="f.{:04d}.png", first=1001)
    warp = ("warp", "in/f.%04d.png", "out/f.%04d.png", "--radius", "10")
    for first in ((), ("--first-frame", "files")):
        k = 1001 if first else 0
        grab = ("--grab", f"30,20,{k + 3}:33,22,{k + 20}")
        said = f"a drag by (3, 2, 17) at (30, 20, {k + 3}) with radius 10 cannot arrive: its target is on the edge"
        refused(run(*warp, *grab, *first), f"{said} or outside of (0, 0, {k}) to (64, 48, {k + 12})")
        refused(run("plot", warp[1], "grid.png", *warp[3:], *grab, *first, "--frame", str(k + 3)), said)
        far = ("--grab", f"30,20,{k + 13}:33,22,{k + 13}", "--border", "none")
        status, _, err = run(*warp, *far, *first, "--force")
        assert status == 0
        assert f"at (30, 20, {k + 13}) with radius 10 starts outside the clip, which has" in err
        assert f"12 frames (from {k})" in err
    recipe = Recipe(strokes=(Stroke.grab((30, 20, 3), to=(33, 22, 20), radius=10),))
    with pytest.raises(SuppleError, match=r"at \(30, 20, 103\) with"):
        warp_file("in/f.%04d.png", "no/f.%04d.png", recipe, clip=ClipOptions(first_frame=100))
    twice = Recipe(strokes=(Stroke.pull([(30, 20, 3)] * 2, by=[(3, 2, 0)] * 2, radius=10),))
    with pytest.raises(SuppleError, match=r"has two handles at \(30, 20, 103\), 1 and 2"):
        warp_file("in/f.%04d.png", "no/f.%04d.png", twice, clip=ClipOptions(first_frame=100))


def test_between_is_an_argument_as_well(here: Path) -> None:
    noisy("in.mkv", "gray")
    made = warp_file("in.mkv", "out.mkv", TIMED, between="nearest")
    assert made.between == "nearest"
    warp_file("in.mkv", "same.mkv", TIMED, clip=ClipOptions(between="nearest"))
    np.testing.assert_array_equal(stack("out.mkv"), stack("same.mkv"))
    with pytest.raises(
        SuppleError,
        match="frames must be the first and the last frame, counted from 0, in this order, "
        r"found \(7, 3\)",
    ):
        warp_file("in.mkv", "out.mkv", TIMED, frames=(7, 3), force=True)


def test_warnings_have_the_numbers_that_are_typed(run: Run, here: Path) -> None:
    pictures("in", 12, names="f.{:04d}.png", first=1001)
    Path("t.csv").write_text("frame,x,y\n1001,30,20\n1007,90,20\n")
    follow = ("--track", "t.csv", "--first-frame", "files", "--frames", "1001-1009")
    warp = ("warp", "in/f.%04d.png", "out/f.%04d.png", *GRAB_2D, *follow)
    refused(run(*warp), "frame 1004: a drag by (4, 3) at (60, 20) with radius 12 cannot arrive")
    strong = ("--grab", "30,20:60,20", "--radius", "8", "--on-fold", "damp", "--track", "t.csv", "--border", "none")
    Path("t.csv").write_text("frame,x,y\n1001,30,20\n1007,40,20\n")
    status, _, err = run(
        "warp", "in/f.%04d.png", "out/f.%04d.png", *strong, "--first-frame", "1001", "--frames", "1003-1005"
    )
    assert status == 0
    assert "warning: frame 1003 (and in 2 more): a drag by (30, 0)" in err
    refused(run("warp", "in/f.1001.png", "one.png", *GRAB_2D, "--first-frame", "7"), "--first-frame is for clips")
