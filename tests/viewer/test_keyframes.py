"""Keys that are set, moved and removed: in a document, and by hands on a clip."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple import Key, Recipe, Stroke, SuppleError
from supple.files.clips import deformation_of, motion_of
from supple.files.jobs import Job
from supple.files.options import ClipOptions
from supple.viewer.document.editing import Document
from supple.viewer.document.keyframes import (
    PARTS,
    Part,
    animated,
    edited,
    moved_key,
    of_key,
    with_key,
    with_key_here,
    without,
)
from tests.clips import closed
from tests.viewer.tools import click, clip, down, drag, move, press, up, wheel

PULL = Stroke(at=(100, 100), by=(10, 5), radius=30)
MOVING = replace(PULL, keys=(Key(2, at=(100, 100)), Key(8, at=(160, 100)), Key(12, strength=0.25), Key(16, strength=1)))
PLACES = st.tuples(st.floats(-200, 400), st.floats(-200, 400))
NUMBERS = st.one_of(st.none(), st.floats(0, 1))
FRAMES = st.integers(-5, 30)


@st.composite
def strokes(draw: Any) -> Stroke:
    keys = []
    for frame in sorted(draw(st.sets(FRAMES, max_size=5))):
        angle, scale = draw(st.one_of(st.none(), st.floats(-180, 180))), draw(st.one_of(st.none(), st.floats(0.5, 2)))
        values = {"at": draw(st.one_of(st.none(), PLACES)), "strength": draw(NUMBERS), "angle": angle, "scale": scale}
        if any(v is not None for v in values.values()):
            keys.append(Key(frame, **values))
    also = draw(st.lists(st.tuples(PLACES, st.tuples(st.floats(-9, 9), st.floats(-9, 9))), max_size=2))
    at, strength = draw(PLACES), draw(st.floats(0, 1))
    return Stroke(at=at, by=(3, 4), radius=20, also=tuple(also), strength=strength, keys=tuple(keys))


def same(one: Stroke, other: Stroke) -> None:
    """Two strokes without keys are the same, within rounding."""
    for a, b in zip(one.handles, other.handles, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    assert (one.radius, one.strength) == pytest.approx((other.radius, other.strength), rel=1e-9)


@given(strokes(), FRAMES, PLACES, st.booleans())
def test_an_edit_is_what_is_seen_in_its_frame(
    stroke: Stroke, frame: int, place: tuple[float, float], whole: bool
) -> None:
    now = stroke.at_frame(frame)
    placed = any(key.at is not None for key in stroke.keys)
    gone = tuple(b - a for a, b in zip(now.at, place, strict=True))
    also = tuple((tuple(a + d for a, d in zip(p, gone, strict=True)), by) for p, by in now.also)
    then = replace(now, at=place, also=also, radius=33, by=(1, 2))
    made = edited(stroke, now, then, frame, whole=whole)
    same(made.at_frame(frame), then)
    # Of the keys, nothing else changes; and of the stroke, no bit that was not edited.
    rest = [[replace(key, at=(0, 0)) for key in each.keys if key.frame != frame] for each in (stroke, made)]
    assert [(k.frame, k.strength, k.angle, k.scale) for k in rest[0]] == [
        (k.frame, k.strength, k.angle, k.scale) for k in rest[1]
    ]
    before, after = ({k.frame: k.at for k in each.keys if k.at is not None} for each in (stroke, made))
    if whole and placed:
        assert after.keys() == before.keys()
        for k, at in after.items():
            assert at == pytest.approx([a + d for a, d in zip(before[k], gone, strict=True)], abs=1e-9)
    elif placed and place != now.at:
        assert after == {**before, frame: place}
    if placed:
        along = edited(stroke, now, replace(now, at=place), frame, whole=whole)  # all goes along
        assert replace(along, keys=stroke.keys) == stroke
    assert made.strength == stroke.strength
    assert edited(stroke, now, now, frame, whole=whole) == stroke
    radius = edited(stroke, now, replace(now, radius=50), frame)
    assert replace(radius, radius=stroke.radius) == stroke


@given(strokes(), FRAMES, FRAMES, st.floats(0, 1))
def test_a_key_of_strength_is_what_was_set(stroke: Stroke, frame: int, other: int, value: float) -> None:
    made = with_key(stroke, frame, strength=value)
    assert made.at_frame(frame).strength == value
    known = {k.frame for k in stroke.keys if k.strength is not None and k.frame != frame}
    for k in known:  # others are as strong as they were
        assert made.at_frame(k).strength == pytest.approx(stroke.at_frame(k).strength, abs=1e-12)
    for key in stroke.keys[:1]:
        for part in (part for part in PARTS if of_key(key, part)):
            to = moved_key(stroke, part, key.frame, other)
            there = of_key(next(k for k in to.keys if k.frame == other), part)
            wanted = of_key(key, part)
            if part == "strength":
                wanted = {part: stroke.at_frame(key.frame).strength}
            assert there.items() >= wanted.items()
            frames, moved = ({k.frame for k in s.keys if of_key(k, part)} for s in (stroke, to))
            assert moved == frames - {key.frame} | {other}
            rest: Part = "place" if part == "strength" else "strength"
            kept = [[(k.frame, of_key(k, rest)) for k in s.keys if of_key(k, rest)] for s in (stroke, to)]
            assert kept[0] == kept[1]


@given(strokes(), FRAMES)
def test_what_is_no_longer_animated_stays_as_it_is_there(stroke: Stroke, frame: int) -> None:
    now, every = stroke.at_frame(frame), {key.frame for key in stroke.keys}
    still = without(stroke, "place", every, frame)
    assert not animated(still, "place")
    assert [k.strength for k in still.keys] == [k.strength for k in stroke.keys if k.strength is not None]
    assert still.at_frame(frame) == now
    even = without(stroke, "strength", every, frame)
    assert not animated(even, "strength")
    assert even.at_frame(frame) == now
    assert without(still, "strength", every, frame) == now
    for part in PARTS:
        same(with_key_here(stroke, part, frame).at_frame(frame), now)


def test_a_turned_stroke_whose_positions_are_removed_stays_where_it_is() -> None:
    stroke = replace(PULL, also=(((120, 100), (1, 0)),), keys=(Key(0, angle=90), Key(4, at=(50, 60)), Key(9, scale=2)))
    now = without(stroke, "place", {4}, 4).at_frame(4)
    assert now.at == (50, 60)
    same(now, stroke.at_frame(4))


def test_a_recipe_with_keys_is_loaded_and_saved_bit_for_bit() -> None:
    recipe = Recipe(
        size=(300, 200), space="pixels", strokes=(replace(MOVING, by=(0.1, 0.3)), replace(PULL, at=(0.7, 50)))
    )
    d = Document((20, 200, 300), recipe=recipe, kind="video")
    assert d.recipe == recipe
    assert Recipe.from_json(d.recipe.to_json()) == recipe
    assert (d.timed, d.size, d.dirty) == (False, (300, 200), False)
    for frame in range(20):
        d.seek(frame)
        assert d.recipe == recipe
        expected = Document((200, 300), recipe=recipe.at_frame(frame)).deformation
        assert d.deformation == expected
    d.seek(5)
    d.change(1, replace(d.strokes[1], radius=31))
    assert d.recipe == replace(recipe, strokes=(recipe.strokes[0], replace(recipe.strokes[1], radius=31)))
    d.undo()
    assert d.recipe == recipe
    small = replace(recipe, size=(150, 100))
    d.load(small)
    assert d.recipe == small.fitted((300, 200))
    assert d.recipe.strokes[0].keys[1].at == (320.5, 200.5)


def test_strokes_of_a_clip_are_of_one_kind() -> None:
    d = Document((20, 200, 300), (1.0, 1.0, 2.0), kind="video")
    assert (d.timed, d.size, d.recipe.time_scale) == (True, (300, 200, 20), 2.0)
    d.timed = False
    assert (d.timed, d.size, d.recipe.time_scale) == (False, (300, 200), None)
    d.add(PULL)
    with pytest.raises(SuppleError, match="all in time, or all in every frame: remove them first"):
        d.timed = True
    with pytest.raises(SuppleError, match="a point of 3 numbers"):
        d.add(Stroke(at=(9, 9, 9), by=(1, 1, 0), radius=9))
    d.undo()
    assert not d.timed
    d.timed = True
    d.redo()
    assert not d.timed  # as what is there
    with pytest.raises(SuppleError, match="this is no clip"):
        Document((200, 300), recipe=Recipe(strokes=(MOVING,)))


def test_a_stroke_may_leave_the_picture_and_what_fails_in_a_frame_says_so() -> None:
    away = replace(PULL, keys=(Key(0, at=(100, 100)), Key(9, at=(5000, 100))))
    d = Document((20, 200, 300), recipe=Recipe(strokes=(away,)), kind="video")
    d.seek(9)
    assert d.trouble is None
    assert tuple(d.deformation.forward((100, 100))) == (100, 100)
    strong = replace(PULL, by=(200, 0), keys=(Key(0, strength=0), Key(9, strength=1)))
    d = Document((20, 200, 300), recipe=Recipe(strokes=(strong,), on_fold="error"), kind="video")
    d.seek(9)
    assert (d.trouble or "").startswith("frame 9: ")
    d.seek(0)
    assert d.trouble is None


def test_steps_are_named() -> None:
    d = Document((20, 200, 300), recipe=Recipe(strokes=(MOVING,)), kind="video")
    d.seek(5)
    names = []
    for made in (
        with_key(MOVING, 5, strength=0.5),
        MOVING,
        moved_key(MOVING, "place", 8, 10),
        with_key(moved_key(MOVING, "place", 8, 10), 10, at=(7, 7)),
        replace(MOVING, keys=()),
    ):
        d.replace(0, made)
        names.append(d.steps[-1].made_by)
    assert names == [f"{what} of stroke 1" for what in ("Key 5", "Remove key 5", "Key 10", "Key 10", "Remove keys")]


class TestHands:
    def test_a_drag_in_every_frame_is_a_stroke_of_two_numbers(self) -> None:
        tools = clip()
        tools.document.timed = False
        tools.radius = 40
        tools.playback.seek(5)
        down(tools, 201, 101)
        wheel(tools, -100)  # the radius: there is no time
        move(tools, 221, 101)
        press(tools, "ArrowRight")
        up(tools, 221, 111)
        made = tools.document.strokes[0]
        assert (made.at, made.by, made.keys) == ((100, 50), (10, 5), ())
        assert made.radius == pytest.approx(44)
        assert tools.playback.frame == 5
        tools.playback.seek(12)
        assert [handle.part for handle in tools.handles()] == ["pivot", "end"]  # it is there, too

    def test_a_drag_of_the_handle_moves_it_or_sets_a_key(self) -> None:
        tools = clip(PULL)
        pivot = tools.view.to_canvas(100, 100)
        click(tools, *pivot)
        assert tools.document.selected == 0
        drag(tools, pivot, (pivot[0] + 20, pivot[1]))
        assert tools.document.strokes[0] == replace(PULL, at=(110, 100))
        tools.document.undo()
        tools.playback.seek(2)
        tools.document.seek(2)
        tools.document.replace(0, with_key(PULL, 2, at=PULL.at))
        tools.playback.seek(8)
        drag(tools, pivot, (pivot[0] + 60, pivot[1] + 120), (pivot[0] + 120, pivot[1]))
        assert tools.document.strokes[0] == replace(PULL, keys=MOVING.keys[:2])
        before = len(tools.document.steps)
        tools.document.undo()
        assert tools.document.strokes[0].keys == MOVING.keys[:1]
        tools.document.redo()
        assert len(tools.document.steps) == before

    def test_with_shift_all_keys_move(self) -> None:
        tools = clip(MOVING)
        tools.document.select(0)
        tools.playback.seek(8)
        tools.document.seek(8)
        x, y = tools.view.to_canvas(160, 100)
        drag(tools, (x, y), (x + 20, y + 40), modifiers=("Shift",))
        keys = tools.document.strokes[0].keys
        assert [key.at for key in keys] == [(110, 120), (170, 120), None, None]
        assert [key.strength for key in keys] == [key.strength for key in MOVING.keys]

    def test_the_end_of_a_weaker_frame_is_dragged_there_and_the_rest_keeps_its_bits(self) -> None:
        tools = clip(replace(MOVING, by=(40, 20)))
        tools.document.select(0)
        tools.playback.seek(12)
        tools.document.seek(12)  # at a quarter of its strength
        x, y = tools.view.to_canvas(170, 105)
        drag(tools, (x, y), (x + 20, y))
        made = tools.document.strokes[0]
        assert made.by == pytest.approx((80, 20))
        assert made.keys == MOVING.keys
        odd = replace(MOVING, by=(0.1, 0.3), keys=(Key(0, at=(100, 100), strength=0.3),))
        tools = clip(odd)
        tools.document.select(0)
        x, y = tools.view.to_canvas(100, 100)
        down(tools, x - 4, y)  # nearer to the pivot than to the end
        move(tools, x + 16, y)
        up(tools, x + 16, y)
        made = tools.document.strokes[0]
        assert made.by == odd.by
        assert made.keys == (Key(0, at=(110, 100), strength=0.3),)

    def test_what_has_no_strength_in_a_frame_keeps_its_drag(self) -> None:
        gone = replace(PULL, keys=(Key(0, at=(100, 100), strength=0), Key(9, strength=1)))
        tools = clip(gone)
        tools.document.select(0)
        assert [handle.part for handle in tools.handles()] == ["pivot"]
        x, y = tools.view.to_canvas(100, 100)
        drag(tools, (x, y), (x + 20, y))
        made = tools.document.strokes[0]
        assert (made.by, made.keys[0]) == (PULL.by, Key(0, at=(110, 100), strength=0))

    def test_keys_lead_to_keys(self) -> None:
        tools = clip(MOVING)
        press(tools, "k")
        assert tools.playback.frame == 0  # none is selected
        tools.document.select(0)
        seen = []
        for key in "kkkkkjjjjj":
            press(tools, key)
            seen.append(tools.playback.frame)
        assert seen == [2, 8, 12, 16, 16, 12, 8, 2, 2, 2]
        assert tools.stroke_frames == dict.fromkeys((2.0, 8.0, 12.0, 16.0), True)

    def test_pins_and_mirror_images_go_along(self) -> None:
        tools = clip(MOVING)
        tools.document.select(0)
        tools.playback.seek(8)
        tools.document.seek(8)
        tools.brush = "pin"
        click(tools, *tools.view.to_canvas(200, 50))
        ((at, by),) = tools.document.strokes[0].also
        assert by == (0, 0)
        assert at == pytest.approx((140.5, 50), abs=1)  # where it is in the recipe: 60 pixels before
        assert tools.document.strokes[0].at == MOVING.at
        assert tools.document.strokes[0].keys == MOVING.keys


@pytest.mark.parametrize("stroke", [MOVING, PULL, Stroke(at=(100, 100, 9), by=(10, 5, 2), radius=30)], ids=str)
def test_frames_that_are_kept_are_those_of_an_export(stroke: Stroke) -> None:
    recipe, count = Recipe(strokes=(stroke,)), 20
    d = Document((count, 200, 300), recipe=recipe, kind="video")
    d.compare(0)
    d.set_hold(2)
    if d.timed:
        job = Job("", "", recipe, clip=ClipOptions(hold=2))
        assert d.deformation == deformation_of(job, closed("a.mp4", count, (200, 300)))
        assert d.base == d.deformation
    else:
        for frame, wanted in enumerate(motion_of(recipe, count, (200, 300), hold=2)):
            d.seek(frame)
            assert d.deformation == wanted
            assert d.base == wanted
    assert d.recipe == replace(recipe, size=d.size, space="pixels", time_scale=1.0 if d.timed else None)
    assert len(d.steps) == 1
    with pytest.raises(SuppleError, match="hold must be a number of frames from 0 to 9, found 10"):
        d.set_hold(10)
    assert d.hold == 2
    d.set_hold(0)
    d.seek(1)
    plain = Document((count, 200, 300), recipe=recipe, kind="video")
    plain.seek(1)
    assert d.deformation == plain.deformation
