"""Headers of NIfTI files, of version 1 or 2, as NumPy records: fields by their names, and extensions as stored.

nibabel is not imported for them, which takes longer than to read most volumes.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from supple.space.geometry import Floats

Header = npt.NDArray[np.void]
FIRST, SECOND = 348, 540  # bytes of the versions, which say so
_FIELDS = {  # names, formats and places
    FIRST: "sizeof_hdr i4 0 dim 8i2 40 intent_p1 f4 56 intent_code i2 68 datatype i2 70 bitpix i2 72 slice_start i2 74 "
    "pixdim 8f4 76 vox_offset f4 108 scl_slope f4 112 scl_inter f4 116 slice_end i2 120 slice_code u1 122 "
    "xyzt_units u1 123 slice_duration f4 132 glmax i4 140 glmin i4 144 descrip S80 148 qform_code i2 252 "
    "sform_code i2 254 quatern 3f4 256 qoffset 3f4 268 srow (3,4)f4 280 intent_name S16 328 magic S4 344",
    SECOND: "sizeof_hdr i4 0 magic S4 4 eol_check 4i1 8 datatype i2 12 bitpix i2 14 dim 8i8 16 intent_p1 f8 80 "
    "pixdim 8f8 104 vox_offset i8 168 scl_slope f8 176 scl_inter f8 184 slice_duration f8 208 slice_start i8 224 "
    "slice_end i8 232 descrip S80 240 qform_code i4 344 sform_code i4 348 quatern 3f8 352 qoffset 3f8 376 "
    "srow (3,4)f8 400 slice_code i4 496 xyzt_units i4 500 intent_code i4 504 intent_name S16 508",
}
CODES = {
    2: "uint8", 4: "int16", 8: "int32", 16: "float32", 64: "float64", 256: "int8", 512: "uint16", 768: "uint32",
    1024: "int64", 1280: "uint64", 128: "3u1", 2304: "4u1",
}  # fmt: skip
OTHERS = {1: "binary", 32: "complex64", 1536: "float128", 1792: "complex128", 2048: "complex256"}


def layout(size: int, order: Literal["<", ">", "="] = "=", more: int = 4) -> np.dtype[Any]:
    """Return the type of a header of a version and byte order, with so many bytes of extensions behind it."""
    words = [*_FIELDS[size].split(), "extensions", f"V{more}", str(size)]
    names, formats, places = words[::3], words[1::3], [int(place) for place in words[2::3]]
    return np.dtype({"names": names, "formats": formats, "offsets": places}).newbyteorder(order)


def made(size: int) -> Header:
    """Return the header of nothing yet."""
    header = np.zeros((), layout(size))
    header["sizeof_hdr"], header["dim"][1:], header["pixdim"] = size, 1, 1
    if size == SECOND:
        header["eol_check"] = (13, 10, 26, 10)
    finish(header)
    return header


def copied(header: Header) -> Header:
    """Return a copy that can be changed, of the bytes between the fields too."""
    return np.frombuffer(bytearray(header.tobytes()), header.dtype).reshape(())


def finish(header: Header) -> None:
    """Make a header that of a single file, whose voxels follow."""
    header["magic"] = b"n+2" if int(header["sizeof_hdr"]) == SECOND else b"n+1"
    header["vox_offset"] = header.itemsize


def set_type(header: Header, kind: str) -> None:
    """Set the type of voxels, by its name in `CODES`."""
    header["datatype"] = next(code for code, name in CODES.items() if name == kind)
    header["bitpix"] = 8 * np.dtype(kind).itemsize


def sform(header: Header) -> Floats:
    """Return the affine matrix."""
    return np.vstack([np.asarray(header["srow"], np.float64), np.eye(4)[3]])


def qform(header: Header) -> Floats:
    """Return the matrix of the quaternion (w, x, y, z), the spacing and the origin; ValueError for none."""
    x, y, z = header["quatern"].astype(np.longdouble)
    square, slack = 1 - (x * x + y * y + z * z), 3 * float(np.finfo(header["quatern"].dtype).eps)
    side = float(header["pixdim"][0])
    if not square > -slack or side not in (-1, 1) or (header["pixdim"][1:4] < 0).any():
        raise ValueError("no rotation, or no spacing")
    w = 0 if abs(square) < slack else np.sqrt(square)
    cross, scale = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), 2 / (w * w + x * x + y * y + z * z)
    made = np.eye(4)
    made[:3, :3] = (np.eye(3) + scale * (w * cross + cross @ cross)) * header["pixdim"][1:4] * (1, 1, side)
    made[:3, 3] = header["qoffset"]
    return made


def set_forms(header: Header, affine: Floats, qcode: int, scode: int) -> None:
    """Set the matrices whose codes are not 0: the qform to the turn that is nearest, by its quaternion."""
    if scode:
        header["sform_code"], header["srow"] = scode, affine[:3]
    if qcode:
        spacing = np.sqrt((affine[:3, :3] ** 2).sum(axis=0))
        turn = affine[:3, :3] / spacing
        side = 1.0 if np.linalg.det(turn) > 0 else -1.0
        left, _, right = np.linalg.svd(turn * (1, 1, side))
        (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = left @ right
        lower = [[xx - yy - zz, 0, 0, 0], [yx + xy, yy - xx - zz, 0, 0], [zx + xz, zy + yz, zz - xx - yy, 0]]
        values, vectors = np.linalg.eigh(np.array([*lower, [yz - zy, zx - xz, xy - yx, xx + yy + zz]]) / 3)
        *turned, w = vectors[:, np.argmax(values)]
        header["qform_code"], header["quatern"] = qcode, np.array(turned) * (-1 if w < 0 else 1)
        header["pixdim"][:4], header["qoffset"] = (side, *spacing), affine[:3, 3]
