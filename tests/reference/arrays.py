"""Arrays after strokes: types, opacity, light, and whole warps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.space.domain import Domain
from tests.reference.motion import Step, grid, inverse, matrices, reached
from tests.reference.samples import faded, sample, sample_frames

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Array = npt.NDArray[Any]


# ---------------------------------------------------------------- types, opacity and light


def rounded(values: Floats, dtype: npt.DTypeLike) -> Array:
    """Return values as a type holds them: integers are rounded half up and bounded."""
    kind = np.dtype(dtype)
    if kind == np.bool_:
        return values >= 0.5
    if kind.kind == "f":
        return values.astype(kind)
    limits = np.iinfo(kind)
    high = np.floor(values + 0.5)
    inside = np.clip(high, float(limits.min), np.nextafter(float(limits.max), 0) if limits.max > 2**53 else limits.max)
    return inside.astype(kind)


def opaque(dtype: npt.DTypeLike) -> float:
    """Return the value of white, and of full opacity."""
    kind = np.dtype(dtype)
    return float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0


def light_of(v: Floats) -> Floats:
    """Return the amount of light of values on sRGB's curve, from 0 to 1."""
    return np.where(v <= 0.04045, v / 12.92, (np.maximum(v + 0.055, 0) / 1.055) ** 2.4)


def curve_of(u: Floats) -> Floats:
    """Return the values on sRGB's curve that stand for amounts of light."""
    return np.where(u <= 0.0031308, 12.92 * u, 1.055 * np.maximum(u, 0) ** (1 / 2.4) - 0.055)


def loaded(values: npt.ArrayLike, top: float, alpha: bool, linear_light: bool) -> Floats:
    """Return numbers as filters take them: in linear light if asked, and multiplied by opacity, their last channel."""
    made = np.array(values, np.float64)
    colours = made[..., :-1] if alpha else made
    if linear_light:
        colours[...] = top * light_of(colours / top)
    if alpha:
        colours *= made[..., -1:] / top
    return made


def stored(values: Floats, dtype: npt.DTypeLike, alpha: bool, linear_light: bool) -> Array:
    """Return filtered numbers as the type holds them: the reverse of `loaded`."""
    top, made = opaque(dtype), values.copy()
    colours = made[..., :-1] if alpha else made
    if alpha:
        opacity = values[..., -1:]
        # A cubic overshoots: the colours are divided by opacity as it is, which is then kept from clear to opaque.
        colours[...] = np.divide(colours * top, opacity, out=np.zeros_like(colours), where=opacity > 0)
        made[..., -1] = np.clip(made[..., -1], 0, top)
    if linear_light:
        colours[...] = top * curve_of(colours / top)
    return rounded(made, dtype)


# ---------------------------------------------------------------- whole warps


def warp(
    source: Array,
    strokes: Sequence[Step],
    domain: Domain,
    filter: str = "auto",
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
) -> Array:
    """Return an image (H, W) or (H, W, C) after strokes, in its own type.

    The strokes are carried out as they are: none is damped. Pixels in no stroke's ball are copied.
    """
    layers = source[None, ..., None] if source.ndim == 2 else source[None]
    q = grid(domain.shape)
    p = inverse(strokes, domain, q)
    m = matrices(strokes, domain, p)
    touched = reached(strokes, domain, q)
    made = _filtered(layers, p[None], m[None], filter, "image", outside, fill, alpha, linear_light, 0.0, touched[None])
    return np.asarray(made[0].reshape(source.shape))


def warp_frames(
    source: Array,
    strokes: Sequence[Step],
    domain: Domain,
    filter: str = "auto",
    between: str | None = None,
    time_filter: bool = False,
    outside: str = "edge",
    fill: npt.ArrayLike = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
) -> Array:
    """Return frames or slices (T, H, W) or (T, H, W, C) after strokes of three coordinates, in their own type."""
    layers = source[..., None] if source.ndim == 3 else source
    between = between or ("nearest" if filter == "nearest" else "linear")
    q = grid(domain.shape)
    p = inverse(strokes, domain, q)
    m = matrices(strokes, domain, p)
    widths = faded(np.linalg.norm(m[..., 2, :], axis=-1)) if time_filter else np.array(0.0)
    touched = reached(strokes, domain, q)
    plane = m[..., :2, :2]
    made = _filtered(layers, p, plane, filter, between, outside, fill, alpha, linear_light, widths, touched)
    return made.reshape(source.shape)


def _filtered(
    layers: Array,
    p: Floats,
    m: Floats,
    filter: str,
    between: str,
    outside: str,
    fill: npt.ArrayLike,
    alpha: bool | None,
    linear_light: bool,
    widths: npt.ArrayLike,
    touched: npt.NDArray[np.bool_],
) -> Array:
    channels, kind = layers.shape[-1], layers.dtype
    straight = (channels == 4 and kind.str[1:] in ("u1", "u2")) if alpha is None else alpha
    values, absent, top = layers, np.broadcast_to(np.asarray(fill, np.float64), (channels,)), opaque(kind)
    if filter != "nearest":
        values = loaded(layers, top, straight, linear_light)
        absent = loaded(absent, top, straight, linear_light)
    if between == "image":
        found = np.stack([sample(values[0], p[0], m[0], filter, outside, absent)])
    else:
        found = sample_frames(values, p, filter, between, outside, absent, widths, m)
    made = found if filter == "nearest" else stored(found, kind, straight, linear_light)
    return np.where(touched[..., None], made, layers)


# ---------------------------------------------------------------- truth


def supersampled(source: Array, d: Deformation, n: int) -> Floats:
    """Return the mean of n × n samples of the cubic interpolant at the exact inverse, for each output pixel."""
    height, width = source.shape[:2]
    within = (np.arange(n) + 0.5) / n - 0.5
    total = np.zeros((height, width, source.shape[2]))
    for v in within:
        for u in within:
            points = d.inverse(grid((height, width)) + np.array([u, v])).points
            total += sample(source, points, filter="cubic")
    return total / n**2


def psnr(a: npt.ArrayLike, b: npt.ArrayLike, peak: float = 255.0) -> float:
    """Return the peak signal to noise ratio in dB."""
    return float(10 * np.log10(peak**2 / np.mean((np.asarray(a, float) - np.asarray(b, float)) ** 2)))
