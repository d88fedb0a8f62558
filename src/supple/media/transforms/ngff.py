"""Coordinate transformations of OME-Zarr (OME-NGFF), from RFC-5 and version 0.6 on: a folder, a Zarr store.

A transformation leads from its input to its output: as a pull map, its input is the space of the resampled image, its
output that of the image that is resampled. Axes stand in the order of arrays, z first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from supple.media.files import PathLike, check_suffix, replacing_together, unwritable
from supple.media.transforms.base import Content, Displacements, Grids, Matrix, check_content, inverse
from supple.media.transforms.omezarr import Store, imported

SUFFIXES = (".zarr",)
VERSION = "0.6"
_FIELDS = "coordinateTransformations"
_ARRAY = "s0"
_SIDES = {2: 512, 3: 64}  # of chunks


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read the coordinate transformation of an OME-Zarr store, of Zarr format 2 or 3, as parts that apply in order.

    The folder is a scene, a multiscale image or a transformation by itself, with one transformation of two or three
    space axes: identity, scale, translation, rotation, affine, mapAxis, byDimension of these; displacements or
    coordinates, whose field is a multiscale group or, as in drafts of RFC-5, an array; a sequence of these; or a
    bijection, of which the forward part is read.

    Parts are x first. Lengths that have a unit are in millimetres, those without are left as they are; axes that have
    an anatomical orientation are turned to LPS, others are left as they are. A field between an affine map and its
    inverse, as `write` makes them, is one field on an oriented grid, if its axes are at right angles. The format does
    not say what a field is beyond its edges: it is taken as no displacement.
    """
    check_suffix(path, Path(path).suffix, SUFFIXES, "is of no OME-Zarr store", "use .zarr", "read")
    return Store(path).contents()


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a map as an OME-Zarr scene of version 0.6, whose transformation leads from the output to the input image.

    Fields of volumes are in millimetres, those of pictures in pixels. A field whose grid is turned is written as a
    sequence: an affine map, the field along its own axes, and the map back; `read` makes one field of it. What a field
    is beyond its edges, the format does not say.
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
        for k, (one, back) in enumerate(fields):
            _write_field(root, k, one, back)


def _axes(n: int) -> list[dict[str, Any]]:
    unit = {"unit": "millimeter"} if n == 3 else {}
    return [{"name": name, "type": "space", "discrete": False, **unit} for name in "zyx"[-n:]]


def _affine(matrix: Matrix) -> dict[str, Any]:
    """Return an affine map as a transformation, z first."""
    n = len(matrix) - 1
    return {"type": "affine", "affine": matrix[:-1][::-1][:, [*range(n)[::-1], n]].tolist()}


class Placement(NamedTuple):
    """Where the samples of a field lie, in the order of an array's axes and in the units of these."""

    shape: Sequence[int]
    scale: Sequence[float]
    translation: Sequence[float]


def bijection(
    axes: Sequence[Mapping[str, Any]], forward: Placement, inverse: Placement, name: str
) -> tuple[dict[str, bytes], tuple[str, str]]:
    """Return the metadata of a scene that holds both directions of a map, as fields without samples yet.

    Parameters
    ----------
    axes : sequence of mapping
        The descriptions of the axes of space, of both images.
    forward : Placement
        Of the field from the output image to the input image, on the grid of the output.
    inverse : Placement
        Of that from the input to the output, on the grid of the input.
    name : str
        Of the transformation.

    Returns
    -------
    dict of bytes
        All files of metadata, by their keys in the store.
    tuple of str
        The paths of the arrays of ``forward`` and ``inverse``: float32, of shape (components, ...), the components in
        the order of the axes. The fill value is 0; chunks hold all components, of 64 samples along each axis of a
        volume and 512 of a picture: two or three megabytes, a good size for an object, and whole patches of the map.
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
    # "linear" or "cubic", as the schema has it; its text calls the latter bspline-cubic
    return {"type": "displacements", "path": f"{_FIELDS}/{index}", "interpolation": interpolation}


def _scene(store: Any, transformation: Mapping[str, Any], axes: Sequence[Mapping[str, Any]]) -> Any:
    """Create the group of a scene of one transformation, from the output to the input; return it."""
    systems = [{"name": name, "axes": list(axes)} for name in ("output", "input")]
    ends = {"input": {"name": "output"}, "output": {"name": "input"}}
    scene = {"coordinateSystems": systems, "coordinateTransformations": [{**transformation, **ends}]}
    return imported().create_group(store, attributes={"ome": {"version": VERSION, "scene": scene}})


def _field(
    root: Any, index: int, axes: Sequence[Mapping[str, Any]], samples: Placement, dtype: Any, **more: Any
) -> Any:
    """Create the array of a field, as a multiscale image of one scale; return it."""
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


def _write_field(root: Any, index: int, field: Displacements, turn: Matrix) -> None:
    """Write a field along the axes of its grid, to which ``turn`` leads."""
    grid, n = field.grid, field.grid.ndim
    values = field.values if np.array_equal(turn, np.eye(n + 1)) else field.values @ turn[:-1, :-1].T
    dtype = np.float64 if field.values.dtype.itemsize == 8 else np.float32
    origin = turn[:-1, :-1] @ grid.origin
    samples = Placement(grid.shape, grid.spacing[::-1], origin[::-1].tolist())
    _field(root, index, _axes(n), samples, dtype)[...] = np.moveaxis(values[..., ::-1], -1, 0).astype(dtype)
