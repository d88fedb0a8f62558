"""Transforms of TorchIO: the images and label maps of a subject, by one draw.

It draws from PyTorch's random state, as TorchIO does. The subject's history records an `Elastic` with the recipe of the
draw, in voxels of the file: ``supple warp scan.nii.gz --recipe`` applies it as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.augment.elastic import RandomElastic as Drawing
from supple.augment.peers import SEEDS, bent_tensor, deformation_of, filter_of, need_library, spacing_of
from supple.engine.sampling import OUTSIDE
from supple.space.checks import choice
from supple.space.domain import Border

need_library("torchio", "TorchIO")
import torch
from torchio import ScalarImage, SpatialTransform, Subject
from torchio.transforms.augmentation import RandomTransform

__all__ = ["Elastic", "RandomElastic"]

_FILTERS = {"nearest": "nearest", "linear": "linear", "cubic": "cubic"}


class RandomElastic(RandomTransform, SpatialTransform):
    """Bend the images and label maps of a subject by random strokes, which never fold.

    Parameters
    ----------
    max_displacement, radius, strokes, border
        As in `supple.augment.RandomElastic`, in millimetres.
    image_interpolation : str
        ``"linear"``, ``"cubic"`` or ``"nearest"``.
    label_interpolation : str
        As for images; ``"nearest"`` keeps labels as they are.
    outside : str
        The boundary mode, where the border is free: ``"edge"``, ``"reflect"``, or ``"constant"`` for 0.
    **kwargs
        As of any transform of TorchIO: ``p``, ``include``, ``exclude``, …
    """

    def __init__(
        self,
        max_displacement: float,
        radius: float | tuple[float, float],
        strokes: int | tuple[int, int] = (3, 6),
        border: Border = "auto",
        image_interpolation: str = "linear",
        label_interpolation: str = "nearest",
        outside: str = "edge",
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.drawing = Drawing(max_displacement, radius, strokes, border)
        self.options = {
            "image_interpolation": image_interpolation,
            "label_interpolation": label_interpolation,
            "outside": outside,
        }
        Elastic("{}", **self.options)  # checks the options

    def apply_transform(self, subject: Subject) -> Subject:
        """Draw a recipe, and apply it."""
        shape, spacing = _space_of(subject)
        seed = int(torch.randint(SEEDS, ()))
        with np.errstate(all="warn"):  # TorchIO turns warnings of NumPy into errors, even those that are off by default
            recipe = self.drawing.draw(shape, seed, spacing=spacing).recipe.to_json()
        return Elastic(recipe, **self.options, **self._get_base_args())(subject)


class Elastic(SpatialTransform):
    """Bend the images and label maps of a subject by a recipe, such as `RandomElastic` has drawn.

    Its ``inverse()``, as ``subject.apply_inverse_transform()`` calls it, bends them back by the exact inverse map.

    Parameters
    ----------
    recipe : str
        The recipe as JSON (``supple.Recipe.from_json`` reads it), for the subject's size, in voxels.
    image_interpolation, label_interpolation, outside, **kwargs
        As in `RandomElastic`.

    Raises
    ------
    SuppleError
        If an argument is invalid; or, when applied, if the recipe is for another size than the subject's.
    """

    def __init__(
        self,
        recipe: str,
        image_interpolation: str = "linear",
        label_interpolation: str = "nearest",
        outside: str = "edge",
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.recipe, self.outside, self.invert_transform = recipe, outside, False
        self.image_interpolation, self.label_interpolation = image_interpolation, label_interpolation
        filter_of("image_interpolation", image_interpolation, _FILTERS)
        filter_of("label_interpolation", label_interpolation, _FILTERS)
        choice("outside", outside, tuple(OUTSIDE))
        self.args_names = ["recipe", "image_interpolation", "label_interpolation", "outside"]

    def apply_transform(self, subject: Subject) -> Subject:
        """Apply the recipe."""
        shape, spacing = _space_of(subject)
        with np.errstate(all="warn"):
            d = deformation_of(self.recipe, shape, spacing)
            for image in self.get_images(subject):
                scalar = isinstance(image, ScalarImage)
                kind = self.image_interpolation if scalar else self.label_interpolation
                # TorchIO's axes are x, y and z; a picture has one slice.
                tensor = image.data[..., 0].permute(0, 2, 1) if d.ndim == 2 else image.data.permute(0, 3, 2, 1)
                made = bent_tensor(d, tensor, kind, self.outside, inverse=self.invert_transform)
                image.set_data((made[:, None] if d.ndim == 2 else made).permute(0, 3, 2, 1).contiguous())
        return subject


def _space_of(subject: Subject) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the shape and the spacing of a deformation of a subject's images."""
    subject.check_consistent_spatial_shape()
    subject.check_consistent_attribute("spacing")
    first = subject.get_first_image()
    axes = 2 if first.spatial_shape[2] == 1 else 3
    return tuple(int(n) for n in first.spatial_shape[:axes][::-1]), spacing_of(first.spacing[:axes])
