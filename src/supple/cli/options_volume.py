"""Options of commands on volumes: what is in a file."""

import glob
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from supple.cli.console import STREAM
from supple.cli.options import parse_number
from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.files.options import VolumeOptions as Reading

VOLUME = Group("Volumes", sort_key=5)
COORDINATES = {"lps": "LPS", "ras": "RAS", "index": "index"}
"""The names of coordinates of points, by how they are spelt in lower case."""


@Parameter(name="*", group=VOLUME)
@dataclass(kw_only=True, eq=False, repr=False)
class VolumeArguments:
    """Options for volumes.

    Parameters
    ----------
    world
        Points of strokes are in millimetres in the file's coordinate system (NIfTI: RAS; DICOM, NRRD and
        MetaImage: LPS) instead of voxels.
    series
        Which series to read from a DICOM folder with several: its number in the list, or its UID.
    shape
        Number of voxels along x, y and z, for a file without a header; needs --dtype.
    dtype
        Data type of a file without a header: uint8, int16, <i2 (little-endian), >f4 (big-endian), …
    spacing
        Distance between voxels along x, y and z in millimetres, for a file without a header (default 1,1,1).
    """

    world: bool = False
    series: Annotated[str | None, Parameter(metavar="N|UID")] = None
    shape: Annotated[str | None, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = None
    dtype: Annotated[str | None, Parameter(metavar="TYPE")] = None
    spacing: Annotated[str | None, Parameter(metavar="X,Y,Z", allow_leading_hyphen=True)] = None

    def to_reading(self, *, labels: bool = False, save_field: str | None = None) -> "Reading":
        """Return the options as the library takes them."""
        from supple.files.options import VolumeOptions as Reading

        layout = None
        if self.shape is not None or self.dtype is not None or self.spacing is not None:
            from supple.media.volume import RawLayout

            if self.shape is None or self.dtype is None:
                raise SuppleError(
                    "a file without a header needs both --shape X,Y,Z and --dtype: give the other one too"
                )
            sizes = tuple(int(n) if n.is_integer() else n for n in parse_three("--shape", self.shape))
            spacing = (1.0, 1.0, 1.0) if self.spacing is None else parse_three("--spacing", self.spacing)
            layout = RawLayout(sizes, self.dtype, spacing)  # type: ignore[arg-type]
        return Reading(world=self.world, labels=labels, save_field=save_field, layout=layout, series=self.series)

    def place_of(self, path: str) -> str | None:
        """Return the convention of a volume, as `Geometry` has it; None of anything else.

        Of several files, it is that of the first one; of standard input, which cannot be read twice, that of DICOM.
        """
        from supple.files.volumes import place_of
        from supple.media.medium import ONE_FILE, holds_volumes
        from supple.media.suffixes import suffix_of

        if path == STREAM:
            return "LPS"
        if glob.has_magic(path) and not os.path.exists(path):
            path = min(glob.glob(path, recursive=True), default=path)
        elif holds_volumes(path):
            path = os.path.join(path, min(name for name in os.listdir(path) if suffix_of(name) in ONE_FILE))
        return place_of(path, self.to_reading())


def parse_numbers(name: str, text: str, count: int, wanted: str) -> tuple[float, ...]:
    """Read so many numbers from the command line."""
    parts = text.split(",")
    if len(parts) != count:
        raise SuppleError(f"{name} must be {wanted}, found {text!r}")
    return tuple(parse_number(name, part, wanted) for part in parts)


def parse_three(name: str, text: str) -> tuple[float, float, float]:
    """Read a number for each axis from the command line."""
    x, y, z = parse_numbers(name, text, 3, "three numbers X,Y,Z")
    return x, y, z
