"""Undo steps by name, and the way through all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from supple.errors import SuppleError
from supple.strokes import Recipe, Stroke
from supple.viewer.document.editing import Document
from supple.viewer.document.words import described, done, drawn, listed, named, place

SHAPE = (60, 80)
A = Stroke(at=(20, 20), by=(4, 2), radius=9)
B = Stroke(at=(50, 40), by=(-3, 5), radius=7)
C = Stroke(at=(30, 45), by=(1, -5), radius=5)


def test_each_step_has_a_name() -> None:
    d = Document(SHAPE, recipe=Recipe(strokes=(A, B, C)))
    steps: list[tuple[Callable[[], object], str]] = [
        (lambda: d.add(A), "Grab at (20, 20)"),
        (lambda: d.remove(3), "Remove stroke 4"),
        (lambda: d.remove(0), "Remove stroke 1"),
        (d.undo, ""),
        (lambda: d.replace(1, replace(B, radius=8)), "Radius of stroke 2"),
        (lambda: d.replace(0, replace(A, by=(3, 3))), "Drag of stroke 1"),
        (lambda: d.replace(0, replace(A, at=(21, 20))), "Edit stroke 1"),
        (lambda: d.replace(0, replace(A, at=(22, 20))), "Position of stroke 1"),
        (lambda: d.replace(2, replace(C, scales=2)), "Fall-off of stroke 3"),
        (lambda: d.hide(1), "Hide stroke 2"),
        (lambda: d.hide(1, False), "Show stroke 2"),
        (lambda: d.move(2, 0), "Move stroke 3 earlier"),
        (lambda: d.move(0, 2), "Move stroke 1 later"),
        (lambda: d.set_rest(border=None), "Free the border"),
        (lambda: d.set_rest(border=5), "Fix the border"),
        (lambda: d.set_rest(on_fold="error"), "Folds"),
        (lambda: d.load(Recipe(strokes=(C,))), "Open a recipe"),
    ]
    for act, name in steps:
        act()
        if name:
            assert d.state.made_by == d.steps[d.step].made_by == name


def test_any_step_is_one_way_from_any_other() -> None:
    d = Document(SHAPE)
    for stroke in (A, B, C):
        d.add(stroke)
    assert [len(state.strokes) for state in d.steps] == [0, 1, 2, 3]
    heard: list[int] = []
    d.on_change.append(lambda: heard.append(len(d.strokes)))
    for to in (1, 3, 0, 2):
        d.go(to)
        assert d.step == to
    d.go(2)
    assert heard == [1, 3, 0, 2]  # those between are not shown
    assert (d.can_undo, d.can_redo) == (True, True)
    d.begin_drag()
    with pytest.raises(SuppleError, match="a drag is under way"):
        d.go(0)
    d.abandon()
    d.add(A)
    assert len(d.steps) == 4


def test_other_brushes_in_words() -> None:
    for brush, name, does in (
        (
            Stroke(at=(5, 6), by=(9, 0), radius=9, also=(((1, 2), (0, 0)), ((3, 4), (1, 0)))),
            "Grab at (5, 6)",
            "by (9, 0) with 1 other point and 1 pin",
        ),
        (Stroke(at=(5, 6), by=(9, 0), radius=9, also=(((1, 2), (0, 0)),)), "Grab at (5, 6)", "by (9, 0) with 1 pin"),
        (Stroke(at=(5, 6), by=(9, 0), radius=9, path=((7, 9),)), "Path at (5, 6)", "by (9, 0)"),
        (Stroke(at=(5, 6), by=(9, 0), radius=9, name="restore"), "Restore at (5, 6)", "by (9, 0)"),
        (Stroke(at=(5, 6), radius=9, brush="scale", factor=0.5), "Pucker at (5, 6)", "by a factor of 0.5"),
        (Stroke(at=(5, 6), radius=9, brush="twist", angle=40), "Twist at (5, 6)", "by 40\u00b0"),
        (Stroke(at=(5, 6), radius=9, brush="scale", factor=1.5), "Bloat at (5, 6)", "by a factor of 1.5"),
        (
            Stroke(at=(5, 6), radius=9, brush="pinch", factor=0.5, axis=(1, 1)),
            "Pinch at (5, 6)",
            "by a factor of 0.5, axis (1, 1)",
        ),
    ):
        assert f"{named(brush)} at {place(brush.at)}" == name
        assert done(brush) == does
        assert drawn((brush,)) == name
        if brush.brush != "grab":
            assert described(brush, None).splitlines()[1:] == [does, "radius 9", "reach: 4 radii"]


def test_a_list_says_how_much() -> None:
    for stroke, said in (
        (A, "Grab (20, 20), radius 9"),
        (Stroke(at=(5, 6), radius=37.5, brush="twist", angle=-40.25), "Twist (5, 6) -40.2\u00b0, radius 37.5"),
        (Stroke(at=(5, 6, 7), radius=9, brush="scale", factor=0.5), "Pucker (5, 6, 7) \u00d70.5, radius 9"),
    ):
        assert listed(stroke) == said


def test_strokes_that_were_drawn_at_once_are_one_step_in_words() -> None:
    some = [Stroke(at=(k, 6), by=(1, 0), radius=9, name="smooth") for k in range(3)]
    assert drawn(some) == "Smooth at (0, 6), 3 strokes"


def test_any_step_is_compared_with_whatever_happens_to_it() -> None:
    d = Document(SHAPE, recipe=Recipe(border=None))
    for stroke in (A, B, C):
        d.add(stroke)
    assert d.compared is None
    assert d.base.is_identity
    assert d.compared_step is None
    d.compare(1)
    assert d.compared is d.steps[1]
    assert d.compared_step == 1
    assert d.base == Document(SHAPE, recipe=Recipe(border=None, strokes=(A,))).deformation
    base = d.base
    d.select(0)
    d.go(1)
    d.select(None)
    assert d.compared_step == 1
    d.go(0)
    assert d.compared_step == 1
    d.add(A)  # the step is gone from the history, and this is another one
    assert d.base is base
    assert d.compared is not None
    assert d.compared_step is None
    d.compare(None)
    assert d.base.is_identity
    assert d.compared is None
