"""What inverting a displacement field costs, and how wrong the inverse is: against ITK's InvertDisplacementField.

    python benchmarks/fields.py --fixed ch2.nii.gz --moving ds000031_sub-01_ses-006_run-001_T1w.nii.gz

The fields are those of a registration of two heads (`heads.py`), made once and kept in a folder. These two are Colin27
at a millimetre, from Debian's package mricron-data, and another person's head, from the source archive of pydeface:

    apt-get download mricron-data && dpkg-deb -x mricron-data_*.deb . && cp usr/share/mricron/templates/ch2.nii.gz .
    pip download --no-deps --no-binary :all: pydeface==2.1.0
    tar xf pydeface-2.1.0.tar.gz --strip-components=3 pydeface-2.1.0/tests/data

Without --fixed, it is the Colin27 that Supple ships, at two millimetres; without --moving, the mirror image of the
fixed head: one real head, not two.

Both are asked for 0.01 voxel. ITK stops when the mean or the largest error is under its threshold, both in voxels, or
after so many iterations. It is asked in two ways: so that the largest error decides, which a field that folds or leads
out of the grid never lets it reach, and so that a mean of 0.001 will do, its own default.

The error is taken at every voxel x of the inverse v, as the length of v(x) + u(x + v(x)) in voxels, by SciPy's linear
interpolation in float64. Voxels that v leads out of the grid do not count, as nothing is known of u there; but where
nothing of the grid arrives, near its border, ITK may end inside it, and that counts as an error. Memory is that of a
process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import heads
import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from measure import HEAD, Row, machine, pair, run
from scipy import ndimage

import supple

Array = npt.NDArray[Any]

TOLERANCE = 0.01  # voxels
TIMES = 100  # ITK's iterations at most; more do not help, and its own default, 10, is far from enough
FIELD: Any = getattr(supple, "Field", None)
OURS_IS_THERE = hasattr(FIELD, "read") and hasattr(FIELD, "invert")  # else only ITK's half is measured
WAYS = {"ITK's": 0.0, "ITK's, a mean will do": 0.001}  # its thresholds of the mean, in voxels
SLOW = {"IterativeInverseDisplacementField": 256, "InverseDisplacementField": 64}  # peers, and the side that they bear
ROOM = 100.0  # megabytes above the field and the result that inverting may take
ALONE = {  # what reads and inverts, in a process of its own
    "ours": "import sys, supple; made = supple.Field.read(sys.argv[1]).invert()",
    "ITK's": "import sys, SimpleITK as sitk; made = sitk.InvertDisplacementField("
    "sitk.ReadImage(sys.argv[1], sitk.sitkVectorFloat32), maximumNumberOfIterations=5)",
}


# Ours: to read a field, and to invert it.


def ours_read(path: Path) -> Any:
    return FIELD.read(path)


def ours_inverted(field: Any) -> Any:
    """Return the result, with its ``field``, ``error`` in millimetres and ``status``."""
    return field.invert(tolerance=TOLERANCE)


# ITK's.


def itk_read(path: Path) -> Any:
    return sitk.ReadImage(str(path), sitk.sitkVectorFloat32)


def itk_inverted(field: Any, times: int = TIMES, mean: float = 0.0, *, border: bool = False) -> Any:
    """Return ITK's inverse; its thresholds are in voxels. ``border`` sets the displacement at the border to zero."""
    return sitk.InvertDisplacementField(
        field,
        maximumNumberOfIterations=times,
        maxErrorToleranceThreshold=TOLERANCE,
        meanErrorToleranceThreshold=mean,
        enforceBoundaryCondition=border,
    )


def itk_fixed_point(field: Any) -> Any:
    """Return the inverse of ITK's slow filter of iterations; its tolerance is in millimetres."""
    return sitk.IterativeInverseDisplacementField(
        field, numberOfIterations=100, stopValue=TOLERANCE * field.GetSpacing()[0]
    )


def itk_splines(field: Any) -> Any:
    """Return the inverse of ITK's slow filter of landmarks: a thin plate through each eighth sample."""
    return sitk.InverseDisplacementField(
        field, size=field.GetSize(), outputOrigin=field.GetOrigin(), outputSpacing=field.GetSpacing(),
        subsamplingFactor=8,
    )  # fmt: skip


# The truth.


@dataclass(frozen=True)
class Truth:
    """How far a map and its inverse together lead from each voxel, in voxels, and where the voxels come from."""

    error: npt.NDArray[np.float32]
    outside: npt.NDArray[np.bool_]  # the inverse leads out of the grid, where nothing is known of the field

    def counted(self, limit: float = TOLERANCE, where: Array | None = None) -> int:
        """How many voxels of the inside are farther off."""
        wrong = (self.error > limit) & ~self.outside
        return int((wrong if where is None else wrong & where).sum())

    @property
    def largest(self) -> float:
        return float(self.error[~self.outside].max(initial=0.0))


def truth(values: Array, inverse: Array, spacing: float) -> Truth:
    """Evaluate an inverse (Z, H, W, 3) of a field on the same grid, whose axes are those of space."""
    shape = np.array(values.shape[:3])
    error = np.empty(values.shape[:3], np.float32)
    outside = np.empty(values.shape[:3], np.bool_)
    y, x = np.meshgrid(*(np.arange(float(n)) for n in shape[1:]), indexing="ij")
    components = [values[..., k] for k in range(3)]
    for z in range(shape[0]):
        back = inverse[z].astype(np.float64) / spacing
        points = np.stack([z + back[..., 2], y + back[..., 1], x + back[..., 0]])
        there = [
            ndimage.map_coordinates(part, points, np.float64, order=1, mode="nearest") / spacing for part in components
        ]
        error[z] = np.sqrt(sum((back[..., k] + there[k]) ** 2 for k in range(3)))
        ends = (shape - 1)[:, None, None]
        outside[z] = ((points < 0) | (points > ends)).any(0)
    return Truth(error, outside)


def near_folds(values: Array, inverse: Array, spacing: float) -> npt.NDArray[np.float32]:
    """Return how far from the next fold each voxel comes, in voxels; infinity without folds."""
    folded = heads.corners(values, spacing)[1] <= 0
    if not folded.any():
        return np.full(folded.shape, np.inf, np.float32)
    away = ndimage.distance_transform_edt(~folded).astype(np.float32)
    found = np.empty_like(away)
    y, x = np.indices(folded.shape[1:])
    for z in range(len(found)):
        back = np.rint(inverse[z] / spacing).astype(int)
        at = [z + back[..., 2], y + back[..., 1], x + back[..., 0]]
        found[z] = away[tuple(np.clip(a, 0, n - 1) for a, n in zip(at, folded.shape, strict=True))]
    return found


# What is measured.


def resampled(field: Any, side: int) -> Any:
    """Return a field with fewer samples along each side, of the same extent."""
    n = field.GetSize()[0]
    grid = sitk.Image([side] * 3, sitk.sitkFloat32)
    step = field.GetSpacing()[0] * n / side
    grid.SetSpacing([step] * 3)
    grid.SetOrigin([o + (step - s) / 2 for o, s in zip(field.GetOrigin(), field.GetSpacing(), strict=True)])
    return sitk.Resample(field, grid, sitk.Transform(), sitk.sitkLinear, 0.0, sitk.sitkVectorFloat32)


def judged(what: str, whose: str, found: Truth, values: Array, inverse: Array, spacing: float) -> Iterator[Row]:
    """Rows of the largest error and of the voxels that are over the tolerance."""
    inside = int((~found.outside).sum())
    over, far = found.counted(), found.counted(0.1)
    yield Row(f"{what}: largest error of {whose}", value=f"{found.largest:.4f} voxels")
    share = f"{over} of {inside} voxels ({100 * over / inside:.4f} %), {far} over 0.1"
    yield Row(f"{what}: over {TOLERANCE:g} voxel, {whose}", value=share)
    if over:
        distance = near_folds(values, inverse, spacing)[(found.error > TOLERANCE) & ~found.outside]
        if np.isfinite(distance).all():
            ends = np.percentile(distance, [50, 90])
            yield Row(
                f"{what}: how far from a fold these come from, {whose}",
                value=f"median {ends[0]:.1f}, nine tenths within {ends[1]:.1f} voxels",
            )


def twice(values: Array, grid: supple.Grid, interpolation: Any) -> float:
    """Return how far the inverse of the inverse is from a field at most, in voxels, where all that it uses is ok."""
    first = supple.Field(values, grid, interpolation).invert()
    second = supple.Field(first.field.values, grid, interpolation).invert()
    shape, spacing = grid.shape, grid.spacing[0]
    off = np.linalg.norm(second.field.values - values, axis=-1) / spacing
    used = ~ndimage.binary_dilation(first.status != 0, iterations=2, border_value=1)
    back = np.rint(second.field.values[..., ::-1] / spacing).astype(int) + np.moveaxis(np.indices(shape), 0, -1)
    at = tuple(np.clip(back[..., k], 0, n - 1) for k, n in enumerate(shape))
    return float(off[(second.status == 0) & used[at]].max())


def held_out(side: int = 96, count: int = 8) -> Iterator[Row]:
    """Rows of the inverse of the inverse of random smooth fields, whose steepest slopes are 0.2 to 0.45."""
    rng, grid = np.random.default_rng(21), supple.Grid((side,) * 3)
    fields = []
    for _ in range(count):
        width, slope = rng.uniform(6, 16), rng.uniform(0.2, 0.45)
        noise = [ndimage.gaussian_filter(rng.normal(size=grid.shape), width) for _axis in range(3)]
        made = np.stack(noise, -1)
        made *= slope / max(np.linalg.norm(np.diff(made, axis=k), axis=-1).max() for k in range(3))
        fields.append(made.astype(np.float32))
    for kind in ("linear", "cubic"):
        worst = max(twice(made, grid, kind) for made in fields)
        what = f"{count} random smooth fields of {side}³, {kind}: inverse of the inverse, off by at most"
        yield Row(what, value=f"{worst:.4f} voxels", bar="≤ 0.02", holds=worst <= 0.02)


def memory(what: str, path: Path) -> Iterator[Row]:
    """Rows of the peak of processes that read the field and invert it."""
    values = np.prod(itk_read(path).GetSize())
    field = 12 * values / 1e6
    bar = field + (12 + 4 + 1) * values / 1e6 + ROOM
    for whose in (*(["ours"] if OURS_IS_THERE else []), "ITK's"):
        peak = run([sys.executable, "-c", ALONE[whose], str(path)])[1]
        limit, holds = (f"≤ {bar:.0f}", peak <= bar) if whose == "ours" else ("", None)
        yield Row(f"{what}: peak memory, {whose}", value=f"{peak:.0f} MB", bar=limit, holds=holds)


def rows(kind: str, path: Path, runs: int, keep: Path | None) -> Iterator[Row]:
    """All that is said of a field."""
    image = itk_read(path)
    spacing, side = image.GetSpacing()[0], image.GetSize()[0]
    values = sitk.GetArrayViewFromImage(image)
    what = f"{kind} {side}³"
    told = path.with_suffix(".json")
    if told.exists():
        known = json.loads(told.read_text())
        yield Row(
            what, value=", ".join(f"{k} {v:.5g}" if isinstance(v, float) else f"{k} {v}" for k, v in known.items())
        )

    kept: dict[str, Any] = {}
    field = ours_read(path) if OURS_IS_THERE else None

    def ours() -> None:
        if field is not None:
            kept["ours"] = ours_inverted(field)

    for way, mean in WAYS.items():

        def peer(way: str = way, mean: float = mean) -> None:
            kept[way] = itk_inverted(image, mean=mean)

        a, b, ratio = pair(ours, peer, runs, warm=False)
        title = f"{what}: ours / {way}, asked for {TOLERANCE:g} voxel"
        if field is None:
            yield Row(title, "not there", f"{b:.2f} s", runs=runs)
        else:
            bar = 0.02 if kind != "smooth" and mean == 0 else None
            limit, holds = ("≤ 0.02", ratio <= bar) if bar else ("", None)
            yield Row(title, f"{a:.2f} s", f"{b:.2f} s", f"{ratio:.4f}", bar=limit, holds=holds, runs=runs)
    inverses = {way: sitk.GetArrayViewFromImage(kept[way]) for way in WAYS}
    if field is not None:
        result = kept["ours"]
        inverses["ours"] = result.field.values
    for whose, inverse in inverses.items():
        found = truth(values, inverse, spacing)
        yield from judged(what, whose, found, values, inverse, spacing)
        if keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            name = "-".join(whose.lower().replace("'s", "").replace(",", "").split())
            np.savez(keep / f"{kind}_{side}_{name}.npz", inverse=inverse, error=found.error, outside=found.outside)
        if field is not None:
            clean = found.counted(where=result.status == 0)
            bar, holds = ("≤ 0", clean == 0) if whose == "ours" else ("", None)
            row = f"{what}: over it among the voxels that ours says are well, {whose}"
            yield Row(row, value=f"{clean}", bar=bar, holds=holds)
        if whose == "ours":
            said = np.bincount(result.status.ravel(), minlength=4)
            yield Row(f"{what}: well, folded, outside, unconverged", value=", ".join(map(str, said)))
            apart = np.abs(result.error / spacing - found.error)[~found.outside & (result.status == 0)].max(initial=0.0)
            yield Row(f"{what}: the error that ours tells, off by at most", value=f"{apart:.4f} voxels")
            if kind == "smooth":
                for way in ("linear", "cubic"):
                    off = twice(field.values, field.grid, way)
                    yield Row(f"{what}: inverse of the inverse, {way}, off by at most", value=f"{off:.4f} voxels")
    yield from memory(what, path)


def slow_rows(kind: str, path: Path) -> Iterator[Row]:
    """ITK's other filters, on fewer samples."""
    makers: dict[str, Callable[[Any], Any]] = {
        "IterativeInverseDisplacementField": itk_fixed_point,
        "InverseDisplacementField": itk_splines,
    }
    for name, side in SLOW.items():
        image = itk_read(path)
        side = min(side, image.GetSize()[0])
        small = resampled(image, side)
        kept: list[Any] = []
        _, seconds, _ = pair(lambda: None, lambda m=makers[name], s=small, k=kept: k.append(m(s)), 1, warm=False)
        values, inverse = sitk.GetArrayViewFromImage(small), sitk.GetArrayViewFromImage(kept[0])
        found = truth(values, inverse, small.GetSpacing()[0])
        over = f"largest error {found.largest:.3f}, {found.counted()} voxels over {TOLERANCE:g}"
        yield Row(f"{kind} {side}³: ITK's {name}", "", f"{seconds:.2f} s", over)


def cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "supple-benchmarks"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fixed", type=Path, default=heads.SHIPPED, help="a head (Supple's own)")
    parser.add_argument("--moving", type=Path, help="another head (the mirror image of the fixed one)")
    parser.add_argument("--data", type=Path, default=cache(), help=f"where the fields are kept ({cache()})")
    parser.add_argument("--side", type=int, default=256, help="samples of the field along each axis (256)")
    parser.add_argument("--kinds", nargs="+", choices=heads.KINDS, default=list(heads.KINDS), help="which fields (all)")
    parser.add_argument("--runs", type=int, default=3, help="pairs of runs (3)")
    parser.add_argument("--slow", action="store_true", help="ITK's slower filters too, on fewer samples")
    parser.add_argument("--keep", type=Path, help="a folder for the inverses and their errors")
    asked = parser.parse_args()
    for path in (asked.fixed, asked.moving):
        if path is not None and not path.exists():
            parser.error(f"{path} does not exist; --help says how to get two heads")
    folder = asked.data / heads.named(asked.fixed, asked.moving)
    fields = heads.made(folder, asked.fixed, asked.moving, asked.side, asked.kinds)
    print(f"{machine()}, SimpleITK {sitk.Version.VersionString()}\n\n{HEAD}", flush=True)
    missed = False
    for row in held_out() if OURS_IS_THERE else ():
        print(row, flush=True)
        missed |= row.holds is False
    for kind, path in fields.items():
        for row in rows(kind, path, asked.runs, asked.keep):
            print(row, flush=True)
            missed |= row.holds is False
        if asked.slow:
            for row in slow_rows(kind, path):
                print(row, flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
