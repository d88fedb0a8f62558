"""Previews of the unedited picture leave with it."""

from __future__ import annotations

import base64
import io
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from supple.media.image import read, write

Y, X = np.mgrid[:60, :80]
PICTURE = Image.fromarray(np.stack([3 * X, 4 * Y, 255 - 3 * X], axis=-1).astype(np.uint8))


def jpeg(size: tuple[int, int], exif: bytes = b"") -> bytes:
    file = io.BytesIO()
    PICTURE.resize(size).save(file, "JPEG", exif=exif)
    return file.getvalue()


INNER = jpeg((16, 12))
PREVIEW = jpeg((40, 30), b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0\0\0" + INNER)  # which has one itself
TEXT = base64.b64encode(PREVIEW)


def directory(*entries: tuple[int, int, int, int]) -> bytes:
    return struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries)


def exif() -> bytes:
    """EXIF with a preview in the maker's note, and one in the folder of the thumbnail."""
    note = b"Maker\0" + PREVIEW + b"kept"
    start = 26 + 18
    first = directory((0x8769, 4, 1, 26)) + struct.pack("<I", start + len(note))
    second = directory((37500, 7, len(note), start)) + bytes(4)
    third = start + len(note)
    thumbnail = directory((0x103, 3, 1, 6), (0x201, 4, 1, third + 42), (0x202, 4, 1, len(PREVIEW))) + bytes(4)
    return b"Exif\0\0II*\0" + struct.pack("<I", 8) + first + second + note + thumbnail + PREVIEW


def resource(number: int, data: bytes, name: bytes = b"") -> bytes:
    title = bytes([len(name)]) + name
    title += bytes(len(title) % 2)
    return b"8BIM" + struct.pack(">H", number) + title + struct.pack(">I", len(data)) + data + bytes(len(data) % 2)


def xmp(inner: bytes) -> bytes:
    return b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF>' + inner + b"</rdf:RDF></x:xmpmeta>"


BROKEN = b"&#xA;".join(TEXT[k : k + 76] for k in range(0, len(TEXT), 76))
PACKETS = {
    "thumbnails": b'<d dc:title="kept"><xap:Thumbnails><rdf:li g:image="' + BROKEN + b'"/></xap:Thumbnails></d>',
    "attribute": b'<d GImage:Mime="image/jpeg" GImage:Data="' + TEXT + b'" dc:title="kept"/>',
    "element": b'<d dc:title="kept"><GDepth:Data>' + TEXT + b"</GDepth:Data></d>",
    "unknown": b'<d dc:title="kept"><own:look>' + TEXT + b"</own:look></d>",
    "gain map": b'<d hdrgm:Version="1.0" dc:title="kept"><Container:Directory><a/></Container:Directory></d>',
}


@pytest.mark.parametrize("packet", PACKETS)
def test_xmp(tmp_path: Path, packet: str) -> None:
    PICTURE.save(tmp_path / "in.jpg", xmp=xmp(PACKETS[packet]))
    write(tmp_path / "out.jpg", read(tmp_path / "in.jpg"))
    made = (tmp_path / "out.jpg").read_bytes()
    assert b'dc:title="kept"' in made
    assert not any(part in made for part in (b"Thumbnails", b"Container", b"hdrgm:", TEXT[40:76]))


@pytest.mark.parametrize("source", [".jpg", ".png", ".webp", ".avif"])
@pytest.mark.parametrize("target", [".jpg", ".png", ".tif", ".webp", ".avif"])
def test_from_file_to_file(tmp_path: Path, source: str, target: str) -> None:
    PICTURE.save(tmp_path / f"in{source}", exif=exif(), xmp=xmp(PACKETS["thumbnails"]))
    if source != ".avif":
        assert (tmp_path / f"in{source}").read_bytes().count(PREVIEW[-200:]) == 2
    write(tmp_path / f"out{target}", read(tmp_path / f"in{source}"))
    data = (tmp_path / f"out{target}").read_bytes()
    assert not any(part in data for part in (PREVIEW[-200:], INNER[-100:], TEXT[40:76]))
    assert b"kept" in data


IPTC = b"\x1c\x02\x05\0\x03abc"


@pytest.mark.parametrize(
    "blocks",
    [
        resource(1005, bytes(16)) + resource(1036, bytes(28) + PREVIEW) + resource(1028, IPTC, b"name"),
        resource(1033, PREVIEW, b"odd") + resource(1028, IPTC),
        resource(1028, IPTC + b"\x1c\x02\xca" + struct.pack(">H", len(PREVIEW)) + PREVIEW),
    ],
    ids=["thumbnail", "old thumbnail", "preview of IPTC"],
)
def test_resources_of_photoshop(tmp_path: Path, blocks: bytes) -> None:
    PICTURE.save(tmp_path / "in.jpg")
    data, block = (tmp_path / "in.jpg").read_bytes(), b"Photoshop 3.0\0" + blocks
    (tmp_path / "in.jpg").write_bytes(data[:2] + b"\xff\xed" + struct.pack(">H", len(block) + 2) + block + data[2:])
    write(tmp_path / "out.jpg", read(tmp_path / "in.jpg"))
    after = (tmp_path / "out.jpg").read_bytes()
    assert PREVIEW[-200:] not in after
    assert IPTC in after
    assert (resource(1005, bytes(16)) in after) == (resource(1005, bytes(16)) in blocks)


def test_profiles_in_hexadecimal_digits(tmp_path: Path) -> None:
    text = PngInfo()
    text.add_text("Raw profile type exif", f"\nexif\n    {len(exif())}\n{exif().hex()}")
    PICTURE.save(tmp_path / "in.png", pnginfo=text)
    write(tmp_path / "out.png", read(tmp_path / "in.png"))
    with Image.open(tmp_path / "out.png") as image:
        image.load()
        assert PREVIEW[-100:].hex() not in str(image.info)


@pytest.mark.parametrize("source", [".png", ".jpg", ".webp", ".avif", ".tif"])
def test_no_resolution_is_made_up_with_exif(tmp_path: Path, source: str) -> None:
    known = Image.Exif()
    known[0x10F] = "kept"
    PICTURE.save(tmp_path / f"in{source}", exif=known)
    picture = read(tmp_path / f"in{source}")
    for target in (".png", ".tif"):
        write(tmp_path / f"out{target}", picture)
        assert b"kept" in (tmp_path / f"out{target}").read_bytes()
    assert b"pHYs" not in (tmp_path / "out.png").read_bytes()
    with Image.open(tmp_path / "out.tif") as image:
        assert image.getexif()[296] == 1  # no unit
