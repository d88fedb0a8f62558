"""Points tracked through clips: photographs that move by known amounts, and what makes a point go lost."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Sequence
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import affine_transform

import supple
from supple.errors import SuppleError, TrackWarning
from supple.files.tracking import track
from supple.media import image
from supple.media.tracks import read_tracks
from tests import clips
from tests.files.clip_files import Run, noisy, refused

Numbers = npt.NDArray[np.float64]
DATA = Path(supple.__file__).parent / "examples" / "data"
SIZE = (200, 150)  # of the frames
CENTRE = np.array([100.0, 75.0])
SPOT = (100.0, 75.0)


def photograph(name: str = "chelsea.jpg") -> Numbers:
    return image.read(DATA / name).pixels.astype(np.float64) @ [0.299, 0.587, 0.114]


@functools.cache
def moved(count: int, angle: float = 0.0, zoom: float = 0.0, seed: int = 3) -> tuple[list[Numbers], Numbers]:
    """Frames of a photograph that shifts, turns and grows, from 0 to 255; and where `SPOT` of frame 0 is in each."""
    picture, (width, height) = photograph(), SIZE
    shifts = np.cumsum(np.random.default_rng(seed).normal(0, 1.3, (count, 2)), axis=0)
    shifts -= shifts[0]
    frames = []
    for k, shift in enumerate(shifts):
        turn, size = np.deg2rad(angle * k), 1 + zoom * k
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) / size
        middle = np.array([160.0, 140.0])  # of the photograph, where the eye is
        rows = back[::-1, ::-1]  # y first
        offset = middle[::-1] - rows @ (CENTRE + shift)[::-1]
        frames.append(affine_transform(picture, rows, offset, (height, width), order=3, mode="mirror"))
    return frames, CENTRE + shifts


def written(
    name: str, frames: Sequence[Numbers], pixel_format: str = "gray", scale: float = 1.0, low: float = 0
) -> str:
    """A clip without loss, whose luma, or red, green and blue, is that of the frames."""
    with av.open(name, "w") as out:
        stream = out.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = *frames[0].shape[::-1], pixel_format
        for luma in frames:
            frame = clips.noise(pixel_format, frames[0].shape[::-1], 0)
            deep = frame.format.components[0].bits > 8
            values = np.clip(np.rint(luma * scale + low), 0, 1023 if deep else 255).astype("<u2" if deep else np.uint8)
            for plane in frame.planes[: 3 if pixel_format.startswith("gbr") else 1]:
                rows = np.zeros((plane.height, plane.line_size // values.itemsize), values.dtype)
                rows[:, : plane.width] = values
                plane.update(rows.tobytes())
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return name


@pytest.mark.parametrize(
    ("pixel_format", "scale", "low"),
    [
        ("gray", 1, 0),
        ("gray10le", 0.25, 64),  # dark: a quarter of 8 bits' steps
        ("yuv420p", 0.8, 16),
        ("yuv444p", 0.8, 16),
        ("yuv422p10le", 3, 64),
        ("yuva420p", 1, 0),
        ("gbrp10le", 4, 0),
    ],
)
def test_a_photograph_that_shifts_is_followed_to_a_tenth_of_a_pixel(
    here: Path, pixel_format: str, scale: float, low: float
) -> None:
    frames, truth = moved(15)
    written("in.mkv", frames, pixel_format, scale, low)
    for k in (0, 7, 14):
        (found,) = track("in.mkv", [(*truth[k], k)])
        assert found.frames.tolist() == list(range(15))
        assert found.lost == ()
        assert np.linalg.norm(found.points - truth, axis=1).max() <= 0.1
        assert found.errors[k] == 0
        assert 0 < found.errors.max() <= 0.3
        assert tuple(found.points[k]) == tuple(truth[k])


@pytest.mark.parametrize(("angle", "zoom"), [(0.5, 0), (0, 0.006), (-0.4, -0.004)])
def test_what_turns_and_grows_does_not_drift(here: Path, angle: float, zoom: float) -> None:
    frames, truth = moved(50, angle, zoom)
    (found,) = track(written("in.mkv", frames), [(*SPOT, 0)])
    assert len(found.frames) == 50
    assert np.linalg.norm(found.points - truth, axis=1).max() <= 0.1


def test_noise_and_changes_of_light_are_endured(here: Path) -> None:
    frames, truth = moved(30, 0.2)
    rng = np.random.default_rng(0)
    seen = [0.9 * frame * (1 - 0.01 * k) + rng.normal(6, 3, frame.shape) for k, frame in enumerate(frames)]
    (found,) = track(written("in.mkv", seen), [(*SPOT, 0)])
    assert len(found.frames) == 30
    assert np.linalg.norm(found.points - truth, axis=1).max() <= 0.25


def test_a_cut_ends_the_track_in_its_frame(here: Path, run: Run) -> None:
    frames, truth = moved(34)
    other = photograph("coffee.jpg")[100:250, 100:300]
    written("in.mkv", [*frames[:8], *[other] * 3, *frames[11:27], *[other] * 7])
    status, out, err = run("track", "in.mkv", "t.csv", "--at", f"{truth[15][0]},{truth[15][1]},15")
    assert (status, out) == (0, "")
    assert [f"is lost in frame {k}: " in line for k, line in zip((10, 27), err.splitlines(), strict=True)] == [True] * 2
    (kept,) = read_tracks("t.csv")
    assert [k for k, _ in kept.keys] == list(range(11, 27))
    np.testing.assert_allclose([at for _, at in kept.keys], truth[11:27], atol=0.1)


def test_what_passes_in_front_does_not_take_the_point_along(here: Path) -> None:
    frames, truth = moved(40)
    bar = photograph("coffee.jpg")[60:210, 200:240]
    first = 0
    for k, frame in enumerate(frames):
        left = 7 * k - 90
        x, end = max(left, 0), min(left + 40, SIZE[0])
        if x < end:
            frame[:, x:end] = bar[:, x - left : end - left]
        first = first or (k if left + 40 > truth[k][0] - 11 else 0)
    with pytest.warns(TrackWarning, match="is lost in frame"):
        (found,) = track(written("in.mkv", frames), [(*SPOT, 0)])
    assert first - 4 <= found.frames[-1] <= first + 3
    assert np.linalg.norm(found.points - truth[: len(found.frames)], axis=1).max() <= 0.5


def test_a_point_may_leave_the_picture(here: Path) -> None:
    picture = photograph()[60:210]
    frames = [picture[:, 9 * k : 9 * k + 200] for k in range(12)]
    with pytest.warns(TrackWarning, match="is lost in frame [67]: it leaves the picture"):
        (found,) = track(written("in.mkv", frames), [(60, 80, 0)])
    np.testing.assert_allclose(found.points, [(60 - 9 * k, 80) for k in found.frames], atol=0.3)


def test_points_of_several_frames_are_followed_in_one_pass(run: Run) -> None:
    frames, truth = moved(20)
    written("in.mkv", frames)
    a, b = truth[3], truth[17] + (20, -14)
    two = ("--at", f"{a[0]},{a[1]},3", "--at", f"{b[0]},{b[1]},17")
    status, out, err = run("track", "in.mkv", "t.csv", *two, "--json")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    assert [(each["first"], each["last"], each["lost"]) for each in facts["points"]] == [(0, 19, [])] * 2
    one, other = read_tracks("t.csv")
    assert (one.name, other.name) == ("1", "2")
    np.testing.assert_allclose([at for _, at in one.keys], truth, atol=0.1)
    np.testing.assert_allclose([at for _, at in other.keys], truth + np.array([20, -14]), atol=0.1)
    warp = ("warp", "in.mkv", "out.mkv", "--grab", "100,75:106,75", "--radius", "9", "--track", "t.csv")
    assert run(*warp, "--track-name", "1")[0] == 0


def test_frames_are_typed_as_an_artist_does(run: Run, here: Path) -> None:
    frames, _ = moved(8)
    os.mkdir("in")
    for k, frame in enumerate(frames):
        image.write(f"in/f.{1001 + k}.png", frame.round().astype(np.uint8))
    one = ("track", "in/f.%04d.png")
    assert run(*one, "a.csv", "--at", "100,75,2") == (0, "", "")
    assert run(*one, "b.csv", "--at", "100,75,00:00:00:02") == (0, "", "")
    assert Path("b.csv").read_bytes() == Path("a.csv").read_bytes()
    status, out, err = run(*one, "c.csv", "--at", "100,75,1003", "--first-frame", "files", "--json")
    assert (status, err) == (0, "")
    (facts,) = json.loads(out)["points"]
    assert (facts["at"], facts["first"], facts["last"]) == ([100, 75, 1003], 1001, 1008)
    (plain,), (counted,) = (read_tracks("a.csv"), read_tracks("c.csv", first=1001))
    assert plain.keys == counted.keys
    assert Path("c.csv").read_text().splitlines()[1].startswith("1001,")
    refused(run(*one, "d.csv", "--at", "100,75,1009", "--first-frame", "1001"), "--at must be from 1001 to 1008")
    refused(run(*one, "d.csv", "--at", "100,75,00:00:01:00"), "--at must be from 00:00:00:00 to 00:00:00:07")
    refused(run(*one, "d.csv", "--at", "900,75,1003", "--first-frame", "1001"), "the point (900, 75) is not in")
    refused(run(*one, "d.csv", "--at", "100,75,x"), "--at must be the number of a frame (0, say)")
    refused(run(*one, "d.mov", "--at", "100,75,2"), "is not that of a table: name a .csv or .txt")


def test_frames_before_are_decoded_from_key_frames_within_memory(here: Path) -> None:
    frames, truth = moved(33)
    with av.open("in.mp4", "w") as out:
        stream = out.add_stream("libx264", rate=25, options={"g": "14", "crf": "1", "bf": "2"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for luma in frames:
            grey = av.VideoFrame.from_ndarray(np.rint(np.clip(luma, 0, 255)).astype(np.uint8), format="gray")
            out.mux(stream.encode(grey.reformat(format="yuv420p")))
        out.mux(stream.encode(None))
    at = [(*truth[32], 32)]
    (free,) = track("in.mp4", at)
    assert free.frames.tolist() == list(range(33))
    assert np.linalg.norm(free.points - truth, axis=1).max() <= 0.15
    (tight,) = track("in.mp4", at, memory=7 * 200 * 150)
    (least,) = track("in.mp4", at, memory=0)
    np.testing.assert_array_equal(free.points, tight.points)
    np.testing.assert_array_equal(free.points, least.points)


@pytest.mark.parametrize(
    ("suffix", "dtype", "scale"), [(".png", np.uint8, 1), (".tif", np.uint16, 9), (".exr", "f4", 0.01)]
)
def test_image_sequences_are_tracked(here: Path, suffix: str, dtype: str, scale: float) -> None:
    frames, truth = moved(9)
    os.mkdir("in")
    for k, luma in enumerate(frames):
        colours = np.stack([luma, luma, luma], axis=-1).clip(0, 255) * scale
        image.write(f"in/{k + 1:03d}{suffix}", colours.astype(dtype))
    for name in ("in", f"in/%03d{suffix}"):
        (found,) = track(name, [(*truth[4], 4)])
        assert len(found.frames) == 9
        assert np.linalg.norm(found.points - truth, axis=1).max() <= 0.1


def test_a_clip_of_one_frame_has_a_track_of_one(run: Run) -> None:
    written("in.mkv", moved(1)[0])
    assert run("track", "in.mkv", "t.csv", "--at", "100,75,0") == (0, "", "")
    assert Path("t.csv").read_text() == "frame,x,y,error\n0,100.0,75.0,0.0\n"


def test_what_cannot_be_tracked_is_refused_and_nothing_written(run: Run) -> None:
    flat = np.full(SIZE[::-1], 90.0)
    written("flat.mkv", [flat] * 5)
    refused(run("track", "flat.mkv", "t.csv", "--at", "100,75,2"), "lost in frame 1: nothing there can be followed")
    written("in.mkv", moved(4)[0])
    one = ("track", "in.mkv", "t.csv")
    refused(run(*one), "give a point to track, and the frame in which it is seen: --at X,Y,K")
    refused(run(*one, "--at", "100,75"), "--at must be X,Y,K")
    refused(run(*one, "--at", "100,x,1"), "--at must be X,Y,K")
    refused(run(*one, "--at", "100,75,1.5"), "--at must be the number of a frame (0, say) or a timecode")
    refused(run(*one, "--at", "100,75,4"), "is of frame 4, and in.mkv has frames 0 to 3")
    refused(
        run(*one, "--at", "200,75,1"), "the point (200, 75) is not in the picture of in.mkv, 200 x 150: give one in it"
    )
    refused(run(*one, "--at", "nan,75,1"), "must be a number from")
    refused(run("track", "in.mkv", "t.mp4", "--at", "9,9,0"), "the suffix .mp4 is not that of a table")
    refused(run("track", "none.mkv", "t.csv", "--at", "9,9,0"), "cannot read none.mkv")
    refused(run("track", str(DATA / "chelsea.jpg"), "t.csv", "--at", "9,9,0"), "is no clip")
    refused(run("track", str(DATA / "brain.nii.gz"), "t.csv", "--at", "9,9,0"), "is no clip")
    assert not os.path.exists("t.csv")
    Path("t.csv").write_text("mine")
    refused(run(*one, "--at", "100,75,1"), "t.csv exists already")
    assert Path("t.csv").read_text() == "mine"
    assert run(*one, "--at", "100,75,1", "--force")[0] == 0
    with pytest.raises(SuppleError, match="at must be one point or more"):
        track("in.mkv", [])


def test_noise_is_not_followed(here: Path) -> None:
    noisy("in.mkv", "gray", 6)
    with pytest.raises(SuppleError, match="is lost in frame"):
        track("in.mkv", [(30, 20, 3)])


AUTO = ("--grab", "100,75:104,75", "--radius", "9", "--track", "auto")


def test_strokes_follow_what_is_under_them(run: Run) -> None:
    frames, truth = moved(16)
    x, y = truth[10]
    written("in.mkv", frames)
    drags = ("--grab", f"{x},{y}:{x + 4},{y}", "--scale", f"{x + 20},{y - 14}:1.3", "--radius", "9")
    how = ("--track", "auto", "--track-frame", "10", "--save-recipe", "r.json", "--memory", "0.0001")
    assert run("warp", "in.mkv", "out.mkv", *drags, *how) == (0, "", "")
    recipe = supple.Recipe.from_json(Path("r.json").read_text())
    for k in range(16):
        grab, scale = recipe.at_frame(k).strokes
        assert np.linalg.norm(grab.at - truth[k]) <= 0.1
        assert np.linalg.norm(scale.at - truth[k] - (20, -14)) <= 0.1
    assert run("warp", "in.mkv", "start.mkv", *AUTO, "--save-recipe", "s.json")[0] == 0
    (start,) = supple.Recipe.from_json(Path("s.json").read_text()).strokes
    assert start.at_frame(0).at == (100, 75)


def test_what_no_stroke_can_follow_is_refused(run: Run) -> None:
    written("in.mkv", moved(4)[0])
    warp = ("warp", "in.mkv", "out.mkv")
    timed = ("--grab", "100,75,2:104,75,2", "--radius", "9", "--track", "auto")
    refused(run(*warp, *timed), "leave out the times of its points, and give --track-frame 2")
    refused(run(*warp, *AUTO, "--track-name", "a"), "--track-name is for the --track of a file, not for auto")
    refused(run(*warp, *AUTO, "--track-frame", "4"), "is of frame 4, and in.mkv has frames 0 to 3")
    refused(run(*warp, "--recipe", "r.json", "--track", "auto"), "r.json")
    refused(run("warp", "-", "out.mkv", *AUTO), "--track auto follows points through one clip")
    refused(run("warp", "in.mkv", "in.mkv", "out", *AUTO), "--track auto follows points through one clip")
    refused(run("warp", str(DATA / "chelsea.jpg"), "out.png", *AUTO), "is no clip")
    assert not os.path.exists("out.mkv")
