"""Arrays that live on a card: what is done with them there. CUDA is imported when there is one."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

from supple.cpu.warp import Certificate
from supple.cuda.arrays import is_on_card
from supple.cuda.card import open_card
from supple.domain import choice, refuse
from supple.streaming import Sampling, Space

__all__ = ["is_on_card", "points_on_card", "warp_on_card"]


def warp_on_card(
    source: Any,
    spaces: Sequence[Space],
    sampling: Sampling,
    *,
    alpha: bool | None,
    out: Any,
    device: str,
    batch: bool = False,
) -> tuple[Any, Certificate]:
    """Warp an array on a card, or a batch of them, and wait for it; SuppleError if that cannot be done."""
    choice("device", device, ("auto", "cpu", "gpu", "cuda"))
    if device == "gpu":
        refuse("device", "left out for an array on a card, which is warped there", device)
    open_card()
    from supple.cuda import job

    work = job.checked(source, spaces, sampling, alpha=alpha, out=out, batch=batch)
    return work.out.given, job.finish(work)


def points_on_card() -> ModuleType:
    """What carries points there (`supple.cuda.points`); SuppleError if CUDA cannot be used."""
    open_card()
    from supple.cuda import points

    return points
