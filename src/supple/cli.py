"""The command line."""

from __future__ import annotations

import contextlib
import glob
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

from cyclopts import App, CycloptsError, Group, Parameter

from supple.cli_view import VIEW_EXAMPLES, ViewCommands
from supple.cli_volume import POINTS_EXAMPLES, RENDER_EXAMPLES, VolumeCommands, say_convention, told_of_software
from supple.console import Console, SomeFailedError, run
from supple.errors import SuppleError
from supple.options import RUNNING, RunOptions, StrokeOptions, VideoOptions, parse_fill, parse_integer, parse_number
from supple.options_volume import VOLUME, VolumeOptions
from supple.workers import workers

if TYPE_CHECKING:
    from supple.batch import Job
    from supple.clips import WarpedClip
    from supple.deformation import Deformation, Report
    from supple.files import Warped
    from supple.volumes import WarpedVolume

What = Literal["grid", "stretch", "axes", "residual", "iterations", "slice", "sheet"]
Filter = Literal["auto", "antialias", "ewa", "cubic", "linear", "nearest"]
Outside = Literal["edge", "constant", "reflect"]
Device = Literal["auto", "cpu", "gpu"]
Warper = Literal["auto", "cpu", "gpu", "cuda"]
Tell = Callable[[str], None]

SAMPLING = Group("Sampling", sort_key=2)
WRITING = Group("Writing", sort_key=3)

_GRAB = "--grab X,Y[,T|Z]:X,Y[,T|Z] --radius R [OPTIONS]"
_EXAMPLES = """\
Example: grab what is at (256, 256), in pixels from the top left, and drag it to (256, 346)

  supple warp photo.jpg out.jpg --grab 256,256:256,346 --radius 100
"""
_WARP_EXAMPLES = """\
Examples:

  supple warp photo.jpg out.jpg --grab 256,256:256,346 --radius 100
  supple warp photo.jpg out.png --grab 90,80:60,70 --grab 300,80:330,70 --radius 40
  supple warp photos/ bent/ --recipe strokes.json
  supple warp clip.mp4 late.mp4 --grab 350,120,38:350,120,52 --radius 60
  supple warp frames/%05d.png bent/%05d.png --recipe strokes.json
  supple warp head.nii.gz bent.nii.gz --grab 90,150,100:90,170,100 --radius 30
"""


_RUN = RunOptions()
_STROKES = StrokeOptions()
_VIDEO = VideoOptions()
_VOLUME = VolumeOptions()


@dataclass(frozen=True, slots=True)
class _Commands:
    """What the commands share: a console."""

    console: Console = field(default_factory=Console)

    def warp(
        self,
        *paths: Annotated[str, Parameter(name="IN... OUT", required=True)],
        strokes: StrokeOptions = _STROKES,
        filter: Annotated[Filter, Parameter(group=SAMPLING)] = "auto",
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
            Colours between pixels: auto averages where the picture shrinks, and is cubic elsewhere.
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
        from supple.batch import Crew, check_recipe_file, make_folders, pair
        from supple.clips import is_clip
        from supple.engines import check_device
        from supple.files import warp_file, write_recipe
        from supple.volumes import holds_volumes, is_volume_job

        if len(paths) < 2:
            raise SuppleError("give a file to read and a name to write to: supple warp IN OUT --grab …")
        self.console.started(quiet=options.quiet, threads=options.threads)
        recipe = strokes.to_recipe()
        say_software = told_of_software(self.console, device)
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
                self.console.tell({**_facts_of(job, made), "device": str(who)})
            say_convention(self.console, reading.world, getattr(made, "geometry", None), job[0], options)

        def failed(job: Job, message: str) -> None:
            if options.json:
                self.console.tell({"input": str(job[0]), "output": str(job[1]), "error": message})

        if not all(is_clip(*job, recipe) for job in jobs):  # of clips, it says that it does not do them
            check_device(device)
        self.console.tell_of_compiling()
        if many:
            from supple.cpu.kernel import threads

            make_folders(jobs)
            # Of clips and volumes one at a time: each has work for all cores.
            large = any(is_clip(*job, recipe) or is_volume_job(*job, recipe, reading) for job in jobs)
            crew = 1 if large else min(len(jobs), threads())
            failures = Crew(crew).work(jobs, do, self.console, failed)
        else:
            failures = 0
            self._alone(jobs[0], do, failed)
        say_software()
        if save_recipe is not None:
            write_recipe(save_recipe, recipe, force=options.force)
        if failures:
            raise SomeFailedError(failures)

    def plot(
        self,
        source: Annotated[str, Parameter(name="IN")],
        target: Annotated[str, Parameter(name="OUT")],
        /,
        *,
        what: Annotated[What, Parameter(group=WRITING)] = "grid",
        frame: Annotated[str | None, Parameter(group=WRITING, metavar="K", allow_leading_hyphen=True)] = None,
        x: Annotated[str | None, Parameter(group=WRITING, metavar="X", allow_leading_hyphen=True)] = None,
        y: Annotated[str | None, Parameter(group=WRITING, metavar="Y", allow_leading_hyphen=True)] = None,
        strokes: StrokeOptions = _STROKES,
        video: VideoOptions = _VIDEO,
        options: RunOptions = _RUN,
    ) -> None:
        """Draw what strokes do to a picture or a video.

        Parameters
        ----------
        source
            The picture or video.
        target
            A PNG, SVG or PDF file.
        what
            Bent lines, growth and shrinking, its direction, the inverse's error, or the work for it. Of a video also a
            cut along time (slice), or frames before and after (sheet).
        frame
            Which frame of a video, counted from 0.
        x
            Which column a slice shows over time.
        y
            Which row a slice shows over time.
        """
        self.console.started(quiet=options.quiet, threads=options.threads)
        recipe = strokes.to_recipe()
        from supple.plots import plot_file

        self.console.tell_of_compiling()
        deformation = plot_file(
            source,
            target,
            recipe,
            what,
            frame=None if frame is None else parse_integer("--frame", frame, "a whole number, counted from 0"),
            x=None if x is None else parse_integer("--x", x, "a whole number of pixels"),
            y=None if y is None else parse_integer("--y", y, "a whole number of pixels"),
            clip=video.to_clip(),
            force=options.force,
            progress=self.console.terminal,
        )
        if options.json:
            job = (Path(source), Path(target))
            facts = (
                _facts(job, deformation, deformation.report()) if deformation.ndim == 2 else deformation.resolution()
            )
            self.console.tell({**facts, "input": source, "output": target, "what": what})

    def info(
        self,
        *files: Annotated[str, Parameter(name="FILE")],
        gpu: Annotated[bool, Parameter(negative=())] = False,
        json: Annotated[bool, Parameter(negative=())] = False,
        volume: VolumeOptions = _VOLUME,
    ) -> None:
        """Tell what pictures, videos, volumes and recipes hold, or which GPUs there are.

        Parameters
        ----------
        files
            Pictures, videos, patterns or folders of frames, volumes, or recipes in JSON.
        gpu
            Which graphics cards there are, and programs that stand in for them; the first one is used.
        json
            As one JSON object for each file.
        """
        from supple.console import REFUSED
        from supple.describe import describe

        if not gpu and not files:
            raise SuppleError("give a file to tell about: supple info FILE, or supple info --gpu")
        if gpu:
            from supple.gpu.device import describe as describe_gpus

            for found in describe_gpus():
                if json:
                    self.console.tell(found)
                else:
                    print(f"{found['name']}: {found['kind']}, {found['backend']}, {found['driver']}")
        failures, reading = 0, volume.to_reading()
        for name in files:
            try:
                facts, text = describe(name, layout=reading.layout, series=reading.series)
            except SuppleError as error:
                failures = REFUSED
                self.console.say(error)
                facts, text = {"file": name, "error": str(error)}, ""
            if json:
                self.console.tell(facts)
            elif text:
                print(text)
        if failures:
            raise SomeFailedError(failures)

    def demo(
        self,
        folder: Annotated[str, Parameter(name="DIR")] = "supple-demo",
        /,
        *,
        device: Annotated[Device, Parameter(group=RUNNING)] = "cpu",
        options: RunOptions = _RUN,
    ) -> None:
        """Write a small gallery, with an index.html to look at.

        Parameters
        ----------
        folder
            Where to.
        device
            Who makes it: the CPU, the GPU, or auto: a graphics card, where there is one.
        """
        from supple.gallery import write_gallery

        self.console.started(quiet=options.quiet, threads=options.threads)
        say_software = told_of_software(self.console, device)
        self.console.tell_of_compiling()
        progress = self.console.say if self.console.terminal else None
        page = write_gallery(folder, force=options.force, device=device, progress=progress)
        say_software()
        if options.json:
            self.console.tell({"output": str(page)})
        elif not options.quiet:
            print(f"open {page}")

    def _alone(self, job: Job, do: Callable[[Job, bool], None], failed: Callable[[Job, str], None]) -> None:
        try:
            do(job, self.console.terminal)
        except SuppleError as error:
            failed(job, str(error))
            raise


def command(arguments: Sequence[str]) -> int:
    """Carry out a command line; return the exit status."""
    return run(lambda console: _dispatch(console, arguments))


def main() -> NoReturn:
    """Carry out the process's own command line, and end."""
    # Where SciPy is installed, Numba would import its linear algebra, for kernels that we do not have: 0.2 s.
    sys.modules.setdefault("scipy.linalg", None)  # type: ignore[arg-type]
    status = command(sys.argv[1:])
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    # All files are whole by now. Tidying up the interpreter takes 0.3 s, and after an interrupt it would wait for
    # threads whose work nobody wants.
    os._exit(status)


def _dispatch(console: Console, arguments: Sequence[str]) -> None:
    app = App(
        name="supple",
        help="Bend pictures, videos and volumes with elastic brushes, exactly inverted and sampled once.",
        help_epilogue=_EXAMPLES,
        help_format="plaintext",
        version=_version,
        default_parameter=Parameter(negative=(), show_default=_unless_false),
        suppress_keyboard_interrupt=False,
        result_action="return_value",
    )
    commands = _Commands(console)
    app.command(commands.warp, usage=f"Usage: supple warp IN... OUT {_GRAB}", help_epilogue=_WARP_EXAMPLES)
    app.command(commands.plot, usage=f"Usage: supple plot IN OUT.png {_GRAB}", help_epilogue="")
    volumes = VolumeCommands(console)
    app.command(volumes.render, usage=f"Usage: supple render VOLUME OUT [{_GRAB}]", help_epilogue=RENDER_EXAMPLES)
    app.command(volumes.points, usage=f"Usage: supple points IN OUT --on FILE {_GRAB}", help_epilogue=POINTS_EXAMPLES)
    app.command(commands.info, usage="Usage: supple info FILE... [--gpu] [--json]", help_epilogue="")
    views = ViewCommands(console)
    app.command(views.view, usage="Usage: supple view FILE [--serve] [OPTIONS]", help_epilogue=VIEW_EXAMPLES)
    app.command(commands.demo, usage="Usage: supple demo [DIR] [OPTIONS]", help_epilogue="")
    try:
        app(list(arguments), exit_on_error=False, print_error=False, verbose=False)
    except CycloptsError as error:
        raise SuppleError(f"{_advised(str(error).strip().rstrip('.'))} (supple --help tells more)") from None


def _advised(text: str) -> str:
    """What is wrong with the options; where one that only looks alike would be advised, the one that is meant."""
    wrong, _, _ = text.partition(" Did you mean")
    if "option: --gpu" in wrong:
        return f"{wrong} --device gpu is for warp, render and demo, and info --gpu tells what there is"
    if '"cuda" for --device' in wrong:
        return "--device cuda is for warp, of pictures and volumes: here it is cpu, gpu or auto"
    if "option: --device" in wrong:
        return f"{wrong} It is for warp, render and demo"
    return text


def _unless_false(value: object) -> object:
    return None if value is False else value


def _version() -> str:
    from supple import __version__

    return f"supple {__version__}"


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
    return _facts(job, made.deformation, made.report())


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
        "held": made.held,
        "tolerance": made.tolerance,
        "error": made.error,
        **deformation.resolution(),
    }


def _facts(job: Job, deformation: Deformation, report: Report) -> dict[str, Any]:
    from dataclasses import asdict

    height, width = deformation.shape
    return {"input": str(job[0]), "output": str(job[1]), "width": width, "height": height, **asdict(report)}


if __name__ == "__main__":
    main()
