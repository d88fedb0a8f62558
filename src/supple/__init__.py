"""Supple bends images, videos and volumes, as if by hand, and never tears them."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from supple.arrays import warp_batch
    from supple.deformation import Arrival, Deformation, Inverse, Report
    from supple.engine.sampling import Sampling
    from supple.errors import (
        DeviceWarning,
        FoldError,
        FoldWarning,
        MissWarning,
        OutsideWarning,
        SuppleError,
        ToleranceWarning,
        TrackWarning,
    )
    from supple.fields import Field, Inverted, Placed, compose, read_maps, to_sitk
    from supple.fields.checks import FieldReport
    from supple.files import warp_file
    from supple.files.maps import grid_of
    from supple.files.options import GridOptions
    from supple.files.tracking import Tracked, track
    from supple.space.affine import Affine
    from supple.space.domain import Domain
    from supple.space.freezing import Freeze
    from supple.space.geometry import Grid
    from supple.space.straighten import Straighten
    from supple.strokes import Recipe, Stroke
    from supple.strokes.keys import Key
    from supple.viewer.window.launch import view

__version__ = "0.1.0"

__all__ = [
    "Affine",
    "Arrival",
    "Deformation",
    "DeviceWarning",
    "Domain",
    "Field",
    "FieldReport",
    "FoldError",
    "FoldWarning",
    "Freeze",
    "Grid",
    "GridOptions",
    "Inverse",
    "Inverted",
    "Key",
    "MissWarning",
    "OutsideWarning",
    "Placed",
    "Recipe",
    "Report",
    "Sampling",
    "Straighten",
    "Stroke",
    "SuppleError",
    "ToleranceWarning",
    "TrackWarning",
    "Tracked",
    "compose",
    "grid_of",
    "read_maps",
    "to_sitk",
    "track",
    "view",
    "warp_batch",
    "warp_file",
]

# The module that defines each public name. Modules are imported on first use, as image libraries load slowly.
_HOMES = {
    "Affine": "space.affine",
    "Arrival": "deformation",
    "Deformation": "deformation",
    "DeviceWarning": "errors",
    "Domain": "space.domain",
    "Field": "fields",
    "FieldReport": "fields.checks",
    "FoldError": "errors",
    "FoldWarning": "errors",
    "Freeze": "space.freezing",
    "Grid": "space.geometry",
    "GridOptions": "files.options",
    "Inverse": "deformation",
    "Inverted": "fields",
    "Key": "strokes.keys",
    "MissWarning": "errors",
    "OutsideWarning": "errors",
    "Placed": "fields",
    "Recipe": "strokes",
    "Report": "deformation",
    "Sampling": "engine.sampling",
    "Straighten": "space.straighten",
    "Stroke": "strokes",
    "SuppleError": "errors",
    "ToleranceWarning": "errors",
    "TrackWarning": "errors",
    "Tracked": "files.tracking",
    "compose": "fields",
    "grid_of": "files.maps",
    "read_maps": "fields",
    "to_sitk": "fields",
    "track": "files.tracking",
    "view": "viewer.window.launch",
    "warp_batch": "arrays",
    "warp_file": "files",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'supple' has no attribute {name!r}")
    return getattr(import_module(f"supple.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*(name for name in globals() if name.startswith("__")), *__all__])
