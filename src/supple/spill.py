"""Room for frames that are held at once: in memory, or in a file that is gone afterwards."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError

Array = npt.NDArray[Any]


@contextlib.contextmanager
def room_for(shapes: Sequence[tuple[int, ...]], dtype: np.dtype[Any], memory: float) -> Iterator[list[Array]]:
    """Arrays of these shapes, of as many frames each: in memory or, where there is too little, in a file."""
    sizes = [math.prod(shape) * dtype.itemsize for shape in shapes]
    if sum(sizes) <= memory:
        yield [np.empty(shape, dtype) for shape in shapes]
        return
    with contextlib.ExitStack() as stack:
        folder = "the folder of temporary files"
        try:
            folder = tempfile.gettempdir()
            file = stack.enter_context(tempfile.TemporaryFile(prefix="supple-"))
            reserve(file, sum(sizes))
        except OSError as error:
            frames, gb, why = shapes[0][0], sum(sizes) / 1e9, error.strerror or error
            raise SuppleError(
                f"{frames} frames have to be held at once, {gb:.2g} GB, more than the memory allowed, and there is "
                f"no room for them in {folder} ({why}): allow more memory, or set TMPDIR to another folder"
            ) from None
        starts = [0, *np.cumsum(sizes)[:-1].tolist()]
        held = [np.memmap(file, dtype, "r+", start, shape) for start, shape in zip(starts, shapes, strict=True)]
        yield [np.asarray(part) for part in held]


def reserve(file: IO[bytes], size: int) -> None:
    """Make a file as large as it is going to be, so that no later write finds the disk full."""
    allocate = getattr(os, "posix_fallocate", None)
    if allocate:
        allocate(file.fileno(), 0, size)
        return
    zeros = bytes(1 << 24)
    for start in range(0, size, len(zeros)):
        file.write(zeros[: size - start])
    file.flush()
