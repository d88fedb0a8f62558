"""T and T⁻¹ of points by the shaders that drawing is composed of, one point for each thread."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from supple.engine.work import Mask
from supple.gpu.device import Gpu
from supple.gpu.field import constants, stroke_buffers
from supple.gpu.memory import download, room, upload
from supple.gpu.shader import TURNS, shader, template

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]

TEXT = template(Path(__file__).with_name("points.wgsl").read_text(encoding="utf-8"))


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
    settings = {"strokes": table.size, "count": n, "tolerance": tolerance, "turns": turns}
    four = [upload(gpu, np.pad(values, ((0, 0), (0, 1))).astype(np.float32)) for values in (anchors, offsets)]
    given = {"anchors": four[0], "offsets": four[1], "results": room(gpu, n * 64)}
    work = shader(gpu, TEXT, entry, constants(table, freeze))
    work.run((-(-n // 64), 1, 1), settings, {**stroke_buffers(gpu, table, axes, freeze), **given})
    return download(gpu, given["results"], np.float32, n * 16).reshape(n, 4, 4).copy()
