"""How a map is sampled, and how accurate the result is: the options, the certificate, and what it warns of."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.errors import FoldWarning, OutsideWarning, SuppleError, ToleranceWarning, argument
from supple.space.domain import choice, flag, number, refuse

# Codes shared with the core and CUDA.
FILTERS = {"auto": 3, "cubic": 2, "linear": 1, "nearest": 0}
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2}
OUTSIDE = {"edge": 0, "constant": 1, "reflect": 2}

LONGEST = _core.constants["LONGEST"]  # frames: the longest time average of a pixel
FINEST = 3e-4
"""The approximate accuracy of a source point in float32, in pixels."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """Sampling options; see `supple.Deformation.warp`. `checked` builds them from user input."""

    filter: str = "auto"
    between: str = "linear"
    time_filter: bool = False
    outside: str = "edge"
    fill: float | Sequence[float] = (0.0,)
    light: bool = False
    tolerance: float = 0.01

    @classmethod
    def checked(
        cls,
        ndim: int = 3,
        *,
        filter: str = "auto",
        tolerance: float = 0.01,
        outside: str = "edge",
        fill: float | Sequence[float] = 0.0,
        linear_light: bool = False,
        between: str | None = None,
        time_filter: bool = False,
        unit: str = "pixels",
    ) -> Sampling:
        """Return checked sampling options, with the arguments of `supple.Deformation.warp`.

        ``ndim`` is 2 for an image, which has no frames to interpolate between; ``unit`` is the unit of the tolerance.

        Raises
        ------
        SuppleError
            If an option is unknown, or does not go with the filter.
        """
        if filter in ("antialias", "ewa"):
            raise SuppleError(
                f'{argument("filter", filter)} is gone: "auto", the default, averages just what the map shrinks '
                "(docs/sampling.md)"
            )
        choice("filter", filter, tuple(FILTERS))
        choice("outside", outside, tuple(OUTSIDE))
        tolerance = number("tolerance", tolerance, f"a number of {unit} above 0", 1e-9, 1e9)
        if between is not None and ndim == 2:
            refuse("between", "left out for an image, which is one frame", between)
        if time_filter and ndim == 2:
            refuse("time_filter", "left out for an image, which is one frame", time_filter)
        light, averaged = flag("linear_light", linear_light), flag("time_filter", time_filter)
        if between is None:
            between = "nearest" if filter == "nearest" else "linear"
        choice("between", between, tuple(BETWEEN))
        if filter == "nearest" and between != "nearest":
            refuse(
                "between", f'"nearest" under {argument("filter", "nearest")}, which keeps values as they are', between
            )
        return cls(filter, between, averaged, outside, fill, light, tolerance)

    def filled(self, channels: int, dtype: np.dtype[Any], *, finite: bool = True) -> Sampling:
        """Return a copy with one fill value for each channel, rounded to the sample type.

        Averages take finite ones only; `supple.arrays.warp_array` fills with others afterwards.

        Raises
        ------
        SuppleError
            If a fill value is not a number, or their count differs from that of the channels.
        """
        try:
            values = np.asarray(self.fill, np.float64)
        except (TypeError, ValueError):
            refuse("fill", "a number, or one for each channel", self.fill)
        if values.shape not in ((), (1,), (channels,)):
            refuse("fill", f"a number, or {channels} of them, one for each channel", self.fill)
        if (finite or dtype.kind != "f") and not np.isfinite(values).all():
            place = "this kind of work" if dtype.kind == "f" else f"samples of {dtype}"
            refuse("fill", f"finite for {place}", self.fill)
        if dtype.kind in "iu":
            values = np.clip(values, np.iinfo(dtype).min, np.iinfo(dtype).max)
        return replace(self, fill=tuple(np.broadcast_to(values, (channels,)).tolist()))


@dataclass(frozen=True, slots=True)
class Certificate:
    """The accuracy of an inverse map, and the cost of computing it.

    Parameters
    ----------
    error : float
        A bound on the distance of source points from T⁻¹(q), in pixels.
    evaluations : float
        The number of evaluations of T.
    unknown : int
        The number of points at which a field could not be solved to the tolerance: the error is infinite, as it is
        where strokes could not be.
    folded, outside : int
        Of the solved points, the number of those where a field folds, and of those that are mapped to from beyond a
        field's grid.
    """

    error: float
    evaluations: float
    unknown: int = 0
    folded: int = 0
    outside: int = 0

    def __or__(self, other: Certificate) -> Certificate:
        """Return the certificate of both maps together."""
        return Certificate(
            max(self.error, other.error),
            self.evaluations + other.evaluations,
            self.unknown + other.unknown,
            self.folded + other.folded,
            self.outside + other.outside,
        )


def certificate_of_status(status: npt.NDArray[np.uint8]) -> Certificate:
    """Return the certificate of points from the core's bits: 1 folded, 2 outside, 4 unsolved."""
    bits = np.bincount(status, minlength=8)
    return Certificate(0.0, 0.0, int(bits[4:].sum()), int(bits[1] + bits[3]), int(bits[2] + bits[3]))


def warn_of(
    certificate: Certificate, tolerance: float, stacklevel: int, folds: str = "", field: str = "a field"
) -> None:
    """Warn if a map may be less accurate than the tolerance, or has folds or gaps.

    ``folds`` says which of the fields that are inverted fold, if any: all that is known of folds is one warning.
    ``field`` is the name of the only field, if there is only one.
    """
    told = [f"{folds}: where they are mapped to, the inverse is one of several points"] if folds else []
    if certificate.unknown or certificate.folded:
        found, whose = [], "a" if folds else "its"
        if certificate.folded:
            found.append(
                f"{certificate.folded} of the points solved lie where {whose} Jacobian determinant is not above 0"
            )
        if certificate.unknown:
            found.append(f"for {certificate.unknown} {'' if found else 'points '}no solution was found")
        told.append(f"{'' if folds else f'{field} folds: '}{', and '.join(found)}")
        told.append(f"what is shown there is one of several points{', or a guess' if certificate.unknown else ''}")
    if told:
        warnings.warn(f"{'; '.join(told)} (supple check shows where)", FoldWarning, stacklevel=stacklevel)
    if certificate.outside:
        warnings.warn(
            f"to {certificate.outside} of the points solved, no point of a field's grid is mapped: what is shown there "
            "continues the field beyond its edge",
            OutsideWarning,
            stacklevel=stacklevel,
        )
    if not certificate.unknown and not certificate.error <= 1.01 * tolerance + FINEST:
        warnings.warn(
            f"the map may be off by {certificate.error:.2g} px somewhere, more than the tolerance {tolerance:g}: "
            "use a larger radius, a shorter drag or a larger tolerance",
            ToleranceWarning,
            stacklevel=stacklevel,
        )
