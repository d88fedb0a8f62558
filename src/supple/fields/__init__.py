"""Displacement fields and their inverses; compositions of fields and affine maps; and the files of both."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.sampling import Certificate, warn_of
from supple.engine.work import Array
from supple.errors import SuppleError, shown
from supple.fields import checks
from supple.fields.checks import FieldReport
from supple.space.affine import Affine, Projective, matrix_rows
from supple.space.checks import assign, choice, number, refuse
from supple.space.geometry import Box, Floats, Grid, check_boxes
from supple.space.splines import coefficients

if TYPE_CHECKING:
    from supple.media import transforms

PathLike = str | os.PathLike[str]
Interpolation = Literal["linear", "cubic", "bspline"]
Beyond = Literal["zero", "edge"]

_ROUNDING = 1e-6  # samples: rounding may place the outermost samples of a field outside of it

OK, FOLDED, OUTSIDE, UNCONVERGED = range(4)
STATUS = ("ok", "folded", "outside", "unconverged")
"""The names of the codes in `Inverted.status`."""


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Field:
    """A displacement field: the map x → x + u(x), with u given on a grid and interpolated in between.

    As in resampling tools, it maps each point of the output to its source point in the input (pull).

    Parameters
    ----------
    values : float32 or float64 array, shape (H, W, 2) or (Z, H, W, 3)
        The displacement at each sample of the grid, x first, in the units of the grid, along the axes of space (LPS
        for volumes), not of the grid. With ``"bspline"``, the coefficients of a cubic B-spline.
    grid : Grid
        The grid of the samples.
    interpolation : str
        ``"linear"``; ``"cubic"``, a cubic B-spline through the values; ``"bspline"``, values are its coefficients.
    beyond : str
        The displacement more than half a sample outside the grid: none (``"zero"``, as in ITK), or that of the
        nearest point of the ``"edge"``.

    Raises
    ------
    SuppleError
        If an argument is invalid, or the values hold NaN or infinity.
    """

    values: Array = field(repr=False)
    grid: Grid
    interpolation: Interpolation = field(default="linear")
    beyond: Beyond = field(default="zero")

    def __init__(
        self, values: npt.ArrayLike, grid: Grid, interpolation: Interpolation = "linear", beyond: Beyond = "zero"
    ) -> None:
        check_grid(grid)
        n = grid.ndim
        shape = "(H, W, 2)" if n == 2 else "(Z, H, W, 3)"
        given = _array(values)
        if given.dtype.kind not in "iuf" or given.dtype.itemsize > 8:
            told = f"{given.dtype} of shape {given.shape}"
            refuse("values", f"real numbers, as an array of shape {shape}", told=told)
        if given.shape != (*grid.shape, n):
            refuse("values", f"an array of shape {(*grid.shape, n)}, as the grid is", told=f"shape {given.shape}")
        choice("interpolation", interpolation, get_args(Interpolation))
        choice("beyond", beyond, get_args(Beyond))
        held = np.ascontiguousarray(given, np.float64 if given.dtype.itemsize == 8 else np.float32)
        if not all(np.isfinite(part).all() for part in held):
            raise SuppleError("the field holds NaN or infinity")
        if interpolation == "bspline" and min(grid.shape) < 4:
            raise SuppleError(f"a cubic B-spline needs 4 coefficients along each axis, found {grid.shape}")
        assign(self, values=held, grid=grid, interpolation=interpolation, beyond=beyond)

    @classmethod
    def from_array(
        cls,
        values: npt.ArrayLike,
        *,
        spacing: float | Sequence[float] = 1.0,
        origin: Sequence[float] | None = None,
        direction: npt.ArrayLike | None = None,
        interpolation: Interpolation = "linear",
        beyond: Beyond = "zero",
    ) -> Self:
        """Return a field of an array; see `Field` and `Grid` for the parameters."""
        given = _array(values)
        if given.ndim not in (3, 4) or given.shape[-1] != given.ndim - 1:  # perhaps with the coordinates first
            refuse("values", "an array of shape (H, W, 2) or (Z, H, W, 3), x first", told=f"shape {given.shape}")
        return cls(given, Grid(given.shape[:-1], spacing, origin, direction), interpolation, beyond)

    @property
    def ndim(self) -> int:
        """The number of coordinates: 2 or 3."""
        return self.grid.ndim

    def __call__(self, positions: npt.ArrayLike) -> Floats:
        """Return the positions x + u(x) of positions x, (..., D), in the grid's units."""
        given = np.asarray(positions, np.float64)
        if given.shape[-1:] != (self.ndim,) or not np.isfinite(given).all():
            refuse("positions", f"finite numbers of shape (..., {self.ndim})", positions)
        part = Placed(self).packed(np.eye(self.ndim + 1))
        moved = checks.through([part], given.reshape(-1, self.ndim))[0]
        return np.ascontiguousarray(moved).reshape(given.shape)

    def packed(self, frame: Floats) -> _core.Sampled:
        """Return the field in the form of the core.

        Parameters
        ----------
        frame : float64 array, shape (D + 1, D + 1)
            The homogeneous matrix from the core's coordinates to positions.
        """
        n = self.ndim
        to_index = np.linalg.inv(self.grid.matrix)
        sizes = self.grid.sizes
        own = self.interpolation == "bspline"  # the coefficients at the ends are beyond the field
        values = coefficients(self.values) if self.interpolation == "cubic" else self.values
        matrix = to_index @ frame
        return _core.Sampled(
            values,
            1 if self.interpolation == "linear" else 3,
            [1.0 if own else 0.0] * n,
            [size - (2.0 if own else 1.0) for size in sizes],
            margin_of(self.interpolation),
            self.beyond == "zero",
            np.ascontiguousarray(matrix[:n]),
            np.ascontiguousarray(np.linalg.inv(matrix[:n, :n])),
            np.ascontiguousarray(to_index[:n, :n]),
        )

    def invert(self, grid: Grid | None = None, *, tolerance: float = 0.01) -> Inverted:
        """Return the inverse displacement field, with its error and status at each sample.

        Each sample y is solved for x with x + u(x) = y by Newton's method on the interpolant, whose Jacobian is exact;
        nothing is smoothed, clamped or set to zero.

        Parameters
        ----------
        grid : Grid, optional
            The grid of the result; by default, the field's own.
        tolerance : float
            The largest distance from the true inverse of the interpolant, in voxels of the field.

        Returns
        -------
        Inverted

        Raises
        ------
        SuppleError
            If the grid has another number of axes, or does not overlap the field and the region that it maps to.
        """
        n = self.ndim
        tolerance = number("tolerance", tolerance, "a number of voxels from 1e-9 to 1e9", 1e-9, 1e9)
        held = own_grid(self) if grid is None else check_grid(grid)
        if held.ndim != n:
            raise SuppleError(f"a field of {n} axes needs a grid of as many, found {held.ndim}")
        check_path([Placed(self, inverse=True)], held, "the grid of the inverse")
        to_index = np.linalg.inv(self.grid.matrix) @ held.matrix
        dtype = self.values.dtype
        values, error = np.empty((*held.shape, n), dtype), np.empty(held.shape, np.float32)
        status = np.zeros(held.shape, np.uint8)
        back = np.ascontiguousarray(np.linalg.inv(to_index)[:n])
        self.packed(np.eye(n + 1)).invert(np.ascontiguousarray(to_index[:n]), back, tolerance, values, error, status)
        return Inverted(type(self)(values, held, beyond=self.beyond), error, status)

    def folded_cells(self) -> npt.NDArray[np.bool_]:
        """Return the cells between neighbouring samples in which the interpolant is not proved to be one-to-one.

        Returns
        -------
        bool array
            The shape has one cell less than samples along each axis of several samples. True where the determinant of
            I + ∂u/∂x may be 0 or less somewhere in the cell, by bounds that hold in the whole cell.
        """
        cells = np.zeros([max(size - 1, 1) for size in own_grid(self).shape], np.uint8)
        self.packed(np.eye(self.ndim + 1)).folded_cells(cells)
        return cells.astype(np.bool_)

    def log_jacobian(self) -> npt.NDArray[np.float32]:
        """Return the logarithm of det(I + ∂u/∂x) at each sample; above 0, the input is larger.

        From central differences between samples, one-sided at the edges; NaN where the determinant is not above 0,
        that is, where the field folds.
        """
        return checks.log_jacobian(sampled(self), own_grid(self))

    def check(self, inverse: Field | None = None) -> FieldReport:
        """Return how far the field moves, whether it folds, and how well another one undoes it.

        Parameters
        ----------
        inverse : Field, optional
            A field that shall undo this one: a point goes through this one first.

        Returns
        -------
        FieldReport

        Raises
        ------
        SuppleError
            If the other field has another number of axes.
        """
        distances = None if inverse is None else self.distances(inverse)
        return self.reported(self.folded_cells(), self.log_jacobian(), distances)

    def distances(self, inverse: Field) -> npt.NDArray[np.float32]:
        """Return |inverse(self(x)) − x| at each sample x, in the grid's units.

        NaN where this field maps a sample more than half a sample beyond the other one's grid.
        """
        if not isinstance(inverse, Field):
            refuse("inverse", "a Field", inverse)
        if inverse.ndim != self.ndim:
            raise SuppleError(f"a field of {self.ndim} axes has no inverse of {inverse.ndim}")
        one, other = (field.packed(np.eye(self.ndim + 1)) for field in (self, inverse))
        return checks.distances(one, other, own_grid(self), own_grid(inverse), margin_of(inverse.interpolation))

    def reported(
        self, folded: Array, logarithms: npt.NDArray[np.float32], distances: npt.NDArray[np.float32] | None = None
    ) -> FieldReport:
        """Return the report from the results of `folded_cells`, `log_jacobian` and `distances`."""
        grid, values = own_grid(self), sampled(self)
        if self.interpolation == "linear":
            least, index = checks.least_at_corners(values, grid)
        else:
            least, index = checks.least_at_samples(self.packed(np.eye(self.ndim + 1)), grid)
        largest, mean = checks.displacements(values)
        return FieldReport(
            grid=grid,
            largest=largest,
            mean=mean,
            cells=folded.size,
            folded=int(np.count_nonzero(folded)),
            determinant=least,
            at=tuple(grid.positions(index).tolist()),
            negative=int(np.count_nonzero(np.isnan(logarithms))),
            consistency=None if distances is None else checks.consistency_of(distances),
        )

    def compose(self, *maps: Map | Placed, grid: Grid | None = None) -> Self:
        """Return the field of this map followed by others: x goes through this one first.

        Parameters
        ----------
        *maps : Field, Affine or Placed
            As in `compose`.
        grid : Grid, optional
            The grid of the result; by default, the field's own.

        Notes
        -----
        Errors and warnings are those of `compose`.
        """
        made = compose((self, *maps), own_grid(self) if grid is None else grid)
        return type(self)(made.values, made.grid)

    @classmethod
    def read(
        cls,
        path: PathLike | Any,
        convention: str | None = None,
        *,
        source: Grid | None = None,
        reference: Grid | None = None,
    ) -> Self:
        """Read a displacement field.

        Parameters
        ----------
        path : str, os.PathLike or SimpleITK.Transform
            The file, or a transform of SimpleITK; see `supple.media.transforms` for the formats.
        convention : str, optional
            The program whose convention the file follows: ``"itk"`` (ITK, ANTs, 3D Slicer), ``"fsl-relative"``,
                ``"fsl-absolute"``, ``"afni"``, ``"mrtrix"``, ``"ngff"``, ``"opencv"``, ``"stmap"``, ... By default, the
                convention that the file shows without doubt.
        source, reference : Grid, optional
            The grids of the input (moving) and of the output (fixed) image, where the convention refers to them: fields
            of FSL to the first, matrices of FLIRT to both.

        Raises
        ------
        SuppleError
            If the file cannot be read, is of another convention, or holds anything but one field.
        """
        found = read_maps(path, convention, source=source, reference=reference)
        only = found[0] if len(found) == 1 else None
        if not isinstance(only, Field):
            name = shown(path) if isinstance(path, str | os.PathLike) else "the transform"
            raise SuppleError(
                f"{name} holds {told(found)}, and not one field: read_maps(path) reads them (supple compose "
                "makes one field of them)"
            )
        return cls(only.values, only.grid, only.interpolation, only.beyond)

    def write(
        self, path: PathLike, convention: str | None = None, *, source: Grid | None = None, force: bool = False
    ) -> None:
        """Write the field in a convention; the file appears whole or not at all.

        Parameters
        ----------
        path, convention, source
            As in `read`; by default, the convention that goes with the suffix.
        force : bool
            Whether to replace an existing file.

        Raises
        ------
        SuppleError
            If the file cannot be written, or the convention cannot hold the field.
        """
        write_maps(path, [self], convention, source=source, force=force)


@dataclass(frozen=True, slots=True, eq=False)
class Inverted:
    """The inverse of a displacement field, with its accuracy.

    Parameters
    ----------
    field : Field
        The inverse, interpolated linearly between its samples. At a sample that is not ``OK``, it is the best point
        that was computed.
    error : float32 array, of the grid's shape
        A bound on the distance of x from the true inverse of the interpolant, in the grid's units (millimetres);
        inf where there is none.
    status : uint8 array, of the grid's shape
        For each sample: `OK`, if x is on the field's grid, and the only preimage, counting the continuation of the
        field beyond its edge; `FOLDED`, if there may be several preimages, as a folded cell maps here, perhaps one
        beyond the grid; `OUTSIDE`, if x is beyond the grid, where the field is continued; or `UNCONVERGED`, if no x
        was within the tolerance.
    """

    field: Field
    error: npt.NDArray[np.float32] = dataclasses.field(repr=False)
    status: npt.NDArray[np.uint8] = dataclasses.field(repr=False)

    @property
    def counts(self) -> dict[str, int]:
        """The number of samples of each status."""
        found = np.bincount(self.status.ravel(), minlength=len(STATUS))
        return dict(zip(STATUS, found.tolist(), strict=True))


Map = Affine | Field
"""A map of positions: an element of a deformation other than a stroke."""


@dataclass(frozen=True, slots=True)
class Placed:
    """A field or an affine map, forward or inverted, perhaps among the strokes of a deformation.

    Parameters
    ----------
    map : Field, Affine or Projective
        From a point of the output to its source point in the input (pull).
    inverse : bool
        Whether to apply the inverse (push).
    after : int
        The number of strokes before it.
    name : str
        The name of its file, for messages.
    """

    map: Field | Affine | Projective
    inverse: bool = False
    after: int = 0
    row: int = field(default=0, repr=False)
    name: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.map, Affine | Projective | Field):
            refuse("a map", "a Field, an Affine, or a Placed with one", self.map)

    @property
    def told(self) -> str:
        """The name in messages."""
        return self.name or ("the field" if isinstance(self.map, Field) else "the affine map")

    def packed(self, frame: Floats) -> _core.Part:
        """Return the map in the form of the core, for coordinates of `Field.packed`, as a part of the pull map."""
        if isinstance(self.map, Field):
            return "field", self.map.packed(frame), self.inverse
        rows = matrix_rows(np.linalg.inv(frame) @ self.map.matrix @ frame, isinstance(self.map, Projective))
        return "affine", rows, self.inverse


def only_name(maps: Iterable[Placed]) -> str:
    """Return the name of the field among maps if there is exactly one, and it has a name; otherwise "a field"."""
    fields = [placed for placed in maps if isinstance(placed.map, Field)]
    return fields[0].name if len(fields) == 1 and fields[0].name else "a field"


def folds_of(maps: Iterable[Placed]) -> str:
    """Return the text of which inverted fields fold, and in how many cells; "" if none does."""
    told = []
    for placed in maps:
        if placed.inverse and isinstance(placed.map, Field):
            cells = placed.map.folded_cells()
            if count := int(np.count_nonzero(cells)):
                doubt = " (is its convention another?)" if placed.name and 4 * count > cells.size else ""
                told.append(f"{placed.told} folds in {count:,} of its {cells.size:,} cells{doubt}")
    return ", and ".join(told)


def warn_of_maps(certificate: Certificate, tolerance: float, maps: Sequence[Placed], unit: str = "px") -> None:
    """Warn as `supple.engine.sampling.warn_of` does, with the names of the fields among the maps."""
    warn_of(certificate, tolerance, folds_of(maps), only_name(maps), unit)


def read_maps(
    path: PathLike | Any, convention: str | None = None, *, source: Grid | None = None, reference: Grid | None = None
) -> tuple[Map, ...]:
    """Read the affine maps and fields of a file, in the order in which a point of the output goes through them.

    Parameters and errors are those of `Field.read`. ``path`` may also be a transform of SimpleITK: an affine map of any
    kind, a displacement field, a cubic B-spline, or a composite of these.
    """
    from supple.media import transforms

    if isinstance(path, str | os.PathLike):
        found = transforms.read(path, convention, source=source, reference=reference)
    else:
        found = transforms.itk.contents_of(path)
    return tuple(Field(*each) if isinstance(each, transforms.Displacements) else Affine(each) for each in found)


def write_maps(
    path: PathLike,
    maps: Sequence[Map],
    convention: str | None = None,
    *,
    source: Grid | None = None,
    reference: Grid | None = None,
    force: bool = False,
) -> None:
    """Write affine maps and fields to a file, in the order of `read_maps`; it appears whole or not at all.

    Parameters and errors are those of `Field.write`, and ``reference`` is that of `Field.read`.
    """
    from supple.media import transforms

    transforms.write(path, _contents(maps), convention, source=source, reference=reference, force=force)


def to_sitk(*maps: Map) -> Any:
    """Return maps as a transform of SimpleITK, several as a composite; a point goes through the first map first.

    Parameters
    ----------
    *maps : Field or Affine
        In millimetres in LPS, or in the units of images with two axes. The continuation of a field beyond its grid
        is lost: ITK moves nothing there.

    Returns
    -------
    SimpleITK.AffineTransform, DisplacementFieldTransform, BSplineTransform or CompositeTransform
        `read_maps` is its inverse.

    Raises
    ------
    SuppleError
        If an argument is neither, or a field has ``"cubic"`` interpolation.
    """
    if not maps or not all(isinstance(each, Field | Affine) for each in maps):
        refuse("maps", "one or more of Field and Affine", maps)
    from supple.media import transforms

    return transforms.itk.transform_of(_contents(maps))


def _contents(maps: Sequence[Map]) -> list[transforms.Content]:
    from supple.media import transforms

    return [
        transforms.Displacements(each.values, each.grid, each.interpolation, each.beyond)
        if isinstance(each, Field)
        else each.matrix
        for each in maps
    ]


def told(maps: Sequence[Map]) -> str:
    """Return a description of maps for messages."""
    return " and ".join("a field" if isinstance(each, Field) else "an affine map" for each in maps) or "nothing"


def compose(maps: Sequence[Map | Placed], grid: Grid) -> Field:
    """Return the displacement field of several maps, one after the other, at the samples of a grid.

    Parameters
    ----------
    maps : sequence of Field, Affine or Placed
        A point goes through the first one first; through the inverse of a `Placed` with ``inverse``.
    grid : Grid
        The grid of the result. At its samples, the result is exact, to float32; between them, it is interpolated.

    Returns
    -------
    Field
        In float32, interpolated linearly.

    Raises
    ------
    SuppleError
        If a map has another number of axes than the grid; or a field does not overlap the grid, or the region to
        which the maps before it lead.

    Warns
    -----
    FoldWarning
        If a field that is inverted folds.
    OutsideWarning
        If no point of an inverted field's grid is mapped to some of the samples.
    """
    n = check_grid(grid).ndim
    given = [each if isinstance(each, Placed) else Placed(each) for each in maps]
    check_axes(given, n, "the result")
    check_path(given, grid, "the grid of the result")
    parts = [placed.packed(np.eye(n + 1)) for placed in given]
    values, certificate = checks.values_at(parts, grid)
    warn_of_maps(certificate, 1.0, given)
    return Field(values, grid)


def check_grid(grid: Grid) -> Grid:
    """Return the grid; SuppleError if it is no Grid, or is sheared."""
    if not isinstance(grid, Grid):
        refuse("grid", "a Grid", grid)
    if grid.shear:
        refuse("grid", "a grid whose axes are at right angles (Grid.upright makes one)", grid)
    return grid


def margin_of(interpolation: Interpolation) -> float:
    """Return how many samples a field extends beyond its outermost ones (for a B-spline, those of `own_grid`)."""
    return _ROUNDING if interpolation == "bspline" else 0.5


def _array(values: npt.ArrayLike) -> Array:
    try:
        return np.asarray(values)
    except ValueError:
        refuse("values", "an array of numbers, of shape (H, W, 2) or (Z, H, W, 3)", values)


def own_grid(field: Field) -> Grid:
    """Return the grid of a field's samples; for B-spline coefficients, without the outermost ones, beyond the field."""
    if field.interpolation != "bspline":
        return field.grid
    return field.grid.crop([1] * field.ndim, [n - 2 for n in field.grid.sizes])


def sampled(field: Field) -> Array:
    """Return the displacements of a field at the samples of `own_grid`."""
    if field.interpolation != "bspline":
        return field.values
    return checks.values_at([Placed(field).packed(np.eye(field.ndim + 1))], own_grid(field))[0]


def check_axes(maps: Iterable[Placed], ndim: int, name: str, is_a: str = "") -> None:
    """Raise SuppleError for a map of another number of axes than ``name``, a picture or a volume unless it ``is_a``."""
    for each in maps:
        if (n := each.map.ndim) != ndim:
            kinds = ("picture", "volume")[:: 1 if n == 2 else -1]
            other = f"{name} is {is_a or f'a {kinds[1]}'}"
            raise SuppleError(f"{each.told} is for {kinds[0]}s, with {n} axes, and {other}: give two with as many axes")


def check_path(
    maps: Iterable[Placed],
    output: Grid,
    where: str = "the grid of the output",
    *,
    source: Grid | None = None,
    name: str = "the input",
) -> None:
    """Raise SuppleError for a field, before the first affine map, that no point of the output comes near.

    A point of the output goes through the first map first; for a part of a grid, the whole grid counts. If ``source``
    is given, the last field must lead there. ``where`` and ``name`` are the owners of ``output`` and ``source``, for
    messages.
    """
    box = output.uncropped().box
    given = list(maps)
    for k, placed in enumerate(given):
        held, what = placed.map, placed.told
        if not isinstance(held, Field):
            return  # an affine map may lead to another region on purpose
        own = held.grid.box
        check_boxes(_led(held, own) if placed.inverse else own, what, box, where)
        if k < len(given) - 1 or source is not None:
            box, where = _led(held, box, placed.inverse), f"what {what} leads to"
    if source is not None:
        check_boxes(box, where, source.box, name)


def _led(field: Field, box: Box, inverse: bool = False) -> Box:
    """Return a box around another box and the region to which a field, or its inverse, may map that."""
    planes = field.values.reshape(-1, *field.values.shape[-2:])
    low = np.min([plane.min(axis=(0, 1)) for plane in planes], axis=0)
    high = np.max([plane.max(axis=(0, 1)) for plane in planes], axis=0)
    if field.interpolation == "cubic":  # a spline exceeds the range of its values by less than 1.5 times the range
        low, high = low - 1.5 * (high - low), high + 1.5 * (high - low)
    least, most = (-high, -low) if inverse else (low, high)
    return box[0] + np.minimum(least, 0.0), box[1] + np.maximum(most, 0.0)
