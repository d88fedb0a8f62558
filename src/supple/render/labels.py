"""Colours of labels: a palette, tables in files, and the consecutive numbers that labels have in rendering."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.engine.work import Array
from supple.errors import SuppleError
from supple.render.picture import linear_light, srgb_of
from supple.space.checks import items, number, refuse
from supple.space.geometry import Floats

Colour = tuple[float, float, float, float]

SUFFIXES = (".ctbl", ".txt")
_MOST = 65535  # visible labels: their numbers have 16 bits
_LARGEST = 1 << 53  # float64 holds the integers up to it
_SPAN = 1 << 24  # the widest range of labels for which a look-up table is made
_SLICER = re.compile(r"(-?\d+)\s+(\S.*?)\s+(\d+)\s+(\d+)\s+(\d+)\s+(\d+)")
_SEGMENT = re.compile(r"Segment(\d+)_")
# From OKLab: the weights of a and b in the cube roots of cone responses, and the matrix from these to linear sRGB.
_TO_CONES = (0.3963377774, 0.2158037573), (-0.1055613458, -0.0638541728), (-0.0894841775, -1.2914855480)
_TO_LINEAR = (
    (4.0767416621, -3.3077115913, 0.2309699292),
    (-1.2684380046, 2.6097574011, -0.3413193965),
    (-0.0041960863, -0.7034186147, 1.7076147010),
)
_SNAP = re.compile(r'(\d+)\s+(\d+)\s+(\d+)\s+(\d+)\s+(\d+(?:\.\d*)?|\.\d+)\s+([01])\s+([01])\s+"(.*)"')


@dataclass(frozen=True, slots=True)
class LabelColours:
    """A colour and an opacity for each label of a volume. Label 0 is the background, which is not seen.

    Parameters
    ----------
    colours : mapping of int to (red, green, blue, opacity), optional
        sRGB from 0 to 1, and the opacity of a millimetre, for each label; others are not seen. By default, all labels
        are opaque, in the colours of `palette`.
    names : mapping of int to str, optional
        Names of labels, for a legend and for colour tables.
    """

    colours: Mapping[int, Colour] | None = None
    names: Mapping[int, str] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        given: Any = self.colours
        if given is None:
            return
        if not isinstance(given, Mapping) or not all(isinstance(k, int | np.integer) for k in given):
            refuse("colours", "a dict of labels, with red, green, blue and opacity for each", told=repr(given)[:60])
        made: dict[int, Colour] = {}
        for label, row in given.items():
            name = f"label {label}'s colour and opacity"
            red, green, blue, opacity = items(name, row, "four numbers: red, green, blue and opacity", (4,))
            r, g, b, a = (number(name, v, "numbers from 0 to 1", 0.0, 1.0) for v in (red, green, blue, opacity))
            made[int(label)] = r, g, b, a
        object.__setattr__(self, "colours", made)

    def name(self, label: int) -> str:
        """Return the name of a label, or ``label-5`` for one without."""
        return self.names.get(int(label), "") or f"label-{label}"

    def of(self, labels: npt.ArrayLike) -> Floats:
        """Return the colours of labels (N,): sRGB and opacity (N, 4)."""
        known = np.asarray(labels)
        if self.colours is None:
            made = np.concatenate([palette(known), np.ones((known.size, 1))], axis=1)
        else:
            made = np.array([self.colours.get(int(k), (0.0, 0.0, 0.0, 0.0)) for k in known], np.float64).reshape(-1, 4)
        made[known == 0] = 0.0
        return made

    def table(self, labels: npt.ArrayLike, step: float) -> npt.NDArray[np.float32]:
        """Return linear red, green and blue, and the opacity of a step in millimetres, of labels: (N, 4)."""
        seen = self.of(labels)
        opacity = 1 - (1 - seen[:, 3:]) ** step
        return np.ascontiguousarray(np.concatenate([linear_light(seen[:, :3]), opacity], axis=1), np.float32)

    def to_ctbl(self, labels: npt.ArrayLike) -> str:
        """Return the text of a colour table of 3D Slicer (``.ctbl``) for labels, for `from_text`."""
        rows = np.rint(255 * self.of(labels)).astype(int)
        lines = [
            f"{k} {self.name(k).replace(' ', '_')} {r} {g} {b} {a}"
            for k, r, g, b, a in np.column_stack([labels, rows]).tolist()
        ]
        return "\n".join(["# label name red green blue opacity", *lines]) + "\n"

    @classmethod
    def from_text(cls, text: str, name: str = "the colour table") -> LabelColours:
        """Read a colour table of 3D Slicer, FreeSurfer or ITK-SNAP; see docs/rendering.md.

        Raises
        ------
        SuppleError
            If a line has none of these formats; the message begins with ``name``.
        """
        made: dict[int, Colour] = {}
        names: dict[int, str] = {}
        inverse = True  # as in FreeSurfer's, where 0 is opaque
        for count, line in enumerate(text.splitlines(), 1):
            told = line.strip()
            if not told or told.startswith("#"):
                continue
            if found := _SNAP.fullmatch(told):
                label, *rgb, part, visible, _, title = found.groups()
                opacity, inverse = float(part) * int(visible), False
            elif found := _SLICER.fullmatch(told):
                label, title, *rgb, part = found.groups()
                opacity = int(part) / 255
            else:
                raise SuppleError(
                    f"{name}, line {count}, is {told[:60]!r}: a colour table has lines of a label, its name, red, "
                    "green, blue and opacity from 0 to 255, as 3D Slicer's, or is one of ITK-SNAP's (\"label R G B "
                    'opacity visible mesh "name"")'
                )
            red, green, blue = (int(v) / 255 for v in rgb)
            if max(red, green, blue, opacity) > 1:
                raise SuppleError(f"{name}, line {count}, is {told[:60]!r}: colours and opacity must not exceed 255")
            if int(label) in made:
                raise SuppleError(f"{name}, line {count}, gives label {label} another time: leave one of them")
            made[int(label)], names[int(label)] = (red, green, blue, opacity), title
        if not made:
            raise SuppleError(f"{name} has no colours: it should have lines of a label, its name, and R G B A")
        if inverse and not any(colour[3] for label, colour in made.items() if label):
            made = {label: (*colour[:3], 1.0) for label, colour in made.items()}
        return cls(made, names)

    @classmethod
    def of_segments(cls, header: Mapping[str, str], labels: npt.ArrayLike) -> LabelColours:
        """Return the colours of labels, as a segmentation of 3D Slicer (``.seg.nrrd``) has them in its header.

        Parameters
        ----------
        header : mapping of str to str
            Fields as ``Segment0_LabelValue`` (by default 1) and ``Segment0_Color``, three numbers from 0 to 1.
        labels : array_like of int
            The labels of the volume; those without a colour in the header have that of `palette`.

        Raises
        ------
        SuppleError
            If a field of the header is invalid.
        """
        made = dict(zip(np.asarray(labels).tolist(), map(tuple, cls().of(labels).tolist()), strict=True))
        names: dict[int, str] = {}
        for k in sorted({int(found[1]) for name in header if (found := _SEGMENT.match(name))}):
            value, colour = (header.get(f"Segment{k}_{name}", "") for name in ("LabelValue", "Color"))
            try:
                label = int(value or 1)
                red, green, blue = map(float, colour.split()) if colour else made.get(label, (0.0,) * 4)[:3]
            except ValueError:
                text = f"segment {k} has the label {value!r} and the colour {colour!r}: these should be a whole number"
                raise SuppleError(f"{text}, and three from 0 to 1") from None
            if label in made:
                made[label], names[label] = (red, green, blue, 1.0), header.get(f"Segment{k}_Name", "")
        return cls(made, names)


def palette(labels: npt.ArrayLike) -> Floats:
    """Return distinct colours of labels, sRGB from 0 to 1, (..., 3); a label always has the same colour.

    Hue and lightness in OKLCH advance by steps chosen such that the first 8, 16, 32 and 64 colours differ most.
    """
    k = np.asarray(labels, np.float64)
    hue = 2 * np.pi * np.mod(0.6535 + 0.27121414 * (k - 1), 1.0)
    light = 0.55 + 0.33 * np.mod(0.0531 + 0.39272236 * (k - 1), 1.0)
    a, b = 0.15 * np.cos(hue), 0.15 * np.sin(hue)
    cones = np.stack([light + x * a + y * b for x, y in _TO_CONES], axis=-1)
    return np.asarray(srgb_of(cones**3 @ np.array(_TO_LINEAR).T), np.float64)


def labels_in(samples: Array) -> Array:
    """Return the labels of a volume, in order, without 0.

    Raises
    ------
    SuppleError
        If a value is no whole number.
    """
    found: Array = np.zeros(0, np.int64)
    for slab in samples:
        values = _whole(slab)
        low = int(values.min())
        if int(values.max()) - low < _SPAN >> 4:
            values = low + np.flatnonzero(np.bincount((values - low).reshape(-1)))  # faster than to sort them
        found = np.union1d(found, values)
    return np.asarray(found[found != 0])


def numbered(samples: Array, visible: Array) -> Array:
    """Return the position of each voxel's label in the sorted ``visible``, from 1 on; 0 for all other labels."""
    if len(visible) > _MOST:
        refuse("the labels", f"at most {_MOST} that are visible", told=f"{len(visible)} of them")
    made = np.zeros(samples.shape, np.uint8 if len(visible) < 256 else np.uint16)
    if len(visible):
        low, span = int(visible[0]), int(visible[-1]) - int(visible[0]) + 1
        places = np.zeros(span + 2 if span <= _SPAN else 0, made.dtype)  # the end entries are for all other labels
        if places.size:
            places[1 + np.asarray(visible, np.int64) - low] = np.arange(1, len(visible) + 1)
        for slab, out in zip(samples, made, strict=True):
            values = _whole(slab)
            if places.size:
                out[...] = places[np.clip(values - (low - 1), 0, span + 1)]
            else:
                at = np.minimum(np.searchsorted(visible, values), len(visible) - 1)
                out[...] = np.where(visible[at] == values, at + 1, 0)
    return made


def _whole(slab: Array) -> npt.NDArray[np.int64]:
    if slab.dtype.kind == "f":
        known = np.where(np.isfinite(slab), slab, 0)
        broken = known[(known != np.rint(known)) | (np.abs(known) > _LARGEST)]
        if broken.size:
            refuse("the labels", "whole numbers (leave the colour table out for other values)", float(broken[0]))
        slab = known
    elif slab.dtype.itemsize == 8 and slab.size and int(slab.max()) > _LARGEST:
        refuse("the labels", f"whole numbers up to {_LARGEST}", int(slab.max()))
    return np.asarray(slab, np.int64)
