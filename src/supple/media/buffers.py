"""Room for results: in memory or, where that is too little, in a file that is gone afterwards."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.media.files import shown
from supple.spill import reserve


@contextlib.contextmanager
def room(
    shape: tuple[int, ...], dtype: npt.DTypeLike, target: str | os.PathLike[str], most: float
) -> Iterator[npt.NDArray[Any]]:
    """An array for what will be written to a file.

    Parameters
    ----------
    shape, dtype
        Of the array.
    target : str or os.PathLike
        The file: beside it is where a temporary one goes.
    most : float
        How many bytes the array may take in memory.

    Raises
    ------
    SuppleError
        If there is no room for it on the disk.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size <= most:
        yield np.empty(shape, dtype)
        return
    folder = os.path.dirname(os.path.realpath(target))
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(tempfile.TemporaryFile(prefix=".supple-", dir=folder))
            reserve(file, size)
        except OSError as error:
            why = error.strerror or error
            raise SuppleError(
                f"the result takes {size / 1e9:.2g} GB, and there is no room for it beside {shown(target)} "
                f"({why}): choose another place"
            ) from None
        yield np.asarray(np.memmap(file, np.dtype(dtype), "r+", 0, shape))


def memory() -> float:
    """How many bytes of memory this machine has."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return math.inf
