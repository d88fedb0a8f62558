"""How a map is sampled, and how accurate the result is: the options, the certificate, and what it warns of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.errors import FoldWarning, OutsideWarning, SuppleError, ToleranceWarning, argument, warn
from supple.space.checks import Vector, assign, choice, flag, number, refuse

# Codes shared with the core and CUDA.
FILTERS = {"auto": 3, "cubic": 2, "linear": 1, "nearest": 0, "labels": 3}  # shares of labels are those of "auto"
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2, "flow": 1}  # the weights of "flow" are linear
OUTSIDE = {"edge": 0, "constant": 1, "reflect": 2}

LONGEST = _core.constants["LONGEST"]  # frames: the longest time average of a pixel
FINEST = 3e-4
"""The approximate accuracy of a source point in float32, in pixels."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How images, frames and volumes are sampled.

    Parameters
    ----------
    filter : str
        ``"auto"`` (cubic, averaged over the residual footprint where the map shrinks), ``"cubic"`` (Keys' with a =
            -0.75), ``"linear"``, ``"nearest"`` (unchanged values), or ``"labels"``: the label with the largest share of
            the footprint of ``"auto"``. Its edges are smooth, and no new labels appear; not for files of clips, nor on
            a CUDA device.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in pixels. Points are float32: values below about 3e-4
        exceed their accuracy.
    outside : str
        Boundary mode: the ``"edge"`` of the source, a ``"constant"``, or its mirror image (``"reflect"``: about the
        outer edge of the border's pixels, as in scipy.ndimage).
    fill : float or sequence of float
        The fill value, in the units of the source; one for all channels, or one for each.
    linear_light : bool
        Whether to average in linear light rather than in sRGB values, which darkens fine detail.
    between : str, optional
        The interpolation between frames or slices: ``"linear"``, ``"cubic"`` or ``"nearest"``; linear by default,
            nearest under ``filter="nearest"``, and cubic under ``"labels"``. ``"flow"`` is for frames alone: samples
            follow the motion between two of them (with the extra ``flow``). Images, of one frame, ignore it.
    time_filter : bool
        Whether to average each pixel over the frames that it covers, where the map compresses time: jagged edges
        become motion blur.
    """

    filter: str = "auto"
    tolerance: float = 0.01
    outside: str = "edge"
    fill: float | Sequence[float] = 0.0
    linear_light: bool = False
    between: str | None = None
    time_filter: bool = False

    def __post_init__(self) -> None:
        if self.filter in ("antialias", "ewa"):
            gone = argument("filter", self.filter)
            better = '"auto", the default, averages just what the map shrinks (docs/sampling.md)'
            raise SuppleError(f"{gone} is gone: {better}")
        choice("filter", self.filter, tuple(FILTERS))
        choice("outside", self.outside, tuple(OUTSIDE))
        checked: dict[str, object] = {
            "tolerance": number("tolerance", self.tolerance, "a number of pixels from 1e-9 to 1e9", 1e-9, 1e9),
            "linear_light": flag("linear_light", self.linear_light),
            "time_filter": flag("time_filter", self.time_filter),
        }
        if self.between is not None:
            choice("between", self.between, tuple(BETWEEN))
            if self.filter == "nearest" and self.between != "nearest":
                keeps = f'"nearest" under {argument("filter", "nearest")}, which keeps values as they are'
                refuse("between", keeps, self.between)
        try:
            fill = np.asarray(self.fill, np.float64)
        except (TypeError, ValueError):
            fill = np.empty((0, 0))
        if fill.ndim > 1:
            refuse("fill", "a number, or one for each channel", self.fill)
        checked["fill"] = tuple(fill.tolist()) if fill.ndim else float(fill)
        if self.filter == "labels" and self.linear_light:
            raise SuppleError(f"labels are no colours: leave {argument('linear_light')} out")
        assign(self, **checked)

    @property
    def between_frames(self) -> str:
        """The interpolation between frames that is in effect."""
        return self.between or {"nearest": "nearest", "labels": "cubic"}.get(self.filter, "linear")

    @property
    def codes(self) -> _core.Codes:
        """The filter, that between frames, the boundary mode, and whether to average over time, for the core."""
        return (FILTERS[self.filter], BETWEEN[self.between_frames], OUTSIDE[self.outside], self.averages_frames)

    @property
    def averages_frames(self) -> bool:
        """True if pixels are averaged over time."""
        return (self.time_filter or self.filter == "labels") and self.between_frames != "nearest"

    @property
    def keeps_values(self) -> bool:
        """Return whether no values are mixed."""
        return self.filter in ("nearest", "labels")

    @classmethod
    def of(cls, sampling: object, options: SamplingFields, ndim: int, *, flow: bool = False) -> Sampling:
        """Return the sampling of an array of ``ndim`` axes, with ``options`` in place of fields of the given one.

        ``flow`` says whether ``between="flow"`` is possible here.
        """
        if not isinstance(sampling, Sampling):
            refuse("sampling", "a Sampling", sampling)
        if ndim == 2:
            for name in ("between", "time_filter"):
                given = options.get(name, getattr(sampling, name))
                if given is not None and given is not False:
                    refuse(name, "left out for an image, which is one frame", given)
        made = replace(sampling, **options) if options else sampling
        if made.between == "flow" and not flow:
            wanted = '"linear", "cubic" or "nearest" here ("flow" is for clips that strokes alone warp, on the CPU)'
            refuse("between", wanted, made.between)
        return made

    def along_all_axes(self) -> Sampling:
        """Return the sampling of a volume, whose slices are sampled as its rows and columns are."""
        between = "cubic" if self.filter in ("auto", "cubic", "labels") else None
        return replace(self, between=between, time_filter=self.filter == "auto")

    def fills(self, channels: int, dtype: np.dtype[Any], *, finite: bool = True) -> Vector:
        """Return the fill value of each channel, in the range of the sample type.

        Fill values in averages must be finite; `supple.arrays.warp_array` stores others afterwards.
        """
        values = np.asarray(self.fill)
        if values.shape not in ((), (1,), (channels,)):
            refuse("fill", f"a number, or {channels} of them, one for each channel", self.fill)
        if (finite or dtype.kind != "f") and not np.isfinite(values).all():
            place = "this kind of work" if dtype.kind == "f" else f"samples of {dtype}"
            refuse("fill", f"finite for {place}", self.fill)
        if dtype.kind in "iu":
            values = np.clip(values, np.iinfo(dtype).min, np.iinfo(dtype).max)
        return tuple(np.broadcast_to(values, (channels,)).tolist())


DEFAULT = Sampling()


class SamplingFields(TypedDict, total=False):
    """The fields of `Sampling`, for type checkers and editors: functions take them by name too."""

    filter: str
    tolerance: float
    outside: str
    fill: float | Sequence[float]
    linear_light: bool
    between: str | None
    time_filter: bool


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
        The numbers of solved points at which a field folds, and of those whose solution is beyond a field's grid.
    """

    error: float = 0.0
    evaluations: float = 0.0
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
    certificate: Certificate,
    tolerance: float,
    folds: str = "",
    field_name: str = "a field",
    unit: str = "px",
) -> None:
    """Warn if a map may be less accurate than the tolerance, or has folds or gaps.

    ``folds`` names the inverted fields that fold, if any, so that all folds are in one warning. ``field_name`` is the
    name of the field, if there is only one.
    """
    if folds or certificate.unknown or certificate.folded:
        inverted = folds or certificate.unknown  # otherwise, the field is perhaps used as it is
        told = [folds or f"{field_name} folds"]
        if inverted:
            told[0] += ": where folds are mapped to, the inverse is one of several points"
        if certificate.folded:
            lie = "lies" if certificate.folded == 1 else "lie"
            told.append(f"{certificate.folded} of the points found {lie} in a part that is turned over")
        if certificate.unknown:
            told.append(f"for {certificate.unknown} of them there is a guess, as no solution was found")
        where = "the statuses of supple invert show" if inverted else "supple check shows"
        warn(f"{'; '.join(told)} ({where} where)", FoldWarning)
    if certificate.outside:
        warn(
            f"to {certificate.outside} of the points solved, no point of a field's grid is mapped: what is shown there "
            "continues the field beyond its edge",
            OutsideWarning,
        )
    if not certificate.unknown and not certificate.error <= 1.01 * tolerance + FINEST:
        warn(
            f"the map may be off by {certificate.error:.2g} {unit} somewhere, more than the tolerance {tolerance:g}: "
            f"use a larger radius or a shorter drag{', or a larger tolerance' if certificate.error < 1 else ''}",
            ToleranceWarning,
        )
