"""Edits of the keys of strokes: what is animated has keys, and an edit in a frame sets one there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal

from supple.strokes import Stroke
from supple.strokes.keys import Key

Part = Literal["at", "strength"]
"""What a key may have: the position of its stroke, or the strength."""
PARTS: tuple[Part, ...] = ("at", "strength")


def animated(stroke: Stroke, part: Part) -> bool:
    """Return whether a stroke has keys for its position, or for its strength."""
    return any(getattr(key, part) is not None for key in stroke.keys)


def with_keys(stroke: Stroke, keys: Iterable[Key], frame: int) -> Stroke:
    """Return a stroke with other keys; what has none any more stays as it is in a frame."""
    made, now = replace(stroke, keys=tuple(keys)), stroke.at_frame(frame)
    if animated(stroke, "at") and not animated(made, "at"):
        made = replace(made, at=now.at, also=now.also, path=now.path)
    if animated(stroke, "strength") and not animated(made, "strength"):
        made = replace(made, strength=now.strength)
    return made


def with_key(stroke: Stroke, frame: int, **values: Any) -> Stroke:
    """Return a stroke with a key in a frame; of one that is there, what is not given stays."""
    if "strength" in values and stroke.strength != 1:  # the product of both is what is edited
        keys = (k if k.strength is None else replace(k, strength=k.strength * stroke.strength) for k in stroke.keys)
        stroke = replace(stroke, keys=tuple(keys), strength=1.0)
    known = {key.frame: key for key in stroke.keys}
    known[frame] = replace(known[frame], **values) if frame in known else Key(frame, **values)
    return replace(stroke, keys=tuple(known[k] for k in sorted(known)))


def without(stroke: Stroke, part: Part | None, frames: Iterable[int], frame: int) -> Stroke:
    """Return a stroke without its keys in some frames, or one part of these; see `with_keys`."""
    gone, kept = set(frames), []
    for key in stroke.keys:
        values = {name: getattr(key, name) for name in PARTS if key.frame not in gone or part not in (None, name)}
        if any(value is not None for value in values.values()):
            kept.append(Key(key.frame, **values))
    return with_keys(stroke, kept, frame)


def moved_key(stroke: Stroke, part: Part, frame: int, to: int) -> Stroke:
    """Return a stroke with the position or the strength of a key moved to another frame, over what is there."""
    value = getattr(stroke.at_frame(frame), part)
    return without(with_key(stroke, to, **{part: value}), part, {frame} - {to}, frame)


def edited(stroke: Stroke, now: Stroke, then: Stroke, frame: int, *, whole: bool = False) -> Stroke:
    """Return a stroke after an edit of what it is in a frame: ``now`` before the edit, and ``then`` after it.

    What is animated gets a key in that frame; all else is the same in all frames. With ``whole``, all positions move.
    """
    if not stroke.keys:
        return then
    made = replace(then, keys=stroke.keys, strength=stroke.strength)
    if then.strength != now.strength:
        changed = animated(stroke, "strength")
        made = with_key(made, frame, strength=then.strength) if changed else replace(made, strength=then.strength)
    if not animated(stroke, "at"):
        return made
    gone = [b - a for a, b in zip(now.at, then.at, strict=True)]
    shift = [b - a for a, b in zip(now.at, stroke.at, strict=True)]
    also = list(then.also)
    for k, (point, by) in enumerate(then.also):
        if k < len(stroke.also) and (any(gone) or point == now.also[k][0]):  # it moves along
            also[k] = stroke.also[k][0], by
        else:
            also[k] = tuple(a + d for a, d in zip(point, shift, strict=True)), by
    made = replace(made, at=stroke.at, also=tuple(also), path=stroke.path)
    if not any(gone):
        return made
    if not whole:
        return with_key(made, frame, at=then.at)
    keys = ((k, None if k.at is None else tuple(a + d for a, d in zip(k.at, gone, strict=True))) for k in made.keys)
    return replace(made, keys=tuple(replace(key, at=at) for key, at in keys))
