"""Mattes from files: pictures, clips and sequences, which multiply strokes of the command line."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

import supple
from supple import Freeze, Recipe
from supple.files import warp_file
from supple.files.freezing import read_matte
from supple.media import image
from tests.files.clip_files import FLAT, GRAB, GRAB_2D, TIMED, Run, noisy, refused, stack

COUNT = 12


def discs(grow: float = 1.0) -> list[np.ndarray]:
    y, x = np.mgrid[:48, :64]
    return [np.where(np.hypot(x - 20 - 2 * k, y - 20) < 16, 255, 0).astype(np.uint8) for k in range(COUNT)]


def grey_clip(name: str, frames: list[np.ndarray], pixel_format: str = "gray") -> None:
    with av.open(name, "w") as out:
        stream = out.add_stream("ffv1", rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = frames[0].shape[1], frames[0].shape[0], pixel_format
        for frame in frames:
            made = av.VideoFrame.from_ndarray(frame, format="gray").reformat(format=pixel_format)
            out.mux(stream.encode(made))
        out.mux(stream.encode(None))


@pytest.mark.parametrize("kind", ["gray", "yuv420p", "alpha"])
def test_the_matte_of_a_clip_moves_with_it(run: Run, here: Path, kind: str) -> None:
    noisy("in.mkv", "gray", COUNT)
    if kind == "alpha":
        Path("m").mkdir()
        for k, frame in enumerate(discs()):
            rgba = np.dstack([np.full((48, 64, 3), 60 + k, np.uint8), frame])
            image.write(f"m/{k:03d}.png", rgba)
        matte = "m/%03d.png"
    else:
        grey_clip("m.mkv", discs(), kind)
        matte = "m.mkv"
    status, _, err = run("warp", "in.mkv", "out.mkv", *GRAB_2D, "--matte", matte, "--save-recipe", "r.json")
    assert (status, err) == (0, "")
    before, after = stack("in.mkv"), stack("out.mkv")
    for k, frame in enumerate(discs()):
        frozen = supple.Deformation((48, 64), border=10, freeze=Freeze.of(255 - frame)).add(FLAT.strokes[0], warn=False)
        np.testing.assert_array_equal(after[k], frozen.warp(before[k]))
    assert (after != before).any(axis=(1, 2)).sum() >= 6
    assert run("warp", "in.mkv", "again.mkv", "--recipe", "r.json")[0] == 0
    np.testing.assert_array_equal(stack("again.mkv"), after)


def test_a_stroke_in_time_under_a_matte(run: Run, here: Path) -> None:
    noisy("in.mkv", "gray", COUNT)
    grey_clip("m.mkv", discs())
    status, _, err = run("warp", "in.mkv", "out.mkv", *GRAB, "--matte", "m.mkv", "--freeze-width", "6", "--hold", "1")
    assert (status, err.count("its matte holds it back")) == (0, err.count("supple: "))
    before, after = stack("in.mkv"), stack("out.mkv")
    matte = read_matte("m.mkv", width=6)
    assert matte == Freeze.matte_of([frame / np.float32(255) for frame in discs()], COUNT, width=6)
    m = matte.shown((COUNT, 48, 64))
    np.testing.assert_array_equal(after[m == 0], before[m == 0])
    np.testing.assert_array_equal(after[[0, -1]], before[[0, -1]])
    assert (after[m == 1] != before[m == 1]).any()
    made = warp_file("in.mkv", "two.mkv", replace(TIMED, strokes=(replace(TIMED.strokes[0], matte=matte),)), hold=1)
    np.testing.assert_array_equal(stack("two.mkv"), after)
    at = np.random.default_rng(2).uniform((0, 0, 0), (63, 47, COUNT - 1), (300, 3))
    np.testing.assert_allclose(made.deformation.forward(made.deformation.inverse(at).points), at, atol=1e-6)
    assert made.report().within


def test_each_stroke_has_its_own_matte(run: Run, here: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    image.write("in.png", pixels)
    left = np.zeros((48, 64), np.uint8)
    left[:, :32] = 255
    image.write("left.png", left)
    image.write("colours.png", pixels)
    image.write("small.png", left[:40])
    two = ("--grab", "20,20:24,22", "--grab", "44,24:40,26", "--radius", "8")
    assert run("warp", "in.png", "out.png", *two, "--matte", "left.png", "--matte", "none")[0] == 0
    strokes = [supple.Stroke.grab((20, 20), to=(24, 22), radius=8), supple.Stroke.grab((44, 24), to=(40, 26), radius=8)]
    strokes[0] = replace(strokes[0], matte=Freeze.of(left, matte=True))
    d = supple.Deformation.from_recipe(Recipe(strokes=tuple(strokes)), (48, 64))
    np.testing.assert_array_equal(image.read("out.png").pixels, d.warp(pixels))
    one = ("warp", "in.png", "bad.png", *GRAB_2D)
    refused(run(*one, "--matte", "colours.png"), "colours.png cannot be a matte: it has colours; give a grey picture")
    refused(
        run(*one, "--matte", "small.png"), "the matte small.png is of 64 x 40 samples, and what is deformed of 64 x 48"
    )
    refused(run(*one, "--matte", "left.png", "--matte", "none"), "--matte is given 2 times for one stroke")
    refused(run(*one, "--matte", "none.png"), "cannot read none.png")
    refused(
        run("warp", "in.png", "bad.png", "--recipe", "r.json", "--matte", "left.png"), "--matte is for strokes, and"
    )
    refused(run(*one, "--matte", "left.png", "--freeze-width", "1"), "--freeze-width must be at least 4 samples")
    grey_clip("moves.mkv", discs())
    refused(run(*one, "--matte", "moves.mkv"), "is taken for a picture, and the matte moves from frame to frame")
    refused(run(*one, "--matte", "moves.mkv", "--freeze-width", "1"), "--freeze-width must be at least 4 samples")
    noisy("in.mkv", "gray", COUNT)
    grey_clip("m.mkv", discs()[:5])
    said = "the matte m.mkv is of 64 x 48 x 5 samples, and what is deformed of 64 x 48 x 12"
    refused(run("warp", "in.mkv", "bad.mkv", *GRAB, "--matte", "m.mkv"), said)
    said = "the matte m.mkv has 5 frames, and the clip 12: give one of its length"
    refused(run("warp", "in.mkv", "bad.mkv", *GRAB_2D, "--matte", "m.mkv"), said)
    noisy("c.mkv", "yuv444p", COUNT)
    refused(run("warp", "in.mkv", "bad.mkv", *GRAB, "--matte", "c.mkv"), "c.mkv cannot be a matte: it has colours")
