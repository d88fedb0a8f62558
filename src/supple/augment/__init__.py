"""Random deformations for training data, which never fold; and transforms for other libraries that draw them.

`supple.augment.monai`, `.torchio`, `.torchvision` and `.albumentations` are modules of their own, for these libraries.
"""

from supple.augment.elastic import RandomElastic, Sample, apply, moved_boxes

__all__ = ["RandomElastic", "Sample", "apply", "moved_boxes"]
