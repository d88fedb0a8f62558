"""Independent oracles: the equations in plain NumPy and float64, written for being right and not for being fast.

It is the one reference: all engines are compared with it.
"""

from tests.reference.arrays import (
    curve_of,
    light_of,
    loaded,
    opaque,
    psnr,
    rounded,
    stored,
    supersampled,
    warp,
    warp_frames,
)
from tests.reference.motion import (
    carried_out,
    differences,
    displacement,
    faces,
    fade,
    forward,
    grab,
    grid,
    inverse,
    jacobian,
    matrices,
    moved,
    reached,
    support,
)
from tests.reference.samples import Residual, averaged, durations, faded, pyramid, sample, sample_frames

__all__ = [
    "Residual",
    "averaged",
    "carried_out",
    "curve_of",
    "differences",
    "displacement",
    "durations",
    "faces",
    "fade",
    "faded",
    "forward",
    "grab",
    "grid",
    "inverse",
    "jacobian",
    "light_of",
    "loaded",
    "matrices",
    "moved",
    "opaque",
    "psnr",
    "pyramid",
    "reached",
    "rounded",
    "sample",
    "sample_frames",
    "stored",
    "supersampled",
    "support",
    "warp",
    "warp_frames",
]
