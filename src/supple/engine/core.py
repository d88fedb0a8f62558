"""The core's calls: plans of T⁻¹, samples at it, and points, on all CPU cores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.motion import Moving
from supple.engine.sampling import BETWEEN, FILTERS, OUTSIDE, Certificate, Sampling, certificate_of_status
from supple.engine.work import Array, Space, Tell, Work, silent
from supple.errors import SuppleError
from supple.space.checks import refuse
from supple.space.geometry import Floats

CONVERGED = 1e-6
"""The largest residual |T(p) - q| of a converged point, in pixels."""

_PADDING = 256  # bytes: more than a vector reads beyond the last sample
_TOGETHER = 8  # planes for each thread between reports of progress
_KINDS: dict[np.dtype[Any], np.dtype[Any]] = {
    np.dtype(np.float16): np.dtype(np.float32),
    np.dtype(np.bool_): np.dtype(np.uint8),
}


def plan_of(space: Space, z: float, tolerance: float, step: tuple[int, int] = (1, 1)) -> _core.Plan:
    """Solve for T⁻¹ on the plane of index z, within a tolerance in pixels, for samples up to ``step`` (x, y) apart."""
    first, shape, box = _laid(space, step)
    return _core.Plan(space.map, *shape, float(first + z), tolerance, box, max(step) > 1)


def _laid(space: Space, step: tuple[int, int]) -> tuple[int, tuple[int, int], _core.Box | None]:
    """Return the first plane of the output, the shape of whole planes, and the box (x0, x1, y0, y1) of each."""
    height, width = space.shape
    if space.grid is not None:
        (x, y, *z), (width, height, *_) = space.grid.first, space.grid.sizes
        return sum(z), (space.grid.whole[-2], space.grid.whole[-1]), (x, x + width, y, y + height)
    if space.composite is None and space.axes[0, 2] < 0:  # free border: include the last chroma samples whole
        height, width = -(-height // step[1]) * step[1], -(-width // step[0]) * step[0]
    return 0, (height, width), None


def certificate_of(plan: _core.Plan, space: Space) -> Certificate:
    """Return the certificate of a plan from the checks of its cells; its counts are of fields alone."""
    return _certificate(plan.checks, space)


def _certificate(checks: _core.Checks, space: Space) -> Certificate:
    return Certificate(*(checks[:2] if space.composite is None else checks))


def measured(plan: _core.Plan, tolerance: float) -> Certificate:
    """Return the error of a plan's source points, measured at every pixel by further Newton steps."""
    _, evaluations, _, folded, _ = plan.checks
    error, unknown = plan.measure(min(1e-5, 1e-3 * tolerance))
    return Certificate(error, evaluations, unknown, folded)


def needed(
    space: Space, sampling: Sampling, planes: Sequence[int] | None = None
) -> tuple[tuple[int, ...], list[float], Certificate]:
    """Return the part of the source that the output, or some planes of it, reads.

    Its bounds are (x0, x1, y0, y1, first frame, last frame + 1). The list has the largest displacement in each plane of
    the output, in pixels; -1 where no stroke reaches it. The certificate is that of the map in these planes.
    """
    (count, rows, columns), (first, (height, width), box) = space.planes, _laid(space, (1, 1))
    part, moved, checks = _core.needed(
        space.map,
        height,
        width,
        [first + z for z in (planes if planes is not None else range(count if space.ndim == 3 else 1))],
        sampling.tolerance,
        space.count,
        space.shape,
        sampling.codes,
        box or (0, columns, 0, rows),
    )
    return part, moved, _certificate(checks, space)


def working_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type in which the core takes samples."""
    native: np.dtype[Any] = dtype.newbyteorder("=")
    return _KINDS.get(native, native)


def view(array: Array) -> Array | None:
    """Return a view of an array in the form that the core takes; None if the array must be copied."""
    if not (array.flags.c_contiguous and array.flags.aligned and array.dtype.isnative):
        return None
    kind = _KINDS.get(array.dtype, array.dtype)
    return np.asarray(array).view(kind) if array.dtype in (kind, np.bool_) else None


def samplings_of(
    work: Work,
    frames: Sequence[Array],
    outs: Sequence[Array],
    count: int,
    corner: tuple[int, int, int] | None = None,
    moving: Moving | None = None,
) -> list[_core.Sampling]:
    """Return the core's sampling jobs for some frames of a clip of ``count``.

    ``frames`` and ``outs`` have one array for each group, contiguous and in native byte order. Frame k is in slot k
    modulo the number of slots (slots, h, w, channels); the destination is (h, w, channels), or that of several planes.
    If the arrays hold a part of the layout's frames, ``corner`` is the position (x, y, frame) of their first sample.
    ``moving`` is the motion that samples between frames follow.
    """
    sampling = work.sampling
    nearest = FILTERS["nearest"], BETWEEN["nearest"], OUTSIDE[sampling.outside], False
    fills = iter(np.broadcast_to(sampling.fill, sum(group.channels for group in work.layout.groups)).tolist())
    made = []
    for group, held, out in zip(work.layout.groups, frames, outs, strict=True):
        fill = [float(next(fills)) for _ in range(group.channels)]
        job = _core.Sampling(
            held, out, count, group.step, group.offset, nearest if group.exact else sampling.codes, fill,
            group.channels - 1 if group.alpha else -1, sampling.linear_light, work.layout.white, corner,
            None if corner is None else group.shape, None if group.exact else moving,
        )  # fmt: skip
        made.append(job)
    return made


def sample(
    work: Work,
    frames: Sequence[Array],
    outs: Sequence[Array],
    tell: Tell = silent,
    *,
    corner: tuple[int, int, int] | None = None,
    copied: Sequence[bool] | None = None,
) -> Certificate:
    """Sample frames in memory, several planes at once on all threads, and return the certificate of the map.

    ``frames`` and ``outs`` have, for each group, an array (count, h, w, channels) of all frames, and one of all planes,
    as `view` returns them. With a ``corner``, the position (x, y, frame) of their first sample, the arrays hold a part
    of the layout's frames (`needed`), in any byte order and with any strides. ``copied`` marks planes in which no
    displacement exceeds the tolerance. For stacks, ``tell`` is called with ``"warp"``, the finished planes, and their
    total.
    """
    space, tolerance, planes = work.space, work.sampling.tolerance, len(outs[0])
    if corner is not None:
        frames = [_padded(held) for held in frames]
    if space.ndim == 2:
        plan = plan_of(space, 0, tolerance, work.layout.step)
        for k in range(planes):  # each frame is an image of its own
            for each in samplings_of(work, [f[k : k + 1] for f in frames], [out[k] for out in outs], 1, corner):
                plan.sample(each)
        return certificate_of(plan, space)
    first, shape, box = _laid(space, work.layout.step)
    together, certificate = _TOGETHER * _core.threads(), Certificate()
    for start in range(0, planes, together):
        some = slice(start, min(start + together, planes))
        numbered = list(range(first + some.start, first + some.stop))
        jobs = samplings_of(work, frames, [out[some] for out in outs], space.count, corner)
        marked = None if copied is None else list(copied[some])
        checks = _core.warp_stack(space.map, *shape, numbered, tolerance, jobs, box, marked)
        certificate |= _certificate(checks, space)
        tell("warp", some.stop, planes)
    return certificate


def _padded(array: Array) -> Array:
    """Return a copy of an array, followed by bytes that vectors may read."""
    held = np.empty(array.nbytes + _PADDING, np.uint8)
    made = held[: array.nbytes].view(array.dtype).reshape(array.shape)
    made[...] = array
    return made


def forward(space: Space, points: npt.ArrayLike, *, matrices: bool = False) -> tuple[Floats, Certificate]:
    """Return T of points (..., D) in pixels, x first, or, if ``matrices``, ∂T/∂p (..., D, D); and the certificate.

    Without fields, T is explicit.
    """
    rows, given = _rows(space, points)
    certificate = Certificate()
    if space.composite is None:
        result, slopes = _core.forward(space.rows, space.axes, rows, matrices, space.freeze)
    else:
        status = np.zeros(len(rows), np.uint8)
        result, slopes, _ = space.composite.through(rows, False, matrices, status)
        certificate = certificate_of_status(status)
    if slopes is None:
        return _points(space, result, rows, given), certificate
    n, steps = space.ndim, space.axes[: space.ndim, 3]
    full = slopes[:, :n, :n] * (steps[None, :] / steps[:, None])
    return np.ascontiguousarray(full.reshape(*given.shape[:-1], n, n)), certificate


def inverse(
    space: Space, points: npt.ArrayLike
) -> tuple[tuple[Floats, Floats, npt.NDArray[np.int64], npt.NDArray[np.bool_]], Certificate]:
    """Return T⁻¹ of points (..., D) with the values of `supple.Inverse`, and the certificate.

    The residual is in pixels, by the least spacing.
    """
    targets, given = _rows(space, points)
    shape, finest = given.shape[:-1], float(space.axes[: space.ndim, 3].min())
    status = np.zeros(len(targets), np.uint8)
    if space.composite is None:
        result, residual, steps = _core.inverse(space.map, targets, 1e-9 * finest)
    else:
        result, _, steps = space.composite.through(targets, True, False, status)
        seen, _, _ = space.composite.through(result, False, False, np.zeros_like(status))
        residual = np.linalg.norm((seen - targets)[:, : space.ndim], axis=1)
    # A bound on the residual in pixels, which for one spacing along all axes is the residual.
    off = residual.reshape(shape) / finest
    near = off <= CONVERGED
    if not near.all():  # far from the origin, rounding alone leaves more
        near |= off <= 1e-14 / finest * np.abs(targets).max(axis=1, initial=0.0).reshape(shape)
    near &= status.reshape(shape) & 4 == 0
    values = _points(space, result, targets, given), off, steps.astype(np.int64).reshape(shape), near
    return values, certificate_of_status(status)


def certified(
    space: Space, points: npt.ArrayLike, *, back: bool
) -> tuple[tuple[Floats, Floats, npt.NDArray[np.bool_]], Certificate]:
    """Return T or T⁻¹ of points (..., D) with the values of `supple.deformation.Certified`, and the certificate."""
    rows, given = _rows(space, points)
    composite = space.composite or _core.Composite(
        space.ndim, space.axes, [("strokes", space.rows, False)], space.freeze
    )
    status, errors = np.zeros(len(rows), np.uint8), np.zeros(len(rows))
    found, _, _ = composite.through(rows, back, False, status, errors)
    if space.composite is None:  # beyond the reach of strokes, no bit changes
        errors[(found == rows).all(axis=1) & (status & 4 == 0)] = 0.0
    shape = given.shape[:-1]
    values = _points(space, found, rows, given), errors.reshape(shape), (status & 4 == 0).reshape(shape)
    return values, certificate_of_status(status)


def inverse_map(
    space: Space, tolerance: float, dtype: npt.DTypeLike = np.float32
) -> tuple[npt.NDArray[Any], Certificate]:
    """Return the source point of every pixel, (*shape, D), and the certificate.

    In float64, points of images of any size are equally accurate.
    """
    out = np.empty((*space.out, space.ndim), dtype)
    certificate = Certificate()
    for z, plane in enumerate(out if space.ndim == 3 else [out]):
        plan = plan_of(space, z, tolerance)
        plan.points(plane)
        certificate |= certificate_of(plan, space)
    return out, certificate


def _rows(space: Space, points: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return points in the core's form, (N, 3) in physical units, and as given."""
    n = space.ndim
    try:
        given = np.asarray(points, np.float64)
    except (TypeError, ValueError):
        refuse("points", f"numbers in an array of shape (..., {n})", points)
    if given.ndim == 0 or given.shape[-1] != n:
        refuse("points", f"an array of shape (..., {n}), x first", told=f"shape {given.shape}")
    if not np.isfinite(given).all():
        raise SuppleError("points must be finite, found NaN or infinity among them")
    rows = np.zeros((given.size // n, 3))
    rows[:, :n] = given.reshape(-1, n) * space.axes[:n, 3]
    return rows, given


def _points(space: Space, moved: Floats, rows: Floats, given: Floats) -> Floats:
    """Return points in samples; a coordinate that did not change keeps every bit."""
    n, flat = space.ndim, given.reshape(-1, space.ndim)
    made = moved[:, :n] / space.axes[:n, 3]
    np.copyto(made, flat, where=moved[:, :n] == rows[:, :n])
    return made.reshape(given.shape)
