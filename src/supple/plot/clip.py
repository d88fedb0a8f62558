"""Plots of a video before and after: a cut along time, and frames side by side."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.plot.frame import DPI, save, sheet, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST = 1600  # the dots of a cut along an axis, at most
_CELL = 2.6  # inches of a frame along its longer side, at most

Colours = npt.NDArray[np.uint8]
Numbered = tuple[int, Colours]


def evenly(count: int, columns: int) -> list[int]:
    """Return some frames of a clip, evenly spaced in time, from the first to the last."""
    return sorted({round(k) for k in np.linspace(0, count - 1, max(1, min(columns, count)))})


def draw_slice(
    before: Colours, after: Colours, at: int, path: str | os.PathLike[str], *, axis: str = "x", force: bool = False
) -> None:
    """Write the figure of `clip_slice` to a PNG, SVG or PDF file."""
    save(clip_slice(before, after, at, axis=axis), path, force=force)


def draw_sheet(
    before: Sequence[Numbered], after: Sequence[Numbered], path: str | os.PathLike[str], *, force: bool = False
) -> None:
    """Write the figure of `clip_sheet` to a PNG, SVG or PDF file."""
    save(clip_sheet(before, after), path, force=force)


def clip_slice(before: Colours, after: Colours, at: int, *, axis: str = "x") -> Figure:
    """Plot a column or row of pixels over time, before and after.

    Parameters
    ----------
    before, after : uint8 array, shape (T, H, 3) or (T, W, 3)
        The column, or the row, of each frame.
    at : int
        Its index.
    axis : str
        ``"x"`` for a column, at that x; ``"y"`` for a row.

    Returns
    -------
    matplotlib.figure.Figure
        Time goes from left to right.
    """
    if before.shape != after.shape:
        raise SuppleError(f"before and after must be of one shape, found {before.shape} and {after.shape}")
    count, rows = before.shape[:2]
    # A hundred frames or rows to an inch, within limits: below _MOST, each has at least one dot.
    width = min(max(count / 100, 4.5), _MOST / DPI)
    height = min(max(rows / 100, 3.6), 0.68 * _MOST / DPI)
    stacked = width > 1.6 * height
    across, down = (1, 2) if stacked else (2, 1)
    made, parts = sheet(across * (width + 0.5) + 0.4, down * (height + 0.4) + 0.7, down, across)
    for axes, cut, name in zip(parts, (before, after), ("Before", "After"), strict=True):
        seen = _fewer(_fewer(cut, _MOST).swapaxes(0, 1), _MOST)
        edges = (-0.5, count - 0.5, rows - 0.5, -0.5)
        axes.imshow(seen, extent=edges, aspect="auto", interpolation="nearest")
        axes.set_title(name, fontsize=11, loc="left")
        axes.tick_params(labelsize=8)
    for axes in parts[down - 1 :]:
        axes.set_xlabel("t (frames)")
    for axes in parts[:down]:
        axes.set_ylabel("y (px)" if axis == "x" else "x (px)")
    title(made, f"The {'column' if axis == 'x' else 'row'} {axis} = {at} over time")
    return made


def clip_sheet(before: Sequence[Numbered], after: Sequence[Numbered]) -> Figure:
    """Plot frames of a clip side by side, and the warped frames below them.

    Parameters
    ----------
    before, after : sequence of (int, uint8 array of shape (H, W, 3))
        The frames' indices, and the frames.

    Returns
    -------
    matplotlib.figure.Figure
    """
    if not before or len(before) != len(after):
        raise SuppleError(f"before and after must be as many frames, found {len(before)} and {len(after)}")
    rows, columns = before[0][1].shape[:2]
    scale = min(_CELL, 20 / len(before)) / max(rows, columns)
    width, height = max(columns * scale, 0.9), max(rows * scale, 0.6)
    made, parts = sheet(len(before) * (width + 0.16) + 0.5, 2 * (height + 0.36) + 0.2, 2, len(before))
    for k, (number, frame) in enumerate([*before, *after]):
        _show_frame(parts[k], frame, scale, f"frame {number}")
    for axes, name in ((parts[0], "Before"), (parts[len(before)], "After")):
        axes.set_ylabel(name, fontsize=11)
    return made


def _show_frame(axes: Axes, frame: Colours, scale: float, caption: str) -> None:
    # A small frame keeps its pixels; a large one is averaged to the dots of the plot.
    (height, width), every = frame.shape[:2], max(1, int(1 / (scale * DPI)))
    seen = _fewer(_fewer(frame, -(-height // every)).swapaxes(0, 1), -(-width // every)).swapaxes(0, 1)
    kind = "nearest" if scale * DPI >= 2 else "antialiased"
    axes.imshow(seen, extent=(0, width, height, 0), interpolation=kind)
    axes.set_title(caption, fontsize=9)
    axes.set(xticks=[], yticks=[])


def _fewer(array: Colours, most: int) -> Colours:
    """Return means of neighbours along the first axis, at most ``most`` of them."""
    every = -(-len(array) // most)
    if every <= 1:
        return array
    starts = np.arange(0, len(array), every)
    counts = np.diff(np.append(starts, len(array)))
    sums = np.add.reduceat(array.astype(np.float32), starts, axis=0)
    return np.asarray(np.rint(sums / counts.reshape(-1, *[1] * (array.ndim - 1))), np.uint8)
