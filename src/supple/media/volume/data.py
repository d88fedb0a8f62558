"""Volumes in memory, and functions shared by the readers of their formats."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, refusing, unreadable
from supple.space.checks import LONGEST_AXIS, integer, items, length, refuse
from supple.space.geometry import Geometry, Grid

Array = npt.NDArray[Any]

_SEGMENT = re.compile(r"Segment\d+_(ID|LabelValue)")
TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The matrix (4, 4) from positions in LPS to positions in RAS, and back."""
_PREFIXES = {
    "": 0, "yocto": -24, "zepto": -21, "atto": -18, "femto": -15, "pico": -12, "nano": -9, "micro": -6, "milli": -3,
    "centi": -2, "deci": -1, "hecto": 2, "kilo": 3, "mega": 6, "giga": 9, "tera": 12, "peta": 15, "exa": 18,
    "zetta": 21, "yotta": 24,
}  # fmt: skip
MILLIMETRES = {f"{prefix}meter": float(f"1e{power + 3}") for prefix, power in _PREFIXES.items()}
MILLIMETRES |= {"angstrom": 1e-7, "inch": 25.4, "foot": 304.8, "yard": 914.4, "mile": 1_609_344.0}
MILLIMETRES["parsec"] = 3.0856775814913673e19
# Not in the specification of OME-Zarr, but in many files.
MILLIMETRES |= dict.fromkeys(("um", "\u00b5m", "\u03bcm", r"\u00b5m", "micron", "microns"), 1e-3)
MILLIMETRES |= {"nm": 1e-6, "mm": 1.0, "cm": 10.0, "m": 1000.0, "metre": 1000.0, "in": 25.4}
"""Millimetres in each unit, by its name in lower case."""
DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """A volume with the contents of its file.

    Samples have the file's dtype, in native byte order. Their shape is (Z, H, W), or (Z, H, W, C) for colours or
    vectors, or (T, Z, H, W) for a time series. If they are mapped from the file, they are read-only.
    """

    samples: Array
    geometry: Geometry
    name: str = "the volume"  # of the file, for messages
    format: str = ""  # "NIfTI", "NRRD", "MetaImage", "MGH", "DICOM", "TIFF" or "raw"
    series: bool = False  # whether the first axis is time
    header: Any = None  # in the file's format; for DICOM, the path of the multi-frame file, or the paths of the slices
    scaling: tuple[float, float] = (1.0, 0.0)  # the values are slope * samples + intercept
    interval: float = 1.0  # seconds between the volumes of a series
    regridded: bool = False  # whether samples and geometry differ from those of the header
    resampled: str = ""  # how slices were resampled on reading, for the description of derived DICOM

    @property
    def sizes(self) -> tuple[int, int, int]:
        """The number of voxels along x, y and z."""
        depth, height, width = self.samples.shape[1:4] if self.series else self.samples.shape[:3]
        return width, height, depth

    @property
    def grid(self) -> Grid:
        """The grid of the voxels, of one volume of a series."""
        return self.geometry.grid(self.sizes[::-1])

    def moved(self, samples: Array, grid: Grid, convention: str) -> Volume:
        """Return a volume with the same header, and new samples on another grid; `convention` is as in `Geometry`."""
        return replace(self, samples=samples, geometry=grid.geometry(convention), regridded=True)

    @property
    def components(self) -> int:
        """The number of values of a voxel."""
        return int(self.samples.shape[3]) if self.samples.ndim == 4 and not self.series else 1

    @property
    def is_segmentation(self) -> bool:
        """True if its header lists segments, as 3D Slicer's segmentations do (``.seg.nrrd``)."""
        return isinstance(self.header, dict) and any(_SEGMENT.fullmatch(name) for name in self.header)

    def rescaled(self) -> Array:
        """Return the scaled values: the samples themselves without a scaling, else float32.

        It is float64 for samples of 64 bits and for integers of 32 bits, which float32 cannot represent exactly.
        """
        return rescaled(self.samples, self.scaling)

    def stored(self, values: float | Sequence[float]) -> float | Sequence[float]:
        """Convert scaled values to stored samples: slope and intercept are undone, and integers rounded.

        SuppleError, as for a fill value, if the dtype cannot hold one. Values that are not numbers pass unchanged.
        """
        try:
            known = np.asarray(values, np.float64)
        except (TypeError, ValueError):
            return values
        slope, intercept = self.scaling
        made = (known - intercept) / slope
        if self.samples.dtype.kind in "iu":
            made, limits = np.rint(made), np.iinfo(self.samples.dtype)
            if (wrong := (made < limits.min) | (made > limits.max)).any():
                low, high = sorted(slope * end + intercept for end in (limits.min, limits.max))
                wanted = f"from {low:.10g} to {high:.10g}, which {self.name} can hold ({self.samples.dtype}, "
                scaled = "unscaled" if self.scaling == (1, 0) else f"times {slope:g}, plus {intercept:g}"
                refuse("fill", f"{wanted}{scaled})", known[wrong].tolist()[0])
        return made.tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class RawLayout:
    """The layout of a file without a header.

    Parameters
    ----------
    shape : (int, int, int)
        The number of voxels along x, y and z; x is the fastest axis of the file.
    dtype : str
        The name in NumPy: ``"uint8"``, ``"<i2"`` (16 bits, little-endian), ``">f4"``, ...
    spacing : (float, float, float)
        Millimetres from a voxel to the next, x first.
    offset : int
        Bytes before the first voxel.

    Raises
    ------
    SuppleError
        If an argument is invalid.
    """

    shape: tuple[int, int, int]
    dtype: str
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: int = 0

    def __post_init__(self) -> None:
        wanted = "three sizes, x first"
        sizes = [
            integer(f"shape[{i}]", size, f"an integer from 1 to {LONGEST_AXIS}", 1, LONGEST_AXIS)
            for i, size in enumerate(items("shape", self.shape, wanted, (3,)))
        ]
        steps = [
            length(f"spacing[{i}]", step)
            for i, step in enumerate(items("spacing", self.spacing, "three numbers, x first", (3,)))
        ]
        integer("offset", self.offset, "a number of bytes", 0, 2**62)
        try:
            known = np.dtype(self.dtype).name in DTYPES
        except (TypeError, ValueError, SyntaxError):
            known = False
        if not known:
            refuse("dtype", f"one of {', '.join(DTYPES)}, or as NumPy shortens them, such as <i2", self.dtype)
        object.__setattr__(self, "shape", tuple(sizes))
        object.__setattr__(self, "spacing", tuple(steps))


def rescaled(samples: Array, scaling: tuple[float, float]) -> Array:
    """Return ``slope * samples + intercept``, as `Volume.rescaled`; the samples themselves for the identity."""
    slope, intercept = scaling
    if (slope, intercept) == (1, 0):
        return samples
    made = np.empty(samples.shape, rescaled_dtype(samples.dtype, scaling))
    for one, whole in zip(made, samples, strict=True):  # slab by slab: intermediates are float64
        one[...] = np.float64(slope) * whole + intercept
    return made


def rescaled_dtype(dtype: npt.DTypeLike, scaling: tuple[float, float]) -> np.dtype[Any]:
    """Return the dtype of `rescaled`."""
    known = np.dtype(dtype)
    if scaling == (1, 0):
        return known
    wide = known.itemsize == 8 or (known.kind in "iu" and known.itemsize == 4)
    return np.dtype(np.float64 if wide else np.float32)


def native(samples: Array) -> Array:
    """Return samples in native byte order, contiguous and aligned, without a copy if possible."""
    return np.require(samples, samples.dtype.newbyteorder("="), ("C", "A"))


def placed(path: PathLike, matrix: npt.ArrayLike, convention: str) -> Geometry:
    """Return the geometry of a matrix (4, 4) from indices, x first, to millimetres in RAS or LPS.

    Any other convention than "RAS" means LPS. SuppleError if a spacing is not above 0, the axes lie in a plane,
    or a number is not finite.
    """
    known = np.array(matrix, np.float64)
    if convention == "RAS":
        known[:2] *= -1
    with np.errstate(all="ignore"):
        spacing = np.sqrt((known[:3, :3] ** 2).sum(axis=0))
        direction = known[:3, :3] / spacing
    return located(path, spacing.tolist(), known[:3, 3].tolist(), direction, convention)


def located(path: PathLike, spacing: list[float], origin: list[float], direction: Array, convention: str) -> Geometry:
    """Return a geometry, with all arguments in LPS; SuppleError with the name of the file if it is invalid."""
    check_spacing(path, spacing)
    (x, y, z), (a, b, c) = spacing, origin
    try:
        return Geometry((x, y, z), (a, b, c), direction, convention)
    except SuppleError as error:
        raise SuppleError(f"cannot read {shown(path)}: {error}") from error


def check_spacing(path: PathLike, spacing: list[float]) -> None:
    """Raise SuppleError for a spacing that is not above 0."""
    if not all(0 < step < np.inf for step in spacing):
        found = " x ".join(f"{step:g}" for step in spacing)
        raise unreadable(path, f"its spacing is {found}, and not three numbers above 0", "correct its header")


def reading(path: PathLike) -> AbstractContextManager[None]:
    """Convert all errors of reading a file to one sentence."""

    def refused(error: Exception) -> SuppleError:
        if isinstance(error, MemoryError):
            return too_large(path)
        known = "it is cut short" if isinstance(error, EOFError) else getattr(error, "strerror", None)
        return unreadable(path, known or "its compressed data is damaged")

    return refusing(refused, MemoryError, EOFError, OSError, zlib.error)


def too_large(path: PathLike, sizes: tuple[int, ...] = ()) -> SuppleError:
    """Return an error for a volume that does not fit into memory."""
    told = f", with {' x '.join(map(str, sizes))} voxels by its header" if sizes else ""
    return unreadable(path, f"it is too large for the memory{told}", "check its header, or cut it into parts")
