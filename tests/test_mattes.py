"""Mattes: factors of single strokes, in pictures and moving with clips."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from supple import Deformation, Freeze, Recipe, Stroke, SuppleError
from supple.engine.work import Mattes

SHAPE = (60, 80)
COUNT = 16
GRAB = Stroke.grab((40, 30), by=(6, -4), radius=14)
TIMED = Stroke.grab((40, 30, 8), by=(4, 2, 2), radius=12)


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (*SHAPE, 3), np.uint8)


def half(edge: int = 44, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """White to the left of an edge, and grey along it."""
    made = np.zeros(shape, np.uint8)
    made[:, :edge] = 255
    made[:, edge - 6 : edge] = 100
    return made


def walking() -> list[np.ndarray]:
    """A disc that walks through a clip."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return [(np.hypot(x - 20 - 2.5 * k, y - 30) < 18).astype(np.float32) for k in range(COUNT)]


def walker() -> Freeze:
    return Freeze.matte_of(walking(), COUNT, width=8)


def factor(matte: Freeze, points: np.ndarray) -> np.ndarray:
    """m of points, by the sum of all coefficients times their splines."""
    total = np.ones((len(points), 1))
    for axis in range(matte.ndim):
        size, first, step = matte.size[axis], matte.first[axis], matte.step[axis]
        t = np.abs(np.clip((points[:, axis] - first) / step, 1, size - 2)[:, None] - np.arange(size))
        spline = np.where(t < 1, 2 / 3 - t * t + t**3 / 2, np.maximum(2 - t, 0) ** 3 / 6)
        total = np.einsum("np,nq->nqp", total, spline).reshape(len(points), -1)
    return total @ (matte.coefficients.reshape(-1) / 255.0)


def test_a_matte_is_a_freeze_mask_the_other_way_round() -> None:
    white = half()
    frozen = Deformation(SHAPE, freeze=Freeze.of(255 - white)).add(GRAB)
    under = Deformation(SHAPE).add(replace(GRAB, matte=Freeze.of(white, matte=True)))
    np.testing.assert_array_equal(frozen.warp(picture()), under.warp(picture()))
    np.testing.assert_array_equal(frozen.inverse_map(), under.inverse_map())
    assert frozen.report() == under.report()
    assert (under.warp(picture())[:, 44:] == picture()[:, 44:]).all()
    assert (under.warp(picture())[:, :30] != picture()[:, :30]).any()


@pytest.mark.parametrize("brush", ["grab", "scale", "twist"])
def test_a_stroke_is_multiplied(brush: str) -> None:
    weak = {
        "grab": Stroke.grab((40, 30), by=(1.5, -1), radius=14),
        "scale": Stroke.scale((40, 30), factor=1.05, radius=14),
        "twist": Stroke.twist((40, 30), angle=3, radius=14),
    }[brush]
    matte = Freeze.of(half(), matte=True)
    at = np.random.default_rng(3).uniform((0, 0), (79, 59), (800, 2))
    plain, under = (
        Deformation(SHAPE, border=None, on_fold="damp").add(s, warn=False) for s in (weak, replace(weak, matte=matte))
    )
    m = factor(matte, at)
    assert m.min() == 0
    assert m.max() > 1 - 1e-6
    np.testing.assert_allclose(under.forward(at) - at, m[:, None] * (plain.forward(at) - at), atol=1e-9)
    # I + m J + K ⊗ ∇m, against central differences of T
    h = 1e-5
    steps = [(under.forward(at + h * e) - under.forward(at - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(under.jacobian(at), np.stack(steps, axis=-1), atol=1e-7)


def test_a_matte_moves_with_a_clip() -> None:
    matte = walker()
    assert matte.samples == (80, 60, COUNT)
    rows = [Freeze.of(frame, width=8, matte=True).coefficients for frame in walking()]
    for k in range(1, COUNT - 1):
        m = matte.at([np.arange(80), np.arange(60), [k]])[0]
        mean = replace(matte.at_frame(k), values=b"\0" * rows[k].size).at([np.arange(80), np.arange(60)])
        for row, weight in ((rows[k - 1], 1), (rows[k], 4), (rows[k + 1], 1)):
            mean = mean + weight / 6 * replace(matte.at_frame(k), values=row.tobytes()).at(
                [np.arange(80), np.arange(60)]
            )
        np.testing.assert_allclose(m, mean, atol=1e-6)
    weak = Stroke.grab((40, 30, 8), by=(0.8, 0.4, 0.3), radius=12)
    plain, under = (
        Deformation((COUNT, *SHAPE), border=None, time=True, on_fold="damp").add(s)
        for s in (weak, replace(weak, matte=matte))
    )
    at = np.random.default_rng(3).uniform((0, 0, 0), (79, 59, COUNT - 1), (800, 3))
    np.testing.assert_allclose(under.forward(at) - at, factor(matte, at)[:, None] * (plain.forward(at) - at), atol=1e-8)


@pytest.mark.parametrize(("by", "axes"), [((0, 0, 6), [2]), ((14, -9, 0), [0, 1])])
def test_the_bound_of_a_stroke_under_a_matte_that_moves_holds_and_is_close(
    by: tuple[float, ...], axes: list[int]
) -> None:
    matte = Freeze.matte_of(walking(), COUNT, width=4)
    stroke = replace(Stroke.grab((40, 30, 8), by=by, radius=30), matte=matte)
    damped = Deformation((COUNT, *SHAPE), time=True, border=None, on_fold="damp").add(stroke, warn=False)
    (part,) = damped.resolution()["damping"]
    assert 0 < part < 1
    at = np.random.default_rng(3).uniform((0, 0, 0), (79, 59, COUNT - 1), (300_000, 3))
    slopes = damped.jacobian(at)[:, axes][:, :, axes]
    lowest = np.linalg.eigvalsh((slopes + np.swapaxes(slopes, 1, 2)) / 2)[:, 0].min()
    assert 0.01 <= lowest <= 0.2  # 0.01 where the bound is exact
    # So a drag takes few steps: edges across its way do not count for more than their slope along it.
    flowing = Deformation((COUNT, *SHAPE), time=True, border=None).add(stroke, warn=False)
    assert len(flowing.space.rows) <= 3 + 2 / part


def test_strokes_with_mattes_of_their_own_apply_one_after_the_other() -> None:
    mattes = [
        None,
        Freeze.of(half(50), matte=True),
        Freeze.of(half(36)[:, ::-1], matte=True),
        Freeze.of(half(50), matte=True),
    ]
    strokes = [replace(Stroke.grab((30 + 6 * k, 30), by=(5, 3 - k), radius=12), matte=m) for k, m in enumerate(mattes)]
    whole = Deformation(SHAPE)
    at = np.random.default_rng(3).uniform((0, 0), (79, 59), (500, 2))
    expected = at
    for stroke in strokes:
        whole = whole.add(stroke, warn=False)
        expected = Deformation(SHAPE).add(stroke, warn=False).forward(expected)
    np.testing.assert_allclose(whole.forward(at), expected, atol=1e-12)
    back = whole.inverse(at)
    assert back.converged.all()
    np.testing.assert_allclose(whole.forward(back.points), at, atol=1e-6)
    report = whole.report()
    assert report.within
    assert report.margin > 0
    space = whole.space
    assert isinstance(space.freeze, Mattes)
    assert len(space.freeze.masks) == 3  # two of them are equal
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(whole)).warp(picture()), whole.warp(picture()))


def test_where_all_mattes_are_black_every_bit_is_kept() -> None:
    left, right = Freeze.of(half(34), matte=True), Freeze.of(half(34)[:, ::-1], matte=True)
    d = Deformation(SHAPE).add(replace(GRAB, matte=left), warn=False)
    d = d.add(replace(Stroke.grab((60, 30), by=(-5, 5), radius=14), matte=right), warn=False)
    source = picture()
    out = d.warp(source)
    np.testing.assert_array_equal(out[:, 34:46], source[:, 34:46])
    assert (out[:, :25] != source[:, :25]).any()
    assert (out[:, 55:] != source[:, 55:]).any()
    clip = np.random.default_rng(1).integers(0, 255, (COUNT, *SHAPE), np.uint8)
    d = Deformation(clip.shape, time=True).add(replace(TIMED, matte=walker()), warn=False)
    out, m = d.warp(clip), walker().shown(clip.shape)
    np.testing.assert_array_equal(out[m == 0], clip[m == 0])
    assert (out[m > 0.9] != clip[m > 0.9]).any()
    assert d.report().within


def test_what_is_frozen_stays_so_under_a_matte() -> None:
    mask = np.zeros(SHAPE, bool)
    mask[20:28, 30:40] = True
    freeze, matte = Freeze.of(mask, width=6), Freeze.of(half(), width=9, matte=True)
    d = Deformation(SHAPE, freeze=freeze).add(replace(GRAB, matte=matte), warn=False)
    source = picture()
    out = d.warp(source)
    np.testing.assert_array_equal(out[mask], source[mask])
    np.testing.assert_array_equal(out[:, 44:], source[:, 44:])
    assert (out != source).any()
    both = matte.times(freeze).shown(SHAPE)
    assert (both <= matte.shown(SHAPE) + 1e-6).all()
    assert (both[mask] == 0).all()
    assert (both[45:, :25] > 1 - 1e-6).all()
    # Of a clip: a mask of its frames, and a matte that moves.
    moving = walker().times(freeze)
    assert moving.samples == (80, 60, COUNT)
    assert (moving.shown((COUNT, *SHAPE))[:, mask] == 0).all()
    still = matte.times(Freeze.of(np.broadcast_to(mask, (COUNT, *SHAPE)), width=6))
    np.testing.assert_allclose(still.shown((COUNT, *SHAPE)), np.broadcast_to(both, (COUNT, *SHAPE)), atol=1e-6)


def test_masks_of_one_lattice_multiply_coefficient_by_coefficient() -> None:
    mask = np.zeros((COUNT, *SHAPE), bool)
    mask[6:9] = True
    held, matte = Freeze.of(mask[:, :1, :1], width=4), walker()
    held = replace(held, samples=matte.samples)
    both = matte.times(held)
    rows = (held.coefficients / 255.0).reshape(-1, 1, 1)
    np.testing.assert_array_equal(both.coefficients, np.rint(matte.coefficients * rows))
    # Across, a mask of another width is read again: no more than the product, and exactly 0 where either is.
    frozen = np.zeros((COUNT, *SHAPE), bool)
    frozen[6:9, 20:30, 30:50] = True
    other = Freeze.of(frozen, width=12, spacing=(1, 1, 3))
    assert (other.step[2], other.step[0]) == (matte.step[2], 3)
    both = matte.times(other).shown(frozen.shape)
    one, two = matte.shown(frozen.shape), other.shown(frozen.shape)
    assert (both <= np.minimum(one, two) + 1e-6).all()
    assert (both[frozen] == 0).all()
    assert (both[12:] == one[12:]).all()
    assert (both[3] < one[3]).any()
    np.testing.assert_array_equal(both[:3], one[:3])  # no later in time than it is by itself


@pytest.mark.parametrize("axis", [0, 1])
def test_the_mirror_image_of_a_stroke_has_that_of_its_matte(axis: int) -> None:
    normal, middle = np.eye(2)[axis], (np.array(SHAPE[::-1]) - 1) / 2
    stroke = replace(Stroke.grab((34, 22), by=(6, -4), radius=14), matte=Freeze.of(half(50), matte=True))
    image = stroke.mirrored(middle, normal)
    source = picture()
    flipped = np.flip(source, 1 - axis)
    out, other = (
        Deformation(SHAPE).add(one, warn=False).warp(each) for one, each in ((stroke, source), (image, flipped))
    )
    assert np.abs(np.flip(other, 1 - axis).astype(int) - out).max() <= 1
    assert (out != source).any()
    assert image.mirrored(middle, normal) == stroke
    assert stroke.is_image(image)
    assert not replace(stroke, matte=None).is_image(image)
    assert stroke.symmetric(middle, normal) == (stroke, image)
    both = Deformation(SHAPE).add(stroke, warn=False).add(image, warn=False).warp(np.maximum(source, flipped))
    assert (both != np.maximum(source, flipped)).any()
    with pytest.raises(SuppleError, match="normal must be along an axis for a stroke with a matte"):
        stroke.mirrored(middle, (1, 1))
    assert not stroke.is_image(replace(stroke, at=(40, 30)))
    longer = replace(image, matte=None, path=(*image.path, (9.0, 9.0)))
    assert not replace(stroke, matte=None).is_image(longer)


def test_the_mirror_image_of_a_matte_that_moves() -> None:
    stroke = replace(TIMED, matte=walker())
    d, image = (
        Deformation((COUNT, *SHAPE), time=True).add(one, warn=False)
        for one in (stroke, stroke.mirrored((0, 29.5, 0), (0, 1, 0)))
    )
    at = np.random.default_rng(3).uniform((0, 0, 0), (79, 59, COUNT - 1), (500, 3))
    np.testing.assert_allclose(
        image.forward(at * (1, -1, 1) + (0, 59, 0)), d.forward(at) * (1, -1, 1) + (0, 59, 0), atol=1e-9
    )


def test_recipes_keep_mattes() -> None:
    recipe = Recipe(strokes=(GRAB, replace(GRAB, matte=Freeze.of(half(), matte=True))), size=(80, 60))
    text = recipe.to_json()
    assert Recipe.from_json(text) == recipe
    with pytest.raises(
        SuppleError, match=r"strokes\[1\]: matte must be an object with first, samples, size, step, values"
    ):
        Recipe.from_json(text.replace('"matte": {', '"matte": {"a": 1, '))
    twice = recipe.fitted((160, 120))
    d = Deformation.from_recipe(twice, (120, 160))
    once = Deformation.from_recipe(recipe, SHAPE)
    at = np.random.default_rng(3).uniform((5, 5), (70, 50), (200, 2))
    np.testing.assert_allclose((d.forward((at + 0.5) * 2 - 0.5) + 0.5) / 2 - 0.5, once.forward(at), atol=2e-3)
    moves = replace(recipe, strokes=(replace(GRAB, matte=walker()),))
    assert moves.moves
    assert Recipe.from_json(moves.to_json()) == moves
    assert not moves.at_frame(3).moves
    np.testing.assert_array_equal(
        moves.at_frame(3).strokes[0].matte.coefficients, Freeze.of(walking()[3], width=8, matte=True).coefficients
    )


def test_long_mattes_are_coarser() -> None:
    frames = (np.full((540, 960), 0.5, np.float32) for _ in range(300))
    matte = Freeze.matte_of(frames, 300)
    assert len(matte.values) <= 2**22
    assert matte.step[0] > Freeze.of(np.zeros((540, 960)), matte=True).step[0]
    with pytest.raises(SuppleError, match="the matte's width must be wider for 3000 frames, or left out, found 4"):
        Freeze.matte_of([np.zeros((540, 960))], 3000, width=4)


def test_mattes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(SuppleError, match="the matte is of 70 x 60 samples, and what is deformed of 80 x 60"):
        Deformation(SHAPE).add(replace(GRAB, matte=Freeze.of(half(40, (60, 70)), matte=True)))
    with pytest.raises(SuppleError, match=r"moves from frame to frame \(keys, or a matte\)"):
        Deformation(SHAPE).add(replace(GRAB, matte=walker()))
    with pytest.raises(SuppleError, match="matte must be a Freeze"):
        replace(GRAB, matte=half())  # type: ignore[arg-type]
    with pytest.raises(SuppleError, match="matte must be an array of shape"):
        Freeze.of([1.0], matte=True)


def test_a_matte_that_moves_fits_frames_of_another_size() -> None:
    recipe = Recipe(strokes=(replace(GRAB, matte=walker()),), size=(80, 60))
    twice = recipe.fitted((160, 120)).at_frame(5)
    at = np.random.default_rng(3).uniform((5, 5), (70, 50), (200, 2))
    found, matte = twice.strokes[0].matte, walker().at_frame(5)
    assert found.samples == (160, 120)
    np.testing.assert_allclose(factor(found, (at + 0.5) * 2 - 0.5), factor(matte, at), atol=1e-12)
    placed = recipe.placed((8, 4), (100, 70)).at_frame(5).strokes[0].matte
    assert placed.samples == (100, 70)
    np.testing.assert_allclose(factor(placed, at + np.array([8, 4])), factor(matte, at), atol=1e-12)
