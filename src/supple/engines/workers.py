"""The threads that share work, and the record of the devices that did it."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

CPU = "cpu"

Item = TypeVar("Item")
Result = TypeVar("Result")

_noted: ContextVar[dict[str, None] | None] = ContextVar("noted", default=None)
_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}
_lock = threading.Lock()
_inside = threading.local()


def threads() -> int:
    """Return the number of worker threads: ``SUPPLE_THREADS``, or the number of CPUs available to this process."""
    asked = os.environ.get("SUPPLE_THREADS", "")
    if asked.isascii() and asked.isdecimal() and int(asked) > 0:
        return int(asked)
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def share(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Run ``work`` for every item on all cores, and return the results in the order of the items.

    A nested call runs in the calling thread, so that a pool never waits for itself. After an error or an
    interruption, no further item is begun.
    """
    listed = list(items)
    n = threads()
    if n == 1 or len(listed) < 2 or getattr(_inside, "yes", False):
        return [work(item) for item in listed]
    with _lock:
        key = (os.getpid(), n)  # a forked child must not wait for its parent's threads
        if key not in _pools:
            from concurrent.futures import ThreadPoolExecutor

            _pools[key] = ThreadPoolExecutor(n, "supple", initializer=_mark)
        pool = _pools[key]
    # Each thread takes the next item when it is free, which is cheaper than a future for each item.
    results: list[Any] = [None] * len(listed)
    left = iter(range(len(listed)))

    def stop() -> None:
        for _ in left:
            pass

    def go() -> None:
        try:
            for k in left:
                results[k] = work(listed[k])
        except BaseException:
            stop()
            raise

    tasks = [pool.submit(go) for _ in range(min(n, len(listed)))]
    try:
        for task in tasks:
            task.result()
    except BaseException:
        stop()
        for task in tasks:
            task.cancel()
        raise
    return results


def _mark() -> None:
    _inside.yes = True


def note(name: str) -> None:
    """Record that a device did some of the work."""
    noted = _noted.get()
    if noted is not None:
        noted[name] = None


class Workers:
    """The devices recorded so far, in order."""

    def __init__(self, noted: dict[str, None]) -> None:
        self._noted = noted

    def __str__(self) -> str:
        return " and ".join(self._noted) or CPU


@contextlib.contextmanager
def workers() -> Iterator[Workers]:
    """Record the devices that work for this thread."""
    noted: dict[str, None] = {}
    token = _noted.set(noted)
    try:
        yield Workers(noted)
    finally:
        _noted.reset(token)
