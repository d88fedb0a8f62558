"""Certify inverses of random fields: count the samples that are called ok, and are not.

    python benchmarks/certify_fields.py --solves 1e9 --seed 1

Every sample called ok is checked by an independent evaluation of the interpolant (`certify_oracle`), and of some, all
points that are mapped to them are searched for. A counterexample is printed with the seed of its case, which
`--case` repeats.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from certify_oracle import VERDICTS, check
from scipy import ndimage
from scipy.stats import special_ortho_group

from supple.errors import SuppleError
from supple.fields import Field
from supple.space.geometry import Grid

Floats = npt.NDArray[np.float64]
Rng = np.random.Generator
KINDS = (
    "smooth", "rough", "folded", "cut", "blocks", "sliding", "one axis", "squeezed", "constant", "collapsed", "bent",
)  # fmt: skip


def log_uniform(rng: Rng, low: float, high: float, size: int | None = None) -> Any:
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def box_in(rng: Rng, shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Return a random box of up to half of a grid along each axis."""
    low = [int(rng.integers(0, s)) for s in shape]
    return tuple(slice(a, a + int(rng.integers(1, max(2, s // 2 + 1)))) for a, s in zip(low, shape, strict=True))


@dataclass(frozen=True)
class Case:
    """A field, the grid of the result, and the tolerance."""

    kind: str
    field: Field
    grid: Grid | None
    tolerance: float

    def __str__(self) -> str:
        f, g = self.field, self.grid
        what = "its own" if g is None else f"{g.shape} of {np.round(g.spacing, 4).tolist()}"
        return (
            f"{self.kind}, {f.grid.shape} of {np.round(f.grid.spacing, 4).tolist()}, {f.interpolation}, "
            f"{f.values.dtype}, beyond {f.beyond}, on {what}, tolerance {self.tolerance:.3g}"
        )


def waves(rng: Rng, shape: tuple[int, ...], width: float, steepness: float) -> Floats:
    """Return smoothed noise whose steepest slope is the one given, in samples."""
    n = len(shape)
    sigma = [0.0 if size == 1 else width for size in shape]
    made = np.stack([ndimage.gaussian_filter(rng.normal(size=shape), sigma, mode="reflect") for _ in range(n)], -1)
    slope = max([float(np.abs(np.diff(made, axis=k)).max()) for k in range(n) if shape[k] > 1] or [1.0])
    return np.asarray(made * (steepness / max(slope, 1e-12)))


def displacement(rng: Rng, kind: str, shape: tuple[int, ...]) -> Floats:
    """Return displacements of a kind, in samples along the axes of the index."""
    n, width = len(shape), float(log_uniform(rng, 0.5, 8))
    index = np.stack(np.indices(shape)[::-1], -1).astype(np.float64)
    still = np.zeros((*shape, n))
    match kind:
        case "smooth":
            return waves(rng, shape, width, float(log_uniform(rng, 0.01, 0.8)))
        case "rough":
            return np.asarray(rng.uniform(-1, 1, (*shape, n)) * log_uniform(rng, 0.02, 1.0))
        case "folded":
            return waves(rng, shape, width, float(rng.uniform(0.8, 5)))
        case "cut":
            steep = float(rng.uniform(0.1, 1.2))
            return waves(rng, shape, 4 * width, steep) + rng.normal(size=n) * rng.choice([0.3, 3, max(shape) / 2])
        case "constant":
            return still + rng.normal(size=n) * rng.choice([0.0, 0.5, 10.0, 1e3, 1e5])
        case "blocks":
            made = waves(rng, shape, width, float(rng.uniform(0.2, 1.5)))
            for _ in range(int(rng.integers(1, 6))):
                made[box_in(rng, shape)] = rng.choice([0.0, 0.0, rng.normal()])
        case "sliding":
            made = waves(rng, shape, width, float(rng.uniform(0.05, 0.6)))
            axis, cut = int(rng.integers(n)), int(rng.integers(1, max(shape) + 1))
            along = rng.normal(size=n) * rng.choice([0.3, 2.0])
            if rng.random() < 0.6:
                along[n - 1 - axis] = rng.uniform(0, 1)
            made += np.where(index[..., n - 1 - axis, None] >= cut, along, 0.0)
        case "one axis" | "squeezed":  # x -> f(x) along one axis, with slopes of all sizes; a little of all else
            made, axis = still, int(rng.integers(n))
            size = shape[axis]
            slopes = log_uniform(rng, 1e-4, 4, size)
            if kind == "one axis":
                slopes *= np.where(rng.random(size) < rng.choice([0.0, 0.1, 0.3]), -1, 1)
            places = np.cumsum(slopes)
            if kind == "squeezed":
                places *= size / places[-1]
            u = places - places[size // 2] - (np.arange(size) - size // 2)
            made[..., n - 1 - axis] = u.reshape([-1 if k == axis else 1 for k in range(n)])
            if rng.random() < 0.5:
                made += rng.normal(size=made.shape) * log_uniform(rng, 1e-4, 0.1)
        case "bent":  # a strip, along a part of a circle or more than one: its ends may lie on each other
            made, (sizes, turn) = still, (shape[:-3:-1], rng.uniform(1, 9))
            radius, angle = sizes[0] / turn + sizes[1] / 2 - index[..., 1], turn * index[..., 0] / sizes[0]
            made[..., 0] = sizes[0] / 2 + radius * np.sin(angle) - index[..., 0]
            made[..., 1] = sizes[1] / 2 - radius * np.cos(angle) - index[..., 1]
        case _:  # collapsed: part of it is mapped to a plane, a line or a point
            made, some, box = waves(rng, shape, width, 0.3), rng.random(n) < 0.6, box_in(rng, shape)
            low = index[tuple(part.start for part in box)]
            made[box] = np.where(some, low - index[box], made[box])
    return made


def case_of(seed: int, case: int, solves: int) -> Case:
    """Return a random case with about a number of solves."""
    rng = np.random.default_rng([seed, case])
    n = int(rng.choice([2, 3]))
    kind = KINDS[int(rng.integers(len(KINDS)))]
    interpolation: Any = rng.choice(["linear", "linear", "cubic", "bspline"])
    least = 4 if interpolation == "bspline" else 1
    most = 120 if n == 2 else 26
    shape = tuple(int(x) for x in rng.integers(max(least, most // 4), most + 1, n))
    if rng.random() < 0.15:
        shape = tuple(max(least, int(rng.integers(1, 4))) if rng.random() < 0.6 else s for s in shape)
    dtype = np.float32 if rng.random() < 0.5 else np.float64
    spacing = np.exp(rng.uniform(-1, 1, n)) if rng.random() < 0.5 else np.full(n, float(rng.choice([1.0, 1.0, 0.7, 3])))
    direction = special_ortho_group.rvs(n, random_state=rng) if rng.random() < 0.4 else np.eye(n)
    origin = rng.normal(size=n) * rng.choice([0.0, 10.0, 300.0])
    grid = Grid(shape, spacing.tolist(), origin.tolist(), direction)
    values = displacement(rng, kind, shape) @ grid.matrix[:n, :n].T
    beyond: Any = rng.choice(["zero", "edge"])
    field = Field(values.astype(dtype), grid, interpolation, beyond)
    tolerance = float(log_uniform(rng, 1e-6, 0.5))
    # A grid of about that many samples over the field, and what is beside it.
    turned = direction @ special_ortho_group.rvs(n, random_state=rng) if rng.random() < 0.4 else direction
    extent = np.multiply(grid.sizes, spacing)
    step = extent.prod() ** (1 / n) / solves ** (1 / n)
    steps = np.maximum(step * np.exp(rng.uniform(-0.3, 0.3, n)), 1e-3 * spacing)
    if rng.random() < 0.1:
        return Case(kind, field, None, tolerance)
    stretch = float(rng.choice([0.6, 1.0, 1.3, 3.0]))
    sizes = [max(1, int(x)) for x in np.minimum(stretch * extent / steps, 3.0 * solves ** (1 / n))]
    steps = np.maximum(steps, stretch * extent / sizes * rng.choice([1.0, 0.5]))
    middle = grid.positions((np.array(grid.sizes) - 1) / 2)
    shift = rng.uniform(-0.5, 0.5, n) * spacing
    corner = middle + shift - turned @ (steps * (np.array(sizes) - 1) / 2)
    return Case(kind, field, Grid(sizes[::-1], steps.tolist(), corner.tolist(), turned), tolerance)


def run(seed: int, case: int, solves: int, searches: int, tally: Counter[str]) -> int:
    """Check one case, and return the number of counterexamples."""
    made = case_of(seed, case, solves)
    try:
        found = made.field.invert(made.grid, tolerance=made.tolerance)
    except SuppleError:
        tally["grids that do not overlap"] += 1
        return 0
    status = found.status
    rng = np.random.default_rng([seed, case, 1])
    ok = status == 0
    edge = ok & ndimage.binary_dilation(~ok) if status.size > 1 else ok
    places = [np.flatnonzero(edge), np.flatnonzero(ok)]
    some = [rng.choice(each, min(searches, len(each)), replace=False) for each in places]
    result = check(made.field, found, made.tolerance, np.unique(np.concatenate(some)).astype(np.intp))
    tally["solves"] += status.size
    tally["ok"] += result.ok
    tally["searched"] += result.searched
    tally["undecided"] += result.undecided
    for name, count in found.counts.items():
        tally[f"status {name}"] += count
    for verdict in {verdict for _, verdict, _ in result.wrong}:
        alike = [(k, text) for k, v, text in result.wrong if v == verdict]
        tally[f"WRONG: {VERDICTS[verdict]}"] += len(alike)
        which = f"{VERDICTS[verdict]} ({len(alike)}): --seed {seed} --case {case}: {made}"
        print(f"COUNTEREXAMPLE {which}; sample {alike[0][0]}: {alike[0][1]}", flush=True)
    return len(result.wrong)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solves", type=float, default=1e7)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--case", type=int, help="only this case")
    parser.add_argument("--each", type=int, default=200_000, help="solves of a case, about")
    parser.add_argument("--searches", type=int, default=300, help="of a case, beside what folds and elsewhere")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after these")
    given = parser.parse_args()
    tally: Counter[str] = Counter()
    start, wrong, shown = time.perf_counter(), 0, 0.0
    if given.case is not None:
        wrong = run(given.seed, given.case, given.each, given.searches, tally)
        print(dict(tally))
        return int(wrong > 0)
    case = 0
    while tally["solves"] < given.solves and (passed := time.perf_counter() - start) < given.seconds:
        wrong += run(given.seed, case, given.each, given.searches, tally)
        case += 1
        if passed - shown > 60:
            shown = passed
            print(f"{passed:.0f} s, {case} cases, {tally['solves'] / passed:.3g} solves/s: {dict(tally)}", flush=True)
    passed = time.perf_counter() - start
    print(f"{case} cases, {passed:.0f} s, {tally['solves'] / passed:.3g} solves/s")
    for name, count in sorted(tally.items()):
        print(f"{count:>14,}  {name}")
    print(f"counterexamples: {wrong}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
