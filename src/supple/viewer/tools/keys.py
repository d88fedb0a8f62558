"""The effects of gestures and keys, in words, which the window shows on `?` and F1."""

from __future__ import annotations

from collections.abc import Mapping

Tool = str
"""One of `BRUSHES`."""
Rows = Mapping[str, str]

BRUSHES: Mapping[Tool, tuple[str, str]] = {
    "grab": ("G", "pull what is under the pointer"),
    "twist": ("T", "turn what is under the pointer: clockwise to the right, a quarter for the brush's radius"),
    "bloat": ("W", "widen what is under the pointer, the more the farther you drag"),
    "pucker": ("P", "draw together what is under the pointer, the more the farther you drag"),
    "pinch": ("N", "squeeze what is under the pointer along the drag, and stretch it across; with Shift, the reverse"),
    "path": ("F", "pull what is under the pointer along the way that you draw"),
    "restore": ("R", "bring back what is under the pointer to where it came from; a click does so once"),
    "push": ("A", "push what is under the pointer to the left of the way that you draw; with Shift, to the right"),
    "smooth": ("S", "even out how far the surroundings have moved; a click does so once"),
    "pin": (
        "D",
        "hold a point against the selected grab, by a click, or drag one more; a click on a point removes it",
    ),
    "freeze": ("C", "paint what later strokes do not move, as it is now; with Shift, thaw"),
    "thaw": ("V", "paint what strokes may move again; with Shift, freeze"),
    "level": ("Y", "draw a line that shall be level, or upright: the picture is turned, in the same resampling"),
    "keystone": ("K", "drag four corners onto what shall be an upright rectangle; any other tool shows the result"),
}
"""For each brush, in the order of the tools' strip, its key, and what a drag with it does."""
_ALWAYS: Rows = {
    **{key: f"{name}: {what}" for name, (key, what) in BRUSHES.items() if name not in ("level", "keystone", "push")},
    "M": "strokes are symmetric about the dashed line, or no longer; its lower knob moves it, the upper one tilts it",
    "click": "select the stroke whose handle is there, or none",
    "[  ]": "smaller and larger brush, or selected stroke",
    "Ctrl+click on a slider": "type its number",
    "Delete, Backspace": "remove the selected stroke",
    "H": "hide it, or show it again",
    "Escape": "close a menu, abandon the drag, or select nothing",
    "Ctrl+Z": "undo; a drag is one step",
    "Ctrl+Shift+Z, Ctrl+Y": "redo",
    "\\ held": "show the original",
    "B": "before and after, side by side; drag the knob between them",
    "Ctrl+S, Ctrl+Shift+S": "save the recipe; under another name",
    "Ctrl+H": "hide handles, or show them again",
    "Ctrl+O": "open a recipe, or another file in a window of its own; or drop it on the window",
    "Ctrl+E": "export",
    "?  F1": "show or hide this list",
}
_PICTURE: Rows = {
    "drag": "pull what is under the pointer, or a handle of the selected stroke",
    "wheel, right drag": "size of the brush: the ring is where a twentieth of a drag is left",
    "Ctrl+wheel": "zoom about the pointer",
    "middle drag, Alt+drag": "move the view",
    "0  1": "fit the picture, or show it at 100 %",
}
_PUSH: Rows = {BRUSHES["push"][0]: f"push: {BRUSHES['push'][1]}"}
KEYS: Mapping[str, Rows] = {
    "image": {
        **_PICTURE,
        **{BRUSHES[name][0]: f"{name}: {BRUSHES[name][1]}" for name in ("push", "level", "keystone")},
        **_ALWAYS,
    },
    "video": {
        **_PICTURE,
        **_PUSH,
        "wheel in a drag": "pull the pixel through time, up is later; also with the arrows Left and Right",
        "Space": "play and pause",
        "Left, Right": "the frame before, and after",
        "Home, End": "the first frame, and the last",
        "I  O  U": "begin and end of the part that is played; the whole clip",
        "L": "play again and again",
        "J  K": "the key before of the selected stroke, and the next",
        "Shift+drag": "move all positions of a stroke that moves, and not only the one in this frame",
        **_ALWAYS,
    },
    "volume": {
        "drag in a plane": "pull the point under the pointer, within the plane",
        "click, Shift+drag": "move the crosshair, through which the planes go, without pulling",
        "wheel in a plane": "the next slice; also with the arrows Up and Down",
        "right drag in a plane": "contrast (left, right) and brightness (up, down)",
        "Ctrl+wheel": "zoom the planes about the pointer",
        "drag on the object": "pull the point under the pointer, parallel to the screen",
        "drag beside it, right drag": "turn the view",
        "click on the cube": "look from that side; a drag of it turns the view",
        "middle drag, Alt+drag": "move the view",
        "wheel on the object": "nearer and farther",
        "Shift+wheel, Shift+right drag": "size of the brush: the ring is where a twentieth of a drag is left",
        "X": "the next way to compare with a fixed volume",
        "L": "set a pair of landmarks, by a click in each of two volumes",
        "1  2  3  4": "give the whole canvas to the axial, coronal, sagittal plane or the rendering; again: all four",
        "Up, Down": "the next slice, and the one before",
        "0": "the view of the beginning",
        **_ALWAYS,
    },
}
"""For each kind of media, gestures and keys in the order in which they are listed, and what they do."""
