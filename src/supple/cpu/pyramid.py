"""A tile at half, a quarter, … of its resolution: each level averages two by two samples of the one before."""

from __future__ import annotations

import numpy as np

from supple.cpu.kernel import colour_kernel as kernel


@kernel
def levels_for(squared, widest):
    """How often a footprint, given by the square of its minor axis, has to be halved to be no wider than that."""
    level, unit = 0, 1.0
    while squared > widest * widest * unit * unit and level < 12:
        level, unit = level + 1, 2.0 * unit
    return level


@kernel
def build(tile, wide, tall, lanes, coarsest):
    """Append the levels 1 to ``coarsest`` to a flat tile, whose sides they must divide.

    Returns where each level starts in it, and how many samples its rows have.
    """
    starts, widths = np.zeros(coarsest + 1, np.int64), np.empty(coarsest + 1, np.int64)
    widths[0] = wide
    for level in range(1, coarsest + 1):
        fine, starts[level] = starts[level - 1], starts[level - 1] + wide * tall * lanes
        stride, wide, tall = wide * lanes, wide // 2, tall // 2
        widths[level] = wide
        for y in range(tall):
            for x in range(wide):
                for c in range(lanes):
                    a = fine + 2 * y * stride + 2 * x * lanes + c
                    total = tile[a] + tile[a + lanes] + tile[a + stride] + tile[a + stride + lanes]
                    tile[starts[level] + (y * wide + x) * lanes + c] = total / 4
    return starts, widths
