"""Coordinate transformations of OME-Zarr (OME-NGFF), from RFC-5 and version 0.6 on: a folder, a Zarr store.

A transformation leads from its input to its output: as a pull map, its input is the space of the resampled image, its
output that of the image that is resampled. Axes stand in the order of arrays, z first.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from supple.geometry import Grid
from supple.media.files import PathLike, check_store, check_suffix, unwritable
from supple.media.transforms.base import Content, Displacements, Matrix
from supple.media.transforms.omezarr import Store, imported

SUFFIXES = (".zarr",)
UNAMBIGUOUS = SUFFIXES
VERSION = "0.6"
_FIELDS = "coordinateTransformations"
_INTERPOLATION = {"linear": "linear", "cubic": "cubic"}  # so the schema; its text calls the latter bspline-cubic


def read(path: PathLike, *, source: Grid | None = None) -> tuple[Content, ...]:
    """Read the coordinate transformation of an OME-Zarr store.

    Parameters
    ----------
    path : str or os.PathLike
        The folder, of Zarr format 2 or 3: a scene, a multiscale image or a transformation by itself, with one
        transformation of two or three space axes: identity, scale, translation, rotation, affine, mapAxis, byDimension
        of these; displacements or coordinates, whose field is a multiscale group or, as in drafts of RFC-5, an array;
        a sequence of these; or a bijection, of which the forward part is read.
    source : Grid, optional
        Not needed.

    Returns
    -------
    tuple of Content
        x first. Lengths that have a unit are in millimetres, those without are left as they are; axes that have an
        anatomical orientation are turned to LPS, others are left as they are. A field between an affine map and its
        inverse, as `write` makes them, is one field on an oriented grid, if its axes are at right angles. The format
        does not say what a field is beyond its edges: it is taken as no displacement.

    Raises
    ------
    SuppleError
        If the folder cannot be read, holds no transformation or several, or one that is not of these.
    """
    check_suffix(path, Path(path).suffix, SUFFIXES, "is of no OME-Zarr store", "use .zarr", "read")
    return Store(path).contents()


def write(path: PathLike, contents: Sequence[Content], *, source: Grid | None = None, force: bool = False) -> None:
    """Write a map as an OME-Zarr scene of version 0.6, whose transformation leads from the output to the input image.

    Fields of volumes are in millimetres, those of pictures in pixels. A field whose grid is turned is written as a
    sequence: an affine map, the field along its own axes, and the map back; `read` makes one field of it. What a field
    is beyond its edges, the format does not say.

    Parameters
    ----------
    path : str or os.PathLike
        The folder, with the suffix ``.zarr``. It appears whole or not at all.
    contents : sequence of Content
        Matrices and fields of one dimension, of which the first applies first.
    source : Grid, optional
        Not needed.
    force : bool
        Whether to replace an existing Zarr store.

    Raises
    ------
    SuppleError
        If there is nothing to write, a field holds coefficients of a spline, NaN or infinity, or the folder cannot be
        written.
    """
    check_suffix(path, Path(path).suffix, SUFFIXES, "is of no OME-Zarr store", "use .zarr")
    sizes = {len(one) - 1 if isinstance(one, np.ndarray) else one.grid.ndim for one in contents}
    if len(sizes) != 1:
        raise unwritable(path, f"the map has parts of {sorted(sizes) or 'no'} dimensions", "give parts of 2, or of 3")
    (n,) = sizes
    for one in contents:
        if isinstance(one, Displacements) and one.interpolation not in _INTERPOLATION:
            what = "OME-Zarr holds displacements, and the field has coefficients of a spline"
            raise unwritable(path, what, "sample it first")
        if not all(np.isfinite(part).all() for part in (one if isinstance(one, np.ndarray) else one.values)):
            raise unwritable(path, "the map holds NaN or infinity", "mend it first")
    zarr = imported()
    with _replacing_store(path, force) as temporary:
        fields: list[str] = []
        steps: list[dict[str, Any]] = []
        for one in contents:
            if isinstance(one, np.ndarray):
                steps.append(_affine(one))
                continue
            name = f"{_FIELDS}/{len(fields)}"
            fields.append(name)
            turn: Matrix = np.eye(n + 1)
            turn[:-1, :-1] = one.grid.direction
            back: Matrix = np.asarray(np.linalg.inv(turn), np.float64)
            plain = np.array_equal(turn, np.eye(n + 1))
            _write_field(zarr.create_group(str(temporary / name)), one, back)
            step = {"type": "displacements", "path": name, "interpolation": _INTERPOLATION[one.interpolation]}
            steps += [step] if plain else [_affine(back), step, _affine(turn)]
        whole = steps[0] if len(steps) == 1 else {"type": "sequence", "transformations": steps}
        systems = [{"name": name, "axes": _axes(n)} for name in ("output", "input")]
        ends = {"input": {"name": "output"}, "output": {"name": "input"}}
        scene = {"coordinateSystems": systems, "coordinateTransformations": [whole | ends]}
        zarr.create_group(str(temporary), overwrite=False, attributes={"ome": {"version": VERSION, "scene": scene}})
        if fields:
            zarr.open_group(str(temporary), mode="r+").require_group(_FIELDS)


def _axes(n: int) -> list[dict[str, Any]]:
    unit = {"unit": "millimeter"} if n == 3 else {}
    return [{"name": name, "type": "space", "discrete": False, **unit} for name in "zyx"[-n:]]


def _affine(matrix: Matrix) -> dict[str, Any]:
    """Return an affine map as a transformation, z first."""
    n = len(matrix) - 1
    return {"type": "affine", "affine": matrix[:-1][::-1][:, [*range(n)[::-1], n]].tolist()}


def _write_field(group: Any, field: Displacements, turn: Matrix) -> None:
    """Write a field along the axes of its grid, to which ``turn`` leads, as a multiscale image of one scale."""
    grid, n = field.grid, field.grid.ndim
    values = field.values if np.array_equal(turn, np.eye(n + 1)) else field.values @ turn[:-1, :-1].T
    dtype = np.float64 if field.values.dtype.itemsize == 8 else np.float32
    stored = np.moveaxis(values[..., ::-1], -1, 0).astype(dtype)
    vector = {"name": "c", "type": "displacement", "discrete": True}
    origin = turn[:-1, :-1] @ grid.origin
    steps = [
        {"type": "scale", "scale": [1.0, *grid.spacing[::-1]]},
        {"type": "translation", "translation": [0.0, *origin[::-1].tolist()]},
    ]
    ends = {"input": {"path": "s0"}, "output": {"name": "physical"}}
    image = {
        "name": "displacements",
        "coordinateSystems": [{"name": "physical", "axes": [vector, *_axes(n)]}],
        "datasets": [
            {"path": "s0", "coordinateTransformations": [{"type": "sequence", "transformations": steps, **ends}]}
        ],
    }
    group.attrs["ome"] = {"version": VERSION, "multiscales": [image]}
    array = group.create_array("s0", shape=stored.shape, dtype=dtype, dimension_names=["c", *"zyx"[-n:]])
    array[...] = stored


@contextlib.contextmanager
def _replacing_store(path: PathLike, force: bool) -> Iterator[Path]:
    """Write a hidden folder beside a store's place, and move it there when it is complete."""
    target = check_store(path, force=force)
    exists = os.path.lexists(target)
    token = f".{os.urandom(6).hex()}"
    temporary, old = target.with_name(f"{token}-{target.name[-40:]}"), target.with_name(f"{token}-old")
    try:
        temporary.mkdir()
        yield temporary
        if exists:
            os.rename(target, old)
        try:
            os.rename(temporary, target)
        except OSError:
            if exists:
                os.rename(old, target)
            raise
    except OSError as error:
        raise unwritable(path, error.strerror or str(error), "make room or choose another place") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
