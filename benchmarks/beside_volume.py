"""The fifth job of `beside.py`: a point of a head is moved by 12 mm, by Supple and by SimpleITK."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from measure import alone, grid_of, in_turn, seconds, wall
from scipy import ndimage

import supple
from supple.media import volume as media

Floats = npt.NDArray[np.float64]

DATA = "examples/data/head.nii.gz"
SPACING = 2.0  # mm
START, BY, RADIUS = np.array([45.0, 88.0, 62.0]), np.array([0.0, -6.0, 0.0]), 20.0  # voxels, voxels, mm
CONTROL = 12  # of the B-spline, along each axis: of 4, 8, 12, 16, 24 and 32, its bump is most like ours

STRICT: dict[str, Any] = {
    "maximumNumberOfIterations": 200,
    "maxErrorToleranceThreshold": 0.01,
    "meanErrorToleranceThreshold": 0.0,
    "enforceBoundaryCondition": False,
}


def lookup(moved: Floats, at: Floats) -> Floats:
    """Displacements in voxels at any points, linear between samples, as SimpleITK's fields are."""
    places = np.moveaxis(at, -1, 0)[::-1]
    return np.stack([ndimage.map_coordinates(moved[..., k], places, order=1, mode="nearest") for k in range(3)], -1)


def folded(of: Floats) -> int:
    """How many cells of a map have a corner where it is turned over."""
    across = [np.diff(of, axis=2)[:-1, :-1], np.diff(of, axis=1)[:-1, :, :-1], np.diff(of, axis=0)[:, :-1, :-1]]
    return int((np.linalg.det(np.stack(across, axis=-1)) <= 0).sum())


def landmarks(shape: tuple[int, ...]) -> tuple[list[float], list[float]]:
    """Where points are in the result and in the head, in mm: the one that moves, and a grid of those that stay."""
    counts = [round((n - 1) * SPACING / (2 * RADIUS)) + 1 for n in shape[::-1]]
    axes = [np.linspace(0, n - 1, count) for n, count in zip(shape[::-1], counts, strict=True)]
    stay = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    ends = np.stack([START, START + BY])
    apart = np.linalg.norm(stay[:, None] - ends, axis=-1).min(axis=1) * SPACING
    stay = stay[apart > 2.5 * RADIUS]
    fixed = np.concatenate([[START + BY], stay]) * SPACING
    moving = np.concatenate([[START], stay]) * SPACING
    return fixed.ravel().tolist(), moving.ravel().tolist()


def returned(back: Floats, forth: Floats) -> Floats:
    """How far from where it was a point is that went forth and back, in mm; 0 where it left the grid."""
    grid = grid_of(back.shape[:3])
    error = np.linalg.norm(forth + lookup(back - grid, forth) - grid, axis=-1)
    inside = ((forth >= 0) & (forth <= np.array(back.shape[2::-1]) - 1)).all(axis=-1)
    return np.asarray(np.where(inside, error * SPACING, 0.0))


def row(name: str, back: Floats, worst: float, times: str) -> str:
    """A line: ``back`` is which point a voxel shows, in voxels."""
    grid = grid_of(back.shape[:3])
    miss = np.linalg.norm((START + BY + lookup(back - grid, (START + BY)[None])[0]) - START) * SPACING
    far = np.linalg.norm(grid - START, axis=-1) * SPACING > 4 * RADIUS
    far &= np.linalg.norm(grid - START - BY, axis=-1) * SPACING > 4 * RADIUS
    moved = np.linalg.norm(back - grid, axis=-1)[far].max() * SPACING
    return f"| {name} | {miss:.2f} mm | {folded(back)} | {moved:.2f} mm | {worst:.3f} mm | {times} |"


def ours(shape: tuple[int, ...]) -> supple.Deformation:
    """The stroke."""
    return supple.Deformation(shape, spacing=(SPACING,) * 3).grab(tuple(START), by=tuple(BY), radius=RADIUS)


def volume(quick: bool, runs: int) -> Iterator[str]:
    """The table."""
    head = media.read(Path(supple.__file__).parent / DATA).samples
    yield (
        "| | misses by | folded cells | beyond 4 radii: moved by up to | worst error of the inverse | time | "
        "ours, in turn | × ours |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    shape = (head.shape[0], head.shape[1], head.shape[2])

    def whole() -> Any:
        d = ours(shape)
        return d.warp(head, filter="linear"), d.inverse_map(), d.forward(grid)

    grid = grid_of(shape)
    d = ours(shape)
    back = np.asarray(d.inverse_map(), np.float64)
    worst = np.linalg.norm(d.forward(back) - grid, axis=-1).max() * SPACING
    some = 1 if quick else min(runs, 3)
    yield row("Supple", back, worst, f"{seconds(alone(whole, wall, some).median)} | |")
    try:
        sitk = importlib.import_module("SimpleITK")
    except ImportError:
        yield "| SimpleITK | is not installed | | | | | | |"
        return
    for name, strict in (("SimpleITK, inverse by its defaults", False), ("SimpleITK, inverse to 0.01 voxels", True)):
        made = itk(sitk, head, strict)
        b, f = made()
        error = returned(b, f)
        yield row(name, b, float(error.max()), in_turn(made, whole, wall, some))


def itk(sitk: Any, head: npt.NDArray[Any], strict: bool) -> Any:
    """What bends the head and maps points by SimpleITK, and returns the two maps."""
    image = sitk.GetImageFromArray(head)
    image.SetSpacing((SPACING,) * 3)
    fixed, moving = landmarks(head.shape)
    grid = grid_of(head.shape)

    def made() -> tuple[Floats, Floats]:
        start = sitk.BSplineTransformInitializer(image, [CONTROL - 3] * 3, 3)
        spline = sitk.LandmarkBasedTransformInitializer(
            start, fixed, moving, referenceImage=image, numberOfControlPoints=CONTROL
        )
        sitk.Resample(image, image, spline, sitk.sitkLinear, 0.0)
        field = sitk.TransformToDisplacementField(
            spline, sitk.sitkVectorFloat64, image.GetSize(), image.GetOrigin(), image.GetSpacing(), image.GetDirection()
        )
        asked = dict(STRICT) if strict else {}
        inverse = sitk.InvertDisplacementField(field, **asked)
        b, f = (grid + sitk.GetArrayFromImage(x) / SPACING for x in (field, inverse))
        return b, f

    return made
