"""A recipe on a clip: the deformations of its frames, how they are sampled, and the work for an engine."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from supple.deformation import Deformation
from supple.engine.sampling import Sampling
from supple.engine.stream import make_plan, stream
from supple.engine.work import Array, Layout, Tell, Work
from supple.errors import SuppleError, argument
from supple.files.motion import motion_of
from supple.media.base import Clip, ClipWarning
from supple.space.domain import length, refuse
from supple.space.geometry import Grid
from supple.strokes import Fit, Recipe, fit_recipe, scaling_of


def deformation_of(
    recipe: Recipe,
    count: int,
    shape: tuple[int, int],
    time_scale: float | None,
    name: str,
    fit: Fit | None = None,
    display: tuple[int, int, int, int] | None = None,
) -> Deformation:
    """Return a recipe on a clip: strokes with a time warp the clip, those without one warp each of its frames.

    Points count in the part ``display`` of frames, as in `supple.media.base.Clip`.
    """
    known = recipe.time_scale if time_scale is None else length("time_scale", time_scale)
    worth = 1.0 if known is None else known
    x, y, width, height = display or (0, 0, *shape[::-1])
    if not recipe.strokes or recipe.strokes[0].ndim == 2:
        made = fit_recipe(recipe, (width, height), fit, name)
        return Deformation.from_recipe(made.placed((x, y), shape[::-1]), Grid(shape, origin=(-x, -y)))
    size = (width, height, count)
    scaling = None if recipe.size is None else scaling_of(recipe.size, size, fit, time=True, name=name)
    if scaling is not None:
        worth *= scaling.frame  # so that the brush covers the same part of the clip
    recipe = fit_recipe(recipe, size, fit, name, time=True).placed((x, y, 0), (*shape[::-1], count))
    return Deformation.from_recipe(recipe, Grid((count, *shape), (1.0, 1.0, worth), (-x, -y, 0)), time=True)


def deformations_of(
    recipe: Recipe,
    clip: Clip,
    time_scale: float | None,
    fit: Fit | None = None,
    tell: Tell = lambda step, done, total: None,
) -> tuple[Deformation, ...]:
    """Return a recipe on a clip: one deformation, or, if its strokes move, one for each frame."""
    count, shape, name = clip.count, clip.layout.shape, clip.name
    if not recipe.moves:
        return (deformation_of(recipe, count, shape, time_scale, name, fit, clip.display),)
    x, y, *size = clip.display or (0, 0, *shape[::-1])
    return motion_of(fit_recipe(recipe, size, fit, name).placed((x, y), shape[::-1]), count, shape, tell)


def sampling_of(
    clip: Clip,
    *,
    filter: str,
    outside: str,
    fill: float | Sequence[float],
    tolerance: float,
    light: bool,
    between: str | None = None,
    time_filter: bool = False,
) -> Sampling:
    """Return the checked sampling options for a clip's frames."""
    layout: Layout = clip.layout
    name: str = clip.name
    sampling = Sampling(filter, tolerance, outside, 0.0, light, between, time_filter)
    if light and (len(layout.groups) > 1 or layout.dtype.kind == "f" or not _is_rgb(layout)):
        raise SuppleError(
            f"{argument('linear_light')} needs frames of RGB or grey of 8 or 16 bits, and {name} has others: leave it "
            "out"
        )
    return replace(sampling, fill=_filled(clip, fill))


def _filled(clip: Clip, fill: float | Sequence[float]) -> tuple[float, ...]:
    """Return the fill value as the components of a clip."""
    layout: Layout = clip.layout
    values = [float(value) for value in np.asarray(fill, np.float64).ravel()]
    paint = getattr(clip, "painted", None)  # only videos, whose planes may not be RGB
    alpha = layout.groups[0].alpha
    grey = (len(layout.groups) == 1 or not paint) and layout.groups[0].channels - alpha == 1
    full = (1 if grey else 3) + alpha if paint else layout.groups[0].channels
    allowed = {1, full, 3} if paint and not grey else {1, full}
    if not np.isfinite(values).all():
        refuse("fill", f"finite for the frames of {clip.name}", fill)
    if len(values) not in allowed:
        colours = "grey" if grey else "red, green and blue"
        refuse("fill", f"a number, or {full} of them ({colours}{', opacity' if alpha else ''}) for {clip.name}", fill)
    if values == [0.0]:
        return tuple(layout.black)
    if len(values) == 1:
        values *= full
    if not paint:
        return (*values, *(0.0 for group in layout.groups[1:] for _ in range(group.channels)))
    return tuple(paint([*values, layout.white] if alpha and len(values) < full else values))


def _is_rgb(layout: Layout) -> bool:
    return all(value == 0 for value in layout.black)


def frames_of(
    clip: Clip, deformations: Sequence[Deformation], sampling: Sampling, planes: Sequence[int], memory: float
) -> Iterator[tuple[int, list[Array]]]:
    """Yield some frames of a warped clip, in order, as arrays that are reused for the next one."""
    work = work_on(clip, deformations, sampling)
    for z, arrays, _ in stream(work, make_plan(work, planes), clip.frames(), memory=memory):
        yield z, arrays


def work_on(clip: Clip, deformations: Sequence[Deformation], sampling: Sampling) -> Work:
    """Return the work on the frames of a clip: of one deformation, or of one for each."""
    space = replace(deformations[0].space, count=clip.count)
    if len(deformations) == 1:
        return Work(space, clip.layout, sampling)
    each = {id(deformation): deformation.space for deformation in deformations}
    return Work(space, clip.layout, sampling, tuple(each[id(deformation)] for deformation in deformations))


def displayed(rotation: float, mirrored: bool) -> str:
    """Return what players do to the frames of a video; empty if nothing."""
    turn = f"turned by {abs(rotation):g}° {'clockwise' if rotation < 0 else 'counterclockwise'}" if rotation else ""
    return " and ".join(filter(None, ("mirrored" if mirrored else "", turn)))


def warn_of_frames(clip: Clip, deformations: Sequence[Deformation]) -> None:
    """Warn that points are those of stored frames, if players turn these; and that fields are bent together."""
    if all(each.is_identity for each in deformations):
        return
    if how := displayed(clip.rotation, clip.mirrored):
        height, width = clip.layout.shape
        what = f"is {how} when it is played: points are in the frame as it is stored, {width} x {height}"
        warnings.warn(f"{clip.name} {what}", ClipWarning, stacklevel=4)
    if clip.fields:
        what = (
            f"is interlaced, {clip.fields} field first, and the two fields of a frame are bent as one picture, which "
            "mixes them: deinterlace it first, with FFmpeg's filter bwdif for instance"
        )
        warnings.warn(f"{clip.name} {what}", ClipWarning, stacklevel=4)
