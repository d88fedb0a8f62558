"""The opacity of a volume's transfer function, drawn over its histogram."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from imgui_bundle import imgui

from supple.render.transfer import TransferFunction
from supple.viewer.panels.stages import VolumeStage

_LINE, _SHADOW, _HIDDEN = 0xFFFFFFFF, 0xC0000000, 0xA0202020  # ABGR
_STEPS = 128  # points of the curve


def opacities(stage: VolumeStage, transfer: TransferFunction, count: int = _STEPS) -> npt.NDArray[np.float32]:
    """Return the opacity of values, from the smallest to the largest, for the transfer function's unit."""
    low, high = stage.scene.range
    table = transfer.table(low, high, transfer.unit)[:, 3]
    return np.asarray(table[np.rint(np.linspace(0, len(table) - 1, count)).astype(int)], np.float32)


def draw(stage: VolumeStage, transfer: TransferFunction) -> None:
    """Draw the curve, and the colours of its points, over the last item; what the density window hides is darker."""
    scene, lines = stage.scene, imgui.get_window_draw_list()
    (low, high), pad = scene.range, imgui.get_style().frame_padding
    least, most = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    left, right, top, bottom = least.x + pad.x, most.x - pad.x, least.y + pad.y, most.y - pad.y

    def across(value: float) -> float:
        part = (value - low) / (high - low) if high > low else 0.0
        return left + min(max(part, 0.0), 1.0) * (right - left)

    if stage.density is not None:
        for a, b in ((left, across(stage.density[0])), (across(stage.density[1]), right)):
            lines.add_rect_filled((a, top), (b, bottom), _HIDDEN)
    known = opacities(stage, transfer)
    curve: list[Any] = [
        imgui.ImVec2(left + k * (right - left) / (len(known) - 1), bottom - float(part) * (bottom - top))
        for k, part in enumerate(known)
    ]
    lines.push_clip_rect((least.x, least.y), (most.x, most.y), True)
    for colour, thick in ((_SHADOW, 3.0), (_LINE, 1.5)):
        lines.add_polyline(curve, colour, thick, 0)
    for value, red, green, blue, part in transfer.points:
        place = low + value * (high - low) if transfer.relative else value
        if low <= place <= high:
            at = across(place), bottom - part * (bottom - top)
            lines.add_circle_filled(at, 4.5, _SHADOW)
            lines.add_circle_filled(at, 3.5, imgui.color_convert_float4_to_u32((red, green, blue, 1.0)))
    lines.pop_clip_rect()
