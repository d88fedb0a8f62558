"""Asynchronous copies between host arrays of any kind and a GPU, through pinned memory.

Copies run through two buffers in each direction: while the GPU copies one, the CPU fills or empties the other.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.workers import share, threads

Array = npt.NDArray[Any]
Part = tuple[slice, slice]

PIECE = 16 << 20  # bytes
_ALONE = 1 << 20  # bytes below which one thread is faster


def pieces(frames: tuple[int, int], shape: tuple[int, int], most: int) -> Iterator[Part]:
    """Yield parts of some frames that are contiguous in memory: their range of frames, and of rows.

    Parameters
    ----------
    frames : (int, int)
        From, to.
    shape : (int, int)
        Rows, and samples in a row.
    most : int
        The largest number of samples in a part, which has at least one row.
    """
    rows, width = shape
    together = max(1, min(most // width, rows))
    if together < rows:
        for k in range(*frames):
            for top in range(0, rows, together):
                yield slice(k, k + 1), slice(top, min(top + together, rows))
        return
    together = max(1, most // (rows * width))
    for k in range(*frames, together):
        yield slice(k, min(k + together, frames[1])), slice(0, rows)


def copied(source: Array, target: Array) -> None:
    """Copy values into an array of the same shape, on all cores."""
    axis = int(np.argmax(source.shape[:2]))
    n = source.shape[axis]
    parts = max(1, min(threads(), n, source.nbytes // _ALONE))
    edges = [n * k // parts for k in range(parts + 1)]

    def copy(ends: tuple[int, int]) -> None:
        at = (slice(None),) * axis + (slice(*ends),)
        np.copyto(target[at], source[at])

    share(copy, itertools.pairwise(edges))


class Lane:
    """One direction of copies between the host and a GPU: a stream, and two alternating buffers.

    Parameters
    ----------
    dtype : numpy.dtype
        The type of the host's samples, in native byte order; bool is stored as bytes on the GPU.
    shape : (int, int)
        Rows of a frame, and samples in a row.
    piece : int
        The bytes of a buffer, which holds at least one row.
    """

    def __init__(self, dtype: np.dtype[Any], shape: tuple[int, int], piece: int = PIECE) -> None:
        from numba import cuda

        self.dtype, self.shape = dtype, shape
        self.kind = np.dtype(np.uint8) if dtype == np.bool_ else dtype
        self.most = max(piece // dtype.itemsize, shape[1])
        self.stream = cuda.stream()
        self._buffers = [cuda.pinned_array(self.most, self.kind) for _ in range(2)]
        self._events = [cuda.event() for _ in range(2)]
        self._turn = 0

    def _next(self) -> tuple[Array, Any]:
        """Return the next buffer, and its event."""
        self._turn ^= 1
        return self._buffers[self._turn], self._events[self._turn]

    def up(self, source: Array, to: Any) -> None:
        """Upload a piece.

        Parameters
        ----------
        source : array, shape (frames, rows, ...)
            An array of the host, which has been read on return.
        to : device array
            Along one axis, as long as ``source``.
        """
        buffer, event = self._next()
        event.synchronize()  # its last content is on the GPU
        held = buffer[: source.size]
        copied(source, held.view(self.dtype).reshape(source.shape))
        to.copy_to_device(held, stream=self.stream)
        event.record(self.stream)

    def down(self, parts: Iterator[tuple[Any, Array]]) -> None:
        """Download pieces: pairs of a device array of one axis and the host array (frames, rows, ...) for it."""
        begun: tuple[Any, Array, Array] | None = None
        for part in itertools.chain(parts, [None]):
            following = None
            if part is not None:
                buffer, event = self._next()
                held = buffer[: part[1].size]
                part[0].copy_to_host(held, stream=self.stream)
                event.record(self.stream)
                following = event, held, part[1]
            if begun is not None:
                event, held, target = begun
                event.synchronize()
                copied(held.view(self.dtype).reshape(target.shape), target)
            begun = following
