"""The records that kernels take, in the layout of kernels/job.hpp and kernels/points.hpp, which check their sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

_SAMPLES = np.dtype([("first", "u8"), ("plane", "i8"), ("row", "i8"), ("column", "i8"), ("channel", "i8")])

JOB = np.dtype(
    [(name, "u8") for name in ("maps", "xs", "ys", "nodes", "leaves", "states", "rough", "told")]
    + [("source", _SAMPLES), ("out", _SAMPLES), ("fill", "u8"), ("top", "u8")]
    + [(name, "f8") for name in ("tolerance", "white", "high")]
    + [
        (name, "i4")
        for name in (
            "map_count", "planes", "first", "shared", "width", "height", "nx", "ny", "from_x", "from_y", "w", "h",
            "count", "held_from", "channels", "between", "rule", "average", "alpha", "light",
        )
    ]
)  # fmt: skip

SOME = np.dtype(
    [(name, "u8") for name in ("map", "points", "to", "matrices", "residual", "steps", "done", "told")]
    + [("count", "i8"), ("tolerance", "f8"), ("wide", "i4"), ("back", "i4")]
)

TOLD = np.dtype([("worst", "f4"), ("rough", "i4"), ("unsolved", "i4"), ("folded", "i4"), ("outside", "i4")])


def record(kind: np.dtype[Any], **values: Any) -> npt.NDArray[Any]:
    """Return an array of one record; fields that are not given are 0."""
    made = np.zeros(1, kind)
    for name, value in values.items():
        made[name] = value
    return made
