"""Times of whole calls by any clock, ours and a peer's in turn: medians, how far they spread, and their table."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

Work = Callable[[], object]
Clock = Callable[[Work], float]  # the seconds that some work takes


def warming(runs: int) -> int:
    """How many calls are not counted: the first compiles, and memory pools fill. None, if one run is all."""
    return min(3, runs - 1)


@dataclass(frozen=True)
class Spread:
    """What was measured several times: the median, and between what eight tenths of it lie."""

    median: float
    low: float
    high: float
    longest: float
    runs: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Of some numbers, at least one."""
        ranked = sorted(values)
        last = len(ranked) - 1
        return cls(
            statistics.median(ranked), ranked[round(0.1 * last)], ranked[round(0.9 * last)], ranked[-1], last + 1
        )

    def map(self, scale: Callable[[float], float]) -> Spread:
        """The same in another unit; one that falls turns the ends around."""
        low, high = sorted((scale(self.low), scale(self.high)))
        return Spread(scale(self.median), low, high, scale(self.longest), self.runs)

    def __str__(self) -> str:
        return f"{digits(self.median)} ({digits(self.low)}–{digits(self.high)})"


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Parameters
    ----------
    what : str
    ours, peer : Spread, optional
        Seconds of a call.
    value : Spread, optional
        What the bar is about.
    unit : str
    bar : float, optional
        The most that will do; or the least, if negative.
    note : str
        Beside it; or in place of it, where nothing was measured.
    """

    what: str
    ours: Spread | None = None
    peer: Spread | None = None
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
        times = [f"{s.map(lambda x: x * 1e3)} ms" if s else "" for s in (self.ours, self.peer)]
        # A time is said once.
        value = f"{self.value} {self.unit}" if self.value and not (self.ours and self.unit == "ms") else ""
        measured = self.value or self.ours
        cells = (self.what, *times, value, bar, word, str(measured.runs) if measured else "", self.note)
        return f"| {' | '.join(cells)} |"

    def told(self) -> dict[str, Any]:
        """As JSON has it."""
        bar = {} if self.bar is None else {"at_least" if self.bar < 0 else "at_most": abs(self.bar)}
        return {**asdict(self), "bar": bar, "holds": self.holds}


def digits(x: float) -> str:
    """Three of them, and all those before the point."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{x:#.3g}".rstrip(".")


def seconds(value: float) -> str:
    """A time, in milliseconds below a second."""
    return f"{digits(value * 1e3)} ms" if value < 1 else f"{digits(value)} s"


def alone(work: Work, clock: Clock, runs: int) -> Spread:
    """Seconds of some work, after calls that are not counted."""
    for _ in range(warming(runs)):
        work()
    return Spread.of([clock(work) for _ in range(runs)])


def paired(ours: Work, peer: Work, clock: Clock, runs: int) -> tuple[Spread, Spread, Spread]:
    """Seconds of each and the ratio ours / peer, of calls in turn; who comes first changes from pair to pair."""
    for _ in range(warming(runs)):
        ours()
        peer()
    a, b = [], []
    for k in range(runs):
        if k % 2:
            a.append(clock(ours))
            b.append(clock(peer))
        else:
            b.append(clock(peer))
            a.append(clock(ours))
    return Spread.of(a), Spread.of(b), Spread.of([x / y for x, y in zip(a, b, strict=True)])


def in_turn(peer: Work, ours: Work, clock: Clock, runs: int) -> str:
    """The cells of a table of peers: the peer's time, ours in turn with it, and the ratio.

    Ours is the peer's median divided by the median ratio, so that no column contradicts another.
    """
    taken, _, ratio = paired(peer, ours, clock, runs)
    return f"{seconds(taken.median)} | {seconds(taken.median / ratio.median)} | {digits(ratio.median)}"


def against(what: str, ours: Work, peer: Work, clock: Clock, runs: int, bar: float | None = None) -> Line:
    """A line that compares times; the bar is the largest ratio that will do."""
    a, b, ratio = paired(ours, peer, clock, runs)
    return Line(what, a, b, ratio, "×", bar)


def took(what: str, work: Work, clock: Clock, runs: int, bar: float | None = None, note: str = "") -> Line:
    """A line of milliseconds."""
    a = alone(work, clock, runs)
    return Line(what, a, None, a.map(lambda x: x * 1e3), "ms", bar, note)


def rate(what: str, work: Work, count: float, unit: str, clock: Clock, runs: int, bar: float | None = None) -> Line:
    """A line of so many a second; the bar is the least that will do."""
    a = alone(work, clock, runs)
    return Line(what, a, None, a.map(lambda x: count / x), unit, None if bar is None else -bar)


HEAD = "| what | ours | peer | value | bar | | runs | |\n|---|---|---|---|---|---|---|---|"


def missed(lines: Iterable[Line]) -> bool:
    """Whether a bar is missed."""
    return any(line.holds is False for line in lines)
