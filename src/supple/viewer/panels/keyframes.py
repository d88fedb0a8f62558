"""The keys of the selected stroke of a clip: the lane below the timeline, their path over the picture, their fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

from imgui_bundle import imgui

from supple.strokes import Stroke
from supple.strokes.keys import curve
from supple.viewer.document.keyframes import PARTS, Part, animated, moved_key, of_key, with_key, with_key_here, without
from supple.viewer.panels import theme
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import button, hint, icon_button, label, progress, wrapped
from supple.viewer.tools.brushes import VideoTools
from supple.viewer.tools.drawing import CLICK, Pair

Mark = tuple[int, Part]
"""A drawn mark of a key: its frame, and whether it is for the position or the strength."""
_ROW = 16.0  # logical pixels of the lane's row of positions, above the curves
_NEAR = 7.0  # the largest distance of the pointer from a mark
_MOST = 400  # samples of a curve
_MANY = 32  # marks, from which on they are small
_COLOURS = {"x": 0xFF7880F0, "y": 0xFF78C86C, "strength": theme.BLUE}
_ANIMATE = "What is animated has keys: an edit in a frame sets one there. Off, it stays as it is in this frame"
_FOLLOW = (
    "Track what is at the stroke's point in this frame, a corner or a spot, through the clip: the stroke moves along. "
    "Positions that it has are replaced"
)
_LANE = (
    "Keys of the selected stroke, diamonds of its position and dots of its strength: click to go to one, drag it to "
    "another frame, or a dot up and down; right-click to remove it. J and K go to the key before and to the next"
)


@lru_cache(maxsize=1)
def _curves(stroke: Stroke) -> dict[str, list[Pair]]:
    """Return the curves of the animated values, by their names: pairs of a frame and a value."""
    step = max(1, (stroke.keys[-1].frame - stroke.keys[0].frame) // _MOST)
    frames = sorted({*range(stroke.keys[0].frame, stroke.keys[-1].frame, step), *(k.frame for k in stroke.keys)})
    made: dict[str, list[Pair]] = {}
    for name, part, axis in (("x", "at", 0), ("y", "at", 1), ("strength", "strength", None)):
        pairs = [(k.frame, getattr(k, part)) for k in stroke.keys if getattr(k, part) is not None]
        if pairs:
            values = [stroke.strength * v if axis is None else v[axis] for _, v in pairs]
            made[name] = [(float(frame), curve([k for k, _ in pairs], values, frame)) for frame in frames]
    return made


def path(view: View, lines: imgui.ImDrawList, placed: Callable[[Pair], Pair]) -> None:
    """Draw the way of the selected stroke through the clip over the picture, with a diamond for each key."""
    chosen = view.document.selected
    stroke = None if chosen is None else view.document.strokes[chosen]
    known = {} if stroke is None or stroke.hidden or not stroke.keys else _curves(stroke)
    if stroke is None or "x" not in known:
        return
    points = [placed((x, y)) for (_, x), (_, y) in zip(known["x"], known["y"], strict=True)]
    theme.outlined_way(lines, points, theme.SOFT)
    for key in stroke.keys:
        if key.at is not None:
            _diamond(lines, placed((key.at[0], key.at[1])), _shade(view, key.frame), len(stroke.keys))


def _shade(view: View, frame: int) -> int:
    return theme.BLUE if frame == view.document.frame else theme.GREY


def _diamond(lines: imgui.ImDrawList, at: Pair, colour: int, count: int) -> None:
    """Draw the mark of a position: a small square among many."""
    x, y = at
    if count > _MANY:
        lines.add_rect_filled((x - 1.5, y - 1.5), (x + 1.5, y + 1.5), colour)
    else:
        theme.diamond(lines, at, 4.5, colour)


def lane(view: View, tools: VideoTools, size: Pair) -> None:
    """Draw the lane at the cursor: the row of positions, below it the curves, and beside them the values."""
    document, playback, lines = view.document, tools.playback, imgui.get_window_draw_list()
    low, buttons = imgui.get_cursor_screen_pos(), imgui.ButtonFlags_
    imgui.invisible_button("##lane", size, buttons.mouse_button_left | buttons.mouse_button_right)
    high, chosen = imgui.get_item_rect_max(), document.selected
    inset = 0.5 * imgui.get_style().grab_min_size + 2.0  # as in the slider above
    first, per_frame = low.x + inset, max(high.x - low.x - 2 * inset, 1.0) / max(playback.count - 1, 1)
    rise, marks = size[1] - _ROW - 9.0, dict[Mark, Pair]()

    def placed(frame: float, part: float) -> Pair:
        return first + per_frame * frame, high.y - 5.0 - part * rise

    lines.add_rect_filled(low, high, theme.packed(theme.FIELD), 4.0)
    stroke = None if chosen is None else document.strokes[chosen]
    if stroke is not None and stroke.keys:
        curves = _curves(stroke)
        lines.push_clip_rect(low, high, True)
        lines.add_line((low.x, low.y + _ROW - 1), (high.x, low.y + _ROW - 1), theme.packed(theme.RAISED))
        for name, pairs in curves.items():
            values = [0.0, 1.0] if name == "strength" else [value for _, value in pairs]
            least, span = min(values), max(max(values) - min(values), 1e-9)
            points: list[Any] = [placed(frame, (value - least) / span) for frame, value in pairs]
            points = [(low.x, points[0][1]), *points, (high.x, points[-1][1])]  # constant beyond the keys
            thick = 2.0 if name == "strength" else 1.0
            lines.add_polyline(points, col=_COLOURS[name], thickness=thick, flags=imgui.ImDrawFlags_.none)
        lines.pop_clip_rect()
        now, at = stroke.at_frame(document.frame), high.y - size[1]
        said = {"x": f"x {now.at[0]:.1f}", "y": f"y {now.at[1]:.1f}", "strength": f"strength {now.strength:.0%}"}
        for name in curves:
            lines.add_text((high.x + 12, at), _COLOURS[name], said[name])
            at += imgui.get_text_line_height()
        last = -math.inf
        for key in stroke.keys:
            x = placed(key.frame, 0)[0]
            if x - last >= 1.0 and of_key(key, "place"):  # keys closer than a pixel would overlap
                marks[key.frame, "place"], last = (x, low.y + 0.5 * _ROW), x
            if key.strength is not None:
                marks[key.frame, "strength"] = placed(key.frame, stroke.strength * key.strength)
    else:
        none = "No keys: animate the selected stroke in the panel" if stroke else "Select a stroke to see its keys"
        lines.add_text((low.x + 10, 0.5 * (low.y + high.y - imgui.get_text_line_height())), theme.DIM, none)
    here = round(placed(playback.frame, 0)[0]) + 0.5
    lines.add_line((here, low.y), (here, high.y), theme.PALE)
    x, y = imgui.get_mouse_pos()
    near = [(max(abs(a - x), abs(b - y)), mark) for mark, (a, b) in marks.items()] if imgui.is_item_hovered() else []
    away, found = min(near, default=(_NEAR, None))
    found = found if away < _NEAR else None
    for (frame, part), place in marks.items():
        colour = theme.WHITE if (view.held_key or found) == (frame, part) else _shade(view, frame)
        if part == "place":
            _diamond(lines, place, colour, len(marks))
        else:
            lines.add_circle_filled(place, 4.5, colour)
            lines.add_circle(place, 4.5, theme.DARK, 0, 1.0)
    hint(_LANE)
    if found and stroke and chosen is not None and imgui.is_item_clicked(imgui.MouseButton_.right):
        view.attempt(partial(document.replace, chosen, without(stroke, found[1], {found[0]}, document.frame)))
    elif imgui.is_mouse_down(imgui.MouseButton_.left) or view.held_key:
        _drag(view, tools, found, (x - first) / per_frame, per_frame, rise)


def _drag(view: View, tools: VideoTools, found: Mark | None, frame: float, per_frame: float, rise: float) -> None:
    """Drag a key, to the side or up and down; or, beside the keys, the frame shown."""
    document, playback, active = view.document, tools.playback, imgui.is_item_active()
    if imgui.is_item_activated():
        playback.pause()
        view.held_key = found
        if found is not None and document.selected is not None:
            view.attempt(partial(document.begin_drag, document.selected))
    held = view.held_key
    if held is None:
        if active:
            playback.seek(frame)
    elif not active:
        view.held_key = None
        if document.dragging and not document.commit():
            playback.seek(held[0])  # a click
    elif imgui.is_key_pressed(imgui.Key.escape) and document.dragging:
        document.abandon()
    elif document.dragging and document.selected is not None:
        gone = imgui.get_mouse_drag_delta(imgui.MouseButton_.left, CLICK)
        stroke, to = document.steps[document.step].strokes[document.selected], held[0] + round(gone.x / per_frame)
        if held[1] == "strength" and abs(gone.y) > abs(gone.x):
            strength = stroke.at_frame(held[0]).strength - gone.y / rise
            stroke = with_key(stroke, held[0], strength=min(max(strength, 0.0), 1.0))
        elif gone.x:
            low, high = min(held[0], 0), max(held[0], playback.count - 1)
            stroke = moved_key(stroke, held[1], held[0], min(max(to, low), high))
        view.attempt(partial(document.preview_as, stroke))


def fields(view: View, i: int, stroke: Stroke) -> None:
    """Draw the fields of the selected stroke's animation: the animated parts, and the keys."""
    document, tools = view.document, view.tools
    assert isinstance(tools, VideoTools)
    frame, frames = document.frame, [key.frame for key in stroke.keys]
    made = stroke
    label("Animate", _ANIMATE)
    for part, text in zip(PARTS, ("position", "strength"), strict=True):
        changed, on = imgui.checkbox(text, animated(stroke, part))
        hint(_ANIMATE)
        imgui.same_line()
        if changed:
            made = with_key_here(stroke, part, frame) if on else without(stroke, part, frames, frame)
    imgui.new_line()
    if frames:
        label("Keys")
        here = frame in frames
        for name, icon, way in (("before", theme.BEFORE, -1), ("after", theme.AFTER, 1)):
            if icon_button(f"key {name}", icon, f"The key {name} this frame ({'J' if way < 0 else 'K'})"):
                tools.go_to_key(way)
            imgui.same_line()
        tip = "Remove the key of this frame" if here else "Set a key in this frame, of what is animated"
        if icon_button("key here", theme.KEY, tip, on=here):
            for part in PARTS:
                if animated(stroke, part):
                    made = without(made, part, {frame}, frame) if here else with_key_here(made, part, frame)
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        wrapped(f"{frames.index(frame) + 1} of {len(frames)}" if here else f"{len(frames)} in all")
    _following(view, i)
    if made is not stroke:
        view.attempt(partial(document.replace, i, made))


def _following(view: View, i: int) -> None:
    """Draw the button that tracks the stroke's point, or the progress of tracking."""
    commands = view.commands
    if commands.following is None:
        label("Follow", _FOLLOW)
        if button("Track its point", tip=_FOLLOW):
            view.attempt(partial(commands.follow, i))
    elif progress(commands.following[2]):
        commands.following[2].cancel()
