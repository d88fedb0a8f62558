"""The distortion of a lens as an OpenCV map and an STMap: inverted, and applied around a stroke in one resampling."""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

PHOTO = Path(supple.__file__).parent / "examples" / "data" / "coffee.jpg"
STROKE = supple.Stroke.grab((430, 200), to=(455, 200), radius=60)  # in the straightened picture


def straightened(shape: tuple[int, int]) -> np.ndarray:
    """Return where each pixel of a straight picture is on the plate, as cv2.initUndistortRectifyMap does."""
    height, width = shape
    centre = np.array([width - 1, height - 1]) / 2
    away = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1) - centre
    bent = 1 - 0.12 * (away**2).sum(axis=-1, keepdims=True) / (centre**2).sum()  # barrel
    return (centre + away * bent).astype(np.float32)


def main(folder: Path) -> None:
    plate = image.read(PHOTO).pixels
    shape = plate.shape[:2]
    np.save(folder / "undistort.npy", straightened(shape))  # for cv2.remap

    undistort = supple.Field.read(folder / "undistort.npy", "opencv")
    undistort.write(folder / "undistort.exr", force=True)  # an STMap, for a compositor
    again = supple.Field.read(folder / "undistort.exr")
    print(f"OpenCV's map and the STMap agree within {np.abs(again.values - undistort.values).max():.5f} px")

    found = undistort.invert()  # gives the lens back
    found.field.write(folder / "redistort.exr", force=True)
    print(f"inverse: {found.counts}")
    print(f"where it is ok, it is exact to {found.error[found.status == 0].max():.6f} px")

    # Straighten, drag, and bend back: one map, and the plate is sampled once.
    straight = supple.Deformation(shape).field(undistort)
    retouched = straight.add(STROKE).field(found.field).warp(plate)

    # What that saves, without the stroke: once through both maps, or one picture after the other.
    once = straight.field(found.field).warp(plate)
    twice = supple.Deformation(shape).field(found.field).warp(straight.warp(plate))
    inner = np.s_[60:-60, 60:-60]
    off = [np.abs(made[inner].astype(int) - plate[inner]).mean() for made in (once, twice)]
    print(f"there and back, values differ by {off[0]:.2f} of 255; by {off[1]:.2f} if each map is resampled by itself")
    image.write(folder / "stmap.png", np.hstack([plate, straight.warp(plate), retouched]), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
