"""Writing deformations as displacement fields: of volumes for other programs, of stored images as OME-Zarr scenes.

A scene holds fields for both directions of the map, which are written block by block.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.blocks import Box, Warp, boxes_of, chunks_of
from supple.deformation import Deformation
from supple.engine.core import certificate_of, forward, plan_of
from supple.engine.memory import beside
from supple.engine.sampling import Certificate, warn_of
from supple.engine.work import Space, Tell
from supple.errors import SuppleError, shown
from supple.fields import Placed, folds_of, only_name, warn_of_maps
from supple.files.tasks import Runner, advancing, check_seen
from supple.media.files import PathLike, check_output, is_store
from supple.media.stores.image import StoredImage
from supple.media.stores.places import overlap
from supple.media.stores.target import Target, check_free, create_arrays
from supple.media.transforms import check_target, ngff
from supple.media.transforms import write_field as write_displacements
from supple.space.checks import number
from supple.space.geometry import Floats, Geometry, Grid

MOST = 1 << 27
"""The most bytes of a field that is kept in memory; larger ones are mapped from a temporary file."""
ROUNDING = 2.0**-22
"""The accuracy of source points in samples: the core stores their fractions as float32."""
PULL, PUSH = range(2)
_WAYS = ("forward", "inverse")  # the format's names
_AT_ONCE = 4096  # tasks in the queue
_SOLVED = 1e-9  # samples: the accuracy of T where it is solved iteratively


def displacement_of(
    deformation: Deformation,
    geometry: Geometry,
    *,
    tolerance: float = 0.01,
    out: npt.NDArray[np.float32] | None = None,
    grid: Grid | None = None,
    warn: bool = True,
) -> npt.NDArray[np.float32]:
    """Return the displacement from each voxel of the output to its source point in the input.

    Parameters
    ----------
    deformation : Deformation
        A deformation of a volume.
    geometry : Geometry
        The geometry of the volume; of the output, if that has another grid.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in voxels.
    out : float32 array, optional
        The array for the result; it may be mapped from a file.
    grid : Grid, optional
        The grid of the output, if it is not that of the input; the deformation must then have a grid in space.
    warn : bool
        Whether to give a ToleranceWarning if the checks of the map's cells do not promise the tolerance everywhere.

    Returns
    -------
    float32 array, shape (Z, H, W, 3)
        The position of T⁻¹(q) minus that of q, in millimetres along the axes of LPS, x first.
    """
    if deformation.ndim != 3:
        raise SuppleError(f"a displacement field is of a volume, and shape {deformation.shape} has two axes")
    tolerance = number("tolerance", tolerance, "a number of voxels from 1e-9 to 1e9", 1e-9, 1e9)
    space = deformation.space_on(grid)
    made = np.empty((*(deformation if grid is None else grid).shape, 3), np.float32) if out is None else out
    if space.is_identity:
        made[...] = 0
        return made
    matrix: Floats = geometry.matrix[:3, :3] if grid is None else deformation.grid.matrix[:3, :3]
    certificate = pull_of(space, matrix, tolerance, made, None if grid is None else between(deformation.grid, grid))
    if warn:
        warn_of(certificate, tolerance)
    return made


def between(own: Grid, grid: Grid) -> tuple[Floats, Floats]:
    """Return the matrix and the shift from indices on ``grid`` (uncropped) to indices on ``own``, in the same space."""
    whole = grid.uncropped()
    turned = np.linalg.solve(own.matrix[:-1, :-1], whole.matrix[:-1, :-1])
    return np.asarray(turned, np.float64), own.indices(whole.origin)


def pull_of(
    space: Space,
    matrix: Floats,
    tolerance: float,
    out: npt.NDArray[np.float32],
    turned: tuple[Floats, Floats] | None = None,
) -> Certificate:
    """Write T⁻¹(q) - q to ``out``, for all samples q of the output, or of the part that is the grid of ``space``.

    ``matrix`` converts a vector in samples of the input, x first, to the written one; ``turned``, a matrix and a shift
    as from `between`, converts indices of the output to indices of the input, if their grids differ. The returned
    certificate is that of T⁻¹, in samples, before rounding to float32.
    """
    planes = out if space.ndim == 3 else out[None]
    first = (0,) * space.ndim if space.grid is None else space.grid.first
    certificate = Certificate(0.0, 0.0)
    # float64, since differences of positions would lose half their digits in float32.
    points, here = np.empty(planes.shape[1:]), np.zeros(planes.shape[1:])
    rows, columns = np.indices(planes.shape[1:3])
    here[..., 0], here[..., 1] = columns + first[0], rows + first[1]
    for k, plane in enumerate(planes):
        plan = plan_of(space, k, tolerance)
        plan.points(points)
        if space.ndim == 3:
            here[..., 2] = first[2] + k
        np.subtract(points, here if turned is None else here @ turned[0].T + turned[1], out=points)
        if space.composite is not None:
            points[np.abs(points) < ROUNDING] = 0  # rounding errors of solved points that do not move
        np.matmul(points, matrix.T, out=plane, casting="same_kind")
        certificate |= certificate_of(plan, space)
    return certificate


def write_transform(
    target: PathLike,
    deformation: Deformation,
    geometry: Geometry,
    *,
    tolerance: float = 0.01,
    force: bool = False,
    grid: Grid | None = None,
    warn: bool = True,
) -> None:
    """Write a deformation of a volume as a displacement field for ITK, ANTs and 3D Slicer.

    The target is ``.nii``, ``.nii.gz``, ``.nrrd``, ``.mha`` or ``.h5``; an existing file is replaced with ``force``.
    Other arguments are those of `displacement_of`.
    """
    check_target(target)
    check_output(target, force=force)
    shape = deformation.shape if grid is None else grid.shape
    with beside(target, (*shape, 3), np.float32, MOST) as out:
        made = displacement_of(deformation, geometry, tolerance=tolerance, out=out, grid=grid, warn=warn)
        write_displacements(target, made, geometry, force=force)


@dataclass(frozen=True, slots=True)
class SavedField:
    """The result of writing a job's map beside its output."""

    address: str
    tolerance: float  # the largest distance of a source point from T⁻¹(q), in samples of the input
    forward: float  # the error estimate of T⁻¹, in samples of the input; infinite if some points are unsolved
    inverse: float | None = None  # that of T: 0 without fields, as T is explicit; None if T was not written
    blocks: int = 0  # the number of chunks
    stored: int = 0  # the number of stored chunks; chunks without displacement are not stored
    done: int = 0  # the number of chunks that an interrupted job had already written


@dataclass(frozen=True, slots=True)
class Work:
    """The data that all tasks of writing a scene share."""

    target: Target
    warp: Warp
    own: Warp  # the same on the grid of the input, whose samples T maps
    scale: tuple[float, ...]

    @property
    def matrix(self) -> Floats:
        """The matrix from vectors in samples of the input, x first, to vectors along stored axes, in their units."""
        return np.ascontiguousarray(np.diag(self.scale)[:, ::-1])


def check_field(address: PathLike, others: Sequence[PathLike], *, flat: bool, force: bool) -> None:
    """Raise SuppleError, before any work, for a field that cannot be written, or that overlaps one of the ``others``.

    ``others`` are the input and the output; ``flat`` means that the map is of a picture, which requires OME-Zarr.
    """
    if any(overlap(address, other) for other in others):
        raise SuppleError(f"{shown(address)} cannot be the field and an image too: give it a place of its own")
    if is_store(address):  # it is written as a scene
        return
    if flat:
        text = f"the field of a picture is written as OME-Zarr, which {shown(address)} is not: name it .zarr"
        raise SuppleError(text)
    check_target(address)
    check_output(address, force=force)


def begin_field(
    address: PathLike, image: StoredImage, warp: Warp, samples: ngff.Placement, job: str, *, force: bool
) -> Callable[[], Work]:
    """Plan a scene of a map, along the axes of an input and in its units; return a function that creates it.

    ``samples`` is the grid of the output's samples; ``job`` identifies the job of the output.
    """
    first, axes = image.levels[0], list(image.spatial)
    scale, translation = ([values[axis] for axis in axes] for values in (first.scale, first.translation))
    own = ngff.Placement(warp.deformation.shape, scale, translation)
    files, paths = ngff.bijection(_axes(image), samples, own, "warp")
    job = f"field of {job}"
    check_free(address, files, job, force)
    both = warp, replace(warp, grid=None)
    return lambda: Work(create_arrays(address, files, paths, force=force, job=job), *both, tuple(scale))


def write_field(work: Work, runner: Runner, tell: Tell, maps: Sequence[Placed]) -> SavedField:
    """Write both directions of a map; `Target.finish` remains to be called.

    ``tell`` is called with ``"field"`` and the finished and the total number of chunks.

    Warns
    -----
    ToleranceWarning, FoldWarning, OutsideWarning
        As in `Deformation.warp` for T⁻¹, and as in `Deformation.forward` for T.
    """
    target, tolerance = work.target, work.warp.sampling.tolerance
    sizes = [chunks_of(block, array.shape) for block, array in zip(target.blocks, target.arrays, strict=True)]
    count = sum(math.prod(map(len, each)) for each in sizes)
    advance = advancing(tell, "field", count)
    items = ((way, box) for way, each in enumerate(sizes) for box in boxes_of(each))
    certificates, stored, done = [Certificate(0.0, 0.0)] * 2, 0, 0
    while some := list(itertools.islice(items, _AT_ONCE)):
        made = runner.each(_write_chunk, work, some, advance)
        for (way, _), (certificate, new, there) in zip(some, made, strict=True):
            certificates[way] |= certificate
            stored += new or there
            done += there
    pull, push = certificates
    warn_of_maps(pull, tolerance, maps)
    solved = folds_of(replace(each, inverse=not each.inverse) for each in maps)
    solved = solved and f"{solved}, as it is solved for {shown(target.address)}"
    warn_of(push, tolerance, folds=solved, field_name=only_name(maps))
    target.note(
        {**{way: _told(one, tolerance) for way, one in zip(_WAYS, certificates, strict=True)}, "chunks": stored}
    )
    return SavedField(target.address, tolerance, _error(pull), _error(push), count, stored, done)


def _write_chunk(work: Work, item: tuple[int, Box]) -> tuple[Certificate, bool, bool]:
    """Write a chunk of one direction; return its certificate, whether it was written, and whether it existed.

    A chunk without displacement is not stored. An existing chunk is solved again, so that the report covers all chunks,
    but it is not written.
    """
    (way, box), target = item, work.target
    check_seen(target.site)
    done = target.begun and target.is_done(way, box)
    values, certificate = (_pulled if way == PULL else _pushed)(work, box[1:], done)
    new = values is not None and bool(values.any())
    if values is not None and new:
        target.write(way, box, np.moveaxis(values, -1, 0))
    return certificate, new, done


def _pulled(work: Work, box: Box, done: bool) -> tuple[npt.NDArray[np.float32] | None, Certificate]:
    """Return T⁻¹(q) - q for the samples of a part of the output; no values if it is stored already."""
    warp, space, tolerance = work.warp, work.warp.space(box), work.warp.sampling.tolerance
    if done:
        certificate = Certificate(0.0, 0.0)
        for k in _planes(box):
            certificate |= certificate_of(plan_of(space, k, tolerance), space)
        return None, certificate
    own, grid = warp.deformation.grid, warp.grid
    turned = None if grid is None or grid.uncropped().is_same_space(own) else between(own, grid)
    out = np.empty((*_shape(box), len(box)), np.float32)
    return out, pull_of(space, work.matrix, tolerance, out, turned)


def _pushed(work: Work, box: Box, done: bool) -> tuple[npt.NDArray[np.float32] | None, Certificate]:
    """Return T(p) - p for the samples of a part of the input; no values if it is stored already."""
    space, certificate = work.own.packed(), Certificate(0.0, 0.0)
    if done and space.composite is None:
        return None, certificate
    first, part = np.array(box)[::-1, 0], work.own.space(box)
    out = np.zeros((*_shape(box), len(box)), np.float32)
    rows, columns = np.indices(_shape(box)[-2:])
    points = np.empty((*rows.shape, len(box)))
    points[..., 0], points[..., 1] = columns + first[0], rows + first[1]
    for k, plane in zip(_planes(box), out if len(box) == 3 else out[None], strict=True):
        # T is the identity wherever T⁻¹ is, which the plan knows.
        if space.composite is None and plan_of(part, k, work.warp.sampling.tolerance).identity:
            continue
        if len(box) == 3:
            points[..., 2] = first[2] + k
        moved, found = forward(space, points)
        certificate |= found
        moved -= points
        if space.composite is not None:
            moved[np.abs(moved) < _SOLVED] = 0
        np.matmul(moved, work.matrix.T, out=plane, casting="same_kind")
    return None if done else out, certificate


def _planes(box: Box) -> range:
    return range(_shape(box)[0]) if len(box) == 3 else range(1)


def _shape(box: Box) -> tuple[int, ...]:
    return tuple(stop - start for start, stop in box)


def _error(certificate: Certificate) -> float:
    return math.inf if certificate.unknown else certificate.error


def _told(certificate: Certificate, tolerance: float) -> dict[str, Any]:
    """Return the facts on one direction for the attributes of the scene, in samples of the input."""
    error = _error(certificate)
    told: dict[str, Any] = {"tolerance": tolerance, "error": error if math.isfinite(error) else None}
    bad = {"unsolved": certificate.unknown, "folded": certificate.folded, "outside": certificate.outside}
    return {**told, **{key: count for key, count in bad.items() if count}}


def _axes(image: StoredImage) -> list[Mapping[str, Any]]:
    """Return the metadata of the axes of space, in agreement with `StoredImage.grid`."""
    axes = [image.axes[axis] for axis in image.spatial]
    if not image.version:
        return [{"name": name, "type": "space", "discrete": False} for name in "zyx"[-len(axes) :]]
    whole = len(axes) == sum(axis.kind == "space" for axis in image.axes)
    made: list[Mapping[str, Any]] = []
    for axis in axes:
        told = {"unit": axis.unit if image.placed else None, "orientation": axis.orientation if whole else None}
        known = {key: one for key, one in told.items() if one}
        made.append({"name": axis.name, "type": "space", "discrete": False, **known})
    return made
