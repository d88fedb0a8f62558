"""Supple bends images, videos and volumes, as if by hand, and never tears them."""

from supple.deformation import Deformation, Inverse, Report
from supple.domain import Domain
from supple.errors import FoldError, FoldWarning, SuppleError
from supple.strokes import Recipe, Stroke

__version__ = "0.1.0"

__all__ = [
    "Deformation",
    "Domain",
    "FoldError",
    "FoldWarning",
    "Inverse",
    "Recipe",
    "Report",
    "Stroke",
    "SuppleError",
]
