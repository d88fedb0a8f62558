"""What several files of tests share."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from windows import close_all

from supple.engines.wgpu.device import Gpu, open_gpu
from supple.errors import SuppleError

# Numba's simulator takes the place of CUDA from its import on: those tests are run by themselves.
collect_ignore = [] if {"1"} & {os.environ.get(k) for k in ("NUMBA_ENABLE_CUDASIM", "SUPPLE_TEST_CUDA")} else ["cuda"]


@pytest.fixture
def gpu() -> Gpu:
    """Whatever adapter there is, opened; where SUPPLE_TEST_GPU is set, there must be one."""
    try:
        return open_gpu()
    except SuppleError as error:
        if os.environ.get("SUPPLE_TEST_GPU") == "1":
            raise
        pytest.skip(str(error))


@pytest.fixture(autouse=True)
def _windows_end() -> Iterator[None]:
    """No window of one test certifies on during the next, and listens to its warnings."""
    yield
    close_all()
