"""Points on a GPU, through a deformation, and its inverse map."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.domain import refuse
from supple.engines.base import Certificate, Space, warn_of
from supple.engines.cuda.arrays import DeviceArray, contiguous, made_like, plain, taken
from supple.engines.cuda.layout import SOME
from supple.engines.cuda.programs import Program, blocks, launch
from supple.engines.cuda.warp import Planes, Told, lattice_of, mapper, paint
from supple.engines.native import CONVERGED


def _columns(points: Any, ndim: int) -> DeviceArray:
    given = taken(points, "points")
    if given.ndim == 0 or given.shape[-1] != ndim:
        refuse("points", f"an array of shape (..., {ndim}), x first", f"shape {given.shape}")
    if given.dtype not in (np.float32, np.float64):
        refuse("points", "an array on a GPU of float32 or float64", f"dtype {given.dtype}")
    return contiguous(given)


def _moved(space: Space, given: DeviceArray, results: dict[str, DeviceArray], *, back: bool) -> Certificate:
    """Map points, and write what is asked for; it waits only for what is known of a composite map."""
    count = given.size // space.ndim
    if not count:
        return Certificate(0.0, 0.0)
    gpu, stream = given.gpu, given.stream
    with gpu.current():
        lattice, told, job = lattice_of(gpu, (space,)), Told.on(stream), np.zeros(1, SOME)
        job["map"], job["points"], job["told"] = lattice.memory.pointer, given.pointer, told.there.pointer
        for name, array in results.items():
            job[name] = array.pointer
        job["count"], job["tolerance"] = count, CONVERGED
        job["wide"], job["back"] = given.dtype == np.float64, back
        launch(gpu, Program("points", space.ndim, space.composite is not None), blocks(count), job, stream)
        told.send()
        # An unknown library may not keep an array alive until it is read.
        if space.composite is None and given.kind != "other":
            _kept_until_read(stream, told, lattice, given)
            return Certificate(0.0, 0.0)
        stream.synchronize()
    return told.certificate(space)


_reading: list[tuple[Any, ...]] = []


def _kept_until_read(stream: Any, *held: Any) -> None:
    """Keep objects alive until a stream gets here."""
    _reading[:] = [each for each in _reading if not each[0].done()]
    _reading.append((stream.record(), *held))


def forward(space: Space, points: Any, *, matrices: bool) -> Any:
    """Return T of points (..., D), or ∂T/∂p (..., D, D), in pixels and float64, in the library of the points."""
    given = _columns(points, space.ndim)
    results = {"to": made_like(given, given.shape, np.float64)}
    if matrices:
        results["matrices"] = made_like(given, (*given.shape, space.ndim), np.float64)
    certificate = _moved(space, given, results, back=False)
    if space.composite is not None:
        warn_of(certificate, 1.0, 4)
    return results["matrices" if matrices else "to"].given


def inverse(space: Space, points: Any) -> tuple[Any, Any, Any, Any]:
    """Return T⁻¹ of points (..., D), with the values of `supple.Inverse`, in the library of the points."""
    given = _columns(points, space.ndim)
    results = {"to": made_like(given, given.shape, np.float64)}
    for name, dtype in (("residual", np.float64), ("steps", np.int64), ("done", np.bool_)):
        results[name] = made_like(given, given.shape[:-1], dtype)
    _moved(space, given, results, back=True)
    found, residual, steps, done = (array.given for array in results.values())
    return found, residual, steps, done


def inverse_map(space: Space, like: Any, tolerance: float, *, offsets: bool = False) -> tuple[Any, Certificate]:
    """Return the source point of every pixel, float32 (*shape, D), x first, in pixels, and the certificate.

    With ``offsets``, displacements from the pixels, which float32 stores more accurately.
    """
    given = taken(plain(like), "like")
    out = made_like(given, (*space.out, space.ndim), np.float32)
    with given.gpu.current():
        made, told = mapper(given.gpu, space, tolerance, offsets=offsets), Told.on(given.stream)
        plane, row, column, channel = out.strides if out.ndim == 4 else (0, *out.strides)
        planes = space.planes[0] if space.ndim == 3 else 1
        paint(made, given.stream, None, Planes(out.pointer, (plane, row, column, channel)), (0, planes), told)
        told.send()
        given.stream.synchronize()
    return out.given, told.certificate(space)
