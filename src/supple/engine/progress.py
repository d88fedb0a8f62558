"""Progress bars and stages on the terminal."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

from supple.engine.work import Tell, silent
from supple.errors import shown


@contextlib.contextmanager
def counted(progress: bool | Callable[[str], None], unit: str = "frames") -> Iterator[Tell]:
    """Show the progress of a clip or a volume: frames or slices, their rate, and the time left."""
    if callable(progress):
        yield lambda step, done, total: progress(step)
        return
    if not progress or sys.stderr is None or not sys.stderr.isatty():
        yield silent
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
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as bar:
        tasks: dict[str, Any] = {}

        def show(step: str, done: int, total: int) -> None:
            if step in ("read", "write"):
                return
            if step not in tasks:
                names = {"plan": "planning", "warp": unit, "render": "rendering", "reduce": "levels"}
                tasks[step] = bar.add_task(names.get(step, step), total=total)
            bar.update(tasks[step], completed=done)

        yield show


@contextlib.contextmanager
def staged(source: str | os.PathLike[str], progress: bool) -> Iterator[Tell]:
    """Show each stage of the work on the terminal, if there is one and ``progress`` is set."""
    if not progress or sys.stderr is None or not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    with console.status(Text(f"{shown(source)}")) as status:
        yield lambda step, done, total: status.update(Text(f"{step}: {shown(source)}"))
