"""Deformation: strokes, affine maps and fields on a domain, and the operations on them."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Concatenate, Literal, ParamSpec, Self, Unpack

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import ROW, numbers
from supple.engine import core
from supple.engine.core import measured, plan_of
from supple.engine.devices import is_on_device
from supple.engine.sampling import DEFAULT, Certificate, Sampling, SamplingFields, warn_of
from supple.engine.work import Mattes, Space, mask_of, on_grid, shown_mask
from supple.errors import FoldWarning, MissWarning, OutsideWarning, SuppleError, argument, numbered, shown, warn
from supple.fields import Field, Placed, check_path, folds_of
from supple.folding.limits import NEAR, farthest
from supple.folding.resolved import FREE_ENOUGH, Resolved, apart, described, freedom_at, padded, spelled
from supple.space.affine import Affine, matrix_rows
from supple.space.checks import (
    Vector,
    assign,
    choice,
    colours_hint,
    flag,
    integer,
    length,
    library_of,
    number,
    point,
    refuse,
    varied,
)
from supple.space.domain import BorderProfile, Domain
from supple.space.freezing import Freeze
from supple.space.geometry import Floats, Grid
from supple.space.straighten import Straighten
from supple.strokes import (
    LEAST,
    MOST,
    PAINTINGS,
    FoldPolicy,
    Recipe,
    Stroke,
    last_freeze,
    pack,
    spoken,
    time_radius_of,
)

_HIT = 1e-6  # samples: a point of a pull this near to its target has arrived
_APART = 0.3  # radii: the least distance between the points that restore and smooth drag
_LAST = "the straightening"  # the name of the map that straightens a picture; the last one
_FREE, _TAKEN = -1, -2  # a point that no later stroke carries away; or one that may be carried away


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """T⁻¹ of some points, with the accuracy of each.

    Parameters
    ----------
    points : float64 array, shape (..., D)
        The source points p, in pixels, x first.
    residual : float64 array, shape (...)
        |T(p) - q|, in pixels, measured at ``points``.
    steps : int64 array, shape (...)
        The number of evaluations of T with its Jacobian, over all strokes.
    converged : bool array, shape (...)
        Whether the residual is at most 1e-6 pixels (beyond 10⁸ pixels, to the accuracy of float64).
    """

    points: Floats
    residual: Floats
    steps: npt.NDArray[np.int64]
    converged: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Certified:
    """Points mapped by a deformation, and the accuracy of each.

    Parameters
    ----------
    points : float64 array, shape (..., D)
        The points, in pixels, x first.
    error : float64 array, shape (...)
        A bound on the distance of each point from its exact image, in physical units (samples times spacing): for
        solved points, four times the remaining Newton step, magnified by the maps after it; and rounding. inf where
        no solution was found.
    converged : bool array, shape (...)
        Whether a solution was found.
    """

    points: Floats
    error: Floats
    converged: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Arrival:
    """The target of a stroke's point, and its actual position. All points are in samples, x first.

    Parameters
    ----------
    target : tuple of float
        ``at + by``.
    arrived : tuple of float
        The position of the point after the stroke.
    final : tuple of float
        The position of the point after all later strokes too.
    miss : float
        The distance from ``arrived`` to ``target``.
    moved : float
        The distance from ``final`` to ``arrived``: the effect of later strokes.
    cause : str or None
        The cause of a miss: ``"fold"``, ``"border"``, ``"freeze"`` for what is frozen, ``"fold and border"``, ``"fold
        and freeze"``; ``"outside"`` if the stroke starts outside a fixed border, where it moves nothing; or None.
    also : tuple of Arrival
        For a pull, the arrivals of its further points, in order.
    carried_by : int or None
        For a grab or a pull, the index of the later stroke that carries the point more than half a sample away;
        None if none does, or one that may do so (see `MissWarning`).
    """

    target: Vector
    arrived: Vector
    final: Vector
    miss: float
    moved: float
    cause: str | None
    also: tuple[Arrival, ...] = ()
    carried_by: int | None = None

    def on(self, grid: Grid, own: Grid) -> Arrival:
        """Return the arrival with its points, which are in samples of ``own``, in samples of ``grid``."""
        target, arrived, final = map(
            tuple, grid.indices(own.positions([self.target, self.arrived, self.final])).tolist()
        )
        miss, moved = math.dist(arrived, target), math.dist(final, arrived)
        also = tuple(one.on(grid, own) for one in self.also)
        return Arrival(target, arrived, final, miss, moved, self.cause, also, self.carried_by)


@dataclass(frozen=True, slots=True)
class Report:
    """The effect of the strokes, and the accuracy of the inverse map.

    Parameters
    ----------
    strokes : int
        The number of strokes given.
    applied : int
        The number of strokes applied: a stroke that flows becomes several.
    damping : tuple of float
        For each given stroke, the applied fraction of its drag: 1 unless it was damped.
    arrivals : tuple of Arrival
        For each given stroke, the target of its point, and its position.
    margin : float
        A lower bound, over all points and strokes, of the smallest eigenvalue of the symmetric part of I + J; of a
        twist that is carried out whole, of the smallest singular value of I + J. It is above 0: no stroke folds. Fields
        are not covered.
    folds : int
        The number of lattice nodes at which the Jacobian determinant is negative. Without fields, ``margin`` proves
        that it is 0.
    tolerance, error : float
        The given tolerance, and the largest distance of a source point of the inverse map from T⁻¹(q), in pixels:
        measured at every pixel, by further Newton steps.
    unconverged : int
        The number of pixels whose error could not be measured, as Newton's method did not converge.
    within : bool
        Whether all pixels converged, and the error is within the tolerance.
    evaluations : float
        Evaluations of T with its Jacobian, for each pixel: far below 1, as most pixels are interpolated.
    """

    strokes: int
    applied: int
    damping: Vector
    arrivals: tuple[Arrival, ...]
    margin: float
    folds: int
    tolerance: float
    error: float
    unconverged: int
    within: bool
    evaluations: float


P = ParamSpec("P")


def _adding(make: Callable[P, Stroke]) -> Callable[Concatenate[Deformation, P], Deformation]:
    """Return the method that adds the stroke of one of `Stroke`'s functions, with its parameters and documentation."""

    def method(self: Deformation, /, *args: P.args, **options: P.kwargs) -> Deformation:
        return self.add(make(*args, **options))

    own = inspect.signature(make)
    first = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    method.__signature__ = own.replace(parameters=[first, *own.parameters.values()])  # type: ignore[attr-defined]
    method.__name__ = make.__name__
    method.__qualname__ = f"Deformation.{make.__name__}"
    stroke = "Return a stroke that"
    method.__doc__ = (make.__doc__ or "").replace(stroke, "Return the deformation with one more stroke, which", 1)
    return method


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Deformation:
    """Strokes on a domain: the map T from each point of the input to its place in the output, and its inverse.

    An immutable value: `grab`, `add`, `affine` and `field` return a new one. Elements apply one after the other, each
    on the result of the last one, and their composition is inverted as a whole, so that an image is sampled once. No
    stroke folds; a field may.

    Parameters
    ----------
    shape : sequence of int or Grid
        The array's shape: ``(H, W)`` for an image, ``(T, H, W)`` or ``(Z, H, W)``; or the grid of the image or the
        volume, with its shape, its spacing, and its position in space, which fields and affine maps refer to.
    border : "auto", float, sequence of float or None
        The width over which strokes fade towards the fixed border: in physical units, one for all axes or one for
        each, x first; ``"auto"``: a tenth of each axis' extent; None: the border is free.
    border_profile : str
        The profile of the fade: ``"quartic"``, smooth where the border ends, or the paper's ``"sine"``.
    spacing : float or sequence of float
        Physical units per sample, x first.
    time : bool
        Whether the first of three axes is time.
    on_fold : str
        The policy for a stroke that would fold the image over itself, or that the border holds back: let it ``"flow"``
        to its target in smaller steps; ``"damp"`` it to a safe length, with a warning; or raise a `FoldError`
        (``"error"``).
    freeze : array or Freeze, optional
        The freeze mask: an array of the shape, True (or white) where strokes shall move nothing; or a `Freeze`, for
        another width of the fade (`Freeze.of`). A clip also takes a mask of shape (H, W), for all its frames.

    Notes
    -----
    The brushes (`grab`, `pull`, `twist`, `scale`, `pinch`) share these parameters: ``at``, their point, in pixels, x
    first (the pivot of a twist, a scale or a pinch stays where it is); ``radius``, that of the brush, in physical units
    (ε of the regularized Kelvinlet); ``reach``, in radii, from 1, beyond which samples keep every bit (the default of 4
    looks as natural as no limit, None); ``strength``, the applied part of the movement, from -1 to 2; and ``poisson``,
    the Poisson ratio ν of the material, at most 0.5 (incompressible; 0.4 by default; and -inf, by default for a drag
    along time alone, has no displacement across the drag).

    In a clip (``time``), brushes are ellipsoids: ``time_radius`` is the radius in frames, by default the larger of the
    drag in time and an eighth of the clip, at most the radius. A drag in the plane moves nothing in time, and one in
    time nothing in the plane, unless a ``poisson`` is given, by which all three axes are one material.

    They raise `SuppleError` if an argument is invalid, if the stroke cannot reach its target, or if no sample is within
    its reach, and `FoldError` if it would fold, or be held back, under ``on_fold="error"``. They warn if the stroke
    starts outside the samples (`OutsideWarning`); if it was damped, under ``on_fold="damp"`` (`FoldWarning`); if a
    freeze mask or a border keeps its point more than half a pixel from the target; and if it carries the point of an
    earlier stroke that far away, unless it begins within a tenth of its radius of that point (both `MissWarning`).

    Examples
    --------
    >>> import numpy as np
    >>> d = Deformation((512, 512)).grab((256, 256), to=(256, 346), radius=100)
    >>> out = d.warp(np.zeros((512, 512, 3), np.uint8))
    >>> d.forward((256, 256))
    array([256., 346.])
    """

    domain: Domain
    on_fold: FoldPolicy
    strokes: tuple[Stroke, ...]
    _resolved: tuple[Resolved, ...] = field(repr=False)
    _space: Space = field(repr=False)  # of the strokes alone
    grid: Grid = field(repr=False)
    maps: tuple[Placed, ...] = field(repr=False)
    output: Grid = field(repr=False)
    straightened: Straighten | None = field(repr=False)
    # For each point of each stroke: where it arrived, that place moved by later maps alone, and where it is now.
    # In physical units, shape (N, 3, 3).
    _points: Floats = field(repr=False)
    _carriers: npt.NDArray[np.int64] = field(repr=False)

    def __init__(
        self,
        shape: Sequence[int] | Grid,
        *,
        border: float | Sequence[float] | Literal["auto"] | None = "auto",
        border_profile: BorderProfile = "quartic",
        spacing: float | Sequence[float] = 1.0,
        time: bool = False,
        on_fold: FoldPolicy = "flow",
        freeze: npt.ArrayLike | Freeze | None = None,
    ) -> None:
        choice("on_fold", on_fold, ("damp", "flow", "error"))
        own = shape if isinstance(shape, Grid) else None
        if own is not None:
            if spacing != 1.0:
                refuse("spacing", "left out beside a grid, which has one", spacing)
            if own.shear:
                refuse("shape", "a grid whose axes are at right angles (Grid.upright makes one)", shape)
            spacing = own.spacing
        sizes = shape.shape if isinstance(shape, Grid) else shape
        if freeze is not None and not isinstance(freeze, Freeze):
            freeze = _freeze_of(freeze, Domain(sizes, spacing, time=time))
        domain = Domain(sizes, spacing, border, border_profile, time, freeze)
        if own is not None and freeze is not None and freeze.place:
            _check_place(freeze, own)
        grid = own or Grid(domain.shape, domain.spacing)
        axes = domain.packed()
        if domain.ndim == 2:
            axes[2, 2] = 0.0  # nothing leaves the plane of an image, so that the field off it does not matter
        height, width = domain.shape[-2:]
        count = domain.shape[0] if domain.ndim == 3 else 1
        space = Space(np.zeros((0, ROW)), axes, domain.ndim, count, (height, width), freeze=mask_of(domain))
        assign(self, domain=domain, on_fold=on_fold, strokes=(), _resolved=(), _space=space, grid=grid, output=grid)
        assign(self, maps=(), straightened=None, _points=np.zeros((0, 3, 3)), _carriers=np.zeros(0, np.int64))

    @classmethod
    def from_recipe(
        cls,
        recipe: Recipe,
        shape: Sequence[int] | Grid,
        *,
        spacing: float | Sequence[float] = 1.0,
        time: bool = False,
        maps: Sequence[Placed] = (),
        warn: bool = True,
        roaming: Collection[int] = (),
        say: Callable[[str, type[Warning]], None] | None = None,
    ) -> Self:
        """Return a recipe's strokes on a domain, without hidden ones; errors and warnings name the stroke.

        ``maps`` are fields and affine maps between the strokes. ``warn`` says whether to warn of fields that fold.
        Strokes with the indices ``roaming`` may start outside the domain without a warning. ``say`` is called in place
        of ``warnings.warn``.

        An amount of the recipe, or a strength of a stroke, below 1 applies that fraction of the stroke's drag. Pivots
        of later strokes move with the material under them, which has then moved less: each is mapped back through the
        earlier strokes at full strength, and forward through them as applied. ``strokes`` of the result are those in
        effect.

        Raises
        ------
        SuppleError
            As `grab` does; if a stroke starts outside the domain, and nothing of it reaches a sample; or if the recipe
            was made for another size (`Recipe.fitted` makes it fit), is in millimetres (`supple.warp_file` takes it),
            or has strokes with keys (`Recipe.at_frame` gives it without).

        Warns
        -----
        OutsideWarning
            If a stroke starts outside the domain.
        FoldWarning, MissWarning
            As `grab` and `field` do.
        """
        if not isinstance(recipe, Recipe):
            refuse("a recipe", "a Recipe (Recipe.from_json reads one)", recipe)
        if recipe.is_world:
            raise SuppleError(f"the recipe is in {recipe.space} millimetres, which only files of volumes have")
        if recipe.moves:
            raise SuppleError(
                "the recipe's strokes move from frame to frame (keys), and this is one map: warp a whole clip, or give "
                "the recipe of one frame"
            )
        made = cls(
            shape,
            border=recipe.border,
            border_profile=recipe.border_profile,
            spacing=spacing,
            time=time,
            on_fold=recipe.on_fold,
            freeze=recipe.freeze,
        )
        size = made.shape[::-1]
        if recipe.strokes and recipe.size is not None and len(recipe.size) == len(size) and recipe.size != size:
            raise SuppleError(
                f"the recipe was made for {spoken(recipe.size)}, and the shape is of {spoken(size)}: "
                "Recipe.fitted makes it fit"
            )
        visible = [(i, stroke) for i, stroke in enumerate(recipe.strokes) if not stroke.hidden]
        whole: Deformation = made  # at full strength; the same object as ``made`` as long as they are equal
        for placed in maps:
            if placed.after == 0:
                made = whole = made._with(placed, warn)
        for k, (i, stroke) in enumerate(visible):
            which = f"stroke {i + 1} of {len(recipe.strokes)}: " if len(recipe.strokes) > 1 else ""
            try:
                before, made = made, made.add(reduced(stroke, recipe.amount, whole, made), warn=False)
                if k < len(visible) - 1:
                    whole = after(stroke, recipe.amount, whole, before, made)
                outside = None if i in roaming else last_outside(made)
            except SuppleError as error:
                raise type(error)(f"{which}{error}") from None
            part, whole_part = part_of(stroke, recipe.amount), recipe.amount * stroke.strength
            more = f"{whole_part:.0%} is more than a stroke can be: {part:.0%} is carried out"
            _warn(None if part == whole_part or stroke.brush == "freeze" else f"{which}{more}", FoldWarning, say)
            _warn(outside and f"{which}{outside}", OutsideWarning, say)
            _warn(*_missed(made._resolved[-1], which), say)
            last = visible[k + 1][0] if k + 1 < len(visible) else len(recipe.strokes)
            for placed in maps:
                if i < placed.after <= last:
                    same = whole is made
                    made = made._with(placed, warn)
                    whole = made if same else whole._with(placed, False)
        _warn(made._carried(0, [i for i, _ in visible], len(recipe.strokes)), MissWarning, say)
        return made if recipe.straighten is None else made.straighten(recipe.straighten)

    def without_strokes(self) -> Self:
        """Return the identity on the same domain, with the same fold policy."""
        domain = self.domain
        return type(self)(
            self.grid,
            border=domain.border,
            border_profile=domain.border_profile,
            time=domain.time,
            on_fold=self.on_fold,
            freeze=domain.freeze,
        )

    @property
    def recipe(self) -> Recipe:
        """The recipe in effect, with its size; hidden strokes are left out."""
        return Recipe(
            border=self.domain.border,
            border_profile=self.domain.border_profile,
            on_fold=self.on_fold,
            strokes=self.strokes,
            size=self.shape[::-1],
            freeze=self.domain.freeze,
            straighten=self.straightened,
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the arrays that it warps."""
        return self.domain.shape

    @property
    def ndim(self) -> int:
        """The number of coordinates of a point."""
        return self.domain.ndim

    @property
    def space(self) -> Space:
        """The packed map and domain, as the core takes them."""
        plain = not self.maps and self.output is self.grid
        return self._space if plain else self.space_on(None, check=False)

    def space_on(
        self, grid: Grid | None, source: Grid | None = None, *, check: bool = True, inverse: bool = False
    ) -> Space:
        """Return the packed map, with the grid of the output if it is not that of the input.

        ``source`` is the grid of the input if it differs from the deformation's: that of a sheared volume, whose
        deformation is on the upright grid around it. ``check`` says whether to check that fields overlap the grids on
        which they are used; ``inverse``, whether the map is T⁻¹.

        Raises
        ------
        SuppleError
            If a field does not overlap the output's grid, or the region to which the maps before it lead; or if the
            inverse of a straightened picture is asked for.
        """
        plain = self._space
        if inverse and self.straightened is not None:
            raise SuppleError("straightening has no inverse here, as the result has another size: leave it out")
        inverse = inverse and not self.is_identity
        if grid is None and self.output is not self.grid:
            grid = self.output
        if grid is None and source is None and not self.maps and not inverse:
            return plain
        if check and self.maps:
            led = [replace(each, inverse=not each.inverse) for each in self.maps] if inverse else reversed(self.maps)
            check_path(led, grid or source or self.grid)
        own = source or self.grid
        if leans := own != self.grid:
            plain = replace(plain, count=own.shape[0] if self.ndim == 3 else 1, shape=(own.shape[-2], own.shape[-1]))
            if grid is None and self.is_identity:
                return plain
        frame, done = _frame(self.grid), 0
        parts: list[_core.Part] = []
        for placed in self.maps:
            if placed.row > done:
                parts.append(("strokes", plain.rows[done : placed.row], False))
            done = placed.row
            kind, held, pulled = placed.packed(frame)
            parts.append((kind, held, not pulled))  # T is the push map
        regrid, whole = None, own if grid is None else grid.uncropped()
        moved = not whole.is_same_space(own)
        if leans or moved:
            regrid = np.diag([*own.spacing, 1.0]) @ np.linalg.inv(whole.matrix) @ frame
        if grid is not None and not moved and grid.shape == own.shape:
            grid = None
        if not self.maps and regrid is None and not inverse:
            return on_grid(plain, grid) if grid else plain
        if done < len(plain.rows):
            parts.append(("strokes", plain.rows[done:], False))
        if inverse:
            parts = [(kind, held, not undone) for kind, held, undone in reversed(parts)]
        if leans:
            parts.insert(0, ("affine", matrix_rows(np.linalg.inv(frame) @ _frame(own)), False))
        if regrid is not None:
            parts.append(("affine", matrix_rows(regrid), False))
        axes = Domain(own.shape, own.spacing).packed() if leans else plain.axes.copy()
        axes[:, 2] = -1.0  # the border applies to the strokes, which have it already
        composite = _core.Composite(self.ndim, plain.axes, parts, plain.freeze)
        return replace(plain, axes=axes, composite=composite, grid=grid)

    @property
    def is_identity(self) -> bool:
        """True if the map is the identity: it has no fields or affine maps, and no stroke with any force."""
        return self._space.rows.size == 0 and not self.maps and self.output is self.grid

    grab = _adding(Stroke.grab)
    pull = _adding(Stroke.pull)
    push = _adding(Stroke.push)
    twist = _adding(Stroke.twist)
    scale = _adding(Stroke.scale)
    pinch = _adding(Stroke.pinch)

    def restore(
        self, at: npt.ArrayLike, *, radius: float, strength: float | Sequence[float] = 1.0, warn: bool = True
    ) -> Self:
        """Return the deformation with one more stroke, which brings the material around points back to its origin.

        The stroke is a pull of the points, and of some around them, to where they came from; it moves nothing beyond
        two radii of their paths. ``at`` is a point of the output, or several (N, D), half a radius apart along the path
        of a brush. ``strength`` is the fraction of the way back, one for all points or one for each; ``warn`` is as in
        `add`, and errors are those of all brushes.
        """
        return self._led(at, radius, strength, "restore", self._displaced, warn)

    def smooth(
        self, at: npt.ArrayLike, *, radius: float, strength: float | Sequence[float] = 1.0, warn: bool = True
    ) -> Self:
        """Return the deformation with one more stroke, which relaxes the displacement around points.

        The stroke is a pull of the points, and of some around them, each to the mean displacement of its surroundings
        at a distance of one radius; it moves nothing beyond two radii of their paths. The arguments are those of
        `restore`.
        """

        def rough(points: Floats) -> Floats:
            around = points[:, None] + radius * self._directions() / np.array(self.domain.spacing)
            return np.asarray(self._displaced(points) - self._displaced(around).mean(axis=1))

        return self._led(at, radius, strength, "smooth", rough, warn)

    def _displaced(self, points: Floats) -> Floats:
        """Return q - T⁻¹(q)."""
        return np.asarray(points - self.inverse(points).points)

    def _directions(self) -> Floats:
        """Return unit vectors (N, D) around a point: to the corners of a hexagon in a frame, or of an icosahedron."""
        if self.ndim == 3 and not self.domain.time:
            golden = (1 + math.sqrt(5)) / 2
            corners = [(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
            turned = [corner[k:] + corner[:k] for k in range(3) for corner in corners]
            return np.array(turned) / math.hypot(1, golden)
        angles = np.arange(6) * math.pi / 3
        made = np.zeros((6, self.ndim))
        made[:, 0], made[:, 1] = np.cos(angles), np.sin(angles)
        return made

    def _led(
        self,
        at: npt.ArrayLike,
        radius: float,
        strength: float | Sequence[float],
        name: str,
        errors: Callable[[Floats], Floats],
        warn: bool,
    ) -> Self:
        """Return the deformation with a pull that removes a fraction of the errors of points and their surroundings."""
        n, spacing = self.ndim, np.array(self.domain.spacing)
        centres = np.array([point("at", p, (n,)) for p in np.atleast_2d(np.asarray(at, object)).tolist()])
        amounts = strength if isinstance(strength, Sequence) else [strength] * len(centres)
        radius, wanted = length("radius", radius), "a number from 0 to 1, or one for each point"
        parts = np.array([number("strength", part, wanted, 0.0, 1.0) for part in amounts])
        if len(parts) != len(centres):
            refuse("strength", wanted, strength)
        ring = np.concatenate([np.zeros((1, n)), 0.5 * radius * self._directions()])
        points, part = np.empty((0, n)), np.empty(0)
        for places, amount in zip((centres * spacing)[:, None] + ring, parts, strict=True):
            far = np.linalg.norm(places[:, None] - points, axis=2).min(axis=1, initial=np.inf) > _APART * radius
            points, part = np.concatenate([points, places[far]]), np.append(part, np.full(far.sum(), amount))
        points, part = points / spacing, part[:, None]
        first, last = (x[:n] / spacing for x in self.domain.packed()[:, :2].T)
        # With a fixed border, only points at least a sample inside move; those at the ends of a clip keep their time.
        held = np.full(n, 0.0 if self.domain.border is None else 1.0)
        low, high = first + held, last - held
        if self.domain.time:
            held[2] = 0.0
        moves = np.all((points > first + held) & (points < last - held), axis=1)
        moves &= freedom_at(padded(points, self.domain), self._frozen) > FREE_ENOUGH
        points, part = points[moves], part[moves]
        if not len(points):
            refuse("at", "a point within the domain that is not frozen", at)
        targets = points - part * errors(points)
        if self.domain.border is not None:
            targets = np.clip(targets, low, high)
        if self.domain.time:
            ends = (points[:, 2] <= low[2]) | (points[:, 2] >= high[2])
            targets[ends, 2] = points[ends, 2]
        stroke = Stroke.pull(points, to=targets, radius=0.5 * radius, reach=3.0)
        return self.add(replace(stroke, name=name), warn=warn)

    def freeze(self, mask: npt.ArrayLike | Freeze | None) -> Self:
        """Return the deformation with a freeze mask for later strokes: these move nothing that it freezes.

        In frozen samples, T⁻¹ stays that of the strokes so far, bit for bit, whatever follows. The mask replaces the
        one before it; that of the deformation (``freeze=``) holds from the first stroke on. Positions in it are those
        of the picture after the strokes so far.

        Parameters
        ----------
        mask : array or Freeze or None
            As `Deformation` takes it; None to freeze nothing from here on.
        """
        if mask is None:
            n = 2 if self.domain.time else self.ndim
            mask = Freeze.free(self.shape[-n:], self.domain.spacing[:n])
        freeze = mask if isinstance(mask, Freeze) else _freeze_of(mask, self.domain)
        return self.add(Stroke.freeze(freeze, ndim=self.ndim))

    def add(self, stroke: Stroke, *, warn: bool = True) -> Self:
        """Return the deformation with one more stroke, applied to the result of the strokes so far.

        Parameters
        ----------
        stroke : Stroke
            A hidden one is not added: the deformation is returned unchanged. A strength other than 1 applies, and
            records, that fraction of the drag; beyond 1, or below 0, as much of it as is possible.
        warn : bool
            Whether to warn if it starts outside the samples or misses its target, and to refuse it if it reaches no
            sample; `warnings` has the text of a miss too. Errors and warnings are those of all brushes.
        """
        if not isinstance(stroke, Stroke):
            refuse("a stroke", "a Stroke", stroke)
        if stroke.ndim != self.ndim:
            raise SuppleError(
                f"{described(stroke)} has a point of {stroke.ndim} numbers, and a point of {self._kind} has "
                f"{self._coordinates}{colours_hint(self.shape)}"
            )
        if self.straightened is not None:
            raise SuppleError("straightening comes last: give strokes before it, where their points are")
        if stroke.hidden:
            return self
        if stroke.changes:
            raise SuppleError(
                "the stroke moves from frame to frame (keys, or a matte), and this is one map: give that of a frame"
            )
        if stroke.time_radius is not None and not self.domain.time:
            raise SuppleError(f"{argument('time_radius')} is for clips, and this is {self._kind}: leave it out")
        stroke = reduced(stroke, 1.0, self, self)
        domain, freeze = self._masked(stroke), self._space.freeze
        mask, row = None if domain is self.domain else mask_of(domain), len(self._space.rows)
        if stroke.brush == "freeze":
            if domain.freeze and domain.freeze.place:
                _check_place(domain.freeze, self.grid)
            resolved = Resolved(pack([], domain.spacing), stroke.at)  # it only affects later strokes
        else:
            if self.strokes and self.strokes[-1].brush == "freeze":
                held = mask_of(self._frozen)
                if row == 0:
                    freeze = held
                elif held is not freeze:
                    freeze, _ = Mattes.adding(freeze, held, row)
            stroke, resolved = farthest(stroke, domain, self.on_fold)
            if domain is not self.domain and mask is not shown_mask(freeze):
                freeze, number = Mattes.adding(freeze, mask)
                table = resolved.rows.copy()
                table["mask"] = number
                resolved = replace(resolved, rows=table)
        rows = np.concatenate([self._space.rows, numbers(resolved.rows)])
        space = replace(self._space, rows=rows, freeze=freeze)
        made = varied(
            self,
            strokes=(*self.strokes, stroke),
            _resolved=(*self._resolved, resolved),
            _space=space,
            **self._after(stroke, resolved, space),
        )
        if warn:
            _warn(last_outside(made), OutsideWarning)
            _warn(*_missed(resolved))
            _warn(made._carried(len(self.strokes), range(len(made.strokes)), len(made.strokes)), MissWarning)
        return made

    def _masked(self, stroke: Stroke) -> Domain:
        """Return the domain with a stroke's mask: that of a freeze, or the matte times the freeze mask in effect."""
        domain, matte = self._frozen, stroke.matte
        if stroke.brush == "freeze":
            return domain.frozen(matte)
        if matte is None:
            return domain
        sizes = domain.shape[::-1]
        if matte.samples != sizes[: matte.ndim] or (matte.ndim < self.ndim and not domain.time):
            name = f"the matte {shown(matte.name)}" if matte.name else "the matte"
            held, wanted = spoken(matte.samples), spoken(sizes)
            raise SuppleError(
                f"{name} is of {held} samples, and what is deformed of {wanted}: give a matte of its size"
            )
        return domain.frozen(matte if mask_of(domain) is None or domain.freeze is None else matte.times(domain.freeze))

    @property
    def _frozen(self) -> Domain:
        """The domain with the freeze mask of the next stroke."""
        last = last_freeze(self.strokes)
        return self.domain if last is None else self.domain.frozen(last)

    def _after(self, stroke: Stroke, resolved: Resolved, space: Space) -> dict[str, npt.NDArray[Any]]:
        """Return ``_points`` and ``_carriers`` after one more stroke."""
        own = padded([at for at, _ in stroke.handles], self.domain)
        points = np.concatenate([self._points[:, 2], own])
        if len(resolved.rows):
            points, _ = _core.forward(numbers(resolved.rows), self._space.axes, points, False, space.freeze)
        points[len(self._points)] = padded(resolved.arrived, self.domain)
        known, carriers, now = self._points.copy(), self._carriers.copy(), points[: len(self._points)]
        off = np.linalg.norm((now - known[:, 1])[:, : self.ndim] / self.domain.spacing, axis=1)
        if len(fresh := np.flatnonzero((off > NEAR) & (carriers == _FREE))):
            grip = max(0.1 * stroke.radius, NEAR * min(self.domain.spacing))
            taken = np.linalg.norm(known[fresh, 2, None] - own, axis=2).min(axis=1) <= grip
            if self.strokes[-1].is_image(stroke):
                taken |= fresh >= len(known) - len(self.strokes[-1].handles)
            carriers[fresh] = np.where(taken | (stroke.name in PAINTINGS), _TAKEN, len(self.strokes))
        carriers[(off <= NEAR) & (carriers >= 0)] = _FREE
        known[:, 2] = now
        new = np.repeat(points[len(known) :, None], 3, axis=1)
        aimed = stroke.brush == "grab" and stroke.name not in PAINTINGS
        free = np.full(len(new), _FREE if aimed else _TAKEN)
        return {"_points": np.concatenate([known, new]), "_carriers": np.concatenate([carriers, free])}

    def _carried(self, first: int, shown: Sequence[int], count: int) -> str | None:
        """Return the warning of points carried away by strokes from index ``first`` on; None if there are none.

        ``shown`` are the indices of the strokes in the user's list, and ``count`` is its length, for the message.
        """
        carried = np.flatnonzero(self._carriers >= first).tolist()
        if not carried:
            return None
        worst: dict[int, tuple[float, int, str]] = {}
        owners = np.repeat(np.arange(len(self.strokes)), [len(stroke.handles) for stroke in self.strokes])
        for k in carried:
            here, there = (self._points[k, 1:, : self.ndim] / self.domain.spacing).tolist()
            found = math.dist(here, there), int(self._carriers[k]), apart(here, there, self.domain)
            worst[owners[k]] = max(found, worst.get(owners[k], found))
        (i, (_, j, far)), *more = sorted(worst.items(), key=lambda pair: -pair[1][0])
        one, other = self.strokes[i], self.strokes[j]
        both = ", or both at once, as a pull" if one.brush == other.brush == "grab" else ""
        text = (
            f"stroke {shown[j] + 1} of {count}, {described(other)}, carries {'a' if one.also else 'the'} point of "
            f"stroke {shown[i] + 1}, {described(one)}, away by {far}: apply stroke {shown[i] + 1} later{both}"
        )
        some = [f"; stroke {shown[j] + 1} that of stroke {shown[i] + 1} by {far}" for i, (_, j, far) in more[:3]]
        return "".join([text, *some, f"; and {len(more) - 3} more" if len(more) > 3 else ""])

    @property
    def _kind(self) -> str:
        return "a picture" if self.ndim == 2 else "a clip" if self.domain.time else "a volume"

    @property
    def _coordinates(self) -> str:
        return "2 numbers, x and y" if self.ndim == 2 else f"3 numbers, x, y and {'t' if self.domain.time else 'z'}"

    def affine(self, matrix: npt.ArrayLike | Affine, *, inverse: bool = False) -> Self:
        """Return the deformation with an affine map after the elements so far.

        Parameters
        ----------
        matrix : array_like, shape (D, D + 1) or (D + 1, D + 1), or Affine
            The map of positions (see `grid`), from a point of the output to its source point in the input (pull),
            as resampling tools take it.
        inverse : bool
            Whether to apply the inverse: a point of the input goes where the matrix says (push).
        """
        return self._with(Placed(matrix if isinstance(matrix, Affine) else Affine(matrix), inverse))

    def field(self, field: Field, *, inverse: bool = False) -> Self:
        """Return the deformation with a displacement field after the elements so far.

        Parameters
        ----------
        field : Field
            From a point of the output to its source point in the input (pull), as resampling tools take it.
        inverse : bool
            Whether to apply the inverse: a point x of the input goes to x + u(x) (push). It is solved at every pixel.

        Warns
        -----
        FoldWarning
            If it is inverted and folds: where folded cells are mapped to, the inverse is one of several points.
        """
        if not isinstance(field, Field):
            refuse("field", "a Field (Field.from_array makes one)", field)
        return self._with(Placed(field, inverse))

    def straighten(self, how: Straighten | None = None, *, sizes: Sequence[int] | None = None, **options: Any) -> Self:
        """Return the deformation of a picture that is straightened after all strokes, in the same resampling.

        It comes last; `output` is then the grid of the result, which `warp` uses. Empty parts get the fill value
        (``fill``, by default 0: transparent, if there is opacity), unless ``outside`` is given.

        Parameters
        ----------
        how : Straighten, optional
            By default, one that changes nothing.
        sizes : sequence of int, optional
            The width and height of the whole picture, whose first pixel is at (0, 0), if this is a part of it.
        **options
            Fields to replace, by name: ``d.straighten(rotate=5)``.

        Examples
        --------
        >>> d = Deformation((400, 600)).straighten(rotate=5)
        >>> d.warp(np.zeros((400, 600), np.uint8)).shape
        (354, 532)
        """
        straighten = replace(how or Straighten(), **options)
        if self.ndim != 2:
            raise SuppleError(f"straightening is for pictures, and this is {self._kind}: leave it out")
        if self.straightened is not None:
            raise SuppleError("the deformation is straightened already: give all of it at once")
        if len(set(self.grid.spacing)) > 1:
            refuse("spacing", "the same along both axes of what is straightened", self.grid.spacing)
        found, (width, height) = straighten.on(self.shape[::-1] if sizes is None else tuple(sizes))
        start = self.grid if sizes is None else Grid(self.shape)
        shift = start.matrix
        if width * height == math.prod(self.shape) and np.array_equal(found.matrix, np.eye(3)):
            made = self
        else:
            matrix = shift @ found.matrix @ np.linalg.inv(shift)
            made = self._with(Placed(type(found)(matrix), name=_LAST))
        output = Grid((height, width), start.spacing, start.origin, start.direction)
        return varied(made, straightened=straighten, output=self.grid if output == self.grid else output)

    def filling(self, sampling: Sampling, options: SamplingFields) -> SamplingFields:
        """Return the options, with ``outside="constant"`` by default if straightening leaves empty parts."""
        gaps = sampling is DEFAULT and self.straightened is not None and self.straightened.has_gaps
        return {"outside": "constant", **options} if gaps else options

    def behind(self, maps: Sequence[Placed], grid: Grid | None = None) -> Self:
        """Return the deformation with fields and affine maps before its strokes; the points of these do not change.

        ``grid`` replaces its own grid, if that has no position in space.
        """
        place = {} if grid is None else {"grid": grid, "output": grid}
        return varied(self, maps=(*(replace(each, after=0, row=0) for each in maps), *self.maps), **place)

    def _with(self, placed: Placed, warn: bool = True) -> Self:
        if self.straightened is not None:
            raise SuppleError("straightening comes last: give fields and affine maps before it")
        if placed.map.ndim != self.ndim:
            what = "field" if isinstance(placed.map, Field) else "affine map"
            raise SuppleError(f"the {what} has {placed.map.ndim} axes, and the shape {self.shape} has {self.ndim}")
        if warn:
            warn_of(Certificate(), math.inf, folds_of([placed]))
        here, points = replace(placed, after=len(self.strokes), row=len(self._space.rows)), self._points.copy()
        if len(points):
            points[:, 1:] = self._moved(placed, points[:, 1:].reshape(-1, 3)).reshape(-1, 2, 3)
        return varied(self, maps=(*self.maps, here), _points=points)

    def forward(self, points: npt.ArrayLike) -> Floats:
        """Return T of points: the positions of input points in the output.

        Parameters
        ----------
        points : array_like, shape (..., D)
            In pixels, x first; on a CUDA device, of float32 or float64, and the result is there too.

        Returns
        -------
        float64 array, shape (..., D)
        """
        found, certificate = place_of(points).forward(self.space, points)
        warn_of(certificate, 1.0)
        return found  # type: ignore[no-any-return]

    def jacobian(self, points: npt.ArrayLike) -> Floats:
        """Return ∂T/∂p = I + J of all strokes together, at points as `forward` takes them.

        Returns
        -------
        float64 array, shape (..., D, D)
            Row i, column j is ∂T_i/∂x_j, in pixels per pixel.
        """
        found, certificate = place_of(points).forward(self.space, points, matrices=True)
        warn_of(certificate, 1.0)
        return found  # type: ignore[no-any-return]

    def inverse(self, points: npt.ArrayLike) -> Inverse:
        """Return T⁻¹ of points: the input points of output points; each is solved, not interpolated.

        Parameters
        ----------
        points : array_like, shape (..., D)
            In pixels, x first. They may lie outside the domain. On a CUDA device, points and results are of float32 or
            float64.

        Returns
        -------
        Inverse

        Warns
        -----
        FoldWarning, OutsideWarning
            If an inverted field folds at some of the points, or no point of its grid leads to them.
        """
        found, certificate = place_of(points).inverse(self.space, points)
        warn_of(certificate, 1.0)
        return Inverse(*found)

    def certified(self, points: npt.ArrayLike, *, inverse: bool = False) -> Certified:
        """Return T of points, or T⁻¹, with a bound on the error of each.

        Parameters
        ----------
        points : array_like, shape (..., D)
            In pixels, x first.
        inverse : bool
            Whether to apply T⁻¹.

        Warns
        -----
        FoldWarning, OutsideWarning
            If a field that has to be inverted folds at some of the points, or no point of its grid leads to them.
        """
        found, certificate = core.certified(self.space, points, back=flag("inverse", inverse))
        warn_of(certificate, 1.0)
        return Certified(*found)

    def inverse_map(self, *, tolerance: float = 0.01, like: Any = None) -> npt.NDArray[np.float32]:
        """Return the source point of every output pixel.

        Parameters
        ----------
        tolerance : float
            The largest distance of a source point from T⁻¹(q), in pixels, before it is rounded to float32.
        like : array on a CUDA device, optional
            An array whose library and device the map shall have: by default, it is NumPy's.

        Returns
        -------
        float32 array, shape (*shape, D)
            In pixels, x first: ``cv2.remap`` takes ``map[..., 0]`` and ``map[..., 1]``.
        """
        tolerance = number("tolerance", tolerance, "a number of pixels from 1e-9 to 1e9", 1e-9, 1e9)
        space = self.space_on(None)
        if like is None:
            found, certificate = core.inverse_map(space, tolerance)
        elif is_on_device(like):
            found, certificate = place_of(like).inverse_map(space, tolerance, like)
        else:
            refuse("like", "an array on a CUDA device, or left out", like)
        warn_of(certificate, tolerance)
        return found

    def warp(
        self,
        source: Any,
        *,
        sampling: Sampling = DEFAULT,
        alpha: bool | None = None,
        clamp: bool = False,
        device: str = "cpu",
        out: npt.NDArray[Any] | None = None,
        grid: Grid | None = None,
        inverse: bool = False,
        **options: Unpack[SamplingFields],
    ) -> Any:
        """Warp an image or a stack of frames.

        Parameters
        ----------
        source : array of shape (H, W[, C]) or (T, H, W[, C]), Picture, or image of SimpleITK or nibabel
            A picture, as `supple.media.image.read` returns it, says itself which channel is opacity; for its array
            alone, ``alpha`` has to say so. Arrays are of bool, integers or floats. Frames are read, and their results
            written, a few at a time, so that both may be memory-mapped. An array on an NVIDIA GPU (PyTorch's, CuPy's,
            Numba's, or any with DLPack or ``__cuda_array_interface__``) is warped there, on its library's current
                stream. For an image of SimpleITK or nibabel, the deformation must have its
                shape and spacing (``Deformation(supple.grid_of(image))``); a volume is sampled alike along all axes
            unless ``between`` is given, components and times are channels, and none is opacity by default.
        sampling : Sampling, optional
            How the source is sampled: the filter, the tolerance, the boundary mode and fill value, and so on.
        alpha : bool, optional
            Whether the last channel is opacity, by which the others are weighted while they are filtered; full opacity
            is the largest value of an integer type, and 1 of floats. By default, the last of exactly four channels of 8
            or 16 bits is opacity.
        clamp : bool
            Whether to clamp the result to the finite range of the source (and ``fill``, if it is visible), which cubic
            filters overshoot beside sharp edges. Only for arrays in host memory, not on a CUDA device.
        device : str
            The ``"cpu"``, as ``"auto"`` is; or ``"cuda"``, which sends the array to an NVIDIA GPU in slabs, so that it
            need not fit its memory.
        out : array, optional
            The array for the result, of its shape and type, and not overlapping ``source``.
        grid : Grid, optional
            The grid of the output; by default, that of the input. `supple.grid_of` reads that of another image. On
            a part of the grid, ``d.grid.crop(…)``, the result equals that part of the whole, bit for bit, and costs
            in proportion.
        inverse : bool
            Whether to apply T⁻¹ in place of T, which undoes a warp. Each pixel p of the result is the source's
            sample at T(p), which is explicit, so the inverse is as exact as the map.
        **options
            Fields of the sampling to replace, by name: ``d.warp(image, filter="linear", outside="reflect")``.

        Returns
        -------
        array, Picture or image
            The result, of the source's shape, or the grid's, and type. An exact copy if the map is the identity. An
            image has the geometry and the header of the source, or the grid's position; integers that nibabel scales
            become true values in float32 (float64 if they have 32 bits or more).

        Raises
        ------
        SuppleError
            If an argument does not fit, or the device cannot be used, or fails.

        Warns
        -----
        ToleranceWarning
            If the checks of the map's cells do not promise the tolerance everywhere.
        GapWarning
            If samples of a picture are NaN, infinite or marked as no data.
        """
        # Imported here to keep `import supple` fast.
        from supple.arrays import warp_array, warp_picture

        inverse = flag("inverse", inverse)
        plain = self.domain.time and not self.maps and grid is None and device != "cuda" and not inverse
        sampling = Sampling.of(sampling, self.filling(sampling, options), self._space.ndim, flow=plain)
        clamp = flag("clamp", clamp)
        if grid is not None:
            if not isinstance(grid, Grid):
                refuse("grid", "a Grid", grid)
            if grid.ndim != self.ndim:
                refuse("grid", f"a grid of {self.ndim} axes, as the deformation is", told=f"one of {grid.ndim}")
        image = None
        if not isinstance(source, np.ndarray) and library_of(source):
            from supple.media.objects import held

            image = held(source)
            if out is not None:
                refuse("out", "left out for an image, of which a new one is returned", told="one")
            if self.ndim == 3 and not options.keys() & {"between", "time_filter"} and sampling.between is None:
                sampling = sampling.along_all_axes()
        source, alpha = (source, alpha) if image is None else (image.samples, bool(alpha))
        space = self.space_on(grid, self._own(image.grid, grid) if image else None, inverse=inverse)
        if hasattr(source, "warped"):
            if alpha is not None or out is not None:
                raise SuppleError("alpha and out are for arrays, and a picture says itself what its channels are")
            space = replace(space, count=space.count * getattr(source, "pages", 1))
            made, certificate = warp_picture(
                source, space, sampling, clamp=clamp, device=device, regridded=grid is not None
            )
        else:
            made, certificate = warp_array(source, space, sampling, alpha=alpha, clamp=clamp, device=device, out=out)
        unit = "voxels" if space.ndim == 3 and not self.domain.time else "px"
        warn_of(certificate, sampling.tolerance, unit=unit)
        return made if image is None else image.like(made, grid or (self.output if self.straightened else None))

    def _own(self, own: Grid, output: Grid | None) -> Grid | None:
        """Return the grid of a sheared image, or None if it is upright; SuppleError if it does not fit."""
        upright, made = own.upright(), "make it on the image's grid, Deformation(supple.grid_of(image))"
        near = np.allclose(upright.spacing, self.grid.spacing, rtol=1e-3, atol=0.0)
        if self.domain.time or upright.shape != self.shape or not near:
            told, wanted = (f"{spoken(each.shape)} at {spelled(each.spacing)}" for each in (upright, self.grid))
            raise SuppleError(f"the image is of shape {told}, and the deformation is for {wanted}: {made}")
        if (own.shear or self.maps or output is not None) and not upright.is_same_space(self.grid):
            raise SuppleError(f"the image lies elsewhere in space than the grid of the deformation: {made}")
        return own if own.shear else None

    def report(self, *, tolerance: float = 0.01, plane: int | None = None, grid: Grid | None = None) -> Report:
        """Report on the strokes and the certified error of the inverse map.

        Parameters
        ----------
        tolerance : float
            The tolerance of the map, in pixels.
        plane : int, optional
            The frame or the slice to measure; by default, all.
        grid : Grid, optional
            The grid of the output; by default, that of the input.
        """
        tolerance = number("tolerance", tolerance, "a number of pixels from 1e-9 to 1e9", 1e-9, 1e9)
        space, shape = self.space_on(grid), (self.output if grid is None else grid).shape
        count = shape[0] if self.ndim == 3 else 1
        which = range(count)
        if plane is not None:
            which = range(k := integer("plane", plane, f"one of the {count} there are", 0, count - 1), k + 1)
        certificate = Certificate()
        for z in which if not space.is_identity else ():
            certificate |= measured(plan_of(space, z, tolerance), tolerance)
        size = float(np.prod(shape)) * len(which) / count
        return Report(
            **self.resolution(),
            folds=certificate.folded,
            tolerance=tolerance,
            error=certificate.error,
            unconverged=certificate.unknown,
            within=certificate.error <= tolerance and certificate.unknown == 0,
            evaluations=certificate.evaluations / size,
        )

    def resolution(self) -> dict[str, Any]:
        """Return the effect of the strokes, as in `Report`, without measuring the map."""
        return {
            "strokes": len(self.strokes),
            "applied": len(self._space.rows),
            "damping": tuple(r.alpha for r in self._resolved),
            "arrivals": self.arrivals,
            "margin": min((r.margin for r in self._resolved), default=1.0),
        }

    @property
    def arrivals(self) -> tuple[Arrival, ...]:
        """For each stroke, the target of its point, and its position."""
        return tuple(map(self.arrival, range(len(self.strokes))))

    def arrival(self, i: int) -> Arrival:
        """Return one of `arrivals`."""
        count = len(self.strokes)
        stroke = self.strokes[integer("a stroke's number", i, f"one of {count}, from 0", 0, count - 1)]
        start, each, found = sum(1 + len(one.also) for one in self.strokes[:i]), self._resolved[i], []
        for k, (at, by) in enumerate(stroke.handles, start):
            here, _, there = (tuple(p) for p in (self._points[k, :, : self.ndim] / self.domain.spacing).tolist())
            target = tuple(a + b for a, b in zip(at, by, strict=True))
            arrived = each.arrived if k == start else here
            final = arrived if (self._points[k, 0] == self._points[k, 2]).all() else there
            miss, carrier = math.dist(arrived, target), int(self._carriers[k])
            cause = each.cause if not stroke.also or miss > _HIT else None
            moved, carried_by = math.dist(final, arrived), None if carrier < 0 else carrier
            found.append(Arrival(target, arrived, final, miss, moved, cause, carried_by=carried_by))
        return replace(found[0], also=tuple(found[1:]))

    def _moved(self, placed: Placed, points: Floats) -> Floats:
        """Return points (N, 3) of the domain as mapped by one field or affine map alone."""
        composite = self.without_strokes()._with(placed, False).space.composite
        assert composite is not None
        return composite.through(points, False, False, np.zeros(len(points), np.uint8))[0]

    @property
    def warnings(self) -> tuple[str | None, ...]:
        """For each stroke, the warning if it misses its target, or None."""
        return tuple(r.warning for r in self._resolved)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Deformation):
            return NotImplemented
        return self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[object, ...]:
        maps = tuple(each for each in self.maps if each.name != _LAST)  # it is given by ``straightened``
        return self.domain, self.grid, self.on_fold, self.strokes, maps, self.straightened


def place_of(points: object) -> Any:
    """Return the module that maps points on their device: `supple.engine.core` or `supple.cuda.points`."""
    if not is_on_device(points):
        return core
    from supple.cuda import points as on_device

    return on_device


def _frame(grid: Grid) -> Floats:
    """Return the homogeneous matrix from a grid's coordinates, index times spacing, to positions."""
    made = np.eye(grid.ndim + 1)
    made[:-1, :-1], made[:-1, -1] = grid.direction, grid.origin
    return made


def _check_place(freeze: Freeze, grid: Grid) -> None:
    """Refuse a freeze mask that lies elsewhere in space than the grid."""
    corners = grid.corners()
    matrix = np.reshape(freeze.place, (3, 4))
    off = np.abs(grid.indices(corners @ matrix[:, :3].T + matrix[:, 3]) - corners).max()
    if not off < 0.01:
        raise SuppleError(
            f"{freeze.told} lies elsewhere in space: its corners are up to {off:.3g} voxels from those of the volume; "
            "resample it to the volume's grid"
        )


def _freeze_of(mask: npt.ArrayLike, domain: Domain) -> Freeze:
    """Return the freeze mask of an array of the domain's shape, or of a frame's."""
    array = np.asarray(mask)
    fit = {domain.shape, domain.shape[1:]} if domain.time else {domain.shape}
    if array.shape not in fit:
        wanted = f"an array of shape {' or '.join(map(str, sorted(fit)))}, or a Freeze"
        refuse("freeze", wanted, told=f"shape {array.shape}")
    return Freeze.of(array, spacing=domain.spacing[: array.ndim])


def part_of(stroke: Stroke, amount: float) -> float:
    """Return the applied fraction of a stroke: the amount times its strength, clamped to the valid range."""
    return min(max(amount * stroke.strength, LEAST), MOST)


def reduced(stroke: Stroke, amount: float, whole: Deformation, now: Deformation) -> Stroke:
    """Return a recipe's stroke as applied, by the recipe's amount and the stroke's strength, with a moved pivot.

    ``whole`` and ``now`` are the strokes before it, at full strength and as applied: the same object if equal.
    """
    part = part_of(stroke, amount)
    if (part == stroke.strength == 1 and whole is now) or stroke.brush == "freeze":
        return stroke
    at = stroke.at if whole is now else tuple(now.forward(whole.inverse(stroke.at).points).tolist())
    domain, time_radius = now.domain, stroke.time_radius
    if part != 1 and domain.time and not stroke.isotropic:  # its default depends on the drag
        time_radius = time_radius_of(stroke, domain.shape[0], domain.spacing[2])
    if 0 <= part <= 1:
        return replace(stroke.weakened(part), at=at, time_radius=time_radius)
    return replace(stroke.weakened(1.0), at=at, time_radius=time_radius, strength=part)


def after(stroke: Stroke, amount: float, whole: Deformation, before: Deformation, now: Deformation) -> Deformation:
    """Return ``whole`` with one more stroke at full strength; or ``now``, the applied strokes, while both are equal."""
    if whole is before and amount * stroke.strength == 1:
        return now
    return whole.add(replace(stroke, strength=1.0), warn=False)


def last_outside(made: Deformation) -> str | None:
    """Return the warning if the last stroke starts outside the samples; SuppleError if it reaches none of them."""
    stroke, rows, domain = made.strokes[-1], made._resolved[-1].rows, made.domain
    sizes = np.array(made.shape[::-1])
    if stroke.brush == "freeze" or np.all((np.array(stroke.at) >= -0.5) & (np.array(stroke.at) <= sizes - 0.5)):
        return None
    if made.ndim == 2:
        extent = f"the picture, which has {sizes[0]} x {sizes[1]} pixels"
    elif domain.time:
        extent = f"the clip, which has {sizes[0]} x {sizes[1]} pixels and {sizes[2]} frames (from {numbered(0)})"
    else:
        extent = f"the volume, which has {sizes[0]} x {sizes[1]} x {sizes[2]} voxels (its point is in voxels here)"
    pivots, spacing = rows["pivot"][:, : made.ndim], np.array(domain.spacing)
    beyond = np.maximum(np.maximum(-0.5 * spacing - pivots, pivots - (sizes - 0.5) * spacing), 0.0)
    text = f"{described(stroke)} starts outside {extent}"
    if domain.time:
        beyond[:, 2] *= rows["stretch"]
    if len(rows) and np.all(np.linalg.norm(beyond, axis=1) >= rows["reach"]):
        raise SuppleError(f"{text}, and reaches nothing of it: use a point inside, a larger radius or a longer reach")
    return text


def _missed(resolved: Resolved, which: str = "") -> tuple[str | None, type[Warning]]:
    """Return the warning of a stroke that misses its target, or None, and its category."""
    text = resolved.warning and f"{which}{resolved.warning}"
    return text, FoldWarning if resolved.alpha < 1 else MissWarning


def _warn(text: str | None, category: type[Warning], say: Callable[[str, type[Warning]], None] | None = None) -> None:
    if text and say is not None:
        say(text, category)
    elif text:
        warn(text, category)
