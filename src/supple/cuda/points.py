"""Points on a GPU, through a deformation, and its inverse map."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.cuda.arrays import DeviceArray, contiguous, made_like, plain, taken
from supple.cuda.device import keep
from supple.cuda.programs import SOME, Program, launch, prepare, record
from supple.cuda.warp import Checks, lattice_of, paint
from supple.engine.core import CONVERGED
from supple.engine.sampling import Certificate
from supple.engine.work import Space
from supple.space.checks import refuse


def _columns(points: Any, ndim: int) -> DeviceArray:
    given = taken(points, "points")
    if given.ndim == 0 or given.shape[-1] != ndim:
        refuse("points", f"an array of shape (..., {ndim}), x first", told=f"shape {given.shape}")
    if given.dtype not in (np.float32, np.float64):
        refuse("points", "an array on a GPU of float32 or float64", told=f"dtype {given.dtype}")
    return contiguous(given)


def _moved(space: Space, given: DeviceArray, results: dict[str, DeviceArray], *, back: bool) -> Certificate:
    """Map points, and write the given results; for a composite map, wait for its counts."""
    count = given.size // space.ndim
    if not count:
        return Certificate(0.0, 0.0)
    gpu, stream = given.gpu, given.stream
    with gpu.current():
        lattice, checks = lattice_of(gpu, (space,)), Checks(stream)
        kernel = prepare(gpu, Program("points", space.ndim, space.composite is not None))
        pointers = {name: array.pointer for name, array in results.items()}
        job = record(SOME, map=lattice.memory.pointer, points=given.pointer, checks=checks.there.pointer, count=count,
                     tolerance=CONVERGED, wide=given.dtype == np.float64, back=back, **pointers)  # fmt: skip
        launch(kernel, job, stream, count)
        # An unknown library may free an array before it is read, so wait.
        if space.composite is None and given.kind != "other":
            keep(stream, checks, lattice, given)
            return Certificate(0.0, 0.0)
        checks.send()
        stream.synchronize()
    return Certificate(0.0, 0.0) if space.composite is None else checks.certificate(space)


def forward(space: Space, points: Any, *, matrices: bool = False) -> tuple[Any, Certificate]:
    """Return T of points (..., D), or ∂T/∂p (..., D, D), in float64, as arrays of their library; see `core.forward`."""
    given = _columns(points, space.ndim)
    results = {"to": made_like(given, given.shape, np.float64)}
    if matrices:
        results["matrices"] = made_like(given, (*given.shape, space.ndim), np.float64)
    certificate = _moved(space, given, results, back=False)
    return results["matrices" if matrices else "to"].given, certificate


def inverse(space: Space, points: Any) -> tuple[tuple[Any, Any, Any, Any], Certificate]:
    """Return T⁻¹ of points (..., D), with the values of `supple.Inverse`, as arrays of their library."""
    given = _columns(points, space.ndim)
    results = {"to": made_like(given, given.shape, np.float64)}
    for name, dtype in (("residual", np.float64), ("steps", np.int64), ("done", np.bool_)):
        results[name] = made_like(given, given.shape[:-1], dtype)
    certificate = _moved(space, given, results, back=True)
    points, residual, steps, done = (array.given for array in results.values())
    return (points, residual, steps, done), certificate


def inverse_map(space: Space, tolerance: float, like: Any, *, offsets: bool = False) -> tuple[Any, Certificate]:
    """Return the source point of every pixel, float32 (*shape, D), x first, in pixels, and the certificate.

    With ``offsets``, displacements from the pixels, which float32 stores more accurately.
    """
    given = taken(plain(like), "like")
    out = made_like(given, (*space.out, space.ndim), np.float32)
    with given.gpu.current():
        checks, to = Checks(given.stream), out.samples(0, coloured=True)
        _held = paint(given.gpu, (space,), out.dtype, checks, (0,) * 5, to, (0, space.planes[0]), tolerance=tolerance,
              average=offsets)  # fmt: skip
        checks.send()
        given.stream.synchronize()
    return out.given, checks.certificate(space)
