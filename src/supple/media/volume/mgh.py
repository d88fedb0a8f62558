"""FreeSurfer's .mgz and .mgh: nibabel reads the header; the tags after the voxels, which it ignores, are kept."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np

from supple.errors import needed, shown
from supple.media.files import PathLike, replacing, unreadable, unwritable
from supple.media.volume.data import TO_RAS, Array, Volume, native, placed, reading
from supple.media.volume.nifti import filled, opened, writing

_START, _FOOTER = 284, 20  # bytes before the voxels, and of the scan parameters after them
_TYPES = ("uint8", "int16", "int32", "float32")


def _imported() -> Any:
    return needed("volume", "MGH files", "nibabel").freesurfer.mghformat


def read(path: PathLike, *, header_only: bool = False) -> Volume:
    """Read a file; without a stored geometry, FreeSurfer's default is used. Frames become a time series."""
    kind = _imported()
    with reading(path), opened(path) as file:
        start = file.read(_START)
        if len(start) < _START or int.from_bytes(start[:4], "big") & 0xFF != 1:
            raise unreadable(path, "it is no .mgz or .mgh file", "check its name")
        header = kind.MGHHeader(start, check=False)
        sizes = [int(n) for n in header["dims"]]
        if min(sizes) < 1 or int(header["type"]) not in kind.data_type_codes.code:
            what = f"it holds {' x '.join(map(str, sizes))} voxels of type {int(header['type'])}"
            raise unreadable(path, what, f"convert it to one of {', '.join(_TYPES)}")
        dtype, shape = header.get_data_dtype(), sizes[::-1] if sizes[3] > 1 else sizes[2::-1]
        outline = Volume(
            np.broadcast_to(np.zeros((), dtype.newbyteorder("=")), shape), placed(path, header.get_affine(), "RAS"),
            shown(path), "MGH", sizes[3] > 1, (header, b""),
        )  # fmt: skip
        if header_only:
            return outline
        samples = native(filled(path, file, dtype, shape, _START))
        footer, tags = file.read(_FOOTER), file.read()
    whole = kind.MGHHeader(start[: header.template_dtype.itemsize - _FOOTER] + footer, check=False)
    seconds = float(whole["tr"]) / 1e3
    return replace(outline, samples=samples, header=(whole, tags), interval=seconds if 0 < seconds < np.inf else 1.0)


def check(path: PathLike, like: Volume, dtype: np.dtype[Any]) -> None:
    """Raise SuppleError for a volume that the format does not hold."""
    if dtype.name not in _TYPES:
        text = f"FreeSurfer's files hold no {dtype.name} values, but {', '.join(_TYPES)}"
        raise unwritable(path, text, "use .nii.gz")
    if like.components > 1:
        raise unwritable(path, f"{like.name} has {like.components} values for each voxel", "use .nii.gz")


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    """Write a file, compressed if its name ends in ``.mgz``; a volume read from MGH keeps its header and tags."""
    kind = _imported()
    known, tags = like.header if like.format == "MGH" else (kind.MGHHeader(), b"")
    header = known.copy()
    header.set_data_dtype(samples.dtype.newbyteorder("="))
    header["dims"] = (*like.sizes, len(samples) if like.series else 1)
    if like.format != "MGH" or like.regridded:
        matrix = TO_RAS @ like.geometry.matrix
        steps = np.sqrt((matrix[:3, :3] ** 2).sum(axis=0))
        header["goodRASFlag"], header["delta"], header["Mdc"] = 1, steps, (matrix[:3, :3] / steps).T
        header["Pxyz_c"] = matrix[:3] @ [*(np.array(like.sizes) / 2), 1.0]
    if like.format != "MGH" and like.series:
        header["tr"] = like.interval * 1e3
    packed = "out.gz" if os.fspath(path).lower().endswith("z") else "out"
    with replacing(path, force=force) as temporary, writing(temporary, packed) as file:
        head = header.binaryblock[:-_FOOTER]
        file.write(head + bytes(_START - len(head)))
        for slab in samples:
            file.write(np.ascontiguousarray(slab, slab.dtype.newbyteorder(">")).data)
        file.write(header.binaryblock[-_FOOTER:] + tags)
