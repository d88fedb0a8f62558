"""Arrays in, arrays out: images, frames, volumes and batches, checked once and sampled."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine import core, labels
from supple.engine.devices import check_gradients, is_on_device
from supple.engine.sampling import DEFAULT, Certificate, Sampling, SamplingFields, warn_of
from supple.engine.stream import make_plan, stream
from supple.engine.work import Array, Deforming, Space, Tell, Work, check_count, silent, spaces_of, work_of
from supple.errors import SuppleError
from supple.space.checks import refuse

# CUDA is imported only where it is used, to keep `import supple` fast.

_WEIGHTLESS = 1e-6  # weights up to this are rounding errors
_SLAB = 1 << 20  # bytes of a slab whose range is computed or clamped
_HOLDERS = ("GetSpacing", "dataobj", "pixel_array", "rescaled")  # attributes of objects that hold an array


def check_device(device: object, what: str = "") -> None:
    """Raise SuppleError for an unknown device, and for ``"cuda"`` where it cannot be used.

    ``what`` names a kind of work that CUDA devices do not support.

    Raises
    ------
    SuppleError
        The message names the devices that can be used.
    """
    if not isinstance(device, str) or device not in ("auto", "cpu", "cuda"):
        refuse("device", '"cpu", "cuda" (on an NVIDIA GPU) or "auto"', device)
    if device == "cuda":
        if what:
            refuse("device", f'"cpu" or "auto" for {what}', device)
        from supple.cuda.device import open_device

        open_device()


def warp_array(
    source: Any,
    space: Space,
    sampling: Sampling,
    *,
    alpha: bool | None = None,
    clamp: bool = False,
    device: str = "cpu",
    out: Any = None,
    tell: Tell = silent,
) -> tuple[Any, Certificate]:
    """Return the warped image or frames, and the certificate of the map.

    Neither the source nor ``out`` need be in memory; a source on a CUDA device stays there. Several images may share
    one map: (N, H, W[, C]), if ``space.count`` is their number. The other arguments are those of
    `supple.Deformation.warp`; of stacks, ``tell`` is called at intervals with ``"warp"``, the number of finished
    planes, and their total.
    """
    held = source
    if type(source) is not np.ndarray:
        if is_on_device(source):
            return _on_device(source, (space,), sampling, alpha, clamp, device, out)
        held = array_of(source, "source")
    work = work_of(held.shape, held.dtype, space, sampling, alpha, finite=False)
    fills = np.asarray(work.sampling.fill)
    constant = sampling.outside == "constant"
    if endless := not np.isfinite(fills).all():  # averages use the edge; the fill value is stored at the end
        sampling = replace(sampling, outside="edge" if constant else sampling.outside, fill=0.0)
        work = work_of(held.shape, held.dtype, space, sampling, alpha)
    if device != "cpu":
        check_device(device)
    shape = held.shape if space.grid is None else (*space.out, *held.shape[len(space.whole) :])
    result = np.empty(shape, held.dtype) if out is None else checked_out(out, held, shape)
    if space.is_identity:
        result[...] = held
        return result, Certificate()
    own = held
    if sampling.filter == "labels" and held.dtype.kind == "f" and _has_gaps(held):
        refuse("source", "an array of labels, which are finite", told="NaN or infinity")
    if gaps := not sampling.keeps_values and held.dtype.kind == "f" and _has_gaps(held):
        own = np.where(np.isfinite(held), held, held.dtype.type(0))
    axes = len(space.whole)
    frames, planes = (a if a.ndim > axes else a[..., None] for a in (own, result))
    frames, planes = (a if axes == 3 else a[None] for a in (frames, planes))
    given, made = core.view(frames), core.view(planes)
    if device == "cuda":
        from supple.cuda import large

        certificate = large.sample(work, frames, planes, tell)
    elif sampling.filter == "labels":
        certificate = labels.sample(work, [frames], [planes], tell)
    elif given is not None and made is not None and sampling.between_frames != "flow":
        certificate = core.sample(work, [given], [made], tell)
    else:
        certificate = _converted(work, frames, planes, tell)
    if clamp:
        clamp_to(held, result, work.sampling)

    def weights(marks: Array, outside: str) -> Array:
        plain = replace(sampling, linear_light=False, outside=outside, fill=0.0)
        return np.asarray(warp_array(marks.astype(np.float32), space, plain, alpha=False, device=device)[0])

    if gaps:
        alpha = work.layout.groups[0].alpha
        _mark(held, result, lambda marks: weights(marks, sampling.outside), alpha)
        if alpha and space.grid is None:  # unchanged pixels keep their colours, even if transparent
            still = _still(space)
            result[still] = held[still]
    if endless and constant:
        beyond = weights(np.ones(space.whole), "constant") < 0.5
        result[beyond] = fills if result.ndim > beyond.ndim else fills[0]
    return result, certificate


def _converted(work: Work, frames: Array, planes: Array, tell: Tell) -> Certificate:
    """Convert frames to a type that the core supports, and sample them a few at a time."""
    kind = core.working_dtype(work.layout.dtype)
    work = replace(work, layout=replace(work.layout, dtype=kind))
    if not work.space.is_plain:  # a composite map may need any frame at any time
        made = np.empty(planes.shape, kind)
        certificate = core.sample(work, [np.ascontiguousarray(frames, kind)], [made], tell)
        with np.errstate(over="ignore"):
            planes[...] = made
        return certificate
    certificate = Certificate()
    plan = make_plan(work, range(len(planes)), tell)
    for z, (plane,), known in stream(work, plan, map(_Frame, frames)):
        with np.errstate(over="ignore"):
            planes[z] = plane
        certificate |= known
        tell("warp", z + 1, len(planes))
    return certificate


class _Frame(NamedTuple):
    """A frame of an array that is converted for the core."""

    samples: Array

    def copy_to(self, arrays: Sequence[Array]) -> None:
        arrays[0][...] = self.samples


def _has_gaps(array: Array) -> bool:
    """Return whether any sample is NaN or infinite."""
    if array.dtype in ("f4", "f8") and array.flags.c_contiguous and array.flags.aligned:
        return not _core.finite(array)
    return any(not np.isfinite(part.min()) or not np.isfinite(part.max()) for part in _slabs(array))


def _still(space: Space) -> npt.NDArray[np.bool_]:
    """Return the mask of the samples at which the map is the identity: these are copies."""
    points, _ = core.inverse_map(space, 0.01)
    own = np.moveaxis(np.indices(points.shape[:-1], np.float32)[::-1], 0, -1)
    return np.broadcast_to((points == own).all(-1), space.out)


def _mark(source: Array, result: Array, weights: Callable[[Array], Array], alpha: bool) -> None:
    """Store NaN and infinities wherever those of the source have a weight other than 0."""

    def touched(marks: Array) -> Array:
        marks = marks | marks[..., -1:] if alpha else marks
        return np.abs(weights(marks)) > _WEIGHTLESS if marks.any() else np.zeros(result.shape, bool)

    high, low = touched(source == np.inf), touched(source == -np.inf)
    result[high], result[low] = np.inf, -np.inf
    result[touched(np.isnan(source)) | (high & low)] = np.nan
    if result.shape == source.shape:  # copies keep every bit: NaNs have many patterns
        np.copyto(result, source, where=np.isnan(result) & np.isnan(source))


def warp_picture(
    picture: Any, space: Space, sampling: Sampling, *, clamp: bool, device: str, regridded: bool, name: str = ""
) -> tuple[Any, Certificate]:
    """Return a warped picture, and the certificate of the map.

    All pages are sampled, and each channel by its own kind. ``space`` is the map of all pages; ``regridded`` says
    whether the output has another grid; ``name`` is the picture's name in warnings.
    """
    found, count = Certificate(), picture.pixels.shape[2] if picture.pixels.ndim == 3 else 1
    if (dtype := picture.pixels.dtype).kind in "iu":
        low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
        if wrong := [value for value in np.ravel(sampling.fill).tolist() if value < low or value > high]:
            refuse("fill", f"from {low} to {high} for the {dtype} of {name or 'the picture'}", wrong[0])
    fill = np.asarray(sampling.fills(count, dtype, finite=False))

    def warp(pixels: Array, alpha: bool, channels: list[int]) -> Array:
        nonlocal found
        how = replace(sampling, fill=tuple(fill[channels].tolist()))
        made, certificate = warp_array(pixels, space, how, alpha=alpha, device=device)
        found |= certificate
        if clamp and not space.is_identity:
            for before, after in zip(pixels, made, strict=True) if picture.pages > 1 else ((pixels, made),):
                clamp_to(before, after, how)  # each page separately
        return np.asarray(made)

    averaged = not sampling.keeps_values and not space.is_identity
    return picture.warped(warp, regridded=regridded, averaged=averaged, name=name), found


def array_of(value: object, name: str) -> Array:
    """Return a value as a NumPy array; SuppleError, which says what to pass, if it is not an array."""
    check_gradients(value, name)
    first = value[0] if isinstance(value, list | tuple) and value else value
    mode, held = getattr(first, "mode", None), ""
    if any(hasattr(type(first), name) for name in _HOLDERS):
        held = f"one of {type(first).__module__}.{type(first).__name__}: give its array, and its spacing to Deformation"
    elif isinstance(first, str | os.PathLike):
        held = "the name of a file: supple.warp_file warps files"
    elif type(first).__module__.startswith("PIL") and mode in ("P", "PA", "HSV", "CMYK"):
        held = f'a picture of the mode {mode}, whose numbers do not mix: give image.convert("RGB")'
    if held:
        refuse(name, "an array", told=held)
    try:
        return np.asarray(value)
    except (TypeError, ValueError):
        refuse(name, "an array of numbers", value)


def checked_out(out: object, held: Array, shape: tuple[int, ...]) -> Array:
    """Return ``out`` if it has the result's shape and the dtype of ``held``, the source; SuppleError otherwise."""
    wanted = f"an array of {held.dtype} of shape {shape}, as the {'source' if shape == held.shape else 'grid'} is"
    if not isinstance(out, np.ndarray):
        refuse("out", wanted, out)
    if out.shape != shape or out.dtype != held.dtype:
        refuse("out", wanted, told=f"{out.dtype} of shape {out.shape}")
    if not out.flags.writeable:
        raise SuppleError("out must be an array that can be written, found a read-only one")
    files = [_file_of(array) for array in (out, held)]
    if np.may_share_memory(out, held) or (None not in files and files[0] == files[1]):
        raise SuppleError("out must not overlap source: the source is read while the result is written")
    return out


def _file_of(array: Array) -> tuple[int, int] | None:
    """Return the device and the inode of the file that an array is mapped from, or None."""
    root: Any = array
    while isinstance(root.base, np.ndarray):
        root = root.base
    if not isinstance(root, np.memmap) or root.filename is None or not os.path.exists(root.filename):
        return None
    found = os.stat(root.filename)
    return found.st_dev, found.st_ino


def _on_device(
    source: Any,
    spaces: tuple[Space, ...],
    sampling: Sampling,
    alpha: bool | None,
    clamp: bool,
    device: str,
    out: Any,
    batch: bool = False,
) -> tuple[Any, Certificate]:
    """Warp an array on its CUDA device."""
    from supple.cuda import sample

    if clamp:
        refuse("clamp", "False for an array on a CUDA device: clip the result there", clamp)
    if device != "cuda":  # the array determines the GPU
        check_device(device)
    return sample(source, spaces, sampling, alpha, out, batch=batch)


def warp_batch(
    sources: Any,
    deformations: Deforming | Sequence[Deforming],
    *,
    sampling: Sampling = DEFAULT,
    alpha: bool | None = None,
    device: str = "cpu",
    out: Any = None,
    **options: Unpack[SamplingFields],
) -> Any:
    """Deform a batch of images, of volumes or of clips.

    Parameters
    ----------
    sources : array of shape (N, H, W[, C]) or (N, T, H, W[, C])
        A NumPy array, or one on an NVIDIA GPU, which warps a batch of images at once.
    deformations : Deformation or sequence of Deformation
        One for all items, or one for each, all of the same shape.
    sampling : Sampling, optional
        How the arrays are sampled; further keywords replace its fields: ``filter="linear"``.
    alpha, device
        As in `supple.Deformation.warp`.
    out : array, optional
        The array for the result, of its shape and type, and not overlapping ``sources``.

    Returns
    -------
    array
        The result, of the sources' shape and type, in an array of the same library.

    Warns
    -----
    ToleranceWarning
        If the checks of a map's cells do not promise the tolerance everywhere.
    """
    spaces = spaces_of(deformations)
    sampling = Sampling.of(sampling, options, spaces[0].ndim)
    if is_on_device(sources):
        result, certificate = _on_device(sources, spaces, sampling, alpha, False, device, out, batch=True)
        warn_of(certificate, sampling.tolerance)
        return result
    held = array_of(sources, "sources")
    shape = spaces[0].whole
    if held.ndim < 1 + len(shape) or held.shape[1 : 1 + len(shape)] != shape:
        sizes = ", ".join(map(str, shape))
        refuse("sources", f"of shape (N, {sizes}) or (N, {sizes}, channels)", told=f"shape {held.shape}")
    check_count(spaces, len(held))
    made = (len(held), *spaces[0].out, *held.shape[1 + len(shape) :])
    result = np.empty(made, held.dtype) if out is None else checked_out(out, held, made)
    for k, item in enumerate(held):
        try:
            space = spaces[k % len(spaces)]
            _, certificate = warp_array(item, space, sampling, alpha=alpha, device=device, out=result[k])
        except SuppleError as error:
            raise type(error)(f"item {k}: {error}" if len(spaces) > 1 else str(error)) from None
        warn_of(certificate, sampling.tolerance)
    return result


def clamp_to(source: Array, result: Array, sampling: Sampling) -> None:
    """Clamp a result to the finite range of its source and the fill value around it, which cubic filters overshoot.

    NaN stay, and so do infinities if the source or the fill value has any.
    """
    kind, cubic = result.dtype.kind, sampling.filter in ("auto", "cubic") or sampling.between_frames == "cubic"
    if kind not in "iuf" or not cubic:
        return
    low, high, infinite = _finite_range(source)
    if low > high:  # no finite value
        return
    if sampling.outside == "constant":
        fills = [float(x) for x in np.ravel(sampling.fill)]
        fill = [x for x in fills if np.isfinite(x)] or [float(low)]
        infinite = infinite or fill != fills
        if kind in "iu":
            least, most = np.iinfo(result.dtype).min, np.iinfo(result.dtype).max
            fill = [min(max(round(x), least), most) for x in fill]
        low, high = min(low, result.dtype.type(min(fill))), max(high, result.dtype.type(max(fill)))
    for part in _slabs(result):  # values within the range keep every bit, the sign of a zero too
        for beyond, bound in ((part < low, low), (part > high, high)):
            np.copyto(part, bound, where=beyond & np.isfinite(part) if infinite else beyond)


def _finite_range(source: Array) -> tuple[Any, Any, bool]:
    """Return the least and the greatest finite value (in reverse order if there is none), and if any is infinite."""
    kind, infinite = source.dtype.newbyteorder("="), False
    low, high = (np.inf, -np.inf) if kind.kind == "f" else (np.iinfo(kind).max, np.iinfo(kind).min)
    for part in _slabs(source):
        least, most = np.fmin.reduce(part, axis=None), np.fmax.reduce(part, axis=None)
        if np.isinf(least) or np.isinf(most):
            infinite, finite = True, part[np.isfinite(part)]
            least, most = finite.min(initial=np.inf), finite.max(initial=-np.inf)
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
