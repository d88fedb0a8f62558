"""Deformations of strokes, affine maps and fields: points, warps, other grids, and parts of grids."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.stats import special_ortho_group

from supple import Deformation
from supple.engine.core import plan_of
from supple.errors import SuppleError
from supple.fields import Field
from supple.space.geometry import Grid
from tests.effort import examples
from tests.fields import drawn

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

Floats = npt.NDArray[np.float64]
Rng = np.random.Generator
DTYPES = ["u1", "u2", "i2", "f4", "f8", "?", "f2", "i4"]


def random_deformation(seed: int, n: int, *, maps: bool = True, beyond: str | None = None, odd: bool = False) -> Any:
    """Return one to four strokes, affine maps and fields of all kinds, on a grid that may be oblique."""
    rng = np.random.default_rng(seed)
    low, high = (12, 48) if n == 2 else (5, 14)
    shape = tuple(int(x) for x in rng.integers(low, high, n))
    if odd:
        shape = tuple(1 if rng.random() < 0.4 else size for size in shape)
    spacing = rng.uniform(0.6, 1.6, n) if rng.random() < 0.5 else np.ones(n)
    turned = special_ortho_group.rvs(n, random_state=rng) if rng.random() < 0.3 else np.eye(n)
    grid = Grid(shape, spacing.tolist(), (rng.normal(size=n) * rng.choice([0, 20])).tolist(), turned)
    made = Deformation(grid, border=None if rng.random() < 0.5 else "auto")
    sizes = np.array(grid.sizes)
    middle = grid.positions((sizes - 1) / 2)
    for _ in range(int(rng.integers(1, 5))):
        kind = rng.integers(3) if maps else 0
        if kind == 0:
            at, by = rng.uniform(0, 1, n) * (sizes - 1), 2 * rng.normal(size=n)
            try:
                made = made.grab(at.tolist(), by=by.tolist(), radius=float(rng.uniform(2, 10) * spacing.min()))
            except SuppleError:
                continue  # what a border holds back entirely
        elif kind == 1:
            scale = float(np.exp(rng.uniform(-1.3, 1.3)))
            matrix = np.eye(n + 1)
            matrix[:n, :n] = scale * (special_ortho_group.rvs(n, random_state=rng) + 0.05 * rng.normal(size=(n, n)))
            matrix[:n, n] = middle - matrix[:n, :n] @ middle + rng.normal(size=n)
            made = made.affine(matrix, inverse=bool(rng.integers(2)))
        else:
            own = tuple(int(x) for x in rng.integers(4, 24 if n == 2 else 10, n))
            steps = spacing * sizes / np.array(own[::-1]) * rng.choice([1.0, 0.6, 1.5])
            corner = middle - turned @ (steps * (np.array(own[::-1]) - 1) / 2)
            field = drawn(
                rng,
                Grid(own, steps.tolist(), corner.tolist(), turned),
                float(rng.uniform(0.02, 0.4)),
                interpolation=str(rng.choice(["linear", "cubic", "bspline"])),
                beyond=beyond or str(rng.choice(["zero", "edge"])),
                dtype=str(rng.choice(["f4", "f8"])),
            )
            made = made.field(field, inverse=bool(rng.integers(2)))
    return made


def random_grid(rng: Rng, made: Deformation) -> Grid:
    """Return another grid about the deformation's: rotated, finer or coarser."""
    n = made.ndim
    shape = tuple(int(x) for x in rng.integers(3, 26 if n == 2 else 9, n))
    sizes = np.array(shape[::-1])
    steps = np.exp(rng.uniform(-0.7, 0.7)) * np.multiply(made.grid.sizes, made.grid.spacing) / sizes
    turned = special_ortho_group.rvs(n, random_state=rng)
    middle = made.grid.positions((np.array(made.grid.sizes) - 1) / 2)
    corner = middle - turned @ (steps * (sizes - 1) / 2) + 0.5 * rng.normal(size=n)
    return Grid(shape, steps.tolist(), corner.tolist(), turned)


def indices(shape: tuple[int, ...]) -> Floats:
    return np.stack(np.indices(shape)[::-1], -1).reshape(-1, len(shape)).astype(np.float64)


def picture(rng: Rng, shape: tuple[int, ...], dtype: str) -> npt.NDArray[Any]:
    noise = rng.normal(size=shape)
    if dtype == "?":
        return noise > 0
    if dtype[0] in "ui":
        limits = np.iinfo(dtype)
        return rng.integers(limits.min // 2, limits.max // 2, shape).astype(dtype)
    return noise.astype(dtype)


def same_in_parts(rng: Rng, made: Deformation, image: Any, grid: Grid, count: int, **options: Any) -> None:
    """Check that random parts of a grid are those of the whole, bit for bit."""
    whole = made.warp(image, grid=grid, **options)
    for _ in range(count):
        first = [int(rng.integers(0, size)) for size in grid.sizes]
        sizes = [int(rng.integers(1, size - a + 1)) for a, size in zip(first, grid.sizes, strict=True)]
        part = made.warp(image, grid=grid.crop(first, sizes), **options)
        box = tuple(slice(a, a + b) for a, b in zip(first[::-1], sizes[::-1], strict=True))
        assert part.shape == whole[box].shape
        assert part.tobytes() == np.ascontiguousarray(whole[box]).tobytes(), (first, sizes)


seeds = st.integers(0, 2**32 - 1)
axes = st.sampled_from([2, 2, 3])


@given(seed=seeds, n=axes, odd=st.booleans())
def test_points_go_there_and_back(seed: int, n: int, odd: bool) -> None:
    made, rng = random_deformation(seed, n, odd=odd), np.random.default_rng(seed)
    places = rng.uniform(-0.2, 1.2, (200, n)) * np.array(made.shape[::-1])
    found = made.inverse(places)
    assert found.residual.shape == found.converged.shape == (200,)
    off = np.abs(made.forward(found.points) - places).max(axis=1)
    assert (off[found.converged] <= 1e-5).all()


@given(seed=seeds, n=axes)
def test_fields_without_an_end_are_always_solved(seed: int, n: int) -> None:
    made, rng = random_deformation(seed, n, beyond="edge"), np.random.default_rng(seed)
    places = rng.uniform(-0.2, 1.2, (200, n)) * np.array(made.shape[::-1])
    found = made.inverse(places)
    assert found.converged.all()
    report = made.report()
    assert report.within
    assert report.unconverged == report.folds == 0


@given(seed=seeds, n=axes)
def test_jacobians_are_central_differences(seed: int, n: int) -> None:
    made, rng, h = random_deformation(seed, n), np.random.default_rng(seed), 1e-6
    places = rng.uniform(0, 1, (60, n)) * (np.array(made.shape[::-1]) - 1)
    ahead, behind = (
        np.stack([(made.forward(places + s * h * e) - made.forward(places)) / (s * h) for e in np.eye(n)], -1)
        for s in (1, -1)
    )
    smooth = np.abs(ahead - behind).max(axis=(1, 2)) < 1e-3  # no kink, and no end of a field, in between
    off = np.abs(made.jacobian(places) - (ahead + behind) / 2).max(axis=(1, 2))
    assert (off[smooth] <= 1e-3 * (1 + np.abs(ahead[smooth]).max(axis=(1, 2)))).all()


@given(seed=seeds, n=axes, tolerance=st.sampled_from([1e-3, 0.01, 0.1]), odd=st.booleans())
def test_maps_are_the_inverse_at_every_pixel(seed: int, n: int, tolerance: float, odd: bool) -> None:
    made = random_deformation(seed, n, odd=odd)
    found = made.inverse(indices(made.shape))
    off = np.linalg.norm(made.inverse_map(tolerance=tolerance).reshape(-1, n) - found.points, axis=1)
    assert (off <= tolerance + 1e-5 * (1 + np.abs(found.points).max()))[found.converged].all()
    report = made.report(tolerance=tolerance)
    assert report.unconverged or report.within


@given(seed=seeds, n=axes, tolerance=st.sampled_from([1e-3, 0.05]))
def test_other_grids_are_sampled_at_their_positions(seed: int, n: int, tolerance: float) -> None:
    made, rng = random_deformation(seed, n), np.random.default_rng(seed)
    image = ndimage.gaussian_filter(rng.normal(size=made.shape), 1.0)
    steep = sum(np.abs(np.diff(image, axis=k)).max(initial=0.0) for k in range(n))
    grid = random_grid(rng, made)
    found = made.inverse(made.grid.indices(grid.positions(indices(grid.shape))))
    wanted = ndimage.map_coordinates(image, found.points[:, ::-1].T, order=1, mode="nearest")
    options: Any = {"between": "linear"} if n == 3 else {}
    got = made.warp(image, filter="linear", grid=grid, tolerance=tolerance, **options)
    assert got.shape == grid.shape
    assert (np.abs(got.ravel() - wanted) <= 1e-4 + 2 * tolerance * steep)[found.converged].all()


@given(seed=seeds, n=axes, other=st.booleans(), maps=st.booleans())
def test_a_warp_by_the_inverse_samples_at_t(seed: int, n: int, other: bool, maps: bool) -> None:
    made, rng, tolerance = random_deformation(seed, n, maps=maps), np.random.default_rng(seed), 1e-3
    if any(isinstance(each.map, Field) for each in made.maps):  # which lead anywhere, and may be solved twice
        made = random_deformation(seed, n, maps=False)
    image = ndimage.gaussian_filter(rng.normal(size=made.shape), 1.0)
    steep = sum(np.abs(np.diff(image, axis=k)).max(initial=0.0) for k in range(n))
    grid = random_grid(rng, made) if other else made.grid
    got = made.warp(image, filter="linear", tolerance=tolerance, grid=grid if other else None, inverse=True)
    seen = made.forward(made.grid.indices(grid.positions(indices(grid.shape))))
    wanted = ndimage.map_coordinates(image, seen[:, ::-1].T, order=1, mode="nearest")
    assert (np.abs(got.ravel() - wanted) <= 1e-4 + 2 * tolerance * steep).all()


@given(seed=seeds)
def test_the_inverse_of_a_field_is_that_of_its_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = drawn(rng, Grid((14, 12, 10), 1.5), 0.3, interpolation="cubic", beyond="edge", dtype="f8")
    image = ndimage.gaussian_filter(rng.normal(size=(14, 12, 10)), 1.0)
    one, other = (Deformation(field.grid).field(field, inverse=push) for push in (False, True))
    kept = {"filter": "linear", "tolerance": 1e-3}
    np.testing.assert_allclose(one.warp(image, inverse=True, **kept), other.warp(image, **kept), atol=5e-3)


def test_what_is_warped_back_lies_where_it_was() -> None:
    d = Deformation((90, 120)).grab((40, 40), by=(14, 6), radius=25).twist((80, 50), angle=70, radius=20)
    y, x = np.mgrid[:90, :120]
    smooth = np.sin(x / 9) * np.cos(y / 11)
    there = d.warp(smooth, filter="cubic", tolerance=1e-3)
    back = d.warp(there, filter="cubic", tolerance=1e-3, inverse=True)
    assert np.abs(there - smooth).max() > 0.5
    assert np.abs(back - smooth)[3:-3, 3:-3].max() < 0.02
    far = np.random.default_rng(0).random((90, 120))
    short = Deformation((90, 120)).grab((20, 20), by=(2, 1), radius=4, reach=2)
    np.testing.assert_array_equal(short.warp(far, inverse=True)[40:], far[40:])  # every bit
    np.testing.assert_array_equal(Deformation((90, 120)).warp(far, inverse=True), far)
    with pytest.raises(SuppleError, match="straightening has no inverse here"):
        d.straighten(rotate=5).warp(far, inverse=True)


@examples(60)
@given(
    seed=seeds,
    n=axes,
    maps=st.booleans(),
    dtype=st.sampled_from(DTYPES),
    channels=st.integers(0, 5),
    filter_=st.sampled_from(["auto", "cubic", "linear", "nearest"]),
    outside=st.sampled_from(["edge", "constant", "reflect"]),
    other=st.booleans(),
    alpha=st.booleans(),
    clamp=st.booleans(),
    time_filter=st.booleans(),
)
def test_parts_of_grids_are_parts_of_the_whole(
    seed: int,
    n: int,
    maps: bool,
    dtype: str,
    channels: int,
    filter_: str,
    outside: str,
    other: bool,
    alpha: bool,
    clamp: bool,
    time_filter: bool,
) -> None:
    made, rng = random_deformation(seed, n, maps=maps), np.random.default_rng(seed)
    image = picture(rng, (*made.shape, channels) if channels else made.shape, dtype)
    options: dict[str, Any] = {"filter": filter_, "outside": outside, "clamp": clamp}
    if outside == "constant":
        options["fill"] = 1.0
    if alpha and channels > 1 and dtype != "?":
        options["alpha"] = True
    if n == 3 and filter_ != "nearest":
        options |= {"time_filter": time_filter, "between": str(rng.choice(["linear", "cubic"]))}
    grid = random_grid(rng, made) if other else made.grid
    same_in_parts(rng, made, image, grid, 3, **options)


def test_a_plane_that_hardly_moves_is_the_same_in_a_part() -> None:
    made = Deformation((17, 10, 14)).grab((4.8, 6.2, 4.8), by=(-3.7, -0.11, -5.27), radius=3.07)
    image = np.random.default_rng(0).normal(size=(17, 10, 14)).astype(np.float32)
    whole = made.warp(image, filter="linear")
    for z in range(17):
        part = made.warp(image, filter="linear", grid=made.grid.crop((0, 0, z), (14, 10, 1)))
        np.testing.assert_array_equal(part[0], whole[z])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["strokes", "affine", "linear", "cubic", "bspline"])
@pytest.mark.parametrize("inverse", [False, True])
def test_what_is_mirrored_does_not_fold(kind: str, inverse: bool) -> None:
    rng = np.random.default_rng(5)
    grid = Grid((60, 70))
    made = Deformation(grid, border=None).grab((30, 28), by=(5, 3), radius=12)
    if kind == "affine":
        made = made.affine([[-1, 0, 69], [0, 1, 0]])
    elif kind != "strokes":
        coarse = Grid((12, 13), 8.0, (-12, -12))
        made = made.field(drawn(rng, coarse, 0.2, interpolation=kind, beyond="edge"), inverse=inverse)
    image = rng.normal(size=grid.shape)
    mirrored = Grid((60, 70), 1.0, (69, 0), [[-1, 0], [0, 1]])
    out = made.warp(image, filter="linear", grid=mirrored, tolerance=1e-4)
    assert made.report().folds == 0
    np.testing.assert_allclose(out[:, ::-1], made.warp(image, filter="linear", tolerance=1e-4), atol=2e-3)


@pytest.mark.filterwarnings("ignore")
def test_a_point_does_not_depend_on_those_beside_it() -> None:
    rng = np.random.default_rng(8)
    field = drawn(rng, Grid((30, 31)), 2.5, width=1.0, beyond="edge")
    made = Deformation((30, 31), border=None).field(field, inverse=True)
    points = rng.uniform(0, 29, (4000, 2))
    order = rng.permutation(len(points))
    for through in (made.forward, lambda given: made.inverse(given).points):
        np.testing.assert_array_equal(through(points)[order], through(points[order]))


@pytest.mark.parametrize("scale", [0.04, 0.2, 5.0, 30.0])
@pytest.mark.parametrize("shape", [(150, 130), (9, 60, 50)])
def test_parts_of_maps_that_shrink_or_enlarge_much(shape: tuple[int, ...], scale: float) -> None:
    n, rng = len(shape), np.random.default_rng(7)
    middle = (np.array(shape[::-1]) - 1) / 2
    matrix = np.eye(n + 1)
    matrix[:n, :n] /= scale  # pull
    matrix[:n, n] = middle - middle / scale
    made = Deformation(shape, border=None).affine(matrix).grab((middle + 3).tolist(), by=[2.0] * n, radius=8)
    image = rng.integers(0, 255, (*shape, 3)).astype(np.uint8)
    same_in_parts(rng, made, image, made.grid, 8)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (1, 1, 1), (1, 1, 9), (1, 9, 1), (9, 1, 1), (2, 1, 33)])
@pytest.mark.parametrize("size", [0.1, 5.0, 1e6, 1e30])
def test_odd_sizes_and_far_points(shape: tuple[int, ...], size: float) -> None:
    n, rng = len(shape), np.random.default_rng(8)
    for interpolation in ("linear", "cubic"):
        for beyond in ("zero", "edge"):
            values = (size * rng.normal(size=(*shape, n))).astype(np.float32)
            field = Field.from_array(values, interpolation=interpolation, beyond=beyond)
            for inverse in (False, True):
                made = Deformation(shape, border=None).field(field, inverse=inverse)
                image = rng.normal(size=shape).astype(np.float32)
                for filter_ in ("auto", "linear", "nearest"):
                    assert np.isfinite(made.warp(image, filter=filter_)).all()
                far = made.warp(image, grid=Grid((4,) * n, 1e12, [-1e12] * n))
                assert far.shape == (4,) * n
                made.report()
                for at in (made.inverse, made.forward, made.jacobian):
                    for value in (1e18, -1e300):
                        at(np.full((5, n), value))
                    for value in (np.inf, np.nan):
                        with pytest.raises(SuppleError, match="finite"):
                            at(np.full((5, n), value))


def digest() -> str:
    """Return a digest of the results of some deformations, and of inverses of their fields."""
    made = hashlib.sha256()
    for seed in range(40):
        each, rng = random_deformation(seed, 2 + seed % 2), np.random.default_rng(seed)
        image = picture(rng, each.shape, DTYPES[seed % len(DTYPES)])
        made.update(each.warp(image).tobytes() + each.inverse_map().tobytes())
        for placed in each.maps:
            if isinstance(placed.map, Field):
                found = placed.map.invert()
                made.update(found.field.values.tobytes() + found.error.tobytes() + found.status.tobytes())
    return made.hexdigest()


@pytest.mark.filterwarnings("ignore")
def test_threads_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    found = set()
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("SUPPLE_THREADS", threads)
        found.add(digest())
    assert len(found) == 1


@pytest.mark.parametrize(("seed", "spacing"), [(1, 0.7), (2, 1.6), (3, 2.3)])
@pytest.mark.parametrize("n", [2, 3])
def test_parts_of_rough_maps_on_other_grids(seed: int, spacing: float, n: int) -> None:
    """What shrinks between nodes, what is rounded by the origin of a part, and what lies at the edge of a frame."""
    rng = np.random.default_rng(seed)
    shape = (170, 150) if n == 2 else (20, 60, 70)
    values = 2.0 * rng.normal(size=(*[-(-size // 8) + 3 for size in shape], n))
    made = Deformation(shape, border=None).grab([30.0] * (n - 1) + [9.0], by=[4.0] * n, radius=9, reach=20)
    made = made.field(Field(values, Grid(values.shape[:-1], 8.0, [-8.0] * n), "cubic", "edge"))
    image = rng.normal(size=shape).astype(np.float32)
    same_in_parts(rng, made, image, made.grid.resampled(spacing), 12, outside="reflect")


def test_a_part_of_a_part_knows_the_whole() -> None:
    grid = Grid((402, 496), 0.7, (-0.25, -0.35))
    part = grid.crop((486, 3), (10, 43)).crop((1, 2), (5, 6))
    assert part.first == (487, 5)
    assert part.uncropped() == grid
    assert part.uncropped().origin == grid.origin
    np.testing.assert_allclose(part.origin, grid.positions((487, 5)))


def test_far_from_the_origin_rounding_is_no_miss() -> None:
    d = Deformation((50, 60), border=None).grab((20, 20), by=(5, 2), radius=9, reach=None)
    d = d.affine([[0.9, 0.2, 3], [-0.2, 0.9, 9], [0, 0, 1]])
    found = d.inverse(np.random.default_rng(0).normal(size=(50, 2)) * 1e12)
    assert found.converged.all()
    assert found.residual.max() > 1e-7


def test_folds_take_no_memory() -> None:
    """Slopes at folds, and points that are not solved, lead anywhere: mirrored frames must not be held up to there."""
    rng = np.random.default_rng(12)
    values = 2.0 * rng.normal(size=(9, 15, 15, 3))
    made = Deformation((41, 99, 95), border=None)
    made = made.field(Field(values, Grid((9, 15, 15), 8.0, (-8, -8, -8)), "cubic", "edge"), inverse=True)
    extents = [plan_of(made.space, z, 0.01).extent() for z in range(41)]
    assert max(moved for _, _, moved, _ in extents) < 8000
    image = rng.integers(0, 100, (41, 99, 95, 3)).astype(np.int32)
    assert np.isfinite(made.warp(image, outside="reflect", between="cubic")).all()


@pytest.mark.parametrize("seed", [4, 5, 8])
def test_parts_of_what_shrinks_between_nodes(seed: int) -> None:
    """Averages are as deep as the steepest slopes need: those of the part must not be deeper, or less deep."""
    rng = np.random.default_rng(seed)
    values = 3.0 * rng.normal(size=(18, 22, 2))
    made = Deformation((120, 150), border=None)
    made = made.field(Field(values, Grid((18, 22), 8.0, (-8, -8)), "cubic", "edge"))
    image = rng.normal(size=(120, 150)).astype(np.float32)
    whole = made.warp(image)
    for y, x in np.ndindex(4, 5):
        sizes = min(32, 150 - 32 * x), min(32, 120 - 32 * y)
        part = made.warp(image, grid=made.grid.crop((32 * x, 32 * y), sizes))
        np.testing.assert_array_equal(part, whole[32 * y : 32 * y + sizes[1], 32 * x : 32 * x + sizes[0]])
