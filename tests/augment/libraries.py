"""Other libraries, whose own warnings are no faults of ours."""

from __future__ import annotations

import importlib
import warnings
from types import ModuleType

import pytest


def library(name: str) -> ModuleType:
    """Return a library; the tests of a module are skipped where it, or what it needs, is not installed."""
    with warnings.catch_warnings(action="ignore"):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            pytest.skip(f"{name} needs {error.name}: pip install '.[augment]'", allow_module_level=True)
