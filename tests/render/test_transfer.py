"""Transfer functions: what values look like, and their files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from supple import SuppleError
from supple.render.transfer import ENTRIES, PRESETS, TransferFunction, transfer_of
from tests.refusals import refused

POINTS = ((0.0, 0.0, 0.5, 1.0, 0.0), (10.0, 1.0, 0.5, 0.0, 0.5), (30.0, 1.0, 1.0, 1.0, 1.0))


def test_between_points_it_is_straight() -> None:
    table = TransferFunction(POINTS).table(0, 30, 1.0)
    assert table.shape == (ENTRIES, 4)
    assert table.dtype == np.float32
    at = round(5 / 30 * (ENTRIES - 1))
    assert table[at, 3] == pytest.approx(0.25, abs=1e-3)
    # sRGB of 0.5 is 0.214 of light.
    np.testing.assert_allclose(table[at, :3], [0.214, 0.214, 0.214], atol=1e-3)
    np.testing.assert_allclose(table[0], [0, 0.214, 1, 0], atol=1e-3)


def test_beyond_the_points_it_goes_on() -> None:
    table = TransferFunction(POINTS[:2]).table(-10, 40, 1.0)
    np.testing.assert_array_equal(table[0], table[ENTRIES // 5 - 1])
    assert table[-1, 3] == pytest.approx(0.5)


def test_opacity_is_of_a_millimetre() -> None:
    one, two, half = (TransferFunction(POINTS).table(0, 30, step)[1000, 3] for step in (1.0, 2.0, 0.5))
    assert 1 - (1 - one) ** 2 == pytest.approx(two, rel=1e-5)
    assert 1 - (1 - half) ** 2 == pytest.approx(one, rel=1e-5)
    thick = TransferFunction(POINTS, unit=2.0).table(0, 30, 2.0)[1000, 3]
    assert thick == pytest.approx(one, rel=1e-5)


def test_relative_values_are_parts_of_the_range() -> None:
    relative = TransferFunction(tuple((p[0] / 30, *p[1:]) for p in POINTS), relative=True)
    np.testing.assert_allclose(relative.table(100, 400, 1.0), TransferFunction(POINTS).table(0, 30, 1.0), atol=1e-6)
    assert relative.table(7, 7, 1.0)[0, 3] == 0


@pytest.mark.parametrize("name", PRESETS)
def test_files_say_it_all(name: str, tmp_path: Path) -> None:
    path = tmp_path / "look.json"
    path.write_text(PRESETS[name].to_json(), encoding="utf-8")
    assert transfer_of(path) == PRESETS[name]
    assert transfer_of(name) == PRESETS[name]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("{", "is not JSON"),
        ("[]", 'has no "points"'),
        ('{"points": []}', "a sequence of points"),
        ('{"points": "abc"}', "a sequence of points"),
        ('{"points": [[1, 2]]}', "five numbers"),
        ('{"points": [[0, 0, 0, 0, 2]]}', "from 0 to 1"),
        ('{"points": [[0, 0, 0, 0, true]]}', "from 0 to 1"),
        ('{"points": [[NaN, 0, 0, 0, 0]]}', "a finite number"),
        ('{"points": [[1, 0, 0, 0, 0], [0, 0, 0, 0, 1]]}', "in ascending order"),
        ('{"points": [[0, 0, 0, 0, 1]], "unit": 0}', "from 1e-6"),
        ('{"points": [[0, 0, 0, 0, 1]], "relative": 1}', "true or false"),
        ('{"points": [[0, 0, 0, 0, 1]], "colour": 1}', "unknown key 'colour'"),
        ('{"points": [[0, 0, 0, 0, 1]], "transfer_function": 2}', "another version"),
    ],
)
def test_bad_files(text: str, wanted: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text, encoding="utf-8")
    assert "bad.json" in refused(transfer_of, path, match=wanted)


@pytest.mark.parametrize("name", ["bone", "look.txt", "missing.json"])
def test_no_such_thing(name: str) -> None:
    assert name in refused(transfer_of, name)


def test_files_may_be_written_by_hand() -> None:
    text = json.dumps({"points": [[-100, 1, 1, 1, 0], [100, 1, 0.5, 0, 0.8]]})
    assert TransferFunction.from_json(text).points == ((-100.0, 1.0, 1.0, 1.0, 0.0), (100.0, 1.0, 0.5, 0.0, 0.8))


TISSUES = {"air": -1000, "lung": -780, "fat": -100, "muscle": 55, "contrast": 300, "bone": 1200}
SEEN = {
    "ct-bone": {"bone"},
    "ct-skin": {"fat", "muscle", "contrast", "bone"},
    "ct-muscle": {"muscle", "contrast", "bone"},
    "ct-lung": {"lung"},
    "ct-vessels": {"contrast", "bone"},
}


@pytest.mark.parametrize("name", SEEN)
def test_tissues_that_presets_show(name: str) -> None:
    """Those that two centimetres of are nearly opaque, and those that nothing is seen of."""
    opacity = {tissue: PRESETS[name].table(hu, hu + 1, 20.0)[0, 3] for tissue, hu in TISSUES.items()}
    assert {tissue for tissue, seen in opacity.items() if seen > 0.4} >= SEEN[name]
    assert {tissue for tissue, seen in opacity.items() if seen == 0} == set(TISSUES) - SEEN[name] - (
        {"contrast"} if name == "ct-bone" else set()
    )


def test_bone_and_blood_have_colours_of_their_own() -> None:
    blood, bone = (PRESETS["ct-vessels"].table(hu, hu + 1, 1.0)[0] for hu in (300, 1200))
    assert blood[0] > 4 * blood[1]
    assert bone[1] > 0.8 * bone[0]


SLICERS = """1
1
0.9
0.1
0.2
10
10 -3024 0 -86.9767 0 45.3791 0.169643 347.907 0.607143 3071 0.616071
4 0 1 255 1
16 -3024 0 0 0 -86.9767 0 0.25098 1 139.919 1 0.894893 0.894893 3071 0.827451 0.658824 1
"""


def test_a_volume_property_of_slicer_is_read(tmp_path: Path) -> None:
    path = tmp_path / "muscle.vp"
    path.write_text(SLICERS, encoding="utf-8")
    found = transfer_of(path)
    assert [p[0] for p in found.points] == [-3024, -86.9767, 45.3791, 139.919, 347.907, 3071]
    assert found.unit == 1
    assert not found.relative
    # Slicer draws each function by straight lines of its own.
    for value in (-500.0, 0.0, 100.0, 300.0, 2000.0):
        table = found.table(value, value + 1e-3, 1.0)[0]
        opacity = np.interp(value, [-3024, -86.9767, 45.3791, 347.907, 3071], [0, 0, 0.169643, 0.607143, 0.616071])
        assert table[3] == pytest.approx(opacity, abs=1e-4)
        green = np.interp(value, [-3024, -86.9767, 139.919, 3071], [0, 0.25098, 0.894893, 0.658824])
        light = green / 12.92 if green <= 0.04045 else ((green + 0.055) / 1.055) ** 2.4
        assert table[1] == pytest.approx(light, abs=1e-4)


@pytest.mark.parametrize("name", PRESETS)
def test_slicer_reads_what_is_written(name: str) -> None:
    given = TransferFunction(PRESETS[name].points, unit=2.0, relative=PRESETS[name].relative)
    text = given.to_vp(-1000, 3000)
    lines = [line.split() for line in text.splitlines()]
    assert [float(line[0]) for line in lines[:6]] == [1, 1, 0.8, 0.15, 0.2, 16]
    assert [int(line[0]) for line in lines[6:]] == [len(line) - 1 for line in lines[6:]]
    assert lines[7] == ["4", "-1000", "1", "3000", "1"]
    back = TransferFunction.from_vp(text)
    assert len(back.points) == len(given.points)
    for value, *colour, opacity in back.points:
        low, high = (value, value + 4000) if not given.relative else (-1000.0, 3000.0)
        at = 0 if not given.relative else round((value + 1000) / 4000 * (ENTRIES - 1))
        np.testing.assert_allclose(given.table(low, high, 1.0)[at, 3], opacity, atol=2e-3)
        np.testing.assert_allclose(back.table(low, high, 1.0)[at], given.table(low, high, 1.0)[at], atol=2e-3)
        assert all(0 <= x <= 1 for x in colour)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1\n1\n",
        *(SLICERS.replace(*pair) for pair in (("16 -3024", "17 -3024"), ("0.616071", "x"), ("3071 0.6", "inf 0.6"))),
    ],
)
def test_what_is_no_volume_property_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "look.vp"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SuppleError, match=r"look\.vp is no volume property of 3D Slicer: six numbers"):
        transfer_of(path)
    path.write_text(SLICERS.replace("0.616071", "1.5"), encoding="utf-8")
    with pytest.raises(SuppleError, match=r"look\.vp: points\[5\]'s colour and opacity must be numbers from 0 to 1"):
        transfer_of(path)


@pytest.mark.parametrize("name", ["ct-skin", "mr-head"])
def test_a_window_of_values_is_kept_in_files(name: str) -> None:
    low, high, window = -1000.0, 1500.0, (-120.0, 500.0)
    whole, part = PRESETS[name], PRESETS[name].within(window, low, high)
    values = np.linspace(low, high, ENTRIES)
    within = (values > window[0] + 2) & (values < window[1] - 2)
    beyond = (values < window[0] - 2) | (values > window[1] + 2)
    for seen in (part, TransferFunction.from_json(part.to_json()), TransferFunction.from_vp(part.to_vp(low, high))):
        np.testing.assert_allclose(seen.table(low, high, 1.0)[within], whole.table(low, high, 1.0)[within], atol=2e-5)
        assert (seen.table(low, high, 1.0)[beyond, 3] == 0).all()
    assert whole.within((-np.inf, np.inf), low, high).table(low, high, 1.0) == pytest.approx(
        whole.table(low, high, 1.0), abs=1e-6
    )
