"""A palette of 256 colours for each frame, as GIF has them."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import av
from av.filter import Graph


class Palettes:
    """Turns frames into such of 256 colours, each with a palette of its own, in a stream.

    Parameters
    ----------
    width, height : int
        Of the frames, which are BGRA.
    """

    def __init__(self, width: int, height: int) -> None:
        self._graph = Graph()
        source = self._graph.add_buffer(
            width=width, height=height, format=av.VideoFormat("bgra"), time_base=Fraction(1, 100)
        )
        split = self._graph.add("split")
        palette = self._graph.add("palettegen", "stats_mode=single")
        use = self._graph.add("paletteuse", "new=1")
        sink = self._graph.add("buffersink")
        source.link_to(split)
        split.link_to(use, 0, 0)
        split.link_to(palette, 1, 0)
        palette.link_to(use, 0, 1)
        use.link_to(sink)
        self._graph.configure()

    def add(self, frame: av.VideoFrame) -> Iterator[av.VideoFrame]:
        """Take a frame, and hand out those that are done."""
        self._graph.vpush(frame)
        return self._done()

    def finish(self) -> Iterator[av.VideoFrame]:
        """Hand out the frames that are left."""
        self._graph.vpush(None)
        return self._done()

    def _done(self) -> Iterator[av.VideoFrame]:
        while True:
            try:
                yield self._graph.vpull()
            except (av.error.BlockingIOError, av.error.EOFError):
                return
