"""Colours for an sRGB screen: by profiles or, for linear and HDR colours, by a view transform."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.media.image import Picture
from supple.media.image.display import in_srgb
from supple.media.medium import Clip
from supple.render.picture import linear_light, srgb_of

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.uint8]

TRANSFORMS = {
    "": "as stored, or by its profile",
    "linear": "linear to sRGB",
    "bt2020": "BT.2020 to sRGB",
    "pq": "PQ to SDR",
    "hlg": "HLG to SDR",
}
"""The names of view transforms, and what they are called."""
_LINEAR_FORMATS = ("OpenEXR", "Radiance", "PNM")  # where they hold floats
_LINEAR, _PQ, _HLG, _BT2020 = 8, 16, 18, 9  # codes of ITU-T H.273: of transfers, and of primaries
_WHITE, _PEAK = 203.0, 1000.0  # cd/m²: diffuse white (BT.2408), and the brightest light that is not clipped
_LUMA = np.array([0.2627, 0.6780, 0.0593], np.float32)  # BT.2020
_TO_SRGB = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32)
_STEPS = 65535  # of tables over square roots


def usual_of(source: Picture | Clip) -> str:
    """Return the view transform that a file asks for."""
    if isinstance(source, Picture):
        linear = source.format in _LINEAR_FORMATS and source.pixels.dtype.kind == "f"
        return "linear" if linear and source.icc is None else ""
    colour = getattr(source, "colour", None)  # of videos
    if colour is None:
        linear = getattr(source, "format", "") in _LINEAR_FORMATS and source.layout.dtype.kind == "f"
        return "linear" if linear else ""
    known = {_PQ: "pq", _HLG: "hlg", _LINEAR: "linear"}
    return known.get(colour.transfer, "bt2020" if colour.primaries == _BT2020 else "")


def on_screen(picture: Picture, transform: str = "") -> Pixels:
    """Return an image's pixels as (rows, columns, 4) of sRGB: through a view transform, or else by its profile."""
    pixels = picture.pixels
    if pixels.dtype.kind == "f" and picture.icc is not None and not transform:  # profiles are for whole numbers
        pixels = np.rint(np.clip(np.nan_to_num(pixels), 0.0, 1.0) * 65535).astype(np.uint16)
    plain = in_srgb(replace(picture, pixels=pixels, icc=None if transform else picture.icc))
    made, colours = plain.pixels, plain.pixels[..., :-1] if plain.alpha else plain.pixels
    if transform and (colours.dtype.kind == "f" or colours.dtype in (np.uint8, np.uint16)):
        out = shown(seen(colours, transform), alpha=False)
        if plain.alpha:
            out[..., 3] = _eight(made[..., -1])
        return out
    return shown(made, alpha=plain.alpha)


def shown(array: npt.NDArray[Any], *, alpha: bool | None = None) -> Pixels:
    """Return an image array (H, W[, C]) as (rows, columns, 4): grey or RGB; of floats, 0 is black and 1 is white.

    The last channel is opacity if ``alpha``; by default, for two or four channels.
    """
    deep = array if array.ndim == 3 else array[..., None]
    channels = deep.shape[2]
    opaque = not (channels in (2, 4) if alpha is None else alpha)
    eight = _eight(deep)
    colours = eight if opaque else eight[..., :-1]
    out = np.full((*deep.shape[:2], 4), 255, np.uint8)
    out[..., :3] = colours[..., :3] if colours.shape[2] >= 3 else colours[..., :1]
    if not opaque:
        out[..., 3] = eight[..., -1]
    return out


def _eight(array: npt.NDArray[Any]) -> Pixels:
    kind = array.dtype
    if kind == np.uint8:
        return np.asarray(array)
    if kind == np.bool_:
        return np.asarray(array, np.uint8) * np.uint8(255)
    if kind == np.uint16:
        return np.asarray((array + np.uint32(128)) // np.uint32(257), np.uint8)
    values = array.astype(np.float32)
    if kind.kind in "iu":  # types without a known value of white
        low, high = float(values.min()), float(values.max())
        values = (values - low) / (high - low) if high > low else np.zeros_like(values)
    return np.asarray(np.rint(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255), np.uint8)


def seen(colours: Array, name: str) -> Pixels:
    """Return colours, (rows, columns, 1 or 3), through a view transform: uint8 of sRGB.

    Whole numbers are codes from 0 to their type's largest; of floats, 1 is white.
    """
    if colours.dtype.kind == "u":
        light = _light(name)[colours if colours.dtype == np.uint16 else colours.astype(np.uint16) * np.uint16(257)]
    elif name == "linear":
        light = np.asarray(colours, np.float32)
    else:
        codes = np.clip(np.nan_to_num(np.asarray(colours, np.float32)), 0, 1) * np.float32(65535)
        light = _light(name)[np.rint(codes).astype(np.uint16)]
    if name != "linear" and light.shape[2] == 3:
        if name == "hlg":
            light = light * (light @ _LUMA)[..., None] ** np.float32(0.2)  # BT.2100's system gamma at 1000 cd/m²
        if name in ("pq", "hlg"):
            brightest = light.max(axis=2) * np.float32(1 / _PEAK)
            light = light * _dimmed()[_index(brightest)][..., None]
        light = light @ _TO_SRGB.T
    return _encoded()[_index(light)]


def _index(values: Floats) -> npt.NDArray[np.uint16]:
    steps = np.sqrt(np.clip(np.nan_to_num(values), 0, 1)) * np.float32(_STEPS)
    return np.asarray(steps + np.float32(0.5), np.uint16)


@cache
def _light(name: str) -> Floats:
    """Return the light of each code of 16 bits: 1 is white, or cd/m² of HDR."""
    code = np.arange(65536) / 65535
    if name == "pq":  # SMPTE ST 2084
        made = _pq_light(code)
    elif name == "hlg":  # ARIB STD-B67
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        made = np.where(code <= 0.5, code**2 / 3, (np.exp((code - c) / a) + b) / 12) * _PEAK ** (1 / 1.2)
    elif name == "linear":
        made = code
    else:
        made = linear_light(code)
    return np.asarray(made, np.float32)


_M1, _M2, _C1, _C2, _C3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128


def _pq_light(code: Array) -> Array:
    part = code ** (1 / _M2)
    return np.asarray(1e4 * (np.maximum(part - _C1, 0) / (_C2 - _C3 * part)) ** (1 / _M1))


def _pq_code(light: Array) -> Array:
    part = (light / 1e4) ** _M1
    return np.asarray(((_C1 + _C2 * part) / (1 + _C3 * part)) ** _M2)


@cache
def _dimmed() -> Floats:
    """Return the factor from cd/m² to what a screen shows, by the square root of the brightest channel.

    That is BT.2390's curve: it leaves dark colours as they are, and bends the bright ones below white.
    """
    light = np.maximum((np.arange(_STEPS + 1) / _STEPS) ** 2, 1e-9) * _PEAK
    whole = _pq_code(np.array(_PEAK))
    code, most = _pq_code(light) / whole, _pq_code(np.array(_WHITE)) / whole
    knee = 1.5 * most - 0.5
    t = np.clip((code - knee) / (1 - knee), 0, 1)
    bent = (2 * t**3 - 3 * t**2 + 1) * knee + (t**3 - 2 * t**2 + t) * (1 - knee) + (3 * t**2 - 2 * t**3) * most
    return np.asarray(_pq_light(np.where(code < knee, code, bent) * whole) / light / _WHITE, np.float32)


@cache
def _encoded() -> Pixels:
    """Return the sRGB of light, by its square root."""
    light = (np.arange(_STEPS + 1) / _STEPS) ** 2
    return np.asarray(np.rint(255 * srgb_of(light)), np.uint8)
