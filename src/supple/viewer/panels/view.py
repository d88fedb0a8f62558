"""The view: a document on a canvas, for the overlays and the panel, and its images."""

from __future__ import annotations

import contextlib
import json
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.gpu.screen import composed
from supple.media import image
from supple.media.files import replacing
from supple.render.labels import LabelColours
from supple.strokes import Recipe
from supple.viewer.document.background import Certifier
from supple.viewer.document.editing import Document
from supple.viewer.document.files import FileCommands
from supple.viewer.document.state import Landmarks
from supple.viewer.panels.painter import Painter, Shot
from supple.viewer.panels.slices import Slices, physical
from supple.viewer.panels.stages import ImageStage, VideoStage, VolumeStage
from supple.viewer.panels.veil import Veil
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.drags import MASKS
from supple.viewer.tools.planes import RENDERED
from supple.viewer.tools.volumes import VolumeTools

WIDE, STRIP = 348, 44  # logical pixels of the tools and the panel, and of the tools alone
BAR, LINE = 44, 24  # and of the timeline and the status line
SETTLED = 0.15  # seconds without a change, after which an image is drawn at full size
FROZEN = "frozen"
"""The name of the overlay of what is frozen."""
COMPUTING = "computing \u2026"
SLOW = 0.5  # seconds that a frame of a clip is waited for, after which that is said
PATIENCE = 5.0  # seconds that saving an image waits for its frames


@dataclass(eq=False, repr=False)
class View:
    """A medium in a window, and its strokes."""

    stage: ImageStage | VolumeStage
    document: Document
    tools: ImageTools | VolumeTools
    canvas: Any  # of rendercanvas
    gpu: Gpu
    source: Path | None  # the source file, for autosave and export
    export: Mapping[str, Any]  # other options of `supple.warp_file`, for the same image
    call_later: Callable[[float, Callable[[], None]], Any]  # calls a function in the canvas's loop, after seconds
    landmarks: Landmarks | None = None  # of a volume

    def __post_init__(self) -> None:
        self.overlay = ""  # one of `supple.gpu.plate.OVERLAYS`, or `FROZEN`
        self.listed: int | None = None  # the stroke that the list has scrolled to
        self.reached: int | None = None  # and the step of the history
        self.sections = read_sections()  # those that were folded or opened
        self.copy_text: Callable[[str], None] | None = None  # to the clipboard, if there is one
        self.typed: dict[str, float] = {}  # numbers being typed in the panel
        self.filled = 0.0
        self.computing = False  # whether the image comes after this frame, as it takes long
        self.painter, self.veil = Painter(self.gpu, self.stage), Veil(self.gpu)
        self.slices: Slices | None = None
        if isinstance(self.stage, VolumeStage):
            labels = bool(getattr(self.export.get("volume"), "labels", False))
            transfer = self.stage.scene.transfer
            colours = transfer if isinstance(transfer, LabelColours) else None
            self.slices = Slices(self.gpu, self.stage.volume, labels, self.stage.unit, colours)
        leave = partial(self.call_later, 0, self.canvas.close)
        self.commands = FileCommands(self.document, self.source, self.write, leave, self.export)
        self.certifier = Certifier(self.canvas.request_draw)
        self._changed_at = 0.0
        self.ready_at = time.perf_counter()  # when an image was last complete
        self._drawn_key: tuple[Shot, int] | None = None
        self._frames: deque[float] = deque(maxlen=30)
        self._callbacks: list[Callable[[Recipe], None]] = []
        self._told: Recipe | None = None
        self._content = self.document.state.content
        self.document.on_change.append(self._changed)

    @property
    def recipe(self) -> Recipe:
        """The recipe of the document."""
        return self.document.recipe

    def on_change(self, call: Callable[[Recipe], None]) -> Callable[[Recipe], None]:
        """Call a function with the recipe after each change; it can be used as a decorator."""
        if not self._callbacks:
            self._told = self.document.recipe
        self._callbacks.append(call)
        return call

    @property
    def logical(self) -> tuple[float, float]:
        """The size of the canvas, in logical pixels."""
        width, height = self.canvas.get_logical_size()
        return max(float(width), 1.0), max(float(height), 1.0)

    @property
    def area(self) -> tuple[float, float]:
        """The size of the image's area, at the upper left corner."""
        width, height = self.logical
        below = LINE + (BAR if self.stage.kind == "video" else 0)
        return max(width - WIDE, 64.0), max(height - below, 64.0)

    def refresh(self) -> None:
        """Draw again, at full size."""
        self._drawn_key = None
        if isinstance(self.tools, VolumeTools):
            self.tools.forget()
        self.canvas.request_draw()

    def attempt(self, work: Callable[[], object]) -> None:
        """Call a function, and show its error in the status line."""
        self.commands.attempt(work)
        self.canvas.request_draw()

    def _changed(self) -> None:
        """Draw again, and call the listeners for a new recipe."""
        self._changed_at, self.filled = time.perf_counter(), 0.0
        before, self._content = self._content, self.document.state.content
        if self._content != before and not self.document.dragging:
            self.commands.message = ""  # it was about what there was before
        self.canvas.request_draw()
        if not self._callbacks or (recipe := self.document.recipe) == self._told:
            return
        self._told = recipe
        for call in self._callbacks:
            try:
                call(recipe)
            except Exception as error:  # errors of listeners do not end the window
                self.commands.message = " ".join(f"on_change: {type(error).__name__}: {error}".split())

    def _shot(self, moving: bool) -> Shot:
        tools, ratio = self.tools, self.canvas.get_pixel_ratio()
        size = tuple(round(n * ratio) for n in self.area)
        common: dict[str, Any] = {"size": size, "place": (0, 0, *size), "moving": moving, "ratio": ratio}
        common["overlay"] = "" if self.overlay == FROZEN else self.overlay
        common |= {"base": self.document.base, "original": tools.original, "split": tools.split is not None}
        if isinstance(tools, VolumeTools):
            hidden = (0.0, 0.0, 1.0, 1.0)  # a pixel of it is drawn
            place = physical(tools.places.get(RENDERED, hidden), ratio, (size[0], size[1]))
            common |= {"size": place[2:], "place": place}
            return Shot(self.document.deformation, camera=tools.stage.placed(tools.view), **common)
        first, scale, common["size"], part = tools.view.drawn((size[0], size[1]), ratio)
        return Shot(self.document.deformation, origin=first, scale=scale, part=part, time=self.frame, **common)

    @property
    def frame(self) -> float:
        """The displayed frame of a clip."""
        return float(self.tools.playback.frame) if isinstance(self.tools, VideoTools) else 0.0

    @property
    def seeking(self) -> bool:
        """Return whether the displayed frame of a clip has been waited for for long."""
        waits = isinstance(self.stage, VideoStage) and not self.painter.ready
        return waits and time.perf_counter() - self.ready_at > SLOW

    @property
    def _playing(self) -> bool:
        return isinstance(self.tools, VideoTools) and self.tools.playback.playing

    @property
    def refining(self) -> bool:
        """Return whether to wait for a volume's buffer before drawing at full size, which is slow without it."""
        slow = isinstance(self.stage, VolumeStage) and self.stage.mode == "hybrid" and self.gpu.software
        filling = self.filled < 1.0 and not self.tools.original  # the buffer is the result's
        return slow and filling and not self.document.deformation.is_identity

    @property
    def busy(self) -> bool:
        """Return whether frames follow each other, so that their rate matters."""
        return self.rate >= 1.5 and (self.tools.dragging or self._playing or self.refining or self._lately)

    @property
    def _lately(self) -> bool:
        """Return whether there was a recent change."""
        return time.perf_counter() - self._changed_at < SETTLED

    @property
    def rate(self) -> float:
        """The recent frames a second."""
        if len(self._frames) < 2 or time.perf_counter() - self._frames[-1] > 1.0:
            return 0.0
        return (len(self._frames) - 1) / max(self._frames[-1] - self._frames[0], 1e-9)

    @property
    def veiled(self) -> bool:
        """Return whether what is frozen is tinted: while it is painted, and as an overlay; it is outlined otherwise."""
        return self.overlay == FROZEN or self.tools.brush in MASKS

    def write(self, path: str, force: bool) -> None:
        """Write the image of the canvas, drawn at full size."""
        image.write(path, self.pixels(), force=force)

    def pixels(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return the visible image, drawn at full size: (rows, columns, 3) of sRGB.

        Raises
        ------
        SuppleError
            If its frames are not decoded in time.
        """
        shot = self._shot(moving=False)
        self._drawn_key = None  # the canvas must be drawn again
        (first, second), stage = self.painter.paint(shot), self.stage
        if isinstance(stage, VideoStage):
            end = time.perf_counter() + PATIENCE
            while not self.painter.ready:
                if not stage.film.arrived(end - time.perf_counter()):
                    raise SuppleError("frames of it are not decoded yet: try it again in a moment")
                first, second = self.painter.paint(shot)
            if stage.trouble:
                raise SuppleError(stage.trouble)
        if self.slices is not None and isinstance(self.tools, VolumeTools):
            ratio = self.canvas.get_pixel_ratio()
            size = round(self.area[0] * ratio), round(self.area[1] * ratio)
            self.slices.update(self.tools)
            seen = self.slices.composed(self.tools, ratio, size, (first, second), self.painter.part)
            return np.ascontiguousarray(seen[..., :3])
        seen = composed(self.gpu, shot.place[2:], first, second, self.tools.split or 0.0, self.painter.part)
        return np.ascontiguousarray(seen[..., :3])


def _settings_file() -> Path:
    from platformdirs import user_config_path

    return user_config_path("supple", appauthor=False) / "window.json"


def read_sections() -> dict[str, bool]:
    """Return which sections are open, by their names; a file that is missing or broken says nothing."""
    with contextlib.suppress(OSError, ValueError, RecursionError, ImportError):
        data: Any = json.loads(_settings_file().read_text(encoding="utf-8"))
        known = data.get("sections") if isinstance(data, dict) else None
        if isinstance(known, dict):
            return {name: opened for name, opened in known.items() if isinstance(opened, bool)}
    return {}


def write_sections(sections: dict[str, bool]) -> None:
    """Keep which sections are open; a folder that cannot be written is ignored."""
    with contextlib.suppress(OSError, SuppleError, ImportError):
        place = _settings_file()
        place.parent.mkdir(parents=True, exist_ok=True)
        with replacing(place, force=True) as target:
            target.write_text(json.dumps({"sections": sections}, indent=1), encoding="utf-8")
