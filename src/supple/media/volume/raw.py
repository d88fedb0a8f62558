"""Raw voxels, without a header, or after three sizes (the .dat volumes of TU Wien)."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import numpy as np

from supple.errors import argument, shown
from supple.media.files import PathLike, head_of, unreadable
from supple.media.volume.data import RawLayout, Volume, native, reading
from supple.space.geometry import Geometry

_HEAD = 6  # three sizes of 16 bits
_CHUNK = 1 << 22
_GZIP = b"\x1f\x8b"


def read_dat(path: PathLike) -> Volume:
    """Map a .dat volume of TU Wien: three sizes, x first, and the samples; all are little-endian uint16.

    SuppleError if it is missing, or its length does not match its sizes.
    """
    head = head_of(path, _HEAD).ljust(_HEAD, b"\0")
    width, height, depth = (int.from_bytes(head[i : i + 2], "little") for i in (0, 2, 4))
    if not width * height * depth:
        raise unreadable(path, f"its header says {width} x {height} x {depth} voxels, which is none")
    return read(path, RawLayout((width, height, depth), "<u2", offset=_HEAD))


def read(path: PathLike, layout: RawLayout | None) -> Volume:
    """Map a file without a header; SuppleError if it is missing, does not match the layout, or there is no layout."""
    head_of(path, 1)
    if layout is None:
        for suffix in (".mhd", ".nhdr"):
            if (beside := Path(path).with_suffix(suffix)).exists():
                raise unreadable(path, f"it has no header, and {shown(beside)} is one", "give that file")
        raise unreadable(path, "it has no header that tells what is in it", f"give {argument('layout')}")
    width, height, depth = layout.shape
    dtype, found = np.dtype(layout.dtype), os.stat(path).st_size
    wanted = layout.offset + dtype.itemsize * width * height * depth
    if wanted != found:
        after = f" after {layout.offset} bytes" if layout.offset else ""
        told = f"{width} x {height} x {depth} voxels of {dtype.name}{after} take {wanted} bytes, and it has {found}"
        raise unreadable(path, told, "give a whole copy of it, or other --shape and --dtype (RawLayout)")
    with reading(path):
        samples = np.memmap(path, layout.dtype, "r", layout.offset, layout.shape[::-1])
        return Volume(native(samples), Geometry(layout.spacing), shown(path), "raw")


def count_bytes(path: PathLike, start: int, most: int, packed: int | None = None) -> int:
    """Return the number of bytes of voxels from an offset on; compressed data (zlib, gzip) count up to about `most`.

    `packed` is the compressed size; 0 if it is unknown. OSError, EOFError or zlib.error if the file cannot be read, or
    the compressed data are incomplete, or their checksum is wrong.
    """
    if packed is None:
        return max(os.stat(path).st_size - start, 0)
    count, left, stream, data = 0, packed or os.stat(path).st_size, zlib.decompressobj(15 | 32), b""
    with open(path, "rb") as file:
        file.seek(start)
        while count <= most:
            if not data:
                data = file.read(min(_CHUNK, left))
                left -= len(data)
            if not data and not stream.eof:
                raise EOFError
            if stream.eof:
                if not data.startswith(_GZIP):
                    break
                stream = zlib.decompressobj(15 | 32)  # gzip may have several members
            count += len(stream.decompress(data, _CHUNK))
            data = stream.unused_data if stream.eof else stream.unconsumed_tail
    return count
