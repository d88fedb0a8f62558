"""The engine for arrays that live on an NVIDIA GPU: kernels in Python, compiled by Numba, a thread for each point.

`supple.Deformation` calls it for such arrays by itself. Warps that nobody waits for begin with `start`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from supple.cuda.job import Warping
    from supple.cuda.starting import start

__all__ = ["Warping", "start"]

_HOMES = {"Warping": "job", "start": "starting"}  # loaded when they are asked for: Numba takes its time


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'supple.cuda' has no attribute {name!r}")
    return getattr(import_module(f"supple.cuda.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
