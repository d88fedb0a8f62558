"""Keyframes of strokes: the curves between them, what a stroke is in a frame, and their JSON."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import supple
from supple import Key, Recipe, Stroke, SuppleError
from supple.strokes.keys import curve

NUMBERS = st.floats(-1e6, 1e6)
KEYS = (Key(2, at=(30, 20), strength=0), Key(6, at=(40, 24)), Key(9, strength=1))
KEYED = Stroke(at=(30, 20), by=(4, 3), radius=12, keys=KEYS)


@given(st.dictionaries(st.integers(-50, 50), NUMBERS, min_size=1, max_size=8), st.data())
def test_a_curve_goes_through_its_keys_and_stays_between_neighbours(keys: dict[int, float], data: Any) -> None:
    frames = sorted(keys)
    values = [keys[k] for k in frames]
    assert [curve(frames, values, k) for k in frames] == values
    at = np.unique(data.draw(st.lists(st.floats(-60, 60), min_size=1, max_size=20)))
    for t in at:
        inside = min(max(t, frames[0]), frames[-1])
        k = min(int(np.searchsorted(frames, inside, "right")) - 1, len(frames) - 2) if len(frames) > 1 else 0
        near = values[k : k + 2]
        assert min(near) <= curve(frames, values, t) <= max(near)


@given(st.lists(st.tuples(st.integers(1, 9), st.floats(0, 100)), min_size=2, max_size=7))
def test_a_curve_rises_where_its_keys_rise_and_has_no_kinks(steps: list[tuple[int, float]]) -> None:
    frames = np.cumsum([step for step, _ in steps]).tolist()
    values = np.cumsum([rise for _, rise in steps]).tolist()
    seen = np.array([curve(frames, values, t) for t in np.linspace(frames[0], frames[-1], 200)])
    assert (np.diff(seen) >= -1e-9).all()
    for k in frames[1:-1]:  # the slope is the same on both sides
        before, after = ((curve(frames, values, k + h) - curve(frames, values, k)) / h for h in (-1e-6, 1e-6))
        assert before == pytest.approx(after, abs=1e-3)


def test_straight_motion_stays_straight_and_is_constant_beyond_its_keys() -> None:
    frames, values = [0, 3, 4, 10], [0.0, 6.0, 8.0, 20.0]
    assert [curve(frames, values, t) for t in (-5, 1, 3.5, 7, 10, 99)] == pytest.approx([0, 2, 7, 14, 20, 20])
    assert curve([0, 10, 20, 30], [0.0, 1.0, 1.0, 0.0], 15) == 1.0
    # By hand: slopes 0.1 at the first key, 0 at the peak.
    assert curve([0, 10, 20], [0.0, 1.0, 0.0], 5) == pytest.approx(0.5 + 10 * 0.1 / 8)


def test_a_stroke_moves_as_a_whole_and_its_strengths_multiply() -> None:
    pull = replace(KEYED, also=(((50, 30), (0, 0)),), strength=0.5)
    now = pull.at_frame(6)
    assert now.keys == ()
    assert now.at == (40, 24)
    assert now.also == (((60, 34), (0, 0)),)
    assert now.by == pull.by
    assert now.strength == pytest.approx(0.5 * curve([2, 9], [0.0, 1.0], 6))
    assert pull.at_frame(0).strength == pull.at_frame(2).strength == 0
    assert pull.at_frame(50) == replace(pull, at=(40, 24), also=now.also, keys=())
    path = Stroke(at=(0, 0), by=(9, 0), path=[(4, 4)], radius=5, keys=[Key(0, at=(1, 2))]).at_frame(7)
    assert (path.at, path.path, path.by) == ((1, 2), ((5, 6),), (9, 0))
    plain = replace(KEYED, keys=())
    assert plain.at_frame(3) is plain
    assert Recipe(strokes=(plain,)).at_frame(3) == Recipe(strokes=(plain,))


def test_a_recipe_in_a_frame_is_a_plain_one() -> None:
    plain = Stroke(at=(9, 9), by=(1, 0), radius=5)
    recipe = Recipe(strokes=(KEYED, plain), amount=0.5, size=(64, 48))
    assert recipe.moves
    assert not Recipe(strokes=(plain, replace(KEYED, hidden=True))).moves
    now = recipe.at_frame(4)
    assert now == replace(recipe, strokes=(KEYED.at_frame(4), plain))
    assert not now.moves
    with pytest.raises(SuppleError, match=r"move from frame to frame \(keys\).*give the recipe of one"):
        supple.Deformation.from_recipe(recipe, (48, 64))
    with pytest.raises(SuppleError, match=r"the stroke moves from frame to frame \(keys, or a matte\)"):
        supple.Deformation((48, 64)).add(KEYED)
    assert supple.Deformation.from_recipe(now, (48, 64)).strokes[1].by == (0.5, 0)


def test_keys_are_scaled_and_mirrored_with_their_stroke() -> None:
    big = Recipe(strokes=(KEYED,), size=(64, 48)).fitted((128, 96)).strokes[0]
    assert big.keys == (Key(2, at=(60.5, 40.5), strength=0), Key(6, at=(80.5, 48.5)), Key(9, strength=1))
    for k in (0, 4, 6, 12):
        scaled = Recipe(strokes=(KEYED.at_frame(k),), size=(64, 48)).fitted((128, 96)).strokes[0]
        assert big.at_frame(k).at == pytest.approx(scaled.at)
    image = KEYED.mirrored((32, 0), (1, 0))
    assert image.keys[1] == Key(6, at=(24, 24))
    assert KEYED.symmetric((32, 0), (1, 0)) == (KEYED, image)


def test_a_stroke_follows_a_track_at_its_own_distance() -> None:
    track = [(1, (100.0, 50.0)), (2, (104.0, 52.0)), (5, (110.0, 40.0))]
    stroke = Stroke(at=(103, 45), by=(1, 0), radius=5)
    made = stroke.following(track, outside="hold")
    assert made.keys == (Key(1, at=(103, 45)), Key(2, at=(107, 47)), Key(5, at=(113, 35)))
    assert stroke.following(track, 5).at_frame(5).at == (103, 45)
    assert stroke.following(track, 5).at_frame(0).at == (93, 55)
    between = stroke.following(track, 3)
    assert between.at_frame(3).at == pytest.approx((103, 45))
    fading = replace(stroke, keys=[Key(0, strength=0), Key(2, strength=1)]).following(track)
    assert [key.frame for key in fading.keys] == [0, 1, 2, 5]
    assert fading.keys[2] == Key(2, at=(107, 47), strength=1)
    with pytest.raises(SuppleError, match="cannot follow a track too"):
        made.following(track)
    with pytest.raises(SuppleError, match="a track must be the positions of a point"):
        stroke.following([])


def test_outside_of_its_track_a_stroke_fades_smoothly() -> None:
    stroke = Stroke(at=(103, 45), by=(1, 0), radius=5, strength=0.5)
    made = stroke.following([(4, (100, 50)), (6, (104, 52)), (9, (110, 40))], 4)
    strengths = [made.at_frame(k).strength for k in range(-3, 17)]
    assert strengths[7:13] == [0.5] * 6
    assert [k - 3 for k, part in enumerate(strengths) if part == 0] == [-3, -2, -1, 14, 15, 16]
    u = np.arange(1, 5) / 5
    np.testing.assert_allclose(strengths[3:7], 0.5 * (3 * u**2 - 2 * u**3))  # without a slope at both ends
    np.testing.assert_allclose(strengths[16:12:-1], 0.5 * (3 * u**2 - 2 * u**3))
    assert made.at_frame(12).at == made.at_frame(9).at
    held = stroke.following([(4, (100, 50)), (9, (110, 40))], 4, outside="hold")
    assert {held.at_frame(k).strength for k in range(-3, 17)} == {0.5}
    assert Recipe.from_json(Recipe(strokes=(made,)).to_json()).strokes == (made,)
    alone = stroke.following([(4, (100, 50))])
    assert [alone.at_frame(k).strength for k in (-1, 4, 9)] == [0, 0.5, 0]
    with pytest.raises(SuppleError, match='outside must be "fade" or "hold"'):
        stroke.following([(4, (100, 50))], outside="stay")  # type: ignore[arg-type]


SHAPES = [
    Stroke(at=(30, 24), by=(3, 1), radius=8, also=[((38, 20), (0, 2))]),
    Stroke(at=(30, 24), by=(2, 3), path=[(33, 23)], radius=8),
    Stroke.twist((30, 24), angle=40, radius=8),
    Stroke.scale((30, 24), factor=1.3, radius=8),
    Stroke.pinch((30, 24), factor=1.2, radius=8),
    Stroke.pinch((30, 24), factor=1.2, axis=(1, 2), radius=8),
]


@pytest.mark.parametrize("stroke", SHAPES, ids=lambda stroke: stroke.brush)
def test_a_stroke_that_is_turned_and_scaled_is_its_map_turned_and_scaled(stroke: Stroke) -> None:
    keyed = replace(stroke, keys=[Key(0, angle=0, scale=1), Key(8, at=(41, 27), angle=70, scale=1.5)])
    turn = np.deg2rad(70)
    matrix = 1.5 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])  # from x towards y

    def placed(points: Any) -> Any:
        return (points - (30, 24)) @ matrix.T + (41, 27)

    points = np.random.default_rng(0).uniform((14, 8), (46, 40), (200, 2))
    shape = (200, 200)
    before, after = (Recipe(border=None, strokes=(s,)) for s in (stroke, keyed.at_frame(8)))
    expected = placed(supple.Deformation.from_recipe(before, shape).forward(points))
    found = supple.Deformation.from_recipe(after, shape).forward(placed(points))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.abs(found - placed(points)).max() > 0.5
    half = keyed.at_frame(4)
    assert half.radius == pytest.approx(8 * 1.25)


def test_a_stroke_turns_and_grows_with_two_points() -> None:
    stroke = Stroke(at=(12, 10), by=(2, 0), radius=4)
    frames = range(3, 40)
    turns = np.deg2rad(20.0 * (np.arange(3, 40) - 5))  # through more than a whole turn
    sizes = 1 + 0.02 * (np.arange(3, 40) - 5)
    a = np.stack([50 + 3.0 * np.arange(37), np.full(37, 20.0)], axis=1)
    b = a + (sizes * 8)[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    first, second = ([(k, tuple(p)) for k, p in zip(frames, points, strict=True)] for points in (a, b))
    made = stroke.following(first, 5, second=[*second, (99, (0, 0))])
    now = made.at_frame(5)
    assert (now.at, now.radius) == (pytest.approx((12, 10)), pytest.approx(4))
    for k, turn, size, p in zip(frames, turns, sizes, a, strict=True):
        now = made.at_frame(k)
        rotation = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        assert now.at == pytest.approx(tuple(rotation @ ((12, 10) - a[2]) + p))
        assert now.by == pytest.approx(tuple(rotation @ (2, 0)))
        assert now.radius == pytest.approx(4 * size)
    angles = [key.angle for key in made.keys if key.angle is not None]
    np.testing.assert_allclose(angles, np.rad2deg(turns), atol=1e-9)
    with pytest.raises(SuppleError, match="no frame in common"):
        stroke.following(first, second=[(99, (0, 0))])
    with pytest.raises(SuppleError, match="at the same place in frame 4: track two points that are apart"):
        stroke.following(first, second=[*second[:1], first[1], *second[2:]])


def test_keys_that_turn_are_kept_and_mirrored_with_their_stroke() -> None:
    stroke = replace(KEYED, keys=(Key(2, at=(30, 20), angle=-30), Key(6, scale=1.5), Key(9, angle=400, strength=0.5)))
    text = Recipe(strokes=(stroke,)).to_json()
    assert '{"frame": 2, "at": [30, 20], "angle": -30}, {"frame": 6, "scale": 1.5}' in text
    assert Recipe.from_json(text).strokes == (stroke,)
    image = stroke.mirrored((32, 0), (1, 0))
    assert [key.angle for key in image.keys] == [30, None, -400]
    for k in (2, 5, 8):
        one, other = image.at_frame(k), stroke.at_frame(k).mirrored((32, 0), (1, 0))
        assert (one.at, one.by, one.radius) == (
            pytest.approx(other.at),
            pytest.approx(other.by),
            pytest.approx(other.radius),
        )
    for bad in ({"scale": 0.001}, {"scale": 101}, {"angle": float("nan")}, {"angle": "x"}):
        with pytest.raises(SuppleError, match=f"{next(iter(bad))} must be a number"):
            Key(0, **bad)


def test_keys_survive_json_and_are_refused_by_name() -> None:
    recipe = Recipe(strokes=(KEYED, replace(KEYED, keys=())))
    text = recipe.to_json()
    assert '"keys": [{"frame": 2, "at": [30, 20], "strength": 0}, {"frame": 6, "at": [40, 24]}, {"frame": 9,' in text
    assert Recipe.from_json(text) == recipe
    assert text.count("keys") == 1

    def refused(keys: str, wanted: str) -> None:
        entry = f'{{"brush": "grab", "at": [1, 2], "by": [3, 4], "radius": 5, "keys": {keys}}}'
        with pytest.raises(SuppleError, match=wanted):
            Recipe.from_json(f'{{"supple": 2, "strokes": [{entry}]}}')

    refused("3", r"strokes\[0\]: keys must be a sequence of Key")
    refused("[3]", r"strokes\[0\]: keys\[0\] must be a JSON object, found 3")
    refused('[{"at": [1, 2]}]', r'strokes\[0\]: the key "frame" is missing in keys\[0\]')
    refused('[{"frame": 1, "atx": [1, 2]}]', r"strokes\[0\]: unknown key 'atx' in keys\[0\]: did you mean \"at\"")
    refused('[{"frame": 1}]', r"the key of frame 1 must have at, strength, angle or scale, and has none")
    refused('[{"frame": 1.5, "strength": 1}]', r"frame must be a whole number")
    refused('[{"frame": 1, "strength": 2}]', r"strength must be a number from 0 to 1, found 2")
    refused('[{"frame": 1, "at": [1, 2, 3]}]', r"at must be 2 numbers")
    twice = '[{"frame": 1, "strength": 1}, {"frame": 1, "strength": 0}]'
    refused(twice, r"keys\[1\].frame must be after that of the key before it, 1, found 1")


def test_strokes_with_a_time_take_no_keys() -> None:
    with pytest.raises(SuppleError, match="keys are for strokes with points of 2 numbers"):
        Stroke(at=(1, 2, 3), by=(0, 0, 1), radius=5, keys=[Key(0, strength=1)])
    with pytest.raises(SuppleError, match=r"keys\[0\] must be a Key"):
        Stroke(at=(1, 2), by=(0, 1), radius=5, keys=[(0, 1)])  # type: ignore[list-item]


@pytest.mark.parametrize("frame", [-3, 9, 500])
def test_a_frame_outside_of_the_track_is_refused(frame: int) -> None:
    stroke = Stroke.scale((9, 9), factor=1.5, radius=4)
    with pytest.raises(SuppleError, match=f"frames 2 to 8, and the stroke of frame {frame}"):
        stroke.following([(2, (9, 9)), (8, (12, 9))], frame)
