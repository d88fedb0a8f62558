"""Random recipes, many points: nothing folds, and every point converges or is reported. ``python tests/soak.py``."""

from __future__ import annotations

import argparse
import math
import sys
import time
import warnings
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

from supple import Deformation, FoldWarning, SuppleError, ToleranceWarning, _core
from supple._core.rows import numbers
from supple.strokes import Stroke

Floats = npt.NDArray[np.float64]

POISSONS = (-math.inf, -20.0, -5.0, -1.0, 0.0, 0.25, 0.3, 0.4, 0.45, 0.5)
BORDERS = (None, 1.0, 50.0, 200.0)
REACHES = (None, None, 1.0, 1.5, 4.0, 10.0)
STROKES = (1, 1, 1, 2, 3, 5, 10, 20, 50)
WORK = 1_500_000
"""About how many points times strokes a recipe gets, ..."""
MOST, LEAST = 20_000, 1_000
"""... and how many points at most and at least that are looked at in every way."""
RECIPES = 400
"""About how many recipes share all points; ..."""
PER_STROKE = 0.5
"""... the more strokes, the fewer points: this is the mean of 1/strokes."""
CHUNK = 1 << 17
"""Points that are solved at once, of many."""
MOST_ROWS = 1_500
"""No stroke is added to more substrokes than that, so that no recipe takes minutes."""
MOST_PIXELS = 20_000
"""Of images whose maps are looked at whole."""
CONVERGED = 1e-6
"""Pixels."""
ROUNDING = 2.0**-52
FAIR = 16.0
"""A point may be reported where rounding alone leaves more than a part of 1/FAIR of what is allowed."""


@dataclass
class Tally:
    """What was looked at, and what was found.

    Points that did not converge are ``reported``; images whose report says that the map is not as exact as asked for
    are ``beyond``; errors are parts of the tolerance, in the others.
    """

    points: int = 0
    recipes: int = 0
    strokes: int = 0
    refused: int = 0
    flowing: int = 0
    reported: int = 0
    worst_residual: float = 0.0
    images: int = 0
    pixels: int = 0
    beyond: int = 0
    reported_pixels: int = 0
    worst_error: float = 0.0
    violations: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """One for each number."""
        names = [f.name for f in fields(self) if f.name != "violations"]
        width = max(map(len, names))
        return [f"{name.replace('_', ' '):{width}} {getattr(self, name):,.6g}" for name in names]


def drawn(rng: np.random.Generator) -> tuple[Deformation, int]:
    """A random recipe on a random domain, and how many of its strokes were refused on the way."""
    ndim = int(rng.integers(2, 4))
    small = rng.uniform() < 0.3
    shape = rng.integers(1, 120 if small and ndim == 2 else 25 if small else 500, ndim)
    if rng.uniform() < 0.05:
        shape[rng.integers(ndim)] = 1
    spacing = np.ones(ndim) if rng.uniform() < 0.6 else np.exp(rng.uniform(-2.3, 2.3, ndim))
    d = Deformation(
        shape.tolist(),
        border=BORDERS[rng.integers(len(BORDERS))],
        border_profile="quartic" if rng.uniform() < 0.7 else "sine",
        spacing=spacing.tolist(),
        on_fold="flow" if rng.uniform() < 0.35 else "damp",
    )
    size, many, refused = shape[::-1] - 1.0, int(rng.choice(STROKES)), 0
    while len(d.strokes) < many and len(d.space.table) < MOST_ROWS and refused < 200:
        radius = float(np.exp(rng.uniform(0, np.log(2 * max(shape) + 2))) * spacing.min())
        at = rng.uniform(0, 1, ndim) * size
        where = rng.uniform()
        if where < 0.15:
            at = rng.uniform(-1, 2, ndim) * (size + 1)
        elif where < 0.3:
            axis = rng.integers(ndim)
            at[axis] = rng.choice([0.0, 1.0, 0.5, size[axis], size[axis] - 1])
        elif where < 0.4 and d.strokes:
            at = np.array(d.strokes[-1].at) + rng.choice([0.0, 1.0]) * np.array(d.strokes[-1].by)
        by = rng.normal(size=ndim) if rng.uniform() < 0.7 else rng.choice([-1.0, 0.0, 1.0], ndim)
        if not by.any():
            continue
        by *= radius * np.exp(rng.uniform(np.log(0.01), np.log(20))) / np.linalg.norm(by)
        try:
            stroke = Stroke.grab(
                at,
                by=by / spacing,
                radius=radius,
                poisson=float(rng.choice(POISSONS)),
                scales=int(rng.integers(1, 4)),
                reach=REACHES[rng.integers(len(REACHES))],
            )
            d = d.add(stroke, warn=False)  # many are outside, or held back
        except SuppleError:
            refused += 1
    return d, refused


def targets(d: Deformation, rng: np.random.Generator, many: int) -> Floats:
    """Points anywhere, outside, on faces, and near what was held and where it went."""
    size = np.array(d.shape[::-1]) - 1.0
    points = rng.uniform(0, 1, (many, d.ndim)) * size
    part = many // 5
    points[:part] = rng.uniform(-1, 2, (part, d.ndim)) * (size + 1)
    rows, axes = np.arange(part, 2 * part), rng.integers(0, d.ndim, part)
    faces = np.array(d.domain.faces) / np.array(d.domain.spacing)[:, None]
    points[rows, axes] = faces[axes, rng.integers(0, 2, part)]
    points[rows, axes] += rng.choice([0.0, 1e-9, -1e-9, 0.3, -0.3], part)
    if d.strokes:
        held = np.array([s.at for s in d.strokes]), np.array([s.by for s in d.strokes])
        which = rng.integers(0, len(d.strokes), 2 * part)
        away = rng.normal(size=(2 * part, d.ndim)) * np.exp(rng.uniform(-14, 0.7, (2 * part, 1)))
        away *= np.array([s.radius for s in d.strokes])[which][:, None] / np.array(d.domain.spacing)
        points[-2 * part :] = held[0][which] + rng.choice([0, 1, 0.5], (2 * part, 1)) * held[1][which] + away
    return points


def attainable(d: Deformation, points: Floats) -> Floats:
    """About how close to T(p), in pixels, rounding lets one come: what each stroke's input cannot tell apart is
    enlarged by all strokes that follow."""
    w = np.zeros((len(points), 3))
    w[:, : d.ndim] = points * d.domain.spacing
    left = np.zeros(len(points))
    rows = numbers(d.space.table)
    for k in range(len(rows)):
        _, matrices = _core.forward(rows[k:], d.space.axes, w, True)
        matrices = np.nan_to_num(matrices, nan=1e300, posinf=1e300, neginf=-1e300)
        left += np.linalg.norm(matrices, axis=(1, 2)) * np.linalg.norm(w, axis=1) * ROUNDING
        w, _ = _core.forward(rows[k : k + 1], d.space.axes, w, False)
    return np.asarray(left / min(d.domain.spacing))


def look_at_points(d: Deformation, rng: np.random.Generator, tally: Tally) -> list[str]:
    """Solve for random points, and for the images of others."""
    wrong = []
    many = int(np.clip(WORK // max(len(d.space.table), 1), LEAST, MOST)) // 2
    flows, finest = d.on_fold == "flow", min(d.domain.spacing)
    sources = targets(d, rng, many)
    q = np.concatenate([targets(d, rng, many), d.forward(sources)])
    found = d.inverse(q)
    tally.points += len(q)
    good = found.converged
    if not np.isfinite(found.points[good]).all():
        wrong.append("points that are not finite have converged")
    # Measured again, where the distance in pixels is bounded as it is reported.
    with np.errstate(all="ignore"):
        p = np.where(np.isfinite(found.points), found.points, 0.0)
        off = np.linalg.norm((d.forward(p) - q) * d.domain.spacing, axis=-1) / finest
    allowed = np.maximum(CONVERGED, 1e-14 * np.abs(q * d.domain.spacing).max(axis=-1) / finest)
    if good.any():
        tally.worst_residual = max(tally.worst_residual, float((off / allowed)[good].max()) * CONVERGED)
    bad = good & ~(off <= 1.1 * allowed)
    if flows and bad.any():  # handed out and taken back, points are rounded once more
        bad[bad] = ~(off[bad] <= allowed[bad] + FAIR * attainable(d, p[bad]))
    if bad.any():
        wrong.append(f"{bad.sum()} residuals, up to {off[bad].max():.3g} px, have been passed off")
    if not good.all():
        tally.reported += int((~good).sum())
        lost = ~good
        if flows:
            lost[lost] = ~(FAIR * attainable(d, p[lost]) > allowed[lost])
        if lost.any():
            worst = found.residual[lost].max()
            wrong.append(f"{lost.sum()} points did not converge (residual up to {worst:.3g} px)")
    # Nothing turns over, and nothing lands on anything else.
    everywhere = np.concatenate([sources, p])
    matrices = d.jacobian(everywhere)
    fine = np.concatenate([good[many:], good]) | (not flows)
    if (turned := fine & ~(np.linalg.det(matrices) > 0)).any():
        wrong.append(f"det ∂T/∂p ≤ 0 at {turned.sum()} points")
    inverse = 1 / np.linalg.svd(matrices[:many], compute_uv=False)[:, -1]
    away = np.linalg.norm(found.points[many:] - sources, axis=-1)
    ratio = max(d.domain.spacing) / finest
    if (other := good[many:] & ~(away <= 2 * ratio * allowed[many:] * (1 + inverse))).any():
        wrong.append(f"T⁻¹(T(p)) is not p at {other.sum()} points, by up to {away[other].max():.3g} px")
    return wrong


def determinants(m: Floats) -> Floats:
    """Of matrices (N, 3, 3), without the checks and copies of NumPy's."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    one = a[:, 0] * (b[:, 1] * c[:, 2] - b[:, 2] * c[:, 1])
    return np.asarray(
        one - a[:, 1] * (b[:, 0] * c[:, 2] - b[:, 2] * c[:, 0]) + a[:, 2] * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    )


def look_at_many(d: Deformation, rng: np.random.Generator, tally: Tally, many: int) -> list[str]:
    """Solve for so many random points at once: each is solved or reported, and none is folded."""
    lost_points = passed_off = turned = 0
    worst = 0.0
    rows, flows, finest = numbers(d.space.table), d.on_fold == "flow", min(d.domain.spacing)
    extent = np.zeros(3)
    extent[: d.ndim] = d.domain.extent
    for start in range(0, many, CHUNK):
        q = rng.random((min(CHUNK, many - start), 3))
        q *= 1.2 * extent
        q -= 0.1 * extent
        p, residual, _ = _core.inverse(d.space.map, q, 1e-9 * finest)
        moved, jacobian = _core.forward(rows, d.space.axes, p, True)
        moved -= q
        off = np.sqrt(np.einsum("ij,ij->i", moved, moved)) / finest
        allowed = np.maximum(CONVERGED, 1e-14 / finest * np.abs(q).max(axis=1))
        good = residual / finest <= allowed
        bad = good & ~(off <= 1.1 * allowed)
        lost = ~good
        folded = ~(determinants(jacobian) > 0)
        tally.points += len(q)
        tally.reported += int(lost.sum())
        tally.worst_residual = max(tally.worst_residual, float((off / allowed)[good].max(initial=0)) * CONVERGED)
        if flows:
            folded &= good
            doubtful = np.flatnonzero(bad | lost)
            room = FAIR * attainable(d, p[doubtful, : d.ndim] / d.domain.spacing)
            bad[doubtful] &= ~(off[doubtful] <= allowed[doubtful] + room)
            lost[doubtful] &= ~(room > allowed[doubtful])
        passed_off += int(bad.sum())
        lost_points += int(lost.sum())
        turned += int(folded.sum())
        worst = max(worst, float(off[bad | lost].max(initial=0)))
    found = {
        f"{passed_off} residuals, up to {worst:.3g} px, have been passed off": passed_off,
        f"{lost_points} points did not converge (residual up to {worst:.3g} px)": lost_points,
        f"det ∂T/∂p ≤ 0 at {turned} points": turned,
    }
    return [f"of {many} at once: {line}" for line, count in found.items() if count]


def look_at_map(d: Deformation, rng: np.random.Generator, tally: Tally) -> list[str]:
    """Whether all of the map is as exact as the report says."""
    wrong = []
    tolerance = float(rng.choice([1.0, 0.1, 0.01, 0.001]))
    with np.errstate(all="ignore"):
        report, found = d.report(tolerance=tolerance), d.inverse_map(tolerance=tolerance).astype(np.float64)
    axes = np.meshgrid(*[np.arange(n, dtype=np.float64) for n in d.shape], indexing="ij")
    true = d.inverse(np.stack(axes[::-1], axis=-1))
    tally.images += 1
    tally.pixels += true.converged.size
    tally.reported_pixels += report.unconverged
    rounding = np.spacing(np.abs(found).astype(np.float32)).astype(np.float64) / 2
    off = np.linalg.norm(np.maximum(np.abs(found - true.points) - rounding, 0), axis=-1)
    # What the comparison itself leaves open.
    inverse = (
        1 / np.linalg.svd(d.jacobian(np.where(np.isfinite(true.points), true.points, 0)), compute_uv=False)[..., -1]
    )
    off = (off - 1e-9 - inverse * true.residual)[true.converged]
    worst = float(off.max(initial=0.0))
    if report.unconverged == 0 and not worst <= report.error:
        wrong.append(f"the map is off by {worst:.3g} px, but {report.error:.3g} was said, at {tolerance:g}")
    if report.within:
        tally.worst_error = max(tally.worst_error, worst / tolerance)
    else:
        tally.beyond += 1
    if report.within != (report.error <= tolerance and report.unconverged == 0):
        wrong.append(f"within is {report.within} at {tolerance:g}, with {report.error:.3g} px")
    if d.on_fold == "damp" and (report.unconverged or not true.converged.all()):
        wrong.append(f"{report.unconverged} pixels of a damped map could not be measured")
    if report.folds and (d.on_fold == "damp" or report.within):
        wrong.append(f"{report.folds} nodes are folded")
    return wrong


def look_at_recipe(rng: np.random.Generator, tally: Tally, work: float) -> list[str]:
    """What is wrong with the next recipe, which gets about ``work`` points times strokes."""
    tally.recipes += 1
    d, refused = drawn(rng)
    tally.strokes += len(d.strokes)
    tally.refused += refused
    tally.flowing += d.on_fold == "flow"
    wrong = look_at_points(d, rng, tally)
    if math.prod(d.shape) * max(1, len(d.space.table) // 20) <= MOST_PIXELS:
        wrong += look_at_map(d, rng, tally)
    wrong += look_at_many(d, rng, tally, int(work / max(len(d.space.table), 1)))
    return [f"{line} ({d.on_fold}, {len(d.strokes)} strokes)" for line in wrong]


def soak(points: int, seed: int = 1, seconds: float = math.inf, show: bool = False) -> Tally:
    """Look at recipe after recipe, each drawn from its own seed, until there were so many points."""
    tally, start, work = Tally(), time.monotonic(), points / (RECIPES * PER_STROKE)
    shown = start
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        warnings.simplefilter("ignore", ToleranceWarning)
        while tally.points < points and time.monotonic() - start < seconds:
            try:
                wrong = look_at_recipe(np.random.default_rng(seed), tally, work)
            except Exception as error:  # of no kind are there any to be
                wrong = [f"{type(error).__name__}: {error}"]
            tally.violations += [f"seed {seed}: {line}" for line in wrong]
            if show and wrong:
                print("\n".join(tally.violations[-len(wrong) :]), flush=True)
            seed += 1
            if show and time.monotonic() - shown > 10:
                shown = time.monotonic()
                print(f"{tally.points:,} points, {len(tally.violations)} violations", flush=True)
    return tally


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000_000, help="how many points at least")
    parser.add_argument("--seed", type=int, default=1, help="of the first recipe; the next ones' follow")
    parser.add_argument("--seconds", type=float, default=math.inf, help="when to stop, done or not")
    args = parser.parse_args()
    began = time.monotonic()
    tally = soak(args.points, args.seed, args.seconds, show=True)
    took = time.monotonic() - began
    print("\n".join(tally.lines()))
    print(f"{took:.0f} s: {tally.points / max(took, 1e-3) / 1e6:.2f} million points a second")
    print(f"{len(tally.violations)} violations" if tally.violations else "no violations")
    if tally.violations:
        print("look at one recipe again: python tests/soak.py --points 1 --seed N")
    return 1 if tally.violations else 0


if __name__ == "__main__":
    sys.exit(main())
