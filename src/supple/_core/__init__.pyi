# The types of what bindings.cpp defines.
from collections.abc import Sequence
from typing import Literal, overload

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

isa: str

def threads() -> int: ...

class Polynomial:
    def __init__(self, coefficients: Sequence[float]) -> None: ...
    def at(self, x: float) -> float: ...

def smallest_strain(
    terms: Floats,
    pivot: Floats,
    direction: Floats,
    reach: float,
    axes: Floats,
    free: float,
    upper: float,
    target: float,
    gap: float,
) -> tuple[float, float, int]: ...
def smallest_free_strain(terms: Floats, reach: float, gap: float) -> tuple[float, float, float, int]: ...
@overload
def forward(
    table: npt.NDArray[np.void], axes: Floats, points: Floats, jacobian: Literal[True]
) -> tuple[Floats, Floats]: ...
@overload
def forward(
    table: npt.NDArray[np.void], axes: Floats, points: Floats, jacobian: Literal[False]
) -> tuple[Floats, None]: ...
