"""Strokes that move with the frames of a clip: a deformation for each frame."""

from __future__ import annotations

import re
import warnings

from supple.deformation import Deformation
from supple.errors import OutsideWarning, SuppleError
from supple.pipeline import Tell
from supple.strokes import Recipe

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
    known: dict[Recipe, Deformation] = {}
    made: list[Deformation] = []
    told: dict[tuple[type[Warning], str], tuple[str, list[int]]] = {}

    def say(text: str, kind: type[Warning]) -> None:
        about = _STROKE.match(text)
        told.setdefault((kind, about[0] if about else ""), (text, []))[1].append(len(made))

    for k in range(count):
        now = recipe.at_frame(k)
        if now not in known:
            try:
                known[now] = Deformation.from_recipe(now, shape, roaming=roaming, say=say)
            except SuppleError as error:
                raise type(error)(f"frame {k}: {error}") from None
        made.append(known[now])
        tell("plan", k + 1, count)
    height, width = shape
    for i in sorted(roaming):
        places = {now.strokes[i].at for now in known}
        if not recipe.strokes[i].hidden and not any(
            -0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5 for x, y in places
        ):
            which = f"stroke {i + 1} of {len(recipe.strokes)}" if len(recipe.strokes) > 1 else "the stroke"
            warnings.warn(
                f"{which} starts outside the picture, which has {width} x {height} pixels, in every frame",
                OutsideWarning,
                stacklevel=4,
            )
    for (kind, _), (text, frames) in told.items():
        more = f" (and in {len(frames) - 1} more)" if len(frames) > 1 else ""
        warnings.warn(f"frame {frames[0]}{more}: {text}", kind, stacklevel=4)
    return tuple(made)
