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
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import heads
import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from measure import HEAD, Line, figure, machine, missed, paired, run, shown, wall
from scipy import ndimage

import supple

Array = npt.NDArray[Any]

TOLERANCE = 0.01  # voxels
TIMES = 100  # ITK's iterations at most; more do not help, and its own default, 10, is far from enough
WAYS = {"ITK's": 0.0, "ITK's, a mean will do": 0.001}  # its thresholds of the mean, in voxels
ROOM = 100.0  # megabytes above the field and the result that inverting may take
ALONE = {  # what reads and inverts, in a process of its own
    "ours": "import sys, supple; made = supple.Field.read(sys.argv[1]).invert()",
    "ITK's": "import sys, SimpleITK as sitk; made = sitk.InvertDisplacementField("
    "sitk.ReadImage(sys.argv[1], sitk.sitkVectorFloat32), maximumNumberOfIterations=5)",
}


def itk_read(path: Path) -> Any:
    return sitk.ReadImage(str(path), sitk.sitkVectorFloat32)


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


def held_out(side: int = 96, count: int = 8) -> Iterator[Line]:
    """The inverse of the inverse of random smooth fields, whose steepest slopes are 0.2 to 0.45."""
    rng, grid = np.random.default_rng(21), supple.Grid((side,) * 3)
    fields = []
    for _ in range(count):
        width, slope = rng.uniform(6, 16), rng.uniform(0.2, 0.45)
        noise = [ndimage.gaussian_filter(rng.normal(size=grid.shape), width) for _axis in range(3)]
        made = np.stack(noise, -1)
        made *= slope / max(np.linalg.norm(np.diff(made, axis=k), axis=-1).max() for k in range(3))
        fields.append(made.astype(np.float32))
    for kind in ("linear", "cubic"):
        what = f"{count} random smooth fields of {side}³, {kind}: inverse of the inverse, off by at most"
        yield figure(what, max(twice(made, grid, kind) for made in fields), "voxels", 0.02)


def lines(kind: str, path: Path, runs: int) -> Iterator[Line]:
    """All that is said of a field."""
    image, field = itk_read(path), supple.Field.read(path)
    spacing, side = image.GetSpacing()[0], image.GetSize()[0]
    values = sitk.GetArrayViewFromImage(image)
    what, kept = f"{kind} {side}³", {}

    def ours() -> None:
        kept["ours"] = field.invert(tolerance=TOLERANCE)

    for way, mean in WAYS.items():

        def peer(way: str = way, mean: float = mean) -> None:
            kept[way] = sitk.InvertDisplacementField(image, TIMES, TOLERANCE, mean, False)

        bar = 0.02 if kind != "smooth" and mean == 0 else None
        title = f"{what}: ours / {way}, asked for {TOLERANCE:g} voxel"
        yield Line(title, *paired(ours, peer, wall, runs, warm=0), "×", bar)
    result = kept["ours"]
    for whose, known in kept.items():
        inverse = known.field.values if whose == "ours" else sitk.GetArrayViewFromImage(known)
        found = truth(values, inverse, spacing)
        yield figure(f"{what}: largest error of {whose}", found.largest, "voxels")
        share = f"of {(~found.outside).sum()} voxels, {found.counted(0.1)} over 0.1"
        yield figure(f"{what}: over {TOLERANCE:g} voxel, {whose}", found.counted(), share)
        row = f"{what}: over it among the voxels that ours says are well, {whose}"
        yield figure(row, found.counted(where=result.status == 0), "voxels", 0 if whose == "ours" else None)
        if whose == "ours":
            yield Line(f"{what}: {', '.join(f'{name} {count}' for name, count in result.counts.items())}")
            apart = np.abs(result.error / spacing - found.error)[~found.outside & (result.status == 0)].max(initial=0.0)
            yield figure(f"{what}: the error that ours tells, off by at most", float(apart), "voxels")
            for way in ("linear", "cubic") if kind == "smooth" else ():
                off = twice(field.values, field.grid, way)
                yield figure(f"{what}: inverse of the inverse, {way}, off by at most", off, "voxels")
    # What a process that reads the field and inverts it may take: both, errors and status, and some room.
    bar = 29 * np.prod(image.GetSize()) / 1e6 + ROOM
    for whose, text in ALONE.items():
        peak = run([sys.executable, "-c", text, str(path)])[1]
        yield figure(f"{what}: peak memory, {whose}", peak, "MB", round(bar) if whose == "ours" else None)


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
    asked = parser.parse_args()
    for path in (asked.fixed, asked.moving):
        if path is not None and not path.exists():
            parser.error(f"{path} does not exist; --help says how to get two heads")
    folder = asked.data / heads.named(asked.fixed, asked.moving)
    fields = heads.made(folder, asked.fixed, asked.moving, asked.side, asked.kinds)
    print(f"{machine()}, SimpleITK {sitk.Version.VersionString()}\n\n{HEAD}", flush=True)
    made = shown(held_out())
    for kind, path in fields.items():
        made += shown(lines(kind, path, asked.runs))
    return int(missed(made))


if __name__ == "__main__":
    sys.exit(main())
