"""Measuring in pairs, on machines that are small and noisy: ours and a peer in turn, ratios run by run."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

HEAD = "| what | ours | peer | ratio | bar | | before | runs |\n|---|---|---|---|---|---|---|---|"
BY_HAND = "by hand"
BEGIN, END = "<!-- measured: {} -->", "<!-- end -->"  # around what a page keeps


@dataclass(frozen=True)
class Row:
    """A line of the table; ``before`` is what the engine before the native core reached."""

    what: str
    ours: str = ""
    peer: str = ""
    value: str = ""
    bar: str = ""
    holds: bool | None = None
    runs: int | str = 1
    before: str = ""

    def __str__(self) -> str:
        mark = "" if self.holds is None else ("holds" if self.holds else "**missed**")
        cells = (self.what, self.ours, self.peer, self.value, self.bar, mark, self.before, self.runs)
        return "| " + " | ".join(map(str, cells)) + " |"


def pair(
    ours: Callable[[], object], peer: Callable[[], object], runs: int, *, warm: bool = True
) -> tuple[float, float, float]:
    """Return the median seconds of each, and the median of the ratios, of runs that alternate."""
    if warm:
        ours()
        peer()
    a, b = [], []
    for _ in range(runs):
        start = time.perf_counter()
        peer()
        middle = time.perf_counter()
        ours()
        end = time.perf_counter()
        a.append(end - middle)
        b.append(middle - start)
    return (
        statistics.median(a),
        statistics.median(b),
        statistics.median(x / y for x, y in zip(a, b, strict=True)),
    )


def timed(
    what: str,
    ours: Callable[[], object],
    peer: Callable[[], object],
    runs: int,
    bar: float | None = None,
    *,
    before: str = "",
    warm: bool = True,
) -> Row:
    """Return a row that compares times; the bar is the largest ratio that will do."""
    a, b, ratio = pair(ours, peer, runs, warm=warm)
    limit, holds = ("", None) if bar is None else (f"≤ {bar:g}", ratio <= bar)
    return Row(what, milliseconds(a), milliseconds(b), f"{ratio:.2f}", limit, holds, runs, before)


def faster(
    what: str,
    ours: Callable[[], object],
    peer: Callable[[], object],
    runs: int,
    bar: float | None = None,
    *,
    before: str = "",
    warm: bool = True,
) -> Row:
    """Return a row that says how many times as long the peer takes; the bar is the smallest that will do."""
    a, b, ratio = pair(ours, peer, runs, warm=warm)
    times = 1 / ratio
    limit, holds = ("", None) if bar is None else (f"≥ {bar:g}×", times >= bar)
    shown = f"{times:.1f}×" if times < 10 else f"{times:.0f}×"
    return Row(what, milliseconds(a), milliseconds(b), shown, limit, holds, runs, before)


def milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:.1f} ms" if seconds < 10 else f"{seconds:.1f} s"


def run(arguments: list[str]) -> tuple[float, float]:
    """Return the seconds and the peak resident megabytes of a process, which must succeed."""
    script = (
        "import os, resource, subprocess, sys, time; t = time.perf_counter();"
        "code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode;"
        "print(time.perf_counter() - t, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    seconds, peak = done.stdout.split()
    unit = 1 if sys.platform == "darwin" else 1024
    return float(seconds), float(peak) * unit / 1e6


def shown(rows: Iterable[Row]) -> list[Row]:
    """Print rows as they are measured; return them."""
    kept = []
    for row in rows:
        kept.append(row)
        print(row, flush=True)
    return kept


def machine() -> str:
    """Return what this machine is, in a line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {cores} cores, {platform.system()}, Python {platform.python_version()}"


def kept(page: str, name: str, text: str) -> str:
    """Return the page with the text between its two marks replaced."""
    before, begun, rest = page.partition(BEGIN.format(name))
    _, ended, after = rest.partition(END)
    if not (begun and ended):
        raise ValueError(f"the page's marks {begun or BEGIN.format(name)} and {END} are missing")
    return f"{before}{begun}\n{text}\n{ended}{after}"


__all__ = ["BY_HAND", "HEAD", "Row", "faster", "kept", "machine", "milliseconds", "pair", "run", "shown", "timed"]
