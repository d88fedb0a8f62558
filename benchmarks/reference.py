"""What a deformed video should look like: many exact points for every pixel, slow and plain."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import supple

Floats = npt.NDArray[np.float64]


def reference_frame(
    frames: npt.NDArray[np.uint8], deformation: supple.Deformation, z: float, n: int = 4, m: int = 1
) -> Floats:
    """A frame of the deformed video, as the mean over n × n points of each pixel, at m times.

    Parameters
    ----------
    frames : array, shape (T, H, W, C)
    deformation : Deformation
        Of shape (T, H, W).
    z : float
        Which frame of the output.
    n : int
        Points along a pixel's side.
    m : int
        Times within a frame's duration; 1 is a point in time.

    Returns
    -------
    float64 array, shape (H, W, C)
        Sampled at T⁻¹ by Newton's method, linear in x, y and t.
    """
    height, width = frames.shape[1:3]
    total = np.zeros(frames.shape[1:])
    for dt in _within(m):
        for dy in _within(n):
            for dx in _within(n):
                y, x = np.mgrid[:height, :width]
                q = np.stack([x + dx, y + dy, np.full(x.shape, z + dt)], axis=-1)
                found = deformation.inverse(q)
                assert found.converged.all()
                total += trilinear(frames, found.points)
    return total / (m * n * n)


def trilinear(frames: npt.NDArray[np.uint8], points: Floats) -> Floats:
    """The video at points (…, 3), x first; beyond its edges, as it is there."""
    total = np.zeros((*points.shape[:-1], frames.shape[-1]))
    below, weights = [], []
    for axis, size in enumerate((frames.shape[2], frames.shape[1], frames.shape[0])):
        at = np.clip(points[..., axis], 0, size - 1)
        first = np.minimum(np.floor(at).astype(np.int64), max(size - 2, 0))
        below.append((first, np.minimum(first + 1, size - 1)))
        weights.append((1 - (at - first), at - first))
    for i in range(2):
        for j in range(2):
            for k in range(2):
                weight = weights[0][i] * weights[1][j] * weights[2][k]
                total += weight[..., None] * frames[below[2][k], below[1][j], below[0][i]]
    return total


def psnr(image: npt.NDArray[np.uint8], reference: Floats) -> float:
    """Peak signal to noise ratio, in decibels, for a white of 255."""
    error = float(np.mean((image.astype(np.float64) - reference) ** 2))
    return float("inf") if error == 0 else float(10 * np.log10(255**2 / error))


def _within(n: int) -> Floats:
    return np.asarray((np.arange(n) + 0.5) / n - 0.5)
