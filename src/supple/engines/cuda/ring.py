"""Frames of the host on a GPU: as many as there is room for, those that are needed next in the place of older ones."""

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
    """Some frames, each in the slot that is its number modulo how many slots there are.

    Parameters
    ----------
    source : array, shape (T, H, W, C)
        All frames, on the host.
    samples : device array
        Of one axis: the slots.
    slots : int
    lane : Lane
        The way there.

    Attributes
    ----------
    there : (int, int)
        Which frames are there, or on their way: from, to.
    """

    def __init__(self, source: Array, samples: Any, slots: int, lane: Lane) -> None:
        self.there: Range = 0, 0
        self._source, self._samples, self._slots, self._lane = source, samples, slots, lane
        self._used = np.full(slots, -1, np.int64)  # which work reads each slot, as far as that is known
        self._done: dict[int, Any] = {}  # when that has been done
        self._waited = -1

    def send(self, low: int, high: int, stream: Any) -> Frames:
        """Have frames on the GPU before what is handed over to a stream next.

        Parameters
        ----------
        low, high : int
            From, to; no more than there are slots.
        stream : numba.cuda stream

        Returns
        -------
        Frames
            Those frames, and where all are there that are not replaced, all of them.
        """
        had = self.there
        if low > had[1] or high < had[0]:  # what is there has no gaps
            had = low, low
        for first, last in ((low, had[0]), (had[1], high)):
            again = range(first - first % self._slots + self._slots, last, self._slots)  # where slots begin anew
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
        """Say that some work reads frames until an event; work is done in the order of its numbers."""
        self._used[np.arange(*frames) % self._slots] = number
        self._done[number] = done

    def forget(self, number: int) -> None:
        """Say that some work is done, and all before it."""
        self._waited = max(self._waited, number)
        self._done = {n: done for n, done in self._done.items() if n > number}

    def _upload(self, first: int, last: int) -> None:
        """Send frames that lie in slots one after the other."""
        rows, width = self._lane.shape
        for frames, part in pieces((first, last), (rows, width), self._lane.most):
            slot = frames.start % self._slots
            latest = int(self._used[slot : slot + frames.stop - frames.start].max())
            if latest > self._waited:  # what is replaced may still be read
                self._done[latest].wait(self._lane.stream)
                self._waited = latest
            samples = self._source[frames, part]
            start = (slot * rows + part.start) * width
            self._lane.up(samples, self._samples[start : start + samples.size])


def recorded(stream: Any) -> Any:
    """An event at the end of what a stream has to do."""
    from numba import cuda

    event = cuda.event()
    event.record(stream)
    return event
