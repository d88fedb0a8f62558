"""Files of displacement fields and affine maps, in the conventions of the programs that use them.

All hold pull maps: of a point of the output, the point of the input that is seen there. In memory, positions and
displacements of volumes are in millimetres in LPS, those of pictures in pixels.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.geometry import Grid
from supple.media.transforms.itk import SUFFIXES_OUT, check_target, write_field

__all__ = ["SUFFIXES_OUT", "Content", "Displacements", "check_target", "write_field"]


class Displacements(NamedTuple):
    """A sampled displacement field as read from a file; see `supple.Field`."""

    values: npt.NDArray[Any]
    grid: Grid
    interpolation: Literal["linear", "cubic", "bspline"] = "linear"
    beyond: Literal["zero", "edge"] = "zero"


Content = npt.NDArray[np.float64] | Displacements
"""The homogeneous matrix of an affine map, or a displacement field. Those of a file apply in order, the first first."""
