"""Bounds on the frames needed for the planes of a stack, from the nodes of their lattices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.base import LONGEST, SLACK, SUPPORT, Sampling, frames_needed
from supple.engines.cuda.kernel import THREADS, blocks, launched
from supple.engines.cuda.lattice import solve
from supple.engines.cuda.reach import COVERED, FAR, FOUND, LEAST, MOST, bound
from supple.engines.cuda.sample import EARLY, LATE
from supple.engines.cuda.warp import Lattice, Pieces

Floats = npt.NDArray[np.float64]
Range = tuple[int, int]


class Needs:
    """Bounds on the frames needed for planes.

    Parameters
    ----------
    count : int
        The number of frames.
    sampling : Sampling
    early, late : float64 array, shape (count,)
        The first and the last time that each plane may read.

    Attributes
    ----------
    more : int
        The number of frames added before and after: nodes do not bound the map within rough cells.
    """

    def __init__(self, count: int, sampling: Sampling, early: Floats, late: Floats) -> None:
        self.more = 0
        self._count, self._sampling = count, sampling
        self._early, self._late = early, late

    def of(self, planes: Range) -> Range:
        """Return the range of frames that a range of planes may read."""
        support = SUPPORT[self._sampling.between]
        first = math.floor(self._early[slice(*planes)].min()) - support + 1 - self.more
        last = math.floor(self._late[slice(*planes)].max()) + support + self.more
        low, high = frames_needed(first, last, self._count, self._sampling.outside)
        return low, high + 1


def needs_of(
    stream: Any, lattice: Lattice, pieces: Pieces, count: int, sampling: Sampling, how: tuple[int, ...]
) -> Needs:
    """Solve the nodes of all planes of a stack, and compute their bounds; it waits for the results.

    Parameters
    ----------
    stream : numba.cuda stream
    lattice, pieces, how
        The arguments of the kernels.
    count : int
        The number of frames.
    sampling : Sampling
    """
    from numba import cuda

    found = np.zeros((count, FOUND), np.float32)
    found[:, LEAST], found[:, MOST] = FAR, -FAR
    there = cuda.to_device(found.reshape(-1), stream=stream)
    for first in range(0, count, pieces.together):
        n = min(pieces.together, count - first)
        launched(solve, blocks(n * lattice.nodes), THREADS, stream)(
            lattice.known, lattice.spans, lattice.deformations, lattice.xs, lattice.ys, n, first, 1,
            pieces.nodes, pieces.told, pieces.counts,
        )  # fmt: skip
        launched(bound, blocks(n * (lattice.size[0] - 1)), THREADS, stream)(
            lattice.xs, lattice.ys, n, first, pieces.nodes, there
        )
    seen = there.copy_to_host(stream=stream)
    stream.synchronize()
    return Needs(count, sampling, *times_of(seen.reshape(count, FOUND), sampling, how))


def times_of(found: npt.NDArray[np.float32], sampling: Sampling, how: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Return the first and the last time that each plane may read.

    Parameters
    ----------
    found : float32 array, shape (planes, FOUND)
        The results of `supple.engines.cuda.reach.bound`.
    sampling : Sampling
    how : tuple of int
        The argument of the kernels.
    """
    z = np.arange(len(found), dtype=np.float64)
    known = (found[:, LEAST] <= found[:, MOST]) & np.isfinite(found).all(axis=1)
    early, late = (np.where(known, z + found[:, k], z) for k in (LEAST, MOST))
    averages = sampling.time_filter and sampling.between in ("linear", "cubic") and sampling.filter != "nearest"
    wide = np.minimum(1.5 * found[:, COVERED], LONGEST) / 2 if averages else 0.0
    wide = np.where(known, wide, 0.0)
    return (
        np.clip(early - SLACK, how[EARLY], how[LATE]) - wide,
        np.clip(late + SLACK, how[EARLY], how[LATE]) + wide,
    )
