"""Strokes that move with the frames of a clip: each frame is bent by a map of its own."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple import Key, Recipe, Stroke
from supple.errors import FoldWarning, OutsideWarning, SuppleError
from supple.files import warp_file
from supple.files.options import ClipOptions
from supple.files.tracking import follow_tracks
from supple.media import image
from tests import clips
from tests.files.clip_files import GRAB_2D, Run, noisy, pictures, refused, stack

KEYS = (Key(3, at=(20, 20), strength=0), Key(6, at=(30, 24), strength=1), Key(9, at=(44, 20), strength=0))
MOVING = Recipe(border=10, strokes=(Stroke(at=(20, 20), by=(4, 3), radius=6, keys=KEYS),))
PLAIN = Stroke(at=(50, 10), by=(0, 3), radius=4)


def warped(frames: Any, recipe: Recipe, **how: Any) -> Any:
    """Each frame as an image of its own."""
    shape = frames.shape[1:3]
    made = [supple.Deformation.from_recipe(recipe.at_frame(k), shape).warp(f, **how) for k, f in enumerate(frames)]
    return np.stack(made)


@pytest.mark.parametrize("pixel_format", ["gray", "yuv444p", "yuv444p10le", "gbrp10le"])
@pytest.mark.parametrize("amount", [1.0, 0.6])
def test_each_frame_is_what_its_own_recipe_makes(here: Path, pixel_format: str, amount: float) -> None:
    frames = stack(noisy("in.mkv", pixel_format))
    recipe = Recipe(border=10, strokes=(*MOVING.strokes, PLAIN), amount=amount)
    made = warp_file("in.mkv", "out.mkv", recipe)
    assert len(made.deformations) == made.frames == 12
    assert 0 < made.error <= made.tolerance == 0.01
    got, expected = stack("out.mkv"), warped(frames, recipe)
    if pixel_format.endswith("10le"):
        expected = np.minimum(expected, 1023)
    np.testing.assert_array_equal(got, expected)
    assert len({frame.tobytes() for frame in got}) == 12
    for k in (4, 6):
        report = made.report(k)
        assert report.within
        assert report.error <= 0.01
    assert made.report(6).arrivals[0].target == pytest.approx((30 + 4 * amount, 24 + 3 * amount))
    with pytest.raises(SuppleError, match="frame must be from 0 to 11, found 12"):
        made.report(12)


def test_frames_in_which_nothing_moves_are_passed_on(here: Path) -> None:
    noisy("in.mkv", "yuv420p")
    made = warp_file("in.mkv", "out.mkv", MOVING)
    assert made.still == 7  # of strength 0: frames 0 to 3, and 9 to 11
    assert made.deformations[0] is made.deformations[3]
    before, after = clips.decoded("in.mkv"), clips.decoded("out.mkv")
    same = [clips.rows(a) == clips.rows(b) for a, b in zip(before, after, strict=True)]
    assert same == [k in (0, 1, 2, 3, 9, 10, 11) for k in range(12)]


def test_pictures_and_folders_are_clips(here: Path) -> None:
    frames = pictures("in", count=12)
    for source, target in (("in/%03d.png", "a/%03d.png"), ("in", "b")):
        os.makedirs(target.split("/", 1)[0], exist_ok=True)
        warp_file(source, target, MOVING, filter="linear", outside="reflect", clip=ClipOptions(memory=0))
        names = sorted(os.listdir(target.split("/", 1)[0]))
        got = np.stack([image.read(f"{target[0]}/{name}").pixels for name in names])
        np.testing.assert_array_equal(got, warped(frames, MOVING, filter="linear", outside="reflect"))


def test_a_recipe_is_scaled_with_its_keys(here: Path) -> None:
    frames = stack(noisy("in.mkv", "yuv444p"))
    small = Recipe(border=10, strokes=MOVING.strokes, size=(64, 48)).fitted((32, 24))
    with pytest.warns(UserWarning, match="is scaled"):
        warp_file("in.mkv", "out.mkv", small)
    np.testing.assert_array_equal(stack("out.mkv"), warped(frames, small.fitted((64, 48))))


def test_a_stroke_may_leave_the_picture_and_is_warned_of_if_it_is_never_there(here: Path) -> None:
    frames = stack(noisy("in.mkv", "yuv444p"))
    leaving = Stroke(at=(30, 20), by=(3, 0), radius=3, keys=[Key(0, at=(30, 20)), Key(11, at=(300, 20))])
    warp_file("in.mkv", "out.mkv", Recipe(border=None, strokes=(leaving,)))
    np.testing.assert_array_equal(stack("out.mkv")[-5:], frames[-5:])
    away = Stroke(at=(-9, 20), by=(3, 0), radius=3, keys=[Key(0, at=(-9, 20)), Key(11, at=(-99, 20))])
    with pytest.warns(OutsideWarning, match="stroke 1 starts outside the picture, which has 64 x 48 .* in every frame"):
        warp_file("in.mkv", "away.mkv", Recipe(strokes=(away,)))
    late = Stroke(at=(9, 20), by=(3, 0), radius=3, keys=[Key(1001, at=(9, 20)), Key(1009, at=(19, 20))])
    with pytest.warns(
        OutsideWarning, match="in frames 1001 to 1009, and the clip has 12, from 0: it follows none of them"
    ):
        warp_file("in.mkv", "late.mkv", Recipe(strokes=(late,)))


def test_what_is_said_of_many_frames_is_one_warning(here: Path) -> None:
    noisy("in.mkv", "yuv444p")
    strong = Stroke(at=(30, 20), by=(20, 0), radius=8, keys=[Key(2, strength=0), Key(8, strength=1)])
    with pytest.warns(FoldWarning, match=r"^frame \d \(and in \d more\): ") as caught:
        warp_file("in.mkv", "out.mkv", Recipe(strokes=(strong,), on_fold="damp"))
    assert len(caught) == 1
    with pytest.raises(supple.FoldError, match=r"^frame \d: "):
        warp_file("in.mkv", "none.mkv", Recipe(strokes=(strong,), on_fold="error"))
    assert not os.path.exists("none.mkv")


def test_a_picture_has_no_frames(run: Run) -> None:
    pictures("in", count=1)
    Path("r.json").write_text(MOVING.to_json())
    refused(run("warp", "in/001.png", "out.png", "--recipe", "r.json"), "strokes with keys move from frame to frame")
    noisy("in.mkv", "yuv444p")
    Path("p.csv").write_text("x,y\n1,2\n")
    refused(run("points", "p.csv", "q.csv", "--on", "in.mkv", "--recipe", "r.json"), "move from frame to frame")
    for what in (["sheet"], ["slice", "--x", "3"], ["grid", "--frame", "6"]):
        assert run("plot", "in.mkv", "o.png", "--recipe", "r.json", "--force", "--what", *what)[0] == 0


def test_a_recipe_says_that_its_strokes_move(run: Run) -> None:
    Path("r.json").write_text(MOVING.to_json())
    status, out, _ = run("info", "r.json")
    assert status == 0
    assert "moving in frames 3 to 9, 3 keys, changing its strength in frames 3 to 9, 3 keys" in out
    noisy("in.mkv", "yuv444p")
    status, out, err = run("warp", "in.mkv", "out.mkv", "--recipe", "r.json", "--json")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    assert facts["moves"] is True
    assert (facts["frames"], facts["still"], facts["strokes"]) == (12, 7, 1)
    assert 0 < facts["error"] <= 0.01
    assert 0 < facts["margin"] < 1


def test_strokes_of_the_command_line_follow_a_track(run: Run) -> None:
    frames = stack(noisy("in.mkv", "yuv444p"))
    Path("t.csv").write_text("frame,x,y\n2,28,20\n5,34,22\n9,36,12\n")
    follow = ["--track", "t.csv", "--outside-track", "hold"]
    assert run("warp", "in.mkv", "out.mkv", *GRAB_2D, *follow, "--save-recipe", "r.json") == (0, "", "")
    stroke = Stroke.grab((30, 20), to=(34, 23), radius=12)
    keys = (Key(2, at=(30, 20)), Key(5, at=(36, 22)), Key(9, at=(38, 12)))
    (kept,) = Recipe.from_json(Path("r.json").read_text()).strokes
    assert kept == Stroke(at=stroke.at, by=stroke.by, radius=12, keys=keys)
    expected = warped(frames, Recipe(border=10, strokes=(kept,)))
    np.testing.assert_array_equal(stack("out.mkv"), expected)
    Path("t.nk").write_text("{{curve x1003 28.5 x1006 34.5 x1010 36.5} {curve x1003 27.5 x1006 25.5 x1010 35.5}}")
    assert run("warp", "in.mkv", "b.mkv", *GRAB_2D, "--track", "t.nk", "--track-first", "1001", *follow[2:]) == (
        0,
        "",
        "",
    )
    np.testing.assert_array_equal(stack("b.mkv"), expected)
    at = [*GRAB_2D, *follow, "--track-frame", "5", "--save-recipe", "at.json"]
    assert run("warp", "in.mkv", "c.mkv", *at)[0] == 0
    (late,) = Recipe.from_json(Path("at.json").read_text()).strokes
    assert late.at_frame(5).at == (30, 20)
    assert run("warp", "in.mkv", "d.mkv", *GRAB_2D, *follow[:2], "--save-recipe", "fading.json")[0] == 0
    (fading,) = Recipe.from_json(Path("fading.json").read_text()).strokes
    assert [fading.at_frame(k).strength for k in (-3, 2, 9, 14)] == [0, 1, 1, 0]
    np.testing.assert_array_equal(stack("d.mkv"), warped(frames, Recipe(border=10, strokes=(fading,))))


def test_a_stroke_turns_with_two_tracks(run: Run) -> None:
    frames = stack(noisy("in.mkv", "yuv444p", 4))
    Path("t.csv").write_text("frame,x,y,name\n0,30,20,a\n3,33,20,a\n0,40,20,b\n3,33,35,b\n")
    turn = ["--track", "t.csv", "--track-turn", "--save-recipe", "r.json"]
    assert run("warp", "in.mkv", "out.mkv", *GRAB_2D, *turn) == (0, "", "")
    (stroke,) = Recipe.from_json(Path("r.json").read_text()).strokes
    now = stroke.at_frame(3)
    assert now.at == (33, 20)
    assert (now.by, now.radius) == (pytest.approx((-4.5, 6)), 18)  # turned by 90 degrees, and 1.5 times as large
    np.testing.assert_array_equal(stack("out.mkv"), warped(frames, Recipe(border=10, strokes=(stroke,))))
    assert "turning in frames 0 to 3" in run("info", "r.json")[1]
    two = (*GRAB_2D, "--grab", "40,20:44,20")
    warp = ("warp", "in.mkv", "none.mkv")
    refused(run(*warp, *GRAB_2D, *turn[:2]), "name one for all, or one for each, or --track-turn to turn with two")
    refused(
        run(*warp, *two, *turn[:3], "--track-name", "a"), "t.csv has one track, and --track-turn turns strokes by two"
    )
    four = [word for name in "abba" for word in ("--track-name", name)]
    assert run("warp", "in.mkv", "two.mkv", *two, *turn[:3], *four)[0] == 0
    refused(run(*warp, *GRAB_2D, "--track-turn"), "--track-turn is for a --track, and there is none")
    refused(run(*warp, *GRAB_2D, "--outside-track", "hold"), "--outside-track is for a --track, and there is none")
    refused(
        run(*warp, *GRAB_2D, "--track", "auto", "--track-turn"),
        "--track-turn is for the --track of a file, not for auto",
    )
    Path("t.csv").write_text("frame,x,y,name\n0,30,20,a\n0,30,20,b\n")
    refused(run(*warp, *GRAB_2D, *turn[:3]), "the two tracks are at the same place in frame 0")


@pytest.mark.parametrize(("outside", "end"), [("fade", "fades beside it"), ("hold", "stays there")])
def test_a_track_of_one_frame_is_said(run: Run, outside: str, end: str) -> None:
    noisy("in.mkv", "yuv444p", 16)
    Path("t.csv").write_text("frame,x,y\n1004,30,20\n")
    follow = ("--track", "t.csv", "--outside-track", outside, "--first-frame", "1001", "--save-recipe", "r.json")
    status, _, err = run("warp", "in.mkv", "out.mkv", *GRAB_2D, *follow)
    assert (status, err.count("\n")) == (0, 1)
    assert f"t.csv: a track has frame 1004 alone: what follows it does not move, and {end}" in err
    (stroke,) = Recipe.from_json(Path("r.json").read_text()).strokes
    assert [stroke.at_frame(k).strength for k in (3, 10)] == [1, 0 if outside == "fade" else 1]


def test_tracks_by_name(run: Run) -> None:
    noisy("in.mkv", "yuv444p", 4)
    Path("t.csv").write_text("frame,x,y,name\n0,1,1,a\n3,4,1,a\n0,9,9,b\n3,9,12,b\n")
    two = Recipe(strokes=(Stroke(at=(20, 20), by=(1, 1), radius=5), Stroke(at=(30, 30), by=(1, 1), radius=5)))
    both = follow_tracks(two, "t.csv", "in.mkv").at_frame(3)
    assert [stroke.at for stroke in both.strokes] == [(23, 20), (30, 33)]
    last = follow_tracks(two, "t.csv", "in.mkv", names=["b"], strokes=[1]).at_frame(3)
    assert [stroke.at for stroke in last.strokes] == [(20, 20), (30, 33)]
    once = follow_tracks(two, "t.csv", "in.mkv", names=["b"]).at_frame(3)
    assert [stroke.at for stroke in once.strokes] == [(20, 23), (30, 33)]
    name = ["--track", "t.csv", "--track-name"]
    assert run("warp", "in.mkv", "out.mkv", *GRAB_2D, *name, "a") == (0, "", "")
    refused(run("warp", "in.mkv", "no.mkv", *GRAB_2D, *name, "c"), "t.csv has no track 'c': its tracks are 'a', 'b'")
    refused(run("warp", "in.mkv", "no.mkv", *GRAB_2D, "--track", "t.csv"), "t.csv has 2 tracks, 'a', 'b', for 1 stroke")


def test_options_of_tracks_that_lead_nowhere_are_refused(run: Run) -> None:
    noisy("in.mkv", "yuv444p", 4)
    Path("t.csv").write_text("frame,x,y\n0,1,1\n3,4,1\n")
    Path("r.json").write_text(Recipe(strokes=(PLAIN,)).to_json())
    warp = ("warp", "in.mkv", "out.mkv")
    refused(run(*warp, *GRAB_2D, "--track-first", "1"), "--track-first is for a --track, and there is none")
    refused(run(*warp, "--recipe", "r.json", "--track", "t.csv"), "there are none: give a --grab")
    refused(run(*warp, *GRAB_2D, "--track", "t.csv", "--track-frame", "x"), "must be the number of a frame (0, say)")
    timed = ("--grab", "30,20,1:33,22,2", "--radius", "10")
    refused(run(*warp, *timed, "--track", "t.csv"), "keys are for strokes with points of 2 numbers")
    assert not os.path.exists("out.mkv")


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ((Key(100, strength=0), Key(120, strength=1)), "no stroke moves a pixel of any frame of in.mkv"),
        ((Key(0, at=(-20, -20)), Key(11, at=(-30, -20))), "in every frame"),
    ],
)
def test_a_stroke_that_moves_no_pixel_is_said(
    here: Path, keys: tuple[Key, ...], told: str, recwarn: pytest.WarningsRecorder
) -> None:
    noisy("in.mkv", "yuv420p", 12)
    warp_file("in.mkv", "out.mkv", Recipe(strokes=[Stroke(at=(30, 20), by=(4, 0), radius=4, keys=keys)]))
    assert any(told in str(each.message) for each in recwarn)
