"""Plots of a deformation: iterations, residual, stretch, axes and grid; and of the work of rays."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.plot import frame as sheets
from supple.plot import measure
from supple.space.checks import choice
from supple.space.geometry import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from supple.media.image import Picture


WHATS = ("iterations", "residual", "stretch", "axes", "grid")

_BLUE = "#33628d"


def plot(
    deformation: Deformation,
    what: str,
    path: str | os.PathLike[str],
    *,
    image: npt.NDArray[Any] | Picture | None = None,
    frame: int | None = None,
    force: bool = False,
) -> None:
    """Write a plot of a deformation to a file.

    Parameters
    ----------
    deformation : Deformation
        A deformation of images or videos.
    what, image, frame
        As in `figure`.
    path : str or os.PathLike
        A PNG, SVG or PDF file, by its suffix.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    SuppleError
        If the deformation cannot be plotted, or the file not be written.
    """
    sheets.check_plot(path, force=force)
    sheets.save(figure(deformation, what, image=image, frame=frame), path, force=force)


def figure(
    deformation: Deformation, what: str, *, image: npt.NDArray[Any] | Picture | None = None, frame: int | None = None
) -> Figure:
    """Plot a deformation.

    Parameters
    ----------
    deformation : Deformation
        A deformation of images, or of videos: then of one frame of the output.
    what : str
        ``"iterations"``: the iterations of each pixel, by the published method and by ours. ``"residual"``: the error
        of the inverse map. ``"stretch"``: expansion and contraction. ``"axes"``: the direction and the amount of the
        largest contraction. ``"grid"``: straight lines, warped; and for a video, the time of the source of each pixel.
    image : array or Picture, optional
        The image before it is deformed, which is shown (deformed) below the stretch, the axes or the grid. For a video,
        the frame of the output.
    frame : int, optional
        The frame of a video, from 0.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    SuppleError
        If ``what`` is unknown, there is no such frame, or the image does not fit.
    """
    choice("what", what, WHATS)
    measure.require_plane(deformation, frame)
    below = sheets.background(deformation, image) if image is not None else None
    if what in ("iterations", "residual"):
        return (_iterations if what == "iterations" else _residual)(deformation, frame)
    if what in ("stretch", "axes"):
        return (_stretch if what == "stretch" else _axes)(deformation, frame, below)
    return _grid(deformation, below) if frame is None else _time_grid(deformation, frame, below)


def _iterations(deformation: Deformation, frame: int | None) -> Figure:
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    found = measure.iterations(deformation, frame)
    px = _unit(deformation)
    made, parts = sheets.panels(deformation, 2, 2)
    most = max(int(found.published.max()), int(found.ours.max()), 1)
    norm = Normalize(0, most)
    left = f"\n{found.unconverged} pixels not within 0.1 {px}" if found.unconverged else ""
    published, ours = f"Published: Gauss–Newton, μ = 0.5, to 0.1 {px}", f"Ours: Newton, to 0.000001 {px}"
    rows = (
        (found.published, published, "iterations", found.published_error, left),
        (found.ours, ours, "evaluations of T and its Jacobian", found.residual, ""),
    )
    for k, (counts, name, unit, error, note) in enumerate(rows):
        bars, shown_map = parts[2 * k], parts[2 * k + 1]
        tally = np.bincount(counts.ravel(), minlength=most + 1) / counts.size
        bars.bar(np.arange(most + 1), 100 * tally, width=0.85, color=_BLUE)
        bars.set_title(name, fontsize=11, loc="left")
        bars.set_xlabel(unit)
        bars.set_ylabel("pixels (%)")
        bars.set_xlim(-0.7, most + 0.7)
        bars.set_ylim(0, 125 * tally.max())  # room for the text
        bars.xaxis.set_major_locator(MaxNLocator(integer=True))
        bars.spines[["top", "right"]].set_visible(False)
        bars.tick_params(labelsize=8)
        kind = "worst distance to the true source" if k == 0 else "worst residual"
        text = f"mean {counts.mean():.1f}, most {counts.max()}\n{kind}: {error.max():.2g} {px}{note}"
        bars.text(0.98, 0.97, text, transform=bars.transAxes, ha="right", va="top", fontsize=9)
        drawn = sheets.show(shown_map, counts.astype(np.float64), found.every, norm, "viridis")
        sheets.map_axes(shown_map, deformation, "At each output pixel")
        sheets.arrows(shown_map, deformation)
        sheets.bar(made, drawn, shown_map, unit)
    text = f"Work to invert every pixel by itself (the lattice needs {found.lattice:.2g} evaluations a pixel)"
    sheets.title(made, text + _of(frame))
    return made


def _residual(deformation: Deformation, frame: int | None) -> Figure:
    from matplotlib.colors import LogNorm

    found = measure.residual(deformation, frame)
    px = _unit(deformation)
    made, parts = sheets.panels(deformation, 1, 2)
    worst = max(float(found.distance.max()), float(found.residual.max()))
    high = 2 * max(worst, found.tolerance, found.bound)
    norm = LogNorm(high * 1e-5, high, clip=True)
    names = ("|T(p) − q| in output pixels", "|p − T⁻¹(q)| in input pixels")
    for axes, values, name in zip(parts, (found.residual, found.distance), names, strict=True):
        drawn = sheets.show(axes, values, found.every, norm, "magma")
        sheets.map_axes(axes, deformation, f"{name}: at most {values.max():.2g}")
    scale = sheets.bar(made, drawn, parts, f"{px}\n(line: tolerance; dotted: certified bound)")
    for value, style, colour in ((found.tolerance, "-", "#00a5a5"), (found.bound, ":", "black")):
        if value > 0:
            scale.axhline(value, color=colour, linestyle=style, linewidth=2)
    text = f"Error of the inverse map: certified at most {found.bound:.3g} {px}, tolerance {found.tolerance:g}"
    sheets.title(
        made, text + (f"; of {found.unconverged} pixels it is not known" if found.unconverged else "") + _of(frame)
    )
    return made


def _stretch(deformation: Deformation, frame: int | None, below: sheets.Background) -> Figure:
    from matplotlib.colors import TwoSlopeNorm

    found = measure.stretch(deformation, frame)
    every = measure.spacing_of(deformation.shape[-2:])
    made, parts = sheets.panels(deformation, 1, len(found))
    low, high = min(values.min() for values in found), max(values.max() for values in found)
    # The largest contraction is as dark as the largest expansion.
    reach = max(1 - low, high - 1, 0.05)
    norm = TwoSlopeNorm(1.0, 1 - reach, 1 + reach) if reach <= 1 else TwoSlopeNorm(1.0, min(low, 0), max(high, 2))
    for axes, values, name in zip(parts, found, ("Vertical", "Horizontal", "In time"), strict=False):
        sheets.under(axes, deformation, below)
        drawn = sheets.show(axes, values, every, norm, "RdBu_r", 0.72 if below is not None else None)
        sheets.map_axes(axes, deformation, f"{name}: {values.min():z.2f} to {values.max():z.2f}")
        sheets.arrows(axes, deformation)
    sheets.bar(made, drawn, parts, "contracted  ←  1  →  expanded")
    sheets.title(made, f"Stretch of the {'picture' if frame is None else 'video'}{_of(frame)}")
    return made


def _axes(deformation: Deformation, frame: int | None, below: sheets.Background) -> Figure:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    found = measure.footprints(deformation, frame)
    made, parts = sheets.panels(deformation, 1, 2)
    levels = [np.maximum(np.log2(values), 0.0) for values in (found.major, found.minor)]
    # Close to a fixed border, a few pixels may contract far more than all others.
    high = max(1.0, float(np.percentile(levels[0], 99.5)))
    names = ("Major axis, log₂ σ₁, and its direction", "Minor axis, log₂ σ₂")
    for axes, level, name in zip(parts, levels, names, strict=True):
        sheets.under(axes, deformation, below)
        alpha = None if below is None else 0.9 * np.sqrt(np.minimum(level / high, 1.0))
        drawn = sheets.show(axes, level, found.every, Normalize(0, high), "YlGnBu", alpha)
        sheets.map_axes(axes, deformation, f"{name}: at most {level.max():.2f}")
    parts[0].add_collection(LineCollection(_needles(found), colors="black", linewidths=0.9, capstyle="round"))
    cut: sheets.Extend = "max" if float(levels[0].max()) > high else "neither"
    sheets.bar(made, drawn, parts, "log₂ of the source pixels that an output pixel spans", cut)
    sheets.title(made, f"Where the picture shrinks: levels of a pyramid (0 where it does not){_of(frame)}")
    return made


def _needles(found: measure.Footprints) -> list[Floats]:
    """Return short lines along the major axes, whose lengths grow with the contraction along them."""
    step = max(1, round(max(found.major.shape) / 36))
    rows, columns = (axis.ravel() for axis in np.indices(found.major.shape)[:, step // 2 :: step, step // 2 :: step])
    shrink = 1 - 1 / np.maximum(found.major[rows, columns], 1.0)
    half = found.direction[rows, columns] * (0.48 * step * np.sqrt(shrink))[:, None]
    centre = np.stack([columns, rows], axis=-1)
    return list(np.stack([centre - half, centre + half], axis=1)[shrink > 0.005] * found.every)


def _grid(deformation: Deformation, below: sheets.Background) -> Figure:
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

    made, (axes,) = sheets.panels(deformation, 1, 1)
    lines = measure.grid(deformation)
    if below is not None:
        axes.imshow(below, extent=sheets.edges(deformation))
        bent = LineCollection(lines, colors="white", linewidths=0.8, alpha=0.9)
        bent.set_path_effects([withStroke(linewidth=1.8, foreground=(0, 0, 0, 0.45))])
    else:
        still = measure.grid(deformation.without_strokes())
        axes.add_collection(LineCollection([x[[0, -1]] for x in still], colors="#d9d9d9", linewidths=0.6))
        bent = LineCollection(lines, colors=_BLUE, linewidths=0.9)
    axes.add_collection(bent)
    sheets.map_axes(axes, deformation, "Straight lines of the input, as the output shows them")
    sheets.arrows(axes, deformation, "black" if below is None else "#d55e00")
    return made


def _time_grid(deformation: Deformation, frame: int, below: sheets.Background) -> Figure:
    from matplotlib.colors import TwoSlopeNorm

    every, points = measure.sources(deformation, frame)
    made, (axes,) = sheets.panels(deformation, 1, 1, beside=1.4)
    sheets.under(axes, deformation, below)
    ahead = points[..., 2] - frame
    reach = max(float(np.abs(ahead).max()), 1e-3)
    norm = TwoSlopeNorm(0.0, -reach, reach)
    drawn = sheets.show(axes, ahead, every, norm, "PuOr_r", None if below is None else 0.55)
    if min(ahead.shape) > 1:
        x, y = (np.arange(n) * float(every) for n in reversed(ahead.shape))
        inside = 1e-6  # so that the lines at the edges are drawn, too
        for c, places in enumerate(measure.ticks(deformation, 24)):
            places = np.clip(places, places[0] + inside, places[-1] - inside)
            axes.contour(x, y, points[..., c], np.unique(places), colors="black", linewidths=0.7)
    sheets.map_axes(axes, deformation, f"Frame {frame} of the output: straight lines of the input")
    sheets.arrows(axes, deformation)
    sheets.bar(made, drawn, axes, f"frame of the input − {frame}")
    return made


def _unit(deformation: Deformation) -> str:
    return "px" if deformation.ndim == 2 else "px and frames"


def _of(frame: int | None) -> str:
    return "" if frame is None else f"; frame {frame}"


def draw_inversions(
    counts: npt.NDArray[np.integer], path: str | os.PathLike[str], *, what: str = "inversions", force: bool = False
) -> None:
    """Plot the number of inversions, or samples, of each ray of an image (H, W): the paper's Fig. 5.5.

    SuppleError if the PNG, SVG or PDF file cannot be written.
    """
    sheets.check_plot(path, force=force)
    height, width = counts.shape
    tall = min(max(height / width, 0.35), 1.6) * 6.0
    made, (axes,) = sheets.sheet(7.4, tall + 0.9, 1, 1)
    seen = counts[counts > 0]
    # The few rays along a surface take far more than the others, and would darken all of them.
    most = float(np.percentile(seen, 99.5)) if seen.size else 1.0
    drawn = axes.imshow(np.where(counts > 0, counts, np.nan), cmap="viridis", vmin=0, vmax=max(most, 1.0))
    axes.set_facecolor("#f4f4f4")
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px)")
    axes.tick_params(labelsize=8)
    mean = float(seen.mean()) if seen.size else 0.0
    axes.set_title(f"{mean:.1f} on average where there are any, {int(counts.max())} at most", fontsize=10, loc="left")
    sheets.bar(made, drawn, axes, f"{what} along the ray", "max" if counts.max() > most else "neither")
    sheets.title(made, f"{what.capitalize()} along each ray")
    sheets.save(made, path, force=force)
