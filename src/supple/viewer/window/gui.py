"""Dear ImGui on a canvas: its events, its layout, and its drawing."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from imgui_bundle import imgui
from wgpu.utils.imgui import ImguiRenderer, ImguiWgpuBackend

from supple.gpu.device import Gpu
from supple.viewer.panels import theme

_BOUND = "__imgui_bind_group"


class _Layer:
    """A context of Dear ImGui, what was laid out in it last, and what draws that."""

    def __init__(self, backend: ImguiWgpuBackend, work: Callable[[], None]) -> None:
        self._context, self._work, self.backend = imgui.get_current_context(), work, backend
        self._laid = time.perf_counter()
        self.data: Any = None
        # ImGui closes open scopes after an error, and the window survives.
        io = backend.io
        io.config_error_recovery_enable_assert = False
        io.config_error_recovery_enable_tooltip = False

    def lay(self, size: tuple[float, float], ratio: float) -> str:
        """Lay it out, for a canvas of a logical size; return the error, or an empty text."""
        imgui.set_current_context(self._context)
        io = self.backend.io
        io.display_size, io.display_framebuffer_scale = imgui.ImVec2(*size), imgui.ImVec2(ratio, ratio)
        now = time.perf_counter()
        io.delta_time, self._laid = max(now - self._laid, 1e-4), now
        imgui.new_frame()
        trouble = ""
        try:
            self._work()
        except Exception as error:  # any error: strokes may be unsaved
            trouble = " ".join(f"{type(error).__name__}: {error}".split())
        finally:
            imgui.render()
        self.data = imgui.get_draw_data()
        return trouble


class Gui:
    """Controls and marks on a canvas, laid out by functions, drawn in the canvas's format, with the canvas's events.

    The marks lie on the picture, below the controls, and are laid out for each frame. They have no events, and a
    context of their own. Both draw with textures of letters, and with pictures by their numbers.
    """

    def __init__(
        self,
        gpu: Gpu,
        canvas: Any,
        format: str,
        controls: Callable[[], None],
        marks: Callable[[], None],
        pictures: Mapping[int, Any],
    ) -> None:
        self._canvas, self._pictures, self._shown = canvas, pictures, dict[int, Any]()
        self._renderer = ImguiRenderer(gpu.device, canvas, format)
        self.trouble = ""  # the error of the last layout
        backend = self._renderer.backend
        theme.apply(backend.io)
        self._controls = _Layer(backend, controls)
        context = imgui.create_context(backend.io.fonts)
        imgui.set_current_context(context)
        own = ImguiWgpuBackend(gpu.device, format)
        own._textures, own._texture_views = backend._textures, backend._texture_views
        theme.style()
        self._marks = _Layer(own, marks)
        imgui.set_current_context(self._renderer.imgui_context)

    def release(self) -> None:
        """Pass the next event on, whatever was under the pointer in the last frame."""
        imgui.set_current_context(self._renderer.imgui_context)
        if not imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
            self._renderer.backend.io.want_capture_mouse = False

    def lay(self, *, all: bool) -> None:
        """Lay out the marks, and the controls if all is to be."""
        size, ratio = self._canvas.get_logical_size(), self._canvas.get_pixel_ratio()
        trouble = self._controls.lay(size, ratio) if all else ""  # first: the letters are theirs
        self.trouble = trouble or self._marks.lay(size, ratio)
        imgui.set_current_context(self._renderer.imgui_context)

    def draw(self, drawing: Any) -> None:
        """Draw what is laid out into a render pass."""
        backend = self._renderer.backend
        views = backend._texture_views
        for which in self._shown.keys() - self._pictures.keys():
            del self._shown[which], views[which]
        for which, texture in self._pictures.items():
            if self._shown.get(which) is not texture:
                self._shown[which] = texture
                views[which] = texture.create_view()
        for view in views.values():
            # wgpu would make one for each draw: it keeps them by a name that Python changes, and never finds them.
            if not hasattr(view, _BOUND):
                entry = {"binding": 0, "resource": view}
                layout = backend._texture_bind_group_layout
                setattr(view, _BOUND, backend._device.create_bind_group(layout=layout, entries=[entry]))
        for layer in (self._marks, self._controls):
            layer.backend.render(layer.data, drawing)
