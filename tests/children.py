"""Child processes of tests: where they find the package and these tests."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCE = str(ROOT / "src")


def _hear() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


# For preexec_fn: what a shell starts in the background ignores SIGINT, and so would every child of it.
HEARING = None if sys.platform == "win32" else _hear


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
