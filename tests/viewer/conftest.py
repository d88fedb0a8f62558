"""What tests of windows share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.viewer.windows import close_all


@pytest.fixture(autouse=True)
def _windows_end() -> Iterator[None]:
    """No window of one test certifies on during the next, and listens to its warnings."""
    yield
    close_all()
