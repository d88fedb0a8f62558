"""Reused buffers and bind groups; bytes are written only when they change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.gpu.device import Gpu
from supple.gpu.kernel import LEAST, READ, UNIFORM


class Kept:
    """An array on the device.

    Parameters
    ----------
    gpu : Gpu
    kind : str
        UNIFORM or READ.
    """

    def __init__(self, gpu: Gpu, kind: str = READ) -> None:
        self._gpu, self._kind = gpu, kind
        self._bytes = b""
        self.buffer: Any = None
        """The buffer of the last array; None at first."""

    def hold(self, array: npt.NDArray[Any]) -> Any:
        """Return the buffer with this array's bytes; it is replaced only if it is too small."""
        data = np.ascontiguousarray(array).tobytes()
        if self.buffer is None or self.buffer.size < len(data):
            usage = "UNIFORM" if self._kind == UNIFORM else "STORAGE"
            size = max(LEAST, 1 << (max(len(data), 1) - 1).bit_length())
            self.buffer = self._gpu.device.create_buffer(size=size, usage=f"{usage}|COPY_DST")
            self._bytes = b""
        if data and data != self._bytes:
            self._gpu.device.queue.write_buffer(self.buffer, 0, data)
            self._bytes = data
        return self.buffer


class Bound:
    """A bind group, rebuilt when one of its resources changes."""

    def __init__(self) -> None:
        self._things: tuple[Any, ...] = ()
        self._group: Any = None

    def group(self, things: Sequence[Any], make: Callable[[], Any]) -> Any:
        """Return the bind group of some resources; ``make`` builds it."""
        if len(things) != len(self._things) or any(a is not b for a, b in zip(things, self._things, strict=True)):
            self._things, self._group = tuple(things), make()
        return self._group
