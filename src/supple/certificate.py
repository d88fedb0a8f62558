"""What is known of a map after it was used: its error, and what it took."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Certificate:
    """The accuracy of a map that was used, and the work that it took.

    Two of them are combined by ``|``: the larger error, and the sums of the rest.

    Parameters
    ----------
    error : float
        The largest distance of a source point from the true one, in pixels.
    evaluations : float
        How many times a stroke was evaluated.
    unknown : int
        How many points are not known to be accurate.
    """

    error: float
    evaluations: float
    unknown: int = 0

    def __or__(self, other: Certificate) -> Certificate:
        return Certificate(
            max(self.error, other.error),
            self.evaluations + other.evaluations,
            self.unknown + other.unknown,
        )
