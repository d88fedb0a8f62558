"""A file, warped in the background, while the window goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from supple.errors import SuppleError
from supple.files import PathLike, warp_file
from supple.strokes import Recipe
from supple.viewer.warning_log import heard

# Where each part of the work begins, and how much of the whole it is. Of a clip, writing begins first, and is over
# with the last frame.
_PARTS = {"read": (0.0, 0.05), "plan": (0.05, 0.1), "warp": (0.15, 0.75), "write": (0.9, 0.1)}
_TEXTS = {"read": "reading", "plan": "planning", "warp": "warping", "write": "writing"}
_BEGUN = "starting"


class _Cancelled(Exception):  # noqa: N818, it is no error
    """Somebody does not want it any more."""


class Export:
    """A file that is warped in a thread of its own, begun as this is made.

    The target appears whole, or not at all. Wait for the end before the program ends, with `join`: an export that is
    under way then fails.

    Parameters
    ----------
    source, target : str or os.PathLike
    recipe : Recipe
        As it is now; what is edited meanwhile does not come into it.
    warp : function, optional
        What does it: as `supple.warp_file`, with its ``tell``.
    **options
        What else it takes.
    """

    def __init__(
        self,
        source: PathLike,
        target: PathLike,
        recipe: Recipe,
        *,
        warp: Callable[..., Any] = warp_file,
        **options: Any,
    ) -> None:
        self.target = Path(target)
        self.progress = 0.0
        """How much is done, from 0 to 1; it never goes back."""
        self.text = _BEGUN
        """The text of the progress, or of the result."""
        self.error: str | None = None
        """Why it failed, in one line."""
        self.result: Any = None
        """Return the result of the function, once it is done."""
        self._warnings: list[str] = []
        self._stop = threading.Event()
        self._cancelled = False
        self._work = partial(warp, source, target, recipe, tell=self._tell, **options)
        self._thread = threading.Thread(target=self._run, name="supple-export")
        self._thread.start()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings, each only once."""
        return tuple(dict.fromkeys(self._warnings))

    @property
    def done(self) -> bool:
        """Return whether it has ended, in whatever way."""
        return not self._thread.is_alive()

    @property
    def cancelled(self) -> bool:
        """Return whether it ended as it was cancelled; there is no new file then."""
        return self._cancelled

    def cancel(self) -> None:
        """Ask it to stop. It does so between two frames, slices or parts; or is done before it hears of it."""
        self._stop.set()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end, for so many seconds at most; return whether it has ended."""
        self._thread.join(timeout)
        return self.done

    def _tell(self, part: str, count: int, total: int) -> None:
        if self._stop.is_set():
            raise _Cancelled
        counted = part in ("plan", "warp") and total > 3
        if part == "write" and self.text == _BEGUN:
            return  # a clip's file, which is only opened
        begin, size = _PARTS[part]
        self.progress = max(self.progress, begin + (size * count / total if counted else 0.0))
        self.text = f"{_TEXTS[part]} {count} of {total}" if counted else _TEXTS[part]

    def _run(self) -> None:
        try:
            with heard(lambda text, kind: self._warnings.append(_line(text))):
                self.result = self._work()
        except _Cancelled:
            self._cancelled, self.text = True, "cancelled"
        except SuppleError as error:
            self.error = self.text = _line(str(error))
        except Exception as error:
            self.error = self.text = _line(f"{type(error).__name__}: {error}")
        else:
            self.progress, self.text = 1.0, "done"


def _line(text: str) -> str:
    return " ".join(text.split())
