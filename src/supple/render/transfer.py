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

from supple.domain import items, number, refuse
from supple.errors import SuppleError
from supple.render.colour import linear_light

ENTRIES = 4096

Point = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class TransferFunction:
    """Colour and opacity, piecewise linear in a volume's values.

    Parameters
    ----------
    points : sequence of (value, red, green, blue, opacity)
        In ascending order of values; colours are sRGB from 0 to 1, and the opacity is that of ``unit`` millimetres.
        Values beyond the first and the last have their colours and opacities.
    unit : float
        Millimetres of material for the opacity.
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
        number("unit", self.unit, "a number of millimetres above 0", 1e-6, 1e6)

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
        known = np.array(self.points)
        # For a constant volume, the smallest value.
        places = known[:, 0] if not self.relative else low + known[:, 0] * ((high - low) or 1.0)
        seen = np.stack([np.interp(values, places, known[:, c]) for c in range(1, 5)], axis=1)
        linear = linear_light(seen[:, :3], 1.0)
        opacity = 1 - (1 - seen[:, 3]) ** (step / self.unit)
        return np.ascontiguousarray(np.concatenate([linear, opacity[:, None]], axis=1), np.float32)

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


PRESETS = {
    # Hounsfield units: water is 0, and compact bone from 300 on.
    "ct-bone": TransferFunction(
        (
            (150.0, 0.62, 0.42, 0.30, 0.0),
            (300.0, 0.80, 0.64, 0.48, 0.25),
            (700.0, 0.93, 0.87, 0.76, 0.7),
            (1500.0, 1.0, 0.98, 0.94, 0.95),
        )
    ),
    "ct-skin": TransferFunction(
        (
            (-450.0, 0.75, 0.52, 0.42, 0.0),
            (-250.0, 0.83, 0.60, 0.49, 0.5),
            (0.0, 0.90, 0.70, 0.58, 0.9),
            (150.0, 0.90, 0.70, 0.58, 0.95),
            (400.0, 1.0, 0.95, 0.88, 0.98),
        )
    ),
    # Fractions of the range: magnetic resonance has no units.
    "mr-head": TransferFunction(
        (
            (0.10, 0.55, 0.38, 0.30, 0.0),
            (0.20, 0.80, 0.60, 0.48, 0.35),
            (0.45, 0.88, 0.74, 0.62, 0.75),
            (0.70, 0.96, 0.90, 0.82, 0.9),
            (1.0, 1.0, 1.0, 1.0, 0.95),
        ),
        relative=True,
    ),
    "grey": TransferFunction(
        ((0.02, 0.0, 0.0, 0.0, 0.0), (0.2, 0.3, 0.3, 0.3, 0.05), (1.0, 1.0, 1.0, 1.0, 0.6)), relative=True
    ),
}


def transfer_of(name: str | os.PathLike[str]) -> TransferFunction:
    """Return a preset by its name, or a transfer function from a JSON file."""
    if isinstance(name, str) and name in PRESETS:
        return PRESETS[name]
    path = Path(name)
    if path.suffix.lower() != ".json":
        refuse("a transfer function", f"a JSON file, or one of {', '.join(PRESETS)}", os.fspath(name))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise SuppleError(f"cannot read {os.fspath(name)!r}: {reason}: name a transfer function in JSON") from None
    return TransferFunction.from_json(text, os.fspath(name))
