"""What holds for events of any tool: escape restores, and merged events do what single ones do."""

from __future__ import annotations

import random
import re
import string
from collections.abc import Callable
from typing import Any

import pytest

from supple.strokes import Stroke
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.gestures import Tools
from supple.viewer.tools.keys import BRUSHES, KEYS
from supple.viewer.tools.volumes import VolumeTools
from tests.viewer.tools import LEFT, MIDDLE, RIGHT, clip, down, image, move, press, solid, up, wheel

ALL = pytest.mark.parametrize("make", [image, clip, solid])
Make = Callable[..., Tools[Any]]


def look(tools: Tools[Any]) -> tuple[Any, ...]:
    playback = tools.playback.frame if isinstance(tools, VideoTools) else None
    return tools.document.state, tools.view, playback


@ALL
def test_escape_at_any_point_restores(make: Make) -> None:
    n = 2 if make is image else 3
    some = Stroke(at=(30, 20, 10)[:n], by=(4, 0, 0)[:n], radius=9)
    path = [(200 + 3 * k, 150 + k) for k in range(12)]
    starts: list[tuple[tuple[float, float], int]] = [((200, 150), LEFT), ((5, 5), LEFT), ((200, 150), MIDDLE)]
    starts += [((200, 150), RIGHT), (make(some).handles()[0].seen if make is not clip else (61, 41), LEFT)]
    for (x, y), button in starts:
        for stop in range(len(path)):
            tools = make(some)
            tools.document.add(some)
            tools.document.undo()
            tools.document.select(0)
            if isinstance(tools, VideoTools):
                tools.playback.seek(10)
            before, deformation = look(tools), tools.document.deformation
            down(tools, x, y, button=button)
            for k, (a, b) in enumerate(path[:stop]):
                move(tools, a, b, buttons=(button,))
                if k % 3 == 1 and tools.held is not None:
                    wheel(tools, -100)
            pressed = tools._gesture is not None
            press(tools, "Escape")
            if pressed:
                assert look(tools) == before
                assert tools.document.deformation is deformation
                assert (tools.document.can_undo, tools.document.can_redo, tools.dragging) == (False, True, False)
            state = tools.document.state
            move(tools, 250, 200, buttons=(button,))
            up(tools, 260, 210, button=button)  # which is still to come
            assert tools.document.state is state


def merged(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """As the window may merge them: moves to the last one, wheels to their sum."""
    made: list[dict[str, Any]] = []
    for event in events:
        last = made[-1] if made else {}
        kind = event["event_type"]
        alike = all(last.get(name) == event.get(name) for name in ("event_type", "modifiers", "buttons"))
        if kind in ("pointer_move", "wheel") and alike:
            made.pop()
            if kind == "wheel":
                event = event | {name: event[name] + last[name] for name in ("dx", "dy")}
        made.append(event)
    return made


@ALL
@pytest.mark.parametrize("seed", range(6))
def test_merged_events_equal_single_ones(make: Make, seed: int) -> None:
    rng = random.Random(seed)
    x, y = 200.0, 150.0
    events: list[dict[str, Any]] = []
    for _ in range(12):
        button = rng.choice([LEFT, LEFT, LEFT, MIDDLE, RIGHT])
        pointer = {"button": button, "buttons": (button,)}
        events.append({"event_type": "pointer_down", "x": x, "y": y, "modifiers": (), **pointer})
        for _ in range(rng.randrange(6)):
            modifiers = rng.choice([(), (), ("Control",), ("Shift",)])
            for _ in range(rng.randrange(1, 5)):
                x, y = x + rng.uniform(-12, 12), y + rng.uniform(-9, 9)
                moved = {"event_type": "pointer_move", "button": 0, "buttons": (button,)}
                events.append({**moved, "x": x, "y": y, "modifiers": modifiers})
            turn = rng.choice([-20.0, 30.0])
            turned = {"event_type": "wheel", "x": x, "y": y, "dx": 0.0, "dy": turn, "modifiers": modifiers}
            events += [turned] * rng.randrange(4)
        events.append({"event_type": "pointer_up", "x": x, "y": y, "modifiers": (), **pointer, "buttons": ()})
        x, y = rng.uniform(120, 260), rng.uniform(100, 200)
    one, other = make(), make()
    for event in events:
        one.handle(event)
    few = merged(events)
    assert len(few) < 0.8 * len(events)
    for event in few:
        other.handle(event)
    assert len(one.document.strokes) == len(other.document.strokes) > 0
    assert one.document.selected == other.document.selected
    for a, b in zip(one.document.strokes, other.document.strokes, strict=True):
        assert b.at == pytest.approx(a.at)
        assert b.by == pytest.approx(a.by, abs=1e-9)
        assert b.radius == pytest.approx(a.radius)
    assert other.radius == pytest.approx(one.radius)
    if isinstance(one, ImageTools) and isinstance(other, ImageTools):
        assert other.view.zoom == pytest.approx(one.view.zoom)
        assert other.view.centre == pytest.approx(one.view.centre)
    if isinstance(one, VolumeTools) and isinstance(other, VolumeTools):
        assert one.stage.project(one.view, (3, 4, 5)) == pytest.approx(other.stage.project(other.view, (3, 4, 5)))


NAMED = (
    "Escape",
    "Delete",
    "Backspace",
    "Home",
    "End",
    "ArrowLeft",
    "ArrowRight",
    "F1",
    "F2",
    "Tab",
    "Enter",
    "ArrowUp",
    "ArrowDown",
)
SPOKEN = {" ": "Space", "ArrowLeft": "Left", "ArrowRight": "Right", "ArrowUp": "Up", "ArrowDown": "Down"}


@pytest.mark.parametrize(("make", "kind"), [(image, "image"), (clip, "video"), (solid, "volume")])
def test_all_keys_are_listed(make: Make, kind: str) -> None:
    rows = KEYS[kind]
    listed = {word for keys in rows if "Ctrl" not in keys for word in re.split("[ ,]+", keys)}
    for key in (*string.printable, *NAMED):
        spoken = SPOKEN.get(key, key.upper() if len(key) == 1 else key)
        tools = make()
        acts = press(tools, key)
        # Of a tool that is for other media, it is said.
        assert (acts and "is for pictures" not in (tools.status or "")) == (spoken in listed), key
    said = {"level": "level is for pictures", "push": "push is for pictures and clips"}
    for name in ("level", "push"):
        tools = make()
        press(tools, BRUSHES[name][0])  # type: ignore[index]
        assert tools.status == (said[name] if name in tools.lacks else None)


def test_the_list_of_keys_is_shown_and_hidden() -> None:
    tools = image(Stroke.grab((100, 100), to=(120, 100), radius=20))
    tools.document.select(0)
    for key in ("?", "F1"):
        press(tools, key)
        assert tools.listing
        press(tools, "Escape")
        assert not tools.listing
        assert tools.document.selected == 0
    press(tools, "F1")
    press(tools, "F1")
    assert not tools.listing
