"""Supple bends images, videos and volumes, as if by hand, and never tears them."""

from typing import TYPE_CHECKING

from supple.deformation import Deformation, Inverse, Report
from supple.domain import Domain
from supple.errors import FoldError, FoldWarning, SuppleError
from supple.strokes import Recipe, Stroke

if TYPE_CHECKING:
    from supple.files import warp_file

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
    "warp_file",
]


def __getattr__(name: str) -> object:
    # Files need a library that arrays do not: it is loaded when it is asked for.
    if name == "warp_file":
        from supple.files import warp_file

        return warp_file
    raise AttributeError(f"module 'supple' has no attribute {name!r}")
