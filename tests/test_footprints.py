"""What a pixel covers, and what samples weigh in its average: against integrals and polynomials."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import reference

from supple.cpu.footprint import (
    ANTIALIAS,
    AUTO,
    ENTRY,
    EWA,
    MAJOR,
    MINOR,
    PADDED,
    PARTS,
    PLACES,
    STEPS,
    TAPS,
    WIDEST,
    XX,
    XY,
    YY,
    extremes,
    footprints,
    slopes,
    weights,
)

Floats = npt.NDArray[np.float64]


def interpolated(place: float, squared: float) -> Floats:
    """What the samples -2 to 3 weigh, as kernels read it from the table."""
    table = weights(np.dtype(np.float64))
    i, j = round(place * PLACES), round(squared * STEPS)
    at = (j * (PLACES + 1) + i) * ENTRY
    entry = table[at : at + ENTRY].reshape(3, PADDED)
    return np.asarray(entry[0] + (place * PLACES - i) * entry[1] + (squared * STEPS - j) * entry[2])


def test_weights_are_integrals_of_the_kernel() -> None:
    rng = np.random.default_rng(0)
    places, squares = rng.uniform(0, 1, 2000), rng.uniform(0, WIDEST**2, 2000)
    squares[:200] = rng.uniform(0, 0.05, 200)
    for place, squared in zip(places, squares, strict=True):
        made = interpolated(place, squared)
        t = np.arange(TAPS) - 2 - place
        wanted = reference.averaged("cubic", t, np.full(TAPS, np.sqrt(squared)))
        np.testing.assert_allclose(made[:TAPS], wanted, rtol=0, atol=2.5e-4)
        assert made.sum() == pytest.approx(1, abs=1e-11)
        assert not made[TAPS:].any()
        if squared <= 1:  # five samples; so many are read
            assert made[5 if place * PLACES < PLACES // 2 + 0.5 else 0] == 0


ALONE = np.zeros((1, 3), np.int64)  # anchors of one run


def row(
    points: npt.NDArray[np.float32], anchors: npt.NDArray[np.int64], run: int, c: int, y: int, left: int, n: int
) -> tuple[Floats, Floats]:
    across, down = np.empty(n, np.float32), np.empty(n, np.float32)
    slopes(points, anchors, run, c, y, left, n, across, down)
    return across.astype(float), down.astype(float)


def test_slopes_are_central_differences_at_ends_too() -> None:
    # Of a cubic, whose own values beyond the ends are known.
    def cubic(y: Floats, x: Floats) -> Floats:  # bent little enough to count as a whole
        return 0.004 * x**3 - 0.08 * x**2 + x - 0.015 * y**3 + 0.1 * y * y + 0.02 * x * y + 0.003 * x * x * y

    y, x = np.mgrid[:7, :20].astype(float)
    edges, anchors = [0, 6, 15, 16, 20], np.array([[0, 5, 0], [7, -3, 1], [8, 9, 2], [-20, 0, 3]])
    points = np.stack([cubic(y, x), -cubic(y, x)])
    for run in range(4):
        for c in range(2):
            points[c, :, edges[run] : edges[run + 1]] -= anchors[run, c]
    across, down = (cubic(y, x + 1) - cubic(y, x - 1)) / 2, (cubic(y + 1, x) - cubic(y - 1, x)) / 2
    for run in range(4):
        left, right = edges[run], edges[run + 1]
        for k in range(7):
            for c, sign in ((0, 1), (1, -1)):
                found = row(points.astype(np.float32), anchors, run, c, k, left, right - left)
                np.testing.assert_allclose(found[0], sign * across[k, left:right], atol=4e-5)
                np.testing.assert_allclose(found[1], sign * down[k, left:right], atol=4e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2), (3, 3), (2, 7), (4, 3)])
def test_slopes_of_few_pixels(shape: tuple[int, int]) -> None:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    points = np.stack([1.5 * x + 0.25 * y, 0.75 * y - 0.5 * x]).astype(np.float32)
    alone = [shape[1] == 1, shape[0] == 1]  # nothing is known of such a direction: it is as if nothing moved
    for k in range(shape[0]):
        for c, wanted in ((0, (1.5, 0.25)), (1, (-0.5, 0.75))):
            for axis, found in enumerate(row(points, ALONE, 0, c, k, 0, shape[1])):
                np.testing.assert_allclose(found, (1.0 if c == axis else 0.0) if alone[axis] else wanted[axis])


@pytest.mark.parametrize("mode", [AUTO, ANTIALIAS, EWA])
def test_footprints_are_those_of_the_jacobian(mode: int) -> None:
    rng = np.random.default_rng(mode)
    for _ in range(50):
        m = rng.normal(0, 1.2, (2, 2))
        y, x = np.mgrid[:5, :6].astype(float)
        points = np.einsum("ij,jyx->iyx", m, np.stack([x, y])).astype(np.float32)
        parts = np.empty(PARTS, np.float32)
        footprints(points, ALONE, 0, 2, 0, 6, mode, parts)
        u, s, _ = np.linalg.svd(m)
        if mode == EWA:
            s = np.maximum(s, 1)
        else:
            low, high = (1.0, 1.21) if mode == AUTO else (0.97**2, 1.0)
            s = s * np.sqrt(np.clip((s[0] ** 2 - low) / (high - low), 0, 1))
        c = (u * s**2) @ u.T
        for place, wanted in ((MAJOR, s[0] ** 2), (MINOR, s[1] ** 2), (XX, c[0, 0]), (XY, c[0, 1]), (YY, c[1, 1])):
            np.testing.assert_allclose(parts[place : place + 6], wanted, atol=1e-4 * (1 + s[0] ** 2))


@pytest.mark.parametrize("mode", [AUTO, ANTIALIAS])
def test_no_footprint_is_larger_than_a_band_s_largest(mode: int) -> None:
    # Under smaller brushes some are, and are cut.
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:96, :200].astype(float)
    for radius in (6.0, 15.0, 40.0, 200.0):
        cx, cy = rng.uniform(0, 200), rng.uniform(0, 96)
        bell = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * radius**2))
        a, b = rng.normal(0, 1.5 * radius, 2)
        points = np.stack([x + a * bell, y + b * bell]).astype(np.float32)
        parts = np.empty(PARTS, np.float32)
        largest, second = extremes(points, ALONE, 0, 0, 200, mode, parts)
        for k in range(96):
            footprints(points, ALONE, 0, k, 0, 200, mode, parts)
            assert parts[MAJOR : MAJOR + 200].max() <= largest
            assert parts[MINOR : MINOR + 200].max() <= second
