"""The question of the window, above everything else."""

from __future__ import annotations

from imgui_bundle import imgui

from supple.viewer.panels import theme
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import primary, wrapped


def draw(view: View) -> None:
    """Draw the open question."""
    asked = view.commands.asked
    if asked is None:
        return
    if not imgui.is_popup_open(asked.title):
        imgui.open_popup(asked.title)
    width, height = view.logical
    imgui.set_next_window_pos((width / 2, height / 2), imgui.Cond_.always, (0.5, 0.5))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (16, 14))
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (16, 9))  # of the title
    shown = imgui.begin_popup_modal(asked.title, None, imgui.WindowFlags_.always_auto_resize)[0]
    imgui.pop_style_var(2)
    if not shown:
        return
    wide = max(min(460.0, width - 60), 80.0)
    wrapped(asked.text, wide, theme.TEXT)
    answer = ""
    if asked.path is not None:
        imgui.set_next_item_width(wide)
        if asked.fresh:
            imgui.set_keyboard_focus_here()
            imgui.get_io().clear_events_queue()  # drop input from before the question
            imgui.get_io().clear_input_keys()
        entered, asked.path = imgui.input_text("##path", asked.path, imgui.InputTextFlags_.enter_returns_true)
        if entered:
            answer = asked.choices[0]
    if not asked.fresh and imgui.is_key_pressed(imgui.Key.enter):
        answer = answer or asked.choices[0]  # for any focus of the keyboard
    asked.fresh = False
    if asked.problem:
        wrapped(asked.problem, wide, theme.WARNING)
    imgui.spacing()
    for k, label in enumerate(asked.offered):
        if k:
            imgui.same_line()
            if imgui.get_cursor_pos_x() + imgui.calc_text_size(label).x > width - 40:
                imgui.new_line()
        if primary(label, 0.0) if k == 0 else imgui.button(label, (0, 32)):
            answer = label
    if imgui.is_key_pressed(imgui.Key.escape) and "Cancel" in asked.choices:
        answer = "Cancel"
    if answer and view.commands.answer(answer):
        imgui.close_current_popup()
    imgui.end_popup()
