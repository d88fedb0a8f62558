"""Keyframes: the position, angle, scale and strength of a stroke in some frames, and the curves between them."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from supple.errors import SuppleError
from supple.space.checks import LARGEST, LONGEST_AXIS, Vector, assign, integer, listed, number, point, refuse

_PARTS = {
    "strength": ("a number from 0 to 1", 0.0, 1.0),
    "angle": ("a number of degrees", -LARGEST, LARGEST),
    "scale": ("a number from 0.01 to 100", 0.01, 100.0),
}


@dataclass(frozen=True, slots=True)
class Key:
    """The values of a stroke in a frame of a clip.

    Parameters
    ----------
    frame : int
        The frame, counted from 0. It may lie before or after the clip.
    at : sequence of float, optional
        The position, x and y in pixels, of the point that is the stroke's ``at``.
    strength : float, optional
        The applied fraction of the stroke, from 0 to 1: a factor beside the stroke's own strength.
    angle : float, optional
        The degrees by which the stroke is turned about its ``at``, from x towards y: its points, drags and axis.
    scale : float, optional
        The factor of its lengths: the distances of its points from ``at``, its drags and its radius.
    """

    frame: int
    at: Vector | None = None
    strength: float | None = None
    angle: float | None = None
    scale: float | None = None

    def __post_init__(self) -> None:
        frame = integer("frame", self.frame, "a whole number, counted from 0", -LONGEST_AXIS, LONGEST_AXIS)
        parts = {k: number(k, getattr(self, k), *how) for k, how in _PARTS.items() if getattr(self, k) is not None}
        if self.at is None and not parts:
            raise SuppleError(f"the key of frame {frame} must have at, strength, angle or scale, and has none")
        assign(self, frame=frame, at=None if self.at is None else point("at", self.at, (2,)), **parts)


def checked_keys(given: object, ndim: int) -> tuple[Key, ...]:
    """Return the keys of a stroke with points of ``ndim`` numbers; SuppleError for other values."""
    keys = listed("keys", given, "a sequence of Key")
    for i, key in enumerate(keys):
        if not isinstance(key, Key):
            refuse(f"keys[{i}]", "a Key", key)
    for i, (one, other) in enumerate(pairwise(keys)):
        if one.frame >= other.frame:
            refuse(f"keys[{i + 1}].frame", f"after that of the key before it, {one.frame}", other.frame)
    if keys and ndim != 2:
        raise SuppleError(
            "keys are for strokes with points of 2 numbers, x and y: one with a time has its time in them"
        )
    return keys


def position(keys: Sequence[Key], frame: float) -> Vector | None:
    """Return the position in a frame; None if no key has any."""
    known = [(key.frame, key.at) for key in keys if key.at is not None]
    if not known:
        return None
    frames = [k for k, _ in known]
    return tuple(curve(frames, values, frame) for values in zip(*(at for _, at in known), strict=True))


def value(keys: Sequence[Key], name: str, frame: float, default: float) -> float:
    """Return the strength, the angle or the scale in a frame; the default if no key has any."""
    known = [(key.frame, part) for key in keys if (part := getattr(key, name)) is not None]
    return curve([k for k, _ in known], [part for _, part in known], frame) if known else default


def curve(frames: Sequence[int], values: Sequence[float], frame: float) -> float:
    """Return the value of a smooth curve through the keys, constant before the first and after the last.

    It is a cubic between two keys, with a continuous slope. It rises only where the keys rise, so it never leaves the
    range of two neighbours (Fritsch and Butland, 1984).
    """
    if frame <= frames[0]:
        return values[0]
    if frame >= frames[-1]:
        return values[-1]
    k = bisect.bisect_right(frames, frame) - 1
    if frame == frames[k]:
        return values[k]
    step, rise = frames[k + 1] - frames[k], values[k + 1] - values[k]
    u = (frame - frames[k]) / step
    left, right = (_slope(frames, values, i) * step for i in (k, k + 1))
    made = values[k] + u * (left + u * (3 * rise - 2 * left - right + u * (left + right - 2 * rise)))
    low, high = sorted((values[k], values[k + 1]))
    return min(max(made, low), high)  # a rounding error may leave the range


def _slope(frames: Sequence[int], values: Sequence[float], i: int) -> float:
    """Return the slope at a key: a harmonic mean of those beside it, 0 at an extremum; at the ends, the secant's."""
    near = [k for k in (i - 1, i) if 0 <= k < len(frames) - 1]
    steps = [frames[k + 1] - frames[k] for k in near]
    slopes = [(values[k + 1] - values[k]) / step for k, step in zip(near, steps, strict=True)]
    if len(slopes) == 1:
        return slopes[0]
    if slopes[0] * slopes[1] <= 0:
        return 0.0
    first, second = steps[0] + 2 * steps[1], 2 * steps[0] + steps[1]
    return (first + second) / (first / slopes[1] + second / slopes[0])
