"""Four strokes turn a cup of coffee into a heart; before and after, side by side."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg"


def heart(shape: tuple[int, int]) -> supple.Deformation:
    strokes = [
        supple.Stroke.grab((290, 24), by=(0, 44), radius=34, scales=2),  # the rim's far side down, into a notch
        supple.Stroke.grab((290, 206), by=(0, 42), radius=60, scales=2),  # the near side down, to a tip
        supple.Stroke.grab((222, 48), by=(-16, -10), radius=45, scales=2),  # and two round shoulders
        supple.Stroke.grab((358, 48), by=(16, -10), radius=45, scales=2),
    ]
    return supple.Deformation.from_recipe(supple.Recipe(strokes=strokes), shape)


def main(folder: Path) -> None:
    photo = image.read(PHOTO)
    d = heart(photo.pixels.shape[:2])
    bent = d.warp(photo.pixels)
    image.write(folder / "heart.jpg", bent, like=photo, force=True)
    image.write(folder / "before_and_after.jpg", np.hstack([photo.pixels, bent]), like=photo, force=True)
    (folder / "heart.json").write_text(d.recipe.to_json(), encoding="utf-8")
    report = d.report()
    print(f"{report.strokes} strokes, {report.folds} folds, every source point within {report.error:.3f} px")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
