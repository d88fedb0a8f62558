"""Coordinate transformations of OME-Zarr (OME-NGFF) 0.6: a folder, a Zarr store.

A transformation leads from its input to its output. As a pull map, its input is the space of the output image, and its
output the space of the input image. Axes are in array order, z first.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from supple.engine.work import Array
from supple.errors import SuppleError, needed
from supple.media.files import PathLike, check_suffix, refusing, replacing_together, unwritable
from supple.media.transforms.base import Content, Displacements, Grids, Matrix, check_content, inverse
from supple.media.volume.data import MILLIMETRES
from supple.space.geometry import Grid

SUFFIXES = (".zarr",)
VERSION = "0.6"
_FIELDS = "coordinateTransformations"
_ARRAY = "s0"
_SIDES = {2: 512, 3: 64}  # of chunks, by the number of axes
ORIENTATIONS = {
    "right-to-left": (0, 1.0), "left-to-right": (0, -1.0), "anterior-to-posterior": (1, 1.0),
    "posterior-to-anterior": (1, -1.0), "inferior-to-superior": (2, 1.0), "superior-to-inferior": (2, -1.0),
}  # fmt: skip
_KINDS = {"displacements": "displacement", "coordinates": "coordinate"}
_INTERPOLATION: dict[str, Literal["linear", "cubic"]] = {"linear": "linear", "cubic": "cubic"}
_EXACT = 1e-6  # of a voxel
_PARAMETERS = ("scale", "translation", "affine", "rotation", "mapAxis")
_LINEAR = ("identity", *_PARAMETERS, "byDimension")
_TYPES = (*_LINEAR, "sequence", "bijection", *_KINDS)

Json = Mapping[str, Any]
Refusal = Callable[[str, str], SuppleError]
"""A function that returns an error from a reason and an advice."""


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read the coordinate transformation of an OME-Zarr store, of Zarr format 2 or 3, as parts that apply in order.

    The folder is a scene or a multiscale image, with one transformation of two or three axes of space: identity, scale,
    translation, rotation, affine, mapAxis, or byDimension of these; displacements or coordinates; a sequence of these;
    or a bijection, of which the forward part is read.

    Parts are x first. Lengths with a unit are converted to millimetres, and axes with an anatomical orientation to LPS;
    others are kept. A field between an affine map and its inverse, as `write` writes them, becomes one field on an
    oriented grid, if its axes are at right angles. The format does not define a field beyond its edges: its
    displacement is 0 there.
    """
    check_suffix(path, Path(path).suffix, SUFFIXES, "is of no OME-Zarr store", "use .zarr", "read")
    return Store(path).contents()


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a map as an OME-Zarr scene of version 0.6, whose transformation leads from the output to the input image.

    Fields of volumes are in millimetres, those of pictures in pixels. A field on an oriented grid is written as a
    sequence: an affine map, the field along its own axes, and the map back; `read` returns one field again. The format
    does not define a field beyond its edges.
    """
    check_suffix(path, Path(path).suffix, SUFFIXES, "is of no OME-Zarr store", "use .zarr")
    sizes = {len(one) - 1 if isinstance(one, np.ndarray) else one.grid.ndim for one in contents}
    if len(sizes) != 1:
        raise unwritable(path, f"the map has parts of {sorted(sizes) or 'no'} dimensions", "give parts of 2, or of 3")
    (n,) = sizes
    for one in contents:
        if isinstance(one, Displacements) and one.interpolation == "bspline":
            what = "OME-Zarr holds displacements, and the field has coefficients of a spline"
            raise unwritable(path, what, "sample it first")
        check_content(path, one, n)
    imported()
    with replacing_together([path], force=force) as (temporary,):
        fields: list[tuple[Displacements, Matrix]] = []
        steps: list[dict[str, Any]] = []
        for one in contents:
            if isinstance(one, np.ndarray):
                steps.append(_affine(one))
                continue
            turn: Matrix = np.eye(n + 1)
            turn[:-1, :-1] = one.grid.direction
            back, plain = inverse(turn), np.array_equal(turn, np.eye(n + 1))
            step = _displacements(len(fields), one.interpolation)
            fields.append((one, back))
            steps += [step] if plain else [_affine(back), step, _affine(turn)]
        whole = steps[0] if len(steps) == 1 else {"type": "sequence", "transformations": steps}
        root = _scene(str(temporary), whole, _axes(n))
        for k, (one, back) in enumerate(fields):  # written along the axes of its grid; `back` leads to these
            grid, rotation = one.grid, back[:-1, :-1]
            values = one.values if np.array_equal(back, np.eye(n + 1)) else one.values @ rotation.T
            dtype = np.float64 if one.values.dtype.itemsize == 8 else np.float32
            samples = Placement(grid.shape, grid.spacing[::-1], (rotation @ grid.origin)[::-1].tolist())
            _field(root, k, _axes(n), samples, dtype)[...] = np.moveaxis(values[..., ::-1], -1, 0).astype(dtype)


def _axes(n: int) -> list[dict[str, Any]]:
    unit = {"unit": "millimeter"} if n == 3 else {}
    return [{"name": name, "type": "space", "discrete": False, **unit} for name in "zyx"[-n:]]


def _affine(matrix: Matrix) -> dict[str, Any]:
    n = len(matrix) - 1
    return {"type": "affine", "affine": matrix[:-1][::-1][:, [*range(n)[::-1], n]].tolist()}


class Placement(NamedTuple):
    """The grid of a field's samples: shape, scale and translation, in the order and the units of an array's axes."""

    shape: Sequence[int]
    scale: Sequence[float]
    translation: Sequence[float]


def bijection(
    axes: Sequence[Mapping[str, Any]], forward: Placement, inverse: Placement, name: str
) -> tuple[dict[str, bytes], tuple[str, str]]:
    """Return the metadata of a scene with fields for both directions of a map, without samples yet.

    ``forward`` is the grid of the output image, whose field leads to the input image; ``inverse`` is the grid of the
    input image, whose field leads back. ``axes`` describe the axes of space of both, and ``name`` is that of the
    transformation. Returned are all metadata by their keys in the store, and the paths of both arrays: float32, shape
    (components, ...), components in the order of the axes. The fill value is 0. Chunks hold all components, with 64
    samples along each axis of a volume, and 512 of a picture: two or three megabytes, and whole patches of the map.
    """
    from zarr.storage import MemoryStore

    held: dict[str, Any] = {}
    ways = {"forward": _displacements(0, "linear"), "inverse": _displacements(1, "linear")}
    root = _scene(MemoryStore(held), {"type": "bijection", "name": name, **ways}, axes)
    side = _SIDES[len(axes)]
    for k, samples in enumerate((forward, inverse)):
        chunks = (len(axes), *(min(side, size) for size in samples.shape))
        _field(root, k, axes, samples, np.float32, chunks=chunks)
    paths = (f"{ways['forward']['path']}/{_ARRAY}", f"{ways['inverse']['path']}/{_ARRAY}")
    return {key: bytes(data.to_bytes()) for key, data in held.items()}, paths


def _displacements(index: int, interpolation: str) -> dict[str, Any]:
    # "linear" or "cubic", as in the schema; the text of the specification has bspline-cubic for the latter
    return {"type": "displacements", "path": f"{_FIELDS}/{index}", "interpolation": interpolation}


def _scene(store: Any, transformation: Mapping[str, Any], axes: Sequence[Mapping[str, Any]]) -> Any:
    """Create and return the group of a scene with one transformation, from the output to the input image."""
    systems = [{"name": name, "axes": list(axes)} for name in ("output", "input")]
    ends = {"input": {"name": "output"}, "output": {"name": "input"}}
    scene = {"coordinateSystems": systems, "coordinateTransformations": [{**transformation, **ends}]}
    return imported().create_group(store, attributes={"ome": {"version": VERSION, "scene": scene}})


def _field(
    root: Any, index: int, axes: Sequence[Mapping[str, Any]], samples: Placement, dtype: Any, **more: Any
) -> Any:
    """Create and return the array of a field, as a multiscale image with one level."""
    vector = {"name": "c", "type": "displacement", "discrete": True}
    steps = [
        {"type": "scale", "scale": [1.0, *map(float, samples.scale)]},
        {"type": "translation", "translation": [0.0, *map(float, samples.translation)]},
    ]
    ends = {"input": {"path": _ARRAY}, "output": {"name": "physical"}}
    image = {
        "name": "displacements",
        "coordinateSystems": [{"name": "physical", "axes": [vector, *axes]}],
        "datasets": [
            {"path": _ARRAY, "coordinateTransformations": [{"type": "sequence", "transformations": steps, **ends}]}
        ],
    }
    attributes = {"ome": {"version": VERSION, "multiscales": [image]}}
    group = root.require_group(_FIELDS).create_group(str(index), attributes=attributes)
    names = ["c", *(axis["name"] for axis in axes)]
    return group.create_array(_ARRAY, shape=(len(axes), *samples.shape), dtype=dtype, dimension_names=names, **more)


def imported() -> Any:
    """Return the module zarr, imported at the first use."""
    return needed("zarr", "Zarr stores", "zarr")


def space_matrix(axes: Sequence[Json], units: Sequence[str | None], error: Refusal) -> Matrix:
    """Return the matrix from coordinates along axes, as stored, to millimetres in LPS, x first.

    ``axes`` are the metadata of two or three axes: names, and types and orientations if present. Coordinates along an
    axis without a unit are kept. ``error`` returns the error to raise.
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
        if unit and unit not in MILLIMETRES:
            raise error(f"its axis {names[i]} has the unit {unit!r}", "name a length, as micrometer or millimeter")
        made[order[i], i] = signs[i] * (MILLIMETRES[unit] if unit else 1.0)
    return made


def ome_of(attributes: Json) -> Json:
    """Return the OME-Zarr metadata among a group's attributes; before version 0.5, they were not under a key "ome"."""
    ome = attributes.get("ome", attributes)
    return ome if isinstance(ome, Mapping) else {}


def parsing(refused: Refusal) -> contextlib.AbstractContextManager[None]:
    """Convert errors about missing or malformed metadata to one sentence."""

    def malformed(error: Exception) -> SuppleError:
        what = f"its metadata are incomplete or malformed ({type(error).__name__}: {error})"
        return refused(what, "see the specification of OME-Zarr")

    return refusing(malformed, KeyError, TypeError, ValueError, IndexError, AttributeError)


class Store:
    """A Zarr store whose transformation is read."""

    def __init__(self, path: PathLike) -> None:
        from supple.media.stores.places import Place

        place = Place(path)
        self.error, self.reading, self.root = place.unreadable, place.reading, place.open()

    def contents(self) -> tuple[Content, ...]:
        """Return the matrices and fields in the store, in millimetres in LPS, x first."""
        with parsing(self.error):
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
        ends = [self._axes(found[end], holder) for end in ("input", "output")]
        n, m = map(len, ends)
        if n != m:
            raise self.error(f"its input has {n} axes, its output {m}", "give one of equal spaces")
        before, after = np.eye(n + 1), np.eye(n + 1)
        for matrix, own, other in ((before, 0, 1), (after, 1, 0)):
            # an axis without a unit has that of the other end
            units = [a.get("unit") or b.get("unit") for a, b in zip(ends[own], ends[other], strict=True)]
            matrix[:-1, :-1] = space_matrix(ends[own], units, self.error)
        return before, after

    def _axes(self, end: Json, holder: Json) -> list[Json]:
        """Return the axes of the coordinate system that ``end`` names: in ``holder``, or in an image at a path."""
        name, path = end["name"], end.get("path")
        ome = ome_of(self._node(path).attrs) if path else {}
        for one in (ome, *ome.get("multiscales", [])) if path else (holder,):
            for system in one.get("coordinateSystems", []):
                if system["name"] == name:
                    return list(system["axes"])
        where = f" of {path}" if path else ""
        raise self.error(f"it does not describe the coordinate system {name!r}{where}", "add it")

    def _parts(self, found: Json, n: int) -> list[Matrix | _Raw]:
        """Return the parts of a transformation, in the coordinates of the file."""
        kind = found["type"]
        if kind == "sequence":
            return [part for one in found["transformations"] for part in self._parts(one, n)]
        if kind == "bijection":
            return self._parts(found["forward"], n)
        if kind in _KINDS:
            return [self._displacements(found, n)]
        return [self._matrix(found, n)]

    def _matrix(self, found: Json, n: int) -> Matrix:
        kind, made = found["type"], np.eye(n + 1)
        if kind == "identity":
            return made
        if kind == "sequence":  # for the indices of a field
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
        if len(numbers) != n:
            raise self.error(f"its {kind} has {len(numbers)} rows, and its space {n} axes", "give one of equal spaces")
        if kind == "scale":
            made[:-1, :-1] = np.diag(numbers)
        elif kind == "translation":
            made[:-1, -1] = numbers
        elif kind == "mapAxis":
            made[:-1, :-1] = np.eye(n)[numbers.astype(int)]
        elif numbers.shape == (n, n + (kind == "affine")):
            made[:-1, : numbers.shape[1]] = numbers
        else:
            raise self.error(f"its {kind} is a matrix of shape {numbers.shape}", "give one of equal spaces")
        if not np.isfinite(made).all():
            raise self.error(f"its {kind} holds NaN or infinity", "mend it")
        return made

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

    def _field(self, path: str) -> tuple[Any, list[Json], Json]:
        """Return the array of a field, its axes, and the transformation of its indices.

        The path is of a multiscale image, or of an array that an image in a group above lists.
        """
        node, parts = self._node(path), path.strip("/").split("/")
        listed = (
            [(parts[:k], parts[k:]) for k in reversed(range(len(parts)))] if hasattr(node, "shape") else [(parts, [])]
        )
        for above, rest in listed:
            for image in ome_of(self._node("/".join(above)).attrs).get("multiscales", []):
                for dataset in image["datasets"]:
                    if not rest or dataset["path"].strip("/").split("/") == rest:
                        (step,) = dataset["coordinateTransformations"]
                        end = step["output"]["name"]
                        axes = {one["name"]: one["axes"] for one in image["coordinateSystems"]}[end]
                        return self._node("/".join([*above, dataset["path"]])), list(axes), step
        raise self.error(f"its field {path} is no multiscale image", "write it as OME-Zarr 0.6 has it")

    def _displacements(self, found: Json, n: int) -> _Raw:
        path, kind = found["path"], _KINDS[found["type"]]
        array, axes, step = self._field(path)
        types = [axis.get("type") for axis in axes]
        vector = types.index(kind) if types.count(kind) == 1 else 0
        if array.ndim != n + 1 or array.dtype.kind not in "iuf" or kind not in types or array.shape[vector] != n:
            what = f"its field {path} is of {array.dtype} and shape {array.shape}, with axes of the types {types}"
            raise self.error(what, f"give real numbers, with one axis of {n} {kind}s")
        told = found.get("interpolation") or "linear"
        if told not in _INTERPOLATION:
            raise self.error(f"its field {path} is to be interpolated by {told!r}", "use linear or cubic")
        matrix = np.delete(np.delete(self._matrix(step, n + 1), vector, 0), vector, 1)
        if not abs(np.linalg.det(matrix)) > 0:
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
    """Convert a part of a transformation to millimetres in LPS, x first; ``axes`` is the matrix from file axes."""
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
    """Return the same map with fewer parts, in order: matrices are multiplied, and fields put on oriented grids.

    A field on an oriented grid is stored as three maps: the affine map M into the axes of the field, the field u, and
    M⁻¹. Together, x → M⁻¹ (M x + u(M x)) = x + L u(M x), with L the linear part of M⁻¹: one field with the vectors L u,
    and samples at M⁻¹ of those of u. Such triples are replaced before adjacent matrices are multiplied, so that a
    field's own matrices are not merged with others; and once more after that, as each of them may be stored as several.
    """
    made: list[Content] = []
    for part in _oriented(parts):
        if made and isinstance(part, np.ndarray) and isinstance(made[-1], np.ndarray):
            made[-1] = np.asarray(part @ made[-1])
        else:
            made.append(part)
    return _oriented(made)


def _oriented(parts: Iterable[Content]) -> list[Content]:
    """Return the parts with each matrix, field and inverse of the matrix replaced by one field."""
    made: list[Content] = []
    for part in parts:
        made.append(part)
        while len(made) > 2 and (whole := _one_field(*made[-3:])) is not None:
            made[-3:] = [whole]
    return made


def _one_field(before: Content, field: Content, after: Content) -> Displacements | None:
    """Return three maps as one field; None if they are not a matrix, a field and its inverse, or sheared."""
    if isinstance(before, Displacements) or not isinstance(field, Displacements) or isinstance(after, Displacements):
        return None
    matrix = after @ field.grid.matrix
    if not abs(np.linalg.det(matrix)) > 0:
        return None
    # the largest error of positions, in voxels
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
