"""Clips warped to clips: videos and image sequences, streamed through a deformation."""

from __future__ import annotations

import contextlib
import os
import shutil
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from supple.deformation import Deformation, Report
from supple.domain import integer, length, number, refuse
from supple.engines.base import Array, Certificate, Layout, Sampling, Work, warn_of
from supple.engines.choice import check_device, engine_for
from supple.errors import SuppleError, shown
from supple.files.motion import motion_of
from supple.media import codecs
from supple.media.base import Clip, ClipWarning, CountError
from supple.media.codecs import SUFFIXES
from supple.media.files import check_output, replacing
from supple.media.image import check_quality, check_target
from supple.media.image.formats import SUFFIXES as SUFFIXES_IN
from supple.media.image.formats import SUFFIXES_OUT as PICTURES_OUT
from supple.media.numbering import has_number, is_sequence
from supple.pipeline import Done, Tell, make_plan, run, stream
from supple.strokes import Fit, Recipe, fit_recipe, scaling_of

if TYPE_CHECKING:
    from fractions import Fraction

PathLike = str | os.PathLike[str]

SUFFIXES_OUT = frozenset(codecs.SUFFIXES_OUT) - {".gif"}
GB = 1e9


@dataclass(frozen=True, slots=True)
class ClipOptions:
    """Options for clips.

    Parameters
    ----------
    between : str, optional
        The interpolation between frames, as in `Deformation.warp`.
    time_filter : bool
        Whether pixels are averaged over time.
    time_scale : float, optional
        The length of a frame in pixels, for the brush: by default that of the recipe, or 1.
    rate : float or Fraction, optional
        Frames a second of an image sequence, which has no rate of its own; 24 by default.
    codec, preset, pixel_format : str, optional
        As in `supple.media.video.writer`.
    crf : float, optional
        As in `supple.media.video.writer`.
    memory : float
        The bytes of memory for frames; frames beyond that go to a temporary file.
    """

    between: str | None = None
    time_filter: bool = False
    time_scale: float | None = None
    rate: float | Fraction | None = None
    codec: str | None = None
    crf: float | None = None
    preset: str | None = None
    pixel_format: str | None = None
    memory: float = 2 * GB


@dataclass(frozen=True, slots=True)
class WarpedClip:
    """A clip that was written.

    Parameters
    ----------
    source, target : pathlib.Path
        The input and the output file.
    deformations : tuple of Deformation
        One: the strokes, on the clip's shape; or on a frame's, if they have no time and warp every frame. Of strokes
        that move with the frames, one for each frame.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in pixels and frames.
    frames : int
        The number of frames.
    still : int
        The number of unchanged frames, which were copied.
    held : int
        The number of frames held at once.
    error : float
        The error estimate from the checks of the map, in pixels and frames; `report` measures it.
    copied : int
        The number of unchanged frames that were not encoded again: their packets are those of the source.
    """

    source: Path
    target: Path
    deformations: tuple[Deformation, ...]
    tolerance: float
    frames: int
    still: int
    held: int
    error: float
    copied: int = 0

    @property
    def deformation(self) -> Deformation:
        """The first of `deformations`."""
        return self.deformations[0]

    def report(self, frame: int = 0) -> Report:
        """Return the report on the strokes and the certified error, measured at every pixel; this is slow.

        Of strokes that move with the frames, ``frame`` is the one that is measured.
        """
        many = len(self.deformations)
        k = integer("frame", frame, f"from 0 to {self.frames - 1}", 0, self.frames - 1) if many > 1 else 0
        return self.deformations[k].report(tolerance=self.tolerance)


def is_clip(source: PathLike, target: PathLike, recipe: Recipe) -> bool:
    """Return whether a file, a pattern or a folder is warped as a clip."""
    suffix, goal = (Path(path).suffix.lower() for path in (source, target))
    timed = recipe.moves or (bool(recipe.strokes) and recipe.strokes[0].ndim == 3)
    if suffix in SUFFIXES or goal in SUFFIXES_OUT or (has_number(source) and not os.path.isfile(source)):
        return True
    if os.path.isdir(source):
        return timed and not _holds_videos_alone(source)
    if timed and suffix in (".png", ".apng") and os.path.isfile(source):
        return _is_animated(source)
    still = suffix not in (".gif", ".webp", ".png", ".apng", "")
    many = goal == ".gif" or has_number(target)
    return (timed and not still) or (many and (suffix == ".gif" or (not still and _is_animated(source))))


def _is_animated(path: PathLike) -> bool:
    """Return whether an image has several frames."""
    from supple.media.sequence import is_animated

    return os.path.isfile(path) and is_animated(path)


def _holds_videos_alone(folder: PathLike) -> bool:
    """Return whether a folder holds videos, not frames."""
    try:
        suffixes = {_suffix(name) for name in os.listdir(folder) if not name.startswith(".")}
    except OSError:
        return False
    return bool(suffixes & SUFFIXES) and not suffixes & SUFFIXES_IN


@contextlib.contextmanager
def open_clip(source: PathLike, *, rate: float | Fraction | None = None, count: int | None = None) -> Iterator[Clip]:
    """Open a video file, or an image sequence by its pattern or folder."""
    if is_sequence(source) and not os.path.isfile(source):
        from supple.media import sequence

        with sequence.open_clip(source, rate=24 if rate is None else rate) as pictures:
            yield pictures
        return
    if rate is None and _suffix(source) == ".webp" and _is_animated(source):
        from supple.media import sequence

        with sequence.open_clip(source) as animation:
            yield animation
        return
    from supple.media import video

    if rate is not None:
        raise SuppleError(f"a rate (--fps) is for image sequences, and {shown(source)} has its own: leave it out")
    with video.open_clip(source, count=count) as clip:
        yield clip


def refuse_picture(path: PathLike) -> None:
    """Raise SuppleError for a single image, which FFmpeg would read as a short video."""
    if _suffix(path) not in SUFFIXES_IN or not os.path.isfile(path) or _is_animated(path):
        return
    from supple.media.video.demux import opened

    with opened(path) as container:
        kind = container.format.name
    if kind.endswith("_pipe") or kind == "image2":
        raise SuppleError(
            f"{shown(path)} is a picture, and has no time: its strokes have 2 numbers, x and y, and no keys, and it is "
            "written as a picture (videos are made of numbered ones, frames/%05d.png, or of a folder)"
        )


def turned(rotation: float) -> str:
    """Return the direction in which players rotate a video."""
    return "clockwise" if rotation < 0 else "counterclockwise"


def warn_of_rotation(clip: Clip, deformations: Sequence[Deformation]) -> None:
    """Warn that points are those of stored frames, if players rotate them."""
    rotation = clip.rotation
    if rotation and not all(each.is_identity for each in deformations):
        height, width = clip.layout.shape
        warnings.warn(
            f"{clip.name} is turned by {abs(rotation):g}° {turned(rotation)} when it is played: points are in the "
            f"frame as it is stored, {width} x {height}",
            ClipWarning,
            stacklevel=4,
        )


def refuse_places(recipe: Recipe, source: PathLike) -> None:
    """Raise SuppleError for a recipe in millimetres, unless it is for a volume."""
    if recipe.is_world:
        raise SuppleError(
            f"the recipe is in {recipe.space} millimetres, and {shown(source)} is no volume: give a recipe in pixels"
        )


def deformation_of(
    recipe: Recipe,
    count: int,
    shape: tuple[int, int],
    time_scale: float | None,
    name: str,
    fit: Fit | None = None,
) -> Deformation:
    """Return a recipe on a clip: strokes with a time warp the clip, those without one warp each of its frames."""
    known = recipe.time_scale if time_scale is None else length("time_scale", time_scale)
    worth = 1.0 if known is None else known
    height, width = shape
    if not recipe.strokes or recipe.strokes[0].ndim == 2:
        return Deformation.from_recipe(fit_recipe(recipe, (width, height), fit, name), shape)
    size = (width, height, count)
    scaling = None if recipe.size is None else scaling_of(recipe.size, size, fit, time=True, name=name)
    if scaling is not None:
        worth *= scaling.frame  # so that the brush covers the same part of the clip
    recipe = fit_recipe(recipe, size, fit, name, time=True)
    return Deformation.from_recipe(recipe, (count, *shape), spacing=(1.0, 1.0, worth), time=True)


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
        return (deformation_of(recipe, count, shape, time_scale, name, fit),)
    return motion_of(fit_recipe(recipe, shape[::-1], fit, name), count, shape, tell)


def sampling_of(
    clip: Clip,
    *,
    filter: str,
    outside: str,
    fill: float | Sequence[float],
    tolerance: float,
    light: bool,
    options: ClipOptions,
) -> Sampling:
    """Return the checked sampling options for a clip's frames."""
    layout: Layout = clip.layout
    name: str = clip.name
    sampling = Sampling.checked(
        filter=filter, outside=outside, tolerance=tolerance, linear_light=light, between=options.between,
        time_filter=options.time_filter,
    )  # fmt: skip
    if light and (len(layout.groups) > 1 or layout.dtype.kind == "f" or not _is_rgb(layout)):
        raise SuppleError(
            f"linear_light needs frames of RGB or grey of 8 or 16 bits, and {name} has others: leave it out"
        )
    return replace(sampling, fill=_filled(clip, fill))


def _filled(clip: Clip, fill: float | Sequence[float]) -> tuple[float, ...]:
    """Return the fill value as the components of a clip."""
    layout: Layout = clip.layout
    values = [float(value) for value in np.asarray(fill, np.float64).ravel()]
    paint = getattr(clip, "painted", None)  # only videos, whose planes may not be RGB
    alpha = layout.groups[0].alpha
    grey = len(layout.groups) == 1 and layout.groups[0].channels - alpha == 1
    full = (1 if grey else 3) + alpha if paint else layout.groups[0].channels
    allowed = {1, full, 3} if paint and not grey else {1, full}
    if len(values) not in allowed or not np.isfinite(values).all():
        colours = "grey" if grey else "red, green and blue"
        refuse("fill", f"a number, or {full} of them ({colours}{', opacity' if alpha else ''}) for {clip.name}", fill)
    if values == [0.0]:
        return tuple(layout.black)
    if len(values) == 1:
        values *= full
    if not paint:
        return tuple(values)
    return tuple(paint([*values, layout.white] if alpha and len(values) < full else values))


def _is_rgb(layout: Layout) -> bool:
    return all(value == 0 for value in layout.black)


def warp_clip(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str = "edge",
    fill: float | Sequence[float] = 0.0,
    linear_light: bool = False,
    quality: int | None = None,
    lossless: bool = False,
    device: str = "cpu",
    force: bool = False,
    options: ClipOptions | None = None,
    tell: Tell = lambda step, done, total: None,
    fit: Fit | None = None,
) -> WarpedClip:
    """Warp a video or an image sequence, frame by frame, as in `supple.warp_file`.

    ``tell`` is called with ``"write"`` when the target is opened, and then with ``"plan"`` or ``"warp"``, the number of
    finished frames, and their total. Strokes that move are planned before the target is opened.
    """
    known = options or ClipOptions()
    check_device(device, "clips")
    check_clip_target(source, target, known, quality=quality, force=force)
    number("memory", known.memory, "a number of bytes from 0", 0.0, 1e30)
    count: int | None = None
    while True:  # twice at most: what a container says of the number of frames may be wrong
        try:
            with open_clip(source, rate=known.rate, count=count) as clip:
                deformations = deformations_of(recipe, clip, known.time_scale, fit, tell)
                if count is None:
                    warn_of_rotation(clip, deformations)
                sampling = sampling_of(
                    clip,
                    filter=filter,
                    outside=outside,
                    fill=fill,
                    tolerance=tolerance,
                    light=linear_light,
                    options=known,
                )
                work = work_on(clip, deformations, sampling)
                untouched = work.is_identity and known == replace(ClipOptions(), memory=known.memory)
                if untouched and not lossless and os.path.isfile(source) and _suffix(source) == _suffix(target):
                    # Encoding a clip again would change it.
                    check_output(target, force=force)
                    with replacing(target, force=force) as place:
                        shutil.copyfile(source, place)
                    done, copied = Done(Certificate(0.0, 0.0), still=clip.count), clip.count
                else:
                    engine = engine_for(device, work)
                    tell("write", 0, clip.count)
                    # The writer first: its errors come before any work.
                    with _writer(clip, target, known, quality, lossless, force) as sink:
                        done = run(clip, sink, work, engine, memory=known.memory, tell=tell)
                        warn_of(done.certificate, tolerance, 3)  # before the target is renamed
                    copied = getattr(sink, "copied", 0)
                return WarpedClip(
                    Path(source), Path(target), deformations, tolerance, clip.count, done.still, done.held,
                    done.certificate.error, copied,
                )  # fmt: skip
        except CountError as miscounted:
            if count is not None:
                raise fickle(source) from None
            count = miscounted.found


def fickle(source: PathLike) -> SuppleError:
    """Return the error for a clip whose frames cannot be counted."""
    return SuppleError(f"{shown(source)} gives another number of frames each time: repair it")


def check_clip_target(
    source: PathLike, target: PathLike, options: ClipOptions, *, quality: int | None = None, force: bool = False
) -> None:
    """Raise SuppleError for an invalid target or option, before a clip is read.

    Raises
    ------
    SuppleError
        If the source is an image, the target has a suffix of no clip, or cannot be written; or if an option is not
        supported for such a target.
    """
    refuse_picture(source)
    name = shown(target)
    if not os.fspath(target):
        raise SuppleError("cannot write '': no file can have that name: choose another")
    if not is_picture_target(target):
        if _suffix(target) in PICTURES_OUT:
            stem, suffix = os.path.splitext(name)
            raise SuppleError(
                f"{name} is one picture, and a clip is many: name a pattern, such as {stem}-%05d{suffix}, or a folder"
            )
        if quality is not None:
            raise SuppleError(f"quality is for pictures, and {name} is a video: give a crf")
        from supple.media import video

        video.check_target(target)
        check_output(target, force=force)
        return
    if has_number(target):
        check_target(target)
    for option in ("codec", "crf", "preset", "pixel_format"):
        if getattr(options, option) is not None:
            raise SuppleError(f"{option} is for videos, and {name} is pictures: leave it out")
    check_quality(target, quality)


def _writer(
    clip: Any, target: PathLike, options: ClipOptions, quality: int | None, lossless: bool, force: bool
) -> contextlib.AbstractContextManager[Any]:
    """Return the writer for a target: a video file, or an image sequence."""
    if is_picture_target(target):
        from supple.media import sequence

        return sequence.writer(clip, target, force=force, quality=quality, lossless=lossless)
    from supple.media import video

    return video.writer(
        clip,
        target,
        codec=options.codec,
        crf=options.crf,
        preset=options.preset,
        pixel_format=options.pixel_format,
        force=force,
        lossless=lossless,
    )


def is_picture_target(target: PathLike) -> bool:
    """Return whether a name is a sequence: a pattern, a folder, or a name without a suffix."""
    suffix = _suffix(target)
    return not suffix or (is_sequence(target) and not (has_number(target) and suffix in SUFFIXES_OUT))


def _suffix(path: PathLike) -> str:
    return Path(path).suffix.lower()


def frames_of(
    clip: Clip, deformations: Sequence[Deformation], sampling: Sampling, planes: Sequence[int], memory: float = 2 * GB
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
