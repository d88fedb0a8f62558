"""Newton's method on sampled displacement fields, for all points at once, on the device of the tensors.

The rules are those of the core (`undo_field` in `sampled.hpp`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import torch

from supple.engines.torch.field import Columns, solved
from supple.engines.torch.sampled import Samples, displaced

_ROUNDS, _FEWER = 24, 12  # evaluations of one solution, and of one on the way to another
_LEAST = 2.0**-12  # the least part of a step
_TRIES = 200
_RELAXED = 100  # iterations of the fixed point


@dataclass(slots=True, eq=False)
class Found:
    """Indices i with i + w(i) = target, of P points.

    Parameters
    ----------
    points : float64 tensor, shape (D, P)
    determinant : float64 tensor, shape (P,)
        That of I + J.
    step2 : float64 tensor, shape (P,)
        The squared distance to the solution, to first order.
    done : bool tensor, shape (P,)
        Whether that is within the tolerance.
    """

    points: torch.Tensor
    determinant: torch.Tensor
    step2: torch.Tensor
    done: torch.Tensor

    @classmethod
    def at(cls, points: torch.Tensor) -> Self:
        """Return points that are not solved yet."""
        one = torch.ones_like(points[0])
        return cls(points.clone(), one, 1e300 * one, torch.zeros_like(one, dtype=torch.bool))

    def put(self, where: torch.Tensor, other: Found) -> None:
        """Replace some points, given by their numbers."""
        self.points[:, where] = other.points
        self.determinant[where] = other.determinant
        self.step2[where] = other.step2
        self.done[where] = other.done

    def part(self, mask: torch.Tensor) -> Found:
        """Return some of the points."""
        return Found(self.points[:, mask], self.determinant[mask], self.step2[mask], self.done[mask])


def solve(samples: Samples, target: torch.Tensor, base: torch.Tensor, tolerance: float) -> Found:
    """Return the indices that are mapped to targets, from several starts where Newton's method fails from the first.

    Parameters
    ----------
    samples : Samples
    target : float64 tensor, shape (D, P)
        Indices.
    base : int64 tensor, shape (P,)
        The number of the first sample of each point's field.
    tolerance : float
        The largest distance to the solution, in samples.
    """
    found = _newton(samples, target, base, target, tolerance, _ROUNDS)
    for attempt in range(4):
        left = (~found.done).nonzero()[:, 0]
        if not len(left):
            break
        goal, own = target[:, left], base[left]
        start = goal
        if attempt == 1:
            start = goal - torch.stack(displaced(samples, list(goal), own)[0])
        elif attempt == 2:
            start = found.points[:, left]
        elif attempt == 3:  # by the residual alone, which passes folds
            for _ in range(_RELAXED):
                there = start + torch.stack(displaced(samples, list(start), own)[0])
                start = start - 0.5 * (there - goal)
        other = _followed(samples, goal, own, start, tolerance)
        found.put(left[other.done], other.part(other.done))
    return found


def _newton(
    samples: Samples, target: torch.Tensor, base: torch.Tensor, start: torch.Tensor, tolerance: float, rounds: int
) -> Found:
    """Return solutions by Newton's method with backtracking."""
    made = Found.at(start)
    live = torch.arange(len(base), device=base.device)
    found, step = Found.at(start), torch.zeros_like(start)
    error, part = torch.full_like(start[0], 1e300), torch.ones_like(start[0])
    for _ in range(rounds):
        tried = found.points + part * step
        w, rows = displaced(samples, list(tried), base)
        e = tried + torch.stack(w) - target
        e2 = (e * e).sum(0)
        taken = e2 <= error * (1 - 1e-4 * part)
        determinant = _determinant(rows)
        columns: list[Columns] = [list(column) for column in zip(*rows, strict=True)]
        move = -torch.stack(solved(columns, list(e)))
        d2 = (move * move).sum(0)
        # Where the field folds, or nearly does, by the residual, and never far.
        far2 = (16 * e2).clamp(min=1)
        shrink = torch.where(d2 > far2, torch.sqrt(far2 / d2), 1.0)
        move = torch.where(determinant > 1e-3, shrink * move, -e)
        found.points = torch.where(taken, tried, found.points)
        step = torch.where(taken, move, step)
        found.step2 = torch.where(taken, d2, found.step2)
        found.determinant = torch.where(taken, determinant, found.determinant)
        error = torch.where(taken, e2, error)
        part = torch.where(taken, 1.0, 0.5 * part)
        found.done = taken & (d2 <= tolerance * tolerance) & (e2 <= 1e2 * tolerance * tolerance)
        ended = found.done | (part <= _LEAST)
        made.put(live[ended], found.part(ended))
        on = ~ended
        live, base, target, found = live[on], base[on], target[:, on], found.part(on)
        step, error, part = step[:, on], error[on], part[on]
        if not len(live):
            return made
    made.put(live, found)
    return made


def _followed(
    samples: Samples, target: torch.Tensor, base: torch.Tensor, start: torch.Tensor, tolerance: float
) -> Found:
    """Return solutions that are followed along the straight lines from start + w(start) to the targets."""
    made = Found.at(start)
    origin = start + torch.stack(displaced(samples, list(start), base)[0])
    here, way = start.clone(), torch.zeros_like(start[0])
    stride = torch.full_like(way, 0.5)
    for _ in range(_TRIES):
        live = ((way < 1) & (stride > 1e-4)).nonzero()[:, 0]
        if not len(live):
            break
        to = (way[live] + stride[live]).clamp(max=1)
        goal = origin[:, live] + to * (target[:, live] - origin[:, live])
        got = _newton(samples, goal, base[live], here[:, live], tolerance, _FEWER)
        stride[live] *= torch.where(got.done, 2.0, 0.5)
        well = live[got.done]
        here[:, well] = got.points[:, got.done]
        way[well] = to[got.done]
        arrived = got.done & (to >= 1)
        made.put(live[arrived], got.part(arrived))
    return made


def _determinant(rows: list[Columns]) -> torch.Tensor:
    if len(rows) == 2:
        (a, b), (c, d) = rows
        return a * d - b * c
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
