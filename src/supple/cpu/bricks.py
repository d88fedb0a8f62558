"""Where a volume can be seen at all: bricks of it, and how far one may go through empty ones.

A brick holds the voxels between which its points lie: BRICK + 1 along each axis, of which the last are its
neighbour's first.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.kernel import kernel

BRICK, FINE = 4, 2
FARTHEST = 255


@kernel
def ranges(samples, size, brick, lows, highs):
    """The smallest and the largest sample of bricks, each ``brick`` voxels wide; ``size`` is (nx, ny, nz)."""
    nx, ny, nz = size[0], size[1], size[2]
    deep, high, wide = lows.shape
    for c in range(deep):
        for b in range(high):
            for a in range(wide):
                low, top = np.float32(np.inf), np.float32(-np.inf)
                for k in range(c * brick, min(c * brick + brick + 1, nz)):
                    for j in range(b * brick, min(b * brick + brick + 1, ny)):
                        row = (k * ny + j) * nx
                        for i in range(a * brick, min(a * brick + brick + 1, nx)):
                            value = np.float32(samples[row + i])
                            low, top = min(low, value), max(top, value)
                lows[c, b, a], highs[c, b, a] = low, top


@kernel
def seen(lows, highs, window, scale, visible):
    """Which bricks have values that are seen.

    ``window`` is the lowest and the highest value that is seen at all, ``scale`` the value of the first entry of a
    transfer function and entries a value, and ``visible`` counts the entries before each that are not transparent.
    """
    deep, high, wide = lows.shape
    out = np.empty(lows.shape, np.bool_)
    end = np.float32(visible.shape[0] - 2)
    for c in range(deep):
        for b in range(high):
            for a in range(wide):
                low, top = max(lows[c, b, a], window[0]), min(highs[c, b, a], window[1])
                first = np.int64(min(max(np.rint((low - scale[0]) * scale[1]), np.float32(0.0)), end))
                last = np.int64(min(max(np.rint((top - scale[0]) * scale[1]), np.float32(0.0)), end))
                out[c, b, a] = low <= top and visible[max(first, last) + 1] > visible[first]
    return out


@kernel
def distances(seen):
    """How many bricks each one is from the nearest that is seen, diagonals counting as one; at most FARTHEST."""
    deep, high, wide = seen.shape
    out = np.empty(seen.shape, np.uint8)
    for c in range(deep):
        for b in range(high):
            for a in range(wide):
                out[c, b, a] = 0 if seen[c, b, a] else FARTHEST
    # Forwards and backwards, from the neighbours that are done: exact for this distance.
    for way in range(2):
        for cc in range(deep):
            c = cc if way == 0 else deep - 1 - cc
            for bb in range(high):
                b = bb if way == 0 else high - 1 - bb
                for aa in range(wide):
                    a = aa if way == 0 else wide - 1 - aa
                    least = np.int64(out[c, b, a])
                    for dc in range(-1, 2):
                        for db in range(-1, 2):
                            for da in range(-1, 2):
                                before = 9 * dc + 3 * db + da
                                if (before < 0) != (way == 0) or before == 0:
                                    continue
                                k, j, i = c + dc, b + db, a + da
                                if 0 <= k < deep and 0 <= j < high and 0 <= i < wide:
                                    least = min(least, np.int64(out[k, j, i]) + 1)
                    out[c, b, a] = least
    return out


@kernel
def moved(seen, brick, nodes, per_voxel, size, out):
    """Which bricks of the deformed volume show any that is seen of the volume's own, by bounds of their displacement.

    Those are ``brick`` voxels wide: narrower ones tell better, as a moved brick lies across several.

    ``nodes`` is the lattice of T⁻¹ (`supple.cpu.solid`), in voxels.
    """
    deep, high, wide = seen.shape
    # Sums over all bricks before, so that any box of them is eight numbers.
    sums = np.zeros((deep + 1, high + 1, wide + 1), np.int64)
    for c in range(deep):
        for b in range(high):
            for a in range(wide):
                sums[c + 1, b + 1, a + 1] = (
                    np.int64(seen[c, b, a])
                    + sums[c, b + 1, a + 1]
                    + sums[c + 1, b, a + 1]
                    + sums[c + 1, b + 1, a]
                    - sums[c, b, a + 1]
                    - sums[c, b + 1, a]
                    - sums[c + 1, b, a]
                    + sums[c, b, a]
                )
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    least, most = np.empty(nodes.shape[3]), np.empty(nodes.shape[3])
    for c in range(out.shape[0]):
        for b in range(out.shape[1]):
            for a in range(out.shape[2]):
                place = (a, b, c)
                for axis in range(3):
                    n = nodes.shape[2 - axis]
                    low = place[axis] * BRICK
                    first[axis] = min(max(int(np.floor(low * per_voxel)), 0), n - 1)
                    last[axis] = min(int(np.ceil(min(low + BRICK, size[axis] - 1) * per_voxel)), n - 1)
                for field in range(nodes.shape[3]):
                    least[field], most[field] = np.inf, -np.inf
                for k in range(first[2], last[2] + 1):
                    for j in range(first[1], last[1] + 1):
                        for i in range(first[0], last[0] + 1):
                            for field in range(nodes.shape[3]):
                                value = np.float64(nodes[k, j, i, field])
                                least[field], most[field] = min(least[field], value), max(most[field], value)
                for axis in range(3):
                    # What the slopes add to the lines between nodes; and a little more, as points are of float32.
                    bent = 0.01
                    for m in range(4 + axis, 16, 4):
                        bent += 0.125 / per_voxel * (most[m] - least[m])
                    p = (place[axis] * BRICK + least[axis] - bent) / brick
                    q = (place[axis] * BRICK + BRICK + most[axis] + bent) / brick
                    n = seen.shape[2 - axis]
                    first[axis] = min(max(int(np.floor(p)), 0), n - 1)
                    last[axis] = min(max(int(np.floor(q)), 0), n - 1) + 1
                x0, y0, z0, x1, y1, z1 = first[0], first[1], first[2], last[0], last[1], last[2]
                total = (
                    sums[z1, y1, x1]
                    - sums[z0, y1, x1]
                    - sums[z1, y0, x1]
                    - sums[z1, y1, x0]
                    + sums[z0, y0, x1]
                    + sums[z0, y1, x0]
                    + sums[z1, y0, x0]
                    - sums[z0, y0, x0]
                )
                out[c, b, a] = total > 0
