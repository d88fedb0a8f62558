"""The document of the window: edits, drags, undo and redo, refusals, and what is rendered of it."""

from __future__ import annotations

import gc
import itertools
import random
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from supple.deformation import Deformation
from supple.errors import FoldError, FoldWarning, SuppleError
from supple.space.freezing import Freeze
from supple.space.geometry import Geometry
from supple.strokes import Recipe, Stroke
from supple.strokes.keys import Key
from supple.viewer.document.editing import Document

SHAPE = (120, 160)


def stroke(x: float = 60, y: float = 50, dx: float = 9, dy: float = -4, **rest: Any) -> Stroke:
    return Stroke(**{"at": (x, y), "by": (dx, dy), "radius": 30, **rest})


STRONG = stroke(dx=200)


def same(d: Document) -> None:
    """The deformation is that of the recipe, to the last bit."""
    with warnings.catch_warnings(action="ignore", category=FoldWarning):
        expected = Deformation.from_recipe(d.recipe, d.shape, spacing=d.spacing)
    assert d.deformation.space.table.tobytes() == expected.space.table.tobytes()
    assert d.deformation.recipe == expected.recipe
    points = np.random.default_rng(0).uniform(0, 100, (20, len(d.shape)))
    np.testing.assert_array_equal(d.deformation.forward(points), expected.forward(points))


class TestEdits:
    def test_each_is_a_step(self) -> None:
        a, b = stroke(), stroke(90, 70)
        d = Document(SHAPE)
        steps: list[tuple[Any, ...]] = [
            (d.add, a),
            (d.add, b),
            (d.replace, 0, stroke(dx=3)),
            (d.move, 0, 1),
            (d.hide, 1),
            (d.hide, 1, False),
            (lambda border: d.set_rest(border=border), None),
            (lambda on_fold: d.set_rest(on_fold=on_fold), "damp"),
            (d.remove, 0),
            (d.load, Recipe(strokes=(b, replace(a, hidden=True)))),
        ]
        states, objects = [d.state], [d.deformation]
        for k, (act, *args) in enumerate(steps):
            act(*args)
            states.append(d.state)
            objects.append(d.deformation)
            assert d.revision == k + 1
            same(d)
        assert all(one != other for one, other in itertools.pairwise(states))
        for k in reversed(range(len(steps))):
            d.undo()
            assert d.state == states[k]
            same(d)
        assert not d.can_undo
        assert not d.dirty
        d.undo()
        assert d.state == states[0]
        for k in range(len(steps)):
            d.redo()
            assert d.state == states[k + 1]
            assert d.deformation.space.table.tobytes() == objects[k + 1].space.table.tobytes()
        assert not d.can_redo
        d.redo()
        assert d.state == states[-1]

    def test_what_they_do(self) -> None:
        a, b, c = stroke(), stroke(90, 70), stroke(40, 40)
        d = Document(SHAPE, recipe=Recipe(strokes=(a, b, c)))
        d.select(2)
        d.move(2, 0)
        assert (list(d.strokes), d.selected) == ([c, a, b], 0)
        d.move(1, 2)
        assert (list(d.strokes), d.selected) == ([c, b, a], 0)
        d.select(2)
        d.remove(0)
        assert (list(d.strokes), d.selected) == ([b, a], 1)
        d.remove(1)
        assert (d.strokes, d.selected) == ((b,), None)
        assert d.add(replace(c, hidden=True)) == 1
        assert d.strokes[1] == replace(c, hidden=True)
        d.replace(1, a)
        assert d.strokes[1] == replace(a, hidden=True)
        assert d.recipe.strokes == (b, replace(a, hidden=True))
        assert d.deformation.strokes == (b,)

    def test_nothing_is_no_step(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(),)))
        d.replace(0, stroke())
        d.move(0, 0)
        d.hide(0, False)
        d.set_rest(border="auto")
        d.set_rest(on_fold="flow")
        d.load(d.recipe)
        assert (d.can_undo, d.revision) == (False, 0)

    def test_selection_is_no_step(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(), stroke(90, 70))))
        d.remove(1)
        d.undo()
        before = d.deformation
        d.select(1)
        assert (d.selected, d.can_undo, d.can_redo, d.dirty) == (1, False, True, False)
        assert d.deformation is before
        d.redo()
        assert d.selected is None
        d.undo()
        assert d.selected == 1
        d.select(None)
        assert d.selected is None

    def test_unchanged_strokes_are_not_worked_out_again(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(), stroke(90, 70))))
        first, before = d.deformation._resolved, d.deformation
        d.add(stroke(20, 20))
        d.hide(2)
        assert d.deformation._resolved == first
        d.replace(2, stroke(30, 30))
        assert d.deformation.strokes == before.strokes
        known = d.deformation
        d.replace(2, stroke(31, 30))  # a hidden one
        assert d.deformation is known

    def test_dirty(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(),)))
        assert not d.dirty
        d.add(stroke(90, 70))
        assert d.dirty
        d.mark_saved()
        assert not d.dirty
        d.undo()
        assert d.dirty
        d.redo()
        d.select(0)
        assert not d.dirty


class TestRefusals:
    @pytest.mark.parametrize("dragging", [False, True])
    def test_numbers(self, dragging: bool) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(),)))
        d.add(stroke(90, 70))
        d.undo()
        before, revision, deformation = d.state, d.revision, d.deformation
        solid = Stroke(at=(1, 2, 3), by=(1, 1, 1), radius=9)
        acts: list[Any] = [
            lambda: d.set_rest(border=-1),
            lambda: d.set_rest(on_fold="tear"),  # type: ignore[arg-type]
            lambda: d.add(solid),
            lambda: d.load(Recipe(strokes=(solid,))),
            lambda: d.load(Recipe(strokes=(replace(stroke(), keys=(Key(3, strength=0),)),))),
        ]
        if dragging:
            d.begin_drag()
            acts = [lambda: d.add(stroke()), lambda: d.set_rest(border=9), lambda: d.select(0), d.begin_drag]
        for act in acts:
            with pytest.raises(SuppleError) as caught:
                act()
            assert str(caught.value).isprintable()
        assert (d.state, d.revision, d.can_redo) == (before, revision, not dragging)
        assert d.deformation is deformation

    def test_folds(self) -> None:
        d = Document(SHAPE, recipe=Recipe(on_fold="error", strokes=(stroke(),)))
        before = d.state
        with pytest.raises(FoldError, match=r"^stroke 2: a drag by"):
            d.add(STRONG)
        assert (d.state, d.revision, d.can_undo) == (before, 0, False)
        d = Document(SHAPE, recipe=Recipe(on_fold="damp", strokes=(STRONG,)))
        with pytest.raises(FoldError):
            d.set_rest(on_fold="error")
        assert d.state.rest.on_fold == "damp"
        d.hide(0)
        d.set_rest(on_fold="error")
        with pytest.raises(FoldError):
            d.hide(0, False)
        assert d.strokes[0].hidden

    def test_no_drag(self) -> None:
        d = Document(SHAPE)
        for act in (d.commit, d.abandon, lambda: d.preview(stroke())):
            with pytest.raises(SuppleError, match="no drag"):
                act()

    def test_what_starts_outside_of_time_or_space(self) -> None:
        clip, solid = (Document((5, 40, 60), kind=kind) for kind in ("video", "volume"))  # type: ignore[arg-type]
        late = Stroke(at=(9, 9, 99), by=(1, 1, 1), radius=9)
        with pytest.raises(
            SuppleError, match=r"outside the clip, which has 60 x 40 pixels and 5 frames .*, and reaches"
        ):
            clip.add(late)
        assert solid.add(replace(late, at=(62, 9, 2))) == 0
        with pytest.raises(SuppleError, match=r"5 voxels \(its point is in voxels here\), and reaches nothing"):
            solid.add(replace(late, at=(99, 9, 2)))
        clip.add(replace(late, hidden=True))
        with pytest.raises(SuppleError, match="reaches nothing"):
            clip.hide(0, False)


class TestFolds:
    def test_each_stroke_knows_where_it_arrives(self, recwarn: pytest.WarningsRecorder) -> None:
        strokes = (stroke(), replace(STRONG, hidden=True), STRONG)
        d = Document(SHAPE, recipe=Recipe(on_fold="damp", strokes=strokes))
        first, second, third = map(d.arrival, range(3))
        assert first is not None
        assert (first.miss, first.cause) == (0, None)
        assert second is None
        assert third is not None
        assert third.cause == "fold"
        assert third.target == (260, 46)
        assert 60 < third.arrived[0] < 240
        assert d.deformation.warnings[0] is None
        assert "damped to" in (d.deformation.warnings[1] or "")  # the second is hidden
        assert d.tracks()[-1][1].handles == (((60, 50), third.arrived),)
        assert not recwarn.list
        d.hide(1, False)
        assert d.arrival(1) is not None
        assert d.arrival(1).arrived == third.arrived
        assert d.arrival(1).moved > 1  # by the third, which begins there too


class TestHiddenStrokes:
    HIDDEN = replace(stroke(90, 70), hidden=True)

    def test_a_deformation_leaves_them_out(self) -> None:
        recipe = Recipe(strokes=(self.HIDDEN, stroke(), self.HIDDEN))
        d = Deformation.from_recipe(recipe, SHAPE)
        assert d.recipe == Recipe(strokes=(stroke(),), size=SHAPE[::-1])
        assert d.space.table.tobytes() == Deformation(SHAPE).add(stroke()).space.table.tobytes()
        assert d.report().strokes == 1
        assert d.add(self.HIDDEN) is d
        with pytest.raises(SuppleError, match="2 numbers"):
            d.add(Stroke(at=(1, 2, 3), by=(1, 1, 1), radius=9, hidden=True))

    def test_errors_count_them(self) -> None:
        with pytest.raises(FoldError, match=r"^stroke 2 of 2: "):
            Deformation.from_recipe(Recipe(on_fold="error", strokes=(self.HIDDEN, STRONG)), SHAPE)

    def test_a_deformation_need_not_warn(self) -> None:
        d = Deformation(SHAPE, on_fold="damp").add(stroke()).add(STRONG, warn=False)
        first, second = d.warnings
        assert first is None
        with pytest.warns(FoldWarning) as caught:
            Deformation(SHAPE, on_fold="damp").add(STRONG)
        assert str(caught[0].message) == second


class TestDrags:
    def test_is_one_step(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(),)))
        before = d.state
        d.begin_drag()
        assert d.dragging
        for k in range(50):
            assert d.preview(stroke(90, 70, k, 0))
            same(d)
        assert d.state.strokes[1].by == (49, 0)
        assert (d.selected, d.can_redo, d.dirty) == (1, False, True)
        assert d.commit()
        assert not d.dragging
        d.undo()
        assert (d.state, d.can_undo) == (before, False)
        d.redo()
        assert d.strokes[1] == stroke(90, 70, 49, 0)
        same(d)

    def test_edits_a_stroke(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(), stroke(90, 70))))
        d.begin_drag(0)
        d.preview(stroke(dx=3))
        assert (list(d.strokes), d.selected) == ([stroke(dx=3), stroke(90, 70)], 0)
        d.commit()
        same(d)
        d.undo()
        assert d.strokes[0] == stroke()

    @pytest.mark.parametrize("end", ["abandon", "undo"])
    def test_is_put_back(self, end: str) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(),)))
        d.add(stroke(90, 70))
        d.undo()
        d.select(0)
        before, deformation = d.state, d.deformation
        d.begin_drag()
        d.preview(stroke(40, 40))
        d.preview(STRONG)
        getattr(d, end)()
        assert d.state is before
        assert d.deformation is deformation
        assert (d.dragging, d.can_redo, d.dirty, d.trouble) == (False, True, False, None)

    def test_nothing_is_no_step(self) -> None:
        d = Document(SHAPE, recipe=Recipe(strokes=(stroke(),)))
        d.add(stroke(90, 70))
        d.undo()
        d.begin_drag()
        assert not d.commit()
        d.begin_drag(0)
        d.preview(stroke(dx=1))
        d.preview(stroke())
        assert not d.commit()
        assert (d.can_undo, d.can_redo, d.selected) == (False, True, None)

    def test_the_last_good_one_stays(self) -> None:
        d = Document(SHAPE, recipe=Recipe(on_fold="error"))
        d.begin_drag()
        assert d.preview(stroke(dx=5))
        told: list[str | None] = []
        d.on_change.append(lambda: told.append(d.trouble))
        assert not d.preview(STRONG)
        assert d.strokes[0] == stroke(dx=5)
        assert d.trouble is not None
        assert "folds" in d.trouble
        assert told == [d.trouble]
        assert d.preview(stroke(dx=6))
        assert d.trouble is None
        d.preview(STRONG)
        assert d.commit()
        assert (d.strokes[0], d.trouble) == (stroke(dx=6), None)


class TestRecipes:
    def test_nothing_that_a_recipe_says_is_lost(self) -> None:
        recipe = Recipe(
            amount=0.3,
            size=SHAPE[::-1],
            space="pixels",
            strokes=(stroke(name="cheek", strength=0.5), stroke(90, 70, 20, 0, hidden=True, name="eye")),
        )
        d = Document(SHAPE, recipe=recipe)
        assert d.recipe == recipe
        d.hide(1, False)
        d.replace(0, replace(d.strokes[0], radius=20))
        assert [(s.name, s.strength) for s in d.recipe.strokes] == [("cheek", 0.5), ("eye", 1.0)]
        assert d.recipe.amount == 0.3
        d.undo()
        d.undo()
        assert d.recipe == recipe

    def test_a_recipe_of_a_smaller_picture_is_scaled(self) -> None:
        small = Recipe(size=(80, 60), strokes=(stroke(30, 25),))
        d = Document(SHAPE, recipe=small)
        assert d.recipe == replace(small.fitted((160, 120)), space="pixels")
        assert d.strokes[0].at == (60.5, 50.5)
        with pytest.raises(SuppleError, match="made for 90 x 60, and this is 160 x 120, of other proportions"):
            d.load(replace(small, size=(90, 60)))
        clip = Recipe(size=(80, 60, 9), strokes=(Stroke(at=(9, 9, 4), by=(2, 0, 0), radius=5),))
        with pytest.raises(SuppleError, match="supple warp scales it, and the window does not"):
            Document((9, 120, 160), recipe=clip, kind="video")

    @pytest.mark.parametrize("space", ["LPS", "RAS"])
    def test_millimetres_are_edited_as_voxels_and_kept(self, space: Any) -> None:
        geometry = Geometry((2, 1, 3), (-10, 20, 30), convention="LPS")
        place = tuple(geometry.to_world((10, 12, 5), space).tolist())
        recipe = Recipe(size=(30, 24, 12), space=space, strokes=(Stroke(at=place, by=(4, 2, 3), radius=9),))
        d = Document((12, 24, 30), geometry.spacing, recipe, kind="volume", geometry=geometry)
        sign = -1 if space == "RAS" else 1
        np.testing.assert_allclose(d.strokes[0].at, (10, 12, 5))
        np.testing.assert_allclose(d.strokes[0].by, (2 * sign, 2 * sign, 1))
        assert (d.recipe.space, d.recipe.size) == (space, (30, 24, 12))
        np.testing.assert_allclose(d.recipe.strokes[0].at, place)
        np.testing.assert_allclose(d.recipe.strokes[0].by, (4, 2, 3))
        with pytest.raises(SuppleError, match=f"in {space} millimetres, and this is no volume"):
            Document((12, 24, 30), recipe=recipe)

    def test_a_part_of_a_recipe_is_drawn_on_as_it_is_seen(self) -> None:
        recipe = Recipe(
            border=None,
            amount=0.5,
            strokes=(stroke(60, 50, 20, 0, strength=0.5), stroke(82, 50, 0, 16), stroke(90, 70)),
        )
        d = Document(SHAPE, recipe=recipe)
        same(d)
        assert d.deformation.strokes[0].by == (5, 0)
        assert d.tracks()[1][1].handles[0][0] == d.deformation.strokes[1].at != (82, 50)
        drawn = stroke(70, 66, 6, 3)
        d.begin_drag()
        assert d.preview(drawn)
        d.commit()
        same(d)
        np.testing.assert_allclose(d.deformation.strokes[3].at, drawn.at, atol=1e-6)
        np.testing.assert_allclose(d.deformation.strokes[3].by, drawn.by, atol=1e-9)
        held = replace(d.seen(1), by=(1.0, 5.0))
        d.begin_drag(1)
        assert d.preview(held)
        d.commit()
        same(d)
        np.testing.assert_allclose(d.deformation.strokes[1].at, held.at, atol=1e-6)
        np.testing.assert_allclose(d.deformation.strokes[1].by, held.by, atol=1e-9)
        np.testing.assert_allclose(d.recipe.strokes[1].at, (82, 50), atol=1e-6)
        np.testing.assert_allclose(d.recipe.strokes[1].by, (2, 10), atol=1e-9)
        d.undo()
        d.hide(0)
        same(d)
        d.hide(0, False)
        same(d)


def random_edit(d: Document, rng: random.Random) -> None:
    n = len(d.strokes)
    some = stroke(
        rng.uniform(0, 160), rng.uniform(0, 120), rng.gauss(0, 40), rng.gauss(0, 40), radius=rng.choice([5, 40])
    )
    i = rng.randrange(n) if n else None
    acts: list[Any] = [
        lambda: d.add(some),
        lambda: d.set_rest(border=rng.choice([None, 5, 30])),
        lambda: d.set_rest(on_fold=rng.choice(["damp", "flow", "error"])),  # type: ignore[arg-type]
        lambda: d.select(i),
        d.begin_drag,
        lambda: d.load(Recipe(strokes=(some, replace(some, hidden=True)))),
    ]
    if i is not None:
        acts += [
            lambda: d.remove(i),
            lambda: d.replace(i, some),
            lambda: d.move(i, rng.randrange(n)),
            lambda: d.hide(i, rng.random() < 0.5),
            lambda: d.begin_drag(i),
            lambda: d.remove(rng.randrange(n)),
        ]
    rng.choice(acts)()
    if d.dragging:
        for _ in range(rng.randrange(4)):
            d.preview(replace(some, by=(rng.gauss(0, 40), rng.gauss(0, 40))))
        rng.choice([d.commit, d.abandon, d.undo])()


@pytest.mark.filterwarnings("ignore::supple.errors.OutsideWarning")
@pytest.mark.parametrize("seed", [0, 1])
def test_soak(seed: int) -> None:
    rng = random.Random(seed)
    gc.collect()
    # Their types, not themselves: some of other libraries' objects warn of being looked at.
    before = sum(issubclass(type(thing), Deformation) for thing in gc.get_objects())
    d = Document(SHAPE, recipe=Recipe(strokes=(stroke(), replace(stroke(90, 70), hidden=True))))
    first, table = d.state, d.deformation.space.table.tobytes()
    past = [d.state.content]  # what undo must bring back
    refused = 0
    for k in range(500):
        if rng.random() < 0.3:
            rng.choice([d.undo, d.redo])()
        else:
            try:
                random_edit(d, rng)
            except SuppleError:
                refused += 1
        assert not d.dragging
        if k % 50 == 0:
            same(d)
            past.append(d.state.content)
    assert 0 < refused < 200
    same(d)
    last, steps = d.state, 0
    while d.can_undo:
        d.undo()
        steps += 1
    assert steps > 5
    assert d.state.content == first.content
    assert d.deformation.space.table.tobytes() == table
    gc.collect()
    alive = sum(issubclass(type(thing), Deformation) for thing in gc.get_objects())
    assert alive - before <= len(d.strokes) + 10  # none is kept for a state that is not shown
    while d.can_redo:
        d.redo()
    assert d.state.content == last.content
    same(d)


def test_a_clip_knows_what_a_frame_is_worth() -> None:
    late = Stroke(at=(30, 20, 3), by=(4, 0, 0), radius=9)
    d = Document((9, 40, 60), (1.0, 1.0, 2.5), Recipe(strokes=(late,), time_scale=2.5), kind="video")
    assert d.recipe.time_scale == 2.5
    with pytest.raises(SuppleError, match=r"frame is worth 4 pixels, and here 2\.5: open .* --time-scale 4"):
        d.load(Recipe(strokes=(late,), time_scale=4))
    assert Document(SHAPE).recipe.time_scale is None


def test_a_matte_is_kept_whatever_is_done_to_its_stroke() -> None:
    white = np.zeros(SHAPE, np.uint8)
    white[:, :70] = 255
    matte = Freeze.of(white, matte=True)
    d = Document(SHAPE, (1.0, 1.0), Recipe(strokes=(stroke(matte=matte), stroke(100))))
    same(d)
    d.replace(0, replace(d.recipe.strokes[0], radius=40))
    d.move(1, 0)
    same(d)
    assert [one.matte for one in d.recipe.strokes] == [None, matte]
    assert Recipe.from_json(d.recipe.to_json()) == d.recipe
