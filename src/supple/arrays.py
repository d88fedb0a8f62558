"""Arrays and functions of points: images, frames, volumes and batches, checked and sent to an engine."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engines.base import Array, Certificate, Engine, EngineError, Layout, Sampling, Space, Work, warn_of
from supple.engines.choice import check_device, engine_at, engine_for
from supple.engines.native import NATIVE
from supple.errors import DeviceWarning, SuppleError, ToleranceWarning
from supple.pipeline import Arrays, Tell, run, sampled
from supple.space.domain import integer, refuse

_MOST_POINTS = 1 << 18  # points in one call of a function
_WEIGHTLESS = 1e-6  # a weight that rounding leaves
_SLAB = 1 << 20  # bytes of a slab whose range is computed or clamped


class Deforming(Protocol):
    """An object with a space: a `supple.Deformation`."""

    @property
    def space(self) -> Space:
        """The packed strokes and domain."""


def warp_array(
    source: Any,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None = None,
    clamp: bool = False,
    device: str = "cpu",
    out: Any = None,
    tell: Tell = lambda step, done, total: None,
) -> tuple[Any, Certificate]:
    """Sample an image, or frames, plane by plane, so that neither the source nor ``out`` need be in memory.

    Parameters
    ----------
    source : array of shape (H, W[, C]) or (T, H, W[, C])
        A NumPy array, or one on a CUDA device. Several images may share one map: (N, H, W[, C]), if ``space.count``
        is their number.
    space, sampling
        The deformation, and the sampling options.
    alpha, clamp, device, out
        As in `supple.Deformation.warp`.
    tell : function
        Called at intervals with ``"warp"``, the number of finished planes and their total.

    Returns
    -------
    array
        Of the source's shape and type.
    Certificate
        The accuracy of the map.

    Raises
    ------
    SuppleError
        If an argument does not fit.

    Warns
    -----
    DeviceWarning
        If the device failed, and the CPU took over.
    """
    engine = engine_at(source)
    held = engine.taken(source, "source")
    if engine is not NATIVE:
        work = work_of(held, space, sampling, alpha)
        if clamp:
            refuse("clamp", "False for an array on a CUDA device: clip the result there", clamp)
        return _on_device(engine, held, work, device, out)
    work = work_of(held, space, sampling, alpha, finite=False)
    fills = np.asarray(work.sampling.fill)
    constant = sampling.outside == "constant"
    if endless := not np.isfinite(fills).all():  # averages take the edge's values, and what is beyond is filled later
        sampling = replace(sampling, outside="edge" if constant else sampling.outside, fill=0.0)
        work = work_of(held, space, sampling, alpha)
    engine = engine_for(device)
    result = engine.result(out, held, shape_of(held, work))
    own = held
    if gaps := not space.is_identity and sampling.filter != "nearest" and _has_gaps(held):
        own = np.where(np.isfinite(held), held, held.dtype.type(0))
    frames, planes = (Arrays((_as_frames(a, len(space.whole)),)) for a in (own, result))
    certificate = _by_device(engine, frames, planes, work, tell)
    if certificate is None:
        certificate = run(frames, planes, work, tell=tell).certificate
    if clamp and not space.is_identity:
        clamp_to(held, result, work.sampling)

    def weights(marks: Array, outside: str) -> Array:
        plain = replace(sampling, light=False, outside=outside, fill=0.0)
        return np.asarray(warp_array(marks.astype(np.float32), space, plain, alpha=False, device=device)[0])

    if gaps:
        alpha = work.layout.groups[0].alpha
        _mark(held, result, lambda marks: weights(marks, sampling.outside), alpha)
        if alpha and space.grid is None:  # what nothing moves keeps its colours, whatever its opacity
            still = _still(space)
            result[still] = held[still]
    if endless and constant and not space.is_identity:
        beyond = weights(np.ones(space.whole), "constant") < 0.5
        result[beyond] = fills if result.ndim > beyond.ndim else fills[0]
    return result, certificate


def _by_device(engine: Engine, source: Arrays, target: Arrays, work: Work, tell: Tell) -> Certificate | None:
    """Send arrays to a device; None if there is none, nothing to do, or, with a warning, if it fails."""
    if engine is NATIVE or work.space.is_identity:
        return None
    planes = len(target.arrays[0])
    try:
        return sampled(engine, work, source.arrays, target.arrays, lambda done: tell("warp", done, planes))
    except EngineError as error:
        warnings.warn(f"the CPU did what {engine.name} could not: {error}", DeviceWarning, stacklevel=4)
        return None


def _has_gaps(array: Array) -> bool:
    """Return whether any sample is NaN or infinite."""
    if array.dtype.kind != "f":
        return False
    if array.dtype in ("f4", "f8") and array.flags.c_contiguous and array.flags.aligned:
        return not _core.finite(array)
    return any(not np.isfinite(part.min()) or not np.isfinite(part.max()) for part in _slabs(array))


def _still(space: Space) -> npt.NDArray[np.bool_]:
    """Return the mask of the samples whose source point is their own: copies."""
    points, _ = NATIVE.inverse_map(space, 0.01)
    own = np.moveaxis(np.indices(points.shape[:-1], np.float32)[::-1], 0, -1)
    return np.broadcast_to((points == own).all(-1), space.out)


def _mark(source: Array, result: Array, weights: Callable[[Array], Array], alpha: bool) -> None:
    """Store NaN and infinities where those of the source have a weight, whatever its sign."""

    def touched(marks: Array) -> Array:
        marks = marks | marks[..., -1:] if alpha else marks
        return np.abs(weights(marks)) > _WEIGHTLESS if marks.any() else np.zeros(result.shape, bool)

    high, low = touched(source == np.inf), touched(source == -np.inf)
    result[high], result[low] = np.inf, -np.inf
    result[touched(np.isnan(source)) | (high & low)] = np.nan
    if result.shape == source.shape:  # what nothing moves keeps every bit, and NaNs have many
        np.copyto(result, source, where=np.isnan(result) & np.isnan(source))


def warp_picture(
    picture: Any, space: Space, sampling: Sampling, *, clamp: bool, device: str, regridded: bool, name: str = ""
) -> tuple[Any, Certificate]:
    """Sample all pages of a picture, a `supple.media.image.Picture`, each channel as what it is.

    Parameters
    ----------
    picture : Picture
    space, sampling, clamp, device
        As in `warp_array`; the space is of all pages.
    regridded : bool
        Whether the grid of the output is another one.
    name : str
        The name of the picture, for warnings.

    Returns
    -------
    Picture
        With new pixels.
    Certificate
        The accuracy of the map.
    """
    found, count = Certificate(0.0, 0.0), picture.pixels.shape[2] if picture.pixels.ndim == 3 else 1
    fill = np.asarray(sampling.filled(count, picture.pixels.dtype, finite=False).fill)

    def warp(pixels: Array, alpha: bool, channels: list[int]) -> Array:
        nonlocal found
        how = replace(sampling, fill=tuple(fill[channels].tolist()))
        made, certificate = warp_array(pixels, space, how, alpha=alpha, device=device)
        found |= certificate
        if clamp and not space.is_identity:
            for before, after in zip(pixels, made, strict=True) if picture.pages > 1 else ((pixels, made),):
                clamp_to(before, after, how)  # each page by itself
        return np.asarray(made)

    averaged = sampling.filter != "nearest" and not space.is_identity
    return picture.warped(warp, regridded=regridded, averaged=averaged, name=name), found


def work_of(held: Any, space: Space, sampling: Sampling, alpha: bool | None, *, finite: bool = True) -> Work:
    """Return the work on an image or on frames; SuppleError if they do not fit."""
    layout = Layout.of_array(held.shape, held.dtype, space.whole, alpha=alpha, light=sampling.light)
    return Work(space, layout, sampling.filled(layout.groups[0].channels, held.dtype, finite=finite))


def shape_of(held: Any, work: Work) -> tuple[int, ...] | None:
    """Return the shape of the result for an array, if it is not that of the array."""
    if work.space.grid is None:
        return None
    before = 0 if work.items is None else 1
    return (*held.shape[:before], *work.space.out, *held.shape[before + len(work.space.whole) :])


def _as_frames(array: Array, axes: int) -> Array:
    """Return a view of an image or of frames with ``axes`` axes, as (count, h, w, channels)."""
    deep = array if array.ndim > axes else array[..., None]
    return deep if axes == 3 else deep[None]


def _on_device(engine: Engine, held: Any, work: Work, device: str, out: Any) -> tuple[Any, Certificate]:
    """Warp an array on its CUDA device."""
    check_device("auto" if device == "cuda" else device)  # the array says which GPU
    result = engine.result(out, held, shape_of(held, work))
    return result.given, sampled(engine, work, [held], [result])


def warp_batch(
    sources: Any,
    deformations: Deforming | Sequence[Deforming],
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str = "edge",
    fill: float | Sequence[float] = 0.0,
    alpha: bool | None = None,
    linear_light: bool = False,
    between: str | None = None,
    time_filter: bool = False,
    device: str = "cpu",
    out: Any = None,
) -> Any:
    """Deform a batch of images, of volumes or of clips.

    Parameters
    ----------
    sources : array of shape (N, H, W[, C]) or (N, T, H, W[, C])
        A NumPy array, or one on an NVIDIA GPU, which warps a batch of images at once.
    deformations : Deformation or sequence of Deformation
        One for all items, or one for each, all of the same shape.
    filter, tolerance, outside, fill, alpha, linear_light, between, time_filter, device
        As in `supple.Deformation.warp`.
    out : array, optional
        The array for the result, of its shape and type, and not overlapping ``sources``.

    Returns
    -------
    array
        The result, of the sources' shape and type, in an array of the same library.

    Raises
    ------
    SuppleError
        If an argument does not fit.

    Warns
    -----
    ToleranceWarning
        If the checks of a map's cells do not promise the tolerance everywhere.
    """
    spaces = spaces_of(deformations)
    sampling = Sampling.checked(
        spaces[0].ndim, filter=filter, tolerance=tolerance, outside=outside, fill=fill, linear_light=linear_light,
        between=between, time_filter=time_filter,
    )  # fmt: skip
    engine = engine_at(sources)
    held = engine.taken(sources, "source" if engine is not NATIVE else "sources")
    if engine is not NATIVE:
        result, certificate = _on_device(engine, held, batch_of(held, spaces, sampling, alpha), device, out)
        warn_of(certificate, sampling.tolerance, 3)
        return result
    shape = spaces[0].whole
    if held.ndim < 1 + len(shape) or held.shape[1 : 1 + len(shape)] != shape:
        sizes = ", ".join(map(str, shape))
        refuse("sources", f"of shape (N, {sizes}) or (N, {sizes}, channels)", told=f"shape {held.shape}")
    _check_count(spaces, len(held))
    result = engine.result(out, held)
    for k, item in enumerate(held):
        try:
            space = spaces[k % len(spaces)]
            _, certificate = warp_array(item, space, sampling, alpha=alpha, device=device, out=result[k])
        except SuppleError as error:
            raise type(error)(f"item {k}: {error}" if len(spaces) > 1 else str(error)) from None
        warn_of(certificate, sampling.tolerance, 3)
    return result


def spaces_of(deformations: Any) -> tuple[Space, ...]:
    """Return the spaces of one deformation, or of several of one shape; SuppleError for other values."""
    wanted = "a Deformation, or a sequence of them, of one shape"
    several = tuple(deformations) if isinstance(deformations, Sequence) else (deformations,)
    spaces = tuple(space for d in several if isinstance(space := getattr(d, "space", None), Space))
    if not spaces or len(spaces) < len(several):
        refuse("deformations", wanted, deformations)
    shapes = [s.whole for s in spaces]
    if len(set(shapes)) > 1:
        other = next(shape for shape in shapes if shape != shapes[0])
        refuse("deformations", wanted, told=f"shapes {shapes[0]} and {other}")
    return spaces


def _check_count(spaces: tuple[Space, ...], count: int) -> None:
    if len(spaces) not in (1, count):
        refuse("deformations", f"one, or one for each of the {count} items", len(spaces))


def batch_of(held: Any, spaces: tuple[Space, ...], sampling: Sampling, alpha: bool | None) -> Work:
    """Return the work on a batch, whose first axis counts items; SuppleError if its shape does not fit."""
    _check_count(spaces, held.shape[0] if held.ndim else 0)
    layout = Layout.of_array(held.shape[1:], held.dtype, spaces[0].whole, alpha=alpha, light=sampling.light)
    return Work(spaces[0], layout, sampling.filled(layout.groups[0].channels, held.dtype), spaces)


def clamp_to(source: Array, result: Array, sampling: Sampling) -> None:
    """Clamp a result to the finite range of its source and the fill value around it, which cubic filters overshoot.

    NaN and infinities are unchanged.
    """
    if result.dtype.kind not in "iuf" or "cubic" not in (sampling.filter.replace("auto", "cubic"), sampling.between):
        return
    low, high, infinite = _finite_range(source)
    if low > high:  # no finite value
        return
    if sampling.outside == "constant":
        fills = [float(value) for value in np.ravel(sampling.fill)]
        fill = [value for value in fills if np.isfinite(value)] or [float(low)]
        infinite = infinite or fill != fills
        if result.dtype.kind in "iu":
            least, most = np.iinfo(result.dtype).min, np.iinfo(result.dtype).max
            fill = [min(max(round(value), least), most) for value in fill]
        low, high = min(low, result.dtype.type(min(fill))), max(high, result.dtype.type(max(fill)))
    for part in _slabs(result):  # values within the range keep every bit, the sign of a zero too
        for beyond, bound in ((part < low, low), (part > high, high)):
            if infinite:
                beyond &= np.isfinite(part)
            np.copyto(part, bound, where=beyond)


def _finite_range(source: Array) -> tuple[Any, Any, bool]:
    """Return the least and the greatest finite value (in reverse order if there is none), and if any is infinite."""
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
    """Yield parts of an array along its first axes that fit the CPU's cache."""
    if array.ndim > 1 and len(array) and array[0].nbytes > _SLAB:
        for part in array:
            yield from _slabs(part)
        return
    rows = max(1, _SLAB * len(array) // max(array.nbytes, 1))
    for start in range(0, len(array), rows):
        yield array[start : start + rows]


def warp_function(
    function: Callable[[npt.NDArray[np.float64]], npt.ArrayLike],
    space: Space,
    samples: int,
    out: Array | None,
) -> Array:
    """Evaluate a function of points at T⁻¹ of every output pixel, as the mean over ``samples``² points of each.

    Nothing is interpolated: the function stays sharp at any magnification.
    """
    samples = integer("samples", samples, "a number of samples along a pixel's side, from 1 to 64", 1, 64)
    height, width = space.shape
    within = (np.arange(samples) + 0.5) / samples - 0.5
    x = (np.arange(width)[:, None] + within).ravel()
    rows = max(1, _MOST_POINTS // (width * samples * samples))
    result: Array | None = None
    for top in range(0, height, rows):
        y = (np.arange(top, min(top + rows, height))[:, None] + within).ravel()
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        points, _, _, converged = NATIVE.inverse(space, grid)
        if not converged.all():
            warnings.warn(
                f"{np.count_nonzero(~converged)} of {converged.size} source points did not converge: what is shown "
                "there is a guess",
                ToleranceWarning,
                stacklevel=3,
            )
        values = np.asarray(function(points))
        if values.ndim not in (1, 2) or values.shape[0] != len(points) or values.dtype.kind not in "biuf":
            wanted = f"numbers of shape ({len(points)},) or ({len(points)}, channels) for points {points.shape}"
            refuse("the function's values", wanted, told=f"{values.dtype} of shape {values.shape}")
        if values.dtype.kind != "f":
            values = values.astype(np.float64)
        square = values.reshape(len(y) // samples, samples, width, samples, *values.shape[1:]).mean(axis=(1, 3))
        if result is None:
            result = NATIVE.result(out, np.empty((height, width, *values.shape[1:]), values.dtype))
        result[top : top + len(square)] = square
    assert result is not None
    return result
