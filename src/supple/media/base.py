"""What open videos and image sequences share: their frames, a warning and an error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from supple.engine.work import Array


@dataclass(frozen=True, slots=True)
class LazyFrame:
    """A frame that is read or unpacked only when it is copied into arrays."""

    copy_to: Callable[[Sequence[Array]], None]


class ClipWarning(UserWarning):
    """A part of a clip is damaged, or cannot be kept."""


class CountError(Exception):
    """The number of decoded frames differs from that of the packets: open the clip again with ``found``."""

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found
