"""A picture of a displacement field: its moved grid, its log-Jacobian, its folds, and the error of an inverse."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.fields import Field, sampled
from supple.fields.checks import FieldReport
from supple.plot import planes
from supple.plot.frame import Box, Extend, bar, check_plot, edges_of, save, set_axes, sheet, title
from supple.space.checks import refuse
from supple.space.geometry import Floats, Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL = 4.6  # inches
_LINES = 40  # of the grid, along the longer side
_CROWDED = 0.05  # of the cells of a slice: if more fold, they are not marked one by one
_WINDOW = 8  # half of the side, in cells, of the window with most folds, which is enlarged
_BLUE, _REST, _FOLDED, _RIM, _GAP = "#33628d", "#d0d0d0", "#f0c800", "#8a6d00", "#555555"

Singles = npt.NDArray[np.float32]


class _Slice(NamedTuple):
    """The data of a picture of a field; lengths are along the picture's axes, to the right and down."""

    rest: Floats  # (H, W, 2): the positions of the samples
    moved: Floats  # (H, W, 2): the positions plus the displacement
    folded: npt.NDArray[np.bool_]  # (H - 1, W - 1)
    logarithms: Singles  # (H, W)
    distances: Singles | None
    steps: tuple[float, float]
    unit: str
    plane: planes.Plane | None  # of a volume


def draw_check(
    field: Field,
    report: FieldReport,
    folded: npt.NDArray[np.bool_],
    logarithms: Singles,
    distances: Singles | None,
    path: str | os.PathLike[str],
    *,
    name: str = "The field",
    plane: str | None = None,
    force: bool = False,
) -> None:
    """Write a picture of a checked field to a PNG, SVG or PDF file; ``name`` is for the title.

    ``report``, ``folded``, ``logarithms`` and ``distances`` are the results of `Field.reported`, `Field.folded_cells`,
    `Field.log_jacobian` and `Field.distances`. For a volume, ``plane`` is as in `supple.plot.planes.chosen`: by
    default, the axial slice with most folded cells on its two sides, which are marked, or the middle one if there are
    none. SuppleError if the file cannot be written, or there is no such plane.
    """
    check_plot(path, force=force)
    save(_figure(_slice(field, report.grid, folded, logarithms, distances, plane), report, name), path, force=force)


def _slice(
    field: Field,
    grid: Grid,
    folded: npt.NDArray[np.bool_],
    logarithms: Singles,
    distances: Singles | None,
    where: str | None = None,
) -> _Slice:
    values, plane, unit, ways = sampled(field), None, "px", np.array(grid.direction).T
    if where is not None and grid.ndim == 2:
        refuse("plane", "left out for a field of a picture", where)
    if grid.ndim == 3:
        unit, sizes = "mm", grid.sizes

        def both(through: int) -> planes.Ints:  # the number of folded cells on the two sides of each slice
            others = tuple(k for k in range(3) if k != 2 - through)
            counts = np.pad(folded.sum(axis=others), 1)[: sizes[through] + 1]
            return np.convolve(counts, (1, 1), "valid")

        plane = planes.chosen(grid, where, both)
        layers = np.pad(folded, [(1, 1) if k == 2 - plane.through else (0, 0) for k in range(3)])
        folded = plane.seen(layers) | plane.seen(layers, min(plane.number + 1, layers.shape[2 - plane.through] - 1))
        values, logarithms = plane.seen(values), plane.seen(logarithms)
        distances = None if distances is None else plane.seen(distances)
        ways = plane.ways
    height, width = logarithms.shape
    sx, sy = grid.spacing[:2] if plane is None else plane.steps
    rest = np.stack(np.meshgrid(np.arange(width) * sx, np.arange(height) * sy), axis=-1)
    along = values.astype(np.float64) @ ways.T  # along the axes of the picture
    return _Slice(rest, rest + along[..., :2], folded, logarithms, distances, (sx, sy), unit, plane)


def _figure(seen: _Slice, report: FieldReport, name: str) -> Figure:
    height, width = seen.logarithms.shape
    whole = edges_of((height, width), seen.steps)
    near = _crowd(seen) if seen.folded.any() else None
    if near is not None and _area(near) > 0.5 * _area(whole):
        near = None
    boxes = [whole] if near is None else [whole, near]
    count = len(boxes) + 1 + (seen.distances is not None)
    columns = 2 if count == 4 else count
    rows = math.ceil(count / columns)
    tall = min(max(height * seen.steps[1] / (width * seen.steps[0]), 0.4), 1.5) * _PANEL
    made, parts = sheet(columns * (_PANEL + 1.2) + 0.3, rows * (tall + 0.7) + 1.0, rows, columns)
    longest = max(height, width)
    _draw_grid(parts[0], seen, max(1, math.ceil(longest / _LINES)))
    what = "Grid, moved by the displacement" + (" (its part in this plane)" if seen.plane else "")
    _set(parts[0], seen, whole, what)
    if near is not None:
        _draw_grid(parts[1], seen, 1)
        _set(parts[1], seen, near, "The same around the folds, a line for each sample")
        left, right, bottom, top = near
        parts[0].plot([left, right, right, left, left], [top, top, bottom, bottom, top], color="black", linewidth=1)
    _draw_jacobian(made, parts[len(boxes)], seen, whole)
    if seen.distances is not None:
        _draw_distances(made, parts[-1], seen, whole, seen.distances)
    made.legend(handles=_handles(seen), loc="outside lower left", ncols=4, fontsize=9, frameon=False)
    told = f"none of {report.cells:,} cells folds"
    if report.folds:
        told = f"{report.folded:,} of {report.cells:,} cells fold ({100 * report.folded / report.cells:.2g} %)"
    place = ", ".join(f"{x + 0.0:.4g}" for x in report.at)
    text = f"{name}: {told}" + (f"; {seen.plane.text}" if seen.plane else "")
    text += f"\nleast determinant {report.determinant:.3g} at ({place}) {seen.unit}; displacement up to "
    title(made, f"{text}{report.largest:.3g} {seen.unit}, {report.mean:.3g} on average")
    return made


def _handles(seen: _Slice) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    made: list[Any] = [Line2D([], [], color=_REST, label="grid at rest"), Line2D([], [], color=_BLUE, label="moved")]
    if seen.folded.any():
        made.append(Patch(facecolor=_FOLDED, edgecolor="black", linewidth=0.6, label="cells that fold"))
    if np.isnan(seen.logarithms).any():
        made.append(Patch(facecolor=_GAP, label="determinant not above 0, by central differences"))
    return made


def _crowd(seen: _Slice) -> Box:
    """Return a square around the moved folded cells of the window with most of them."""
    height, width = seen.folded.shape
    sums = np.pad(seen.folded.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    tall, wide = min(2 * _WINDOW, height), min(2 * _WINDOW, width)
    counts = sums[tall:, wide:] - sums[:-tall, wide:] - sums[tall:, :-wide] + sums[:-tall, :-wide]
    best = np.argwhere(counts == counts.max())
    top, left = best[len(best) // 2].tolist()  # the middle of equal ones: the first has the folds at its edge
    cells = np.argwhere(seen.folded[top : top + tall, left : left + wide]) + np.array([top, left])
    places = _corners(seen.moved, cells).reshape(-1, 2)
    (x, y), (right, bottom) = places.min(axis=0), places.max(axis=0)
    half = 0.8 * max(right - x, bottom - y, 6 * max(seen.steps))
    x, y = (x + right) / 2, (y + bottom) / 2
    return x - half, x + half, y + half, y - half


def _corners(points: Floats, cells: npt.NDArray[np.intp]) -> Floats:
    """Return the corners (N, 4, 2) of cells, in order around each; along an axis of one sample, they coincide."""
    last = np.array(points.shape[:2]) - 1
    turn = [np.minimum(cells + corner, last) for corner in ((0, 0), (0, 1), (1, 1), (1, 0))]
    return np.stack([points[corner[:, 0], corner[:, 1]] for corner in turn], axis=1)


def _draw_grid(axes: Axes, seen: _Slice, every: int) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    height, width = seen.logarithms.shape
    rows, columns = ([*range(0, n - 1, every), n - 1] for n in (height, width))
    for points, colour, wide in ((seen.rest, _REST, 0.6), (seen.moved, _BLUE, 0.8)):
        lines = [points[row] for row in rows] + [points[:, column] for column in columns]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=wide))
    cells = np.argwhere(seen.folded)
    if len(cells):
        drawn = PolyCollection(list(_corners(seen.moved, cells)), facecolors=_FOLDED, edgecolors=_RIM)
        # Many folded cells overlap: they are drawn below the lines.
        drawn.set(linewidth=0.6 if every == 1 else 0.0 if _is_crowded(seen) else 0.2)
        drawn.set(zorder=0.5 if _is_crowded(seen) else 3, alpha=0.5 if _is_crowded(seen) else 1.0)
        axes.add_collection(drawn)


def _is_crowded(seen: _Slice) -> bool:
    """Return whether so many cells fold that marks around each would hide everything else."""
    return float(seen.folded.mean()) > _CROWDED


def _outline(seen: _Slice) -> list[Floats]:
    whole = np.pad(seen.folded, 1)
    across, down = np.argwhere(whole[:, 1:] != whole[:, :-1]), np.argwhere(whole[1:] != whole[:-1])
    sides = [_corners(seen.rest, across - (1, 0))[:, [0, 3]], _corners(seen.rest, down - (0, 1))[:, [0, 1]]]
    return list(np.concatenate(sides))


def _draw_jacobian(made: Figure, axes: Axes, seen: _Slice, box: Box) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import TwoSlopeNorm
    from matplotlib.patheffects import withStroke

    known = seen.logarithms[np.isfinite(seen.logarithms)]
    # A few samples beside a fold would make all others pale.
    reach = max(float(np.percentile(np.abs(known), 99)) if known.size else 0.0, 0.02)
    axes.set_facecolor(_GAP)
    drawn = _show(axes, box, seen.logarithms, TwoSlopeNorm(0.0, -reach, reach), "RdBu_r")
    if seen.folded.any() and not _is_crowded(seen):
        halo = [withStroke(linewidth=2.6, foreground="black")]
        axes.add_collection(LineCollection(_outline(seen), colors=_FOLDED, linewidths=1.4, path_effects=halo))
    elif seen.folded.any():
        axes.add_collection(LineCollection(_outline(seen), colors=_FOLDED, linewidths=0.9))
    low, high = (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)
    _set(axes, seen, box, f"ln det(I + ∂u/∂x): {low:z.2f} to {high:z.2f}")
    what = "volume" if seen.plane else "area"
    cuts: dict[tuple[bool, bool], Extend] = {(True, True): "both", (True, False): "min", (False, True): "max"}
    cut = cuts.get((low < -1.001 * reach, high > 1.001 * reach), "neither")
    bar(made, drawn, axes, f"ln(input {what} / output {what})", cut)


def _draw_distances(made: Figure, axes: Axes, seen: _Slice, box: Box, distances: Singles) -> None:
    from matplotlib.colors import LogNorm

    known = distances[np.isfinite(distances)]
    high = max(float(known.max()) if known.size else 0.0, 1e-6)
    axes.set_facecolor(_REST)
    drawn = _show(axes, box, np.maximum(distances, high * 1e-4), LogNorm(high * 1e-4, high), "magma")
    _set(axes, seen, box, f"|second(first(x)) − x|: at most {high:.2g} {seen.unit}")
    gaps = "; grey: first(x) is outside of the second field" if np.isnan(distances).any() else ""
    bar(made, drawn, axes, f"{seen.unit}{gaps}")


def _show(axes: Axes, box: Box, values: Singles, norm: Any, colours: str) -> Any:
    return axes.imshow(values, extent=box, norm=norm, cmap=colours, interpolation="nearest")


def _area(box: Box) -> float:
    return (box[1] - box[0]) * (box[2] - box[3])


def _set(axes: Axes, seen: _Slice, box: Box, name: str) -> None:
    if seen.plane:
        planes.set_up(axes, seen.plane, box, name)
    else:
        set_axes(axes, box, 1.0, name, (f"x ({seen.unit})", f"y ({seen.unit})"))
