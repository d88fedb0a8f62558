"""Tools of a window without one, and the events that they are sent."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.render.picture import Pick
from supple.space.geometry import Geometry
from supple.strokes import Recipe, Stroke
from supple.viewer.document.editing import Document
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.gestures import Tools
from supple.viewer.tools.planes import RENDERED
from supple.viewer.tools.playback import Playback
from supple.viewer.tools.volumes import VolumeTools

LEFT, RIGHT, MIDDLE = 1, 2, 3


def send(tools: Tools[Any], kind: str, x: float = 0, y: float = 0, *modifiers: str, **rest: Any) -> bool:
    event: dict[str, Any] = {"event_type": kind, "x": float(x), "y": float(y), "modifiers": modifiers}
    if kind == "wheel":
        event |= {"dx": 0.0, "dy": 0.0, "buttons": ()}
    return tools.handle(event | rest)


def down(tools: Tools[Any], x: float, y: float, *modifiers: str, button: int = LEFT) -> bool:
    return send(tools, "pointer_down", x, y, *modifiers, button=button, buttons=(button,))


def move(tools: Tools[Any], x: float, y: float, *modifiers: str, buttons: tuple[int, ...] = (LEFT,)) -> bool:
    return send(tools, "pointer_move", x, y, *modifiers, button=0, buttons=buttons)


def up(tools: Tools[Any], x: float, y: float, *modifiers: str, button: int = LEFT) -> bool:
    return send(tools, "pointer_up", x, y, *modifiers, button=button, buttons=())


def wheel(tools: Tools[Any], dy: float, *modifiers: str, x: float = 300, y: float = 200, dx: float = 0) -> bool:
    return send(tools, "wheel", x, y, *modifiers, dy=dy, dx=dx)


def press(tools: Tools[Any], key: str, *modifiers: str) -> bool:
    return tools.handle({"event_type": "key_down", "key": key, "modifiers": modifiers})


def drag(tools: Tools[Any], *path: tuple[float, float], button: int = LEFT, modifiers: tuple[str, ...] = ()) -> None:
    down(tools, *path[0], *modifiers, button=button)
    for x, y in path[1:]:
        move(tools, x, y, *modifiers, buttons=(button,))
    up(tools, *path[-1], *modifiers, button=button)


def click(tools: Tools[Any], x: float, y: float) -> None:
    drag(tools, (x, y), (x + 1, y))


def state(tools: Tools[Any]) -> tuple[object, bytes]:
    return tools.document.state.content, tools.document.deformation.space.table.tobytes()


def image(*strokes: Stroke, on_fold: Any = "damp") -> ImageTools:
    """A picture of 300 x 200 pixels, each two logical ones wide."""
    return ImageTools(Document((200, 300), recipe=Recipe(strokes=strokes, on_fold=on_fold)), (600, 400))


def arrived(tools: Tools[Any], i: int) -> tuple[float, ...]:
    arrival = tools.document.arrival(i)
    assert arrival is not None
    return arrival.arrived


def clip(*strokes: Stroke, count: int = 20) -> VideoTools:
    document = Document((count, 200, 300), recipe=Recipe(border=None, strokes=strokes), kind="video")
    return VideoTools(document, Playback(count, 10), (600, 400))


def solid(*strokes: Stroke, large: int | None = RENDERED) -> VolumeTools:
    """A volume whose object is a disc in the middle of the rendering, which has the whole canvas."""
    document = Document((40, 50, 60), (1, 1, 1), Recipe(border=None, strokes=strokes), kind="volume")

    def pick(x: float, y: float) -> Pick | None:
        return Pick((x / 10, 20.0, y / 10), (0, 0, 0), 50.0) if np.hypot(x - 200, y - 150) < 100 else None

    def pull(pick: Pick, to: tuple[float, float]) -> tuple[float, ...]:
        # By the true camera, which the tools lead: it stands in front, and +z is up.
        assert tools is not None
        view = tools.stage.view(tools.view)
        start = (np.array(pick.index) - view.eye) * view.spacing
        ray = view.direction(to[0] - 0.5, to[1] - 0.5)
        return tuple(ray * (start @ view.ahead) / (ray @ view.ahead) - start)

    tools = VolumeTools(document, Geometry(), (400, 300), pick, pull, (0.0, 1.0))
    tools.enlarge(large)
    return tools
