"""A real GPU against the CPU, at size: every kind of array, every type, every filter (``make test-cuda``)."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np
import pytest

import supple
from supple.cuda.device import CudaDevice
from supple.errors import ToleranceWarning
from tests.cuda.at_size import (
    CLOSE,
    apart,
    bent,
    both,
    host,
    labels,
    near_a_boundary,
    only_on_a_card,
    sized,
    typed,
    waves,
)
from tests.cuda.driver import REAL, sent
from tests.effort import pairs

pytestmark = pytest.mark.usefixtures("gpu")

TYPES = ["f2", "f4", "f8", "u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "?"]
FILTERS = ["linear", "cubic", "nearest"]
OUTSIDE = ["edge", "constant", "reflect"]

# How many in a batch, or 0; their shape; channels.
ROOMS: dict[str, tuple[int, tuple[int, ...], int]] = {
    "picture": (0, sized(1080, 1920), 3),
    "volume": (0, sized(128, 160, 192), 0),
    "frames": (0, sized(40, 270, 480), 3),
    "pictures": (8, sized(256, 320), 3),
    "volumes": (3, sized(64, 80, 96), 0),
}

# Every type is compared with the oracle, too (test_parity.py); on a card, where each is a moment, all of them meet all
# filters here as well.
CASES = pairs(list(ROOMS), TYPES if REAL else ["f4", "u2", "?"], FILTERS, OUTSIDE)
if REAL:
    CASES += [
        (room, dtype, name, OUTSIDE[(i // 3 + j) % 3])
        for room in ("picture", "volume")
        for (i, dtype), (j, name) in itertools.product(enumerate(TYPES), enumerate(FILTERS))
    ]


def maps(count: int, shape: tuple[int, ...]) -> Any:
    """One deformation; or for a batch, one for each item."""
    if not count:
        return bent(shape, 1)
    return [bent(shape, k, count=1 + k % 3) for k in range(count)]


@pytest.mark.parametrize(("room", "dtype", "filter", "outside"), CASES)
def test_it_makes_what_the_cpu_makes(room: str, dtype: str, filter: str, outside: str) -> None:
    count, shape, channels = ROOMS[room]
    whole, d = (count, *shape) if count else shape, maps(count, shape)
    options: dict[str, Any] = {"filter": filter, "outside": outside, "fill": 1}
    if filter == "nearest":
        source = labels(whole, channels, dtype)
        made, wanted = both(sent(source), source, d, **options)
        near = np.stack([near_a_boundary(x) for x in d]) if count else near_a_boundary(d)
        assert near.mean() < 0.02
        differ = (made != wanted).any(axis=-1) if channels else made != wanted
        assert not (differ & ~near).any()
        return
    source = typed(waves(whole, channels), dtype)
    made, wanted = both(sent(source), source, d, **options)
    if source.dtype == np.bool_:  # but where it is as much the one as the other
        between = both_as_floats(source, d, options)
        assert (np.abs(between - 0.5)[made != wanted] < 2 * CLOSE).all()
    else:
        assert apart(made, wanted, source).max() <= CLOSE


def both_as_floats(source: np.ndarray, d: Any, options: dict[str, Any]) -> np.ndarray:
    values = source.astype(np.float32)
    return both(values, values, d, **options)[1]


@pytest.mark.parametrize("dtype", ["f4", "u1"])
@pytest.mark.parametrize("room", ["picture", "volume", "frames"])
def test_averages(room: str, dtype: str) -> None:
    _, shape, channels = ROOMS[room]
    source = typed(waves(shape, channels), dtype)
    made, wanted = both(sent(source), source, bent(shape, 1), time_filter=room == "frames")
    # How far a pixel reaches in time is known at nodes, and interpolated linearly between them.
    assert apart(made, wanted, source).max() <= (2 * CLOSE if room == "frames" else CLOSE)


@only_on_a_card  # a small zone plate has too few rings
def test_averages_are_near_those_of_many_samples() -> None:
    # A zone plate, squeezed: what lies between pixels would alias.
    n = sized(512)[0]

    def drawn(points: np.ndarray) -> np.ndarray:
        x, y = points[:, 0] - n / 2, points[:, 1] - n / 2
        return np.asarray(0.5 + 0.5 * np.cos((x**2 + y**2) * (np.pi / (2.5 * n))))

    d = supple.Deformation((n, n), border=n / 12, on_fold="flow").grab(
        (n / 2, 0.3 * n), by=(0, 0.36 * n), radius=n / 4.8, reach=None
    )
    within = (np.arange(8 * n) + 0.5) / 8 - 0.5
    fine = d.inverse(np.stack(np.meshgrid(within, within), -1).reshape(-1, 2)).points
    truth = drawn(fine).reshape(n, 8, n, 8).mean(axis=(1, 3))
    grid = np.stack(np.meshgrid(np.arange(n), np.arange(n))[:2], -1).reshape(-1, 2)
    plate = drawn(grid).reshape(n, n).astype(np.float32)

    def quality(made: np.ndarray) -> float:
        return float(-10 * np.log10(np.mean((made - truth) ** 2)))

    there = sent(plate)
    ours, plain = (quality(host(d.warp(there, filter=name))) for name in ("auto", "linear"))
    assert ours > plain + 3
    assert ours > quality(d.warp(plate)) - 1


@pytest.mark.parametrize("border", [None, 20.0])
@pytest.mark.parametrize("room", ["picture", "volume"])
@pytest.mark.parametrize("tolerance", [0.01, 1e-3])
def test_the_map_is_as_exact_as_asked(room: str, border: float | None, tolerance: float) -> None:
    shape = ROOMS[room][1]
    d = bent(shape, 3, border=border, spacing=1.0 if len(shape) == 2 else (1.0, 0.8, 1.7))
    points = host(d.inverse_map(like=sent(np.zeros(1, np.float32)), tolerance=tolerance))
    assert points.shape == (*shape, len(shape))
    rng = np.random.default_rng(0)
    index = tuple(rng.integers(0, n, 50_000) for n in shape)
    at, found = np.stack(index[::-1], -1).astype(np.float64), points[index].astype(np.float64)
    coarse = 2.0**-23 * max(shape)  # how finely float32 holds them
    assert np.linalg.norm(found - d.inverse(at).points, axis=-1).max() <= tolerance + 3e-4 + coarse
    grown = np.linalg.norm(d.jacobian(found), ord=2, axis=(-2, -1))
    residual = np.linalg.norm(d.forward(found) - at, axis=-1)
    assert (residual <= 1.5 * grown * (tolerance + 3e-4 + coarse)).all()


def test_more_samples_than_32_bits_count(gpu: CudaDevice) -> None:
    shape = sized(1300, 1300, 1300)
    if gpu.free < 3 * np.prod(shape):
        pytest.skip(f"{gpu.name} has {gpu.free / 1e9:.1f} GB left, {3 * np.prod(shape) / 1e9:.1f} are needed")
    n = shape[0]
    # A ramp along z, x and y, which linear interpolation does not bend.
    ramp = np.linspace(0, 80, n, dtype=np.float32)
    source = np.empty(shape, np.uint8)
    for z in range(n):
        source[z] = ramp[z] + ramp[None, :] + ramp[:, None]
    d = supple.Deformation(shape, border=None, on_fold="damp").grab(
        (n / 2, n / 2, 0.9 * n), by=(n / 20, n / 30, -n / 25), radius=n / 5, reach=None
    )
    made = host(d.warp(sent(source), filter="linear"))
    index = tuple(np.random.default_rng(2).integers(0, n, 20_000) for _ in shape)
    index = tuple(np.append(i, [0, n - 1]) for i in index)
    points = np.clip(d.inverse(np.stack(index[::-1], -1).astype(np.float64)).points, 0, n - 1)
    wanted = 80 * points.sum(axis=-1) / (n - 1)
    assert np.abs(made[index] - wanted).max() < 2


@pytest.mark.parametrize("filter", ["linear", "nearest", "auto"])
def test_arrays_of_the_host_through_a_card(gpu: CudaDevice, filter: str) -> None:
    shape = ROOMS["volume"][1]
    d = bent(shape, 5)
    source = waves(shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)
        options: dict[str, Any] = {"filter": filter, "tolerance": 1e-4}
        made = d.warp(source, device="cuda", **options)
        off = apart(made, d.warp(source, **options), source)
    if filter == "nearest":
        assert not (off[~near_a_boundary(d)] > 0).any()
    else:
        assert np.quantile(off, 0.999 if filter == "auto" else 1.0) <= CLOSE
