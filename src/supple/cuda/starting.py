"""Warps that others need not wait for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from supple.cuda import job
from supple.domain import integer
from supple.streaming import Space
from supple.warping import checked_sampling, one_or_each


class Deforming(Protocol):
    """Anything with a space: a `supple.Deformation`."""

    @property
    def space(self) -> Space:
        """The strokes on their domain."""


def start(
    source: Any,
    deformations: Deforming | Sequence[Deforming],
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str = "edge",
    fill: float | Sequence[float] = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
    between: str | None = None,
    time_filter: bool = False,
    slab: int | None = None,
    stream: Any = None,
    out: Any = None,
) -> job.Warping:
    """Hand a warp over to a GPU, and go on at once.

    It begins when what was handed over to the source's stream before is done, and goes on beside what comes after.

    Parameters
    ----------
    source : array on a GPU
        As `supple.Deformation.warp` takes it; or a batch (N, …).
    deformations : Deformation or sequence of Deformation
        One; or a sequence for a batch, of one for all, or of N.
    filter, tolerance, outside, fill, alpha, linear_light, between, time_filter
        As in `supple.Deformation.warp`.
    slab : int, optional
        How many planes of a stack are handed over at once: between two slabs, other streams' kernels get their turn.
        By default, as many as need 256 MB beside the arrays.
    stream : stream of PyTorch, CuPy or Numba, optional
        Where it goes on, if not on a stream of its own.
    out : array on the same GPU, optional
        Where to put the result.

    Returns
    -------
    Warping
        To wait for, or to poll. Neither the source nor the result may be touched before it is done, unless their stream
        was told to wait (`Warping.join`).

    Raises
    ------
    SuppleError
        If an argument does not fit, or the GPU cannot be used.
    """
    batch = isinstance(deformations, Sequence)
    spaces = one_or_each(deformations)
    sampling = checked_sampling(
        spaces[0].ndim, filter=filter, tolerance=tolerance, outside=outside, fill=fill, linear_light=linear_light,
        between=between, time_filter=time_filter,
    )  # fmt: skip
    if slab is not None:
        slab = integer("slab", slab, "a number of planes from 1 on", 1, 1 << 30)
    work = job.checked(source, spaces, sampling, alpha=alpha, out=out, batch=batch)
    return job.start(work, slab=slab, stream=stream)
