"""Transforms of MONAI: an image, or the images, labels, points and boxes of a dictionary, by one draw.

They draw from their random state: ``set_random_state``, or ``monai.utils.set_determinism``, makes them repeatable.
Images have channels first, as everywhere in MONAI. The first axis of space is x, as MONAI's readers have it: points are
indices along the axes, and a recipe fits the file that was read.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from supple.augment.elastic import RandomElastic as Drawing
from supple.augment.peers import bent_tensor, edged_tensor, filter_of, moved_tensor, need_library, spacing_of
from supple.deformation import Deformation
from supple.space.checks import refuse
from supple.space.domain import Border

need_library("monai", "MONAI")
import torch
from monai.config import KeysCollection
from monai.data import MetaTensor
from monai.data.meta_obj import get_track_meta
from monai.transforms import MapTransform, RandomizableTransform
from monai.utils import TransformBackends, convert_to_dst_type, convert_to_tensor, ensure_tuple, ensure_tuple_rep

__all__ = ["RandElastic", "RandElasticD", "RandElasticDict", "RandElasticd"]

_FILTERS = {"nearest": "nearest", "bilinear": "linear", "bicubic": "cubic"}
_PADDING = {"border": "edge", "reflection": "reflect", "zeros": "constant"}


class _Randomized(RandomizableTransform):
    """What both transforms share: a draw."""

    drawing: Drawing
    deformation: Deformation | None = None
    """The last draw: its recipe can be kept."""

    def randomize(self, img: torch.Tensor) -> None:
        """Draw the deformation of an image (C, *spatial)."""
        super().randomize(None)
        self.deformation = _drawn(self.drawing, img, self.R) if self._do_transform else None


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
        """Return the image (C, *spatial), bent; or by the last draw again, if it shall not ``randomize``."""
        held = convert_to_tensor(img, track_meta=get_track_meta())
        if randomize:
            self.randomize(held)
        if self.deformation is None:
            return held
        return _bent(self.deformation, held, self.mode if mode is None else mode, self.padding_mode)


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
        """Return the dictionary, with what is bent in the place of what was given."""
        made = dict(data)
        held = [*self.key_iterator(made, self.mode, self.padding_mode)]
        for key, *_ in held:
            made[key] = convert_to_tensor(made[key], track_meta=get_track_meta())
        if not held:
            return made
        self.randomize(made[held[0][0]])
        d = self.deformation
        if d is None:
            return made
        for key, mode, padding in held:
            made[key] = _bent(d, made[key], mode, padding)
        for keys, move in ((self.point_keys, moved_tensor), (self.box_keys, edged_tensor)):
            for key in keys:
                if key in made:
                    points = convert_to_tensor(made[key], track_meta=isinstance(made[key], MetaTensor))
                    made[key] = convert_to_dst_type(move(d, torch.as_tensor(points)), points)[0]
                elif not self.allow_missing_keys:
                    raise KeyError(f"Key `{key}` of transform `{type(self).__name__}` was missing in the data")
        return made


RandElasticD = RandElasticDict = RandElasticd


def _drawn(drawing: Drawing, img: torch.Tensor, state: Any) -> Deformation:
    shape = tuple(img.shape[1:])
    if len(shape) not in (2, 3):
        refuse("img", "of shape (C, H, W) or (C, H, W, D)", told=f"shape {tuple(img.shape)}")
    spacing = img.pixdim.tolist()[: len(shape)] if isinstance(img, MetaTensor) else [1.0] * len(shape)
    seed = int(state.randint(2**32, dtype="uint64"))
    return drawing.draw(shape[::-1], seed, spacing=spacing_of(spacing))


def _bent(d: Deformation, img: torch.Tensor, mode: str, padding: str) -> torch.Tensor:
    kind, outside = filter_of("mode", mode, _FILTERS), filter_of("padding_mode", padding, _PADDING)
    if tuple(img.shape[1:]) != d.shape[::-1]:
        refuse("img", f"of spatial size {d.shape[::-1]}, as the first image", told=f"shape {tuple(img.shape)}")
    held = img.as_tensor() if isinstance(img, MetaTensor) else img
    turned = (0, *range(d.ndim, 0, -1))  # x is MONAI's first axis, and Supple's last one
    made = bent_tensor(d, held.permute(turned), kind, outside).permute(turned).contiguous()
    return convert_to_dst_type(made, img)[0]
