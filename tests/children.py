"""Child processes of tests: where they find the package and these tests."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCE = str(ROOT / "src")


def _hear() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


# For preexec_fn: what a shell starts in the background ignores SIGINT, and so would every child of it.
HEARING = None if sys.platform == "win32" else _hear
