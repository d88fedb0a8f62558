"""The lattice's promise: no pixel is farther from the true T⁻¹ than the report says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import reference

from supple import Deformation, SuppleError
from supple.cpu import lattice

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

POISSONS = [-math.inf, -5.0, 0.0, 0.3, 0.45, 0.5]
TOLERANCES = (1.0, 0.1, 0.01, 1e-3)


def measured(d: Deformation, tolerance: float) -> float:
    """How far the worst pixel of the map is from T⁻¹, less what float32 cannot tell apart."""
    found = d.inverse_map(tolerance=tolerance)
    assert found.dtype == np.float32
    assert found.shape == (*d.shape, d.ndim)
    true = d.inverse(reference.grid(d.shape))
    assert true.converged.all()
    off = np.abs(found - true.points) - np.spacing(np.abs(found)) / 2
    return float(np.linalg.norm(np.maximum(off, 0), axis=-1).max())


def promise(d: Deformation, tolerances: tuple[float, ...] = TOLERANCES) -> None:
    for tolerance in tolerances:
        report = d.report(tolerance=tolerance)
        assert report.within
        assert report.error <= tolerance
        assert report.folds == 0
        worst = measured(d, tolerance)
        assert worst <= report.error, f"tolerance {tolerance}: {worst:.3g} px, said {report.error:.3g} px; {d}"


def drawn(rng: np.random.Generator, shape: tuple[int, ...], strokes: int, **domain: Any) -> Deformation:
    """Random strokes: from a pixel's radius to the whole, at nodes, borders, anywhere, weak and too strong."""
    d = Deformation(shape, border=[None, 1.0, 5.0, 50.0, 200.0][rng.integers(5)], **domain)
    size, n = np.array(shape[::-1]) - 1.0, len(shape)
    for _ in range(strokes):
        radius = float(np.exp(rng.uniform(0, math.log(max(shape) + 8))))
        at = rng.uniform(-0.1, 1.1, n) * size
        if rng.uniform() < 0.3:
            at = 32 * np.round(at / 32) + rng.choice([0, 0.5, 16], n)
        elif rng.uniform() < 0.2:
            at[rng.integers(n)] = rng.choice([0, 1, 2.5])
        by = rng.normal(size=n)
        by *= radius * np.exp(rng.uniform(math.log(0.03), math.log(20))) / np.linalg.norm(by)
        poisson, scales = float(rng.choice(POISSONS)), int(rng.integers(1, 4))
        d = d.grab(at, by=by / d.domain.spacing, radius=radius, poisson=poisson, scales=scales)
    return d


@pytest.mark.parametrize("seed", range(24))
def test_one_stroke(seed: int) -> None:
    rng = np.random.default_rng(seed)
    promise(drawn(rng, tuple(int(n) for n in rng.integers(33, 110, 2)), 1))


@pytest.mark.parametrize("seed", range(8))
def test_sequences(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    promise(drawn(rng, tuple(int(n) for n in rng.integers(33, 80, 2)), int(rng.integers(2, 21))), (1.0, 0.01))


@pytest.mark.parametrize("seed", range(4))
def test_pixels_that_are_not_square(seed: int) -> None:
    rng = np.random.default_rng(2000 + seed)
    spacing = tuple(np.exp(rng.uniform(-1.5, 1.5, 2)))
    promise(drawn(rng, (70, 90), 2, spacing=spacing))


@pytest.mark.parametrize("seed", range(60))
def test_what_is_asked_for_is_reached(seed: int) -> None:
    rng = np.random.default_rng(4000 + seed)
    spacing = tuple(np.exp(rng.uniform(-1.5, 1.5, 2))) if rng.uniform() < 0.3 else (1.0, 1.0)
    shape, strokes = tuple(int(n) for n in rng.integers(33, 140, 2)), int(rng.choice([1, 1, 1, 2, 3, 5, 10, 20]))
    d = drawn(rng, shape, strokes, spacing=spacing)
    for tolerance in TOLERANCES:
        report = d.report(tolerance=tolerance)
        assert report.within
        assert report.error <= tolerance
        assert report.unconverged == 0


@pytest.mark.filterwarnings("ignore::supple.ToleranceWarning")
@pytest.mark.parametrize("axis", [0, 1])
def test_squeezed_against_the_last_column_or_row(axis: int) -> None:
    """Every drag is safe; together they leave 10⁻⁸ of a length at the face."""
    shape, at, by = (40, 60), (40, 20), (100, 0)
    if axis == 1:
        shape, at, by = shape[::-1], at[::-1], by[::-1]
    d = Deformation(shape, border=5)
    for _ in range(6):
        d = d.grab(at, by=by, radius=15)
    promise(d, (1.0, 0.01))


# Single strokes for which bounds of less than the true error have been seen.
FOUND = [
    ((129, 90), None, (67.7, 64.5), (2.39, -1.06), 4.0, 1),
    ((102, 94), None, (31.2, 100.5), (2.2, 4.9), 12.4, 3),
    ((85, 62), 50.0, (11.0, 8.5), (-7.37, -26.88), 13.8, 3),
    ((121, 106), 5.0, (61.8, 81.3), (-16.35, -61.01), 39.1, 3),
    ((108, 126), None, (96.7, 13.9), (6.65, 8.45), 3.9, 2),
    ((129, 100), 1.0, (64.1, 65.0), (11.21, 4.08), 10.9, 2),
    ((47, 128), 5.0, (27.1, 15.9), (6.48, -9.89), 8.6, 3),
    ((50, 106), None, (53.9, 48.4), (-2.28, 8.02), 8.1, 1),
    ((66, 119), None, (6.6, 46.1), (38.89, 2.4), 19.9, 1),
    ((119, 89), None, (54.9, 57.8), (-1.61, -3.13), 2.7, 3),
    ((124, 63), None, (44.2, 36.0), (-19.09, 16.76), 11.3, 2),
    ((129, 93), None, (75.9, 112.3), (-5.76, 25.58), 27.9, 2),
    ((53, 118), 50.0, (96.7, 31.7), (1.31, 4.73), 10.1, 3),
    ((93, 96), 1.0, (68.9, 13.9), (-8.16, -4.62), 5.4, 2),
    ((125, 111), None, (106.0, 65.1), (-8.44, 0.12), 24.0, 3),
]


@pytest.mark.parametrize("case", FOUND)
def test_where_bounds_have_failed(case: tuple[Any, ...]) -> None:
    shape, border, at, by, radius, scales = case
    promise(Deformation(shape, border=border).grab(at, by=by, radius=radius, scales=scales))


@pytest.mark.parametrize("at", [(48.0, 48.0), (64.0, 64.0), (47.3, 50.9), (33.0, 2.0)])
@pytest.mark.parametrize("radius", [1.0, 1.7, 3.0, 8.0])
def test_spikes_between_the_nodes(at: tuple[float, float], radius: float) -> None:
    """A tri-scale brush of a few pixels is felt at no node around it."""
    d = Deformation((97, 97)).grab(at, by=(0.9 * radius, -0.5 * radius), radius=radius, scales=3)
    promise(d)
    # It is there, and it was found.
    assert measured(Deformation((97, 97)), 1.0) == 0
    moved = np.linalg.norm(d.inverse_map() - reference.grid(d.shape), axis=-1)
    assert moved.max() > 0.3 * radius


@pytest.mark.parametrize("border", [1.0, 5.0, 50.0])
def test_strokes_at_the_border(border: float) -> None:
    for at in ((0.5, 40.0), (60.0, 98.4), (2.0, 2.0), (99.0, 0.0)):
        promise(Deformation((100, 100), border=border).grab(at, by=(9, -7), radius=12), (1.0, 0.01))


SIZES = [(1, 1), (1, 2), (1, 50), (50, 1), (2, 2), (3, 40), (31, 31), (32, 32), (33, 33), (34, 32), (65, 33), (33, 66)]


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("border", [None, 50.0])
def test_sizes(shape: tuple[int, int], border: float | None) -> None:
    at = np.array(shape[::-1]) * (0.4, 0.6)
    promise(Deformation(shape, border=border).grab(at, by=(3, -2), radius=9), (1.0, 0.01))


def test_stacks_of_planes() -> None:
    rng = np.random.default_rng(7)
    for shape in ((5, 33, 40), (3, 1, 30), (2, 65, 7)):
        promise(drawn(rng, shape, 2, spacing=(0.8, 1.0, 2.5)), (1.0, 0.01))


@pytest.mark.parametrize("seed", range(4))
def test_flow(seed: int) -> None:
    rng = np.random.default_rng(3000 + seed)
    d = Deformation((80, 100), border=[None, 20.0][seed % 2], on_fold="flow")
    while d.is_identity:
        try:
            at, radius = rng.uniform(25, 55, 2), rng.uniform(5, 40)
            d = d.grab(at, to=rng.uniform(25, 55, 2), radius=radius, scales=int(rng.integers(1, 4)))
        except SuppleError:
            continue
    promise(d, (1.0, 0.01))


def test_far_from_the_origin() -> None:
    """Offsets are kept relative to where they are, so that size costs no precision."""
    d = Deformation((40, 20_000), border=None).grab((19_900, 20), by=(6.3, 3.1), radius=20)
    d = d.grab((19_500.3, 10), by=(-4, 3.1), radius=8, scales=2)
    report = d.report()
    assert report.within
    band = reference.grid(d.shape)[:, 19_300:]
    off = np.abs(d.inverse_map()[:, 19_300:] - d.inverse(band).points)
    assert np.linalg.norm(off, axis=-1).max() <= report.error + 2**-9
    # The map comes out in float32, but what samples it does not: a ramp shows it.
    ramp = np.broadcast_to(np.arange(20_000.0), (40, 20_000))
    seen = d.warp(ramp, filter="linear")[:, 19_300:19_980]
    expected = np.minimum(d.inverse(band[:, :680]).points[..., 0], 19_999)
    assert np.abs(seen - expected).max() <= report.error


def test_a_tolerance_out_of_reach_is_not_claimed() -> None:
    report = Deformation((90, 90)).grab((40, 40), by=(20, 9), radius=30).report(tolerance=1e-9)
    assert not report.within
    assert 1e-9 < report.error < 1e-3


def test_no_strokes_no_error() -> None:
    d = Deformation((70, 50))
    assert d.report().error == 0
    np.testing.assert_array_equal(d.inverse_map(), reference.grid((70, 50)))


def test_pixels_are_interpolated() -> None:
    """What a tolerance buys is less work."""
    d = Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100)
    assert d.report(tolerance=1.0).evaluations < d.report().evaluations < 0.1


def test_the_compiled_patch_does_what_its_python_does() -> None:
    nodes = np.random.default_rng(8).normal(size=(2, 2, lattice.NODE))
    for s, t in np.random.default_rng(9).uniform(0, 1, (5, 2)):
        for c in range(3):
            args = (nodes, 0, 0, c, 16.0, 8.0, s, t)
            assert lattice.patch(*args) == pytest.approx(lattice.patch.py_func(*args), rel=1e-12)
