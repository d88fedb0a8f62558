"""Strokes and recipes: immutable values, their JSON, their scaling to other sizes, and the packed table of engines."""

from __future__ import annotations

import json
import math
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal, NoReturn, Self, get_args

import numpy as np
import numpy.typing as npt

from supple.domain import (
    LARGEST,
    LONGEST_AXIS,
    Border,
    BorderProfile,
    check_border_profile,
    checked_border,
    choice,
    integer,
    items,
    length,
    number,
    point,
    refuse,
    value_shown,
)
from supple.errors import ScaleWarning, SuppleError
from supple.keys import Key, checked_keys, position
from supple.keys import strength as strength_of

Brush = Literal["grab", "twist", "scale", "pinch"]
FoldPolicy = Literal["damp", "flow", "error"]
CoordinateSpace = Literal["pixels", "LPS", "RAS"]
Fit = Literal["pixels", "stretch", "inside"]
FITS: tuple[str, ...] = get_args(Fit)
Point = Sequence[float] | npt.NDArray[Any]

VERSION = 2
REACH = 4.0  # as natural as an unlimited reach, and local
POISSON = 0.4

STROKE_DTYPE = np.dtype(
    [
        ("pivot", np.float64, (3,)),
        ("force", np.float64, (3,)),
        ("matrix", np.float64, (3, 3)),
        ("radius2", np.float64, (3,)),
        ("p", np.float64, (3,)),
        ("q", np.float64, (3,)),
        ("r", np.float64, (3,)),
        ("terms", np.int64),
        ("power", np.int64),
        ("joined", np.int64),
        ("reach", np.float64),
        ("most", np.float64),
    ],
    align=True,
)

# Keys added after version 1.
_NEW = (
    "border_profile", "reach", "size", "space", "amount", "time_scale", "name", "strength", "to", "angle", "factor",
    "axis", "also", "path", "keys",
)  # fmt: skip
_PART = "a number from 0 to 1"
LARGEST_ANGLE = 3600.0  # degrees
MOST_HANDLES = 1000
LARGEST_FACTOR = 100.0

# The radii are ε, 1.1ε and 1.21ε. The weights that cancel the far field, divided by their sum at the pivot, are
# exactly these fractions; computed in floats they would lose digits.
_WEIGHTS = {1: np.array([1.0]), 2: np.array([11.0, -11.0]), 3: np.array([14641.0, -26741.0, 12100.0]) / 331}
_RADIUS2 = (1.0, 1.21, 1.4641)


@dataclass(frozen=True, slots=True)
class Scaling:
    """A map of coordinates: ``p`` to ``(p + 0.5) * factor - 0.5 + offset`` along each axis, x first.

    Parameters
    ----------
    factors, offsets : tuple of float
    length : float
        The factor of lengths, such as a brush's radius.
    """

    factors: tuple[float, ...]
    offsets: tuple[float, ...]
    length: float

    @property
    def widths(self) -> tuple[float, ...]:
        """The factor of a border's width along each axis, in physical units."""
        return (*self.factors[:2], self.length)[: len(self.factors)]

    @property
    def frame(self) -> float:
        """The factor of the time scale, in physical units; 1 without time."""
        return self.length / self.factors[2] if len(self.factors) == 3 else 1.0

    def point(self, p: Sequence[float]) -> tuple[float, ...]:
        """Return the image of a point."""
        moved = zip(p, self.factors, self.offsets, strict=True)
        return tuple(x if (s, o) == (1.0, 0.0) else (x + 0.5) * s - 0.5 + o for x, s, o in moved)

    def drag(self, v: Sequence[float]) -> tuple[float, ...]:
        """Return the image of a difference of two points."""
        return tuple(x * s for x, s in zip(v, self.factors, strict=True))


def scaling_of(
    made: Sequence[int], size: Sequence[int], how: Fit | None = None, *, time: bool = False, name: str = "this"
) -> Scaling | None:
    """Return the map of coordinates from one size to another; None for the identity.

    Parameters
    ----------
    made, size : sequence of int
        Samples along each axis, x first, in equal numbers: width and height; and frames, or slices.
    how : str, optional
        Without it, only images of the same proportions fit, within half a pixel, and clips with as many frames.
        ``"pixels"``: unchanged coordinates; ``"stretch"``: each axis by a factor of its own, and lengths by the
        geometric mean of those of x and y; ``"inside"``: x and y at the same scale, the largest that fits, centred.
    time : bool
        Whether the third axis is time.
    name : str
        The owner of the size, for the message.

    Raises
    ------
    SuppleError
        If the sizes do not fit.
    """
    if how is not None:
        choice("fit", how, FITS)
    made, size = tuple(made), tuple(size)
    if made == size or how == "pixels":
        return None
    found = f"the recipe was made for {spoken(made)}, and {name} is {spoken(size)}"
    if len(size) == 3 and not time:
        raise SuppleError(
            f"{found}: voxels are not scaled, as lengths are millimetres: fit='pixels' takes the indices as they are"
        )
    if len(size) == 3 and made[2] != size[2] and how != "stretch":
        raise SuppleError(
            f"{found}: fit='stretch' scales time too, and fit='pixels' takes frames and pixels as they are"
        )
    factors = tuple(b / a for a, b in zip(made, size, strict=True))
    x, y = factors[:2]
    if how == "inside":
        scale = min(x, y)
        offsets = tuple((b - a * scale) / 2 for a, b in zip(made[:2], size[:2], strict=True))
        return Scaling((scale, scale, *factors[2:]), (*offsets, 0.0)[: len(size)], scale)
    if how is None:
        low = max((b - 0.5) / a for a, b in zip(made[:2], size[:2], strict=True))
        high = min((b + 0.5) / a for a, b in zip(made[:2], size[:2], strict=True))
        if low > high:
            raise SuppleError(
                f"{found}, of other proportions: say how it fits, with fit='stretch' (each axis by a factor of its "
                "own), fit='inside' (at one scale, centred) or fit='pixels' (coordinates as they are)"
            )
    return Scaling(factors, (0.0,) * len(size), x if x == y else math.sqrt(x * y))


def spoken(size: Sequence[int]) -> str:
    """Return a size in words."""
    return " x ".join(map(str, size))


@dataclass(frozen=True, slots=True, kw_only=True)
class Stroke:
    """One movement of a brush.

    Parameters
    ----------
    at : sequence of float
        The position of the brush, in samples, x first: ``(x, y)``, ``(x, y, t)`` or ``(x, y, z)``.
    by : sequence of float, optional
        The drag of a grab, in samples; as many numbers. The pivot of the other brushes stays where it is.
    radius : float
        The brush's radius, in physical units.
    poisson : float or None
        The material's Poisson ratio, at most 0.5 (incompressible); ``-inf`` is allowed. None: 0.4; but ``-inf``, which
        has no displacement across the drag, for a drag along time alone.
    scales : int
        1 reaches farthest (fading as 1/r), 2 fades as 1/r³, 3 as 1/r⁵.
    reach : float or None
        The reach in radii, from 1: beyond, the displacement is exactly 0. None: unlimited, as in the paper.
    brush : str
        ``"grab"`` moves the pivot by the drag. The others are affine at the pivot, and fade with the distance:
        ``"twist"`` turns it by the angle; ``"scale"`` magnifies it by the factor (in a clip, in x and y alone);
        ``"pinch"`` stretches it by the factor along the axis, and by the inverse across it (in a volume, by the
        inverse's root along both axes across).
    angle : float or None
        Of a twist: degrees, from x towards y; in a volume, right-handed about the axis.
    factor : float or None
        Of a scale or a pinch: above 1, it bloats or stretches; below 1, it puckers or squeezes.
    axis : sequence of float or None
        Of a twist of three coordinates, and of a pinch: a direction, in samples. None: z or time; and x.
    also : sequence of (sequence of float, sequence of float)
        Of a grab: further points and their drags, in samples. All are carried out at once, so that each point arrives;
        a point with a drag of 0 is a pin.
    path : sequence of sequences of float
        Of a grab: the points through which it is dragged on its way, in samples. None: a straight line.
    hidden : bool
        Whether it is kept in the recipe, but not applied.
    name : str or None
        A name for users.
    strength : float
        The applied fraction of the drag, from 0 to 1; see `Deformation.from_recipe`.
    keys : sequence of Key
        In a clip, of a stroke of two coordinates: where its point ``at`` is, and how strong it is, in some frames, in
        ascending order. The whole stroke moves along with ``at``; see `Recipe.at_frame`.
    """

    at: tuple[float, ...]
    by: tuple[float, ...] = ()
    radius: float
    poisson: float | None = None
    scales: int = 1
    reach: float | None = REACH
    brush: Brush = "grab"
    angle: float | None = None
    factor: float | None = None
    axis: tuple[float, ...] | None = None
    also: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = ()
    path: tuple[tuple[float, ...], ...] = ()
    hidden: bool = False
    name: str | None = None
    strength: float = 1.0
    keys: tuple[Key, ...] = ()

    def __post_init__(self) -> None:
        choice("brush", self.brush, get_args(Brush))
        if not isinstance(self.hidden, bool):
            refuse("hidden", "true or false", self.hidden)
        if not isinstance(self.name, str | None):
            refuse("name", "text", self.name)
        at = point("at", self.at)
        checked = {
            "at": at,
            "by": self._checked_by(at),
            "radius": length("radius", self.radius),
            "poisson": None
            if self.poisson is None
            else number("poisson", self.poisson, "a number up to 0.5, or -inf", -math.inf, 0.5),
            "scales": integer("scales", self.scales, "1, 2 or 3", 1, 3),
            "reach": _checked_reach(self.reach),
            "strength": number("strength", self.strength, _PART, 0.0, 1.0),
            **self._checked_shape(len(at)),
            "also": self._checked_pairs(len(at)),
            "path": self._checked_path(len(at)),
            "keys": checked_keys(self.keys, len(at)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def _checked_by(self, at: tuple[float, ...]) -> tuple[float, ...]:
        if self.brush == "grab":
            return point("by", self.by, (len(at),))
        still = (0.0,) * len(at)
        if self.by not in ((), still):
            refuse("by", f"left out for a {self.brush}, which does not move its pivot", self.by)
        return still

    def _checked_pairs(self, ndim: int) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
        wanted = "pairs of a point and its drag"
        given: object = self.also
        if not isinstance(given, Iterable):
            refuse("also", wanted, given)
        pairs = tuple(given)
        if pairs and self.brush != "grab":
            refuse("also", f"left out for a {self.brush}", self.also)
        if len(pairs) >= MOST_HANDLES:
            refuse("also", f"fewer than {MOST_HANDLES} pairs", len(pairs))
        made = []
        for i, pair in enumerate(pairs):
            if not isinstance(pair, tuple | list) or len(pair) != 2:
                refuse(f"also[{i}]", wanted, pair)
            made.append((point(f"also[{i}] point", pair[0], (ndim,)), point(f"also[{i}] drag", pair[1], (ndim,))))
        return tuple(made)

    def _checked_path(self, ndim: int) -> tuple[tuple[float, ...], ...]:
        given: object = self.path
        if not isinstance(given, Iterable):
            refuse("path", "a sequence of points", given)
        made = tuple(point(f"path[{i}]", p, (ndim,)) for i, p in enumerate(given))
        if made and (self.brush != "grab" or self.also):
            refuse("path", f"left out for a {'pull' if self.also else self.brush}", f"{len(made)} points")
        return made

    def _checked_shape(self, ndim: int) -> dict[str, object]:
        """Return the angle, the factor and the axis, each if the brush has one."""
        takes = {"grab": (), "twist": ("angle", "axis"), "scale": ("factor",), "pinch": ("factor", "axis")}[self.brush]
        for name in ("angle", "factor", "axis"):
            if name not in takes and getattr(self, name) is not None:
                refuse(name, f"left out for a {self.brush}", getattr(self, name))
        if self.brush != "grab" and self.scales != 1:
            refuse("scales", f"1 for a {self.brush}, which fades as 1/r² of itself", self.scales)
        checked: dict[str, object] = {}
        if "angle" in takes:
            wanted = f"a number of degrees from {-LARGEST_ANGLE:g} to {LARGEST_ANGLE:g}"
            checked["angle"] = number("angle", self.angle, wanted, -LARGEST_ANGLE, LARGEST_ANGLE)
        if "factor" in takes:
            wanted = f"a number from {1 / LARGEST_FACTOR:g} to {LARGEST_FACTOR:g}"
            checked["factor"] = number("factor", self.factor, wanted, 1 / LARGEST_FACTOR, LARGEST_FACTOR)
        if self.axis is not None:
            if self.brush == "twist" and ndim == 2:
                refuse("axis", "left out for a twist of points of 2 numbers", self.axis)
            axis = point("axis", self.axis, (ndim,))
            if not any(axis):
                refuse("axis", "a direction, with a number other than 0", self.axis)
            checked["axis"] = axis
        return checked

    @classmethod
    def grab(
        cls,
        at: Point,
        *,
        to: Point | None = None,
        by: Point | None = None,
        path: Sequence[Point] = (),
        radius: float,
        poisson: float | None = None,
        scales: int = 1,
        reach: float | None = REACH,
    ) -> Self:
        """Return a stroke that drags the point ``at`` ``to`` another, or ``by`` a distance, or along a ``path``."""
        start = point("at", at)
        if len(path) and to is None and by is None:
            *path, to = path
        if by is not None and to is None:
            drag = point("by", by, (len(start),))
        elif to is not None and by is None:
            end = point("to", to, (len(start),))
            drag = tuple(b - a for a, b in zip(start, end, strict=True))
        else:
            raise SuppleError(f"a grab takes one of to and by, found {'neither' if to is None else 'both'}")
        return cls(at=start, by=drag, path=path, radius=radius, poisson=poisson, scales=scales, reach=reach)  # type: ignore[arg-type]

    @classmethod
    def pull(
        cls,
        points: npt.ArrayLike,
        *,
        to: npt.ArrayLike | None = None,
        by: npt.ArrayLike | None = None,
        pins: npt.ArrayLike = (),
        radius: float,
        poisson: float | None = None,
        reach: float | None = REACH,
    ) -> Self:
        """Return a stroke that drags many points at once; see `supple.Deformation.pull`."""
        start = _points("points", points)
        if (to is None) == (by is None):
            raise SuppleError(f"a pull takes one of to and by, found {'neither' if to is None else 'both'}")
        given = _points("by" if to is None else "to", by if to is None else to)
        if len(given) != len(start):
            refuse("by" if to is None else "to", f"{len(start)} points, one for each of points", f"{len(given)}")
        drags = given
        if to is not None:
            pairs_given = zip(start, given, strict=True)
            drags = [[b - a for a, b in zip(p, q, strict=False)] for p, q in pairs_given]
        stay = _points("pins", pins)
        pairs = [*zip(start, drags, strict=True), *((p, [0.0] * len(p)) for p in stay)]
        if not start:
            refuse("points", "one point at least", points)
        (at, drag), *also = pairs
        return cls(at=at, by=drag, also=also, radius=radius, poisson=poisson, reach=reach)  # type: ignore[arg-type]

    @property
    def ndim(self) -> int:
        """The number of coordinates of its points: 2 or 3."""
        return len(self.at)

    def legs(self) -> tuple[Self, ...]:
        """Return the straight grabs, one after the other, that make up a grab along a path.

        Points within a twentieth of the radius of the straight line between others are left out; of crooked paths,
        more, so that a path has at most four legs for each radius of its length.
        """
        end = tuple(a + b for a, b in zip(self.at, self.by, strict=True))
        points = np.array([self.at, *self.path, end])
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        tolerance, kept = 0.05 * self.radius, [0, len(points) - 1]
        while True:
            kept = [0, *_corners(points, 0, len(points) - 1, tolerance), len(points) - 1]
            if len(kept) - 1 <= 4 * max(1.0, length / self.radius):
                break
            tolerance *= 2
        ways = pairwise(kept)
        return tuple(
            replace(self, at=tuple(points[i].tolist()), by=tuple((points[j] - points[i]).tolist()), path=())
            for i, j in ways
        )

    def mirrored(self, at: Point, normal: Point) -> Self:
        """Return the mirror image of the stroke about a line or, with three coordinates, a plane.

        Parameters
        ----------
        at : sequence of float
            A point of the line or plane, in samples.
        normal : sequence of float
            The direction across it, in samples.
        """
        origin, n = np.array(point("at", at, (self.ndim,))), np.array(point("normal", normal, (self.ndim,)))
        if not n.any():
            refuse("normal", "a direction, with a number other than 0", normal)
        n = n / np.linalg.norm(n)

        def turned(v: Sequence[float]) -> tuple[float, ...]:
            return tuple((np.array(v) - 2 * np.dot(v, n) * n).tolist())

        def placed(p: Sequence[float]) -> tuple[float, ...]:
            return tuple((np.array(p) - 2 * np.dot(np.array(p) - origin, n) * n).tolist())

        axis = None if self.direction is None else turned(self.direction)
        return replace(
            self,
            at=placed(self.at),
            by=turned(self.by),
            also=tuple((placed(p), turned(v)) for p, v in self.also),
            path=tuple(map(placed, self.path)),
            angle=None if self.angle is None else -self.angle,
            axis=self.axis if axis == self.direction else axis,
            keys=tuple(key if key.at is None else replace(key, at=placed(key.at)) for key in self.keys),
        )

    def symmetric(self, at: Point, normal: Point) -> tuple[Self, ...]:
        """Return the strokes that make this one symmetric about a line or a plane.

        Those are one that drags the points and their mirror images at once, as a pull; or, of other brushes, of grabs
        along a path and of strokes with keys, the stroke and its mirror image after it. Points within a hundredth of
        the radius of the line are their own images, and only dragged along it.

        Parameters
        ----------
        at, normal : sequence of float
            As in `mirrored`.
        """
        image = self.mirrored(at, normal)
        apart = math.dist(self.at, image.at) > 0.02 * self.radius
        if self.brush != "grab" or self.path or (self.keys and apart):
            if apart:
                return self, image
            if self.path:
                raise SuppleError("a path that begins on the line of symmetry has two images there: begin beside it")
            return (self,)
        pairs = []
        for (p, v), (q, w) in zip(self.handles, image.handles, strict=True):
            if math.dist(p, q) > 0.02 * self.radius:
                pairs += [(p, v), (q, w)]
            else:
                pairs.append((p, tuple((a + b) / 2 for a, b in zip(v, w, strict=True))))
        return (replace(self, at=pairs[0][0], by=pairs[0][1], also=tuple(pairs[1:])),)

    def weakened(self, part: float) -> Self:
        """Return a part of the stroke: of its drag, its angle, or its factor's logarithm; at full strength."""
        return replace(
            self,
            by=tuple(part * x for x in self.by),
            also=tuple((at, tuple(part * x for x in by)) for at, by in self.also),
            path=tuple(tuple(a + part * (b - a) for a, b in zip(self.at, p, strict=True)) for p in self.path),
            angle=None if self.angle is None else part * self.angle,
            factor=None if self.factor is None else self.factor**part,
            strength=1.0,
        )

    def at_frame(self, frame: float) -> Self:
        """Return what the stroke is in a frame of a clip, by its keys: moved as a whole, and of another strength.

        Between two keys, each coordinate and the strength follow a smooth curve that never leaves their range; before
        the first and after the last, they are constant.
        """
        if not self.keys:
            return self
        held = replace(self, keys=(), strength=self.strength * strength_of(self.keys, frame))
        at = position(self.keys, frame)
        if at is None or at == self.at:
            return held
        shift = [b - a for a, b in zip(self.at, at, strict=True)]

        def moved(p: Sequence[float]) -> tuple[float, ...]:
            return tuple(a + d for a, d in zip(p, shift, strict=True))

        also = tuple((moved(p), by) for p, by in self.also)
        return replace(held, at=at, also=also, path=tuple(map(moved, self.path)))

    def following(self, track: Sequence[tuple[int, Point]], frame: float | None = None) -> Self:
        """Return the stroke with keys that move it along with a tracked point.

        Parameters
        ----------
        track : sequence of (int, point)
            The position of a tracked point in some frames, in ascending order (`supple.media.tracks.read_tracks`).
        frame : float, optional
            The frame in which the stroke is where it is now: there, it keeps its distance from the tracked point, as
            it does in all frames. By default, the first of the track.

        Raises
        ------
        SuppleError
            If the track is none, or the stroke has positions in its keys already.
        """
        keys = checked_keys([Key(k, tuple(at)) for k, at in track], self.ndim)
        if not keys:
            refuse("a track", "the positions of a point in one frame or more", track)
        if any(key.at is not None for key in self.keys):
            raise SuppleError("the stroke has keys with positions, and cannot follow a track too: leave one out")
        origin = position(
            keys, keys[0].frame if frame is None else number("frame", frame, "a frame", -LARGEST, LARGEST)
        )
        assert origin is not None
        shift = [a - b for a, b in zip(self.at, origin, strict=True)]
        made = {key.frame: key for key in self.keys}
        for key in keys:
            assert key.at is not None
            at = tuple(a + d for a, d in zip(key.at, shift, strict=True))
            made[key.frame] = replace(made.get(key.frame, key), at=at)
        return replace(self, keys=tuple(made[k] for k in sorted(made)))

    @property
    def is_still(self) -> bool:
        """True if it moves nothing: a drag or an angle of 0, or a factor of 1."""
        drags = (self.by, *(by for _, by in self.also), *(np.subtract(p, self.at) for p in self.path))
        return not any(map(any, drags)) and not self.angle and self.factor in (None, 1.0)

    @property
    def handles(self) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
        """The points of a grab and their drags, in samples: one pair, and those that it has besides."""
        return ((self.at, self.by), *self.also)

    @property
    def direction(self) -> tuple[float, ...] | None:
        """The axis of a twist or a pinch, in samples, also where it is the default; None without one, as of a plane."""
        if self.axis is not None or self.brush not in ("twist", "pinch") or (self.brush == "twist" and self.ndim == 2):
            return self.axis
        return (0.0, 0.0, 1.0) if self.brush == "twist" else (1.0, 0.0, 0.0)[: self.ndim]

    def matrix(self, spacing: Sequence[float], *, time: bool = False) -> npt.NDArray[np.float64]:
        """Return ∂K/∂p at the pivot, in physical units, shape (3, 3): R - I of a rotation R, for instance.

        Parameters
        ----------
        spacing : sequence of float
            Physical units per sample, x first.
        time : bool
            Whether the third axis is time.
        """
        made, plane = np.zeros((3, 3)), time or self.ndim == 2
        axis = np.array((0.0, 0.0, 1.0))
        if (direction := self.direction) is not None:
            axis[: self.ndim] = np.multiply(direction, spacing)
            axis[self.ndim :] = 0.0
            axis /= np.abs(axis).max()  # so that no square overflows
            axis /= np.linalg.norm(axis)
        if self.angle is not None:
            angle, (x, y, z) = math.radians(self.angle), axis
            skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            made = math.sin(angle) * skew + 2 * math.sin(angle / 2) ** 2 * (skew @ skew)
        elif self.factor is not None:
            within = np.diag([1.0, 1.0, 0.0 if plane else 1.0])
            if self.brush == "pinch" and plane and axis[2]:
                refuse("axis", "a direction within the frame, with a 0 for time", self.axis)
            along, power = np.outer(axis, axis), math.log(self.factor)
            if self.brush == "scale":
                made = math.expm1(power) * within
            else:
                made = math.expm1(power) * along + math.expm1(-power if plane else -power / 2) * (within - along)
        return made

    def material(self, *, time: bool = False) -> float:
        """Return the Poisson ratio in effect, if the third axis is ``time`` or is not."""
        if self.poisson is not None:
            return self.poisson
        return -math.inf if time and not any(self.by[:2]) else POISSON


def _points(name: str, values: object) -> list[list[float]]:
    """Return rows of coordinates; what the rows hold is checked by `Stroke`."""
    try:
        made = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        refuse(name, "points of 2 or 3 numbers each, x first", values)
    if made.size == 0:
        return []
    if made.ndim != 2 or made.shape[1] not in (2, 3):
        refuse(name, "points of 2 or 3 numbers each, x first", f"an array of shape {made.shape}")
    return made.tolist()  # type: ignore[no-any-return]


def _corners(points: npt.NDArray[np.float64], first: int, last: int, tolerance: float) -> list[int]:
    """Return the points of a line between two of it that are needed to stay within a tolerance (Douglas-Peucker)."""
    if last - first < 2:
        return []
    way, offs = points[last] - points[first], points[first + 1 : last] - points[first]
    length2 = float(way @ way)
    along = np.clip(offs @ way / length2, 0, 1) if length2 > 0 else np.zeros(len(offs))
    away = np.linalg.norm(offs - along[:, None] * way, axis=1)
    worst = int(np.argmax(away))
    if away[worst] <= tolerance:
        return []
    middle = first + 1 + worst
    before, behind = _corners(points, first, middle, tolerance), _corners(points, middle, last, tolerance)
    return [*before, middle, *behind]


def _checked_reach(reach: object) -> float | None:
    if reach is None:
        return None
    return number("reach", reach, f"a number of radii from 1 to {LARGEST:g}, or None for no limit", 1.0, LARGEST)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """A sequence of strokes and their options, to be applied to any medium.

    Parameters
    ----------
    border : "auto", float, sequence of float or None
        The width of the fixed border, as in `Domain`.
    border_profile : str
        The profile of the fixed border: ``"quartic"``, or the paper's ``"sine"``.
    on_fold : str
        The policy for a stroke that would fold the image, or that the border holds back: ``"flow"``, ``"damp"`` or
        ``"error"``.
    strokes : iterable of Stroke
        In order of application, all with the same number of coordinates. Hidden ones are not applied.
    size : sequence of int or None
        The samples along each axis, x first, of the medium that it was made for; as many numbers as coordinates.
    space : str or None
        The coordinates of points: ``"pixels"`` (indices, in volumes); or, in volumes, millimetres in ``"LPS"`` or
        ``"RAS"``. None: pixels, unless the reader of the volume determines otherwise.
    amount : float
        The applied fraction of every stroke's drag, from 0 to 1.
    time_scale : float or None
        For a recipe with times, the length of a frame in pixels. None: 1, unless the reader of the clip determines
        otherwise.
    """

    border: Border = "auto"
    border_profile: BorderProfile = "quartic"
    on_fold: FoldPolicy = "flow"
    strokes: tuple[Stroke, ...] = ()
    size: tuple[int, ...] | None = None
    space: CoordinateSpace | None = None
    amount: float = 1.0
    time_scale: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "border", checked_border(self.border))
        check_border_profile(self.border_profile)
        choice("on_fold", self.on_fold, get_args(FoldPolicy))
        if not isinstance(self.strokes, Iterable):
            refuse("strokes", "a sequence of Stroke", self.strokes)
        strokes = tuple(self.strokes)
        for i, stroke in enumerate(strokes):
            if not isinstance(stroke, Stroke):
                refuse(f"strokes[{i}]", "a Stroke", stroke)
            if (n := strokes[0].ndim) != stroke.ndim:
                refuse(f"strokes[{i}].at", f"a point of {n} numbers, as in strokes[0]", stroke.at)
        object.__setattr__(self, "strokes", strokes)
        ndim = strokes[0].ndim if strokes else None
        if self.size is not None:
            object.__setattr__(self, "size", _checked_size(self.size, ndim))
        if self.space is not None:
            choice("space", self.space, get_args(CoordinateSpace))
            if self.is_world and ndim == 2:
                refuse("space", '"pixels" where points have 2 numbers', self.space)
        object.__setattr__(self, "amount", number("amount", self.amount, _PART, 0.0, 1.0))
        if self.time_scale is not None:
            object.__setattr__(self, "time_scale", length("time_scale", self.time_scale))

    @property
    def is_world(self) -> bool:
        """True if points are in space, in millimetres."""
        return self.space in ("LPS", "RAS")

    @property
    def moves(self) -> bool:
        """True if a stroke that is not hidden has keys: it is another one in each frame of a clip."""
        return any(stroke.keys and not stroke.hidden for stroke in self.strokes)

    def at_frame(self, frame: float) -> Self:
        """Return the recipe of a frame of a clip, by the keys of its strokes: without keys, and for a picture.

        Parameters
        ----------
        frame : float
            The frame, counted from 0.
        """
        if not any(stroke.keys for stroke in self.strokes):
            return self
        return replace(self, strokes=tuple(stroke.at_frame(frame) for stroke in self.strokes))

    def fitted(self, size: Sequence[int], how: Fit | None = None, *, time: bool = False, name: str = "this") -> Self:
        """Return the recipe scaled to a medium of another size.

        The centre p of a pixel goes to (p + 0.5) s - 0.5, where s is the factor from the old size to the new one; radii
        and borders are scaled, too. For a clip, the length of a frame must be scaled by `Scaling.frame`.

        Parameters
        ----------
        size : sequence of int
            Samples along each axis, x first.
        how : str, optional
            Without it, only a size of the same proportions fits, within half a pixel. ``"pixels"``: same coordinates;
            ``"stretch"``: each axis has a factor of its own, and the radius has their geometric mean;
            ``"inside"``: x and y have the same factor, the largest that fits, and the result is centred.
        time : bool
            Whether a third axis is time. Only ``"stretch"`` scales it.
        name : str
            The owner of the size, for messages.

        Raises
        ------
        SuppleError
            If it does not fit, or ``how`` is given and the recipe has no size, or is in millimetres.
        """
        size = _checked_size(size, None)
        if how is not None and self.is_world:
            raise SuppleError(
                f"fit is for recipes in pixels, and this one is in {self.space} millimetres: leave it out"
            )
        if how is not None and self.size is None:
            raise SuppleError("fit needs the size that the recipe was made for, and it has none: leave it out")
        if self.strokes and self.strokes[0].ndim != len(size):
            return self  # invalid recipes are reported when they are applied
        if self.size is None or self.is_world or not self.strokes:
            return replace(self, size=size)
        scaling = scaling_of(self.size, size, how, time=time, name=name)
        if scaling is None:
            return replace(self, size=size)
        strokes = [
            replace(
                s,
                at=scaling.point(s.at),
                by=scaling.drag(s.by),
                also=tuple((scaling.point(at), scaling.drag(by)) for at, by in s.also),
                path=tuple(map(scaling.point, s.path)),
                axis=None if s.axis is None else scaling.drag(s.axis),
                radius=s.radius * scaling.length,
                keys=tuple(k if k.at is None else replace(k, at=scaling.point(k.at)) for k in s.keys),
            )
            for s in self.strokes
        ]
        border = self.border
        if isinstance(border, float | tuple):
            given = border if isinstance(border, tuple) else (border,) * len(size)
            if len(given) == len(size):  # else reported when it is applied
                widths = tuple(width * s for width, s in zip(given, scaling.widths, strict=True))
                border = widths[0] if isinstance(border, float) and len(set(widths)) == 1 else widths
        return replace(self, size=size, strokes=tuple(strokes), border=border)

    def to_json(self) -> str:
        """Return the recipe as strict JSON, one stroke a line, from which `from_json` makes an equal one."""
        head: dict[str, object] = {
            "supple": VERSION,
            "border": list(map(_plain, self.border)) if isinstance(self.border, tuple) else _plain(self.border),
            "border_profile": self.border_profile,
            "on_fold": self.on_fold,
            "amount": _plain(self.amount),
        }
        if self.space is not None:
            head["space"] = self.space
        if self.size is not None:
            head["size"] = list(self.size)
        if self.time_scale is not None:
            head["time_scale"] = _plain(self.time_scale)
        members = [f"  {_dump(key)}: {_dump(value)}" for key, value in head.items()]
        strokes = ",\n".join(f"    {_dump(_stroke_entry(stroke))}" for stroke in self.strokes)
        members.append(f'  "strokes": [\n{strokes}\n  ]' if strokes else '  "strokes": []')
        return "{\n" + ",\n".join(members) + "\n}\n"

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read a recipe written by `to_json` or by hand.

        Parameters
        ----------
        text : str
            The JSON text. All keys but ``supple`` and ``strokes``, and of a stroke ``brush``, ``at``, ``radius`` and
            ``by`` (or ``to``), have defaults. A recipe of version 1 has no ``reach``, and the border is ``"sine"``.

        Raises
        ------
        SuppleError
            If it is not a recipe; the message names the fault.
        """
        data = _parse(text)
        if not isinstance(data, dict):
            refuse("a recipe", "a JSON object", data)
        if "supple" not in data:
            raise SuppleError(f'the key "supple", a recipe\'s version ({VERSION}), is missing in {value_shown(data)}')
        version = integer('"supple"', data.pop("supple"), "1 or 2 (the versions that this release reads)", 1, VERSION)
        _check_keys("the recipe", data, _known(cls, version), ["strokes"])
        if version == 1:
            data = {"border": 50.0, "on_fold": "damp", **data, "border_profile": "sine"}
        if not isinstance(data["strokes"], list):
            refuse("strokes", "a list", data["strokes"])
        data["strokes"] = [_stroke(f"strokes[{i}]", entry, version) for i, entry in enumerate(data["strokes"])]
        return cls(**data)


def fit_recipe(recipe: Recipe, size: Sequence[int], how: Fit | None, name: str, *, time: bool = False) -> Recipe:
    """Return a recipe scaled to a file's size by `Recipe.fitted`, and warn if ``how`` is not given.

    Parameters
    ----------
    recipe : Recipe
    size : sequence of int
        Samples along each axis, x first.
    how : str or None
        As in `Recipe.fitted`.
    name : str
        The name of the file, for messages.
    time : bool
        Whether a third axis is time.
    """
    made = recipe.fitted(size, how, time=time, name=name)
    if how is None and recipe.size is not None and made.strokes != recipe.strokes:
        warnings.warn(
            f"the recipe was made for {spoken(recipe.size)}, and is scaled for {name}, which is {spoken(size)}",
            ScaleWarning,
            stacklevel=4,
        )
    return made


def _plain(x: float | str | None) -> float | str | None:
    if not isinstance(x, float) or not x.is_integer() or abs(x) >= 2**53 or (x == 0 and math.copysign(1, x) < 0):
        return x
    return int(x)


def _dump(value: object) -> str:
    return json.dumps(value, allow_nan=False)


def _stroke_entry(stroke: Stroke) -> dict[str, object]:
    shape: dict[str, object] = {"by": [_plain(x) for x in stroke.by]}
    if stroke.brush != "grab":
        shape = {name: _plain(x) for name, x in (("angle", stroke.angle), ("factor", stroke.factor)) if x is not None}
    if stroke.also:
        shape["also"] = [[[_plain(x) for x in at], [_plain(x) for x in by]] for at, by in stroke.also]
    if stroke.path:
        shape["path"] = [[_plain(x) for x in p] for p in stroke.path]
    if stroke.axis is not None:
        shape["axis"] = [_plain(x) for x in stroke.axis]
    entry: dict[str, object] = {
        "brush": stroke.brush,
        "at": [_plain(x) for x in stroke.at],
        **shape,
        "radius": _plain(stroke.radius),
        "scales": stroke.scales,
        "reach": _plain(stroke.reach),
        "poisson": "-inf" if stroke.poisson == -math.inf else _plain(stroke.poisson),
        "strength": _plain(stroke.strength),
    }
    if stroke.hidden:
        entry["hidden"] = True
    if stroke.name is not None:
        entry["name"] = stroke.name
    if stroke.keys:
        entry["keys"] = [_key_entry(key) for key in stroke.keys]
    return entry


def _key_entry(key: Key) -> dict[str, object]:
    entry: dict[str, object] = {"frame": key.frame}
    if key.at is not None:
        entry["at"] = [_plain(x) for x in key.at]
    if key.strength is not None:
        entry["strength"] = _plain(key.strength)
    return entry


def _known(made: type[Recipe | Stroke], version: int) -> list[str]:
    """Return the keys of a version."""
    return [field.name for field in fields(made) if version > 1 or field.name not in _NEW]


def _stroke(where: str, entry: object, version: int) -> Stroke:
    if not isinstance(entry, dict):
        refuse(where, "a JSON object", entry)
    known, end = _known(Stroke, version), "to" if "to" in entry and version > 1 else "by"
    needed = {"twist": "angle", "scale": "factor", "pinch": "factor"}.get(str(entry.get("brush")), end)
    _check_keys(where, entry, [*known, "to"] if version > 1 else known, ["brush", "at", needed, "radius"])
    if end == "to":
        if "by" in entry:
            raise SuppleError(f'{where} takes one of "to" and "by", found both')
        entry = {**entry, "by": _drag(where, entry["at"], entry["to"])}
        del entry["to"]
    if version == 1:
        entry = {"poisson": POISSON, **entry, "reach": None}
    if entry.get("poisson") == "-inf":
        entry["poisson"] = -math.inf
    if "keys" in entry:
        entry = {**entry, "keys": _keys(where, entry["keys"])}
    try:
        return Stroke(**entry)
    except SuppleError as error:
        raise SuppleError(f"{where}: {error}") from None


def _keys(where: str, entries: object) -> list[Key]:
    if not isinstance(entries, list):
        refuse(f"{where}: keys", "a list of objects with frame, at and strength", entries)
    made = []
    for i, entry in enumerate(entries):
        name = f"{where}: keys[{i}]"
        if not isinstance(entry, dict):
            refuse(name, "an object with frame, at and strength", entry)
        _check_keys(name, entry, [field.name for field in fields(Key)], ["frame"])
        try:
            made.append(Key(**entry))
        except SuppleError as error:
            raise SuppleError(f"{name}: {error}") from None
    return made


def _drag(where: str, at: object, to: object) -> tuple[float, ...]:
    try:
        start = point("at", at)
        return tuple(b - a for a, b in zip(start, point("to", to, (len(start),)), strict=True))
    except SuppleError as error:
        raise SuppleError(f"{where}: {error}") from None


def _checked_size(size: object, ndim: int | None) -> tuple[int, ...]:
    lengths = (2, 3) if ndim is None else (ndim,)
    sizes = items("size", size, f"{' or '.join(map(str, lengths))} numbers of samples, x first", lengths)
    wanted = f"a whole number from 1 to {LONGEST_AXIS}"
    return tuple(integer(f"size[{i}]", n, wanted, 1, LONGEST_AXIS) for i, n in enumerate(sizes))


def _check_keys(where: str, entry: dict[str, object], known: list[str], required: list[str]) -> None:
    for key in entry:
        if key not in known:
            import difflib

            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}"
            if key in _NEW:
                hint = f'it is of version {VERSION} ("supple": {VERSION})'
            raise SuppleError(f"unknown key {value_shown(key)} in {where}: {hint}")
    for key in required:
        if key not in entry:
            raise SuppleError(f'the key "{key}" is missing in {where}')


def _parse(text: str) -> Any:
    if not isinstance(text, str):
        refuse("a recipe", "text in JSON", text)
    try:
        return json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant, parse_int=_parse_int)
    except json.JSONDecodeError as error:
        reason = f"{error.msg} at line {error.lineno}, column {error.colno}"
    except RecursionError:
        reason = "it is nested too deeply"
    raise SuppleError(f"a recipe must be JSON: {reason}")


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    twice = [key for key, n in Counter(key for key, _ in pairs).items() if n > 1]
    if twice:
        raise SuppleError(f"the key {value_shown(twice[0])} is given twice in one object of the recipe")
    return dict(pairs)


def _no_constant(token: str) -> NoReturn:
    raise SuppleError(f'a recipe must be strict JSON, found {token} (an infinite poisson is written "-inf")')


def _parse_int(digits: str) -> float:
    # Python refuses to read integers of thousands of digits; as a float, such a number is out of bounds.
    return int(digits) if len(digits) < 100 else float(digits)


def pack(strokes: Iterable[Stroke], spacing: Sequence[float], *, time: bool = False) -> npt.NDArray[np.void]:
    """Return the strokes as the table that the engines read.

    With ``d = point - pivot`` and ``rho_i² = |d|² + radius2_i``, a row is the displacement
    ``sum_i (p_i / rho_iⁿ + q_i / rho_iⁿ⁺²) v + (r_i / rho_iⁿ⁺²) (d · v) d``. A grab has the ``power`` n = 1, and v is
    its ``force``, the displacement of the pivot; the other brushes have n = 3, and v is ``matrix @ d``, where the
    matrix is the displacement's Jacobian at the pivot (de Goes and James, "Regularized Kelvinlets", 2017; section 5).
    Where ``reach`` is finite, that is multiplied by ``1 - 10t³ + 15t⁴ - 6t⁵``, ``t = |d| / reach``, and 0 beyond.
    Rows that are ``joined`` act at once with the one before them: all are evaluated at the same point, and added;
    ``most`` bounds their displacement, if it is known, and is infinite otherwise.

    Parameters
    ----------
    strokes : iterable of Stroke
    spacing : sequence of float
        Physical units per sample, x first; as many as the strokes have coordinates.
    time : bool
        Whether the third axis is time.

    Returns
    -------
    ndarray of STROKE_DTYPE
        One row a stroke, in physical units; a missing third coordinate is 0.
    """
    n, rows = len(spacing), []
    for i, stroke in enumerate(strokes):
        if stroke.ndim != n:
            refuse(f"strokes[{i}].at", f"a point of {n} numbers, as the medium has {n} axes", stroke.at)
        pivot, force = (
            (*(x * step for x, step in zip(v, spacing, strict=True)), 0.0)[:3] for v in (stroke.at, stroke.by)
        )
        matrix, power = stroke.matrix(spacing, time=time), 1 if stroke.brush == "grab" else 3
        terms = _terms(stroke.radius, stroke.material(time=time), stroke.scales, stroke.brush)
        reach = math.inf if stroke.reach is None else stroke.reach * stroke.radius
        rows.append((pivot, force, matrix, *terms, stroke.scales, power, 0, reach, math.inf))
    return np.array(rows, STROKE_DTYPE)


@lru_cache(maxsize=256)
def _terms(radius: float, poisson: float, scales: int, brush: Brush) -> npt.NDArray[np.float64]:
    """Return the columns radius2, p, q and r of a row, as four rows."""
    # b/a of the kelvinlet (a itself cancels): from 0, at -inf, to 1/2, so that no sum here loses digits.
    ratio = 1 / (4 * (1 - poisson))
    made = np.zeros((4, 3))
    radius2, p, q, r = made
    radius2[:] = radius**2
    if brush != "grab":
        # Of a rotation and of a scale, the part with b vanishes, or is proportional to that with a.
        share = ratio if brush == "pinch" else 0.0
        scale = radius**3 / (2.5 - 2 * share)
        p[0], q[0], r[0] = scale * (1 - 2 * share), scale * 1.5 * radius**2, scale * 3 * share
        made.flags.writeable = False
        return made
    scale = radius * 2 / (3 - 2 * ratio)
    weights, m = _WEIGHTS[scales], scales
    radius2[:m] *= _RADIUS2[:m]
    p[:m] = weights * (scale * (1 - ratio))
    r[:m] = weights * (scale * ratio)
    q[:m] = weights * scale * radius2[:m] / 2
    if m > 1:
        # These must sum to exactly zero, or a remainder of 1/r would outlast 1/r⁵. The sums are exact.
        p[m - 1] = -p[: m - 1].sum()
        r[m - 1] = -r[: m - 1].sum()
    made.flags.writeable = False
    return made


def numbers(table: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Return a table's rows in the layout of the native core: float64 (n, 32), with the bits of the integers."""
    return np.ascontiguousarray(table).view(np.float64).reshape(len(table), STROKE_DTYPE.itemsize // 8)
