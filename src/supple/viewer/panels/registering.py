"""The panel of a volume beside a fixed one: how both are compared, labels over them, and pairs of landmarks."""

from __future__ import annotations

from functools import partial

import numpy as np
from imgui_bundle import imgui, imgui_ctx

from supple.viewer.document.landmarks import Landmarks
from supple.viewer.panels import theme
from supple.viewer.panels.layers import Segmentation
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import (
    button,
    choice,
    entry,
    eye,
    hint,
    icon_button,
    label,
    rows,
    section,
    slider,
    wrapped,
)
from supple.viewer.tools.comparing import MODES, SHARES, Comparison
from supple.viewer.tools.volumes import VolumeTools

_MOST = 8  # rows of a list
_SET = "Click a point in the bent volume, and the same point in the fixed one: in their planes, or one after the other"
_AXES = "Planes through the crosshair along the axes of the patient, or along the voxels, which are oblique"


def draw(view: View) -> None:
    """Draw the sections that apply to the volume."""
    tools = view.tools
    if not isinstance(tools, VolumeTools) or view.slices is None:
        return
    if tools.geometry.oblique and tools.geometry.convention != "array":
        label("Planes", _AXES)
        changed, on = imgui.checkbox("along the patient's axes", tools.upright is not None)
        hint(_AXES)
        if changed:
            tools.reformat(on)
            view.refresh()
    if tools.comparison is not None:
        _comparison(view, tools, tools.comparison)
    if view.slices.segmentation is not None:
        _labels(view, view.slices.segmentation)
    if tools.comparison is not None and view.document.state.marks is not None:
        _landmarks(view, tools, view.document.state.marks)


def _comparison(view: View, tools: VolumeTools, known: Comparison) -> None:
    if not section(view, "Compare"):
        return
    tip = f"{MODES[known.mode]}. X goes on to the next way"
    mode = choice("Fixed", known.mode, {name: name for name in MODES}, tip)
    if mode != known.mode:
        tools.compare(mode)
        view.refresh()
    if known.mode in SHARES:
        _, said, tip, low, high, form = SHARES[known.mode]
        share = slider(said, known.shares[known.mode], low, high, form, tip)
        if share != known.shares[known.mode]:
            known.shares[known.mode] = share
            view.refresh()


def _labels(view: View, known: Segmentation) -> None:
    if not section(view, "Labels", f"Labels ({len(known.labels)})"):
        return
    opacity = slider("Opacity", known.opacity, 0.0, 1.0, tip="Of labels over the planes; 0 for none")
    if opacity != known.opacity:
        known.opacity = opacity
        view.refresh()
    size = imgui.get_frame_height()
    for i in rows(view, "labels", len(known.labels), _MOST):
        number = known.labels[i]
        if eye(number in known.hidden):
            known.hidden ^= {number}
            view.refresh()
        red, green, blue = known.shades[i][:3].tolist()
        imgui.color_button("##colour", (red, green, blue, 1.0), imgui.ColorEditFlags_.no_tooltip, (size, size))
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text(f"{number}  {known.colours.names.get(number, '')}".rstrip())


def _landmarks(view: View, tools: VolumeTools, marks: Landmarks) -> None:
    if not section(view, "Landmarks", f"Landmarks ({len(marks.names)})" if marks.names else "Landmarks"):
        return
    document = view.document
    if button("Set a pair (L)", tip=_SET, on=tools.marking):
        tools.press("l")
    residuals, before = marks.residuals(document.deformation), marks.residuals(document.base)
    pairs = marks.pairs
    if pairs:
        now, then = residuals[pairs], before[pairs]
        wrapped(f"Residuals: mean {now.mean():.2f} mm, largest {now.max():.2f} mm; before strokes {then.mean():.2f} mm")
    if marks.names:
        _list(view, tools, marks, residuals, before)
    tip = "One stroke with the radius of the brush, by which each point ends at the fixed one"
    if button("Pull them together", tip=tip, enabled=bool(pairs)):
        view.attempt(partial(_pull, view, tools, marks))
    if marks.names and button("Save landmarks \u2026"):
        view.commands.ask("save landmarks")


def _list(view: View, tools: VolumeTools, marks: Landmarks, residuals: np.ndarray, before: np.ndarray) -> None:
    for i in rows(view, "landmarks", len(marks.names), _MOST):
        name = marks.names[i]
        if icon_button("remove", theme.CROSS, "Remove it"):
            view.attempt(partial(view.document.mark, marks.without(i), f"Remove landmark {name}"))
        imgui.same_line()
        whole = bool(np.isfinite(residuals[i]))
        said = f"{residuals[i]:.2f} mm" if whole else "one point"
        with imgui_ctx.push_style_color(imgui.Col_.text, imgui.ImVec4(*(theme.TEXT if whole else theme.FAINT))):
            at = imgui.get_content_region_avail().x - imgui.calc_text_size(said).x
            if entry(f"{name}##landmark", False, max(at - 8, 20)):
                where = marks.moved(view.document.deformation)[i]
                tools.sight = tools.sight.at(tuple(where if np.isfinite(where[0]) else marks.fixed[i]), tools.sizes)
                view.refresh()
            hint(f"{before[i]:.2f} mm before strokes; click to go there" if whole else "Click to go there")
            imgui.same_line()
            imgui.align_text_to_frame_padding()
            imgui.text(said)


def _pull(view: View, tools: VolumeTools, marks: Landmarks) -> None:
    """Pull the points of all pairs to the fixed ones, as one stroke."""
    document = view.document
    stroke = marks.pull(document.deformation, tools.next_stroke)
    document.begin_drag()
    if document.preview(stroke):
        document.commit()
        return
    trouble = document.trouble
    document.abandon()
    view.commands.message = trouble or ""
