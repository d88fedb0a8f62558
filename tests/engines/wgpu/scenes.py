"""What is drawn of volumes, compared."""

from __future__ import annotations

import numpy as np

from supple.geometry import Geometry
from supple.render.picture import Rendering
from supple.render.transfer import TransferFunction

SHAPE, SIZE = (22, 30, 26), (40, 52)
GEOMETRY = Geometry(spacing=(0.9, 1.1, 1.8))
SOFT = TransferFunction(((0.3, 1, 0.2, 0.1, 0), (0.5, 0.9, 0.5, 0.3, 0.3), (1, 1, 1, 1, 0.8)), relative=True)


def apart(one: Rendering, other: Rendering) -> float:
    """How far two pictures are from one another, in decibels."""
    a, b = (p.pixels((0.1, 0.2, 0.3)).astype(float) for p in (one, other))
    return float(20 * np.log10(255 / max(1e-3, np.sqrt(np.mean((a - b) ** 2)))))
