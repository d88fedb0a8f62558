"""The panel and what lies over the picture, as Dear ImGui draws them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from typing import Any

from imgui_bundle import imgui
from wgpu.utils.imgui import ImguiRenderer

from supple.engines.wgpu.device import Gpu
from supple.viewer.imgui_renderer import Ink


class Gui:
    """Draws controls, and hands them the canvas's events.

    Parameters
    ----------
    gpu : Gpu
    canvas : rendercanvas canvas
    format : str
        Of what it presents.
    controls : function
        Says what there is, each time.
    """

    def __init__(self, gpu: Gpu, canvas: Any, format: str, controls: Callable[[], None]) -> None:
        self._canvas, self._controls = canvas, controls
        # Of this, what it does with events: it draws with a bind group more for each clip of each frame (wgpu 0.32).
        self._renderer = ImguiRenderer(gpu.device, canvas, format)
        self._ink = Ink(gpu, format)
        self.trouble = ""
        """The error of the last layout, if there was one."""
        io = self._renderer.backend.io
        # What was not ended, as something went wrong, is ended for us, and the window lives.
        io.config_error_recovery_enable_assert = False
        io.config_error_recovery_enable_tooltip = False
        _dress()

    def release(self) -> None:
        """Hand the next event on, whatever lay under the pointer when the last frame was drawn."""
        imgui.set_current_context(self._renderer.imgui_context)
        if not imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
            self._renderer.backend.io.want_capture_mouse = False

    def lay(self) -> None:
        """Find out what is to be drawn, and what is wanted with it."""
        imgui.set_current_context(self._renderer.imgui_context)
        ratio, io = self._canvas.get_pixel_ratio(), self._renderer.backend.io
        io.display_size = self._canvas.get_logical_size()
        io.display_framebuffer_scale = ratio, ratio
        imgui.new_frame()
        self.trouble = ""
        try:
            self._controls()
        except Exception as error:  # whatever it is: strokes may be unsaved
            self.trouble = " ".join(f"{type(error).__name__}: {error}".split())
        finally:
            imgui.render()

    def draw(self, drawing: Any) -> None:
        """Draw that into a render pass."""
        self._ink.draw(imgui.get_draw_data(), drawing)


def _dress() -> None:
    """Letters that can be read, and colours that do not glare."""
    io, style = imgui.get_io(), imgui.get_style()
    font = resources.files("imgui_bundle") / "assets" / "fonts" / "DroidSans.ttf"
    with resources.as_file(font) as path:
        if path.is_file():
            io.fonts.add_font_from_file_ttf(str(path), 15.0)
    style.set_color_(imgui.Col_.modal_window_dim_bg, (0.0, 0.0, 0.0, 0.45))
    style.set_color_(imgui.Col_.popup_bg, (0.12, 0.12, 0.13, 1.0))
    style.frame_rounding = style.grab_rounding = style.popup_rounding = 3.0
    style.item_spacing = imgui.ImVec2(7, 5)
