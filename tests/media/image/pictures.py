"""Pictures for tests, saved by libvips, and how refusals are looked at."""

import numpy as np
import pyvips

FORMATS = (".png", ".jpg", ".tif", ".webp", ".avif")
SAVERS = {".png": "pngsave", ".jpg": "jpegsave", ".tif": "tiffsave", ".webp": "webpsave", ".avif": "heifsave"}
SRGB = bytes(pyvips.Operation.call("profile_load", "srgb"))
BLOB, STRING, INT = pyvips.GValue.blob_type, pyvips.GValue.refstr_type, pyvips.GValue.gint_type
# what a viewer does to the stored pixels, for each value of the orientation tag
UPRIGHT = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: np.rot90(a, 2),
    4: lambda a: a[::-1],
    5: lambda a: np.swapaxes(a, 0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(np.swapaxes(a, 0, 1), 2),
    8: lambda a: np.rot90(a, 1),
}


def noise(dtype, *shape):
    random = np.random.default_rng(sum(shape))
    dtype = np.dtype(dtype)
    if dtype.kind == "f":
        return random.normal(size=shape).astype(dtype)
    bounds = np.iinfo(dtype)
    return random.integers(bounds.min, bounds.max, shape, dtype, endpoint=True)


def smooth(height, width, dtype=np.uint8):
    """Make a picture that lossy formats keep well, and that no two turns of are alike."""
    y, x = np.mgrid[:height, :width]
    colours = np.stack([x / width, y / height, (x + y) / (width + height)], axis=-1)
    return (colours * np.iinfo(dtype).max).astype(dtype)


def save(path, pixels, fields=(), **options):
    """Write an image with pyvips alone."""
    image = pyvips.Image.new_from_array(pixels, interpretation="b-w" if pixels.ndim == 2 else "srgb").copy()
    for name, value in dict(fields).items():
        image.set_type({bytes: BLOB, str: STRING, int: INT}[type(value)], name, value)
    getattr(image, SAVERS[path.suffix])(str(path), **options)


def loaded(path):
    """Read an image with pyvips alone: its pixels as they stand in the file, and its header."""
    image = pyvips.Image.new_from_buffer(path.read_bytes(), "")
    return image.numpy(), {name: image.get(name) for name in image.get_fields()}


SOURCES = (".jpg", ".png", ".webp", ".avif")
