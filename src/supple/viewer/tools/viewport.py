"""The viewport: the position of an image on the canvas, zoomed and panned."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Self

from supple.viewer.tools.drawing import Pair

CLOSEST = 64.0  # the largest size of an image pixel, in physical pixels of the screen
FARTHEST = 0.25  # the smallest zoom, relative to the one that fits, or to 100 % if that is less
_MOST = 8192  # the most columns or rows to draw: every device has textures of this size
_HORIZON = 1e-3  # the least depth that is shown in perspective; the depth of the middle is 1
_BESIDE = 2.0  # pixels beside a picture in perspective that are drawn

Turn = tuple[float, float, float, float]
"""A linear map from displacements in an image to those on screen: its matrix, row by row."""
UPRIGHT: Turn = (1.0, 0.0, 0.0, 1.0)
Part = tuple[float, float, float, float, float, float, float, float, float]
"""A part of a drawn image, as `supple.gpu.screen.Part`."""


def turn_of(rotation: float, aspect: Fraction | None = None, *, mirrored: bool = False) -> Turn:
    """Return the map to an image as it is shown: mirrored left to right, and then turned counterclockwise, by quarters.

    The aspect is the width of a stored pixel, relative to its height.
    """
    quarters = round(rotation / 90) % 4
    cosine, sine = (1.0, 0.0, -1.0, 0.0)[quarters], (0.0, 1.0, 0.0, -1.0)[quarters]
    wide = float(aspect or 1) * (-1 if mirrored else 1)
    return wide * cosine, sine, -wide * sine, cosine


@dataclass(frozen=True)
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
    vanishing: Pair = (0.0, 0.0)
    """Of a picture in perspective: at d pixels from its middle, it is shown at turn · d / (1 + vanishing · d)."""

    def __post_init__(self) -> None:
        width, height = self.canvas_size
        # A minimized or unopened window has no size.
        object.__setattr__(self, "canvas_size", (max(1.0, float(width)), max(1.0, float(height))))
        if self.held is not None:
            low, high = self.limits
            zoom, centre = self.held
            x, y = (min(max(c, -0.5), n - 0.5) for c, n in zip(centre, self.image_size, strict=True))
            object.__setattr__(self, "held", (min(max(zoom, low), high), (x, y)))

    @cached_property
    def zoom(self) -> float:
        """The logical pixels of the canvas for each pixel of the image, where `stretch` is 1."""
        return self._fit if self.held is None else self.held[0]

    @cached_property
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

    @cached_property
    def stretch(self) -> Pair:
        """The extent of a pixel of the image as it is shown, to the right and down: 1 where pixels are square."""
        a, b, c, d = self.turn
        return math.hypot(a, b), math.hypot(c, d)

    @cached_property
    def _fit(self) -> float:
        (width, height), (a, b, c, d), (g, h) = self.canvas_size, self.turn, self.vanishing
        x, y = (n / 2 for n in self.image_size)
        ends = [(p, q, 1 + g * p + h * q) for p in (-x, x) for q in (-y, y)]
        across, down = (max(abs(i * p + j * q) / w for p, q, w in ends) for i, j in ((a, b), (c, d)))
        return min(width / (2 * across), height / (2 * down))

    @cached_property
    def _near(self) -> tuple[Turn, Pair]:
        """The turn and the vanishing, relative to the centre of the canvas."""
        (a, b, c, d), (g, h) = self.turn, self.vanishing
        if not (g or h):
            return self.turn, self.vanishing
        x, y = (p - (n - 1) / 2 for p, n in zip(self.centre, self.image_size, strict=True))
        w = 1 + g * x + h * y
        u, v = (a * x + b * y) / w, (c * x + d * y) / w
        return ((a - u * g) / w, (b - u * h) / w, (c - v * g) / w, (d - v * h) / w), (g / w, h / w)

    @cached_property
    def matrix(self) -> tuple[tuple[float, float, float], ...]:
        """The homogeneous matrix from points of the image to those of the canvas."""
        ((a, b, c, d), (g, h)), zoom, (cx, cy) = self._near, self.zoom, self.centre
        x, y = self.canvas_size[0] / 2, self.top + self.canvas_size[1] / 2
        w = 1 - g * cx - h * cy
        rows = ((zoom * a + x * g, zoom * b + x * h), (zoom * c + y * g, zoom * d + y * h))
        ends = (x * w - zoom * (a * cx + b * cy), y * w - zoom * (c * cx + d * cy))
        return (*rows[0], ends[0]), (*rows[1], ends[1]), (g, h, w)

    def to_image(self, x: float, y: float) -> Pair:
        """Return the point of the image under a point of the canvas; it may lie outside."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        dx, dy, w = self._back((x - width / 2) / zoom, (y - self.top - height / 2) / zoom)
        w = max(w, _HORIZON)
        return cx + dx / w, cy + dy / w

    def to_canvas(self, x: float, y: float) -> Pair:
        """Return the position of a point of the image on the canvas."""
        (width, height), (cx, cy), zoom = self.canvas_size, self.centre, self.zoom
        dx, dy = self._shown(x - cx, y - cy)
        return width / 2 + dx * zoom, self.top + height / 2 + dy * zoom

    def _shown(self, x: float, y: float) -> Pair:
        """Return a displacement in the image, from the centre, as it is shown."""
        (a, b, c, d), (g, h) = self._near
        w = max(1 + g * x + h * y, _HORIZON)
        return (a * x + b * y) / w, (c * x + d * y) / w

    def _back(self, x: float, y: float) -> tuple[float, float, float]:
        """Return the displacement from the centre that is shown as this one: its numerators, and their divisor."""
        (a, b, c, d), (g, h) = self._near
        size = a * d - b * c
        p, q = (d * x - b * y) / size, (a * y - c * x) / size
        return p, q, 1 - g * p - h * q

    @lru_cache(maxsize=2)  # noqa: B019 - of the last views
    def drawn(self, size: tuple[int, int], ratio: float) -> tuple[Pair, float, tuple[int, int], Part]:
        """Return the part of the image to draw, along its axes, as fine as a canvas of ``size`` physical pixels.

        It is given by the point of the image at the first sample, the step from sample to sample, columns and rows, and
        the canvas in fractions of these, as a `supple.gpu.screen.Part`.
        """
        width, height = (n / ratio for n in size)
        inset = 0.5 / ratio
        below = self.top + height
        ys = (self.top + inset, below - inset)
        ends = [self.to_image(x, y) for x in (inset, width - inset) for y in ys]
        origin, far = (tuple(map(of, *ends)) for of in (min, max))
        fine = 1.0 / (self.zoom * ratio * max(self.stretch))
        if any(self.vanishing):  # what lies beyond the picture may be endless
            origin = tuple(max(p, -_BESIDE) for p in origin)
            far = tuple(min(p, n - 1 + _BESIDE) for p, n in zip(far, self.image_size, strict=True))
            fine *= min(self._depth(*end) for end in itertools.product(*zip(origin, far, strict=True)))
        extent = far[0] - origin[0], far[1] - origin[1]
        scale = max(fine, max(extent) / (_MOST - 1))
        columns, rows = (math.ceil(e / scale - 1e-3) + 1 for e in extent)

        def within(x: float, y: float) -> tuple[float, float, float]:
            (cx, cy), (p, q, w) = self.centre, self._back((x - width / 2) / self.zoom, (y - middle) / self.zoom)
            p, q = (cx - origin[0]) * w + p, (cy - origin[1]) * w + q
            return (p / scale + 0.5 * w) / columns, (q / scale + 0.5 * w) / rows, w

        middle = self.top + height / 2
        (x, y, w), (a, b, e), (c, d, f) = (within(*at) for at in ((0.0, self.top), (width, self.top), (0.0, below)))
        return origin, scale, (columns, rows), (x, y, a - x, b - y, c - x, d - y, w, e - w, f - w)

    def _depth(self, x: float, y: float) -> float:
        """Return the depth of a point of the image, at which it is shown so much smaller than the middle."""
        (g, h), (columns, rows) = self.vanishing, self.image_size
        return max(1 + g * (x - (columns - 1) / 2) + h * (y - (rows - 1) / 2), _HORIZON)

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point lies within the image."""
        return all(-0.5 <= p <= n - 0.5 for p, n in zip((x, y), self.image_size, strict=True))

    def fit(self) -> Self:
        """Return the viewport that shows the whole image, as large as it fits."""
        return replace(self, held=None)

    def actual(self) -> Self:
        """Return the viewport at 100 %: image pixels on the physical pixels of the screen."""
        middles, corner = (n * self.pixel_ratio / 2 for n in self.canvas_size), (c + 0.5 for c in self.centre)
        flat = replace(self, vanishing=(0.0, 0.0))
        seen = flat._shown(*corner)
        x, y, _ = flat._back(*(c - math.remainder(c - m, 1.0) for c, m in zip(seen, middles, strict=True)))
        return replace(self, held=(1 / self.pixel_ratio, (x - 0.5, y - 0.5)))

    def zoom_about(self, x: float, y: float, factor: float) -> Self:
        """Return the viewport zoomed about a point of the canvas."""
        low, high = self.limits
        zoom = min(max(self.zoom * factor, low), high)
        if zoom == self.zoom:
            return self
        width, height, kept = *self.canvas_size, self.zoom / zoom
        (px, py), (cx, cy) = self.to_image(x, y), self.centre
        centre = px + (cx - px) * kept, py + (cy - py) * kept
        if any(self.vanishing):
            middle = self.top + height / 2
            centre = self.to_image(x + (width / 2 - x) * kept, y + (middle - y) * kept)
        return replace(self, held=(zoom, centre))

    def pan(self, dx: float, dy: float) -> Self:
        """Return the viewport with the image moved by logical pixels."""
        if not (dx or dy):
            return self
        (cx, cy), zoom = self.centre, self.zoom
        x, y, w = self._back(-dx / zoom, -dy / zoom)
        return replace(self, held=(zoom, (cx + x / max(w, _HORIZON), cy + y / max(w, _HORIZON))))

    def resize(self, canvas_size: Pair, pixel_ratio: float | None = None, top: float = 0.0) -> Self:
        """Return the viewport for another size of canvas: the centre stays in place, and a fitted image still fits."""
        return replace(self, canvas_size=canvas_size, pixel_ratio=pixel_ratio or self.pixel_ratio, top=top)
