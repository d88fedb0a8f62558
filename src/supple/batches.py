"""Batches of arrays, each item through a deformation of its own, or all through one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from supple.cuda_arrays import is_on_card, warp_on_card
from supple.deformation import Deformation
from supple.domain import refuse
from supple.errors import SuppleError
from supple.warping import as_array, checked_sampling, one_or_each, result_like, warn_of


def warp_batch(
    sources: Any,
    deformations: Deformation | Sequence[Deformation],
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str = "edge",
    fill: float | Sequence[float] = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
    between: str | None = None,
    time_filter: bool = False,
    device: str = "cpu",
    out: Any = None,
) -> Any:
    """Deform a batch of images, of volumes or of clips.

    Parameters
    ----------
    sources : array of shape (N, H, W[, C]) or (N, T, H, W[, C])
        NumPy's, or on an NVIDIA GPU, where a batch of images is warped at once.
    deformations : Deformation or sequence of Deformation
        One for all items, or one for each, all of one shape.
    filter, tolerance, outside, fill, alpha, linear_light, between, time_filter, device
        As in `supple.Deformation.warp`.
    out : array, optional
        Where to put the result; of its shape and type, and not overlapping ``sources``.

    Returns
    -------
    array
        Of the sources' shape and type, and of their library.

    Raises
    ------
    SuppleError
        If an argument does not fit.

    Warns
    -----
    ToleranceWarning
        If the checks of a map's cells do not promise the tolerance everywhere.
    """
    spaces = one_or_each(deformations)
    sampling = checked_sampling(
        spaces[0].ndim, filter=filter, tolerance=tolerance, outside=outside, fill=fill, linear_light=linear_light,
        between=between, time_filter=time_filter,
    )  # fmt: skip
    if is_on_card(sources):
        result, certificate = warp_on_card(sources, spaces, sampling, alpha=alpha, out=out, device=device, batch=True)
        warn_of(certificate, sampling.tolerance, 3)
        return result
    several = tuple(deformations) if isinstance(deformations, Sequence) else (deformations,)
    array = as_array(sources, "sources")
    shape = several[0].shape
    if array.ndim < 1 + len(shape) or array.shape[1 : 1 + len(shape)] != shape:
        sizes = ", ".join(map(str, shape))
        refuse("sources", f"of shape (N, {sizes}) or (N, {sizes}, channels)", f"shape {array.shape}")
    if len(several) not in (1, len(array)):
        refuse("deformations", f"one, or one for each of the {len(array)} items", len(several))
    result = result_like(out, array)
    for k, item in enumerate(array):
        try:
            several[k % len(several)].warp(
                item, filter=filter, tolerance=tolerance, outside=outside, fill=fill, alpha=alpha,
                linear_light=linear_light, between=between, time_filter=time_filter, device=device, out=result[k],
            )  # fmt: skip
        except SuppleError as error:
            raise type(error)(f"item {k}: {error}" if len(several) > 1 else str(error)) from None
    return result
