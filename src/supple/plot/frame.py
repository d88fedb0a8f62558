"""Parts of plots: backgrounds, panels, maps, colour bars, arrows for strokes, and the file."""

from __future__ import annotations

import os
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.errors import SuppleError, shown
from supple.media.files import check_output, replacing
from supple.plot.measure import spacing_of
from supple.space.geometry import Floats
from supple.strokes import Stroke

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from matplotlib.patheffects import AbstractPathEffect

    from supple.media.image import Picture


_MOST_PIXELS = 1 << 21  # the largest resolution of a plot


def background(deformation: Deformation, image: npt.NDArray[Any] | Picture) -> npt.NDArray[np.float32]:
    """Return the deformed image as RGB from 0 to 1, float32 (h, w, 3), reduced if it is large.

    The image is of any type of `Deformation.warp`: grey (H, W[, 1]), or with alpha, RGB or RGBA (H, W, 2 to 4); or a
    picture of any colours, which is converted. For a video, it is a frame of the output, which is deformed already.
    """
    if not isinstance(image, np.ndarray) and hasattr(image, "warped"):
        from supple.media.image.display import in_srgb

        image = in_srgb(image).pixels
    array = np.asarray(image)
    if deformation.ndim == 3 and (array.shape[:2] != deformation.shape[1:] or array.ndim > 3):
        height, width = deformation.shape[1:]
        raise SuppleError(f"a frame to plot on must be of shape ({height}, {width}[, C]), found {array.shape}")
    if array.ndim == 3 and array.shape[2] > 4:
        raise SuppleError(f"an image to plot on must be grey, RGB or RGBA, found shape {array.shape}")
    bent = array
    if deformation.ndim == 2:
        bent = deformation.warp(array, alpha=array.ndim == 3 and array.shape[2] in (2, 4))
    low, high = _range(array)
    every = spacing_of(deformation.shape[-2:], _MOST_PIXELS)
    height, width = (n // every * every for n in bent.shape[:2])
    blocks = bent[:height, :width].reshape(height // every, every, width // every, every, -1)
    small = blocks.mean(axis=(1, 3), dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        small = np.clip(np.nan_to_num((small - low) / (high - low)), 0, 1)
    if small.shape[2] in (2, 4):
        opacity = small[..., -1:]
        small = small[..., :-1] * opacity + (1 - opacity)
    return np.ascontiguousarray(np.broadcast_to(small, (*small.shape[:2], 3)), np.float32)


def _range(array: npt.NDArray[Any]) -> tuple[float, float]:
    if array.dtype == np.bool_:
        return 0.0, 1.0
    if array.dtype.kind == "u" and array.dtype.itemsize <= 2:
        return 0.0, float(np.iinfo(array.dtype).max)
    finite = array[np.isfinite(array)] if array.dtype.kind == "f" else array
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if array.dtype.kind == "f" and low >= 0 and high <= 1:
        return 0.0, 1.0
    return low, high if high > low else low + 1.0


SUFFIXES = (".png", ".svg", ".pdf")
DPI = 150

_PANEL = 5.0  # inches
_LETTERS = 13  # characters of a colour bar's label in an inch
_MOST_STROKES = 12  # the most strokes drawn as arrows: more would hide the image
_AROUND, _NEAR, _STEPS = 6, 0.75, 16  # points around a pivot, their distance in radii, and the steps of their paths

Background = npt.NDArray[np.float32] | None
Extend = Literal["neither", "max", "min", "both"]
Box = tuple[float, float, float, float]
"""Left, right, bottom and top; top < bottom, since y points down."""


def check_plot(path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Raise SuppleError if no plot can be written to this path; call it before any work."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise SuppleError(f"cannot write {shown(path)}: a plot's name must end in {', '.join(SUFFIXES)}")
    check_output(path, force=force)


def save(made: Figure, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write a figure to a file, which appears whole or not at all; equal figures make equal bytes."""
    check_plot(path, force=force)
    suffix = Path(path).suffix.lower()
    metadata = {"Date": None} if suffix == ".svg" else {"CreationDate": None} if suffix == ".pdf" else {}
    with replacing(path, force=force) as file:
        made.savefig(file, format=suffix[1:], dpi=DPI, metadata=metadata)


def sheet(width: float, height: float, rows: int, columns: int) -> tuple[Figure, list[Axes]]:
    """Return a figure of ``width`` by ``height`` inches, and its panels, row by row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    made = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1))
    FigureCanvasAgg(made)
    return made, list(made.subplots(rows, columns, squeeze=False).flat)


def panels(deformation: Deformation, rows: int, columns: int, beside: float = 0.3) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels in the deformation's proportions, and ``beside`` inches between them."""
    tall = min(max(ratio(deformation), 0.35), 1.6) * _PANEL
    return sheet(columns * (_PANEL + 1.0) + beside, rows * (tall + 0.7) + 0.6, rows, columns)


def ratio(deformation: Deformation) -> float:
    """Return height over width, in physical units."""
    (height, width), (sx, sy) = deformation.shape[-2:], deformation.domain.spacing[:2]
    return (height * sy) / (width * sx)


def edges(deformation: Deformation) -> Box:
    """Return left, right, bottom and top of the image: the outer edges of its pixels."""
    return edges_of(deformation.shape[-2:])


def edges_of(shape: tuple[int, ...], steps: tuple[float, float] = (1, 1)) -> Box:
    """Return left, right, bottom and top of samples (H, W), which are ``steps`` apart to the right and down."""
    (height, width), (x, y) = shape, steps
    return -0.5 * x, (width - 0.5) * x, (height - 0.5) * y, -0.5 * y


def map_axes(axes: Axes, deformation: Deformation, name: str) -> None:
    """Set axes up for a map: y down, in pixels."""
    sx, sy = deformation.domain.spacing[:2]
    set_axes(axes, edges(deformation), sy / sx, name, ("x (px)", "y (px)"))


def set_axes(axes: Axes, box: Box, scale: float, name: str, labels: tuple[str, str]) -> None:
    """Set axes up for a map of a box; a unit of y is as long as ``scale`` units of x."""
    left, right, bottom, top = box
    axes.set_aspect(scale if 1 / 6 <= scale * (bottom - top) / (right - left) <= 6 else "auto")
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_title(name, fontsize=11, loc="left")
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.tick_params(labelsize=8)


def show(
    axes: Axes, values: Floats, every: int, norm: Normalize, colours: str, alpha: Floats | float | None = None
) -> AxesImage:
    """Draw values of every ``every``-th pixel as a map."""
    extent = edges_of(values.shape, (every, every))
    return axes.imshow(values, extent=extent, norm=norm, cmap=colours, alpha=alpha, interpolation="nearest")


def under(axes: Axes, deformation: Deformation, below: Background) -> None:
    """Draw the image, light and grey, below a map."""
    if below is not None:
        grey = below @ np.array([0.299, 0.587, 0.114], np.float32)
        axes.imshow(0.3 + 0.7 * grey, extent=edges(deformation), cmap="gray", vmin=0, vmax=1)


def bar(made: Figure, drawn: AxesImage, parts: Axes | list[Axes], label: str, extend: Extend = "neither") -> Axes:
    """Add a colour bar, and return its axes."""
    made_bar = made.colorbar(drawn, ax=parts, shrink=0.9, pad=0.02, extend=extend)
    first = parts[0] if isinstance(parts, list) else parts
    room = 0.9 * made.get_figheight() * first.get_position().height  # inches
    made_bar.set_label("\n".join(textwrap.fill(line, max(8, int(room * _LETTERS))) for line in label.splitlines()))
    made_bar.ax.tick_params(labelsize=8)
    return made_bar.ax


def arrows(axes: Axes, deformation: Deformation, colour: str = "black") -> None:
    """Draw strokes as arrows: the drag of a grab; for other brushes, the paths of some points around the pivot."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path as Line
    from matplotlib.patheffects import withStroke

    halo: list[AbstractPathEffect] = [withStroke(linewidth=2.6, foreground="white")]
    for stroke in [each for each in deformation.strokes if each.brush != "freeze"][:_MOST_STROKES]:
        (x, y), (dx, dy) = stroke.at[:2], stroke.by[:2]
        for path in paths(deformation, stroke):
            axes.add_patch(
                FancyArrowPatch(
                    path=Line(path), arrowstyle="->", mutation_scale=8, shrinkA=0, shrinkB=0, linewidth=1.3,
                    color=colour, clip_on=True, path_effects=halo,
                )
            )  # fmt: skip
        axes.plot(*np.array([at[:2] for at, _ in stroke.handles]).T, "o", markersize=4.5, color=colour, mec="white")
        if deformation.ndim == 3:
            # The text is on the side opposite the arrow.
            across, down = (-1 if dx > 0 and x > 0.15 * deformation.shape[2] else 1), (-1 if dy < 0 else 1)
            end = f" → {stroke.at[2] + stroke.by[2]:g}" if stroke.brush == "grab" else ""
            axes.annotate(
                f"t {stroke.at[2]:g}{end}", (x, y), (6 * across, 5 * down),
                textcoords="offset points", ha="left" if across > 0 else "right", va="bottom" if down > 0 else "top",
                fontsize=8, color=colour, path_effects=halo, annotation_clip=True,
            )  # fmt: skip


def paths(deformation: Deformation, stroke: Stroke) -> list[Floats]:
    """Return the lines (n, 2) of a stroke in a plot: the paths of its points as it grows from 0 to full strength."""
    if stroke.brush == "grab":
        lines = [np.array([at, *stroke.path, np.add(at, by)])[:, :2] for at, by in stroke.handles]
        return [line for line in lines if (line != line[0]).any()]
    if stroke.is_still:
        return []
    turns = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False) + np.pi / _AROUND
    points = np.tile(stroke.at, (_AROUND, 1))
    ring = np.column_stack([np.cos(turns), np.sin(turns)]) * (_NEAR * stroke.radius)
    points[:, :2] += ring / deformation.domain.spacing[:2]
    # Without the border, to show the brush alone.
    alone = Deformation(deformation.grid, border=None, time=deformation.domain.time)
    pieces = len(alone.add(stroke).space.table)  # more than one if the stroke flows
    piece, parts = stroke.weakened(1 / pieces), max(_STEPS // pieces, 1)
    growing = [alone.add(piece.weakened(k / parts)) for k in range(1, parts + 1)]
    found = [points]
    for _ in range(pieces):
        start = found[-1]
        found += [part.forward(start) for part in growing]
    return list(np.stack(found, axis=1)[..., :2])


def title(made: Figure, text: str) -> None:
    """Put a title on the whole figure."""
    made.suptitle(text, fontsize=13, x=0.01, ha="left")
