"""What several files of tests share."""

from __future__ import annotations

import os

import pytest

from supple.errors import SuppleError
from supple.gpu.device import Gpu, open_gpu

# Numba's simulator takes the place of CUDA from its import on: those tests are run by themselves.
collect_ignore = (
    [] if {"1"} & {os.environ.get(k) for k in ("NUMBA_ENABLE_CUDASIM", "SUPPLE_TEST_CUDA")} else ["engines/cuda/card"]
)


@pytest.fixture
def gpu() -> Gpu:
    """Whatever adapter there is, opened; where SUPPLE_TEST_GPU is set, there must be one."""
    try:
        return open_gpu()
    except SuppleError as error:
        if os.environ.get("SUPPLE_TEST_GPU") == "1":
            raise
        pytest.skip(str(error))
