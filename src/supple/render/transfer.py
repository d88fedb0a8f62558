"""Transfer functions: colour and opacity of a volume's values."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError
from supple.render.labels import SUFFIXES as TABLES
from supple.render.labels import LabelColours
from supple.render.picture import linear_light
from supple.space.checks import items, number, refuse

ENTRIES = 4096

Point = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class TransferFunction:
    """Colour and opacity, piecewise linear in a volume's values.

    Parameters
    ----------
    points : sequence of (value, red, green, blue, opacity)
        In ascending order of values; colours are sRGB from 0 to 1, and the opacity is that of ``unit`` millimetres.
        Values beyond the first or the last point have its colour and opacity.
    unit : float
        The millimetres of material that have the opacity.
    relative : bool
        Whether values are fractions of the volume's range: 0 its smallest value, 1 its largest.
    """

    points: tuple[Point, ...]
    unit: float = 1.0
    relative: bool = False

    def __post_init__(self) -> None:
        given: Any = self.points
        if isinstance(given, str) or not isinstance(given, Sequence) or not 1 <= len(given) <= 10_000:
            refuse("points", "a sequence of points (value, red, green, blue, opacity)", given)
        made: list[Point] = []
        for i, point in enumerate(given):
            name = f"points[{i}]"
            values = items(name, point, "five numbers: value, red, green, blue and opacity", (5,))
            value = number(f"{name}'s value", values[0], "a finite number", -1e30, 1e30)
            rest = [number(f"{name}'s colour and opacity", v, "numbers from 0 to 1", 0.0, 1.0) for v in values[1:]]
            if made and value < made[-1][0]:
                refuse(name, f"in ascending order of values, from {made[-1][0]:g} on", value)
            made.append((value, rest[0], rest[1], rest[2], rest[3]))
        object.__setattr__(self, "points", tuple(made))
        number("unit", self.unit, "a number of millimetres from 1e-6 to 1e6", 1e-6, 1e6)

    def table(self, low: float, high: float, step: float) -> npt.NDArray[np.float32]:
        """Return the colours and opacities of values from ``low`` to ``high``.

        Parameters
        ----------
        low, high : float
        step : float
            The step of a ray, in millimetres, for which the opacity holds.

        Returns
        -------
        float32 array, shape (4096, 4)
            Linear red, green and blue, and opacity.
        """
        values = np.linspace(low, high, ENTRIES)
        known = np.array(self.absolute(low, high).points)
        seen = np.stack([np.interp(values, known[:, 0], known[:, c]) for c in range(1, 5)], axis=1)
        linear = linear_light(seen[:, :3])
        opacity = 1 - (1 - seen[:, 3]) ** (step / self.unit)
        return np.ascontiguousarray(np.concatenate([linear, opacity[:, None]], axis=1), np.float32)

    def within(self, window: tuple[float, float], low: float, high: float) -> TransferFunction:
        """Return this transfer function for values from ``window[0]`` to ``window[1]``; others are transparent.

        ``low`` and ``high`` are the range of the volume's values; relative values are fractions of it.
        """
        span = (high - low) or 1.0
        first, last = (((x - low) / span if self.relative else x) for x in (max(window[0], low), min(window[1], high)))
        known = np.array(self.points)

        def at(value: float) -> Point:
            red, green, blue, opacity = (float(np.interp(value, known[:, 0], known[:, c])) for c in (1, 2, 3, 4))
            return value, red, green, blue, opacity

        points = [at(first), *(p for p in self.points if first < p[0] < last), at(last)]
        step = 1e-6 * (1.0 if self.relative else span)  # 3D Slicer ignores a step of zero width
        if window[0] > low:
            points.insert(0, (first - step, *points[0][1:4], 0.0))
        if window[1] < high:
            points.append((last + step, *points[-1][1:4], 0.0))
        return TransferFunction(tuple(points), self.unit, self.relative)

    def absolute(self, low: float, high: float) -> TransferFunction:
        """Return this transfer function in values; relative ones are fractions of the range ``low`` to ``high``."""
        if not self.relative:
            return self
        span = (high - low) or 1.0  # in a constant volume, the fraction 0 is its value
        return TransferFunction(tuple((low + p[0] * span, *p[1:]) for p in self.points), self.unit)

    def to_json(self) -> str:
        """Return the JSON text for `from_json`."""
        made = {
            "transfer_function": 1,
            "unit": self.unit,
            "relative": self.relative,
            "points": [list(point) for point in self.points],
        }
        return json.dumps(made, indent=2) + "\n"

    @classmethod
    def from_json(cls, text: str, name: str = "the transfer function") -> TransferFunction:
        """Read a transfer function.

        Raises
        ------
        SuppleError
            If the text is invalid; the message begins with ``name``.
        """
        try:
            made = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise SuppleError(f"{name} is not JSON ({error}): it should be as docs/rendering.md shows") from None
        known = {"transfer_function", "unit", "relative", "points"}
        if not isinstance(made, dict) or "points" not in made:
            raise SuppleError(f'{name} has no "points": it should be an object with a list of them')
        if made.get("transfer_function", 1) != 1 or isinstance(made.get("transfer_function", 1), bool):
            raise SuppleError(f"{name} is of another version than 1, which this one reads: update Supple")
        if set(made) - known:
            raise SuppleError(f"{name} has an unknown key {sorted(set(made) - known)[0]!r}: it knows {sorted(known)}")
        if not isinstance(made.get("relative", False), bool):
            raise SuppleError(f'{name}: "relative" must be true or false, found {made["relative"]!r}')
        try:
            return cls(made["points"], made.get("unit", 1.0), made.get("relative", False))
        except SuppleError as error:
            raise SuppleError(f"{name}: {error}") from None

    def to_vp(self, low: float, high: float) -> str:
        """Return the text of a volume property of 3D Slicer (``.vp``), for `from_vp`.

        Parameters
        ----------
        low, high : float
            The range of the volume's values; relative ones are fractions of it. Opacities are those of a millimetre.
        """
        places = [p[0] for p in self.absolute(low, high).points]
        opacities = [1 - (1 - p[4]) ** (1 / self.unit) for p in self.points]
        tables = [
            [x for pair in zip(places, opacities, strict=True) for x in pair],
            [low, 1.0, high if high > low else low + 1.0, 1.0],
            [x for place, p in zip(places, self.points, strict=True) for x in (place, *p[1:4])],
        ]
        lines = [f"{x:g}" for x in _SLICER] + [" ".join(f"{x:.9g}" for x in (len(t), *t)) for t in tables]
        return "\n".join(lines) + "\n"

    @classmethod
    def from_vp(cls, text: str, name: str = "the volume property") -> TransferFunction:
        """Read a volume property of 3D Slicer (``.vp``): its opacity and its colours.

        Its lighting and its opacity by gradient are ignored: this renderer has its own lighting, and lacks the other.

        Raises
        ------
        SuppleError
            If the text is invalid; the message begins with ``name``.
        """
        lines = [line.split() for line in text.splitlines() if line.strip()]
        try:
            opacity, colours = (_control_points(lines[k], each) for k, each in ((6, 2), (8, 4)))
        except (IndexError, ValueError):
            raise SuppleError(
                f"{name} is no volume property of 3D Slicer: six numbers, and then points of opacity, of opacity by "
                "gradient, and of colour, each in a line that begins with how many numbers follow"
            ) from None
        # Both are piecewise linear, so points at the union of their values describe both exactly.
        values = np.union1d(opacity[:, 0], colours[:, 0])
        seen = [np.interp(values, colours[:, 0], colours[:, c]) for c in (1, 2, 3)]
        seen.append(np.interp(values, opacity[:, 0], opacity[:, 1]))
        try:
            return cls(tuple(map(tuple, np.stack([values, *seen], axis=1).tolist())))
        except SuppleError as error:
            raise SuppleError(f"{name}: {error}") from None


SUFFIXES = (".json", ".vp")
LABELS = "labels"  # the name of the palette of labels
# The first lines of a .vp: linear, shaded; diffuse, ambient and specular light, and its power, as in raymarch.hpp.
_SLICER = (1, 1, 0.8, 0.15, 0.2, 16)


def _control_points(words: list[str], each: int) -> npt.NDArray[np.float64]:
    """Return control points (N, each), sorted by value; ValueError if their count is wrong, or a number invalid."""
    count, *numbers = words
    found = np.array([float(x) for x in numbers]).reshape(-1, each)
    if int(count) != found.size or not found.size or not np.isfinite(found).all():
        raise ValueError
    return found[np.argsort(found[:, 0], kind="stable")]


# fmt: off
PRESETS = {
    # Hounsfield units: water is 0, and compact bone from 300 on.
    "ct-bone": TransferFunction((
        (150.0, 0.62, 0.42, 0.30, 0.0), (300.0, 0.80, 0.64, 0.48, 0.25), (700.0, 0.93, 0.87, 0.76, 0.7),
        (1500.0, 1.0, 0.98, 0.94, 0.95),
    )),
    "ct-skin": TransferFunction((
        (-450.0, 0.75, 0.52, 0.42, 0.0), (-250.0, 0.83, 0.60, 0.49, 0.5), (0.0, 0.90, 0.70, 0.58, 0.9),
        (150.0, 0.90, 0.70, 0.58, 0.95), (400.0, 1.0, 0.95, 0.88, 0.98),
    )),
    # Muscle from 40 to 70; fat, below 0, is not seen.
    "ct-muscle": TransferFunction((
        (-10.0, 0.42, 0.12, 0.10, 0.0), (30.0, 0.60, 0.20, 0.16, 0.15), (70.0, 0.76, 0.33, 0.26, 0.5),
        (150.0, 0.88, 0.64, 0.50, 0.7), (400.0, 1.0, 0.96, 0.90, 0.9),
    )),
    # Lungs are about -850 where they are full of air, and denser around vessels and airways.
    "ct-lung": TransferFunction((
        (-920.0, 0.30, 0.42, 0.62, 0.0), (-850.0, 0.45, 0.58, 0.78, 0.008), (-700.0, 0.86, 0.66, 0.62, 0.06),
        (-500.0, 0.95, 0.78, 0.70, 0.12), (-300.0, 0.95, 0.78, 0.70, 0.0),
    )),
    # Blood with a contrast medium, from 150 to 450 as a rule; bone is denser, or as dense where it is spongy.
    "ct-vessels": TransferFunction((
        (130.0, 0.55, 0.06, 0.06, 0.0), (200.0, 0.78, 0.12, 0.09, 0.35), (400.0, 0.92, 0.30, 0.18, 0.75),
        (600.0, 0.97, 0.84, 0.70, 0.8), (1300.0, 1.0, 0.98, 0.94, 0.92),
    )),
    # Fractions of the range: magnetic resonance has no units.
    "mr-head": TransferFunction((
        (0.10, 0.55, 0.38, 0.30, 0.0), (0.20, 0.80, 0.60, 0.48, 0.35), (0.45, 0.88, 0.74, 0.62, 0.75),
        (0.70, 0.96, 0.90, 0.82, 0.9), (1.0, 1.0, 1.0, 1.0, 0.95),
    ), relative=True),
    # For volumes in which all but the brain is 0.
    "mr-brain": TransferFunction((
        (0.12, 0.42, 0.26, 0.25, 0.0), (0.30, 0.70, 0.50, 0.46, 0.3), (0.55, 0.88, 0.74, 0.68, 0.75),
        (0.80, 0.97, 0.91, 0.86, 0.9), (1.0, 1.0, 0.98, 0.96, 0.95),
    ), relative=True),
    # Fractions of the range of nearly all values: see `supple.render.appearance.levelled`.
    "grey": TransferFunction((
        (0.06, 0.0, 0.0, 0.0, 0.0), (0.2, 0.3, 0.3, 0.3, 0.05), (1.0, 1.0, 1.0, 1.0, 0.6),
    ), relative=True),
}
# fmt: on

HOUNSFIELD = tuple(name for name in PRESETS if name.startswith("ct-"))
"""The presets of Hounsfield units."""


def transfer_of(name: str | os.PathLike[str]) -> Transfer:
    """Return a preset by its name, or a transfer function (``.json``, ``.vp``) or a colour table from a file.

    SuppleError if it cannot be read, or is invalid.
    """
    if isinstance(name, str) and (name in PRESETS or name == LABELS):
        return PRESETS.get(name) or LabelColours()
    path, suffix = os.fspath(name), Path(name).suffix.lower()
    if suffix not in (*SUFFIXES, *TABLES):
        kinds = f"{', '.join(SUFFIXES)}, or {' or '.join(TABLES)} with colours of labels"
        refuse("a transfer function", f"a file ({kinds}), or one of {', '.join(PRESETS)}, {LABELS}", path)
    try:
        text = Path(name).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        what = (
            f"a colour table ({', '.join(TABLES)})"
            if suffix in TABLES
            else f"a transfer function ({' or '.join(SUFFIXES)})"
        )
        raise SuppleError(f"cannot read {path!r}: {reason}: name {what}") from None
    if suffix in TABLES:
        return LabelColours.from_text(text, path)
    return TransferFunction.from_vp(text, path) if suffix == ".vp" else TransferFunction.from_json(text, path)


Transfer = TransferFunction | LabelColours
"""Colours and opacities, of values or of labels."""
