"""Tracks, the positions of points in the frames of a clip: tables, Nuke's curves, After Effects' keyframes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from supple.errors import shown
from supple.media.files import PathLike, head_of, unreadable
from supple.media.timecode import PATTERN
from supple.space.checks import LARGEST, LONGEST_AXIS, choice, value_shown

Convention = Literal["pixels", "nuke", "ae"]
CONVENTIONS: tuple[str, ...] = get_args(Convention)

_GIVE = "give a table frame,x,y, curves of Nuke, or keyframes copied from After Effects"
_FIRST = {"pixels": 0, "nuke": 1, "ae": 0}  # the number of a clip's first frame, by convention
_AE = "Adobe After Effects"
_COLUMNS = ("frame", "x", "y", "name")
_CURVE = re.compile(r"\{\s*curve\b([^{}]*)\}")
_PAIR = re.compile(r"\{\s*\{\s*curve\b([^{}]*)\}\s*\{\s*curve\b([^{}]*)\}\s*\}")
_POINTS = re.compile(r"(?:track|to)\d*")
# A row of the node Tracker4: enabled or not, its name, x and y.
_ROW = re.compile(r"\{\s*(?:\{[^{}]*\}|\d+)\s+\"([^\"]*)\"\s+\{\s*curve\b([^{}]*)\}\s+\{\s*curve\b([^{}]*)\}")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_KEYED = re.compile(rf"x({_NUMBER.pattern})")


@dataclass(frozen=True, slots=True)
class Track:
    """The positions of a point in some frames of a clip: its name in the file, which may be empty, and its keys.

    A key is (frame, x, y), in ascending order of frames, which count from 0. Pixel centres are at integers; the centre
    of the top left pixel is (0, 0).
    """

    name: str
    keys: tuple[tuple[int, tuple[float, float]], ...]


class _Key(NamedTuple):
    """A key as read: its place in the file, for messages, and its frame and position."""

    where: str
    frame: float
    x: float
    y: float


_Keys = dict[str, list[_Key]]


def read_tracks(
    path: PathLike,
    *,
    convention: Convention | None = None,
    height: int | Callable[[], int] | None = None,
    first: int | None = None,
    frames: Callable[[str, str], int] | None = None,
) -> tuple[Track, ...]:
    """Return the tracks of a table, of a script of Nuke, or of keyframes copied from After Effects.

    The rows of a table are frame, x, y and, if there are several tracks, their name, with or without a header,
    separated by commas, semicolons, tabs or spaces. Scripts hold curves of points, of a tracker or a corner pin;
    keyframes are positions, corner pins and trackers.

    ``convention`` is that of a table. ``"pixels"``: from the top left pixel, whose centre is (0, 0), and frames from 0;
    ``"nuke"``: from the lower left corner, y upwards, with pixel centres at halves, and frames from 1, which needs the
    ``height`` of the frames; ``"ae"``: from the top left corner, with pixel centres at halves, and frames from 0.
    Scripts and keyframes have their own; a table with a header is in pixels by default. ``first`` is the number of the
    clip's first frame in the file, if it differs from that: 1001, for instance. ``frames(file, timecode)`` converts a
    timecode in a table to a frame from 0; its first argument is for messages. SuppleError, with the line or the track,
    if the file cannot be read or holds no tracks, or its convention is not known.
    """
    if convention is not None:
        choice("convention", convention, CONVENTIONS)
    data = head_of(path, -1, _GIVE, _GIVE)
    if b"\0" in data:
        raise unreadable(path, "it is no text in UTF-8", _GIVE)
    text = data.decode("utf-8", "replace").removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    if text.lstrip().startswith(_AE):
        own, found = "ae", _after_effects(path, text)
    elif _CURVE.search(text):
        own, found = "nuke", _nuke(path, text)
    else:
        if frames is not None:  # before lines are split into cells, perhaps at semicolons
            start = _FIRST[convention or "pixels"] if first is None else first
            text = re.sub(PATTERN, lambda code: str(frames(shown(path), code[0]) + start), text)
        headed, found = _table(path, text)
        own = convention or ("pixels" if headed else "")
        if not own:
            what = "it is a table without a header, and does not say from where its pixels count"
            advice = "say whether it is from nuke, ae or in pixels (--track-from), or begin it with a line frame,x,y"
            raise unreadable(path, what, advice)
    if convention not in (None, own):
        raise unreadable(path, f"its positions are those of {own}, and {convention} was asked for", "leave that out")
    up = own == "nuke"
    if up and height is None:
        raise unreadable(path, "y points up in Nuke, from the lower edge", "give the height of the frames")
    rows = (height() if callable(height) else height or 0) if up else 0
    start, half = _FIRST[own] if first is None else first, 0.0 if own == "pixels" else 0.5
    return tuple(
        Track(label, tuple((k - start, (x - half, rows - y - half if up else y - half)) for k, x, y in points))
        for label, points in ((label, _ordered(path, keys)) for label, keys in found.items())
    )


def _ordered(path: PathLike, keys: Sequence[_Key]) -> list[tuple[int, float, float]]:
    made: dict[int, tuple[int, float, float]] = {}
    for where, frame, x, y in keys:
        for what, value in (("x", x), ("y", y)):
            if not abs(value) <= LARGEST:
                raise unreadable(path, f"{where}: {what} is {value:g}", "give a finite number")
        if not (abs(frame) <= LONGEST_AXIS and float(frame).is_integer()):
            raise unreadable(path, f"{where}: the frame is {frame:g}", "give a whole number")
        k = int(frame)
        if k in made:
            raise unreadable(path, f"{where}: frame {k} is there twice in one track", "give each track a name")
        made[k] = (k, x, y)
    return [made[k] for k in sorted(made)]


def _table(path: PathLike, text: str) -> tuple[bool, _Keys]:
    """Return whether a table has a header, and its tracks."""
    lines = [(n, line.strip()) for n, line in enumerate(text.split("\n"), 1)]
    rows = [(n, _cells(line)) for n, line in lines if line and not line.startswith("#")]
    if not rows:
        raise unreadable(path, "it holds no tracks", _GIVE)
    number, head = rows[0]
    width, headed = len(head), not any(map(_is_number, head))
    columns = {column: k for k, column in enumerate(_COLUMNS[:width])}
    if headed:
        names = [cell.lower() for cell in head]
        missing = [column for column in _COLUMNS[:3] if names.count(column) != 1]
        if missing:
            what = f"its columns are {value_shown(', '.join(head))}, without one named {missing[0]}"
            raise unreadable(path, f"line {number}: {what}", _GIVE)
        columns = {column: names.index(column) for column in _COLUMNS if column in names}
    keys: _Keys = {}
    for number, cells in rows[headed:]:
        if len(cells) != width or (not headed and width not in (3, 4)):
            wanted = (
                f"{width}, as the first line has" if headed or width in (3, 4) else "frame, x, y, or a name besides"
            )
            raise unreadable(path, f"line {number}: it has {len(cells)} columns", f"give {wanted}")
        for column in _COLUMNS[:3]:
            if not _is_number(cell := cells[columns[column]]):
                raise unreadable(path, f"line {number}: {column} is {value_shown(cell)}", "give a number")
        label = cells[columns["name"]] if "name" in columns else ""
        values = (float(cells[columns[column]]) for column in _COLUMNS[:3])
        keys.setdefault(label, []).append(_Key(f"line {number}", *values))
    if not keys:
        raise unreadable(path, "it has a header alone", "give the frames and positions below it")
    return headed, keys


def _cells(line: str) -> list[str]:
    separator = next((mark for mark in ("\t", ";", ",") if mark in line), None)
    return [cell.strip().strip("\"'") for cell in line.split(separator)]


def _is_number(text: str) -> bool:
    try:
        return not math.isnan(float(text))
    except ValueError:
        return False


def _after_effects(path: PathLike, text: str) -> _Keys:
    """Return the positions of keyframes: sections that begin with a name, and have columns in pixels."""
    keys: _Keys = {}
    label = ""
    columns: list[str] = []
    body, end, _ = text.partition("\nEnd of Keyframe Data")
    for number, line in enumerate(body.split("\n"), 1):
        if line and not line[0].isspace():
            parts = [part.strip() for part in line.split("\t") if part.strip()]
            label, columns = " ".join(parts[1:] if len(parts) > 1 else parts), []
            continue
        cells = [cell.strip() for cell in line.split("\t")][1:]
        if "Frame" in cells[:1]:
            columns = cells
            continue
        if columns[1:3] != ["X pixels", "Y pixels"] or label == "Anchor Point" or not any(cells):
            continue
        if not cells[0]:
            continue  # a constant value has no frame
        if len([*filter(None, cells)]) != len([*filter(None, columns)]) or not all(map(_is_number, cells[:3])):
            raise unreadable(path, f"line {number}: it is {value_shown(line.strip())}", "give a frame, x and y")
        keys.setdefault(label, []).append(_Key(f"line {number}", *map(float, cells[:3])))
    if not keys:
        raise unreadable(path, "none of its keyframes are positions", "copy those of a position or a tracker")
    if not end:
        raise unreadable(path, "it breaks off before End of Keyframe Data")
    return keys


def _nuke(path: PathLike, text: str) -> _Keys:
    """Return the points of a script: rows of Tracker4 nodes, and pairs of curves in knobs of points."""
    curves = [found.groups() for found in _ROW.finditer(text)]
    for pair in _PAIR.finditer(text):
        knob = re.search(r"([A-Za-z_]\w*)?\s*\Z", text[max(0, pair.start() - 80) : pair.start()])
        label = (knob and knob[1]) or ""
        if not label or _POINTS.fullmatch(label):
            curves.append((label, *pair.groups()))
    if not curves:
        raise unreadable(path, "none of its curves are of points", "give a tracker or a corner pin")
    keys: _Keys = {}
    for name, *both in curves:
        label, k = name or "track", 2
        while label in keys:
            label, k = f"{name or 'track'} {k}", k + 1
        where = f"track {value_shown(label)}"
        x, y = (dict(_values(path, where, curve)) for curve in both)
        if not x or x.keys() != y.keys():
            what = f"{where}: x has {len(x)} keys, and y {len(y)}, of other frames"
            raise unreadable(path, what, "give both alike")
        keys[label] = [_Key(where, frame, x[frame], y[frame]) for frame in x]
    return keys


def _values(path: PathLike, where: str, curve: str) -> Iterator[tuple[float, float]]:
    """Yield the keys (frame, value) of a curve: ``x1 100 101 x5 90`` has frames 1, 2 and 5; letters are its shape."""
    frame: float | None = None
    given = False
    for word in curve.split():
        if keyed := _KEYED.fullmatch(word):
            frame, given = float(keyed[1]), True
        elif _NUMBER.fullmatch(word):
            if frame is None:
                raise unreadable(path, f"{where}: its curve has a value without a frame", "copy it again")
            frame = frame if given else frame + 1
            given = False
            yield frame, float(word)
