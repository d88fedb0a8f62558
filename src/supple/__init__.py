"""Supple bends images, videos and volumes, as if by hand, and never tears them."""

from importlib import import_module

TYPE_CHECKING = False  # not imported, as an interrupt of imports here would be a traceback
if TYPE_CHECKING:
    from supple.arrays import warp_batch as warp_batch
    from supple.deformation import Arrival as Arrival
    from supple.deformation import Deformation as Deformation
    from supple.deformation import Inverse as Inverse
    from supple.deformation import Report as Report
    from supple.engine.sampling import Sampling as Sampling
    from supple.errors import DeviceWarning as DeviceWarning
    from supple.errors import FoldError as FoldError
    from supple.errors import FoldWarning as FoldWarning
    from supple.errors import MissWarning as MissWarning
    from supple.errors import OutsideWarning as OutsideWarning
    from supple.errors import SuppleError as SuppleError
    from supple.errors import ToleranceWarning as ToleranceWarning
    from supple.errors import TrackWarning as TrackWarning
    from supple.fields import Field as Field
    from supple.fields import Inverted as Inverted
    from supple.fields import Placed as Placed
    from supple.fields import compose as compose
    from supple.fields import read_maps as read_maps
    from supple.fields import to_sitk as to_sitk
    from supple.fields.checks import FieldReport as FieldReport
    from supple.files import warp_file as warp_file
    from supple.files.maps import grid_of as grid_of
    from supple.files.options import GridOptions as GridOptions
    from supple.files.tracking import Tracked as Tracked
    from supple.files.tracking import track as track
    from supple.space.affine import Affine as Affine
    from supple.space.domain import Domain as Domain
    from supple.space.freezing import Freeze as Freeze
    from supple.space.geometry import Grid as Grid
    from supple.space.straighten import Straighten as Straighten
    from supple.strokes import Recipe as Recipe
    from supple.strokes import Stroke as Stroke
    from supple.strokes.keys import Key as Key
    from supple.viewer.window.launch import view as view

__version__ = "0.1.0"

# The public names by the modules that define them. Modules are imported on first use, as image libraries load slowly.
_NAMES = {
    "arrays": "warp_batch",
    "deformation": "Arrival Deformation Inverse Report",
    "engine.sampling": "Sampling",
    "errors": "DeviceWarning FoldError FoldWarning MissWarning OutsideWarning SuppleError "
    "ToleranceWarning TrackWarning",
    "fields": "Field Inverted Placed compose read_maps to_sitk",
    "fields.checks": "FieldReport",
    "files": "warp_file",
    "files.maps": "grid_of",
    "files.options": "GridOptions",
    "files.tracking": "Tracked track",
    "space.affine": "Affine",
    "space.domain": "Domain",
    "space.freezing": "Freeze",
    "space.geometry": "Grid",
    "space.straighten": "Straighten",
    "strokes": "Recipe Stroke",
    "strokes.keys": "Key",
    "viewer.window.launch": "view",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'supple' has no attribute {name!r}")
    return getattr(import_module(f"supple.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*(name for name in globals() if name.startswith("__")), *__all__])
