"""EXIF in TIFF, which libvips neither reads nor writes: converted from and to the block of other formats.

Both are folders of tags. Folders are read as far as they are valid, and laid out anew, which keeps the valid parts of
damaged ones. Only wanted tags are read, and no more than `_ROOM` bytes of them.
"""

from __future__ import annotations

import io
import os
from collections.abc import Collection
from dataclasses import dataclass
from typing import BinaryIO, Literal, TypeAlias

import numpy as np

from supple.media.files import PathLike

# Kept: libvips passes no EXIF into a TIFF, nor out of one (TestExifInTiff).

# for each folder the folders below it, by the tag of their offset; the image's own folder has no tag
_IMAGE, _EXIF, _GPS, _INTEROP = -1, 34665, 34853, 40965
_BELOW: dict[int, tuple[int, ...]] = {_IMAGE: (_EXIF, _GPS), _EXIF: (_INTEROP,), _GPS: (), _INTEROP: ()}
_WIDTH, _HEIGHT = 40962, 40963
# tags of the image's own folder: names, dates, texts and ratings; the others describe the stored pixels
_SOUGHT = {269, 270, 271, 272, 305, 306, 315, 316, 18246, 18249, 33432, *range(40091, 40096), _EXIF, _GPS}
_MOST = 4096  # entries of a folder
_ROOM = 2**24  # bytes in all
_PREFIX = b"Exif\0\0"
SHAPED = b'{"shape": '  # tifffile's description of an array: dropped, as the shape may change
# by type of value: its size in bytes, and the size of the units whose bytes are swapped
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 129: 1}
_TURNED = {**_SIZES, 5: 4, 10: 4}
_LONG8 = 16
Order: TypeAlias = Literal["little", "big"]


@dataclass(frozen=True, slots=True)
class Value:
    """A value to be laid out: its type, and its bytes in little-endian order."""

    kind: int
    data: bytes

    @property
    def integers(self) -> list[int]:
        """The numbers, if they are integers without sign; none of other types."""
        size = {1: 1, 3: 2, 4: 4}.get(self.kind)
        return np.frombuffer(self.data, f"<u{size}").tolist() if size else []


# an entry as stored in a file, a value to be laid out, or a folder below
Folder: TypeAlias = "dict[int, bytes | Value | Folder]"


class _Form:
    """The number format of a file: its byte order, and whether it is a BigTIFF; and the sizes of counts and entries."""

    def __init__(self, order: Order, big: bool = False) -> None:
        self.order, self.big = order, big
        self.count, self.word, self.step = (8, 8, 20) if big else (2, 4, 12)

    def number(self, data: bytes) -> int:
        return int.from_bytes(data, self.order)

    def stored(self, number: int, size: int) -> bytes:
        return number.to_bytes(size, self.order)

    def swapped(self, kind: int, data: bytes) -> bytes:
        """Swap values of a type from the file's byte order to little-endian order, or back."""
        return data if self.order == "little" else np.frombuffer(data, f"u{_TURNED[kind]}").byteswap().tobytes()


class Reader:
    """A reader of folders; `whole` is true if all that was wanted could be read."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.size = file.seek(0, os.SEEK_END)
        self.room, self.whole = _ROOM, True
        head = self.at(0, 16)
        order: Order = "big" if head.startswith(b"MM") else "little"
        magic = int.from_bytes(head[2:4], order)
        self.form = _Form(order, magic == 43)
        self.start = 8 if self.form.big else 4  # the position of the first folder's offset
        self.first = self.form.number(head[self.start : self.start + self.form.word])
        if head[:2] not in (b"II", b"MM") or magic not in (42, 43):
            self.first, self.whole = self.size, False

    def at(self, offset: int, size: int) -> bytes:
        """Return the bytes at an offset, fewer at the end of the file."""
        size = min(size, self.size - offset)
        if size <= 0:
            return b""
        self.file.seek(offset)
        return self.file.read(size)

    def entries(self, offset: int) -> tuple[list[bytes], bytes]:
        """Return a folder's entries as stored, and the bytes after them."""
        form = self.form
        head = self.at(offset, form.count)
        count = min(form.number(head), _MOST)
        table = self.at(offset + form.count, form.step * count + form.word)
        found = min(count, len(table) // form.step)
        if len(head) < form.count or found < form.number(head):
            self.whole = False
        entries = [table[at : at + form.step] for at in range(0, form.step * found, form.step)]
        return entries, table[form.step * count :].ljust(form.word, b"\0")

    def folder(self, offset: int, parent: int = _IMAGE) -> Folder:
        """Read a folder and those below it, each only once, which ends cycles."""
        found: Folder = {}
        for entry in self.entries(offset)[0]:
            tag = self.form.number(entry[:2])
            if tag in found or (parent == _IMAGE and tag not in _SOUGHT):
                continue
            if tag not in _BELOW:
                value = self.value(entry)
                if value is not None and value.data and not value.data.startswith(SHAPED):
                    found[tag] = value
            elif tag not in _BELOW[parent]:
                self.whole = False
            elif below := self.folder(self.integer(entry) or self.size, tag):
                found[tag] = below
        return found

    def value(self, entry: bytes) -> Value | None:
        """Return the value of an entry, which is in it or at its offset; None if it is incomplete."""
        form = self.form
        kind, count = form.number(entry[2:4]), form.number(entry[4 : -form.word])
        size = _SIZES.get(kind, _ROOM + 1) * count
        if size <= form.word:
            data = entry[-form.word :][:size]
        else:
            data = self.at(form.number(entry[-form.word :]), size) if size <= self.room else b""
        if kind not in _SIZES or len(data) < size:
            self.whole = False
            return None
        self.room -= size
        return Value(2 if kind == 129 else kind, form.swapped(kind, data))

    def integer(self, entry: bytes) -> int:
        """Return the integer stored in an entry; 0 for other types."""
        size = {1: 1, 3: 2, 4: 4, 13: 4, 16: 8, 18: 8}.get(self.form.number(entry[2:4]), 0)
        return self.form.number(entry[-self.form.word :][:size])


def from_tiff(path: PathLike) -> tuple[bytes | None, bool]:
    """Return an EXIF block of a TIFF's first page, if it has tags, and whether all could be read."""
    with open(path, "rb") as file:
        reader = Reader(file)
        found = reader.folder(reader.first)
    return (_block(found, reader.form) if found else None), reader.whole


def is_whole(block: bytes) -> bool:
    """Return whether all of an EXIF block can be read."""
    return _parsed(block)[2]


def fitted(block: bytes, most: int) -> bytes:
    """Return an EXIF block of at most ``most`` bytes: the largest values are dropped until it fits."""
    found, form, _ = _parsed(block)
    folders = [found, *(item for item in found.values() if isinstance(item, dict))]
    while len(block) > most:
        values = [(len(item.data), k, tag) for k, folder in enumerate(folders) for tag, item in folder.items()
                  if isinstance(item, Value)]  # fmt: skip
        _, k, tag = max(values)
        del folders[k][tag]
        block = _block(found, form)
    return block


def for_tiff(block: bytes, width: int, height: int) -> Folder:
    """Return the tags of an EXIF block, with the size of its image; no tags for an empty block."""
    found = _parsed(block)[0]
    inner = found.get(_EXIF)
    if isinstance(inner, dict):
        for tag, number in ((_WIDTH, width), (_HEIGHT, height)):
            if tag in inner:
                inner[tag] = Value(4, number.to_bytes(4, "little"))
    return found


def into_tiff(path: PathLike, added: Folder, changed: Folder, dropped: Collection[int] = ()) -> None:
    """Lay the folders of a TIFF's pages out anew, at its end.

    ``added`` are tags for the first page, unless it has them; ``changed`` are new values for every page; the tags
    ``dropped`` are removed from every page.
    """
    if not added and not changed and not dropped:
        return
    with open(path, "rb+") as file:
        reader = Reader(file)
        form, link, at, end = reader.form, reader.start, reader.first, reader.size
        while at:
            entries, following = reader.entries(at)
            stored: Folder = {form.number(entry[:2]): entry for entry in entries}
            folder = {tag: item for tag, item in (added | stored | changed).items() if tag not in dropped}
            place = end + -end % form.word
            data = _laid(folder, place, form, following)
            file.seek(end)
            file.write(bytes(place - end) + data)
            file.seek(link)
            file.write(form.stored(place, form.word))
            added, end = {}, place + len(data)
            link, at = place + form.count + form.step * len(folder), form.number(following)


def _parsed(block: bytes) -> tuple[Folder, _Form, bool]:
    reader = Reader(io.BytesIO(block.removeprefix(_PREFIX)))
    return reader.folder(reader.first), reader.form, reader.whole


def _block(found: Folder, source: _Form) -> bytes:
    form = _Form(source.order)  # unchanged, since makers' notes may depend on it
    head = (b"II" if form.order == "little" else b"MM") + form.stored(42, 2) + form.stored(8, 4)
    return _PREFIX + head + _laid(found, 8, form)


def _laid(folder: Folder, place: int, form: _Form, following: bytes = b"") -> bytes:
    """Return the bytes of a folder at `place`, followed by its values."""
    table = bytearray(form.stored(len(folder), form.count))
    rest = bytearray()
    behind = place + form.count + form.step * len(folder) + form.word
    behind += -behind % form.word
    for tag, item in sorted(folder.items()):
        if isinstance(item, bytes):
            table += item
            continue
        if isinstance(item, Value):
            kind, count = item.kind, len(item.data) // _SIZES[item.kind]
            data = form.swapped(kind, item.data)
        else:
            kind, count = (_LONG8 if form.big else 4), 1
            data = _laid(item, behind + len(rest), form)
        if isinstance(item, dict) or len(data) > form.word:
            inline = form.stored(behind + len(rest), form.word)
            rest += data + bytes(-len(data) % form.word)
        else:
            inline = data.ljust(form.word, b"\0")
        table += form.stored(tag, 2) + form.stored(kind, 2) + form.stored(count, form.word) + inline
    table += following or bytes(form.word)
    return bytes(table + bytes(behind - place - len(table)) + rest)
