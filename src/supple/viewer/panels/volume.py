"""How a volume is rendered: its colours, the window of its values, and the curve of their opacity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from imgui_bundle import imgui, imgui_ctx

from supple.render.box import whole_box
from supple.render.transfer import LABELS, PRESETS, TransferFunction
from supple.viewer.panels import theme
from supple.viewer.panels.stages import VolumeStage
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import LABEL, REST, button, choice, hint, label, section, slider, typed, wrapped
from supple.viewer.tools.planes import ends_of
from supple.viewer.tools.volumes import VolumeTools


def draw(view: View) -> None:
    """Draw the section of a volume."""
    stage = view.stage
    if not isinstance(stage, VolumeStage) or not section(view, "Volume"):
        return
    names = [*PRESETS, *([LABELS] if stage.unit == "label" else [])]
    tip = "Which colours and opacities the values have"
    preset = choice("Colours", stage.preset, {name: name for name in names}, tip)
    if preset != stage.preset:
        _show(view, lambda: stage.look(preset, stage.density))
    low, high = stage.scene.range
    window = stage.density or (low, high)
    wide, transfer = imgui.get_content_region_avail().x, stage.scene.transfer
    if isinstance(transfer, TransferFunction):
        with imgui_ctx.push_style_color(imgui.Col_.plot_histogram, imgui.ImVec4(*theme.FAINT)):
            imgui.plot_histogram("##histogram", stage.histogram, graph_size=(wide, 50))
        hint("How many voxels have which value, on a logarithmic scale, and the opacity of each")
        _curve(stage, transfer)
    for k, said in enumerate(("Values from", "to")):
        tip = "The range of values that the colours are spread over"
        value = slider(said, window[k], low, high, "%.4g", tip)
        both = (value, max(window[1], value)) if k == 0 else (min(window[0], value), value)
        if value != window[k] and both[0] < both[1]:
            _show(view, partial(stage.look, transfer, None if both == (low, high) else both))
    if isinstance(transfer, TransferFunction):
        _transfer(view, stage, transfer)
    _cutting(view, stage)
    if stage.apart:
        tip = "Render what lies thin beside the body too, as a table or a head holder does"
        if button("Table", tip=tip, on=stage.table):
            _show(view, lambda: stage.set_table(not stage.table))
    filling = view.filled < 1.0 and not view.tools.original
    if filling and not view.document.deformation.is_identity:
        imgui.progress_bar(view.filled, (REST, 6), "")
        wrapped("Bending a copy of the volume: pictures are faster once it is complete.")


def _show(view: View, work: Callable[[], object]) -> None:
    """Change the display of a volume, and show an error if it is refused."""
    view.attempt(work)
    view.refresh()


def _cutting(view: View, stage: VolumeStage) -> None:
    """Draw the sides of the box that is rendered, and buttons that move one of them to the crosshair."""
    if not imgui.tree_node("Cut away"):
        return
    tools = view.tools
    assert isinstance(tools, VolumeTools)
    box, wide = stage.scene.clip, imgui.get_content_region_avail().x
    whole, named = whole_box(stage.shape), ends_of(tools.planes)
    gap = imgui.get_style().item_spacing.x
    beside = wide - LABEL + imgui.get_style().indent_spacing
    label("At crosshair", "The half of the rendering to that side of the crosshair; again: all of it")
    for k, side in ((k, side) for k in range(3) for side in range(2)):
        (first, last), at = whole[k], float(tools.index[k])
        left = (max(at, first), last) if side == 0 else (first, min(at, last))
        on = box[k] == left != whole[k]
        if button(f"{named[k][side]}##cut", (beside - 5 * gap) / 6, on=on, enabled=left[0] < left[1]):
            _show(view, partial(stage.cut, (*box[:k], whole[k] if on else left, *box[k + 1 :])))
        if (k, side) != (2, 1):
            imgui.same_line()
    for k, (first, last) in enumerate(whole):
        low, high = box[k]
        label(f"{'xyz'[k]}, {named[k][0]} to {named[k][1]}", "The voxels from which, and to which, it is rendered")
        imgui.set_next_item_width(0.5 * (beside - gap))
        from_ = slider(f"##from{k}", low, first, last, "%.0f")
        imgui.same_line()
        imgui.set_next_item_width(0.5 * (beside - gap))
        to = slider(f"##to{k}", high, first, last, "%.0f")
        if (from_, to) != (low, high):
            low = min(round(from_), high - 1) if from_ != low else low
            high = max(round(to), low + 1) if to != high else high
            _show(view, partial(stage.cut, (*box[:k], (float(low), float(high)), *box[k + 1 :])))
    if button("Show all", 0.0, enabled=box != whole):
        _show(view, partial(stage.cut, None))
    imgui.tree_pop()


def _transfer(view: View, stage: VolumeStage, transfer: TransferFunction) -> None:
    if not imgui.tree_node("Transfer function"):
        return
    points = [list(p) for p in transfer.points]
    wide = imgui.get_content_region_avail().x
    for k, (value, red, green, blue, opacity) in enumerate(points):
        imgui.push_id(k)
        imgui.set_next_item_width(0.28 * wide)
        moved = typed(view, f"##value{k}", value, "%.3g", "The value, as a part of the range")
        imgui.same_line()
        painted, colour = imgui.color_edit3("##colour", [red, green, blue], imgui.ColorEditFlags_.no_inputs)
        hint("Its colour")
        imgui.same_line()
        imgui.set_next_item_width(0.34 * wide)
        seen = slider("##opacity", opacity, 0.0, 1.0, "%.2f", "Its opacity")
        if moved is not None or painted or seen != opacity:
            points[k] = [value if moved is None else moved, *colour, seen]
        imgui.same_line()
        removed = button("x", 0.0, "Remove the point") and len(points) > 2
        imgui.pop_id()
        if removed:
            del points[k]
            break
    if imgui.button("Add a point") and len(points) >= 2:
        middle = [0.5 * (a + b) for a, b in zip(points[-2], points[-1], strict=True)]
        points.insert(len(points) - 1, middle)
    if points != [list(p) for p in transfer.points]:
        made: Any = tuple(sorted((tuple(p) for p in points), key=lambda p: p[0]))
        _show(view, lambda: stage.look(replace(transfer, points=made), stage.density))
    imgui.tree_pop()


_CURVE, _UNDER, _DARKER = 0xFFFFFFFF, 0xC0000000, 0xA0202020  # ABGR
_STEPS = 128  # points of the curve


def _opacities(stage: VolumeStage, transfer: TransferFunction, count: int = _STEPS) -> npt.NDArray[np.float32]:
    """Return the opacity of values, from the smallest to the largest, for the transfer function's unit."""
    low, high = stage.scene.range
    table = transfer.table(low, high, transfer.unit)[:, 3]
    return np.asarray(table[np.rint(np.linspace(0, len(table) - 1, count)).astype(int)], np.float32)


def _curve(stage: VolumeStage, transfer: TransferFunction) -> None:
    """Draw the curve and the colours of its points over the last item; values outside the density window are darker."""
    scene, lines = stage.scene, imgui.get_window_draw_list()
    (low, high), pad = scene.range, imgui.get_style().frame_padding
    least, most = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    left, right, top, bottom = least.x + pad.x, most.x - pad.x, least.y + pad.y, most.y - pad.y

    def across(value: float) -> float:
        part = (value - low) / (high - low) if high > low else 0.0
        return left + min(max(part, 0.0), 1.0) * (right - left)

    if stage.density is not None:
        for a, b in ((left, across(stage.density[0])), (across(stage.density[1]), right)):
            lines.add_rect_filled((a, top), (b, bottom), _DARKER)
    known = _opacities(stage, transfer)
    curve: list[Any] = [
        imgui.ImVec2(left + k * (right - left) / (len(known) - 1), bottom - float(part) * (bottom - top))
        for k, part in enumerate(known)
    ]
    lines.push_clip_rect((least.x, least.y), (most.x, most.y), True)
    for colour, thick in ((_UNDER, 3.0), (_CURVE, 1.5)):
        lines.add_polyline(curve, colour, thick, 0)
    for value, red, green, blue, part in transfer.points:
        place = low + value * (high - low) if transfer.relative else value
        if low <= place <= high:
            at = across(place), bottom - part * (bottom - top)
            lines.add_circle_filled(at, 4.5, _UNDER)
            lines.add_circle_filled(at, 3.5, imgui.color_convert_float4_to_u32((red, green, blue, 1.0)))
    lines.pop_clip_rect()
