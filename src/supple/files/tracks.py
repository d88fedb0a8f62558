"""Making strokes follow tracks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

from supple.engine.work import Tell, silent
from supple.errors import SuppleError, TrackWarning, argument, caller, listing, numbered, shown
from supple.files.clips import open_clip
from supple.files.options import GB
from supple.files.tracking import track
from supple.media.files import PathLike
from supple.media.tracks import Convention, read_tracks
from supple.strokes import Recipe, Stroke


def follow_tracks(
    recipe: Recipe,
    path: PathLike | None,
    clip: PathLike,
    *,
    names: Sequence[str] = (),
    frame: int | None = None,
    strokes: Sequence[int] | None = None,
    convention: Convention | None = None,
    first: int | None = None,
    turn: bool = False,
    outside: Literal["fade", "hold"] = "fade",
    memory: float = 2 * GB,
    tell: Tell = silent,
    frames: Callable[[str, str], int] | None = None,
) -> Recipe:
    """Return a recipe whose strokes follow the tracks of a file, or the material under them.

    Parameters
    ----------
    recipe : Recipe
        A recipe whose strokes have points of two numbers.
    path : str, os.PathLike or None
        A file for `supple.media.tracks.read_tracks`. If None, `supple.track` tracks the point ``at`` of each stroke
        through the clip, starting from ``frame``.
    clip : str or os.PathLike
        The clip; its height is needed for Nuke's coordinates.
    names : sequence of str
        The tracks to follow: one for all strokes, or one for each, in order. By default all tracks of the file.
    frame : int, optional
        The frame to which the strokes' positions in the recipe refer; by default, the first of each track, or of the
        clip.
    strokes : sequence of int, optional
        The indices of the strokes; by default, all.
    convention, first, frames
        As in `supple.media.tracks.read_tracks`.
    turn : bool
        Whether each stroke follows two consecutive tracks: it moves with the first point, and turns and grows with the
        line from the first to the second.
    outside : str
        What strokes do before and after their tracks, as in `supple.Stroke.following`.
    memory, tell
        As in `supple.track`.

    Raises
    ------
    SuppleError
        If the file cannot be read; a name is not in it; or the number of tracks is neither one nor that of the strokes
        (with ``turn``, two, or twice as many); or as in `supple.track`.
    """

    def height() -> int:
        with open_clip(clip) as opened:
            return opened.layout.shape[0]

    made: list[Stroke] = list(recipe.strokes)
    which = [k for k, each in enumerate(made) if each.brush != "freeze"] if strokes is None else strokes
    if path is None:
        for k in which:
            if made[k].ndim == 3:
                x, y, t = made[k].at
                raise SuppleError(
                    f"a stroke with a time is not tracked, and ({x:g}, {y:g}, {numbered(t):g}) has one: leave out the "
                    f"times of its points, and give {argument('track_frame', round(numbered(t)))}"
                )
        found = track(clip, [(*made[k].at, frame or 0) for k in which], memory=memory, tell=tell)
        for k, seen in zip(which, found, strict=True):
            made[k] = made[k].following(seen.keys, frame or 0, outside=outside)
        return replace(recipe, strokes=tuple(made))
    tracks = read_tracks(path, convention=convention, height=height, first=first, frames=frames)
    known = {track.name: track for track in tracks}
    for name in names:
        if name not in known:
            raise SuppleError(
                f"{shown(path)} has no track {name!r}: its tracks are {listing(list(map(repr, known)), 6)}"
            )
    wanted = [known[name] for name in names] or list(tracks)
    each = 2 if turn else 1
    if len(wanted) < each:
        raise SuppleError(
            f"{shown(path)} has one track, and {argument('track_turn')} turns strokes by two, of points of one thing: "
            "track one more, or leave it out"
        )
    if len(wanted) not in (each, each * len(which)):
        many = "1 stroke" if len(which) == 1 else f"{len(which)} strokes"
        one = "two for all, or two" if turn else "one for all, or one"
        turning = f", or {argument('track_turn')} to turn with two" if len(wanted) == 2 * len(which) else ""
        names = listing([repr(track.name) for track in wanted], 6)
        raise SuppleError(f"{shown(path)} has {len(wanted)} tracks, {names}, for {many}: name {one} for each{turning}")
    for i, k in enumerate(which):
        own, *second = wanted if len(wanted) == each else wanted[each * i : each * (i + 1)]
        made[k] = made[k].following(own.keys, frame, second=second[0].keys if second else (), outside=outside)
    for alone in wanted:
        if len(alone.keys) == 1:
            at, what = numbered(alone.keys[0][0]), "fades beside it" if outside == "fade" else "stays there"
            text = f"{shown(path)}: a track has frame {at} alone: what follows it does not move, and {what}"
            warnings.warn(text, TrackWarning, stacklevel=caller())
    return replace(recipe, strokes=tuple(made))
