"""The layout of strokes in the core; `supple.strokes.pack` explains the columns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

STROKE_DTYPE = np.dtype(
    [
        ("pivot", np.float64, (3,)),
        ("force", np.float64, (3,)),
        ("matrix", np.float64, (3, 3)),
        ("radius2", np.float64, (3,)),
        ("p", np.float64, (3,)),
        ("q", np.float64, (3,)),
        ("r", np.float64, (3,)),
        ("terms", np.int64),
        ("power", np.int64),
        ("joined", np.int64),
        ("reach", np.float64),
        ("most", np.float64),
        ("turn", np.float64, (3,)),
        ("stretch", np.float64),
        ("coupled", np.float64),
        ("flat", np.float64),
        ("mask", np.int64),
    ],
    align=True,
)
ROW = STROKE_DTYPE.itemsize // 8
"""The numbers of a row of the table."""


def numbers(table: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Return a table's rows in the layout of the core: float64 (n, `ROW`), in which integers keep their bits."""
    return np.ascontiguousarray(table).view(np.float64).reshape(len(table), ROW)
