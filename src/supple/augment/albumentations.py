"""Transforms of Albumentations: images, masks, boxes, key points and volumes of a sample, by one draw.

They draw from the generator that Albumentations gives them: ``A.Compose([...], seed=...)`` makes them repeatable.
The parameter of a call is the recipe of its deformation, as JSON: ``ReplayCompose`` keeps it, and applies it again.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from supple.augment.elastic import RandomElastic as Drawing
from supple.augment.peers import SEEDS, bent_stack, deformation_of, edged, filter_of, need_library, spacing_of
from supple.deformation import Deformation
from supple.engine.sampling import OUTSIDE
from supple.engine.work import Array
from supple.errors import SuppleError
from supple.space.checks import choice, refuse

need_library("albumentations", "Albumentations")
import cv2
from albumentations import DualTransform
from albumentations.core.transforms_interface import BaseTransformInitSchema, Transform3D
from albumentations.core.type_definitions import ALL_TARGETS, Targets

if hasattr(DualTransform, "sample_parameters"):
    text = "supple.augment.albumentations needs Albumentations 2.0, found AlbumentationsX, which has the same name and"
    raise SuppleError(f"{text} other hooks: pip uninstall albumentationsx; pip install albumentations")

__all__ = ["RandomElastic", "RandomElastic3D"]


_FILTERS = {cv2.INTER_NEAREST: "nearest", cv2.INTER_LINEAR: "linear", cv2.INTER_CUBIC: "cubic"}


Radius = float | tuple[float, float]
Strokes = int | tuple[int, int]
Edges = Literal["auto"] | float | tuple[float, ...] | None
Outside = Literal["edge", "reflect", "constant"]


class _Schema(BaseTransformInitSchema):
    max_displacement: float
    radius: Radius
    strokes: Strokes
    border: Edges
    interpolation: int
    outside: Outside


class _Elastic(DualTransform):
    """The base of both transforms: their options, and the recipe of a draw and its deformation."""

    spacing: tuple[float, ...] = (1.0, 1.0)

    def _set(self, max_displacement: float, radius: Radius, strokes: Strokes, border: Edges, **sampling: Any) -> None:
        self._drawing = Drawing(max_displacement, radius, strokes, border)
        self.max_displacement, self.radius, self.strokes, self.border = max_displacement, radius, strokes, border
        self.interpolation, self.outside = sampling["interpolation"], sampling["outside"]
        self._filter = filter_of("interpolation", self.interpolation, _FILTERS)
        choice("outside", self.outside, tuple(OUTSIDE))

    def _drawn(self, shape: tuple[int, ...]) -> dict[str, Any]:
        seed = int(self.random_generator.integers(SEEDS))
        recipe = self._drawing.draw(shape, seed, spacing=spacing_of(self.spacing)).recipe.to_json()
        return {"recipe": recipe, "extent": shape}

    def _of(self, recipe: str, extent: tuple[int, ...]) -> Deformation:
        return deformation_of(recipe, tuple(extent), spacing_of(self.spacing))

    def apply_to_keypoints(self, keypoints: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return moved key points (N, 2+), or (N, 3+) in a volume; only coordinates change."""
        if not len(keypoints):
            return keypoints
        d = self._of(recipe, extent)
        made = keypoints.astype(np.result_type(keypoints, np.float32))
        made[:, : d.ndim] = d.forward(keypoints[:, : d.ndim].astype(np.float64))
        return made


class RandomElastic(_Elastic):
    """Bend images, masks, boxes and key points by random strokes, which never fold.

    Images of a sample, and slices of volumes, share one map; masks are sampled by the nearest pixel.

    Parameters
    ----------
    max_displacement, radius, strokes, border
        As in `supple.augment.RandomElastic`, in pixels.
    interpolation : int
        ``cv2.INTER_LINEAR``, ``INTER_CUBIC`` or ``INTER_NEAREST``.
    outside : str
        The boundary mode, where the border is free: ``"edge"``, ``"reflect"``, or ``"constant"`` for 0.
    p : float
        The probability.
    """

    _targets = ALL_TARGETS

    class InitSchema(_Schema):
        """The types of the arguments."""

    def __init__(
        self,
        max_displacement: float,
        radius: Radius,
        strokes: Strokes = (3, 6),
        border: Edges = "auto",
        interpolation: int = cv2.INTER_LINEAR,
        outside: Outside = "edge",
        p: float = 0.5,
    ) -> None:
        super().__init__(p=p)
        self._set(max_displacement, radius, strokes, border, interpolation=interpolation, outside=outside)

    def get_params_dependent_on_data(self, params: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
        """Draw a recipe for a sample."""
        return self._drawn(tuple(params["shape"][:2]))

    def apply_to_images(self, images: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return bent images (N, H, W[, C]), or a volume (D, H, W[, C]); all are bent alike."""
        return bent_stack(self._of(recipe, extent), images, self._filter, self.outside)

    apply_to_volume = apply_to_images

    def apply(self, img: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return a bent image (H, W[, C])."""
        return np.asarray(self.apply_to_images(img[None], recipe, extent)[0])

    def apply_to_mask3d(self, mask3d: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return a bent mask (D, H, W[, C]); all slices are bent alike."""
        return bent_stack(self._of(recipe, extent), mask3d, "nearest", self.outside)

    def apply_to_mask(self, mask: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return a bent mask (H, W[, C])."""
        return np.asarray(self.apply_to_mask3d(mask[None], recipe, extent)[0])

    def apply_to_bboxes(self, bboxes: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return the boxes (N, 4+) around bent boxes, in fractions of the image."""
        if not len(bboxes):
            return bboxes
        size = np.array((*extent[::-1], *extent[::-1]), np.float64)
        made = bboxes.astype(np.result_type(bboxes, np.float32))
        made[:, :4] = edged(self._of(recipe, extent), bboxes[:, :4] * size) / size
        return made


class RandomElastic3D(_Elastic, Transform3D):
    """Bend volumes, their masks and their key points by random strokes in space, which never fold.

    Parameters
    ----------
    max_displacement, radius, strokes, border, interpolation, outside, p
        As in `RandomElastic`; lengths are in voxels, or in millimetres if there is a spacing.
    spacing : (float, float, float)
        Millimetres per voxel, along x, y and z.
    """

    _targets = (Targets.VOLUME, Targets.MASK3D, Targets.KEYPOINTS)

    class InitSchema(_Schema):
        """The types of the arguments."""

        spacing: tuple[float, float, float]

    def __init__(
        self,
        max_displacement: float,
        radius: Radius,
        strokes: Strokes = (3, 6),
        border: Edges = "auto",
        interpolation: int = cv2.INTER_LINEAR,
        outside: Outside = "edge",
        spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
        p: float = 0.5,
    ) -> None:
        super().__init__(p=p)
        self._set(max_displacement, radius, strokes, border, interpolation=interpolation, outside=outside)
        self.spacing = spacing

    def get_params_dependent_on_data(self, params: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
        """Draw a recipe for a sample."""
        volume = data["volume"] if "volume" in data else next(iter(data.get("volumes", ())), None)
        if volume is None:
            wanted = "given to RandomElastic3D (RandomElastic is for images)"
            refuse("volume", wanted, told=", ".join(data) or "nothing")
        return self._drawn(tuple(volume.shape[:3]))

    def apply_to_volume(self, volume: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return a bent volume (D, H, W[, C])."""
        d = self._of(recipe, extent)
        return np.asarray(d.warp(volume, filter=self._filter, outside=self.outside, alpha=False))

    def apply_to_mask3d(self, mask3d: Array, recipe: str, extent: tuple[int, ...], **params: Any) -> Array:
        """Return a bent mask (D, H, W[, C])."""
        return np.asarray(self._of(recipe, extent).warp(mask3d, filter="nearest", outside=self.outside, alpha=False))
