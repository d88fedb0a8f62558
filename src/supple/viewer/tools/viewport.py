"""The viewport: how a picture lies on the canvas, zoomed and panned."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

from supple.viewer.tools.gestures import Pair

CLOSEST = 64.0  # the largest that a pixel of the picture may be, in physical pixels of the screen
FARTHEST = 0.25  # the smallest that a picture may be, as a part of what fits, or of its own size where that is less


@dataclass(frozen=True, slots=True)
class Viewport:
    """A picture on a canvas, zoomed and panned.

    Points of the picture are counted from the middle of its upper left pixel; those of the canvas are in logical
    pixels, from its upper left corner. The middle of the canvas is always over the picture, so that it is never lost.
    What is held is the zoom, and the point of the picture in the middle of the canvas; without them, the picture fits,
    also when the canvas changes its size.
    """

    image_size: tuple[int, int]  # width and height
    canvas_size: Pair
    pixel_ratio: float = 1.0  # physical pixels along the side of a logical one
    held: tuple[float, Pair] | None = None

    def __post_init__(self) -> None:
        width, height = self.canvas_size
        # A window that is made small, or is not there yet, has no size.
        object.__setattr__(self, "canvas_size", (max(1.0, float(width)), max(1.0, float(height))))
        if self.held is not None:
            low, high = self.limits
            zoom, centre = self.held
            x, y = (min(max(c, -0.5), n - 0.5) for c, n in zip(centre, self.image_size, strict=True))
            object.__setattr__(self, "held", (min(max(zoom, low), high), (x, y)))

    @property
    def zoom(self) -> float:
        """Logical pixels of the canvas to a pixel of the picture."""
        return self._fit if self.held is None else self.held[0]

    @property
    def centre(self) -> Pair:
        """The point of the picture in the middle of the canvas."""
        width, height = self.image_size
        return ((width - 1) / 2, (height - 1) / 2) if self.held is None else self.held[1]

    @property
    def percent(self) -> float:
        """The zoom in physical pixels of the screen: 100 is one for one."""
        return 100 * self.zoom * self.pixel_ratio

    @property
    def limits(self) -> Pair:
        """The smallest and the largest zoom."""
        actual = 1 / self.pixel_ratio
        return FARTHEST * min(self._fit, actual), max(self._fit, CLOSEST * actual)

    @property
    def _fit(self) -> float:
        (width, height), (columns, rows) = self.canvas_size, self.image_size
        return min(width / columns, height / rows)

    def to_image(self, x: float, y: float) -> Pair:
        """The point of the picture under a point of the canvas; it may lie outside."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        return cx + (x - width / 2) / zoom, cy + (y - height / 2) / zoom

    def to_canvas(self, x: float, y: float) -> Pair:
        """Where a point of the picture lies on the canvas."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        return width / 2 + (x - cx) * zoom, height / 2 + (y - cy) * zoom

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point of the picture's plane lies within the picture."""
        return all(-0.5 <= p <= n - 0.5 for p, n in zip((x, y), self.image_size, strict=True))

    def fit(self) -> Self:
        """Show the whole picture, as large as it fits."""
        return replace(self, held=None)

    def actual(self) -> Self:
        """Show a pixel of the picture as one physical pixel of the screen: 100 %, and on its grid."""
        middles = (n * self.pixel_ratio / 2 - 0.5 for n in self.canvas_size)
        x, y = (c - math.remainder(c - m, 1.0) for c, m in zip(self.centre, middles, strict=True))
        return replace(self, held=(1 / self.pixel_ratio, (x, y)))

    def zoom_about(self, x: float, y: float, factor: float) -> Self:
        """Zoom, so that what is under a point of the canvas stays there."""
        low, high = self.limits
        zoom = min(max(self.zoom * factor, low), high)
        if zoom == self.zoom:
            return self
        (px, py), (cx, cy), kept = self.to_image(x, y), self.centre, self.zoom / zoom
        return replace(self, held=(zoom, (px + (cx - px) * kept, py + (cy - py) * kept)))

    def pan(self, dx: float, dy: float) -> Self:
        """Push the picture along the canvas, by logical pixels."""
        if not (dx or dy):
            return self
        (cx, cy), zoom = self.centre, self.zoom
        return replace(self, held=(zoom, (cx - dx / zoom, cy - dy / zoom)))

    def resize(self, canvas_size: Pair, pixel_ratio: float | None = None) -> Self:
        """Lay it on a canvas of another size: what was in the middle stays there, and what fitted still fits."""
        return replace(self, canvas_size=canvas_size, pixel_ratio=pixel_ratio or self.pixel_ratio)
