"""Overlays on the image and its views: marks, strokes, rings, and the orientation cube; and the bars below it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from imgui_bundle import imgui, imgui_ctx

from supple.deformation import Deformation
from supple.engine.sampling import DEFAULT
from supple.files.clips import between_frames
from supple.files.options import ClipOptions
from supple.render.box import whole_box
from supple.render.camera import rounded
from supple.space.geometry import SIDES
from supple.viewer.document.keyframes import animated
from supple.viewer.document.settings import keep
from supple.viewer.document.words import done, named
from supple.viewer.panels import keyframes, landmarks, straightening, theme
from supple.viewer.panels.stages import VideoStage, VolumeStage
from supple.viewer.panels.view import COMPUTING, LANE, LINE, TOP, View
from supple.viewer.panels.widgets import hint, icon_button, pinned, wrapped
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.drawing import Pair, Place, Point
from supple.viewer.tools.planes import FIXED, RENDERED, Pane
from supple.viewer.tools.viewport import Viewport
from supple.viewer.tools.volumes import VolumeTools

_LETTERS = 0xF0FFFFFF  # ABGR
_PLANES = (0xFF6478F0, 0xFF78C86C, 0xFF50C8E8)  # red, green and yellow, as elsewhere for these three
_INSET = 8.0  # logical pixels from a view's edge to its text
_GAP = 3.0  # logical pixels around a letter that lines leave free
_NAMED = 30.0  # logical pixels from a view's upper edge to the names of before and after, below the plane's name
_BAR = (0.28, 30.0)  # the largest part of a view's width, and the least logical pixels, of a scale bar
_DASH = 14.0  # logical pixels from one dash to the next
_ROOMY = 240.0  # logical pixels: a narrower view has no room for all of its text
_BEGIN = (
    "The wheel, or a right drag, sets the size of the brush: the ring is how far it is felt.",
    ("The wheel with Shift sets the size of the brush: the ring is how far it is felt."),
)
_PAPER = 0xC8181818
_GRID = 0x98FFFFFF
_CLOSE, _PARTS = 14.0, 4  # the least logical pixels between lines of the grid, and the segments of a line between two


def _views(view: View, tools: VolumeTools, lines: imgui.ImDrawList) -> None:
    """Draw the overlays of all views; their planes are sampled first."""
    if view.slices is not None:
        view.slices.update(tools, not view._lately)
    for k, place in tools.places.items():
        left, top, width, height = place
        lines.push_clip_rect((left, top), (left + width, top + height), True)
        if k == RENDERED:
            _rendering(view, tools, lines, place)
        else:
            _plane(view, tools, lines, k)
        if tools.active == k:
            rings(tools, lines)
        if k < FIXED:
            names(tools, lines, place, _NAMED)
        _button(tools, lines, k)
        lines.pop_clip_rect()


def rings(tools: ImageTools | VolumeTools, lines: imgui.ImDrawList) -> None:
    """Draw the extent of the brush: where a twentieth of a drag is left and, faint, the reach, if there is one."""
    middle, radius, held = tools.pointer, tools.ring, tools.held
    if middle is None or tools.original or not radius:
        return
    if tools.sizing or (held is not None and held.shapes):  # the point stays, and the pointer says how much
        middle = tools.sizing or (held and held.start) or middle
    felt, reach = tools.extent
    if reach is not None and reach > felt:
        ring(lines, middle, reach * radius, tools.stretch, theme.SHADE, 3.0)
        ring(lines, middle, reach * radius, tools.stretch, theme.PALE)
    ring(lines, middle, felt * radius, tools.stretch, theme.DARK, 3.0)
    ring(lines, middle, felt * radius, tools.stretch, theme.WHITE)


def ring(lines: imgui.ImDrawList, middle: Pair, radius: float, stretch: Pair, colour: int, thick: float = 1.0) -> None:
    """Draw a circle of the image: an ellipse where its pixels are not square."""
    lines.add_ellipse(middle, (radius * stretch[0], radius * stretch[1]), colour, 0.0, 0, thick)


def names(tools: ImageTools | VolumeTools, lines: imgui.ImDrawList, place: Place, down: float) -> None:
    """Write what a view, or each side of its split, shows: before, after or a step, ``down`` pixels below the top.

    The knob of the split is drawn, too.
    """
    if (at := tools.knob_in(place)) is not None:
        knob(lines, at)
    (left, top, width, _), named = place, []
    compared = tools.document.compared is not None
    if tools.original:
        named = [("Step A" if compared else "Original", left + 10.0)]
    elif tools.split is not None and 0.05 < tools.split < 0.95:
        middle, (before, after) = left + tools.split * width, ("Step A", "Now") if compared else ("Before", "After")
        named = [(before, middle - 10 - imgui.calc_text_size(before).x - 20), (after, middle + 10)]
    for text, x in named:
        size, y = imgui.calc_text_size(text), top + down
        lines.add_rect_filled((x, y), (x + size.x + 20, y + size.y + 8), 0xB0181818, 6.0)
        lines.add_text((x + 10, y + 4), theme.WHITE, text)


def knob(lines: imgui.ImDrawList, at: Pair, colour: int = theme.WHITE) -> None:
    """Draw the knob of a line that can be dragged: of the split between before and after, or of symmetry."""
    x, y = at
    lines.add_circle_filled(at, 9.0, colour)
    lines.add_circle(at, 9.0, theme.DARK, 0, 1.0)
    for way in (-1, 1):
        lines.add_triangle_filled((x + 6 * way, y), (x + 2 * way, y - 4), (x + 2 * way, y + 4), 0xFF202020)


def _text(lines: imgui.ImDrawList, at: Pair, said: str, colour: int = _LETTERS, align: Pair = (0.0, 0.0)) -> None:
    """Write a line with a shadow, such that its point ``align``, in fractions of its size, is at ``at``."""
    size = imgui.calc_text_size(said)
    x, y = round(at[0] - align[0] * size.x), round(at[1] - align[1] * size.y)
    lines.add_text((x + 1, y + 1), 0xD0000000, said)
    lines.add_text((x, y), colour, said)


def _button(tools: VolumeTools, lines: imgui.ImDrawList, k: int) -> None:
    """Draw the button that enlarges a view: the corners of a frame, which point outwards or inwards."""
    left, top, width, height = tools.button(k)
    x, y, large = left + width / 2, top + height / 2, tools.sight.large is not None
    over = tools.pointer is not None and left <= tools.pointer[0] and top <= tools.pointer[1] < top + height
    colour = theme.WHITE if over and tools.active == k else theme.GREY
    near, far = (2.0, 6.0) if large else (6.0, 2.0)
    for a, b in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        corner = [(x + a * p, y + b * q) for p, q in ((far, near), (near, near), (near, far))]
        theme.outlined_way(lines, corner, colour, 1.5)


def _plane(view: View, tools: VolumeTools, lines: imgui.ImDrawList, k: int) -> None:
    pane = tools.pane(k)
    left, top, width, height = pane.place
    fixed, compared = k >= FIXED, tools.comparison
    if tools.mask is not None and not tools.original and not fixed and pane.upright is None:
        axes, index = (pane.plane.axis, pane.plane.across, pane.plane.down), pane.index[pane.plane.axis]
        view.veil.draw(lines, tools.mask, tools.sizes, pane.to_canvas, theme.packed(view.veil_colour), axes, index)
    sides = list(zip(pane.plane.sides, ((0, 0.5), (1, 0.5), (0.5, 0), (0.5, 1)), strict=True))
    letters = [_letter(pane.place, side, *at) for side, at in sides]
    if not fixed and pane.upright is None:
        _cut(view, lines, pane)
    _crosshair(tools, lines, pane, letters)
    if (grip := tools.grip_of(k)) is not None:
        mirror(lines, grip, top, height)

    def ball(start: Pair, point: Point, radius: float) -> None:  # where the plane cuts it
        away = pane.away(point) * pane.spacing[pane.plane.axis]
        if abs(away) < radius:
            lines.add_circle(start, math.sqrt(radius**2 - away**2) * pane.scale, theme.BALL, 0, 1.0)

    if not fixed:
        strokes(view, lines, pane.to_canvas, pane.crosses, ball)
    landmarks.draw(view, lines, pane.to_canvas, _text, pane, k)
    for (side, _), (a, b, _, _) in zip(sides, letters, strict=True):
        _text(lines, (a + _GAP, b + _GAP), side)
    axis, name = pane.plane.axis, f"{pane.plane.name}, fixed" if fixed else pane.plane.name
    _text(lines, (left + _INSET, top + _INSET), name, _PLANES[k % FIXED])
    wide = imgui.calc_text_size(name).x
    place, slant = _lies(tools, pane)
    number = f"{'xyz'[axis]} {pane.index[axis]}" if pane.upright is None else ""
    room = 0.5 * width - 4 * _INSET - wide  # beside the letter in the middle
    wordings = (number, place, slant and f"oblique by {slant}"), (number, place, slant), (place, slant), (place,)
    joined = ("   ".join(filter(None, words)) for words in wordings)
    fitting = next((text for text in joined if imgui.calc_text_size(text).x < room), "")
    _text(lines, (left + 2 * _INSET + wide, top + _INSET), fitting, theme.GREY)
    _bar(lines, pane.place, pane.scale)
    other = compared is not None and compared.beside and tools.active % FIXED == k % FIXED and tools.active != k
    if other and tools.pointer is not None and (point := tools.hover) is not None:  # the pointer, in the other volume
        x, y = pane.to_canvas(point)
        theme.outlined(lines, (((x - 6, y), (x + 6, y)), ((x, y - 6), (x, y + 6))), theme.WHITE)
    if view.slices is not None and not view.slices.labels and width > _ROOMY:
        low, high = tools.sight.fixed if fixed else tools.sight.window
        unit = view.slices.unit if view.slices.unit != "label" else ""
        said = f"W {high - low:.4g}  L {0.5 * (low + high):.4g} {unit}".rstrip()
        _text(lines, (left + width - _INSET, top + height - _INSET), said, theme.GREY, (1.0, 1.0))


def _letter(place: Place, side: str, across: float, down: float) -> Place:
    """Return the box of the letter of a side of a view, by its place in fractions: left, top, right and bottom."""
    (left, top, width, height), size = place, imgui.calc_text_size(side)
    x = round(left + _INSET + across * (width - 2 * _INSET - size.x))
    y = round(top + _INSET + down * (height - 2 * _INSET - size.y))
    return x - _GAP, y - _GAP, x + size.x + _GAP, y + size.y + _GAP


def _lies(tools: VolumeTools, pane: Pane) -> tuple[str, str]:
    """Return a plane's position on the patient's axis that it crosses, such as S 12 mm, and its tilt, in words."""
    geometry = tools.geometry
    if geometry.convention == "array":
        return "", ""
    row = int(np.abs(geometry.direction[:, pane.plane.axis]).argmax())
    place = float(geometry.to_lps(tools.index)[row])
    slant = f"{geometry.oblique:.2g}\u00b0" if geometry.oblique and pane.upright is None else ""
    return f"{SIDES[row][place < 0]} {abs(place):.1f} mm", slant


def _crosshair(tools: VolumeTools, lines: imgui.ImDrawList, pane: Pane, letters: Iterable[Place]) -> None:
    """Draw the other two planes as lines, with gaps about the voxel where they cross, and where letters are."""
    (left, top, width, height), (x, y) = pane.place, pane.placed(pane.index)
    normal = {plane.axis: _PLANES[k] & 0xB0FFFFFF for k, plane in enumerate(tools.planes)}
    upright, level, gap, edge = normal[pane.plane.across], normal[pane.plane.down], 7.0, _INSET
    wide, high = [(x - gap, x + gap)], [(y - gap, y + gap)]
    for a, b, c, d in letters:
        wide += [(a - edge, c + edge)] if b <= y <= d else []
        high += [(b - edge, d + edge)] if a <= x <= c else []
    for a, b in _between(left, left + width, wide):
        lines.add_line((a, y), (b, y), level, 1.0)
    for a, b in _between(top, top + height, high):
        lines.add_line((x, a), (x, b), upright, 1.0)


def _between(low: float, high: float, gaps: list[Pair]) -> Iterator[Pair]:
    """Yield the parts of an interval that are in no gap."""
    for a, b in sorted(gaps):
        if low < min(a, high):
            yield low, min(a, high)
        low = max(low, b)
    if low < high:
        yield low, high


def _cut(view: View, lines: imgui.ImDrawList, pane: Pane) -> None:
    """Draw the rendered box, if something is cut away; faint if the plane lies outside of the box."""
    assert isinstance(view.stage, VolumeStage)
    box = view.stage.scene.clip
    if box == whole_box(view.stage.shape):
        return
    low, high = box[pane.plane.axis]
    colour = theme.SOFT if low <= pane.index[pane.plane.axis] <= high else theme.DIM
    (a, b), (c, d) = (pane.to_canvas(tuple(corner)) for corner in zip(*box, strict=True))
    lines.add_rect((min(a, c), min(b, d)), (max(a, c), max(b, d)), colour, 0.0, 1.0)


def strokes(
    view: View,
    lines: imgui.ImDrawList,
    place: Callable[[Point], Pair | None],
    there: Callable[[Point], bool] = lambda point: True,
    ball: Callable[[Pair, Point, float], None] = lambda place, point, radius: None,
) -> None:
    """Draw the strokes; points of the selected one in other frames or planes are faint.

    ``place`` returns the position of a point on the canvas, or None if it is hidden; ``there`` whether it is in the
    frame or plane shown; ``ball`` draws the ball of the selected stroke's brush, given a position on the canvas, the
    point there, and the radius.
    """
    document = view.document
    for i, each in () if view.tools.bare else document.tracks():
        selected = document.selected == i
        if not selected and len(document.strokes) > 60:
            continue
        stroke, wanted = each.stroke, each.wanted
        colour = theme.BLUE if selected else theme.SOFT
        for point, where in each.handles:
            start, end, starts, ends = place(point), place(where), there(point), there(where)
            if start is not None and end is not None and (starts or ends or selected):
                if starts and ends:
                    way = [at for at in (start, *map(place, stroke.path), end) if at is not None]
                    theme.outlined_way(lines, way, colour, 1.5)
                if starts:
                    lines.add_circle_filled(start, 3.0, colour)
                else:
                    lines.add_circle(start, 2.0, theme.DIM, 0, 1.0)
                if not ends:
                    lines.add_circle(end, 3.0, theme.DIM, 0, 1.5)
                elif stroke.brush == "grab":
                    lines.add_circle(end, 5.0, colour, 0, 2.0)
                    if wanted is not None and (target := place(wanted)) is not None:
                        lines.add_line(end, target, theme.RED, 1.5)
                        lines.add_circle(target, 4.0, theme.RED, 0, 1.5)
                if selected:
                    ball(start, point, stroke.radius)
            wanted = None  # only the first one's is known


def mirror(lines: imgui.ImDrawList, grip: Pair, top: float, height: float, tilt: Pair | None = None) -> None:
    """Draw the line of symmetry, dashed, through its knobs."""
    (x, y), (a, b) = grip, tilt or (grip[0], grip[1] - 1.0)
    slope = (a - x) / (b - y)
    steps = (k * _DASH for k in range(math.ceil(height / _DASH)))
    dashes = ((top + step, top + min(step + 0.55 * _DASH, height)) for step in steps)
    theme.outlined(lines, ([(x + slope * (end - y), end) for end in dash] for dash in dashes), theme.BLUE)
    for at in (grip, tilt):
        if at is not None:
            knob(lines, at, theme.BLUE)


def _rendering(view: View, tools: VolumeTools, lines: imgui.ImDrawList, place: Place) -> None:
    strokes(view, lines, tools.projected)
    if tools.sight.large is None and (at := tools.projected(tuple(map(float, tools.index)))) is not None:
        ways = ((-1, 0), (1, 0), (0, -1), (0, 1))
        theme.outlined(lines, ([(at[0] + r * a, at[1] + r * b) for r in (3, 9)] for a, b in ways), theme.WHITE)
    landmarks.draw(view, lines, tools.projected, _text)
    if view.computing:
        left, top, width, _ = place
        _text(lines, (left + width / 2, top + _INSET), COMPUTING, align=(0.5, 0.0))
    _cube(tools, lines)
    _bar(lines, place, tools.stage.scale(tools.view, tools.stage.target(tools.view)))


def _bar(lines: imgui.ImDrawList, place: Place, scale: float) -> None:
    left, top, width, height = place
    most = max(_BAR[0] * width, _BAR[1])
    if scale <= 0:
        return
    length = rounded(most / scale)
    x, y = left + _INSET, top + height - _INSET
    end = x + length * scale
    theme.outlined(lines, (((x, y - 2), (end, y - 2)), *(((a, y - 6), (a, y)) for a in (x, end))), theme.WHITE, 2.0)
    _text(lines, (x, y - 8), f"{length:g} mm", align=(0.0, 1.0))


_DARKEST, _BRIGHTEST = 0.46, 0.88  # grey of faces that get no light, and all of it
_EDGE, _INK = 0xFF202020, 0xFF101010  # ABGR
_LARGE = 1.2  # letters of the cube, relative to others
_SLANT = (0.12, 0.3)  # the `Face.towards` between which a letter fades in: it would not fit on narrower faces


def _cube(tools: VolumeTools, lines: imgui.ImDrawList) -> None:
    """Draw the faces of the cube with their letters; the one that a click would choose is blue."""
    font, high = imgui.get_font(), _LARGE * imgui.get_font_size()
    for face in tools.cube:
        grey = _DARKEST + (_BRIGHTEST - _DARKEST) * face.lit
        colour: theme.Colour = (grey, grey, grey, 1.0)
        if face == tools.side:
            r, g, b, _ = theme.ACCENT
            colour = (r * grey / _BRIGHTEST, g * grey / _BRIGHTEST, b * grey / _BRIGHTEST, 1.0)
        corners: list[Any] = [imgui.ImVec2(*corner) for corner in face.corners]
        lines.add_convex_poly_filled(corners, imgui.color_convert_float4_to_u32(colour))
        lines.add_polyline([*corners, corners[0]], _EDGE, 1.5, 0)
        size, (x, y) = imgui.calc_text_size(face.name), face.middle
        least, most = _SLANT
        opaque = min(max((face.towards - least) / (most - least), 0.0), 1.0)
        shade = _INK & 0xFFFFFF | round(255 * opaque) << 24
        at = (round(x - 0.5 * _LARGE * size.x), round(y - 0.5 * _LARGE * size.y))
        lines.add_text(font, high, at, shade, face.name)


_USUAL = ClipOptions()


def draw(view: View) -> None:
    """Draw the overlays of the image."""
    lines = imgui.get_background_draw_list()
    width, height = view.area
    lines.push_clip_rect((0, TOP), (width, TOP + height))
    tools = view.tools
    if isinstance(tools, VolumeTools):
        _views(view, tools, lines)
    else:
        if tools.mask is not None and not tools.original:
            size, colour = view.document.shape[:-3:-1], theme.packed(view.veil_colour)
            view.veil.draw(lines, tools.mask, size, lambda p: tools.view.to_canvas(*p), colour)
        if view.overlay == "grid" and not view.document.timed:
            _grid(view, lines)
        straightening.overlay(view, tools, lines)
        if (grip := tools.grip) is not None:
            mirror(lines, grip, TOP, height, tools.tilt)
        _handles(view, lines)
        rings(tools, lines)
        names(tools, lines, tools.place, 10.0)
    if not view.hinted:
        _hints(view, lines)
    lines.pop_clip_rect()


def _hints(view: View, lines: imgui.ImDrawList) -> None:
    """Draw hints on how to begin, until there is a stroke."""
    if view.document.strokes:
        view.hinted = True
        keep(hinted=True)
        return
    size = _BEGIN[view.stage.kind == "volume"]
    said = f"Drag what you see: it is pulled along.\n{size}\nThe other brushes are at the right; F1 lists all keys."
    (width, height), text = view.area, imgui.calc_text_size(said)
    left, top = 0.5 * (width - text.x), TOP + height - text.y - 40
    lines.add_rect_filled((left - 16, top - 12), (left + text.x + 16, top + text.y + 12), _PAPER, 8.0)
    lines.add_text((left, top), theme.WHITE, said)


def _grid(view: View, lines: imgui.ImDrawList) -> None:
    """Draw lines of the original as they are bent, on both sides of the split."""
    tools, document = view.tools, view.document
    assert isinstance(tools, ImageTools)
    left, top, width, height = tools.place
    cut = left + width * (1.0 if tools.original else tools.split or 0.0)
    for deformation, begin, end in ((document.base, left, cut), (document.deformation, cut, left + width)):
        lines.push_clip_rect((begin, top), (end, top + height), True)
        for points in _bent_grid(deformation, tools.view):
            lines.add_polyline(points, col=_GRID, thickness=1.0, flags=imgui.ImDrawFlags_.none)
        lines.pop_clip_rect()


def grid_step(zoom: float) -> int:
    """Return the pixels from one line of the grid to the next: 32, or more where these would lie close together."""
    return 32 << max(math.ceil(math.log2(_CLOSE / (32 * zoom))), 0)


@lru_cache(maxsize=2)
def _bent_grid(deformation: Deformation, view: Viewport) -> list[list[Any]]:
    step, (columns, rows) = grid_step(view.zoom), view.image_size
    matrix = np.array(view.matrix)
    low, high = (0.0, view.top), (view.canvas_size[0], view.top + view.canvas_size[1])
    made: list[list[Any]] = []
    for across, most in ((0, columns), (1, rows)):
        other = (rows, columns)[across]
        level, along = np.arange(0, most, step), np.linspace(-0.5, other - 0.5, other * _PARTS // step + 2)
        points = np.empty((len(level), len(along), 2))
        points[..., across], points[..., 1 - across] = level[:, None], along
        bent = deformation.forward(points.reshape(-1, 2)).reshape(points.shape)
        seen = bent @ matrix[:2, :2].T + matrix[:2, 2]
        seen /= bent @ matrix[2:, :2].T + matrix[2, 2]
        shown = seen[((seen >= low) & (seen <= high)).all(-1).any(-1)].tolist()
        made += [[imgui.ImVec2(x, y) for x, y in line] for line in shown]
    return made


def bars(view: View) -> None:
    """Draw the timeline and the status line, which covers some of the picture if it has several lines."""
    said = status(view)
    high = LINE + imgui.calc_text_size(said, wrap_width=view.area[0] - 16).y - imgui.get_text_line_height()
    (wide, _), (_, below) = view.area, view.logical
    if isinstance(view.stage, VideoStage):
        with pinned("timeline", (0, below - high - view.bar), (wide, view.bar), (8, 8)):
            _timeline(view, view.stage)
    with pinned("status", (0, below - high), (wide, high), (8, 3)):
        wrapped(said, colour=theme.TEXT)


def _handles(view: View, lines: imgui.ImDrawList) -> None:
    tools = view.tools
    assert isinstance(tools, ImageTools)
    timed = view.document.timed

    def placed(point: Point) -> Pair:
        return tools.view.to_canvas(*point[:2])

    def there(point: Point) -> bool:
        return not timed or abs(point[2] - view.frame) <= 0.5

    def ball(start: Pair, point: Point, radius: float) -> None:
        if there(point):
            ring(lines, start, radius * tools.view.zoom, tools.stretch, theme.BALL)

    keyframes.path(view, lines, placed)
    strokes(view, lines, placed, there, ball)


def _timeline(view: View, stage: VideoStage) -> None:
    tools = view.tools
    assert isinstance(tools, VideoTools)
    playback, width = tools.playback, view.area[0]
    tip = "Pause (Space)" if playback.playing else "Play (Space)"
    if icon_button("play", theme.PAUSE if playback.playing else theme.PLAY, tip):
        tools.press(" ")
    imgui.same_line()
    last = stage.film.count - 1
    said = f"{playback.frame} / {last}   {playback.seconds:.2f} s"
    most = f"{last} / {last}   {last / stage.rate:.2f} s"
    beside = imgui.calc_text_size(most).x + imgui.calc_text_size("loop").x + imgui.get_frame_height() + 44
    imgui.set_next_item_width(max(80.0, imgui.get_content_region_avail().x - beside))
    with imgui_ctx.push_style_color(imgui.Col_.slider_grab, imgui.ImVec4(*theme.TEXT)):
        changed, frame = imgui.slider_int("##frame", playback.frame, 0, last, "")
    if changed:
        playback.seek(frame)
    begin, end, lines = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.get_window_draw_list()
    inset = 0.5 * imgui.get_style().grab_min_size + 2.0  # a slider's knob stays within it

    def across(at: float) -> int:
        return round(begin.x + inset + (end.x - begin.x - 2 * inset) * at / max(last, 1))

    if (playback.first, playback.last) != (0, last):
        lines.add_rect((across(playback.first) - 2, begin.y), (across(playback.last) + 2, end.y), theme.BLUE, 2.0)
    for at, selected in tools.stroke_frames.items():
        x = across(at) + 0.5
        lines.add_line((x, end.y - 6), (x, end.y), theme.BLUE if selected else theme.SOFT, 2.0)
    hint("The frame; below it, where strokes are. I and O mark the part that is played, U removes the marks")
    imgui.same_line(0, 12)
    imgui.text(said)
    imgui.same_line(width - imgui.get_frame_height() - imgui.calc_text_size("loop").x - 16)
    _, playback.loop = imgui.checkbox("loop", playback.loop)
    hint("Play again and again (L)")
    if not view.document.timed:
        imgui.set_cursor_screen_pos((begin.x, end.y + 6))
        keyframes.lane(view, tools, (end.x - begin.x, LANE - 6))


def status(view: View) -> str:
    """Return the status line: a message, or the point under the pointer and its value; and remarks on the image."""
    parts = [view.stage.trouble]
    tools, document = view.tools, view.document
    if view.computing:  # the point under the pointer would have to wait for it
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
    if document.timed and not document.deformation.is_identity and _follows(view.commands.options.get("clip", _USUAL)):
        parts.append("frames are mixed here, and an export follows their motion")
    if isinstance(tools, ImageTools):
        parts.append(f"{tools.view.percent:.0f} %")
    if view.refining and not document.dragging:
        parts.append(f"refining the rendering, {100 * view.filled:.0f} %")
    if view.painter.coarse > 1 and tools.dragging:
        why = "no hardware GPU" if view.gpu.software else "the GPU is slow"
        parts.append(f"drawn at 1/{view.painter.coarse} while you drag: {why}")
    return "   |   ".join(p for p in parts if p)


@lru_cache(maxsize=4)
def _follows(options: ClipOptions) -> bool:
    return between_frames(DEFAULT, options).between == "flow"


def _held(view: View) -> str:
    held, document = view.tools.held, view.document
    if held is not None and held.paints:
        return f"{held.tool}: {len(held.painted)} {'place' if len(held.painted) == 1 else 'places'}"
    if document.selected is None:
        return ""
    stroke, own = document.seen(document.selected), document.strokes[document.selected]
    if held is not None and held.item is not None and held.part == "pivot" and animated(own, "place"):
        return "all keys move" if held.shift else f"key of frame {document.frame}; with Shift, all keys move"
    if stroke.brush != "grab":
        return f"{named(stroke)} {done(stroke)}"
    unit = "" if document.space is None else " mm"
    by = document.as_saved(stroke).by
    return "by " + " ".join(f"{v:+.1f}" for v in by) + unit  # the held point stays under the pointer


def _is_before(view: View) -> bool:
    """Return whether the original, or the step that the result is compared with, is under the pointer."""
    tools = view.tools
    if tools.split is None or tools.pointer is None or tools.original:
        return tools.original
    at = tools.knob_in(tools.place)
    return at is not None and tools.pointer[0] < at[0]


def _of_a_volume(view: View, tools: VolumeTools, hover: tuple[float, ...]) -> list[str]:
    """Return the value of a voxel on screen, and its position."""
    stage, slices, document = view.stage, view.slices, view.document
    assert isinstance(stage, VolumeStage)
    assert slices is not None
    pane = tools.pane_under
    if pane is not None:
        seen = document.base if _is_before(view) else document.deformation
        value = slices.value(seen, pane.plane, pane.own(hover), pane.index[pane.plane.axis])
    elif tools.under is not None:
        value = slices.told(stage.value(tools.under))
    else:
        value = ""
    return [value, stage.place(hover)]


def certified(view: View) -> str:
    """Return the certified error of the pixels, or of the samples of a rendering, in words."""
    deformation, stage, tools = view.document.deformation, view.stage, view.tools
    if deformation.is_identity:
        return ""
    if isinstance(stage, VolumeStage):
        return f"rendering read within {stage.scene.error:.2g} voxels of the map"
    if view.document.dragging or (isinstance(tools, VideoTools) and tools.playback.playing):
        return ""
    film = stage.kind == "video"
    report = view.certifier.report(deformation, round(view.frame) if view.document.timed else None)
    where = " in this frame" if film else ""
    if report is None:
        return "checking the pixels \u2026"
    return f"pixels read within {report.error:.2g} px of the map{where}"
