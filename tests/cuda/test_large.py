"""Arrays of the host on a GPU, in slabs, against the native engine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.cuda.device import CudaDevice
from supple.cuda.large import sample
from supple.engine.devices import workers
from supple.engine.sampling import Certificate, Sampling
from supple.engine.work import work_of
from supple.errors import SuppleError
from supple.media import volume as media
from supple.space.geometry import Geometry
from tests.cuda.driver import Driver

STACK = (24, 12, 14)
FRAME = 12 * 14 * 4


def bent(by: float = 1.6, shape: tuple[int, ...] = STACK) -> supple.Deformation:
    middle = (np.array(shape[::-1]) - 1) / 2
    return supple.Deformation(shape, border=None, on_fold="damp").grab(
        middle, by=[0.8, -0.6, by][: len(shape)], radius=9.0, reach=None
    )


def noise(shape: tuple[int, ...] = STACK, dtype: Any = np.float32) -> np.ndarray:
    return (200 * np.random.default_rng(0).random(shape)).astype(dtype)


def by_device(
    gpu: CudaDevice, d: supple.Deformation, source: np.ndarray, room: int | None = None, **options: Any
) -> tuple[np.ndarray, Certificate, list[int]]:
    sampling = Sampling(**{"filter": "linear", "tolerance": 1e-3, **options})
    work = work_of(source.shape, source.dtype, d.space, sampling)
    made, told = np.empty_like(source), []
    given, out = (a if a.ndim > len(d.shape) else a[..., None] for a in (source, made))
    if len(d.shape) == 2:
        given, out = given[None], out[None]
    certificate = sample(work, given, out, lambda step, done, total: told.append(done), room=room)
    return made, certificate, told


@pytest.mark.parametrize("room", [9 * FRAME, 14 * FRAME, None])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"outside": "reflect", "between": "nearest"},
        {"filter": "cubic", "between": "cubic", "outside": "constant", "fill": 30.0},
        {"time_filter": True, "outside": "reflect"},
    ],
    ids=str,
)
def test_slabs(gpu: CudaDevice, options: dict[str, Any], room: int | None) -> None:
    d, source = bent(), noise()
    made, certificate, told = by_device(gpu, d, source, room, **options)
    np.testing.assert_allclose(made, d.warp(source, **{"filter": "linear", "tolerance": 1e-3, **options}), atol=0.5)
    assert told == sorted(told)
    assert told[-1] == len(source)
    assert len(told) > 3
    assert 0 < certificate.error <= 1e-3


def test_two_slabs_are_under_way(gpu: CudaDevice, played: Driver) -> None:
    by_device(gpu, bent(), noise(), 14 * FRAME)
    launches = [k for k, (name, _) in enumerate(played.calls) if name == "cuLaunchKernel"]
    copies = [k for k, (name, a) in enumerate(played.calls) if name == "cuMemcpyDtoHAsync" and a[2] == FRAME]
    # The kernels of the second slab are launched before the first plane comes back.
    assert sum(k < copies[0] for k in launches) >= 8
    streams = {arguments[8] for name, arguments in played.calls if name == "cuLaunchKernel"}
    assert len(streams) == 2


@pytest.mark.parametrize("dtype", [">i2", "?", "f2", ">f8", "u1"])
def test_types(gpu: CudaDevice, dtype: str) -> None:
    source = noise(dtype=dtype) if dtype != "?" else noise() > 100
    made, _, _ = by_device(gpu, bent(), source, 14 * FRAME)
    wanted = bent().warp(source, filter="linear", tolerance=1e-3)
    assert made.dtype == source.dtype
    if dtype == "?":
        assert (made != wanted).mean() < 0.01
    else:
        assert np.abs(made.astype(float) - wanted.astype(float)).max() <= 1.0


def test_layouts(gpu: CudaDevice, tmp_path: Path) -> None:
    source = np.asfortranarray(noise((*STACK, 2), np.int16))[:, ::-1]
    d = bent()
    mapped = np.memmap(tmp_path / "out.raw", ">i2", "w+", 0, source.shape)
    made = d.warp(source, filter="linear", tolerance=1e-3, device="cuda")
    wanted = d.warp(source, filter="linear", tolerance=1e-3)
    assert np.abs(made.astype(int) - wanted).max() <= 1
    del mapped


def test_what_does_not_fit_is_refused(gpu: CudaDevice) -> None:
    with pytest.raises(SuppleError, match=r"GB for a plane do not fit into the memory of .*: device="):
        by_device(gpu, bent(), noise(), 2 * FRAME)


@pytest.mark.parametrize("error", [KeyboardInterrupt, BrokenPipeError])
def test_an_error_on_the_way_is_the_caller_s(gpu: CudaDevice, error: type[BaseException]) -> None:
    d, source = bent(), noise()
    work = work_of(source.shape, source.dtype, d.space, Sampling(filter="linear"))

    def tell(step: str, done: int, total: int) -> None:
        raise error

    with pytest.raises(error):  # nothing is left over: see the fixture
        sample(work, source[..., None], np.empty_like(source)[..., None], tell, room=14 * FRAME)


def test_deformations_send_arrays(gpu: CudaDevice) -> None:
    d, source = bent(), noise()
    with workers() as who:
        d.warp(source, filter="linear", device="cuda")
    assert who() == gpu.name
    image = noise((30, 40, 3), np.uint8)
    flat = bent(0.0, (30, 40))
    assert np.abs(flat.warp(image, device="cuda").astype(int) - flat.warp(image)).max() <= 3
    with pytest.raises(SuppleError, match="source must be of shape"):
        d.warp(source[1:], device="cuda")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_volumes_from_file_to_file(gpu: CudaDevice, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("SimpleITK")
    source = noise(dtype=np.int16)
    media.write("in.nrrd", source, media.Volume(source, Geometry()))
    common = ["--grab", "6,5,12:7,4,13", "--radius", "9", "--border", "none", "--filter", "linear", "--quiet"]
    assert command(["warp", "in.nrrd", "cpu.nrrd", *common]) == 0
    capfd.readouterr()
    assert command(["warp", "in.nrrd", "cuda.nrrd", *common, "--device", "cuda", "--json"]) == 0
    one, other = (np.asarray(media.read(f"{name}.nrrd").samples).astype(int) for name in ("cpu", "cuda"))
    assert np.abs(one - other).max() <= 4  # each is within 0.01 voxels
    told = json.loads(capfd.readouterr().out)
    assert told["device"] == gpu.name
    assert told["error"] <= 0.01
