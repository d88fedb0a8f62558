"""Strokes that follow the tracks of a file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace

from supple.errors import SuppleError, shown
from supple.files.clips import open_clip
from supple.media.tracks import Convention, read_tracks
from supple.strokes import Recipe, Stroke

PathLike = str | os.PathLike[str]


def follow_tracks(
    recipe: Recipe,
    path: PathLike,
    clip: PathLike,
    *,
    names: Sequence[str] = (),
    frame: int | None = None,
    strokes: Sequence[int] | None = None,
    convention: Convention | None = None,
    first: int | None = None,
    frames: Callable[[str, str], int] | None = None,
) -> Recipe:
    """Return a recipe whose strokes move along with the tracks of a file.

    Parameters
    ----------
    recipe : Recipe
        Its strokes have points of two numbers.
    path : str or os.PathLike
        A file that `supple.media.tracks.read_tracks` reads.
    clip : str or os.PathLike
        The clip, whose height is needed for positions of Nuke.
    names : sequence of str
        The tracks to follow: one for all strokes, or one for each, in order. By default all tracks of the file.
    frame : int, optional
        The frame in which the strokes are where the recipe has them; by default, the first of each track.
    strokes : sequence of int, optional
        The indices of the strokes; by default, all.
    convention, first, frames
        As in `supple.media.tracks.read_tracks`.

    Raises
    ------
    SuppleError
        If the file cannot be read, a name is not in it, or there are neither one track nor as many as strokes.
    """

    def height() -> int:
        with open_clip(clip) as opened:
            return opened.layout.shape[0]

    tracks = read_tracks(path, convention=convention, height=height, first=first, frames=frames)
    known = {track.name: track for track in tracks}
    for name in names:
        if name not in known:
            raise SuppleError(f"{shown(path)} has no track {name!r}: its tracks are {_listed(list(known))}")
    wanted = [known[name] for name in names] or list(tracks)
    which = range(len(recipe.strokes)) if strokes is None else strokes
    if len(wanted) not in (1, len(which)):
        many = "1 stroke" if len(which) == 1 else f"{len(which)} strokes"
        raise SuppleError(
            f"{shown(path)} has {len(wanted)} tracks, {_listed([track.name for track in wanted])}, for {many}: name "
            "one for all, or one for each"
        )
    made: list[Stroke] = list(recipe.strokes)
    for k, track in zip(which, wanted * len(which) if len(wanted) == 1 else wanted, strict=True):
        made[k] = made[k].following(track.keys, frame)
    return replace(recipe, strokes=tuple(made))


def _listed(names: Sequence[str]) -> str:
    few = [repr(name) for name in names[:6]]
    return ", ".join(few) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
