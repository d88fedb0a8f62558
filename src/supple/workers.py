"""Who does the work: the threads that share it, the devices that did some of it, and how far it is."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from typing import Any, TypeVar

CPU = "cpu"

Item = TypeVar("Item")
Result = TypeVar("Result")

_noted: ContextVar[dict[str, None] | None] = ContextVar("noted", default=None)
_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}
_lock = threading.Lock()
_inside = threading.local()


def threads() -> int:
    """Return the number of threads that work at once: ``SUPPLE_THREADS``, or as many CPUs as this process may use."""
    asked = os.environ.get("SUPPLE_THREADS", "")
    if asked.isascii() and asked.isdecimal() and int(asked) > 0:
        return int(asked)
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def share(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Run ``work`` for every item on all cores, and return the results in the items' order.

    Called from inside such work, it runs in the calling thread: a pool never waits for itself. When an item fails, or
    the caller is interrupted, no other item is begun.
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


@contextlib.contextmanager
def counted(
    progress: bool | Callable[[str], None],
    unit: str = "frames",
    also: Callable[[str, int, int], None] | None = None,
) -> Iterator[Callable[[str, int, int], None]]:
    """Show how far a clip or a volume is: frames or slices, their rate, and the time left; and tell somebody else."""
    if also is not None:
        with counted(progress, unit) as counts:

            def both(step: str, done: int, total: int) -> None:
                counts(step, done, total)
                also(step, done, total)

            yield both
        return
    if callable(progress):
        yield lambda step, done, total: progress(step)
        return
    if not progress or sys.stderr is None or not sys.stderr.isatty():
        yield lambda step, done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(TextColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.1f} {unit}/s" if speed else "")

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(""),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, Any] = {}

        def show(step: str, done: int, total: int) -> None:
            if step in ("read", "write"):
                return
            if step not in tasks:
                names = {"plan": "planning", "warp": unit, "render": "rendering"}
                tasks[step] = bar.add_task(names[step], total=total)
            bar.update(tasks[step], completed=done)

        yield show
