"""The window: `make bench-window`, or `python benchmarks/window.py`.

A 1080p photograph with 20 strokes, and one more that is dragged, on a canvas without a screen: what the main thread
takes from a pointer's move to the frame that shows it, in its own time (not that in which it waits), and how many
frames a second there are. Where the device is a program on the same processor, it takes the caches with it: so the same
is measured once more with all that is recorded for the device, but not handed to it. Then a drag on the rendering of a
head of 256³ voxels, and what comes after it; and what a start takes beside that of an empty window of the same
libraries.
"""

from __future__ import annotations

import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from measure import seconds
from rendercanvas.offscreen import RenderCanvas
from video import enlarged
from wgpu.backends.wgpu_native import _api, _ffi, _helpers

import supple
from supple.engine import core
from supple.gpu.device import open_gpu
from supple.media import image
from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.view import BAR, LINE, WIDE
from supple.viewer.tools.planes import RENDERED
from supple.viewer.window.launch import opened

DATA = Path(supple.__file__).parent / "examples" / "data"
_EMPTY = """
import time
from imgui_bundle import imgui
from rendercanvas.offscreen import RenderCanvas
from wgpu.utils.imgui import ImguiRenderer
import wgpu
canvas = RenderCanvas(size=(1280, 800))
adapter = wgpu.gpu.request_adapter_sync()
gui = ImguiRenderer(adapter.request_device_sync(), canvas)
gui.set_gui(lambda: imgui.text("empty"))
canvas.request_draw(gui.render)
canvas.draw()
print(time.time())
"""
_OURS = """
import sys, time
from types import SimpleNamespace
import supple.cli
from rendercanvas.offscreen import RenderCanvas
from supple.viewer.window.launch import opened
canvas = RenderCanvas(size=(1280, 800))
view = opened(sys.argv[1], None, canvas, SimpleNamespace(call_later=lambda seconds, work: None))
canvas.draw()
print(time.time())
view.close()
"""
_LOOP = SimpleNamespace(call_later=lambda seconds, work: None)  # frames are drawn from here: nothing comes later


def twenty(source: Any, scale: float = 1.0, frozen: bool = False) -> list[Stroke]:
    """Return 20 strokes and, among them, a freeze beside the drag."""
    strokes = [
        Stroke.grab((scale * (150 + 80 * k), scale * (300 + 20 * k)), by=(15 * scale, 28 * scale), radius=120 * scale)
        for k in range(20)
    ]
    if frozen:
        y, x = np.ogrid[: source.shape[0], : source.shape[1]]
        mask = np.hypot((x / scale - 480) / 220, (y / scale - 560) / 160) < 1
        strokes.insert(10, Stroke.freeze(Freeze.of(mask), ndim=2))
    return strokes


def shown(source: Any, *strokes: Stroke, size: tuple[int, int] = (1280, 800)) -> tuple[Any, Any]:
    """Return a view of a source with strokes, and its canvas, whose pictures are not read back, as on a screen."""
    canvas = RenderCanvas(size=size)
    view = opened(source, Recipe(border=None, strokes=strokes), canvas, _LOOP)
    canvas.draw()
    view._context._rc_present = lambda **options: {"method": "skip"}
    return view, canvas


def send(canvas: Any, kind: str, x: float, y: float, *buttons: int) -> None:
    """Send an event of a pointer."""
    common = {"modifiers": (), "time_stamp": time.perf_counter(), "ntouches": 0, "touches": {}}
    canvas.submit_event(common | {"event_type": kind, "x": x, "y": y, "button": 1, "buttons": buttons})
    canvas._process_events()


class Clock:
    """The main thread's own time, apart by who takes it, frame by frame.

    What wgpu's native library takes, with the driver below it, is measured call by call, and so is the CPU's warp,
    where it is no GPU that warps. The rest is Python's part: this code, the bindings of wgpu and all of Dear ImGui, and
    rendercanvas.
    """

    def __init__(self) -> None:
        self.native, self._main, self._plain = 0.0, threading.get_ident(), _api.libf
        self.warp, self._run = 0.0, core.sample
        self._timing = _helpers.SafeLibCalls(SimpleNamespace(**dict(self._timed())), _api.error_handler)

    def _timed(self) -> Iterator[tuple[str, Any]]:
        for name in dir(self._plain):
            if name.startswith("wgpu"):
                yield name, self._wrapped(getattr(_ffi.lib, name))

    def _wrapped(self, call: Any) -> Any:
        def timed(*arguments: Any) -> Any:
            if threading.get_ident() != self._main:
                return call(*arguments)
            start = time.thread_time()
            try:
                return call(*arguments)
            finally:
                self.native += time.thread_time() - start

        return timed

    def _warped(self, *arguments: Any, **options: Any) -> Any:
        start = time.thread_time()
        try:
            return self._run(*arguments, **options)
        finally:
            self.warp += time.thread_time() - start

    def frames(self, works: Iterator[Callable[[], object]]) -> tuple[float, float, float]:
        """Of some works, the median of Python's part, of that of wgpu's native code, and of that of the warp.

        By turns, they are timed as they are, and with each call into native code timed: that takes a little itself.
        """
        wholes, natives, warps = [], [], []
        core.sample = self._warped
        for k, work in enumerate(works):
            _api.libf = self._timing if k % 2 else self._plain
            self.native = self.warp = 0.0
            start = time.thread_time()
            work()
            whole = time.thread_time() - start - self.warp
            warps.append(self.warp)
            if k % 2:
                natives.append(self.native)
            else:
                wholes.append(whole)
        _api.libf, core.sample = self._plain, self._run
        whole, native = statistics.median(wholes), statistics.median(natives)
        return whole - native, native, statistics.median(warps)


def dragged(view: Any, canvas: Any) -> tuple[tuple[float, float, float], float, float]:
    """A drag's median frame, as `Clock.frames` tells it; frames a second; and Python's part if the device rests."""

    def frames(first: int) -> Iterator[Callable[[], None]]:
        for k in range(first, first + 80):

            def frame(k: int = k) -> None:
                send(canvas, "pointer_move", 402 + k, 400 - k, 1)
                canvas.draw()

            yield frame

    send(canvas, "pointer_down", 400, 400, 1)
    for frame in frames(0):  # it learns how large pixels must be
        frame()
    begun = time.perf_counter()
    for frame in frames(80):
        frame()
    rate = 80 / (time.perf_counter() - begun)
    clock = Clock()
    parts = clock.frames(frames(160))
    queue, submit = view.gpu.device.queue, view.gpu.device.queue.submit
    queue.submit = lambda commands: None
    alone = clock.frames(frames(240))[0]
    queue.submit = submit
    send(canvas, "pointer_up", 722, 80)
    return parts, rate, alone


def played(path: Path, rate: int = 25, spent: float = 3.0) -> tuple[int, int]:
    """Return how many frames of a clip that is bent in time are due in some seconds, and how many are seen."""
    stroke = Stroke.grab((960, 540, 40), by=(150, 0, 4), radius=300)
    view, canvas = shown(path, stroke, size=(1920 + WIDE, 1080 + BAR + LINE))
    for _ in range(20):  # what is compiled, and the first frames
        canvas.draw()
        time.sleep(0.05)
    seen = []
    view.tools.playback.toggle()
    begun = time.perf_counter()
    while time.perf_counter() - begun < spent:
        canvas.draw()
        if view.painter.ready:
            seen.append(view.tools.playback.frame)
        time.sleep(0.001)
    view.close()
    return round(rate * spent), len([a for a, b in itertools.pairwise(seen) if a != b]) + 1


def pulled(target: Path, moves: int = 40) -> tuple[float, float]:
    """Frames a second of a drag on the rendering of a head of 256³ voxels, and seconds until that is whole after it."""
    import SimpleITK as sitk  # noqa: N813
    from heads import SHIPPED, cube

    head = sitk.ReadImage(str(SHIPPED), sitk.sitkFloat32)
    finer = sitk.Resample(head, cube(head, 256), sitk.Transform(), sitk.sitkBSpline, 0.0)
    sitk.WriteImage(sitk.Cast(sitk.Clamp(finer, sitk.sitkFloat32, 0, 255), sitk.sitkInt16), str(target))
    view, canvas = shown(target)
    left, top, width, height = view.tools.places[RENDERED]
    x, y = left + width / 2, top + height / 2
    send(canvas, "pointer_move", x, y)
    canvas.draw()
    send(canvas, "pointer_down", x, y, 1)
    begun = time.perf_counter()
    for k in range(2 * moves):  # it learns in the first half
        begun = time.perf_counter() if k == moves else begun
        send(canvas, "pointer_move", x - k / 2, y + k / 2, 1)
        canvas.draw()
    rate = moves / (time.perf_counter() - begun)
    send(canvas, "pointer_up", x - moves, y + moves)
    begun = time.perf_counter()
    while view.filled < 1 or view._drawn_key is None or view._drawn_key[1]:
        canvas.draw()
    taken = time.perf_counter() - begun
    view.close()
    return rate, taken


def start_of(text: str, *arguments: str) -> float:
    """The seconds until a process says that it is there, the second time."""
    taken = 0.0
    for _ in range(2):
        begun = time.time()
        said = subprocess.run(
            [sys.executable, "-c", text, *arguments], capture_output=True, text=True, check=True
        ).stdout
        taken = float(said.split()[-1]) - begun
    return taken


def main() -> None:
    """Print a table."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder
        photo = np.ascontiguousarray(np.tile(image.read(DATA / "coffee.jpg").pixels, (3, 4, 1))[:1080, :1920])
        view, canvas = shown(photo, *twenty(photo))
        (python, native, warp), rate, alone = dragged(view, canvas)
        print(f"{open_gpu().name}\n")
        print("| what | measured | bar |\n|---|---|---|")
        print(f"| from a move to its frame, Python's part | {seconds(python)} | 2 ms |")
        print(f"| the same, where the device does not work on the same processor | {seconds(alone)} | 2 ms |")
        print(f"| wgpu's native library and the driver, on the same thread | {seconds(native)} | |")
        print(f"| the CPU's warp, on the same thread | {seconds(warp)} | |")
        print(f"| frames a second meanwhile, drawn at 1/{view.painter.coarse} | {rate:.0f} | 25 |")
        view.close()
        large = np.tile(photo, (4, 4, 1))[:4000, :6000]
        for what, source, scale, frozen, bar in (
            ("the same, 1080p, with a freeze among the strokes", photo, 1.0, True, 25),
            ("the same, 24 megapixels", large, 4000 / 1080, False, 12),
            ("the same, 24 megapixels, with a freeze among the strokes", large, 4000 / 1080, True, 12),
        ):
            view, canvas = shown(source, *twenty(source, scale, frozen))
            (python, native, warp), rate, _ = dragged(view, canvas)
            print(f"| {what}: the CPU's warp, of one thread | {seconds(warp)} | |")
            print(f"| frames a second | {rate:.0f} | {bar} |")
            view.close()
        due, seen = played(enlarged(Path(folder) / "clip.mp4", 100, 1920, 1080, "veryfast"))
        print(f"| 1080p clip of 25 frames a second, bent and played: frames of {due} | {seen} | {due}, on a GPU |")
        rate, taken = pulled(Path(folder) / "head.nii.gz")
        print(f"| frames a second of a drag on the rendering of a head of 256³ voxels | {rate:.0f} | 10 |")
        print(f"| from its end to the whole rendering | {taken:.2f} s | 3 s |")
        photo_file = Path(folder) / "photo.jpg"
        image.write(photo_file, photo)
        both = (_EMPTY,), (_OURS, str(photo_file))
        empty, ours = (statistics.median(start_of(*words) for _ in range(3)) for words in both)
        beside = f"an empty window of the same libraries takes {empty:.2f} s"
        print(f"| start of a process to the first picture of a 1080p photograph; {beside} | {ours:.2f} s | 1.5 s |")


if __name__ == "__main__":
    main()
