"""Arrays that live on a CUDA device, or are sent there. CUDA is imported when there is a device."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.domain import choice, refuse
from supple.workers import note

if TYPE_CHECKING:
    from supple.certificate import Certificate
    from supple.cuda.card import Card
    from supple.streaming import Sampling, Space, Tell

__all__ = ["check_sent", "is_on_card", "open_card", "points_on_card", "warp_on_card", "warp_sent"]


def open_card(number: int = 0) -> Card:
    """Return the CUDA device of a number, ready to work; SuppleError says why it cannot be used."""
    from supple.cuda import card

    return card.open_card(number)


def is_on_card(value: object) -> bool:
    """Return whether something is an array on a CUDA device; no library is imported to find out."""
    if isinstance(value, np.ndarray):
        return False
    from supple.cuda import arrays

    return arrays.is_on_card(value)


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
    """Warp an array on a CUDA device, or a batch of them, and wait for it; SuppleError if that cannot be done."""
    choice("device", device, ("auto", "cpu", "gpu", "cuda"))
    if device == "gpu":
        refuse("device", "left out for an array on a CUDA device, which is warped there", device)
    open_card()
    from supple.cuda import job

    work = job.checked(source, spaces, sampling, alpha=alpha, out=out, batch=batch)
    return work.out.given, job.finish(work)


def check_sent(sampling: Sampling, dtype: np.dtype[Any]) -> None:
    """Refuse what no CUDA device does, and that there is none, before any work; SuppleError says why."""
    open_card()
    from supple.cuda.warp import check_known

    check_known(dtype)


def warp_sent(
    source: Any,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None,
    out: npt.NDArray[Any] | None,
    tell: Tell = lambda done: None,
) -> tuple[npt.NDArray[Any], Certificate] | None:
    """Warp an array of the host on a CUDA device.

    Parameters
    ----------
    source, space, sampling, alpha, out, tell
        As `supple.cuda.large.warp_host` takes them.

    Returns
    -------
    array and Certificate, or None
        None where the device failed, and the CPU should do it.

    Raises
    ------
    SuppleError
        If there is no CUDA device that can be used, or an argument does not fit.
    """
    card = open_card()
    from supple.cuda.card import failures
    from supple.cuda.large import warp_host
    from supple.gpu.kernel import let_through, passing
    from supple.gpu_clips import warn

    failed = ""
    with let_through():
        try:
            made = warp_host(card, source, space, sampling, alpha=alpha, out=out, tell=passing(tell))
            if made[1].unknown:
                failed = f"{made[1].unknown} points could not be solved to the tolerance"
        except failures() as error:
            failed = " ".join(str(error).split())[:120] or type(error).__name__
    if failed:
        warn(card.name, failed, 5)
        return None
    if space.table.size:
        note(card.name)
    return made


def points_on_card() -> ModuleType:
    """Return the module that moves points on the GPU (`supple.cuda.points`); SuppleError if CUDA cannot be used."""
    open_card()
    from supple.cuda import points

    return points
