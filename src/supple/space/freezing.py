"""Freeze masks: the part of a picture or a volume in which strokes move nothing."""

from __future__ import annotations

import base64
import binascii
import math
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, shown
from supple.space.checks import (
    Shape,
    Vector,
    assign,
    checked_shape,
    checked_sizes,
    integer,
    items,
    length,
    point,
    refuse,
)
from supple.space.geometry import Floats

Rows = npt.NDArray[np.float32]
Lattice = tuple[int, float, float]  # coefficients along an axis, the position of the first, and the step

_FREE = 255  # a coefficient of 1
_EDGE = 3  # extra coefficients at each end that repeat the outermost: the spline is constant there
_LEAST = 8  # coefficients along an axis
_MOST = 2**28
_MOST_ACROSS = 2  # the largest number of coefficients, over the number that is needed
_MOST_IN_TIME = 2**22  # coefficients of a moving matte: 210 MB in the core
_PART = 1 / 32  # of the shorter side: the default width of the fade
_SHORTEST = 4.0  # samples: the least width of the fade


@dataclass(frozen=True, slots=True)
class Freeze:
    """A freeze mask: the factor m(p) of the displacement, from 0 where it is frozen to 1 where it is free.

    m is a cubic B-spline. Each coefficient is the least freedom of the samples that its basis function covers, so that
    m and its derivatives are exactly 0 at every frozen sample, and m rises to 1 over the width of the fade. `of`
    returns the mask of an image or a label.

    Parameters
    ----------
    samples : tuple of int
        The samples along each axis, x first, of the medium that it is for.
    size : tuple of int
        Coefficients along each axis, x first: 1 along an axis on which m does not depend.
    first : tuple of float
        The position of the first coefficient, in samples, x first.
    step : tuple of float
        Samples from one coefficient to the next, along each axis.
    values : bytes
        The coefficients, from 0 to 255 for 1, in C order: x varies fastest. The outermost four along an axis are equal.
    place : tuple of float
        The first three rows of the matrix from indices of samples to positions in LPS, if the mask was a volume in
        space; otherwise empty.
    name : str
        The name of the file that it was read from, for messages.

    Raises
    ------
    SuppleError
        If the arguments do not fit together.
    """

    samples: Shape
    size: Shape
    first: Vector
    step: Vector
    values: bytes = field(repr=False)
    place: Vector = ()
    name: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        wanted = f"1 or an integer from {_LEAST} on"
        given = items("freeze size", self.size, "two or three numbers, x first", (2, 3))
        sizes = tuple(integer("freeze size", n, wanted, 1, 2**20) for n in given)
        if any(1 < n < _LEAST for n in sizes):
            refuse("freeze size", wanted, self.size)
        one, each = (len(sizes),), f"{len(sizes)} numbers, x first"
        assign(
            self,
            size=sizes,
            samples=checked_sizes("freeze samples", self.samples, each, one),
            first=point("freeze first", self.first, one),
            step=tuple(length("freeze step", x) for x in items("freeze step", self.step, each, one)),
            place=point("freeze place", self.place, (0, 12)),
        )
        for size, count, apart in zip(self.size, self.samples, self.step, strict=True):
            if size > _MOST_ACROSS * (count / apart + _LEAST + 2 * _EDGE):
                raise SuppleError(f"freeze size must fit {count} samples that are {apart:g} apart, found {size}")
        if len(self.values) != math.prod(sizes):
            raise SuppleError(f"freeze values must be {math.prod(sizes)} bytes, found {len(self.values)}")
        level = self.coefficients.copy()
        _level(level)
        if level.tobytes() != self.values:
            raise SuppleError("freeze values must have four equal ones at each end of an axis")

    @classmethod
    def of(
        cls,
        mask: npt.ArrayLike,
        *,
        width: float | None = None,
        spacing: float | Sequence[float] = 1.0,
        place: Sequence[float] = (),
        name: str = "",
        matte: bool = False,
    ) -> Self:
        """Return the freeze mask of an image or a volume; or the matte of a stroke, which applies where it is white.

        Parameters
        ----------
        mask : array, shape (H, W) or (Z, H, W)
            bool: True is frozen. Floats from 0 to 1: 1 is frozen. Whole numbers from 0: the largest value of the
            type is frozen (255 of uint8), or the larger of two values if there are only two. Values in between let
            a part of the displacement through.
        width : float, optional
            The width of the fade beside what is frozen, in physical units: at least 4 samples. By default a 32nd of
            the shortest side.
        spacing : float or sequence of float
            Physical units per sample, x first.
        place, name
            As in `Freeze`.
        matte : bool
            Whether it is a matte (`Stroke.matte`), where white is free and black is frozen. Black samples do not
            move at all; the fade is inside the white.

        Raises
        ------
        SuppleError
            If the mask is not of such a shape, type or range, or the width is less than 4 samples.
        """
        array, what = np.asarray(mask), "matte" if matte else "freeze"
        if array.ndim not in (2, 3) or 0 in array.shape:
            refuse(what, "an array of shape (H, W) or (Z, H, W)", told=f"shape {array.shape}")
        if array.dtype.kind not in "buif":
            refuse(what, "an array of bool, integers or floats", told=f"dtype {array.dtype}")
        checked_shape(array.shape)
        steps = (spacing,) * array.ndim if isinstance(spacing, float | int) else tuple(spacing)
        apart = _apart(array.shape, steps, width, "matte" if matte else "freeze mask")
        least = _FREE - _freedom_of(array) if matte else _freedom_of(array)
        lattices = [_lattice(n, step) for n, step in zip(reversed(array.shape), apart, strict=True)]
        for axis, lattice in enumerate(reversed(lattices)):
            least = _covered(least, axis, lattice)
        _level(least)
        sizes, first, _ = zip(*lattices, strict=True)
        return cls(array.shape[::-1], sizes, first, apart, least.tobytes(), tuple(place), name)

    @classmethod
    def matte_of(
        cls, frames: Iterable[npt.NDArray[Any]], count: int, *, width: float | None = None, name: str = ""
    ) -> Self:
        """Return the matte of a stroke that moves with the ``count`` frames of a clip, each an array (H, W).

        Each frame becomes a row of coefficients, as by `of`; in between, m is a cubic spline in time, too, which
        averages three frames. The default fade is as wide as that of `of`, or wider, so that there are at most four
        million coefficients: SuppleError if a given ``width`` needs more.
        """
        rows: list[npt.NDArray[np.uint8]] = []
        for frame in frames:
            if not rows:
                apart = _apart(frame.shape, (1.0, 1.0), width, "matte")[0]
                while math.prod(n / apart + 9 for n in frame.shape) > _MOST_IN_TIME / (count + 2 * _EDGE + 2):
                    if width is not None:
                        refuse("the matte's width", f"wider for {count} frames, or left out", told=f"{width:g}")
                    apart *= 1.05
            made = cls.of(frame, width=4 * apart, matte=True, name=name)
            rows.append(made.coefficients)
        values = np.stack([*rows[:1] * (_EDGE + 1), *rows, *rows[-1:] * (_EDGE + 1)])
        return made._in_time(len(rows), len(values), -1.0 - _EDGE, values.tobytes())

    @classmethod
    def free(cls, shape: Sequence[int], spacing: Sequence[float]) -> Self:
        """Return a freeze mask of an image or a volume that freezes nothing, on the lattice that `of` would use."""
        samples, apart = tuple(reversed(shape)), _apart(shape, spacing, None)
        size, first, _ = zip(*map(_lattice, samples, apart), strict=True)
        return cls(samples, size, first, apart, bytes([_FREE]) * math.prod(size))

    @property
    def ndim(self) -> int:
        """The number of axes."""
        return len(self.size)

    @property
    def told(self) -> str:
        """The name in messages."""
        return f"the freeze mask {shown(self.name)}" if self.name else "the freeze mask"

    @property
    def is_free(self) -> bool:
        """True if nothing is frozen."""
        return bool(self.coefficients.min() == _FREE)

    @property
    def inverted(self) -> Self:
        """The mask 1 - m, with frozen and free exchanged."""
        return replace(self, values=(_FREE - self.coefficients).tobytes())

    @property
    def freed(self) -> Self:
        """The mask of the same medium in which nothing is frozen."""
        return replace(self, values=bytes([_FREE]) * len(self.values))

    @property
    def middle(self) -> Vector:
        """The middle of the frozen part, in samples, x first; that of the medium if nothing is frozen."""
        held = 1.0 - self.coefficients / _FREE if not self.is_free else np.ones(self.coefficients.shape)
        found = []
        for axis, n in enumerate(self.samples[: self.ndim]):
            sums = held.sum(axis=tuple(k for k in range(self.ndim) if k != self.ndim - 1 - axis))
            places = np.clip(self.first[axis] + self.step[axis] * np.arange(self.size[axis]), 0, n - 1)
            found.append(float(round(places @ sums / sums.sum())))
        return tuple(found)

    @property
    def share(self) -> float:
        """The fraction of the medium that is frozen, from samples at up to 256 places along each axis."""
        return float((self.at([np.linspace(0, n - 1, min(n, 256)).round() for n in self.samples]) == 0).mean())

    @property
    def coefficients(self) -> npt.NDArray[np.uint8]:
        """The coefficients, in C order, read-only: (..., y, x)."""
        return np.frombuffer(self.values, np.uint8).reshape(self.size[::-1])

    def packed(self, spacing: Sequence[float]) -> tuple[Floats, Floats, Floats]:
        """Return the mask in the layout of the core.

        Parameters
        ----------
        spacing : sequence of float
            Physical units per sample, x first; three for a clip, in whose frames a mask of two axes is the same.

        Returns
        -------
        values : float64 array, shape (nz, ny, nx)
            The coefficients, from 0 to 1.
        first, step : float64 array, shape (3,)
            The position of the first coefficient, and the distance between coefficients, in physical units.
        """
        n = self.ndim
        values = self.coefficients.reshape((1,) * (3 - n) + self.size[::-1]) / _FREE
        first, step = np.zeros(3), np.ones(3)
        first[:n] = np.multiply(self.first, spacing[:n])
        step[:n] = np.multiply(self.step, spacing[:n])
        return values, first, step

    def shown(self, shape: Sequence[int]) -> npt.NDArray[np.float32]:
        """Return m at the samples of an array of a shape (H, W) or (Z, H, W)."""
        return self.at([np.arange(n) for n in reversed(shape)])

    def at(self, places: Sequence[npt.ArrayLike]) -> npt.NDArray[np.float32]:
        """Return m on a grid of positions along each axis, in samples, x first: an array (..., y, x)."""
        lattice = zip(places, self.size, self.first, self.step, strict=True)
        each = [_weights(np.asarray(p, np.float64), size, first, step) for p, size, first, step in lattice]
        # Only the coefficients with a weight are used: for a plane, those beside it.
        used = [np.flatnonzero(weights.any(axis=0)) for weights in each]
        parts = [slice(rows[0], rows[-1] + 1) for rows in used]
        made = self.coefficients[tuple(reversed(parts))] / np.float32(_FREE)
        for axis, (weights, part) in enumerate(zip(reversed(each), reversed(parts), strict=True)):
            made = np.moveaxis(np.tensordot(weights[:, part], made, (1, axis)), 0, axis)
        return np.asarray(made, np.float32)

    def painted(
        self,
        at: Sequence[float],
        radius: float,
        spacing: Sequence[float],
        *,
        frozen: bool = True,
        plane: int | None = None,
    ) -> Self:
        """Return the mask with a ball more of it frozen, or free.

        Parameters
        ----------
        at : sequence of float
            The centre, in samples, x first.
        radius : float
            In physical units. All samples within it become frozen, or, without ``frozen``, all coefficients free.
        spacing : sequence of float
            Physical units per sample, x first.
        frozen : bool
        plane : int, optional
            An axis, x first, along which only the coefficients next to the centre are painted.
        """
        made = self.coefficients.copy()
        near: list[slice] = []  # of the coefficients along each axis, x first
        away, beyond = np.zeros(()), np.zeros((), bool)
        for k in range(self.ndim):
            off = np.abs(self.first[k] + self.step[k] * np.arange(self.size[k]) - at[k]) * spacing[k]
            covered = 2 * self.step[k] * spacing[k]
            reached = np.maximum(off - covered, 0.0) if frozen else off
            found = np.flatnonzero(reached <= radius)
            if not found.size:
                return self
            near.append(slice(found[0], found[-1] + 1))
            shape = (-1,) + (1,) * k
            away = away + (reached[near[-1]] ** 2).reshape(shape)
            if plane == k:
                beyond = beyond | (off[near[-1]] > covered).reshape(shape)
        made[tuple(reversed(near))][(away <= radius**2) & ~beyond] = 0 if frozen else _FREE
        _level(made)
        return replace(self, values=made.tobytes())

    def fitted(self, samples: Sequence[int], moved: Callable[[Sequence[float]], Sequence[float]] | None) -> Self:
        """Return the mask for a medium of another size.

        Parameters
        ----------
        samples : sequence of int
            The samples of that medium along each axis, x first.
        moved : function or None
            Maps a point of this medium to that one, each axis by itself; None if points stay the same.
        """
        n, m = self.ndim, len(samples)
        some = (*tuple(samples)[:n], *self.samples[m:])
        if moved is None:
            return replace(self, samples=some)
        ends = self.first, tuple(np.add(self.first, self.step).tolist())
        first, next_ = ((*moved((*p, *(0.0,) * (m - n))[:m])[:n], *p[m:]) for p in ends)
        step = tuple(b - a for a, b in zip(first, next_, strict=True))
        return replace(self, samples=some, first=first, step=step)

    def at_frame(self, k: int) -> Self:
        """Return the mask at a frame if it moves with a clip; otherwise the mask itself."""
        if self.ndim == 2:
            return self
        row = min(max(round((k - self.first[2]) / self.step[2]), 0), self.size[2] - 1)
        parts: dict[str, Any] = {name: getattr(self, name)[:2] for name in ("samples", "size", "first", "step")}
        return replace(self, values=self.coefficients[row].tobytes(), **parts)

    def mirrored(self, axis: int, at: float) -> Self:
        """Return the mirror image of the mask along an axis, x first, about a position on it, in samples."""
        if axis >= self.ndim:
            return self
        first = list(self.first)
        first[axis] = 2 * at - first[axis] - self.step[axis] * (self.size[axis] - 1)
        return replace(self, first=tuple(first), values=np.flip(self.coefficients, self.ndim - 1 - axis).tobytes())

    def times(self, other: Self) -> Self:
        """Return the product with another mask of the same medium: at most the other one, and 0 where either is.

        It has the lattice of this mask, and the other's along axes on which this one is constant. Along axes with the
        same lattice, coefficients are multiplied; along others, the other mask fades a little later.
        """
        if self.ndim < other.ndim:
            return self._in_time(other.samples[2]).times(other)
        if self.ndim > other.ndim:
            other = other._in_time(self.samples[2])
        mine, its = (list(zip(each.size, each.first, each.step, strict=True)) for each in (self, other))
        made = [own if own[0] > 1 else other for own, other in zip(mine, its, strict=True)]
        least, apart = np.divide(other.coefficients, _FREE, dtype=np.float32), False
        for axis, old, new, n in zip(range(self.ndim), its[::-1], made[::-1], other.samples[::-1], strict=True):
            if old[0] != 1 and old != new:
                least, apart = _moved(least, axis, n, old, new), True
        product = self.coefficients * least
        values = np.asarray(np.floor(product + 1e-3) if apart else np.rint(product), np.uint8)
        _level(values)
        size, first, step = zip(*made, strict=True)
        return replace(self, size=size, first=first, step=step, values=values.tobytes())

    def _in_time(self, samples: int, size: int = 1, first: float = 0.0, values: bytes | None = None) -> Self:
        """Return the mask of a frame as one of a clip: the same in all frames, or with a row of values for each."""
        more = {"samples": samples, "size": size, "first": first, "step": 1.0}
        parts: dict[str, Any] = {name: (*getattr(self, name), end) for name, end in more.items()}
        return replace(self, values=self.values if values is None else values, **parts)

    def entry(self) -> dict[str, Any]:
        """Return the mask as a JSON object; its coefficients are compressed (zlib), in base 64."""
        packed = base64.b64encode(zlib.compress(self.values, 9)).decode()
        made: dict[str, Any] = {name: list(getattr(self, name)) for name in ("samples", "size", "first", "step")}
        return {**made, "values": packed, **({"place": list(self.place)} if self.place else {})}

    @classmethod
    def from_entry(cls, entry: object, what: str = "freeze") -> Self:
        """Return the mask of an `entry`; SuppleError for anything else."""
        keys = {"samples", "size", "first", "step", "values"}
        if not isinstance(entry, dict) or set(entry) - {"place"} != keys or not isinstance(entry["values"], str):
            refuse(what, f"an object with {', '.join(sorted(keys))}", entry)
        count = math.prod(n for n in entry["size"] if isinstance(n, int)) if isinstance(entry["size"], list) else 0
        try:
            values = zlib.decompressobj().decompress(
                base64.b64decode(entry["values"], validate=True), min(count, _MOST) + 1
            )
        except (binascii.Error, ValueError, zlib.error):
            raise SuppleError(f"{what}: the values are damaged: they must be zlib's, in base 64") from None
        return cls(**{**entry, "values": values})


def _apart(shape: Sequence[int], spacing: Sequence[float], width: float | None, of: str = "") -> Vector:
    """Return the samples between coefficients along each axis for a width of the fade, or for the default width."""
    least = _SHORTEST * min(spacing)
    if width is None:
        sides = [n * step for n, step in zip(reversed(shape), spacing, strict=True) if n > 1]
        width = max(_PART * min(sides, default=1.0), least)
    elif length(f"the {of}'s width", width) < least:
        here = "" if least == _SHORTEST else f", which is {least:g} here"
        refuse(f"the {of}'s width", f"at least 4 samples{here}", told=f"{width:g}")
    return tuple(max(width / 4 / step, 1.0) for step in spacing)


def _lattice(n: int, step: float) -> Lattice:
    """Return the lattice of coefficients for n samples along an axis, with _EDGE repeated ones at each end."""
    return (1, 0.0, step) if n == 1 else (math.ceil((n - 1) / step) + 3 + 2 * _EDGE, (-1 - _EDGE) * step, step)


def _freedom_of(mask: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return the freedom of the samples of a mask, from 0 (frozen) to 255."""
    low, high, white = mask.min(), mask.max(), 1 if mask.dtype.kind in "bf" else np.iinfo(mask.dtype).max
    if not (low >= 0 and high <= white):  # also for NaN
        refuse("freeze", f"an array of values from 0 to {white} (frozen)", told=f"from {low:g} to {high:g}")
    if mask.dtype.kind in "iu" and low < high and np.all((mask == low) | (mask == high)):
        mask, white = mask == high, 1
    return np.floor((white - mask.astype(np.float64)) * _FREE / white).astype(np.uint8)


def _covered(values: npt.NDArray[Any], axis: int, lattice: Lattice) -> npt.NDArray[Any]:
    """Return, for each coefficient along an axis, the least of the samples that its basis function covers."""
    (size, first, step), n = lattice, values.shape[axis]
    places = first + step * np.arange(size)
    # And half a sample more, where the chroma of frozen pixels may lie.
    low = np.clip(np.ceil(places - 2 * step - 0.5), 0, n - 1).astype(int)
    high = np.clip(np.floor(places + 2 * step + 0.5), 0, n - 1).astype(int)
    rows = [np.take(values, range(a, max(a, b) + 1), axis) for a, b in zip(low, high, strict=True)]
    return np.concatenate([row.min(axis, keepdims=True) for row in rows], axis)


def _moved(values: Rows, axis: int, n: int, old: Lattice, new: Lattice) -> Rows:
    """Return coefficients on another lattice along an axis of n samples: the least m under each basis function."""
    if axis and values.ndim == 3:  # plane by plane, as all of a clip may not fit
        return np.stack([_moved(plane, axis - 1, n, old, new) for plane in values])
    return _covered(np.moveaxis(np.tensordot(_weights(np.arange(n), *old), values, (1, axis)), 0, axis), axis, new)


def _level(made: npt.NDArray[np.uint8]) -> None:
    """Set the outermost coefficients along each axis to the innermost of the four."""
    for axis, n in enumerate(made.shape):
        if n > 1:
            rows = np.moveaxis(made, axis, 0)
            rows[:_EDGE], rows[-_EDGE:] = rows[_EDGE], rows[-1 - _EDGE]


def _weights(places: npt.NDArray[Any], size: int, first: float, step: float) -> npt.NDArray[np.float32]:
    """Return the weights of ``size`` coefficients at positions."""
    if size == 1:
        return np.ones((len(places), 1), np.float32)
    u = np.clip((places[:, None] - first) / step, 1.0, size - 2.0)
    t = np.abs(u - np.arange(size))
    inner, outer = 2 / 3 - t * t * (1 - t / 2), np.maximum(2 - t, 0) ** 3 / 6
    return np.asarray(np.where(t < 1, inner, outer), np.float32)
