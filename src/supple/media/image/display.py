"""Pictures as a screen shows them: grey or RGB of sRGB, with opacity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyvips

from supple.media.image import Picture
from supple.media.image.formats import Array, divided, wrapped
from supple.media.image.tiff import CIELAB


def in_srgb(picture: Picture) -> Picture:
    """Return a picture in grey or RGB, through its profile if it has one, without channels of data.

    CMYK and Lab, which have no other way, become RGB of 8 bits, CMYK without a profile by a usual one; and so does what
    has a profile. Other floats and integers stay as they are. `pixels` have shape (H, W, 1 to 4), and the last channel
    is opacity, not multiplied, if `alpha` is true.
    """
    pixels = picture.pixels if picture.pixels.ndim == 3 else picture.pixels[..., None]
    extra = picture.extra or ((2,) if picture.alpha else ())
    count = pixels.shape[2] - len(extra)
    if picture.interpretation == "multiband" and not extra and count > 3:
        count = 3
    opacity = next((k for k, kind in enumerate(extra) if kind), None)
    colours = np.ascontiguousarray(pixels[..., :count] if count in (1, 3, 4) else pixels[..., :1])
    shown = pixels[..., count + opacity, None] if opacity is not None else None
    if shown is not None and extra[opacity or 0] == 1:
        colours = divided(np.concatenate([colours, shown], axis=-1))[..., :-1]
    made = _converted(colours, picture)
    if shown is not None:
        if made.dtype != shown.dtype:
            white = np.iinfo(shown.dtype).max if shown.dtype.kind in "iu" else 1.0
            shown = np.rint(np.clip(shown / white, 0, 1) * 255).astype(np.uint8)
        made = np.concatenate([made, shown], axis=-1)
    return replace(
        picture, pixels=made, alpha=shown is not None, icc=None, interpretation="srgb", bits=made.dtype.itemsize * 8,
        extra=(), _header={},
    )  # fmt: skip


def _converted(colours: Array, picture: Picture) -> Array:
    kind, dtype = picture.interpretation, colours.dtype
    if kind == "lab" and colours.shape[2] == 3:
        values = colours.astype(np.float32)
        if dtype.kind == "u":  # as ICC encodes them; TIFF's a* and b* of 16 bits have 256 steps for each whole number
            white, wide = float(np.iinfo(dtype).max), dtype.itemsize == 2
            tiff = picture._header.get("tiff")
            step = (256.0 if tiff is not None and tiff.photometric == CIELAB else 257.0) if wide else 1.0
            values = np.concatenate(
                [values[..., :1] * np.float32(100 / white), (values[..., 1:] / step) - 128], axis=-1, dtype=np.float32
            )
        elif dtype == np.int16:  # as libvips writes 16 bits: L* by its bits without a sign, a* and b* with one
            light = np.ascontiguousarray(colours[..., :1]).view(np.uint16) * np.float32(100 / 65535)
            values = np.concatenate([light, values[..., 1:] / 256], axis=-1, dtype=np.float32)
        image = wrapped(np.ascontiguousarray(values), "lab", 32).colourspace("srgb")
        return np.asarray(image.numpy()).reshape(*colours.shape[:2], 3)
    if dtype not in (np.uint8, np.uint16) or (kind != "cmyk" and not picture.icc):
        return colours
    name = "cmyk" if kind == "cmyk" else {1: "b-w", 3: "srgb"}.get(colours.shape[2], "multiband")
    if dtype == np.uint16:
        name = {"b-w": "grey16", "srgb": "rgb16"}.get(name, name)
    image = wrapped(colours, name, 16).copy()
    if picture.icc:
        image.set_type(pyvips.GValue.blob_type, "icc-profile-data", picture.icc)
    try:
        seen = image.icc_transform("srgb", embedded=True, **({"input_profile": "cmyk"} if kind == "cmyk" else {}))
        return np.asarray(seen.numpy()).reshape(*colours.shape[:2], -1)[..., :3]
    except pyvips.Error:  # an invalid profile, or one for other colours
        if kind != "cmyk":
            return colours
        seen = wrapped(colours, name, 16).icc_transform("srgb", input_profile="cmyk")
        return np.asarray(seen.numpy()).reshape(*colours.shape[:2], -1)[..., :3]
