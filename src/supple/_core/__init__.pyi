# The types of what bindings.cpp defines.
from collections.abc import Sequence
from typing import Any, Literal, overload

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
def forward(strokes: Floats, axes: Floats, points: Floats, jacobian: Literal[True]) -> tuple[Floats, Floats]: ...
@overload
def forward(strokes: Floats, axes: Floats, points: Floats, jacobian: Literal[False]) -> tuple[Floats, None]: ...
def inverse(
    strokes: Floats, axes: Floats, targets: Floats, ndim: int, tolerance: float
) -> tuple[Floats, Floats, Floats]: ...
def invert_as_published(
    strokes: Floats,
    axes: Floats,
    z: float,
    every: int,
    mu: float,
    tolerance: float,
    limit: int,
    corrected: bool,
    points: npt.NDArray[np.float32],
    counts: npt.NDArray[np.int64],
    residual: Floats,
) -> None: ...

class Sampling:
    def __init__(
        self,
        frames: npt.NDArray[Any],
        out: npt.NDArray[Any],
        count: int,
        step: tuple[int, int],
        offset: tuple[float, float],
        filter: int,
        between: int,
        rule: int,
        average: bool,
        fill: Sequence[float],
        alpha: int,
        light: bool,
        white: float,
    ) -> None: ...

class Plan:
    @property
    def error(self) -> float: ...
    @property
    def evaluations(self) -> float: ...
    @property
    def unsolved(self) -> int: ...
    @property
    def folds(self) -> int: ...
    @property
    def identity(self) -> bool: ...
    def __init__(
        self, strokes: Floats, axes: Floats, ndim: int, height: int, width: int, z: float, tolerance: float
    ) -> None: ...
    def extent(self) -> tuple[tuple[float, ...], tuple[float, ...], float, float]: ...
    def points(self, out: npt.NDArray[np.float32] | Floats) -> None: ...
    def measure(self, finest: float) -> tuple[float, int]: ...
    def sample(self, sampling: Sampling, box: tuple[int, int, int, int] | None = None) -> None: ...

def warp_stack(
    strokes: Floats,
    axes: Floats,
    height: int,
    width: int,
    planes: Sequence[int],
    tolerance: float,
    samplings: Sequence[Sampling],
) -> tuple[float, float]: ...

BRICK: int
NODE: int

class Strokes:
    def __init__(self, rows: npt.NDArray[np.float64], axes: npt.NDArray[np.float64]) -> None: ...

class Lattice:
    def __init__(self, nodes: npt.NDArray[np.float32], step: int) -> None: ...
    def solve(self, strokes: Strokes) -> tuple[float, float]: ...
    def error(self, strokes: Strokes) -> float: ...
    def between(self, points: npt.NDArray[np.float32], out: npt.NDArray[np.float32]) -> None: ...

class Transfer:
    def __init__(
        self, table: npt.NDArray[np.float32], low: float, scale: float, threshold: float, bottom: float, top: float
    ) -> None: ...

class View:
    def __init__(
        self,
        packed: npt.NDArray[np.float64],
        step: float,
        lamp: tuple[float, float, float],
        shaded: bool,
        skips: npt.NDArray[np.uint8],
    ) -> None: ...

def draw(
    samples: npt.NDArray[Any],
    view: View,
    transfer: Transfer,
    lattice: Lattice | None,
    cells: int,
    strokes: Strokes | None,
    columns: npt.NDArray[np.float64],
    rows: npt.NDArray[np.float64],
    light: npt.NDArray[np.float32],
    depth: npt.NDArray[np.float64],
    work: npt.NDArray[np.int64],
) -> None: ...
def brick_ranges(
    samples: npt.NDArray[Any], brick: int, lows: npt.NDArray[np.float32], highs: npt.NDArray[np.float32]
) -> None: ...
def brick_distances(seen: npt.NDArray[np.bool_], out: npt.NDArray[np.uint8]) -> None: ...
def brick_moved(
    lattice: Lattice, seen: npt.NDArray[np.bool_], fine: int, slack: float, out: npt.NDArray[np.bool_]
) -> None: ...
def look_up(samples: npt.NDArray[Any], points: npt.NDArray[np.float32], out: npt.NDArray[np.float32]) -> None: ...
