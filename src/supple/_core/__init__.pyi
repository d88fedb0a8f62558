# Types of the core's modules.
from collections.abc import Sequence
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

isa: str

def threads() -> int: ...

# ---- points

class Freeze:
    def __init__(self, values: Singles, first: Sequence[float], step: Sequence[float]) -> None: ...
    def stand_for(self, masks: Sequence[Freeze | None], freezes: Sequence[tuple[int, int]]) -> None: ...
    def freedom(self, points: Floats) -> tuple[Floats, Floats]: ...

class Map:
    def __init__(
        self,
        strokes: Floats,
        axes: Floats,
        ndim: int,
        freeze: Freeze | None = None,
        composite: Composite | None = None,
    ) -> None: ...

@overload
def forward(
    strokes: Floats, axes: Floats, points: Floats, jacobian: Literal[True], freeze: Freeze | None = None
) -> tuple[Floats, Floats]: ...
@overload
def forward(
    strokes: Floats, axes: Floats, points: Floats, jacobian: bool, freeze: Freeze | None = None
) -> tuple[Floats, Floats | None]: ...
def inverse(map: Map, targets: Floats, tolerance: float) -> tuple[Floats, Floats, Floats]: ...
def invert_as_published(
    strokes: Floats,
    axes: Floats,
    z: float,
    every: int,
    mu: float,
    tolerance: float,
    limit: int,
    corrected: bool,
    points: Singles,
    counts: Integers,
    residual: Floats,
) -> None: ...

# ---- fields

class Sampled:
    def __init__(
        self,
        values: Array,
        order: int,
        first: Sequence[float],
        last: Sequence[float],
        margin: float,
        zero: bool,
        to_index: Floats,
        to_place: Floats,
        vectors: Floats,
    ) -> None: ...
    def folded_cells(self, cells: npt.NDArray[np.uint8]) -> None: ...
    def invert(
        self,
        grid: Floats,
        back: Floats,
        tolerance: float,
        values: Array,
        error: Singles,
        status: npt.NDArray[np.uint8],
    ) -> None: ...

Part = tuple[Literal["strokes", "affine", "field"], Floats | tuple[Floats, Floats] | Sampled, bool]

class Composite:
    def __init__(self, ndim: int, axes: Floats, parts: Sequence[Part], freeze: Freeze | None = None) -> None: ...
    def through(
        self,
        points: Floats,
        backwards: bool,
        jacobian: bool,
        status: npt.NDArray[np.uint8],
        errors: Floats | None = None,
    ) -> tuple[Floats, Floats | None, Floats]: ...

# ---- planes

Box = tuple[int, int, int, int]
Codes = tuple[int, int, int, bool]
Checks = tuple[float, float, int, int, int]  # the error, evaluations, and counts: unsolved, folded, outside

class Sampling:
    def __init__(
        self,
        frames: Array,
        out: Array,
        count: int,
        step: tuple[int, int],
        offset: tuple[float, float],
        codes: Codes,
        fill: Sequence[float],
        alpha: int,
        light: bool,
        white: float,
        corner: tuple[int, int, int] | None = None,
        size: tuple[int, int] | None = None,
        motion: tuple[Array, list[float], float, float, float] | None = None,
    ) -> None: ...

class Plan:
    def __init__(
        self,
        map: Map,
        height: int,
        width: int,
        z: float,
        tolerance: float,
        box: Box | None = None,
        chroma: bool = False,
    ) -> None: ...
    @property
    def checks(self) -> Checks: ...
    @property
    def identity(self) -> bool: ...
    @property
    def nbytes(self) -> int: ...
    def extent(self) -> tuple[tuple[float, ...], tuple[float, ...], float, float]: ...
    def points(self, out: Singles | Floats) -> None: ...
    def measure(self, finest: float) -> tuple[float, int]: ...
    def sample(self, sampling: Sampling, box: Box | None = None) -> None: ...

def finite(samples: Array) -> bool: ...
def warp_stack(
    map: Map,
    height: int,
    width: int,
    planes: Sequence[int],
    tolerance: float,
    samplings: list[Sampling],
    box: Box | None = None,
    copied: list[bool] | None = None,
) -> Checks: ...
def needed(
    map: Map,
    height: int,
    width: int,
    planes: Sequence[int],
    tolerance: float,
    count: int,
    size: tuple[int, int],
    codes: Codes,
    box: Box,
) -> tuple[tuple[int, ...], list[float], Checks]: ...
def flatten(maps: Sequence[Map], base: int) -> bytes: ...

constants: dict[str, float]

# ---- folding

def smallest_strain(
    stroke: Floats,
    axes: Floats,
    free: float,
    distance: float,
    target: float,
    gap: float,
    freeze: Freeze | None = None,
) -> tuple[float, float]: ...
def largest_displacement(strokes: Floats, axes: Floats, freeze: Freeze | None = None) -> float: ...
def smallest_free_strain(stroke: Floats, gap: float) -> tuple[float, float, float]: ...
def is_whole(stroke: Floats, axes: Floats, freeze: Freeze | None = None) -> bool: ...

# ---- volumes

BRICK: int

class Look:
    def __init__(
        self,
        camera: Floats,
        skips: npt.NDArray[np.uint8],
        table: Singles,
        sums: Floats,
        low: float,
        scale: float,
        threshold: float,
        top: float,
        step: float,
        light: Sequence[float],
        shaded: bool,
        box: Floats,
        plane: Sequence[float],
        silhouettes: float,
        projection: int,
        arrives: Singles,
        placed: Singles,
        labelled: bool,
    ) -> None: ...

def draw(
    samples: Array,
    colours: Array | None,
    look: Look,
    map: Map | None,
    columns: Floats,
    rows: Floats,
    light: Singles,
    depth: Floats,
    work: Integers,
    ends: Singles | None = None,
) -> None: ...
def raster(
    look: Look,
    points: Floats,
    normals: Singles,
    triangles: npt.NDArray[np.int32],
    lines: npt.NDArray[np.int32],
    colour: Sequence[float],
    radius: float,
    columns: Floats,
    rows: Floats,
    out: Singles,
) -> None: ...
def brick_ranges(samples: Array, lows: Singles, highs: Singles) -> None: ...
def block_means(
    samples: Array, wide: Sequence[int], table: Singles, low: float, scale: float, out: Singles
) -> None: ...
def brick_distances(seen: npt.NDArray[np.bool_], out: npt.NDArray[np.uint8]) -> None: ...
def look_up(samples: Array, points: Singles, out: Singles, labelled: bool = False) -> None: ...
