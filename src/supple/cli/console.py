"""Messages and exit statuses of the command line: every failure is one line and an exit status."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from supple.errors import LayerWarning, ScaleWarning, Spelling, SuppleError, facing

if TYPE_CHECKING:
    from supple.deformation import Arrival, Deformation
    from supple.space.geometry import Geometry, Grid

DONE, FAULT, REFUSED = 0, 1, 2
INTERRUPTED = 128 + signal.SIGINT
TERMINATED = 128 + signal.SIGTERM
STREAM = "(standard)"  # stands for "-" as a file: standard input or output
PIPE_CLOSED = 141  # 128 + SIGPIPE, which Windows does not name


# Arguments of the library that have an option of the same name.
_NAMES = (
    "annotate azimuth between border border_profile clamp clip codec compression convention crf crop density device "
    "distance elevation error eyes field_of_view fill filter first_frame fit fixed fixed_points flat force frame "
    "frames freeze freeze_width from hold irregular jaw keystone label_colours labels landmarks legend "
    "linear_light lossless map memory mode nose on_fold outside percent_of picture pixel_format plane poisson "
    "preset quality radius reach refer_to reference resample roll rotate save_field scale_to scales scheduler "
    "segmentation series shape shear size slim smile source spacing status step strength table target time "
    "time_filter time_radius time_scale to tolerance track_frame track_turn transfer turntable up workers world "
    "x y"
)
_OPTIONS = {name: f"--{name.replace('_', '-')}" for name in _NAMES.split()}
_OPTIONS |= {"supersampling": "--smooth", "layout": "--shape, --dtype and --spacing", "rate": "--fps"}
_OPTIONS |= {"the freeze mask's width": "--freeze-width", "the matte's width": "--freeze-width", "normal": "--mirror"}


def naming(**others: str) -> Spelling:
    """Return how messages name arguments: as options, ``--on-fold flow`` for ``on_fold='flow'``, or as ``others``."""
    known = _OPTIONS | others

    def option(name: str, value: object) -> str:
        if "[" in name and typed(name):  # the index of a number does not say which of the text it is
            return f"each number of {known[name.partition('[')[0]]}"
        if name not in known or value is Spelling.ANY or value is True:
            return known.get(name, name)
        if value is False:
            return known[name].replace("--", "--no-", 1)
        return f"{known[name]} {'none' if value is None else value}"

    def typed(name: str) -> str:
        option, console = known.get(name.partition("[")[0]), _current.get(None)
        if option is None or console is None:
            return ""
        from supple.space.checks import value_shown

        wanted = option.replace("-", "[-_]")
        given = re.findall(f"(?:^|\0){wanted}[\0=]([^\0]*)", "\0".join(console.arguments))
        return value_shown(given[0]) if len(given) == 1 else ""

    return Spelling(option, "none", typed=typed)


COMMAND = naming()
"""The spelling of arguments in messages of a command."""


class Terminated(BaseException):
    """The process received SIGTERM or SIGHUP."""


class SomeFailedError(Exception):
    """Some of several files failed; each failure has been reported."""

    def __init__(self, status: int) -> None:
        super().__init__()
        self.status = status


def one_line(text: object) -> str:
    """Return a message as one line of printable characters."""
    joined = " ".join(str(text).splitlines())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in joined)


@dataclass(slots=True, eq=False)
class File:
    """A file being processed, and the warnings about it so far, which begin with its name if ``named`` is true."""

    source: str = ""
    target: str = ""
    named: bool = False
    warnings: list[str] = field(default_factory=list)


def _finite(value: Any) -> Any:
    """Return a value for JSON, with None (null) in place of numbers that are not finite."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


_file: ContextVar[File | None] = ContextVar("file", default=None)


@contextlib.contextmanager
def about(file: File) -> Iterator[None]:
    """Collect the warnings of this context in a `File`; worker threads run in a copy of the context."""
    token = _file.set(file)
    try:
        yield
    finally:
        _file.reset(token)


class Console:
    """The output of messages: line by line to standard error, also beside a progress bar."""

    def __init__(self) -> None:
        self.quiet = self.strict = False
        self.arguments: tuple[str, ...] = ()  # of the command line, in order
        self.all = File()  # warnings without a file, or about a single one
        self.goes_on = ""  # the message on what an interruption leaves, and how to resume
        self.names: dict[str, str] = {}  # user-visible names of temporary files
        self._said: set[str] = set()
        self._lock = threading.Lock()

    @property
    def file(self) -> File:
        """The file being processed in this context."""
        return _file.get() or self.all

    @property
    def terminal(self) -> bool:
        """Return whether to show progress: standard error is a terminal, and messages are wanted."""
        return not self.quiet and sys.stderr is not None and sys.stderr.isatty()

    def say(self, text: object) -> None:
        """Write a line to standard error."""
        line = f"supple: {one_line(text)}"
        for path, name in self.names.items():
            line = line.replace(path, name)
        with self._lock, contextlib.suppress(OSError, ValueError):
            if sys.stderr is not None:
                print(line, file=sys.stderr, flush=True)

    def note(self, text: object) -> None:
        """Write a line to standard error, once, unless --quiet is given."""
        line = one_line(text)
        if self._is_new(line) and not self.quiet:
            self.say(line)

    def _is_new(self, line: str) -> bool:
        with self._lock:
            new = line not in self._said
            self._said.add(line)
        return new

    def tell(self, facts: Mapping[str, object]) -> None:
        """Write one JSON object as a line to standard output, with the warnings about the file."""
        warned = list(dict.fromkeys(self.all.warnings + self.file.warnings))
        line = json.dumps(_finite({**facts, "warnings": warned}))
        with self._lock:  # one line at a time, from any thread
            sys.stdout.write(line + "\n")
            sys.stdout.flush()

    def warn(self, text: object, *, meant: bool = False) -> None:
        """Write a warning once, unless --quiet is given; with --strict, raise SuppleError instead.

        With ``meant``, it is only a note on what the user asked for, and not an error with --strict. As after every
        error, unfinished output files are removed.
        """
        file, line = self.file, one_line(text)
        names = tuple(one_line(name) for name in (file.source, file.target) if name)
        if names and not meant and (file.named or self.strict) and not line.startswith(names):
            line = f"{names[0]}: {line}"
        file.warnings.append(line)  # listed once for each file
        if self.strict and not meant:
            raise SuppleError(f"{line} (--strict: warnings are errors)")
        if self._is_new(line) and not self.quiet:
            self.say(line if meant else f"warning: {line}")


_current: ContextVar[Console] = ContextVar("console")


def current() -> Console:
    """Return the console of the running command."""
    return _current.get()


def warn_of_software(console: Console, device: str) -> None:
    """Warn if the requested GPU is emulated in software; SuppleError if there is none at all."""
    if device != "gpu":
        return
    from supple.gpu.device import open_gpu

    gpu = open_gpu()
    if gpu.software:
        console.warn(f"{gpu.name} is a program that runs on the CPU: no GPU was found")


def say_convention(console: Console, world: bool, geometry: Geometry | None, name: object) -> None:
    """Print the convention of points that are positions in space."""
    if world and geometry and not console.quiet:
        console.say(f"points are {geometry.convention} millimetres, as {name} has them")


def told(*deformations: Deformation, own: Grid | None = None) -> dict[str, Any]:
    """Return the facts on the strokes' results, ready for JSON; for moving strokes, the worst of all frames.

    ``own`` is the grid of the input, if it is not that of the deformations.
    """
    from supple.files.jobs import arrivals_on

    bent = [each for each in dict.fromkeys(deformations) if each.strokes]  # frames that are passed on have no strokes
    each = [deformation.resolution() for deformation in bent or deformations[:1]]
    arrivals = zip(*(arrivals_on(own, deformations[0].grid, made["arrivals"]) for made in each), strict=True)

    def off(arrival: Arrival) -> tuple[float, float]:
        points = arrival, *arrival.also
        return max(point.miss for point in points), max(point.moved for point in points)

    return {
        "strokes": each[0]["strokes"],
        "applied": max(made["applied"] for made in each),
        "damping": tuple(map(min, zip(*(made["damping"] for made in each), strict=True))),
        "arrivals": [asdict(max(some, key=off)) for some in arrivals],
        "margin": min(made["margin"] for made in each),
    }


def run(command: Callable[[Console], object]) -> int:
    """Run a command; convert its result, an error or an interrupt to an exit status and at most one line."""
    console = Console()
    token = _current.set(console)
    try:
        with _signals(), _warnings(console), facing(COMMAND):
            command(console)
            if sys.stdout is not None:
                sys.stdout.flush()
        return DONE
    except SomeFailedError as failed:
        return failed.status
    except (KeyboardInterrupt, Terminated) as stopped:
        what, status = ("terminated", TERMINATED) if isinstance(stopped, Terminated) else ("interrupted", INTERRUPTED)
        console.say(f"{what}: {console.goes_on}" if console.goes_on else what)
        return status
    except BrokenPipeError:
        _close_output()
        return PIPE_CLOSED
    except Exception as error:
        if isinstance(error, OSError):
            _close_output()
        message, status = outcome(error)
        if status == FAULT and os.environ.get("SUPPLE_DEBUG") == "1":
            raise
        console.say(message)
        return status
    finally:
        _current.reset(token)


def outcome(error: Exception) -> tuple[str, int]:
    """Return the message for an error, and the exit status."""
    if isinstance(error, SuppleError):
        return str(error), REFUSED
    if isinstance(error, MemoryError):
        return "this takes more memory than there is: cut the picture into parts", REFUSED
    if isinstance(error, OSError):
        return f"the system refuses: {error.strerror or error}", REFUSED
    told = f"{type(error).__name__}: {error}".rstrip(": ")
    return f"a fault of Supple's own ({told}): please report it, with what SUPPLE_DEBUG=1 shows", FAULT


def _close_output() -> None:
    """Redirect standard output to the null device, so that the interpreter's flush at exit cannot fail again."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def _signals() -> Iterator[None]:
    """Raise `Terminated` on SIGTERM and SIGHUP, so that the command cleans up as after an interrupt."""
    before: dict[int, Any] = {}
    for name in ("SIGTERM", "SIGHUP") if threading.current_thread() is threading.main_thread() else ():
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:  # not if nohup, say, has set one
            before[number] = signal.signal(number, _terminate)
    hook = sys.unraisablehook
    timers: list[threading.Timer] = []

    def again(ignored: sys.UnraisableHookArgs) -> None:
        # Exceptions in callbacks from C, as of a library that writes, are not propagated: so send the signal again,
        # after this function has returned.
        sent = {KeyboardInterrupt: signal.SIGINT, Terminated: signal.SIGTERM}.get(ignored.exc_type)
        if sent is None:
            hook(ignored)
        else:
            timers.append(threading.Timer(0.05, _send, (sent,)))
            timers[-1].start()

    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for timer in timers:
            timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)


def _send(number: signal.Signals) -> None:
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:  # also wakes up a waiting main thread
        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


@contextlib.contextmanager
def deaf() -> Iterator[None]:
    """Ignore interrupts and termination while something must be finished."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _warnings(console: Console) -> Iterator[None]:
    """Print each of Supple's warnings as a line; other packages' warnings are ignored unless SUPPLE_DEBUG=1."""

    def show(message: Warning | str, category: type[Warning], *rest: object, **named: object) -> None:
        if category.__module__.startswith("supple."):
            console.warn(message, meant=issubclass(category, ScaleWarning | LayerWarning))

    with warnings.catch_warnings():
        if os.environ.get("SUPPLE_DEBUG") != "1":
            warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
