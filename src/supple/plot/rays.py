"""Plots of the work of each ray of a rendered volume."""

from __future__ import annotations

import os

import numpy as np
import numpy.typing as npt

from supple.plot.frame import bar, check_plot, save, sheet, title


def draw_inversions(
    counts: npt.NDArray[np.integer], path: str | os.PathLike[str], *, what: str = "inversions", force: bool = False
) -> None:
    """Plot the number of inversions, or samples, of each ray of an image: the paper's Fig. 5.5.

    Parameters
    ----------
    counts : integer array, shape (H, W)
    path : str or os.PathLike
        A PNG, SVG or PDF file, by its suffix.
    what : str
        The name of the counts.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    SuppleError
        If it cannot be written there.
    """
    check_plot(path, force=force)
    height, width = counts.shape
    tall = min(max(height / width, 0.35), 1.6) * 6.0
    made, (axes,) = sheet(7.4, tall + 0.9, 1, 1)
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
    bar(made, drawn, axes, f"{what} along the ray", "max" if counts.max() > most else "neither")
    title(made, f"{what.capitalize()} along each ray")
    save(made, path, force=force)


__all__ = ["draw_inversions"]
