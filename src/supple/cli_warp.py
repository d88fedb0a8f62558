"""The command that bends files."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from supple.console import Console, SomeFailedError, current, say_convention, told_of_software
from supple.errors import SuppleError
from supple.options import RUNNING, RunOptions, StrokeOptions, VideoOptions, parse_fill, parse_number
from supple.options_volume import VOLUME, VolumeOptions
from supple.workers import workers

if TYPE_CHECKING:
    from supple.batch import Job
    from supple.clips import WarpedClip
    from supple.deformation import Deformation, Report
    from supple.files import Warped
    from supple.volumes import WarpedVolume

Outside = Literal["edge", "constant", "reflect"]
Warper = Literal["auto", "cpu", "gpu", "cuda"]
Tell = Callable[[str], None]

SAMPLING = Group("Sampling", sort_key=2)
WRITING = Group("Writing", sort_key=3)

_RUN = RunOptions()
_STROKES = StrokeOptions()
_VIDEO = VideoOptions()
_VOLUME = VolumeOptions()


def warp(
    *paths: Annotated[str, Parameter(name="IN... OUT", required=True)],
    strokes: StrokeOptions = _STROKES,
    filter: Annotated[str, Parameter(group=SAMPLING, metavar="auto|cubic|linear|nearest")] = "auto",
    outside: Annotated[Outside, Parameter(group=SAMPLING)] = "edge",
    fill: Annotated[str, Parameter(group=SAMPLING, metavar="V|V,V,V", allow_leading_hyphen=True)] = "0",
    tolerance: Annotated[str, Parameter(group=SAMPLING, metavar="PX", allow_leading_hyphen=True)] = "0.01",
    linear_light: Annotated[bool, Parameter(group=SAMPLING)] = False,
    quality: Annotated[int | None, Parameter(group=WRITING, metavar="1..100", allow_leading_hyphen=True)] = None,
    lossless: Annotated[bool, Parameter(group=WRITING)] = False,
    save_recipe: Annotated[str | None, Parameter(group=WRITING, metavar="FILE")] = None,
    video: VideoOptions = _VIDEO,
    labels: Annotated[bool, Parameter(group=VOLUME)] = False,
    save_field: Annotated[str | None, Parameter(group=VOLUME, metavar="FILE")] = None,
    volume: VolumeOptions = _VOLUME,
    device: Annotated[Warper, Parameter(group=RUNNING)] = "cpu",
    options: RunOptions = _RUN,
) -> None:
    """Bend pictures, videos and volumes.

    Several files, a folder or a pattern in quotes go into a folder, under the same names. Numbered pictures,
    frames/%05d.png, or with a time a folder of them, are a video; a folder of DICOM slices is a volume.

    Parameters
    ----------
    paths
        Files to read, and last the one to write (by suffix: PNG, JPEG, TIFF, WebP, AVIF; MP4, MOV, MKV, WebM,
        AVI, GIF; NIfTI, NRRD, MHA) or a folder.
    filter
        Colours between pixels: auto is cubic, and averages just what the map shrinks.
    outside
        What is seen beyond the edges: these go on, a constant (--fill), or the mirror image.
    fill
        The constant, in the picture's own values: one for all channels, or one for each.
    tolerance
        How far from its exact place a colour may be taken, in pixels; this is certified.
    linear_light
        Average light rather than sRGB values, which darken fine detail.
    quality
        For JPEG (default 95), WebP and AVIF (90).
    lossless
        Keep every value in WebP and AVIF, and of a video, by FFV1 or the --codec; PNG and TIFF always do.
    save_recipe
        Write the strokes, to be carried out again with --recipe.
    labels
        Values are names of things, and are kept: each voxel takes that of the nearest.
    save_field
        Write the inverse displacements too, for SimpleITK, ANTs and 3D Slicer: NIfTI, NRRD, MHA or .h5.
    device
        Who does it: the CPU, the GPU, or auto: a graphics card, where there is one; or cuda, an NVIDIA card, of
        pictures and volumes.
    """
    console = current()
    from supple.batch import Crew, check_recipe_file, make_folders, pair
    from supple.clips import is_clip
    from supple.engines import check_device
    from supple.files import warp_file, write_recipe
    from supple.native import check_filter
    from supple.volumes import holds_volumes, is_volume_job

    if len(paths) < 2:
        raise SuppleError("give a file to read and a name to write to: supple warp IN OUT --grab …")
    console.started(quiet=options.quiet, threads=options.threads)
    check_filter(filter)
    recipe = strokes.to_recipe()
    say_software = told_of_software(console, device)
    sampling: dict[str, Any] = {
        "filter": filter,
        "outside": outside,
        "fill": parse_fill(fill),
        "tolerance": parse_number("--tolerance", tolerance, "a number of pixels above 0"),
        "linear_light": linear_light,
        "quality": quality,
        "lossless": lossless,
        "device": device,
        "force": options.force,
        "clip": video.to_clip(),
        "volume": volume.to_reading(labels=labels, save_field=save_field),
    }
    if not paths[-1]:
        raise SuppleError("cannot write '': name a file, or a folder, last")
    reading = sampling["volume"]
    single = len(paths) == 2 and not _stands_for_several(paths[0]) and not holds_volumes(paths[0])
    if single and (is_volume_job(paths[0], paths[1], recipe, reading) or is_clip(paths[0], paths[1], recipe)):
        jobs, many = [(Path(paths[0]), Path(paths[1]))], False
    else:
        jobs, many = pair(paths[:-1], paths[-1])
    if save_recipe is not None:
        if save_field is not None and os.path.realpath(save_recipe) == os.path.realpath(save_field):
            raise SuppleError(f"{save_recipe} cannot be both the recipe and the field: give one another name")
        check_recipe_file(save_recipe, jobs, options.force)

    def do(job: Job, tell: bool | Tell) -> None:
        with workers() as who:
            made = warp_file(job[0], job[1], recipe, progress=tell, **sampling)
        if options.json:
            console.tell({**_facts_of(job, made), "device": str(who)})
        say_convention(console, reading.world, getattr(made, "geometry", None), job[0])

    def failed(job: Job, message: str) -> None:
        if options.json:
            console.tell({"input": str(job[0]), "output": str(job[1]), "error": message})

    if not all(is_clip(*job, recipe) for job in jobs):  # of clips, it says that it does not do them
        check_device(device)
    if many:
        from supple.workers import threads

        make_folders(jobs)
        # Of clips and volumes one at a time: each has work for all cores.
        large = any(is_clip(*job, recipe) or is_volume_job(*job, recipe, reading) for job in jobs)
        crew = 1 if large else min(len(jobs), threads())
        failures = Crew(crew).work(jobs, do, console, failed)
    else:
        failures = 0
        _alone(console, jobs[0], do, failed)
    say_software()
    if save_recipe is not None:
        write_recipe(save_recipe, recipe, force=options.force)
    if failures:
        raise SomeFailedError(failures)


def _alone(console: Console, job: Job, do: Callable[[Job, bool], None], failed: Callable[[Job, str], None]) -> None:
    try:
        do(job, console.terminal)
    except SuppleError as error:
        failed(job, str(error))
        raise


def _stands_for_several(source: str) -> bool:
    """Whether several videos go into a folder, which a pattern stands for; of one, a folder takes the pictures."""
    from supple.media.numbering import has_number

    return glob.has_magic(source) and not has_number(source) and not os.path.exists(source)


def _facts_of(job: Job, made: Warped | WarpedClip | WarpedVolume) -> dict[str, Any]:
    from supple.clips import WarpedClip
    from supple.volumes import WarpedVolume

    if isinstance(made, WarpedClip):
        return _clip_facts(made)
    if isinstance(made, WarpedVolume):
        return _volume_facts(made)
    return picture_facts(job, made.deformation, made.report())


def _volume_facts(made: WarpedVolume) -> dict[str, Any]:
    depth, height, width = made.deformation.shape
    return {
        "input": str(made.source),
        "output": str(made.target),
        "width": width,
        "height": height,
        "depth": depth,
        "volumes": made.volumes,
        "spacing": list(made.geometry.spacing),
        "convention": made.geometry.convention,
        "tolerance": made.tolerance,
        "error": made.error,
        **made.deformation.resolution(),
    }


def _clip_facts(made: WarpedClip) -> dict[str, Any]:
    deformation = made.deformation
    height, width = deformation.shape[-2:]
    return {
        "input": str(made.source),
        "output": str(made.target),
        "width": width,
        "height": height,
        "frames": made.frames,
        "still": made.still,
        "copied": made.copied,
        "held": made.held,
        "tolerance": made.tolerance,
        "error": made.error,
        **deformation.resolution(),
    }


def picture_facts(job: Job, deformation: Deformation, report: Report) -> dict[str, Any]:
    """Return what is told of a picture that was warped or drawn."""
    from dataclasses import asdict

    height, width = deformation.shape
    return {"input": str(job[0]), "output": str(job[1]), "width": width, "height": height, **asdict(report)}
