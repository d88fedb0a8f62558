"""T⁻¹ in a volume: solved at the nodes of a cubic lattice, interpolated in between, and certified.

For pictures of a volume, which need source points anywhere and not only on its planes. A node knows the displacement
u and, exactly, its slopes G = ∂u/∂q. Along each axis, at a part s of the way h from a node to the next, the line
between their values is off by half of s (1 - s) h (G₀ - G₁), up to the third order: with that, little more than the
nodes of a cell is read, and the error falls with the cube of h at least. It is halved until what the checks see
is good enough.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from supple.cpu.blend import displaced, turned
from supple.cpu.field import X, Y, Z, apply
from supple.cpu.kernel import BATCH, kernel, lean, share
from supple.cpu.lattice import NODE, RESERVE, RESOLVED, SMOOTH, M, U, solve_rows
from supple.cpu.newton import QX, QY, QZ, ROWS

Floats = npt.NDArray[np.float64]

FIELDS = 16  # of a node: u, and the columns of ∂p/∂q, each with a 0, as `supple.cpu.blend` takes them
COARSEST, FINEST = 8, 2  # voxels from node to node: a finer lattice would be larger than the volume
# Where a cell is looked at: its middle, those of its faces and edges at one corner, and of its eighths.
_SEEN = np.array(
    [*(p for p in itertools.product((0.5, 0.0), repeat=3) if any(p)), *itertools.product((0.25, 0.75), repeat=3)]
)


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """The inverse displacements of a volume.

    Parameters
    ----------
    nodes : float32 array, shape (nz, ny, nx, 16)
        The displacement T⁻¹(q) - q in voxels, x first, and the columns of ∂p/∂q; each followed by a 0.
    step : int
        Voxels from node to node; the first is the first voxel.
    error : float
        How far a source point is from the true T⁻¹(q), in voxels, as far as the checks see, with their reserve;
        infinity where even the finest lattice is too coarse for them to see anything.
    evaluations : float
        Of T with its Jacobian.
    """

    nodes: npt.NDArray[np.float32]
    step: int
    error: float
    evaluations: float


def solve_solid(
    table: npt.NDArray[np.void],
    axes: Floats,
    shape: tuple[int, ...],
    tolerance: float,
    attempt: Callable[[int], tuple[Solid, float]] | None = None,
) -> Solid:
    """Solve for T⁻¹ on a lattice in a volume of ``shape`` (Z, H, W), as fine as the tolerance needs, in voxels.

    The error says whether the finest was enough. ``attempt`` is what solves with so many voxels from node to node, and
    tells the least length over which the map varies; these kernels, by default.
    """
    step, evaluations = COARSEST, 0.0
    while True:
        solid, smooth = attempt(step) if attempt else _solve(table, axes, shape, step)
        evaluations += solid.evaluations
        # What is seen at points says little where the map varies between them.
        resolved = step <= RESOLVED * smooth
        if (solid.error <= tolerance and resolved) or step == FINEST:
            return Solid(solid.nodes, step, solid.error if resolved else math.inf, evaluations)
        # The error falls with the cube of the step.
        finer = min(step * (tolerance / max(solid.error, tolerance)) ** (1 / 3), max(RESOLVED * smooth, FINEST))
        step = max(FINEST, min(step // 2, 2 ** math.floor(math.log2(max(finer, 1.0)))))


def _solve(table: npt.NDArray[np.void], axes: Floats, shape: tuple[int, ...], step: int) -> tuple[Solid, float]:
    """A lattice, and the least length, in voxels, over which the map varies at a node."""
    xs, ys, zs = (np.arange(0, max(n - 1, 1) + step, step, dtype=np.int64) for n in reversed(shape))
    nodes = np.zeros((zs.size, ys.size, xs.size, FIELDS), np.float32)

    def layer(k: int) -> tuple[float, float]:
        own = np.empty((ys.size, xs.size, NODE))
        spent = float(solve_rows(table, axes, float(zs[k]), xs, ys, 0, ys.size, own))
        nodes[k, :, :, :3] = own[..., U : U + 3]
        for c in range(3):
            nodes[k, :, :, 4 * c + 4 : 4 * c + 7] = own[..., M + c : M + 9 : 3]
        return spent, float(own[..., SMOOTH].min())

    layers = share(layer, range(zs.size))

    def look(k: int) -> float:
        return float(_check(table, axes, nodes, step, k, _SEEN))

    worst = max(share(look, range(zs.size - 1)))
    return Solid(nodes, step, worst, sum(spent for spent, _ in layers)), min(smooth for _, smooth in layers)


@lean
def _cell_of(nodes, per_voxel, x, y, z):
    """The cell that a point lies in, given in voxels, and where in it; ``per_voxel`` are the nodes per voxel."""
    zero = np.float32(0.0)
    sx = min(max(x * per_voxel, zero), np.float32(nodes.shape[2] - 1))
    sy = min(max(y * per_voxel, zero), np.float32(nodes.shape[1] - 1))
    sz = min(max(z * per_voxel, zero), np.float32(nodes.shape[0] - 1))
    i = min(np.int32(sx), np.int32(nodes.shape[2] - 2))
    j = min(np.int32(sy), np.int32(nodes.shape[1] - 2))
    k = min(np.int32(sz), np.int32(nodes.shape[0] - 2))
    return i, j, k, sx - np.float32(i), sy - np.float32(j), sz - np.float32(k)


@lean
def displacement(nodes, per_voxel, x, y, z):
    """T⁻¹(q) - q at a point, in voxels."""
    i, j, k, u, v, w = _cell_of(nodes, per_voxel, x, y, z)
    one, half = np.float32(1.0), np.float32(0.5) / per_voxel
    row, layer = nodes.shape[2] * FIELDS, nodes.shape[1] * nodes.shape[2] * FIELDS
    place = k * layer + j * row + i * FIELDS
    bu, bv, bw = half * u * (one - u), half * v * (one - v), half * w * (one - w)
    return displaced(nodes, place, row, layer, u, v, w, bu, bv, bw)


@lean
def transposed(nodes, per_voxel, x, y, z, fx, fy, fz):
    """(∂p/∂q)ᵀ f at a point."""
    i, j, k, u, v, w = _cell_of(nodes, per_voxel, x, y, z)
    row, layer = nodes.shape[2] * FIELDS, nodes.shape[1] * nodes.shape[2] * FIELDS
    return turned(nodes, k * layer + j * row + i * FIELDS, row, layer, u, v, w, fx, fy, fz)


@kernel
def _check(table, axes, nodes, step, k, seen):
    """The worst error, in voxels, that is seen in a layer of cells."""
    w = np.empty(ROWS * BATCH)
    high, wide = nodes.shape[1] - 1, nodes.shape[2] - 1
    sx, sy, sz = axes[0, 2], axes[1, 2], axes[2, 2]
    cells, points = high * wide, seen.shape[0]
    together = BATCH // points
    worst = 0.0
    m = np.empty(FIELDS)
    for start in range(0, cells, together):
        n = min(together, cells - start)
        for e in range(n):
            j, i = (start + e) // wide, (start + e) % wide
            for s in range(points):
                at = e * points + s
                x, y, z = (i + seen[s, 0]) * step, (j + seen[s, 1]) * step, (k + seen[s, 2]) * step
                w[QX + at], w[QY + at], w[QZ + at] = x * sx, y * sy, z * sz
                dx, dy, dz = displacement(nodes, np.float32(1.0 / step), np.float32(x), np.float32(y), np.float32(z))
                w[X + at], w[Y + at], w[Z + at] = w[QX + at] + dx * sx, w[QY + at] + dy * sy, w[QZ + at] + dz * sz
        apply(w, n * points, table, axes, 0, table.shape[0], False)
        for e in range(n):
            j, i = (start + e) // wide, (start + e) % wide
            for c in range(FIELDS):
                m[c] = 0.5 * (np.float64(nodes[k, j, i, c]) + np.float64(nodes[k + 1, j + 1, i + 1, c]))
            for s in range(points):
                at = e * points + s
                ex, ey, ez = (
                    (w[X + at] - w[QX + at]) / sx,
                    (w[Y + at] - w[QY + at]) / sy,
                    (w[Z + at] - w[QZ + at]) / sz,
                )
                error = 0.0
                for c in range(3):
                    value = m[4 + c] * ex + m[8 + c] * ey + m[12 + c] * ez
                    error += value * value
                worst = max(worst, error)
    return RESERVE * np.sqrt(worst)


def unmoved() -> npt.NDArray[np.float32]:
    """A lattice for volumes that nothing moves."""
    return np.zeros((2, 2, 2, FIELDS), np.float32)
