"""The cache of a clip's frames: decoded ahead in a thread, and kept within a limit of memory."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.files.clips import open_clip
from supple.files.options import PathLike
from supple.media.sequence import Pictures
from supple.viewer.panels.transforms import on_screen, seen, shown, usual_of
from supple.viewer.tools.viewport import turn_of

Pixels = npt.NDArray[np.uint8]
Span = tuple[int, int]

ROOM = 512 << 20  # bytes of cached frames


class FrameCache:
    """A clip's frames as (rows, columns, 4) of sRGB, decoded on request.

    The number of cached frames depends on their bytes.

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
            self.turn = turn_of(clip.rotation, clip.aspect, mirrored=clip.mirrored)
            found = clip.survey.starts if hasattr(clip, "survey") else ()
            self.transform = usual_of(clip)  # the view transform, one of `TRANSFORMS`
            self._like = clip.picture(0)[0] if isinstance(clip, Pictures) else None
            self.starts = found if len(found) == clip.count else ()
            """Seconds at which each frame is shown, where they are not evenly spaced."""
        self.size: tuple[int, int] = (width, height)
        self.most = max(4, room // (4 * width * height))  # the number of cached frames
        self.error = ""  # the reason why decoding has stopped
        self._frames: OrderedDict[int, Pixels] = OrderedDict()
        self._wanted: tuple[Span, ...] = ((0, 0),)
        self._news = threading.Condition()
        self._closed = False
        self._start()

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._work, name="supple-film", daemon=True)
        self._thread.start()

    def want(self, first: int, last: int, *others: Span) -> None:
        """Request frames ``first`` to ``last``, and others; frames after the first too, while there is room.

        After an error, decoding is tried again for another request.
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
        """Return a frame, or None while it is not decoded."""
        with self._news:
            found = self._frames.get(frame)
            if found is not None:
                self._frames.move_to_end(frame)
            return found

    def set_transform(self, name: str) -> None:
        """Set the view transform; frames are decoded again."""
        with self._news:
            self.transform = name
            self._frames.clear()
            self._news.notify_all()

    def _seen(self, clip: Any, arrays: list[npt.NDArray[Any]], transform: str) -> Pixels:
        """Return a frame through a view transform."""
        if self._like is not None:
            return on_screen(replace(self._like, pixels=arrays[0]), transform)
        rgb = clip.to_rgb(arrays, deep=bool(transform))
        return shown(seen(rgb, transform) if transform else rgb, alpha=False)

    def wait(self, first: int, last: int, seconds: float) -> bool:
        """Wait for frames; return whether they are there."""
        self.want(first, last)
        return self.arrived(seconds)

    def arrived(self, seconds: float) -> bool:
        """Wait for the last request, or the end of decoding; return whether it was in time."""
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
        """Return the next frame to decode; None if there is none."""
        due = (k for first, last in self._due_spans() for k in range(first, last + 1))
        return next((k for k in due if k not in self._frames), None)

    def _due_spans(self) -> tuple[Span, ...]:
        """Return the requested frames, and then those after the first of them, as many as fit the cache."""
        first = self._wanted[0][0]
        return *self._wanted, (first, min(self.count, first + self.most * 3 // 4) - 1)

    def _work(self) -> None:
        try:
            with open_clip(self._path, count=self.count) as clip:
                while not self._closed:
                    self._decode(clip)
        except Exception as error:  # threads that wait see the error
            kind = "" if isinstance(error, SuppleError) else f"{self.name} cannot be decoded: "
            with self._news:
                self.error = f"{kind}{error}"
                self._news.notify_all()

    def _decode(self, clip: Any) -> None:
        """Decode from the requested frame on, until it lies behind, or beyond the next key frame."""
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        begin = self._due()
        if begin is None:
            return
        kept = 0
        seeks = hasattr(clip, "frames_from")  # image sequences need none
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
                    transform = self.transform
                    pixels = self._seen(clip, arrays, transform)
                    with self._news:
                        if transform != self.transform:
                            return
                        self._frames[at] = pixels
                        self._thin()
                        self._news.notify_all()
                    kept += 1
        with self._news:
            if not kept and self._next() == begin:  # otherwise it would be sought forever
                raise SuppleError(f"{self.name} ends before frame {begin}")

    def _due(self) -> int | None:
        """Wait for the next frame to decode; None if the cache is closed."""
        with self._news:
            self._news.wait_for(lambda: self._closed or self._next() is not None)
            return None if self._closed else self._next()

    def _thin(self) -> None:
        while len(self._frames) > self.most:
            oldest = next((k for k in self._frames if not any(a <= k <= b for a, b in self._wanted)), None)
            if oldest is None:
                return
            del self._frames[oldest]
