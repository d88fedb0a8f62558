"""Functions shared by the transforms of other libraries: tensors, stacks of images, recipes as parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.augment.elastic import moved_boxes, one_thread_in_workers
from supple.deformation import Deformation
from supple.engine.sampling import Sampling, warn_of
from supple.errors import SuppleError
from supple.space.checks import refuse
from supple.space.geometry import Floats
from supple.strokes import Recipe

if TYPE_CHECKING:
    import torch

SEEDS = 2**63 - 1


def need_library(module: str, name: str) -> None:
    """Raise SuppleError, with the command to install it, unless a library is there."""
    if find_spec(module) is None:
        raise SuppleError(f"supple.augment.{module} needs {name}, which is not installed: pip install {module}")


def filter_of(name: str, given: Any, known: Mapping[Any, str]) -> str:
    """Return Supple's name of a library's interpolation; SuppleError if Supple has none like it."""
    if given not in known:
        refuse(name, f"one of {', '.join(map(str, known))}", given)
    return known[given]


@lru_cache(maxsize=8)
def deformation_of(recipe: str, shape: tuple[int, ...], spacing: tuple[float, ...]) -> Deformation:
    """Return the deformation of a recipe's JSON, the form in which libraries record a draw."""
    made, quiet = Recipe.from_json(recipe), lambda text, kind: None  # random strokes miss no target
    return Deformation.from_recipe(made, shape, spacing=spacing, say=quiet)


def bent_stack(d: Deformation, images: npt.NDArray[Any], filter: str, outside: str) -> npt.NDArray[Any]:
    """Return images (N, H, W[, C]) by one deformation of (H, W), whose map is computed once."""
    one_thread_in_workers()
    if not images.size:
        return images.copy()
    if len(images) == 1:
        return np.asarray(d.warp(images[0], filter=filter, outside=outside, alpha=False))[None]
    sampling = Sampling(filter, outside=outside)
    made, certificate = warp_array(images, replace(d.space, count=len(images)), sampling, alpha=False)
    warn_of(certificate, sampling.tolerance)
    return np.asarray(made)


def bent_tensor(
    d: Deformation, tensor: torch.Tensor, filter: str, outside: str, *, inverse: bool = False
) -> torch.Tensor:
    """Return a tensor (..., *shape), whose items are all bent, or bent back."""
    from supple.torch import warp

    one_thread_in_workers()
    flat = tensor.reshape(-1, *d.shape)
    return warp(flat, d, inverse=inverse, filter=filter, outside=outside).reshape(tensor.shape)


def edged(d: Deformation, boxes: npt.NDArray[Any], *, inverse: bool = False) -> Floats:
    """Return moved boxes (N, 2 D), in coordinates in which a picture's edge is at 0, not at -0.5."""
    return moved_boxes(d, np.asarray(boxes, np.float64) - 0.5, inverse=inverse) + 0.5


def moved_tensor(d: Deformation, points: torch.Tensor, *, inverse: bool = False) -> torch.Tensor:
    """Return points (..., D), moved or moved back, in their type: whole numbers are rounded."""
    given = points.detach().cpu().numpy().astype(np.float64)
    return _like(points, d.inverse(given).points if inverse else d.forward(given))


def edged_tensor(d: Deformation, boxes: torch.Tensor, *, inverse: bool = False) -> torch.Tensor:
    """Return boxes (..., 2 D) moved as by `edged`, in their own type: integers are rounded."""
    flat = boxes.detach().cpu().numpy().reshape(-1, 2 * d.ndim)
    return _like(boxes, edged(d, flat, inverse=inverse).reshape(tuple(boxes.shape)))


def _like(given: torch.Tensor, values: Floats) -> torch.Tensor:
    import torch

    made = torch.from_numpy(values)
    return (made if given.is_floating_point() else made.round()).to(given)


def spacing_of(values: Sequence[float]) -> tuple[float, ...]:
    """Return a spacing as Python floats, by which deformations are cached."""
    return tuple(float(x) for x in values)
