"""One stroke of each brush beside a grab, on a picture of 1920 x 1080, by turns: seconds of a whole warp.

python benchmarks/brushes.py [--runs N]

Strokes have the same points, radii and reach, move pixels about as far, and take one step each; twelve are spread over
the picture. The bar: at most 1.5 times as long as a grab.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from typing import Any

import numpy as np
from paired import HEAD, Work, against, missed

import supple
from supple.strokes import Stroke

SHAPE, RADIUS, BAR = (1080, 1920), 120.0, 1.5
CENTRE = ((960.0, 540.0),)
POINTS = tuple((x, y) for y in (200.0, 540.0, 880.0) for x in (270.0, 730.0, 1190.0, 1650.0))
GRAB: dict[str, Any] = {"brush": "grab", "by": (30.0, 15.0)}
BRUSHES: dict[str, dict[str, Any]] = {
    "twist by 40°": {"brush": "twist", "angle": 40},
    "scale by 1.6": {"brush": "scale", "factor": 1.6},
    "scale by 0.6": {"brush": "scale", "factor": 0.6},
    "pinch by 0.6": {"brush": "pinch", "factor": 0.6},
}


def clock(work: Work) -> float:
    """Return the seconds that some work takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def warp(photo: np.ndarray[Any, np.dtype[np.uint8]], count: int, stroke: dict[str, Any]) -> Work:
    """Return a whole warp by so many strokes, as defaults have it; each of them is resolved anew."""
    points = POINTS if count > 1 else CENTRE
    turns = itertools.count()

    def work() -> object:
        # Of its own for each run, or the limits of folding would be known from the run before.
        radius = RADIUS + 1e-6 * next(turns)
        d = supple.Deformation(SHAPE)
        for at in points:
            d = d.add(Stroke(at=at, radius=radius, **stroke))
        assert len(d.space.table) == count
        return d.warp(photo)

    return work


def main() -> int:
    """Print the table; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=15)
    runs = parser.parse_args().runs
    photo = np.random.default_rng(1).integers(0, 256, (*SHAPE, 3), np.uint8)
    lines = []
    print(HEAD)
    for count in (1, len(POINTS)):
        for name, stroke in BRUSHES.items():
            what = f"{name}, beside a grab" if count == 1 else f"{count} times {name}, beside {count} grabs"
            line = against(what, warp(photo, count, stroke), warp(photo, count, GRAB), clock, runs, BAR)
            lines.append(line)
            print(line, flush=True)
    return int(missed(lines))


if __name__ == "__main__":
    sys.exit(main())
