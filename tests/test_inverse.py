"""T⁻¹ of points: found wherever they are and however hard the strokes drag; or, if not, so reported."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, SuppleError
from supple.folding.strain import limit
from supple.strokes import Stroke
from tests import reference, soak

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Floats = npt.NDArray[np.float64]

SHAPE = (90, 120)
VOLUME = (30, 40, 50)


def twenty_radii(**how: Any) -> Deformation:
    return Deformation((300, 300), **{"border": 64, "on_fold": "damp", **how}).grab(
        (150, 150), by=(200, 0), radius=10, scales=2, reach=None
    )


def deep_sequence(**how: Any) -> Deformation:
    rng = np.random.default_rng(1)
    d = Deformation(SHAPE, **{"border": 64, "on_fold": "damp", **how})
    for _ in range(30):
        radius = float(np.exp(rng.uniform(0.5, 5)))
        by = rng.normal(size=2) * radius
        d = d.grab(rng.uniform(0, 1, 2) * (119, 89), by=by, radius=radius, scales=int(rng.integers(1, 4)), reach=None)
    return d


def damped(at: Any = (50.5, 30.0), by: Any = (9.0, -17.0), radius: float = 30.0, **how: Any) -> Deformation:
    """One drag, as far as it does not fold; of the options, some are the brush's."""
    brush = {name: how.pop(name) for name in ("poisson", "scales", "reach") if name in how}
    d = Deformation(how.pop("shape", SHAPE), **{"border": 64, "on_fold": "damp", **how})
    return d.add(Stroke.grab(at, by=by, radius=radius, **brush), warn=False)


def far(at: Any, by: Any, radius: float, **how: Any) -> Deformation:
    return damped(at, by, radius, reach=None, **how)


PROBLEMS: dict[str, Callable[[], Deformation]] = {
    "nothing": lambda: Deformation(SHAPE, border=64, on_fold="damp"),
    "one grab": damped,
    "a free border": lambda: damped(border=None),
    "a border of one pixel": lambda: damped(border=1.0),
    "a border wider than all": lambda: damped(border=1e6),
    "ν = 0.5": lambda: damped(poisson=0.5),
    "ν = -∞": lambda: damped(poisson=-math.inf),
    "two scales": lambda: damped(scales=2),
    "three scales": lambda: damped(scales=3),
    "20 radii, damped": lambda: twenty_radii(),
    "20 radii, damped, free": lambda: twenty_radii(border=None),
    "20 radii, flowing": lambda: twenty_radii(on_fold="flow", border=None),
    "20 radii, flowing, a border": lambda: far((100, 150), (200, 0), 10, scales=2, shape=(300, 400), on_fold="flow"),
    "just below the limit": lambda: far((60, 40), (0.985 * 20 * limit(0.4, 1), 0), 20, border=None),
    "a corner": lambda: far((0, 0), (30, 40), 30),
    "the other corner": lambda: far((119, 89), (-30, -40), 30, scales=2, border=5),
    "a free corner": lambda: far((119, 0), (-30, 40), 30, border=None),
    "a face": lambda: far((60, 0), (4, 40), 30, border=3),
    "far outside": lambda: far((-300, 500), (400, 90), 200),
    "just outside": lambda: far((-3, 92), (20, -30), 15, scales=3, border=None),
    "a pixel's radius": lambda: far((60.3, 40.9), (1, -0.7), 1, scales=3),
    "a radius of many images": lambda: far((60, 40), (900, 500), 5000),
    "flat pixels": lambda: far((50, 30), (40, -2), 12, spacing=(0.2, 3.0)),
    "tiny units": lambda: far((50, 30), (9, -17), 3e-8, spacing=1e-9, border=1e-8),
    "thirty strokes": lambda: deep_sequence(),
    "thirty strokes, free": lambda: deep_sequence(border=None),
    "there and back": lambda: (
        Deformation((200, 200), border=20)
        .grab((60, 100), to=(140, 105), radius=20)
        .grab((140, 105), to=(60, 100), radius=20)
    ),
    "a volume": lambda: far((25, 20, 15), (9, -7, 4), 12, shape=VOLUME, border=8),
    "thick slices": lambda: damped(
        (25, 20, 15), (9, -7, 1), 12, scales=2, shape=VOLUME, border=10, spacing=(0.7, 0.7, 3.0)
    ).grab((5, 39, 0), by=(-9, -7, 30), radius=40, poisson=-2),
    "a volume, flowing": lambda: far((10, 20, 15), (30, -8, 5), 5, shape=VOLUME, border=None, on_fold="flow"),
    "one row": lambda: far((50, 0), (30, 0), 20, shape=(1, 120)),
    "one pixel": lambda: far((0, 0), (3, 1), 4, shape=(1, 1), border=None),
}


def targets(d: Deformation) -> Floats:
    """Points within, outside, far outside, on faces and corners, and around what is held and where it goes."""
    rng = np.random.default_rng(2)
    n, size = d.ndim, np.array(d.shape[::-1]) - 1.0
    inside = rng.uniform(0, 1, (300, n)) * size
    faces = np.where(rng.uniform(size=(100, n)) < 0.4, rng.integers(0, 2, (100, n)) * size, inside[:100])
    corners = np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=n))) * size
    outside, far = rng.uniform(-1, 2, (100, n)) * (size + 1), rng.normal(size=(50, n)) * 1e4
    held = [np.array(s.at) + part * np.array(s.by) for s in d.strokes for part in (0, 0.5, 1)]
    steps = np.array(d.domain.spacing)
    near = [
        h + rng.normal(size=(5, n)) * s.radius * 10.0 ** rng.uniform(-8, 0, (5, 1)) / steps
        for h, s in zip(held, [s for s in d.strokes for _ in range(3)], strict=True)
    ]
    return np.concatenate([inside, faces, corners, outside, far, *(h[None] for h in held), *near])


@pytest.mark.parametrize("problem", PROBLEMS)
def test_it_is_the_inverse(problem: str) -> None:
    d = PROBLEMS[problem]()
    q = targets(d)
    found = d.inverse(q)
    assert found.converged.all()
    assert found.points.dtype == found.residual.dtype == np.float64
    # By the engine's own T, and the residual is as it is said to be, ...
    off = np.linalg.norm(d.forward(found.points) - q, axis=-1)
    assert off.max() < 1e-6
    rounding = 1e-14 * (1 + np.abs(q).max()) * (1 + np.linalg.norm(d.jacobian(found.points), axis=(1, 2)))
    said = found.residual * min(d.domain.spacing) / np.array(d.domain.spacing).max()
    assert (said <= off + 100 * rounding).all()
    assert (off <= found.residual + 100 * rounding).all()
    # ... and by the printed equations, where what is applied can be told without the engine.
    if d.on_fold == "damp":
        moved = reference.forward(reference.carried_out(d), d.domain, found.points)
        assert np.abs(moved - q).max() < 1e-6
    # One-to-one: it comes back from where it was sent to.
    p = q[:600]
    back = d.inverse(d.forward(p))
    assert back.converged.all()
    leeway = 2e-6 / np.linalg.svd(d.jacobian(p), compute_uv=False)[:, -1]
    ratio = max(d.domain.spacing) / min(d.domain.spacing)
    assert (np.linalg.norm(back.points - p, axis=-1) <= ratio * leeway).all()
    assert (np.linalg.det(d.jacobian(found.points)) > 0).all()


def test_faces_and_corners_stay_where_they_are() -> None:
    d = deep_sequence(border=7.0)
    x, y = np.linspace(-0.5, 119.5, 50), np.linspace(-0.5, 89.5, 50)
    for axis, side, along in ((1, -0.5, x), (1, 89.5, x), (0, -0.5, y), (0, 119.5, y)):
        q = np.empty((50, 2))
        q[:, axis], q[:, 1 - axis] = side, along
        found = d.inverse(q)
        assert found.converged.all()
        np.testing.assert_array_equal(found.points[:, axis], q[:, axis])
    corners = np.array(list(itertools.product((-0.5, 119.5), (-0.5, 89.5))))
    np.testing.assert_array_equal(d.inverse(corners).points, corners)
    # What is within stays within.
    inside = d.inverse(reference.grid(SHAPE)).points
    assert ((inside >= -0.5) & (inside <= (119.5, 89.5))).all()


def test_far_from_the_domain() -> None:
    for border in (None, 20.0):
        d = damped(border=border)
        for distance in (1e3, 1e6, 1e9, 1e12):
            q = np.array([[distance, 3.0], [-distance, -distance], [40.0, distance]])
            found = d.inverse(q)
            assert found.converged.all()
            np.testing.assert_allclose(d.forward(found.points), q, rtol=1e-14, atol=1e-6)


def test_the_identity_is_exact() -> None:
    q = np.random.default_rng(4).normal(size=(50, 2)) * 1e3
    for d in (
        Deformation(SHAPE, border=64, on_fold="damp"),
        Deformation(SHAPE, spacing=(0.3, 0.7), border=64, on_fold="damp").grab((5, 5), by=(0, 0), radius=4, reach=None),
    ):
        found = d.inverse(q)
        np.testing.assert_array_equal(found.points, q)
        assert found.converged.all()
        assert (found.residual == 0).all()
        assert not np.may_share_memory(found.points, q)


def test_few_steps() -> None:
    """Newton's method: a handful of evaluations, even at the very limit."""
    gentle = Deformation((512, 512), border=64, on_fold="damp").grab((256, 256), by=(0, 90), radius=100, reach=None)
    q = reference.grid((512, 512))[::16, ::16]
    assert gentle.inverse(q).steps.mean() < 6
    assert gentle.inverse(q).steps.max() < 12
    hard = PROBLEMS["just below the limit"]()
    assert hard.inverse(reference.grid(SHAPE)).steps.max() < 40


def test_what_cannot_be_undone_is_reported() -> None:
    """Each of these drags can be undone alone; together they lose more digits than float64 has."""
    d = Deformation((100, 100), border=5, border_profile="sine", on_fold="flow")
    for _ in range(5):
        d = d.grab((30, 50), to=(98.5, 50), radius=8, reach=None)
    for _ in range(5):
        d = d.grab((98.5, 50), to=(30, 50), radius=8, reach=None)
    q = reference.grid(d.shape)
    found = d.inverse(q)
    lost = ~found.converged
    assert lost.any()
    assert not lost.all()
    # What is said of each is true, ...
    assert (found.residual[lost] > 1e-6).all()
    assert (found.residual[~lost] <= 1e-6).all()
    off = np.linalg.norm(d.forward(found.points) - q, axis=-1)
    assert (off[~lost] <= 1e-4).all()
    # ... and it is lost to rounding only.
    assert (soak.attainable(d, found.points[lost]) > 1e-6 / soak.FAIR).all()
    report = d.report()
    assert report.unconverged > 0
    assert not report.within


@pytest.mark.parametrize("shape", [(), (1,), (7,), (0,), (2, 0), (3, 4), (0, 5, 2), (2, 1, 3)])
@pytest.mark.parametrize("ndim", [2, 3])
@pytest.mark.parametrize("moved", [False, True])
def test_shapes_are_kept(shape: tuple[int, ...], ndim: int, moved: bool) -> None:
    d = Deformation((SHAPE, VOLUME)[ndim - 2], border=64, on_fold="damp")
    if moved:
        d = d.grab((20, 15, 12)[:ndim], by=(3, 2, 1)[:ndim], radius=10, reach=None)
    points = np.full((*shape, ndim), 12.0)
    found = d.inverse(points)
    assert found.points.shape == points.shape
    assert found.residual.shape == found.steps.shape == found.converged.shape == shape
    assert found.converged.dtype == np.bool_
    assert found.steps.dtype == np.int64
    assert (points == 12).all()


def test_points_of_any_kind() -> None:
    d = damped()
    expected = d.inverse(np.array([[12.0, 40.0], [7.0, 3.0]])).points
    columns = np.array([[12.0, 7.0], [40.0, 3.0]])
    wide = np.zeros((4, 4))
    wide[::2, ::2] = [[12, 40], [7, 3]]
    frozen = np.array([[12.0, 40.0], [7.0, 3.0]])
    frozen.flags.writeable = False
    for points in (
        [[12, 40], [7, 3]],
        ((12.0, 40), (7, 3)),
        np.array([[12, 40], [7, 3]], np.uint8),
        np.array([[12, 40], [7, 3]], np.float16),
        np.array([[12, 40], [7, 3]], ">f4"),
        columns.T,
        wide[::2, ::2],
        frozen,
    ):
        np.testing.assert_array_equal(d.inverse(points).points, expected)


BAD = [
    (3.0, "shape"),
    ((), "shape"),
    ((1, 2, 3), "shape"),
    (np.zeros((2, 3)), "shape"),
    (np.zeros((2, 0)), "shape"),
    ("here", "points must be"),
    ([(1, 2), (3,)], "points must be"),
    ([1, None], "points must be"),
    ((1j, 2), "points must be"),
    ((math.nan, 1), "finite"),
    ([(1, 2), (math.inf, 3)], "finite"),
    ((1, -math.inf), "finite"),
]


@pytest.mark.parametrize(("points", "message"), BAD)
@pytest.mark.parametrize("method", ["inverse", "forward", "jacobian"])
def test_bad_points_are_refused(points: Any, message: str, method: str) -> None:
    for d in (PROBLEMS["nothing"](), damped()):
        with pytest.raises(SuppleError, match=message):
            getattr(d, method)(points)
