"""What these tests share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import supple
from tests.gpu.scenes import GEOMETRY, SHAPE


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    made = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=SHAPE), 2.5, mode="constant")
    made -= made.min()
    return (made / made.max()).astype(np.float32)


@pytest.fixture(scope="module")
def bent() -> supple.Deformation:
    d = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None, on_fold="damp")
    return d.grab((13, 14, 11), by=(3, -2, 2), radius=9, reach=None).grab(
        (6, 20, 8), by=(-1, 2, 1), radius=8, reach=None
    )
