"""Zarr arrays and OME-Zarr images: opened, and created like another for blocks that many processes write."""

from supple.media.stores.image import LABELS, Level, StoredAxis, StoredImage, open_image
from supple.media.stores.inputs import Samples, like_file
from supple.media.stores.places import Place, overlap
from supple.media.stores.target import Target, check_free, create, create_arrays, holding

__all__ = [
    "LABELS",
    "Level",
    "Place",
    "Samples",
    "StoredAxis",
    "StoredImage",
    "Target",
    "check_free",
    "create",
    "create_arrays",
    "holding",
    "like_file",
    "open_image",
    "overlap",
]
