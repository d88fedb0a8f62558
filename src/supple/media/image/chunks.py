"""Chunks of PNG files, which libvips does not tell of."""

from __future__ import annotations

import os
from typing import BinaryIO


def found(file: BinaryIO, name: bytes) -> bytes:
    """Go to the data of a chunk of a PNG that stands before the pixels; return its length, or nothing."""
    at, kind = 8, b""
    while kind not in (name, b"IDAT"):
        file.seek(at)
        head = file.read(8)
        if len(head) < 8:
            return b""
        at, kind = at + 12 + int.from_bytes(head[:4]), head[4:]
    return head[:4] if kind == name else b""


def png_frames(path: str | os.PathLike[str]) -> int:
    """Count the frames of a PNG; 1 where it is not animated."""
    with open(path, "rb") as file:
        return int.from_bytes(file.read(4)) if found(file, b"acTL") else 1
