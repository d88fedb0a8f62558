"""The type of open videos and image sequences."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from supple.media import sequence, video

Clip: TypeAlias = "sequence.Pictures | video.Clip"
"""An open image sequence or video, whose frames are read in order."""
