"""What lies over the image: the brush's ring and the strokes' handles; and the bars below it."""

from __future__ import annotations

import math

from imgui_bundle import imgui

from supple.viewer.document.words import done, named
from supple.viewer.panels import marks, theme
from supple.viewer.panels.stages import VideoStage, VolumeStage
from supple.viewer.panels.view import BAR, COMPUTING, LINE, View
from supple.viewer.panels.widgets import hint, icon_button, shortened
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.drags import Pair, Point
from supple.viewer.tools.playback import Playback
from supple.viewer.tools.volumes import VolumeTools

_BARE = (
    imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_scrollbar
    | imgui.WindowFlags_.no_bring_to_front_on_focus
)


def draw(view: View) -> None:
    """Draw what lies over the image."""
    lines = imgui.get_background_draw_list()
    width, height = view.area
    lines.push_clip_rect((0, 0), (width, height))
    tools = view.tools
    if isinstance(tools, VolumeTools):
        marks.draw(view, tools, lines)
    else:
        if tools.mask is not None and not tools.original:
            size, outline = view.document.shape[:-3:-1], not view.veiled
            view.veil.draw(lines, tools.mask, size, lambda p: tools.view.to_canvas(*p), outline=outline)
        if (grip := tools.grip) is not None:
            marks.mirror(lines, grip, 0.0, height)
        _handles(view, lines)
        marks.rings(tools, lines)
        if tools.knob is not None:
            marks.knob(lines, tools.knob)
        marks.names(tools, lines, (0.0, 0.0, width, height), 10.0)
    lines.pop_clip_rect()


def bars(view: View) -> None:
    """Draw the timeline and the status line."""
    if isinstance(view.stage, VideoStage):
        _timeline(view, view.stage)
    _status(view)


def _handles(view: View, lines: imgui.ImDrawList) -> None:
    tools = view.tools
    assert isinstance(tools, ImageTools)
    (left, top), zoom = tools.view.to_canvas(0.0, 0.0), tools.view.zoom
    a, b, c, d = (zoom * n for n in tools.view.turn)

    def placed(point: Point) -> Pair:  # as the viewport does, which finds its zoom anew for each
        return left + a * point[0] + b * point[1], top + c * point[0] + d * point[1]

    def there(point: Point) -> bool:
        return not isinstance(tools, VideoTools) or abs(point[2] - view.frame) <= 0.5

    def ball(start: Pair, point: Point, radius: float) -> None:
        if there(point):
            marks.ring(lines, start, radius * zoom, tools.stretch, theme.BALL)

    marks.strokes(view, lines, placed, there, ball)


def _timeline(view: View, stage: VideoStage) -> None:
    tools = view.tools
    assert isinstance(tools, VideoTools)
    playback = tools.playback
    width, height = view.area[0], view.logical[1]
    _bar("timeline", height - LINE - BAR, width, BAR, (8, 8))
    if icon_button("play", theme.PAUSE if playback.playing else theme.PLAY, imgui.get_frame_height()):
        tools.press(" ")
    hint("Pause (Space)" if playback.playing else "Play (Space)")
    imgui.same_line()
    last = stage.film.count - 1
    said = f"{playback.frame} / {last}   {playback.seconds:.2f} s"
    most = f"{last} / {last}   {last / stage.rate:.2f} s"
    beside = imgui.calc_text_size(most).x + imgui.calc_text_size("loop").x + imgui.get_frame_height() + 44
    imgui.set_next_item_width(max(80.0, imgui.get_content_region_avail().x - beside))
    imgui.push_style_color(imgui.Col_.slider_grab, theme.TEXT)
    changed, frame = imgui.slider_int("##frame", playback.frame, 0, last, "")
    imgui.pop_style_color()
    if changed:
        playback.seek(frame)
    _marked(playback)
    for at, selected in tools.stroke_frames.items():
        x, high = round(_at_frame(at, playback)) + 0.5, imgui.get_item_rect_max()
        imgui.get_window_draw_list().add_line((x, high.y - 6), (x, high.y), theme.BLUE if selected else theme.SOFT, 2.0)
    hint("The frame; below it, where strokes are. I and O mark the part that is played, U removes the marks")
    imgui.same_line(0, 12)
    imgui.text(said)
    imgui.same_line(width - imgui.get_frame_height() - imgui.calc_text_size("loop").x - 16)
    changed, loop = imgui.checkbox("loop", playback.loop)
    if changed:
        playback.set_loop(loop)
    hint("Play again and again (L)")
    _end_bar()


def _bar(name: str, top: float, wide: float, high: float, padding: Pair) -> None:
    """Begin a bar below the picture."""
    imgui.set_next_window_pos((0, top))
    imgui.set_next_window_size((wide, high))
    imgui.push_style_var(imgui.StyleVar_.window_padding, padding)
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.push_style_color(imgui.Col_.window_bg, theme.RAIL)
    imgui.begin(name, None, _BARE)


def _end_bar() -> None:
    imgui.end()
    imgui.pop_style_color()
    imgui.pop_style_var(2)


def _marked(playback: Playback) -> None:
    """Mark the played part of the timeline, if it is not all."""
    if (playback.first, playback.last) == (0, playback.count - 1):
        return
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    first, last = (round(_at_frame(frame, playback)) for frame in (playback.first, playback.last))
    imgui.get_window_draw_list().add_rect((first - 2, low.y), (last + 2, high.y), theme.BLUE, 2.0)


def _at_frame(frame: float, playback: Playback) -> float:
    """Return where on the timeline, the last item, a frame is."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    inset = 0.5 * imgui.get_style().grab_min_size + 2.0  # a slider's knob stays within it
    return low.x + inset + (high.x - low.x - 2 * inset) * frame / max(playback.count - 1, 1)


def _status(view: View) -> None:
    _bar("status", view.logical[1] - LINE, view.area[0], LINE, (8, 3))
    said = status(view)
    imgui.text(shortened(said, imgui.get_content_region_avail().x))
    hint(said.replace("   |   ", "\n"))  # all of it
    _end_bar()


def status(view: View) -> str:
    """Return the status line: a message, or the point under the pointer; how exact pixels are; frames a second."""
    parts = [view.stage.trouble]
    tools, document = view.tools, view.document
    if view.computing:  # what is under the pointer would wait for it
        return COMPUTING
    if view.seeking:
        return f"seeking frame {view.frame:.0f} \u2026"
    trouble = tools.status or view.commands.message
    if trouble:
        parts.append(trouble)
    elif (hover := tools.hover) is not None:  # for a volume, it casts a ray
        names = {"image": "xy", "video": "xyt", "volume": "xyz"}[view.stage.kind]
        parts.append("  ".join(f"{name} {v:.1f}" for name, v in zip(names, hover, strict=False)))
        if document.dragging:
            parts.append(_held(view))
        elif isinstance(tools, VolumeTools):
            parts += _of_a_volume(view, tools, hover)
        elif not isinstance(view.stage, VolumeStage):
            seen = document.base if _is_before(view) else document.deformation
            parts.append(view.stage.value((hover[0], hover[1]), view.frame, seen))
    parts.append(certified(view))
    if isinstance(tools, ImageTools):
        parts.append(f"{tools.view.percent:.0f} %")
    if view.refining and not document.dragging:
        parts.append(f"refining the rendering, {100 * view.filled:.0f} %")
    elif view.busy:
        parts.append(f"{view.rate:.0f} frames a second")
    if view.painter.coarse > 1 and tools.dragging:
        why = "no hardware GPU" if view.gpu.software else "the GPU is slow"
        parts.append(f"drawn at 1/{view.painter.coarse} while you drag: {why}")
    return "   |   ".join(p for p in parts if p)


def _held(view: View) -> str:
    """Return what the drag does so far."""
    held, document = view.tools.held, view.document
    if held is not None and held.paints:
        return f"{held.tool}: {len(held.made)} {'stroke' if len(held.made) == 1 else 'strokes'}"
    if document.selected is None:
        return ""
    stroke = document.seen(document.selected)
    if stroke.brush != "grab":
        return f"{named(stroke)} {done(stroke)}"
    return "by " + " ".join(f"{v:+.1f}" for v in stroke.by)  # the held point stays under the pointer


def _is_before(view: View) -> bool:
    """Return whether the original, or what else the result is compared with, is under the pointer."""
    tools = view.tools
    if tools.split is None or tools.pointer is None or tools.original:
        return tools.original
    return tools.knob is not None and tools.pointer[0] < tools.knob[0]


def _of_a_volume(view: View, tools: VolumeTools, hover: tuple[float, ...]) -> list[str]:
    """Return the value of a voxel on screen, and its position."""
    stage, slices, document = view.stage, view.slices, view.document
    assert isinstance(stage, VolumeStage)
    assert slices is not None
    pane = tools.pane_under
    if pane is not None:
        seen = document.base if _is_before(view) else document.deformation
        value = slices.value(seen, pane.plane, hover, pane.index[pane.plane.axis])
    elif tools.under is not None:
        value = slices.told(stage.value(tools.under))
    else:
        value = ""
    return [value, stage.place(hover)]


def certified(view: View) -> str:
    """Return how far pixels, or samples of a rendering, may be read from where the map says."""
    deformation, stage, tools = view.document.deformation, view.stage, view.tools
    if deformation.is_identity:
        return ""
    if isinstance(stage, VolumeStage):
        error = stage.scene.error
        if not stage.warned:
            return f"rendering read within {error:.2g} voxels of the map"
        off = f"up to {error:.2g} voxels" if math.isfinite(error) else "more than a voxel"
        return f"parts of the rendering may be {off} out of place: choose Rendering: exact"
    if view.document.dragging or (isinstance(tools, VideoTools) and tools.playback.playing):
        return ""
    film = stage.kind == "video"
    report = view.certifier.report(deformation, round(view.frame) if film else None)
    where = " in this frame" if film else ""
    if report is None:
        return "checking the pixels \u2026"
    return f"pixels read within {report.error:.2g} px of the map{where}"
