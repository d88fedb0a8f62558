"""Plots of a deformation, and their data."""

from supple.errors import need

need("plot", "plots", "matplotlib")

from supple.plot.clip import clip_sheet, clip_slice, draw_sheet, draw_slice
from supple.plot.draw import WHATS, figure, plot

__all__ = ["WHATS", "clip_sheet", "clip_slice", "draw_sheet", "draw_slice", "figure", "plot"]
