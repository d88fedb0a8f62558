"""Random strokes: they never fold, move nothing too far, and bend all that belongs to an image alike."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import supple
from supple.augment import RandomElastic, apply, elastic, moved_boxes
from supple.cli import command
from supple.media import image
from tests import reference
from tests.refusals import refused

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg"
HEAD = PHOTO.with_name("head.nii.gz")


@st.composite
def draws(draw: st.DrawFn) -> tuple[RandomElastic, supple.Deformation]:
    shape = tuple(draw(st.lists(st.integers(1, 90), min_size=2, max_size=3)))
    spacing = tuple(draw(st.floats(0.3, 3)) for _ in shape)
    small = max(n * s for n, s in zip(shape[::-1], spacing, strict=True)) * draw(st.floats(0.02, 2))
    radius = (small, small * draw(st.floats(1, 3)))
    border: Any = draw(st.sampled_from(["auto", None, 0.3 * small, 3 * small]))
    augment = RandomElastic(small * draw(st.floats(0, 1)), radius, (0, 7), border)
    return augment, augment.draw(shape, draw(st.integers(0, 2**40)), spacing=spacing)


@settings(max_examples=40, deadline=None)
@given(draws(), st.integers(0, 2**32))
def test_draws_do_not_fold_and_nothing_moves_too_far(drawn: Any, seed: int) -> None:
    augment, d = drawn
    known = d.resolution()
    assert known["applied"] <= known["strokes"] <= 7  # each in one step, or none
    assert known["margin"] >= 0.3 - 1e-9
    assert d.warnings == (None,) * len(d.strokes)
    points = np.random.default_rng(seed).uniform(-0.5, np.array(d.shape[::-1]) - 0.5, (300, d.ndim))
    moved = d.forward(points)
    # By the slow reference, which knows no bounds: in the plane of a picture, and where a volume has an extent.
    steps = reference.carried_out(d)
    np.testing.assert_allclose(moved, reference.forward(steps, d.domain, points), atol=1e-9)
    assert np.linalg.det(reference.jacobian(steps, d.domain, points)).min() > 0
    farthest = np.linalg.norm((moved - points) * d.domain.spacing, axis=1).max()
    assert farthest <= augment.max_displacement + 1e-9
    if d.domain.border is not None:
        assert np.all((moved >= -0.5 - 1e-9) & (moved <= np.array(d.shape[::-1]) - 0.5 + 1e-9))
    np.testing.assert_allclose(d.inverse(moved).points, points, atol=1e-5)


def test_strokes_are_of_the_kind_that_was_asked_for() -> None:
    augment = RandomElastic(6, (20, 30), (2, 4))
    found = [augment.draw((200, 300), seed) for seed in range(60)]
    assert {len(d.strokes) for d in found} == {2, 3, 4}
    strokes = [stroke for d in found for stroke in d.strokes]
    radii, places = [s.radius for s in strokes], np.array([s.at for s in strokes])
    assert 20 <= min(radii) < 21.5 < 28.5 < max(radii) <= 30
    assert np.all(places.min(axis=0) < (15, 10))
    assert np.all(places.max(axis=0) > (284, 189))
    turns = np.array([math.atan2(*s.by[::-1]) for s in strokes])
    assert np.all(np.histogram(turns, 4, (-math.pi, math.pi))[0] > len(strokes) / 8)
    lengths = [math.hypot(*s.by) for s in strokes]
    assert max(lengths) < 6
    assert np.std(lengths) > 1


def test_a_seed_is_a_draw_and_a_generator_is_the_next_one() -> None:
    augment = RandomElastic(5, 20)
    one = augment.draw((64, 80), 7)
    assert one == augment.draw((64, 80), 7)
    assert one == pickle.loads(pickle.dumps(augment)).draw((64, 80), np.int64(7))
    assert one != augment.draw((64, 80), 8)
    rng = np.random.default_rng(7)
    assert augment.draw((64, 80), rng) == one != augment.draw((64, 80), rng)
    assert augment.draw((64, 80)) != augment.draw((64, 80))


def test_all_that_belongs_to_an_image_is_bent_alike() -> None:
    y, x = np.mgrid[:120.0, :160.0]
    augment = RandomElastic(8, (20, 40))
    points = np.random.default_rng(0).uniform((10, 10), (149, 109), (50, 2))
    labels = ((x // 20 + y // 20) % 5).astype(np.uint8)
    made = augment(np.stack([x, y], axis=-1), labels=labels, points=points, seed=3)
    d = made.deformation
    np.testing.assert_array_equal(made.points, d.forward(points))
    # What the bent picture shows at a bent key point is the key point: to 0.001 pixels, if its map is as exact.
    ramps = d.warp(np.stack([x, y], axis=-1), filter="linear", tolerance=3e-4)
    shown = [ndimage.map_coordinates(ramps[..., k], made.points[:, ::-1].T, order=3) for k in (0, 1)]
    np.testing.assert_allclose(np.stack(shown, -1), points, atol=1e-3)
    sources = d.inverse(np.stack([x, y], axis=-1)).points
    within = np.clip(sources, 0, (159, 119))  # a ramp ends at the outermost pixels' centres
    np.testing.assert_allclose(made.image, within, atol=0.011)
    rounded = np.clip(np.floor(sources + 0.5).astype(int), 0, (159, 119))
    near = np.abs(sources + 0.5 - np.round(sources + 0.5)).min(axis=-1) < 0.02  # halfway between labels, by either
    np.testing.assert_array_equal(made.labels[~near], labels[rounded[..., 1], rounded[..., 0]][~near])
    assert set(np.unique(made.labels)) <= set(range(5))


def test_a_volume_with_a_spacing_is_bent_in_millimetres() -> None:
    z, y, x = np.mgrid[:12.0, :50.0, :40.0]
    augment = RandomElastic(5, (12, 18), 5, border=None)
    spacing = (1.0, 1.0, 4.0)
    made = augment(z, labels=(z > 5), points=[(20, 20, 6)], seed=2, shape=z.shape, spacing=spacing)
    assert made.deformation == augment.draw(supple.Grid(z.shape, spacing), 2)
    moved = made.deformation.forward(np.stack([x, y, z], -1)) - np.stack([x, y, z], -1)
    assert 3 < np.linalg.norm(moved * spacing, axis=-1).max() <= 5
    assert np.abs(moved[..., 2]).max() <= 5 / 4
    np.testing.assert_array_equal(made.image, made.deformation.warp(z, filter="linear"))
    assert made.labels.dtype == bool


def test_boxes_hold_the_bent_boxes() -> None:
    for shape, limit in (((150, 200), 0.004), ((30, 50, 60), 0.03)):
        d = RandomElastic(10, (12, 25), 6).draw(shape, 5)
        size = np.array(shape[::-1])
        corners = np.sort(np.random.default_rng(1).uniform(0, size - 1, (8, 2, len(size))), axis=1)
        boxes = corners.reshape(8, -1)
        made = moved_boxes(d, boxes)
        for (low, high), box in zip(corners, made, strict=True):
            inner = d.forward(np.random.default_rng(2).uniform(low, high, (20_000, len(size))))
            assert np.all(inner >= box[: len(size)] - limit)
            assert np.all(inner <= box[len(size) :] + limit)
        fine = np.stack([np.concatenate([q.min(0), q.max(0)]) for q in (d.forward(outline(*c)) for c in corners)])
        np.testing.assert_allclose(made, fine, atol=limit)
        whole = np.concatenate([-0.5 * np.ones(len(size)), size - 0.5])[None]
        np.testing.assert_allclose(moved_boxes(d, whole), whole, atol=1e-9)  # the border is fixed
    assert moved_boxes(d, np.zeros((0, 6))).shape == (0, 6)
    flat = np.array([[5.0, 5.0, 5.0, 5.0, 5.0, 5.0]])
    np.testing.assert_allclose(moved_boxes(d, flat), np.tile(d.forward(flat[:, :3]), 2))


def test_only_what_is_around_strokes_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """A face of this box has a million points, and a lattice of the volume, 250,000."""
    looked: list[int] = []
    forward = supple.Deformation.forward

    def counted(self: supple.Deformation, points: Any) -> Any:
        looked.append(len(points))
        return forward(self, points)

    monkeypatch.setattr(supple.Deformation, "forward", counted)
    starts = np.random.default_rng(2).uniform(0, 500, (6, 3))
    looked.append(len(elastic._looked_at(starts, np.full(6, 8.0), np.zeros(3), np.full(3, 500.0))))
    d = supple.Deformation((500, 500, 500), border=None).grab((20, 250, 250), by=(-4, 1, 0), radius=8)
    made = moved_boxes(d, [(20, 20, 20, 480, 480, 480)])
    assert max(looked) < 30_000
    assert made[0, 0] == pytest.approx(16, abs=0.05)
    np.testing.assert_array_equal(made[0, 1:], (20, 20, 480, 480, 480))


def outline(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return many points of the surface of a box."""
    n = len(low)
    count = 4000 if n == 2 else 150
    sides = []
    for k in range(n):
        for end in (low, high):
            axes = [np.linspace(a, b, count) for a, b in zip(low, high, strict=True)]
            axes[k] = end[k : k + 1]
            sides.append(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, n))
    return np.concatenate(sides)


def test_boxes_of_fields_are_followed_closely() -> None:
    x = np.arange(60.0)
    values = np.zeros((40, 60, 2))
    values[..., 1] = 3 * np.cos(x / 5)
    d = supple.Deformation((40, 60)).field(supple.Field.from_array(values), inverse=True)
    made = moved_boxes(d, [[5, 10, 50, 20]])
    np.testing.assert_allclose(made, [[5, 10 - 3, 50, 20 + 3]], atol=0.05)


def test_a_draw_is_a_recipe_for_files(tmp_path: Path) -> None:
    pytest.importorskip("nibabel")
    photo = image.read(PHOTO).pixels
    image.write(tmp_path / "photo.png", photo)
    made = RandomElastic(20, (40, 90))(photo, seed=11)
    (tmp_path / "strokes.json").write_text(made.deformation.recipe.to_json(), encoding="utf-8")
    words = ["--recipe", str(tmp_path / "strokes.json"), "--filter", "linear", "--strict"]
    assert command(["warp", str(tmp_path / "photo.png"), str(tmp_path / "out.png"), *words]) == 0
    np.testing.assert_array_equal(image.read(tmp_path / "out.png").pixels, made.image)
    again = supple.Deformation.from_recipe(supple.Recipe.from_json(made.deformation.recipe.to_json()), photo.shape[:2])
    assert again == made.deformation
    np.testing.assert_array_equal(apply(again, photo).image, made.image)


def test_drags_that_add_up_are_shortened(monkeypatch: pytest.MonkeyPatch) -> None:
    augment = RandomElastic(10, 60, 8)
    found = [np.abs(d.forward(points()) - points()).max() for d in (augment.draw((100, 100), k) for k in range(20))]
    assert max(found) <= 10
    monkeypatch.setattr(elastic, "SLACK", math.inf)
    longer = [np.abs(d.forward(points()) - points()).max() for d in (augment.draw((100, 100), k) for k in range(20))]
    assert max(longer) > 12  # what they do otherwise


def points() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(100.0), np.arange(100.0)), axis=-1)


def test_nothing_to_move_is_a_copy() -> None:
    photo = np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8)
    for augment in (RandomElastic(0, 20), RandomElastic(5, 20, 0)):
        assert not augment.draw((30, 40), 1).strokes
        made = augment(photo, boxes=[[1, 2, 3, 4]], seed=1)
        np.testing.assert_array_equal(made.image, photo)
        np.testing.assert_array_equal(made.boxes, [[1, 2, 3, 4]])
        assert made.labels is made.points is None
    one = RandomElastic(5, 20).draw((1, 1), 3)
    np.testing.assert_array_equal(one.forward((0, 0)), (0, 0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((5, 0), "radius must be a number above 0"),
        ((5, (30, 20)), "radius must be a number, or two in ascending order, found (30, 20)"),
        ((5, (1, 2, 3)), "radius must be a number, or two in ascending order, found (1, 2, 3)"),
        ((31, (30, 40)), "max_displacement must be a number from 0 to 30, the smallest radius, found 31"),
        ((-1, 30), "max_displacement must be a number from 0 to 30"),
        ((5, 30, 2.5), "strokes must be a whole number from 0 to 1000, or two in ascending order, found 2.5"),
        ((5, 30, (4, 2)), "strokes must be a whole number from 0 to 1000, or two in ascending order, found (4, 2)"),
        ((5, 30, 3, "fixed"), "border must be"),
    ],
)
def test_bad_options_are_one_sentence(arguments: tuple[Any, ...], message: str) -> None:
    assert refused(RandomElastic, *arguments).startswith(message)


def test_bad_samples_are_one_sentence() -> None:
    augment, photo = RandomElastic(5, 20), np.zeros((40, 50), np.uint8)
    for options, message in (
        ({"seed": -1}, "seed must be a whole number from 0, or a numpy.random.Generator, found -1"),
        ({"seed": "x"}, "seed must be"),
        ({"points": [(1, 2, 3)]}, "points must be finite numbers of shape (N, 2), found shape (1, 3)"),
        ({"points": [(1, math.nan)]}, "points must be finite numbers of shape (N, 2), found some that are not finite"),
        ({"boxes": [(1, 2, 0, 3)]}, "boxes[0] must be a lower corner and an upper one, found [1.0, 2.0, 0.0, 3.0]"),
        ({"boxes": "x"}, "boxes must be finite numbers of shape (N, 4)"),
        ({"labels": photo[1:]}, "labels must be of shape (40, 50), with or without channels, found shape (39, 50"),
        ({"shape": (1, 2, 3, 4)}, "shape must be"),
    ):
        assert refused(augment, photo, **options).startswith(message)
    with pytest.raises(supple.SuppleError, match=r"shape must be given for an image of shape \(40, 50, 60\)"):
        augment(np.zeros((40, 50, 60)))
    with pytest.raises(supple.SuppleError, match="image must be of shape"):
        augment(np.zeros(5))
    with pytest.raises(supple.SuppleError, match="deformation must be a Deformation"):
        apply(augment, photo)  # type: ignore[arg-type]


def test_channels_are_no_axes_of_space() -> None:
    augment = RandomElastic(2, 6)
    assert augment(np.zeros((20, 30, 4), np.uint8)).deformation.shape == (20, 30)
    assert augment(np.zeros((9, 20, 30, 2))).deformation.shape == (9, 20, 30)
    assert augment(np.zeros((20, 30, 9)), shape=(20, 30)).image.shape == (20, 30, 9)


def test_four_channels_are_no_colours_with_opacity() -> None:
    photo = np.random.default_rng(0).integers(1, 255, (40, 50, 4)).astype(np.uint8)
    photo[..., 3] = 0
    made = RandomElastic(3, 10)(photo, labels=photo, seed=1)
    assert made.image is not None
    for k in range(3):
        np.testing.assert_array_equal(made.image[..., k], RandomElastic(3, 10)(photo[..., k], seed=1).image)
