"""The entry point of the command line: its commands, and the end of the process."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, NoReturn

from cyclopts import (
    App,
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from supple.cli.console import STREAM, current, run
from supple.errors import SuppleError

_GRAB = "--grab X,Y[,T|Z]:X,Y[,T|Z] --radius R [OPTIONS]"
_EXAMPLES = """
supple warp photo.jpg out.jpg --grab 256,256:256,346 --radius 100
supple warp photo.jpg out.png --grab 90,80:60,70 --grab 300,80:330,70 --radius 40
supple warp photo.jpg out.png --scale 90,80:1.3 --scale 300,80:1.3 --twist 195,160:20 --radius 40
supple warp photos/ bent/ --recipe strokes.json
supple warp clip.mp4 late.mp4 --grab 350,120,38:350,120,52 --radius 60
supple warp frames/%05d.png bent/%05d.png --recipe strokes.json
supple warp clip.mp4 nose.mp4 --scale 345,58:1.6 --radius 24 --track nose.csv --track-frame 10
supple warp head.nii.gz bent.nii.gz --grab 45,88,62:45,76,58 --radius 40
supple warp cells.zarr bent.zarr --recipe strokes.json --workers 8
supple warp moving.nii.gz seen.nii.gz --affine 0GenericAffine.mat --field 1Warp.nii.gz --reference fixed.nii.gz
supple face photo.jpg out.jpg --slim 20 --eyes 15 --smile 10 --nose -10
supple face portraits/ done/ --slim 15 --landmarks landmarks/
supple plan cells.zarr --recipe strokes.json
supple plan s3://bucket/brain.zarr --grab 900,800,400:930,800,400 --radius 0.5 --workers 8
supple render head.nii.gz face.png --azimuth 30
supple render head.nii.gz bent.png --grab 45,88,62:45,76,58 --radius 40 --azimuth 38
supple render ct/ skull.png --transfer ct-bone
supple render head.nii.gz turn.mp4 --turntable 120
supple points marks.fcsv moved.fcsv --on head.nii.gz --grab 45,88,62:45,76,58 --radius 40
supple points clicked.csv origin.csv --on photo.jpg --recipe strokes.json --inverse
supple track clip.mp4 nose.csv --at 345,58,10
supple view photo.jpg
supple view clip.mp4 --recipe strokes.json
supple view head.nii.gz --serve
supple view ct.raw --shape 512,512,200 --dtype int16 --spacing 0.7,0.7,1.5
supple invert warp.nii.gz inverse.nii.gz --status status.nii.gz
supple invert composite.h5 inverse.nii.gz --to itk --reference moving.nii.gz
supple check warp.nii.gz --picture warp.png
supple check warp.nii.gz inverse.nii.gz --map logjac.nii.gz
supple compose warp.nii.gz affine.mat --out both.nii.gz --to itk
supple compose a.nii.gz --inverse b.nii.gz --convention fsl-relative --source moving.nii.gz --out c.mha
supple convert warp.nii.gz warp.mha
supple convert warp.nii.gz fsl.nii.gz --from itk --to fsl-relative --source moving.nii.gz
"""
# The module of each command, and its usage. Only the module of the given command is imported.
_COMMANDS = (
    ("cli.warp:warp", f"warp IN... OUT {_GRAB}"),
    ("cli.face:face", "face IN... OUT [--slim P] [--eyes P] [--smile P] [--nose P] [OPTIONS]"),
    ("cli.plot:plot", f"plot IN OUT.png {_GRAB}"),
    ("cli.volume:render", f"render VOLUME OUT [{_GRAB}]"),
    ("cli.volume:points", f"points IN OUT --on FILE {_GRAB}"),
    ("cli.track:track", "track CLIP OUT.csv --at X,Y,K [--at X,Y,K]... [OPTIONS]"),
    ("cli.warp:plan", f"plan IN {_GRAB}"),
    ("cli.info:info", "info FILE... [--gpu] [--json]"),
    ("cli.view:view", "view FILE [--serve] [OPTIONS]"),
    ("cli.fields:invert", "invert FIELD OUT [OPTIONS]"),
    ("cli.fields:check", "check FIELD [INVERSE] [OPTIONS]"),
    ("cli.fields:compose", "compose MAP [--inverse] MAP [--inverse]... --out FILE [OPTIONS]"),
    ("cli.fields:convert", "convert IN OUT [--from NAME] [--to NAME] [OPTIONS]"),
    ("cli.plot:demo", "demo [DIR] [OPTIONS]"),
)
_OF_FILES = ("--recipe", "--save-recipe", "--save-field", "--on", "--field", "--affine", "--reference")
_PYTHON = "Restoring and smoothing are for Python (Deformation.restore) and for the window (supple view)"
# Advice for unknown options that have another way.
_ELSEWHERE = {
    "--gpu": "--device gpu is for render and demo, and info --gpu tells what there is",
    "--restore": _PYTHON,
    "--smooth": _PYTHON,
}


def command(arguments: Sequence[str]) -> int:
    """Carry out a command line; return the exit status."""
    return run(lambda console: _dispatch(arguments))


def main() -> NoReturn:
    """Run the command line of the process, and exit."""
    status = command(sys.argv[1:])
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    # All files are complete here. The interpreter's cleanup takes 0.3 s, and after an interrupt it would wait for
    # threads whose work is no longer needed.
    os._exit(status)


def _dispatch(arguments: Sequence[str]) -> None:
    app = App(
        name="supple",
        help="Bend pictures, videos and volumes with elastic brushes, exactly inverted and sampled once.",
        help_epilogue=_examples("warp photo.jpg out.jpg"),
        help_format="plaintext",
        help_formatter=_formatter() if not arguments or {"--help", "-h"} & {*arguments} else None,
        version=_version,
        default_parameter=Parameter(negative=(), show_default=_unless_empty),
        suppress_keyboard_interrupt=False,
        result_action="return_value",
    )
    for where, usage in _COMMANDS:
        examples = _examples(where.partition(":")[2])
        app.command(f"supple.{where}", usage=f"Usage: supple {usage}", help_epilogue=examples)
    if not arguments or arguments[0] in app.help_flags:
        app.resolved_commands()  # otherwise the help would lack the commands' first lines
    # Otherwise a single dash would be parsed as an option.
    for option, value in itertools.pairwise(arguments):
        if value == "-" and option in _OF_FILES:
            raise SuppleError(f"{option} - is not possible: - is for the files IN and OUT; name a file")
        named = value in ("nearest", "smooth") or os.path.exists(value)
        if option == "--labels" and value.isalpha() and not named:  # otherwise it would be read as a folder
            raise SuppleError(f"--labels must be nearest or smooth, or stand alone, found {value!r}")
    arguments = [STREAM if argument == "-" else argument for argument in arguments]
    if STREAM in arguments and arguments[0] not in ("warp", "info", "points"):
        raise SuppleError("- for standard input or output is for warp, info and points: give the name of a file")
    words = zip(arguments, [*arguments[1:], ""], strict=False)  # --labels alone takes no word, whatever follows
    arguments = ["--labels=nearest" if a == "--labels" and b not in ("nearest", "smooth") else a for a, b in words]
    current().arguments = tuple(arguments)
    try:
        app(list(arguments), exit_on_error=False, print_error=False, verbose=False)
    except CycloptsError as error:
        if isinstance(error.__cause__, SuppleError):  # of a value: its message is complete
            raise error.__cause__ from None
        raise SuppleError(f"{_advised(error, app)} (supple --help tells more)") from None


def _advised(error: CycloptsError, app: App) -> str:
    """Return the text of an error about options, with better advice than cyclopts' suggestions of similar names."""
    text = str(error).strip().rstrip(".")
    wrong, _, meant = text.partition(" Did you mean")
    if isinstance(error, UnknownOptionError):
        given = error.token.keyword or error.token.value
        option = given.partition("=")[0]
        verbs = [usage.partition(" ")[0] for _, usage in _COMMANDS]
        having = [
            verb for verb in verbs if any(option in each.names for each in app[verb].assemble_argument_collection())
        ]
        instead = [f"It is an option of {', '.join(having)}"] if having else []
        instead += [_ELSEWHERE[option]] if option in _ELSEWHERE else []
        return ". ".join([wrong.rstrip(".").replace(given, option), *instead]) if instead else text
    if isinstance(error, MissingArgumentError) and error.argument and error.command_chain:
        if not error.argument.name.startswith("--"):
            usage = next(usage for _, usage in _COMMANDS if usage.startswith(error.command_chain[0]))
            return f"give the files: supple {usage}"
        return f"give {error.keyword or error.argument.name}, and a value after it"
    if isinstance(error, UnusedCliTokensError):
        return f"more names than this command takes: leave out {', '.join(map(repr, error.unused_tokens or ()))}"
    if isinstance(error, UnknownCommandError):
        name = (error.unused_tokens or [""])[0]
        kind = "option" if name.startswith("-") else "command"
        meant = f" Did you mean{meant.partition('?')[0]}?" if meant else ""
        known = ", ".join(usage.partition(" ")[0] for _, usage in _COMMANDS)
        return f'Unknown {kind} "{name}".{meant} The commands are {known}'
    return wrong if isinstance(error, CoercionError) else text


def _examples(begin: str) -> str:
    """Return the examples that begin so, in lines that fit the terminal; a backslash goes on with one."""
    width = shutil.get_terminal_size().columns - 8
    some = [line for line in _EXAMPLES.splitlines() if line.startswith(f"supple {begin} ")]
    parts = (textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False) for line in some)
    return "\n".join(["Examples:\n", *("  " + " \\\n      ".join(each) for each in parts)]) if some else ""


def _formatter() -> Any:
    """Return cyclopts' formatter of help, with paragraphs wrapped to the terminal instead of as in the source."""
    from cyclopts.help import DefaultFormatter

    def join(text: Any) -> None:
        held = getattr(text, "primary_renderable", None)
        if held is not None:
            held.plain = re.sub(r"(?<!\n)\n(?!\n)", " ", held.plain)

    class Formatter(DefaultFormatter):
        def __call__(self, console: Any, options: Any, panel: Any) -> None:
            for entry in panel.entries:
                join(entry.description)
            super().__call__(console, options, panel)

        def render_description(self, console: Any, options: Any, description: Any) -> None:
            join(description)
            super().render_description(console, options, description)

    return Formatter()


def _unless_empty(value: object) -> object:
    return None if value is False or value == () else value


def _version() -> str:
    from supple import __version__

    return f"supple {__version__}"
