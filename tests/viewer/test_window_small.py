"""What a first clip, a first freeze, a thaw and a symmetric push say and do in the window."""

from __future__ import annotations

import numpy as np

from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke
from supple.viewer.document.editing import Document
from supple.viewer.document.words import described, listed
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.playback import Playback
from tests.viewer.tools import drag, press


def test_a_first_drag_in_a_kept_frame_bends_it() -> None:
    document = Document((20, 200, 300), recipe=Recipe(border=None), kind="video", hold=1)
    tools = VideoTools(document, Playback(20, 10), (600, 400))
    drag(tools, (200, 200), (240, 200))
    assert document.hold == 0
    assert "Keep ends" in (tools.status or "")
    moved = document.deformation.forward((100.0, 99.5, 0.0)) - (100.0, 99.5, 0.0)
    assert np.hypot(*moved[:2]) > 5
    # Where there are strokes, the ends stay as they were chosen, and that is said.
    document.set_hold(2)
    drag(tools, (400, 200), (420, 200))
    assert document.hold == 2
    assert "kept" in (tools.status or "")


def test_a_thaw_is_listed_as_one() -> None:
    free = Freeze.free((200, 300), (1.0, 1.0))
    first = free.painted((150, 100), 60, (1.0, 1.0))
    less = first.painted((150, 100), 20, (1.0, 1.0), frozen=False)
    assert listed(Stroke.freeze(first)).startswith("Freeze: ")
    assert listed(Stroke.freeze(less), before=first).startswith("Thaw: ")
    assert listed(Stroke.freeze(first), before=less).startswith("Freeze: ")


def test_the_radius_of_a_restoring_is_that_of_its_brush() -> None:
    tools = ImageTools(Document((200, 300)), (600, 400))
    drag(tools, (300, 200), (340, 200))
    tools.radius = 24
    press(tools, "r")
    drag(tools, (340, 200), (344, 200))
    stroke = tools.document.strokes[-1]
    assert stroke.name == "restore"
    assert listed(stroke).endswith("radius 24")
    assert "radius 24\n" in described(stroke, None)


def test_a_push_may_cross_its_mirror_line() -> None:
    tools = ImageTools(Document((200, 300), recipe=Recipe(border=None)), (600, 400))
    tools.radius = 15
    press(tools, "m")
    press(tools, "a")
    drag(tools, (240, 190), (270, 196), (300, 200), (330, 204), (360, 210))
    assert tools.status is None
    assert {stroke.name for stroke in tools.document.strokes} == {"push"}
    assert not tools.document.deformation.is_identity
