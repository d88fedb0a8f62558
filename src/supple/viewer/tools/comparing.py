"""Ways to compare a bent volume with a fixed one, in the planes of both."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.uint8]

MODES = {
    "beside": "The planes of both, one below the other; the crosshair and the pointer are in both",
    "blend": "The mean of both: at 0, the bent volume alone, at 100 % the fixed one",
    "colours": "The bent volume is magenta, and the fixed one green: grey where both are as bright",
    "checkerboard": "Squares of both in turn",
    "difference": "Grey where both are as bright; brighter where the bent volume is, darker where the fixed one is",
}
"""The ways to compare, and what they show."""
SHARES = {
    "blend": (0.5, "Share", "How much of the fixed volume is seen", 0.0, 1.0, "%.0f %%"),
    "checkerboard": (20.0, "Squares", "The side of a square", 2.0, 100.0, "%.0f mm"),
    "difference": (1.0, "Contrast", "What a difference is multiplied by", 0.5, 8.0, "\u00d7 %.1f"),
}
"""The setting of a way to compare, if it has one: its first, least and largest value, name, hint and format."""


@dataclass(slots=True)
class Comparison:
    """How two volumes are compared."""

    window: tuple[float, float]  # the values of the fixed one that are black and white at first
    mode: str = "beside"  # one of `MODES`
    shares: dict[str, float] = field(default_factory=lambda: {name: first for name, (first, *_) in SHARES.items()})

    @property
    def beside(self) -> bool:
        """True if both have planes of their own."""
        return self.mode == "beside"

    @property
    def look(self) -> tuple[object, ...]:
        """Everything that a picture of both depends on, except their samples and windows."""
        return self.mode, self.shares.get(self.mode)

    def compared(self, bent: Pixels, fixed: Pixels, spacing: tuple[float, float]) -> Pixels:
        """Return one picture of both planes, (rows, columns, 4); ``spacing`` is a pixel's height and width, in mm."""
        if self.mode == "beside":
            return bent
        share, made = self.shares.get(self.mode, 0.0), bent.copy()
        one, other = (each[..., :3].astype(np.float32) for each in (bent, fixed))
        if self.mode == "blend":
            made[..., :3] = np.rint(one + (other - one) * share)
        elif self.mode == "colours":
            made[..., 1] = fixed[..., 1]
        elif self.mode == "checkerboard":
            row, column = ((np.arange(n) * step // share) % 2 for n, step in zip(bent.shape, spacing, strict=False))
            made = np.where((row[:, None] != column)[..., None], fixed, bent)
        else:
            made[..., :3] = np.rint(np.clip(127.5 + 0.5 * share * (one - other), 0, 255))
        return made
