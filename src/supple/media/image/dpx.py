"""The header of DPX files, of which FFmpeg reads and writes only the pixels."""

from __future__ import annotations

import os
import struct

from supple.media.files import PathLike, unreadable

SIZE = 2048  # bytes: of the generic header and those of film and television; what users append is not read
_RGB = (6, 50, 51)  # the descriptors of luminance, RGB and RGBA


def header_of(path: PathLike) -> bytes:
    """Return the header; SuppleError for samples that FFmpeg does not read, or reads only in part."""
    with open(path, "rb") as file:
        head = file.read(SIZE)
    if len(head) < SIZE:
        raise unreadable(path, "it is cut short")
    (count,) = struct.unpack_from(f"{order_of(head)}H", head, 770)
    if count != 1 or head[800] not in _RGB:
        kind = f"{count} image elements" if count != 1 else f"samples of kind {head[800]}"
        raise unreadable(path, f"a DPX with {kind} is not supported", "write it as one of RGB, RGBA or grey")
    return head


def order_of(head: bytes) -> str:
    """Return the byte order of a file with this header, as in `struct`."""
    return "<" if head[:4] == b"XPDS" else ">"


def dressed(data: bytes, head: bytes, path: PathLike) -> bytes:
    """Return an encoded file ``data`` with the header ``head`` of another file.

    The fields that describe the storage of pixels are those of ``data``; so are black and white, if the bit depths
    differ. Samples of more than 8 bits must be in the byte order of ``head``. If ``head`` is empty, FFmpeg's header is
    kept, but its transfer curve (linear) becomes undefined.
    """
    if not head:
        return data[:801] + bytes(2) + data[803:]
    order, own = order_of(head), order_of(data)
    made = bytearray(head)
    fields = [(770, "HIII"), (804, "HHIII"), *([(784, "IfIf")] if head[803] != data[803] else [])]
    for at, form in fields:
        struct.pack_into(order + form, made, at, *struct.unpack_from(own + form, data, at))
    made[800], made[803] = data[800], data[803]
    (start,) = struct.unpack_from(f"{own}I", data, 4)
    size = SIZE + len(data) - start
    for at, value in ((4, SIZE), (16, size), (24, 1664), (28, SIZE - 1664), (32, 0), (808, SIZE)):
        struct.pack_into(f"{order}I", made, at, value)
    made[36:136] = os.fsencode(os.path.basename(path))[:99].ljust(100, b"\0")
    return bytes(made) + data[start:]
