"""Training data: random elastic strokes that never fold, alike for an image, its labels and its key points."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg"
STROKES, VARIANTS = 5, 4


def random_deformation(shape: tuple[int, int], rng: np.random.Generator) -> supple.Deformation:
    size = np.array([shape[1] - 1, shape[0] - 1])
    d = supple.Deformation(shape)  # a drag too strong for one stroke takes several
    for _ in range(STROKES):
        radius = rng.uniform(0.1, 0.35) * size.min()
        at = rng.uniform(0.15, 0.85, 2) * size
        to = np.clip(at + rng.normal(0, 0.45 * radius, 2), 0.1 * size, 0.9 * size)
        d = d.grab(at, to=to, radius=radius, scales=int(rng.integers(1, 4)))
    return d


def main(folder: Path) -> None:
    rng = np.random.default_rng(1)
    photo = image.read(PHOTO).pixels
    labels = (photo[..., 0] > 150).astype(np.uint8)
    points = np.array([[290.0, 150.0], [365.0, 285.0]])  # the coffee, and the spoon

    rows = []
    for k in range(VARIANTS):
        d = random_deformation(photo.shape[:2], rng)
        bent, bent_labels = d.warp(photo), d.warp(labels, filter="nearest")
        assert set(np.unique(bent_labels)) <= {0, 1}
        report = d.report()
        moved = "; ".join(f"({x:.1f}, {y:.1f})" for x, y in d.forward(points))
        print(f"{k}: margin {report.margin:.2f}, folds {report.folds}, points at {moved}")
        rows.append(np.hstack([bent, np.repeat(bent_labels[..., None] * 255, 3, axis=2)]))
    image.write(folder / "augmented.jpg", np.vstack(rows), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
