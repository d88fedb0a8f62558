"""Faces in pictures: their landmarks, from files or by detection, and the strokes that adjust them."""

from __future__ import annotations

import os
import re
import threading
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import SuppleError, argument, listing, shown
from supple.media.faces import SUFFIXES, Face, named, read_faces
from supple.media.files import PathLike
from supple.media.image import info
from supple.space.checks import choice, number
from supple.space.geometry import Floats
from supple.strokes import Stroke

ADJUSTMENTS = ("slim", "eyes", "smile", "nose", "jaw")
"""The adjustments of a face, in percent."""
_MODULES = ("dlib", "face_recognition_models")  # the packages of the detector and of its models
_LONGEST = 1600  # pixels on the longest side of the picture in which faces are detected
_LEAST = 0.3  # the lowest accepted score of a detection
_RADIUS = 0.3  # of the brush; this and the next three are in distances between the eyes
_AROUND = 0.45  # from the outline of the face to the pins around it
_APART = 0.03  # the smallest distance between handles
_CHIN = 1.8  # below the eyes, if there is no landmark for it
_EYES = tuple(f"{side}_eye_{end}" for side in ("left", "right") for end in ("inner", "outer", "top", "bottom"))
_PAIRS = {"mouth": ("mouth_left", "mouth_right"), "nose": ("nose_left", "nose_right")}
_FIXED = (
    "left_eye", "right_eye", *(f"{side}_brow{end}" for side in ("left", "right") for end in ("_inner", "", "_outer")),
    "nose_bridge", "nose_tip", "nose_base", "forehead", "mouth_top", "mouth_bottom",
)  # fmt: skip
_OUTLINE = ("ear_right", "jaw_right", *(f"jaw_{k}" for k in range(1, 18)), "chin", "jaw_left", "ear_left")
_NEEDED = {"eyes": _EYES, "smile": _PAIRS["mouth"], "nose": _PAIRS["nose"]}
_NEEDED |= dict.fromkeys(("slim", "jaw"), ("jaw_left", "jaw_right", "chin"))


def faces_of(picture: PathLike, landmarks: PathLike | None = None) -> tuple[Face, ...]:
    """Return the landmarks of the faces of a picture, the largest face first.

    Parameters
    ----------
    picture : str or os.PathLike
        A picture. Landmarks are in pixels of the upright picture, as strokes are.
    landmarks : str or os.PathLike, optional
        Their file; or a folder with a file of the picture's stem; or a name in which ``*`` stands for that stem. By
        default, the file of that stem beside the picture; without one, faces are detected, if the extra ``face`` is
        installed, by dlib's detector of frontal faces and its model of 68 landmarks.

    Returns
    -------
    tuple of dict
        As `supple.media.faces.read_faces` returns them.

    Raises
    ------
    SuppleError
        If there are no landmarks, their file cannot be read, or no face is found.
    """
    facts = info(picture)
    path = landmarks_file(picture, landmarks)
    if path is None:
        return _found(picture)
    width, height, turn = (int(str(facts[name])) for name in ("width", "height", "orientation"))
    return read_faces(path, (width, height), picture=picture, turn=turn)


def landmarks_file(picture: PathLike, landmarks: PathLike | None = None) -> Path | None:
    """Return the file of landmarks of a picture; None if none is given, and none lies beside it."""
    folder, stem = Path(picture).parent if landmarks is None else Path(landmarks), Path(picture).stem
    if landmarks is not None and not os.path.isdir(landmarks):
        return Path(os.fspath(landmarks).replace("*", stem))
    path = next((path for suffix in SUFFIXES if (path := folder / f"{stem}{suffix}").is_file()), None)
    if path is None and landmarks is not None:
        raise SuppleError(
            f"{shown(landmarks)} has no landmarks of {shown(picture)}: add {shown(f'{stem}.pts')} or .csv"
        )
    return path


def can_find() -> bool:
    """Return whether the packages that detect faces are installed."""
    return all(find_spec(module) is not None for module in _MODULES)


def _found(picture: PathLike) -> tuple[Face, ...]:
    """Return the faces that are detected in a picture."""
    name = shown(picture)
    if not can_find():
        raise SuppleError(
            f"{name} has no landmarks: put {shown(f'{Path(picture).stem}.pts')}, .csv, .xml or .json beside it, or pip "
            "install 'supple[face]', by which faces are found"
        )
    from supple.media.image.vips import opened

    image = opened(picture)[0]
    width = int(str(info(picture)["width"]))
    small = image.thumbnail_image(_LONGEST, height=_LONGEST).colourspace("srgb")
    pixels = np.ascontiguousarray(small.flatten().numpy() if small.hasalpha() else small.numpy())[..., :3]
    with _ONE:
        detector, predictor = _models()
        boxes, _, _ = detector.run(pixels, 0, _LEAST)
        order = sorted(range(len(boxes)), key=lambda k: -boxes[k].area())
        shapes = [predictor(pixels, boxes[k]).parts() for k in order]
    if not shapes:
        raise SuppleError(f"no face is found in {name}: put a file of its landmarks beside it, .pts or .csv")
    scale = width / pixels.shape[1]
    return tuple(named((np.array([(p.x, p.y) for p in shape]) + 0.5) * scale - 0.5) for shape in shapes)


_ONE = threading.Lock()


@cache
def _models() -> tuple[Any, Any]:
    import dlib

    spec = find_spec("face_recognition_models")  # not imported: it needs an old setuptools
    (folder,) = (spec and spec.submodule_search_locations) or ("",)
    return dlib.get_frontal_face_detector(), dlib.shape_predictor(
        str(Path(folder) / "models" / "shape_predictor_68_face_landmarks.dat")
    )


def face_stroke(face: Face, *, place: int = 1, size: tuple[int, ...] | None = None, **percents: float) -> Stroke:
    """Return a pull of a face's landmarks that adjusts the face; landmarks that do not move are pins.

    More pins hold the background around the outline of the face. Lengths are in proportion to the distance between the
    eyes, and directions follow from the eyes and the chin, so that tilted faces are adjusted in the same way.

    Parameters
    ----------
    face : dict
        Landmarks by name, as `faces_of` returns them.
    place : int
        Which face of the picture it is, for the stroke's name.
    size : (int, int), optional
        The width and height of the picture: landmarks on its edge or beyond are dropped.
    slim, jaw : float
        At 100, ``slim`` narrows the face from the cheeks to the chin by half its width; ``jaw`` widens the jaw by half.
    eyes, nose : float
        The percentage by which the eyes become larger, and the nose wider.
    smile : float
        How far the corners of the mouth move up, in percent of half its width; they move outwards by half of that.

    Raises
    ------
    SuppleError
        If a percentage is not from -100 to 100, or a landmark is missing that it needs.
    """
    part = dict.fromkeys(ADJUSTMENTS, 0.0)
    for name, percent in percents.items():
        choice("an adjustment", name, ADJUSTMENTS)
        part[name] = number(name, percent, "percent from -100 to 100", -100, 100) / 100
    places = {name: np.array(at) for name, at in face.items()}
    for eye in ("left_eye", "right_eye"):
        corners = [places[name] for name in (f"{eye}_inner", f"{eye}_outer") if name in places]
        places |= {eye: np.mean(corners, axis=0)} if eye not in places and len(corners) == 2 else {}
    needed: dict[str, tuple[str, ...]] = {"the size of a face": ("left_eye", "right_eye")}
    needed |= {argument(name): marks for name, marks in _NEEDED.items() if part[name]}
    for what, marks in needed.items():
        if missing := [mark for mark in marks if mark not in places]:
            raise SuppleError(f"{what} needs {listing(missing, 8)}, of which there is no landmark: add it")
    left, right = places["left_eye"], places["right_eye"]
    unit = float(np.linalg.norm(left - right))
    if not unit > 0:
        raise SuppleError("left_eye and right_eye are at one place, so that the face has no size: move one")
    across, centre = (left - right) / unit, places.get("nose_bridge", (left + right) / 2)
    down = np.array([-across[1], across[0]])
    below = next((places[name] for name in ("chin", "mouth", "mouth_bottom", "nose_tip") if name in places), centre)
    down = -down if (below - centre) @ down < 0 else down  # in a mirrored picture, the person's left is on the left
    middle = places.get("chin", centre + _CHIN * unit * down) - centre  # the way from the eyes to the chin

    def move(name: str) -> Floats:
        at = places[name]
        depth = (at - centre) @ down / (middle @ down)  # 0 at the eyes, 1 at the chin
        aside = (at - centre - depth * middle) @ across  # the signed distance from the face's middle line
        if name in _EYES:
            return np.asarray(part["eyes"] * (at - places[name.rpartition("_")[0]]))
        if name in _PAIRS["mouth"]:
            half = (at - places[_PAIRS["mouth"][0]] + at - places[_PAIRS["mouth"][1]]) @ across / 2
            out = 0.5 * part["smile"] - 0.15 * part["slim"]
            return np.asarray(out * half * across - part["smile"] * abs(half) * down)
        if name in _PAIRS["nose"]:
            return np.asarray(part["nose"] * aside * across)
        if name not in _OUTLINE:
            return np.zeros(2)
        cheeks, chin = np.clip([depth / 0.45, depth / 0.25 - 3], 0, 1)
        slim = cheeks**2 * (3 - 2 * cheeks) * (1 - 0.6 * chin**2)
        jaw = np.exp(-(((depth - 0.72) / 0.2) ** 2))
        return np.asarray(0.5 * (part["jaw"] * jaw - part["slim"] * slim) * aside * across)

    handles: list[tuple[Floats, Floats]] = []
    mouth = _PAIRS["mouth"] if {*_PAIRS["mouth"]} <= {*places} else ()
    outline = _OUTLINE if part["slim"] or part["jaw"] else ()
    for name in (*_EYES, *mouth, *_PAIRS["nose"], *_FIXED, *outline):
        if name in places and all(np.linalg.norm(at - places[name]) > _APART * unit for at, _ in handles):
            handles.append((places[name], move(name)))
            if name in outline:
                out = places[name] - centre
                handles.append((places[name] + _AROUND * unit * out / np.linalg.norm(out), np.zeros(2)))
    if size is not None:
        ends = np.array(size) - 1
        handles = [(at, by) for at, by in handles if np.all((at > 0) & (at < ends) & (at + by > 0) & (at + by < ends))]
    if not handles:
        raise SuppleError("the face lies on the edge of the picture or beyond it: leave it out")
    points, moves = zip(*handles, strict=True)
    said = ", ".join(f"{name} {100 * share:g}" for name, share in part.items() if share)
    return replace(Stroke.pull(points, by=moves, radius=_RADIUS * unit), name=f"face {place}: {said}")


def adjusted(stroke: Stroke) -> tuple[int, dict[str, float]] | None:
    """Return the number of the face and the percentages in the name of an adjusting stroke; None for other strokes."""
    found = re.fullmatch(r"face (\d+): (.*)", stroke.name or "")
    if found is None:
        return None
    return int(found[1]), {name: float(x) for name, x in re.findall(r"(\w+) (-?[\d.]+)", found[2])}
