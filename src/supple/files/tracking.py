"""Points of a clip, tracked through its frames by pyramidal Lucas-Kanade, forwards and backwards."""

from __future__ import annotations

import itertools
import math
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engine.work import Array, Tell, silent
from supple.errors import SuppleError, TrackWarning, caller, need, shown
from supple.files.clips import displayed, fickle, open_clip, refuse_picture
from supple.files.options import GB, PathLike
from supple.media.base import Clip, ClipWarning, CountError
from supple.media.files import check_suffix, replacing
from supple.media.medium import opened
from supple.space.checks import point, refuse

Numbers = npt.NDArray[np.float64]
Box = tuple[int, int, int, int]  # x and y of the first pixel, and of the one after the last

_SUFFIXES = (".csv", ".txt")
_STRETCH = 16  # frames that are followed back before the way forwards counts
_WINDOW = 21  # pixels that are compared, at least: a 36th of the height of larger frames
_REACH = 8  # windows on each side of a point: the pixels in which it is searched
_FARTHEST = 1.0  # pixels between both ways, and between Lucas-Kanade and the template
_ALIKE = 0.8  # correlation with the template, below which another one is taken
_LUMA = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """Where a point is in the frames of a clip.

    Parameters
    ----------
    frames : array of int64, shape (N,)
        Consecutive frames, counted from 0.
    points : array of float64, shape (N, 2)
        x and y in each frame, in pixels.
    errors : array of float64, shape (N,)
        The distance in pixels between the way forwards and the way back from up to 16 frames later; 0 in the frame in
        which the point was given.
    lost : tuple of (int, str)
        The frames, at most one at each end, in which the point was lost, and why.
    """

    frames: npt.NDArray[np.int64]
    points: Numbers
    errors: Numbers
    lost: tuple[tuple[int, str], ...]

    @property
    def keys(self) -> tuple[tuple[int, tuple[float, float]], ...]:
        """The positions, as `supple.Stroke.following` takes them."""
        return tuple((int(k), (float(x), float(y))) for k, (x, y) in zip(self.frames, self.points, strict=True))


class _Template:
    """What is around a point in a frame, and the affine map from there to the frame that was seen last."""

    def __init__(self, image: Array, at: Numbers, half: int) -> None:
        x, y, right, bottom = _box(image.shape, at, half)
        self.half, self.pixels, self.at = half, image[y:bottom, x:right].astype(np.float32), at - (x, y)
        self.turn = np.eye(2)

    def refined(self, image: Array, at: Numbers) -> Numbers | None:
        """Return a position near ``at`` at which the image looks like the template; None if there is none."""
        import cv2

        start = np.c_[self.turn, at - self.turn @ self.at].astype(np.float32)
        how = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-4)
        try:
            alike, found = cv2.findTransformECC(
                self.pixels, image.astype(np.float32), start, cv2.MOTION_AFFINE, how, None, 1
            )
        except cv2.error:  # it does not converge
            return None
        turn, shift = found[:, :2].astype(np.float64), found[:, 2]
        place: Numbers = turn @ self.at + shift
        if alike < _ALIKE or math.dist(place, at) > _FARTHEST or not 0.25 < np.linalg.det(turn) < 4:
            return None
        self.turn = turn
        return place


@dataclass(frozen=True, slots=True)
class _Step:
    """The same part of two consecutive frames, and where it begins."""

    before: Array
    after: Array
    corner: tuple[int, int]

    @property
    def reversed(self) -> _Step:
        return _Step(self.after, self.before, self.corner)

    def taken(self, at: Numbers, window: int, template: _Template | None) -> tuple[Numbers | None, _Template | None]:
        """Return where a point goes, None if nothing is seen of it; and the template from then on."""
        import cv2

        low, high = float(self.before.min()), float(self.before.max())
        before, after = (_scaled(image, low, high) for image in (self.before, self.after))
        start = (at - self.corner).astype(np.float32).reshape(1, 1, 2)
        lucas_kanade: Any = cv2.calcOpticalFlowPyrLK
        ended, seen, _ = lucas_kanade(before, after, start, None, winSize=(window, window), maxLevel=3)
        place: Numbers = ended[0, 0].astype(np.float64)
        height, width = self.after.shape
        if not seen[0, 0] or not (0 <= place[0] <= width - 1 and 0 <= place[1] <= height - 1):
            return None, template
        if template is not None:
            better = template.refined(self.after, place)
            place = place if better is None else better
            template = _Template(self.after, place, template.half) if better is None else template
        return place + self.corner, template


class _Walk:
    """A point on its way through frames in one direction of time."""

    def __init__(self, at: tuple[float, float, int], box: Box) -> None:
        self.begin, self.box = at[2], box  # the pixels in which points count
        self.window = max(_WINDOW, min(box[2] - box[0], box[3] - box[1]) // 36 | 1)
        self._half = self.window * 3 // 4  # of the template
        self.points = [np.array(at[:2], np.float64)]
        self.errors = [0.0]
        self.why = ""  # it was lost, if not empty
        self._steps: list[_Step] = []
        self._image: Array | None = None  # the frame before
        self._template: _Template | None = None

    def see(self, image: Array) -> None:
        """Go on to the next frame; the first is that in which the point was given."""
        if self._image is not None and not self.why:
            self._advance(self._image, image)
        if self._image is None:
            self._template = _Template(image, self.points[0], self._half)
        self._image = image

    def _advance(self, before: Array, after: Array) -> None:
        at = self.points[-1]
        x, y, right, bottom = _box(after.shape, at, _REACH * self.window)
        step = _Step(before[y:bottom, x:right].copy(), after[y:bottom, x:right].copy(), (x, y))
        place, self._template = step.taken(at, self.window, self._template)
        likely, edge = (2 * at - self.points[-2:][0], self.window // 2) if place is None else (place, 0)
        left, top, right, bottom = self.box
        if not (left + edge <= likely[0] < right - edge and top + edge <= likely[1] < bottom - edge):
            self.why = "it leaves the picture"
        elif place is None:
            self.why = "nothing there can be followed: it is flat, or gone"
        else:
            self._steps.append(step)
            self.points.append(place)
        if self.why or len(self._steps) == _STRETCH:
            self.settle()

    def settle(self) -> None:
        """Follow the last steps back; leave out those that do not lead to where they began."""
        count, begin = len(self._steps), len(self.points) - len(self._steps)
        refined, missed = self.points[begin - 1 :], math.inf
        del self.points[begin:]
        for n, way, half in self._ways(refined, count):
            back = self._way([step.reversed for step in reversed(self._steps[:n])], way[n], half)
            distances = [math.dist(p, q) for p, q in zip(back[1:], way[n - 1 :: -1], strict=False)]
            apart = max(distances) if len(back) > n else math.inf
            if apart <= _FARTHEST:
                self.points += way[1 : n + 1]
                self.errors += distances[::-1]
                if half is None:
                    last = self._steps[n - 1]
                    self._template = _Template(last.after, way[n] - last.corner, self._half)
                break
            missed = apart
        if len(self.points) - begin < count:
            by = "" if math.isinf(missed) else f" by {missed:.2g} pixels"
            self.why = f"the ways forwards and backwards differ{by}"
        self._steps = []

    def _ways(self, refined: list[Numbers], count: int) -> Iterator[tuple[int, list[Numbers], int | None]]:
        """Yield steps to take, the longest first: refined, and as Lucas-Kanade alone has them.

        On smooth things that change their shape, the template misleads.
        """
        plain: list[Numbers] = []
        for n in range(count, 0, -1):
            yield n, refined, self._half
            plain = plain or self._way(self._steps, refined[0], None)
            if n < len(plain):
                yield n, plain, None

    def _way(self, steps: Sequence[_Step], at: Numbers, half: int | None) -> list[Numbers]:
        """Return the positions after steps, from ``at`` on, as far as something is seen."""
        way, place = [at], at
        template = None if half is None else _Template(steps[0].before, at - steps[0].corner, half)
        for step in steps:
            taken, template = step.taken(place, self.window, template)
            if taken is None:
                break
            way.append(place := taken)
        return way


def track(
    path: PathLike, at: Sequence[Sequence[float]], *, memory: float = 2 * GB, tell: Tell = silent
) -> tuple[Tracked, ...]:
    """Return where points of a clip are in its frames.

    Each point is followed from its frame to the last and to the first one by pyramidal Lucas-Kanade (Bouguet, 2000) on
    luma, and placed where the frame looks like the one in which it was given (an affine map of what is around it, by
    the enhanced correlation of Evangelidis and Psarakis, 2008), so that it does not drift. It is followed back, too:
    where both ways are more than a pixel apart in up to 16 frames, it is lost (Kalal and others, 2010).

    Parameters
    ----------
    path : str or os.PathLike
        A video, a pattern or a folder of pictures.
    at : sequence of (float, float, int)
        The points: x and y in pixels, and the frame, counted from 0.
    memory : float
        The bytes that decoded frames may take, on the way to the first frame.
    tell : function of (str, int, int), optional
        Called with ``"track"``, the number of frames seen, and their total.

    Returns
    -------
    tuple of Tracked
        One for each point, in order.

    Warns
    -----
    TrackWarning
        If a point is lost before the clip ends or begins, with the frame.

    Raises
    ------
    SuppleError
        If the clip cannot be read, OpenCV is missing, a point is not in the clip, or all points are lost at once.
    """
    need("flow", "tracked points", "cv2")
    if opened(path, moves=True).kind != "clip":
        raise SuppleError(f"{shown(path)} is no clip, and has no frames through which a point goes: give a clip")
    refuse_picture(path)
    count: int | None = None
    while True:  # twice at most: what a container says of the number of frames may be wrong
        try:
            with open_clip(path, count=count) as clip:
                return _tracked(clip, at, memory, tell)
        except CountError as miscounted:
            if count is not None:
                raise fickle(path) from None
            count = miscounted.found


def _tracked(clip: Clip, at: Sequence[Sequence[float]], memory: float, tell: Tell) -> tuple[Tracked, ...]:
    x, y, width, height = clip.display or (0, 0, *clip.layout.shape[::-1])
    begins = [_checked(f"at[{i}]", each, clip, width, height) for i, each in enumerate(at)]
    if not begins:
        refuse("at", "one point or more, (x, y, frame)", at)
    if how := displayed(clip.rotation, clip.mirrored):
        what = f"is {how} when it is played: points are in the frame as it is stored, {width} x {height}"
        warnings.warn(f"{clip.name} {what}", ClipWarning, stacklevel=caller())
    box = (x, y, x + width, y + height)
    both = [[_Walk((p + x, q + y, k), box) for p, q, k in begins] for _ in range(2)]
    first, last = (choose(k for _, _, k in begins) for choose in (min, max))
    done, total = 0, clip.count - first + last + 1
    for walks, frames in zip(both, (_onwards(clip, first), _backwards(clip, last, memory)), strict=True):
        for k, image in frames:
            for walk in walks:
                if not walk.why and (k >= walk.begin if walks is both[0] else k <= walk.begin):
                    walk.see(image)
            done += 1
            tell("track", done, total)
            if all(walk.why for walk in walks):
                break
        for walk in walks:
            walk.settle()
    return _joined(both[0], both[1], np.array([x, y]), clip.name)


def _checked(name: str, given: Sequence[float], clip: Clip, width: int, height: int) -> tuple[float, float, int]:
    x, y, k = point(name, given, (3,))
    where, frames = f"the point ({x:g}, {y:g})", f"frames 0 to {clip.count - 1}"
    if not (k.is_integer() and 0 <= k < clip.count):
        raise SuppleError(f"{where} is of frame {k:g}, and {clip.name} has {frames}: give one of these")
    if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        raise SuppleError(f"{where} is not in the picture of {clip.name}, which is {width} x {height}: give one in it")
    return x, y, int(k)


def _joined(onwards: Sequence[_Walk], backwards: Sequence[_Walk], corner: Numbers, name: str) -> tuple[Tracked, ...]:
    """Return both ways of each point as one; warn of those that are lost."""
    tracks, lines = [], []
    for later, earlier in zip(onwards, backwards, strict=True):
        points = np.array([*earlier.points[:0:-1], *later.points]) - corner
        frames = later.begin - len(earlier.points) + 1 + np.arange(len(points))
        errors = np.array([*earlier.errors[:0:-1], *later.errors])
        ends = ((int(frames[0]) - 1, earlier.why), (int(frames[-1]) + 1, later.why))
        tracks.append(Tracked(frames, points, errors, tuple(end for end in ends if end[1])))
        x, y = later.points[0] - corner
        where = f"the point ({x:g}, {y:g}) of frame {later.begin}"
        lines += [f"{name}: {where} is lost in frame {k}: {why}" for k, why in tracks[-1].lost]
    if lines and all(len(each.frames) == 1 for each in tracks):
        raise SuppleError(f"{lines[0]}: choose a corner or a spot that stays in sight")
    for line in lines:
        warnings.warn(line, TrackWarning, stacklevel=caller())
    return tuple(tracks)


def _onwards(clip: Any, first: int) -> Iterator[tuple[int, Array]]:
    """Yield the luma of frames from ``first`` on."""
    arrays = [np.empty((*group.shape, group.channels), clip.layout.dtype) for group in clip.layout.groups]
    seeks = hasattr(clip, "frames_from")  # image sequences need none
    for k, frame in clip.frames_from(first) if seeks else itertools.islice(enumerate(clip.frames()), first, None):
        frame.copy_to(arrays)
        yield k, _luma(clip, arrays[0])


def _backwards(clip: Any, last: int, memory: float) -> Iterator[tuple[int, Array]]:
    """Yield the luma of frames from ``last`` to 0: decoded from key frames on, as many at once as memory allows."""
    size = math.prod(clip.layout.shape) * max(clip.layout.dtype.itemsize, 1 if _is_luma(clip) else 4)
    most = max(2, int(memory // size))
    while last >= 0:
        begin = max(last - _STRETCH, 0)
        begin = max(clip.key_before(begin) if hasattr(clip, "key_before") else begin, last + 1 - most)
        yield from reversed(list(itertools.islice(_onwards(clip, begin), last + 1 - begin)))
        last = begin - 1


def _is_luma(clip: Any) -> bool:
    """Return whether the first component of frames is grey or luma."""
    group = clip.layout.groups[0]
    family = clip.form.kind.family if hasattr(clip, "form") else "rgb"
    return group.channels - group.alpha < 3 or family == "yuv"


def _luma(clip: Any, samples: Array) -> Array:
    """Return a copy of the luma of a frame, as stored; of floats its root, as these are linear light."""
    if _is_luma(clip):
        values: Array = samples[..., 0].copy()
    else:
        values = samples[..., :3].astype(np.float32) @ np.array(_LUMA, np.float32)
    return np.sqrt(np.maximum(np.nan_to_num(values), 0)) if clip.layout.dtype.kind == "f" else values


def _box(shape: tuple[int, ...], at: Numbers, half: int) -> Box:
    """Return the part of an image around a point."""
    x, y = (round(float(value)) for value in at)
    return max(x - half, 0), max(y - half, 0), min(x + half + 1, shape[1]), min(y + half + 1, shape[0])


def _scaled(image: Array, low: float, high: float) -> npt.NDArray[np.uint8]:
    """Return values from ``low`` to ``high`` as 8 bits."""
    scale = 255 / (high - low) if high > low else 0.0
    values: Array = (image.astype(np.float32) - low) * scale + 0.5
    return np.clip(values, 0, 255).astype(np.uint8)


def write_track(path: PathLike, tracks: Sequence[Tracked], *, force: bool = False) -> None:
    """Write a table that `supple.media.tracks.read_tracks` reads: frame, x, y and error; of several tracks, a name.

    The names are 1, 2 and so on. SuppleError if the file exists and ``force`` is false, or it cannot be written.
    """
    check_target(path)
    named = len(tracks) > 1
    lines = ["frame,x,y,error" + ",name" * named]
    for n, each in enumerate(tracks, 1):
        for k, (x, y), error in zip(each.frames, each.points, each.errors, strict=True):
            values = (round(float(value), 3) for value in (x, y, error))
            lines.append(",".join([str(k), *map(str, values), *([str(n)] if named else [])]))
    with replacing(path, force=force) as place:
        place.write_text("\n".join(lines) + "\n", "utf-8")


def check_target(path: PathLike) -> None:
    """Raise SuppleError for a name that is not of a table."""
    suffix = os.path.splitext(os.fspath(path))[1]
    check_suffix(path, suffix, _SUFFIXES, "is not that of a table", "name a .csv or a .txt")
