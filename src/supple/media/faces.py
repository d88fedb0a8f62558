"""Named landmarks of faces from files: tables, ``.pts`` of iBUG, XML of dlib and JSON of MediaPipe."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import PurePath
from typing import Any
from xml.etree import ElementTree

import numpy as np

from supple.errors import SuppleError, shown
from supple.media.files import PathLike, check_suffix, head_of, refusing, unreadable
from supple.media.points import text_of
from supple.media.tables import bare, parsed
from supple.space.geometry import Floats

Face = dict[str, tuple[float, float]]
"""The landmarks of a face: their names, and their pixels in the upright picture, x first."""

SUFFIXES = (".pts", ".csv", ".tsv", ".txt", ".xml", ".json")
_GIVE = f"give landmarks in a file {', '.join(SUFFIXES)}"

_KINDS = {
    ".pts": "list of n_points points between { and }",
    ".xml": "dataset of dlib's imglab, with images, boxes and parts",
    ".json": "result of MediaPipe's face landmarker, with a list face_landmarks",
}
_LISTS = ("face_landmarks", "faceLandmarks", "multi_face_landmarks", "multiFaceLandmarks")

# By name, the indices, from 0, of the iBUG 300-W points (68) whose mean it is. Left is the person's own left.
_NAMES: dict[str, Sequence[int]] = {
    "left_eye": range(42, 48), "left_eye_inner": (42,), "left_eye_outer": (45,), "left_eye_top": (43, 44),
    "left_eye_bottom": (46, 47), "left_brow": (24,), "left_brow_inner": (22,), "left_brow_outer": (26,),
    "right_eye": range(36, 42), "right_eye_inner": (39,), "right_eye_outer": (36,), "right_eye_top": (37, 38),
    "right_eye_bottom": (40, 41), "right_brow": (19,), "right_brow_inner": (21,), "right_brow_outer": (17,),
    "nose_bridge": (27,), "nose_tip": (30,), "nose_base": (33,), "nose_left": (35,), "nose_right": (31,),
    "mouth": (48, 51, 54, 57), "mouth_left": (54,), "mouth_right": (48,), "mouth_top": (51,), "mouth_bottom": (57,),
    "chin": (8,), "jaw_left": (12,), "jaw_right": (4,), "ear_left": (16,), "ear_right": (0,),
}  # fmt: skip
# The indices of these 68 in MediaPipe's face mesh of 468 points, or 478 with the irises.
_MESH = (
    127, 234, 93, 132, 58, 136, 150, 176, 152, 400, 379, 365, 288, 361, 323, 454, 356,  # jaw
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,  # brows
    168, 197, 195, 4, 98, 97, 2, 326, 327,  # nose
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  # eyes
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,  # lips
    78, 81, 13, 311, 308, 402, 14, 178,  # and between them
)  # fmt: skip


def read_faces(path: PathLike, size: tuple[int, int], *, picture: PathLike = "", turn: int = 1) -> tuple[Face, ...]:
    """Return the faces of a file of landmarks, the largest first.

    Parameters
    ----------
    path : str or os.PathLike
        A table (.csv, .tsv, .txt) with columns x, y and name (not needed for 68, 468 or 478 rows); ``.pts``, which
        counts pixels from 1; ``.xml`` of dlib's imglab; or ``.json`` of MediaPipe's face landmarker, in fractions of
        the picture's width and height.
    size : (int, int)
        The width and height of the upright picture.
    picture : str or os.PathLike
        The picture's name, to find its entry in an XML for several pictures.
    turn : int
        The orientation in the picture's header, 1 to 8, for an XML whose landmarks are in stored, not upright pixels.

    Returns
    -------
    tuple of dict
        For each face, the pixel (x, y) of each name. Schemes of 68 (iBUG, dlib) and 468 or 478 points (MediaPipe) have
        the names in docs/faces.md, and all have ``point_0``, ``point_1`` … in the order of the file.

    Raises
    ------
    SuppleError
        If the file cannot be read, is damaged or has no face, or most landmarks lie outside of the picture.
    """
    suffix = PurePath(path).suffix.lower()
    check_suffix(path, suffix, SUFFIXES, "is of no landmarks", _GIVE, "read")
    if suffix in (".csv", ".tsv", ".txt"):
        faces = [_of_table(path)]
    else:
        text = head_of(path, -1, _GIVE, _GIVE).decode("utf-8-sig", "replace")
        kinds = ValueError, TypeError, LookupError, AttributeError, RecursionError, ElementTree.ParseError
        with refusing(lambda _: unreadable(path, f"it is no {_KINDS[suffix]}", _GIVE), *kinds):
            if suffix == ".pts":
                faces = [named(_of_pts(text) - 1)]  # the first pixel is (1, 1)
            elif suffix == ".xml":
                faces = _of_xml(path, text, size, picture, turn)
            else:
                faces = [named(points * size - 0.5) for points in _of_json(text)]
    for face in faces:
        points = np.array([*face.values()])
        out = np.any(~((points >= -1) & (points <= size)), axis=1)
        if np.mean(out) > 0.5 or not np.isfinite(points).all():
            name, (x, y) = next(item for item, lost in zip(face.items(), out.tolist(), strict=True) if lost)
            raise SuppleError(
                f"{shown(path)} has {name} at ({x:.5g}, {y:.5g}), outside of the picture of {size[0]} x {size[1]} "
                "pixels: give the landmarks of this picture, in pixels of it upright"
            )
    if not faces:
        raise SuppleError(f"{shown(path)} has no face: {_GIVE}")
    return tuple(sorted(faces, key=lambda face: float(np.prod(np.ptp([*face.values()], axis=0))), reverse=True))


def named(points: Floats, names: Sequence[str] = ()) -> Face:
    """Return points (N, 2) by ``names``, or by those of their scheme and ``point_0``, ``point_1`` and so on."""
    places = np.asarray(points, np.float64)
    scheme = places if len(places) == 68 else places[[*_MESH]] if len(places) in (468, 478) else None
    face = {plain(name): at for name, at in zip(names, places, strict=False) if name}
    if not face and scheme is not None:
        face = {name: scheme[[*own]].mean(axis=0) for name, own in _NAMES.items()}
        face |= {f"jaw_{k + 1}": scheme[k] for k in range(17)}
        face |= {"forehead": places[10]} if len(places) > 68 else {}
    if not any(names):
        face |= {f"point_{k}": at for k, at in enumerate(places)}
    return {name: (float(at[0]), float(at[1])) for name, at in face.items()}


def plain(name: str) -> str:
    """Return a landmark's name normalised for comparison: in lower case, with _ between words."""
    return re.sub(r"[\s-]+", "_", name.strip().lower())


def _of_table(path: PathLike) -> Face:
    name = shown(path)
    table, points, _, names, _ = parsed(name, text_of(path), fcsv=False)
    if not any(names) and 0 not in table.columns:  # without a header, text in the first cell is a name
        names = tuple(bare(table.records[row].cells[0]) for row in table.rows)
    if not any(names) and len(points) not in (68, 468, 478):
        raise SuppleError(f"{name} has {len(points)} points without names: give them in a column name")
    face = named(points[:, :2], names)
    if any(names) and len(face) < len(names):
        raise SuppleError(f"{name} has a landmark without a name, or two of one: give each a name of its own")
    return face


def _of_pts(text: str) -> Floats:
    rows = [
        line.replace(",", " ").split() for line in text.partition("{")[2].partition("}")[0].split("\n") if line.strip()
    ]
    points = np.array([[float(x), float(y)] for x, y in rows])
    if not rows or int(text.partition("n_points:")[2].split()[0]) != len(rows):
        raise ValueError
    return points


def _of_xml(path: PathLike, text: str, size: tuple[int, int], picture: PathLike, turn: int) -> list[Face]:
    images = [*ElementTree.fromstring(text).iter("image")]
    stem = PurePath(picture).stem
    own = [each for each in images if PurePath(each.attrib["file"].replace("\\", "/")).stem == stem]
    if not own:
        raise SuppleError(f"{shown(path)} has no image {shown(stem)}: add it, or give a file of its own")
    across = turn >= 5 and (own[0].get("width"), own[0].get("height")) == (str(size[1]), str(size[0]))
    faces = []
    for box in own[0].iter("box"):
        parts = [(each.attrib["name"], float(each.attrib["x"]), float(each.attrib["y"])) for each in box.iter("part")]
        names = [name for name, _, _ in parts]
        if all(name.isdigit() for name in names):
            parts, names = sorted(parts, key=lambda part: int(part[0])), []
        points = np.array([at for _, *at in parts])
        if across and size[0] != size[1]:  # landmarks are in stored pixels: rotate them
            x, y = points.T[::-1]
            x, y = size[0] - 1 - x if turn in (6, 7) else x, size[1] - 1 - y if turn in (7, 8) else y
            points = np.stack([x, y], axis=1)
        if len(parts):
            faces.append(named(points, names))
    return faces


def _of_json(text: str) -> list[Floats]:
    data: Any = json.loads(text)
    if isinstance(data, dict):
        data = data[next((name for name in _LISTS if name in data), _LISTS[0])]
    faces = [face["landmark"] if isinstance(face, dict) else face for face in data]
    return [np.array([[float(at["x"]), float(at["y"])] for at in face]) for face in faces if face]
