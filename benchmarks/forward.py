"""The baseline for videos: the naive solution of the paper's Appendix A, by forward mapping.

Haetinger and Gastal, Appendix A, "Naive solution for video warping and visualization": every pixel of every frame
is a vertex, and each is moved by T, in a dense setup phase. What is hard is to slice the deformed space-time volume
into frames, which is done in a *two-step interpolation*: the value of a frame's vertex is interpolated between the
volume's vertices that surround it in time, "the vertices that had the same x, y values before the displacement and
that are now placed in front and behind the frame"; then "all the vertices of each frame" make a triangle strip, and
colours are interpolated between those points.

The appendix leaves open how the surrounding vertices are found, and what is shown where there are none. Here, either
every frame searches all columns of vertices from their start, or, which is much faster, it goes on from where the
frame before found them, since times only grow along a column that one stroke has moved. A place without vertices
stays black. The authors' took 45 seconds for a video of 640 × 368.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import numpy.typing as npt
from mesh import rasterize

import supple

Frames = npt.NDArray[np.uint8]
Vertices = npt.NDArray[np.float32]


def forward_warp(
    frames: Frames,
    deformation: supple.Deformation,
    *,
    literal: bool = False,
    threads: int = 2,
    seconds: dict[str, float] | None = None,
) -> Frames:
    """Deform a video by the method of Appendix A.

    Parameters
    ----------
    frames : uint8 array, shape (T, H, W, C)
    deformation : Deformation
        Of shape (T, H, W).
    literal : bool
        Whether each frame searches its columns of vertices from the start, as the text has it, rather than from where
        the frame before found them.
    threads : int
        Each takes a part of the frames.
    seconds : dict, optional
        To be filled with how long the parts took: the two steps' as sums over all threads.

    Returns
    -------
    uint8 array, shape (T, H, W, C)
    """
    spent = {"setup": 0.0, "in time": 0.0, "triangles": 0.0} if seconds is None else seconds
    spent.update(dict.fromkeys(("setup", "in time", "triangles"), 0.0))
    parts = np.array_split(np.arange(len(frames)), threads)
    start = time.perf_counter()
    vertices = np.empty((*frames.shape[:3], 3), np.float32)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda part: _set_up(part, deformation, vertices), parts))
        spent["setup"] = time.perf_counter() - start
        out = np.zeros_like(frames)
        for took in pool.map(lambda part: _draw(part, frames, vertices, out, literal), parts):
            spent["in time"] += took[0]
            spent["triangles"] += took[1]
    return out


def _set_up(part: npt.NDArray[np.int64], deformation: supple.Deformation, vertices: Vertices) -> None:
    """Move all pixels of some frames."""
    height, width = vertices.shape[1:3]
    points = np.empty((height, width, 3))
    points[..., 1], points[..., 0] = np.mgrid[:height, :width]
    for k in part:
        points[..., 2] = k
        vertices[k] = deformation.forward(points)


def _draw(
    part: npt.NDArray[np.int64], frames: Frames, vertices: Vertices, out: Frames, literal: bool
) -> tuple[float, float]:
    """Draw some frames, one after the other; tell how long the two steps took."""
    height, width, channels = frames.shape[1:]
    found = np.zeros((height, width), np.int64)
    # In float32, pixels on an edge of two triangles would be in neither.
    places, colours = np.empty((height, width, 2)), np.empty((height, width, channels), np.float32)
    spent = [0.0, 0.0]
    for k in part:
        start = time.perf_counter()
        if literal:
            found[:] = 0
        surround(frames, vertices, float(k), found, places, colours)
        middle = time.perf_counter()
        # A triangle with a corner that is nowhere (NaN) has no pixel in it.
        rasterize(colours, places, out[k])
        spent = [spent[0] + middle - start, spent[1] + time.perf_counter() - middle]
    return spent[0], spent[1]


def _kernel(function: Callable[..., object]) -> Callable[..., object]:
    made: Callable[..., object] = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    return made


@_kernel
def surround(frames, vertices, now, found, places, colours):  # type: ignore[no-untyped-def]
    """Interpolate the vertices of a frame between those that surround it in time.

    ``found`` has, for every column of vertices, the index of the one in front of the frame before.
    """
    count, height, width, channels = frames.shape
    for y in range(height):
        for x in range(width):
            k = found[y, x]
            while k < count - 2 and vertices[k + 1, y, x, 2] < now:
                k += 1
            found[y, x] = k
            after = min(k + 1, count - 1)
            a, b = np.float64(vertices[k, y, x, 2]), np.float64(vertices[after, y, x, 2])
            if not a <= now <= b:
                places[y, x, 0], places[y, x, 1] = np.nan, np.nan
                continue
            weight = (now - a) / (b - a) if b > a else 0.0
            for c in range(2):
                before = np.float64(vertices[k, y, x, c])
                places[y, x, c] = before + weight * (vertices[after, y, x, c] - before)
            for c in range(channels):
                colours[y, x, c] = (1.0 - weight) * frames[k, y, x, c] + weight * frames[after, y, x, c]
