"""Plots of the effect of strokes on an image, a video or a volume."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.engine.progress import counted
from supple.engine.sampling import Sampling
from supple.engine.stream import make_plan
from supple.engine.work import Array
from supple.errors import SuppleError, argument, shown
from supple.files import clips
from supple.files.grids import grid_on
from supple.files.jobs import Job, refuse_places
from supple.files.options import ClipOptions
from supple.media.files import check_output
from supple.plot import WHATS, draw_sheet, draw_slice, plot
from supple.plot.clip import evenly
from supple.plot.frame import check_plot
from supple.space.checks import choice, integer
from supple.strokes import fit_recipe

Colours = npt.NDArray[np.uint8]

_COLUMNS = 6  # frames on a sheet
_SEEN = 0.5  # pixels and frames: the smallest displacement that counts as visible


def plot_file(
    job: Job,
    what: str = "grid",
    *,
    frame: int | None = None,
    x: int | None = None,
    y: int | None = None,
    progress: bool = False,
    plane: str | None = None,
) -> Deformation:
    """Plot the effect of strokes, fields and affine maps on a file.

    Parameters
    ----------
    job : Job
        Of these: ``source``, an image, a video, a pattern or a folder of frames, or a volume; ``target``, a PNG, SVG or
        PDF file; ``recipe``, ``maps`` and ``grid``, that of another volume; ``clip``, ``volume``, ``fit``, ``force``.
    what : str
        One of `supple.plot.WHATS`; for a clip also ``"slice"``, a column or a row over time, and ``"sheet"``, some
        frames before and after the warp, from the range with displacements of at least half a pixel.
    frame : int, optional
        The frame of a clip to plot.
    x, y : int, optional
        The column, or row, of a slice.
    progress : bool
        Whether to show the progress of a clip on a terminal.
    plane : str, optional
        The plane of a volume, as in `supple.plot.volume.draw_volume`.

    Returns
    -------
    Deformation
        The strokes on the file's shape.

    Raises
    ------
    SuppleError
        If the source cannot be read, plotted or written.
    """
    source, target, recipe, options, maps, force = job.source, job.target, job.recipe, job.clip, job.maps, job.force
    choice("what", what, (*WHATS, "slice", "sheet"))
    clips.refuse_encoding(options, target, "a plot")
    if what != "slice" and (x is not None or y is not None):
        text = f"{argument('x')} and {argument('y')} are for slices, and {what} shows whole frames: leave them out"
        raise SuppleError(text)
    check_output(target, force=force)
    check_plot(target, force=force)
    if (kind := replace(job, target="").medium.kind) in ("volume", "store"):  # of which the latter cannot be read whole
        if frame is not None or options != ClipOptions(memory=options.memory):
            raise SuppleError(f"{shown(source)} is a volume, which has no frames: leave out what is for videos")
        return _plot_volume(job, what, plane)
    for name, value in (("plane", plane), ("reference", job.grid and kind == "clip"), ("world", job.volume.world)):
        if value:
            raise SuppleError(f"{argument(name)} is for volumes, and {shown(source)} is none: leave it out")
    refuse_places(recipe, source)

    def once(count: int | None) -> Deformation:
        with clips.open_clip(source, rate=options.rate, count=count) as clip:
            height, width = clip.layout.shape
            deformations = clips.deformations_of(job, clip, tell)
            deformation = deformations[0]
            if count is None:
                clips.warn_of_frames(clip, deformations)
            line: tuple[Any, ...] = ()
            planes: Sequence[int] = ()
            if what == "slice":
                if (x is None) == (y is None):
                    text = f"a slice shows one column or one row over time: give {argument('x')} or {argument('y')}"
                    raise SuppleError(text)
                axis, given, most = ("x", x, width) if x is not None else ("y", y, height)
                at = integer(axis, given, f"from 0 to {most - 1}, as the frame is {width} x {height}", 0, most - 1)
                line, planes = (slice(None), at) if axis == "x" else (at,), range(clip.count)
            elif what == "sheet":
                planes = _seen_best(clip, deformations, options)
            else:
                if frame is None:
                    raise SuppleError(f"{clip.name} is a video: give {argument('frame')}, from 0 to {clip.count - 1}")
                planes = [integer("frame", frame, f"from 0 to {clip.count - 1}", 0, clip.count - 1)]
                deformation = deformations[planes[0]] if len(deformations) > 1 else deformation
            if what not in WHATS and frame is not None:
                text = f"{argument('frame')} is for the pictures of one frame, and {what} shows many: leave it out"
                raise SuppleError(text)
            before = [] if what in WHATS else [rgb[line].copy() for rgb in _shown(clip, planes)]
            work = clips.work_on(clip, deformations, clips.sampling_of(clip, clips.between_frames(Sampling(), options)))
            after = []
            for _, arrays, _ in clips.streamed(clip, work, make_plan(work, planes), options.memory):
                after.append(clip.to_rgb(arrays)[line].copy())
                tell("warp", len(after), len(planes))
            if what == "slice":
                draw_slice(np.stack(before), np.stack(after), at, target, axis=axis, force=force)
            elif what == "sheet":
                sheets = (list(zip(planes, some, strict=True)) for some in (before, after))
                draw_sheet(next(sheets), next(sheets), target, force=force)
            else:
                timed = deformation.ndim == 3
                plot(deformation, what, target, image=after[0], frame=planes[0] if timed else None, force=force)
        return deformation

    if kind == "clip":
        if maps:
            clips.refuse_maps(source)
        clips.refuse_picture(source)
        with counted(progress) as tell:
            return clips.counted_anew(source, once)
    timeless = options == ClipOptions(memory=options.memory)
    if what in ("slice", "sheet") or frame is not None or not timeless:
        raise SuppleError(f"{shown(source)} is taken for a picture, which has no time: leave out what is for videos")
    from supple.media.image import read

    if recipe.straighten is not None:
        raise SuppleError("plots are of strokes and maps, on the picture as it is: leave straightening out")
    picture = read(source)
    height, width = picture.pixels.shape[:2]
    fitted = fit_recipe(recipe, (width, height), job.fit, shown(source))
    deformation = Deformation.from_recipe(fitted, (height, width), maps=maps)
    plot(deformation, what, target, image=picture, force=force)
    return deformation


def _plot_volume(job: Job, what: str, plane: str | None) -> Deformation:
    """Plot a deformation on a plane of a volume; for a series, of its first volume."""
    from supple.files.volumes import deformation_of, is_of_labels, open_volume
    from supple.plot import volume as drawn

    if what not in drawn.WHATS:
        kinds = " or ".join(drawn.WHATS)
        raise SuppleError(f"{what} is for pictures and videos, and {shown(job.source)} is a volume: draw {kinds}")
    volume = open_volume(job.source, job.volume)
    out = grid_on(job.grid, volume.grid, volume.name, job.maps)
    deformation = deformation_of(job, volume)
    labels, samples = volume.is_segmentation or is_of_labels(volume), volume.rescaled()
    drawn.draw_volume(
        deformation, what, samples[0] if volume.series else samples, volume.grid, job.target,
        out=out, plane=plane, labels=labels, name=Path(job.source).name, force=job.force,
    )  # fmt: skip
    return deformation


def _seen_best(clip: Any, deformations: Sequence[Deformation], options: ClipOptions) -> list[int]:
    """Return the frames of a sheet: evenly spaced over those with visible displacements."""
    sampling = Sampling(tolerance=_SEEN, between=options.between, time_filter=options.time_filter)
    work = clips.work_on(clip, deformations, clips.sampling_of(clip, sampling))
    moving = np.flatnonzero(~make_plan(work, range(clip.count)).still)
    first, last = (int(moving[0]), int(moving[-1])) if moving.size else (0, clip.count - 1)
    return [first + k for k in evenly(last - first + 1, _COLUMNS)]


def _shown(clip: Any, planes: Sequence[int]) -> Iterator[Colours]:
    """Yield the given frames of a clip, unwarped, in RGB."""
    wanted = set(planes)
    arrays: list[Array] = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
    for k, picture in enumerate(clip.frames()):
        if k in wanted:
            picture.copy_to(arrays)
            yield clip.to_rgb(arrays)
