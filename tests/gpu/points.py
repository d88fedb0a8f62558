"""T and T⁻¹ of points by the shaders that drawing is composed of, one point for each thread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.folding.strain import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import FIELD, constants, uploaded
from supple.gpu.kernel import (
    READ,
    TURNS,
    UNIFORM,
    WRITE,
    download,
    pipeline,
    room,
    run,
    source,
    spread,
    upload,
)

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]

NAMES = (*FIELD, "turns", "points")
KINDS = (UNIFORM, UNIFORM, READ, READ, READ, WRITE, READ)


def compiled(gpu: Gpu, entry: str, known: dict[str, int] | None = None) -> Any:
    """Return a pipeline of points.wgsl, which lies beside this file, and its layout."""
    if NAMES not in gpu.pipelines:
        code = source(*NAMES[:-1]) + Path(__file__).with_name("points.wgsl").read_text(encoding="utf-8")
        gpu.pipelines[NAMES] = gpu.device.create_shader_module(code=code)
    return pipeline(gpu, NAMES, entry, KINDS, known)


def forward(
    gpu: Gpu, table: npt.NDArray[np.void], axes: Floats, anchors: Floats, offsets: Floats, freeze: Mask | None = None
) -> tuple[Singles, Singles]:
    """Return T(p) - anchor (N, 3) and ∂T/∂p (N, 3, 3) of points p = ``anchors + offsets`` (N, 3), in physical units."""
    found = _points(gpu, "forward", table, axes, anchors, offsets, 0.0, freeze)
    return found[:, 0, :3], np.moveaxis(found[:, 1:, :3], 1, 2)


def inverse(
    gpu: Gpu,
    table: npt.NDArray[np.void],
    axes: Floats,
    anchors: Floats,
    tolerance: float,
    freeze: Mask | None = None,
    turns: int = TURNS,
) -> tuple[Singles, Singles, Singles]:
    """Return T⁻¹(q) - q of points q (N, 3), in physical units, the residual |T(p) - q| and the evaluations of T."""
    found = _points(gpu, "inverse", table, axes, anchors, np.zeros_like(anchors), tolerance, freeze, turns)
    return found[:, 0, :3], found[:, 0, 3], found[:, 1, 3]


def _points(
    gpu: Gpu,
    entry: str,
    table: npt.NDArray[np.void],
    axes: Floats,
    anchors: Floats,
    offsets: Floats,
    tolerance: float,
    freeze: Mask | None,
    turns: int = TURNS,
) -> Singles:
    n = len(anchors)
    settings = np.zeros(1, [("strokes", "u4"), ("count", "u4"), ("tolerance", "f4"), ("turns", "u4")])
    settings["strokes"], settings["count"], settings["tolerance"] = table.size, n, tolerance
    settings["turns"] = turns
    four = [upload(gpu, np.pad(values, ((0, 0), (0, 1))).astype(np.float32)) for values in (anchors, offsets)]
    results = room(gpu, n * 64)
    places, strokes, mask = uploaded(gpu, table, axes, freeze)
    buffers = [upload(gpu, settings, UNIFORM), places, strokes, *four, results, mask]
    run(gpu, [(compiled(gpu, entry, constants(table, freeze)), buffers, (*spread(n, 64), 1))])
    return download(gpu, results, np.float32, n * 16).reshape(n, 4, 4).copy()
