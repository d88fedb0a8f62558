"""The accuracy of an inverse map."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Certificate:
    """The accuracy of a map of source points, and what it cost to compute.

    Parameters
    ----------
    error : float
        A bound on the distance of source points from T⁻¹(q), in pixels.
    evaluations : float
        How often T was evaluated.
    unknown : int
        How many points could not be solved to the tolerance.
    """

    error: float
    evaluations: float
    unknown: int = 0

    def __or__(self, other: Certificate) -> Certificate:
        """Return the certificate of two maps together."""
        return Certificate(
            max(self.error, other.error), self.evaluations + other.evaluations, self.unknown + other.unknown
        )
