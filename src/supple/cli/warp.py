"""The commands that bend files, and that plan it."""

import glob
import os
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import asdict, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from supple.cli.console import (
    STREAM,
    File,
    SomeFailedError,
    about,
    one_line,
    told,
)
from supple.cli.options import (
    RUNNING,
    SAMPLING,
    VIDEO,
    WRITING,
    Labels,
    RunOptions,
    SamplingOptions,
    SeveralOptions,
    TrackOptions,
    VideoOptions,
    VolumeArguments,
    WorkerOptions,
    WritingOptions,
    is_pattern,
    text,
    whole,
)
from supple.cli.options_maps import (
    MapOptions,
    OutputOptions,
    output_facts,
    say_output,
)
from supple.cli.options_strokes import StrokeOptions
from supple.engine.devices import workers
from supple.errors import SuppleError, shown

if TYPE_CHECKING:
    from supple.deformation import Deformation, Report
    from supple.files.jobs import Warped
    from supple.files.stores import Planned
    from supple.strokes import Recipe

Warper = Literal["auto", "cpu", "cuda"]
Tell = Callable[[str], None]
_OF_STORES = ("shape", "levels", "labels", "blocks", "done", "copied", "read", "copied_bytes")
Pair = tuple[Any, Any]  # of Path; for one file, which may be at a URL, of str


def warp(
    *paths: Annotated[str, Parameter(name="IN... OUT", required=True)],
    strokes: StrokeOptions = StrokeOptions(),
    maps: MapOptions = MapOptions(),
    output: OutputOptions = OutputOptions(),
    sampling: SamplingOptions = SamplingOptions(),
    linear_light: Annotated[bool, Parameter(group=SAMPLING)] = False,
    clamp: Annotated[bool | None, Parameter(group=SAMPLING, negative="--no-clamp")] = None,
    writing: WritingOptions = WritingOptions(),
    compression: Annotated[str | None, Parameter(group=WRITING, metavar="HOW")] = None,
    fast: Annotated[bool, Parameter(group=WRITING)] = False,
    save_field: Annotated[str | None, Parameter(group=WRITING, metavar="FILE")] = None,
    frames: Annotated[str | None, text("A-B", group=VIDEO)] = None,
    frame: Annotated[str | None, text("K", group=VIDEO)] = None,
    hold: Annotated[int, whole(group=VIDEO)] = 0,
    video: VideoOptions = VideoOptions(),
    tracks: TrackOptions = TrackOptions(),
    labels: Labels = False,
    volume: VolumeArguments = VolumeArguments(),
    several: SeveralOptions = SeveralOptions(),
    running: WorkerOptions = WorkerOptions(),
    device: Annotated[Warper, Parameter(group=RUNNING)] = "cpu",
    options: RunOptions = RunOptions(),
) -> None:
    """Bend pictures, videos and volumes.

    Several files, a folder or a pattern in quotes are written to a folder under the same names. Numbered pictures
    (frames/%05d.png or frames/#####.png) are a video, and so is a folder of pictures if the strokes have a time. A
    folder of DICOM slices is a volume. A Zarr array or an OME-Zarr image, in a folder or at an address, is written
    block by block to another one, and goes on where it was interrupted.

    Parameters
    ----------
    paths
        Files to read, and last the file or folder to write. The suffix of OUT is its format: PNG, JPEG, TIFF,
        WebP, AVIF, OpenEXR, DPX and others; MP4, MOV, MKV, WebM, AVI, GIF, APNG, WebP; NIfTI, NRRD, MHA; Zarr, of
        pictures and volumes. A dash, -, is standard input or output, in the input's format.
    linear_light
        Average in linear light instead of sRGB values, so that fine detail does not darken.
    clamp
        Keep values within the range of the input, which cubic filters leave beside sharp edges (default for volumes
        and pictures of floats).
    compression
        How TIFF and PNG are compressed: none, deflate, lzw or packbits (TIFF), or a level of deflate, 0 to 9. A TIFF
        keeps its own.
    fast
        Write lossless pictures as fast as their format allows; they are larger.
    save_field
        Also write the map from the result to its source points. Of a picture: an STMap (.exr, .tif) or a map for
        cv2.remap (.npy, .npz, .xml, .yml). Of a volume: a displacement field for SimpleITK, ANTs and 3D Slicer: NIfTI,
        NRRD, MHA or .h5; or beside a Zarr store, of both directions of the map, as OME-Zarr: .zarr.
    frames
        Bend frames A to B of a video, and pass on the others as they are. Strokes count in the whole video.
    frame
        Write this frame of a video alone, bent, as a picture.
    hold
        Keep every bit of the first and the last N frames of a video: strokes fade towards them.
    device
        Where to compute: cpu (which auto is), or cuda (an NVIDIA GPU, for pictures and volumes).
    """
    console, save_recipe = options.start(paths[0] if len(paths) == 2 else ""), writing.save_recipe
    from supple.arrays import check_device
    from supple.cli.jobs import Crew, make_folders, pair, piped, summary
    from supple.engine.sampling import FINEST
    from supple.files.jobs import Job
    from supple.files.recipes import check_recipe_name, write_recipe
    from supple.media.files import is_store
    from supple.media.medium import holds_volumes

    if len(paths) < 2:
        raise SuppleError("give a file to read and a name to write to: supple warp IN OUT --grab …")
    grid, typed = output.to_grid(), video.frames(paths[0])
    reading = volume.to_reading(strokes=strokes.bends, labels=labels)
    edits_of = partial(
        strokes.read, maps, reading, console.arguments,
        reference=output.onto, frames=typed, empty=grid is not None,
    )  # fmt: skip
    folder = os.path.isdir(paths[0]) and not is_store(paths[0])
    alone = len(paths) == 2 and paths[0] != STREAM and not folder and not is_pattern(paths[0])
    edits = edits_of(paths[0], target=paths[-1] if alone else None)
    for option, value in {"--track": tracks.track, "--save-recipe": save_recipe}.items():
        if value is not None and edits.relative and not alone:
            raise SuppleError(f"{option} is for one file where strokes are at landmarks or in percent: leave one out")
    if strokes.mirror is not None and tracks.track is not None:
        raise SuppleError("--mirror is of strokes that stay, and --track moves them: leave one out")
    elements = edits.maps
    recipe = tracks.followed(edits.recipe, edits.own, paths, video.to_clip().memory, typed)
    if elements and save_recipe is not None:
        raise SuppleError("--save-recipe is for strokes alone, which --field and --affine are not: leave it out")
    if 1e-9 <= sampling.tolerance < FINEST:
        written = f"{sampling.tolerance:g}".replace("e-0", "e-")
        console.warn(
            f"--tolerance {written} is not reached everywhere: source points are float32, and exact to about "
            f"{FINEST:g} pixels"
        )
    shot = replace(
        video.to_clip(), hold=hold, first_frame=typed.first,
        frame=None if frame is None else typed.read("--frame", frame),
        frames=None if frames is None else typed.part("--frames", frames),
    )  # fmt: skip
    elsewhere = bool(elements) or output.onto is not None or recipe.straighten is not None
    known, outside = sampling.to_sampling(elsewhere, linear_light)
    template = Job(
        paths[0], paths[-1], recipe, known, outside, clamp, writing.quality, writing.lossless, device, options.force,
        shot, reading, strokes.to_fit(), grid=grid, compression="fast" if fast else compression,
        running=running.to_running(), save_field=save_field,
    )  # fmt: skip
    if fast and compression is not None:
        raise SuppleError("--fast is a compression, and so is what --compression names: give one of them")
    if options.json and paths[-1] == STREAM:
        raise SuppleError("--json and the picture cannot both go to standard output: leave --json out, or name a file")
    if not paths[-1]:
        raise SuppleError("cannot write '': name a file, or a folder, last")
    if save_recipe is not None:
        check_recipe_name(save_recipe, force=options.force)

    paths = _as_clip(paths, recipe)
    left: list[Path] = []
    single = len(paths) == 2 and not is_pattern(paths[0]) and not holds_volumes(paths[0])
    stored = next(filter(is_store, paths), "")
    if stored and STREAM in paths:
        raise SuppleError(f"{shown(stored)} is a Zarr store, and standard output or input cannot be used: name a file")
    if stored and not single:
        raise SuppleError(f"{shown(stored)} is a Zarr store, and stores are written one at a time: name one, and OUT")
    into = os.path.isdir(paths[-1]) or paths[-1].endswith(("/", os.sep))
    if single:
        medium = replace(template, source=paths[0], target=paths[1]).medium
        # DICOM slices are written to a folder as one volume; a folder of other volumes is a batch, as for pictures
        single = medium.kind in ("clip", "store") or (medium.kind == "volume" and (not into or medium.is_dicom))
    if single:
        named, many = str if medium.kind == "store" else Path, False
        pairs = list[Pair]([(named(paths[0]), named(paths[1]))])
    else:
        pairs, many, left = pair(paths[:-1], paths[-1], recursive=several.recursive)
    several.check(many, options.force)
    if len(pairs) > 1 and save_field is not None:
        raise SuppleError("--save-field is of one file, and there are several: leave it out")
    _check_apart(save_recipe, [save_field, *chain(*pairs)])
    marks = strokes.landmarks
    if many and marks is not None and os.path.isfile(marks) and not marks.lower().endswith(".xml"):
        raise SuppleError(
            f"--landmarks {marks} is of one picture, and there are several: give a folder with a file for each, or a "
            "pattern ('marks/*.pts')"
        )
    there = [target for _, target in pairs if several.skip_existing and os.path.exists(target)]
    pairs = [both for both in pairs if both[1] not in there]
    kept: set[Recipe] = set()
    files = {job: File(shown(job[0]), shown(job[1]), many) for job in pairs}

    def do(pair: Pair, tell: bool | Tell) -> None:
        with about(files[pair]):
            with workers() as who, piped(pair, console) as (source, target):
                job = replace(template, source=source, target=target)
                if edits.relative and not alone:
                    job = replace(job, recipe=edits_of(source, target=target).recipe)
                if elements:
                    job.check()  # before any output, in case the job is refused
                    job = elements.placed(console, job)
                used = {"maps": elements.facts(job.medium.grid)} if elements and options.json else {}

                def written(step: str, done: int, total: int) -> None:
                    if job.medium.kind == "store" and step in ("field", "warp"):
                        parts, name = ("blocks", target) if step == "warp" else ("parts", save_field or "")
                        what = f"{done} of {total} {parts} of {shown(name)} are written"
                        console.goes_on = f"{what}, the same command goes on"

                made = job.warp(tell, written)
            kept.add(_kept(job.recipe, made, reading.world))
            if options.json:
                known = {"input": "-"} if str(pair[0]) == STREAM else {}
                console.tell({**_facts_of(pair, made), **used, **known, "device": who()})
            if made.done:
                what = f"{made.done} of {made.blocks} blocks were there already"
                console.note(f"{shown(pair[1])}: {what}, of a job that was interrupted")
            if made.labels:
                console.note(f"{shown(pair[1])}: the label images {', '.join(made.labels)} are bent with it")
            say_output(console, made, None if grid is None else made.grid, pair[1], pair[0], reading.world)

    lost: set[Pair] = set()

    def failed(pair: Pair, message: str) -> None:
        lost.add(pair)
        if options.json:
            with about(files[pair]):
                error = one_line(message)
                console.tell({"input": str(pair[0]), "output": str(pair[1]), "error": error})

    media = [replace(template, source=source, target=target).medium for source, target in pairs]
    kinds = {medium.kind for medium in media}
    if kinds & {"picture", "volume"}:  # others raise an error of their own
        check_device(device)
    if many:
        from supple._core import threads

        if elements and media:
            try:
                first = media[0].grid
            except SuppleError:
                pass  # it is reported as one of the jobs
            else:
                elements.read(first)  # an unreadable file of maps must fail before all jobs
        make_folders(pairs)
        # Clips and volumes are processed one at a time, as each uses all cores.
        crew = threads() if kinds == {"picture"} else 1
        failures = Crew(max(min(len(pairs), several.jobs or crew), 1)).work(pairs, do, console, failed)
        if len(pairs) > 1 or left or there:
            console.note(summary(pairs, [source for source, _ in lost], len(there), paths[-1], left))
    else:
        failures = 0
        try:
            do(pairs[0], console.terminal)
        except SuppleError as error:
            failed(pairs[0], str(error))
            raise
    if save_recipe is not None:
        write_recipe(save_recipe, _shared(recipe, kept), force=options.force)
    if failures:
        raise SomeFailedError(failures)


def _kept(recipe: "Recipe", made: "Warped", world: bool) -> "Recipe":
    """Return a recipe for saving, with the size that it is for and the space of its points."""
    own = made.own or made.deformation.grid
    size, space = recipe.size or own.sizes, recipe.space or "pixels"
    if world and made.geometry is not None:
        space = made.geometry.convention  # type: ignore[assignment]
    scale, shape = recipe.time_scale, own.shape
    if made.deformation.domain.time and (recipe.size is None or recipe.size == shape[::-1]):
        scale = made.deformation.domain.spacing[2]
    return replace(recipe, size=size if recipe.strokes or recipe.straighten else None, space=space, time_scale=scale)


def _shared(recipe: "Recipe", kept: "Collection[Recipe]") -> "Recipe":
    """Return the recipe to save after several files: with size and space if they hold for all files."""
    for known in (kept, {replace(one, size=recipe.size) for one in kept}):
        if len(known) == 1:
            return next(iter(known))
    return recipe


def _as_clip(paths: tuple[str, ...], recipe: "Recipe") -> tuple[str, ...]:
    """Return paths with ``f.*.exr`` as a clip's pattern, if needed; SuppleError for pictures with strokes in time."""
    from supple.media.numbering import has_number, of_star
    from supple.media.pictures import SUFFIXES
    from supple.media.suffixes import ANIMATED, CLIPS_OUT

    source, target = paths[0], paths[-1]
    timed = recipe.moves or (bool(recipe.strokes) and recipe.strokes[0].ndim == 3)
    if any(os.path.isdir(path) or Path(path).suffix.lower() not in SUFFIXES for path in paths[:-1]):
        return paths
    folder, name = os.path.split(source)
    star = not glob.has_magic(name.replace("*", "", 1)) and "*" in name and not glob.has_magic(folder)
    if len(paths) == 2 and star and not os.path.exists(source):
        many = has_number(target) or "*" in os.path.basename(target) or target.lower().endswith(CLIPS_OUT + ANIMATED)
        if (timed or many) and (pattern := of_star(source)) is not None:
            number = re.sub("d.*", "d", os.path.basename(pattern)[name.index("*") :])
            return pattern, target.replace("*", number)
    if timed and (len(paths) > 2 or is_pattern(source)):
        raise SuppleError(
            f"strokes with a time or with keys are for clips, and {shown(source)} stands for several pictures: give "
            "the pattern of a numbered sequence, such as f.%04d.exr, or a folder"
        )
    return paths


def _check_apart(save_recipe: str | None, paths: Iterable[str | Path | None]) -> None:
    """Raise SuppleError if the saved recipe would replace an input or an output."""
    from supple.media.files import same_file

    if save_recipe is None:
        return
    for path in [Path(each) for each in paths if each]:
        if same_file(save_recipe, path) or Path(save_recipe).resolve() == path.resolve():
            raise SuppleError(f"--save-recipe {save_recipe} is a file that is bent or written: choose another name")


def _facts_of(pair: Pair, made: "Warped") -> dict[str, Any]:
    """Return the facts on a warped file, ready for JSON."""
    grid = made.grid or made.own or made.deformation.grid
    sizes = dict(zip(("width", "height", "depth"), grid.sizes[: 2 if made.kind == "clip" else 3], strict=False))
    if made.kind == "picture":
        facts = picture_facts(pair, made.deformation, made.report()) | sizes
    else:
        facts = {"input": str(made.source), "output": str(made.target), **sizes}
        if made.kind == "store":
            facts |= {name: getattr(made, name) for name in _OF_STORES} | {"spacing": grid.spacing}
            facts |= {} if made.field is None else {"field": asdict(made.field)}
        elif made.geometry is None:
            facts |= {"frames": made.frames, "still": made.still, "copied": made.copied, "held": made.held}
            if made.between:
                facts["between"] = made.between
        else:
            facts |= {"volumes": made.frames, "spacing": list(grid.spacing), "convention": made.geometry.convention}
        facts |= {"tolerance": made.tolerance, "error": made.error}
        facts |= {"moves": len(made.deformations) > 1} if made.kind == "clip" else {}
        facts |= told(*made.deformations, own=made.own)
    return facts | output_facts(made)


def picture_facts(job: Pair, deformation: "Deformation", report: "Report") -> dict[str, Any]:
    """Return the facts on a warped or plotted picture, ready for JSON."""
    height, width = deformation.shape
    return {"input": str(job[0]), "output": str(job[1]), "width": width, "height": height, **asdict(report)}


def plan(
    source: Annotated[str, Parameter(name="IN")],
    /,
    *,
    strokes: StrokeOptions = StrokeOptions(),
    maps: MapOptions = MapOptions(),
    output: OutputOptions = OutputOptions(),
    sampling: SamplingOptions = SamplingOptions(),
    labels: Labels = False,
    volume: VolumeArguments = VolumeArguments(),
    running: WorkerOptions = WorkerOptions(),
    options: RunOptions = RunOptions(),
) -> None:
    """Tell what a warp in blocks would read and write, without reading a sample.

    Parameters
    ----------
    source
        A Zarr array or an OME-Zarr image, a volume, or a picture.
    """
    from supple.engine.progress import counted
    from supple.files.jobs import Job
    from supple.files.stores import PLANNED, plan_file

    console = options.start(source)
    grid = output.to_grid()
    reading = volume.to_reading(strokes=strokes.bends, labels=labels)
    edits = strokes.read(
        maps, reading, console.arguments, source, target=PLANNED, reference=output.onto, empty=grid is not None
    )
    known, outside = sampling.to_sampling(bool(edits.maps) or output.onto is not None)
    job = Job(
        source, PLANNED, edits.recipe, known, outside, volume=reading, fit=strokes.to_fit(), grid=grid,
        running=running.to_running(),
    )  # fmt: skip
    job = edits.maps.placed(console, job)
    with counted(console.terminal, "blocks") as tell:
        found = plan_file(job, tell)
    if options.json:
        console.tell({"file": source, **asdict(found)})
    else:
        print(_described(source, found))


def _described(name: str, found: "Planned") -> str:
    from rich.filesize import decimal

    from supple.cli.describe import listed

    each = " x ".join(map(str, found.block))
    copies = f"{found.copied} of them copies of what no stroke reaches ({decimal(found.copied_bytes)} uncompressed)"
    lines = {
        "output": f"{' x '.join(map(str, found.shape))} {found.dtype}, {decimal(found.size)} with coarser levels, "
        "uncompressed",
        "blocks": f"{found.blocks} of {each}, {copies if found.copied else 'none of them a copy'}",
        "to read": f"{decimal(found.read)} of whole chunks, uncompressed{', beside the copies' * bool(found.copied)}",
        "memory": f"{decimal(found.memory)} for each process, which works on {found.tasks} blocks at a time",
        "error": f"{found.error:.2g} px at most, of the inverse map",
    }
    return listed(name, lines)
