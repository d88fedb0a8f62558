"""Images of a stage at the size of the canvas, or smaller during a drag on a slow device."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

from supple.deformation import Deformation
from supple.gpu.device import Gpu
from supple.gpu.memory import wait
from supple.gpu.plate import Sight
from supple.gpu.screen import ALL, Part, canvas_texture
from supple.render.camera import Camera
from supple.viewer.panels.stages import ImageStage, VolumeStage

FRAME = 0.05  # seconds of a frame during a drag
COARSEST = 8
_HOME = Camera()


def _about_the_middle(seen: tuple[int, int], drawn: tuple[int, int]) -> Part:
    """Return the visible part of a volume's image: a camera looks at its centre, and fits the shorter side."""
    pixel = min(seen) / min(drawn)
    width, height = (n / (m * pixel) for n, m in zip(seen, drawn, strict=True))
    return 0.5 - 0.5 * width, 0.5 - 0.5 * height, width, 0.0, 0.0, height


@dataclass(frozen=True, slots=True)
class Shot:
    """A request for an image."""

    deformation: Deformation
    base: Deformation  # of what the result is compared with: the original, or a step of the history
    size: tuple[int, int]  # columns and rows of what is drawn, along the axes of the image as it is stored
    place: tuple[int, int, int, int] = (0, 0, 0, 0)  # left, top, columns and rows of its area, in physical pixels
    part: Part = ALL  # what is drawn, as it lies on that area
    moving: bool = False  # during a drag, a smaller image will do
    origin: tuple[float, float] = (0.0, 0.0)  # the position in the image of the first pixel that is drawn
    scale: float = 1.0  # the step to the next, in pixels of the image
    time: float = 0.0  # the frame
    camera: Camera = _HOME
    overlay: str = ""  # one of `supple.gpu.plate.OVERLAYS`
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
        self._textures: dict[tuple[int, tuple[int, int]], Any] = {}
        self._begun = 0.0  # when the device got its work
        self._adapts = True  # whether fewer pixels take less

    def paint(self, shot: Shot, encoder: Any = None) -> tuple[Any, Any]:
        """Draw a shot; return the texture of the result and, if the shot is split, that of its base.

        With an encoder, commands are recorded for its submission, except those that must run at once.
        """
        if shot.split:  # both need the same frames of a clip
            encoder = None
        before, self.ready = self.stage.trouble, True
        seen = (shot.base if shot.original else shot.deformation, shot.base)[: 1 + shot.split]
        sight = self._sight(shot)
        if not isinstance(self.stage, VolumeStage):
            self.stage.expect(seen, sight)
            self._adapts = self.stage.solves(sight)
            if not self._adapts:
                self.coarse = 1
                wait(self.gpu)  # until here, the device may draw the last image, while this one is warped
        self._begun = time.perf_counter()
        textures = [self._drawn(k, shot, sight, deformation, encoder) for k, deformation in enumerate(seen)]
        # The status line, already laid out, shows the error.
        self.ready &= self.stage.trouble == before
        return textures[0], textures[1] if shot.split else None

    def learn(self) -> None:
        """Wait for the last image, and adapt the size of drawn pixels to the device's time, where it depends on it."""
        if not self._adapts:
            return
        wait(self.gpu)
        seconds = time.perf_counter() - self._begun
        if seconds > FRAME and self.coarse < COARSEST:
            self.coarse += 1
        elif self.coarse > 1 and seconds * (self.coarse / (self.coarse - 1)) ** 2 < 0.7 * FRAME:
            self.coarse -= 1

    def _sight(self, shot: Shot) -> Sight:
        """Return the visible part, at full size."""
        return Sight(
            shot.origin,
            shot.scale,
            shot.size,
            shot.time,
            solved=not shot.moving,
            overlay=shot.overlay,
            square=8.0 * shot.ratio,
        )

    def _drawn(self, k: int, shot: Shot, sight: Sight, deformation: Deformation, encoder: Any) -> Any:
        stage, coarse = self.stage, self.coarse if shot.moving else 1
        size = (max(1, -(-shot.size[0] // coarse)), max(1, -(-shot.size[1] // coarse)))
        if (k, size) not in self._textures:
            if len(self._textures) >= 8:
                self._textures.clear()
            self._textures[k, size] = canvas_texture(self.gpu, size)
        texture = self._textures[k, size]
        if isinstance(stage, VolumeStage):
            stage.draw(deformation, shot.camera, size, texture, shot.overlay, int(shot.original or k))
            self.part = _about_the_middle(shot.size, size)
            return texture
        x, y = (n / (m * coarse) for n, m in zip(shot.size, size, strict=True))
        a, b, c, d, e, f = shot.part
        self.part = a * x, b * y, c * x, d * y, e * x, f * y
        # The centre of a coarse pixel lies between those of the fine ones that it covers.
        inset = 0.5 * (coarse - 1) * shot.scale
        (x, y), scale = shot.origin, shot.scale * coarse
        sight = replace(sight, origin=(x + inset, y + inset), scale=scale, size=size, square=sight.square / coarse)
        self.ready &= stage.draw(deformation, sight, texture, encoder)
        return texture
