"""Pictures of volumes with a scale bar and the sides of the patient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument, need
from supple.render.camera import Projection, bar_of, sides_of
from supple.render.labels import LabelColours
from supple.space.checks import refuse
from supple.space.geometry import Geometry

need("plot", "marks on pictures", "matplotlib")

LEAST = 96
"""Pixels along a side: a smaller picture has no room for marks."""

_LETTERS, _SMALLEST = 0.035, 11.0  # the height of letters: a fraction of the shorter side, and the least in pixels
_FONT, _SERIFS = "DejaVu Sans", "DejaVu Sans Mono"  # both come with Matplotlib; the second has an I with serifs


def check_annotated(size: tuple[int, int]) -> None:
    """Raise SuppleError for a size, rows and columns, without room for marks."""
    if min(size) < LEAST:
        text = f"{argument('annotate')} needs a picture of {LEAST} pixels or more along both sides, found"
        raise SuppleError(f"{text} {size[1]}x{size[0]}: give a larger size, or leave it out")


Entry = tuple[str, tuple[float, float, float]]
"""A name, and its colour as sRGB from 0 to 1."""


def entries_of(colours: LabelColours, labels: npt.ArrayLike) -> list[Entry]:
    """Return the names and colours of labels that are not fully transparent, for a legend."""
    known = np.asarray(labels)
    rows = zip(known.tolist(), colours.of(known).tolist(), strict=True)
    return [(colours.name(k), (r, g, b)) for k, (r, g, b, opacity) in rows if opacity > 0]


def annotated(
    pixels: npt.NDArray[np.uint8],
    view: Projection,
    geometry: Geometry,
    *,
    legend: Sequence[Entry] = (),
    marks: bool = True,
) -> npt.NDArray[np.uint8]:
    """Return a picture of a volume with a scale bar, and letters for the patient's sides.

    The bar, at the lower left, holds at the distance of the camera's target: in perspective, nearer parts appear
    larger. The letter at an edge names the side of the patient there, R, L, A, P, S or I, or several for an oblique
    view, the nearest first; without a patient, it is an axis of the voxels with its sign.

    Parameters
    ----------
    pixels : uint8 array, shape (H, W, 3 or 4)
        sRGB, with straight alpha, as `supple.render.picture.Rendering.pixels` returns it.
    view : Projection
        Of the picture: ``scene.view(camera, size)``.
    geometry : Geometry
        The volume's.
    legend : sequence of (str, (float, float, float))
        Names and colours to list at the upper left, as many as there is room for; then how many more there are.
    marks : bool
        Whether the bar and the letters are drawn.

    Returns
    -------
    uint8 array, shape (H, W, 3 or 4)
        A copy.

    Raises
    ------
    SuppleError
        If the pixels do not fit, or are too few.
    """
    given = np.asarray(pixels)
    if given.dtype != np.uint8 or given.shape not in ((*view.size, 3), (*view.size, 4)):
        wanted = f"uint8 of shape ({view.size[0]}, {view.size[1]}, 3 or 4), as the view's size"
        refuse("pixels", wanted, told=f"{given.dtype} of shape {given.shape}")
    check_annotated(view.size)
    drawn = _drawn(view, geometry, legend, marks)
    made = given.copy()
    at = drawn[..., 3] > 0
    over, under = drawn[at] / 255.0, made[at] / 255.0
    opaque = over[:, 3:]
    if made.shape[2] == 3:
        mixed = opaque * over[:, :3] + (1 - opaque) * under
    else:
        left = (1 - opaque) * under[:, 3:]
        colours = (opaque * over[:, :3] + left * under[:, :3]) / (opaque + left)
        mixed = np.concatenate([colours, opaque + left], axis=1)
    made[at] = np.rint(255 * mixed)
    return made


def _drawn(view: Projection, geometry: Geometry, legend: Sequence[Entry], marks: bool) -> npt.NDArray[np.uint8]:
    """Return the marks alone, (H, W, 4): white with dark outlines, to be seen on anything."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import IdentityTransform

    (height, width), bar = view.size, bar_of(view)
    # At 72 dpi, a point is a pixel. Matplotlib truncates the size to integers, hence 0.01.
    made = Figure(figsize=((width + 0.01) / 72, (height + 0.01) / 72), dpi=72, facecolor="none")
    canvas = FigureCanvasAgg(made)
    high = max(_LETTERS * min(view.size), _SMALLEST)
    edge, thick = round(0.8 * high), max(round(0.14 * high), 2)
    halo = [withStroke(linewidth=0.25 * high, foreground="#101010")]
    shared: dict[str, Any] = {
        "transform": IdentityTransform(), "color": "white", "parse_math": False, "usetex": False,
        "path_effects": halo,
    }  # fmt: skip
    middle = width / 2, height / 2
    smaller, line_high = 0.85 * high, 1.3 * high
    foot = middle[1] + high if marks else 3 * edge  # above the letter at the left
    room = max(int((height - edge - foot) / line_high), 1)
    shown = [*legend] if len(legend) <= room else [*legend[: room - 1], (f"and {len(legend) - room + 1} more", None)]
    for k, (text, colour) in enumerate(shown):
        base = height - edge - (k + 1) * line_high
        if colour is not None:
            patch = Rectangle(
                (edge, base), smaller, smaller, facecolor=colour, edgecolor="#101010", transform=IdentityTransform()
            )
            made.add_artist(patch)
        made.text(edge + 1.3 * high, base, text, ha="left", va="baseline", fontsize=smaller, fontfamily=_FONT, **shared)
    if not marks:
        canvas.draw()  # type: ignore[no-untyped-call]
        return np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    left, right, above, below = sides_of(view, geometry)
    for text, x, y, across, along in (
        (left, edge, middle[1], "left", "center"),
        (right, width - edge, middle[1], "right", "center"),
        (above, middle[0], height - edge, "center", "top"),
        (below, middle[0], edge, "center", "bottom"),
    ):
        made.text(x, y, text, ha=across, va=along, fontsize=high, fontweight="bold", fontfamily=_SERIFS, **shared)
    base = edge + thick / 2
    outline = [withStroke(linewidth=thick + 0.2 * high, foreground="#101010", capstyle="projecting")]
    line = Line2D(
        [edge, edge + bar.pixels], [base, base], color="white", linewidth=thick, solid_capstyle="butt",
        transform=IdentityTransform(), path_effects=outline,
    )  # fmt: skip
    made.add_artist(line)
    above_bar = base + thick / 2 + 0.35 * high
    made.text(edge, above_bar, bar.label, ha="left", va="baseline", fontsize=smaller, fontfamily=_FONT, **shared)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
