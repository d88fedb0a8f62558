"""What ``cuda`` as a device says where it cannot be used, and where it does not do what is asked."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.cuda import device as devices
from supple.errors import SuppleError
from supple.examples.gallery import write_gallery
from supple.files.renders import RenderOptions
from supple.media import image
from supple.media import volume as media
from supple.render.scene import Scene
from supple.space.geometry import Geometry
from supple.strokes import Recipe
from tests.cuda.driver import Status

MISSING = "CUDA needs the package cuda-bindings, which is not installed"
GRAB = ("--grab", "4,4:5,4", "--radius", "3")
SOLID = ("--grab", "4,4,2:5,4,2", "--radius", "3")


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """NVIDIA's packages are not there."""
    real = importlib.import_module

    def missing(name: str, *rest: Any) -> Any:
        if name == "cuda.bindings.driver":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(devices.importlib, "import_module", missing)
    monkeypatch.setattr(devices, "_opened", {})
    devices.driver.cache_clear()
    yield
    devices.driver.cache_clear()


class Broken:
    """A driver of which some functions fail."""

    CUdevice_attribute = SimpleNamespace(
        CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR=0, CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR=1
    )

    CUmemPool_attribute = SimpleNamespace(CU_MEMPOOL_ATTR_RELEASE_THRESHOLD=4)
    cuuint64_t = int

    def __init__(self, **results: Any) -> None:
        self._results = {
            "cuInit": (Status(0),), "cuDriverGetVersion": (Status(0), 13000), "cuDeviceGetCount": (Status(0), 1),
            "cuDeviceGet": (Status(0), 0), "cuDeviceGetName": (Status(0), b"a GPU\0"),
            "cuDevicePrimaryCtxRetain": (Status(0), "context"), "cuCtxPushCurrent": (Status(0),),
            "cuCtxPopCurrent": (Status(0), None), "cuMemGetInfo": (Status(0), 1, 2),
            "cuDeviceGetDefaultMemPool": (Status(0), "pool"), "cuMemPoolGetAttribute": (Status(0), 0),
            "cuMemPoolSetAttribute": (Status(0),), "cuMemPoolTrimTo": (Status(0),),
        }  # fmt: skip
        self._results |= results

    def __getattr__(self, name: str) -> Any:
        if name == "cuDeviceGetAttribute":
            return lambda attribute, device: (Status(0), self._results.get("capability", (9, 0))[attribute])
        result = self._results[name]
        if isinstance(result, Exception):

            def fail(*given: Any) -> Any:
                raise result

            return fail
        return lambda *given: result


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pictures and a volume, and targets that are there already."""
    pytest.importorskip("SimpleITK")  # which writes the volume
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
    wanted = f'{MISSING}: pip install "supple[cuda]" for drivers from 580 on, or "supple[cuda12]" from 525 on'
    for ask in (
        devices.open_device,
        lambda: supple.Deformation((9, 9)).warp(np.zeros((9, 9)), device="cuda"),
        lambda: supple.warp_batch(np.zeros((2, 9, 9)), supple.Deformation((9, 9)), device="cuda"),
    ):
        with pytest.raises(SuppleError) as caught:
            ask()
        assert str(caught.value).removeprefix("item 0: ") == wanted


class Failed(int):
    """A status that is no success."""

    name = "CUDA_ERROR_UNKNOWN"


class NoDevice(Failed):
    name = "CUDA_ERROR_NO_DEVICE"


@pytest.mark.parametrize(
    ("results", "wanted"),
    [
        (
            {"cuInit": RuntimeError("Failed to dlopen libcuda.so.1")},
            "NVIDIA's driver, which is not installed; device='cpu'",
        ),
        ({"cuInit": (NoDevice(100),)}, "no NVIDIA GPU was found: the driver sees none; device='cpu'"),
        ({"cuInit": (Failed(999),)}, "driver does not work .cuInit: CUDA_ERROR_UNKNOWN.; device='cpu'"),
        ({"cuDeviceGetCount": (Status(0), 0)}, "no NVIDIA GPU was found"),
        (
            {"cuDriverGetVersion": (Status(0), 12040)},
            r"knows CUDA 12\.4, and what is installed needs 13: .*supple.cuda12",
        ),
        ({"capability": (7, 0)}, r"a GPU is too old: its compute capability is 7\.0, and 7\.5 is needed"),
        ({"cuMemGetInfo": (Failed(2), None, None)}, r"GPU 0 cannot be opened .cuMemGetInfo: .*; device='cpu'"),
    ],
)
def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, results: dict[str, Any], wanted: str) -> None:
    made = Broken(**results)
    monkeypatch.setattr(devices, "driver", lambda: made)
    monkeypatch.setattr(devices, "toolkit", lambda: 13)
    monkeypatch.setattr(devices, "_opened", {})
    with pytest.raises(SuppleError, match=wanted) as caught:
        devices.open_device()
    assert "\n" not in str(caught.value)


def test_a_number_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Broken()
    monkeypatch.setattr(devices, "driver", lambda: made)
    monkeypatch.setattr(devices, "_opened", {})
    assert devices.open_device().name == "a GPU"
    with pytest.raises(SuppleError, match="GPU 3 is not there: CUDA sees 1 of them"):
        devices.open_device(3)


def test_this_machine_has_a_card_or_says_why_not() -> None:
    said = "device='cpu'"
    try:
        assert devices.open_device().name
    except SuppleError as error:
        said = str(error)
    assert "device='cpu'" in said or "pip install" in said
    assert "\n" not in said


@pytest.mark.usefixtures("without", "folder")
def test_the_command_line_ends_before_any_work(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("files.pictures.read", "files.volumes.open_volume"):
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


@pytest.mark.usefixtures("folder")
def test_clips_and_views_are_refused_whoever_is_there(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("av")
    wanted = '--device must be "cpu" or "auto" for clips, found \'cuda\''
    assert refused(capfd, "warp", "clip.mp4", "out.mp4", *GRAB, "--device", "cuda") == wanted
    assert refused(capfd, "warp", "pictures/%d.png", "out/%d.png", *GRAB, "--device", "cuda") == wanted
    here = 'Invalid value "cuda" for --device. Choose from: "auto", "cpu"'
    assert refused(capfd, "render", "head.nrrd", "new.png", "--device", "cuda").startswith(here)
    assert refused(capfd, "demo", "gallery", "--device", "cuda").startswith(here)
    assert "Unknown option: --device" in refused(capfd, "view", "photo.png", "--device", "cuda")
    drawing = '"auto" or "cpu" or "gpu", found'
    for ask, known in (
        (lambda: RenderOptions(device="cuda"), drawing),
        (lambda: Scene(np.zeros((4, 4, 4)), device="cuda"), drawing),
        (lambda: write_gallery("gallery", device="cuda"), drawing),
        (lambda: supple.warp_file("clip.mp4", "out.mp4", Recipe(), device="cuda"), '"cpu" or "auto" for clips'),
    ):
        with pytest.raises(SuppleError, match=f"device must be {known}"):
            ask()
    assert not Path("gallery").exists()


@pytest.mark.usefixtures("folder")
def test_other_devices_import_nothing_of_it() -> None:
    code = (
        "import sys; from supple.cli import command\n"
        "for kind, name in (('grab', 'photo.png'), ('solid', 'head.nrrd')):\n"
        "    at = '4,4:5,4' if kind == 'grab' else '4,4,2:5,4,2'\n"
        "    for device in ('cpu', 'auto'):\n"
        "        asked = ['--grab', at, '--radius', '3', '--device', device]\n"
        "        assert command(['warp', name, device + name, *asked]) == 0\n"
        "sys.exit(any(m.split('.')[0] == 'cuda' for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
