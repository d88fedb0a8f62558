"""The frames of a clip that are shown: decoded ahead in a thread, and kept as long as there is room."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.files import PathLike
from supple.files.clips import open_clip

Pixels = npt.NDArray[np.uint8]
Span = tuple[int, int]

ROOM = 512 << 20  # bytes of frames that are kept


class FrameCache:
    """A clip's frames as (rows, columns, 4) of sRGB, each there some time after it is asked for.

    As many are kept as there is room for, in bytes.

    Raises
    ------
    SuppleError
        If the clip cannot be read.
    """

    def __init__(self, path: PathLike, *, room: int = ROOM) -> None:
        self._path = path
        with open_clip(path) as clip:
            self.name: str = clip.name
            self.count: int = clip.count
            height, width = clip.layout.shape
            self.rate = float(clip.rate)
            found = clip.survey.starts if hasattr(clip, "survey") else ()
            self.starts = found if len(found) == clip.count else ()
            """Seconds at which each frame is shown, where they are not evenly spaced."""
        self.size: tuple[int, int] = (width, height)
        self.most = max(4, room // (4 * width * height))  # how many frames are kept
        self.error = ""  # why no more frames come, if none do
        self._frames: OrderedDict[int, Pixels] = OrderedDict()
        self._wanted: tuple[Span, ...] = ((0, 0),)
        self._news = threading.Condition()
        self._closed = False
        self._start()

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._work, name="supple-film", daemon=True)
        self._thread.start()

    def want(self, first: int, last: int, *others: Span) -> None:
        """Ask for frames ``first`` to ``last``, and others; what follows the first is decoded too, while there is room.

        Where decoding has failed, it is tried again once other frames are asked for.
        """
        with self._news:
            wanted = tuple((max(0, a), min(self.count - 1, b)) for a, b in ((first, last), *others))
            again = bool(self.error) and wanted != self._wanted
            self._wanted = wanted
            if again and not self._closed and not self._there():
                self.error = ""
                self._start()
            self._news.notify_all()

    def get(self, frame: int) -> Pixels | None:
        """A frame, if it is there."""
        with self._news:
            found = self._frames.get(frame)
            if found is not None:
                self._frames.move_to_end(frame)
            return found

    def wait(self, first: int, last: int, seconds: float) -> bool:
        """Wait until frames are there; whether they are."""
        self.want(first, last)
        return self.arrived(seconds)

    def arrived(self, seconds: float) -> bool:
        """Wait until all that was asked for last is there, or nothing more comes; whether it did not take too long."""
        with self._news:
            return self._news.wait_for(lambda: bool(self.error) or self._there(), seconds)

    def _there(self) -> bool:
        return all(k in self._frames for first, last in self._wanted for k in range(first, last + 1))

    def close(self) -> None:
        """Stop decoding."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._thread.join(5.0)

    def _next(self) -> int | None:
        """Which frame is to be decoded next; None for none now."""
        due = (k for first, last in self._due_spans() for k in range(first, last + 1))
        return next((k for k in due if k not in self._frames), None)

    def _due_spans(self) -> tuple[Span, ...]:
        """Frames that are wanted, and then those after the first of them, as many as are kept beside those."""
        first = self._wanted[0][0]
        return *self._wanted, (first, min(self.count, first + self.most * 3 // 4) - 1)

    def _work(self) -> None:
        try:
            with open_clip(self._path, count=self.count) as clip:
                while not self._closed:
                    self._decode(clip)
        except Exception as error:  # a thread has nobody to tell but those who wait
            kind = "" if isinstance(error, SuppleError) else f"{self.name} cannot be decoded: "
            with self._news:
                self.error = f"{kind}{error}"
                self._news.notify_all()

    def _decode(self, clip: Any) -> None:
        """Decode on from what is wanted, until that lies behind, or beyond where decoding may begin anew."""
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        begin = self._due()
        if begin is None:
            return
        kept = 0
        seeks = hasattr(clip, "frames_from")  # numbered pictures do not
        found = clip.frames_from(begin) if seeks else (pair for pair in enumerate(clip.frames()))
        with contextlib.closing(found) as frames:
            for at, picture in frames:
                due = self._due()
                if due is None or due < at or (due > at + 1 and seeks and clip.key_before(due) > at):
                    return
                with self._news:
                    keep = at not in self._frames and any(a <= at <= b for a, b in self._due_spans())
                if keep:
                    picture.copy_to(arrays)
                    pixels = np.full((self.size[1], self.size[0], 4), 255, np.uint8)
                    pixels[..., :3] = clip.to_rgb(arrays)
                    with self._news:
                        self._frames[at] = pixels
                        self._thin()
                        self._news.notify_all()
                    kept += 1
        with self._news:
            if not kept and self._next() == begin:  # or it would be sought for ever
                raise SuppleError(f"{self.name} ends before frame {begin}")

    def _due(self) -> int | None:
        """Wait until a frame is to be decoded; None if it is closed."""
        with self._news:
            self._news.wait_for(lambda: self._closed or self._next() is not None)
            return None if self._closed else self._next()

    def _thin(self) -> None:
        while len(self._frames) > self.most:
            oldest = next((k for k in self._frames if not any(a <= k <= b for a, b in self._wanted)), None)
            if oldest is None:
                return
            del self._frames[oldest]
