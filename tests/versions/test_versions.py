"""Each dependency, by the calls of it that Supple makes: what `tools/versions.py` runs with the lowest and the newest.

A test here says that a version works at all; that the values are right is for the tests of each room.
"""

from __future__ import annotations

import contextlib
import locale
import threading
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.gpu.device import Gpu
from supple.media import image
from tests.viewer.windows import SIZE, opened, wait_for

DATA = Path(supple.__file__).parent / "examples" / "data"
GRAB = ("--grab", "30,20:33,20", "--radius", "6")
PICTURE = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)


@pytest.fixture(autouse=True)
def global_locale() -> None:
    """ITK's reader of VTK images leaves the process in the locale C, where Python opens files as ASCII."""
    locale.setlocale(locale.LC_CTYPE, "")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    image.write("in.png", PICTURE)
    return tmp_path


def warped(source: Path | str, target: str, *options: str) -> None:
    assert command(["warp", str(source), target, *(options or GRAB)]) == 0
    assert Path(target).exists()


def test_pillow_heif(folder: Path) -> None:
    heif = pytest.importorskip("pillow_heif")
    heif.from_bytes("RGB", (60, 40), PICTURE.tobytes()).save("in.heic")
    warped("in.heic", "out.png")


def test_psd_tools(folder: Path) -> None:
    psd = pytest.importorskip("psd_tools").PSDImage
    from PIL import Image

    psd.frompil(Image.fromarray(PICTURE)).save("in.psd")
    warped("in.psd", "out.png")


def test_rawpy(folder: Path) -> None:
    pytest.importorskip("rawpy")
    Path("in.dng").write_bytes(b"II*\0" + bytes(100))
    assert command(["warp", "in.dng", "out.png", *GRAB]) == 2  # that it develops one, tests/media/image shows


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp", ".avif"])
def test_pyvips(folder: Path, suffix: str) -> None:
    import pyvips

    from supple.viewer.panels.transforms import on_screen

    profile = bytes(pyvips.Operation.call("profile_load", "p3"))
    made = pyvips.Image.new_from_array(PICTURE).copy(interpretation="srgb", xres=4, yres=4)
    made.set_type(pyvips.GValue.blob_type, "icc-profile-data", profile)
    made.set_type(pyvips.GValue.gint_type, "orientation", 1 if suffix == ".avif" else 6)
    made.write_to_file(f"profile{suffix}")
    warped(f"profile{suffix}", f"out{suffix}")
    assert image.info(f"out{suffix}")["profile"]
    seen = on_screen(image.read(f"out{suffix}"))
    assert seen.shape == ((40, 60, 4) if suffix == ".avif" else (60, 40, 4))


def test_cyclopts_and_rich(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for line in (["--help"], ["warp", "--help"], ["--version"], ["info", "in.png"]):
        assert command(line) == 0
    assert "in.png" in capsys.readouterr().out
    assert command(["warp", "in.png", "--radios", "7"]) == 2
    assert "--radios" in capsys.readouterr().err


def test_wgpu_rendercanvas_imgui_and_platformdirs(gpu: Gpu, folder: Path) -> None:
    view, hand = opened(Path("in.png"))
    hand.drag((300, 300), (340, 300))
    assert len(view.recipe.strokes) == 1
    hand.key("?")
    assert view.pixels().ndim == 3
    view.commands.ask("save")
    view.canvas.draw()
    assert view.commands.asked is not None


def test_anywidget(gpu: Gpu, folder: Path) -> None:
    from rendercanvas.anywidget import JS, RenderCanvas

    canvas = RenderCanvas(size=SIZE)
    assert JS
    assert canvas._repr_mimebundle_() is not None


def test_glfw() -> None:
    import glfw

    for name in ("init", "set_window_should_close", "set_window_close_callback", "set_drop_callback"):
        assert callable(getattr(glfw, name))
    assert callable(glfw.set_clipboard_string)


def test_uvicorn_websockets_and_simplejpeg(gpu: Gpu, folder: Path) -> None:
    from rendercanvas.http import RenderCanvas, asgi
    from websockets.sync.client import connect

    from supple.viewer.window import server

    canvas = RenderCanvas(max_fps=30, update_mode="ondemand")
    ended = threading.Event()
    with contextlib.closing(server.listening(0)) as listener:
        port = listener.getsockname()[1]
        app = server.guarded(asgi, "token", "Supple")
        thread = threading.Thread(target=lambda: server.serve(app, listener, ended.is_set))
        thread.start()
        try:
            address = f"http://127.0.0.1:{port}/?token=token"
            opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
            with wait_for(lambda: _reached(opener, address), 20.0) as page:
                assert b"Supple" in page.read()
            cookie = "supple-token=token"
            origin: Any = f"http://127.0.0.1:{port}"
            with connect(f"ws://127.0.0.1:{port}/ws", additional_headers={"Cookie": cookie}, origin=origin) as page:
                assert page.protocol.state.name == "OPEN"
        finally:
            ended.set()
            thread.join(20)
        assert not thread.is_alive()
        canvas.close()


def _reached(opener: Any, address: str) -> Any:
    with contextlib.suppress(OSError):
        return opener.open(address, timeout=5)
    return None


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm", ".gif"])
def test_av(folder: Path, suffix: str) -> None:
    import av

    with av.open("in.mkv", "w") as out:
        film, sound = out.add_stream("libx264", rate=25), out.add_stream("aac", rate=48000, layout="mono")
        film.width, film.height, film.pix_fmt = 64, 48, "yuv420p"
        for k in range(6):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 40 * k, np.uint8), format="rgb24")
            out.mux(film.encode(frame))
        heard = av.AudioFrame.from_ndarray(np.zeros((1, 8192), np.float32), "fltp", "mono")
        heard.sample_rate = 48000
        out.mux(sound.encode(heard))
        out.mux(film.encode(None))
        out.mux(sound.encode(None))
    warped("in.mkv", f"out{suffix}")
    assert command(["warp", f"out{suffix}", "frames/%03d.png", *GRAB]) == 0
    assert command(["info", f"out{suffix}"]) == 0


@pytest.mark.parametrize("suffix", [".bmp", ".exr", ".hdr", ".jp2", ".ppm"])
def test_pictures_of_av(folder: Path, suffix: str) -> None:
    deep = suffix in (".exr", ".hdr")
    image.write(f"in{suffix}", PICTURE.astype(np.float32) / 255 if deep else PICTURE)
    warped(f"in{suffix}", f"out{suffix}")


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha", ".tif"])
def test_simpleitk_and_nibabel(folder: Path, suffix: str) -> None:
    volume = ("--grab", "30,40,30:33,40,30", "--radius", "12")
    warped(DATA / "head.nii.gz", f"out{suffix}", *volume)
    assert command(["info", f"out{suffix}"]) == 0


def test_pydicom(folder: Path) -> None:
    import SimpleITK as sitk  # noqa: N813

    Path("slices").mkdir()
    for k in range(5):
        made = sitk.GetImageFromArray(np.full((1, 20, 24), 100 * k, np.int16))
        for key, value in (("0020|0013", f"{k}"), ("0020|0032", f"0\\0\\{k}"), ("0020|0037", "1\\0\\0\\0\\1\\0"),
                           ("0020|000e", "1.2.3"), ("0020|000d", "1.2.4"), ("0008|0060", "CT")):  # fmt: skip
            made.SetMetaData(key, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(f"slices/{k}.dcm")
        writer.Execute(made)
    warped("slices", "out", "--grab", "12,10,2:13,10,2", "--radius", "4")
    assert len(list(Path("out").iterdir())) == 5


def test_fields_of_itk_and_openexr(folder: Path) -> None:
    field = supple.Field.from_array(np.full((40, 60, 2), 1.5, np.float32))
    field.write("map.exr")
    assert supple.Field.read("map.exr").ndim == 2
    warped("in.png", "out.png", "--field", "map.exr")
    solid = supple.Field.from_array(np.full((20, 30, 40, 3), 1.5, np.float32))
    for name, convention in (("map.mha", "itk"), ("map.h5", "itk"), ("map.nii.gz", "itk")):
        solid.write(name, convention=convention)
        assert supple.Field.read(name, convention=convention).ndim == 3


@pytest.mark.parametrize("name", ["out.zarr", "out.ome.zarr"])
def test_zarr_tifffile_and_imagecodecs(folder: Path, name: str) -> None:
    import tifffile

    samples = np.random.default_rng(0).integers(0, 9, (200, 300), np.uint16)
    tifffile.imwrite("in.ome.tif", samples, tile=(64, 64), compression="zlib")
    warped("in.ome.tif", name, "--grab", "150,100:160,100", "--radius", "20")
    assert command(["info", name]) == 0


def test_distributed(folder: Path) -> None:
    import zarr

    samples = np.random.default_rng(0).integers(0, 9, (200, 300), np.uint16)
    zarr.create_array("in.zarr", data=samples, chunks=(64, 64))
    warped("in.zarr", "workers.zarr", "--grab", "150,100:160,100", "--radius", "20", "--workers", "1")


def test_dask_arrays() -> None:
    import dask.array as da

    import supple.dask as lazy

    warp = supple.Deformation((64, 64)).grab((30, 30), by=(4, 0), radius=8)
    array = np.arange(64 * 64, dtype=np.float32).reshape(64, 64)
    made = lazy.warp(da.from_array(array, chunks=32), warp)
    np.testing.assert_array_equal(np.asarray(made.compute(scheduler="threads")), warp.warp(array))


def test_matplotlib(folder: Path) -> None:
    for what in ("grid", "residual", "stretch"):
        assert command(["plot", "in.png", f"{what}.png", "--what", what, *GRAB]) == 0


def test_opencv(folder: Path) -> None:
    assert command(["track", str(DATA / "bunny.mp4"), "out.csv", "--at", "345,58,4"]) == 0
    assert len(Path("out.csv").read_text().splitlines()) == 65
