"""Landmarks of a volume, their positions after strokes, and the same points in a fixed volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.space.geometry import Floats
from supple.strokes import Stroke

_NOWHERE = (np.nan,) * 3


class Landmarks:
    """Named points of a volume before strokes, and of a fixed one: float64 voxels (N, 3), x first; NaN if missing.

    A landmark with both points is a pair; its residual is the distance from the first, moved by strokes, to the fixed
    one. They are immutable: edits return others. ``open`` is the index of a landmark whose second point is not set yet.
    """

    def __init__(
        self, names: Sequence[str], points: Floats, fixed: Floats | None = None, *, open: int | None = None
    ) -> None:
        self.names, self.points, self.open = tuple(names), np.asarray(points, np.float64), open
        self.fixed = np.full(self.points.shape, np.nan) if fixed is None else np.asarray(fixed, np.float64)
        self._moved: tuple[Deformation, Floats] | None = None

    @classmethod
    def paired(cls, names: Sequence[str], points: Floats, others: Sequence[str], fixed: Floats) -> Landmarks:
        """Return the landmarks of two files: matched by their names, or in order if these differ or occur twice."""
        order = list(others)
        if not set(names) & set(others) or len(set(names)) < len(names) or len(set(order)) < len(order):
            if len(names) != len(others):
                what = f"{len(names)} and {len(others)} landmarks, whose names do not match: give as many of both"
                raise SuppleError(f"the files have {what}, in order")
            return cls(names, points, fixed)
        known = [*names, *(name for name in others if name not in names)]
        both = (dict(zip(names, points.tolist(), strict=True)), dict(zip(others, fixed.tolist(), strict=True)))
        return cls(known, *(np.array([each.get(name, _NOWHERE) for name in known]).reshape(-1, 3) for each in both))

    @property
    def pairs(self) -> list[int]:
        """The indices of the landmarks with both points."""
        return np.flatnonzero(np.isfinite(self.points).all(1) & np.isfinite(self.fixed).all(1)).tolist()

    def moved(self, deformation: Deformation) -> Floats:
        """Return the positions of the points after strokes, (N, 3); the last result is cached."""
        if deformation.is_identity:
            return self.points
        if self._moved is None or self._moved[0] is not deformation:
            made, known = self.points.copy(), np.isfinite(self.points).all(1)
            made[known] = deformation.forward(made[known])
            self._moved = deformation, made
        return self._moved[1]

    def residuals(self, deformation: Deformation) -> Floats:
        """Return the residual of each landmark after strokes, in millimetres, (N,); NaN where it is no pair."""
        away = (self.moved(deformation) - self.fixed) * deformation.domain.spacing
        return np.asarray(np.linalg.norm(away, axis=1))

    def clicked(self, point: tuple[float, ...], deformation: Deformation, fixed: bool | None) -> Self:
        """Return landmarks with a clicked point of the open pair or, if there is none, of a new one.

        ``point`` is in voxels of the deformed volume, or of the fixed one if ``fixed``. With None, one picture shows
        both volumes: the first point of a pair is that of the deformed one.
        """
        i, names, both = self.open, self.names, [self.points.copy(), self.fixed.copy()]
        if i is None:
            i, number = len(names), len(names) + 1
            while str(number) in names:
                number += 1
            names, both = (*names, str(number)), [np.vstack([each, _NOWHERE]) for each in both]
        theirs = fixed if fixed is not None else bool(np.isfinite(both[0][i]).all())
        both[theirs][i] = point if theirs else deformation.inverse(point).points
        return type(self)(names, *both, open=None if np.isfinite([each[i] for each in both]).all() else i)

    def without(self, i: int) -> Self:
        """Return the landmarks without number ``i``."""
        return type(self)(
            self.names[:i] + self.names[i + 1 :], *(np.delete(v, i, 0) for v in (self.points, self.fixed))
        )

    def pull(self, deformation: Deformation, brush: Stroke) -> Stroke:
        """Return the stroke that brings the points of all pairs from their present positions to the fixed ones.

        Points that are there already become pins. The radius, reach and Poisson ratio are those of ``brush``.
        """
        pairs = self.pairs
        if not pairs:
            raise SuppleError("no landmark has a point in both volumes: click it in both, or open files of points")
        start, end = self.moved(deformation)[pairs], self.fixed[pairs]
        made = Stroke.pull(start.tolist(), to=end.tolist(), radius=brush.radius, poisson=brush.poisson)
        return replace(made, reach=brush.reach)
