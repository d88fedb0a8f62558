"""Arrays and functions through a map: checked, prepared and sampled."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.certificate import Certificate
from supple.domain import choice, colours_hint, flag, integer, number, refuse
from supple.errors import SuppleError, ToleranceWarning
from supple.native import BETWEEN, FILTERS, OUTSIDE, certificate_of, check_filter
from supple.stacks import warp_stack
from supple.streaming import Group, Layout, Sampling, Space, Tell, make_plan, samplings_of, stream

__all__ = ["FILTERS", "OUTSIDE", "Source", "interpolated", "warp_array", "warp_function"]

Array = npt.NDArray[Any]
Source = Array | Callable[[npt.NDArray[np.float64]], npt.ArrayLike]

FINEST = 3e-4
"""About how exact a source point is that is stored in float32, in pixels."""

_MOST_POINTS = 1 << 18  # of a function, asked for at once
_SLAB = 1 << 20  # bytes whose range is looked at, or kept, at once


def interpolated(filter: str, between: str | None) -> str:
    """How frames are interpolated, if it is not said; SuppleError if that does not go with the filter."""
    if between is None:
        return "nearest" if filter == "nearest" else "linear"
    choice("between", between, tuple(BETWEEN))
    if filter == "nearest" and between != "nearest":
        refuse("between", '"nearest" under filter="nearest", which keeps values as they are', between)
    return between


def checked_sampling(
    ndim: int,
    *,
    filter: str,
    tolerance: float,
    outside: str,
    fill: float | Sequence[float],
    linear_light: bool,
    between: str | None,
    time_filter: bool,
) -> Sampling:
    """How samples are made, as `supple.Deformation.warp` is asked; SuppleError if something is not known."""
    check_filter(filter)
    choice("outside", outside, tuple(OUTSIDE))
    tolerance = number("tolerance", tolerance, "a number of pixels above 0", 1e-9, 1e9)
    if between is not None and ndim == 2:
        refuse("between", "left out for an image, which is one frame", between)
    if time_filter and ndim == 2:
        refuse("time_filter", "left out for an image, which is one frame", time_filter)
    light, averaged = flag("linear_light", linear_light), flag("time_filter", time_filter)
    return Sampling(filter, interpolated(filter, between), averaged, outside, fill, light, tolerance)  # type: ignore[arg-type]


def warn_of(certificate: Certificate, tolerance: float, stacklevel: int) -> None:
    """Warn if a map may be less exact than was asked."""
    if not certificate.error <= 1.01 * tolerance + FINEST:
        warnings.warn(
            f"the map may be off by {certificate.error:.2g} px somewhere, more than the tolerance {tolerance:g}: "
            "use a larger radius, a shorter drag or a larger tolerance",
            ToleranceWarning,
            stacklevel=stacklevel,
        )


def one_or_each(deformations: Any) -> tuple[Space, ...]:
    """The spaces of one deformation, or of several of one shape; SuppleError if they are none."""
    wanted = "a Deformation, or a sequence of them, of one shape"
    several = tuple(deformations) if isinstance(deformations, Sequence) else (deformations,)
    if not several or not all(isinstance(getattr(d, "space", None), Space) for d in several):
        refuse("deformations", wanted, deformations)
    spaces = tuple(d.space for d in several)
    shapes = [s.whole for s in spaces]
    if len(set(shapes)) > 1:
        other = next(shape for shape in shapes if shape != shapes[0])
        refuse("deformations", wanted, f"shapes {shapes[0]} and {other}")
    return spaces


def clamp_to(source: Array, result: Array, sampling: Sampling) -> None:
    """Keep a result within the finite values of its source, and the constant around it: cubics go beyond.

    NaN and infinities stay where they are.
    """
    if result.dtype.kind not in "iuf" or "cubic" not in (sampling.filter.replace("auto", "cubic"), sampling.between):
        return
    low, high, infinite = _finite_range(source)
    if low > high:  # there is no finite value
        return
    if sampling.outside == "constant":
        fill = [float(value) for value in np.ravel(sampling.fill)]
        if result.dtype.kind in "iu":
            least, most = np.iinfo(result.dtype).min, np.iinfo(result.dtype).max
            fill = [min(max(round(value), least), most) for value in fill]
        low, high = min(low, result.dtype.type(min(fill))), max(high, result.dtype.type(max(fill)))
    for part in _slabs(result):  # only what is beyond is touched: all else keeps every bit, the sign of a zero too
        for beyond, bound in ((part < low, low), (part > high, high)):
            if infinite:
                beyond &= np.isfinite(part)
            np.copyto(part, bound, where=beyond)


def _finite_range(source: Array) -> tuple[Any, Any, bool]:
    """The least and the greatest finite value, and whether there are infinities; the greatest first if none is."""
    kind, infinite = source.dtype.newbyteorder("="), False
    low, high = (np.inf, -np.inf) if kind.kind == "f" else (np.iinfo(kind).max, np.iinfo(kind).min)
    for part in _slabs(source):
        least, most = np.fmin.reduce(part, axis=None), np.fmax.reduce(part, axis=None)
        if np.isinf(least) or np.isinf(most):
            infinite, part = True, part[np.isfinite(part)]
            if not part.size:
                continue
            least, most = part.min(), part.max()
        low, high = min(low, least), max(high, most)
    return kind.type(low), kind.type(high), infinite


def _slabs(array: Array) -> Iterator[Array]:
    """Parts of an array along its first axis, which a processor's cache can hold."""
    rows = max(1, _SLAB * len(array) // max(array.nbytes, 1))
    for start in range(0, len(array), rows):
        yield array[start : start + rows]


def warp_array(
    source: Array,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None,
    out: Array | None,
    tell: Tell = lambda done: None,
) -> tuple[Array, Certificate]:
    """Sample an image, or an array of frames, plane by plane, so that neither it nor ``out`` need be in memory.

    ``tell`` is called with the number of planes done, now and then.
    """
    array, straight = checked_source(source, space.whole, alpha, sampling.light)
    axes = len(space.whole)
    channels = array.shape[axes] if array.ndim > axes else 1
    colours = checked_fill(sampling.fill, channels, array.dtype)
    result = result_like(out, array)
    if space.table.size == 0:
        result[...] = array
        return result, Certificate(0.0, 0.0)
    kind = array.dtype.newbyteorder("=")
    kind = np.dtype(np.float32) if kind == np.float16 else np.dtype(np.uint8) if kind == np.bool_ else kind
    white = 1.0 if kind.kind == "f" or array.dtype.kind == "b" else float(np.iinfo(kind).max)
    layout = Layout((Group(space.shape, channels, alpha=straight),), kind, white)
    sampling = replace(sampling, fill=tuple(colours))
    ready = all(_as_kind(a, kind) is not None for a in (array, result))
    if space.ndim == 2:
        held = array if ready else np.require(array, kind, ["C", "ALIGNED"])
        made = result if ready else np.empty(array.shape, kind)
        frames, image = (_as_kind(a, kind) for a in (held, made))
        assert frames is not None
        assert image is not None
        plan = space.plan(0, sampling.tolerance)
        (job,) = samplings_of(
            space,
            layout,
            sampling,
            [frames.reshape(1, *space.shape, channels)],
            [image.reshape(*space.shape, channels)],
            1,
        )
        plan.sample(job)
        if made is not result:
            with np.errstate(over="ignore"):
                result[...] = made
        return result, certificate_of(plan)
    whole = (*space.whole, channels)
    certificate = Certificate(0.0, 0.0)
    if ready:
        both = [np.asarray(a.reshape(whole)).view(kind) for a in (array, result)]
        for done, known in warp_stack(space, layout, sampling, range(space.count), both[:1], both[1:]):
            certificate |= known
            tell(done)
        return result, certificate
    deep, target = (a[..., None] if a.ndim == 3 else a for a in (array, result))
    plan_ = make_plan(space, layout, sampling, range(space.count))
    slices = (_ArrayFrame(deep[z]) for z in range(space.count))
    for z, planes, known in stream(space, layout, sampling, plan_, slices):
        with np.errstate(over="ignore"):
            target[z] = planes[0]
        certificate |= known
        tell(z + 1)
    return result, certificate


def _as_kind(array: Array, kind: np.dtype[Any]) -> Array | None:
    """Return an array as one of a kind that shares its memory; None if it cannot."""
    if not (array.flags.c_contiguous and array.flags.aligned and array.dtype.isnative):
        return None
    return array.view(kind) if array.dtype in (kind, np.bool_) else None


@dataclass(frozen=True, slots=True, eq=False)
class _ArrayFrame:
    """A frame of an array that the core does not take as it is."""

    samples: Array

    def copy_to(self, arrays: Sequence[Array]) -> None:
        arrays[0][...] = self.samples


def checked_source(source: object, shape: tuple[int, ...], alpha: bool | None, light: bool) -> tuple[Array, bool]:
    """The source as an array that fits, and whether its last channel is opacity."""
    array = as_array(source, "source")
    return array, checked_kind(array.shape, array.dtype, shape, alpha, light)


def check_gradients(value: object, name: str) -> None:
    """Refuse a tensor that wants gradients, which would get none here."""
    if getattr(value, "requires_grad", False) is True:
        raise SuppleError(
            f"{name} is a tensor that wants gradients, found requires_grad=True: supple.torch.warp makes them, and "
            "tensor.detach() does without"
        )


def as_array(value: object, name: str) -> Array:
    """A value as NumPy's array; SuppleError if it is none."""
    check_gradients(value, name)
    try:
        return np.asarray(value)
    except (TypeError, ValueError):
        refuse(name, "an array of numbers", value)


def checked_kind(
    found: tuple[int, ...], dtype: np.dtype[Any], shape: tuple[int, ...], alpha: bool | None, light: bool
) -> bool:
    """Return whether the last channel of an array of some shape and type is opacity; SuppleError if it does not fit."""
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        refuse("source", "an array of bool, integers or floats of up to 64 bits", f"dtype {dtype}")
    axes = len(shape)
    if found[:axes] != shape or len(found) not in (axes, axes + 1) or 0 in found:
        sizes = ", ".join(map(str, shape))
        wanted = f"of shape ({sizes}) or ({sizes}, channels), as the deformation is{colours_hint(shape)}"
        refuse("source", wanted, f"shape {found}")
    channels = found[axes] if len(found) > axes else 1
    if alpha is not None and not isinstance(alpha, bool | np.bool_):
        refuse("alpha", "True or False, or None to have it guessed", alpha)
    straight = bool(alpha) if alpha is not None else channels == 4 and dtype.str[1:] in ("u1", "u2")
    if straight and channels < 2:
        raise SuppleError(f"alpha=True needs a last channel beside the colours, found shape {found}")
    if light and (dtype.kind == "b" or (dtype.kind in "iu" and dtype.str[1:] not in ("u1", "u2"))):
        raise SuppleError(f"linear_light needs 8 or 16 bit colours or floats, found {dtype}")
    return straight


def checked_fill(fill: float | Sequence[float], channels: int, dtype: Any) -> npt.NDArray[np.float64]:
    """The constant as one number for each channel, as near as a type has it; SuppleError if it is none."""
    try:
        values = np.asarray(fill, np.float64)
    except (TypeError, ValueError):
        refuse("fill", "a number, or one for each channel", fill)
    if values.shape not in ((), (1,), (channels,)) or not np.isfinite(values).all():
        refuse("fill", f"a number, or {channels} of them, one for each channel", fill)
    if dtype.kind in "iu":
        values = np.clip(values, np.iinfo(dtype).min, np.iinfo(dtype).max)
    return np.ascontiguousarray(np.broadcast_to(values, (channels,)))


def result_like(out: Array | None, like: Array) -> Array:
    """Where the result goes: ``out``, if it fits (SuppleError if not), or a new array."""
    if out is None:
        return np.empty_like(like, order="C")
    wanted = f"an array of {like.dtype} of shape {like.shape}, as the source is"
    given: object = out  # it may be anything
    if not isinstance(given, np.ndarray):
        refuse("out", wanted, given)
    if out.shape != like.shape or out.dtype != like.dtype:
        refuse("out", wanted, f"{out.dtype} of shape {out.shape}")
    if not out.flags.writeable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    if np.may_share_memory(out, like) or _same_bytes(out, like):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return out


def _same_bytes(out: Array, source: Array) -> bool:
    """Return whether two arrays are mapped from overlapping parts of one file."""
    one, two = _mapped(out), _mapped(source)
    if one is None or two is None or not (one[1] < two[2] and two[1] < one[2]):
        return False
    try:
        return os.path.samefile(one[0], two[0])
    except OSError:  # one of them is gone, and lives on only here
        return False


def _mapped(array: Array) -> tuple[str, int, int] | None:
    """The file that an array is mapped from, and from which byte to which."""
    root: Any = array
    while isinstance(root.base, np.ndarray):
        root = root.base
    if not isinstance(root, np.memmap) or root.filename is None:
        return None
    low, high = np.lib.array_utils.byte_bounds(array)
    start = root.offset - np.lib.array_utils.byte_bounds(root)[0]
    return os.fspath(root.filename), low + start, high + start


def warp_function(
    function: Callable[[npt.NDArray[np.float64]], npt.ArrayLike],
    shape: tuple[int, int],
    inverse: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
    samples: int,
    out: Array | None,
) -> Array:
    """Evaluate a function of points at T⁻¹ of every output pixel, at the mean of ``samples``² points of each.

    There is nothing to interpolate: the function is as sharp, however far the map enlarges it.
    """
    samples = integer("samples", samples, "a number of samples along a pixel's side, from 1 to 64", 1, 64)
    height, width = shape
    within = (np.arange(samples) + 0.5) / samples - 0.5
    x = (np.arange(width)[:, None] + within).ravel()
    rows = max(1, _MOST_POINTS // (width * samples * samples))
    result: Array | None = None
    for top in range(0, height, rows):
        y = (np.arange(top, min(top + rows, height))[:, None] + within).ravel()
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        points = inverse(grid)
        values = np.asarray(function(points))
        if values.ndim not in (1, 2) or values.shape[0] != len(points) or values.dtype.kind not in "biuf":
            wanted = f"numbers of shape ({len(points)},) or ({len(points)}, channels) for points {points.shape}"
            refuse("the function's values", wanted, f"{values.dtype} of shape {values.shape}")
        if values.dtype.kind != "f":
            values = values.astype(np.float64)
        square = values.reshape(len(y) // samples, samples, width, samples, *values.shape[1:]).mean(axis=(1, 3))
        if result is None:
            result = result_like(out, np.empty((height, width, *values.shape[1:]), values.dtype))
        result[top : top + len(square)] = square
    assert result is not None
    return result
