"""What engines make of arrays, as one table: media × strokes × types × filters × boundary modes × opacity and light.

A row is one of them; `Row.check` gives its arrays, of several numbers of channels, to an engine, and compares what it
makes with the slow reference: samples of the printed interpolants at the exact inverse. Numbers of all types and
channels go through the reference together, as its points and weights are the same for all: it is asked once for each
kind of strokes, filter and boundary mode.
"""

from __future__ import annotations

import functools
import itertools
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import Deformation, FoldWarning, Freeze, MissWarning, Stroke
from tests import reference
from tests.effort import pairs

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]
Engine = Callable[..., Array]

TYPES = ("bool", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")
BRIGHT = ("u1", "u2", "f2", "f4", "f8")  # which light may be asked of
CLEAR = (*BRIGHT, "i2", "u4")  # which have an opacity in tests
RULES = ("edge", "constant", "reflect")

# In a plane, between planes, and averaged over time or not.
FILTERS = tuple((name, None, False) for name in ("nearest", "linear", "cubic", "auto"))
TIMED = (
    ("nearest", "nearest", False),
    ("linear", "linear", False),
    ("linear", "cubic", False),
    ("linear", "nearest", False),
    ("cubic", "linear", False),
    ("cubic", "cubic", False),
    ("auto", "linear", False),
    ("linear", "linear", True),
    ("auto", "cubic", True),
)

# How many channels arrays have: 0 is none, not even one. Where opacity counts, it is the last.
CHANNELS = {"plain": (0, 1, 2, 3, 4, 5, 9), "opacity": (2, 4, 5), "light": (1, 3), "opacity and light": (4,)}


def _types(kind: str) -> tuple[str, ...]:
    return {"plain": TYPES, "opacity": CLEAR}.get(kind, BRIGHT)


@dataclass(frozen=True)
class Limits:
    """How far results may be from the reference's: the most and the mean, in parts of the range, and what may not be.

    Where the nearest sample is in doubt, results are not looked at; nearer than ``margin`` to that, they are.
    """

    most: float = 2e-4
    mean: float = 5e-5
    odd: float = 0.0
    margin: float = 1e-4


@dataclass(frozen=True)
class Row:
    """One way of many: see the module."""

    scene: str
    dtype: str
    filter: str
    between: str | None
    average: bool
    outside: str
    kind: str = "plain"

    def __str__(self) -> str:
        parts = (self.scene, self.dtype, self.filter, self.between, "averaged" if self.average else None, self.outside)
        return "-".join([x for x in parts if x] + ([] if self.kind == "plain" else [self.kind]))

    @property
    def options(self) -> dict[str, Any]:
        """Return what a warp is asked for, but for the fill."""
        made: dict[str, Any] = {"filter": self.filter, "outside": self.outside, "alpha": "opacity" in self.kind}
        if "light" in self.kind:
            made["linear_light"] = True
        return made | ({"between": self.between, "time_filter": self.average} if self.between else {})

    def check(
        self, engine: Engine, limits: Limits, channels: Iterable[int] | None = None, types: tuple[str, ...] = ()
    ) -> None:
        """Compare what an engine makes with what it should make, of some numbers of channels.

        The reference is asked for the numbers of some ``types`` together: those whose rows are tested as well.
        """
        d = scene(self.scene)
        numbers = tuple(c for c in CHANNELS[self.kind] if channels is None or c in channels)
        assert numbers
        known = _types(self.kind)
        sizes = tuple((t, max(c, 1)) for t in known if t in types or t == self.dtype for c in numbers)
        for count in numbers:
            source = samples(self.scene, self.dtype, max(count, 1), self.kind)
            fill = _fill(self.dtype, max(count, 1), self.kind)
            given = source if count else source[..., 0]
            found = engine(d, given, fill=fill if count else fill[0], **self.options)
            assert (found.dtype, found.shape) == (given.dtype, given.shape)
            self._compare(d, found.reshape(source.shape), source, limits, sizes)

    def _compare(
        self, d: Deformation, found: Array, source: Array, limits: Limits, sizes: tuple[tuple[str, int], ...]
    ) -> None:
        q = places(self.scene)
        np.testing.assert_array_equal(found[~q.touched], source[~q.touched])
        sure = q.touched & q.sure(self.filter, self.between, limits.margin)
        assert sure.sum() > 0.7 * q.touched.sum()
        if self.filter == "nearest":  # bit for bit, also of 64-bit integers
            fill = _fill(self.dtype, source.shape[-1], self.kind)
            if d.ndim == 2:
                exact = reference.sample(source, q.points, None, "nearest", self.outside, fill)
            else:
                exact = reference.sample_frames(source, q.points, "nearest", "nearest", self.outside, fill)
            assert found[sure].tobytes() == exact[sure].tobytes()
            assert np.isin(found, [*np.unique(source), *np.array(fill).astype(source.dtype)]).all()
            return
        wanted = _expected(self.scene, self.filter, self.between, self.average, self.outside, self.kind, sizes)
        made, values = found[sure], wanted[self.dtype, source.shape[-1]][sure]
        if self.kind == "plain":
            span = np.ptp(source.astype(np.float64))
            _near(made, values, np.full(values.shape, span), limits)
            return
        top = reference.opaque(self.dtype)
        colours, weight = values, np.ones((*values.shape[:-1], 1))
        if "opacity" in self.kind:
            opacity, colours = values[..., -1:], values[..., :-1]
            _near(made[..., -1:], top * np.clip(opacity, 0, 1), np.full(opacity.shape, top), limits)
            made = made[..., :-1]
            assert not made[opacity[..., 0] < -1e-3].any()  # what is not there has no colour
            # Of what is hardly there, the colour is hardly known.
            seen = (opacity[..., 0] > 0.1) & (opacity[..., 0] <= 1)
            assert seen.mean() > 0.2
            made, weight = made[seen], opacity[seen]
            colours = colours[seen] / weight
        if "light" in self.kind:
            # The curve is steep where it is dark.
            lit, colours = colours, reference.curve_of(colours)
            weight = weight / np.where(lit < 0.02, 13, 3)
        _near(made, top * colours, top / np.broadcast_to(weight, colours.shape), limits)


def _near(found: Array, wanted: Floats, spans: Floats, limits: Limits) -> None:
    """Whether results hold what is wanted, bounded and rounded as their type does."""
    kind = found.dtype
    if kind == np.bool_:
        clear = np.abs(wanted - 0.5) > limits.most
        wrong = (found != (wanted >= 0.5)) & clear
        assert wrong.mean() <= limits.odd
        return
    rounding = 0.0
    if kind.kind in "iu":
        ends = np.iinfo(kind)
        wanted, rounding = np.clip(wanted, float(ends.min), float(ends.max)), 0.5
    elif kind == np.float16:
        rounding = 2**-11 * float(np.abs(wanted).max())
    off = np.maximum(np.abs(found.astype(np.float64) - wanted) - rounding, 0) / spans
    assert (off > limits.most).mean() <= limits.odd, f"{(off > limits.most).sum()} of {off.size}, up to {off.max()}"
    assert np.minimum(off, limits.most).mean() <= limits.mean, f"{off.mean()} in the mean, up to {off.max()}"


# ---------------------------------------------------------------- strokes


def _squeezed(shape: tuple[int, ...], at: tuple[float, ...], radius: float, turns: int) -> Deformation:
    """Return strokes from all sides towards a place, which shrink what lies there along both axes."""
    d = Deformation(shape, border=None, on_fold="damp")
    for _ in range(turns):
        for way in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            d = d.grab(
                np.array(at) - 0.8 * radius * np.array(way), by=0.6 * radius * np.array(way), radius=radius, reach=None
            )
    return d


def _mask(shape: tuple[int, ...]) -> Freeze:
    """Return a mask: what is to the left of the middle is frozen, and a stripe in part, farther left."""
    held = np.zeros(shape)
    width = shape[-1]
    held[..., 2 * width // 5 : width // 2] = 1
    held[..., : shape[-2] // 3, : width // 4] = 0.6
    return Freeze.of(held, width=4.0)


PLANE, CLIP = (45, 70), (6, 24, 37)

SCENES: dict[str, Callable[[], Deformation]] = {
    # Shrinks and magnifies, and reaches beyond the image on two sides.
    "image": lambda: (
        Deformation(PLANE, border=None, on_fold="damp")
        .grab((30, 20), by=(14, -9), radius=16, reach=None)
        .grab((8, 30), by=(-6, 5), radius=9, scales=2, reach=None)
    ),
    # So strong that averages are of a pyramid.
    "image, squeezed": lambda: _squeezed(PLANE, (35, 22), 11, 3),
    # Part of it is left alone; the border holds.
    "image, local": lambda: Deformation(PLANE, border=10, on_fold="damp").grab(
        (34, 20), by=(4, 5), radius=7, reach=2.5
    ),
    # Parts of it are frozen, and held in part, within what moves.
    "image, frozen": lambda: (
        Deformation(PLANE, border=10, freeze=_mask(PLANE))
        .grab((40, 22), by=(-14, 4), radius=16, reach=None)
        .twist((20, 20), angle=40, radius=12, reach=None)
    ),
    # Turned, magnified and squeezed, one after the other.
    "image, turned": lambda: (
        Deformation(PLANE, border=None, on_fold="damp")
        .twist((26, 20), angle=60, radius=13, reach=None)
        .scale((50, 25), factor=1.5, radius=9, reach=None)
        .pinch((14, 33), factor=0.7, axis=(1, 1), radius=10, reach=None)
    ),
    # Beyond the clip along every axis, and at both of its ends.
    "clip": lambda: (
        Deformation(CLIP, border=None, on_fold="damp")
        .grab((15, 12, 2.5), by=(8, -6, 3.2), radius=10, reach=None)
        .grab((33, 20, 4.3), by=(-5, 6, -3.2), radius=8, reach=None)
    ),
    # Time runs several times as fast before it.
    "clip, hurried": lambda: Deformation(CLIP, border=None, on_fold="flow").add(
        Stroke.grab((17, 12, -5), by=(4, -2, 9), radius=5, reach=None), warn=False
    ),
    "clip, local": lambda: Deformation(CLIP, border=6.0, on_fold="damp").grab(
        (18, 12, 3), by=(2, -1, 0.6), radius=3, reach=2.0
    ),
    "clip, frozen": lambda: Deformation(CLIP, border=None, time=True, freeze=_mask(CLIP[1:])).grab(
        (22, 13, 2.5), by=(-5, 2, 0.8), radius=11, reach=None
    ),
    "volume, frozen": lambda: Deformation(CLIP, spacing=(2.0, 0.8, 1.0), border=3.0, freeze=_mask(CLIP)).grab(
        (22, 13, 2.7), by=(-4, 2, 1), radius=9, reach=None
    ),
    # Voxels that are no cubes, in a border.
    "volume": lambda: Deformation(CLIP, spacing=(2.0, 0.8, 1.0), border=3.0, on_fold="damp").grab(
        (18, 11, 2.7), by=(5, 4, 1), radius=9, reach=None
    ),
    "volume, turned": lambda: (
        Deformation(CLIP, spacing=(2.0, 0.8, 1.0), border=3.0, on_fold="damp")
        .twist((18, 11, 2.7), angle=50, axis=(1, 2, 4), radius=9, reach=None)
        .scale((25, 15, 2.0), factor=0.8, radius=8, reach=None)
        .pinch((12, 9, 3.0), factor=1.2, axis=(1, 1, 0), radius=8, reach=None)
    ),
    # For what is slow.
    "small image": lambda: Deformation((13, 16), border=None, on_fold="damp").grab(
        (9, 6), by=(2.3, 1.6), radius=11, reach=None
    ),
    "small image, turned": lambda: (
        Deformation((13, 16), border=None, on_fold="damp")
        .twist((9, 6), angle=50, radius=15, reach=None)
        .scale((6, 7), factor=1.2, radius=15, reach=None)
        .pinch((8, 5), factor=0.8, radius=15, reach=None)
    ),
    "small clip": lambda: Deformation((5, 9, 10), border=None, on_fold="damp").grab(
        (5, 4, 2), by=(3.1, 2.2, 2.5), radius=20, reach=None
    ),
    "small volume": lambda: Deformation((5, 9, 10), spacing=(1.7, 0.8, 1.0), border=3.0, on_fold="damp").grab(
        (5, 4, 2), by=(0.9, 0.7, 0.6), radius=7, reach=None
    ),
}


@functools.cache
def scene(name: str) -> Deformation:
    """Return a scene's strokes, of which some are damped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FoldWarning)
        warnings.simplefilter("ignore", MissWarning)
        return SCENES[name]()


@dataclass(frozen=True)
class Places:
    """Where the pixels of a scene come from."""

    points: Floats
    matrices: Floats
    touched: npt.NDArray[np.bool_]

    def sure(self, filter: str, between: str | None, margin: float) -> npt.NDArray[np.bool_]:
        """Return where it is clear which sample is the nearest, or which frame."""
        off = np.abs(self.points - np.floor(self.points) - 0.5) > margin
        if filter == "nearest":
            return np.asarray(off.all(axis=-1))
        return np.asarray(off[..., 2]) if between == "nearest" else np.ones(off.shape[:-1], np.bool_)


@functools.cache
def places(name: str) -> Places:
    """Return where pixels come from, by the reference."""
    d = scene(name)
    strokes, q = reference.carried_out(d), reference.grid(d.shape)
    points = reference.inverse(strokes, d.domain, q)
    touched = reference.reached(strokes, d.domain, q) & ~reference.frozen(d.domain, q)
    return Places(points, reference.matrices(strokes, d.domain, points), touched)


# ---------------------------------------------------------------- numbers


@functools.cache
def samples(name: str, dtype: str, channels: int, kind: str = "plain") -> Array:
    """Return noise: all of a type's range, and its very ends side by side; from 0 to white where that is known."""
    rng, form = np.random.default_rng(channels), np.dtype(dtype)
    size = (*scene(name).shape, channels)
    if kind != "plain":
        top = reference.opaque(dtype)
        parts = rng.uniform(size=size)
        if kind == "opacity":  # clear, opaque, and between
            parts[..., ::4, :, -1], parts[..., 1::4, :, -1] = 0, 1
        elif "opacity" in kind:  # nowhere so clear that what it is divided by is lost in rounding
            parts[..., -1] = 0.5 + 0.5 * parts[..., -1]
        return (parts * top).astype(form)
    if form == np.bool_:
        return rng.uniform(size=size) < 0.5
    if form.kind == "f":
        return (100 * rng.normal(size=size)).astype(form)
    ends = np.iinfo(form)
    made = rng.integers(ends.min, ends.max, size, form, endpoint=True)
    made[..., ::7, :, :], made[..., 3::7, :, :] = ends.max, ends.min
    return made


def _fill(dtype: str, channels: int, kind: str) -> list[float]:
    if kind != "plain":
        return [x * reference.opaque(dtype) for x in (0.3, 0.9, 0.1, 0.6)[: channels - 1]] + [
            0.5 * reference.opaque(dtype)
        ]
    return [1.0] * channels if dtype == "bool" else [3.0 + 9 * c for c in range(channels)]


@functools.cache
def _expected(
    name: str,
    filter: str,
    between: str | None,
    average: bool,
    outside: str,
    kind: str,
    sizes: tuple[tuple[str, int], ...],
) -> dict[tuple[str, int], Floats]:
    """Return the samples of some types and numbers of channels: not yet bounded and rounded; in parts of white as
    filters take them, multiplied by opacity and in linear light, where white is known."""
    d, at = scene(name), places(name)
    sizes = tuple(dict.fromkeys(sizes))
    parts: list[Floats] = []
    fills: list[Floats] = []
    for dtype, channels in sizes:
        values = samples(name, dtype, channels, kind).astype(np.float64)
        fill = np.array(_fill(dtype, channels, kind))
        if kind != "plain":
            top, ways = reference.opaque(dtype), ("opacity" in kind, "light" in kind)
            values, fill = (reference.loaded(x / top, 1.0, *ways) for x in (values, fill))
        parts.append(values)
        fills.append(fill)
    source, fill = np.concatenate(parts, axis=-1), np.concatenate(fills)
    if d.ndim == 2:
        found = reference.sample(source, at.points, at.matrices, filter, outside, fill)
    else:
        widths = reference.faded(np.linalg.norm(at.matrices[..., 2, :], axis=-1)) if average else np.array(0.0)
        plane = at.matrices[..., :2, :2]
        assert between is not None
        found = reference.sample_frames(source, at.points, filter, between, outside, fill, widths, plane)
    ends = np.cumsum([c for _, c in sizes])[:-1]
    return dict(zip(sizes, np.split(found, ends, axis=-1), strict=True))


# ---------------------------------------------------------------- rows


def rows(
    scenes: Iterable[str], types: Iterable[str] = TYPES, kinds: Iterable[str] = ("plain",), *, few: bool = False
) -> list[Row]:
    """Return all rows of some scenes; or ``few``, in which every two of scene, type, filter, rule and kind meet."""

    def known(name: str, dtype: str, way: tuple[str, str | None, bool], outside: str, kind: str) -> bool:
        ways = FILTERS if len(scene(name).shape) == 2 else TIMED
        return way in ways and (kind == "plain" or (way[0] != "nearest" and dtype in _types(kind)))

    axes = (list(scenes), list(types), FILTERS + TIMED, RULES, list(kinds))
    chosen = pairs(*axes, where=known) if few else [row for row in itertools.product(*axes) if known(*row)]
    return [Row(name, dtype, *way, outside, kind) for name, dtype, way, outside, kind in chosen]
