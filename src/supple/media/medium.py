"""The kind of a file, picture, clip or volume; decided once, by its content, its name, the output and the strokes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeAlias

from supple.errors import shown
from supple.media.files import PathLike
from supple.media.numbering import has_number
from supple.media.pictures import SUFFIXES as PICTURES
from supple.media.suffixes import CLIPS, CLIPS_OUT, VOLUMES_OUT, is_animation, is_volume, suffix_of
from supple.space.geometry import Grid

if TYPE_CHECKING:
    from supple.media import sequence, video
    from supple.media.volume import RawLayout, Volume

Kind = Literal["picture", "clip", "volume"]
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
    layout: RawLayout | None = None  # this and the next are of volumes, as in `supple.media.volume.read`
    series: str | None = None
    irregular: str | None = None

    @property
    def name(self) -> str:
        """The name for messages."""
        return shown(self.path)

    @cached_property
    def outline(self) -> Volume:
        """A volume without its samples, as `supple.media.volume.outline_of` returns it."""
        from supple.media.volume import outline_of

        return outline_of(self.path, raw=self.layout, series=self.series, irregular=self.irregular)

    @cached_property
    def grid(self) -> Grid | None:
        """The grid of a picture in pixels, or of a volume in millimetres; None for a clip."""
        if self.kind == "volume":
            return self.outline.grid
        return picture_grid(self.path) if self.kind == "picture" else None

    @property
    def is_dicom(self) -> bool:
        """True if it is a volume in DICOM."""
        if self.kind != "volume" or self.layout is not None:
            return False
        from supple.media.volume import is_dicom

        return is_dicom(self.path)


def opened(
    path: PathLike,
    target: PathLike = "",
    *,
    axes: int = 2,
    moves: bool = False,
    layout: RawLayout | None = None,
    series: str | None = None,
    irregular: str | None = None,
) -> Medium:
    """Return a file, a pattern or a folder as a `Medium`, and decide its kind.

    Parameters
    ----------
    path : str or os.PathLike
    target : str or os.PathLike
        The output: where it has several frames or is a volume, the input is read as a clip or a volume if it can be.
    axes : int
        The number of axes of points, maps and the output's grid: with 3, the pages of a TIFF are a volume.
    moves : bool
        Whether strokes have a time or move from frame to frame: then animated pictures and a folder of pictures are a
        clip.
    layout, series, irregular
        As in `supple.media.volume.read`; with one of the first two, it is a volume.
    """
    goal = suffix_of(target)
    if layout is not None or series is not None or _is_volume(path, goal, axes == 3):
        return Medium(path, "volume", layout, series, irregular)
    return Medium(path, "clip" if _is_clip(path, target, goal, moves) else "picture")


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
