"""Transforms of MONAI: an image, or the images, labels, points and boxes of a dictionary, by one draw.

They draw from their random state: ``set_random_state``, or ``monai.utils.set_determinism``, makes them repeatable.
Images have channels first, as everywhere in MONAI. The first axis of space is x, as MONAI's readers have it: points are
indices along the axes, and a recipe fits the file that was read.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from supple.augment.elastic import RandomElastic as Drawing
from supple.augment.peers import (
    bent_tensor,
    deformation_of,
    edged_tensor,
    filter_of,
    moved_tensor,
    need_library,
    spacing_of,
)
from supple.deformation import Deformation
from supple.space.checks import refuse
from supple.space.domain import Border

need_library("monai", "MONAI")
import torch
from monai.config import KeysCollection
from monai.data import MetaTensor
from monai.data.meta_obj import get_track_meta
from monai.transforms import InvertibleTransform, MapTransform, RandomizableTransform
from monai.utils import (
    TraceKeys,
    TransformBackends,
    convert_to_dst_type,
    convert_to_tensor,
    ensure_tuple,
    ensure_tuple_rep,
)

__all__ = ["RandElastic", "RandElasticD", "RandElasticDict", "RandElasticd"]

_FILTERS = {"nearest": "nearest", "bilinear": "linear", "bicubic": "cubic"}
_PADDING = {"border": "edge", "reflection": "reflect", "zeros": "constant"}


class _Randomized(RandomizableTransform, InvertibleTransform):
    """The base of both transforms: a draw, and its trace in the bent images, by which ``inverse`` bends them back."""

    drawing: Drawing
    deformation: Deformation | None = None
    """The last draw: its recipe can be kept."""

    def randomize(self, img: torch.Tensor) -> None:
        """Draw the deformation of an image (C, *spatial)."""
        super().randomize(None)
        self.deformation = _drawn(self.drawing, img, self.R) if self._do_transform else None

    def _traced(self, img: torch.Tensor, mode: str, padding: str) -> torch.Tensor:
        """Return an image, bent by the last draw if there is one, with the recipe in its trace."""
        d, extra = self.deformation, {}
        if d is not None:
            recipe, spacing = d.recipe.to_json(), list(d.domain.spacing)
            extra = {"recipe": recipe, "spacing": spacing, "mode": mode, "padding_mode": padding}
            img = _bent(d, img, mode, padding)
        return self.push_transform(img, extra_info=extra)

    def _undone(self, img: torch.Tensor) -> tuple[torch.Tensor, Deformation | None]:
        """Return an image, bent back by the recipe in its trace, and the deformation, if it was bent."""
        extra = self.pop_transform(img)[TraceKeys.EXTRA_INFO]
        if not extra:
            return img, None
        d = deformation_of(extra["recipe"], tuple(img.shape[:0:-1]), spacing_of(extra["spacing"]))
        return _bent(d, img, extra["mode"], extra["padding_mode"], inverse=True), d


class RandElastic(_Randomized):
    """Bend an image by random strokes, which never fold.

    Parameters
    ----------
    max_displacement, radius, strokes, border
        As in `supple.augment.RandomElastic`: in millimetres for a ``MetaTensor`` with a spacing, or else in voxels.
    prob : float
        The probability.
    mode : str
        ``"bilinear"`` (in a volume, trilinear), ``"bicubic"`` or ``"nearest"``.
    padding_mode : str
        The boundary mode, where the border is free: ``"border"``, ``"reflection"`` or ``"zeros"``.
    """

    backend = [TransformBackends.TORCH]  # noqa: RUF012

    def __init__(
        self,
        max_displacement: float,
        radius: float | tuple[float, float],
        strokes: int | tuple[int, int] = (3, 6),
        prob: float = 0.1,
        border: Border = "auto",
        mode: str = "bilinear",
        padding_mode: str = "border",
    ) -> None:
        RandomizableTransform.__init__(self, prob)
        self.drawing = Drawing(max_displacement, radius, strokes, border)
        self.mode, self.padding_mode = mode, padding_mode
        filter_of("mode", mode, _FILTERS)
        filter_of("padding_mode", padding_mode, _PADDING)

    def __call__(self, img: Any, mode: str | None = None, randomize: bool = True) -> torch.Tensor:
        """Return the bent image (C, *spatial); without ``randomize``, by the last draw again."""
        held = convert_to_tensor(img, track_meta=get_track_meta())
        if randomize:
            self.randomize(held)
        return self._traced(held, self.mode if mode is None else mode, self.padding_mode)

    def inverse(self, data: torch.Tensor) -> torch.Tensor:
        """Return a bent image (a ``MetaTensor``, which has the trace), bent back by the exact inverse map."""
        return self._undone(data)[0]


class RandElasticd(_Randomized, MapTransform):
    """Bend the images, labels, points and boxes of a dictionary by random strokes, which never fold.

    Parameters
    ----------
    keys
        The keys of images and labels (C, *spatial), all of one spatial size. The first present one has the spacing.
    max_displacement, radius, strokes, prob, border
        As in `RandElastic`.
    mode, padding_mode : str or sequence of str
        As in `RandElastic`; one for all keys, or one for each: ``"nearest"`` for labels.
    point_keys
        The keys of points (..., D): indices along the axes of the images.
    box_keys
        The keys of boxes (N, 2 D) in MONAI's standard mode: the lower corner and the upper one, where the first voxel
        is from 0 to 1.
    allow_missing_keys : bool
        Whether keys may be missing.
    """

    backend = RandElastic.backend

    def __init__(
        self,
        keys: KeysCollection,
        max_displacement: float,
        radius: float | tuple[float, float],
        strokes: int | tuple[int, int] = (3, 6),
        prob: float = 0.1,
        border: Border = "auto",
        mode: str | Sequence[str] = "bilinear",
        padding_mode: str | Sequence[str] = "border",
        point_keys: KeysCollection = (),
        box_keys: KeysCollection = (),
        allow_missing_keys: bool = False,
    ) -> None:
        MapTransform.__init__(self, keys, allow_missing_keys)
        RandomizableTransform.__init__(self, prob)
        self.mode = ensure_tuple_rep(mode, len(self.keys))
        self.padding_mode = ensure_tuple_rep(padding_mode, len(self.keys))
        for one, other in zip(self.mode, self.padding_mode, strict=True):
            filter_of("mode", one, _FILTERS)
            filter_of("padding_mode", other, _PADDING)
        self.drawing = Drawing(max_displacement, radius, strokes, border)
        self.point_keys, self.box_keys = ensure_tuple(point_keys), ensure_tuple(box_keys)

    def __call__(self, data: Mapping[Hashable, Any]) -> dict[Hashable, Any]:
        """Return the dictionary with the bent entries in place of the given ones."""
        made = dict(data)
        held = [*self.key_iterator(made, self.mode, self.padding_mode)]
        for key, *_ in held:
            made[key] = convert_to_tensor(made[key], track_meta=get_track_meta())
        if not held:
            return made
        self.randomize(made[held[0][0]])
        for key, mode, padding in held:
            made[key] = self._traced(made[key], mode, padding)
        if (d := self.deformation) is not None:
            self._move(made, d)
        return made

    def inverse(self, data: Mapping[Hashable, Any]) -> dict[Hashable, Any]:
        """Return a dictionary whose images and labels (``MetaTensor``), points and boxes are bent back.

        The trace of the images has the exact inverse map. Boxes become those around the boxes that are bent back, which
        are larger than the original ones.
        """
        made, d = dict(data), None
        for key in self.key_iterator(made):
            made[key], d = self._undone(made[key])
        if d is not None:
            self._move(made, d, inverse=True)
        return made

    def _move(self, made: dict[Hashable, Any], d: Deformation, *, inverse: bool = False) -> None:
        """Replace the points and boxes of a dictionary by moved ones."""
        for keys, move in ((self.point_keys, moved_tensor), (self.box_keys, edged_tensor)):
            for key in keys:
                if key in made:
                    points = convert_to_tensor(made[key], track_meta=isinstance(made[key], MetaTensor))
                    made[key] = convert_to_dst_type(move(d, torch.as_tensor(points), inverse=inverse), points)[0]
                elif not self.allow_missing_keys:
                    raise KeyError(f"Key `{key}` of transform `{type(self).__name__}` was missing in the data")


RandElasticD = RandElasticDict = RandElasticd


def _drawn(drawing: Drawing, img: torch.Tensor, state: Any) -> Deformation:
    shape = tuple(img.shape[1:])
    if len(shape) not in (2, 3):
        refuse("img", "of shape (C, H, W) or (C, H, W, D)", told=f"shape {tuple(img.shape)}")
    spacing = img.pixdim.tolist()[: len(shape)] if isinstance(img, MetaTensor) else [1.0] * len(shape)
    seed = int(state.randint(2**32, dtype="uint64"))
    return drawing.draw(shape[::-1], seed, spacing=spacing_of(spacing))


def _bent(d: Deformation, img: torch.Tensor, mode: str, padding: str, *, inverse: bool = False) -> torch.Tensor:
    kind, outside = filter_of("mode", mode, _FILTERS), filter_of("padding_mode", padding, _PADDING)
    if tuple(img.shape[1:]) != d.shape[::-1]:
        refuse("img", f"of spatial size {d.shape[::-1]}, as the first image", told=f"shape {tuple(img.shape)}")
    held = img.as_tensor() if isinstance(img, MetaTensor) else img
    turned = (0, *range(d.ndim, 0, -1))  # x is MONAI's first axis, and Supple's last one
    made = bent_tensor(d, held.permute(turned), kind, outside, inverse=inverse).permute(turned).contiguous()
    return convert_to_dst_type(made, img)[0]
