"""Addresses in memory."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest


@pytest.fixture
def memory() -> Iterator[str]:
    """An address in memory, empty."""
    fsspec = pytest.importorskip("fsspec")
    address = f"memory://supple-{os.urandom(4).hex()}"
    yield address
    fs = fsspec.filesystem("memory")
    if fs.exists(address):
        fs.rm(address, recursive=True)
