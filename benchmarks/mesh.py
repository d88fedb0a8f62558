"""The baseline of forward mapping: every pixel a vertex of a mesh of triangles, moved by T and filled in."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(nogil=True, cache=True, error_model="numpy")
def rasterize(image, moved, out):  # type: ignore[no-untyped-def]
    """Draw the mesh of an image's pixels, moved to ``moved`` (H, W, 2), with colours interpolated in triangles."""
    height, width, channels = image.shape
    for y in range(height - 1):
        for x in range(width - 1):
            for half in range(2):
                ax, ay = (x, y) if half == 0 else (x + 1, y + 1)
                bx, by, cx, cy = x + 1, y, x, y + 1
                x0, y0 = moved[ay, ax, 0], moved[ay, ax, 1]
                x1, y1 = moved[by, bx, 0], moved[by, bx, 1]
                x2, y2 = moved[cy, cx, 0], moved[cy, cx, 1]
                area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
                if area == 0.0:
                    continue
                left, right = (
                    max(0, int(np.ceil(min(x0, x1, x2)))),
                    min(width - 1, int(np.floor(max(x0, x1, x2)))),
                )
                top, low = (
                    max(0, int(np.ceil(min(y0, y1, y2)))),
                    min(height - 1, int(np.floor(max(y0, y1, y2)))),
                )
                for j in range(top, low + 1):
                    for i in range(left, right + 1):
                        u = ((i - x0) * (y2 - y0) - (x2 - x0) * (j - y0)) / area
                        v = ((x1 - x0) * (j - y0) - (i - x0) * (y1 - y0)) / area
                        if u >= -1e-9 and v >= -1e-9 and u + v <= 1.0 + 1e-9:
                            for c in range(channels):
                                colour = (1.0 - u - v) * image[ay, ax, c] + u * image[by, bx, c] + v * image[cy, cx, c]
                                out[j, i, c] = np.uint8(min(max(colour + 0.5, 0.0), 255.0))
