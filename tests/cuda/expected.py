"""What results should be: by the slow oracles of ``tests/reference``, for arrays of a few hundred samples."""

from __future__ import annotations

from typing import Any

import numpy as np

import supple
from tests import reference


def expected(d: supple.Deformation, source: np.ndarray, **options: Any) -> np.ndarray:
    """Return an image, frames or slices after a deformation's strokes; a ``tolerance`` is of no concern here."""
    options.pop("tolerance", None)
    warp = reference.warp if d.ndim == 2 else reference.warp_frames
    return warp(source, reference.carried_out(d), d.domain, **options)


def sources(d: supple.Deformation) -> np.ndarray:
    """Return T⁻¹ of all pixels, x first."""
    return reference.inverse(reference.carried_out(d), d.domain, reference.grid(d.shape))


def untouched(d: supple.Deformation) -> np.ndarray:
    """Return which pixels lie in no stroke's ball."""
    return ~reference.reached(reference.carried_out(d), d.domain, reference.grid(d.shape))


def surely_nearest(d: supple.Deformation) -> np.ndarray:
    """Return which source points are not within 1e-3 pixels of where another sample is the nearest."""
    return np.asarray((np.abs(sources(d) % 1 - 0.5) > 1e-3).all(axis=-1))
