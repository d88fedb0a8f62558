"""The window: `make bench-window`, or `python benchmarks/window.py`.

A 1080p photograph with 20 strokes, and one more that is dragged, on a canvas without a screen: what the main thread
takes from a pointer's move to the frame that shows it, and how many frames a second there are. Then what a start takes
beside that of an empty window of the same libraries.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measure import milliseconds

import supple
from supple.gpu.device import open_gpu
from supple.media import image
from supple.strokes import Recipe, Stroke

DATA = Path(supple.__file__).parent / "data"
_EMPTY = """
import time
begun = time.perf_counter()
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
print(time.perf_counter() - begun)
"""
_OURS = """
import sys, time
begun = time.perf_counter()
from rendercanvas.offscreen import RenderCanvas, loop
from supple.viewer.launch import opened
canvas = RenderCanvas(size=(1280, 800))
view = opened(sys.argv[1], None, canvas, loop)
canvas.draw()
print(time.perf_counter() - begun)
view.close()
"""


def opened(source: Any) -> tuple[Any, Any]:
    """A view of 20 strokes."""
    from rendercanvas.offscreen import RenderCanvas, loop

    from supple.viewer.launch import opened as opened_on

    canvas = RenderCanvas(size=(1280, 800))
    strokes = tuple(Stroke.grab((150 + 80 * k, 300 + 20 * k), by=(15, 28), radius=120) for k in range(20))
    view = opened_on(source, Recipe(border=None, strokes=strokes), canvas, loop)
    canvas.draw()
    return view, canvas


def dragged(view: Any, canvas: Any, count: int) -> tuple[list[float], float]:
    """The main thread's own time for each frame of a drag, and frames a second."""

    def send(kind: str, x: float, y: float, *buttons: int) -> None:
        common = {"modifiers": (), "time_stamp": time.perf_counter(), "ntouches": 0, "touches": {}}
        event = {"event_type": kind, "x": x, "y": y, "button": 1, "buttons": buttons}
        canvas.submit_event(common | event)
        canvas._process_events()

    send("pointer_down", 400, 400, 1)
    own: list[float] = []
    begun = 0.0
    for k in range(count):
        if k == count // 3:  # it has learnt how large pixels must be
            begun = time.perf_counter()
            own.clear()
        start = time.thread_time()
        send("pointer_move", 402 + k, 400 - k, 1)
        canvas.draw()
        own.append(time.thread_time() - start)
    seconds = time.perf_counter() - begun
    send("pointer_up", 402 + count, 400 - count)
    return own, len(own) / seconds


def start_of(text: str, *arguments: str) -> float:
    """What a process says that it took, the second time."""
    said = ""
    for _ in range(2):
        said = subprocess.run(
            [sys.executable, "-c", text, *arguments], capture_output=True, text=True, check=True
        ).stdout
    return float(said.split()[-1])


def main() -> None:
    """Print a table."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder
        photo = np.ascontiguousarray(np.tile(image.read(DATA / "coffee.jpg").pixels, (3, 4, 1))[:1080, :1920])
        view, canvas = opened(photo)
        own, rate = dragged(view, canvas, 120)
        print(f"{open_gpu().name}\n")
        print("| what | measured | bar |\n|---|---|---|")
        print(
            f"| from a move to its frame, the main thread's own time | {milliseconds(statistics.median(own))} | 2 ms |"
        )
        print(f"| frames a second meanwhile, drawn at 1/{view.painter.coarse} | {rate:.0f} | 15 |")
        view.close()
        both = (_EMPTY,), (_OURS, str(DATA / "coffee.jpg"))
        empty, ours = (statistics.median(start_of(*words) for _ in range(3)) for words in both)
        beside = milliseconds(empty)
        print(f"| start to the first picture, beside an empty window's {beside} | {ours / empty:.2f}× | 2× |")


if __name__ == "__main__":
    main()
