"""Plots of a deformation, and their data."""

from supple.errors import need

need("plot", "plots", "matplotlib")

from supple.plot.clip import clip_sheet, clip_slice, draw_sheet, draw_slice, evenly
from supple.plot.draw import WHATS, figure, plot
from supple.plot.frame import check_plot
from supple.plot.measure import (
    Errors,
    Footprints,
    Iterations,
    footprints,
    grid,
    iterations,
    residual,
    sources,
    stretch,
)

__all__ = [
    "WHATS",
    "Errors",
    "Footprints",
    "Iterations",
    "check_plot",
    "clip_sheet",
    "clip_slice",
    "draw_sheet",
    "draw_slice",
    "evenly",
    "figure",
    "footprints",
    "grid",
    "iterations",
    "plot",
    "residual",
    "sources",
    "stretch",
]
