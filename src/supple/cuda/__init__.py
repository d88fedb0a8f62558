"""Warps and points of arrays on an NVIDIA GPU: the core's calls, by kernels of its headers; asynchronous warps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from supple.cuda import job
from supple.cuda.job import Warping
from supple.engine.sampling import DEFAULT, Sampling
from supple.engine.work import Deforming, spaces_of
from supple.space.domain import integer

__all__ = ["start"]


def start(
    source: Any,
    deformations: Deforming | Sequence[Deforming],
    *,
    sampling: Sampling = DEFAULT,
    alpha: bool | None = None,
    slab: int | None = None,
    stream: Any = None,
    out: Any = None,
    **options: Any,
) -> Warping:
    """Start a warp on a GPU, and return at once.

    It begins after earlier work on the streams of ``source`` and ``out``, and runs in parallel with later work.

    Parameters
    ----------
    source : array on a GPU
        As in `supple.Deformation.warp`; or a batch (N, …).
    deformations : Deformation or sequence of Deformation
        One; or a sequence for a batch, of one for all, or of N.
    sampling : Sampling, optional
        How the arrays are sampled; further keywords replace its fields: ``filter="linear"``.
    alpha
        As in `supple.Deformation.warp`.
    slab : int, optional
        The number of planes of a stack in one launch: between slabs, kernels of other streams can run.
        By default, as many as need 256 MB beside the arrays.
    stream : stream of PyTorch, CuPy, Numba or cuda-core, optional
        The stream of the warp; by default, one of its own.
    out : array on the same GPU, optional
        The array for the result.

    Returns
    -------
    Warping
        The warp, to wait for or to poll. Neither the source nor the result may be used before it is done, unless their
        stream waits for it (`Warping.join`).

    Raises
    ------
    SuppleError
        If an argument does not fit, or the GPU cannot be used.
    """
    spaces = spaces_of(deformations)
    sampling = Sampling.of(sampling, options, spaces[0].ndim)
    if slab is not None:
        slab = integer("slab", slab, "a number of planes from 1 on", 1, 1 << 30)
    work, held, result = job.prepared(source, spaces, sampling, alpha, out, batch=isinstance(deformations, Sequence))
    return job.start(work, held, result, slab=slab, stream=stream)
