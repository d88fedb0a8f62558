"""A deformed volume, computed brick by brick beside its source."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from supple.gpu.memory import download, owned, room
from supple.gpu.shader import BLOCK, MOST_GROUPS, Pace, shader, source
from supple.gpu.solid import Lattice
from supple.gpu.volume import Volume


class Filling:
    """The buffer of a deformed volume, and its filled part.

    It is always computed from the original volume and all strokes. Another filling of the same volume replaces this
    one, which starts again when it is next used.

    Parameters
    ----------
    volume : Volume
        A volume with room for the buffer.
    lattice : Lattice
    polished : bool
        Whether each voxel is refined by Newton's method, where the lattice alone is not accurate enough.
    tolerance : float
        The tolerance of source points, in voxels.
    """

    def __init__(self, volume: Volume, lattice: Lattice, *, polished: bool, tolerance: float) -> None:
        self._volume, self._lattice = volume, lattice
        self._tolerance = tolerance
        self._bricks = math.prod(-(-n // BLOCK) for n in volume.size)
        self._made = 0
        self._pace = Pace(1)
        self._key = object()  # not ``self``: a reference cycle would hold the device's memory
        chosen = lattice.constants | {"LABELLED": volume.labelled, "POLISHED": polished}
        self._shader = shader(volume.gpu, source("fill", volume.voxel), "fill", chosen)
        self._target = volume.warped.create_view()

    @property
    def part(self) -> float:
        """The filled part, from 0 to 1."""
        return self._made / self._bricks if self._volume.owner is self._key else 0.0

    def advance(self, seconds: float = math.inf) -> float:
        """Fill bricks for about this long; return the filled part.

        Raises
        ------
        ArithmeticError
            If points could not be solved to the tolerance in float32.
        """
        if self._volume.owner is not self._key:
            self._volume.owner, self._made = self._key, 0
        gpu, start = self._volume.gpu, self._made
        with owned(room(gpu, 4)) as (lost,):
            for first, count in self._pace.parts(self._bricks - start, min(seconds, 0.25), seconds):
                self._make(start + first, count, lost)
                if download(gpu, lost, np.uint32, 1)[0]:  # waits
                    raise ArithmeticError("voxels could not be solved in its numbers")
                self._made = start + first + count
        return self.part

    def prepare(self) -> None:
        """Run for no brick, since some devices compile only at the first run."""
        with owned(room(self._volume.gpu, 4)) as (lost,):
            self._make(0, 0, lost)

    def _make(self, first: int, count: int, lost: Any) -> None:
        volume, lattice = self._volume, self._lattice
        settings = {"size": volume.size, "first": first, "count": count, "tolerance": self._tolerance}
        rows = max(1, -(-count // MOST_GROUPS))
        given = {"voxels": volume.samples, "warped": None, "lost": lost, "made": self._target}
        groups = max(1, -(-count // rows)), rows, 1
        self._shader.run(groups, lattice.settings | settings, lattice.resources | given)
