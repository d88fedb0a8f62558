"""A head bent moderately and strongly, outside and inside (paper, figures 5.4, 6.8 and 6.9).

python head.py [FOLDER [VOLUME]]     any CT, or the MR head that comes along
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813

import supple
from supple.files.renders import default_transfer
from supple.files.volumes import open_volume
from supple.media import image
from supple.render.camera import Camera
from supple.render.scene import Scene
from supple.space.geometry import Geometry

DATA = Path(supple.__file__).parent / "examples" / "data"
HEAD, BRAIN = DATA / "head.nii.gz", DATA / "brain.nii.gz"
SIZE, BACKGROUND = (360, 360), (0.1, 0.1, 0.12)
# A point as fractions of the volume from its right, front and lower faces, and drags in millimetres, all in LPS.
AT, RADIUS = (0.55, 0.2, 0.72), 36
DRAGS = {"as it was": (0, 0, 0), "moderate": (-4, 22, -12), "strong": (-8, 46, -24)}


@dataclass(frozen=True)
class Layer:
    """A visible part of a volume: its window of values, and the value of its surface."""

    name: str
    samples: np.ndarray
    transfer: str
    density: tuple[float, float]


def layers(path: Path) -> tuple[Geometry, list[Layer]]:
    """Return the skin and the interior: low and high density."""
    volume = open_volume(path)
    samples = volume.rescaled()
    top = float(samples.max())
    if default_transfer(volume) == "ct-skin":
        return volume.geometry, [
            Layer("skin", samples, "ct-skin", (-300, top)),
            Layer("bone", samples, "ct-bone", (250, top)),
        ]
    # In MR, fat is as bright as the brain and bone is dark, so that no window shows the interior: it is masked.
    inside = open_volume(BRAIN).samples > 0 if Path(path) == HEAD else samples > top / 4
    return volume.geometry, [
        Layer("skin", samples, "mr-head", (0.12 * top, top)),
        Layer("brain", np.where(inside, samples, 0), "mr-head", (0.2 * top, top)),
        Layer("bone", skull(samples < 0.3 * top, inside, volume.geometry), "ct-bone", (300, 1000)),
    ]


def skull(dark: np.ndarray, brain: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Return the outer surface of the skull in MR: dark voxels around the brain, up to the bright fat of the scalp."""
    radius = [max(1, round(12 / step)) for step in geometry.spacing]
    inner = sitk.GetImageFromArray(brain.astype(np.uint8))
    around = sitk.BinaryDilate(inner, radius, sitk.sitkBall)
    found = sitk.And(around, sitk.Or(inner, sitk.GetImageFromArray(dark.astype(np.uint8))))
    found = sitk.BinaryMorphologicalOpening(found, [2, 2, 2])
    found = sitk.RelabelComponent(sitk.ConnectedComponent(found), sortByObjectSize=True) == 1
    found = sitk.BinaryFillhole(sitk.BinaryMorphologicalClosing(found, [2, 2, 2]))
    return sitk.GetArrayFromImage(sitk.DiscreteGaussian(sitk.Cast(found, sitk.sitkFloat32), 2.0)) * 1000


def bent(shape: tuple[int, ...], geometry: Geometry, by: tuple[float, ...]) -> supple.Deformation:
    """Return one stroke, for any direction of the volume's axes."""
    middle = (np.array(shape[::-1]) - 1) / 2
    at = middle * (1 + 2 * (geometry.direction.T @ (np.array(AT) - 0.5)))
    d = supple.Deformation(shape, spacing=geometry.spacing, border=30)
    return d.grab(at, by=geometry.direction.T @ np.array(by) / geometry.spacing, radius=RADIUS)


def main(folder: Path, path: Path = HEAD) -> None:
    geometry, seen = layers(path)
    shape = seen[0].samples.shape
    camera = Camera(azimuth=38, elevation=12, distance=480)
    made = {name: bent(shape, geometry, by) for name, by in DRAGS.items()}
    rows = []
    for layer in seen:
        scenes = [
            Scene(layer.samples, geometry, deformation=d, transfer=layer.transfer, density=layer.density)
            for d in made.values()
        ]
        rows.append(np.hstack([s.render(camera, SIZE, supersampling=2).pixels(BACKGROUND) for s in scenes]))
    image.write(folder / "head.png", np.vstack(rows), force=True)
    for name, d in made.items():
        report = d.report()
        print(f"{name}: {report.applied} steps, {report.folds} folds, source points within {report.error:.3f} voxels")


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:] or ["."]))
