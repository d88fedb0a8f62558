"""In-memory buffers or, if memory is short, buffers in a temporary file that is deleted afterwards."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from typing import IO

import numpy as np
import numpy.typing as npt

from supple.engine.work import Array
from supple.errors import SuppleError, shown

Full = Callable[[str, str, str], str]


@contextlib.contextmanager
def buffers(
    shapes: Sequence[tuple[int, ...]], dtype: npt.DTypeLike, memory: float, full: Full, folder: str | None = None
) -> Iterator[list[Array]]:
    """Open arrays in memory or, beyond ``memory`` bytes, in a temporary file in a folder (by default, the system's).

    ``full`` returns the error for a full disk, a SuppleError, from the size, the folder and the system's reason.
    """
    kind = np.dtype(dtype)
    sizes = [math.prod(shape) * kind.itemsize for shape in shapes]
    if sum(sizes) <= memory:
        yield [np.empty(shape, kind) for shape in shapes]
        return
    with contextlib.ExitStack() as stack:
        place = folder or "the folder of temporary files"
        try:
            place = folder or tempfile.gettempdir()
            file = stack.enter_context(tempfile.TemporaryFile(prefix=".supple-", dir=place))
            reserve(file, sum(sizes))
        except OSError as error:
            raise SuppleError(full(f"{sum(sizes) / 1e9:.2g} GB", place, str(error.strerror or error))) from None
        starts = [0, *np.cumsum(sizes)[:-1].tolist()]
        held = [np.memmap(file, kind, "r+", start, shape) for start, shape in zip(starts, shapes, strict=True)]
        yield [np.asarray(part) for part in held]


@contextlib.contextmanager
def beside(
    target: str | os.PathLike[str], shape: tuple[int, ...], dtype: npt.DTypeLike, memory: float
) -> Iterator[Array]:
    """Open an array in memory or, beyond ``memory`` bytes, in a temporary file beside ``target``, for its data.

    Raises
    ------
    SuppleError
        If there is no room on the disk.
    """

    def full(size: str, folder: str, reason: str) -> str:
        beside = f"there is no room for it beside {shown(target)} ({reason})"
        return f"the result takes {size}, and {beside}: choose another place, or make it smaller"

    with buffers([shape], dtype, memory, full, os.path.dirname(os.path.realpath(target))) as (array,):
        yield array


def machine_memory() -> float:
    """Return the bytes of memory of this machine."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return math.inf


def reserve(file: IO[bytes], size: int) -> None:
    """Extend a file to its final size, so that no later write finds the disk full."""
    allocate = getattr(os, "posix_fallocate", None)
    if allocate:
        allocate(file.fileno(), 0, size)
        return
    zeros = bytes(1 << 24)
    for start in range(0, size, len(zeros)):
        file.write(zeros[: size - start])
    file.flush()
