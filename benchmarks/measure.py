"""Measuring in pairs, on machines that are small and noisy: ours and a peer in turn, ratios run by run."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    what: str
    ours: str
    peer: str
    value: str
    bar: str
    holds: bool | None
    runs: int


def pair(ours: Callable[[], object], peer: Callable[[], object], runs: int) -> tuple[float, float, float]:
    """Median seconds of each, and the median of the ratios, of runs that alternate."""
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


def timed(what: str, ours: Callable[[], object], peer: Callable[[], object], runs: int, bar: float | None) -> Row:
    """A row that compares times; the bar is the largest ratio that will do."""
    a, b, ratio = pair(ours, peer, runs)
    return Row(
        what,
        milliseconds(a),
        milliseconds(b),
        f"{ratio:.2f}",
        "" if bar is None else f"≤ {bar:g}",
        None if bar is None else ratio <= bar,
        runs,
    )


def milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:.1f} ms" if seconds < 10 else f"{seconds:.1f} s"


def run(arguments: list[str]) -> tuple[float, float]:
    """Seconds and peak resident megabytes of a process, which must succeed."""
    script = (
        "import os, resource, subprocess, sys, time; t = time.perf_counter();"
        "code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode;"
        "print(time.perf_counter() - t, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    seconds, peak = done.stdout.split()
    unit = 1 if sys.platform == "darwin" else 1024
    return float(seconds), float(peak) * unit / 1e6


def machine() -> str:
    """What this machine is, in a line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {cores} cores, {platform.system()}, Python {platform.python_version()}"


__all__ = ["Row", "machine", "milliseconds", "pair", "run", "timed"]
