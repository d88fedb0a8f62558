"""What a video and an image sequence are while they are open."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from supple.media.sequence import Pictures
    from supple.media.video import Clip as Video

Clip: TypeAlias = "Pictures | Video"
"""An open medium that streams; its attributes are those that both have."""


class ClipWarning(UserWarning):
    """A part of a clip is damaged, or cannot be kept."""


class CountError(Exception):
    """The number of decoded frames differs from that of the packets: open the clip again with ``found``."""

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found
