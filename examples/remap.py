"""The inverse map as an array, for any resampler: cv2.remap takes its two planes directly."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "chelsea.jpg"


def remap(pixels: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the result of ``cv2.remap(pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)``."""
    height, width = pixels.shape[:2]
    x, y = x.clip(0, width - 1), y.clip(0, height - 1)
    i, j = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    s, t = (x - i)[..., None], (y - j)[..., None]
    upper = pixels[j, i] * (1 - s) + pixels[j, i + 1] * s
    lower = pixels[j + 1, i] * (1 - s) + pixels[j + 1, i + 1] * s
    return np.rint(upper * (1 - t) + lower * t).astype(pixels.dtype)


def main(folder: Path) -> None:
    photo = image.read(PHOTO).pixels
    d = supple.Deformation(photo.shape[:2]).grab((266, 243), by=(-45, 12), radius=70)

    source = d.inverse_map(tolerance=0.001)  # (H, W, 2), float32: the source point of each output pixel
    np.save(folder / "map.npy", source)
    remapped = remap(photo, source[..., 0], source[..., 1])
    image.write(folder / "remapped.png", remapped, force=True)

    ours = d.warp(photo, filter="linear", tolerance=0.001)
    print(f"largest difference to warp: {np.abs(ours.astype(int) - remapped).max()} of 255")
    print(f"error of the map: at most {d.report(tolerance=0.001).error:.4f} px")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
