"""The window itself: events in, pictures out; all that is edited is a document."""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from imgui_bundle import imgui
from wgpu.utils.imgui import ImguiRenderer

from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.gpu.screen import Screen, pixels_of
from supple.media import image
from supple.media.files import check_output, replacing
from supple.strokes import Recipe
from supple.viewer import overlay, panels
from supple.viewer.autosave import Autosave
from supple.viewer.certify import Certifier
from supple.viewer.document import Document
from supple.viewer.exporting import Export
from supple.viewer.painter import Painter, Shot
from supple.viewer.stages import ImageStage, VideoStage, VolumeStage
from supple.viewer.tools import Tools

BAR, LINE = 44, 24  # logical pixels of the timeline and of the status line
SETTLED = 0.15  # seconds without a change, after which a picture is drawn in full
FILLING = 0.004


@dataclass(slots=True)
class Question:
    """Something that the window asks.

    Parameters
    ----------
    name : str
        What it is about.
    title, text : str
    choices : tuple of str
        The first one is what Enter means.
    path : str, optional
        The name of a file to be entered.
    """

    name: str
    title: str
    text: str
    choices: tuple[str, ...]
    path: str | None = None
    problem: str = ""
    fresh: bool = True


class View:
    """A medium in a window, and the strokes that are drawn on it.

    Parameters
    ----------
    stage : ImageStage, VideoStage or VolumeStage
    document : Document
    tools : Tools
    canvas : rendercanvas canvas
    gpu : Gpu
    source : Path, optional
        The file, for autosave and export.
    call_later : function
        Of seconds and a function, which runs then in the canvas's loop.
    """

    def __init__(
        self,
        stage: ImageStage | VideoStage | VolumeStage,
        document: Document,
        tools: Tools,
        canvas: Any,
        gpu: Gpu,
        *,
        source: Path | None = None,
        call_later: Callable[[float, Callable[[], None]], Any] = lambda seconds, work: None,
    ) -> None:
        self.stage, self.document, self.tools, self.canvas, self.gpu = stage, document, tools, canvas, gpu
        self.source = source
        self.overlay = ""
        self.filled = 0.0
        self.message = ""
        """What is said in the status line, until something else happens."""
        self.asked: Question | None = None
        self.export: Export | None = None
        self.painter = Painter(gpu, stage)
        self.autosave = Autosave(source) if source is not None else None
        self.certifier = Certifier(self._wake)
        self.recipe_path: Path | None = None
        self._call_later = call_later
        self._changed_at, self._drawn_key = 0.0, None
        self._textures: tuple[Any, Any] | None = None
        self._frames: deque[float] = deque(maxlen=30)
        self._callbacks: list[Callable[[Recipe], None]] = []
        self.python_seconds = 0.0
        """What the last frame took here, apart from the device."""
        context = canvas.get_wgpu_context()
        self._format = context.get_preferred_format(gpu.device.adapter)
        context.configure(device=gpu.device, format=self._format)
        self._context, self._screen = context, Screen(gpu, self._format)
        self._gui = ImguiRenderer(gpu.device, canvas, self._format)
        self._gui.set_gui(self._controls)
        self._gui.backend.io.set_ini_filename("")
        document.on_change.append(self._changed)
        canvas.add_event_handler(
            self._event, "pointer_down", "pointer_move", "pointer_up", "wheel", "key_down", "key_up", "resize", "close"
        )
        canvas.request_draw(self.draw)

    @property
    def recipe(self) -> Recipe:
        """What was done."""
        return self.document.recipe

    def on_change(self, call: Callable[[Recipe], None]) -> Callable[[Recipe], None]:
        """Call a function with the recipe whenever it changes; it can be used as a decorator."""
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
        below = LINE + (BAR if self.stage.kind == "video" else 0)
        return max(width - panels.WIDE, 64.0), max(height - below, 64.0)

    @property
    def longest(self) -> float:
        """The largest radius that the brush may have."""
        return float(max(n * s for n, s in zip(reversed(self.stage.shape), self.stage.spacing, strict=True)))

    def refresh(self) -> None:
        """Draw anew, in full."""
        self._drawn_key = None
        self._wake()

    def attempt(self, work: Callable[[], object]) -> None:
        """Do what may be refused, and say so then."""
        try:
            work()
            self.message = ""
        except SuppleError as error:
            self.message = str(error)
        self._wake()

    def _wake(self) -> None:
        self.canvas.request_draw()

    def _changed(self) -> None:
        self._changed_at = time.perf_counter()
        recipe = self.document.recipe
        if self.autosave is not None and not self.document.dragging:
            self.autosave.keep(recipe, time.monotonic(), dirty=self.document.dirty)
        for call in self._callbacks:
            call(recipe)
        self._wake()

    def _event(self, event: dict[str, Any]) -> None:
        kind = event["event_type"]
        if kind == "close":
            self.close()
            return
        if self.asked is not None:
            self._wake()
            return
        inside = event.get("x", 0) < self.area[0] and event.get("y", 0) < self.area[1]
        if kind in ("pointer_down", "wheel") and not inside:
            self._wake()
            return
        self.attempt_quietly(lambda: self.tools.handle(event))
        for request in self.tools.take_requests():
            self.ask(request)
        self._wake()

    def attempt_quietly(self, work: Callable[[], object]) -> None:
        """The same, but what was said before stays."""
        try:
            work()
        except SuppleError as error:
            self.message = str(error)

    # What is drawn.

    def draw(self) -> None:
        """Draw a frame: what is asked for by the canvas."""
        begun = time.perf_counter()
        self._frames.append(begun)
        tools, (width, height) = self.tools, self.area
        ratio = self.canvas.get_pixel_ratio()
        tools.resize((width, height), ratio)
        if tools.playback is not None and tools.playback.playing:
            tools.tick(begun)
        moving = tools.dragging or begun - self._changed_at < SETTLED or self._playing
        shot = self._shot((round(width * ratio), round(height * ratio)), ratio, moving)
        key = (shot.deformation, *(getattr(shot, name) for name in _SEEN), self.painter.coarse if moving else 0)
        waited = 0.0
        if key != self._drawn_key or not self.painter.ready:
            painting = time.perf_counter()
            with contextlib.suppress(SuppleError):
                self._textures = self.painter.paint(shot)
            waited = time.perf_counter() - painting
            self._drawn_key = key
        view = self._context.get_current_texture().create_view()
        if self._textures is not None:
            first, second = self._textures
            self._screen.present(view, first, second, tools.split or 0.0, (0, 0, *shot.size))
        self._gui.render()
        self.python_seconds = time.perf_counter() - begun - waited
        self._go_on(moving, shot)

    def _shot(self, size: tuple[int, int], ratio: float, moving: bool) -> Shot:
        tools = self.tools
        common: dict[str, Any] = {
            "size": size,
            "moving": moving,
            "original": tools.original,
            "split": tools.split is not None,
            "overlay": self.overlay,
        }
        if self.stage.kind == "volume":
            return Shot(self.document.deformation, camera=tools.camera, **common)
        viewport = tools.viewport
        first = viewport.to_image(0.5 / ratio, 0.5 / ratio)
        time_ = float(tools.frame) if self.stage.kind == "video" else 0.0
        return Shot(self.document.deformation, origin=first, scale=1.0 / (viewport.zoom * ratio), time=time_, **common)

    @property
    def _playing(self) -> bool:
        return self.tools.playback is not None and self.tools.playback.playing

    def _go_on(self, moving: bool, shot: Shot) -> None:
        """See that what is not done yet goes on."""
        if self._playing or not self.painter.ready:
            self._wake()
        elif moving:
            self._call_later(SETTLED, self._wake)
        elif isinstance(self.stage, VolumeStage):
            try:
                self.filled = self.stage.fill(shot.deformation, shot.camera, shot.size, FILLING)
            except SuppleError as error:
                self.message = str(error)
            if self.filled < 1.0:
                self._drawn_key = None  # each frame is faster than the last
                self._wake()
        if self.export is not None and not self.export.done:
            self._call_later(0.1, self._wake)

    @property
    def rate(self) -> float:
        """Frames a second, lately."""
        if len(self._frames) < 2 or time.perf_counter() - self._frames[-1] > 1.0:
            return 0.0
        return (len(self._frames) - 1) / max(self._frames[-1] - self._frames[0], 1e-9)

    def _controls(self) -> None:
        panels.panel(self)
        overlay.draw(self)

    # What is asked for.

    def ask(self, name: str) -> None:
        """Ask what a request needs: the name of a file, most often."""
        stem = self.source.with_suffix("") if self.source is not None else Path("picture")
        suffix = self.source.suffix if self.source is not None else ".png"
        known = os.fspath(self.recipe_path or f"{stem}.recipe.json")
        questions = {
            "save": ("Save the recipe", "What supple warp --recipe takes.", ("Save", "Cancel"), known),
            "open": ("Open a recipe", "In the place of the strokes there are; undo brings these back.", _OPEN, known),
            "export": ("Export", "At full quality, to any format of supple warp.", _EXPORT, f"{stem}-bent{suffix}"),
            "copy": (
                "Save what is seen",
                "The picture as it is on the canvas.",
                ("Save", "Cancel"),
                f"{stem}-view.png",
            ),
        }
        if name == "save" and self.recipe_path is not None:
            self.attempt(lambda: self.save(self.recipe_path or known, force=True))
        elif name in questions:
            title, text, choices, path = questions[name]
            self.asked = Question(name, title, text, choices, path)
        self._wake()

    def answer(self, choice: str) -> None:
        """Go on with what was asked."""
        asked = self.asked
        if asked is None:
            return
        try:
            if choice != "Cancel":
                self._do(asked, choice)
            self.asked = None
            imgui.close_current_popup()
        except SuppleError as error:
            asked.problem = str(error)
        self._wake()

    def _do(self, asked: Question, choice: str) -> None:
        path, force = asked.path or "", choice == "Replace"
        if asked.name == "restore":
            if choice == "Restore" and self.autosave is not None and self.autosave.found is not None:
                self.document.load(self.autosave.found)
        elif asked.name == "save":
            self.save(path, force=True)
        elif asked.name == "open":
            self.open(path)
        elif asked.name == "copy":
            self.copy(path, force=force)
        elif asked.name == "export":
            self.begin_export(path, force=force)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the recipe."""
        check_output(path, force=force)
        with replacing(path, force=force) as place:
            Path(place).write_text(self.document.recipe.to_json(), encoding="utf-8")
        self.recipe_path = Path(path)
        self.document.mark_saved()
        self.message = f"saved {path}"

    def open(self, path: str | os.PathLike[str]) -> None:
        """Read a recipe in the place of the strokes that there are, as one step."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise SuppleError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from None
        self.document.load(Recipe.from_json(text))
        self.message = f"opened {path}"

    def copy(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the picture as it is on the canvas."""
        image.write(path, self.pixels(), force=force)
        self.message = f"saved {path}"

    def pixels(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """What is seen, drawn in full: (rows, columns, 3) of sRGB."""
        ratio = self.canvas.get_pixel_ratio()
        width, height = self.area
        shot = self._shot((round(width * ratio), round(height * ratio)), ratio, False)
        first, _ = self.painter.paint(shot)
        return np.ascontiguousarray(pixels_of(self.gpu, first)[..., :3])

    def begin_export(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Begin to write the whole medium, bent, beside what goes on here."""
        if self.source is None:
            raise SuppleError("there is no file to export: Deformation.warp makes arrays of arrays")
        if self.export is not None and not self.export.done:
            raise SuppleError("an export is under way: cancel it, or wait for it")
        self.export = Export(self.source, path, self.document.recipe, force=force, on_progress=self._wake)

    def end_export(self) -> None:
        """Cancel it, or put it aside when it is done."""
        if self.export is not None and not self.export.done:
            self.export.cancel()
        else:
            self.export = None

    def close(self) -> None:
        """End cleanly: what was drawn and not saved is kept, and offered again."""
        self.certifier.close()
        if self.export is not None:
            self.export.cancel()
        if isinstance(self.stage, VideoStage):
            self.stage.film.close()
        if self.autosave is not None:
            if self.document.dirty:
                self.autosave.flush(self.document.recipe)
            else:
                self.autosave.clear()


_SEEN = ("size", "moving", "origin", "scale", "time", "camera", "overlay", "original", "split")
_OPEN, _EXPORT = ("Open", "Cancel"), ("Export", "Replace", "Cancel")
