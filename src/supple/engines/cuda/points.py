"""Points on a GPU, through a deformation, and its inverse map."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.domain import refuse
from supple.engines.base import Certificate, Space, check_plain
from supple.engines.cuda import field, newton
from supple.engines.cuda.arrays import DeviceArray, contiguous, made_like, plain, taken
from supple.engines.cuda.colour import FILTERS, NOTHING
from supple.engines.cuda.kernel import THREADS, blocks, launched
from supple.engines.cuda.sample import Way
from supple.engines.cuda.warp import Colours, Frames, Pieces, held, lattice_of, make_planes, told_of


def _columns(points: Any, ndim: int) -> DeviceArray:
    given = taken(points, "points")
    if given.ndim == 0 or given.shape[-1] != ndim:
        refuse("points", f"an array of shape (..., {ndim}), x first", f"shape {given.shape}")
    if given.dtype not in (np.float32, np.float64):
        refuse("points", "an array on a GPU of float32 or float64", f"dtype {given.dtype}")
    return contiguous(given)


def _known(space: Space, given: DeviceArray) -> tuple[Any, Any]:
    check_plain(space)
    known, spans = field.packed([space.table], [space.axes])
    return held(given.gpu, known), held(given.gpu, spans)


def forward(space: Space, points: Any, *, matrices: bool) -> Any:
    """Return T of points (..., D), or ∂T/∂p (..., D, D), in pixels and float64, in the library of the points."""
    given = _columns(points, space.ndim)
    moved = made_like(given, given.shape, np.float64)
    found = made_like(given, (*given.shape, space.ndim), np.float64) if matrices else None
    n = given.span // space.ndim
    with given.gpu.current():
        known, spans = _known(space, given)
        nothing = held(given.gpu, np.zeros(0))
        if n:
            launched(field.forward, blocks(n), THREADS, given.stream)(
                known, spans, space.ndim, given.flat(), moved.flat(), found.flat() if found else nothing
            )
            _wait_for(given)
    return found.given if found else moved.given


def _wait_for(given: DeviceArray) -> None:
    """Wait, if the library does not keep an array alive until it is read."""
    if given.kind == "numba" and not hasattr(given.given, "__cuda_ndarray__"):
        given.stream.synchronize()


def inverse(space: Space, points: Any) -> tuple[Any, Any, Any, Any]:
    """Return T⁻¹ of points (..., D), with the values of `supple.Inverse`, in the library of the points."""
    finest = float(space.axes[: space.ndim, 3].min())
    given = _columns(points, space.ndim)
    found = made_like(given, given.shape, np.float64)
    kinds = (np.float64, np.int64, np.bool_)
    residual, steps, converged = (made_like(given, given.shape[:-1], dtype) for dtype in kinds)
    n = given.span // space.ndim
    with given.gpu.current():
        known, spans = _known(space, given)
        if n:
            launched(newton.inverse, blocks(n), THREADS, given.stream)(
                known, spans, space.ndim, given.flat(), finest,
                found.flat(), residual.flat(), steps.flat(), converged.flat(),
            )  # fmt: skip
            _wait_for(given)
    return found.given, residual.given, steps.given, converged.given


def inverse_map(space: Space, like: Any, tolerance: float, *, offsets: bool = False) -> tuple[Any, Certificate]:
    """Return the source point of every pixel, float32 (*shape, D), x first, in pixels, and the certificate.

    With ``offsets``, displacements from the pixels, which float32 stores more accurately.
    """
    check_plain(space)
    given = taken(plain(like), "like")
    out = made_like(given, (*space.whole, space.ndim), np.float32)
    gpu, stream = given.gpu, given.stream
    strides = out.strides if space.ndim == 3 else (0, *out.strides)
    with gpu.current():
        lattice = lattice_of(gpu, (space,))
        pieces = Pieces(out, [lattice], space.count)
        nothing = held(gpu, np.zeros(1, np.float32))
        way = Way(FILTERS["offsets" if offsets else "map"], NOTHING)
        colours = Colours(way, nothing, (-1, 0, 0), (0.0, 0.0, 1.0))
        source = Frames(nothing, (space.count, *space.shape, space.ndim, 0, 0, 0, 0, 0, 0, space.count, 0, space.count))
        into = Frames(out.flat(), (space.count, *space.shape, space.ndim, *strides, 0, 0, space.count, 0, space.count))
        make_planes(
            gpu, stream, lattice, pieces, colours, space.shape, (0, space.count), source, into, tolerance=tolerance
        )
        return out.given, told_of(pieces, stream)
