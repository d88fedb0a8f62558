"""Key points mapped with the image: forward with T, and back with its inverse."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "chelsea.jpg"
POINTS = {"left eye": (172, 116), "right eye": (318, 136), "nose": (266, 243)}


def marked(pixels: np.ndarray, points: np.ndarray) -> np.ndarray:
    shown = pixels.copy()
    for x, y in np.rint(points).astype(int):
        shown[y - 1 : y + 2, x - 6 : x + 7] = shown[y - 6 : y + 7, x - 1 : x + 2] = (0, 200, 255)
    return shown


def main(folder: Path) -> None:
    photo = image.read(PHOTO).pixels
    points = np.array(list(POINTS.values()), float)
    d = supple.Deformation(photo.shape[:2]).grab(points[2], by=(-45, 12), radius=70)

    moved = d.forward(points)
    for name, a, b in zip(POINTS, points, moved, strict=True):
        print(f"{name}: ({a[0]:g}, {a[1]:g}) is now at ({b[0]:.2f}, {b[1]:.2f})")
    back = d.inverse(moved)
    assert back.converged.all()
    assert np.abs(back.points - points).max() < 1e-5

    pair = np.hstack([marked(photo, points), marked(d.warp(photo), moved)])
    image.write(folder / "key_points.png", pair, force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
