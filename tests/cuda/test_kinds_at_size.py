"""A real GPU: arrays of each library as they come, on their streams and GPUs, and warps that nobody waits for."""

from __future__ import annotations

import time
import types
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import supple
import supple.cuda
from supple.cuda.arrays import CudaArray
from supple.cuda.device import CudaDevice, call
from tests.cuda.at_size import CLOSE, TIGHT, apart, bent, host, only_on_a_card, sized, waves
from tests.cuda.driver import OnDevice, sent

pytestmark = [
    only_on_a_card,
    pytest.mark.usefixtures("gpu"),
    pytest.mark.filterwarnings("ignore:The 'generic' unit for NumPy timedelta:DeprecationWarning"),  # of Numba's own
]

SHAPE, VOLUME = sized(480, 640), sized(48, 160, 192)
OPTIONS: dict[str, Any] = {"filter": "linear", "tolerance": TIGHT}


def torch_() -> Any:
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip(f"torch {torch.__version__} sees no GPU")
    return torch


def cupy_() -> Any:
    return pytest.importorskip("cupy")


def numba_() -> Any:
    pytest.importorskip("numba_cuda")
    from numba import cuda

    return cuda


PUT: dict[str, Callable[[np.ndarray], Any]] = {
    "supple": lambda array: sent(array),
    "numba": lambda array: numba_().to_device(array),
    "cupy": lambda array: cupy_().asarray(array),
    "torch": lambda array: torch_().as_tensor(array, device="cuda"),
}


@pytest.fixture(params=PUT)
def put(request: pytest.FixtureRequest, gpu: CudaDevice) -> Callable[[np.ndarray], Any]:
    """What sends an array to the GPU, as one library has it."""
    chosen = PUT[request.param]
    chosen(np.zeros(1, np.float32))  # leaves the test out where there is no such library
    return chosen


def test_they_come_back_as_they_came(put: Callable[[np.ndarray], Any]) -> None:
    d = bent(SHAPE, border=20.0)
    source = waves(SHAPE, 3)
    there = put(source)
    made = d.warp(there, **OPTIONS)
    kind = CudaArray if isinstance(there, OnDevice) else type(there)  # nobody knows how that one is made
    assert type(made) is kind
    assert host(made).dtype == source.dtype
    assert kind is CudaArray or getattr(made, "device", None) == getattr(there, "device", None)
    wanted = d.warp(source, **OPTIONS)
    assert apart(host(made), wanted, source).max() <= CLOSE
    out = put(np.zeros_like(source))
    assert d.warp(there, out=out, **OPTIONS) is out
    np.testing.assert_array_equal(host(out), host(made))
    assert type(d.inverse_map(like=there)) is kind
    points = put(np.random.default_rng(0).uniform(0, min(SHAPE), (1000, 2)))
    assert type(d.forward(points)) is type(d.inverse(points).points) is type(d.jacobian(points)) is kind
    batch = put(np.stack([source, source[::-1]]))
    assert type(supple.warp_batch(batch, d, **OPTIONS)) is kind


VIEWS = {"every other": np.s_[::2, 1::3], "a window": np.s_[1:-1, 2:-1], "turned around": np.s_[::-1, ::-2]}


@pytest.mark.parametrize("name", VIEWS)
def test_views(put: Callable[[np.ndarray], Any], name: str) -> None:
    whole = waves(SHAPE)
    there = put(whole)
    if name == "turned around" and hasattr(there, "is_cuda"):
        pytest.skip("torch has no negative strides")
    source = np.ascontiguousarray(whole[VIEWS[name]])
    d = bent(source.shape)
    wanted = d.warp(source, **OPTIONS)
    assert apart(host(d.warp(there[VIEWS[name]], **OPTIONS)), wanted, source).max() <= CLOSE
    out = put(np.full_like(whole, -7))
    d.warp(put(source), out=out[VIEWS[name]], **OPTIONS)
    left = host(out).copy()
    assert apart(left[VIEWS[name]].copy(), wanted, source).max() <= CLOSE
    left[VIEWS[name]] = -7
    np.testing.assert_array_equal(left, -7)


@pytest.mark.parametrize("kind", ["cupy", "torch"])
def test_channels_first(kind: str) -> None:
    source = np.stack([waves(SHAPE, 3), waves(SHAPE, 3)[::-1]])
    ds = [bent(SHAPE, 1), bent(SHAPE, 2)]
    there = PUT[kind](np.ascontiguousarray(source.transpose(0, 3, 1, 2)))
    turned = there.permute(0, 2, 3, 1) if kind == "torch" else there.transpose(0, 2, 3, 1)
    made = supple.warp_batch(turned, ds, **OPTIONS)
    assert apart(host(made), supple.warp_batch(source, ds, **OPTIONS), source).max() <= CLOSE


def test_arrays_of_libraries_that_nobody_knows() -> None:
    source = waves(SHAPE)
    d = bent(SHAPE)
    wanted = d.warp(source, **OPTIONS)
    assert apart(host(d.warp(sent(source), **OPTIONS)), wanted, source).max() <= CLOSE
    tensor = torch_().as_tensor(source, device="cuda")
    packed = types.SimpleNamespace(__dlpack__=tensor.__dlpack__, __dlpack_device__=tensor.__dlpack_device__)
    assert apart(host(d.warp(packed, **OPTIONS)), wanted, source).max() <= CLOSE


def test_the_stream_of_the_moment_is_the_one() -> None:
    torch = torch_()
    source = waves(VOLUME)
    d = bent(VOLUME)
    wanted = d.warp(source, **OPTIONS)
    pinned = torch.as_tensor(source).pin_memory()
    stream = torch.cuda.Stream()
    large = torch.rand(4096, 4096, device="cuda") / 4096
    torch.cuda.synchronize()
    with torch.cuda.stream(stream):
        for _ in range(20):  # a while, before the source is there
            large = large @ large
        there = pinned.to("cuda", non_blocking=True)
        made = d.warp(there, **OPTIONS)
        doubled = made * 2
    stream.synchronize()
    assert apart(host(made), wanted, source).max() <= CLOSE
    np.testing.assert_array_equal(host(doubled), 2 * host(made))


def test_the_second_card_keeps_what_is_its_own() -> None:
    if int(call("cuDeviceGetCount")) < 2:
        pytest.skip("there is one GPU")
    torch = torch_()
    source = waves(SHAPE)
    d = bent(SHAPE)
    made = [d.warp(torch.as_tensor(source, device=f"cuda:{k}"), **OPTIONS) for k in (1, 0, 1)]
    assert [x.device.index for x in made] == [1, 0, 1]
    for x in made:
        assert apart(host(x), d.warp(source, **OPTIONS), source).max() <= CLOSE
    with pytest.raises(supple.SuppleError, match="out must be an array on the source's GPU"):
        d.warp(torch.as_tensor(source, device="cuda:1"), out=made[1], **OPTIONS)


def test_warps_that_go_on_beside_each_other(put: Callable[[np.ndarray], Any]) -> None:
    sources = [np.ascontiguousarray(np.roll(waves(VOLUME), 9 * k, axis=2)) for k in range(4)]
    ds = [bent(VOLUME, k) for k in range(4)]
    there = [put(source) for source in sources]
    under_way = [
        supple.cuda.start(x, d, slab=1 + 3 * k, **OPTIONS) for k, (x, d) in enumerate(zip(there, ds, strict=True))
    ]
    until = time.monotonic() + 600
    while not all(warping.done() for warping in under_way):
        assert time.monotonic() < until
    for warping, x, d, source in zip(under_way, there, ds, sources, strict=True):
        made = warping.wait()
        assert made is warping.array
        assert warping.done()
        assert warping.error <= TIGHT + 3e-4
        np.testing.assert_array_equal(host(made), host(d.warp(x, **OPTIONS)))
        assert apart(host(made), d.warp(source, **OPTIONS), source).max() <= CLOSE


def test_a_stream_waits_in_place_of_the_host() -> None:
    torch = torch_()
    d = bent(VOLUME)
    there = torch.as_tensor(waves(VOLUME), device="cuda")
    warping = supple.cuda.start(there, d, slab=4, **OPTIONS)
    warping.join()
    doubled = warping.array * 2  # on torch's stream, which waits
    np.testing.assert_array_equal(host(doubled), 2 * host(d.warp(there, **OPTIONS)))
    warping.wait()


def test_memory_that_is_let_go_is_not_taken_too_soon() -> None:
    torch = torch_()
    d = bent(VOLUME)
    source = torch.as_tensor(waves(VOLUME), device="cuda")
    wanted = host(d.warp(source, **OPTIONS))
    for _ in range(20):
        warping = supple.cuda.start(source.clone(), d, slab=2, **OPTIONS)
        for _ in range(4):  # takes what the clone, or a scratch array, may have left
            torch.full_like(source, 1e9)
        np.testing.assert_array_equal(host(warping.wait()), wanted)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("filter", ["linear", "cubic"])
@pytest.mark.parametrize("shape", [sized(96, 128), sized(12, 40, 48)])
def test_gradients_are_those_of_the_cpu(shape: tuple[int, ...], filter: str, dtype: str) -> None:
    torch = torch_()
    import supple.torch

    d = bent(shape, 3, border=12.0)
    kind = getattr(torch, dtype)
    weights = waves(shape[::-1]).T
    results = []
    for device in ("cpu", "cuda"):
        picture = torch.as_tensor(waves(shape), dtype=kind, device=device)[None].requires_grad_()
        given = {
            name: torch.tensor([getattr(s, name) for s in d.strokes], dtype=kind, device=device, requires_grad=True)
            for name in ("at", "by", "radius")
        }
        made = supple.torch.warp(picture, d, filter=filter, tolerance=TIGHT, **given)
        assert (made.device.type, made.dtype) == (device, kind)
        (made[0] * torch.as_tensor(weights.copy(), dtype=kind, device=device)).sum().backward()
        leaves = {"made": made, "picture": picture.grad, **{name: x.grad for name, x in given.items()}}
        assert all(x.device.type == device for x in leaves.values())
        results.append({name: host(x) for name, x in leaves.items()})
    for name, wanted in results[0].items():
        # Where linear interpolation has a kink, points that differ in their last place have other slopes.
        off = np.abs(results[1][name] - wanted) / max(float(np.abs(wanted).max()), 1e-9)
        assert off.max() < (1e-6 if dtype == "float64" else 5e-3), name
