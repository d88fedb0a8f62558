"""How every kernel is compiled, and how kernels share the cores."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from numba import njit

# Inputs are checked to be finite outside the kernels, so that these may assume it.
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "reassoc"}

BATCH = 64  # points that go through the strokes together: their workspace fits the first-level cache


def _compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    made: Callable[..., Any]
    try:
        made = njit(nogil=True, cache=True, error_model="numpy", **options)(function)
    except RuntimeError:  # neither the package's folder nor the user's cache can be written: compile at every start
        made = njit(nogil=True, error_model="numpy", **options)(function)
    return made


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile for one core, without the interpreter's lock, kept on disk."""
    return _compiled(function, fastmath=FAST)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of the kernel that calls it: a level of calls, each of which is optimised again, less."""
    return njit(nogil=True, error_model="numpy", fastmath=FAST, inline="always")(function)


def lean(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of the kernel that calls it, for what it does to every item; it makes no array.

    Elsewhere Numba counts the references to each array that is handed on, at every call: shared by the cores, those
    counts can take longer than the work.
    """
    options: dict[str, Any] = {"nogil": True, "fastmath": FAST, "forceinline": True, "_nrt": False}
    made: Callable[..., Any] = njit(error_model="numpy", **options)(function)
    return made


def colour_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same for samples, which may be infinite or not a number."""
    return _compiled(function, fastmath=FAST - {"nnan", "ninf"})


def threads() -> int:
    """How many threads work at once: ``SUPPLE_THREADS``, or as many as this process may use."""
    asked = os.environ.get("SUPPLE_THREADS", "")
    if asked.isascii() and asked.isdecimal() and int(asked) > 0:
        return int(asked)
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}
_lock = threading.Lock()
_inside = threading.local()


def share(work: Callable[[Any], Any], items: Iterable[Any], *, brief: bool = False) -> list[Any]:
    """``work`` for every item, on all cores; the results in the items' order.

    Called from inside such work, it runs there and then: one pool never waits for itself. Of ``brief`` items the
    caller does some itself, which saves waking another thread; it hears an interrupt when it is done with one.
    """
    listed = list(items)
    n = threads()
    if n == 1 or len(listed) < 2 or getattr(_inside, "yes", False):
        return [work(item) for item in listed]
    with _lock:
        key = (os.getpid(), n)  # a forked child must not wait for its parent's threads
        if key not in _pools:
            _pools[key] = ThreadPoolExecutor(n, "supple", initializer=_mark)
        pool = _pools[key]
    # Each thread takes the next item when it is done with one: cheaper than a future for each.
    results: list[Any] = [None] * len(listed)
    left = iter(range(len(listed)))

    def stop() -> None:
        for _ in left:  # nobody begins another
            pass

    def go() -> None:
        try:
            for k in left:
                results[k] = work(listed[k])
        except BaseException:
            stop()
            raise

    tasks = [pool.submit(go) for _ in range(min(n, len(listed)) - brief)]
    try:
        if brief:
            try:
                _inside.yes = True
                go()
            finally:
                _inside.yes = False
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
