"""Transfer functions: what values look like, and their files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from supple import SuppleError
from supple.render.transfer import ENTRIES, PRESETS, TransferFunction, transfer_of

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
        ('{"points": [[0, 0, 0, 0, 1]], "unit": 0}', "above 0"),
        ('{"points": [[0, 0, 0, 0, 1]], "relative": 1}', "true or false"),
        ('{"points": [[0, 0, 0, 0, 1]], "colour": 1}', "unknown key 'colour'"),
        ('{"points": [[0, 0, 0, 0, 1]], "transfer_function": 2}', "another version"),
    ],
)
def test_bad_files(text: str, wanted: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SuppleError, match=wanted) as caught:
        transfer_of(path)
    assert "bad.json" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["bone", "look.txt", "missing.json"])
def test_no_such_thing(name: str) -> None:
    with pytest.raises(SuppleError) as caught:
        transfer_of(name)
    assert name in str(caught.value)


def test_files_may_be_written_by_hand() -> None:
    text = json.dumps({"points": [[-100, 1, 1, 1, 0], [100, 1, 0.5, 0, 0.8]]})
    assert TransferFunction.from_json(text).points == ((-100.0, 1.0, 1.0, 1.0, 0.0), (100.0, 1.0, 0.5, 0.0, 0.8))
