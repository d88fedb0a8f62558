"""Clips warped to clips: videos and image sequences, streamed through a deformation."""

from __future__ import annotations

import contextlib
import os
import shutil
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from supple.arrays import check_device
from supple.deformation import Deformation, Report
from supple.engine.sampling import Certificate, warn_of
from supple.engine.stream import Done, run
from supple.engine.work import Tell
from supple.errors import OutsideWarning, SuppleError, argument, caller, shown
from supple.files.clip_work import deformations_of, sampling_of, warn_of_frames, work_on
from supple.files.kinds import VIDEOS_OUT, is_animated
from supple.files.options import ClipOptions, PathLike
from supple.folding.resolved import warn_of_still
from supple.media.base import Clip, CountError
from supple.media.files import check_output, replacing
from supple.media.image import check_quality, check_target
from supple.media.image.formats import SUFFIXES as SUFFIXES_IN
from supple.media.image.formats import SUFFIXES_OUT as PICTURES_OUT
from supple.media.numbering import has_number, is_sequence
from supple.media.suffixes import suffix_of
from supple.space.domain import integer, number
from supple.space.geometry import Grid
from supple.strokes import Fit, Recipe

if TYPE_CHECKING:
    from fractions import Fraction


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
    own : Grid, optional
        The grid of the frames as they are shown, if it is not that of the deformation: OpenEXR may have pixels beyond.
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
    own: Grid | None = None

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


@contextlib.contextmanager
def open_clip(
    source: PathLike,
    *,
    rate: float | Fraction | None = None,
    count: int | None = None,
    target: PathLike | None = None,
) -> Iterator[Clip]:
    """Open a video file, or an image sequence by its pattern or folder; ``target`` is what is written of it, if any."""
    if is_sequence(source) and not os.path.isfile(source):
        from supple.media import sequence

        with sequence.open_clip(source, rate=24 if rate is None else rate, target=target) as pictures:
            yield pictures
        return
    if rate is None and suffix_of(source) == ".webp" and is_animated(source):
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
            with open_clip(source, rate=known.rate, count=count, target=target) as clip:
                deformations = deformations_of(recipe, clip, known.time_scale, fit, tell)
                if count is None:
                    warn_of_still(recipe.strokes)
                    warn_of_frames(clip, deformations)
                sampling = sampling_of(
                    clip,
                    filter=filter,
                    outside=outside,
                    fill=fill,
                    tolerance=tolerance,
                    light=linear_light,
                    between=known.between,
                    time_filter=known.time_filter,
                )
                work = work_on(clip, deformations, sampling)
                untouched = work.is_identity and known == replace(ClipOptions(), memory=known.memory)
                if untouched and not lossless and os.path.isfile(source) and suffix_of(source) == suffix_of(target):
                    # Encoding a clip again would change it.
                    check_output(target, force=force)
                    _warn_of_none(recipe, clip)
                    with replacing(target, force=force) as place:
                        shutil.copyfile(source, place)
                    done, copied = Done(Certificate(0.0, 0.0), still=clip.count), clip.count
                else:
                    tell("write", 0, clip.count)
                    # The writer first: its errors come before any work.
                    with _writer(clip, target, known, quality, lossless, force) as sink:
                        done = run(clip, sink, work, memory=known.memory, tell=tell)
                        warn_of(done.certificate, tolerance, 3)  # before the target is renamed
                        if done.still == clip.count:
                            _warn_of_none(recipe, clip)
                    copied = getattr(sink, "copied", 0)
                return WarpedClip(
                    Path(source), Path(target), deformations, tolerance, clip.count, done.still, done.held,
                    done.certificate.error, copied, _own(clip, deformations[0]),
                )  # fmt: skip
        except CountError as miscounted:
            if count is not None:
                raise fickle(source) from None
            count = miscounted.found


def _own(clip: Clip, deformation: Deformation) -> Grid | None:
    if clip.display is None:
        return None
    grid, (width, height) = deformation.grid, clip.display[2:]
    return Grid((*grid.shape[:-2], height, width), grid.spacing)


def _warn_of_none(recipe: Recipe, clip: Clip) -> None:
    """Warn that strokes that move something do not in this clip."""
    able = (each for each in recipe.strokes if each.strength > 0 and not each.hidden and not each.is_still)
    if recipe.amount and any(able):
        text = f"no stroke moves a pixel of any frame of {clip.name}: its frames are as they were"
        warnings.warn(text, OutsideWarning, stacklevel=caller())


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
        if suffix_of(target) in PICTURES_OUT:
            stem, suffix = os.path.splitext(name)
            raise SuppleError(
                f"{name} is one picture, and a clip is many: name a pattern, such as {stem}-%05d{suffix}, or a folder"
            )
        if quality is not None:
            raise SuppleError(f"{argument('quality')} is for pictures, and {name} is a video: give a crf")
        from supple.media import video

        video.check_target(target)
        check_output(target, force=force)
        return
    if has_number(target):
        check_target(target)
    for option in ("codec", "crf", "preset", "pixel_format"):
        if getattr(options, option) is not None:
            raise SuppleError(f"{argument(option)} is for videos, and {name} is pictures: leave it out")
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
    suffix = suffix_of(target)
    return not suffix or (is_sequence(target) and not (has_number(target) and suffix in VIDEOS_OUT))
