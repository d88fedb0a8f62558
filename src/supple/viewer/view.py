"""The window itself: events in, pictures out; all that is edited is a document."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.screen import Screen, composed, pixels_of
from supple.errors import SuppleError
from supple.media import image
from supple.strokes import Recipe
from supple.viewer import overlay, panels
from supple.viewer.certify import Certifier
from supple.viewer.document import Document
from supple.viewer.files import Desk
from supple.viewer.gui import Gui
from supple.viewer.interrupts import unbroken
from supple.viewer.painter import Painter, Shot
from supple.viewer.redraw import Waking
from supple.viewer.stages import ImageStage, VideoStage, VolumeStage
from supple.viewer.tools import ImageTools, VideoTools, VolumeTools

SETTLED = 0.15  # seconds without a change, after which a picture is drawn in full
FILLING = 0.004
PATIENCE = 5.0  # seconds that what is saved waits for the frames it is made of


class View:
    """A medium in a window, and the strokes that are drawn on it.

    Parameters
    ----------
    stage : ImageStage, VideoStage or VolumeStage
    document : Document
    tools : ImageTools, VideoTools or VolumeTools
    canvas : rendercanvas canvas
    gpu : Gpu
    source : Path, optional
        The file, for autosave and export.
    export : mapping, optional
        What else `supple.warp_file` takes to make what is seen.
    call_later : function
        Of seconds and a function, which runs then in the canvas's loop.
    """

    def __init__(
        self,
        stage: ImageStage | VideoStage | VolumeStage,
        document: Document,
        tools: ImageTools | VideoTools | VolumeTools,
        canvas: Any,
        gpu: Gpu,
        *,
        source: Path | None = None,
        export: Mapping[str, Any] | None = None,
        call_later: Callable[[float, Callable[[], None]], Any] = lambda seconds, work: None,
    ) -> None:
        self.stage, self.document, self.tools, self.canvas, self.gpu = stage, document, tools, canvas, gpu
        self.overlay = ""
        self.listed: int | None = None
        self.typed: dict[str, float] = {}
        """Numbers that are being typed in the panel."""
        self.filled = 0.0
        self.painter = Painter(gpu, stage)
        self._waking = Waking(canvas, call_later)
        self.desk = Desk(document, source, self.write, self._leave, "auto", export)
        self.certifier = Certifier(self._waking.now)
        self._closed = False
        self._pressed = 0.0
        self._call_later = call_later
        self._changed_at = 0.0
        self._drawn_key: tuple[Any, ...] | None = None
        self._textures: tuple[Any, Any] | None = None
        self._laid = (0.0, 0.0, 0.0)
        self._frames: deque[float] = deque(maxlen=30)
        self._callbacks: list[Callable[[Recipe], None]] = []
        self._told: Recipe | None = None
        context = canvas.get_wgpu_context()
        self._format = context.get_preferred_format(gpu.device.adapter)
        context.configure(device=gpu.device, format=self._format)
        self._context, self._screen = context, Screen(gpu, self._format)
        self._gui = Gui(gpu, canvas, self._format, self._controls)
        document.on_change.append(self._changed)
        canvas.add_event_handler(self._stir, *_HANDS, "char", order=-100)
        canvas.add_event_handler(self._event, *_HANDS, "pointer_leave", "close")
        canvas.request_draw(self.draw)

    @property
    def recipe(self) -> Recipe:
        """The edit history."""
        return self.document.recipe

    def on_change(self, call: Callable[[Recipe], None]) -> Callable[[Recipe], None]:
        """Call a function with the recipe whenever it changes; it can be used as a decorator."""
        if not self._callbacks:
            self._told = self.document.recipe
        self._callbacks.append(call)
        return call

    @property
    def logical(self) -> tuple[float, float]:
        """The canvas, in logical pixels."""
        width, height = self.canvas.get_logical_size()
        return max(float(width), 1.0), max(float(height), 1.0)

    @property
    def area(self) -> tuple[float, float]:
        """The part of it that the picture has, from the upper left corner."""
        width, height = self.logical
        below = panels.LINE + (panels.BAR if self.stage.kind == "video" else 0)
        return max(width - panels.WIDE, 64.0), max(height - below, 64.0)

    def refresh(self) -> None:
        """Draw anew, in full."""
        self._drawn_key = None
        if isinstance(self.tools, VolumeTools):
            self.tools.forget()
        self._waking.now()

    def attempt(self, work: Callable[[], object]) -> None:
        """Do what may be refused, and say so then."""
        self.desk.attempt(work)
        self._waking.now()

    def _changed(self) -> None:
        self._changed_at, self.filled = time.perf_counter(), 0.0
        self._tell()
        self._waking.now()

    def _tell(self) -> None:
        """Tell whoever wants to know of another recipe."""
        if not self._callbacks or (recipe := self.document.recipe) == self._told:
            return
        self._told = recipe
        for call in self._callbacks:
            try:
                call(recipe)
            except Exception as error:  # its own matter: the window goes on
                self.desk.message = " ".join(f"on_change: {type(error).__name__}: {error}".split())

    def _stir(self, event: dict[str, Any]) -> None:
        """See that an event is answered, though the panel may keep it to itself."""
        kind = event["event_type"]
        if kind == "pointer_move" and not self._inside(event):
            self.tools.handle({"event_type": "pointer_leave"})
        if kind in ("pointer_down", "pointer_up") and event.get("button") not in _BUTTONS:
            event["stop_propagation"] = True  # the panel knows no others
        elif kind in ("pointer_down", "wheel") and self._inside(event) and self.desk.asked is None:
            self._gui.release()
        self._waking.stir()

    def _inside(self, event: dict[str, Any]) -> bool:
        """Return whether it is on the picture."""
        return bool(event.get("x", 0) < self.area[0] and event.get("y", 0) < self.area[1])

    @unbroken()
    def _event(self, event: dict[str, Any]) -> None:
        kind = event["event_type"]
        if kind == "close":
            self.close()
            return
        if self.desk.asked is not None and kind not in ("pointer_up", "key_up"):  # these end what was begun
            self._waking.now()
            return
        if kind in ("pointer_down", "wheel") and not self._inside(event):
            self._waking.now()
            return
        if kind == "pointer_down":
            self.desk.message = ""
            self._pressed = event.get("time_stamp", 0.0)
        elif kind == "pointer_move" and event.get("time_stamp", self._pressed) < self._pressed:
            return  # browsers hold moves back, and hand them over after a press that came later
        before = self.tools.view
        self.tools.handle(event)
        if self.tools.view is not before:
            self._changed_at = time.perf_counter()
        if kind == "pointer_up" and self.desk.message.startswith(_HOLDING):
            self.desk.message = ""
        requests, self.tools.requests[:] = list(self.tools.requests), []
        for request in requests:
            if self.tools.dragging:
                self.desk.message = f"{_HOLDING}: then {request}"
            else:
                self.desk.ask(request)
        self._waking.now()

    # What is drawn.

    @unbroken()
    def draw(self) -> None:
        """Draw a frame: what is asked for by the canvas."""
        if self._closed:
            return
        self.desk.tick()  # first: whatever comes, strokes are kept
        begun = time.perf_counter()
        self._frames.append(begun)
        tools, (width, height) = self.tools, self.area
        ratio = self.canvas.get_pixel_ratio()
        if self._laid != (width, height, ratio):
            self._laid = width, height, ratio
            tools.handle({"event_type": "resize", "width": width, "height": height, "pixel_ratio": ratio})
        if isinstance(tools, VideoTools):
            tools.playback.frame_at(begun)
        moving = tools.dragging or self._lately or self._playing or self._filling
        shot = self._shot((round(width * ratio), round(height * ratio)), ratio, moving)
        key = (shot.deformation, *(getattr(shot, name) for name in _SEEN), self.painter.coarse if moving else 0)
        self._gui.lay()
        if self._gui.trouble:
            self.desk.message = self._gui.trouble
        encoder, begun = self.gpu.device.create_command_encoder(), time.perf_counter()
        anew = key != self._drawn_key or not self.painter.ready
        if anew:
            with contextlib.suppress(SuppleError):
                self._textures = self.painter.paint(shot, encoder)
            self._drawn_key = key
        self._present(shot, encoder)
        if anew and moving:
            self.painter.learn(begun)
        self._go_on(shot)

    def _present(self, shot: Shot, encoder: Any) -> None:
        """Bring it all onto the canvas, at once."""
        onto = self._context.get_current_texture()
        colours = {"view": onto.create_view(), "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 1)}
        drawing = encoder.begin_render_pass(color_attachments=[colours])
        if self._textures is not None:
            place = (0, 0, *(min(a, b) for a, b in zip(shot.size, onto.size, strict=False)))
            self._screen.draw(drawing, *self._textures, self.tools.split or 0.0, place, self.painter.part)
        self._gui.draw(drawing)
        drawing.end()
        self.gpu.device.queue.submit([encoder.finish()])

    def _shot(self, size: tuple[int, int], ratio: float, moving: bool) -> Shot:
        tools = self.tools
        common: dict[str, Any] = {
            "size": size,
            "moving": moving,
            "original": tools.original,
            "split": tools.split is not None,
            "ratio": ratio,
            "overlay": self.overlay,
        }
        if isinstance(tools, VolumeTools):
            return Shot(self.document.deformation, camera=tools.camera, **common)
        viewport = tools.viewport
        first = viewport.to_image(0.5 / ratio, 0.5 / ratio)
        scale = 1.0 / (viewport.zoom * ratio)
        return Shot(self.document.deformation, origin=first, scale=scale, time=self.frame, **common)

    @property
    def frame(self) -> float:
        """The frame that is shown, of a clip."""
        return float(self.tools.playback.frame) if isinstance(self.tools, VideoTools) else 0.0

    @property
    def _playing(self) -> bool:
        return isinstance(self.tools, VideoTools) and self.tools.playback.playing

    @property
    def _filling(self) -> bool:
        """Return whether to wait for a volume's buffer before it is drawn in full, which takes seconds without it."""
        stage = self.stage
        if not (isinstance(stage, VolumeStage) and stage.mode == "hybrid" and self.gpu.software):
            return False
        return self.filled < 1.0 and not self.document.deformation.is_identity

    def _go_on(self, shot: Shot) -> None:
        """See that what is not done yet goes on."""
        if self._playing or not self.painter.ready:
            self._waking.now()
        elif self._lately:
            self._waking.later(max(self._changed_at + SETTLED - time.perf_counter(), 0.01))
        elif isinstance(self.stage, VolumeStage) and not self.tools.dragging:
            self._fill(shot)
        if (self.desk.export is not None and not self.desk.export.done) or self.document.dirty:
            self._waking.later(0.25)  # to see how far it is, and to keep what was done
        self._waking.answer()
        if self.desk.asked is not None:
            self._waking.later(0.25)  # where one writes, a line blinks

    def _fill(self, shot: Shot) -> None:
        waiting, before = self._filling, self.filled
        assert isinstance(self.stage, VolumeStage)
        try:
            seconds = 10 * FILLING if waiting else FILLING
            self.filled = self.stage.fill(shot.deformation, shot.camera, shot.size, seconds)
        except SuppleError as error:
            self.filled, self.desk.message = 1.0, str(error)
        if before < self.filled or self.filled < 1.0:
            if not waiting:
                self._drawn_key = None  # each frame is faster than the last
            self._waking.now()

    @property
    def busy(self) -> bool:
        """Return whether frames are drawn one after the other, so that it matters how many."""
        return self.rate >= 1.5 and (self.tools.dragging or self._playing or self._filling or self._lately)

    @property
    def _lately(self) -> bool:
        """Return whether there was a change just now."""
        return time.perf_counter() - self._changed_at < SETTLED

    @property
    def rate(self) -> float:
        """Frames a second, lately."""
        if len(self._frames) < 2 or time.perf_counter() - self._frames[-1] > 1.0:
            return 0.0
        return (len(self._frames) - 1) / max(self._frames[-1] - self._frames[0], 1e-9)

    def _controls(self) -> None:
        panels.panel(self)
        overlay.draw(self)

    def write(self, path: str, force: bool) -> None:
        """Write the picture as it is on the canvas, drawn in full."""
        image.write(path, self.pixels(), force=force)

    def pixels(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return the picture that is seen, drawn in full: (rows, columns, 3) of sRGB.

        Raises
        ------
        SuppleError
            If frames that it is made of do not come.
        """
        ratio = self.canvas.get_pixel_ratio()
        width, height = self.area
        shot = self._shot((round(width * ratio), round(height * ratio)), ratio, False)
        first, second = self._whole(shot)
        seen = pixels_of(self.gpu, first)
        if second is not None:
            seen = composed(self.gpu, first, second, self.tools.split or 0.0)
        return np.ascontiguousarray(seen[..., :3])

    def _whole(self, shot: Shot) -> tuple[Any, Any]:
        """The textures of a shot once all that it needs is there."""
        self._drawn_key = None  # what is on the canvas is drawn over
        textures, stage = self.painter.paint(shot), self.stage
        if isinstance(stage, VideoStage):
            end = time.perf_counter() + PATIENCE
            while not self.painter.ready:
                if not stage.film.arrived(end - time.perf_counter()):
                    raise SuppleError("frames of it are not decoded yet: try it again in a moment")
                textures = self.painter.paint(shot)
            if stage.trouble:
                raise SuppleError(stage.trouble)
        return textures

    def drop(self, paths: list[str]) -> None:
        """Open a file that was dropped on the window: a recipe here, anything else in a window of its own."""
        if not paths:
            return
        if paths[0].lower().endswith(".json"):
            self.attempt(lambda: self.desk.open(paths[0]))
        else:
            self.attempt(lambda: self.desk.open_beside(paths[0]))

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.canvas._repr_mimebundle_(**options)

    def _leave(self) -> None:
        self._call_later(0, self.canvas.close)

    def close(self) -> None:
        """End what goes on here."""
        if self._closed:
            return
        self._closed = True
        self.certifier.close()
        self.desk.end()
        if isinstance(self.stage, VideoStage):
            self.stage.film.close()


_HOLDING = "let go of the stroke first"
_HANDS = ("pointer_down", "pointer_move", "pointer_up", "wheel", "key_down", "key_up", "resize")
_BUTTONS = range(1, 6)
_SEEN = ("size", "moving", "origin", "scale", "time", "camera", "overlay", "original", "split")
