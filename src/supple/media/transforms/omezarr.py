"""The transformation of an OME-Zarr store: found by its metadata, and turned from their order and units to ours."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from supple.errors import SuppleError, need, said
from supple.media.files import PathLike, unreadable
from supple.media.transforms.base import Array, Content, Displacements, Matrix, inverse
from supple.space.geometry import Grid

_PREFIXES = {
    "": 0, "yocto": -24, "zepto": -21, "atto": -18, "femto": -15, "pico": -12, "nano": -9, "micro": -6, "milli": -3,
    "centi": -2, "deci": -1, "hecto": 2, "kilo": 3, "mega": 6, "giga": 9, "tera": 12, "peta": 15, "exa": 18,
    "zetta": 21, "yotta": 24,
}  # fmt: skip
_UNITS = {f"{prefix}meter": float(f"1e{power + 3}") for prefix, power in _PREFIXES.items()}
_UNITS |= {
    "angstrom": 1e-7,
    "inch": 25.4,
    "foot": 304.8,
    "yard": 914.4,
    "mile": 1_609_344.0,
    "parsec": 3.0856775814913673e19,
}
# Not of the specification, but of many files.
_UNITS |= {**dict.fromkeys(("um", "\u00b5m", "\u03bcm", "micron", "microns"), 1e-3), "nm": 1e-6, "mm": 1.0, "cm": 10.0}
"""Millimetres."""
ORIENTATIONS = {
    "right-to-left": (0, 1.0), "left-to-right": (0, -1.0), "anterior-to-posterior": (1, 1.0),
    "posterior-to-anterior": (1, -1.0), "inferior-to-superior": (2, 1.0), "superior-to-inferior": (2, -1.0),
}  # fmt: skip
_KINDS = {"displacements": "displacement", "coordinates": "coordinate"}
_INTERPOLATION: dict[str, Literal["linear", "cubic"]] = {"linear": "linear", "cubic": "cubic", "bspline-cubic": "cubic"}
_EXACT = 1e-6  # of a voxel
_PARAMETERS = ("scale", "translation", "affine", "rotation", "mapAxis")
_LINEAR = ("identity", *_PARAMETERS, "byDimension")
_TYPES = (*_LINEAR, "sequence", "bijection", *_KINDS)

Json = Mapping[str, Any]


def imported(what: str = "transformations of OME-Zarr") -> Any:
    """Return the module zarr, imported at the first use; ``what`` says in an error what needs it."""
    need("zarr", what, "zarr")
    import zarr

    return zarr


def space_matrix(axes: Sequence[Json], units: Sequence[str | None], error: Callable[[str, str], SuppleError]) -> Matrix:
    """Return the matrix from coordinates along axes, as stored, to millimetres in LPS, x first.

    Parameters
    ----------
    axes : sequence of mapping
        The descriptions of two or three axes: their names, and their types and orientations if they have any.
    units : sequence of str or None
        Those of the axes; what has none is left as it is.
    error : callable
        It returns the error to raise, from what was found and what would do.
    """
    names = [str(axis["name"]) for axis in axes]
    n, listed = len(axes), ", ".join(names)
    odd = [str(axis.get("type")) for axis in axes if axis.get("type") not in (None, "space", "array")]
    if n not in (2, 3) or odd:
        what = f"its axes are {listed}" + (f", of the type {odd[0]} too" if odd else "")
        raise error(what, "give a transformation of two or three space axes")
    lower = [name.lower() for name in names]
    order = ["xyz".index(name) for name in lower] if set(lower) == set("xyz"[:n]) else list(range(n))[::-1]
    signs = [1.0] * n
    told = [axis.get("orientation") for axis in axes]
    if any(told):
        values = [one.get("value") if isinstance(one, Mapping) else one for one in told]
        turns = [ORIENTATIONS.get(str(value), (-1, 1.0)) for value in values]
        if {axis for axis, _ in turns} != set(range(n)):
            raise error(f"its axes have the orientations {values}", f"use {', '.join(ORIENTATIONS)}")
        order, signs = [axis for axis, _ in turns], [sign for _, sign in turns]
    made = np.zeros((n, n))
    for i, unit in enumerate(units):
        if unit and unit not in _UNITS:
            raise error(f"its axis {names[i]} has the unit {unit!r}", "name a length, as micrometer or millimeter")
        made[order[i], i] = signs[i] * (_UNITS[unit] if unit else 1.0)
    return made


def ome_of(attributes: Json) -> Json:
    """Return the metadata of OME-Zarr among those of a group; before version 0.5, they had no name of their own."""
    ome = attributes.get("ome", attributes)
    return ome if isinstance(ome, Mapping) else {}


class Store:
    """A Zarr store whose transformation is read."""

    def __init__(self, path: PathLike) -> None:
        self.path = path
        zarr = imported()
        if not os.path.isdir(path):
            raise self.error("there is no such folder", "check the name")
        with self.reading("it is no Zarr group, or damaged"):
            self.root = zarr.open_group(os.fspath(path), mode="r")

    def error(self, reason: str, advice: str = "give a whole copy of it") -> SuppleError:
        """Return an error that names the store."""
        return unreadable(self.path, reason, advice)

    @contextlib.contextmanager
    def reading(self, what: str) -> Iterator[None]:
        """Convert all errors of zarr to one sentence."""
        try:
            yield
        except SuppleError:
            raise
        except Exception as error:  # zarr's codecs raise any of them
            raise self.error(f"{what} ({said(error)})") from error

    @contextlib.contextmanager
    def parsing(self) -> Iterator[None]:
        """Convert errors of metadata whose parts are missing, or of another type, to one sentence."""
        try:
            yield
        except SuppleError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            what = f"its metadata are incomplete or malformed ({type(error).__name__}: {error})"
            raise self.error(what, "see the specification of OME-Zarr 0.6") from error

    def contents(self) -> tuple[Content, ...]:
        """Return what the store holds, in millimetres in LPS, x first."""
        with self.parsing():
            found, holder = self._only()
            before, after = self._systems(found, holder)
            made = self._parts(found, len(before) - 1)
        try:
            turned = [_turned(part, before) for part in made]
        except SuppleError as error:
            raise self.error(str(error), "resample the field") from error
        tail = after @ inverse(before)
        if not np.allclose(tail, np.eye(len(tail)), rtol=0, atol=1e-12):
            turned.append(tail)
        return tuple(shortened(turned))

    def _only(self) -> tuple[Json, Json]:
        """Return the only transformation, and the object that it is listed in."""
        ome = ome_of(self.root.attrs)
        holders = [ome.get("scene"), ome, *ome.get("multiscales", [])[:1]]
        for holder in holders:
            listed = holder.get("coordinateTransformations") if holder else None
            if listed:
                if len(listed) != 1:
                    names = ", ".join(str(one.get("name") or one.get("type")) for one in listed)
                    raise self.error(f"it holds {len(listed)} transformations ({names})", "give a store of one")
                return listed[0], holder
        raise self.error("it holds no coordinateTransformations of a scene or an image", "give a store that has one")

    def _systems(self, found: Json, holder: Json) -> tuple[Matrix, Matrix]:
        """Return the matrices from the coordinates of input and output, as stored, to millimetres in LPS, x first."""
        axes = [self._axes(found.get(end), holder) for end in ("input", "output")]
        known = [one for one in axes if one is not None] or [self._guessed(found)]
        ends = [known[0] if one is None else one for one in axes]
        if len(ends[0]) != len(ends[1]):
            raise self.error(
                f"its input has {len(ends[0])} axes, its output {len(ends[1])}", "give one of equal spaces"
            )
        # what has no unit is in that of the other end
        units = [[axis.get("unit") for axis in end] for end in ends]
        for one, other in (units, units[::-1]):
            one[:] = [a or b for a, b in zip(one, other, strict=True)]
        before, after = np.eye(len(ends[0]) + 1), np.eye(len(ends[0]) + 1)
        before[:-1, :-1], after[:-1, :-1] = (space_matrix(*end, self.error) for end in zip(ends, units, strict=True))
        return before, after

    def _axes(self, end: Any, holder: Json) -> list[Json] | None:
        """Return the axes of a coordinate system; None if the store describes none at all."""
        name, path = (end.get("name"), end.get("path")) if isinstance(end, Mapping) else (end, None)
        holders: list[Json] = [holder, ome_of(self.root.attrs)]
        if path:
            ome = ome_of(self._node(path).attrs)
            holders = [ome, *ome.get("multiscales", [])]
        systems = [system for one in holders for system in one.get("coordinateSystems", [])]
        for system in systems:
            if system["name"] == name:
                return list(system["axes"])
        if path or (systems and name is not None):
            where = f" of {path}" if path else ""
            raise self.error(f"it does not describe the coordinate system {name!r}{where}", "add it")
        return None

    def _guessed(self, found: Json) -> list[Json]:
        """Return the axes of a store without coordinate systems: those of its first field, or z, y, x."""
        if found["type"] in ("sequence", "bijection"):
            inner = found["transformations"] if found["type"] == "sequence" else [found["forward"]]
            fields = [one for one in inner if one["type"] not in ("identity", "scale", "translation")]
            return self._guessed((fields or inner)[0])
        if found["type"] in _KINDS:
            return [axis for axis in self._field(found)[1] if axis.get("type") != _KINDS[found["type"]]]
        return [{"name": name} for name in "zyx"[-(self._size(found) or 3) :]]

    def _parts(self, found: Json, n: int) -> list[Matrix | _Raw]:
        """Return the parts of a transformation, in coordinates as they are stored."""
        kind = found["type"]
        if kind == "sequence":
            return [part for one in found["transformations"] for part in self._parts(one, n)]
        if kind == "bijection":
            return self._parts(found["forward"], n)
        if kind in _KINDS:
            return [self._displacements(found, n)]
        matrix = self._matrix(found, n)
        if matrix.shape != (n + 1, n + 1):
            raise self.error(
                f"its {kind} has {len(matrix) - 1} rows, and its space {n} axes", "give one of equal spaces"
            )
        return [matrix]

    def _matrix(self, found: Json, n: int) -> Matrix:
        """Return the homogeneous matrix of a linear transformation, of ``n`` axes if it does not say how many."""
        kind, made = found["type"], np.eye(n + 1)
        if kind == "identity":
            return made
        if kind == "sequence":  # of a field's indices
            for one in found["transformations"]:
                made = self._matrix(one, n) @ made
            return made
        if kind == "byDimension":
            for one in found["transformations"]:
                rows, columns = (one.get(f"{end}Axes", one.get(f"{end}_axes")) for end in ("output", "input"))
                part = self._matrix(one["transformation"], len(columns))
                made[np.ix_(rows, range(n + 1))] = 0
                made[np.ix_(rows, [*columns, n])] = part[:-1]
            return made
        if kind not in _LINEAR:
            known = _LINEAR if kind in _TYPES else _TYPES
            raise self.error(f"it holds a transformation of the type {kind!r} here", f"use {', '.join(known)}")
        numbers = self._numbers(found, kind)
        size = len(numbers)
        made = np.eye(size + 1)
        if kind == "scale":
            made[:-1, :-1] = np.diag(numbers)
        elif kind == "translation":
            made[:-1, -1] = numbers
        elif kind == "mapAxis":
            made[:-1, :-1] = np.eye(size)[numbers.astype(int)]
        elif numbers.shape == (size, size + (kind == "affine")):
            made[:-1, : numbers.shape[1]] = numbers
        else:
            raise self.error(f"its {kind} is a matrix of shape {numbers.shape}", "give one of equal spaces")
        if not np.isfinite(made).all():
            raise self.error(f"its {kind} holds NaN or infinity", "mend it")
        return made

    def _size(self, found: Json) -> int | None:
        """Return the number of axes of a transformation that is linear; None if it does not say."""
        if found["type"] == "sequence":
            sizes = [self._size(one) for one in found["transformations"]]
            return next((size for size in sizes if size), None)
        return len(self._numbers(found, found["type"])) if found["type"] in _PARAMETERS else None

    def _numbers(self, found: Json, kind: str) -> Matrix:
        if kind in found:
            return np.array(found[kind], np.float64)
        array = self._node(found["path"])
        with self.reading(f"{found['path']} cannot be read"):
            return np.array(array[...], np.float64)

    def _node(self, path: str) -> Any:
        parts = [part for part in path.split("/") if part not in ("", ".")]
        if ".." in parts or ":" in path:
            raise self.error(f"it refers to {path!r}, outside of it", "put all into one store")
        with self.reading(f"it lacks {path!r}"):
            return self.root["/".join(parts)] if parts else self.root

    def _field(self, found: Json) -> tuple[Any, list[Json], list[Json]]:
        """Return the array of a field, its axes, and the transformations of its indices."""
        path = found["path"]
        node = self._node(path)
        ome = ome_of(node.attrs)
        image: Json
        dataset: Json | None
        if hasattr(node, "shape") and not ome.get("coordinateSystems"):
            image, dataset = self._above(path)
        elif hasattr(node, "shape"):
            image = dataset = ome
        else:
            image = ome["multiscales"][0]
            dataset = image["datasets"][0]
            node = self._node(f"{path}/{dataset['path']}")
        steps = list(dataset["coordinateTransformations"]) if dataset else []
        if not steps:
            raise self.error(f"its field {path} has no coordinateTransformations of its own", "add a scale")
        out = steps[0].get("output")
        name = out.get("name") if isinstance(out, Mapping) else out
        systems = image.get("coordinateSystems", [])
        axes = next((one["axes"] for one in systems if one["name"] == name), image.get("axes"))
        if axes is None:
            raise self.error(f"its field {path} does not describe the coordinate system {name!r}", "add it")
        return node, list(axes), steps[:1] if out is not None else steps

    def _above(self, path: str) -> tuple[Json, Json | None]:
        """Return the multiscale image, in a group above, that an array is part of, and its description there."""
        parts = path.strip("/").split("/")
        for k in reversed(range(len(parts))):
            for image in ome_of(self._node("/".join(parts[:k])).attrs).get("multiscales", []):
                for dataset in image["datasets"]:
                    if dataset["path"].strip("/").split("/") == parts[k:]:
                        return image, dataset
        return {}, None

    def _displacements(self, found: Json, n: int) -> _Raw:
        path, kind = found["path"], _KINDS[found["type"]]
        array, axes, steps = self._field(found)
        types = [axis.get("type") for axis in axes]
        if types.count(kind) != 1:
            listed = ", ".join(map(str, types))
            raise self.error(f"its field {path} has axes of the types {listed}", f"make one of them a {kind}")
        vector = types.index(kind)
        if array.ndim != n + 1 or len(axes) != n + 1 or array.shape[vector] != n:
            what = f"its field {path} has the shape {array.shape}, with {n} components along the axis {vector} expected"
            raise self.error(what, "give a field of equal spaces")
        if array.dtype.kind not in "iuf":
            raise self.error(f"its field {path} is of {array.dtype}", "write float32 or float64")
        told = found.get("interpolation") or "linear"
        if told not in _INTERPOLATION:
            raise self.error(f"its field {path} is to be interpolated by {told!r}", "use linear or cubic")
        whole = {"type": "sequence", "transformations": steps}
        matrix = self._matrix(whole, self._size(whole) or n + 1)
        if len(matrix) == n + 2:
            matrix = np.delete(np.delete(matrix, vector, 0), vector, 1)
        if matrix.shape != (n + 1, n + 1) or not abs(np.linalg.det(matrix)) > 0:
            raise self.error(f"the coordinateTransformations of its field {path} do not fit its axes", "mend them")
        with self.reading(f"its field {path} is damaged or cut short"):
            values = np.moveaxis(np.asarray(array[...]), vector, -1)
        if not all(np.isfinite(part).all() for part in values):
            raise self.error(f"its field {path} holds NaN or infinity", "fill them first")
        if kind == "coordinate":
            indices = np.moveaxis(np.indices(values.shape[:-1], np.float64), 0, -1)
            values = values - (indices @ matrix[:-1, :-1].T + matrix[:-1, -1])
        return _Raw(values, matrix, _INTERPOLATION[told])


class _Raw(NamedTuple):
    """A field as it is stored: in the order and the units of the file's axes."""

    values: Array
    matrix: Matrix  # from an index to its position
    interpolation: Literal["linear", "cubic"]


def _turned(part: Matrix | _Raw, axes: Matrix) -> Content:
    """Return a part of a transformation in millimetres in LPS, x first, with ``axes`` from stored coordinates."""
    if not isinstance(part, _Raw):
        return np.asarray(axes @ part @ inverse(axes))
    n = len(axes) - 1
    order = [int(np.flatnonzero(row)[0]) for row in axes[:n]]  # of the array's axes, x first
    matrix = (axes @ part.matrix)[:n, [*order, n]]
    spacing = np.linalg.norm(matrix[:, :n], axis=0)
    shape = [part.values.shape[axis] for axis in order[::-1]]
    grid = Grid(shape, spacing.tolist(), matrix[:, n].tolist(), matrix[:, :n] / spacing)
    dtype = np.float64 if part.values.dtype.itemsize == 8 else np.float32
    values = part.values.transpose([*order[::-1], n]) @ axes[:n, :n].T.astype(dtype)
    return Displacements(np.ascontiguousarray(values, dtype), grid, part.interpolation)


def shortened(parts: Iterable[Content]) -> list[Content]:
    """Return the same map of fewer parts, the first first: matrices multiplied, and fields on oriented grids.

    Where fields lie along the axes of space, one on a turned grid is written as three maps: M into the axes of the
    field, the field u, and M⁻¹ back. That is x → M⁻¹ (M x + u(M x)) = x + L u(M x), with L the linear part of M⁻¹: one
    field of the vectors L u, whose samples lie where M⁻¹ puts those of u. These are found before matrices that follow
    each other are multiplied, so that a field's own matrices are not lost among others; and after that, since a
    sequence may spell each of them as several.
    """
    made: list[Content] = []
    for part in _oriented(parts):
        if made and isinstance(part, np.ndarray) and isinstance(made[-1], np.ndarray):
            made[-1] = np.asarray(part @ made[-1])
        else:
            made.append(part)
    return _oriented(made)


def _oriented(parts: Iterable[Content]) -> list[Content]:
    """Return the parts with a matrix, a field and the inverse of the matrix as one field."""
    made: list[Content] = []
    for part in parts:
        made.append(part)
        while len(made) > 2 and (whole := _one_field(*made[-3:])) is not None:
            made[-3:] = [whole]
    return made


def _one_field(before: Content, field: Content, after: Content) -> Displacements | None:
    """Return three maps as one field; None if they are no matrix, field and inverse, or their grid is sheared."""
    if isinstance(before, Displacements) or not isinstance(field, Displacements) or isinstance(after, Displacements):
        return None
    matrix = after @ field.grid.matrix
    if not abs(np.linalg.det(matrix)) > 0:
        return None
    # by how many voxels positions are off at most
    off = np.abs(inverse(matrix) @ (after @ before - np.eye(len(after))) @ matrix)[:-1] @ [*field.grid.sizes, 1]
    if off.max() > _EXACT:
        return None
    spacing = np.linalg.norm(matrix[:-1, :-1], axis=0)
    try:
        grid = Grid(field.grid.shape, spacing.tolist(), matrix[:-1, -1].tolist(), matrix[:-1, :-1] / spacing)
    except SuppleError:  # the axes lie in a plane
        return None
    if grid.shear:
        return None
    values = np.empty_like(field.values)
    for k, plane in enumerate(field.values):
        values[k] = plane @ after[:-1, :-1].T
    return field._replace(values=values, grid=grid)
