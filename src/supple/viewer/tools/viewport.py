"""The viewport: the position of an image on the canvas, zoomed and panned."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Self

from supple.viewer.tools.drawing import Pair

CLOSEST = 64.0  # the largest size of an image pixel, in physical pixels of the screen
FARTHEST = 0.25  # the smallest zoom, relative to the one that fits, or to 100 % if that is less
_MOST = 8192  # columns or rows that are drawn: those of any device

Turn = tuple[float, float, float, float]
"""A map of displacements in an image to those that are shown: x from x and from y, and y from x and from y."""
UPRIGHT: Turn = (1.0, 0.0, 0.0, 1.0)
Part = tuple[float, float, float, float, float, float]
"""A part of what is drawn, as `supple.gpu.screen.Part`."""


def turn_of(rotation: float, aspect: Fraction | None = None, *, mirrored: bool = False) -> Turn:
    """Return the map to an image as it is shown: mirrored left to right, and then turned counterclockwise, by quarters.

    The aspect is the width of a stored pixel, relative to its height.
    """
    quarters = round(rotation / 90) % 4
    cosine, sine = (1.0, 0.0, -1.0, 0.0)[quarters], (0.0, 1.0, 0.0, -1.0)[quarters]
    wide = float(aspect or 1) * (-1 if mirrored else 1)
    return wide * cosine, sine, -wide * sine, cosine


@dataclass(frozen=True, slots=True)
class Viewport:
    """An image on a canvas, turned as it is shown, zoomed and panned.

    Points of the image, as it is stored, are measured from the centre of its upper left pixel; those of the canvas are
    in logical pixels, from the upper left corner of the window: the canvas begins `top` below that. The centre of the
    canvas is always over the image, which stays visible. The state is the zoom, and the point of the image in the
    centre of the canvas; without them, the image fits, after a change of size too.
    """

    image_size: tuple[int, int]  # width and height
    canvas_size: Pair
    pixel_ratio: float = 1.0  # physical pixels for each logical pixel
    turn: Turn = UPRIGHT
    held: tuple[float, Pair] | None = None
    top: float = 0.0

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
        """The logical pixels of the canvas for each pixel of the image, where `stretch` is 1."""
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
    def stretch(self) -> Pair:
        """The extent of a pixel of the image as it is shown, to the right and down: 1 where pixels are square."""
        a, b, c, d = self.turn
        return math.hypot(a, b), math.hypot(c, d)

    @property
    def _fit(self) -> float:
        (width, height), (columns, rows), (a, b, c, d) = self.canvas_size, self.image_size, map(abs, self.turn)
        return min(width / (a * columns + b * rows), height / (c * columns + d * rows))

    def to_image(self, x: float, y: float) -> Pair:
        """Return the point of the image under a point of the canvas; it may lie outside."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        dx, dy = self._back((x - width / 2) / zoom, (y - self.top - height / 2) / zoom)
        return cx + dx, cy + dy

    def to_canvas(self, x: float, y: float) -> Pair:
        """Return the position of a point of the image on the canvas."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        dx, dy = self._shown(x - cx, y - cy)
        return width / 2 + dx * zoom, self.top + height / 2 + dy * zoom

    def _shown(self, x: float, y: float) -> Pair:
        """Return a displacement in the image as it is shown."""
        a, b, c, d = self.turn
        return a * x + b * y, c * x + d * y

    def _back(self, x: float, y: float) -> Pair:
        """Return the displacement in the image that is shown as this one."""
        a, b, c, d = self.turn
        size = a * d - b * c
        return (d * x - b * y) / size, (a * y - c * x) / size

    def drawn(self, size: tuple[int, int], ratio: float) -> tuple[Pair, float, tuple[int, int], Part]:
        """Return what is drawn of the image, along its axes, for a canvas of physical pixels; it is as fine as these.

        That is the point of the image at the first sample, the step to the next, columns and rows, and the canvas in
        fractions of them: its upper left corner, and its sides across and down, x and y of each.
        """
        width, height = (n / ratio for n in size)
        inset = 0.5 / ratio
        below = self.top + height
        ys = (self.top + inset, below - inset)
        ends = [self.to_image(x, y) for x in (inset, width - inset) for y in ys]
        origin, far = (tuple(map(of, *ends)) for of in (min, max))
        extent = far[0] - origin[0], far[1] - origin[1]
        scale = max(1.0 / (self.zoom * ratio * max(self.stretch)), max(extent) / (_MOST - 1))
        columns, rows = (math.ceil(e / scale - 1e-3) + 1 for e in extent)

        def within(x: float, y: float) -> Pair:
            p, q = self.to_image(x, y)
            return ((p - origin[0]) / scale + 0.5) / columns, ((q - origin[1]) / scale + 0.5) / rows

        (x, y), (a, b), (c, d) = (within(*at) for at in ((0.0, self.top), (width, self.top), (0.0, below)))
        return origin, scale, (columns, rows), (x, y, a - x, b - y, c - x, d - y)

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point lies within the image."""
        return all(-0.5 <= p <= n - 0.5 for p, n in zip((x, y), self.image_size, strict=True))

    def fit(self) -> Self:
        """Return the viewport that shows the whole image, as large as it fits."""
        return replace(self, held=None)

    def actual(self) -> Self:
        """Return the viewport at 100 %: image pixels on the physical pixels of the screen."""
        middles, corner = (n * self.pixel_ratio / 2 for n in self.canvas_size), (c + 0.5 for c in self.centre)
        x, y = self._back(*(c - math.remainder(c - m, 1.0) for c, m in zip(self._shown(*corner), middles, strict=True)))
        return replace(self, held=(1 / self.pixel_ratio, (x - 0.5, y - 0.5)))

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
        x, y = self._back(dx / zoom, dy / zoom)
        return replace(self, held=(zoom, (cx - x, cy - y)))

    def resize(self, canvas_size: Pair, pixel_ratio: float | None = None, top: float = 0.0) -> Self:
        """Return the viewport for another size of canvas: the centre stays in place, and a fitted image still fits."""
        return replace(self, canvas_size=canvas_size, pixel_ratio=pixel_ratio or self.pixel_ratio, top=top)
