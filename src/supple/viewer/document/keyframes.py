"""Edits of the keys of strokes: editing an animated property in a frame sets a key there."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, Literal

from supple.strokes import Stroke
from supple.strokes.keys import Key, position, value

Place = tuple[float, ...]

Part = Literal["place", "strength"]
"""Animated properties of a stroke: its position, angle and scale; or its strength."""
PARTS: Mapping[Part, tuple[str, ...]] = {"place": ("at", "angle", "scale"), "strength": ("strength",)}
"""For each part, the numbers of a key."""


def of_key(key: Key, part: Part) -> dict[str, Any]:
    """Return the values that a key has for a part, by their names."""
    return {name: getattr(key, name) for name in PARTS[part] if getattr(key, name) is not None}


def animated(stroke: Stroke, part: Part) -> bool:
    """Return whether a stroke has keys for a part."""
    return any(of_key(key, part) for key in stroke.keys)


def with_key(stroke: Stroke, frame: int, **values: Any) -> Stroke:
    """Return a stroke with a key in a frame; other values of an existing key stay."""
    if "strength" in values and stroke.strength != 1:  # the edited value is the product of both strengths
        keys = (k if k.strength is None else replace(k, strength=k.strength * stroke.strength) for k in stroke.keys)
        stroke = replace(stroke, keys=tuple(keys), strength=1.0)
    known = {key.frame: key for key in stroke.keys}
    known[frame] = replace(known[frame], **values) if frame in known else Key(frame, **values)
    return replace(stroke, keys=tuple(known[k] for k in sorted(known)))


def with_key_here(stroke: Stroke, part: Part, frame: int) -> Stroke:
    """Return a stroke with a key in a frame that holds the present values of a part."""
    now = stroke.at_frame(frame)
    known: dict[str, Any] = {"at": now.at} if part == "place" else {"strength": now.strength}
    for name, default in (("angle", 0.0), ("scale", 1.0)) if part == "place" else ():
        if any(getattr(key, name) is not None for key in stroke.keys):
            known[name] = value(stroke.keys, name, frame, default)
    return with_key(stroke, frame, **known)


def without(stroke: Stroke, part: Part, frames: Iterable[int], frame: int) -> Stroke:
    """Return a stroke without the keys of a part in ``frames``; if none is left, the part is as in ``frame``."""
    gone, kept, now = set(frames), [], stroke.at_frame(frame)
    for key in stroke.keys:
        left = {} if key.frame in gone else of_key(key, part)
        for other in PARTS:
            left |= of_key(key, other) if other != part else {}
        kept += [Key(key.frame, **left)] if left else []
    made = replace(stroke, keys=tuple(kept))
    if animated(stroke, part) and not animated(made, part):
        return (
            replace(made, strength=now.strength)
            if part == "strength"
            else replace(now, keys=made.keys, strength=stroke.strength)
        )
    if (before := position(stroke.keys, frame)) and not position(kept, frame):  # the keys left turn or scale only
        gone_by = [b - a for a, b in zip(stroke.at, before, strict=True)]
        made = made.mapped(lambda p: tuple(a + d for a, d in zip(p, gone_by, strict=True)), lambda v: v)
    return made


def moved_key(stroke: Stroke, part: Part, frame: int, to: int) -> Stroke:
    """Return a stroke with a part of a key moved to another frame, where it replaces existing values."""
    values = of_key(next(key for key in stroke.keys if key.frame == frame), part)
    if part == "strength":
        values = {part: stroke.at_frame(frame).strength}
    return without(with_key(stroke, to, **values), part, {frame} - {to}, frame)


def edited(stroke: Stroke, now: Stroke, then: Stroke, frame: int, *, whole: bool = False) -> Stroke:
    """Return a stroke edited in a frame, where it is ``now`` before the edit and ``then`` after it.

    Edited properties get a key in that frame if they are animated; others change in all frames. With ``whole``, the
    positions of all keys move. Values that were not edited keep every bit.
    """
    names = [field.name for field in fields(stroke)]
    alike = {name: getattr(stroke, name) for name in names if getattr(then, name) == getattr(now, name)}
    if not stroke.keys:
        return replace(then, **alike)
    scale = value(stroke.keys, "scale", frame, 1.0)
    turn = cmath.rect(scale, math.radians(value(stroke.keys, "angle", frame, 0.0)))
    placed = any(key.at is not None for key in stroke.keys)
    at, moved = stroke.at if placed else then.at, then.at != now.at

    def back(v: Place) -> Place:
        made = complex(*v) / turn
        return made.real, made.imag

    def point(p: Place) -> Place:
        arm = tuple(a - b for a, b in zip(p, then.at, strict=True))
        return tuple(a + (b - c) + (d - e) for a, b, c, d, e in zip(p, back(arm), arm, at, then.at, strict=True))

    made = then.mapped(point, back)
    known = dict(zip(now.also, stroke.also, strict=True)) if placed or not moved else {}
    also = tuple(known.get(pair, pulled) for pair, pulled in zip(then.also, made.also, strict=True))
    moves = {"at": at, "also": also, **({"path": stroke.path} if placed else {})}
    made = replace(made, **{"radius": then.radius / scale, **alike, **moves})
    if then.strength != now.strength and animated(stroke, "strength"):
        made = with_key(replace(made, strength=stroke.strength), frame, strength=then.strength)
    if not (placed and moved):
        return made
    if not whole:
        return with_key(made, frame, at=then.at)
    gone = [b - a for a, b in zip(now.at, then.at, strict=True)]
    keys = ((k, None if k.at is None else tuple(a + d for a, d in zip(k.at, gone, strict=True))) for k in made.keys)
    return replace(made, keys=tuple(replace(key, at=place) for key, place in keys))
