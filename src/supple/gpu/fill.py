"""A deformed volume, computed brick by brick beside its source."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.memory import download, owned, room, upload
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
        self._blocks = tuple(-(-n // BLOCK) for n in reversed(volume.size))
        self._made = np.zeros(self._blocks, np.bool_)
        self._pace = Pace(1)
        self._key = object()  # not ``self``: a reference cycle would hold the device's memory
        chosen = lattice.constants | {"LABELLED": volume.labelled, "POLISHED": polished}
        self._shader = shader(volume.gpu, source("fill", volume.voxel), "fill", chosen)
        self._target = volume.warped.create_view()
        self.finished = room(volume.gpu, 4 * self._made.size)
        """A buffer with a 1 for each brick that is filled with all of its neighbours, so that it can be read."""

    @property
    def part(self) -> float:
        """The filled part, from 0 to 1."""
        return float(self._made.mean()) if self._volume.owner is self._key else 0.0

    def advance(self, seconds: float = math.inf, order: npt.NDArray[np.intp] | None = None) -> float:
        """Fill bricks for about this long; return the filled part.

        Parameters
        ----------
        seconds : float
        order : int array
            The order of bricks: flat indices of arrays (bricks z, y, x).

        Raises
        ------
        ArithmeticError
            If points could not be solved to the tolerance in float32.
        """
        if self._volume.owner is not self._key:
            self._volume.owner = self._key
            self._made[...] = False
            self._tell()  # the map of another filling is no longer valid
        gpu = self._volume.gpu
        every = np.arange(self._made.size) if order is None else order
        wanted = every[~self._made.reshape(-1)[every]].astype(np.uint32)
        try:
            with owned(room(gpu, 4)) as (lost,):
                for first, count in self._pace.parts(wanted.size, min(seconds, 0.25), seconds):
                    some = wanted[first : first + count]
                    self._make(some, lost)
                    if download(gpu, lost, np.uint32, 1)[0]:  # waits
                        raise ArithmeticError("voxels could not be solved in its numbers")
                    self._made.reshape(-1)[some] = True
        finally:
            self._tell()
        return self.part

    def prepare(self) -> None:
        """Run for no brick, since some devices compile only at the first run."""
        with owned(room(self._volume.gpu, 4)) as (lost,):
            self._make(np.zeros(0, np.uint32), lost)

    def _make(self, wanted: npt.NDArray[np.uint32], lost: Any) -> None:
        volume, lattice, count = self._volume, self._lattice, wanted.size
        settings = {"size": volume.size, "count": count, "tolerance": self._tolerance}
        rows = max(1, -(-count // MOST_GROUPS))
        with owned(upload(volume.gpu, wanted)) as (some,):
            given = {"voxels": volume.samples, "warped": None, "wanted": some, "lost": lost, "made": self._target}
            self._shader.run(
                (max(1, -(-count // rows)), rows, 1), lattice.settings | settings, lattice.resources | given
            )

    def _tell(self) -> None:
        """Upload the map of readable bricks: interpolated samples and slopes read their neighbours too."""
        padded = np.pad(self._made, 1, constant_values=True)
        ready = np.ones_like(self._made)
        for shift in np.ndindex(3, 3, 3):
            ready &= padded[tuple(slice(s, s + n) for s, n in zip(shift, self._blocks, strict=True))]
        words: Any = ready.astype(np.uint32)
        self._volume.gpu.device.queue.write_buffer(self.finished, 0, words)
