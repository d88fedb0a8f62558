"""The kind of a file, picture, clip, volume or store; decided once, by its content, name, output and strokes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, is_store
from supple.media.numbering import has_number
from supple.media.pictures import SUFFIXES as PICTURES
from supple.media.suffixes import CLIPS, CLIPS_OUT, VOLUMES_OUT, is_animation, is_volume, suffix_of
from supple.space.geometry import Grid

if TYPE_CHECKING:
    from supple.media import sequence, video
    from supple.media.stores.inputs import Source
    from supple.media.volume import Volume

Kind = Literal["picture", "clip", "volume", "store"]
Clip: TypeAlias = "sequence.Pictures | video.Clip"
"""An open image sequence or video, whose frames are read in order."""

VIDEOS_OUT = frozenset(CLIPS_OUT) - {".gif"}
ONE_FILE = frozenset({".nii", ".nii.gz", ".nrrd", ".mha"})
"""The suffixes of files that are always volumes."""
_TIFF = (".tif", ".tiff")
_MAY_MOVE = (".gif", ".webp", ".png", ".apng", "")  # the suffixes of pictures that may be animated


@dataclass(frozen=True, eq=False)
class Medium:
    """A file, a folder or a pattern of names, and what it is taken for; its header is read when it is asked for."""

    path: PathLike
    kind: Kind
    how: Mapping[str, Any] = field(default_factory=dict)  # of a volume: the options of `supple.media.volume.read`
    axes: int | None = None  # of points, maps and the output's grid; None if nothing says it

    @property
    def name(self) -> str:
        """The name for messages."""
        return shown(self.path)

    @cached_property
    def outline(self) -> Volume:
        """A volume without its samples, as `supple.media.volume.outline_of` returns it."""
        if self.kind == "store":
            return self.stored.outline
        from supple.media.volume import outline_of

        return outline_of(self.path, **self.how)

    @cached_property
    def stored(self) -> Source:
        """A source that is read and written block by block: a store, or a picture or volume that becomes one."""
        from supple.media.stores.inputs import open_source

        if not is_store(self.path) and opened(self.path, self.path, axes=self.axes, how=self.how).kind == "clip":
            kind = "folder without a volume" if os.path.isdir(self.path) else "clip"
            raise SuppleError(
                f"{self.name} is a {kind}, and blocks are of pictures, volumes and Zarr stores: give one of these"
            )
        return open_source(self.path, self.axes, self.how)

    @cached_property
    def grid(self) -> Grid | None:
        """The grid of a picture in pixels, or of a volume in millimetres; None for a clip."""
        if self.kind == "store":
            return self.stored.grid
        if self.kind == "volume":
            return self.outline.grid
        return picture_grid(self.path) if self.kind == "picture" else None


def opened(
    path: PathLike,
    target: PathLike = "",
    *,
    axes: int | None = None,
    moves: bool = False,
    how: Mapping[str, Any] | None = None,
) -> Medium:
    """Return a file, a pattern or a folder as a `Medium`, and decide its kind.

    Parameters
    ----------
    path : str or os.PathLike
    target : str or os.PathLike
        The output: where it has several frames or is a volume, the input is read as a clip or a volume if it can be;
        where either is a Zarr store, it is read block by block.
    axes : int, optional
        The number of axes of points, maps and the output's grid: with 3, the pages of a TIFF are a volume.
    moves : bool
        Whether strokes have a time or move from frame to frame: then animated pictures and a folder of pictures are a
        clip.
    how : mapping, optional
        Options of `supple.media.volume.read`; with ``raw`` or ``series``, it is a volume.
    """
    goal, how = suffix_of(target), how or {}
    kind: Kind = "clip"
    if is_store(path) or (target and is_store(target)):
        kind = "store"
    elif {"raw", "series"} & {*how} or _is_volume(path, goal, axes == 3):
        kind = "volume"
    elif not _is_clip(path, target, goal, moves):
        kind = "picture"
    return Medium(path, kind, how, axes)


def _is_volume(path: PathLike, goal: str, solid: bool) -> bool:
    wanted = goal in VOLUMES_OUT and goal not in _TIFF
    if os.path.isdir(path):
        return is_volume(path) or (wanted and not any(inner or files for _, inner, files in os.walk(path)))
    if suffix_of(path) not in _TIFF:
        return is_volume(path)
    if not (solid or wanted):
        return False
    from supple.media.volume.pages import has_pages

    return has_pages(path)


def _is_clip(path: PathLike, target: PathLike, goal: str, timed: bool) -> bool:
    suffix = suffix_of(path)
    if suffix in CLIPS or goal in VIDEOS_OUT or (has_number(path) and not os.path.isfile(path)):
        return True
    if os.path.isdir(path):
        suffixes = _suffixes_in(path)
        return timed and not (bool(suffixes & CLIPS) and not suffixes & PICTURES)  # videos alone
    if timed and suffix in (".png", ".apng") and os.path.isfile(path):
        return is_animated(path)
    if suffix not in _MAY_MOVE:
        return False
    if timed or (goal == suffix == ".gif"):
        return True
    return (goal == ".gif" or is_animation(target, path) or has_number(target)) and is_animated(path)


def is_animated(path: PathLike) -> bool:
    """Return whether an image has several frames; False for unreadable files."""
    if not os.path.isfile(path):
        return False
    from supple.media.image.vips import pages_of

    form, count = pages_of(path)
    return form in ("GIF", "PNG", "WebP") and count > 1


def picture_grid(path: PathLike) -> Grid:
    """Return the grid of a picture, in pixels, from its header."""
    from supple.media.image import info

    facts = info(path)
    return Grid((int(str(facts["height"])), int(str(facts["width"]))))


def holds_volumes(path: PathLike) -> bool:
    """Return whether a folder holds volumes as separate files."""
    return os.path.isdir(path) and bool(_suffixes_in(path) & ONE_FILE)


def _suffixes_in(folder: PathLike) -> set[str]:
    try:
        return {suffix_of(name) for name in os.listdir(folder) if not name.startswith(".")}
    except OSError:
        return set()
