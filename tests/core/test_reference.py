"""The slow reference itself, against mathematics: every other engine is compared with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple.space.domain import Domain
from supple.strokes import Stroke
from tests import reference

Floats = npt.NDArray[np.float64]


def strokes_of(ndim: int, **options: Any) -> list[Stroke]:
    """Return strokes of one to three scales and materials of every kind, none of which folds."""
    drags = np.array([[3.1, -2.7, 1.4], [-1.5, 1.73, -1.61], [0.7, 0.9, 1.3]])[:, :ndim]
    places = np.array([[20.3, 17.7, 14.2], [31.3, 6.9, 9.4], [7.7, 29.5, 20.2]])[:, :ndim]
    return [
        Stroke.grab(
            at, by=by, radius=9.0 - i, scales=i + 1, poisson=(0.4, 0.5, -math.inf)[i], **{"reach": None, **options}
        )
        for i, (at, by) in enumerate(zip(places, drags, strict=True))
    ]


def places(domain: Domain, count: int = 300, beyond: float = 0.0, seed: int = 0) -> Floats:
    size = np.array(domain.shape[::-1]) - 1
    return np.random.default_rng(seed).uniform(-beyond, size + beyond, (count, domain.ndim))


@pytest.mark.parametrize("scales", [1, 2, 3])
@pytest.mark.parametrize("poisson", [0.5, 0.4, 0.0, -math.inf])
def test_the_pivot_moves_by_the_drag_and_what_is_near_alike(scales: int, poisson: float) -> None:
    domain = Domain((50, 60, 70), border=None)
    stroke = Stroke.grab((30, 20, 10), by=(2, -3, 4), radius=20, scales=scales, poisson=poisson, reach=None)
    np.testing.assert_allclose(reference.forward([stroke], domain, (30, 20, 10)), (32, 17, 14), atol=1e-12)
    np.testing.assert_allclose(reference.jacobian([stroke], domain, (30, 20, 10)), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("reach", [1.0, 2.5, 4.0])
def test_reach_ends_at_its_ball(reach: float) -> None:
    domain = Domain((60, 60, 60), spacing=(1, 1, 2), border=None)
    stroke = Stroke.grab((30, 30, 15), by=(1, -2, 0.5), radius=5, reach=reach)
    free = Stroke.grab((30, 30, 15), by=(1, -2, 0.5), radius=5, reach=None)
    np.testing.assert_allclose(reference.forward([stroke], domain, (30, 30, 15)), (31, 28, 15.5), atol=1e-12)
    points = places(domain, 4000)
    distance = np.linalg.norm((points - stroke.at) * (1, 1, 2), axis=-1)
    k = reference.forward([stroke], domain, points) - points
    inside = reference.reached([stroke], domain, points)
    np.testing.assert_array_equal(inside, distance < 5 * reach)
    assert not k[~inside].any()
    assert (k[distance < 4.9 * reach] != 0).any(axis=-1).all()
    # The quintic that falls from 1 to 0 with two derivatives of 0 at both ends.
    share = np.polyval([-6, 15, -10, 0, 0, 1], distance[inside] / (5 * reach))
    whole = reference.forward([free], domain, points[inside]) - points[inside]
    np.testing.assert_allclose(k[inside], share[:, None] * whole, atol=1e-12)


@pytest.mark.parametrize("profile", ["sine", "quartic"])
def test_the_border_fades_in_smoothly(profile: str) -> None:
    x = np.linspace(0, 30, 3001)
    beta, slope = reference.fade(x, 30.0, 8.0, profile)
    assert beta[0] == 0 == beta[-1]
    assert beta[800] == pytest.approx(1)
    np.testing.assert_allclose(beta, beta[::-1], atol=1e-12)
    expected = np.gradient(beta, x)
    np.testing.assert_allclose(slope[1:-1], expected[1:-1], atol=1e-3)
    bend = np.abs(np.diff(np.gradient(beta, x), 1)[780:820]).max() / (x[1] - x[0])
    assert bend < 0.01 if profile == "quartic" else bend > 0.03  # of the sine, the second derivative jumps there


# ---------------------------------------------------------------- filters


def symmetric(large: float, small: float, angle: float, turn: float = 0.3) -> Floats:
    """Return M with the squared singular values λ±, whose larger left vector is at an angle."""

    def rotation(t: float) -> Floats:
        return np.array([[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]])

    return rotation(angle) @ np.diag([math.sqrt(large), math.sqrt(small)]) @ rotation(turn)


SHRINKAGES = [
    (0.8, 0.5),
    (1.0, 1.0),
    (1.04, 0.7),
    (1.15, 1.05),
    (1.25, 0.3),
    (2.0, 1.6),
    (2.5, 2.4),
    (3.0, 0.9),
    (3.6, 3.4),
    (9.0, 2.0),
    (30.0, 3.9),
    (60.0, 14.0),
    (300.0, 0.5),
    (700.0, 12.8),
]


OWN = -1 / 15  # ∫ x² k(x) dx of Keys' kernel with a = -0.75


def level_of(large: float, small: float) -> tuple[int, float]:
    """Return the pyramid's level of a footprint, and how much of the next one is mixed in."""
    want, k = max(small, large / 400), 0
    while want / 4**k >= 4:
        k += 1
    f = min(max((want / 4**k - 3.2) / 0.8, 0), 1)
    return k, f * f * (3 - 2 * f)


@pytest.mark.parametrize(("large", "small"), SHRINKAGES)
@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_second_moments_are_those_of_the_residual_footprint(large: float, small: float, angle: float) -> None:
    """Of the weights around each point, averaged over all places within a block of the pyramid."""
    size, blocks = 160, 8
    x, y = np.meshgrid(np.arange(size) - 80.0, np.arange(size) - 80.0)
    source = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    within = (np.arange(4 * blocks) + 0.5) / 4 - blocks / 2
    points = np.stack(np.meshgrid(within, within), axis=-1) - 0.5
    found = reference.sample(source, points + 80, symmetric(large, small, angle))
    one, mx, my, xx, xy, yy = np.moveaxis(found, -1, 0)
    px, py = points[..., 0], points[..., 1]
    second = np.array(
        [
            [np.mean(xx - 2 * px * mx + px * px * one), np.mean(xy - px * my - py * mx + px * py * one)],
            [0.0, np.mean(yy - 2 * py * my + py * py * one)],
        ]
    )
    second[1, 0] = second[0, 1]
    assert abs(np.mean(mx - px)) < 1e-3
    assert abs(np.mean(my - py)) < 1e-3

    u, v = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    alpha = max(large - 1, 0.0)
    rise = 0.0 if alpha <= 0.1 else min(1, 0.2 / 0.1 * (alpha - 0.1) / alpha)
    wanted = np.zeros((2, 2))
    k, more = level_of(large, small)
    for level, share in ((k, 1 - more), (k + 1, more)):
        # A level's samples are averages over 2^k, so that nothing narrower is left.
        along, across = (rise * (max(x, 4.0**level) - 1) / 12 for x in (large, small))
        wanted += share * (along * np.outer(u, u) + across * np.outer(v, v) + 4.0**level * OWN * np.eye(2))
    np.testing.assert_allclose(second, wanted, rtol=1e-3, atol=1e-3)


def test_keys_interpolates_with_continuous_slopes() -> None:
    source = np.random.default_rng(1).normal(size=(1, 30, 1))

    def at(x: Floats) -> Floats:
        return reference.sample(source, np.stack([x, 0 * x], -1), filter="cubic")[:, 0]

    inside = np.arange(3.0, 27.0)
    np.testing.assert_allclose(at(inside), source[0, 3:27, 0], atol=1e-12)
    left, right = (at(inside) - at(inside - 1e-6)) / 1e-6, (at(inside + 1e-6) - at(inside)) / 1e-6
    np.testing.assert_allclose(left, right, atol=1e-4)
    # The slope at a sample is -a times the central difference over two samples.
    np.testing.assert_allclose(right, 0.75 * (source[0, 4:28, 0] - source[0, 2:26, 0]), atol=1e-4)


NEXT_SPOT = [1 + (1.7 * k) ** 2 for k in (1, 2, 5, 15, 16)]
NEXT_SPOT_FADES_IN = [1 + (1.7 * (k + 0.75)) ** 2 for k in (0, 1, 4, 14, 15)]


@pytest.mark.parametrize(
    ("large", "small", "thresholds"),
    [
        pytest.param(lambda t: t, lambda t: 0.5, [1.05], id="the interpolant ends"),
        pytest.param(lambda t: t, lambda t: 1.1, [1.2], id="the ramp ends"),
        pytest.param(lambda t: t, lambda t: 0.8, [2.62], id="the narrow case ends"),
        pytest.param(lambda t: t, lambda t: t - 0.02, [2.62], id="the narrow case ends along both axes"),
        pytest.param(lambda t: t, lambda t: 1.3, NEXT_SPOT, id="the next number of spots"),
        pytest.param(lambda t: t, lambda t: 1.3, NEXT_SPOT_FADES_IN, id="the next number fades in"),
        pytest.param(lambda t: 20.0, lambda t: t, [1.0], id="the minor axis starts"),
        pytest.param(lambda t: 20 + t, lambda t: t, [3.2, 12.8, 51.2], id="the next level fades in"),
        pytest.param(lambda t: 20 + t, lambda t: t, [4.0, 16.0, 64.0], id="the next level"),
        pytest.param(lambda t: t, lambda t: 2.0, [400 * 3.2, 400 * 4.0], id="the level of a long footprint"),
    ],
)
def test_nothing_steps_at_a_threshold(
    large: Callable[[float], float], small: Callable[[float], float], thresholds: list[float]
) -> None:
    rng = np.random.default_rng(2)
    source = rng.uniform(0, 255, (96, 96, 1))
    points = rng.uniform(20, 75, (40, 2))

    def at(t: float) -> Floats:
        return np.asarray(reference.sample(source, points, symmetric(large(t), small(t), 0.6)))

    for t in thresholds:
        assert np.abs(at(t * (1 + 1e-9)) - at(t * (1 - 1e-9))).max() < 1e-4
        # Farther on, the footprint does matter.
        assert np.abs(at(t * 1.1) - at(t)).max() > 1e-4


# ---------------------------------------------------------------- frames


def test_between_frames() -> None:
    rng = np.random.default_rng(5)
    frames = rng.uniform(size=(7, 12, 13, 2))
    points = np.column_stack([rng.uniform(1, 11, (60, 2)), rng.uniform(2, 4, 60)])
    t, x = points[:, 2], points[:, :2]
    low = np.floor(t).astype(int)
    parts = np.stack([reference.sample(frame, x, filter="cubic") for frame in frames])
    pair = [parts[low + i, np.arange(60)] for i in range(-1, 3)]
    f = (t - low)[:, None]
    linear = (1 - f) * pair[1] + f * pair[2]
    np.testing.assert_allclose(reference.sample_frames(frames, points, "cubic", "linear"), linear, atol=1e-12)
    # Catmull and Rom: the cubic through both with the slopes of central differences.
    slope, next_one = (pair[2] - pair[0]) / 2, (pair[3] - pair[1]) / 2
    hermite = (
        (2 * f**3 - 3 * f**2 + 1) * pair[1]
        + (f**3 - 2 * f**2 + f) * slope
        + (3 * f**2 - 2 * f**3) * pair[2]
        + (f**3 - f**2) * next_one
    )
    np.testing.assert_allclose(reference.sample_frames(frames, points, "cubic", "cubic"), hermite, atol=1e-12)
    nearest = parts[np.floor(t + 0.5).astype(int), np.arange(60)]
    np.testing.assert_array_equal(reference.sample_frames(frames, points, "cubic", "nearest"), nearest)
    plane = symmetric(3.0, 2.0, 0.4)
    wide = reference.sample_frames(frames, points, "auto", "linear", matrices=plane)
    each = np.stack([reference.sample(frame, x, plane) for frame in frames])
    np.testing.assert_allclose(wide, (1 - f) * each[low, np.arange(60)] + f * each[low + 1, np.arange(60)], atol=1e-12)


@pytest.mark.parametrize("between", ["linear", "cubic"])
def test_time_is_averaged_over_a_box(between: str) -> None:
    frames = np.random.default_rng(6).uniform(size=(30, 3, 3, 1))
    for width in (0.4, 1.0, 3.3, 8.0):
        ends = np.linspace(10.2, 18.3, 9)
        points = np.column_stack([np.ones(9), np.ones(9), ends])
        found = reference.sample_frames(frames, points, "linear", between, widths=width)
        within = width * ((np.arange(2000) + 0.5) / 2000 - 0.5)
        many = np.stack([np.ones((9, 2000)), np.ones((9, 2000)), ends[:, None] + within], -1)
        truth = reference.sample_frames(frames, many, "linear", between).mean(axis=1)
        np.testing.assert_allclose(found, truth, atol=1e-5)


# ---------------------------------------------------------------- whole warps


def test_types_hold_what_is_rounded_half_up() -> None:
    assert reference.rounded(np.array([-3.0, 0.5, 1.5, 254.49, 254.5, 300.0]), "u1").tolist() == [
        0,
        1,
        2,
        254,
        255,
        255,
    ]
    assert reference.rounded(np.array([-128.6, -0.5, -0.51]), "i1").tolist() == [-128, 0, -1]
    assert reference.rounded(np.array([1e30, -1e30]), "i8").tolist() == [2**63 - 1024, -(2**63)]
    assert reference.rounded(np.array([0.49, 0.5]), "?").tolist() == [False, True]
    assert reference.rounded(np.array([0.1]), "f4").dtype == np.float32
