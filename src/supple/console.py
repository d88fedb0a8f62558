"""What the command line says, and how it ends: one line for all that goes wrong, and an exit status."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.geometry import Geometry

DONE, FAULT, REFUSED = 0, 1, 2
INTERRUPTED = 128 + signal.SIGINT
TERMINATED = 128 + signal.SIGTERM
PIPE_CLOSED = 141  # 128 + SIGPIPE, which Windows does not name


# An argument of the library that a message begins with, and says what it must be.
_ARGUMENT = re.compile(
    r"^(between|clamp|codec|crf|density|device|distance|elevation|field_of_view|fill|filter|frame|labels"
    r"|linear_light|memory|outside|pixel_format|preset|quality|rate|roll|save_field|series|shape|size"
    r"|step|target|time_scale|tolerance|transfer|turntable|up|world)"
    r"(?= is for | must be | needs )"
)


class Terminated(BaseException):
    """Somebody asked the process to end."""


class SomeFailedError(Exception):
    """Of several files, some were not done; each has been reported."""

    def __init__(self, status: int) -> None:
        super().__init__()
        self.status = status


def one_line(text: object) -> str:
    """Make any message a line that a terminal shows as it is."""
    joined = " ".join(str(text).splitlines())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in joined)


def as_options(text: str) -> str:
    """Name options as the command line does, where a message of the library names arguments."""
    text = _ARGUMENT.sub(lambda found: "--" + found[1].replace("_", "-"), text)
    text = re.sub(r'^filter="(\w+)"', r"--filter \1", text)
    text = re.sub("^supersampling(?= must be )", "--smooth", text)
    text = re.sub(r' \((?:force|series)=(?:True|"1")\)', "", text)  # beside the option that does the same
    return re.sub(r"\bon_fold='(\w+)'", r"--on-fold \1", text).replace("border=None", "--border none")


class Console:
    """Where messages go. Line by line to standard error, above a progress bar if there is one."""

    def __init__(self) -> None:
        self.quiet = False
        self.bar: Any = None
        self._said: set[str] = set()
        self._lock = threading.Lock()

    @property
    def terminal(self) -> bool:
        """Whether a person watches."""
        return not self.quiet and sys.stderr is not None and sys.stderr.isatty()

    def say(self, text: object) -> None:
        """Write a line to standard error."""
        line = f"supple: {as_options(one_line(text))}"
        with self._lock, contextlib.suppress(OSError, ValueError):
            if self.bar is not None:
                self.bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
            elif sys.stderr is not None:
                print(line, file=sys.stderr, flush=True)

    def tell(self, facts: Mapping[str, object]) -> None:
        """Write one JSON object, a line, to standard output."""
        with self._lock:  # one line at a time, though many threads have something to tell
            sys.stdout.write(json.dumps(facts) + "\n")
            sys.stdout.flush()

    def warn(self, text: object) -> None:
        """Write a warning, unless it has been written before or nobody wants to hear."""
        line = one_line(text)
        if not self.quiet and line not in self._said:
            self._said.add(line)
            self.say(f"warning: {line}")

    def started(self, *, quiet: bool, threads: int | None) -> None:
        """Take the options that every command has."""
        self.quiet = quiet
        if threads is not None:
            if threads < 1:
                raise SuppleError(f"--threads must be a number of threads from 1, found {threads}")
            os.environ["SUPPLE_THREADS"] = os.environ["VIPS_CONCURRENCY"] = str(threads)


_current: ContextVar[Console] = ContextVar("console")


def current() -> Console:
    """Return the console of the command that runs."""
    return _current.get()


def told_of_software(console: Console, device: str) -> Callable[[], None]:
    """Return what says, when the work is done, that the GPU that was asked for is none.

    Raises
    ------
    SuppleError
        If there is not even such a one.
    """
    if device != "gpu":
        return lambda: None
    from supple.gpu.device import open_gpu

    gpu = open_gpu()
    text = f"{gpu.name} is a program that runs on the CPU: no graphics card was found"
    return lambda: console.warn(text) if gpu.software else None


def say_convention(console: Console, world: bool, geometry: Geometry | None, name: object) -> None:
    """Say in which coordinates points were taken, if they are places in space."""
    if world and geometry and not console.quiet:
        console.say(f"points are {geometry.convention} millimetres, as {name} has them")


def run(command: Callable[[Console], object]) -> int:
    """Run a command; turn however it ends into an exit status and at most one line."""
    console = Console()
    token = _current.set(console)
    try:
        with _signals(), _warnings(console):
            command(console)
            if sys.stdout is not None:
                sys.stdout.flush()
        return DONE
    except SomeFailedError as failed:
        return failed.status
    except SuppleError as error:
        console.say(error)
        return REFUSED
    except KeyboardInterrupt:
        console.say("interrupted")
        return INTERRUPTED
    except Terminated:
        console.say("terminated")
        return TERMINATED
    except BrokenPipeError:
        _close_output()
        return PIPE_CLOSED
    except MemoryError:
        console.say("this takes more memory than there is: cut the picture into parts")
        return REFUSED
    except OSError as error:
        _close_output()
        console.say(f"the system refuses: {error.strerror or error}")
        return REFUSED
    except Exception as error:
        if os.environ.get("SUPPLE_DEBUG") == "1":
            raise
        console.say(fault(error))
        return FAULT
    finally:
        _current.reset(token)


def fault(error: BaseException) -> str:
    """Say that we are to blame."""
    told = f"{type(error).__name__}: {error}".rstrip(": ")
    return f"a fault of Supple's own ({told}): please report it, with what SUPPLE_DEBUG=1 shows"


def _close_output() -> None:
    """Keep the interpreter from trying once more at its end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def _signals() -> Iterator[None]:
    """End as after an interrupt, with everything cleaned up, when asked to terminate."""
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        names = []
    before: dict[int, Any] = {}
    for number in (getattr(signal, name) for name in names):
        if signal.getsignal(number) == signal.SIG_DFL:  # others, nohup say, know what they do
            before[number] = signal.signal(number, _terminate)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


@contextlib.contextmanager
def deaf() -> Iterator[None]:
    """Let nothing interrupt what must be finished."""
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
    """Make each of our warnings a line; those of others are for developers."""

    def show(message: Warning | str, category: type[Warning], *rest: object, **named: object) -> None:
        if category.__module__.startswith("supple."):
            console.warn(message)

    with warnings.catch_warnings():
        if os.environ.get("SUPPLE_DEBUG") != "1":
            warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
