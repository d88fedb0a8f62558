"""One stroke of each brush beside a grab, on a picture of 1920 x 1080, by turns: seconds of a whole warp.

python benchmarks/brushes.py [--runs N]

Strokes have the same points, radii and reach, move pixels about as far, and take one step each; twelve are spread over
the picture. The bar: at most 1.5 times as long as a grab. Then a pull of 200 pairs, whose points are spread over the
picture, at least 60 pixels apart, and move by 10 pixels each; beside one grab whose radius is 0.15 of the height, as in
`run.py`, and whose drag 0.1 of it. The bar: at most 10 times as long. And a path of 100 points beside a straight one.
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


def scattered(count: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return points at least 60 pixels apart."""
    rng, found = np.random.default_rng(0), np.empty((0, 2))
    while len(found) < count:
        point = rng.uniform((60, 60), (SHAPE[1] - 60, SHAPE[0] - 60))
        if not (np.linalg.norm(found - point, axis=1) < 60).any():
            found = np.concatenate([found, point[None]])
    return found


def made(photo: np.ndarray[Any, np.dtype[np.uint8]], **stroke: Any) -> Work:
    """Return a whole warp by one stroke, in as many steps as it takes, resolved anew."""
    turns = itertools.count()

    def work() -> object:
        # As above: of its own for each run.
        one = Stroke(**{**stroke, "radius": stroke["radius"] + 1e-6 * next(turns)})
        return supple.Deformation(SHAPE).add(one).warp(photo)

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
    points = scattered(200)
    by = 10 * np.stack([np.cos(np.arange(200.0)), np.sin(np.arange(200.0))], axis=-1)
    pull = Stroke.pull(points, to=points + by, radius=70)
    grab = {"at": CENTRE[0], "by": (76.0, 76.0), "radius": 162.0}
    handles = {"at": pull.at, "by": pull.by, "also": pull.also, "radius": pull.radius}
    lines.append(
        against("a pull of 200 pairs, beside a grab", made(photo, **handles), made(photo, **grab), clock, runs, 10)
    )
    print(lines[-1], flush=True)
    turn = np.linspace(0, np.pi, 100)
    way = np.stack([960 - 80 * np.cos(turn), 540 + 80 * np.sin(turn)], axis=-1).tolist()
    path = {"at": way[0], "by": (160.0, 0.0), "path": way[1:-1], "radius": 100.0}
    straight = {"at": way[0], "by": (80 * np.pi, 0.0), "radius": 100.0}
    what = "a path of 100 points, beside a straight drag of its length"
    lines.append(against(what, made(photo, **path), made(photo, **straight), clock, runs, 4))
    print(lines[-1], flush=True)
    return int(missed(lines))


if __name__ == "__main__":
    sys.exit(main())
