"""What lies over the picture: the brush's ring, the strokes' handles, the timeline, and the status line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import imgui

from supple.camera import view_of
from supple.viewer.stages import VideoStage, VolumeStage

if TYPE_CHECKING:
    from supple.viewer.view import View

_WHITE, _DARK, _BLUE, _RED = 0xFFFFFFFF, 0xA0000000, 0xFFFFA040, 0xFF5060FF  # ABGR
_BARE = (
    imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_scrollbar
    | imgui.WindowFlags_.no_bring_to_front_on_focus
)


def draw(view: View) -> None:
    """Draw all of it."""
    lines = imgui.get_background_draw_list()
    width, height = view.area
    lines.push_clip_rect((0, 0), (width, height))
    if view.stage.kind == "volume":
        _marks(view, lines)
    else:
        _handles(view, lines)
        _ring(view, lines)
    lines.pop_clip_rect()
    if isinstance(view.stage, VideoStage):
        _timeline(view, view.stage)
    _status(view)


def _ring(view: View, lines: imgui.ImDrawList) -> None:
    pointer = view.tools.pointer
    if pointer is None or view.tools.original:
        return
    radius = view.tools.radius * view.tools.viewport.zoom
    lines.add_circle(pointer, radius, _DARK, 0, 3.0)
    lines.add_circle(pointer, radius, _WHITE, 0, 1.0)


def _handles(view: View, lines: imgui.ImDrawList) -> None:
    document, viewport = view.document, view.tools.viewport
    for i, item in enumerate(document.items):
        if item.hidden:
            continue
        selected = document.selected == i
        if not selected and len(document.items) > 60:
            continue
        start, end = (viewport.to_canvas(*p[:2]) for p in document.handles(i))
        colour = _BLUE if selected else 0x90FFFFFF
        lines.add_line(start, end, _DARK, 3.0)
        lines.add_line(start, end, colour, 1.5)
        lines.add_circle_filled(start, 3.0, colour)
        lines.add_circle(end, 5.0, colour, 0, 2.0)
        damping = document.damping(i)
        if damping < 0.995:
            # As far as was wanted, and is not reached.
            wanted = viewport.to_canvas(*(a + b for a, b in zip(item.stroke.at[:2], item.stroke.by[:2], strict=True)))
            lines.add_line(end, wanted, _RED, 1.5)
            lines.add_circle(wanted, 4.0, _RED, 0, 1.5)
        if selected:
            lines.add_circle(start, item.stroke.radius * viewport.zoom, 0x80FFA040, 0, 1.0)


def _marks(view: View, lines: imgui.ImDrawList) -> None:
    """The strokes of a volume, as the camera sees them."""
    stage = view.stage
    assert isinstance(stage, VolumeStage)
    width, height = view.area
    seen = view_of(view.tools.camera, stage.shape, stage.volume.geometry, (round(height), round(width)))
    right, below = seen.packed[3], seen.packed[4]

    def place(p: tuple[float, ...]) -> tuple[float, float] | None:
        away = (np.array(p) - seen.eye) * seen.spacing
        depth = float(away @ seen.ahead)
        if depth <= 1e-6:
            return None
        x, y = (float(away @ axis) / float(axis @ axis) / depth for axis in (right, below))
        return x + (width - 1) / 2, y + (height - 1) / 2

    for i, item in enumerate(view.document.items):
        if item.hidden:
            continue
        start, end = (place(p) for p in view.document.handles(i))
        if start is None or end is None:
            continue
        colour = _BLUE if view.document.selected == i else 0x90FFFFFF
        lines.add_line(start, end, _DARK, 3.0)
        lines.add_line(start, end, colour, 1.5)
        lines.add_circle(end, 5.0, colour, 0, 2.0)


def _timeline(view: View, stage: VideoStage) -> None:
    from supple.viewer.view import BAR, LINE

    playback = view.tools.playback
    assert playback is not None
    width, height = view.area[0], view.logical[1]
    imgui.set_next_window_pos((0, height - LINE - BAR))
    imgui.set_next_window_size((width, BAR))
    imgui.begin("timeline", None, _BARE)
    if imgui.button("pause" if playback.playing else "play", (54, 0)):
        view.tools.handle({"event_type": "key_down", "key": " ", "modifiers": ()})
    imgui.same_line()
    imgui.set_next_item_width(max(80.0, width - 330))
    changed, frame = imgui.slider_int("##frame", view.tools.frame, 0, stage.film.count - 1, "")
    if changed:
        view.tools.seek(frame)
    imgui.same_line()
    seconds = view.tools.frame / stage.rate if stage.rate else 0.0
    imgui.text(f"{view.tools.frame} / {stage.film.count - 1}  {seconds:.2f} s")
    imgui.same_line()
    changed, loop = imgui.checkbox("loop", playback.loop)
    if changed:
        playback.loop = loop
    imgui.end()


def _status(view: View) -> None:
    from supple.viewer.view import LINE

    height = view.logical[1]
    imgui.set_next_window_pos((0, height - LINE))
    imgui.set_next_window_size((view.area[0], LINE))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (8, 3))
    imgui.begin("status", None, _BARE)
    imgui.text(status(view))
    imgui.end()
    imgui.pop_style_var()


def status(view: View) -> str:
    """The line of status: a message, or the point under the pointer; frames a second; and the certified error."""
    parts = []
    trouble = view.document.trouble or view.message
    if trouble:
        parts.append(trouble)
    elif view.tools.hover is not None:
        hover = view.tools.hover
        names = {"image": "xy", "video": "xyt", "volume": "xyz"}[view.stage.kind]
        parts.append("  ".join(f"{name} {v:.1f}" for name, v in zip(names, hover, strict=False)))
        if not isinstance(view.stage, VolumeStage):
            value = view.stage.value((hover[0], hover[1]), float(view.tools.frame))
            if value:
                parts.append(value)
    if view.stage.kind != "volume":
        parts.append(f"{view.tools.viewport.percent:.0f} %")
    if view.rate:
        parts.append(f"{view.rate:.0f} frames a second")
    if view.painter.coarse > 1 and view.tools.dragging:
        parts.append(f"drawn at 1/{view.painter.coarse} while you drag: {why(view)}")
    parts.append(certified(view))
    return "   |   ".join(p for p in parts if p)


def why(view: View) -> str:
    """Why pictures are smaller while a hand moves."""
    return "no graphics card" if view.gpu.software else "the card is slow"


def certified(view: View) -> str:
    """What is known of the error of what is seen."""
    deformation = view.document.deformation
    if isinstance(view.stage, VolumeStage):
        return "" if deformation.is_identity else f"within {view.stage.scene.error:.2g} voxels"
    if deformation.is_identity:
        return ""
    if deformation.ndim == 3 or view.document.dragging:
        return ""
    report = view.certifier.report(deformation)
    return "measuring the error ..." if report is None else f"error at most {report.error:.2g} px, certified"
