"""What filters do to photographs, against truth: `python benchmarks/quality.py`.

A photograph is averaged down four times, as a camera with fewer pixels would have seen it, and warped. The truth is
what that camera would have seen of the warped scene: the full photograph at the exact source points of many places in
each output pixel, averaged. The zone plate is a function, so that its input and its truth are both averages over
pixels.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import skimage
from measure import grid_of, psnr

import supple

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
Warp = Callable[[Bytes, supple.Deformation], npt.NDArray[np.generic]]

SMALLER = 4  # how many times each side of a photograph is averaged down
WITHIN = 8  # places along each side of an output pixel
MARGIN = 4  # pixels of the border that do not count: filters and truth see other things beyond it

OURS = Path(supple.__file__).parent / "examples" / "data"
THEIRS = Path(skimage.__file__).parent / "data"
PHOTOGRAPHS = [OURS / f"{name}.jpg" for name in ("astronaut", "chelsea", "coffee")]
PHOTOGRAPHS += [THEIRS / name for name in ("camera.png", "rocket.jpg", "retina.jpg", "motorcycle_left.png")]
PHOTOGRAPHS += [THEIRS / name for name in ("hubble_deep_field.jpg", "ihc.png")]


@dataclass(frozen=True)
class Stroke:
    """A grab in the middle, in parts of the height."""

    name: str
    by: tuple[float, float]
    radius: float

    def on(self, height: int, width: int) -> supple.Deformation:
        """Return the deformation of a picture of this size; its border is free."""
        drag = (self.by[0] * height, self.by[1] * height)
        middle = ((width - 1) / 2, (height - 1) / 2)
        return supple.Deformation((height, width), border=None).grab(
            middle, by=drag, radius=self.radius * height, reach=None
        )


STROKES = Stroke("moderate", (0.11, 0.17), 0.2), Stroke("strong", (0.2, 0.3), 0.2)
BARS = {"moderate stroke": (36.8, 37.1), "strong stroke": (36.75, 37.0, 38.1), "zone plate": (36.0,)}  # dB, of "auto"


def photograph(path: Path) -> tuple[Floats, Bytes]:
    """Return a photograph, and what it is averaged down to."""
    full = cv2.imread(str(path), cv2.IMREAD_COLOR)
    height, width = (n - n % SMALLER for n in full.shape[:2])
    full = full[:height, :width].astype(np.float64)
    blocks = full.reshape(height // SMALLER, SMALLER, width // SMALLER, SMALLER, -1)
    return full, np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def places(n: int) -> list[tuple[float, float]]:
    """Return n × n places in a pixel, from its middle."""
    along = ((np.arange(n) + 0.5) / n - 0.5).tolist()
    return [(u, v) for v in along for u in along]


def truth(full: Floats, d: supple.Deformation) -> Floats:
    """Return what is seen of the full photograph in each output pixel, on average."""
    q = grid_of(d.shape)
    total = np.zeros((*d.shape, full.shape[2]))
    for place in places(WITHIN):
        at = d.inverse(q + place).points * SMALLER + (SMALLER - 1) / 2
        total += cv2.remap(
            full, *np.moveaxis(at.astype(np.float32), -1, 0), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
    return total / WITHIN**2


def shrinking(d: supple.Deformation) -> tuple[Floats, Floats]:
    """Return how far each output pixel's content came from, and σ₁ of M = ∂p/∂q there."""
    q = grid_of(d.shape)
    p = d.inverse(q).points
    sizes = np.linalg.svd(np.linalg.inv(d.jacobian(p)), compute_uv=False)
    inside = ((p >= MARGIN) & (p <= np.array(d.shape[::-1]) - 1 - MARGIN)).all(axis=-1)
    return np.where(inside, np.linalg.norm(p - q, axis=-1), 0.0), np.where(inside, sizes[..., 0], 0.0)


def remapped(image: Bytes, d: supple.Deformation, interpolation: int) -> npt.NDArray[np.generic]:
    """Return what OpenCV makes of the exact map."""
    p = d.inverse(grid_of(d.shape)).points.astype(np.float32)
    return cv2.remap(image, p[..., 0], p[..., 1], interpolation, borderMode=cv2.BORDER_REPLICATE)


def warped(image: Bytes, d: supple.Deformation, name: str) -> npt.NDArray[np.generic]:
    """Return what Supple makes of it."""
    return d.warp(image, filter=name, tolerance=1e-3)


FILTERS: dict[str, Warp] = {
    "`cv2` cubic": partial(remapped, interpolation=cv2.INTER_CUBIC),
    "`cv2` Lanczos4": partial(remapped, interpolation=cv2.INTER_LANCZOS4),
    "`linear`": partial(warped, name="linear"),
    "`cubic`": partial(warped, name="cubic"),
    "`auto`": partial(warped, name="auto"),
}


def photographs(stroke: Stroke, filters: dict[str, Warp]) -> dict[str, list[float]]:
    """Return each filter's mean dB of all photographs: where anything moved, where σ₁ > 1.15, where σ₁ > 2."""
    each: dict[str, list[list[float]]] = {name: [] for name in filters}
    for path in PHOTOGRAPHS:
        full, image = photograph(path)
        d = stroke.on(*image.shape[:2])
        wanted = truth(full, d)
        distance, size = shrinking(d)
        regions = [part for part in (distance > 0.5, size > 1.15, size > 2) if part.any()]
        for name, warp in filters.items():
            made = warp(image, d)
            each[name].append([psnr(made[part], wanted[part]) for part in regions])
    return {name: np.mean(values, axis=0).tolist() for name, values in each.items()}


def rings(points: Floats) -> Floats:
    """Return the zone plate, as a function of points: in the corners of 512², its rings are 2.2 pixels wide."""
    return np.asarray(127.5 + 127.5 * np.cos(np.pi * ((points - 256) ** 2).sum(axis=-1) / 800))


def zone_plate(filters: dict[str, Warp]) -> dict[str, list[float]]:
    """Return each filter's dB on a zone plate of 512², under the stroke of the paper's figure 6.1b."""
    d = supple.Deformation((512, 512), border=None).grab((256, 256), by=(0, 90), radius=100, reach=None)
    q = grid_of((512, 512))
    image = np.rint(np.mean([rings(q + place) for place in places(WITHIN)], axis=0)).astype(np.uint8)
    wanted = np.mean([rings(d.inverse(q + place).points) for place in places(WITHIN)], axis=0)
    inside = shrinking(d)[1] > 0
    return {name: [psnr(warp(image, d)[inside], wanted[inside])] for name, warp in filters.items()}


def measured(filters: dict[str, Warp]) -> dict[str, dict[str, list[float]]]:
    """Return what each filter reaches on each kind of picture, in dB."""
    found = {f"{stroke.name} stroke": photographs(stroke, filters) for stroke in STROKES}
    return {**found, "zone plate": zone_plate(filters)}


def table(found: dict[str, dict[str, list[float]]]) -> str:
    """Return the table of docs/sampling.md."""
    lines = [f"| filter | {' | '.join(found)} |", "|---|---|---|---|"]
    for name in found["zone plate"]:
        cells = [" / ".join(f"{value:.2f}" for value in column[name]) for column in found.values()]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(table(measured(FILTERS)))
