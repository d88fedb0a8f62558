"""What strokes need compiled, made ready beside the window: the first one then waits for nothing."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from supple.camera import Camera
from supple.deformation import Deformation
from supple.rendering import Scene
from supple.viewer.heard import heard

TOLD = 1.0  # seconds after which it is said: what was compiled before is there sooner


class Compiling:
    """Carries out what nobody sees, in a thread of its own, which a program waits for when it ends.

    A thread that Python ends in the middle of an import keeps its lock, and the program would wait for that for ever.

    Parameters
    ----------
    *works : function
        What is carried out, one after the other.
    """

    def __init__(self, *works: Callable[[], None]) -> None:
        self._works = works
        self._begun, self._closed = 0.0, False
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Begin, unless it has begun."""
        if self._thread is None:
            self._begun = time.perf_counter()
            self._thread = threading.Thread(target=self._run, name="supple-compile", daemon=False)
            self._thread.start()

    def close(self) -> None:
        """Stop when what is at hand is done."""
        self._closed = True

    @property
    def busy(self) -> bool:
        """Whether it takes so long that somebody might wait for it."""
        alive = self._thread is not None and self._thread.is_alive()
        return alive and time.perf_counter() - self._begun > TOLD

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._thread is not None and not self._thread.is_alive()

    def _run(self) -> None:
        # Whoever does it in earnest hears of what is wrong; and a program that ends begins no threads.
        with contextlib.suppress(Exception), heard(lambda text, kind: None):
            for work in self._works:
                if not self._closed:
                    work()


def stroke(axes: int) -> None:
    """One stroke with a border that is fixed, its inverse, and what is certified of it."""
    middle = (16.0,) * axes
    made = Deformation((33,) * axes, border=4.0).grab(middle, by=(0.5,) * axes, radius=6.0)
    made.inverse([middle])
    made.report()


def ray(dtype: npt.DTypeLike) -> None:
    """What is seen under the pointer, of a volume that is bent."""
    shape = (9, 9, 9)
    bent = Deformation(shape, border=None).grab((4, 4, 4), by=(0.1, 0, 0), radius=8.0)
    for deformation in (None, bent):
        Scene(np.ones(shape, dtype), deformation=deformation).pick(Camera(), (9, 9), (4, 4))
