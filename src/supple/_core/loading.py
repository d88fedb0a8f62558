"""The choice of the core's build: there is one for each instruction set."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from supple.errors import SuppleError


def _built(name: str) -> bool:
    return find_spec(f"supple._core.{name}") is not None


def load() -> ModuleType:
    """Return the module for the best instruction set, or for the one that ``SUPPLE_ISA`` names.

    Raises
    ------
    SuppleError
        If the core was not compiled, or ``SUPPLE_ISA`` names an unknown or unsupported instruction set.
    """
    try:
        from supple._core.cpu import isas
    except ModuleNotFoundError:
        raise SuppleError(
            "Supple's native core is not compiled: run `make core` in a source tree, "
            "or install the package again with `pip install --force-reinstall supple`."
        ) from None
    usable = [name for name in isas() if _built(name)]
    asked = os.environ.get("SUPPLE_ISA", "")
    if asked and asked not in usable:
        raise SuppleError(f'SUPPLE_ISA="{asked}" cannot be had here; what can: {", ".join(usable) or "nothing"}.')
    if not usable:
        raise SuppleError("Supple's native core needs a processor with SSE4.2 (x86-64-v2), and this one has none.")
    return import_module(f"supple._core.{asked or usable[0]}")
