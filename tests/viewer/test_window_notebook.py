"""The window as a widget of a notebook; and where there is no GPU or no screen."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvips

import supple
from supple.gpu.device import Gpu
from tests.viewer.windows import DATA


def test_what_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.viewer.window import launch

    def none() -> Gpu:
        raise supple.SuppleError("no GPU was found: install one; device='cpu' needs none")

    with monkeypatch.context() as patch:
        patch.setattr(launch, "open_gpu", none)
        with pytest.raises(supple.SuppleError, match=r"install one$"):
            launch.opened(np.zeros((4, 4)), None, None, None)
    monkeypatch.setattr("glfw.init", lambda: False)
    with pytest.raises(supple.SuppleError, match=r"no screen.*--serve"):
        launch.show(np.zeros((4, 4)))


class Notebook:
    """A kernel, and the front end of one widget in it."""

    def __init__(self, client: Any) -> None:
        self.client, self.comm, self.said = client, "", ""
        self.frames: list[bytes] = []

    def run(self, code: str) -> str:
        """What a cell prints; if it shows a widget, that is the one that is talked to."""
        self.said = ""
        asked = self.client.execute(code)
        answer = self.client.get_shell_msg(timeout=120)
        while answer["parent_header"].get("msg_id") != asked:
            answer = self.client.get_shell_msg(timeout=120)
        assert answer["content"]["status"] == "ok", answer["content"].get("traceback")
        self.hear(lambda message: message["msg_type"] == "status" and message["parent_header"]["msg_id"] == asked)
        return self.said.strip()

    def hear(self, enough: Callable[[Any], bool], seconds: float = 120.0) -> None:
        """Take in what the kernel tells, until that is enough."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            message = self.client.get_iopub_msg(timeout=seconds)
            content, kind = message["content"], message["msg_type"]
            if kind == "stream":
                self.said += content["text"]
            elif kind in ("execute_result", "display_data"):
                self.comm = content["data"]["application/vnd.jupyter.widget-view+json"]["model_id"]
            elif kind == "comm_msg" and content["data"].get("content", {}).get("type") == "framebufferdata":
                self.frames.append(bytes(message["buffers"][0]))
                shown = {
                    "index": content["data"]["content"]["index"],
                    "timestamp": time.time(),
                    "localtime": time.time(),
                }
                self.tell({"method": "update", "state": {"_frame_feedback": shown}, "buffer_paths": []})
            if enough(message) and (kind != "status" or content["execution_state"] == "idle"):
                return
        raise AssertionError("it took too long")

    def tell(self, data: Any) -> None:
        """Tell the widget something, as its front end does."""
        message = self.client.session.msg("comm_msg", {"comm_id": self.comm, "data": data})
        self.client.shell_channel.send(message)

    def event(self, kind: str, **event: Any) -> None:
        common = {"type": kind, "modifiers": [], "timestamp": time.time()}
        self.tell({"method": "custom", "content": common | event})


def test_a_notebook_shows_a_widget_that_is_dragged_on(gpu: Gpu, tmp_path: Path) -> None:
    pytest.importorskip("ipykernel")
    pytest.importorskip("anywidget")
    from jupyter_client.manager import start_new_kernel

    env = os.environ | {"IPYTHONDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    manager, client = start_new_kernel(kernel_name="python3", env=env, cwd=str(tmp_path))
    try:
        notebook = Notebook(client)
        notebook.run(
            f"import supple\nfrom supple.media import image\nphoto = image.read({str(DATA / 'coffee.jpg')!r}).pixels\n"
            "view = supple.view(photo)\ntold = []\nview.on_change(told.append)\nview"
        )
        assert notebook.comm
        size = {"width": 800, "height": 500, "pwidth": 800, "pheight": 500, "ratio": 1.0}
        notebook.event("resize", **size)
        notebook.tell({"method": "update", "state": {"_has_visible_views": True}, "buffer_paths": []})
        notebook.hear(lambda _: bool(notebook.frames))
        shown = np.asarray(pyvips.Image.new_from_buffer(notebook.frames[-1], "").numpy())
        assert shown.shape[:2] == (500, 800)
        assert np.ptp(shown[100:400, 50:450].astype(int)) > 200
        touch = {"ntouches": 0, "touches": {}}
        notebook.event("pointer_down", x=250, y=250, button=1, buttons=[1], **touch)
        for x in (260, 280, 300):
            notebook.event("pointer_move", x=x, y=230, button=0, buttons=[1], **touch)
        notebook.event("pointer_up", x=300, y=230, button=1, buttons=[], **touch)
        count = len(notebook.frames)
        notebook.hear(lambda _: len(notebook.frames) > count + 1)
        for _ in range(100):  # frames may come before what they show is told
            if "0" not in notebook.run("print(len(view.recipe.strokes), len(told))").split():
                break
            time.sleep(0.1)
        said = notebook.run("print(len(view.recipe.strokes), view.recipe.strokes[0].by, told[-1] == view.recipe)")
        number, by, same = said.split(" ", 1)[0], said[said.index("(") : said.index(")") + 1], said.split()[-1]
        assert (number, same) == ("1", "True")
        x, y = (float(v) for v in by.strip("()").split(","))
        assert x > 20
        assert y < -8
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
