"""Draw random deformations by `supple.augment`, of any sizes and options, and look for folds.

    python benchmarks/augment_folds.py --draws 1000000    40 minutes of a core; --jobs shares it among processes

Of each draw: the proven margin of every step; the determinant of I + J at points of the picture or volume; whether
points come back from where they go, which they would not where the map folds; and, of one draw of a hundred, whether
small triangles, or tetrahedra, keep their orientation, which asks neither the margin nor the Jacobian. What is found is
printed with the seed that draws it again: `--first SEED --draws 1`.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from dataclasses import dataclass, field, fields

import numpy as np

import supple
from supple.augment import RandomElastic

POINTS = 100
LOOKED_CLOSER = 100  # one draw of so many


@dataclass
class Tally:
    """What was drawn and found."""

    draws: int = 0
    strokes: int = 0
    steps: int = 0
    margin: float = 1.0
    determinant: float = np.inf
    farthest: float = 0.0
    back: float = 0.0
    triangles: int = 0
    found: list[str] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Add the numbers of others; a least or a largest one is that of both."""
        for each in fields(self):
            both = getattr(self, each.name), getattr(other, each.name)
            how = {"margin": min, "determinant": min, "farthest": max, "back": max}.get(each.name)
            setattr(self, each.name, how(both) if how else both[0] + both[1])


def drawn(seed: int) -> tuple[supple.Deformation, RandomElastic]:
    """Return the draw of a seed: of a picture or a volume, of any size, with mild options and extreme ones."""
    rng = np.random.default_rng(seed)
    ndim = int(rng.integers(2, 4))
    sizes = 2 ** rng.uniform(4, 11 if ndim == 2 else 7, ndim)
    shape = tuple(int(n) for n in sizes)
    spacing = (1.0,) * ndim if rng.random() < 0.5 else tuple(2 ** rng.uniform(-1, 1.5, ndim))
    extent = min(n * s for n, s in zip(reversed(shape), spacing, strict=True))
    small = extent * rng.uniform(0.05, 0.4)
    large = small * rng.uniform(1, 2.5)
    border: object = ("auto", None, extent * rng.uniform(0.02, 0.5))[rng.integers(3)]
    longest = small * min(1.0, rng.uniform(0, 1.2))
    augment = RandomElastic(longest, (small, large), (1, 8), border=border)
    return augment.draw(shape, rng, spacing=spacing), augment


def looked_at(seed: int, tally: Tally) -> None:
    """Draw once, and look for folds."""
    d, augment = drawn(seed)
    known = d.resolution()
    rng = np.random.default_rng(seed + 1)
    points = rng.uniform(0, np.array(d.shape[::-1]) - 1, (POINTS, d.ndim))
    moved = d.forward(points)
    determinant = float(np.linalg.det(d.jacobian(points)).min())
    farthest, most = float(np.linalg.norm((moved - points) * d.domain.spacing, axis=1).max()), augment.max_displacement
    inverse = d.inverse(moved)
    back = float(np.abs(inverse.points - points).max())
    part = farthest / most if most else 0.0
    tally.add(Tally(1, known["strokes"], known["applied"], known["margin"], determinant, part, back))
    for good, text in (
        (known["margin"] > 0, f"margin {known['margin']}"),
        (determinant > 0, f"determinant {determinant}"),
        (inverse.converged.all() and back < 1e-3, f"a point comes back {back} samples from where it was"),
        (farthest <= most, f"a point moves by {farthest}, and at most {most} was asked"),
    ):
        if not good:
            tally.found.append(f"seed {seed}: {text}")
    if seed % LOOKED_CLOSER == 0:
        turned, count = triangles(d, rng)
        tally.triangles += count
        if turned:
            tally.found.append(f"seed {seed}: {turned} of {count} small simplices are turned over")


def triangles(d: supple.Deformation, rng: np.random.Generator) -> tuple[int, int]:
    """Count small simplices that the map turns over, and all: a point, and its neighbours along the axes."""
    size, n = np.array(d.shape[::-1]) - 1, d.ndim
    side = 1e-3 * min(s.radius for s in d.strokes) / np.array(d.domain.spacing)
    corners = rng.uniform(0, size, (2000, n))[:, None] + np.concatenate([np.zeros((1, n)), np.diag(side)])
    moved = d.forward(corners.reshape(-1, n)).reshape(corners.shape)
    volume = np.linalg.det(moved[:, 1:] - moved[:, :1])
    return int((volume <= 0).sum()), len(volume)


def part(first: int, draws: int) -> Tally:
    """Look at consecutive seeds."""
    tally = Tally()
    for seed in range(first, first + draws):
        try:
            looked_at(seed, tally)
        except Exception as error:
            tally.draws += 1
            tally.found.append(f"seed {seed}: {type(error).__name__}: {error}")
    return tally


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=1, help="the first seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args()
    os.environ.setdefault("SUPPLE_THREADS", "1")
    began, tally, chunk = time.monotonic(), Tally(), 1000
    parts = [
        (k, min(chunk, given.first + given.draws - k)) for k in range(given.first, given.first + given.draws, chunk)
    ]
    with multiprocessing.get_context("spawn").Pool(given.jobs) as pool:
        for done in pool.imap_unordered(_part, parts):
            tally.add(done)
            for line in done.found:
                print(line, flush=True)
            if tally.draws % 50_000 == 0:
                print(f"{tally.draws} draws, {len(tally.found)} found, {time.monotonic() - began:.0f} s", flush=True)
    print(
        f"{tally.draws} draws of {tally.strokes} strokes in {tally.steps} steps: {len(tally.found)} found.\n"
        f"Least margin {tally.margin:.3f}, least determinant {tally.determinant:.2g} at {tally.draws * POINTS:.3g} "
        f"points, {tally.triangles} small simplices; the longest displacement is {tally.farthest:.3f} of the longest "
        f"asked for; points come back within {tally.back:.1g} samples. {time.monotonic() - began:.0f} s."
    )
    return 1 if tally.found else 0


def _part(ends: tuple[int, int]) -> Tally:
    return part(*ends)


if __name__ == "__main__":
    sys.exit(main())
