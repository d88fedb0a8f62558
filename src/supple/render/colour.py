"""Values on sRGB's curve, and the light that they stand for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def linear_light(values: npt.NDArray[np.floating], white: float) -> npt.NDArray[np.floating]:
    """Return values on sRGB's curve as amounts of light; ``white`` stays ``white``."""
    u = np.asarray(values) / white
    with np.errstate(invalid="ignore"):
        return np.asarray(white * np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4))
