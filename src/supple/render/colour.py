"""Conversion of sRGB values to linear light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def linear_light(values: npt.NDArray[np.floating], white: float) -> npt.NDArray[np.floating]:
    """Return sRGB values in linear light; ``white`` is unchanged."""
    u = np.asarray(values) / white
    with np.errstate(invalid="ignore"):
        return np.asarray(white * np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4))
