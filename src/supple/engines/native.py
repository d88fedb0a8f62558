"""The native engine: planes and points computed by the C++ core on all CPU cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engines.base import (
    BETWEEN,
    FILTERS,
    OUTSIDE,
    Array,
    Certificate,
    Sampling,
    Space,
    Steps,
    Work,
    certificate_of_status,
    check_gradients,
    warn_of,
)
from supple.engines.workers import CPU
from supple.errors import SuppleError, argument
from supple.space.domain import refuse
from supple.space.geometry import Grid
from supple.strokes import numbers

Floats = npt.NDArray[np.float64]

CONVERGED = 1e-6
"""The largest residual |T(p) - q| of a converged point, in pixels."""

_PADDING = 256  # bytes: more than a vector reads beyond the last sample
_TOGETHER = 8  # planes for each thread between reports of progress
_KINDS: dict[np.dtype[Any], np.dtype[Any]] = {
    np.dtype(np.float16): np.dtype(np.float32),
    np.dtype(np.bool_): np.dtype(np.uint8),
}
# Objects that hold an array, by their library and one of their attributes.
_HELD = {
    ("SimpleITK", "GetSpacing"): "an image of SimpleITK: give SimpleITK.GetArrayViewFromImage(image)",
    ("nibabel", "dataobj"): "an image of nibabel: give numpy.asanyarray(image.dataobj).T",
    ("pydicom", "pixel_array"): "a data set of pydicom: give its pixel_array",
    ("supple", "rescaled"): "a volume: give its samples",
}


def plan_of(space: Space, z: float, tolerance: float, step: tuple[int, int] = (1, 1)) -> _core.Plan:
    """Solve for T⁻¹ on a plane.

    Parameters
    ----------
    space : Space
    z : float
        The index of the plane, in samples.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in pixels.
    step : (int, int)
        The largest spacing of samples, in pixels, x first.
    """
    first, shape, box = _laid(space, step)
    return _core.Plan(
        numbers(space.table), space.axes, space.ndim, *shape, float(first + z), tolerance, space.composite, box,
        space.freeze,
    )  # fmt: skip


def needed(space: Space, sampling: Sampling) -> tuple[tuple[int, ...], list[float], Certificate]:
    """Return the part of the source that a part of the output, ``space.grid``, reads.

    Returns
    -------
    tuple of int
        Its bounds x0, x1, y0, y1, and the first frame and that after the last.
    list of float
        How far each plane of the part moves, in pixels; -1 where no stroke reaches it.
    Certificate
        The accuracy of the map there.
    """
    assert space.grid is not None
    return needed_by(space, sampling, *_part(space.grid))


def needed_by(
    space: Space, sampling: Sampling, planes: range, box: tuple[int, int, int, int]
) -> tuple[tuple[int, ...], list[float], Certificate]:
    """Return what some planes of the output read, in a box (x0, x1, y0, y1) of each; see `needed`."""
    height, width = space.shape if space.grid is None else space.grid.whole[-2:]
    part, moved, error, found = _core.needed(
        numbers(space.table),
        space.axes,
        space.ndim,
        height,
        width,
        list(planes),
        sampling.tolerance,
        space.count,
        space.shape,
        FILTERS[sampling.filter],
        BETWEEN[sampling.between],
        OUTSIDE[sampling.outside],
        sampling.time_filter and sampling.between != "nearest",
        space.composite,
        box,
        space.freeze,
    )
    return part, moved, _certificate(space, error, 0.0, found)


def _padded(array: Array) -> Array:
    """Return a copy of an array, followed by bytes that vectors may read."""
    held = np.empty(array.nbytes + _PADDING, np.uint8)
    made = held[: array.nbytes].view(array.dtype).reshape(array.shape)
    made[...] = array
    return made


def _part(grid: Grid) -> tuple[range, tuple[int, int, int, int]]:
    """Return the planes of the whole grid that a part of it has, and the box (x0, x1, y0, y1) in each."""
    (x, y, *z), (width, height, *depth) = grid.first, grid.sizes
    planes = range(z[0], z[0] + depth[0]) if z else range(1)
    return planes, (x, x + width, y, y + height)


def _laid(space: Space, step: tuple[int, int]) -> tuple[int, tuple[int, int], tuple[int, int, int, int] | None]:
    """Return the first plane of the output, the shape of whole planes, and the box of each that is wanted."""
    if space.grid is None:
        return 0, space.planned(step) if space.composite is None else space.shape, None
    planes, box = _part(space.grid)
    return planes[0], (space.grid.whole[-2], space.grid.whole[-1]), box


def certificate_of(plan: _core.Plan, space: Space) -> Certificate:
    """Return the certificate of a plan from the checks of its cells, with their reserve."""
    return _certificate(space, plan.error, plan.evaluations, (plan.unsolved, plan.folds, plan.outside))


def _certificate(space: Space, error: float, evaluations: float, found: tuple[int, int, int]) -> Certificate:
    """Return a certificate; points that are not solved, fold, and lie outside are those of fields alone."""
    return Certificate(error, evaluations, *((0, 0, 0) if space.composite is None else found))


def measured(plan: _core.Plan, tolerance: float) -> Certificate:
    """Return the error of a plan's source points, measured at every pixel by further Newton steps."""
    error, unknown = plan.measure(min(1e-5, 1e-3 * tolerance))
    return Certificate(error, plan.evaluations, unknown)


def samplings_of(
    work: Work, frames: Sequence[Array], outs: Sequence[Array], count: int, corner: tuple[int, int, int] | None = None
) -> list[_core.Sampling]:
    """Return the core's sampling jobs for some frames.

    Parameters
    ----------
    work : Work
    frames : sequence of arrays
        For each group, the frames (slots, h, w, channels); frame k is in slot k modulo the number of slots:
        contiguous, in native byte order.
    outs : sequence of arrays
        For each group, the destination: (h, w, channels) or (planes, h, w, channels), contiguous.
    count : int
        The number of frames of the clip.
    corner : (int, int, int), optional
        If ``frames`` are a part of those of the layout: the position x, y, and the frame, of their first sample.
    """
    return [
        _core.Sampling(
            held,
            out,
            count,
            group.step,
            group.offset,
            FILTERS[sampling.filter],
            BETWEEN[sampling.between],
            OUTSIDE[sampling.outside],
            sampling.time_filter and sampling.between != "nearest",
            fill.tolist(),
            group.channels - 1 if group.alpha else -1,
            sampling.light,
            work.layout.white,
            corner,
            None if corner is None else group.shape,
        )
        for group, sampling, held, fill, out in zip(
            work.layout.groups, work.samplings, frames, work.fills, outs, strict=True
        )
    ]


@dataclass(frozen=True, slots=True)
class Native:
    """The engine that is always available (`supple.engines.base.Engine`)."""

    name: str = CPU

    def taken(self, value: object, name: str) -> Array:
        """Return a value as a NumPy array; SuppleError if it is not an array."""
        check_gradients(value, name)
        _check_held(value[0] if isinstance(value, list | tuple) and value else value, name)
        try:
            return np.asarray(value)
        except (TypeError, ValueError):
            refuse(name, "an array of numbers", value)

    def result(self, out: Array | None, held: Array, shape: tuple[int, ...] | None = None) -> Array:
        """See `Engine.result`; it is an array of the source's type, and of its shape or the given one."""
        if out is None:
            return np.empty_like(held, order="C") if shape is None else np.empty(shape, held.dtype)
        shape = held.shape if shape is None else shape
        wanted = f"an array of {held.dtype} of shape {shape}, as the {'source' if shape == held.shape else 'grid'} is"
        given: object = out  # user input of any type
        if not isinstance(given, np.ndarray):
            refuse("out", wanted, given)
        if out.shape != shape or out.dtype != held.dtype:
            refuse("out", wanted, told=f"{out.dtype} of shape {out.shape}")
        if not out.flags.writeable:
            raise SuppleError("out must be an array that can be written, found a read-only one")
        if np.may_share_memory(out, held) or _same_bytes(out, held):
            raise SuppleError("out must not overlap source: the source is read while the result is written")
        return out

    def working_dtype(self, dtype: np.dtype[Any]) -> np.dtype[Any]:
        """Return the type in which samples are processed."""
        native: np.dtype[Any] = dtype.newbyteorder("=")
        return _KINDS.get(native, native)

    def view(self, array: Array) -> Array | None:
        """Return a view of an array in the form the core takes; None if the array must be copied."""
        kind = self.working_dtype(array.dtype)
        if not (array.flags.c_contiguous and array.flags.aligned and array.dtype.isnative):
            return None
        return np.asarray(array).view(kind) if array.dtype in (kind, np.bool_) else None

    def warp(
        self, work: Work, frames: Sequence[Array], outs: Sequence[Array], planes: Sequence[int] | None = None
    ) -> Steps:
        """See `Engine.warp`: planes side by side, on all threads; all of them, or those that are named."""
        space, tolerance, step = work.space, work.sampling.tolerance, work.layout.step
        wanted = range(len(outs[0])) if planes is None else planes
        if space.ndim == 2:
            plan = plan_of(space, 0, tolerance, step)
            for k, z in enumerate(wanted):  # each frame is an image of its own
                for each in samplings_of(work, [f[z : z + 1] for f in frames], [out[k] for out in outs], 1):
                    plan.sample(each)
            yield len(wanted), certificate_of(plan, space)
            return
        first, shape, box = _laid(space, step)
        numbered = [first + z for z in wanted]
        yield from _stacked(
            work,
            numbered,
            shape,
            box,
            lambda some: samplings_of(work, frames, [out[some] for out in outs], space.count),
        )

    def warp_part(
        self,
        work: Work,
        frames: Sequence[Array],
        outs: Sequence[Array],
        corner: tuple[int, int, int],
        copied: Sequence[bool],
    ) -> Certificate:
        """Sample a part of the output, ``work.space.grid``, from the part of the source that it reads (`needed`).

        Parameters
        ----------
        work : Work
            Its layout is that of whole frames, of one group.
        frames : sequence of arrays
            For each item that is warped alike, the part of the source (slots, h, w, channels), in any order of bytes
            and axes.
        outs : sequence of arrays
            For each item, the part of the output (planes, h, w, channels).
        corner : (int, int, int)
            The position x, y, and the frame, of the first sample of ``frames``.
        copied : sequence of bool
            Which planes are copied, since all of them moves by less than the tolerance.
        """
        space, tolerance = work.space, work.sampling.tolerance
        grid = space.grid
        assert grid is not None
        frames = [_padded(held) for held in frames]
        if space.ndim == 2:
            plan = plan_of(space, 0, tolerance)
            for held, out in zip(frames, outs, strict=True):
                for each in samplings_of(work, [held], [out[0]], 1, corner):
                    plan.sample(each)
            return certificate_of(plan, space)
        planes, box = _part(grid)

        def given(some: slice) -> list[_core.Sampling]:
            items = zip(frames, outs, strict=True)
            return [s for held, out in items for s in samplings_of(work, [held], [out[some]], space.count, corner)]

        certificate = Certificate(0.0, 0.0)
        for _, known in _stacked(work, list(planes), (grid.whole[-2], grid.whole[-1]), box, given, copied):
            certificate |= known
        return certificate

    def stream(self, work: Work, window: Sequence[Array]) -> Callable[[int, Sequence[Array]], Certificate]:
        """Return a function that makes a plane of a stream, given its number and an array for each group.

        The frames that it samples are in the window, for each group an array (capacity, h, w, channels); frame k is in
        slot k modulo the capacity.
        """
        tolerance, step = work.sampling.tolerance, work.layout.step
        every = None  # one map for all frames
        if work.space.ndim == 2 and work.items is None:
            every = plan_of(work.space, 0, tolerance, step)

        def make(z: int, outs: Sequence[Array]) -> Certificate:
            space, frames, count = work.space if work.items is None else work.items[z], window, work.space.count
            plan = every or plan_of(space, z if space.ndim == 3 else 0, tolerance, step)
            if space.ndim == 2:  # each frame is an image of its own
                slot = z % len(window[0])
                frames, count = [held[slot : slot + 1] for held in window], 1
            for each in samplings_of(work, frames, outs, count):
                plan.sample(each)
            return certificate_of(plan, space)

        return make

    def forward(self, space: Space, points: npt.ArrayLike, *, matrices: bool = False) -> Floats:
        """See `Engine.forward`."""
        rows, given = _rows(space, points)
        found, slopes, certificate = _sent(space, rows, matrices)
        warn_of(certificate, 1.0, 4)
        if slopes is None:
            return _points(space, found, rows, given)
        n, steps = space.ndim, space.axes[: space.ndim, 3]
        full = slopes[:, :n, :n] * (steps[None, :] / steps[:, None])
        return np.ascontiguousarray(full.reshape(*given.shape[:-1], n, n))

    def inverse(
        self, space: Space, points: npt.ArrayLike
    ) -> tuple[Floats, Floats, npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """See `Engine.inverse`; the residual is in pixels, by the least spacing."""
        targets, given = _rows(space, points)
        shape, finest = given.shape[:-1], float(space.axes[: space.ndim, 3].min())
        status = np.zeros(len(targets), np.uint8)
        if space.composite is None:
            found, residual, steps = _core.inverse(
                numbers(space.table), space.axes, targets, space.ndim, 1e-9 * finest, space.freeze
            )
        else:
            found, _, steps = space.composite.through(targets, True, False, status)
            seen, _, _ = space.composite.through(found, False, False, np.zeros_like(status))
            residual = np.linalg.norm((seen - targets)[:, : space.ndim], axis=1)
            warn_of(certificate_of_status(status), 1.0, 4)
        # A bound on the residual in pixels, which for one spacing along all axes is the residual.
        off = residual.reshape(shape) / finest
        near = off <= CONVERGED
        if not near.all():  # far from the origin, rounding alone leaves more
            near |= off <= 1e-14 / finest * np.abs(targets).max(axis=1, initial=0.0).reshape(shape)
        near &= status.reshape(shape) & 4 == 0
        return _points(space, found, targets, given), off, steps.astype(np.int64).reshape(shape), near

    def inverse_map(
        self, space: Space, tolerance: float, like: Any = None, dtype: npt.DTypeLike = np.float32
    ) -> tuple[npt.NDArray[Any], Certificate]:
        """See `Engine.inverse_map`; in float64, points of any size of image are as accurate."""
        out = np.empty((*space.out, space.ndim), dtype)
        certificate = Certificate(0.0, 0.0)
        for z, plane in enumerate(out if space.ndim == 3 else [out]):
            plan = plan_of(space, z, tolerance)
            plan.points(plane)
            certificate |= certificate_of(plan, space)
        return out, certificate


NATIVE = Native()


def forward_of(space: Space, points: npt.ArrayLike) -> tuple[Floats, Certificate]:
    """Return T of points, as `Engine.forward` does, and its certificate: without fields, T is explicit."""
    rows, given = _rows(space, points)
    found, _, certificate = _sent(space, rows, jacobian=False)
    return _points(space, found, rows, given), certificate


def _sent(space: Space, rows: Floats, jacobian: bool) -> tuple[Floats, Floats | None, Certificate]:
    """Return T of points in the core's form, the derivatives or None, and the certificate."""
    if space.composite is None:
        return *_core.forward(numbers(space.table), space.axes, rows, jacobian, space.freeze), Certificate(0.0, 0.0)
    status = np.zeros(len(rows), np.uint8)
    found, slopes, _ = space.composite.through(rows, False, jacobian, status)
    return found, slopes, certificate_of_status(status)


def _check_held(value: Any, name: str) -> None:
    """Raise SuppleError for what holds an array, and of which NumPy makes another one or none, with what to give."""
    library, mode = type(value).__module__.partition(".")[0], getattr(value, "mode", None)
    known = (told for (root, attribute), told in _HELD.items() if root == library and hasattr(type(value), attribute))
    told = next(known, "")
    if told:
        told += ", and its spacing to Deformation"
    elif isinstance(value, str | os.PathLike):
        told = "the name of a file: supple.warp_file warps files"
    elif library == "PIL" and mode in ("P", "PA", "HSV", "CMYK"):
        told = f'a picture of the mode {mode}, whose numbers do not mix: give image.convert("RGB")'
    if told:
        raise SuppleError(f"{argument(name)} must be an array, found {told}")


def _stacked(
    work: Work,
    planes: Sequence[int],
    shape: tuple[int, int],
    box: tuple[int, int, int, int] | None,
    given: Callable[[slice], list[_core.Sampling]],
    copied: Sequence[bool] | None = None,
) -> Steps:
    """Sample planes of a stack, a few for each thread at a time, of which ``given`` returns the sampling jobs."""
    space, table, together = work.space, numbers(work.space.table), _TOGETHER * _core.threads()
    for start in range(0, len(planes), together):
        some = slice(start, min(start + together, len(planes)))
        error, steps, (folded, outside, unknown) = _core.warp_stack(
            table, space.axes, *shape, planes[some], work.sampling.tolerance, given(some), space.composite, box,
            None if copied is None else list(copied[some]), space.freeze,
        )  # fmt: skip
        yield some.stop, _certificate(space, error, steps, (unknown, folded, outside))


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


def _points(space: Space, found: Floats, rows: Floats, given: Floats) -> Floats:
    """Return the images of points in samples; a coordinate that did not change keeps every bit."""
    n, flat = space.ndim, given.reshape(-1, space.ndim)
    made = found[:, :n] / space.axes[:n, 3]
    np.copyto(made, flat, where=found[:, :n] == rows[:, :n])
    return made.reshape(given.shape)


def _same_bytes(out: Array, source: Array) -> bool:
    """Return whether two arrays map overlapping parts of one file."""
    one, two = _mapped(out), _mapped(source)
    if one is None or two is None or not (one[1] < two[2] and two[1] < one[2]):
        return False
    try:
        return os.path.samefile(one[0], two[0])
    except OSError:  # a file may be deleted while it is mapped
        return False


def _mapped(array: Array) -> tuple[str, int, int] | None:
    """Return the file that an array is mapped from, and the range of bytes."""
    root: Any = array
    while isinstance(root.base, np.ndarray):
        root = root.base
    if not isinstance(root, np.memmap) or root.filename is None:
        return None
    low, high = np.lib.array_utils.byte_bounds(array)
    start = root.offset - np.lib.array_utils.byte_bounds(root)[0]
    return os.fspath(root.filename), low + start, high + start
