"""Freezes among strokes: the state before them stays, bit for bit; and amounts and strengths beyond 0 and 1."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple import Deformation, Freeze, Recipe, Stroke, SuppleError, warp_file
from supple.engine.work import Mattes, refuse_mattes
from supple.errors import FoldError, FoldWarning, MissWarning
from supple.folding.resolved import described
from supple.strokes import pack
from tests.clips import decoded, make
from tests.effort import examples

pytestmark = pytest.mark.filterwarnings("ignore::supple.MissWarning")

Bools = npt.NDArray[np.bool_]
SHAPE = (120, 160)


def ball(shape: tuple[int, ...], rng: np.random.Generator) -> Bools:
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    centre, size = rng.uniform(0.2, 0.8, len(shape)) * shape, min(shape[-2:])
    away = np.linalg.norm((places - centre) / np.array(shape) * size, axis=-1)
    return np.asarray(away < rng.uniform(0.08, 0.3) * size)


def drawn(shape: tuple[int, ...], rng: np.random.Generator) -> Stroke:
    at, size = rng.uniform(0.2, 0.8, len(shape)) * shape[::-1], np.array(shape[::-1])
    radius = float(rng.uniform(0.05, 0.25) * min(shape))
    if len(shape) == 2 and rng.uniform() < 0.3:
        return Stroke.twist(at, angle=float(rng.uniform(-60, 60)), radius=radius)
    return Stroke.grab(at, by=rng.uniform(-0.08, 0.08, len(shape)) * size, radius=radius)


def disc(x: float, y: float, radius: float) -> Bools:
    return np.asarray(np.hypot(*np.ogrid[-y : SHAPE[0] - y, -x : SHAPE[1] - x]) < radius)


@examples(12)
@given(st.integers(0, 10**6), st.sampled_from([(90, 130), (120, 170), (230, 90), (10, 40, 44), (8, 44, 40)]))
def test_what_is_frozen_is_the_state_before_bit_for_bit(seed: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    state = Deformation(shape, border=(None, "auto")[seed % 2], time=len(shape) == 3 and shape[0] == 8)
    for _ in range(rng.integers(1, 4)):
        state = state.add(drawn(shape, rng), warn=False)
    mask, more = ball(shape, rng), ball(shape, rng)
    whole = held = state.freeze(mask)
    for _ in range(rng.integers(1, 4)):
        whole = whole.add(drawn(shape, rng), warn=False)
    np.testing.assert_array_equal(whole.inverse_map()[mask], state.inverse_map()[mask])
    # The oracle: one deformation after the other, the second with the mask from the beginning.
    second = Deformation(shape, border=state.domain.border, time=state.domain.time, freeze=mask)
    for stroke in whole.strokes[len(held.strokes) :]:
        second = second.add(stroke, warn=False)
    points = rng.uniform(0, 1, (300, len(shape))) * (np.array(shape[::-1]) - 1)
    np.testing.assert_allclose(whole.forward(points), second.forward(state.forward(points)), atol=1e-9)
    back = whole.inverse(points)
    assert back.converged.all()
    np.testing.assert_allclose(whole.forward(back.points), points, atol=1e-5)
    report = whole.report()
    assert report.within
    assert report.margin > 0
    assert report.folds == 0
    # Another freeze after that holds what there is then, where the first one held and elsewhere.
    both = Freeze.of(more, width=5).times(Freeze.of(mask))
    last = whole.freeze(both).add(drawn(shape, rng), warn=False).add(drawn(shape, rng), warn=False)
    np.testing.assert_array_equal(last.inverse_map()[mask | more], whole.inverse_map()[mask | more])
    samples = np.argwhere(mask | more)[::11, ::-1].astype(float)
    np.testing.assert_array_equal(last.inverse(samples).points, whole.inverse(samples).points)


def bent() -> tuple[Deformation, Deformation, Bools]:
    """A state, the same with a freeze and strokes, and what is frozen."""
    mask = disc(85, 62, 24)
    state = Deformation(SHAPE).grab((70, 60), by=(14, 3), radius=24).twist((95, 60), angle=30, radius=14)
    whole = state.freeze(mask).grab((112, 60), by=(-16, 8), radius=20).grab((60, 80), by=(20, -10), radius=18)
    return state, whole, mask


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("options", [{}, {"filter": "linear", "outside": "reflect"}, {"filter": "nearest"}])
def test_pictures_show_it(dtype: Any, options: Any) -> None:
    state, whole, mask = bent()
    source = (np.random.default_rng(1).uniform(0, 1, (*SHAPE, 3)) * (1 if np.dtype(dtype).kind == "f" else 200)).astype(
        dtype
    )
    made, held = whole.warp(source, **options), state.warp(source, **options)
    np.testing.assert_array_equal(made[mask], held[mask])
    assert (made != held).any()
    assert (held[mask] != source[mask]).any()  # what was done before keeps its effect
    part = whole.grid.crop((40, 30), (70, 51))
    np.testing.assert_array_equal(whole.warp(source, grid=part, **options), made[30:81, 40:110])


def test_clips_show_it_with_their_chroma(tmp_path: Path) -> None:
    clip = make(tmp_path / "in.mkv", "ffv1", count=2, size=SHAPE[::-1], smooth=False)
    state, whole, mask = bent()
    for name, d in (("state", state), ("whole", whole)):
        warp_file(clip, tmp_path / f"{name}.mkv", d.recipe)
    for a, b in zip(decoded(tmp_path / "state.mkv"), decoded(tmp_path / "whole.mkv"), strict=True):
        one, other = a.to_ndarray(), b.to_ndarray()
        np.testing.assert_array_equal(one[: SHAPE[0]][mask], other[: SHAPE[0]][mask])
        for plane in (0, 1):  # of colours, whose samples lie between pixels
            u, v = (x[SHAPE[0] :].reshape(2, SHAPE[0] // 2, -1)[plane] for x in (one, other))
            np.testing.assert_array_equal(u[mask[::2, ::2] & mask[1::2, 1::2]], v[mask[::2, ::2] & mask[1::2, 1::2]])
        assert (one != other).any()


def test_a_freeze_before_all_strokes_is_that_of_the_deformation() -> None:
    mask = disc(85, 62, 24)
    one = Deformation(SHAPE, freeze=mask).grab((60, 60), by=(10, 3), radius=24)
    other = Deformation(SHAPE).freeze(mask).grab((60, 60), by=(10, 3), radius=24)
    np.testing.assert_array_equal(one.inverse_map(), other.inverse_map())
    assert not isinstance(other.space.freeze, Mattes)  # which other devices take
    assert one.report() == replace(other.report(), strokes=1, damping=(1.0,), arrivals=other.arrivals[1:])


def test_thawing_is_an_edit_like_any_other() -> None:
    mask, stroke = disc(85, 62, 24), Stroke.grab((85, 62), by=(12, 5), radius=22)
    state = Deformation(SHAPE).grab((70, 60), by=(14, 3), radius=24)
    held = state.freeze(mask).grab((110, 60), by=(-10, 0), radius=20)
    thawed = held.freeze(None).add(stroke)
    assert thawed.arrivals[-1].miss < 1e-6
    free = Deformation(SHAPE).add(stroke)
    points = np.random.default_rng(2).uniform((0, 0), (159, 119), (400, 2))
    np.testing.assert_allclose(thawed.forward(points), free.forward(held.forward(points)), atol=1e-12)
    assert [s.brush for s in thawed.strokes] == ["grab", "freeze", "grab", "freeze", "grab"]
    # In place of the mask before it, not beside it.
    moved = held.freeze(disc(20, 20, 10)).add(stroke)
    np.testing.assert_allclose(moved.forward([(85, 62)]), free.forward(held.forward([(85, 62)])), atol=1e-9)


def test_mattes_multiply_with_the_freeze_before_them() -> None:
    mask, white = disc(85, 62, 24), np.zeros(SHAPE, np.uint8)
    white[:, 60:] = 255
    matte = Freeze.of(white, matte=True)
    state = Deformation(SHAPE).grab((70, 60), by=(14, 3), radius=24)
    whole = state.freeze(mask).add(replace(Stroke.grab((85, 90), by=(-8, -20), radius=25), matte=matte), warn=False)
    still = mask | (white == 0)
    np.testing.assert_array_equal(whole.inverse_map()[mask], state.inverse_map()[mask])
    np.testing.assert_allclose(whole.inverse_map()[still], state.inverse_map()[still], atol=0.01)
    assert np.abs(whole.inverse_map() - state.inverse_map()).max() > 5


def test_restoring_leaves_what_is_frozen() -> None:
    state, whole, mask = bent()
    back = whole.restore((85, 62), radius=60, warn=False)
    np.testing.assert_array_equal(back.inverse_map()[mask], state.inverse_map()[mask])
    with pytest.raises(SuppleError, match="at must be a point within the domain that is not frozen"):
        whole.restore((85, 62), radius=6)


def test_recipes_keep_it() -> None:
    _, whole, _ = bent()
    text = whole.recipe.to_json()
    assert Recipe.from_json(text) == whole.recipe
    made = Deformation.from_recipe(Recipe.from_json(text), SHAPE)
    assert made == whole
    np.testing.assert_array_equal(made.inverse_map(), whole.inverse_map())
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(whole)).inverse_map(), whole.inverse_map())
    with pytest.raises(SuppleError, match=r'the key "matte" is missing in strokes\[0\]'):
        Recipe.from_json('{"supple": 3, "strokes": [{"brush": "freeze", "at": [1, 2], "radius": 1}]}')
    # A hidden one holds nothing, and one of another size fits.
    strokes = tuple(replace(s, hidden=s.brush == "freeze") for s in whole.strokes)
    free = Deformation.from_recipe(replace(whole.recipe, strokes=strokes), SHAPE)
    assert free.space.freeze is None
    assert described(whole.strokes[2]) == "a freeze at (85, 62)"
    twice = Deformation.from_recipe(whole.recipe.fitted((320, 240)), (240, 320))
    at = np.random.default_rng(3).uniform((5, 5), (150, 110), (200, 2))
    np.testing.assert_allclose((twice.forward((at + 0.5) * 2 - 0.5) + 0.5) / 2 - 0.5, whole.forward(at), atol=0.01)


def test_what_a_freeze_is_not() -> None:
    mask = Freeze.of(disc(85, 62, 24))
    freeze = Stroke.freeze(mask)
    assert freeze.at == (85, 62)
    assert freeze.symmetric((80, 0), (1, 0)) == (freeze,)
    for wrong, said in (
        ({"matte": None}, "matte must be a mask, for a freeze, found None"),
        ({"strength": 0.5}, "strength must be left out for a freeze, found 0.5"),
        ({"by": (1.0, 2.0)}, "by must be left out for a freeze"),
        ({"factor": 2.0}, "factor must be left out for a freeze"),
    ):
        with pytest.raises(SuppleError, match=said):
            replace(freeze, **wrong)  # type: ignore[arg-type]
    with pytest.raises(SuppleError, match="the freeze mask is of 160 x 120 samples, and what is deformed of 90 x 80"):
        Deformation((80, 90)).grab((5, 5), by=(2, 2), radius=9).freeze(mask)
    with pytest.raises(SuppleError, match="freeze must be an array of shape"):
        Deformation(SHAPE).freeze(np.zeros((4, 5)))
    assert len(pack([], (1, 1))) == 0


def test_other_devices_refuse_it_and_say_so() -> None:
    _, whole, _ = bent()
    with pytest.raises(SuppleError, match="a freeze stands between strokes, which CUDA does not take"):
        refuse_mattes(whole.space, "CUDA")
    torch = pytest.importorskip("torch")
    import supple.torch

    with pytest.raises(SuppleError, match="a freeze stands between strokes, which PyTorch does not take"):
        supple.torch.forward(torch.zeros(1, 2), whole)
    first = Deformation(SHAPE).freeze(disc(85, 62, 24)).grab((40, 60), by=(4, 3), radius=24)
    points = torch.tensor([[40.0, 60.0], [85.0, 62.0]], dtype=torch.float64)
    np.testing.assert_allclose(supple.torch.forward(points, first), first.forward(points.numpy()), atol=1e-9)
    with pytest.raises(SuppleError, match="gradients need one freeze mask for all strokes"):
        supple.torch.forward(points, first, radius=torch.tensor([3.0, 24.0], requires_grad=True))


@pytest.mark.parametrize("part", [-1.0, -0.4, 0.0, 0.7, 1.5, 2.0])
def test_amounts(part: float) -> None:
    """A stroke's drag, angle or logarithm of a factor times the part, and what follows carried along."""
    grab, twist = Stroke.grab((60, 60), by=(8, 3), radius=20), Stroke.twist((95, 60), angle=30, radius=14)
    scale = Stroke.scale((90, 80), factor=1.5, radius=12)
    for stroke, there in (
        (grab, np.array((60, 60)) + part * np.array((8, 3))),
        (twist, None),
        (scale, None),
    ):
        for d in (
            Deformation(SHAPE).add(replace(stroke, strength=part)),
            Deformation.from_recipe(Recipe(strokes=(stroke,), amount=part), SHAPE),
        ):
            if there is not None:
                np.testing.assert_allclose(d.forward(stroke.at), there, atol=1e-6)
            turn = np.deg2rad(30 * part)
            wanted = {
                "twist": np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]),
                "scale": 1.5**part * np.eye(2),
            }.get(stroke.brush, d.jacobian(stroke.at))
            np.testing.assert_allclose(d.jacobian(stroke.at), wanted, atol=1e-6)
            assert d.report().margin > 0
    # A second stroke at the material that the first one moved.
    later = Stroke.grab((68, 63), by=(0, 6), radius=16)
    d = Deformation.from_recipe(Recipe(strokes=(grab, later), amount=part), SHAPE)
    np.testing.assert_allclose(d.forward((60, 60)), (60 + 8 * part, 60 + 9 * part), atol=1e-6)


def test_beyond_what_is_possible_it_is_as_far_as_that_and_said() -> None:
    near = Stroke.grab((130, 60), by=(20, 0), radius=30)
    with pytest.warns(
        FoldWarning, match=r"200% of a drag by \(20, 0\) at \(130, 60\) .* is carried out at 147%, as far"
    ):
        d = Deformation(SHAPE).add(replace(near, strength=2.0))
    assert 158 < d.forward((130, 60))[0] < 159.5
    assert d.report().damping[0] == pytest.approx(0.735, abs=0.01)
    assert (d.arrivals[0].target, d.arrivals[0].cause) == ((170, 60), "fold")
    assert d.report().margin > 0
    with pytest.warns(FoldWarning, match="stroke 1 of 2: 200% of"):
        Deformation.from_recipe(Recipe(strokes=(near, near), amount=2.0), SHAPE)
    with pytest.warns(MissWarning, match="200% of a scale by 50 .* at 117%, as far as is possible: factor must be"):
        d = Deformation(SHAPE).add(Stroke.scale((80, 60), factor=50, radius=10, strength=2.0))
    assert 95 < d.jacobian((80, 60))[0, 0] <= 100
    left = Stroke.grab((20, 60), by=(30, 0), radius=20, strength=-1.0)
    with pytest.warns(FoldWarning, match="-100% of a drag"):
        d = Deformation(SHAPE).add(left)
    assert -0.5 < d.forward((20, 60))[0] < 1
    with pytest.raises(SuppleError, match="cannot arrive"):  # at full strength, too
        Deformation(SHAPE).add(replace(near, by=(200.0, 0.0)))
    with pytest.raises(FoldError, match="folds"):
        Deformation(SHAPE, on_fold="error").add(Stroke.grab((80, 60), by=(20, 0), radius=15, strength=2.0))
    with pytest.warns(FoldWarning, match="damped"):
        Deformation(SHAPE, on_fold="damp").add(Stroke.grab((80, 60), by=(20, 0), radius=15, strength=2.0))
    for wrong in (2.01, -1.01, float("nan")):
        with pytest.raises(SuppleError, match="strength must be a number from -1 "):
            replace(near, strength=wrong)


def test_the_ends_of_a_clip_stay_in_spite_of_freezes() -> None:
    from supple.files.clips import with_ends

    mask = Freeze.of(disc(85, 62, 24))
    strokes = (
        Stroke.grab((60, 60, 10), by=(10, 3, 2), radius=20),
        Stroke.freeze(mask, ndim=3),
        Stroke.grab((70, 60, 10), by=(10, 3, 2), radius=20),
    )
    recipe = with_ends(Recipe(strokes=strokes), 3, (20, *SHAPE), 1.0)
    d = Deformation.from_recipe(recipe, (20, *SHAPE), time=True)
    for k in (0, 2, 17, 19):
        points = np.array([(x, y, k) for x in (50, 60, 75) for y in (50, 62)], float)
        np.testing.assert_array_equal(d.forward(points), points)
    assert np.abs(d.forward((65, 60, 9)) - (65, 60, 9)).max() > 1


def test_clips_of_floats_keep_what_is_frozen_and_differ_beside_it_as_far_as_it_moves() -> None:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    frame = (0.5 + 0.4 * np.sin(columns / 9) * np.cos(rows / 7)).astype(np.float32)  # 0.06 a pixel at most
    clip = np.repeat(frame[None], 12, axis=0)
    d = Deformation(clip.shape, time=True).freeze(mask := Freeze.of(disc(60, 60, 24)))
    d = d.add(Stroke.grab((95, 60, 6), by=(10, 0, 2), radius=20), warn=False)
    out, points = d.warp(clip), d.inverse_map()
    inside = disc(60, 60, 20)
    np.testing.assert_array_equal(out[:, inside], clip[:, inside])
    held = mask.shown(SHAPE) == 0  # at its edge, points are within the tolerance, 0.01
    np.testing.assert_allclose(out[:, held], clip[:, held], rtol=0, atol=6e-4)
    moved = np.abs(points[..., :2] - np.stack([columns, rows], -1)).max(axis=-1)
    faint = (moved > 0) & (moved < 0.02)  # so little that bytes hide it: it is there in floats
    assert faint.any()
    assert np.all(np.abs(out - clip)[faint] <= 0.13 * (moved[faint] + 0.01))


def test_what_is_more_than_a_stroke_can_be_is_said() -> None:
    stroke = Stroke.grab((100, 60), by=(4, 0), radius=30, strength=2.0)
    with pytest.warns(FoldWarning, match="400% is more than a stroke can be: 200% is carried out"):
        d = Deformation.from_recipe(Recipe(strokes=(stroke,), amount=2.0), (120, 160))
    np.testing.assert_allclose(d.forward((100, 60)), (108, 60), atol=0.01)
