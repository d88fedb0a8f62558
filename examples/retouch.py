"""Retouch a portrait: larger eyes, a smaller nose, a narrower chin and a tilted head, by scale, pinch and twist."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "astronaut.jpg"
EYES = ((204, 101), (246, 103))


def retouched(shape: tuple[int, ...]) -> supple.Deformation:
    d = supple.Deformation(shape)
    for eye in EYES:
        d = d.scale(eye, factor=1.35, radius=11)  # bloat
    d = d.scale((225, 122), factor=0.8, radius=12)  # pucker the nose
    d = d.pinch((225, 152), factor=0.85, radius=24)  # squeeze the chin along x
    return d.twist((226, 120), angle=-8, radius=70)  # tilt the head to the left, with all that was done to it


def main(folder: Path) -> None:
    photo = image.read(PHOTO)
    d = retouched(photo.pixels.shape[:2])
    out = d.warp(photo.pixels)
    image.write(folder / "retouched.png", out, like=photo, force=True)
    (folder / "retouch.json").write_text(d.recipe.to_json(), encoding="utf-8")

    face = np.s_[20:240, 140:320]
    pair = np.hstack([photo.pixels[face], out[face]])
    image.write(folder / "retouched-faces.png", pair.repeat(3, axis=0).repeat(3, axis=1), force=True)
    for eye in EYES:
        matrix = d.jacobian(eye)
        size, turn = (
            np.sqrt(np.linalg.det(matrix)),
            np.degrees(np.arctan2(matrix[1, 0] - matrix[0, 1], np.trace(matrix))),
        )
        print(f"an eye is {size:.2f} times as large, and turned by {turn:.1f}°")
    report = d.report()
    print(f"{report.applied} steps, none folds; every pixel is within {report.error:.3f} of its place")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
