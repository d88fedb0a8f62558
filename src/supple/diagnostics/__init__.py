"""Pictures of a deformation, to judge it by, and the numbers behind them."""

from supple.diagnostics.draw import WHATS, figure, plot
from supple.diagnostics.measure import (
    Errors,
    Footprints,
    Iterations,
    footprints,
    grid,
    iterations,
    residual,
    stretch,
)

__all__ = [
    "WHATS",
    "Errors",
    "Footprints",
    "Iterations",
    "figure",
    "footprints",
    "grid",
    "iterations",
    "plot",
    "residual",
    "stretch",
]
