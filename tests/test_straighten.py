"""Pictures straightened: turned, sheared, freed of perspective and framed, with strokes in one resampling."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import pyvips
from hypothesis import given
from hypothesis import strategies as st

import supple
from supple import Deformation, Recipe, Straighten, Stroke
from supple.errors import SuppleError
from tests import reference
from tests.effort import examples

Floats = npt.NDArray[np.float64]
SIZE = (90, 60)  # x first
QUAD = ((18.0, 8.0), (74.0, 13.0), (82.0, 55.0), (6.0, 50.0))
CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
CASES: list[dict[str, Any]] = [
    {"rotate": 6.5},
    {"rotate": -100.0, "fit": "pad"},
    {"shear": (8.0, -3.0), "fit": "keep"},
    {"keystone": QUAD},
    {"keystone": QUAD, "rotate": -4.0, "fit": "pad"},
    {"keystone": QUAD, "rotate": 2.0, "scale_to": (64, 64)},
    {"rotate": 3.0, "scale_to": (40,), "fit": "pad"},
]


def pull(straighten: Straighten, q: Floats, size: tuple[int, int] = SIZE) -> Floats:
    """Return where pixels of the result come from, through the matrix of the straightening alone."""
    m = straighten.on(size)[0].matrix
    found = np.concatenate([q, np.ones((*q.shape[:-1], 1))], axis=-1) @ m.T
    return np.asarray(found[..., :2] / found[..., 2:])


def edges(straighten: Straighten, size: tuple[int, int] = SIZE) -> Floats:
    """Return where the outer corners of the result come from."""
    return pull(straighten, CORNERS * straighten.on(size)[1] - 0.5, size)


def bent() -> Deformation:
    return Deformation(SIZE[::-1]).grab((40, 30), by=(9, -5), radius=12).twist((60, 30), angle=40, radius=9)


class TestTheMap:
    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_is_that_of_strokes_after_the_matrix_within_its_certificate(self, case: dict[str, Any]) -> None:
        d, straighten = bent(), Straighten(**case)
        made = d.straighten(**case)
        q = reference.grid(made.output.shape)
        expected = reference.inverse(reference.carried_out(d), d.domain, pull(straighten, q))
        found, report = made.inverse_map(), made.report()
        assert report.within
        assert np.linalg.norm(found - expected, axis=-1).max() <= 0.01 + 1e-4
        np.testing.assert_allclose(made.inverse(q).points, expected, atol=1e-6)

    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_undoes_itself_and_has_the_derivatives_of_differences(self, case: dict[str, Any]) -> None:
        made = bent().straighten(**case)
        points = np.random.default_rng(2).uniform((5, 5), np.array(SIZE) - 6, (40, 2))
        np.testing.assert_allclose(made.inverse(made.forward(points)).points, points, atol=1e-6)
        np.testing.assert_allclose(made.jacobian(points), reference.differences(made.forward, points, 1e-3), atol=1e-6)

    @pytest.mark.parametrize("case", CASES, ids=str)
    @pytest.mark.parametrize("filter", ["auto", "linear"])
    def test_samples_are_those_of_a_slow_warp_by_it(self, case: dict[str, Any], filter: str) -> None:
        d, straighten = bent(), Straighten(**case)
        made = d.straighten(**case)
        smooth = np.random.default_rng(3).uniform(0, 255, (8, 12))
        source = np.asarray(pyvips.Image.new_from_array(smooth).resize(7.5, kernel="cubic").numpy(), np.float32)
        assert source.shape == SIZE[::-1]
        q = reference.grid(made.output.shape)
        mid = pull(straighten, q)
        p = reference.inverse(reference.carried_out(d), d.domain, mid)
        through = reference.matrices(reference.carried_out(d), d.domain, p)
        matrices = through @ reference.differences(lambda x: pull(straighten, x), q, 1e-3)
        outside = "edge" if straighten.fit == "crop" else "constant"
        expected = reference.sample(source[..., None], p, matrices, filter, outside)[..., 0]
        found = made.warp(source, filter=filter, tolerance=1e-3)
        beside = np.abs(p - np.clip(p, 1, np.array(SIZE) - 2)).max(axis=-1) > 0  # the step to what is filled
        assert found.shape == expected.shape
        assert np.abs(found - expected)[~beside].max() < 0.5
        assert np.abs(found - expected).mean() < 0.1

    def test_parts_of_the_output_are_those_of_the_whole(self) -> None:
        made = bent().straighten(keystone=QUAD, rotate=3)
        source = np.random.default_rng(1).integers(0, 256, SIZE[::-1], np.uint8)
        part = made.output.crop((7, 11), (20, 15))
        np.testing.assert_array_equal(made.warp(source, grid=part), made.warp(source)[11:26, 7:27])

    def test_a_batch_has_the_size_of_the_output(self) -> None:
        made = bent().straighten(rotate=5)
        source = np.random.default_rng(1).integers(0, 256, SIZE[::-1], np.uint8)
        batch = supple.warp_batch(np.stack([source, source]), made)
        np.testing.assert_array_equal(batch, np.stack([made.warp(source)] * 2))


class TestTheFrame:
    @given(
        st.floats(-180, 180),
        st.floats(-30, 30),
        st.lists(st.floats(0, 0.25), min_size=8, max_size=8),
        st.booleans(),
        st.sampled_from([(), (50,), (33, 70)]),
    )
    @examples(60)
    def test_crop_has_no_empty_corners_and_could_not_be_larger(
        self, rotate: float, shear: float, inset: list[float], frames: bool, scale_to: tuple[int, ...]
    ) -> None:
        size = (400, 300)
        quad = (CORNERS + np.array(inset).reshape(4, 2) * (1 - 2 * CORNERS)) * size
        straighten = Straighten(rotate, (shear, 0.0), tuple(map(tuple, quad.tolist())) if frames else (), scale_to)
        try:
            _, found = straighten.on(size)
        except SuppleError:
            assert frames  # one that is too steep
            return
        corners = edges(straighten, size)
        assert (corners > -0.5 - 1e-6).all()
        assert (corners < np.array(size) - 0.5 + 1e-6).all()
        # A frame of the same proportions that is larger by two pixels touches the outside wherever it lies.
        grown = (np.array(found) + 2.0 * np.array(found) / min(found)) / found
        off = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 9)] * 2), -1).reshape(-1, 1, 2)
        out = pull(straighten, (np.array(found) - 1) / 2 + (off * (grown - 1) + (CORNERS - 0.5) * grown) * found, size)
        assert ((out < -0.5) | (out > np.array(size) - 0.5)).any(axis=(1, 2)).all()

    @pytest.mark.parametrize(("rotate", "turns"), [(90, -1), (180, 2), (-90, 1), (270, 1), (-360, 0)])
    @pytest.mark.parametrize("fit", ["crop", "pad"])
    @pytest.mark.parametrize("shape", [(7, 12), (8, 11), (9, 9)])
    def test_quarter_turns_move_whole_pixels(self, rotate: float, turns: int, fit: Any, shape: tuple[int, int]) -> None:
        source = np.random.default_rng(0).integers(0, 256, (*shape, 3), np.uint8)
        found = Deformation(shape).straighten(rotate=rotate, fit=fit).warp(source)
        np.testing.assert_array_equal(found, np.rot90(source, turns))

    @pytest.mark.parametrize("rotate", [1.0, 17.0, -33.0, 60.0, 123.0])
    def test_pad_has_the_size_of_vips_and_crop_that_of_the_formula(self, rotate: float) -> None:
        size = (640, 480)
        white = pyvips.Image.black(*size).rotate(rotate)
        _, (width, height) = Straighten(rotate, fit="pad").on(size)
        assert abs(width - white.width) <= 1
        assert abs(height - white.height) <= 1
        a = math.radians(rotate)
        c, s = abs(math.cos(a)), abs(math.sin(a))
        w, h = size if c > s else size[::-1]
        scale = min(size[0] / (w * c + h * s), size[1] / (w * s + h * c))
        assert Straighten(rotate).on(size)[1] == (math.floor(w * scale), math.floor(h * scale))

    def test_pad_shows_all_and_keep_has_the_own_size(self) -> None:
        for fit in ("pad", "keep"):
            white = Deformation((60, 90)).straighten(rotate=10, fit=fit).warp(np.full((60, 90), 200, np.uint8))
            assert white[0, 0] == 0
            assert fit == "pad" or white.shape == (60, 90)
            if fit == "pad":  # nothing of it is cut off
                assert abs(int(white.sum(dtype=np.int64)) / 200 - 5400) < 30

    def test_a_keystone_becomes_an_upright_rectangle_about_its_middle(self) -> None:
        made = Deformation((60, 90)).straighten(keystone=QUAD, fit="keep")
        seen = made.forward(QUAD)
        np.testing.assert_allclose(seen[[0, 1], 1], seen[[1, 0], 1], atol=1e-9)
        np.testing.assert_allclose(seen[[0, 1], 0], seen[[3, 2], 0], atol=1e-9)
        np.testing.assert_allclose(seen.mean(axis=0), np.mean(QUAD, axis=0), atol=1e-9)
        sides = np.linalg.norm(np.roll(QUAD, -1, axis=0) - QUAD, axis=1)
        np.testing.assert_allclose(seen[2] - seen[0], [(sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2])

    def test_a_turn_is_clockwise_and_scale_to_distorts_nothing(self) -> None:
        x, y = Deformation((60, 90)).straighten(rotate=90, fit="keep").forward((54.5, 29.5))  # right of the middle
        np.testing.assert_allclose((x, y), (44.5, 39.5), atol=1e-9)
        for fit in ("crop", "pad", "keep"):
            made = Deformation((60, 90)).straighten(scale_to=(50, 50), rotate=10, fit=fit)
            assert made.output.shape == (50, 50)
            j = made.jacobian((40, 30))
            np.testing.assert_allclose(j.T @ j, np.eye(2) * np.linalg.det(j), atol=1e-12)

    @pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 2), (5, 3), (7, 4), (9, 5)])
    def test_half_a_pixel_is_a_pixel(self, width: int, height: int) -> None:
        for fit in ("crop", "pad", "keep"):
            assert Straighten(scale_to=(width,), fit=fit).on((40, 20))[1] == (width, height)

    def test_nothing_asked_changes_no_bit(self) -> None:
        source = np.random.default_rng(0).integers(0, 256, (20, 30), np.uint8)
        made = Deformation((20, 30)).straighten()
        assert made.is_identity
        np.testing.assert_array_equal(made.warp(source), source)


class TestRecipes:
    def test_hold_it_and_fit_other_sizes(self) -> None:
        straighten = Straighten(3.5, 2.0, QUAD, (800,), "pad")
        recipe = Recipe(strokes=(Stroke.grab((20, 20), by=(3, 4), radius=9),), size=SIZE, straighten=straighten)
        assert Recipe.from_json(recipe.to_json()) == recipe
        double = recipe.fitted((180, 120))
        assert double.straighten is not None
        np.testing.assert_allclose(double.straighten.keystone, (np.array(QUAD) + 0.5) * 2 - 0.5)
        bare = Recipe(straighten=Straighten(keystone=QUAD), size=SIZE).fitted((180, 120)).straighten
        assert bare is not None
        assert bare.keystone == double.straighten.keystone
        plain = Deformation.from_recipe(recipe, SIZE[::-1])
        assert plain == Deformation.from_recipe(plain.recipe, SIZE[::-1])
        assert plain.output.shape[1] == 800
        assert '"straighten"' not in Recipe().to_json()

    @pytest.mark.parametrize(
        ("entry", "said"),
        [
            ('{"rotat": 3}', 'did you mean "rotate"'),
            ('{"rotate": "x"}', "straighten: rotate must be a number of degrees"),
            ('{"fit": "all"}', 'straighten: fit must be "crop" or "pad" or "keep"'),
            ('{"keystone": [[0, 0], [1, 0], [1, 1]]}', "straighten: keystone must be four points"),
            ("3", "straighten must be a JSON object"),
        ],
    )
    def test_bad_ones_are_named(self, entry: str, said: str) -> None:
        with pytest.raises(SuppleError, match=said):
            Recipe.from_json(f'{{"supple": 3, "straighten": {entry}, "strokes": []}}')


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Straighten(rotate=math.nan), "rotate must be a number of degrees"),
        (lambda: Straighten(shear=(50, 50)), "two angles that leave the picture upright"),
        (lambda: Straighten(keystone=(QUAD[1], QUAD[0], *QUAD[2:])), "top left, top right, bottom right, bottom left"),
        (lambda: Straighten(keystone=QUAD[::-1]), "top left, top right, bottom right, bottom left"),
        (lambda: Straighten(scale_to=(0,)), "scale_to must be a number of pixels from 1"),
        (lambda: Straighten(keystone=((44, 5), (46, 5), (89, 59), (0, 59))).on(SIZE), "less perspective"),
        (lambda: Deformation((3, 20, 20)).straighten(rotate=1), "straightening is for pictures, and this is a volume"),
        (lambda: Deformation((20, 20)).straighten(rotate=1).straighten(rotate=1), "straightened already"),
        (lambda: Deformation((20, 20)).straighten(rotate=1).grab((9, 9), by=(1, 0), radius=4), "comes last"),
        (lambda: Deformation((20, 20)).straighten(rotate=1).affine(np.eye(3)), "comes last"),
        (lambda: Deformation((20, 20), spacing=(1, 2)).straighten(rotate=1), "the same along both axes"),
    ],
)
def test_what_cannot_be_is_refused(call: Any, said: str) -> None:
    with pytest.raises(SuppleError, match=said):
        call()


def test_one_number_is_a_width() -> None:
    assert supple.Straighten(scale_to=300).scale_to == (300,)  # type: ignore[arg-type]
