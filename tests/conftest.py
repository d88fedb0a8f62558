"""What several files of tests share."""

from __future__ import annotations

import os

import pytest

from supple.errors import SuppleError
from supple.gpu.device import Gpu, open_gpu


@pytest.fixture
def gpu() -> Gpu:
    """Whatever adapter there is, opened; where SUPPLE_TEST_GPU is set, there must be one."""
    try:
        return open_gpu()
    except SuppleError as error:
        if os.environ.get("SUPPLE_TEST_GPU") == "1":
            raise
        pytest.skip(str(error))
