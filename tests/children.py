"""Child processes of tests: where they find the package and these tests."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SOURCE = str(ROOT / "src")


def _hear() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


# For preexec_fn: what a shell starts in the background ignores SIGINT, and so would every child of it.
HEARING = None if sys.platform == "win32" else _hear


def start(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    """Start a command line in a process of its own, which hears interrupts."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "encoding": "utf-8", "preexec_fn": HEARING}
    environment = {**os.environ, "PYTHONPATH": SOURCE, **options.pop("env", {})}
    return subprocess.Popen([sys.executable, "-m", "supple", *arguments], env=environment, **{**pipes, **options})


def watched(*arguments: str) -> tuple[int, str]:
    """Run a command line whose messages go to a terminal; return its status, and what is shown."""
    import pty

    terminal, inside = pty.openpty()
    screen = {"TERM": "xterm", "COLUMNS": "100"}
    process = start(*arguments, env=screen, stdout=subprocess.DEVNULL, stderr=inside, encoding=None)
    os.close(inside)
    shown = b""
    with contextlib.suppress(OSError):  # once all is read
        while got := os.read(terminal, 4096):
            shown += got
    os.close(terminal)
    return process.wait(), shown.decode()


@contextlib.contextmanager
def full_disk(room: int) -> Iterator[None]:
    """Let no file of this process grow beyond so many bytes."""
    import resource

    least, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (least, most))
