"""Training data: random elastic strokes that never fold, alike for an image, its labels and its key points."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.augment import RandomElastic
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg"
VARIANTS = 4


def main(folder: Path) -> None:
    photo = image.read(PHOTO).pixels
    labels = (photo[..., 0] > 150).astype(np.uint8)
    points = [(290, 150), (365, 285)]  # the coffee, and the spoon
    augment = RandomElastic(max_displacement=60, radius=(60, 140), strokes=(4, 8))

    rows = []
    for k in range(VARIANTS):
        made = augment(photo, labels=labels, points=points, seed=k)
        assert set(np.unique(made.labels)) <= {0, 1}
        report = made.deformation.report()
        moved = "; ".join(f"({x:.1f}, {y:.1f})" for x, y in made.points)
        print(f"{k}: margin {report.margin:.2f}, folds {report.folds}, points at {moved}")
        rows.append(np.hstack([made.image, np.repeat(made.labels[..., None] * 255, 3, axis=2)]))
    image.write(folder / "augmented.jpg", np.vstack(rows), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
