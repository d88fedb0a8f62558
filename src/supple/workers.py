"""Which devices did some work, for whoever asks."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

CPU = "cpu"

_noted: ContextVar[dict[str, None] | None] = ContextVar("noted", default=None)


def note(name: str) -> None:
    """Say that a device did some of it."""
    noted = _noted.get()
    if noted is not None:
        noted[name] = None


class Workers:
    """Those that were noted so far, in their order."""

    def __init__(self, noted: dict[str, None]) -> None:
        self._noted = noted

    def __str__(self) -> str:
        return " and ".join(self._noted) or CPU  # which goes without saying


@contextlib.contextmanager
def workers() -> Iterator[Workers]:
    """Hear of the devices that do what is done in this thread."""
    noted: dict[str, None] = {}
    token = _noted.set(noted)
    try:
        yield Workers(noted)
    finally:
        _noted.reset(token)
