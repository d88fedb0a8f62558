"""Fields and affine maps as values: what they refuse, their inverses, and their compositions."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple.deformation import Deformation
from supple.errors import FoldWarning, OutsideWarning, SuppleError
from supple.fields import FOLDED, OK, OUTSIDE, Affine, Field, Placed, compose, own_grid
from supple.space.geometry import Grid
from tests.fields import OPTIONS, along_x, checked, drawn, drawn_grid, moved, on_grid, positions_of
from tests.refusals import refused


@pytest.mark.parametrize("tolerance", [0, -1, np.nan, "fine", 1e12])
def test_tolerances_are_numbers_above_0(tolerance: Any) -> None:
    with pytest.raises(SuppleError, match="tolerance"):
        Field.from_array(np.zeros((4, 5, 2))).invert(tolerance=tolerance)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(8, 9), (5, 6, 7)])
def test_results_have_the_type_and_the_grid(shape: tuple[int, ...], dtype: Any) -> None:
    rng = np.random.default_rng(1)
    grid = drawn_grid(rng, shape)
    field = drawn(rng, grid, 0.2, beyond="edge", dtype=np.dtype(dtype).str[1:])
    found = field.invert()
    assert found.field.values.dtype == dtype
    assert found.error.dtype == np.float32
    assert found.status.dtype == np.uint8
    assert found.error.shape == found.status.shape == shape
    assert found.field.grid is grid
    assert found.field.beyond == "edge"
    assert found.counts == {"ok": found.status.size, "folded": 0, "outside": 0, "unconverged": 0}


def test_the_grid_of_coefficients_is_that_of_the_field() -> None:
    field = Field.from_array(np.zeros((7, 8, 9, 3)), spacing=(1, 2, 3), interpolation="bspline")
    assert field.invert().field.grid.shape == own_grid(field).shape == (5, 6, 7)
    assert own_grid(field).origin == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(("interpolation", "beyond", "dtype"), OPTIONS)
@pytest.mark.parametrize("shift", [(0.0, 0.0), (2.25, -3.25), (1e4, 1e4)])
def test_constant_fields(interpolation: str, beyond: str, dtype: str, shift: tuple[float, float]) -> None:
    values = np.zeros((12, 14, 2), dtype) + np.array(shift, dtype)
    field = Field.from_array(values, interpolation=interpolation, beyond=beyond)
    found = field.invert()
    targets = positions_of(found.field.grid)
    inside = on_grid(field, targets - shift).reshape(found.status.shape)
    np.testing.assert_array_equal(found.status, np.where(inside, OK, OUTSIDE))
    if beyond == "edge":
        inside[...] = True
    # The error is that of the rounding to float32, of what is given and what is found.
    off = np.abs(found.field.values + np.array(shift))[inside]
    assert off.max(initial=0.0) <= 1e-6 * (1 + max(np.abs(shift)))
    assert found.error[inside].max(initial=0.0) <= 0.01


@pytest.mark.parametrize("shape", [(14, 17), (8, 9, 10)])
def test_the_inverse_of_an_affine_field_is_affine(shape: tuple[int, ...]) -> None:
    n, rng = len(shape), np.random.default_rng(2)
    grid = drawn_grid(rng, shape)
    matrix = np.eye(n + 1)
    matrix[:n] += 0.15 * rng.normal(size=(n, n + 1))
    affine, places = Affine(matrix), positions_of(grid)
    for interpolation in ("linear", "bspline"):  # both of which hold linear functions
        values = (affine(places) - places).reshape(*shape, n)
        field = Field(values, grid, interpolation)
        found = field.invert(tolerance=1e-6)
        ok = found.status == OK
        wanted = affine.inverse()(positions_of(found.field.grid)).reshape(*found.status.shape, n)
        # Near the border, the field is continued as it is at its ends.
        index = grid.indices(wanted)
        inner = ((index >= 1) & (index <= np.array(grid.sizes) - 2)).all(axis=-1)
        assert ok[inner].all()
        off = found.field.values + positions_of(found.field.grid).reshape(wanted.shape) - wanted
        assert (np.linalg.norm(off, axis=-1) <= found.error + 1e-9)[inner].all()


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3, 1e6, 1e30])
def test_what_is_ok_is_within_the_tolerance(size: float, dtype: str) -> None:
    """Float32 cannot hold large displacements, and then nothing is called ok."""
    rng = np.random.default_rng(3)
    for shape in [(1, 7), (6, 7), (2, 1, 3)]:
        values = (size * rng.normal(size=(*shape, len(shape)))).astype(dtype)
        for interpolation in ("linear", "cubic"):
            for tolerance in (1e-6, 0.01):
                field = Field.from_array(values, interpolation=interpolation, beyond="edge")
                found = field.invert(tolerance=tolerance)
                ok = found.status == OK
                assert (found.error[ok] <= tolerance * (1 + 1e-6)).all()
                assert np.isfinite(found.field.values[ok]).all()


@pytest.mark.parametrize("shape", [(31, 34), (9, 11, 13)])
@pytest.mark.parametrize("interpolation", ["linear", "bspline"])
def test_the_error_covers_the_rounding_of_the_result(shape: tuple[int, ...], interpolation: Any) -> None:
    field = drawn(np.random.default_rng(4), Grid(shape, 0.7), 0.3, interpolation=interpolation, dtype="f4")
    rounded = field.invert()
    exact = Field(field.values.astype(np.float64), field.grid, interpolation).invert(tolerance=1e-9)
    both = (rounded.status == OK) & (exact.status == OK)
    off = np.linalg.norm(rounded.field.values - exact.field.values, axis=-1)
    assert both.mean() > 0.5
    assert (off <= rounded.error + exact.error + 1e-13)[both].all()
    assert 1e-9 < rounded.error[both].max() < 1e-5


def test_what_is_mapped_away_is_outside() -> None:
    field = along_x(np.arange(20.0) + 6)
    found = field.invert()
    assert (found.status[:, :5] == OUTSIDE).all()
    assert (found.status[:, 6:] == OK).all()
    np.testing.assert_allclose(found.field.values[:, 6:, 0], -6, atol=1e-12)


def test_a_fold_and_what_is_mapped_there() -> None:
    places = np.interp(np.arange(40.0), [0, 15, 20, 39], [0, 22, 12, 39])
    found = along_x(places).invert()
    y = np.arange(40)
    assert (found.status[:, (y >= 12) & (y <= 22)] != OK).all()
    assert (found.status == FOLDED).any()
    assert (found.status[:, (y < 11) | (y > 23)] == OK).all()


def test_an_inverse_that_is_not_known_has_no_error() -> None:
    rng = np.random.default_rng(4)
    found = Field.from_array(30 * rng.normal(size=(30, 30, 2))).invert()
    assert np.isinf(found.error[found.status == 3]).all()
    assert np.isfinite(found.error[found.status == OK]).all()
    assert np.isfinite(found.field.values).all()


@given(
    seed=st.integers(0, 2**32 - 1),
    option=st.sampled_from(OPTIONS),
    steepness=st.sampled_from([0.05, 0.3, 0.6]),
    width=st.sampled_from([0.0, 1.0, 4.0]),
    tolerance=st.sampled_from([1e-5, 0.01, 0.2]),
    shape=st.lists(st.integers(1, 12), min_size=2, max_size=3),
)
def test_random_inverses(
    seed: int, option: tuple[str, str, str], steepness: float, width: float, tolerance: float, shape: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    interpolation, beyond, dtype = option
    if interpolation == "bspline":
        shape = [max(4, n) for n in shape]
    if interpolation != "linear":
        steepness *= 0.4
    grid = drawn_grid(rng, tuple(shape))
    field = drawn(rng, grid, steepness, width=width, interpolation=interpolation, beyond=beyond, dtype=dtype)
    onto = Grid(
        rng.integers(1, 14, len(shape)).tolist(),
        rng.uniform(0.2, 2, len(shape)).tolist(),
        grid.positions(rng.uniform(0, 1, len(shape)) * (np.array(grid.sizes) - 1)).tolist(),
        drawn_grid(rng, tuple(shape)).direction,
    )
    for each in (None, onto):
        checked(field, field.invert(each, tolerance=tolerance), tolerance)


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "bspline"])
@pytest.mark.parametrize("shape", [(16, 18), (8, 9, 10)])
def test_compositions_are_those_of_the_maps(shape: tuple[int, ...], interpolation: str) -> None:
    n, rng = len(shape), np.random.default_rng(5)
    grid = drawn_grid(rng, shape)
    matrix = np.eye(n + 1)
    matrix[:n] += 0.1 * rng.normal(size=(n, n + 1))
    affine = Affine(matrix)
    one, other = (
        drawn(rng, grid, 0.3, interpolation=interpolation, beyond="edge", dtype=dtype) for dtype in ("f4", "f8")
    )
    places = positions_of(grid)
    wanted = moved(other, affine(moved(one, places)))
    with warnings.catch_warnings(action="error"):
        made = one.compose(affine, other, grid=grid)
    assert made.values.dtype == np.float32
    np.testing.assert_allclose(made.values.reshape(-1, n) + places, wanted, atol=1e-5)
    # Each after its inverse changes nothing; "edge" fields go on, so that whether it is outside does not matter.
    with warnings.catch_warnings(action="ignore", category=OutsideWarning):
        back = compose([one, affine, Placed(affine, True), Placed(one, True)], grid)
        forth = compose([Placed(one, True), one], grid)
    for each in (back, forth):
        np.testing.assert_allclose(each.values, 0, atol=1e-6)


def test_compositions_warn_of_folds_and_of_what_is_outside() -> None:
    places = np.interp(np.arange(40.0), [0, 15, 20, 39], [0, 22, 12, 39])
    folded, away = along_x(places), along_x(np.arange(20.0) + 6)
    with pytest.warns(
        FoldWarning, match=r"^u\.nii folds in 15 of its 117 cells: where folds are mapped to, the"
    ) as told:
        compose([Placed(folded, True, name="u.nii")], Grid((4, 40)))
    assert len(told) == 1
    # Used as it is, it has one value at each point.
    here = r"^u\.nii folds; \d+ of the points found lie in a part that is turned over \(supple check shows where\)$"
    with pytest.warns(FoldWarning, match=here):
        compose([Placed(folded, name="u.nii")], Grid((4, 40)))
    with pytest.warns(OutsideWarning):
        compose([Placed(away, True)], Grid((4, 20)))


def test_a_composition_begins_on_the_grid_of_the_result() -> None:
    field, far = along_x(np.arange(20.0)), Grid((4, 20), origin=(500.0, 0.0))
    with pytest.raises(SuppleError, match=r"the field and the grid of the result do not overlap: from \("):
        compose([field], far)
    with pytest.raises(SuppleError, match="the affine map is for volumes, with 3 axes"):
        compose([Affine(np.eye(4))], far)
    compose([Affine([[1, 0, -500], [0, 1, 0]]), field], far)


FLAT = Field.from_array(np.zeros((4, 5, 2)))
WRONG: list[tuple[Callable[[], Any], str]] = [
    (lambda: Field(np.zeros((4, 5, 2)), (4, 5)), r"grid must be a Grid, found \(4, 5\)"),  # type: ignore[arg-type]
    (lambda: Field(np.zeros((4, 5, 3)), Grid((4, 5))), r"values must be an array of shape \(4, 5, 2\), as the grid is"),
    (lambda: Field.from_array(np.zeros((4, 5, 3))), r"values must be an array of shape \(H, W, 2\) or \(Z, H, W, 3\),"),
    (
        lambda: Field.from_array(np.zeros((2, 4, 5))),
        r"values must be an array of .* found shape \(2, 4, 5\)",
    ),
    (lambda: Field.from_array(np.zeros((4, 5))), r"values must be an array of .* x first, found shape \(4, 5\)"),
    (lambda: Field.from_array(np.zeros((0, 5, 2))), r"shape\[0\] must be an integer from 1"),
    (lambda: Field.from_array(np.zeros((4, 5, 2)), interpolation="quintic"), "interpolation must be"),  # type: ignore[arg-type]
    (lambda: Field.from_array(np.zeros((4, 5, 2)), beyond="wrap"), "beyond must be"),  # type: ignore[arg-type]
    (lambda: Field.from_array(np.zeros((3, 5, 2)), interpolation="bspline"), "4 coefficients"),
    (lambda: FLAT.invert(Grid((4, 5), 1.0, (100.0, 0.0))), "do not overlap"),
    (lambda: FLAT.invert(Grid((4, 5, 6))), "a field of 2 axes needs a grid of as many"),
    (lambda: Field.from_array(np.zeros((4, 5, 2), complex)), "values must be real numbers, .*complex128 of shape"),
    (lambda: Field.from_array([[1, 2], [3]]), "values must be an array of numbers"),
    (lambda: Field.from_array(np.full((4, 5, 2), np.nan)), "the field holds NaN or infinity"),
    (lambda: FLAT.invert((4, 5)), "grid must be a Grid"),  # type: ignore[arg-type]
    (lambda: FLAT.check("u.nii"), "inverse must be a Field, found 'u.nii'"),  # type: ignore[arg-type]
    (lambda: FLAT.check(Field.from_array(np.zeros((4, 5, 6, 3)))), "a field of 2 axes has no inverse of 3"),
    (lambda: FLAT.compose("u.nii"), "a map must be a Field, an Affine, or a Placed with one"),  # type: ignore[arg-type]
    (lambda: FLAT.compose(FLAT, grid=3), "grid must be a Grid"),  # type: ignore[arg-type]
    (lambda: compose([FLAT], None), "grid must be a Grid"),  # type: ignore[arg-type]
    (lambda: compose([FLAT, Affine(np.eye(4))], Grid((4, 5))), "the affine map is for volumes, with 3 axes"),
    (lambda: Placed(np.eye(3)), "a map must be a Field, an Affine"),  # type: ignore[arg-type]
    (lambda: Deformation((4, 5)).field(np.zeros((4, 5, 2))), "field must be a Field"),  # type: ignore[arg-type]
    (lambda: Deformation((4, 5, 6)).field(FLAT), "the field has 2 axes, and the shape"),
    (
        lambda: Deformation(Grid((4, 5), 1.0, (90, 0))).field(FLAT).inverse_map(),
        "the grid of the output do not overlap",
    ),
    (
        lambda: Deformation((4, 5)).field(FLAT).warp(np.zeros((4, 5)), grid=Grid((4, 5), 1.0, (90, 0))),
        "the field and the grid of the output do not overlap",
    ),
]


@pytest.mark.parametrize(("make", "said"), WRONG)
def test_what_is_wrong_is_told_in_a_line(make: Callable[[], Any], said: str) -> None:
    refused(make, match=said)


def test_affine_maps() -> None:
    affine = Affine([[1, 0.5, 2], [0, 2, -1]])
    np.testing.assert_allclose(affine((3, 4)), (7, 7))
    np.testing.assert_allclose(affine.inverse()(affine(np.ones((2, 3, 2)))), np.ones((2, 3, 2)))
    for wrong in (np.zeros((2, 3)), np.full((2, 3), np.nan), np.eye(2), [[1, 0, 0], [0, 1, 0], [0, 0, 2]], "affine"):
        with pytest.raises(SuppleError):
            Affine(wrong)
