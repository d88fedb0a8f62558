"""Previews of a picture in its metadata, which show the old pixels: removed, wherever they are."""

from __future__ import annotations

import re

_SIGNS = re.compile(rb"\xff\xd8\xff|\xff\xd9")  # where a JPEG begins, and where one ends
_RESOURCE = re.compile(rb"(?s)8BIM(..)")
_THUMBNAILS = (1033, 1036)
_PLACES = rb"(?:\w+:Thumbnails|(?:Container|GContainer|GDepth|GImage|hdrgm|HDRGainMap):\w+|xmpNote:HasExtendedXMP)"
# elements, attributes, and any picture in base64: JPEG, PNG, GIF, WebP, TIFF, AVIF and HEIF
_IN_XMP = (
    rb"(?s)<(" + _PLACES + rb")\b(?:[^<>]*/>|.*?</\1\s*>)",
    rb"(?s)\s" + _PLACES + rb"\s*=\s*(?:\"[^\"]*\"|'[^']*')",
    rb"\sdcterms:provenance\s*=\s*\"[^\"]*(?:c2pa|jumbf)[^\"]*\"",
    rb"(?:/9j/|iVBORw0KGgo|R0lGOD|UklGR|SUkq|TU0AK|AAAA\w\wZ0eX)[A-Za-z0-9+/=\s&#;]{64,}",
)


def blanked(data: bytes) -> bytes:
    """Return bytes with zeros for every JPEG in them, in maker notes for instance, whose offsets stay valid."""
    made, begin, depth = bytearray(data), 0, 0
    for found in _SIGNS.finditer(data):  # one may hold another
        opens = found[0] != b"\xff\xd9"
        if opens and depth == 0:
            begin = found.start()
        if opens or depth:
            depth += 1 if opens else -1
            made[begin : found.end()] = bytes(found.end() - begin)
    return bytes(made)


def without_thumbnails(data: bytes) -> bytes:
    """Return Photoshop's image resources without thumbnails."""
    made, at = bytearray(), 0
    while found := _RESOURCE.search(data, at):
        made += data[at : found.start()]
        name = found.end() + (data[found.end()] // 2 * 2 + 2 if found.end() < len(data) else 0)
        size = int.from_bytes(data[name : name + 4])
        at = min(name + 4 + size + size % 2, len(data))
        if int.from_bytes(found[1]) not in _THUMBNAILS:
            made += data[found.start() : at]
    return bytes(made + data[at:])


def without_pictures(xmp: bytes) -> bytes:
    """Return XMP without pictures, and without what refers to others in the file."""
    for pattern in _IN_XMP:
        xmp = re.sub(pattern, b"", xmp)
    return xmp
