"""The viewport: the position of an image on the canvas, zoomed and panned."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

from supple.viewer.tools.drags import Pair

CLOSEST = 64.0  # the largest size of an image pixel, in physical pixels of the screen
FARTHEST = 0.25  # the smallest zoom, relative to the one that fits, or to 100 % if that is less


@dataclass(frozen=True, slots=True)
class Viewport:
    """An image on a canvas, zoomed and panned.

    Points of the image are measured from the centre of its upper left pixel; those of the canvas are in logical pixels,
    from its upper left corner. The centre of the canvas is always over the image, which stays visible. The state is the
    zoom, and the point of the image in the centre of the canvas; without them, the image fits, after a change of size
    too.
    """

    image_size: tuple[int, int]  # width and height
    canvas_size: Pair
    pixel_ratio: float = 1.0  # physical pixels for each logical pixel
    held: tuple[float, Pair] | None = None

    def __post_init__(self) -> None:
        width, height = self.canvas_size
        # A minimized or unopened window has no size.
        object.__setattr__(self, "canvas_size", (max(1.0, float(width)), max(1.0, float(height))))
        if self.held is not None:
            low, high = self.limits
            zoom, centre = self.held
            x, y = (min(max(c, -0.5), n - 0.5) for c, n in zip(centre, self.image_size, strict=True))
            object.__setattr__(self, "held", (min(max(zoom, low), high), (x, y)))

    @property
    def zoom(self) -> float:
        """The logical pixels of the canvas for each pixel of the image."""
        return self._fit if self.held is None else self.held[0]

    @property
    def centre(self) -> Pair:
        """The point of the image in the centre of the canvas."""
        width, height = self.image_size
        return ((width - 1) / 2, (height - 1) / 2) if self.held is None else self.held[1]

    @property
    def percent(self) -> float:
        """The zoom in physical pixels of the screen: 100 is one to one."""
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
        """Return the point of the image under a point of the canvas; it may lie outside."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        return cx + (x - width / 2) / zoom, cy + (y - height / 2) / zoom

    def to_canvas(self, x: float, y: float) -> Pair:
        """Return the position of a point of the image on the canvas."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        return width / 2 + (x - cx) * zoom, height / 2 + (y - cy) * zoom

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point lies within the image."""
        return all(-0.5 <= p <= n - 0.5 for p, n in zip((x, y), self.image_size, strict=True))

    def fit(self) -> Self:
        """Return the viewport that shows the whole image, as large as it fits."""
        return replace(self, held=None)

    def actual(self) -> Self:
        """Return the viewport at 100 %: image pixels on the physical pixels of the screen."""
        middles = (n * self.pixel_ratio / 2 - 0.5 for n in self.canvas_size)
        x, y = (c - math.remainder(c - m, 1.0) for c, m in zip(self.centre, middles, strict=True))
        return replace(self, held=(1 / self.pixel_ratio, (x, y)))

    def zoom_about(self, x: float, y: float, factor: float) -> Self:
        """Return the viewport zoomed about a point of the canvas."""
        low, high = self.limits
        zoom = min(max(self.zoom * factor, low), high)
        if zoom == self.zoom:
            return self
        (px, py), (cx, cy), kept = self.to_image(x, y), self.centre, self.zoom / zoom
        return replace(self, held=(zoom, (px + (cx - px) * kept, py + (cy - py) * kept)))

    def pan(self, dx: float, dy: float) -> Self:
        """Return the viewport with the image moved by logical pixels."""
        if not (dx or dy):
            return self
        (cx, cy), zoom = self.centre, self.zoom
        return replace(self, held=(zoom, (cx - dx / zoom, cy - dy / zoom)))

    def resize(self, canvas_size: Pair, pixel_ratio: float | None = None) -> Self:
        """Return the viewport for another size of canvas: the centre stays in place, and a fitted image still fits."""
        return replace(self, canvas_size=canvas_size, pixel_ratio=pixel_ratio or self.pixel_ratio)
