"""The pressure of a pen: how much of a new stroke is made; the recipe says no more than that."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from supple.strokes import Stroke
from supple.viewer.tools.gestures import Tools
from tests.viewer.tools import clip, image, press, send, solid, state


def drawn(tools: Tools[Any], key: str, *pressures: float | None) -> tuple[Stroke, ...]:
    """The strokes of a drag to the right, with a pressure at each place."""
    tools.radius = 20
    press(tools, key)
    count = len(tools.document.strokes)
    for k, pressure in enumerate(pressures):
        more = {} if pressure is None else {"pressure": pressure}
        kind = "pointer_move" if k else "pointer_down"
        send(tools, kind, 201 + 10 * k, 101, button=0 if k else 1, buttons=(1,), **more)
    send(tools, "pointer_up", 201 + 10 * (len(pressures) - 1), 101, button=1, buttons=())
    return tools.document.strokes[count:]


def picture() -> Tools[Any]:
    return image(on_fold="flow")  # which paths take


@pytest.mark.parametrize("kind", [picture, clip, solid])
@pytest.mark.parametrize(("key", "what"), [("g", "by"), ("f", "by"), ("t", "angle"), ("w", "factor"), ("n", "factor")])
def test_the_greatest_pressure_is_how_much_of_a_stroke_is_made(kind: Any, key: str, what: str) -> None:
    def amount(*pressures: float | None) -> float:
        tools = kind()
        (stroke,) = drawn(tools, key, *pressures)
        after = state(tools)
        press(tools, "z", "Control")
        press(tools, "y", "Control")
        assert state(tools) == after
        assert stroke.strength == 1
        value = getattr(stroke, what)
        return float(np.log(value) if what == "factor" else np.linalg.norm(value))

    whole = amount(None, None, None, None)
    assert whole != 0
    assert amount(1.0, 1.0, 1.0, 1.0) == pytest.approx(whole)
    assert amount(0.5, 0.5, 0.5, 0.5) == pytest.approx(0.75 * whole)
    assert amount(0.1, 0.5, 0.2, 0.0) == pytest.approx(0.75 * whole)  # the pen is lifted at the end
    assert amount(0.0, 0.0, 0.0, 0.0) == pytest.approx(0.01 * whole)


def test_a_path_is_led_a_part_of_its_way() -> None:
    (whole,), (half,) = (drawn(picture(), "f", *[pressure] * 5) for pressure in (1.0, 0.5))
    ends = np.array(whole.path) - whole.at, np.array(half.path) - half.at
    np.testing.assert_allclose(ends[1], 0.75 * ends[0])


def test_without_the_switch_and_for_a_mouse_it_is_all() -> None:
    tools = image()
    (stroke,) = drawn(tools, "g", None, None)
    assert not tools.pen
    tools.document.select(None)
    tools.pressing = False
    assert drawn(tools, "g", 0.2, 0.3)[0].by == stroke.by
    assert tools.pen


def test_each_dab_of_a_painting_has_the_pressure_of_its_place() -> None:
    def left(*pressures: float) -> float:
        tools = image(Stroke.grab((100, 50), by=(12, 0), radius=30))
        drawn(tools, "r", *pressures)
        moved = tools.document.deformation.forward([(100, 50)])[0] - (100, 50)
        return float(np.linalg.norm(moved))

    hard, soft, lifted = left(1.0, 1.0), left(0.2, 0.2), left(0.2, 0.0)
    assert hard < 0.5 * soft
    assert soft < 12
    assert lifted >= soft


@pytest.mark.parametrize("key", ["g", "r"])
def test_the_peak_of_a_drag_counts_where_moves_were_dropped_but_not_for_paintings(key: str) -> None:
    def left(**last: float) -> tuple[Stroke, ...]:
        tools = image(Stroke.grab((100, 50), by=(12, 0), radius=30))
        tools.radius = 20
        press(tools, key)
        send(tools, "pointer_down", 201, 101, button=1, buttons=(1,), pressure=0.2, peak=0.2)
        send(tools, "pointer_move", 231, 101, button=0, buttons=(1,), pressure=0.2, peak=0.2)
        send(tools, "pointer_up", 231, 101, button=1, buttons=(), pressure=0.2, **last)
        return tools.document.strokes[1:]

    low, high = left(peak=0.2), left(peak=0.5)
    if key == "r":
        assert high == low
    else:
        np.testing.assert_allclose(high[0].by, np.array(low[0].by) * 0.75 / 0.36)


@pytest.mark.parametrize("wrong", ["abc", None, [], {}, float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("key", ["g", "r"])
def test_a_pressure_that_is_no_number_is_none(key: str, wrong: Any) -> None:
    def made(*pressures: Any) -> tuple[Stroke, ...]:
        tools = image(Stroke.grab((100, 50), by=(12, 0), radius=30))
        strokes = drawn(tools, key, *pressures)
        assert tools.status is None
        return strokes

    assert made(wrong, wrong, wrong) == made(None, None, None)
    assert made(0.3, wrong, wrong) == made(0.3, 0.3, 0.3)
    assert made(7, 10**400, 1.5) == made(1.0, 1.0, 1.0)
    assert made(-3, -1, -0.0) == made(0.0, 0.0, 0.0)


@pytest.mark.parametrize("key", ["g", "r"])
def test_a_light_pen_that_joins_a_drag_of_a_mouse_does_not_weaken_it(key: str) -> None:
    def made(pressure: float | None) -> tuple[Stroke, ...]:
        return drawn(image(Stroke.grab((100, 50), by=(12, 0), radius=30)), key, None, pressure, pressure)

    assert made(0.1) == made(None)


def test_pins_are_where_they_are() -> None:
    tools = image(Stroke.grab((100, 50), by=(12, 0), radius=30))
    tools.document.select(0)
    press(tools, "d")
    for k, x in enumerate((301, 301)):
        kind = "pointer_move" if k else "pointer_down"
        send(tools, kind, x, 201, button=0 if k else 1, buttons=(1,), pressure=0.3)
    send(tools, "pointer_up", 301, 201, button=1, buttons=())
    (stroke,) = tools.document.strokes
    assert stroke.by == (12, 0)
    assert [by for _, by in stroke.also] == [(0, 0)]
