"""A function as a source: a fractal evaluated at the source points, sharp at any magnification.

Figure 6.3 of Haetinger and Gastal, with y down: p0 = (200, 400), f = (200, 100), ε = 100.
"""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.media import image

SIZE, ITERATIONS = 700, 60


def mandelbrot(points: np.ndarray) -> np.ndarray:
    """Return the colours of points (N, 2), by the escape time of z² + c."""
    c = (points[:, 0] / SIZE - 0.72) * 2.6 + 1j * (points[:, 1] / SIZE - 0.5) * 2.6
    z, escape = np.zeros_like(c), np.full(len(c), float(ITERATIONS))
    inside = np.arange(len(c))
    for k in range(ITERATIONS):
        z = z * z + c[inside]
        size = np.abs(z)
        out = size > 8
        escape[inside[out]] = k + 1 - np.log2(np.log2(size[out]))
        inside, z = inside[~out], z[~out]
    phase = 0.35 * np.sqrt(escape)[:, None] * 2 * np.pi + np.array([3.4, 3.8, 4.4])
    return np.where(escape[:, None] < ITERATIONS, 0.5 + 0.5 * np.cos(phase), 0.02)


def main(folder: Path) -> None:
    still = supple.Deformation((SIZE, SIZE), border=None)
    bent = still.grab((200, 400), by=(200, 100), radius=100, reach=None)
    places = (np.arange(2 * SIZE) - 0.5) / 2  # of four points for each pixel, which are averaged
    points = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
    for name, d in (("fractal", still), ("fractal_bent", bent)):
        colours = mandelbrot(d.inverse(points).points).reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
        image.write(folder / f"{name}.png", np.rint(255 * colours).astype(np.uint8), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
