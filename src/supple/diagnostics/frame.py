"""What the plots are made of: panels, maps, colour bars, and the strokes as arrows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from matplotlib.patheffects import AbstractPathEffect

_PANEL = 5.0  # inches
_MOST_STROKES = 12  # that are drawn as arrows: more of them hide the picture

Floats = npt.NDArray[np.float64]
Background = npt.NDArray[np.float32] | None
Extend = Literal["neither", "max"]


def panels(deformation: Deformation, rows: int, columns: int) -> tuple[Figure, list[Axes]]:
    """A figure with panels in the deformation's proportions."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    spaced = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)
    tall = min(max(ratio(deformation), 0.35), 1.6) * _PANEL
    made = Figure(figsize=(columns * (_PANEL + 1.0) + 0.3, rows * (tall + 0.7) + 0.6), layout=spaced)
    FigureCanvasAgg(made)
    return made, list(made.subplots(rows, columns, squeeze=False).flat)


def ratio(deformation: Deformation) -> float:
    """Height over width, in physical units."""
    (height, width), (sx, sy) = deformation.shape, deformation.domain.spacing
    return (height * sy) / (width * sx)


def edges(deformation: Deformation) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of the picture, half a pixel around its pixels' centres."""
    height, width = deformation.shape
    return -0.5, width - 0.5, height - 0.5, -0.5


def map_axes(axes: Axes, deformation: Deformation, name: str) -> None:
    """Make axes those of a map: y down, in pixels."""
    sx, sy = deformation.domain.spacing
    axes.set_aspect(sy / sx if 1 / 6 <= ratio(deformation) <= 6 else "auto")
    left, right, bottom, top = edges(deformation)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_title(name, fontsize=11, loc="left")
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px)")
    axes.tick_params(labelsize=8)


def show(
    axes: Axes, values: Floats, every: int, norm: Normalize, colours: str, alpha: Floats | float | None = None
) -> AxesImage:
    """Draw values, of every so many-th pixel, as a map."""
    rows, columns = values.shape
    extent = (-every / 2, (columns - 0.5) * every, (rows - 0.5) * every, -every / 2)
    return axes.imshow(values, extent=extent, norm=norm, cmap=colours, alpha=alpha, interpolation="nearest")


def under(axes: Axes, deformation: Deformation, below: Background) -> None:
    """Draw the picture, light and grey, below a map."""
    if below is not None:
        grey = below @ np.array([0.299, 0.587, 0.114], np.float32)
        axes.imshow(0.3 + 0.7 * grey, extent=edges(deformation), cmap="gray", vmin=0, vmax=1)


def bar(made: Figure, drawn: AxesImage, parts: Axes | list[Axes], label: str, extend: Extend = "neither") -> Axes:
    """Add a colour bar, and return its axes."""
    made_bar = made.colorbar(drawn, ax=parts, shrink=0.9, pad=0.02, extend=extend)
    made_bar.set_label(label)
    made_bar.ax.tick_params(labelsize=8)
    return made_bar.ax


def arrows(axes: Axes, deformation: Deformation, colour: str = "black") -> None:
    """The strokes, from where they grab to where they drag."""
    from matplotlib.patheffects import withStroke

    halo: list[AbstractPathEffect] = [withStroke(linewidth=2.6, foreground="white")]
    for stroke in deformation.strokes[:_MOST_STROKES]:
        (x, y), (dx, dy) = stroke.at, stroke.by
        arrow = axes.annotate(
            "", (x + dx, y + dy), (x, y), annotation_clip=True,
            arrowprops={"arrowstyle": "->", "linewidth": 1.3, "color": colour, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        if arrow.arrow_patch is not None:
            arrow.arrow_patch.set_path_effects(halo)
        axes.plot([x], [y], "o", markersize=4.5, color=colour, markeredgecolor="white")


def title(made: Figure, text: str) -> None:
    """Put a title on the whole figure."""
    made.suptitle(text, fontsize=13, x=0.01, ha="left")
