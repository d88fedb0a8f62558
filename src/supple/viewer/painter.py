"""Pictures of a stage as large as the canvas, or smaller while a hand moves and the device is slow."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from supple.camera import Camera
from supple.deformation import Deformation
from supple.gpu.device import Gpu
from supple.gpu.plate import Sight
from supple.gpu.screen import canvas_texture
from supple.viewer.stages import ImageStage, VideoStage, VolumeStage

FRAME = 0.05  # seconds that a frame may take while a hand moves
COARSEST = 8


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What is to be seen.

    Parameters
    ----------
    deformation : Deformation
    size : (int, int)
        Columns and rows of the part of the canvas, in physical pixels.
    moving : bool
        Whether a hand moves: a smaller picture will do.
    origin, scale
        Where the first physical pixel lies in the picture, and how far it is from one to the next, in its pixels.
    time : float
        The frame.
    camera : Camera
        Of a volume.
    overlay : str
        One of `supple.gpu.plate.OVERLAYS`.
    original : bool
        Whether to show what it was.
    split : bool
        Whether to show both.
    """

    deformation: Deformation
    size: tuple[int, int]
    moving: bool = False
    origin: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    time: float = 0.0
    camera: Camera = field(default_factory=Camera)
    overlay: str = ""
    original: bool = False
    split: bool = False


class Painter:
    """Paints a stage.

    Parameters
    ----------
    gpu : Gpu
    stage : ImageStage, VideoStage or VolumeStage
    """

    def __init__(self, gpu: Gpu, stage: ImageStage | VideoStage | VolumeStage) -> None:
        self.gpu, self.stage = gpu, stage
        self.coarse = 4 if gpu.software else 1
        """How many pixels of the canvas one that is drawn covers, along each side, while a hand moves."""
        self.ready = True
        """Whether all that the last picture needs was there."""
        self._textures: dict[tuple[str, tuple[int, int]], Any] = {}
        self._untouched: Deformation | None = None

    def paint(self, shot: Shot) -> tuple[Any, Any]:
        """Draw a shot; return the texture of what is seen and, if the shot is split, that of what was."""
        coarse = self.coarse if shot.moving else 1
        size = (max(1, -(-shot.size[0] // coarse)), max(1, -(-shot.size[1] // coarse)))
        begun = time.perf_counter()
        first = self._drawn("first", shot, size, coarse, original=shot.original)
        second = self._drawn("second", shot, size, coarse, original=True) if shot.split else None
        if shot.moving:
            self._wait(first)
            self._learn(time.perf_counter() - begun)
        return first, second

    def _drawn(self, name: str, shot: Shot, size: tuple[int, int], coarse: int, *, original: bool) -> Any:
        texture = self._texture(name, size)
        stage = self.stage
        deformation = self._plain(shot.deformation) if original else shot.deformation
        if isinstance(stage, VolumeStage):
            stage.draw(deformation, shot.camera, size, texture)
            self.ready = True
            return texture
        # The middle of a coarse pixel lies between those of the fine ones that it covers.
        inset = 0.5 * (coarse - 1) * shot.scale
        sight = Sight(
            (shot.origin[0] + inset, shot.origin[1] + inset),
            shot.scale * coarse,
            size,
            shot.time,
            solved=not shot.moving,
            overlay=shot.overlay,
        )
        self.ready = stage.draw(deformation, sight, texture)
        return texture

    def _plain(self, deformation: Deformation) -> Deformation:
        if self._untouched is None:
            domain = deformation.domain
            self._untouched = Deformation(domain.shape, border=domain.border, spacing=domain.spacing)
        return self._untouched

    def _texture(self, name: str, size: tuple[int, int]) -> Any:
        key = (name, size)
        if key not in self._textures:
            if len(self._textures) >= 8:
                self._textures.clear()
            self._textures[key] = canvas_texture(self.gpu, size)
        return self._textures[key]

    def _wait(self, texture: Any) -> None:
        self.gpu.device.queue.read_texture({"texture": texture}, {"bytes_per_row": 4, "rows_per_image": 1}, (1, 1, 1))

    def _learn(self, seconds: float) -> None:
        """Draw larger pixels where a frame took too long, and smaller ones where there is time to spare."""
        if seconds > FRAME and self.coarse < COARSEST:
            self.coarse += 1
        elif self.coarse > 1 and seconds * (self.coarse / (self.coarse - 1)) ** 2 < 0.7 * FRAME:
            self.coarse -= 1
