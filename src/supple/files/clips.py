"""Clips, that is videos and image sequences: opening them, and streaming their frames through deformations."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from supple.deformation import Deformation
from supple.engine.motion import need_flow
from supple.engine.sampling import DEFAULT, Certificate, Sampling, warn_of
from supple.engine.stream import Done, Frame, Plan, make_plan, run, stream
from supple.engine.work import Array, Layout, Tell, Work
from supple.errors import OutsideWarning, SuppleError, argument, counting, numbered, shown, warn
from supple.files.jobs import Job, Warped
from supple.files.options import ClipOptions, GridOptions, PathLike
from supple.folding.resolved import warn_of_still
from supple.media.base import ClipWarning, CountError
from supple.media.files import check_output, replacing
from supple.media.image import check_options, check_target
from supple.media.medium import VIDEOS_OUT, Clip, is_animated
from supple.media.numbering import has_number, is_sequence
from supple.media.pictures import SUFFIXES as SUFFIXES_IN
from supple.media.pictures import SUFFIXES_OUT as PICTURES_OUT
from supple.media.suffixes import ANIMATED, is_animation, suffix_of
from supple.media.timecode import Numbering
from supple.space.checks import LONGEST_AXIS, integer, items, length, number, refuse
from supple.space.domain import AUTO, Domain
from supple.space.freezing import Freeze
from supple.space.geometry import Grid
from supple.strokes import Recipe, Stroke, fit_recipe, scaling_of

if TYPE_CHECKING:
    from fractions import Fraction

T = TypeVar("T")
_ENCODING = ("codec", "crf", "preset", "pixel_format")
_STROKE = re.compile(r"stroke \d+ of \d+: ")


@contextlib.contextmanager
def open_clip(
    source: PathLike,
    *,
    rate: float | Fraction | None = None,
    count: int | None = None,
    target: PathLike | None = None,
) -> Iterator[Clip]:
    """Open a video file, or an image sequence by its pattern or folder; ``target`` is the output, if any."""
    pictures = is_sequence(source) and not os.path.isfile(source)
    if pictures or (rate is None and suffix_of(source) == ".webp" and is_animated(source)):
        from supple.media import sequence

        with sequence.open_clip(source, rate=24 if rate is None else rate, target=target) as opened:
            yield opened
        return
    from supple.media import video

    if rate is not None:
        raise SuppleError(f"{argument('rate')} is for image sequences, and {shown(source)} has its own: leave it out")
    with video.open_clip(source, count=count) as clip:
        yield clip


def numbering_of(source: PathLike, *, first: int | None = 0, rate: float | Fraction | None = None) -> Numbering:
    """Return the numbers and the timecodes of a clip's frames, from the number of the ``first`` one.

    If ``first`` is None, it is the number in the name of a sequence's first picture; SuppleError if there is none.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings are given when it is warped
        with open_clip(source, rate=rate) as clip:
            if first is None and (first := getattr(clip, "first", None)) is None:
                raise SuppleError(f"{clip.name} has no numbers in its names: give {argument('first_frame')} a number")
            varies = bool(clip.info().get("variable"))
            return Numbering(clip.name, clip.count, clip.rate, first, getattr(clip, "timecode", ""), varies)


def refuse_picture(path: PathLike) -> None:
    """Raise SuppleError for a single image, which FFmpeg would read as a short video."""
    if suffix_of(path) not in SUFFIXES_IN or not os.path.isfile(path) or is_animated(path):
        return
    from supple.media.video.demux import opened

    with opened(path) as container:
        kind = container.format.name
    if kind.endswith("_pipe") or kind == "image2":
        raise SuppleError(
            f"{shown(path)} is a picture, and has no time: its strokes have 2 numbers, x and y, and no keys, and it is "
            "written as a picture (videos are made of numbered ones, frames/%05d.png, or of a folder)"
        )


def refuse_maps(source: PathLike) -> NoReturn:
    """Raise SuppleError for fields, affine maps and other grids, which clips do not take."""
    raise SuppleError(
        f"fields and other grids are for pictures and volumes, and {shown(source)} is a clip: leave them out"
    )


def warp(job: Job, tell: Tell) -> Warped:
    """Warp a video or an image sequence, frame by frame, as in `supple.warp_file`.

    ``tell`` is called with ``"write"`` when the target is opened, and then with ``"plan"`` or ``"warp"``, the number of
    finished frames, and their total. Strokes that move are planned before the target is opened.
    """

    def once(count: int | None) -> Warped:
        known = job.clip
        with open_clip(job.source, rate=known.rate, count=count, target=job.target) as clip:
            bent = bent_of(clip, known)
            deformations = deformations_of(job, clip, tell, bent=bent)
            if count is None:
                warn_of_still(job.recipe.strokes)
                warn_of_frames(clip, deformations)
            return _written(job, clip, deformations, bent, tell)

    with counting(job.clip.first_frame):
        return counted_anew(job.source, once)


def counted_anew(source: PathLike, use: Callable[[int | None], T]) -> T:
    """Return ``use(None)``; or ``use(count)``, if the container states a wrong number of frames (`CountError`)."""
    try:
        return use(None)
    except CountError as miscounted:
        found = miscounted.found
    try:
        return use(found)
    except CountError:
        raise SuppleError(f"{shown(source)} gives another number of frames each time: repair it") from None


def bent_of(clip: Clip, options: ClipOptions) -> range:
    """Return the range of frames to bend; SuppleError if the clip does not have them, or all are held."""
    last, one = clip.count - 1, options.frame
    if 2 * options.hold > last:
        raise SuppleError(
            f"{argument('hold')} {options.hold} keeps all {clip.count} frames of {clip.name}: keep fewer than half"
        )
    if options.hold and not any(parts_of(clip.count, options.hold)):
        raise SuppleError(
            f"{argument('hold')} {options.hold} leaves too few of the {clip.count} frames of {clip.name} to fade in "
            "and out: keep fewer"
        )
    first, end = (one, one) if one is not None else options.frames or (0, last)
    if end > last:
        what = argument("frames" if one is None else "frame")
        raise SuppleError(f"{what} must be from 0 to {last}, the frames of {clip.name}, found {end}")
    return range(first, end + 1)


def _written(job: Job, clip: Clip, deformations: tuple[Deformation, ...], bent: range, tell: Tell) -> Warped:
    """Write an open clip, some of whose frames are bent by their deformations."""
    source, target, known = job.source, job.target, job.clip
    sampling = sampling_of(clip, between_frames(job.sampling, known))
    work = replace(work_on(clip, deformations, sampling), bent=bent)
    plain = replace(known, memory=ClipOptions().memory, frames=None, hold=0, first_frame=None)
    untouched = work.is_identity and not job.lossless and plain == ClipOptions()
    count, copied = clip.count, 0
    if known.frame is not None:
        with _writer(clip, job) as sink:
            plan = make_plan(work, bent)
            for z, arrays, certificate in streamed(clip, work, plan, known.memory):
                sink.write(arrays, z)
                warn_of(certificate, sampling.tolerance)
                tell("warp", 1, 1)
        done, count = Done(certificate, int(plan.still.sum()), plan.capacity), 1
    elif untouched and os.path.isfile(source) and suffix_of(source) == suffix_of(target):
        # Encoding a clip again would change it.
        _warn_of_none(job.recipe, clip)
        with replacing(target, force=job.force) as place:
            shutil.copyfile(source, place)
        done, copied = Done(Certificate(0.0, 0.0), still=clip.count), clip.count
    else:
        tell("write", 0, clip.count)
        # Open the writer first, so that its errors come before any work.
        with _writer(clip, job) as sink:
            done = run(clip, sink, work, memory=known.memory, tell=tell)
            warn_of(done.certificate, sampling.tolerance)  # before the target is renamed
            if done.still == clip.count:
                _warn_of_none(job.recipe, clip)
        copied = sink.copied
    own = None
    if clip.display is not None:
        grid, (width, height) = deformations[0].grid, clip.display[2:]
        own = Grid((*grid.shape[:-2], height, width), grid.spacing)
    return Warped(
        Path(source), Path(target), "clip", deformations, sampling.tolerance, done.certificate.error, count,
        done.still, copied, done.held, own=own,
        between=sampling.between_frames if deformations[0].ndim == 3 else "",
    )  # fmt: skip


def _warn_of_none(recipe: Recipe, clip: Clip) -> None:
    """Warn that no stroke has an effect in this clip."""
    able = (each for each in recipe.strokes if each.strength and not each.hidden and not each.is_still)
    if recipe.amount and any(able):
        text = f"no stroke moves a pixel of any frame of {clip.name}: its frames are as they were"
        warn(text, OutsideWarning)


def check(job: Job) -> None:
    """Raise SuppleError for an invalid target or option, before a clip is read."""
    target, name = job.target, shown(job.target)
    if job.maps or job.grid not in (None, GridOptions()):
        refuse_maps(job.source)
    refuse_picture(job.source)
    number("memory", job.clip.memory, "a number of bytes from 0", 0.0, 1e30)
    if between_frames(job.sampling, job.clip).between == "flow":
        need_flow()
    _check_shot(job.clip)
    if not os.fspath(target):
        raise SuppleError("cannot write '': no file can have that name: choose another")
    one, many = job.clip.frame is not None, is_picture_target(target)
    if one or many or is_animation(target, job.source):
        if one or has_number(target):
            check_target(target)
        refuse_encoding(job.clip, target, "a picture" if one else "pictures")
        check_options(target, quality=job.quality, lossless=job.lossless, compression=job.compression)
    elif suffix_of(target) in PICTURES_OUT:
        stem, suffix = os.path.splitext(name)
        raise SuppleError(
            f"{name} is one picture, and a clip is many: name an animated one ({' or '.join(ANIMATED)}), a "
            f"pattern, such as {stem}-%05d{suffix}, or a folder"
        )
    else:
        for option, instead in (("quality", "give a crf"), ("compression", "leave it out")):
            if getattr(job, option) is not None:
                raise SuppleError(f"{argument(option)} is for pictures, and {name} is a video: {instead}")
        from supple.media import video

        video.check_target(target)
    if one or not many:
        check_output(target, force=job.force)


def _check_shot(options: ClipOptions) -> None:
    """Raise SuppleError for invalid options on frames."""
    for name in ("frame", "hold", "first_frame"):
        if (value := getattr(options, name)) is not None:
            integer(name, value, "a whole number from 0", 0, LONGEST_AXIS)
    if options.frames is not None:
        wanted = "the first and the last frame, counted from 0, in this order"
        first, last = items("frames", options.frames, wanted, (2,))
        if integer("frames", first, wanted, 0, LONGEST_AXIS) > integer("frames", last, wanted, 0, LONGEST_AXIS):
            refuse("frames", wanted, options.frames)
        if options.frame is not None:
            raise SuppleError(
                f"{argument('frame')} writes one frame, and {argument('frames')} are some: give one of them"
            )


def refuse_encoding(options: ClipOptions, target: PathLike, what: str) -> None:
    """Raise SuppleError for options of encoders if the target, ``what``, is not a video."""
    for option in _ENCODING:
        if getattr(options, option) is not None:
            raise SuppleError(f"{argument(option)} is for videos, and {shown(target)} is {what}: leave it out")


def _writer(clip: Any, job: Job) -> contextlib.AbstractContextManager[Any]:
    """Return the writer for a target: a video file, or an image sequence."""
    known, shared = job.clip, {"force": job.force, "lossless": job.lossless}
    pictures: dict[str, Any] = {"quality": job.quality, "compression": job.compression, **shared}
    if known.frame is not None or is_picture_target(job.target):
        from supple.media import sequence

        first = 1 if known.first_frame is None else known.first_frame
        return sequence.writer(clip, job.target, only=known.frame, first=first, **pictures)
    if is_animation(job.target, job.source):
        from supple.media import animation

        return animation.writer(clip, job.target, **pictures)
    from supple.media.video.encode import writer

    return writer(clip, job.target, **{option: getattr(known, option) for option in _ENCODING}, **shared)


def is_picture_target(target: PathLike) -> bool:
    """Return whether a name is a sequence: a pattern, a folder, or a name without a suffix."""
    suffix = suffix_of(target)
    return not suffix or (is_sequence(target) and not (has_number(target) and suffix in VIDEOS_OUT))


def deformation_of(job: Job, clip: Clip) -> Deformation:
    """Return the deformation of a clip by a job: strokes with a time warp the clip, others each frame alike.

    Points are relative to the display window of the clip.
    """
    recipe, fit, time_scale, hold = job.recipe, job.fit, job.clip.time_scale, job.clip.hold
    count, shape, name = clip.count, clip.layout.shape, clip.name
    known = recipe.time_scale if time_scale is None else length("time_scale", time_scale)
    worth = 1.0 if known is None else known
    x, y, width, height = clip.display or (0, 0, *shape[::-1])
    if not recipe.strokes or recipe.strokes[0].ndim == 2:
        made = fit_recipe(recipe, (width, height), fit, name)
        return Deformation.from_recipe(made.placed((x, y), shape[::-1]), Grid(shape, origin=(-x, -y)))
    size = (width, height, count)
    scaling = None if recipe.size is None else scaling_of(recipe.size, size, fit, time=True, name=name)
    if scaling is not None:
        worth *= scaling.frame  # so that the brush covers the same part of the clip
    recipe = fit_recipe(recipe, size, fit, name, time=True).placed((x, y, 0), (*shape[::-1], count))
    if hold:
        recipe = with_ends(recipe, hold, (count, *shape), worth)
    return Deformation.from_recipe(recipe, Grid((count, *shape), (1.0, 1.0, worth), (-x, -y, 0)), time=True)


def with_ends(recipe: Recipe, hold: int, shape: tuple[int, ...], worth: float) -> Recipe:
    """Return a recipe in time with a mask that freezes ``hold`` frames at each end; a frame is ``worth`` pixels."""
    widths = Domain(shape, (1.0, 1.0, worth), recipe.border).border_widths
    ends = fade_of(shape, hold, None if widths is None else widths[2] / worth)
    strokes = (
        replace(each, matte=ends.times(each.matte)) if each.brush == "freeze" and each.matte else each
        for each in recipe.strokes
    )
    return replace(recipe, strokes=tuple(strokes), freeze=ends if recipe.freeze is None else ends.times(recipe.freeze))


def fade_of(shape: tuple[int, ...], hold: int, width: float | None = None) -> Freeze:
    """Return a mask for a clip (T, H, W) that varies along time alone, and freezes ``hold`` frames at each end.

    ``width`` is the length of the fade beside them in frames, by default a tenth of the clip, as for a border.
    """
    frames = np.arange(shape[0])
    away = np.minimum(frames, frames[::-1]) - hold
    # The spline averages three frames, which widens the fade by one frame on either side.
    part = np.clip(away / (max(4.0, AUTO * len(frames) if width is None else width) - 2), 0, 1)
    ramp = (part**2 * (3 - 2 * part)).reshape(-1, 1, 1)
    return replace(Freeze.matte_of(ramp, len(frames)), samples=shape[::-1])


@lru_cache(maxsize=4)
def parts_of(count: int, hold: int) -> tuple[float, ...]:
    """Return the strength, 0 to 1, in each frame of strokes without a time, if frames are held at each end."""
    return tuple(map(float, fade_of((count, 1, 1), hold).at([[0], [0], np.arange(count)]).ravel()))


def deformations_of(job: Job, clip: Clip, tell: Tell, *, bent: range | None = None) -> tuple[Deformation, ...]:
    """Return the deformations of a clip by a job: one, or one for each frame if its strokes move or fade.

    Deformations of frames that are not ``bent`` are not used, and arbitrary.
    """
    recipe, hold, count, shape, name = job.recipe, job.clip.hold, clip.count, clip.layout.shape, clip.name
    if recipe.straighten is not None:
        raise SuppleError(f"straightening is for pictures, and {name} is a clip: leave it out")
    if not (recipe.moves or (hold and recipe.strokes and recipe.strokes[0].ndim == 2)):
        return (deformation_of(job, clip),)
    x, y, *size = clip.display or (0, 0, *shape[::-1])
    fitted = fit_recipe(recipe, size, job.fit, name).placed((x, y), shape[::-1])
    return motion_of(fitted, count, shape, tell, hold=hold, bent=bent)


def between_frames(sampling: Sampling, options: ClipOptions) -> Sampling:
    """Return ``sampling`` with the options for time: by default, samples follow motion if OpenCV is installed."""
    between = options.between
    if sampling.filter == "labels":
        refuse("filter", '"auto", "cubic", "linear" or "nearest" for a clip', sampling.filter)
    if between is None and sampling.filter != "nearest" and find_spec("cv2") is not None:
        between = "flow"
    return replace(sampling, between=between, time_filter=options.time_filter)


def sampling_of(clip: Clip, sampling: Sampling = DEFAULT) -> Sampling:
    """Return sampling options for a clip's frames, with the fill value converted to its components."""
    layout = clip.layout
    if sampling.linear_light and (len(layout.groups) > 1 or layout.dtype.kind == "f" or any(layout.black)):
        raise SuppleError(
            f"{argument('linear_light')} needs frames of RGB or grey of 8 or 16 bits, and {clip.name} has others: "
            "leave it out"
        )
    return replace(sampling, fill=_filled(clip, sampling.fill))


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
    if layout.dtype.kind == "u" and not 0 <= min(values) <= max(values) <= layout.white:
        refuse("fill", f"from 0 to {layout.white:g} for the frames of {clip.name}", fill)
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


def streamed(clip: Any, work: Work, plan: Plan, memory: float) -> Iterator[tuple[int, list[Array], Certificate]]:
    """Yield the frames of a plan, as `stream` does; only the frames of the clip that they need are read."""
    first = int(plan.keep[0]) if plan.planes else 0
    frames: Iterable[Frame] = islice(clip.frames(), first, None)  # files are only read when copied
    if first and not clip.stills:
        frames = (frame for _, frame in clip.frames_from(first))
    yield from stream(work, plan, frames, memory=memory, first=first)


def work_on(clip: Clip, deformations: Sequence[Deformation], sampling: Sampling) -> Work:
    """Return the work on the frames of a clip, with one deformation, or one for each frame."""
    space = replace(deformations[0].space, count=clip.count)
    if len(deformations) == 1:
        return Work(space, clip.layout, sampling)
    each = {id(deformation): deformation.space for deformation in deformations}
    return Work(space, clip.layout, sampling, tuple(each[id(deformation)] for deformation in deformations))


def displayed(rotation: float, mirrored: bool) -> str:
    """Return, in words, how players mirror and rotate the frames of a video; empty if they do not."""
    turn = f"turned by {abs(rotation):g}° {'clockwise' if rotation < 0 else 'counterclockwise'}" if rotation else ""
    return " and ".join(filter(None, ("mirrored" if mirrored else "", turn)))


def warn_of_display(clip: Clip) -> None:
    """Warn that points refer to stored frames, if players mirror or rotate these."""
    if how := displayed(clip.rotation, clip.mirrored):
        height, width = clip.layout.shape
        what = f"is {how} when it is played: points are in the frame as it is stored, {width} x {height}"
        warn(f"{clip.name} {what}", ClipWarning)


def warn_of_frames(clip: Clip, deformations: Sequence[Deformation]) -> None:
    """Warn that points refer to stored frames if players rotate these, and that interlaced fields are bent together."""
    if all(each.is_identity for each in deformations):
        return
    warn_of_display(clip)
    if clip.fields:
        what = (
            f"is interlaced, {clip.fields} field first, and the two fields of a frame are bent as one picture, which "
            "mixes them: deinterlace it first, with FFmpeg's filter bwdif for instance"
        )
        warn(f"{clip.name} {what}", ClipWarning)


def motion_of(
    recipe: Recipe,
    count: int,
    shape: tuple[int, int],
    tell: Tell = lambda step, done, total: None,
    *,
    hold: int = 0,
    bent: range | None = None,
) -> tuple[Deformation, ...]:
    """Return the deformation of each frame for a recipe whose strokes have keys or fade.

    The recipe must fit the frames, whose ``shape`` is (rows, columns). Equal frames share one deformation; frames that
    are not ``bent`` have the identity. Strokes with keys may leave the picture, with an OutsideWarning if they start
    outside it in every frame; of equal warnings in several frames, only the first is given. ``tell`` is called with
    ``"plan"``, the number of planned frames, and ``count``. ``hold`` is as in `ClipOptions`. Errors are those of
    `Deformation.from_recipe`, with the frame.
    """
    for matte in (stroke.matte for stroke in recipe.strokes):
        if matte is not None and matte.ndim == 3 and matte.samples[2] != count:
            what = f"has {matte.samples[2]} frames, and the clip {count}: give one of its length"
            raise SuppleError(f"the matte {shown(matte.name)} {what}")
    roaming = {i for i, stroke in enumerate(recipe.strokes) if any(key.at is not None for key in stroke.keys)}
    frames = [recipe.at_frame(k) for k in range(count)]
    if hold:
        parts = parts_of(count, hold)
        frames = [replace(now, amount=now.amount * part) for now, part in zip(frames, parts, strict=True)]
    known: dict[Recipe, Deformation] = {}
    still = Deformation.from_recipe(replace(recipe, strokes=()), shape)
    told: dict[tuple[type[Warning], str], tuple[str, set[Recipe]]] = {}
    for k, now in enumerate(frames):

        def say(text: str, kind: type[Warning], now: Recipe = now) -> None:
            about = _STROKE.match(text)
            told.setdefault((kind, about[0] if about else ""), (text, set()))[1].add(now)

        if bent is not None and k not in bent:
            continue
        if now not in known:
            try:
                known[now] = Deformation.from_recipe(now, shape, roaming=roaming, say=say)
            except SuppleError as error:
                raise type(error)(f"frame {numbered(k)}: {error}") from None
        tell("plan", k + 1, count)
    _check_places(recipe, roaming, {now.strokes for now in frames}, count, shape)
    for (kind, _), (text, some) in told.items():
        at = [k for k, now in enumerate(frames) if now in some]
        more = f" (and in {len(at) - 1} more)" if len(at) > 1 else ""
        warn(f"frame {numbered(at[0])}{more}: {text}", kind)
    return tuple(still if bent is not None and k not in bent else known[now] for k, now in enumerate(frames))


def _check_places(
    recipe: Recipe, moving: Iterable[int], seen: Iterable[Sequence[Stroke]], count: int, shape: tuple[int, int]
) -> None:
    """Warn of strokes whose keys are all outside this clip, or which are never in the picture."""
    (height, width), seen = shape, list(seen)
    for i in sorted(moving):
        stroke, which = recipe.strokes[i], f"stroke {i + 1}"
        if stroke.hidden:
            continue
        frames = [key.frame for key in stroke.keys if key.at is not None]
        if len(frames) > 1 and (frames[-1] < 0 or frames[0] >= count):
            text = f"{which} has positions in frames {numbered(frames[0])} to {numbered(frames[-1])}, and the clip has "
            text += f"{count}, from {numbered(0)}: it follows none of them (does the track give the first another?)"
            warn(text, OutsideWarning)
        places = [strokes[i].at for strokes in seen]
        if not any(-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5 for x, y in places):
            text = f"{which} starts outside the picture, which has {width} x {height} pixels, in every frame"
            warn(text, OutsideWarning)
