"""The stages of a window, one for each kind of media: each draws itself, through strokes, into a texture."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from supple._core.rows import numbers
from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import DEFAULT, Sampling
from supple.engine.work import Mattes, Space, seen_from, shown_mask
from supple.errors import SuppleError
from supple.files.clips import open_clip
from supple.files.options import PathLike
from supple.gpu.device import Gpu
from supple.gpu.plate import BACK, Overlay, Plate, Sight, halved
from supple.gpu.screen import SWAPPED, canvas_texture
from supple.media.image import Picture
from supple.media.sequence import Pictures
from supple.media.volume import Volume
from supple.render.appearance import without_table
from supple.render.box import Box
from supple.render.camera import Camera
from supple.render.labels import LabelColours
from supple.render.picture import Pick
from supple.render.scene import Scene
from supple.render.transfer import LABELS, Transfer
from supple.space.geometry import Grid
from supple.viewer.document.background import heard
from supple.viewer.document.editing import Kind
from supple.viewer.panels.layers import Registration, Segmentation
from supple.viewer.panels.transforms import on_screen, seen, shown, usual_of
from supple.viewer.tools.viewport import turn_of

Pixels = npt.NDArray[np.uint8]
Span = tuple[int, int]

ROOM = 512 << 20  # bytes of cached frames


class FrameCache:
    """A clip's frames as (rows, columns, 4) of sRGB, decoded on request, as many as fit ``room`` bytes."""

    def __init__(self, path: PathLike, *, room: int = ROOM) -> None:
        self._path = path
        with open_clip(path) as clip:
            self.name: str = clip.name
            self.count: int = clip.count
            height, width = clip.layout.shape
            self.rate = float(clip.rate)
            self.turn = turn_of(clip.rotation, clip.aspect, mirrored=clip.mirrored)
            found = () if isinstance(clip, Pictures) else clip.survey.starts
            self.transform = usual_of(clip)  # the view transform, one of `TRANSFORMS`
            self._like = clip.picture(0)[0] if isinstance(clip, Pictures) else None
            self.starts = found if len(found) == clip.count else ()
            """Seconds at which each frame is shown, where they are not evenly spaced."""
        self.size: tuple[int, int] = (width, height)
        self.most = max(4, room // (4 * width * height))  # the number of cached frames
        self.error = ""  # the reason why decoding has stopped
        self._frames: OrderedDict[int, Pixels] = OrderedDict()
        self._wanted: dict[int, None] = {0: None}  # the requested frames, and those that follow while there is room
        self._ahead = range(0)
        self._news = threading.Condition()
        self._closed = False
        self._start()

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._work, name="supple-film", daemon=True)
        self._thread.start()

    def want(self, first: int, last: int, *others: Span) -> None:
        """Request frames ``first`` to ``last``, and other spans. Frames after ``first`` follow while there is room.

        After an error, another request tries to decode again.
        """
        with self._news:
            spans = (range(max(0, a), min(self.count - 1, b) + 1) for a, b in ((first, last), *others))
            wanted, begin = dict.fromkeys(chain.from_iterable(spans)), max(0, first)
            again = bool(self.error) and wanted != self._wanted
            self._wanted, self._ahead = wanted, range(begin, min(self.count, begin + self.most * 3 // 4))
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
        if self._like is not None:
            return on_screen(replace(self._like, pixels=arrays[0]), transform)
        rgb = clip.to_rgb(arrays, deep=bool(transform))
        return shown(seen(rgb, transform) if transform else rgb, alpha=False)

    def arrived(self, seconds: float) -> bool:
        """Wait for the last request, or the end of decoding; return whether it was in time."""
        with self._news:
            return self._news.wait_for(lambda: bool(self.error) or self._there(), seconds)

    def _there(self) -> bool:
        return self._wanted.keys() <= self._frames.keys()

    def close(self) -> None:
        """Stop decoding."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._thread.join(5.0)

    def _next(self) -> int | None:
        return next((k for k in chain(self._wanted, self._ahead) if k not in self._frames), None)

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
        """Decode from the next requested frame on, until a request is for one behind, or beyond the next key frame."""
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        begin = self._due()
        if begin is None:
            return
        kept = 0
        seeks = not clip.stills  # image sequences need none
        found = clip.frames_from(begin) if seeks else (pair for pair in enumerate(clip.frames()))
        with contextlib.closing(found) as frames:
            for at, picture in frames:
                due = self._due()
                if due is None or due < at or (due > at + 1 and seeks and clip.key_before(due) > at):
                    return
                with self._news:
                    keep = at not in self._frames and (at in self._wanted or at in self._ahead)
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
            oldest = next((k for k in self._frames if k not in self._wanted), None)
            if oldest is None:
                return
            del self._frames[oldest]


Floats = npt.NDArray[np.float64]
Rectangle = tuple[int, int, int, int]  # x0, y0, and x1, y1 beyond the last
_NOTHING: Rectangle = (1 << 30, 1 << 30, 0, 0)

CELL = 32  # pixels: the core solves cells of this side as a whole
_ROUGH = Sampling("cubic", tolerance=0.1)  # while a hand drags: the footprint takes more than half of the time
_LINEAR = Sampling("linear")  # from pixels to those of the window, while a hand drags or where they are enlarged
_TEXTURES = 4  # that are drawn in turn: the result and its base, each at full size and during a drag
_EDGE = 4  # pixels beyond those that the window shows, for the filter of its last ones
_SMALLEST = 256  # pixels of the longer side of the smallest level


class Levels:
    """An image, (rows, columns, 4), and smaller ones, each half as large as the one before, made when needed."""

    def __init__(self, pixels: Pixels) -> None:
        self.has_alpha = not bool((pixels[..., 3] == 255).all())
        self._made = [(pixels, Grid(pixels.shape[:2]))]

    def at(self, k: int) -> tuple[Pixels, Grid]:
        """Return a level, and the grid of its pixels; 0 is the image itself."""
        while len(self._made) <= k:
            smaller = halved(self._made[-1][0])
            self._made.append((smaller, Grid(smaller.shape[:2])))
        return self._made[k]

    def of(self, scale: float) -> int:
        """Return the level for a window with pixels ``scale`` pixels of the image apart; it is at least as fine."""
        longest = max(self._made[0][0].shape)
        most = max(math.ceil(math.log2(longest / _SMALLEST)), 0)
        return min(max(math.ceil(math.log2(scale) - 1.0), 0), most)


class Warped:
    """The visible part of an image, warped as `Deformation.warp` does it, and then scaled."""

    def __init__(self, gpu: Gpu, levels: Levels) -> None:
        self._gpu, self._levels = gpu, levels
        self.image = levels.at(0)[0]
        self._place: tuple[int, Rectangle] = 0, _NOTHING  # the level and the part that are held
        self._pixels: Pixels = np.empty((0, 0, 4), np.uint8)  # of that part
        self._map: tuple[object, Space, Grid] | None = None  # from that part to a window, and the window's grid
        self._rough: Rectangle = _NOTHING  # around the parts warped during a drag, which are warped again after it
        self._drawn: dict[Any, tuple[object, Rectangle]] = {}  # what each texture shows, and what is warped anew since
        self._overlay = Overlay(gpu, self.image.shape[1::-1])
        self._plain: Any = None  # the texture of what lies under an overlay
        self.shown: Deformation | None = None

    def bring(self, deformation: Deformation, sight: Sight) -> None:
        """Warp the part that a sight shows, as far as it is not there yet; in a drag, roughly."""
        k = self._levels.of(sight.scale)
        source, _ = self._levels.at(k)
        place = k, _visible(sight, k, source.shape)
        stale = x0, y0, x1, y1 = place[1]
        if self.shown is None or place != self._place:
            self._pixels = np.empty((y1 - y0, x1 - x0, 4), np.uint8)
            self._rough = _NOTHING
            self._drawn.clear()
        else:
            anew = (
                _cells(changed(self.shown.space, deformation.space), k) if deformation is not self.shown else _NOTHING
            )
            stale = _common(stale, _around(anew, self._rough) if sight.solved else anew)
        self._place, self.shown = place, None
        if stale[0] < stale[2] and stale[1] < stale[3]:
            self._rough = _NOTHING if sight.solved else _around(self._rough, stale)
            self._warp(deformation, sight, k, stale)
            self._drawn = {texture: (how, _around(known, stale)) for texture, (how, known) in self._drawn.items()}
        self.shown = deformation

    def _warp(self, deformation: Deformation, sight: Sight, k: int, part: Rectangle) -> None:
        source, grid = self._levels.at(k)
        x0, y0, x1, y1 = part
        if deformation.is_identity:
            made = source[y0:y1, x0:x1]
        else:
            space = replace(_reduced(deformation, k, source.shape), grid=grid.crop((x0, y0), (x1 - x0, y1 - y0)))
            made, _ = warp_array(source, space, DEFAULT if sight.solved else _ROUGH, alpha=self._levels.has_alpha)
        left, top, *_ = self._place[1]
        self._pixels[y0 - top : y1 - top, x0 - left : x1 - left] = made

    def draw(self, sight: Sight, texture: Any, encoder: Any = None) -> None:
        """Draw the part, scaled, into a texture; an overlay is recorded into the encoder."""
        assert self.shown is not None
        if not sight.overlay:
            self._write(sight, texture)
            return
        self.forget(texture)
        if self._plain is None or self._plain.size[:2] != sight.size:
            self._plain = canvas_texture(self._gpu, sight.size)
            self._overlay.under = self._plain.create_view()
        self._write(sight, self._plain)
        space = self.shown.space
        self._overlay.draw(sight, space.table, space.axes, texture, encoder, shown_mask(space.freeze))

    def forget(self, texture: Any) -> None:
        """Draw all of a texture the next time, since something else was drawn into it."""
        self._drawn.pop(texture, None)

    def _write(self, sight: Sight, texture: Any) -> None:
        """Write those pixels of a texture that differ from what a sight shows."""
        x, y = (round(at, 3) for at in sight.origin)  # without noise, which would be a pixel more or less
        sight = replace(sight, origin=(x, y))
        how = self._place, sight.origin, sight.scale, sight.size, sight.square, sight.solved
        known, stale = self._drawn.pop(texture, (None, _NOTHING))
        while len(self._drawn) >= _TEXTURES:
            del self._drawn[next(iter(self._drawn))]
        self._drawn[texture] = how, _NOTHING
        height, width = self.image.shape[:2]
        part = _common(_of_window(sight, (0, 0, width, height), 0), (0, 0, *sight.size))
        if known == how:
            part = _common(part, _grown(_of_window(sight, _grown(stale, 1), self._place[0]), 3))  # as filters reach
        else:
            filled(self._gpu, texture, np.full((*sight.size[::-1], 4), _back(sight), np.uint8))
        x0, y0, x1, y1 = part
        if x0 < x1 and y0 < y1:
            filled(self._gpu, texture, self._framed(sight, part), (x0, y0))

    def _framed(self, sight: Sight, part: Rectangle) -> Pixels:
        """Return a part of what a sight shows, blended with the background where the image covers pixels in part."""
        made, back = self._scaled(sight, part), _back(sight).astype(np.float32)
        for axis, n in enumerate(self.image.shape[1::-1]):
            low, high = (sight.origin[axis] + sight.scale * end for end in (part[axis], part[2 + axis] - 1))
            if min(low + 0.5, n - 0.5 - high) >= sight.scale / 2:
                continue  # it covers them whole
            at = np.arange(part[axis], part[2 + axis]) * sight.scale + sight.origin[axis]
            cover = np.clip(np.minimum(at + 0.5, n - 0.5 - at) / sight.scale + 0.5, 0, 1)
            for j in np.flatnonzero(cover < 1):
                line = made[j] if axis else made[:, j]
                line[...] = np.rint(back + cover[j] * (line - back))
        return made

    def _scaled(self, sight: Sight, part: Rectangle) -> Pixels:
        """Return a part of what a sight shows, in pixels of the window, over a checkerboard where it is transparent."""
        k, (left, top, *_) = self._place
        ratio, (x0, y0, x1, y1) = sight.scale / 2**k, part
        first = [(at + 0.5) / 2**k - 0.5 - corner for at, corner in zip(sight.origin, (left, top), strict=True)]
        if ratio == 1 and all(at.is_integer() for at in first):
            rows, columns = (slice(int(first[n]) + part[n], int(first[n]) + part[2 + n]) for n in (1, 0))
            made = self._pixels[rows, columns].copy()
        else:
            how = self._place, sight.origin, sight.scale, sight.size
            if self._map is None or self._map[0] != how:
                grid = Grid(sight.size[::-1], ratio, first)
                self._map = how, Deformation(self._pixels.shape[:2], border=None).space_on(grid), grid
            space = replace(self._map[1], grid=self._map[2].crop((x0, y0), (x1 - x0, y1 - y0)))
            sampling = DEFAULT if sight.solved and ratio > 1 else _LINEAR
            made, _ = warp_array(self._pixels, space, sampling, alpha=self._levels.has_alpha)
        if not self._levels.has_alpha:
            return made
        y, x = np.ogrid[y0:y1, x0:x1]
        square = max(sight.square, 1.0)  # and greys, as in plate.wgsl
        odd = ((x + 0.5) // square + (y + 0.5) // square) % 2 > 0
        opacity = made[..., 3:] / np.float32(255)
        solid = np.full_like(made, 255)
        solid[..., :3] = np.rint(made[..., :3] * opacity + np.where(odd, 107, 148)[..., None] * (1 - opacity))
        return solid


def changed(before: Space, after: Space) -> tuple[Floats, Floats]:
    """Return a box around all points where two maps of strokes differ: the least and the largest x and y, in pixels."""
    if (before.axes != after.axes).any() or before.freeze is not after.freeze:
        return np.full(2, -math.inf), np.full(2, math.inf)
    one, other = before.rows, after.rows
    most = min(len(one), len(other))
    same = _alike(one[:most], other[:most])
    last = _alike(one[::-1][: most - same], other[::-1][: most - same])
    # Rows that act at once are one map.
    while same and (before.table["joined"][same : same + 1].any() or after.table["joined"][same : same + 1].any()):
        same -= 1
    while last and after.table["joined"][-last]:
        last -= 1
    differing = np.concatenate([one[same : len(one) - last], other[same : len(other) - last]])
    rows = differing.view(after.table.dtype)[:, 0]
    pivots, reach = rows["pivot"][:, :2], rows["reach"][:, None]
    low, high = (pivots - reach).min(axis=0, initial=math.inf), (pivots + reach).max(axis=0, initial=-math.inf)
    # Where the box meets the reach of a later stroke, that stroke may carry the difference to all of its reach.
    for row in after.table[len(after.table) - last :]:
        pivot, reach = row["pivot"][:2], row["reach"]
        if (low <= pivot + reach).all() and (pivot - reach <= high).all():
            low, high = np.minimum(low, pivot - reach), np.maximum(high, pivot + reach)
    return low, high


def _alike(one: Floats, other: Floats) -> int:
    """Return the number of rows before the first that differs."""
    differs = (one != other).any(axis=1)
    first = int(differs.argmax()) if len(differs) else 0
    return first if len(differs) and differs[first] else len(differs)


def _cells(box: tuple[Floats, Floats], k: int) -> Rectangle:
    """Return the cells of a level that a box of the image touches, and those beside them, which are split as well."""
    ends = []
    for side, more in zip(box, (-1, 2), strict=True):
        places = (((p + 0.5) / 2**k - 0.5) / CELL for p in side.tolist())
        ends += [(math.floor(min(max(p, -2.0), 1 << 20)) + more) * CELL for p in places]
    x0, y0, x1, y1 = (max(end, 0) for end in ends)
    return x0, y0, x1, y1


def _reduced(deformation: Deformation, k: int, shape: tuple[int, ...]) -> Space:
    space = deformation.space
    table, axes = space.table.copy(), space.axes.copy()
    inset = np.array([0.5 * (2**k - 1)] * 2 + [0.0]) * axes[:, 3]  # the centre of the level's first pixel
    table["pivot"] -= inset
    axes[:, :2] -= inset[:, None]
    axes[:2, 3] *= 2**k
    freeze = seen_from(space.freeze, tuple(inset.tolist()))
    return replace(space, rows=numbers(table), axes=axes, shape=(shape[0], shape[1]), freeze=freeze)


def _visible(sight: Sight, k: int, shape: tuple[int, ...]) -> Rectangle:
    """Return the part of a level that a sight shows; at least one pixel."""
    found = []
    for start, count, most in zip(sight.origin, sight.size, shape[1::-1], strict=True):
        ends = (start - 0.5 * sight.scale, start + (count - 0.5) * sight.scale)
        low, high = ((end + 0.5) / 2**k - 0.5 for end in ends)
        first = min(max(math.floor(low) - _EDGE, 0), most - 1)
        found.append((first, min(max(math.ceil(high) + _EDGE, first + 1), most)))
    (x0, x1), (y0, y1) = found
    return x0, y0, x1, y1


def _of_window(sight: Sight, part: Rectangle, k: int) -> Rectangle:
    """Return the pixels of the window that a part of a level covers, or covers in part."""
    places = ((edge * 2**k - 0.5 - sight.origin[n % 2]) / sight.scale for n, edge in enumerate(part))
    x0, y0, x1, y1 = (math.ceil(at + 0.5) if n > 1 else math.floor(at - 0.5) + 1 for n, at in enumerate(places))
    return x0, y0, x1, y1


def _back(sight: Sight) -> Pixels:
    return np.rint([255 * v for v in (*sight.back, 1.0)]).astype(np.uint8)


def _grown(part: Rectangle, by: int) -> Rectangle:
    return part[0] - by, part[1] - by, part[2] + by, part[3] + by


def _common(one: Rectangle, other: Rectangle) -> Rectangle:
    return max(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), min(one[3], other[3])


def _around(one: Rectangle, other: Rectangle) -> Rectangle:
    return min(one[0], other[0]), min(one[1], other[1]), max(one[2], other[2]), max(one[3], other[3])


Point = tuple[float, ...]
_OVERLAID = "the overlay leaves out freezes after the first stroke, and mattes"
SLOW = 0.5  # seconds: what takes longer is announced


class ImageStage:
    """A photograph."""

    kind: Kind = "image"

    def __init__(self, gpu: Gpu, name: str, source: Picture | Pixels) -> None:
        self._gpu, self._given = gpu, source
        self.transform = usual_of(source) if isinstance(source, Picture) else ""
        """The view transform, one of `TRANSFORMS`."""
        layers = source.layers if isinstance(source, Picture) else None
        self.turn = turn_of(0.0, None if layers is None else layers.aspect)
        """The linear map from displacements in the image to those on screen."""
        self._lay()
        height, width = self.pixels.shape[:2]
        self.shape: tuple[int, ...] = (height, width)
        self.spacing: tuple[float, ...] = (1.0, 1.0)
        self._name(name, (width, height))

    def _lay(self) -> None:
        """Compute the displayed pixels, and upload them unless the CPU warps."""
        given = self._given
        whole = given if isinstance(given, Picture) else Picture(given, alpha=True)
        self.pixels = on_screen(whole, self.transform)
        if not self._gpu.software:
            self._plate = Plate(self._gpu, self.pixels.shape[1::-1])
            self._plate.put(0, self.pixels)

    def set_transform(self, name: str) -> None:
        """Set the view transform."""
        self.transform = name
        self._lay()

    def _name(self, name: str, size: tuple[int, int]) -> None:
        self.name, self.size = name, size
        self.trouble = ""  # the reason why the display is incomplete
        self._warped: list[Warped] = []  # the result, and its base beside it, where the CPU warps
        self._brought: list[tuple[Deformation, Warped]] = []  # those of them that the next drawing needs
        self._under: tuple[Deformation, Point, Point] | None = None

    def solves(self, deformations: tuple[Deformation, ...], sight: Sight) -> bool:
        """Return whether drawing solves T⁻¹ in shaders, whose time depends on the number of pixels."""
        return bool(sight.overlay) or not all(map(self._warps, deformations))

    def _warps(self, deformation: Deformation) -> bool:
        """Return whether the CPU warps: it is faster than a software GPU, and shaders take no more than one mask."""
        return self._gpu.software or isinstance(deformation.space.freeze, Mattes)

    def expect(self, deformations: tuple[Deformation, ...], sight: Sight) -> None:
        """Prepare the next drawing: warp the image, where the device does not."""
        several = any(isinstance(deformation.space.freeze, Mattes) for deformation in deformations)
        self.trouble = _OVERLAID if several and sight.overlay else ""
        pixels, self._brought = self._frame(sight.time), []
        if not any(map(self._warps, deformations)):
            return
        if pixels is not None and (not self._warped or self._warped[0].image is not pixels):
            levels = Levels(pixels)
            self._warped = [Warped(self._gpu, levels), Warped(self._gpu, levels)]
        for deformation, warped in zip(deformations, self._warped, strict=False):
            if self._warps(deformation):  # while a frame is decoded, the one before it
                warped.bring(deformation, sight)
                self._brought.append((deformation, warped))

    def draw(self, deformation: Deformation, sight: Sight, texture: Any, encoder: Any = None) -> bool:
        """Draw the visible part, or record it into an encoder; return whether it is complete."""
        own = next((warped for brought, warped in self._brought if brought is deformation), None)
        for warped in self._warped:
            if warped is not own:
                warped.forget(texture)
        if not self._warps(deformation):
            self._drawn(deformation, sight, texture, encoder)
            return True
        if own is not None:
            own.draw(sight, texture, encoder)
        return own is not None and own.image is self._frame(sight.time)

    def _drawn(self, deformation: Deformation, sight: Sight, texture: Any, encoder: Any) -> None:
        space = deformation.space
        self._plate.draw(sight, space.table, space.axes, texture, encoder, shown_mask(space.freeze))

    def value(self, point: tuple[float, float], time: float, deformation: Deformation | None = None) -> str:
        """Return the value of the pixel at a point of a frame, through strokes if they are given."""
        x, y, frame = self._source(deformation, (*point, time))
        pixels, x, y = self._frame(frame), math.floor(x + 0.5), math.floor(y + 0.5)
        if pixels is None or not (0 <= x < pixels.shape[1] and 0 <= y < pixels.shape[0]):
            return ""
        r, g, b, a = (int(v) for v in pixels[y, x])
        return f"{r} {g} {b}" if a == 255 else f"{r} {g} {b}, opacity {a / 255:.2f}"

    def _frame(self, frame: float) -> Pixels | None:
        return self.pixels

    def _source(self, deformation: Deformation | None, point: Point) -> Point:
        """Return the point T⁻¹(x), or x without strokes; the last one is cached."""
        if deformation is None or deformation.is_identity:
            return point
        last = self._under
        if last is None or last[0] is not deformation or last[1] != point:
            made = deformation.inverse(np.array([point[: deformation.ndim]], np.float64)).points[0]
            last = self._under = deformation, point, (*map(float, made), *point[deformation.ndim :])
        return last[2]


class VideoStage(ImageStage):
    """A clip."""

    kind = "video"

    def __init__(self, gpu: Gpu, film: FrameCache, time_scale: float = 1.0) -> None:
        self.film, self.rate, self.transform, self.turn = film, film.rate, film.transform, film.turn
        width, height = film.size
        self.shape, self.spacing = (film.count, height, width), (1.0, 1.0, time_scale)
        slots = max(2, min(film.most, Plate.most(gpu, film.size), film.count))
        self._name(film.name, film.size)
        self._plate = Plate(gpu, film.size, film.count, slots)
        self._gpu = gpu
        self._spans: dict[tuple[Deformation, float], Span] = {}

    def set_transform(self, name: str) -> None:
        """Set the view transform; frames are decoded again."""
        self.transform = name
        self.film.set_transform(name)
        self._plate.earliest = self._plate.held = 0

    def expect(self, deformations: tuple[Deformation, ...], sight: Sight) -> None:
        """Prepare the next drawing: request its frames together, since separate requests might displace each other."""
        time = sight.time
        needed = {(d, time): self._spans.get((d, time)) or self.needed(d, time) for d in deformations}
        self._spans, slots = needed, self._plate.slots
        most = max(last - first + 1 for first, last in needed.values())
        super().expect(deformations, sight)
        if deformations[0].ndim == 3 and any(isinstance(d.space.freeze, Mattes) for d in deformations):
            self.trouble = "freezes after the first stroke, and mattes, are not shown: export has them"
        if most > slots:
            self.trouble = f"needs {most} frames at once, and {slots} are kept: export shows it whole"
        first, *others = (self._kept(span) for span in needed.values())
        self.film.want(*first, *others)

    def _warps(self, deformation: Deformation) -> bool:
        return (deformation.ndim == 2 or deformation.is_identity) and super()._warps(deformation)

    def _kept(self, span: Span) -> Span:
        """Return the first frames of a span, as many as fit the device."""
        return span[0], min(span[1], span[0] + self._plate.slots - 1)

    def draw(self, deformation: Deformation, sight: Sight, texture: Any, encoder: Any = None) -> bool:
        """Draw the visible part of an expected frame, or record it into an encoder; return whether it is complete."""
        if self._warps(deformation):
            ready = super().draw(deformation, sight, texture, encoder)
        else:
            ready = self._laid(*self._kept(self._spans[deformation, sight.time]))
            if self._plate.held:
                super().draw(deformation, sight, texture, encoder)
        if ready:
            return True
        self.trouble = self.film.error or self.trouble
        return bool(self.film.error)

    def _laid(self, first: int, last: int) -> bool:
        plate = self._plate
        for k in range(first, last + 1):
            if plate.earliest <= k < plate.earliest + plate.held:
                continue
            pixels = self.film.get(k)
            if pixels is None:
                return False
            plate.put(k, pixels)
        return True

    def needed(self, deformation: Deformation, time: float) -> tuple[int, int]:
        """Return the first and the last source frame of an output frame, estimated from a grid of points."""
        low = high = time
        if not deformation.is_identity and deformation.ndim == 3:
            width, height = self.size
            xs, ys = np.linspace(0, width - 1, 24), np.linspace(0, height - 1, 14)
            grid = np.stack(np.meshgrid(xs, ys, [time]), -1).reshape(-1, 3)
            times = deformation.inverse(grid).points[:, 2]
            low, high = float(times.min()), float(times.max())
            margin = 0.1 * (high - low)
            low, high = low - margin, high + margin
        last = self.film.count - 1
        return min(max(math.floor(low), 0), last), min(max(math.floor(high) + 1, 0), last)

    def _frame(self, frame: float) -> Pixels | None:
        return self.film.get(min(max(round(frame), 0), self.film.count - 1))


NIMBLE = 0.04  # seconds that a preview of a drag may take
_ROUGHEST, _EASY = 8, 1 << 21  # the largest step of a preview, in voxels; how many voxels are warped in a moment


class VolumeStage:
    """A volume with a transfer function; of a series, one volume.

    Without a hardware GPU, the core renders it on the CPU, which is faster than shaders there: a preview of every few
    voxels while strokes change, and all of them once a thread has warped them.
    """

    kind: Kind = "volume"

    def __init__(self, gpu: Gpu, volume: Volume, transfer: Transfer | str, samples: Any = None) -> None:
        self.name, self.volume = volume.name, volume
        self.preset = transfer if isinstance(transfer, str) else ""
        # The preset of computed tomography was chosen by its values.
        labels = self.preset == LABELS or isinstance(transfer, LabelColours)
        self.unit = "HU" if self.preset.startswith("ct-") else "label" if labels else ""  # of values
        self.density: tuple[float, float] | None = None
        self.clip: Box | None = None
        self._gpu = gpu
        self._samples = volume.rescaled() if samples is None else samples
        self.table = False  # whether thin parts beside the body are rendered, too; ``apart`` is their fraction
        known = without_table(self._samples, volume.geometry.spacing) if self.unit == "HU" else (self._samples, 0.0)
        self._body, self.apart = known
        self._bent: dict[int, tuple[Deformation, Scene]] = {}  # the result (0), and its base (1)
        self._rough: dict[int, tuple[Deformation, Scene]] = {}  # previews of the same; ``_apart`` is their step
        self._apart = next(k for k in (1, 2, 4, 8) if k == _ROUGHEST or self._samples.size <= _EASY * k**3)
        self.drawn_in: float | None = None  # seconds of the CPU for the last image, without the warp
        self._pool = ThreadPoolExecutor(1, "supple-bend")
        self._ahead: tuple[Deformation, Future[tuple[Deformation, Scene]]] | None = None  # what the thread warps
        self.scene = self._made(transfer)
        self.shape, self.spacing = self.scene.shape, tuple(volume.geometry.spacing)
        counts, _ = np.histogram(self._samples, 96, self.scene.range)
        self.histogram = np.log1p(counts).astype(np.float32)  # logarithms of voxel counts by value
        self._plain = self.scene
        self.trouble = ""  # a remark on the displayed image
        self._seconds = {False: 0.0, True: math.inf}  # to solve the last map without a freeze mask, and with one
        self.registration: Registration | None = None  # if there is one, ``volume`` is on the window's grid
        self.segmentation: Segmentation | None = None

    def _made(self, transfer: Transfer | str) -> Scene:
        device = "cpu" if self._gpu.software else "gpu"
        scene = Scene(
            self._samples if self.table else self._body,
            self.volume.geometry,
            transfer=transfer,
            density=self.density,
            clip=self.clip,
            mode="hybrid",
            device=device,
        )
        if scene._held is None and not self._gpu.software:
            raise SuppleError(f"{self.name} is more than a shader takes of {self._gpu.name}")
        return scene

    def set_table(self, table: bool) -> None:
        """Set whether a CT has its table."""
        self.table = table
        self._plain = self._made(self.scene.transfer)
        self.scene, self._bent, self._rough, self._ahead = self._plain, {}, {}, None

    def deform(self, deformation: Deformation, beside: int = 0) -> Scene:
        """Return the scene with strokes, of the result or of its base; the last one of each is cached."""
        if deformation.is_identity:
            return self._plain
        known = self._known(deformation)
        if known is None and self._ahead is not None and self._ahead[0] is deformation:
            known = self._ahead[1].result()
        if known is None:
            begun = time.perf_counter()
            known = self._solved(self._plain, deformation)
            self._seconds[deformation.space.freeze is not None] = time.perf_counter() - begun
        self._bent[beside] = known
        if not beside:
            self.scene = known[1]
        return known[1]

    def _solved(self, plain: Scene, deformation: Deformation) -> tuple[Deformation, Scene]:
        with heard():
            return deformation, plain.deformed(deformation)

    @property
    def previews(self) -> bool:
        """True if the CPU renders a warped volume, of which there is a preview while strokes change."""
        return self._plain.gpu is None

    def preview(self, deformation: Deformation, beside: int = 0) -> Scene:
        """Return the scene with strokes or, until it is computed, a preview of every few voxels."""
        if not self.previews or deformation.is_identity or self._known(deformation) is not None:
            return self.deform(deformation, beside)
        known = self._rough.get(beside)
        if known is None or known[0] is not deformation:
            begun, apart = time.perf_counter(), self._apart
            scene = self.deform(deformation, beside) if apart == 1 else self._plain.deformed(deformation, coarse=apart)
            known = self._rough[beside] = deformation, scene
            seconds = time.perf_counter() - begun
            if seconds > NIMBLE and apart < _ROUGHEST:
                self._apart *= 2
            elif seconds < NIMBLE / 16 and apart > 1:
                self._apart //= 2
        return known[1]

    def _known(self, deformation: Deformation) -> tuple[Deformation, Scene] | None:
        return next((known for known in self._bent.values() if known[0] is deformation), None)

    def is_slow(self, deformation: Deformation) -> bool:
        """Return whether drawing through strokes would take long, judged by the last ones; not if they are cached."""
        if deformation.is_identity or self.previews or self._known(deformation) is not None:
            return False
        return self._seconds[deformation.space.freeze is not None] > SLOW

    def on_canvas(self, deformation: Deformation) -> Scene:
        """Return the scene with strokes, or the last one if computing it would take long."""
        return self.scene if self.is_slow(deformation) else self.preview(deformation)

    def look(self, transfer: Transfer | str, density: tuple[float, float] | None) -> None:
        """Set another transfer function."""
        self.preset, self.density = transfer if isinstance(transfer, str) else "", density
        self._change(lambda scene: scene.seen_through(transfer, density))

    def cut(self, clip: Box | None) -> None:
        """Render the volume within another box; all of it for None."""
        self.clip = clip
        self._change(lambda scene: scene.clipped(clip))

    def _change(self, change: Callable[[Scene], Scene]) -> None:
        self._plain = change(self._plain)
        self._bent = {k: (made, change(scene)) for k, (made, scene) in self._bent.items()}
        self._rough, self._ahead = {}, None
        self.scene = self._bent[0][1] if 0 in self._bent else self._plain

    def draw(
        self,
        deformation: Deformation,
        camera: Camera,
        size: tuple[int, int],
        texture: Any,
        beside: int = 0,
        *,
        moving: bool = False,
    ) -> None:
        """Render into a texture of ``size`` (columns, rows); by the CPU if the scene is not on the GPU."""
        scene, (columns, rows) = (self.preview if moving else self.deform)(deformation, beside), size
        if scene.gpu is not None:
            with contextlib.suppress(SuppleError):  # points that shaders cannot solve: the CPU does
                scene.draw(texture, camera, (rows, columns), background=BACK)
                return
        pixels, begun = np.full((rows, columns, 4), 255, np.uint8), time.perf_counter()
        with heard():
            pixels[..., :3] = scene.render(camera, (rows, columns)).pixels(BACK)
        filled(self._gpu, texture, pixels)
        self.drawn_in = time.perf_counter() - begun

    def fill(self, deformation: Deformation, seconds: float) -> float:
        """Fill a part of the buffer; return the filled part."""
        if deformation.is_identity:
            return 1.0
        if self.previews and self._known(deformation) is None:
            if self._ahead is None or self._ahead[0] is not deformation:
                if self._ahead is not None:
                    self._ahead[1].cancel()
                self._ahead = deformation, self._pool.submit(self._solved, self._plain, deformation)
            if self._ahead[1] not in wait([self._ahead[1]], seconds).done:
                return 0.0
        return self.deform(deformation).fill(seconds=seconds)

    def close(self) -> None:
        """End the thread, after its current work."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def value(self, pick: Pick) -> Any:
        """Return the value of a picked voxel."""
        last = [n - 1 for n in reversed(self.shape)]
        x, y, z = np.clip(np.floor(np.array(pick.source) + 0.5), 0, last).astype(int)
        return self._samples[z, y, x]

    def place(self, point: Point) -> str:
        """Return the position of a voxel on screen, in millimetres."""
        geometry = self.volume.geometry
        place = ", ".join(f"{round(v, 1) + 0.0:.1f}" for v in geometry.to_world(point).tolist())
        return f"({place}) mm {geometry.convention}"


def filled(gpu: Gpu, texture: Any, pixels: Pixels, corner: Span | None = None) -> Any:
    """Return a texture with pixels (rows, columns, 4): the given one, or a new one if there is none of their size.

    With a corner, they are a part of the given texture, whose first column and row it is.
    """
    rows, columns = pixels.shape[:2]
    if corner is None and (texture is None or texture.size[:2] != (columns, rows)):
        usage = "TEXTURE_BINDING|COPY_DST"
        texture = gpu.device.create_texture(size=(columns, rows, 1), format="rgba8unorm", usage=usage)
    place = {"texture": texture, "origin": (*(corner or (0, 0)), 0)}
    layout = {"bytes_per_row": 4 * columns, "rows_per_image": rows}
    pixels = np.ascontiguousarray(pixels)
    if texture.format == SWAPPED:
        words = pixels.view("<u4")
        pixels = (words & 0xFF00FF00 | (words & 0xFF) << 16 | words >> 16 & 0xFF).view(np.uint8)
    gpu.device.queue.write_texture(place, pixels, layout, (columns, rows, 1))
    return texture
