"""The strokes and their domain in the layout of the shaders; T and T⁻¹ of points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.kernel import READ, TURNS, UNIFORM, WRITE, download, pipeline, room, run, spread, upload

Floats = npt.NDArray[np.float64]

STROKE = np.dtype(
    [
        ("pivot", np.float32, 3),
        ("terms", np.float32),
        ("rest", np.float32, 4),
        ("force", np.float32, 3),
        ("power", np.float32),
        ("matrix", np.float32, (3, 4)),
        ("radius2", np.float32, 4),
        ("p", np.float32, 4),
        ("q", np.float32, 4),
        ("r", np.float32, 4),
        ("joined", np.uint32, 4),
    ]
)
_POINTS = ("field", "newton", "points", "turns")


def packed(table: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return a table of strokes (`supple.strokes.pack`) in float32: each pivot as the sum of two numbers, and 1/R.

    The weights are those of powers of ε/ρ, so that no power of ρ overflows.
    """
    out = np.zeros(table.size, STROKE)
    power, radius = table["power"][:, None], np.sqrt(table["radius2"])
    with np.errstate(over="ignore"):  # checked by `fits`
        out["pivot"] = table["pivot"]
        out["rest"][:, :3] = table["pivot"] - out["pivot"].astype(np.float64)
        out["rest"][:, 3] = 1.0 / table["reach"]
        out["force"], out["terms"], out["power"] = table["force"], table["terms"], table["power"]
        out["matrix"][..., :3] = np.swapaxes(table["matrix"], 1, 2)  # columns
        out["joined"][:, 0] = table["joined"]
        out["radius2"][:, :3] = table["radius2"]
        for name, n in (("p", power), ("q", power + 2), ("r", power + 2)):
            out[name][:, :3] = table[name] / radius**n
    return out


def constants(table: npt.NDArray[np.void]) -> dict[str, int]:
    """Return the constants of shaders for a table: software adapters run both sides of a branch."""
    return {"GRABS": int(bool((table["power"] == 1).all() and not table["joined"].any()))}


def fits(table: npt.NDArray[np.void]) -> bool:
    """Return whether float32 holds all numbers of a table and their products."""
    made = packed(table)
    names = ("pivot", "force", "matrix", "radius2", "p", "q", "r")
    return all(bool((np.abs(made[name]) < 1e18).all()) for name in names)


def local(table: npt.NDArray[np.void]) -> bool:
    """Return whether all strokes have a limited reach, so that some pixels may be unchanged."""
    return bool(np.isfinite(table["reach"]).all())


def reached(table: npt.NDArray[np.void], axes: Floats, planes: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Return the mask of the planes, in a range of the third axis, that intersect the ball of any stroke."""
    z = np.arange(*planes)[:, None] * axes[2, 3]
    return np.asarray((np.abs(z - table["pivot"][:, 2]) < table["reach"]).any(axis=1))


def domain(axes: Floats) -> npt.NDArray[np.float32]:
    """Return a packed domain (`Domain.packed`) in the layout of the shaders.

    Its rows are the first and last faces of the three axes, the widths of the border, the spacing and the profiles.
    The fourth spacing is the unit of errors: the least spacing of the axes along which points move. An image has no
    displacement along its third axis.
    """
    out = np.zeros((5, 4), np.float32)
    out[:, :3] = axes.T
    moving = (axes[:, 1] != axes[:, 0]) | (axes[:, 2] != 0.0)
    out[3, 3] = axes[moving if moving.any() else ..., 3].min()
    return out


def forward(
    gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, anchors: Floats, offsets: Floats
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return T(p) - anchor (N, 3) and ∂T/∂p (N, 3, 3) of points p = ``anchors + offsets`` (N, 3), in physical units."""
    found = _points(gpu, "forward", table, axes, anchors, offsets, 0.0)
    return found[:, 0, :3], np.moveaxis(found[:, 1:, :3], 1, 2)


def inverse(
    gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, anchors: Floats, tolerance: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return T⁻¹(q) - q of points q (N, 3), in physical units, the residual |T(p) - q| and the evaluations of T."""
    found = _points(gpu, "inverse", table, axes, anchors, np.zeros_like(anchors), tolerance)
    return found[:, 0, :3], found[:, 0, 3], found[:, 1, 3]


def _points(
    gpu: Gpu, entry: str, table: npt.NDArray[np.void], axes: Floats, anchors: Floats, offsets: Floats, tolerance: float
) -> npt.NDArray[np.float32]:
    n = len(anchors)
    settings = np.zeros(1, [("strokes", "u4"), ("count", "u4"), ("tolerance", "f4"), ("turns", "u4")])
    settings["strokes"], settings["count"], settings["tolerance"] = table.size, n, tolerance
    settings["turns"] = TURNS

    def four(values: Floats) -> Any:
        return upload(gpu, np.pad(values, ((0, 0), (0, 1))).astype(np.float32))

    results = room(gpu, n * 64)
    buffers = [
        upload(gpu, settings, UNIFORM),
        upload(gpu, domain(axes), UNIFORM),
        upload(gpu, packed(table)),
        four(anchors),
        four(offsets),
        results,
    ]
    made = pipeline(gpu, _POINTS, entry, (UNIFORM, UNIFORM, READ, READ, READ, WRITE), constants(table))
    run(gpu, [(made, buffers, spread(n, 64))])
    return download(gpu, results, np.float32, n * 16).reshape(n, 4, 4).copy()
