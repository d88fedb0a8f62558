"""A stroke whose point a later one carries away from where it arrived is a warning that names both."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
import pytest

from supple import Deformation, Key, MissWarning, Recipe, Stroke
from supple.files.clips import motion_of
from supple.viewer.document.editing import Document

ONE, OTHER = Stroke.grab((60, 60), by=(20, 0), radius=25), Stroke.grab((80, 85), by=(0, 20), radius=25)
AGAIN = Stroke.grab((150, 60), by=(0, 9), radius=25)


def said(make: Callable[[], Deformation]) -> tuple[Deformation, list[str]]:
    """Return what is made, and the warnings of points that are carried away."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        made = make()
    assert all(issubclass(each.category, MissWarning) for each in caught)
    return made, [str(each.message) for each in caught]


def built(*strokes: Stroke, start: Deformation | None = None) -> tuple[Deformation, list[str]]:
    def make() -> Deformation:
        d = start or Deformation((160, 240))
        for stroke in strokes:
            d = d.add(stroke)
        return d

    return said(make)


def test_both_strokes_are_named_when_the_later_one_is_added() -> None:
    d, (text,) = built(ONE, OTHER)
    moved = math.dist(d.forward((60, 60)), (80, 60))
    assert moved > 0.5
    assert text == (
        "stroke 2 of 2, a drag by (0, 20) at (80, 85) with radius 25, carries the point of stroke 1, a drag by (20, 0) "
        f"at (60, 60) with radius 25, away by {moved:.3g} pixels: apply stroke 1 later, or both at once, as a pull"
    )
    assert [arrival.carried_by for arrival in d.arrivals] == [1, None]
    assert d.arrivals[0].moved == pytest.approx(moved)
    assert built(ONE, OTHER, AGAIN)[1] == [text]  # once
    with warnings.catch_warnings(action="error"):
        Deformation((160, 240)).add(ONE).add(OTHER, warn=False)


def test_less_than_half_a_pixel_is_nothing() -> None:
    for drag, carried in ((0.5, False), (0.7, True)):
        later = Stroke.grab((80, 70), by=(0, drag), radius=25)
        d, texts = built(ONE, later)
        assert (d.arrivals[0].moved > 0.5) == carried == bool(texts)


def test_a_recipe_is_one_sentence_with_its_own_numbers() -> None:
    hidden, third = Stroke(at=(9, 9), by=(1, 1), radius=9, hidden=True), Stroke.grab((60, 110), by=(20, 0), radius=12)
    strokes = (hidden, ONE, hidden, third, OTHER, AGAIN)
    d, (text,) = said(lambda: Deformation.from_recipe(Recipe(strokes=strokes), (160, 240)))
    first, second = (d.arrivals[k].moved for k in (0, 1))
    assert text.startswith("stroke 5 of 6, a drag by (0, 20) at (80, 85)")
    assert (
        f"carries the point of stroke 2, a drag by (20, 0) at (60, 60) with radius 25, away by {first:.3g} pix" in text
    )
    assert text.endswith(f"; stroke 5 that of stroke 4 by {second:.3g} pixels")
    many = [Stroke.grab((60 + 4 * k, 60 + 9 * (k % 2)), by=(5, 0), radius=40) for k in range(8)]
    _, (text,) = said(lambda: Deformation.from_recipe(Recipe(strokes=many), (160, 240)))
    assert text.count(" that of stroke ") == 3
    assert text.endswith("more")


def test_what_comes_back_is_not_carried_away() -> None:
    there, back = Stroke.grab((80, 70), by=(0, 2), radius=25), Stroke.grab((80, 72), by=(0, -2), radius=25)
    for order in ((ONE, there), (ONE, there, back)):
        d, texts = said(lambda order=order: Deformation.from_recipe(Recipe(strokes=order), (160, 240)))  # type: ignore[misc]
        assert bool(texts) == (d.arrivals[0].moved > 0.5) == (len(order) == 2)


@pytest.mark.parametrize("time", [False, True])
def test_volumes_say_millimetres_and_clips_frames(time: bool) -> None:
    spacing = (1.0, 1.0, 1.0) if time else (0.7, 0.7, 2.0)
    start = Deformation((40, 60, 80), spacing=spacing, time=time)
    one = Stroke.grab((30, 30, 14), by=(5, 0, 0), radius=12)
    drag = (0.0, 0.0, 6.0)
    d, (text,) = built(one, Stroke.grab((38, 36, 16), by=drag, radius=12, poisson=0.4), start=start)
    off = d.forward((30, 30, 14)) - (35, 30, 14)
    if time:
        assert f"away by {math.hypot(*off[:2]):.3g} pixels and {abs(off[2]):.3g} frames" in text
    else:
        assert f"away by {math.hypot(*(off * spacing)):.3g} mm" in text


def test_points_and_pins_of_pulls_are_watched_and_the_worst_is_said() -> None:
    pull = Stroke.pull([(40, 60), (60, 60)], to=[(45, 60), (60, 66)], pins=[(80, 60)], radius=20)
    d, (text,) = built(pull, Stroke.grab((84, 66), by=(12, 0), radius=12))
    moved = [each.moved for each in (d.arrivals[0], *d.arrivals[0].also)]
    assert np.argmax(moved) == 2
    assert f"carries a point of stroke 1, a pull of 3 handles with radius 20, away by {moved[2]:.3g} pixels" in text
    assert d.arrivals[0].also[1].carried_by == 1
    one = Stroke.grab((50, 80), by=(0, -4), radius=20)
    assert "a pull of 3 handles with radius 20, carries the point of stroke 1" in built(one, pull)[1][0]
    held = Stroke.pull([(84, 66)], by=[(12, 0)], pins=[(80, 60)], radius=12)
    assert not built(ONE, held)[1]  # the point is pinned


def test_brushes_carry_points_but_have_no_target_of_their_own() -> None:
    twist = Stroke.twist((80, 80), angle=60, radius=25)
    assert "stroke 2 of 2, a twist by 60°" in built(ONE, twist)[1][0]
    assert "apply stroke 1 later" in built(ONE, twist)[1][0]
    assert "pull" not in built(ONE, twist)[1][0]
    assert not built(twist, ONE)[1]


@pytest.mark.parametrize(
    "strokes",
    [
        (ONE, Stroke.grab((80, 60), by=(0, 30), radius=25)),
        (ONE, Stroke.grab((81, 61.5), by=(0, 30), radius=25)),
        (Stroke.grab((60, 60), path=[(80, 60), (80, 80), (60, 80)], radius=25),),
        (Stroke.grab((60, 60), by=(120, 0), radius=20),),
        Stroke.grab((100, 60), path=[(95, 70), (105, 90)], radius=30).symmetric((119.5, 0), (1, 0)),
        Stroke.grab((100, 60), by=(-12, 9), radius=30).symmetric((119.5, 0), (1, 0)),
    ],
    ids=["taken on", "about there", "path", "flow", "mirrored path", "mirrored grab"],
)
def test_strokes_that_belong_together_do_not_warn(strokes: tuple[Stroke, ...]) -> None:
    d, texts = built(*strokes)
    assert not texts
    assert {arrival.carried_by for arrival in d.arrivals} == {None}


def test_restoring_and_smoothing_undo_on_purpose() -> None:
    start = Deformation((160, 240)).add(ONE)
    restored, texts = said(
        lambda: start.restore((80, 62), radius=40).restore((70, 60), radius=40).smooth((60, 70), radius=30)
    )
    assert not texts
    assert restored.arrivals[0].moved > 5


def test_maps_between_strokes_carry_nothing_away() -> None:
    d, texts = built(ONE)
    shifted = d.affine([[1, 0, 9.0], [0, 1, 0]])
    made, more = said(lambda: shifted.add(Stroke.grab((200, 130), by=(4, 0), radius=15)))
    assert not texts
    assert not more
    assert made.arrivals[0].moved == pytest.approx(9)
    assert made.arrivals[0].carried_by is None
    made, (text,) = said(lambda: shifted.add(Stroke.grab((71, 70), by=(0, 1.5), radius=25)))
    assert f"away by {abs(made.forward((60, 60))[1] - 60):.3g} pixels" in text  # without the shift


def test_strokes_with_keys_are_one_warning_of_all_frames() -> None:
    keys = (Key(0, at=(200, 85)), Key(9, at=(80, 85)))
    moving = Recipe(strokes=(ONE, Stroke(at=(200, 85), by=(0, 20), radius=20, keys=keys)))
    with warnings.catch_warnings(record=True, action="always") as caught:
        frames = motion_of(moving, 10, (160, 240))
    (text,) = [str(each.message) for each in caught]
    far = [d.arrivals[0].carried_by == 1 for d in frames]
    assert 1 < sum(far) < 10
    assert text.startswith(f"frame {far.index(True)} (and in {sum(far) - 1} more): stroke 2 of 2, a drag by (0, 20)")


def test_the_window_marks_the_stroke() -> None:
    document = Document(
        (160, 240), recipe=Recipe(strokes=(ONE, Stroke(at=(9, 9), by=(1, 1), radius=9, hidden=True), OTHER))
    )
    assert [document.carrier(i) for i in range(3)] == [2, None, None]
    assert [document.misses(i) for i in range(3)] == [True, False, False]
    document.hide(2, True)
    assert not document.misses(0)
