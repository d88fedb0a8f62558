"""Faces of pictures: their landmarks, from files or found, and the strokes that adjust them."""

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
_MODULES = ("dlib", "face_recognition_models")  # whose wheels have the program, and its models
_LONGEST = 1600  # pixels of the picture in which faces are looked for
_LEAST = 0.3  # score of a detection
_RADIUS = 0.3  # of the brush, in distances of the eyes, as all that follow
_AROUND = 0.45  # how far beyond the outline of the face nothing moves
_APART = 0.03  # between handles
_CHIN = 1.8  # below the eyes, where no landmark says it
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
        A picture. Landmarks count in it as it is shown upright, as strokes do.
    landmarks : str or os.PathLike, optional
        Their file; or a folder, which has a file with the picture's stem; or a name in which ``*`` stands for that.
        By default, the file of that stem beside the picture; without one, faces are found, if the extra ``face`` is
        installed: by dlib's detector of frontal faces, and its model of 68 landmarks.

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
    """Return whether what finds faces is installed."""
    return all(find_spec(module) is not None for module in _MODULES)


def _found(picture: PathLike) -> tuple[Face, ...]:
    """Return the faces that are found in a picture."""
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
    """Return the pull of all landmarks of a face that adjusts it; those that do not move are pins.

    Beyond the outline of the face, pins hold the background. Lengths follow from the distance of the eyes, and
    directions from them and the chin, so that a tilted face is adjusted alike.

    Parameters
    ----------
    face : dict
        Landmarks by name, as `faces_of` returns them.
    place : int
        Which face of the picture it is, for the stroke's name.
    size : (int, int), optional
        The width and height of the picture: what lies on its edge or beyond is left out.
    slim, jaw : float
        At 100, the face becomes slimmer by half of its width, from the cheeks to the chin; and the jaw wider by half of
        its.
    eyes, nose : float
        By how many percent the eyes get larger; the nose wider.
    smile : float
        How far the corners of the mouth go up, in percent of half its width, and out, by half as much.

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
    down = -down if (below - centre) @ down < 0 else down  # the person's left is on the left: a mirrored picture
    middle = places.get("chin", centre + _CHIN * unit * down) - centre  # the way from the eyes to the chin

    def move(name: str) -> Floats:
        at = places[name]
        depth = (at - centre) @ down / (middle @ down)  # 0 at the eyes, 1 at the chin
        aside = (at - centre - depth * middle) @ across  # from the middle of the face
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
    """Return which face a stroke adjusts, and by what percentages, as its name says; None for another stroke."""
    found = re.fullmatch(r"face (\d+): (.*)", stroke.name or "")
    if found is None:
        return None
    return int(found[1]), {name: float(x) for name, x in re.findall(r"(\w+) (-?[\d.]+)", found[2])}
