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
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from measure import HEAD, Line, Work, against, missed, shown, wall

import supple
from supple.strokes import Stroke

Array = npt.NDArray[np.uint8]

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


def warp(photo: Array, strokes: list[dict[str, Any]], steps: int | None = None) -> Work:
    """Return a whole warp by strokes, which are resolved anew, each in so many steps if that is given."""
    turns = itertools.count()

    def work() -> object:
        # Of its own for each run, or the limits of folding would be known from the run before.
        more, d = 1e-6 * next(turns), supple.Deformation(SHAPE)
        for stroke in strokes:
            d = d.add(Stroke(**{**stroke, "radius": stroke["radius"] + more}), warn=False)
        assert steps is None or len(d.space.table) == steps * len(strokes)
        return d.warp(photo)

    return work


def scattered(count: int) -> npt.NDArray[np.float64]:
    """Return points at least 60 pixels apart."""
    rng, found = np.random.default_rng(0), np.empty((0, 2))
    while len(found) < count:
        point = rng.uniform((60, 60), (SHAPE[1] - 60, SHAPE[0] - 60))
        if not (np.linalg.norm(found - point, axis=1) < 60).any():
            found = np.concatenate([found, point[None]])
    return found


def lines(runs: int) -> Iterator[Line]:
    """Yield the lines of the table."""
    photo = np.random.default_rng(1).integers(0, 256, (*SHAPE, 3), np.uint8)
    for points in (CENTRE, POINTS):
        grabs, *others = ([{"at": at, "radius": RADIUS, **one} for at in points] for one in (GRAB, *BRUSHES.values()))
        count = len(points)
        for name, strokes in zip(BRUSHES, others, strict=True):
            what = f"{name}, beside a grab" if count == 1 else f"{count} times {name}, beside {count} grabs"
            yield against(what, warp(photo, strokes, 1), warp(photo, grabs, 1), wall, runs, BAR)
    points = scattered(200)
    by = 10 * np.stack([np.cos(np.arange(200.0)), np.sin(np.arange(200.0))], axis=-1)
    pull = Stroke.pull(points, to=points + by, radius=70)
    handles = {"at": pull.at, "by": pull.by, "also": pull.also, "radius": pull.radius}
    grab = {"at": CENTRE[0], "by": (76.0, 76.0), "radius": 162.0}
    yield against("a pull of 200 pairs, beside a grab", warp(photo, [handles]), warp(photo, [grab]), wall, runs, 10)
    turn = np.linspace(0, np.pi, 100)
    way = np.stack([960 - 80 * np.cos(turn), 540 + 80 * np.sin(turn)], axis=-1).tolist()
    path = {"at": way[0], "by": (160.0, 0.0), "path": way[1:-1], "radius": 100.0}
    straight = {"at": way[0], "by": (80 * np.pi, 0.0), "radius": 100.0}
    what = "a path of 100 points, beside a straight drag of its length"
    yield against(what, warp(photo, [path]), warp(photo, [straight]), wall, runs, 4)


def main() -> int:
    """Print the table; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=15)
    runs = parser.parse_args().runs
    print(HEAD)
    return int(missed(shown(lines(runs))))


if __name__ == "__main__":
    sys.exit(main())
