"""Pictures as a screen shows them: grey or RGB of sRGB, with opacity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyvips

from supple.media.image import Picture
from supple.media.image.formats import Array, divided, meant, white_of, wrapped
from supple.media.image.tiff import CIELAB


def in_srgb(picture: Picture) -> Picture:
    """Return a picture in grey or RGB, through its profile if it has one, without channels of data.

    CMYK, Lab and pixels with a profile become RGB of 8 bits; CMYK without a profile is converted by a default one.
    Other floats and integers stay as they are. `pixels` have shape (H, W, 1 to 4); if `alpha` is true, the last channel
    is opacity, by which colours are not multiplied.
    """
    pixels = np.atleast_3d(picture.pixels)
    extra = picture.meanings
    count = pixels.shape[2] - len(extra)
    if picture.interpretation == "multiband" and not extra and count > 3:
        count = 3
    colours = np.ascontiguousarray(pixels[..., : count if count in (1, 3, 4) else 1])
    opacity = next((k for k, kind in enumerate(extra) if kind), None)
    if opacity is None:
        made = _converted(colours, picture)
    else:
        shown = pixels[..., count + opacity, None]
        if extra[opacity] == 1:
            colours = divided(np.concatenate([colours, shown], axis=-1))[..., :-1]
        made = _converted(colours, picture)
        if made.dtype != shown.dtype:
            shown = np.rint(np.clip(shown / white_of(shown.dtype), 0, 1) * 255).astype(np.uint8)
        made = np.concatenate([made, shown], axis=-1)
    return replace(
        picture, pixels=made, alpha=opacity is not None, icc=None, interpretation="srgb", bits=made.dtype.itemsize * 8,
        extra=(), _header={},
    )  # fmt: skip


def _converted(colours: Array, picture: Picture) -> Array:
    kind, dtype = picture.interpretation, colours.dtype
    if kind == "lab" and colours.shape[2] == 3:
        values = colours.astype(np.float32)
        if dtype.kind == "u":  # ICC's encoding; in TIFFs of 16 bits, a* and b* have 256 steps a unit
            tiff = picture._header.get("tiff")
            step = 1 if dtype.itemsize == 1 else 256 if tiff is not None and tiff.photometric == CIELAB else 257
            values[..., 0] *= 100 / white_of(dtype)
            values[..., 1:] = values[..., 1:] / step - 128
        elif dtype == np.int16:  # libvips' encoding of 16 bits: L* is unsigned, a* and b* are signed
            values[..., 0] = colours[..., 0].view(np.uint16) * np.float32(100 / 65535)
            values[..., 1:] /= 256
        seen = wrapped(values, "lab", 32).colourspace("srgb")
    elif dtype not in (np.uint8, np.uint16) or (kind != "cmyk" and not picture.icc):
        return colours
    else:
        image = wrapped(colours, meant(dtype, colours.shape[2], kind), 16)
        if picture.icc:
            image.set_type(pyvips.GValue.blob_type, "icc-profile-data", picture.icc)
        try:  # libvips uses its default CMYK profile if there is none, or an invalid one
            usual = {"input_profile": "cmyk"} if kind == "cmyk" else {}
            seen = image.icc_transform("srgb", embedded=True, **usual)
            seen = seen.extract_band(0, n=min(seen.bands, 3))
        except pyvips.Error:  # an invalid profile, or one for other colours
            return colours
    return np.asarray(seen.numpy()).reshape(*colours.shape[:2], -1)
