"""A transform of torchvision (v2): images, videos, masks, boxes and key points of a sample, by one draw.

It draws from PyTorch's random state: `torch.manual_seed` makes it repeatable, and workers of a ``DataLoader`` differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from supple.augment.elastic import RandomElastic as Drawing
from supple.augment.peers import SEEDS, bent_tensor, edged_tensor, filter_of, moved_tensor, need_library
from supple.engine.sampling import OUTSIDE
from supple.errors import SuppleError
from supple.space.checks import choice
from supple.space.domain import Border

need_library("torchvision", "torchvision")
import torch
from torchvision import tv_tensors
from torchvision.transforms import InterpolationMode, v2
from torchvision.transforms.v2 import functional as F  # noqa: N812

__all__ = ["RandomElastic"]

_FILTERS = {"nearest": "nearest", "bilinear": "linear", "bicubic": "cubic"}
_XYXY = tv_tensors.BoundingBoxFormat.XYXY


class RandomElastic(v2.Transform):
    """Bend images, videos, masks, boxes and key points by random strokes, which never fold.

    In a sample (in any nesting), everything that torchvision's transforms take is bent alike: images and videos, also
    PIL's; masks, sampled by the nearest pixel; boxes, in formats without a rotation; and key points. The frames of a
    video share one map. `v2.RandomApply` gives it a probability.

    Parameters
    ----------
    max_displacement, radius, strokes, border
        As in `supple.augment.RandomElastic`, in pixels.
    interpolation : str or InterpolationMode
        ``"bilinear"``, ``"bicubic"`` or ``"nearest"``.
    outside : str
        The boundary mode, where the border is free: ``"edge"``, ``"reflect"``, or ``"constant"`` for 0.

    Raises
    ------
    SuppleError
        If an argument is invalid; or, when applied, if a sample has boxes with a rotation.
    """

    def __init__(
        self,
        max_displacement: float,
        radius: float | Sequence[float],
        strokes: int | Sequence[int] = (3, 6),
        *,
        border: Border = "auto",
        interpolation: str | InterpolationMode = "bilinear",
        outside: str = "edge",
    ) -> None:
        super().__init__()
        self._drawing = Drawing(max_displacement, radius, strokes, border)  # type: ignore[arg-type]
        self.max_displacement, self.radius = self._drawing.max_displacement, self._drawing.radius
        self.strokes, self.border = self._drawing.strokes, self._drawing.border
        self.interpolation = getattr(interpolation, "value", interpolation)
        choice("outside", outside, tuple(OUTSIDE))
        self.outside = outside
        self._filter = filter_of("interpolation", self.interpolation, _FILTERS)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        """Draw the deformation of a sample: its recipe can be kept (``params["deformation"].recipe``)."""
        seed = int(torch.randint(SEEDS, ()))
        return {"deformation": self._drawing.draw(v2.query_size(flat_inputs), seed)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        """Return one input of a sample, bent."""
        d = params["deformation"]
        if isinstance(inpt, tv_tensors.BoundingBoxes):
            return self._boxes(inpt, d)
        if isinstance(inpt, tv_tensors.KeyPoints):
            return tv_tensors.wrap(moved_tensor(d, inpt.as_subclass(torch.Tensor)), like=inpt)
        if isinstance(inpt, torch.Tensor):
            kind = "nearest" if isinstance(inpt, tv_tensors.Mask) else self._filter
            made = bent_tensor(d, inpt.as_subclass(torch.Tensor), kind, self.outside)
            return tv_tensors.wrap(made, like=inpt) if isinstance(inpt, tv_tensors.TVTensor) else made
        made = bent_tensor(d, F.pil_to_tensor(inpt), self._filter, self.outside)
        return F.to_pil_image(made, mode=inpt.mode)

    def _boxes(self, boxes: tv_tensors.BoundingBoxes, d: Any) -> tv_tensors.BoundingBoxes:
        kind = boxes.format
        if tv_tensors.is_rotated_bounding_format(kind):
            text = f"boxes of format {kind.value} have a rotation, which a bend changes at each corner: convert them to"
            raise SuppleError(f"{text} XYXY, XYWH or CXCYWH, or to key points")
        corners = F.convert_bounding_box_format(boxes, new_format=_XYXY)
        made = tv_tensors.wrap(edged_tensor(d, corners.as_subclass(torch.Tensor)), like=corners)
        return F.convert_bounding_box_format(F.clamp_bounding_boxes(made), new_format=kind)
