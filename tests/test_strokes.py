"""Strokes: values, refusals, and the packed table against exact arithmetic."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import FrozenInstanceError, replace
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple._core.rows import STROKE_DTYPE
from supple.deformation import Deformation
from supple.errors import OutsideWarning, SuppleError
from supple.strokes import Recipe, Stroke, pack, poisson_of
from tests import reference
from tests.strokes import grab, ratios, recipes, refusal

POINTS = [(1,), (1, 2, 3, 4), (), 5, None, "12", b"12", {1: 2, 3: 4}, np.eye(2), np.array(1)]
BAD: dict[str, tuple[str, list[Any]]] = {
    "at": ("2 or 3 numbers, x first, found ", POINTS),
    "by": ("2 numbers, x first, found ", POINTS),
    "radius": ("a number above 0 (from ", [
        0, -0.0, -1, math.nan, math.inf, True, "100", None, 1e-31, 1e31, 10**400, Fraction(10**400), [1], np.eye(1),
    ]),
    "poisson": ("a number up to 0.5, or -inf, found ", [
        0.6, math.nextafter(0.5, 1), math.nan, math.inf, True, "-inf", -(10**400),
    ]),
    "scales": ("1, 2 or 3, found ", [0, 4, -1, 1.0, True, "1", None, math.nan, [1], np.array([1, 2])]),
    "reach": ("a number of radii from 1 to 1e+30, or None for no limit, found ", [
        0, -4, 0.999, math.nan, math.inf, 1.1e30, True, "4", "none", [4], 10**400,
    ]),
    "hidden": ("True or False, found ", [0, 1, None, "true", []]),
    "brush": ('"grab" or "twist" or "scale" or "pinch" or "freeze", found ', [
        "bend", "", "Grab", None, 1, ["grab"],
    ]),
}  # fmt: skip
RATIOS = [0.4, 0.5, 0.25, 0.0, -1.0, -1e9, -1e308, -math.inf]
Floats = npt.NDArray[np.float64]


def displacement_reference(row: np.void, points: npt.ArrayLike) -> Floats:
    """K at points of three coordinates, as the table defines it."""
    d = np.asarray(points, np.float64) - row["pivot"]
    along = (d @ row["force"])[..., None] * d
    total: Floats = np.zeros_like(d)
    for i in range(int(row["terms"])):
        rho = np.sqrt((d * d).sum(-1, keepdims=True) + row["radius2"][i])
        total += (row["p"][i] / rho + row["q"][i] / rho**3) * row["force"] + row["r"][i] / rho**3 * along
    return total


def kelvinlets(stroke: Stroke, points: Floats) -> Floats:
    """K at points of three coordinates from the equations as they are printed: weighted, then normalised."""
    pivot, f = np.zeros((2, 3))
    pivot[: stroke.ndim], f[: stroke.ndim] = stroke.at, stroke.by
    return reference.grab(f, stroke.radius, stroke.poisson, stroke.scales, points - pivot)[0]


def exact_magnitude(row: np.void, distance: int) -> Decimal:
    """|K| at a distance, slantwise to the force, in 60 digits: what rounding is left is the table's."""
    with localcontext() as context:
        context.prec = 60
        slant = [Decimal(3) / 5 * distance, Decimal(4) / 5 * distance, Decimal(0)]
        force = [Decimal(float(x)) for x in row["force"]]
        dot = sum((x * y for x, y in zip(slant, force, strict=True)), Decimal(0))
        total = [Decimal(0)] * 3
        for i in range(int(row["terms"])):
            radius2, p, q, r = (Decimal(float(row[name][i])) for name in ("radius2", "p", "q", "r"))
            rho = (Decimal(distance) ** 2 + radius2).sqrt()
            total = [
                t + (p / rho + q / rho**3) * f + r / rho**3 * dot * x
                for t, f, x in zip(total, force, slant, strict=True)
            ]
        return sum((t * t for t in total), Decimal(0)).sqrt()


class TestStroke:
    def test_defaults(self) -> None:
        stroke = grab()
        assert (stroke.poisson, stroke.scales, stroke.brush, stroke.ndim) == (None, 1, "grab", 2)
        assert (stroke.reach, poisson_of(stroke)) == (4, 0.4)
        assert grab(at=(1, 2, 3), by=(1, 2, 3)).ndim == 3

    def test_is_a_value(self) -> None:
        stroke = grab(at=np.array([1, 2]), by=[3, np.float32(4)], radius=np.int64(5), scales=np.uint8(2))
        assert stroke == Stroke(at=(1.0, 2.0), by=(3.0, 4.0), radius=5.0, scales=2)
        assert len({stroke, replace(stroke), copy.deepcopy(stroke), pickle.loads(pickle.dumps(stroke))}) == 1
        assert [type(x) for x in (*stroke.at, *stroke.by, stroke.radius)] == [float] * 5
        assert type(stroke.scales) is int
        with pytest.raises(FrozenInstanceError):
            stroke.radius = 3.0  # type: ignore[misc]
        with pytest.raises(TypeError):
            Stroke((1, 2), (3, 4), 5)  # type: ignore[call-arg]

    def test_grab_to_and_by(self) -> None:
        expected = Stroke(at=(256, 256), by=(0, 90), radius=100)
        assert Stroke.grab((256, 256), to=(256, 346), radius=100) == expected
        assert Stroke.grab([256, 256], by=np.array([0, 90]), radius=100) == expected
        solid = Stroke.grab((1, 2, 3), to=(3, 2, 1), radius=4, poisson=-math.inf, scales=3, reach=5)
        assert solid == Stroke(at=(1, 2, 3), by=(2, 0, -2), radius=4, poisson=-math.inf, scales=3, reach=5.0)
        assert type(solid.reach) is float

    def test_grab_takes_one_of_to_and_by(self) -> None:
        both = refusal(lambda: Stroke.grab((1, 2), to=(1, 2), by=(1, 2), radius=1))
        assert both == "a grab takes one of to and by, found both"
        assert refusal(lambda: Stroke.grab((1, 2), radius=1)).endswith("found neither")

    def test_refuses_points_of_unlike_lengths(self) -> None:
        assert refusal(lambda: grab(by=(1, 2, 3))) == "by must be 2 numbers, x first, found (1, 2, 3)"
        assert refusal(lambda: grab(at=(1, 2, 3))) == "by must be 3 numbers, x first, found (0, 90)"
        assert refusal(lambda: Stroke.grab((1, 2, 3), to=(1, 2), radius=1)).startswith("to must be 3 numbers")

    @pytest.mark.parametrize("name", BAD)
    def test_refuses(self, name: str) -> None:
        wanted, every = BAD[name]
        for bad in every:
            assert refusal(lambda b=bad: grab(**{name: b})).startswith(f"{name} must be {wanted}")

    @pytest.mark.parametrize(
        "bad", [math.nan, math.inf, -math.inf, True, np.True_, "1", None, 1j, [1], 1.1e30, 10**400]
    )
    def test_refuses_coordinates(self, bad: Any) -> None:
        assert refusal(lambda: grab(at=(1, bad))).startswith("at[1] must be a number from -1e+30 to 1e+30, found ")
        assert refusal(lambda: grab(by=(bad, 1))).startswith("by[0] must be ")


class TestPack:
    def test_layout(self) -> None:
        assert STROKE_DTYPE.isalignedstruct
        assert STROKE_DTYPE.itemsize == 39 * 8
        assert STROKE_DTYPE.names[:3] == ("pivot", "force", "matrix")
        given = "radius2 p q r terms power joined reach most turn stretch coupled flat mask"
        assert STROKE_DTYPE.names[3:] == tuple(given.split())
        table = pack([grab(), grab()], (1, 1))
        assert table.dtype == STROKE_DTYPE
        assert table.shape == (2,)
        assert table.flags.c_contiguous
        assert pack([], (1, 1)).shape == (0,)

    def test_units(self) -> None:
        image = pack([grab(at=(3, 5), by=(7, 11))], (2, 10))[0]
        np.testing.assert_array_equal(image["pivot"], [6, 50, 0])
        np.testing.assert_array_equal(image["force"], [14, 110, 0])
        assert image["radius2"][0] == 100.0**2
        volume = pack((s for s in [grab(at=(3, 5, 7), by=(-1, 0, 1))]), (1, 2, 0.5))[0]
        np.testing.assert_array_equal(volume["pivot"], [3, 10, 3.5])
        np.testing.assert_array_equal(volume["force"], [-1, 0, 0.5])

    def test_the_reach_is_in_physical_units(self) -> None:
        table = pack([grab(reach=None), grab(), grab(radius=7, reach=1)], (2, 10))
        assert table["reach"].tolist() == [math.inf, 400.0, 7.0]

    @pytest.mark.parametrize("scales", [1, 2, 3])
    @pytest.mark.parametrize("poisson", RATIOS)
    @pytest.mark.parametrize("radius", [1e-30, 1e-3, 0.7, 100, 1e30])
    def test_the_pivot_moves_by_the_force(self, scales: int, poisson: float, radius: float) -> None:
        stroke = grab(at=(1, -2, 3), by=(4, 5, -6), radius=radius, poisson=poisson, scales=scales)
        row = pack([stroke], (1, 2, 3))[0]
        moved = displacement_reference(row, row["pivot"])
        np.testing.assert_allclose(moved, row["force"], rtol=(2e-15, 2e-14, 2e-13)[scales - 1])

    @pytest.mark.parametrize("scales", [1, 2, 3])
    @pytest.mark.parametrize("poisson", [0.4, 0.5, 0.0, -1e9, -math.inf])
    def test_the_equations(self, scales: int, poisson: float) -> None:
        stroke = grab(at=(1, -2, 3), by=(4, 5, -6), radius=10, poisson=poisson, scales=scales)
        points = np.random.default_rng(5).normal(0, 30, (500, 3))
        ours = displacement_reference(pack([stroke], (1, 1, 1))[0], points)
        np.testing.assert_allclose(ours, kelvinlets(stroke, points), rtol=1e-9, atol=1e-12)

    @pytest.mark.parametrize("poisson", RATIOS)
    @pytest.mark.parametrize("scales", [1, 2, 3])
    def test_decay(self, scales: int, poisson: float) -> None:
        row = pack([grab(at=(0, 0), by=(1, 0.3), radius=0.7, poisson=poisson, scales=scales)], (1, 1))[0]
        ratio = exact_magnitude(row, 700) / exact_magnitude(row, 1400)
        # Without b, two scales cancel as much as three do with it.
        expected = 32 if scales == 3 or (scales == 2 and poisson < -1e300) else (2, 8)[scales - 1]
        if (scales, poisson) == (2, -1e9):
            assert 8 < ratio < 32
        else:
            assert float(ratio) == pytest.approx(expected, rel=1e-4)

    @given(st.floats(1e-30, 1e30), ratios, st.sampled_from([2, 3]))
    def test_far_fields_cancel_to_the_last_bit(self, radius: float, poisson: float, scales: int) -> None:
        row = pack([grab(radius=radius, poisson=poisson, scales=scales)], (1, 1))[0]
        assert sum(Fraction(float(x)) for x in row["p"]) == 0
        assert sum(Fraction(float(x)) for x in row["r"]) == 0

    @given(recipes())
    def test_anything_allowed_is_finite(self, recipe: Recipe) -> None:
        ndim = recipe.strokes[0].ndim if recipe.strokes else 2
        for spacing in ((1e-30,) * ndim, (1e30,) * ndim):
            table = pack(recipe.strokes, spacing)
            for name in set(STROKE_DTYPE.names or ()) - {"reach", "most"}:
                assert np.isfinite(table[name]).all()
            assert (table["radius2"] > 0).all()

    def test_refuses_strokes_of_another_dimension(self) -> None:
        assert refusal(lambda: pack([grab()], (1, 1, 1))) == (
            "strokes[0].at must be a point of 3 numbers, as the medium has 3 axes, found (256.0, 256.0)"
        )


def test_a_stroke_outside_is_judged_by_its_reach_in_physical_units() -> None:
    def at(x: float, reach: float | None = 4.0, to: float = 1.0) -> Recipe:
        stroke = Stroke(at=(x, 5.0), by=(to, 0.0), radius=3.0, reach=reach)
        return Recipe(strokes=[stroke], border=None)

    def made(recipe: Recipe) -> Deformation:
        return Deformation.from_recipe(recipe, (10, 20), spacing=(2.0, 1.0))

    made(at(-0.5))
    made(at(19.5))
    with pytest.warns(OutsideWarning, match="starts outside the picture, which has 20 x 10 pixels"):
        made(at(-6.4))
    with pytest.raises(SuppleError, match="reaches nothing of it"):
        made(at(-6.6))
    with pytest.warns(OutsideWarning):
        made(at(-600.0, None))
    with pytest.warns(OutsideWarning):
        made(at(-6.6, to=20.0))  # a flow goes on from where it is


def test_what_poissons_ratio_keeps() -> None:
    """At 0.5, short drags keep volumes, without a reach; they never keep areas, and lower ratios keep less."""

    def change(ndim: int, poisson: float, reach: float | None = None) -> float:
        made = Deformation((41,) * ndim, border=None).add(
            Stroke(at=(20.0,) * ndim, by=(1.0,) + (0.0,) * (ndim - 1), radius=10, poisson=poisson, reach=reach)
        )
        points = np.stack(np.meshgrid(*[np.arange(0.0, 41.0, 2.0)] * ndim), axis=-1)
        return float(np.abs(np.linalg.det(made.jacobian(points)) - 1).max())

    assert change(3, 0.5) < 0.002
    assert change(2, 0.5) > 0.01
    assert change(3, 0.5, 4.0) > 0.01
    for ndim in (2, 3):
        assert change(ndim, 0.5) < change(ndim, 0.3) < change(ndim, -1.0)
