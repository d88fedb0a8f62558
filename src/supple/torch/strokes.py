"""Tensors that replace numbers of a deformation's strokes: checked, and made into deformations."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from supple.deformation import Deformation
from supple.errors import FoldWarning, MissWarning, SuppleError
from supple.space.domain import refuse
from supple.strokes import pack
from supple.torch.field import Freedom, Kind, Strokes, axes_of


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """A deformation, and the tensors that replace numbers of its strokes.

    Parameters
    ----------
    deformation : Deformation
        The deformation at the tensors' values.
    at, by : tensor of shape (n, D), or None
    radius : tensor of shape (n,), or None
    """

    deformation: Deformation
    at: torch.Tensor | None
    by: torch.Tensor | None
    radius: torch.Tensor | None

    @property
    def differentiable(self) -> bool:
        """Return whether a tensor requires gradients."""
        given = (self.at, self.by, self.radius)
        return torch.is_grad_enabled() and any(x is not None and x.requires_grad and x.numel() for x in given)

    def strokes(self, dtype: torch.dtype, device: torch.device) -> Strokes:
        """Return T of the deformation, differentiable with respect to the tensors that require gradients.

        Raises
        ------
        SuppleError
            If one does, and a stroke has become several.
        """
        d = self.deformation
        if not self.differentiable:
            return Strokes.of(d.space, dtype, device)
        flows = d.on_fold == "flow"
        if flows and len(d.space.table) > sum(not stroke.is_still for stroke in d.strokes):
            raise SuppleError(
                "gradients of strokes need strokes that are carried out in one go, found one that flows in several; "
                "use on_fold='damp', a larger radius or less of it"
            )
        numbers = [[s.at for s in d.strokes], [s.by for s in d.strokes], [s.radius for s in d.strokes]]
        at, by, radius = (
            torch.tensor(known, dtype=dtype, device=device) if given is None else given.to(device, dtype)
            for given, known in zip((self.at, self.by, self.radius), numbers, strict=True)
        )
        damping = d.resolution()["damping"]
        parts = [stroke.weakened(part) for part, stroke in zip(damping, d.strokes, strict=True)]
        rows = pack(parts, d.domain.spacing, time=d.domain.time)
        kinds = [Kind.of(row, d.ndim, part) for row, part in zip(rows, damping, strict=True)]
        freedom = Freedom.of(d.space.freeze, dtype, device)
        return Strokes(at, by, radius, kinds, axes_of(d.space), flows, freedom)


def items(
    deformation: Deformation | Sequence[Deformation],
    at: torch.Tensor | None,
    by: torch.Tensor | None,
    radius: torch.Tensor | None,
) -> tuple[list[Item], bool]:
    """Return the items for a tensor: one item for all of it, or, if the flag is True, one for each item of the batch.

    Raises
    ------
    SuppleError
        If the arguments do not fit each other.

    Warns
    -----
    FoldWarning
        If a stroke that would have folded was damped.
    """
    many = deformations(deformation)
    single = isinstance(deformation, Deformation)
    given = {"at": (at, 2), "by": (by, 2), "radius": (radius, 1)}
    counts = {} if single else {"deformation": len(many)}
    for name, (tensor, axes) in given.items():
        if tensor is None:
            continue
        _check(name, tensor, axes, many)
        if any(d.maps for d in many):
            raise SuppleError(f"{name} is for deformations of strokes alone, found one with fields or affine maps")
        if tensor.ndim > axes:
            counts[name] = len(tensor)
    if len(set(counts.values())) > 1:
        found = ", ".join(f"{count} of {name}" for name, count in counts.items())
        raise SuppleError(f"a batch takes as many of each, one for each item, found {found}")
    made = []
    for i in range(next(iter(counts.values()), 1)):
        tensors = [x[i] if x is not None and x.ndim > axes else x for x, axes in given.values()]
        made.append(Item(_rebuilt(many[i % len(many)], *tensors), *tensors))
    return made, bool(counts)


def deformations(deformation: object) -> list[Deformation]:
    """Return one or many deformations as a list; SuppleError for other values, or different shapes."""
    many = [deformation] if isinstance(deformation, Deformation) else deformation
    if not isinstance(many, Sequence) or not many or not all(isinstance(d, Deformation) for d in many):
        refuse("deformation", "a Deformation, or a sequence of them, one for each item of the batch", deformation)
    if len({d.shape for d in many}) > 1:
        found = ", ".join(map(str, dict.fromkeys(d.shape for d in many)))
        raise SuppleError(f"the deformations of a batch must be of one shape, found {found}")
    return list(many)


def _check(name: str, tensor: object, axes: int, many: Sequence[Deformation]) -> None:
    counts = dict.fromkeys(len(d.strokes) for d in many)
    if len(counts) > 1:
        raise SuppleError(f"{name} needs deformations of as many strokes each, found {', '.join(map(str, counts))}")
    sizes = [next(iter(counts)), many[0].ndim][:axes]
    text, each = ", ".join(map(str, sizes)), "row" if axes == 2 else "number"
    one = f"({text})" if axes == 2 else f"({text},)"
    wanted = f"a tensor of shape {one}, one {each} for each stroke, or (N, {text}) for a batch"
    if not isinstance(tensor, torch.Tensor):
        refuse(name, wanted, tensor)
    if tensor.ndim not in (axes, axes + 1) or list(tensor.shape[-axes:]) != sizes or tensor.is_complex():
        refuse(name, wanted, told=f"{tensor.dtype} of shape {tuple(tensor.shape)}")


def _rebuilt(
    d: Deformation, at: torch.Tensor | None, by: torch.Tensor | None, radius: torch.Tensor | None
) -> Deformation:
    if at is None and by is None and radius is None:
        return d
    given = {"at": at, "by": by, "radius": radius}
    columns = {name: x.detach().to("cpu", torch.float64).tolist() for name, x in given.items() if x is not None}
    if "by" in columns:
        columns["by"] = list(map(tuple, columns["by"]))
    made = d.without_strokes()
    for i, stroke in enumerate(d.strokes):
        try:
            made = made.add(replace(stroke, **{name: rows[i] for name, rows in columns.items()}), warn=False)
        except SuppleError as error:
            raise type(error)(f"stroke {i + 1} of {len(d.strokes)}: {error}") from None
    for text, part in zip(made.warnings, made.resolution()["damping"], strict=True):
        if text:
            warnings.warn(text, FoldWarning if part < 1 else MissWarning, stacklevel=4)
    return made
