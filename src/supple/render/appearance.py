"""The appearance of a volume: its prepared samples, transfer functions, light, and empty-space skipping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import Sampling
from supple.engine.work import Array
from supple.errors import SuppleError
from supple.render.box import Clip, box_of
from supple.render.camera import Projection
from supple.render.labels import LabelColours, labels_in, numbered
from supple.render.picture import linear_light, luminance_and_colours
from supple.render.transfer import ENTRIES, LABELS, PRESETS, Transfer, TransferFunction, transfer_of
from supple.space.checks import choice, point, refuse
from supple.space.geometry import Floats

DARK = 0.06  # of white: a maximum projection is transparent up to it, and opaque from twice as much on
AIR, SKIN = -1000.0, -450.0  # Hounsfield units
_THIN = 6.0  # mm: half of the largest thickness of a table
COARSE = 2.0  # of the finest spacing: slices farther apart are smoothed
_LOOKED_AT = 1 << 20  # voxels for a quantile
MOST = 1e18  # the largest sample: float32 holds the squares of gradients
_TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32)
PROJECTIONS = ("none", "maximum", "minimum", "average")


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """How rays see the samples of a volume: values, or the numbers of labels."""

    transfer: Transfer
    density: tuple[float, float]  # the visible range of values or labels
    range: tuple[float, float]  # the smallest and the largest value or label
    projection: str  # one of `PROJECTIONS`
    table: npt.NDArray[np.float32]  # (N, 4): linear light, and the opacity of a step along a ray
    low: float  # the value of the table's first entry, and entries for each unit of value
    scale: float
    threshold: float  # the lowest visible sample; infinity if nothing is visible
    window: tuple[float, float]  # the visible range of samples
    labels: Array | None = None  # the visible labels, sorted; samples are their positions, from 1 on

    def visible(self, lows: Array, highs: Array) -> npt.NDArray[np.bool_]:
        """Return which bricks are visible, given the lowest and the highest sample of each."""
        if self.projection != "none":
            return np.ones(lows.shape, np.bool_)
        before = np.concatenate([[0], np.cumsum(self.table[:, 3] > 0)])  # visible entries before each
        lows, highs = np.maximum(lows, np.float32(self.window[0])), np.minimum(highs, np.float32(self.window[1]))

        def entry(values: Array) -> npt.NDArray[np.intp]:
            places = np.rint((values - np.float32(self.low)) * np.float32(self.scale))
            return np.asarray(np.clip(places, 0, len(self.table) - 1), np.intp)

        return np.asarray((lows <= highs) & (before[entry(highs) + 1] > before[entry(lows)]), np.bool_)


def skipped(seen: Seen, lows: Array, highs: Array) -> npt.NDArray[np.uint8]:
    """Return each brick's distance in bricks to the next visible one, 0 in visible ones, by the ranges of samples."""
    skips = np.zeros(lows.shape, np.uint8)
    if seen.projection == "none":  # a projection reads all samples of a ray
        _core.brick_distances(seen.visible(lows, highs), skips)
    return skips


def ranged(samples: Array) -> tuple[Array, Array]:
    """Return the smallest and the largest sample of each brick."""
    counts = [-(-(n - 1) // _core.BRICK) for n in samples.shape]
    lows, highs = np.empty(counts, np.float32), np.empty(counts, np.float32)
    _core.brick_ranges(samples, lows, highs)
    return lows, highs


def levelled(transfer: TransferFunction, samples: Array, values: tuple[float, float]) -> TransferFunction:
    """Return the preset ``grey`` in the values of a volume; other transfer functions unchanged.

    Its range ends at the quantile 0.999, since metal is far brighter. For Hounsfield units it begins at air, since
    lower values may occur. ``values`` are the smallest and the largest one.
    """
    if transfer is not PRESETS["grey"]:
        return transfer
    low, high = values
    some = samples.reshape(-1)[:: max(1, samples.size // _LOOKED_AT)]
    top = float(np.quantile(some, 1 - 1e-3))
    return transfer.absolute(AIR if is_hounsfield(low, high) else low, top if top > low else high)


def is_hounsfield(low: float, high: float) -> bool:
    """Return whether values from ``low`` to ``high`` look like Hounsfield units: they include air and bone."""
    return low <= -800 and high >= 200


def _parts(seen: npt.NDArray[np.uint8]) -> tuple[Array, npt.NDArray[np.intp]]:
    """Return the number of the part of each voxel that is 1, of voxels that touch by their faces, and their sizes.

    The number 0 is that of all other voxels.
    """
    from supple.media.volume.itk import imported  # here, as it takes time

    itk = imported()
    labels = itk.GetArrayFromImage(itk.ConnectedComponent(itk.GetImageFromArray(seen)))
    return labels, np.bincount(labels.reshape(-1))


def without_table(samples: Array, spacing: Sequence[float]) -> tuple[Array, float]:
    """Return a CT without thin parts beside the body, such as a table or a head holder, and the removed fraction.

    Voxels as dense as skin are divided into components, connected by faces; the largest one is the body. Others become
    air if they are nowhere thicker than 12 mm, and reach out of the box around the body: arms and legs are thicker,
    and objects inside the body do not leave its box. The fraction is of all voxels as dense as skin.

    Parameters
    ----------
    samples : array (Z, H, W)
        Hounsfield units.
    spacing : sequence of float
        In millimetres, x first.
    """
    dense = (samples >= SKIN).astype(np.uint8)
    labels, sizes = _parts(dense)
    if len(sizes) < 3:
        return samples, 0.0
    body = int(sizes[1:].argmax()) + 1
    radius = [max(1, round(_THIN / step)) for step in spacing]
    # For values 0 and 1 this equals a binary erosion, in less than half of the time.
    from supple.media.volume.itk import imported

    itk = imported()
    core = itk.GetArrayFromImage(itk.GrayscaleErode(itk.GetImageFromArray(dense), radius, itk.sitkBox))
    own = labels == body
    ends = (np.flatnonzero(own.any(axis=tuple({0, 1, 2} - {axis})))[[0, -1]] for axis in range(3))
    inner = np.bincount(labels[tuple(slice(a, b + 1) for a, b in ends)].reshape(-1), minlength=len(sizes))
    thick = np.bincount(labels[core != 0], minlength=len(sizes)) > 0
    apart = (sizes > inner) & ~thick
    apart[[0, body]] = False
    if not apart.any():
        return samples, 0.0
    return np.where(apart[labels], np.asarray(AIR, samples.dtype), samples), float(sizes[apart].sum() / sizes[1:].sum())


def transfer_function(given: Transfer | str) -> Transfer:
    """Return a transfer function, or the preset of a name."""
    if isinstance(given, Transfer):
        return given
    choice("transfer", given, (*PRESETS, LABELS))
    return transfer_of(given)


def sampled(
    given: Array,
    transfer: Transfer,
    density: tuple[float, float] | None,
    step: float,
    projection: str = "none",
    spacing: Sequence[float] = (1.0, 1.0, 1.0),
) -> tuple[Array, Array | None, Seen]:
    """Return a volume's samples for rays (values or numbers of labels), their colours, if any, and their appearance."""
    colours = None
    if isinstance(transfer, LabelColours):
        if projection != "none":
            raise SuppleError(f"a projection ({projection}) is of values, and labels have none: choose one of them")
        if given.ndim != 3:
            refuse("samples", "labels, (Z, H, W), for colours of labels", told=f"shape {given.shape}")
        found, window = labels_in(given), window_of(density, one=True)
        table = transfer.table(found, step)
        shown = (table[:, 3] > 0) & (found >= window[0]) & (found <= window[1])
        values = float(found.min(initial=0)), float(found.max(initial=0))
        table = np.concatenate([np.zeros((1, 4), np.float32), table[shown]])
        threshold, all_ = 0.5 if shown.any() else math.inf, (-math.inf, math.inf)
        seen = Seen(transfer, window, values, projection, table, 0.0, 1.0, threshold, all_, found[shown])
        return widened(numbered(given, found[shown])), None, seen
    if given.ndim == 4:
        given, colours = luminance_and_colours(given)
        colours = widened(colours)
    ready = prepared(given)
    values = float(ready.min()), float(ready.max())
    if projection == "none" and colours is None and not is_hounsfield(*values):
        ready = evened(ready, spacing)
    known = levelled(transfer, ready, values)
    return ready, colours, seen_through(known, density, values, step, projection)


def evened(samples: Array, spacing: Sequence[float]) -> Array:
    """Return samples smoothed by a cubic B-spline across slices that are far apart; others as they are.

    An edge within a slice is sharper than slices are close: linear samples between two of them would be terraces.
    """
    for axis, step in enumerate(reversed(spacing)):
        if step > COARSE * min(spacing):
            made, near = np.empty_like(samples), np.arange(samples.shape[axis])[:, None] + (-1, 1)
            near = near.clip(0, len(near) - 1).T
            for k, here in enumerate(samples):
                ends = (samples[i[k]] if axis == 0 else here.take(i, axis - 1) for i in near)
                mean = (4 * here.astype(np.float32) + sum(end.astype(np.float32) for end in ends)) / 6
                made[k] = np.rint(mean) if samples.dtype.kind in "iu" else mean
            samples = made
    return samples


def window_of(density: tuple[float, float] | None, *, one: bool = False) -> tuple[float, float]:
    """Return the visible range of values; with ``one``, it may be of a single value."""
    if density is None:
        return -math.inf, math.inf
    low, high = point("density", density, (2,))
    if low > high or (low == high and not one):
        refuse("density", "two values LO,HI, the lower one first", density)
    return low, high


def seen_through(
    transfer: TransferFunction,
    density: tuple[float, float] | None,
    values: tuple[float, float],
    step: float,
    projection: str,
) -> Seen:
    """Return the appearance of samples of a range ``values``, by a transfer function and a window of values.

    In a projection, they are grey and opaque, from black at the window's lower end to white at its upper one; in a
    maximum, nearly black ones are transparent, as the air around a body.
    """
    (low, high), window = values, window_of(density)
    places = np.linspace(low, high, ENTRIES)
    if projection != "none":
        black, white = window if density is not None else values
        shades = np.clip((places - black) / ((white - black) or 1.0), 0.0, 1.0)
        grey, opaque = linear_light(np.stack([shades] * 3, axis=1)), np.ones((ENTRIES, 1))
        if projection == "maximum":
            opaque = np.clip(shades / DARK - 1, 0, 1)[:, None]
        table = np.concatenate([opaque * grey, opaque], axis=1).astype(np.float32)
        threshold = -math.inf
    else:
        table = transfer.table(low, high, step)
        # An entry is for all values that round to it: those up to halfway to its neighbours.
        half = 0.5 * (high - low) / (ENTRIES - 1)
        seen = (table[:, 3] > 0) & (places + half >= window[0]) & (places - half <= window[1])
        first = int(np.argmax(seen)) if seen.any() else 0
        if not seen.any():
            threshold = math.inf
        elif first == 0:
            threshold = -math.inf if window[0] <= low else window[0]
        else:
            threshold = max(window[0], float(places[first]) - half)
    scale = (ENTRIES - 1) / (high - low) if high > low else 0.0
    return Seen(transfer, window, values, projection, table, low, scale, threshold, window)


def summed(table: Array) -> Floats:
    """Return the sums of extinction times colour, and of extinction, of all entries before each: (N + 1, 4)."""
    known = table.astype(np.float64)
    extinction = -np.log1p(-np.minimum(known[:, 3:], 1 - 1e-9))
    known[:, 3] = 1.0
    return np.concatenate([np.zeros((1, 4)), np.cumsum(known * extinction, axis=0)])


def fixed(samples: Array, transfer: Transfer) -> Transfer:
    """Return a transfer function in absolute values of a volume, so that hiding parts does not change it."""
    if not isinstance(transfer, TransferFunction):
        return transfer
    seen = sampled(np.asarray(samples), transfer, None, 1.0)[2]
    assert isinstance(seen.transfer, TransferFunction)
    return seen.transfer.absolute(*seen.range)


def largest(samples: Array, transfer: Transfer | str, density: tuple[float, float] | None = None) -> Array:
    """Return a volume of which only the largest visible component, connected by voxels' faces, stays visible.

    Other visible voxels get the highest value below the visible ones; in a label map, and in colours (with their
    opacity, if they have one), they are 0.

    Parameters
    ----------
    samples : array (Z, H, W), or (Z, H, W, 3 or 4) of colours
    transfer, density
        What is visible, as in `supple.render.scene.Scene`.

    Raises
    ------
    SuppleError
        If the smallest value is visible, so that no value hides a voxel.
    """
    ready, seen = _hiding(samples, transfer, density)
    shown = np.stack([seen.visible(slab, slab) for slab in ready])
    parts, sizes = _parts(shown.astype(np.uint8))
    sizes[0] = 0
    hides = shown & (parts != sizes.argmax())
    if samples.ndim == 4 or seen.labels is not None:
        return np.where(hides.reshape(hides.shape + (1,) * (samples.ndim - 3)), np.zeros((), samples.dtype), samples)
    hidden = ready[ready < seen.threshold].max(initial=seen.range[0])
    return np.where(hides, np.asarray(hidden, ready.dtype), ready)


def cropped(samples: Array, crop: Clip, transfer: Transfer | str, density: tuple[float, float] | None = None) -> Array:
    """Return a volume of which only a box is visible, whose faces lie half a voxel beyond its outermost voxels.

    In a label map, and in colours (with their opacity, if they have one), all else is 0.

    Parameters
    ----------
    samples : array (Z, H, W), or (Z, H, W, 3 or 4) of colours
    crop : three of (float, float)
        For each axis, x first, the first and the last voxel, or None: see `supple.render.box.box_of`.
    transfer, density
        What is visible, as in `supple.render.scene.Scene`.

    Raises
    ------
    SuppleError
        If the box is not within the volume, or the smallest value is visible, so that no value hides a voxel.
    """
    ready, seen = _hiding(samples, transfer, density)
    box = box_of(crop, samples.shape[:3], "crop", single=True)
    kept = tuple(
        slice(math.ceil(low), min(math.floor(high) + 1, n))  # a single slice is a box of two
        for (low, high), n in zip(reversed(box), samples.shape, strict=False)
    )
    if any(part.start >= part.stop for part in kept):
        raise SuppleError("crop must hold a voxel along each axis: from a voxel to the same or a later one")
    if samples.ndim == 4 or seen.labels is not None:
        whole = np.zeros_like(samples)
        whole[kept] = samples[kept]
        return whole
    # Around the box, visible values are mirrored at the threshold, so that they cross it half a voxel outside.
    around = tuple(slice(max(p.start - 1, 0), min(p.stop + 1, n)) for p, n in zip(kept, ready.shape, strict=True))
    ends = [(p.start - a.start, a.stop - p.stop) for p, a in zip(kept, around, strict=True)]
    edge = np.pad(ready[kept], ends, mode="edge").astype(np.float64)
    low, threshold = seen.range[0], seen.threshold
    below = np.nextafter(np.float32(threshold), np.float32(-np.inf))
    mirrored = np.clip(np.minimum(edge, 2 * threshold - edge), low, max(low, below))
    made = np.full_like(ready, low)
    made[around] = np.floor(mirrored) if ready.dtype.kind in "iu" else mirrored
    made[kept] = ready[kept]
    return made


def _hiding(samples: Array, transfer: Transfer | str, density: tuple[float, float] | None) -> tuple[Array, Seen]:
    """Return prepared samples and their appearance; SuppleError if no value is below the visible ones."""
    ready, _, seen = sampled(np.asarray(samples), transfer_function(transfer), density, 1.0)
    if seen.threshold == -math.inf:
        told = "all is visible, down to the smallest value, and no value hides a voxel"
        raise SuppleError(f"{told}: choose a higher density")
    return ready[tuple(map(slice, samples.shape[:3]))], seen


def lamp(view: Projection) -> npt.NDArray[np.float32]:
    """Return the unit direction, along the volume's axes, to a lamp above and to the left of the camera."""
    right, down = (axis / np.linalg.norm(axis) for axis in view.packed[3:])
    towards = -view.ahead - 0.35 * right - 0.45 * down
    return np.asarray(towards / np.linalg.norm(towards), np.float32)


def triple(values: npt.NDArray[np.floating]) -> tuple[float, float, float]:
    """Return three floats of Python."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def prepared(given: Array) -> Array:
    """Return samples for the kernels: of a supported type, at least two along each axis, without NaN.

    SuppleError if the squares of their gradients overflow float32.
    """
    whole, low, high = True, 0.0, 0.0
    if given.dtype.itemsize > 2 or given.dtype.kind == "f":
        low, high = float(given.min()), float(given.max())
        if not (whole := math.isfinite(low) and math.isfinite(high)):
            finite = given[np.isfinite(given)]
            low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
        most = max(low, high, key=abs)
        if abs(most) > MOST:
            refuse("samples", f"values from {-MOST:g} to {MOST:g} to be seen (divide larger ones)", float(f"{most:g}"))
    if given.dtype.newbyteorder("=") not in _TYPES:
        with np.errstate(over="ignore"):
            given = given.astype(np.float32)
    ready = np.require(given, given.dtype.newbyteorder("="), ["C", "ALIGNED"])
    return widened(ready if whole else np.nan_to_num(ready, nan=low, neginf=low, posinf=high))


def thinned(samples: Array, coarse: int) -> Array:
    """Return every ``coarse``-th voxel of samples (Z, H, W[, C]) along each axis, and the last one."""
    if coarse == 1:
        return samples
    places = (np.minimum(np.arange(-(-(n - 1) // coarse) + 1) * coarse, n - 1) for n in samples.shape[:3])
    return samples[np.ix_(*places)]


def warped(samples: Array, deformation: Deformation, labelled: bool, tolerance: float, coarse: int = 1) -> Array:
    """Return prepared samples or colours, warped by a deformation: with linear interpolation, or the nearest label.

    ``samples`` are those of every voxel, or `thinned` by ``coarse``.
    """
    chosen = Sampling(filter="nearest" if labelled else "linear", tolerance=tolerance)
    if coarse == 1:
        return widened(deformation.warp(samples[tuple(map(slice, deformation.shape))], sampling=chosen))
    space = deformation.space
    axes = space.axes.copy()
    axes[:, 3] *= coarse  # from sample to sample; faces and strokes are in physical units
    part = replace(space, axes=axes, count=len(samples), shape=samples.shape[1:3])
    return np.asarray(warp_array(samples, part, chosen)[0])


def widened(samples: Array) -> Array:
    """Return samples (Z, H, W[, C]), repeated where there are fewer than two along an axis of space."""
    missing = [(0, 1 if n < 2 else 0) for n in samples.shape[:3]] + [(0, 0)] * (samples.ndim - 3)
    return np.pad(samples, missing, mode="edge") if min(samples.shape[:3]) < 2 else samples
