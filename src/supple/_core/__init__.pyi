# The types of what bindings.cpp defines.
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

isa: str

def threads() -> int: ...

class Polynomial:
    def __init__(self, coefficients: Sequence[float]) -> None: ...
    def at(self, x: float) -> float: ...

BRICK: int
NODE: int

class Strokes:
    def __init__(self, rows: NDArray[np.float64], axes: NDArray[np.float64]) -> None: ...

class Lattice:
    def __init__(self, nodes: NDArray[np.float32], step: int) -> None: ...
    def solve(self, strokes: Strokes) -> tuple[float, float]: ...
    def error(self, strokes: Strokes) -> float: ...
    def between(self, points: NDArray[np.float32], out: NDArray[np.float32]) -> None: ...

class Transfer:
    def __init__(
        self, table: NDArray[np.float32], low: float, scale: float, threshold: float, bottom: float, top: float
    ) -> None: ...

class View:
    def __init__(
        self,
        packed: NDArray[np.float64],
        step: float,
        lamp: tuple[float, float, float],
        shaded: bool,
        skips: NDArray[np.uint8],
    ) -> None: ...

def draw(
    samples: NDArray[Any],
    view: View,
    transfer: Transfer,
    lattice: Lattice | None,
    cells: int,
    strokes: Strokes | None,
    columns: NDArray[np.float64],
    rows: NDArray[np.float64],
    light: NDArray[np.float32],
    depth: NDArray[np.float64],
    work: NDArray[np.int64],
) -> None: ...
def brick_ranges(samples: NDArray[Any], brick: int, lows: NDArray[np.float32], highs: NDArray[np.float32]) -> None: ...
def brick_distances(seen: NDArray[np.bool_], out: NDArray[np.uint8]) -> None: ...
def brick_moved(lattice: Lattice, seen: NDArray[np.bool_], fine: int, slack: float, out: NDArray[np.bool_]) -> None: ...
def look_up(samples: NDArray[Any], points: NDArray[np.float32], out: NDArray[np.float32]) -> None: ...
