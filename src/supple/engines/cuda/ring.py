"""Host frames in a ring on a GPU; new ones replace the oldest."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.cuda.staging import Lane, pieces
from supple.engines.cuda.warp import Frames

Array = npt.NDArray[Any]
Range = tuple[int, int]


class Ring:
    """Frames, each in the slot that is its number modulo the number of slots.

    Parameters
    ----------
    source : array, shape (T, H, W, C)
        All frames, on the host.
    samples : device array
        The slots, along one axis.
    slots : int
    lane : Lane
        The copies to the GPU.

    Attributes
    ----------
    there : (int, int)
        The range of frames that are there, or on their way: from, to.
    """

    def __init__(self, source: Array, samples: Any, slots: int, lane: Lane) -> None:
        self.there: Range = 0, 0
        self._source, self._samples, self._slots, self._lane = source, samples, slots, lane
        self._used = np.full(slots, -1, np.int64)  # the last known work that reads each slot
        self._done: dict[int, Any] = {}  # its event
        self._waited = -1

    def send(self, low: int, high: int, stream: Any) -> Frames:
        """Upload frames before the next work of a stream.

        Parameters
        ----------
        low, high : int
            From, to; at most as many as there are slots.
        stream : numba.cuda stream

        Returns
        -------
        Frames
            These frames, and all others that are still there.
        """
        had = self.there
        if low > had[1] or high < had[0]:  # the range has no gaps
            had = low, low
        for first, last in ((low, had[0]), (had[1], high)):
            again = range(first - first % self._slots + self._slots, last, self._slots)  # wrap-around
            edges = [first, *again, max(first, last)]
            for a, b in itertools.pairwise(edges):
                self._upload(a, b)
        start, end = min(low, had[0]), max(high, had[1])
        if end - start > self._slots:  # the far end has been replaced
            start, end = (high - self._slots, high) if high > had[1] else (low, low + self._slots)
        self.there = start, end
        recorded(self._lane.stream).wait(stream)
        count, height, width, channels = self._source.shape
        if self._slots == count:
            low, high = self.there
        size = height * width * channels
        places = (count, height, width, channels, size, width * channels, channels, 1, 0)
        return Frames(self._samples, (*places, low, high, low % self._slots, self._slots), ring=count > 1)

    def read_by(self, number: int, frames: Range, done: Any) -> None:
        """Record that work reads frames until an event; work ends in the order of its numbers."""
        self._used[np.arange(*frames) % self._slots] = number
        self._done[number] = done

    def forget(self, number: int) -> None:
        """Record that some work, and all before it, is done."""
        self._waited = max(self._waited, number)
        self._done = {n: done for n, done in self._done.items() if n > number}

    def _upload(self, first: int, last: int) -> None:
        """Upload frames in consecutive slots."""
        rows, width = self._lane.shape
        for frames, part in pieces((first, last), (rows, width), self._lane.most):
            slot = frames.start % self._slots
            latest = int(self._used[slot : slot + frames.stop - frames.start].max())
            if latest > self._waited:  # replaced frames may still be read
                self._done[latest].wait(self._lane.stream)
                self._waited = latest
            samples = self._source[frames, part]
            start = (slot * rows + part.start) * width
            self._lane.up(samples, self._samples[start : start + samples.size])


def recorded(stream: Any) -> Any:
    """Return an event at the end of a stream's work."""
    from numba import cuda

    event = cuda.event()
    event.record(stream)
    return event
