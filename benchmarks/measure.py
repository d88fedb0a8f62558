"""Times of whole calls by any clock, ours and a peer's in turn: medians, how far they spread, and their table."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Work = Callable[[], object]
Clock = Callable[[Work], float]  # the seconds that some work takes

HEAD = "| what | ours | peer | value | bar | | runs | |\n|---|---|---|---|---|---|---|---|"
BEGIN, END = "<!-- measured: {} -->", "<!-- end -->"  # around what a page keeps
WARMING = 3  # calls that are not counted: the first compiles, and memory pools fill


def wall(work: Work) -> float:
    """Return the seconds of some work on the host's clock."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def cpu(work: Work) -> float:
    """Return the seconds that the process spends on some work, on all its threads."""
    start = time.process_time()
    work()
    return time.process_time() - start


@dataclass(frozen=True)
class Spread:
    """The median of several measurements, and between what eight tenths of them lie."""

    median: float
    low: float
    high: float
    longest: float
    runs: int

    @classmethod
    def of(cls, *values: float) -> Spread:
        """Return the spread of some numbers, at least one."""
        ranked = sorted(values)
        last = len(ranked) - 1
        return cls(
            statistics.median(ranked), ranked[round(0.1 * last)], ranked[round(0.9 * last)], ranked[-1], last + 1
        )

    def map(self, scale: Callable[[float], float]) -> Spread:
        """Return the spread in another unit; one that falls turns the ends around."""
        low, high = sorted((scale(self.low), scale(self.high)))
        return Spread(scale(self.median), low, high, scale(self.longest), self.runs)

    def __str__(self) -> str:
        return f"{digits(self.median)} ({digits(self.low)}–{digits(self.high)})" if self.runs > 1 else digits(self.low)


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Parameters
    ----------
    what : str
    ours, peer : Spread or str
        Seconds of a call, or other figures with their unit.
    value : Spread, optional
        What the bar is about.
    unit : str
    bar : float, optional
        The most that will do; or the least, if negative.
    note : str
        Beside it; or in place of it, where nothing was measured.
    """

    what: str
    ours: Spread | str = ""
    peer: Spread | str = ""
    value: Spread | None = None
    unit: str = "ms"
    bar: float | None = None
    note: str = ""

    @property
    def holds(self) -> bool | None:
        """Whether the bar is met; None without one, or where nothing was measured."""
        if self.bar is None or self.value is None:
            return None
        return self.value.median >= -self.bar if self.bar < 0 else self.value.median <= self.bar

    def __str__(self) -> str:
        bar = "" if self.bar is None else f"{'≥' if self.bar < 0 else '≤'} {abs(self.bar):g}"
        word = {True: "holds", False: "**missed**", None: "" if self.bar is None else "not measured"}[self.holds]
        times = [s if isinstance(s, str) else f"{s.map(lambda x: x * 1e3)} ms" for s in (self.ours, self.peer)]
        # A time is said once.
        value = f"{self.value} {self.unit}" if self.value and not (self.ours and self.unit == "ms") else ""
        runs = self.value.runs if self.value else ""
        return f"| {' | '.join((self.what, *times, value, bar, word, str(runs), self.note))} |"

    def told(self) -> dict[str, Any]:
        """Return the line as JSON has it."""
        bar = {} if self.bar is None else {"at_least" if self.bar < 0 else "at_most": abs(self.bar)}
        return {**asdict(self), "bar": bar, "holds": self.holds}


def digits(x: float) -> str:
    """Return a number with three digits, and all those before the point."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{x:#.3g}".rstrip(".")


def seconds(value: float) -> str:
    """Return a time, in milliseconds below a second."""
    return f"{digits(value * 1e3)} ms" if value < 1 else f"{digits(value)} s"


def alone(work: Work, clock: Clock, runs: int) -> Spread:
    """Return the seconds of some work, after calls that are not counted."""
    for _ in range(min(WARMING, runs - 1)):
        work()
    return Spread.of(*(clock(work) for _ in range(runs)))


def paired(ours: Work, peer: Work, clock: Clock, runs: int, warm: int = WARMING) -> tuple[Spread, Spread, Spread]:
    """Return the seconds of each and the ratio ours / peer, of calls in turn; who comes first changes each time."""
    for _ in range(min(warm, runs - 1)):
        ours()
        peer()
    a, b = [], []
    for k in range(runs):
        for work, taken in ((ours, a), (peer, b)) if k % 2 else ((peer, b), (ours, a)):
            taken.append(clock(work))
    return Spread.of(*a), Spread.of(*b), Spread.of(*(x / y for x, y in zip(a, b, strict=True)))


def in_turn(peer: Work, ours: Work, clock: Clock, runs: int) -> str:
    """Return the cells of a table of peers: the peer's time, ours in turn with it, and the ratio.

    Ours is the peer's median divided by the median ratio, so that no column contradicts another.
    """
    taken, _, ratio = paired(peer, ours, clock, runs)
    return f"{seconds(taken.median)} | {seconds(taken.median / ratio.median)} | {digits(ratio.median)}"


def against(
    what: str, ours: Work, peer: Work, clock: Clock, runs: int, bar: float | None = None, warm: int = WARMING
) -> Line:
    """Return a line that compares times; the bar is the largest ratio that will do."""
    return Line(what, *paired(ours, peer, clock, runs, warm), "×", bar)


def took(what: str, work: Work, clock: Clock, runs: int, bar: float | None = None, note: str = "") -> Line:
    """Return a line of milliseconds."""
    a = alone(work, clock, runs)
    return Line(what, a, "", a.map(lambda x: x * 1e3), "ms", bar, note)


def rate(what: str, work: Work, count: float, unit: str, clock: Clock, runs: int, bar: float | None = None) -> Line:
    """Return a line of so many a second; the bar is the least that will do."""
    a = alone(work, clock, runs)
    return Line(what, a, "", a.map(lambda x: count / x), unit, None if bar is None else -bar)


def figure(
    what: str, value: float, unit: str, bar: float | None = None, *, ours: str = "", peer: str = "", note: str = ""
) -> Line:
    """Return a line of a number that is measured once."""
    return Line(what, ours, peer, Spread.of(value), unit, bar, note)


def grid_of(shape: Sequence[int]) -> npt.NDArray[np.float64]:
    """Return the points of all samples, x first."""
    return np.stack(np.meshgrid(*(np.arange(float(n)) for n in shape), indexing="ij")[::-1], axis=-1)


def psnr(found: npt.ArrayLike, wanted: npt.ArrayLike) -> float:
    """Return the peak signal to noise ratio in dB, for a white of 255."""
    error = float(np.mean((np.asarray(found, np.float64) - np.asarray(wanted)) ** 2))
    return float(10 * np.log10(255**2 / max(error, 1e-30)))


def missed(lines: Iterable[Line]) -> bool:
    """Return whether a bar is missed."""
    return any(line.holds is False for line in lines)


def shown(lines: Iterable[Line]) -> list[Line]:
    """Print lines as they are measured; return them."""
    made = []
    for line in lines:
        made.append(line)
        print(line, flush=True)
    return made


def run(arguments: Sequence[str]) -> tuple[float, float]:
    """Return the seconds and the peak resident megabytes of a process, which must succeed."""
    script = (
        "import os, resource, subprocess, sys, time; t = time.perf_counter();"
        "code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode;"
        "print(time.perf_counter() - t, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    taken, peak = map(float, done.stdout.split())
    return taken, peak * (1 if sys.platform == "darwin" else 1024) / 1e6


def machine() -> str:
    """Return what this machine is, in a line."""
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    model = names[0].split(":", 1)[1].strip() if names else platform.processor() or platform.machine()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {cores} cores, {platform.system()}, Python {platform.python_version()}"


def kept(page: str, name: str, text: str) -> str:
    """Return the page with the text between its two marks replaced."""
    before, begun, rest = page.partition(BEGIN.format(name))
    _, ended, after = rest.partition(END)
    if not (begun and ended):
        raise ValueError(f"the page's marks {begun or BEGIN.format(name)} and {END} are missing")
    return f"{before}{begun}\n{text}\n{ended}{after}"
