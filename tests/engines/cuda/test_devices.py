"""What ``cuda`` as a device says where it cannot be used, and where it does not do what is asked."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.engines.base import Layout, Sampling, Work
from supple.engines.cuda import device as devices
from supple.engines.cuda.engine import Cuda
from supple.errors import SuppleError
from supple.examples.gallery import write_gallery
from supple.files.clips import warp_clip
from supple.files.renders import RenderOptions
from supple.files.volumes import warp_volume
from supple.geometry import Geometry
from supple.media import image
from supple.media import volume as media
from supple.render.scene import Scene
from supple.strokes import Recipe, Stroke

MISSING = "CUDA needs the package numba-cuda, which is not installed"
GRAB = ("--grab", "4,4:5,4", "--radius", "3")
SOLID = ("--grab", "4,4,2:5,4,2", "--radius", "3")


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba's package for CUDA is not there."""
    find = devices.importlib.util.find_spec
    monkeypatch.setattr(
        devices.importlib.util, "find_spec", lambda name, *rest: None if name == "numba_cuda" else find(name, *rest)
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pictures and a volume, and targets that are there already."""
    monkeypatch.chdir(tmp_path)
    Path("pictures").mkdir()
    for name in ("photo.png", "pictures/a.png", "pictures/b.png"):
        image.write(name, np.zeros((9, 9), np.uint8))
    samples = np.zeros((5, 9, 9), np.int16)
    media.write("head.nrrd", samples, media.Volume(samples, Geometry()))
    for name in ("there.png", "there.nrrd"):
        Path(name).write_text("as it was", encoding="utf-8")
    return tmp_path


def refused(capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that a command line ends with."""
    before = sorted(Path().rglob("*"))
    assert command(arguments) == 2
    said = capfd.readouterr()
    assert said.out == ""
    assert said.err.startswith("supple: ")
    assert said.err.count("\n") == 1
    assert sorted(Path().rglob("*")) == before
    return said.err.removeprefix("supple: ").rstrip()


def test_it_says_what_to_install(without: None) -> None:
    wanted = f'{MISSING}: pip install "supple[cuda12]" or "supple[cuda13]", for drivers from 525 or 580 on'
    for ask in (
        devices.open_device,
        lambda: supple.Deformation((9, 9)).warp(np.zeros((9, 9)), device="cuda"),
        lambda: supple.warp_batch(np.zeros((2, 9, 9)), supple.Deformation((9, 9)), device="cuda"),
    ):
        with pytest.raises(SuppleError) as caught:
            ask()
        assert str(caught.value).removeprefix("item 0: ") == wanted


@pytest.mark.parametrize(
    ("said", "wanted"),
    [
        ("Error at driver init: \nCUDA driver library cannot be found.", "which is not installed; device cpu"),
        ("Call to cuInit results in CUDA_ERROR_NO_DEVICE", "no NVIDIA GPU was found: the driver sees none"),
        ("Call to cuInit results in\nCUDA_ERROR_UNKNOWN", "driver does not work .*results in CUDA_ERROR_UNKNOWN"),
    ],
)
def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, said: str, wanted: str) -> None:
    pytest.importorskip("numba_cuda")
    from numba.cuda.cudadrv import driver, error

    class Driver:
        def get_version(self) -> tuple[int, int]:
            raise error.CudaSupportError(said)

    monkeypatch.setattr(driver, "driver", Driver())
    devices._opened.cache_clear()
    with pytest.raises(SuppleError, match=wanted) as caught:
        devices.open_device()
    assert "\n" not in str(caught.value)


def test_a_driver_of_yesterday_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba_cuda")
    from numba.cuda.cudadrv import driver

    class Driver:
        def get_version(self) -> tuple[int, int]:
            return 12, 4

    monkeypatch.setattr(driver, "driver", Driver())
    monkeypatch.setattr(devices, "toolkit", lambda: 13)
    devices._opened.cache_clear()
    with pytest.raises(SuppleError, match=r"knows CUDA 12\.4, and what is installed needs 13.*supple\[cuda12\]"):
        devices.open_device()


def test_this_machine_has_a_card_or_says_why_not() -> None:
    pytest.importorskip("numba_cuda")
    devices._opened.cache_clear()
    said = "device cpu"
    try:
        assert devices.open_device().name
    except SuppleError as error:
        said = str(error)
    assert "device cpu" in said or "pip install" in said
    assert "\n" not in said


@pytest.mark.usefixtures("without", "folder")
def test_the_command_line_ends_before_any_work(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("files.read", "files.volumes.open_volume"):
        monkeypatch.setattr(f"supple.{module}", lambda *rest, **options: pytest.fail("it was read"))
    for source, target, strokes in (
        ("photo.png", "new.png", GRAB),
        ("photo.png", "there.png", (*GRAB, "--force")),
        ("head.nrrd", "new.nrrd", SOLID),
        ("head.nrrd", "there.nrrd", (*SOLID, "--force", "--save-field", "field.nrrd")),
        ("pictures", "bent", (*GRAB, "--save-recipe", "strokes.json")),
    ):
        assert refused(capfd, "warp", source, target, *strokes, "--device", "cuda").startswith(MISSING)
    for name in ("there.png", "there.nrrd"):
        assert Path(name).read_text(encoding="utf-8") == "as it was"


@pytest.mark.usefixtures("without", "folder")
def test_files_are_not_read_for_a_card_that_is_not_there() -> None:
    flat, solid = (Recipe(strokes=(Stroke.grab((4, 4, 2)[:n], by=(1, 0, 0)[:n], radius=3),)) for n in (2, 3))
    for source, target, recipe in (("photo.png", "new.png", flat), ("head.nrrd", "new.nrrd", solid)):
        with pytest.raises(SuppleError, match=MISSING):
            supple.warp_file(source, target, recipe, device="cuda")
        assert not Path(target).exists()
    with pytest.raises(SuppleError, match=MISSING):
        warp_volume("head.nrrd", "new.nrrd", solid, device="cuda")
    assert not Path("new.nrrd").exists()


@pytest.mark.usefixtures("folder")
def test_clips_and_views_are_refused_whoever_is_there(capfd: pytest.CaptureFixture[str]) -> None:
    wanted = '--device must be "cpu", "gpu" or "auto" for clips, found \'cuda\''
    assert refused(capfd, "warp", "clip.mp4", "out.mp4", *GRAB, "--device", "cuda") == wanted
    assert refused(capfd, "warp", "pictures/%d.png", "out/%d.png", *GRAB, "--device", "cuda") == wanted
    here = "--device cuda is for warp, of pictures and volumes: here it is cpu, gpu or auto"
    assert refused(capfd, "render", "head.nrrd", "new.png", "--device", "cuda").startswith(here)
    assert refused(capfd, "demo", "gallery", "--device", "cuda").startswith(here)
    assert "Unknown option: --device" in refused(capfd, "view", "photo.png", "--device", "cuda")
    for ask, what in (
        (lambda: RenderOptions(device="cuda"), "a volume that is seen"),
        (lambda: Scene(np.zeros((4, 4, 4)), device="cuda"), "a volume that is seen"),
        (lambda: write_gallery("gallery", device="cuda"), "the gallery"),
        (lambda: warp_clip("clip.mp4", "out.mp4", Recipe(), device="cuda"), "clips"),
    ):
        with pytest.raises(SuppleError, match=f'device must be "cpu", "gpu" or "auto" for {what}'):
            ask()
    assert not Path("gallery").exists()


def test_a_function_of_points_is_the_cpu_s() -> None:
    with pytest.raises(SuppleError, match='device must be "cpu" for a function of points'):
        supple.Deformation((9, 9)).warp(lambda points: points[:, 0], device="cuda")


@pytest.mark.usefixtures("folder")
def test_other_devices_import_nothing_of_it() -> None:
    code = (
        "import sys; from supple.cli import command\n"
        "for kind, name in (('grab', 'photo.png'), ('solid', 'head.nrrd')):\n"
        "    at = '4,4:5,4' if kind == 'grab' else '4,4,2:5,4,2'\n"
        "    for device in ('cpu', 'auto'):\n"
        "        asked = ['--grab', at, '--radius', '3', '--device', device]\n"
        "        assert command(['warp', name, device + name, *asked]) == 0\n"
        "sys.exit(any(m.split('.')[0] in ('numba_cuda', 'cuda') or m.startswith('numba.cuda') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_maps_are_refused_before_anything_starts() -> None:
    pytest.importorskip("numba_cuda")
    from supple.engines.cuda import job, points

    d = supple.Deformation((9, 9)).affine([[1, 0, 1], [0, 1, 0]])
    layout = Layout.of_array((9, 9), np.dtype(np.float32), (9, 9), alpha=None, light=False)
    given: Any = None
    for call in (
        lambda: job.Job(Work(d.space, layout, Sampling()), given, given),
        lambda: points.inverse_map(d.space, given, 0.01),
        lambda: points._known(d.space, given),
    ):
        with pytest.raises(SuppleError, match="fields, affine maps, output grids and freeze masks are for the CPU"):
            call()


def test_maps_other_than_strokes_are_refused() -> None:
    plain = supple.Deformation((9, 9))
    moved = plain.affine([[1, 0, 1], [0, 1, 0]])
    layout = Layout.of_array((9, 9), np.dtype(np.uint8), (9, 9), alpha=None, light=False)
    engine = Cuda(None)  # type: ignore[arg-type]
    engine.check(Work(plain.space, layout, Sampling()))
    for work in (
        Work(moved.space, layout, Sampling()),
        Work(plain.space, layout, Sampling(), (plain.space, moved.space)),
        Work(plain.space_on(plain.grid.crop((1, 1), (3, 3))), layout, Sampling()),
    ):
        with pytest.raises(SuppleError, match="fields, affine maps, output grids and freeze masks are for the CPU"):
            engine.check(work)
