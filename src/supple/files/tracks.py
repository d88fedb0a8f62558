"""Strokes that follow the tracks of a file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from supple.engine.work import Tell, silent
from supple.errors import SuppleError, argument, shown
from supple.files.clips import open_clip
from supple.files.options import GB
from supple.files.tracking import track
from supple.media.tracks import Convention, read_tracks
from supple.strokes import Recipe, Stroke

PathLike = str | os.PathLike[str]
Outside = Literal["fade", "hold"]


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
    turn: bool = False,
    outside: Outside = "fade",
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
    convention, first
        As in `supple.media.tracks.read_tracks`.
    turn : bool
        Whether each stroke follows two tracks, one after the other: it moves with the first point, and turns and grows
        with the way to the second.
    outside : str
        What strokes do before and after their tracks, as in `supple.Stroke.following`.

    Raises
    ------
    SuppleError
        If the file cannot be read, a name is not in it, or there are neither one track nor as many as strokes (with
        ``turn``, two, or twice as many).
    """

    def height() -> int:
        with open_clip(clip) as opened:
            return opened.layout.shape[0]

    tracks = read_tracks(path, convention=convention, height=height, first=first)
    known = {track.name: track for track in tracks}
    for name in names:
        if name not in known:
            raise SuppleError(f"{shown(path)} has no track {name!r}: its tracks are {_listed(list(known))}")
    wanted = [known[name] for name in names] or list(tracks)
    which = range(len(recipe.strokes)) if strokes is None else strokes
    each = 2 if turn else 1
    if len(wanted) not in (each, each * len(which)):
        many = "1 stroke" if len(which) == 1 else f"{len(which)} strokes"
        one = "two for all, or two" if turn else "one for all, or one"
        turning = f", or {argument('track_turn')} to turn with two" if len(wanted) == 2 * len(which) else ""
        raise SuppleError(
            f"{shown(path)} has {len(wanted)} tracks, {_listed([track.name for track in wanted])}, for {many}: name "
            f"{one} for each{turning}"
        )
    made: list[Stroke] = list(recipe.strokes)
    for i, k in enumerate(which):
        own, *second = wanted if len(wanted) == each else wanted[each * i : each * (i + 1)]
        made[k] = made[k].following(own.keys, frame, second=second[0].keys if second else (), outside=outside)
    return replace(recipe, strokes=tuple(made))


def follow_points(
    recipe: Recipe,
    clip: PathLike,
    *,
    frame: int = 0,
    strokes: Sequence[int] | None = None,
    outside: Outside = "fade",
    memory: float = 2 * GB,
    tell: Tell = silent,
) -> Recipe:
    """Return a recipe whose strokes move along with what their points ``at`` show in a frame of a clip.

    The points are tracked through the clip by `supple.track`, in pixels of its frames.

    Parameters
    ----------
    recipe : Recipe
        Its strokes have points of two numbers.
    clip : str or os.PathLike
        A video, a pattern or a folder of pictures.
    frame : int
        The frame in which the strokes are where the recipe has them, counted from 0.
    strokes : sequence of int, optional
        The indices of the strokes; by default, all.
    outside : str
        As in `follow_tracks`.
    memory, tell
        As in `supple.track`.

    Raises
    ------
    SuppleError
        If a stroke has a time, or as in `supple.track`.
    """
    made = list(recipe.strokes)
    which = range(len(made)) if strokes is None else strokes
    for k in which:
        if made[k].ndim == 3:
            x, y, t = made[k].at
            raise SuppleError(
                f"a stroke with a time is not tracked, and ({x:g}, {y:g}, {t:g}) has one: leave out the times of its "
                f"points, and give {argument('track_frame', round(t))}"
            )
    found = track(clip, [(*made[k].at, frame) for k in which], memory=memory, tell=tell)
    for k, each in zip(which, found, strict=True):
        made[k] = made[k].following(each.keys, frame, outside=outside)
    return replace(recipe, strokes=tuple(made))


def _listed(names: Sequence[str]) -> str:
    few = [repr(name) for name in names[:6]]
    return ", ".join(few) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
