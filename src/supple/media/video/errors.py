"""Errors and warnings of video, each one sentence."""

from __future__ import annotations

import os
import re

import av

from supple.errors import SuppleError, shown


class ClipWarning(UserWarning):
    """Something of a clip is damaged, or does not come through."""


class CountError(Exception):
    """Decoding gave another number of frames than the packets promised: open the clip again with that number.

    Parameters
    ----------
    found : int
        How many frames there are.
    """

    def __init__(self, found: int) -> None:
        super().__init__(f"decoding gives {found} frames")
        self.found = found


def unreadable(path: str | os.PathLike[str], reason: str, advice: str) -> SuppleError:
    """Say why a file cannot be read as video, and what would help."""
    return SuppleError(f"cannot read {shown(path)}: {reason}: {advice}")


def unwritable(path: str | os.PathLike[str], reason: str, advice: str) -> SuppleError:
    """Say why a clip cannot be written as asked, and what would help."""
    return SuppleError(f"cannot write {shown(path)}: {reason}: {advice}")


def said(error: Exception) -> str:
    """Shorten what FFmpeg said to its reason."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return re.sub(r"\s+", " ", str(text)).strip().rstrip(".").replace("[Errno", "[error")


def raised(path: str | os.PathLike[str], error: av.FFmpegError) -> Exception:
    """Turn FFmpeg's error while writing into an error of the system, where it is one, or into one sentence."""
    if isinstance(error, OSError) and error.errno:
        return OSError(error.errno, os.strerror(error.errno))
    return unwritable(
        path, f"the container refuses what it is given ({said(error)})", "choose another one, such as .mkv"
    )
