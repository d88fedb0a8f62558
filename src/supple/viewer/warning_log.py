"""Warnings, heard by who asked for the work that they are about, while others work in other threads."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import TextIO

Ear = Callable[[str, type[Warning]], None]

_lock = threading.RLock()
_ears: list[tuple[int, Ear]] = []  # the thread of each, and whom to tell
_outside: list[contextlib.ExitStack] = []  # what puts all back once nobody listens


@contextlib.contextmanager
def heard(tell: Ear) -> Iterator[None]:
    """Tell of the warnings of this thread, and of threads that work for it, instead of printing them.

    `warnings.catch_warnings` is for a single thread: two that overlap leave a mess behind. A warning of a thread that
    nobody listens to goes to who listens in the background, as its helpers have threads of their own; those of the
    main thread go on as they would.

    Parameters
    ----------
    tell : function of str and type
        What is warned of, and the warning's kind. It is called from the thread that warns.
    """
    mine = (threading.get_ident(), tell)
    with _lock:
        if not _ears:
            _listen()
        _ears.append(mine)
    try:
        yield
    finally:
        with _lock:
            _ears.remove(mine)
            if not _ears:
                _outside.pop().close()


def _listen() -> None:
    stack = contextlib.ExitStack()
    stack.enter_context(warnings.catch_warnings())
    before = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        ear = _whose(threading.get_ident())
        if ear is None:
            before(message, category, filename, lineno, file, line)
        else:
            ear(str(message), category)

    warnings.simplefilter("always")
    warnings.showwarning = show
    _outside.append(stack)


def _whose(thread: int) -> Ear | None:
    main = threading.main_thread().ident
    with _lock:
        own = [ear for ident, ear in _ears if ident == thread]
        others = [ear for ident, ear in _ears if ident != main] if thread != main else []
    return next(reversed(own or others), None)
