"""The window: Dear ImGui on a canvas, events, frames and their scheduling; signals close it between frames."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from imgui_bundle import imgui
from wgpu.utils.imgui import ImguiRenderer, ImguiWgpuBackend, imgui_backend

from supple.errors import SuppleError, facing
from supple.gpu.device import Gpu
from supple.gpu.screen import SWAPPED, Screen, covers
from supple.viewer.document.words import WINDOW
from supple.viewer.panels import actions, overlay, panel, theme
from supple.viewer.panels.stages import VideoStage, VolumeStage
from supple.viewer.panels.view import SETTLED, TOP, Shot, View
from supple.viewer.tools.brushes import VideoTools
from supple.viewer.tools.planes import RENDERED
from supple.viewer.tools.volumes import VolumeTools

_BOUND = "__imgui_bind_group"


@contextlib.contextmanager
def _without_gamma() -> Iterator[None]:
    """Let backends of ImGui draw without a gamma, which is 1 here: where no GPU draws, powers take most of the time."""
    text = imgui_backend.FRAGMENT_SHADER_SRC
    imgui_backend.FRAGMENT_SHADER_SRC = text.replace("pow(color.rgb, vec3<f32>(uniforms.gamma))", "color.rgb")
    try:
        yield
    finally:
        imgui_backend.FRAGMENT_SHADER_SRC = text


class _Layer:
    """A context of Dear ImGui, its last layout, and the backend that draws it."""

    def __init__(self, backend: ImguiWgpuBackend, work: Callable[[], None]) -> None:
        self._context, self._work, self.backend = imgui.get_current_context(), work, backend
        self._laid = time.perf_counter()
        self.data: Any = None
        # ImGui closes open scopes after an error, and the window survives.
        io = backend.io
        io.config_error_recovery_enable_assert = False
        io.config_error_recovery_enable_tooltip = False

    def lay(self, size: tuple[float, float], ratio: float) -> str:
        """Run the layout for a canvas of a logical size; return the error, or an empty text."""
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
    context of their own. Both draw with the same font textures, and with ``pictures``, textures by their numbers.
    """

    @_without_gamma()
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

    def close_lists(self, kept: int) -> bool:
        """Close menus and lists until ``kept`` popups are left; return whether there were more."""
        imgui.set_current_context(self._renderer.imgui_context)
        more = len(self._renderer.imgui_context.open_popup_stack) > kept
        if more:
            imgui.internal.close_popup_to_level(kept, True)
        return more

    def lay(self, *, all: bool) -> None:
        """Lay out the marks and, with ``all``, the controls."""
        size, ratio = self._canvas.get_logical_size(), self._canvas.get_pixel_ratio()
        trouble = self._controls.lay(size, ratio) if all else ""  # first: they own the font textures
        self.trouble = trouble or self._marks.lay(size, ratio)
        imgui.set_current_context(self._renderer.imgui_context)

    def draw(self, drawing: Any, *, all: bool) -> None:
        """Draw the marks and, with ``all``, the controls into a render pass."""
        backend = self._renderer.backend
        views = backend._texture_views
        for which in self._shown.keys() - self._pictures.keys():
            del self._shown[which], views[which]
        for which, texture in self._pictures.items():
            if self._shown.get(which) is not texture:
                self._shown[which] = texture
                views[which] = texture.create_view()
        for view in views.values():
            # wgpu's backend would make a bind group for each draw: it looks for a cached one under a name that Python
            # has mangled, and never finds it.
            if not hasattr(view, _BOUND):
                entry = {"binding": 0, "resource": view}
                layout = backend._texture_bind_group_layout
                setattr(view, _BOUND, backend._device.create_bind_group(layout=layout, entries=[entry]))
        for layer in (self._marks, self._controls) if all else (self._marks,):
            layer.backend.render(layer.data, drawing)

    def copy(self, encoder: Any, source: Any, to: Any) -> None:
        """Copy what the windows of the controls cover from a texture to another one, both of the canvas's size."""
        ratio, size = self._canvas.get_pixel_ratio(), to.size
        for window in self._renderer.imgui_context.windows:
            if window.active and not window.hidden and window.parent_window is None:
                low, high = window.pos, window.pos + window.size
                left, top = max(int(low.x * ratio), 0), max(int(low.y * ratio), 0)
                columns = min(math.ceil(high.x * ratio), size[0]) - left
                rows = min(math.ceil(high.y * ratio), size[1]) - top
                if min(columns, rows) > 0:
                    places = ({"texture": texture, "origin": (left, top, 0)} for texture in (source, to))
                    encoder.copy_texture_to_texture(*places, (columns, rows, 1))


FILLING = 0.004  # seconds of each frame for filling a volume's buffer
ANSWERED = 0.1  # seconds after an event until a panel has reacted
FOLLOWED = 0.2  # seconds after which the controls follow a drag
HINTED = 0.3  # seconds after an event until a panel shows a hint under a resting pointer
_ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
HINTS = 4  # frames for a hint: it is measured in its first frame, and visible in the next


class Waking:
    """A scheduler of a canvas's frames, at once or later, by the timer of its loop."""

    def __init__(self, canvas: Any, call_later: Callable[[float, Callable[[], None]], Any]) -> None:
        self._canvas, self._call_later = canvas, call_later
        self._stirred, self._due = -math.inf, math.inf
        self._hints = 0  # frames that are left for a hint

    def later(self, seconds: float) -> None:
        """Schedule a frame after some seconds, if none is due earlier."""
        due = time.perf_counter() + seconds
        if due < self._due:
            self._due = due
            self._call_later(seconds, self._woken)

    def stir(self) -> None:
        """Schedule some frames for an event: a panel reacts in the second or the third."""
        self._stirred, self._hints = time.perf_counter(), HINTS
        self._canvas.request_draw()

    def answer(self) -> None:
        """Schedule the remaining frames of an event, after a frame."""
        since = time.perf_counter() - self._stirred
        if since < ANSWERED:
            self._canvas.request_draw()
        elif since < HINTED:
            self.later(HINTED - since)
        elif self._hints > 0:
            self._hints -= 1
            self._canvas.request_draw()

    def _woken(self) -> None:
        self._due = math.inf
        self._canvas.request_draw()


@contextlib.contextmanager
def unbroken() -> Iterator[None]:
    """Delay Ctrl+C and termination until the end of a frame, which needs its canvas; errors name the controls."""
    with facing(WINDOW), _held((signal.SIGINT, *_ENDS), lambda: None):
        yield


@contextlib.contextmanager
def closed_by_signals(loop: Any) -> Iterator[None]:
    """Close the windows of a loop on a termination signal, whose own handler is called afterwards."""
    # rendercanvas handles Ctrl+C only, and logs exceptions raised in a frame.
    with _held(_ENDS, loop.stop):
        yield


@contextlib.contextmanager
def _held(numbers: tuple[int, ...], heard: Callable[[], None]) -> Iterator[None]:
    """Call ``heard`` at once for signals that have a handler, and the handler when the block has ended."""
    main = threading.current_thread() is threading.main_thread()
    before = {n: handler for n in numbers if main and callable(handler := signal.getsignal(n))}
    came: dict[int, Any] = {}

    def hear(number: int, frame: Any) -> None:
        came[number] = frame
        heard()

    for number in before:
        signal.signal(number, hear)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number, frame in came.items():
            before[number](number, frame)


class Window(View):
    """A view in a window, with the parameters of `View`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        canvas, device = self.canvas, self.gpu.device
        self._waking = Waking(canvas, self.call_later)
        self._closed = False
        self._pressed = 0.0
        self._textures: tuple[Any, Any] | None = None
        self._laid = (0.0, 0.0, 0.0)
        self._followed = -math.inf  # when the controls were laid out
        self._kept: Any = None  # in a drag, what the controls looked like then: a texture
        self._titled = ""
        self._typing = False  # whether the character of a key may follow
        self._context = canvas.get_wgpu_context()
        # sRGB goes to the screen as it is: a conversion to linear light and back would cost each pixel two powers.
        presented = self._context.get_preferred_format(device.adapter).removesuffix("-srgb")
        self._context.configure(device=device, format=presented, usage="RENDER_ATTACHMENT|COPY_SRC|COPY_DST")
        if presented == SWAPPED:
            self.painter.format = SWAPPED
        self._screen = Screen(self.gpu, presented)
        self._gui = Gui(self.gpu, canvas, presented, self._controls, lambda: overlay.draw(self), self.veil.textures)
        canvas.add_event_handler(self._stir, *_HANDS, "char", order=-100)
        canvas.add_event_handler(self._event, *_HANDS, "char", "pointer_leave", "close")
        canvas.request_draw(self.draw)

    def _stir(self, event: dict[str, Any]) -> None:
        """Schedule frames for an event, even if the panel consumes it."""
        kind = event["event_type"]
        if kind == "key_down" and event.get("key") == "Escape":  # closes a list first, and then a question
            event["stop_propagation"] = self._gui.close_lists(int(self.commands.asked is not None))
        if kind == "pointer_move" and not self._inside(event):
            self.tools.handle({"event_type": "pointer_leave"})
        if kind in ("pointer_down", "pointer_up") and event.get("button") not in range(1, 6):
            event["stop_propagation"] = True  # the panel knows no others
        elif kind in ("pointer_down", "wheel") and self._inside(event) and self.commands.asked is None:
            self._gui.release()
        self._waking.stir()

    def _inside(self, event: dict[str, Any]) -> bool:
        return bool(event.get("x", 0) < self.area[0] and TOP <= event.get("y", 0) < TOP + self.area[1])

    @unbroken()
    def _event(self, event: dict[str, Any]) -> None:
        kind = event["event_type"]
        if kind == "close":
            self.close()
            return
        if kind == "resize":  # the next frame tells the tools, whose area is smaller than the canvas
            self.canvas.request_draw()
            return
        if self.commands.asked is not None and kind not in ("pointer_up", "key_up"):  # these end a gesture
            self.canvas.request_draw()
            return
        if kind in ("pointer_down", "wheel") and not self._inside(event):
            self.canvas.request_draw()
            return
        if kind == "char":  # in some toolkits, only these events depend on the layout of the keyboard
            typing, self._typing = self._typing, False  # a key that is held repeats its character
            if typing and event.get("data") == "?":
                self.tools.press("?")
                self.canvas.request_draw()
            return
        if kind == "key_down":
            self._typing = True
            if event.get("key") == "?":
                return
        if kind == "pointer_down":
            self.commands.message = ""
            self._pressed = event.get("time_stamp", 0.0)
        elif kind == "pointer_move" and event.get("time_stamp", self._pressed) < self._pressed:
            return  # browsers delay moves, and may deliver them after a later press
        before = self.tools.view
        self.tools.handle(event)
        if kind == "pointer_move" and self.tools.held is None and not self._inside(event):
            self.tools.handle({"event_type": "pointer_leave"})  # in one move onto the panel
        if self.tools.view is not before:
            self._changed_at = time.perf_counter()
        if kind == "pointer_up" and self.commands.message.startswith(_HOLDING):
            self.commands.message = ""
        requests, self.tools.requests[:] = list(self.tools.requests), []
        for request in requests:
            if self.tools.dragging:
                self.commands.message = f"{_HOLDING}: then {request}"
            else:
                self.commands.ask(request)
        self.canvas.request_draw()

    @unbroken()
    def draw(self) -> None:
        """Draw a frame on the canvas's request."""
        if self._closed:
            return
        self.commands.tick()  # first: autosave before any error
        self._title()
        begun = time.perf_counter()
        if self.painter.ready:
            self.ready_at = begun
        tools, (width, height) = self.tools, self.area
        ratio = self.canvas.get_pixel_ratio()
        if self._laid != (width, height, ratio):
            self._laid, self._kept = (width, height, ratio), None
            size = {"width": width, "height": height, "top": TOP, "pixel_ratio": ratio}
            tools.handle({"event_type": "resize", **size})
        if isinstance(tools, VideoTools):
            tools.playback.frame_at(begun)
        moving = tools.dragging or self._lately or self._playing or self.refining
        shot = self._shot(moving)
        key = shot, self.painter.coarse if moving else 0
        anew = key != self._drawn_key or not self.painter.ready
        bent = shot.base if shot.original else shot.deformation
        slow = anew and isinstance(self.stage, VolumeStage) and self.stage.is_slow(bent)
        rests = slow and tools.dragging and self._lately  # the image waits until the pointer rests
        self.computing = slow and not rests and not self.computing
        if not tools.dragging or not self._lately or self.computing or begun > self._followed + FOLLOWED:
            self._followed, self._kept = begun, None
        self._gui.lay(all=self._kept is None)
        if self._gui.trouble:
            self.commands.message = self._gui.trouble
        encoder = self.gpu.device.create_command_encoder()
        anew = anew and not rests and not self.computing
        if anew:
            with contextlib.suppress(SuppleError):
                self._textures = self.painter.paint(shot, encoder)
            self._drawn_key = key
        if slow and anew and isinstance(tools, VolumeTools):
            tools.forget()  # another point is under the pointer now
        self._present(shot, encoder)
        if anew and moving:
            self.painter.learn()
        self._go_on(shot)

    def _title(self) -> None:
        unsaved = "\u25cf " if self.document.dirty else ""
        title = f"{unsaved}{self.stage.name} - Supple"
        if title != self._titled:
            self._titled = title
            self.canvas.set_title(title)

    def _present(self, shot: Shot, encoder: Any) -> None:
        onto = self._context.get_current_texture()
        colours = {"view": onto.create_view(), "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 1)}
        drawing = encoder.begin_render_pass(color_attachments=[colours])
        if self._textures is not None and (not isinstance(self.tools, VolumeTools) or RENDERED in self.tools.places):
            left, top, columns, rows = shot.place
            place = (left, top, min(columns, onto.size[0] - left), min(rows, onto.size[1] - top))
            first, second = self._textures
            if second is None and first.format == onto.format and covers(first, place[2:], self.painter.part):
                drawing.end()  # a software GPU copies in a tenth of the time of a shader
                there = {"texture": onto, "origin": (left, top, 0)}
                encoder.copy_texture_to_texture({"texture": first}, there, first.size)
                drawing = encoder.begin_render_pass(color_attachments=[colours | {"load_op": "load"}])
            elif min(place[2:]) > 0:  # a canvas may have shrunk since
                self._screen.draw(drawing, first, second, self.tools.split or 0.0, place, self.painter.part)
        if self.slices is not None and isinstance(self.tools, VolumeTools):
            self.slices.draw(drawing, onto.format, self.tools, shot.ratio, onto.size[:2])
        self._gui.draw(drawing, all=self._kept is None)
        drawing.end()
        if self._kept is not None:
            self._gui.copy(encoder, self._kept, onto)
        elif self.tools.dragging:
            self._kept = self.gpu.device.create_texture(size=onto.size, format=onto.format, usage="COPY_SRC|COPY_DST")
            self._gui.copy(encoder, onto, self._kept)
        self.gpu.device.queue.submit([encoder.finish()])

    def _go_on(self, shot: Shot) -> None:
        if self.computing or self._playing or not self.painter.ready:
            self.canvas.request_draw()
        elif self._lately:
            self._waking.later(max(self._changed_at + SETTLED - time.perf_counter(), 0.01))
        elif isinstance(self.stage, VolumeStage) and not self.tools.dragging and not shot.original:
            self._fill(shot)
        commands = self.commands
        busy = (commands.export is not None and not commands.export.done) or commands.following is not None
        if busy or (commands.autosave is not None and commands.autosave.due):
            self._waking.later(0.25)  # to show progress, and to autosave
        self._waking.answer()
        if self.commands.asked is not None or self.commands.choosing is not None:
            self._waking.later(0.25)  # a text cursor blinks, and a dialog of the system may be answered

    def _fill(self, shot: Shot) -> None:
        waiting, before = self.refining, self.filled
        assert isinstance(self.stage, VolumeStage)
        try:
            seconds = 10 * FILLING if waiting else FILLING
            self.filled = self.stage.fill(shot.deformation, seconds)
        except SuppleError as error:
            self.filled, self.commands.message = 1.0, str(error)
        if before < self.filled or self.filled < 1.0:
            if not waiting and self.filled == 1.0:
                self._drawn_key = None
            self.canvas.request_draw()

    def _controls(self) -> None:
        actions.menu(self)
        panel.panel(self)
        actions.strip(self)
        overlay.bars(self)
        panel.list_keys(self)

    def drop(self, paths: list[str]) -> None:
        """Open a file dropped on the window."""
        for path in paths[:1]:
            self.attempt(partial(self.commands.take, path))

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.canvas._repr_mimebundle_(**options)

    def close(self) -> None:
        """End the work of the window."""
        if self._closed:
            return
        self._closed = True
        self.commands.end()
        if isinstance(self.stage, VideoStage):
            self.stage.film.close()
        elif isinstance(self.stage, VolumeStage):
            self.stage.close()


_HOLDING = "let go of the stroke first"
_HANDS = ("pointer_down", "pointer_move", "pointer_up", "wheel", "key_down", "key_up", "resize")
