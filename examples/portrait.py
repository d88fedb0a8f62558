"""Retouch a portrait: a broader smile and wider eyes, saved as a recipe for any copy of the image."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "astronaut.jpg"

# Three scales fade as 1/r⁵: the mouth moves, and the chin stays.
STROKES = [
    supple.Stroke.grab((204, 141), by=(-4, -5), radius=14, scales=3),  # corners of the mouth
    supple.Stroke.grab((244, 142), by=(4, -5), radius=14, scales=3),
    supple.Stroke.grab((203, 97), by=(0, -1.5), radius=9, scales=3),  # upper lids
    supple.Stroke.grab((246, 99), by=(0, -1.5), radius=9, scales=3),
    supple.Stroke.grab((203, 104), by=(0, 1), radius=9, scales=3),  # lower lids
    supple.Stroke.grab((246, 106), by=(0, 1), radius=9, scales=3),
]


def main(folder: Path) -> None:
    photo = image.read(PHOTO)
    recipe = supple.Recipe(strokes=STROKES)
    (folder / "smile.json").write_text(recipe.to_json(), encoding="utf-8")

    d = supple.Deformation.from_recipe(recipe, photo.pixels.shape[:2])
    smiling = d.warp(photo.pixels)
    face = np.s_[40:220, 150:310]
    pair = np.hstack([photo.pixels[face], smiling[face]])
    image.write(folder / "portrait.png", smiling, force=True)
    image.write(folder / "faces.png", pair.repeat(3, axis=0).repeat(3, axis=1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
