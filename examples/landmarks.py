"""Landmarks mapped with a volume, and its displacement field for resampling in other programs, here SimpleITK.

python landmarks.py [FOLDER [VOLUME]]     another NIfTI, of a head in MNI coordinates
"""

import sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813
from head import BACKGROUND, HEAD

import supple
from supple.files.landmarks import move_points
from supple.files.options import VolumeOptions
from supple.files.volumes import open_volume
from supple.media import image, points
from supple.render.camera import Camera
from supple.render.scene import Scene

# Positions in the file's own coordinates, RAS, in millimetres.
MARKS = {"forehead": (-8, 76, 38), "brow": (-30, 73, 4), "crown": (-14, 10, 102), "temple": (-72, 30, 14)}
BRUSH = supple.Stroke.grab((-8, 72, 40), by=(4, -34, -12), radius=34)
CAMERA, SIZE = Camera(azimuth=38, elevation=18, distance=480), (480, 480)


def marked(scene: Scene, indices: np.ndarray) -> np.ndarray:
    """Return an image with a cross at each point."""
    pixels = scene.render(CAMERA, SIZE, supersampling=2).pixels(BACKGROUND)
    view = scene.view(CAMERA, SIZE)
    away = (indices - view.eye) * view.spacing
    for right_down in away @ view.packed[3:].T / (away @ view.ahead)[:, None]:
        x, y = np.rint(right_down / (view.packed[3:] ** 2).sum(axis=1) + (np.array(SIZE[::-1]) - 1) / 2).astype(int)
        pixels[y - 1 : y + 2, x - 8 : x + 9] = pixels[y - 8 : y + 9, x - 1 : x + 2] = (0, 200, 255)
    return pixels


def main(folder: Path, path: Path = HEAD) -> None:
    target, field = folder / "bent.nii.gz", folder / "field.nii.gz"
    recipe = supple.Recipe(strokes=[BRUSH], border=20)
    made = supple.warp_file(
        path, target, recipe, filter="linear", force=True, volume=VolumeOptions(world=True), save_field=field
    )

    rows = ["name,r,a,s", *(f"{name},{r},{a},{s}" for name, (r, a, s) in MARKS.items())]
    (folder / "marks.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    moved = move_points(folder / "marks.csv", folder / "moved.csv", made.deformation, made.geometry, force=True)
    move_points(folder / "moved.csv", folder / "back.csv", made.deformation, made.geometry, inverse=True, force=True)
    before, after, again = (points.read_points(folder / f"{name}.csv").points for name in ("marks", "moved", "back"))
    for name, a, b, way in zip(MARKS, before, after, moved.displaced, strict=True):
        print(f"{name}: {np.round(a, 1)} is now at {np.round(b, 1)}, {way:.1f} mm away")
    print(f"and back to within {np.linalg.norm(again - before, axis=1).max():.4f} mm")

    source = sitk.ReadImage(str(path))
    vectors = sitk.ReadImage(str(field), sitk.sitkVectorFloat64)
    theirs = sitk.Resample(source, sitk.DisplacementFieldTransform(vectors), sitk.sitkLinear)
    bent = open_volume(target)
    apart = np.abs(sitk.GetArrayFromImage(theirs).astype(float) - bent.samples)
    print(f"SimpleITK with that field: {(apart > 1).sum()} of {apart.size} voxels differ by more than 1")

    pair = [
        marked(Scene(volume.samples, volume.geometry, transfer="mr-head"), volume.geometry.from_world(places))
        for volume, places in ((open_volume(path), before), (bent, after))
    ]
    image.write(folder / "landmarks.png", np.hstack(pair), force=True)


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:] or ["."]))
