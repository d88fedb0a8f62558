"""Files of pictures, clips, volumes, transforms and points, read and written."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from supple.media.medium import Medium


def open(path: str | os.PathLike[str], target: str | os.PathLike[str] = "", **asked: Any) -> Medium:  # noqa: A001
    """Return what a file is taken for, its grid and its header, as `supple.media.medium.opened` does."""
    from supple.media.medium import opened

    return opened(path, target, **asked)
