"""Random displacement fields, and an evaluation of them that shares nothing with the core's: scipy's."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.stats import special_ortho_group

from supple.fields import Field, Inverted
from supple.space.geometry import Grid

Floats = npt.NDArray[np.float64]
OPTIONS = [(i, b, d) for i in ("linear", "cubic", "bspline") for b in ("zero", "edge") for d in ("f4", "f8")]


def drawn_grid(rng: np.random.Generator, shape: tuple[int, ...], *, plain: bool = False) -> Grid:
    n = len(shape)
    if plain:
        return Grid(shape)
    turned = special_ortho_group.rvs(n, random_state=rng)
    return Grid(shape, rng.uniform(0.4, 2.0, n).tolist(), rng.normal(size=n).tolist(), turned)


def drawn(
    rng: np.random.Generator,
    grid: Grid,
    steepness: float,
    *,
    width: float = 2.0,
    interpolation: Any = "linear",
    beyond: Any = "zero",
    dtype: str = "f8",
) -> Field:
    """Return a field whose steepest slope is below the one given, in samples; above 1, it may fold."""
    n, shape = grid.ndim, grid.shape
    sigma = [0.0 if size == 1 else width for size in shape]
    made = np.stack([ndimage.gaussian_filter(rng.normal(size=shape), sigma) for _ in range(n)], -1)
    slopes = [float(np.linalg.norm(np.diff(made, axis=k), axis=-1).max()) for k in range(n) if shape[k] > 1]
    made *= steepness / (n**0.5 * max(slopes, default=1.0))
    return Field((made @ grid.matrix[:n, :n].T).astype(dtype), grid, interpolation, beyond)


def along_x(places: npt.ArrayLike, rows: int = 4, **options: Any) -> Field:
    """Return the field that takes sample k of each row to a place: exact where it is linear."""
    given = np.asarray(places, np.float64)
    values = np.zeros((rows, len(given), 2))
    values[..., 0] = given - np.arange(len(given))
    return Field.from_array(values, **options)


def solutions(places: Floats, y: float) -> tuple[list[float], list[float]]:
    """Return all x with f(x) = y, and the slopes there, of a function that is linear between its places."""
    found, slopes = [], []
    if y < places[0]:
        found.append(y - places[0])
        slopes.append(1.0)
    for k, (a, b) in enumerate(itertools.pairwise(places)):
        if min(a, b) <= y <= max(a, b) and a != b:
            found.append(k + (y - a) / (b - a))
            slopes.append(b - a)
    if y > places[-1]:
        found.append(len(places) - 1 + y - places[-1])
        slopes.append(1.0)
    return found, slopes


def on_grid(field: Field, positions: Floats, slack: float = 0.0) -> npt.NDArray[np.bool_]:
    own = field.interpolation == "bspline"
    index, sizes = field.grid.indices(positions), np.array(field.grid.sizes)
    low, high = (1.0, sizes - 2.0) if own else (-0.5, sizes - 0.5)
    return np.asarray(((index >= low - slack) & (index <= high + slack)).all(axis=-1))


def moved(field: Field, positions: Floats, *, beyond: str | None = None) -> Floats:
    """Return x + u(x) by scipy."""
    n, own = field.ndim, field.interpolation == "bspline"
    sizes = np.array(field.grid.sizes)
    index = field.grid.indices(positions)
    index = np.clip(index, 1.0 if own else 0.0, sizes - (2.0 if own else 1.0))
    order, values = (1 if field.interpolation == "linear" else 3), field.values.astype(np.float64)
    if field.interpolation == "cubic":
        for axis in range(n):
            if values.shape[axis] > 1:
                values = ndimage.spline_filter1d(values, 3, axis, mode="mirror")
    u = np.stack(
        [
            ndimage.map_coordinates(values[..., a], index[..., ::-1].T, order=order, mode="mirror", prefilter=False)
            for a in range(n)
        ],
        -1,
    )
    if (beyond or field.beyond) == "zero":
        u = np.where(on_grid(field, positions)[:, None], u, 0.0)
    return np.asarray(positions + u)


def positions_of(grid: Grid) -> Floats:
    index = np.indices(grid.shape).reshape(grid.ndim, -1)[::-1].T
    return grid.positions(index)


def settled(field: Field, targets: Floats, guess: Floats) -> Floats:
    """Return the solutions of x + u(x) = y for a field whose slope is below 1, by fixed points: these cannot fail."""
    found = guess.copy()
    for _ in range(200):
        step = moved(field, found, beyond="edge") - targets
        found -= step
        if np.abs(step).max(initial=0.0) < 1e-14 * (1 + np.abs(targets).max(initial=0.0)):
            break
    return found


def checked(field: Field, found: Inverted, tolerance: float) -> int:
    """Check all samples called ok of a field whose slope is below 1, and return how many there are."""
    targets, ok = positions_of(found.field.grid), found.status.ravel() == 0
    u = found.field.values.reshape(-1, field.ndim)[ok].astype(np.float64)
    stays = ~on_grid(field, targets[ok], -1e-9) & (u == 0).all(axis=1) if field.beyond == "zero" else u[:, 0] != u[:, 0]
    truth = settled(field, targets[ok], targets[ok] + u)
    off = truth - targets[ok] - u
    grain = 1e-9 + 1e-6 * float(np.abs(field.values).max()) * (field.values.dtype == np.float32)
    far = np.linalg.norm(off, axis=1) > found.error.ravel()[ok] * (1 + 1e-6) + grain
    steps = np.linalg.norm(off @ np.linalg.inv(field.grid.matrix[:-1, :-1]).T, axis=1)
    loose = steps > tolerance + grain / min(field.grid.spacing)
    assert not (far & ~stays).any(), f"{int((far & ~stays).sum())} samples are farther off than their error"
    assert not (loose & ~stays).any(), f"{int((loose & ~stays).sum())} samples are farther off than the tolerance"
    if field.beyond == "zero":
        assert (stays | on_grid(field, truth, 1e-6)).all(), "solutions lie beyond the grid"
    return int(ok.sum())
