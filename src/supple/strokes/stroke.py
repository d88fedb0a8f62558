"""A stroke: immutable, checked when it is made."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self, TypedDict, Unpack, get_args

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, none, numbered
from supple.space.checks import LARGEST, assign, choice, flag, integer, items, length, listed, number, point, refuse
from supple.space.freezing import Freeze
from supple.strokes.keys import Key, checked_keys, position, value

Brush = Literal["grab", "twist", "scale", "pinch", "freeze"]
Point = Sequence[float] | npt.NDArray[Any]
Place = tuple[float, ...]

REACH = 4.0  # as natural as an unlimited reach, and local
LARGEST_ANGLE = 3600.0  # degrees
LARGEST_FACTOR = 100.0
MOST_FLAT = 0.9
MOST_HANDLES = 1000
PAINTINGS = frozenset(("restore", "smooth", "push"))
"""The names of painted strokes, which have many points at once."""
PART = "a number from -1 (the opposite) to 2"
LEAST, MOST = -1.0, 2.0
"""The range of a recipe's amount and a stroke's strength."""
FADE = 5  # frames before and after a track, over which a stroke that follows it fades


PAIRS = "pairs of a point and its drag"
_USUAL: dict[str, object] = {"scales": 1, "flat": 0.0, "also": (), "path": (), "chord": False}
_USUAL |= dict.fromkeys(("angle", "factor", "axis"))
_TAKES = {
    "grab": ("scales", "flat", "also", "path"),
    "twist": ("angle", "axis", "chord"),
    "scale": ("factor",),
    "pinch": ("factor", "axis"),
    "freeze": (),
}


class BrushOptions(TypedDict, total=False):
    """The parameters that all brushes share, besides ``at`` and ``radius``: see `Stroke`."""

    reach: float | None
    time_radius: float | None
    strength: float


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
        The reach in radii, from 1: farther than that from the path of its points, the displacement is exactly 0.
        None: unlimited, as in the paper.
    time_radius : float or None
        In a clip, the brush's radius in time, in frames: the brush is an ellipsoid, and its reach is a multiple of
        both radii. None: the larger of the drag in time and an eighth of the clip, but at most the radius in frames
        (`supple.strokes.time_radius_of`).
    flat : float
        For a grab with a reach: the fraction of its radius, in space and time, up to 0.9, within which everything
        moves as its point does.
    brush : str
        ``"grab"`` moves the pivot by the drag. The others are affine at the pivot, and fade with the distance:
        ``"twist"`` turns it by the angle; ``"scale"`` magnifies it by the factor (in a clip, in x and y alone);
        ``"pinch"`` stretches it by the factor along the axis, and by the inverse across it (in a volume, by the
            inverse's root along both axes across). ``"freeze"`` moves nothing: its ``matte`` replaces the freeze mask
            for later strokes, which move nothing where it is 0 (`Stroke.freeze` makes one).
    angle : float or None
        For a twist: degrees, from x towards y; in a volume, right-handed about the axis.
    factor : float or None
        For a scale or a pinch: above 1, it bloats or stretches; below 1, it puckers or squeezes.
    axis : sequence of float or None
        For a twist with three coordinates, or a pinch: a direction, in samples. None: z or time; or x.
    chord : bool
        For a twist: whether points move along chords, and so nearer to the pivot, as in recipes before version 3.
        Otherwise they keep their distance from the pivot.
    isotropic : bool
        In a clip, whether time is like a direction in space, as in recipes before version 3: the radius in time
        equals that in space, and a drag in the plane moves points in time as well. Otherwise a drag in the plane
        moves nothing in time, and one in time nothing in the plane, unless ``poisson`` is given.
    also : sequence of (sequence of float, sequence of float)
        For a grab: further points and their drags, in samples, applied at once, so that each point arrives; a point
        with a drag of 0 is a pin.
    path : sequence of sequences of float
        For a grab: the points through which its point is dragged, in samples. None: a straight line.
    hidden : bool
        Whether it is kept in the recipe, but not applied.
    name : str or None
        A name for users.
    strength : float
        The applied fraction of the drag, the angle or the factor's logarithm, from -1 (the opposite) to 2; see
        `Deformation.from_recipe`.
    matte : Freeze or None
        A factor m(p) of its displacement, 1 where it applies in full, in addition to the freeze mask (made by
        `Freeze.of` and `Freeze.matte_of`); for a freeze, its mask.
    keys : sequence of Key
        In a clip, for a stroke with two coordinates: the position of ``at``, the angle, scale and strength in some
        frames, in ascending order. The whole stroke moves with them; see `Recipe.at_frame`.
    """

    at: Place
    by: Place = ()
    radius: float
    poisson: float | None = None
    scales: int = 1
    reach: float | None = REACH
    time_radius: float | None = None
    flat: float = 0.0
    brush: Brush = "grab"
    angle: float | None = None
    factor: float | None = None
    axis: Place | None = None
    chord: bool = False
    isotropic: bool = False
    also: tuple[tuple[Place, Place], ...] = ()
    path: tuple[Place, ...] = ()
    hidden: bool = False
    name: str | None = None
    strength: float = 1.0
    keys: tuple[Key, ...] = ()
    matte: Freeze | None = None

    def __post_init__(self) -> None:
        choice("brush", self.brush, get_args(Brush))
        if not isinstance(self.name, str | None):
            refuse("name", "text", self.name)
        if not isinstance(self.matte, Freeze | None):
            refuse("matte", "a Freeze (Freeze.of makes one from an array)", self.matte)
        at = point("at", self.at)
        one, still, degrees = (len(at),), (0.0,) * len(at), LARGEST_ANGLE
        reach = f"a number of radii from 1 to {LARGEST:g}, or {none()} for no limit"
        factor = f"a number from {1 / LARGEST_FACTOR:g} to {LARGEST_FACTOR:g}"
        pairs = [items("also", pair, PAIRS, (2,)) for pair in listed("also", self.also, PAIRS)]
        checked: dict[str, Any] = {
            "scales": integer("scales", self.scales, "1, 2 or 3", 1, 3),
            "flat": number("flat", self.flat, f"a part of the radius from 0 to {MOST_FLAT}", 0.0, MOST_FLAT),
            "also": tuple(
                (point(f"also[{i}] point", p, one), point(f"also[{i}] drag", v, one)) for i, (p, v) in enumerate(pairs)
            ),
            "path": tuple(
                point(f"path[{i}]", p, one) for i, p in enumerate(listed("path", self.path, "a sequence of points"))
            ),
            "angle": _number(
                "angle", self.angle, f"a number of degrees from {-degrees:g} to {degrees:g}", -degrees, degrees
            ),
            "factor": _number("factor", self.factor, factor, 1 / LARGEST_FACTOR, LARGEST_FACTOR),
            "axis": None if self.axis is None else point("axis", self.axis, one),
            "chord": flag("chord", self.chord),
        }
        takes = _TAKES[self.brush]
        for name, usual in _USUAL.items():
            if name not in takes and checked[name] not in (usual, None):
                refuse(name, f"left out for a {self.brush}", checked[name])
        for name in ("angle", "factor"):
            if name in takes and checked[name] is None:
                refuse(name, f"a number, for a {self.brush}", None)
        if self.brush != "grab" and self.by not in ((), still):
            refuse("by", f"left out for a {self.brush}, which does not move its pivot", self.by)
        if checked["axis"] is not None and (not any(checked["axis"]) or (self.brush == "twist" and len(at) == 2)):
            wanted = "a direction, with a number other than 0, and of a twist, in three dimensions"
            refuse("axis", wanted, self.axis)
        if checked["also"] and checked["path"]:
            refuse("path", "left out for a pull", told=f"{len(checked['path'])} points")
        if len(pairs) >= MOST_HANDLES:
            refuse("also", f"fewer than {MOST_HANDLES} pairs", len(pairs))
        if checked["flat"] and (pairs or self.reach is None):
            refuse("flat", f"left out for a {'pull' if pairs else 'grab without a reach'}", self.flat)
        if self.time_radius is not None and (len(at) == 2 or self.isotropic):
            refuse("time_radius", "left out for a stroke without time, or one that is isotropic", self.time_radius)
        assign(
            self,
            at=at,
            by=point("by", self.by, one) if self.brush == "grab" else still,
            radius=length("radius", self.radius),
            poisson=_number("poisson", self.poisson, "a number up to 0.5, or -inf", -math.inf, 0.5),
            reach=_number("reach", self.reach, reach, 1.0, LARGEST),
            time_radius=None if self.time_radius is None else length("time_radius", self.time_radius),
            strength=number("strength", self.strength, PART, LEAST, MOST),
            hidden=flag("hidden", self.hidden),
            isotropic=flag("isotropic", self.isotropic),
            keys=checked_keys(self.keys, len(at)),
            **checked,
        )
        if self.brush == "freeze" and (self.matte is None or self.keys or self.strength != 1):
            name = "matte" if self.matte is None else "keys" if self.keys else "strength"
            refuse(name, "a mask, for a freeze" if name == "matte" else "left out for a freeze", getattr(self, name))

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
        flat: float = 0.0,
        **options: Unpack[BrushOptions],
    ) -> Self:
        """Return a stroke that drags the material at a point.

        Parameters
        ----------
        at : sequence of float
            The grabbed point.
        to, by : sequence of float
            The target or the drag; one of the two. Near a fixed border, a stroke that does not flow falls short by the
            border's factor β there.
        path : sequence of points, optional
            The points through which it is dragged on its way; without ``to`` and ``by``, the last one is the target.
        scales : int
            1: a wide effect, fading as 1/r. 2 and 3: more local, as 1/r³ and 1/r⁵.
        flat : float
            The fraction of the radius, in space and time, up to 0.9, within which everything moves as the point
            does; the rest fades as usual. It requires a reach.
        radius, poisson, reach, time_radius, strength
            As for all brushes (`Deformation`). The reach is measured from the whole path of the point.
        """
        start = point("at", at)
        if len(path) and to is None and by is None:
            *path, to = path
        _check_ends("grab", to, by)
        end = point("by" if to is None else "to", by if to is None else to, (len(start),))
        drag = end if to is None else tuple(b - a for a, b in zip(start, end, strict=True))
        known: dict[str, Any] = {"path": path, "poisson": poisson, "scales": scales, "flat": flat, **_known(options)}
        return cls(at=start, by=drag, radius=radius, **known)

    @classmethod
    def twist(
        cls,
        at: Point,
        *,
        angle: float,
        radius: float,
        axis: Point | None = None,
        **options: Unpack[BrushOptions],
    ) -> Self:
        """Return a stroke that turns the material around a point.

        At the point, it rotates by exactly the angle, which fades with the distance; all points keep their distance
        from the point. A twist folds at no angle; where a fixed border or a freeze mask holds a part of it back,
        ``on_fold`` applies.

        Parameters
        ----------
        angle : float
            In degrees, from x towards y: clockwise on a screen. In a volume, right-handed about the axis. Any number of
            turns, up to ten.
        axis : sequence of float, optional
            In a volume or a clip, the direction of the axis, in samples; by default, that of z or of time.
        at, radius, reach, time_radius, strength
            As for all brushes.
        """
        return cls(brush="twist", at=at, angle=angle, axis=axis, radius=radius, **_known(options))  # type: ignore[arg-type]

    @classmethod
    def scale(cls, at: Point, *, factor: float, radius: float, **options: Unpack[BrushOptions]) -> Self:
        """Return a stroke that bloats or puckers the material around a point.

        At the point, lengths are magnified by exactly the factor; it fades with the distance. In a clip, x and y are
        magnified, and time is not.

        Parameters
        ----------
        factor : float
            Above 1 it bloats, below 1 it puckers; from 0.01 to 100.
        strength : float
            The applied part of the factor's logarithm: half of a scale by 4 is one by 2.
        at, radius, reach, time_radius
            As for all brushes.
        """
        return cls(brush="scale", at=at, factor=factor, radius=radius, **_known(options))  # type: ignore[arg-type]

    @classmethod
    def pinch(
        cls,
        at: Point,
        *,
        factor: float,
        radius: float,
        axis: Point | None = None,
        poisson: float | None = None,
        **options: Unpack[BrushOptions],
    ) -> Self:
        """Return a stroke that pinches the material around a point.

        At the point, lengths along the axis are multiplied by exactly the factor, and those across it by its inverse
        (in a volume, by the inverse's root along both axes across), so that areas and volumes there stay the same.

        Parameters
        ----------
        factor : float
            Below 1 it squeezes along the axis, above 1 it stretches; from 0.01 to 100.
        axis : sequence of float, optional
            A direction, in samples; by default, that of x.
        at, radius, poisson, reach, time_radius, strength
            As for all brushes; the strength is a part of the factor's logarithm.
        """
        known: dict[str, Any] = {"axis": axis, "poisson": poisson, **_known(options)}
        return cls(brush="pinch", at=at, factor=factor, radius=radius, **known)  # type: ignore[arg-type]

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
        **options: Unpack[BrushOptions],
    ) -> Self:
        """Return a stroke that drags many points at once, each to its own target.

        The forces at the points are solved together, so that every point arrives, whatever the others do; where the map
        would fold, they move in several steps, each solved anew at the points' positions (de Goes and James,
        "Regularized Kelvinlets", 2017; section 6).

        Parameters
        ----------
        points : array_like, shape (N, D)
            The dragged points, in pixels, x first; up to 1,000 with the pins.
        to, by : array_like, shape (N, D)
            Their targets, or their drags; one of the two.
        pins : array_like, shape (M, D), optional
            Points that stay where they are.
        radius : float
            About the distance between the points, or more.
        poisson, reach, time_radius, strength
            As for all brushes. Frozen points are released, with a warning; if two points pull against each other so
            that they cannot arrive without a fold, an error names both.

        Warns
        -----
        OutsideWarning, FoldWarning, MissWarning
            As for all brushes, for its first point.

        Examples
        --------
        >>> d = Deformation((512, 512))
        >>> d = d.pull([(200, 250), (300, 250)], to=[(180, 250), (320, 250)], pins=[(250, 250)], radius=60)
        >>> d.forward([(200, 250), (250, 250)]).round(6)
        array([[180., 250.],
               [250., 250.]])
        """
        start, stay = _points("points", points), _points("pins", pins)
        _check_ends("pull", to, by)
        which = "by" if to is None else "to"
        given = _points(which, by if to is None else to)
        if given.shape != start.shape:
            refuse(which, f"an array of shape {start.shape}, as the points are", told=f"shape {given.shape}")
        if not start.size:
            refuse("points", "one point at least", points)
        drags = given if to is None else given - start
        pairs = [*zip(start.tolist(), drags.tolist(), strict=True), *((p, [0.0] * len(p)) for p in stay.tolist())]
        if len(pairs) > MOST_HANDLES:
            refuse("points", f"at most {MOST_HANDLES} points, pins among them", len(pairs))
        (at, drag), *also = pairs
        return cls(at=at, by=drag, also=also, radius=radius, poisson=poisson, **_known(options))  # type: ignore[arg-type]

    @classmethod
    def push(
        cls,
        path: Sequence[Point],
        *,
        by: float,
        radius: float,
        poisson: float | None = None,
        **options: Unpack[BrushOptions],
    ) -> Self:
        """Return a stroke that pushes the material along a path sideways.

        ``by`` is the distance, in pixels, to the left of the direction of the path; below 0, to the right. The options
        are ``poisson``, ``reach`` and ``strength``, as for all brushes.
        """
        ends = [np.array(point(f"path[{i}]", p, (2,))) for i, p in enumerate(path)]
        lengths = np.cumsum([0.0, *(math.dist(a, b) for a, b in itertools.pairwise(ends))])
        if not lengths[-1] > 0:
            refuse("path", "two points or more, which are apart", told=f"{len(ends)} points")
        away, radius = number("by", by, "a number of samples", -LARGEST, LARGEST), length("radius", radius)
        places = np.linspace(0.0, lengths[-1], min(max(round(2 * lengths[-1] / radius), 1), MOST_HANDLES) + 1)
        way = np.stack([np.interp(places, lengths, x) for x in zip(*ends, strict=True)], axis=1)
        along = np.gradient(way, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        drags = away * np.stack([along[:, 1], -along[:, 0]], axis=1)
        return replace(cls.pull(way, by=drags, radius=radius, poisson=poisson, **options), name="push")

    @classmethod
    def freeze(cls, mask: Freeze, *, ndim: int | None = None) -> Self:
        """Return a freeze for later strokes, which move nothing where the mask is 0; see `supple.Deformation.freeze`.

        Its ``at`` is the middle of the frozen part. ``ndim`` is the number of coordinates of the other strokes, by
        default that of the mask: strokes in time have one more.
        """
        return cls(brush="freeze", at=(*mask.middle, 0.0)[: ndim or len(mask.middle)], radius=1.0, matte=mask)

    @property
    def ndim(self) -> int:
        """The number of coordinates of its points: 2 or 3."""
        return len(self.at)

    @property
    def changes(self) -> bool:
        """True if it differs from frame to frame of a clip: it has keys, or a moving matte."""
        return bool(self.keys) or (self.ndim == 2 and self.matte is not None and self.matte.ndim == 3)

    @property
    def is_whole(self) -> bool:
        """True if its points are not edited one by one: it was painted, or adjusts a face."""
        return self.name is not None and (self.name in PAINTINGS or self.name.startswith("face "))

    def mapped(self, place: Callable[[Place], Place], turn: Callable[[Place], Place]) -> Self:
        """Return the stroke with its points mapped by ``place``, and its drags and its axis by ``turn``."""
        return replace(
            self,
            at=place(self.at),
            by=turn(self.by),
            also=tuple((place(at), turn(by)) for at, by in self.also),
            path=tuple(map(place, self.path)),
            axis=None if self.axis is None else turn(self.axis),
            keys=tuple(key if key.at is None else replace(key, at=place(key.at)) for key in self.keys),
        )

    def mirrored(self, at: Point, normal: Point) -> Self:
        """Return the mirror image of the stroke about a line or, with three coordinates, a plane.

        Parameters
        ----------
        at : sequence of float
            A point of the line or plane, in samples.
        normal : sequence of float
            The direction across it, in samples; for a stroke with a matte, that of an axis, or SuppleError.
        """
        origin, n = np.array(point("at", at, (self.ndim,))), np.array(point("normal", normal, (self.ndim,)))
        if not n.any():
            refuse("normal", "a direction, with a number other than 0", normal)
        n, matte = n / np.linalg.norm(n), self.matte
        if matte is not None:
            across = np.flatnonzero(n)
            if len(across) > 1:
                refuse("normal", "along an axis for a stroke with a matte, which is mirrored too", normal)
            matte = matte.mirrored(int(across[0]), float(origin[across[0]]))

        def turned(v: Place) -> Place:
            return tuple((np.array(v) - 2 * np.dot(v, n) * n).tolist())

        def placed(p: Place) -> Place:
            return tuple((np.array(p) - 2 * np.dot(np.array(p) - origin, n) * n).tolist())

        axis = None if self.direction is None else turned(self.direction)
        image = self.mapped(placed, turned)
        return replace(
            image,
            keys=tuple(key if key.angle is None else replace(key, angle=-key.angle) for key in image.keys),
            angle=None if self.angle is None else -self.angle,
            axis=self.axis if axis == self.direction else axis,
            matte=matte,
        )

    def is_image(self, other: Stroke) -> bool:
        """Return whether another stroke is the mirror image of this one about the line or plane midway between them."""
        across = np.subtract(other.at, self.at)
        slants = self.matte is not None and np.count_nonzero(across) > 1
        if other.brush != self.brush or not across.any() or slants:
            return False
        image = self.mirrored(np.add(self.at, other.at) / 2, across)
        ways, others = ([each.by, *each.path] for each in (image, other))
        alike = image == replace(other, at=image.at, by=image.by, path=image.path, axis=image.axis)
        close = len(ways) == len(others) and np.allclose(ways, others, rtol=0, atol=1e-6 * self.radius)
        return alike and close

    def symmetric(self, at: Point, normal: Point) -> tuple[Self, ...]:
        """Return the strokes that make this one symmetric about a line or a plane.

        A grab becomes one stroke, which drags its points and their mirror images at once, as a pull. Other brushes,
        grabs along a path or with a plateau, and strokes with keys or a matte become two: the stroke, and then its
        mirror image. Points within a hundredth of the radius of the line are their own images, and only dragged along
        it.

        Parameters
        ----------
        at, normal : sequence of float
            As in `mirrored`.
        """
        if self.brush == "freeze":
            return (self,)
        image = self.mirrored(at, normal)
        apart = math.dist(self.at, image.at) > 0.02 * self.radius
        if self.brush != "grab" or self.path or ((self.keys or self.flat or self.matte) and apart):
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
        """Return the stroke at full strength, with a fraction of its drag, its angle, or its factor's logarithm."""
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
        """Return the stroke at a frame of a clip, by its keys: moved, turned and scaled as a whole, and weakened.

        Between two keys, each coordinate, the angle, the scale and the strength follow a smooth curve that never leaves
        their range; before the first and after the last, they are constant. A matte is that of the frame.
        """
        if not self.changes:
            return self
        matte = self.matte and self.matte.at_frame(round(frame))
        held = replace(self, keys=(), matte=matte, strength=self.strength * value(self.keys, "strength", frame, 1.0))
        angle, scale = value(self.keys, "angle", frame, 0.0), value(self.keys, "scale", frame, 1.0)
        at = position(self.keys, frame) or self.at
        if (at, angle, scale) == (self.at, 0.0, 1.0):
            return held
        turn = cmath.rect(scale, math.radians(angle))

        def turned(v: Place) -> Place:
            made = turn * complex(*v)
            return made.real, made.imag

        def moved(p: Place) -> Place:
            arm = tuple(a - b for a, b in zip(p, self.at, strict=True))
            return tuple(a + (b - c) + (d - e) for a, b, c, d, e in zip(p, turned(arm), arm, at, self.at, strict=True))

        made = replace(held, axis=self.direction if angle else self.axis).mapped(moved, turned)
        return replace(made, at=at, radius=self.radius * scale)

    def following(
        self,
        track: Sequence[tuple[int, Point]],
        frame: float | None = None,
        *,
        second: Sequence[tuple[int, Point]] = (),
        outside: Literal["fade", "hold"] = "fade",
    ) -> Self:
        """Return the stroke with keys that move it along with a tracked point.

        Parameters
        ----------
        track : sequence of (int, point)
            The position of a tracked point in some frames, in ascending order (`supple.media.tracks.read_tracks`).
        frame : float, optional
            The frame in which the stroke is where it is now; its distance to the tracked point in this frame is
            kept in all frames. By default, the first of the track.
        second : sequence of (int, point)
            A second point of the same object: the stroke turns and grows with the vector from the first point to
            this one, in the frames that both have.
        outside : str
            ``"fade"``: before and after the track, the stroke fades out within 5 frames, unless it has keys with a
            strength. ``"hold"``: it stays as it is at the ends of the track.

        Raises
        ------
        SuppleError
            If the track is empty, the frame is outside it, or the stroke's keys have positions already.
        """
        choice("outside", outside, ("fade", "hold"))
        places, ends = _track(track, self.ndim), _track(second, self.ndim)
        if not places:
            refuse("a track", "the positions of a point in one frame or more", track)
        if any((key.at, key.angle, key.scale) != (None,) * 3 for key in self.keys):
            raise SuppleError("the stroke has keys with positions, and cannot follow a track too: leave one out")
        first, *_, last = (*places, *places)
        begin = first if frame is None else number("frame", frame, "a frame", -LARGEST, LARGEST)
        if not first <= begin <= last:
            raise SuppleError(
                f"the track is of the frames {numbered(first)} to {numbered(last)}, and the stroke of frame "
                f"{numbered(begin):g}: give one of those"
            )
        turns, degrees = dict.fromkeys(places, 1 + 0j), dict[int, float]()
        if ends:
            ways = {k: ends[k] - p for k, p in places.items() if k in ends}
            turns, degrees = _turns(ways, begin)
        arm, made = complex(*self.at), {key.frame: key for key in self.keys}
        arm -= _place({k: places[k] for k in turns}, begin)
        for k, turn in turns.items():
            away = places[k] + turn * arm
            place: dict[str, Any] = {"at": (away.real, away.imag)}
            place |= {"angle": degrees[k], "scale": abs(turn)} if degrees else {}
            made[k] = replace(made.get(k, Key(k, **place)), **place)
        if outside == "fade" and not self.keys:
            first, *_, last = (*turns, *turns)  # those that both tracks have
            for k in (first, last):
                made[k] = replace(made[k], strength=1.0)
            for k in (FADE, FADE + 1):  # twice, so that the curve begins and ends without a slope
                made[first - k], made[last + k] = Key(first - k, strength=0.0), Key(last + k, strength=0.0)
        return replace(self, keys=tuple(made[k] for k in sorted(made)))

    @property
    def is_still(self) -> bool:
        """True if it moves nothing: a drag or an angle of 0, or a factor of 1."""
        drags = (self.by, *(by for _, by in self.also), *(np.subtract(p, self.at) for p in self.path))
        return not any(map(any, drags)) and not self.angle and self.factor in (None, 1.0)

    @property
    def handles(self) -> tuple[tuple[Place, Place], ...]:
        """The points of a grab and their drags, in samples: its own, and then those of ``also``."""
        return ((self.at, self.by), *self.also)

    @property
    def direction(self) -> Place | None:
        """The axis of a twist or a pinch, in samples, or the default; None if it has none, as in a plane."""
        if self.axis is not None or self.brush not in ("twist", "pinch") or (self.brush == "twist" and self.ndim == 2):
            return self.axis
        return (0.0, 0.0, 1.0) if self.brush == "twist" else (1.0, 0.0, 0.0)[: self.ndim]


def last_freeze(strokes: Sequence[Stroke]) -> Freeze | None:
    """Return the mask of the last freeze among strokes; None if there is none, or all are hidden."""
    return next((s.matte for s in reversed(strokes) if s.brush == "freeze" and not s.hidden), None)


def _track(points: Sequence[tuple[int, Point]], ndim: int) -> dict[int, complex]:
    """Return the positions of a tracked point by frame, as complex numbers x + iy."""
    keys = checked_keys([Key(k, tuple(at)) for k, at in points], ndim)
    return {key.frame: complex(*key.at or ()) for key in keys}


def _place(places: dict[int, complex], frame: float) -> complex:
    """Return the position at a frame, interpolated between those of a track."""
    found = position([Key(k, (p.real, p.imag)) for k, p in places.items()], frame)
    return complex(*found or ())


def _turns(ways: dict[int, complex], begin: float) -> tuple[dict[int, complex], dict[int, float]]:
    """Return, by frame, the rotation and scaling of a vector since frame ``begin``, and the rotation in degrees."""
    if not ways:
        raise SuppleError("the two tracks have no frame in common: track both points through the same frames")
    for k, way in ways.items():
        if abs(way) < 1:
            raise SuppleError(
                f"the two tracks are at the same place in frame {numbered(k)}: track two points that are apart"
            )
    first = _place(ways, begin)
    turns = {k: way / first for k, way in ways.items()}
    degrees = np.rad2deg(np.unwrap(np.angle(list(turns.values()))))
    degrees -= 360 * np.round(np.interp(begin, list(turns), degrees) / 360)
    return turns, dict(zip(turns, degrees.tolist(), strict=True))


def _known(options: BrushOptions) -> BrushOptions:
    if unknown := sorted(options.keys() - BrushOptions.__annotations__.keys()):
        raise TypeError(f"unexpected keyword argument {unknown[0]!r}")
    return options


def _check_ends(what: str, to: object, by: object) -> None:
    if (to is None) == (by is None):
        raise SuppleError(f"a {what} takes one of to and by, found {'neither' if to is None else 'both'}")


def _points(name: str, values: object) -> npt.NDArray[np.float64]:
    """Return rows of coordinates; `Stroke` checks them."""
    wanted = "points of 2 or 3 numbers each, x first"
    try:
        made = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        refuse(name, wanted, values)
    if made.size and (made.ndim != 2 or made.shape[1] not in (2, 3)):
        refuse(name, wanted, told=f"an array of shape {made.shape}")
    return made


def _number(name: str, value: object, wanted: str, low: float, high: float) -> float | None:
    return None if value is None else number(name, value, wanted, low, high)
