"""Plots of a deformation on a plane of a volume: lines of the input, or the change of volume, over the warped slice."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import Sampling
from supple.fields import Field, warn_of_maps
from supple.plot import planes
from supple.plot.frame import bar, check_plot, edges_of, save, sheet, title
from supple.space.geometry import Floats, Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WHATS = ("grid", "stretch")
_PANEL, _LINES, _BLUE = 6.0, 24, "#33628d"
_COARSE = 20  # samples along an axis at which displacements are compared, to find the plane that moves most


def draw_volume(
    deformation: Deformation,
    what: str,
    samples: npt.NDArray[Any],
    own: Grid,
    path: str | os.PathLike[str],
    *,
    out: Grid | None = None,
    plane: str | None = None,
    labels: bool = False,
    name: str = "The volume",
    force: bool = False,
) -> None:
    """Write a plot of a deformation on a plane of the deformed volume to a PNG, SVG or PDF file.

    Parameters
    ----------
    deformation : Deformation
        Of the volume.
    what : str
        ``"grid"``: evenly spaced planes of the input, as lines; or ``"stretch"``: the natural logarithm of det ∂T/∂p,
        the volume around a point in the output over that in the input.
    samples : array (Z, Y, X) or (Z, Y, X, C)
        The volume, on the grid ``own``; ``labels`` are sampled without mixing them.
    out : Grid, optional
        The grid of the output; by default, the volume's.
    plane : str, optional
        As in `supple.plot.planes.chosen`; by default, the axial slice that moves most, apart from affine maps.
    name : str
        For the title.
    """
    check_plot(path, force=force)
    grid, home, maps = out or own, deformation.grid, deformation.maps
    known = [each for each in maps if not isinstance(each.map, Field)]
    bends = deformation.strokes or len(known) < len(maps)  # false if there are affine maps alone
    affine = Deformation(home, border=None).behind(known if bends else ())

    def moves(through: int) -> Floats:  # the mean displacement of each slice's samples, in millimetres
        axes = [np.unique(np.linspace(0, n - 1, min(n, _COARSE)).round()) for n in grid.sizes]
        axes[through] = np.arange(grid.sizes[through], dtype=np.float64)
        points = grid.positions(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))
        both = (each.inverse(home.indices(points)).points for each in (deformation, affine))
        found, plain = map(home.positions, both)
        far = np.linalg.norm(found - plain, axis=1).reshape([len(axis) for axis in axes])
        return np.asarray(far.mean(axis=tuple(k for k in range(3) if k != through)))

    seen = planes.chosen(grid, plane, moves)
    part = seen.part
    mixed = "nearest" if labels else "linear"
    slab, certificate = warp_array(samples, deformation.space_on(part, own), Sampling(mixed))
    warn_of_maps(certificate, 0.01, maps)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in part.sizes[::-1]), indexing="ij")[::-1], axis=-1)
    places = part.positions(index.reshape(-1, 3).astype(np.float64))
    points = deformation.inverse(deformation.grid.indices(places)).points
    source = deformation.grid.positions(points)
    picture = seen.seen(slab.mean(axis=3) if slab.ndim > 3 else slab, 0)
    lines = seen.seen((own.indices(source) * own.spacing).reshape(index.shape), 0)
    made = _figure(deformation, what, seen, picture, lines, points, own)
    far = float(np.linalg.norm(source - places, axis=1).max())
    title(made, f"{name}: {seen.text}\ndisplacement on it up to {far:.3g} mm")
    save(made, path, force=force)


def _figure(
    deformation: Deformation,
    what: str,
    plane: planes.Plane,
    slab: npt.NDArray[Any],
    source: Floats,
    points: Floats,
    own: Grid,
) -> Figure:
    from matplotlib.colors import TwoSlopeNorm

    (height, width), (sx, sy) = slab.shape, plane.steps
    box = edges_of(slab.shape, plane.steps)
    tall = min(max(height * sy / (width * sx), 0.4), 1.6) * _PANEL
    made, (axes,) = sheet(_PANEL + (2.0 if what == "stretch" else 1.0), tall + 1.3, 1, 1)
    known = slab[np.isfinite(slab)].astype(np.float64)
    low, high = np.percentile(known, (0.5, 99.5)) if known.size else (0.0, 1.0)
    axes.imshow(slab, extent=box, cmap="gray", vmin=low, vmax=max(high, low + 1e-9), interpolation="nearest")
    if what == "grid":
        x, y = np.arange(width) * sx, np.arange(height) * sy
        longest = max(n * s for n, s in zip(own.sizes, own.spacing, strict=True))
        power = 10.0 ** math.floor(math.log10(longest / _LINES))
        step = power * next(k for k in (1, 2, 5, 10) if k * power >= longest / _LINES)
        turned = np.abs(np.array(own.direction).T @ plane.ways.T).max(axis=1)  # not the axis across the plane
        for axis in np.argsort(-turned)[:2].tolist() if min(slab.shape) > 1 else ():
            values = source[..., axis]
            levels = np.arange(math.ceil(values.min() / step), math.floor(values.max() / step) + 1) * step
            if len(levels):
                axes.contour(x, y, values, levels, colors="#ffd400", linewidths=0.7)
        text = f"Planes of the input every {step:g} mm, as the output shows them"
    else:
        volumes = np.linalg.det(deformation.jacobian(points)).reshape(plane.part.shape)
        values = np.log(np.maximum(plane.seen(volumes, 0), 1e-6))
        reach = max(float(np.percentile(np.abs(values), 99.5)), 0.02)
        drawn = axes.imshow(
            values, extent=box, norm=TwoSlopeNorm(0.0, -reach, reach), cmap="RdBu_r", alpha=0.7, interpolation="nearest"
        )
        extend: Any = "both" if np.abs(values).max() > 1.001 * reach else "neither"
        bar(made, drawn, axes, "ln(output volume / input volume)", extend)
        text = f"Change of volume: {np.exp(values.min()):.2f} to {np.exp(values.max()):.2f} times"
    planes.set_up(axes, plane, box, text)
    return made
