"""The view: a document on a canvas, for the overlays and the panel, and its images."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from imgui_bundle import imgui

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.gpu.memory import wait
from supple.gpu.plate import Sight
from supple.gpu.screen import ALL, PLAIN, Part, Screen, canvas_texture, composed
from supple.media import image
from supple.media.faces import Face
from supple.render.camera import Camera
from supple.space.freezing import Freeze
from supple.strokes import Recipe
from supple.viewer.document.background import Certifier
from supple.viewer.document.editing import Document
from supple.viewer.document.files import FileCommands
from supple.viewer.document.keyframes import Part as KeyPart
from supple.viewer.document.settings import keep_recent, settings
from supple.viewer.panels.slices import Slices, physical
from supple.viewer.panels.stages import ImageStage, VideoStage, VolumeStage, filled
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.drawing import Pair
from supple.viewer.tools.planes import RENDERED
from supple.viewer.tools.volumes import VolumeTools

_FIRST = 1 << 20  # the number of the first texture: font textures have low numbers
_OUTER = 0.5  # coefficients from the outermost ones to the edges of a texture, whose texels are at coefficients


class Veil:
    """Textures whose opacity is 1 - m at every coefficient of the freeze mask; a new mask renews them."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self.textures: dict[int, Any] = {}
        """Textures by the numbers under which ImGui knows them."""
        self._known: dict[int, tuple[Freeze, int, list[Pair]]] = {}  # with the ranges of what is not clear

    def draw(
        self,
        lines: imgui.ImDrawList,
        mask: Freeze,
        sizes: Sequence[int],
        seen: Callable[[tuple[float, ...]], Pair],
        colour: int,
        axes: tuple[int, int, int] = (2, 0, 1),
        index: int = 0,
    ) -> None:
        """Draw the veil over a picture, or over a plane of a volume.

        Sizes are samples along each axis, x first; ``seen`` returns where a point is on the canvas. The axes are the
        plane's normal, the one across it and the one down, and the index is its place along the normal.
        """
        normal, across, down = axes
        which = _FIRST + normal
        known = self._known.get(which)
        if known is None or known[:2] != (mask, index):
            known = self._known[which] = mask, index, self._upload(which, mask, axes, index)
        low, high = [0.0] * len(sizes), [0.0] * len(sizes)
        ends = [-0.5] * len(sizes), [n - 0.5 for n in sizes]
        for k in (across, down):
            low[k], high[k] = ends[0][k], ends[1][k]
            if mask.size[k] > 1:
                low[k] = mask.first[k] - mask.step[k] * _OUTER
                high[k] = mask.first[k] + mask.step[k] * (mask.size[k] - _OUTER)
        for k, (least, most) in zip((across, down), known[2], strict=True):
            ends[0][k], ends[1][k] = max(ends[0][k], least), min(ends[1][k], most)
        (a, b), (c, d) = (seen(tuple(end)) for end in ends)
        lines.push_clip_rect((min(a, c), min(b, d)), (max(a, c), max(b, d)), True)
        right, left = low.copy(), high.copy()
        right[across], left[across] = high[across], low[across]
        first, second, third, fourth = (seen(tuple(corner)) for corner in (low, right, high, left))
        lines.add_image_quad(imgui.ImTextureRef(which), first, second, third, fourth, col=colour)
        lines.pop_clip_rect()

    def _upload(self, which: int, mask: Freeze, axes: tuple[int, int, int], index: int) -> list[Pair]:
        normal, across, down = axes
        places: list[Any] = [
            np.zeros(1) if n == 1 else first + step * np.arange(1, n - 1)
            for n, first, step in zip(mask.size, mask.first, mask.step, strict=True)
        ]
        if mask.ndim == 3:
            places[normal] = np.array([float(index)])
        shade = mask.at(places)
        if mask.ndim == 3:
            shade = shade.squeeze(2 - normal)
        if down < across:
            shade = shade.T
        shade = np.pad(shade, 1, mode="edge")  # at its very edge, a texture repeats
        pixels = np.full((*shade.shape, 4), 255, np.uint8)
        pixels[..., 3] = np.rint(255 * (1 - np.clip(shade, 0, 1)))
        self.textures[which] = filled(self._gpu, self.textures.get(which), pixels)
        ranges: list[Pair] = []
        for axis, k in enumerate((across, down)):
            there = np.flatnonzero(pixels[..., 3].any(axis)) if mask.size[k] > 1 else np.array([-math.inf, math.inf])
            low, high = (there[0] - 1, there[-1] + 1) if there.size else (0, 0)
            ranges.append((mask.first[k] + mask.step[k] * low, mask.first[k] + mask.step[k] * high))
        return ranges


FRAME = 0.05  # seconds of a frame during a drag
COARSEST = 8
_HOME = Camera()


@dataclass(frozen=True, slots=True)
class Shot:
    """A request for an image."""

    deformation: Deformation
    base: Deformation  # the one that the result is compared with: of the original, or of a step of the history
    sight: Sight  # the part to draw, at full size, along the axes of the stored image; unsolved during a drag
    place: tuple[int, int, int, int] = (0, 0, 0, 0)  # left, top, columns and rows of its area, in physical pixels
    part: Part = ALL  # the part of the drawn image that covers the area
    camera: Camera = _HOME
    original: bool = False  # show the base
    split: bool = False  # show both
    ratio: float = 1.0  # physical pixels for each logical pixel


class Painter:
    """A painter of a stage."""

    def __init__(self, gpu: Gpu, stage: ImageStage | VolumeStage) -> None:
        self.gpu, self.stage = gpu, stage
        self.coarse = 4 if gpu.software and stage.kind != "image" else 1
        """The pixels of the canvas for each drawn one, along each side, during a drag."""
        self.ready = True  # whether the last image is complete
        self.part: Part = ALL  # the visible part of the textures
        self.format = PLAIN  # of the textures that the CPU draws
        self._textures: dict[tuple[int, tuple[int, int], str], Any] = {}
        self._begun = 0.0  # when the device got its work
        self._adapts = True  # whether fewer pixels take less time

    def paint(self, shot: Shot, encoder: Any = None) -> tuple[Any, Any]:
        """Draw a shot; return the texture of the result and, if the shot is split, that of its base.

        With an encoder, commands are recorded for its submission, except those that must run at once.
        """
        if shot.split:  # both need the same frames of a clip
            encoder = None
        before, self.ready = self.stage.trouble, True
        seen = (shot.base if shot.original else shot.deformation, shot.base)[: 1 + shot.split]
        if not isinstance(self.stage, VolumeStage):
            self.stage.expect(seen, shot.sight)
            self._adapts = self.stage.solves(seen, shot.sight)
            if not self._adapts:
                wait(self.gpu)  # until here, the device may draw the last image, while this one is warped
        self._begun = time.perf_counter()
        textures = [self._drawn(k, shot, deformation, encoder) for k, deformation in enumerate(seen)]
        # The status line, already laid out, shows the error.
        self.ready &= self.stage.trouble == before
        return textures[0], textures[1] if shot.split else None

    def learn(self) -> None:
        """Wait for the last image, and adapt the size of drawn pixels to its time, if that depends on the size."""
        if not self._adapts:
            return
        seconds = self.stage.drawn_in if isinstance(self.stage, VolumeStage) else None
        if seconds is None:
            wait(self.gpu)
            seconds = time.perf_counter() - self._begun
        if seconds > FRAME and self.coarse < COARSEST:
            self.coarse += 1
        elif self.coarse > 1 and seconds * (self.coarse / (self.coarse - 1)) ** 2 < 0.7 * FRAME:
            self.coarse -= 1

    def _drawn(self, k: int, shot: Shot, deformation: Deformation, encoder: Any) -> Any:
        stage, sight, coarse = self.stage, shot.sight, self.coarse if self._adapts and not shot.sight.solved else 1
        size = (max(1, -(-sight.size[0] // coarse)), max(1, -(-sight.size[1] // coarse)))
        by_cpu = stage.previews if isinstance(stage, VolumeStage) else not self._adapts
        key = k, size, self.format if by_cpu else PLAIN
        if key not in self._textures:
            if len(self._textures) >= 8:
                self._textures.clear()
            self._textures[key] = canvas_texture(self.gpu, *key[1:])
        texture = self._textures[key]
        if isinstance(stage, VolumeStage):
            moving = not sight.solved
            stage.draw(deformation, shot.camera, size, texture, int(shot.original or k), moving=moving)
            # A camera looks at the centre of the image, and fits the shorter side.
            pixel = min(sight.size) / min(size)
            width, height = (n / (m * pixel) for n, m in zip(sight.size, size, strict=True))
            self.part = 0.5 - 0.5 * width, 0.5 - 0.5 * height, width, 0.0, 0.0, height, 1.0, 0.0, 0.0
            return texture
        x, y = (n / (m * coarse) for n, m in zip(sight.size, size, strict=True))
        a, b, c, d, e, f, w, across, down = shot.part
        self.part = a * x, b * y, c * x, d * y, e * x, f * y, w, across, down
        # The centre of a coarse pixel lies between those of the fine ones that it covers.
        inset = 0.5 * (coarse - 1) * sight.scale
        (x, y), scale = sight.origin, sight.scale * coarse
        sight = replace(sight, origin=(x + inset, y + inset), scale=scale, size=size, square=sight.square / coarse)
        self.ready &= stage.draw(deformation, sight, texture, encoder)
        return texture


WIDE, STRIP = 348, 44  # logical pixels of the tools and the panel, and of the tools alone
TOP, BAR, LANE, LINE = 24, 44, 62, 24  # and of the menu, the timeline, the keys below it, and the status line
SETTLED = 0.15  # seconds without a change, after which an image is drawn at full size
COMPUTING = "computing \u2026"
SLOW = 0.5  # seconds of waiting for a frame of a clip, after which the status line says so
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

    def __post_init__(self) -> None:
        self.overlay = ""  # one of `supple.gpu.plate.OVERLAYS`
        self.brush, self.own = self.tools.brush, False  # the last one; whether the selected stroke's numbers are seen
        self.listed: dict[str, int | None] = {}  # the rows to which lists have scrolled
        self.faces: tuple[Face, ...] | str | None = None  # of the picture, or why there are none; None at first
        self.face = 0  # the index of the face whose sliders are shown
        self.moved_face: tuple[int | None, Face] | None = None  # its stroke's index, and landmarks before the stroke
        known = settings() if self.source is None else keep_recent(self.source)
        self.sections = known.sections  # whether a section is open, if it was folded or opened
        self.recent = known.recent[self.source is not None :]  # other files
        self.veil_colour, self.hinted = known.veil, known.hinted
        self.copy_text: Callable[[str], None] | None = None  # to the clipboard, if there is one
        self.typed: dict[str, float] = {}  # numbers being typed in the panel
        self.held_key: tuple[int, KeyPart] | None = None  # the frame of the key that is dragged, and which part of it
        self.filled = 0.0
        self.computing = False  # whether the image is left to the next frame, since it takes long
        self.painter, self.veil = Painter(self.gpu, self.stage), Veil(self.gpu)
        self.slices: Slices | None = None
        if isinstance(self.stage, VolumeStage):
            labels = bool(getattr(self.export.get("volume"), "labels", False))
            self.slices = Slices(self.gpu, self.stage, labels)
        leave = partial(self.call_later, 0, self.canvas.close)
        self.commands = FileCommands(self.document, self.source, self.write, leave, self.export)
        self.certifier = Certifier(self.canvas.request_draw)
        self._changed_at = 0.0
        self.ready_at = time.perf_counter()  # when an image was last complete
        self._drawn_key: tuple[Shot, int] | None = None
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
        """The size of the image's area, at the left, below the menu."""
        width, height = self.logical
        return max(width - WIDE, 64.0), max(height - TOP - LINE - self.bar, 64.0)

    @property
    def bar(self) -> int:
        """The height of the timeline, and of the lane of keys, which strokes in time do not have."""
        return 0 if self.stage.kind != "video" else BAR if self.document.timed else BAR + LANE

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
        self._changed_at, self.filled = time.perf_counter(), 0.0
        before, self._content = self._content, self.document.state.content
        if self._content != before and not self.document.dragging:
            self.commands.message = ""  # it was about the state before
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
        tools, document, ratio = self.tools, self.document, self.canvas.get_pixel_ratio()
        document.seek(round(self.frame))
        (width, height), top = (round(n * ratio) for n in self.area), round(TOP * ratio)
        lines = self.overlay == "grid" and not document.timed  # the module `overlay` draws these lines
        overlay, square = "" if lines else self.overlay, 8.0 * ratio
        first, scale, size, part = (0.0, 0.0), 1.0, (width, height), ALL
        place, camera = (0, top, width, height), _HOME
        if isinstance(tools, VolumeTools):
            hidden = (0.0, 0.0, 1.0, 1.0)  # a hidden rendering is drawn at the size of a pixel
            place = physical(tools.places.get(RENDERED, hidden), ratio, (width, top + height))
            size, camera = place[2:], tools.stage.placed(tools.view)
        else:
            first, scale, size, part = tools.view.drawn(size, ratio)
        sight = Sight(first, scale, size, self.frame, solved=not moving, overlay=overlay, square=square)
        split = tools.split is not None
        return Shot(document.deformation, document.base, sight, place, part, camera, tools.original, split, ratio)

    @property
    def frame(self) -> float:
        """The displayed frame of a clip."""
        return float(self.tools.playback.frame) if isinstance(self.tools, VideoTools) else 0.0

    @property
    def seeking(self) -> bool:
        """Return whether the displayed frame of a clip has been awaited for longer than `SLOW`."""
        waits = isinstance(self.stage, VideoStage) and not self.painter.ready
        return waits and time.perf_counter() - self.ready_at > SLOW

    @property
    def _playing(self) -> bool:
        return isinstance(self.tools, VideoTools) and self.tools.playback.playing

    @property
    def refining(self) -> bool:
        """Return whether to wait for a volume's buffer before drawing at full size, which is slow without it."""
        slow = isinstance(self.stage, VolumeStage) and self.stage.previews
        filling = self.filled < 1.0 and not self.tools.original  # the buffer is the result's
        return slow and filling and not self.document.deformation.is_identity

    @property
    def _lately(self) -> bool:
        return time.perf_counter() - self._changed_at < SETTLED

    def write(self, path: str, force: bool) -> None:
        """Write the image of the canvas, drawn at full size."""
        image.write(path, self.pixels(), force=force)

    def pixels(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return the visible image, drawn at full size: (rows, columns, 3) of sRGB.

        SuppleError if its frames are not decoded in time.
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
        tools, slices = self.tools, self.slices
        top = round(TOP * shot.ratio)
        size = round(self.area[0] * shot.ratio), top + round(self.area[1] * shot.ratio)

        def draw(drawing: Any) -> None:
            if not isinstance(tools, VolumeTools) or RENDERED in tools.places:
                screen = Screen(self.gpu, PLAIN)
                screen.draw(drawing, first, second, tools.split or 0.0, shot.place, self.painter.part)
            if slices is not None and isinstance(tools, VolumeTools):
                slices.update(tools)
                slices.draw(drawing, PLAIN, tools, shot.ratio, size)

        return np.ascontiguousarray(composed(self.gpu, size, draw)[top:, :, :3])
