"""Tests on a GPU or, where ``NUMBA_ENABLE_CUDASIM`` is 1, on one that Numba plays: then arrays are tiny."""

from __future__ import annotations

import importlib.util
import os
from typing import Any

import pytest

from supple.engines.cuda.device import CudaDevice, open_device, simulated
from supple.errors import SuppleError


@pytest.fixture(scope="session")
def gpu() -> CudaDevice:
    """The GPU, or the simulator."""
    _there()
    return open_device()


def _there() -> None:
    """Leave tests out where there is no Numba for CUDA, as on macOS; where it must be there, they fail."""
    if importlib.util.find_spec("numba_cuda") is None and os.environ.get("SUPPLE_TEST_CUDA_COMPILER") != "1":
        pytest.skip("numba-cuda is not installed")


@pytest.fixture
def numba_cuda() -> Any:
    """Numba's CUDA, whose arrays live on the GPU."""
    _there()
    open_device()
    from numba import cuda

    return cuda


def pytest_report_header() -> str:
    """Say who does it."""
    try:
        return "cuda: the simulator" if simulated() else f"cuda: {open_device().name}"
    except SuppleError as error:
        return f"cuda: {error}"
