"""Samples that follow the motion between two frames, point by point."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tests.reference.samples import _interpolated, _place, sample

Floats = npt.NDArray[np.float64]


def displacement_at(
    fields: npt.NDArray[np.float32], points: Floats, a: Floats, first: tuple[float, float], apart: float
) -> Floats:
    """Return v and its weight, (N, 3), of points that are seen the part a of a frame after the first of a pair.

    With u(m) the displacement of what is at m halfway, it is that v for which v = u(p + (1/2 - a) v).
    """
    place = (points - first) / apart
    v, values = np.zeros((len(points), 3)), fields[..., :3].astype(np.float64)
    for _ in range(60):
        at = place + (0.5 - a)[:, None] * v[:, :2] / apart
        before, v = v, _interpolated(values, at[:, 0], at[:, 1], "linear", "edge", np.zeros(3))
        if np.abs(v - before).max(initial=0) < 1e-13:
            break
    return v


def sample_between(
    source: npt.NDArray[Any],
    points: Floats,
    fields: npt.NDArray[np.float32],
    longest: list[float],
    first: tuple[float, float],
    apart: float,
    filter: str,
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    step: tuple[int, int] = (1, 1),
    offset: tuple[float, float] = (0.0, 0.0),
    matrices: Floats | None = None,
) -> Floats:
    """Return samples of frames (T, h, w, C) at points (N, 3) in pixels of the frame, x first.

    ``fields`` (T - 1, h, w, 4) and ``longest`` are those of each pair; samples lie ``step`` pixels apart, the first at
    ``offset``.
    """
    count, channels = len(source), source.shape[3]
    made = np.zeros((len(points), channels))
    value = np.broadcast_to(np.asarray(fill, np.float64), (channels,))

    def seen(k: int, at: Floats, some: npt.NDArray[np.bool_]) -> Floats:
        own = int(_place(np.array(k), count, outside))
        if own < 0:
            return np.broadcast_to(value, (len(at), channels))
        every = None if matrices is None else matrices[some]
        return np.asarray(sample(source[own], (at - offset) / step, every, filter, outside, fill))

    whole = np.floor(points[:, 2]).astype(np.int64)
    for k in np.unique(whole):
        some = whole == k
        p, a = points[some, :2], points[some, 2] - k
        i, j = (int(_place(np.array(n), count, outside)) for n in (k, k + 1))
        v, weight, after = np.zeros_like(p), np.zeros(len(p)), a
        if i >= 0 and j >= 0 and i != j:
            pair = min(i, j)
            if longest[pair] < 0:
                weight, after = np.ones(len(p)), np.clip((a - 0.5) / 0.1 + 0.5, 0, 1)
            elif longest[pair] > 0:
                forth = i < j  # or the clip plays backwards, in its mirror image
                found = displacement_at(fields[pair], p, a if forth else 1 - a, first, apart)
                v, weight = found[:, :2] * (1 if forth else -1), found[:, 2]
        mixed = (1 - a)[:, None] * seen(k, p, some) + a[:, None] * seen(k + 1, p, some)
        before, behind = seen(k, p - a[:, None] * v, some), seen(k + 1, p + (1 - a)[:, None] * v, some)
        along = (1 - after)[:, None] * before + after[:, None] * behind
        made[some] = np.where((a == 0)[:, None], mixed, weight[:, None] * along + (1 - weight)[:, None] * mixed)
    return made
