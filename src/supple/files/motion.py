"""Strokes that move with the frames of a clip: a deformation for each frame."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Sequence

from supple.deformation import Deformation
from supple.engine.work import Tell
from supple.errors import OutsideWarning, SuppleError
from supple.strokes import Recipe, Stroke

_STROKE = re.compile(r"stroke \d+ of \d+: ")


def motion_of(
    recipe: Recipe, count: int, shape: tuple[int, int], tell: Tell = lambda step, done, total: None
) -> tuple[Deformation, ...]:
    """Return the deformation of each frame, of a recipe whose strokes have keys.

    Frames that are alike share one. A stroke that moves may leave the picture; what is known of a stroke in many frames
    is one warning, that of the first of them.

    Parameters
    ----------
    recipe : Recipe
        It fits the frames.
    count : int
        The number of frames.
    shape : (int, int)
        Rows and columns of a frame.
    tell : function
        Called with ``"plan"``, the number of frames that are planned, and ``count``.

    Raises
    ------
    SuppleError
        As `Deformation.from_recipe` does, with the frame.

    Warns
    -----
    OutsideWarning
        If a stroke that moves begins outside the picture in every frame.
    FoldWarning, MissWarning
        As `Deformation.from_recipe` does.
    """
    roaming = {i for i, stroke in enumerate(recipe.strokes) if any(key.at is not None for key in stroke.keys)}
    frames = [recipe.at_frame(k) for k in range(count)]
    known: dict[Recipe, Deformation] = {}
    told: dict[tuple[type[Warning], str], tuple[str, set[Recipe]]] = {}
    for k, now in enumerate(frames):

        def say(text: str, kind: type[Warning], now: Recipe = now) -> None:
            about = _STROKE.match(text)
            told.setdefault((kind, about[0] if about else ""), (text, set()))[1].add(now)

        if now not in known:
            try:
                known[now] = Deformation.from_recipe(now, shape, roaming=roaming, say=say)
            except SuppleError as error:
                raise type(error)(f"frame {k}: {error}") from None
        tell("plan", k + 1, count)
    _check_places(recipe, roaming, {now.strokes for now in known}, count, shape)
    for (kind, _), (text, some) in told.items():
        at = [k for k, now in enumerate(frames) if now in some]
        more = f" (and in {len(at) - 1} more)" if len(at) > 1 else ""
        warnings.warn(f"frame {at[0]}{more}: {text}", kind, stacklevel=4)
    return tuple(known[now] for now in frames)


def _check_places(
    recipe: Recipe, moving: Iterable[int], seen: Iterable[Sequence[Stroke]], count: int, shape: tuple[int, int]
) -> None:
    """Warn of strokes that do not move in this clip, or are never in the picture."""
    (height, width), seen = shape, list(seen)
    for i in sorted(moving):
        stroke, which = recipe.strokes[i], f"stroke {i + 1}"
        if stroke.hidden:
            continue
        frames = [key.frame for key in stroke.keys if key.at is not None]
        if len(frames) > 1 and (frames[-1] < 0 or frames[0] >= count):
            warnings.warn(
                f"{which} has positions in frames {frames[0]} to {frames[-1]}, and the clip has {count}, from 0: it "
                "stands still (--track-first says which number a track gives to the first)",
                OutsideWarning,
                stacklevel=5,
            )
        places = [strokes[i].at for strokes in seen]
        if not any(-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5 for x, y in places):
            warnings.warn(
                f"{which} starts outside the picture, which has {width} x {height} pixels, in every frame",
                OutsideWarning,
                stacklevel=5,
            )
