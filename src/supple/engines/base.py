"""The values exchanged by pipeline and engines, and the protocol that every engine implements."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.errors import FoldWarning, OutsideWarning, SuppleError, ToleranceWarning, argument, none
from supple.folding.strain import Mask
from supple.space.domain import choice, colours_hint, flag, number, refuse
from supple.space.geometry import Grid

Array = npt.NDArray[Any]

# Codes shared with the core and CUDA.
FILTERS = {"auto": 3, "cubic": 2, "linear": 1, "nearest": 0}
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2}
OUTSIDE = {"edge": 0, "constant": 1, "reflect": 2}

LONGEST = _core.constants["LONGEST"]  # frames: the longest time average of a pixel
FINEST = 3e-4
"""The approximate accuracy of a source point in float32, in pixels."""

_GONE = ("antialias", "ewa")


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


@dataclass(frozen=True, slots=True)
class Space:
    """The packed strokes and domain, as engines take them, and the number of frames.

    Parameters
    ----------
    table : ndarray of STROKE_DTYPE
        Strokes that are known to be one-to-one.
    axes : float64 array, shape (3, 5)
        The packed domain: a row (first, last, sigma, spacing, profile) for each axis, x first (`Domain.packed`).
    ndim : int
        2: one map, of an image or of each frame alike; 3: a map through a clip or a volume.
    count : int
        The number of frames or slices.
    shape : (int, int)
        Rows and columns of each frame.
    composite : _core.Composite, optional
        The whole map, if there is more to it than strokes: affine maps, fields, or another grid of the output.
    grid : Grid, optional
        The grid of the output, if it is not that of the input.
    freeze : Mask, optional
        The freeze mask that the strokes are subject to; that of a composite map's is its own, too.
    """

    table: npt.NDArray[np.void]
    axes: npt.NDArray[np.float64]
    ndim: int
    count: int
    shape: tuple[int, int]
    composite: _core.Composite | None = None
    grid: Grid | None = None
    freeze: Mask | None = None

    @property
    def whole(self) -> tuple[int, ...]:
        """The shape of the arrays: of one image, or of all frames."""
        return self.shape if self.ndim == 2 and self.count == 1 else (self.count, *self.shape)

    @property
    def is_identity(self) -> bool:
        """Return whether the map is the identity: no strokes, or none with any force."""
        return self.table.size == 0 and self.is_plain

    @property
    def is_plain(self) -> bool:
        """Return whether the map has strokes alone, and the output the grid of the input."""
        return self.composite is None and self.grid is None

    @property
    def out(self) -> tuple[int, ...]:
        """The shape of the output arrays."""
        if self.grid is None:
            return self.whole
        return self.grid.shape if self.ndim == 3 or self.count == 1 else (self.count, *self.grid.shape)

    @property
    def planes(self) -> tuple[int, int, int]:
        """The number of planes of the output, and the rows and columns of each."""
        if self.grid is None:
            return (self.count, *self.shape)
        width, height, *depth = self.grid.sizes
        return depth[0] if depth else self.count, height, width

    def planned(self, step: tuple[int, int]) -> tuple[int, int]:
        """Return the rows and columns of a plan that covers samples up to ``step`` pixels apart."""
        height, width = self.shape
        if self.axes[0, 2] >= 0:  # beyond a fixed face, the displacement is constant
            return height, width
        return -(-height // step[1]) * step[1], -(-width // step[0]) * step[0]


@dataclass(frozen=True, slots=True)
class Group:
    """The components of a frame that share a grid of samples.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of samples.
    channels : int
        The number of components. Their samples are arrays of shape (rows, samples, channels).
    step : (int, int)
        Pixels of the frame from one sample to the next, x first: (2, 2) for the chroma of 4:2:0.
    offset : (float, float)
        The position of the first sample, in pixels of the frame, x first: the chroma siting.
    alpha : bool
        Whether the last channel is opacity.
    exact : bool
        Whether samples are those of the nearest pixel and frame, whatever the filter is.
    """

    shape: tuple[int, int]
    channels: int
    step: tuple[int, int] = (1, 1)
    offset: tuple[float, float] = (0.0, 0.0)
    alpha: bool = False
    exact: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """The layout of a frame.

    Parameters
    ----------
    groups : tuple of Group
        The first has a sample for every pixel of the frame.
    dtype : numpy.dtype
        The type of all samples.
    white : float
        The largest sample value, which is also that of full opacity: 255, 1023, …
    black : tuple of float
        The components of black: one value for all, or one for each in the order of the groups.
    """

    groups: tuple[Group, ...]
    dtype: np.dtype[Any]
    white: float
    black: tuple[float, ...] = (0.0,)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame, in pixels."""
        return self.groups[0].shape

    @property
    def step(self) -> tuple[int, int]:
        """The largest spacing of the samples of any group, in pixels, x first."""
        return max(g.step[0] for g in self.groups), max(g.step[1] for g in self.groups)

    @classmethod
    def of_array(
        cls, shape: tuple[int, ...], dtype: np.dtype[Any], whole: tuple[int, ...], *, alpha: bool | None, light: bool
    ) -> Layout:
        """Return the layout of the frames in an array.

        Parameters
        ----------
        shape, dtype
            The shape and the type of the array.
        whole : tuple of int
            The shape of the deformation.
        alpha : bool, optional
            Whether the last channel is opacity; guessed if None.
        light : bool
            Whether averages are computed in linear light.

        Raises
        ------
        SuppleError
            If the array does not fit the deformation, or its type is not supported.
        """
        if dtype.kind not in "biuf" or dtype.itemsize > 8:
            refuse("source", "an array of bool, integers or floats of up to 64 bits", told=f"dtype {dtype}")
        axes = len(whole)
        if shape[:axes] != whole or len(shape) not in (axes, axes + 1) or 0 in shape:
            sizes = ", ".join(map(str, whole))
            wanted = f"of shape ({sizes}) or ({sizes}, channels), as the deformation is{colours_hint(whole)}"
            refuse("source", wanted, told=f"shape {shape}")
        channels = shape[axes] if len(shape) > axes else 1
        if alpha is not None and not isinstance(alpha, bool | np.bool_):
            refuse("alpha", f"True or False, or {none()} to have it guessed", alpha)
        straight = bool(alpha) if alpha is not None else channels == 4 and dtype.str[1:] in ("u1", "u2")
        if straight and channels < 2:
            raise SuppleError(f"alpha=True needs a last channel beside the colours, found shape {shape}")
        if light and (dtype.kind == "b" or (dtype.kind in "iu" and dtype.str[1:] not in ("u1", "u2"))):
            raise SuppleError(f"{argument('linear_light')} needs 8 or 16 bit colours or floats, found {dtype}")
        white = float(np.iinfo(dtype).max) if dtype.kind in "iu" else 1.0
        return cls((Group(whole[-2:], channels, alpha=straight),), dtype.newbyteorder("="), white)  # type: ignore[arg-type]


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
        check_filter(filter)
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


def check_filter(filter: object) -> None:
    """Raise SuppleError for an unknown filter."""
    if filter in _GONE:
        raise SuppleError(
            f'{argument("filter", filter)} is gone: "auto", the default, averages just what the map shrinks '
            "(docs/sampling.md)"
        )
    choice("filter", filter, tuple(FILTERS))


def check_gradients(value: object, name: str) -> None:
    """Raise SuppleError for a tensor that requires gradients, which this operation does not compute."""
    if getattr(value, "requires_grad", False) is True:
        raise SuppleError(
            f"{name} is a tensor that wants gradients, found requires_grad=True: supple.torch.warp makes them, and "
            "tensor.detach() does without"
        )


@dataclass(frozen=True, slots=True)
class Work:
    """The job of an engine: a deformation, the layout of the frames, and the sampling options.

    Parameters
    ----------
    space : Space
    layout : Layout
    sampling : Sampling
    items : tuple of Space, optional
        Of a batch along the first axis: one deformation for all items, or one for each. Of a clip whose frames are each
        bent by a map of their own: one for each.
    """

    space: Space
    layout: Layout
    sampling: Sampling
    items: tuple[Space, ...] | None = None

    @property
    def spaces(self) -> tuple[Space, ...]:
        """The maps: that of all frames, or that of each."""
        return self.items or (self.space,)

    @property
    def is_identity(self) -> bool:
        """Return whether all maps are the identity."""
        return all(space.is_identity for space in self.spaces)

    @property
    def samplings(self) -> list[Sampling]:
        """The sampling options of each group."""
        nearest = replace(self.sampling, filter="nearest", between="nearest", time_filter=False)
        return [nearest if group.exact else self.sampling for group in self.layout.groups]

    @property
    def fills(self) -> list[npt.NDArray[np.float64]]:
        """The fill values of each group."""
        channels = [g.channels for g in self.layout.groups]
        values = np.broadcast_to(np.asarray(self.sampling.fill, np.float64), sum(channels))
        return np.split(values, np.cumsum(channels)[:-1])


Steps = Generator[tuple[int, Certificate], None, None]
"""Pairs of the number of finished planes and the certificate of the planes finished since the last pair."""


class EngineError(Exception):
    """A failure of a device in work it generally supports; the CPU takes over."""


class Engine(Protocol):
    """A device that samples frames at the source point of every pixel, and maps points.

    Methods raise `EngineError` if the device fails, and SuppleError, in one sentence, for what they do not take.
    """

    @property
    def name(self) -> str:
        """The name of the device, as shown to users."""

    def taken(self, value: Any, name: str) -> Any:
        """Return an array in the form the engine holds it, with a shape and a dtype; SuppleError if unsupported."""

    def result(self, out: Any, held: Any, shape: tuple[int, ...] | None = None) -> Any:
        """Return the destination: ``out`` if it fits (SuppleError if not), or a new array.

        It is of the type of the held array, and of its shape or the given one.
        """

    def warp(self, work: Work, frames: Sequence[Array], outs: Sequence[Array]) -> Steps:
        """Sample frames that are all in memory.

        Parameters
        ----------
        work : Work
        frames, outs : sequence of arrays
            All frames, and the destination of all planes: an array (count, h, w, channels) for each group.

        Yields
        ------
        int
            The number of finished planes.
        Certificate
            The accuracy of the map of the planes finished since the last step.
        """

    def forward(self, space: Space, points: Any, *, matrices: bool = False) -> Any:
        """Return T of points (..., D) in pixels, x first; or, if ``matrices``, ∂T/∂p (..., D, D), in float64."""

    def inverse(self, space: Space, points: Any) -> tuple[Any, Any, Any, Any]:
        """Return T⁻¹ of points (..., D), and for each point its residual, number of steps and convergence."""

    def inverse_map(self, space: Space, tolerance: float, like: Any = None) -> tuple[Any, Certificate]:
        """Return the source point of every pixel, float32 (*shape, D), stored like ``like``, and the certificate."""
