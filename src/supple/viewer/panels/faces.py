"""Faces of a picture: a section of the panel, whose sliders edit one stroke for each face."""

from __future__ import annotations

from functools import partial

import numpy as np
from imgui_bundle import imgui

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.files.faces import adjusted, can_find, face_stroke, faces_of, landmarks_file
from supple.media.faces import Face
from supple.viewer.document.editing import Document
from supple.viewer.panels.strokes import drag
from supple.viewer.panels.view import View
from supple.viewer.panels.widgets import REST, choice, section, slider, wrapped

_MOST = 0.5
_SLIDERS = {
    "slim": ("Slim", "Bring the sides of the face nearer together, from the cheeks to the chin"),
    "eyes": ("Eyes", "Make the eyes larger"),
    "smile": ("Smile", "Raise the corners of the mouth"),
    "nose": ("Nose", "Make the nose wider; below 0, narrower"),
    "jaw": ("Jaw", "Make the jaw wider; below 0, narrower"),
}


def draw(view: View) -> None:
    """Draw the section."""
    source = view.commands.source
    if view.stage.kind != "image" or source is None or not section(view, "Face"):
        return
    if view.faces is None and (
        landmarks_file(source) is not None or not can_find() or imgui.button("Find faces", (REST, 0))
    ):
        try:
            view.faces = faces_of(source)
        except SuppleError as error:
            view.faces = str(error)
    if isinstance(view.faces, str):
        wrapped(view.faces)
    elif view.faces is not None:
        _sliders(view, view.faces)


def _sliders(view: View, faces: tuple[Face, ...]) -> None:
    document = view.document
    if len(faces) > 1:
        view.face = choice("Face", view.face, {k: str(k + 1) for k in range(len(faces))}, "The largest is the first")
    known = [adjusted(stroke) for stroke in document.strokes]
    i = next((k for k, each in enumerate(known) if each is not None and each[0] == view.face + 1), None)
    percents = {} if i is None else dict((known[i] or (0, {}))[1])
    moved = False
    for name, (said, tip) in _SLIDERS.items():
        before = percents.get(name, 0.0) / 100
        part = slider(said, before, -_MOST, _MOST, tip=tip)
        if part != before:
            percents[name], moved = float(round(100 * part)), True
    if moved and not document.dragging:
        below = document.deformation if i is None else document.below(i)
        view.moved_face = i, _seen(faces[view.face], below)
    if moved and view.moved_face is not None:
        drag(view, i, partial(_preview, document, *view.moved_face, view.face + 1, percents))


def _preview(document: Document, i: int | None, face: Face, place: int, percents: dict[str, float]) -> None:
    stroke = face_stroke(face, place=place, size=document.deformation.grid.sizes, **percents)
    if i is None:
        document.preview(stroke, select=False)
    else:
        document.preview_as(stroke)


def _seen(face: Face, before: Deformation) -> Face:
    """Return the landmarks of a face, moved by the strokes before."""
    points = before.forward(np.array([*face.values()]))
    return {name: (float(x), float(y)) for name, (x, y) in zip(face, points, strict=True)}
