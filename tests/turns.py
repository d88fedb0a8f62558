"""Brushes that twist, scale and pinch, and strokes that act at once, for tests of every engine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from supple.space.domain import Domain
from supple.strokes import Stroke, pack
from tests.reference import Step

AFFINE: dict[int, tuple[Stroke, ...]] = {
    2: (
        Stroke(brush="twist", at=(20.3, 17.7), angle=70, radius=7),
        Stroke(brush="twist", at=(20.3, 17.7), angle=70, radius=7, chord=True),
        Stroke(brush="scale", at=(20.3, 17.7), factor=1.6, radius=7, reach=2.5),
        Stroke(brush="pinch", at=(20.3, 17.7), factor=0.7, axis=(1, 2), radius=7, reach=None),
    ),
    3: (
        Stroke(brush="twist", at=(20.3, 17.7, 6.2), angle=-50, axis=(1, -2, 2), radius=7),
        Stroke(brush="scale", at=(20.3, 17.7, 6.2), factor=0.6, radius=7, reach=2.5),
        Stroke(brush="pinch", at=(20.3, 17.7, 6.2), factor=1.4, axis=(1, 2, -1), radius=7, poisson=0.3, reach=None),
    ),
}
"""One of each brush, for images and for volumes."""


def at_once(domain: Domain) -> tuple[npt.NDArray[np.void], list[Step]]:
    """Return a table of grabs and of brushes, some of which act at once, and what they do by the reference."""
    n, size, steps = domain.ndim, np.array(domain.shape[::-1]) - 1.0, np.array(domain.spacing)
    radius = 0.25 * float(size.max()) * float(steps.min())
    strokes = []
    for k, place in enumerate((0.3, 0.45, 0.6)):
        by = radius / steps * np.array([0.14, -0.09, 0.05])[:n] * (-1) ** k
        strokes.append(Stroke.grab(place * size, by=by, radius=radius, scales=1 + k, reach=(None, 4, 2.5)[k]))
    turns = [
        Stroke(brush="twist", at=tuple(0.4 * size), angle=12, radius=radius),
        Stroke(brush="pinch", at=tuple(0.55 * size), factor=0.9, radius=radius, poisson=0.3),
        Stroke(brush="scale", at=tuple(0.7 * size), factor=1.1, radius=radius),
    ]
    alone, last = (Stroke.grab(p * size, by=0.1 * radius / steps, radius=radius) for p in (0.5, 0.2))
    table = pack([alone, *strokes, *turns[:2], last, turns[2]], domain.spacing, time=domain.time)
    table["joined"] = [0, 0, 1, 1, 1, 1, 0, 1]
    return table, [alone, (*strokes, *turns[:2]), (last, turns[2])]
