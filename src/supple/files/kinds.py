"""What a file is warped as: a picture, a clip or a volume."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from supple.errors import SuppleError, shown
from supple.files.options import GridOptions, PathLike, VolumeOptions
from supple.media.image.formats import SUFFIXES as PICTURES
from supple.media.numbering import has_number
from supple.media.suffixes import CLIPS, CLIPS_OUT, VOLUMES_OUT, is_volume, suffix_of
from supple.strokes import Recipe

if TYPE_CHECKING:
    from supple.fields import Placed

Kind = Literal["picture", "clip", "volume"]

VIDEOS_OUT = frozenset(CLIPS_OUT) - {".gif"}
ONE_FILE = frozenset({".nii", ".nii.gz", ".nrrd", ".mha"})
"""The suffixes of files that are always volumes."""
_TIFF = (".tif", ".tiff")
_PERHAPS = (".gif", ".webp", ".png", ".apng", "")  # the suffixes of pictures that may be animated


def kind_of(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    options: VolumeOptions | None = None,
    *,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Kind:
    """Return what a file, a pattern or a folder is warped as: by its content and name, and by what is asked for.

    The pages of a TIFF are a volume if points, maps or the output have three axes, and pages otherwise. A folder of
    pictures, or an animation, is a clip if strokes have a time or keys.
    """
    known = options or VolumeOptions()
    if known.layout is not None or known.series is not None or _is_volume(source, target, recipe, maps, grid):
        return "volume"
    return "clip" if _is_clip(source, target, recipe) else "picture"


def _is_volume(
    source: PathLike, target: PathLike, recipe: Recipe, maps: Sequence[Placed], grid: GridOptions | None
) -> bool:
    counts = [stroke.ndim for stroke in recipe.strokes[:1]] + [each.map.ndim for each in maps[:1]]
    solid = 3 in counts or (grid is not None and grid.ndim == 3)
    volumes = suffix_of(target) in set(VOLUMES_OUT) - set(_TIFF)
    if os.path.isdir(source):
        return is_volume(source) or (volumes and not any(inner or files for _, inner, files in os.walk(source)))
    if suffix_of(source) in _TIFF:
        if not (solid or volumes):
            return False
        from supple.media.volume.pages import has_pages

        return has_pages(source)
    return is_volume(source)


def _is_clip(source: PathLike, target: PathLike, recipe: Recipe) -> bool:
    suffix, goal = suffix_of(source), suffix_of(target)
    timed = recipe.moves or (bool(recipe.strokes) and recipe.strokes[0].ndim == 3)
    if suffix in CLIPS or goal in VIDEOS_OUT or (has_number(source) and not os.path.isfile(source)):
        return True
    if os.path.isdir(source):
        return timed and not _holds_videos_alone(source)
    if timed and suffix in (".png", ".apng") and os.path.isfile(source):
        return is_animated(source)
    if suffix not in _PERHAPS:
        return False
    many = goal == ".gif" or has_number(target)
    return timed or (many and (suffix == ".gif" or is_animated(source)))


def is_animated(path: PathLike) -> bool:
    """Return whether an image has several frames."""
    if not os.path.isfile(path):
        return False
    from supple.media import sequence

    return sequence.is_animated(path)


def _holds_videos_alone(folder: PathLike) -> bool:
    """Return whether a folder holds videos, not frames."""
    try:
        suffixes = {suffix_of(name) for name in os.listdir(folder) if not name.startswith(".")}
    except OSError:
        return False
    return bool(suffixes & CLIPS) and not suffixes & PICTURES


def holds_volumes(path: PathLike) -> bool:
    """Return whether a folder holds volumes as separate files."""
    try:
        return os.path.isdir(path) and any(suffix_of(name) in ONE_FILE for name in os.listdir(path))
    except OSError:
        return False


def is_derived(source: PathLike, options: VolumeOptions) -> bool:
    """Return whether a volume is DICOM, from which DICOM is derived: slices into a folder."""
    if options.layout is not None:
        return False
    from supple.media.volume import is_dicom

    return is_dicom(source)


def refuse_places(recipe: Recipe, source: PathLike) -> None:
    """Raise SuppleError for a recipe in millimetres, unless it is for a volume."""
    if recipe.is_world:
        raise SuppleError(
            f"the recipe is in {recipe.space} millimetres, and {shown(source)} is no volume: give a recipe in pixels"
        )
