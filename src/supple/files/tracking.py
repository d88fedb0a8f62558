"""Tracking points through the frames of a clip by pyramidal Lucas-Kanade, and strokes that follow them."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from supple.engine.work import Array, Tell, silent
from supple.errors import SuppleError, TrackWarning, argument, listing, need, numbered, shown, warn
from supple.files.clips import counted_anew, open_clip, refuse_picture, warn_of_display
from supple.files.options import GB, PathLike
from supple.media.files import replacing
from supple.media.medium import Clip, opened
from supple.media.tracks import Convention, read_tracks
from supple.space.checks import point, refuse
from supple.strokes import Recipe, Stroke

Numbers = npt.NDArray[np.float64]
Step = tuple[Array, Array, Numbers]  # the same part of two consecutive frames, and (x, y) of its first pixel

_STRETCH = 16  # frames after which a path is verified by tracking it back
_WINDOW = 21  # pixels: the smallest side of the window; 1/36 of the shorter side of large frames
_REACH = 8  # windows on each side of a point: the part of a frame in which it is searched
_FARTHEST = 1.0  # pixels: the largest distance between path and path back, and between Lucas-Kanade and the template
_ALIKE = 0.8  # the correlation with the template below which a new one is taken
_LUMA = np.array((0.2126, 0.7152, 0.0722), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """The positions of a point in the frames of a clip.

    Parameters
    ----------
    frames : array of int64, shape (N,)
        Consecutive frames, counted from 0.
    points : array of float64, shape (N, 2)
        x and y in each frame, in pixels.
    errors : array of float64, shape (N,)
        The distance in pixels between the path and the path tracked back; 0 in the frame of the given point.
    lost : tuple of (int, str)
        The frames just before and after ``frames`` in which the point was lost, and why; empty at the ends of the clip.
    """

    frames: npt.NDArray[np.int64]
    points: Numbers
    errors: Numbers
    lost: tuple[tuple[int, str], ...]

    @property
    def keys(self) -> tuple[tuple[int, tuple[float, float]], ...]:
        """The positions as keys for `supple.Stroke.following`."""
        return tuple((int(k), (float(x), float(y))) for k, (x, y) in zip(self.frames, self.points, strict=True))


class _Template:
    """The samples around a point in a frame, and the affine map from this frame to the latest one."""

    def __init__(self, image: Array, at: Numbers, half: int) -> None:
        part, corner = _around(image, at, half)
        self.half, self.pixels, self.at, self.turn = half, part.astype(np.float32), at - corner, np.eye(2)

    def refined(self, image: Array, at: Numbers) -> Numbers | None:
        """Return a position near ``at`` at which the image looks like the template; None if there is none."""
        import cv2

        start = np.c_[self.turn, at - self.turn @ self.at].astype(np.float32)
        how = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-4)
        seen = image.astype(np.float32)
        try:
            alike, found = cv2.findTransformECC(self.pixels, seen, start, cv2.MOTION_AFFINE, how, None, 1)
        except cv2.error:  # no convergence
            return None
        turn = found[:, :2].astype(np.float64)
        place: Numbers = turn @ self.at + found[:, 2]
        if alike < _ALIKE or math.dist(place, at) > _FARTHEST or not 0.25 < np.linalg.det(turn) < 4:
            return None
        self.turn = turn
        return place


class _Walk:
    """A point that is tracked in one direction of time."""

    def __init__(self, at: Sequence[float], frame: int, shape: tuple[int, ...]) -> None:
        self.frame, self.points, self.errors = frame, [np.array(at, np.float64)], [0.0]
        self.window = max(_WINDOW, min(shape) // 36 | 1)
        self.why = ""  # the reason if the point was lost, else empty
        self._steps: list[Step] = []
        self._image: Array | None = None  # the previous frame
        self._template: _Template | None = None

    def see(self, image: Array) -> None:
        """Track the point into the next frame; the first call has the frame in which the point was given."""
        before, self._image, at = self._image, image, self.points[-1]
        if before is None:
            self._template = self._look(image, at)
            return
        part, corner = _around(before, at, _REACH * self.window)
        step = part.copy(), _around(image, at, _REACH * self.window)[0].copy(), corner
        place, self._template = self._taken(step, at, self._template)
        likely, edge = (2 * at - self.points[-2:][0], self.window) if place is None else (place, 0)
        if not (edge <= likely.min() and (likely + edge < image.shape[::-1]).all()):
            self.why = "it leaves the picture"
        elif place is None:
            self.why = "nothing there can be followed: it is flat, hidden, or at the edge"
        else:
            self._steps.append(step)
            self.points.append(place)
        if self.why or len(self._steps) == _STRETCH:
            self.settle()

    def settle(self) -> None:
        """Verify the latest steps by tracking them back; drop those whose path back ends elsewhere.

        If steps with the template fail, as on smooth objects that change their shape, they are tried without it.
        """
        steps, count = self._steps, len(self._steps)
        refined, missed = self.points[-count - 1 :], math.inf
        plain: list[Numbers] = []
        del self.points[len(self.points) - count :]
        for n, looks in itertools.product(range(count, 0, -1), (True, False)):
            plain = plain if looks or plain else self._way(steps, refined[0], looks=False)
            way = refined if looks else plain
            if n >= len(way):
                continue
            back = self._way([(after, before, corner) for before, after, corner in steps[n - 1 :: -1]], way[n], looks)
            distances = [math.dist(p, q) for p, q in zip(back[1:], way[n - 1 :: -1], strict=False)]
            apart = max(distances) if len(back) > n else math.inf
            if apart <= _FARTHEST:
                self.points += way[1 : n + 1]
                self.errors += distances[::-1]
                if not looks:
                    self._template = self._look(steps[n - 1][1], way[n] - steps[n - 1][2])
                break
            missed = apart
        else:
            n = 0
        if n < count:
            by = "" if math.isinf(missed) else f" by {missed:.2g} pixels"
            self.why = f"the ways forwards and backwards differ{by}"
        self._steps = []

    def _way(self, steps: Sequence[Step], at: Numbers, looks: bool) -> list[Numbers]:
        """Return ``at`` and the positions after each step, until the point is lost; ``looks`` uses a template."""
        way, template = [at], self._look(steps[0][0], at - steps[0][2]) if looks else None
        for step in steps:
            place, template = self._taken(step, way[-1], template)
            if place is None:
                break
            way.append(place)
        return way

    def _taken(self, step: Step, at: Numbers, template: _Template | None) -> tuple[Numbers | None, _Template | None]:
        """Return the position of a point after a step, None if it is lost; and the template for the next step."""
        import cv2

        before, after, corner = step
        low = before.min()
        scale = 255 / max(float(before.max()) - float(low), 1e-9)
        eight = [np.clip((image - np.float32(low)) * scale, 0, 255).astype(np.uint8) for image in (before, after)]
        start = (at - corner).astype(np.float32).reshape(1, 1, 2)
        lucas_kanade: Any = cv2.calcOpticalFlowPyrLK
        ended, seen, _ = lucas_kanade(*eight, start, None, winSize=(self.window, self.window), maxLevel=3)
        place: Numbers = ended[0, 0].astype(np.float64)
        if not seen[0, 0] or place.min() < 0 or (place > np.subtract(after.shape[::-1], 1)).any():
            return None, template
        if template is not None:
            better = template.refined(after, place)
            place, template = (place, self._look(after, place)) if better is None else (better, template)
        return place + corner, template

    def _look(self, image: Array, at: Numbers) -> _Template:
        return _Template(image, at, self.window * 3 // 4)


def track(
    path: PathLike, at: Sequence[Sequence[float]], *, memory: float = 2 * GB, tell: Tell = silent
) -> tuple[Tracked, ...]:
    """Track points through the frames of a clip.

    Each point is tracked from its frame to the last and to the first one by pyramidal Lucas-Kanade (Bouguet, 2000) on
    luma. Its position is refined by matching a template from its first frame under an affine map, by the enhanced
    correlation of Evangelidis and Psarakis (2008), so that it does not drift. Every 16 frames, the path is tracked
    back: where both are more than a pixel apart, the point is lost (Kalal and others, 2010), with a `TrackWarning` that
    names the frame.

    Parameters
    ----------
    path : str or os.PathLike
        A video, a pattern or a folder of pictures.
    at : sequence of (float, float, int)
        The points: x and y in pixels, and the frame, counted from 0.
    memory : float
        Bytes of memory for decoded frames, when tracking towards the first frame.
    tell : function of (str, int, int), optional
        Called with ``"track"``, the number of frames seen, and their total.

    Returns
    -------
    tuple of Tracked
        One for each point, in order.

    Raises
    ------
    SuppleError
        If the clip cannot be read, OpenCV is missing, a point is not in the clip, or all points are lost at once.
    """
    need("flow", "tracked points", "cv2")
    if not isinstance(path, str | os.PathLike):
        refuse("path", "the name of a clip", path)
    if opened(path, moves=True).kind != "clip":
        raise SuppleError(f"{shown(path)} is no clip, and has no frames through which a point goes: give a clip")
    refuse_picture(path)

    def once(count: int | None) -> tuple[Tracked, ...]:
        with open_clip(path, count=count) as clip:
            return _tracked(clip, at, memory, tell)

    return counted_anew(path, once)


def _tracked(clip: Clip, at: Sequence[Sequence[float]], memory: float, tell: Tell) -> tuple[Tracked, ...]:
    x0, y0, width, height = clip.display or (0, 0, *clip.layout.shape[::-1])
    points = [point(f"at[{i}]", each, (3,)) for i, each in enumerate(at)]
    for x, y, k in points:
        where, frames = f"the point ({x:g}, {y:g})", f"frames {numbered(0)} to {numbered(clip.count - 1)}"
        if not (k.is_integer() and 0 <= k < clip.count):
            raise SuppleError(f"{where} is of frame {numbered(k):g}, and {clip.name} has {frames}: give one of these")
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise SuppleError(f"{where} is not in the picture of {clip.name}, {width} x {height}: give one in it")
    if not points:
        refuse("at", "one point or more, (x, y, frame)", at)
    warn_of_display(clip)
    onwards, backwards = ([_Walk((x + x0, y + y0), int(k), clip.layout.shape) for x, y, k in points] for _ in range(2))
    first, last = (choose(walk.frame for walk in onwards) for choose in (min, max))
    done, total = 0, clip.count - first + last + 1
    for walks, sign in ((onwards, 1), (backwards, -1)):
        for k, image in _from(clip, first) if sign > 0 else _back(clip, last, memory):
            going = [walk for walk in walks if not walk.why]
            for walk in going:
                if sign * (k - walk.frame) >= 0:
                    walk.see(image)
            done += 1
            tell("track", done, total)
            if not going:
                break
        for walk in walks:
            walk.settle()
    return _joined(onwards, backwards, np.array([x0, y0]), clip.name)


def _joined(onwards: Sequence[_Walk], backwards: Sequence[_Walk], corner: Numbers, name: str) -> tuple[Tracked, ...]:
    """Join the paths of each point in both directions of time; warn of lost points."""
    tracks, lines = [], []
    for later, earlier in zip(onwards, backwards, strict=True):
        points = np.array([*earlier.points[:0:-1], *later.points]) - corner
        frames = later.frame - len(earlier.points) + 1 + np.arange(len(points))
        ends = ((int(frames[0]) - 1, earlier.why), (int(frames[-1]) + 1, later.why))
        lost = tuple(end for end in ends if end[1])
        tracks.append(Tracked(frames, points, np.array([*earlier.errors[:0:-1], *later.errors]), lost))
        x, y = later.points[0] - corner
        what = f"{name}: the point ({x:g}, {y:g}) of frame {numbered(later.frame)} is lost in frame"
        lines += [f"{what} {numbered(k)}: {why}" for k, why in lost]
    if lines and all(len(each.frames) == 1 for each in tracks):
        raise SuppleError(f"{lines[0]}: choose a corner or a spot that stays in sight")
    for line in lines:
        warn(line, TrackWarning)
    return tuple(tracks)


def _from(clip: Any, first: int) -> Iterator[tuple[int, Array]]:
    """Yield (frame, luma) from ``first`` on, as stored; for floats, which are linear light, the square root."""
    arrays = [np.empty((*group.shape, group.channels), clip.layout.dtype) for group in clip.layout.groups]
    samples, group = arrays[0], clip.layout.groups[0]
    family = "rgb" if clip.stills else clip.form.kind.family
    colours = group.channels - group.alpha >= 3 and family != "yuv"
    every = itertools.islice(enumerate(clip.frames()), first, None) if clip.stills else clip.frames_from(first)
    for k, frame in every:
        frame.copy_to(arrays)
        luma = (samples[..., :3] @ _LUMA).astype(samples.dtype) if colours else samples[..., 0].copy()
        yield k, np.sqrt(np.maximum(np.nan_to_num(luma), 0)) if luma.dtype.kind == "f" else luma


def _back(clip: Any, last: int, memory: float) -> Iterator[tuple[int, Array]]:
    """Yield (frame, luma) from ``last`` down to 0; decoded from key frames, in batches that fit ``memory``."""
    most = max(2, int(memory // (math.prod(clip.layout.shape) * clip.layout.dtype.itemsize)))
    while last >= 0:
        begin = max(last - _STRETCH, 0)
        begin = max(begin if clip.stills else clip.key_before(begin), last + 1 - most)
        yield from reversed(list(itertools.islice(_from(clip, begin), last + 1 - begin)))
        last = begin - 1


def _around(image: Array, at: Numbers, half: int) -> tuple[Array, Numbers]:
    """Return the part of an image around a point, and x and y of its first pixel."""
    x, y = (round(float(value)) for value in at)
    corner = max(x - half, 0), max(y - half, 0)
    return image[corner[1] : y + half + 1, corner[0] : x + half + 1], np.array(corner, np.float64)


def write_track(path: PathLike, tracks: Sequence[Tracked], *, force: bool = False, first: int = 0) -> None:
    """Write a table for `supple.media.tracks.read_tracks`: frame, x, y, error and, for several tracks, a name.

    The names are 1, 2 and so on; ``first`` is the number of the clip's first frame. SuppleError if the file exists and
    ``force`` is false, or it cannot be written.
    """
    lines = ["frame,x,y,error" + ",name" * (len(tracks) > 1)]
    for n, each in enumerate(tracks, 1):
        for k, *values in zip(each.frames, *each.points.T, each.errors, strict=True):
            cells = [str(first + k), *(str(round(float(value), 3)) for value in values), *[str(n)] * (len(tracks) > 1)]
            lines.append(",".join(cells))
    with replacing(path, force=force) as place:
        place.write_text("\n".join(lines) + "\n", "utf-8")


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
            warn(text, TrackWarning)
    return replace(recipe, strokes=tuple(made))
