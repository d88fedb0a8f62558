"""The values that pass between pipeline and engines, and the one protocol that every engine implements."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from supple.domain import choice, colours_hint, flag, number, refuse
from supple.errors import SuppleError, ToleranceWarning

Array = npt.NDArray[Any]

# The numbers by which the core, WGSL and CUDA know them.
FILTERS = {"auto": 3, "cubic": 2, "linear": 1, "nearest": 0}
BETWEEN = {"nearest": 0, "linear": 1, "cubic": 2}
OUTSIDE = {"edge": 0, "constant": 1, "reflect": 2}

SUPPORT = {"nearest": 1, "linear": 1, "cubic": 2}
LONGEST = 64.0  # frames that a pixel is averaged over, at most
SLACK = 1e-3  # frames
FINEST = 3e-4
"""About how exact a source point is that is stored in float32, in pixels."""

_GONE = ("antialias", "ewa")


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


def warn_of(certificate: Certificate, tolerance: float, stacklevel: int) -> None:
    """Warn if a map may be less exact than was asked."""
    if not certificate.error <= 1.01 * tolerance + FINEST:
        warnings.warn(
            f"the map may be off by {certificate.error:.2g} px somewhere, more than the tolerance {tolerance:g}: "
            "use a larger radius, a shorter drag or a larger tolerance",
            ToleranceWarning,
            stacklevel=stacklevel,
        )


@dataclass(frozen=True, slots=True)
class Space:
    """The strokes on their domain, packed as engines take them, and the number of frames.

    Parameters
    ----------
    table : ndarray of STROKE_DTYPE
        Strokes that are known to be one-to-one.
    axes : float64 array, shape (3, 5)
        The packed domain.
    ndim : int
        2 for an image, 3 for a clip or a volume.
    count : int
        How many frames or slices; of a clip that is bent frame by frame, ``ndim`` is 2.
    shape : (int, int)
        Rows and columns of each.
    """

    table: npt.NDArray[np.void]
    axes: npt.NDArray[np.float64]
    ndim: int
    count: int
    shape: tuple[int, int]

    @property
    def whole(self) -> tuple[int, ...]:
        """The shape of the arrays: of an image, or of all frames."""
        return self.shape if self.ndim == 2 and self.count == 1 else (self.count, *self.shape)

    @property
    def is_identity(self) -> bool:
        """Return whether there is nothing to do: no strokes, or none with any force."""
        return self.table.size == 0

    def planned(self, step: tuple[int, int]) -> tuple[int, int]:
        """Return rows and columns of a plan, which reaches as far as samples ``step`` pixels apart may lie."""
        height, width = self.shape
        if self.axes[0, 2] >= 0:  # beyond a fixed face, the map goes on as at the face
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
        How many components. Their samples are arrays of shape (rows, samples, channels).
    step : (int, int)
        Pixels of the frame from one sample to the next, x first: (2, 2) for the chroma of 4:2:0.
    offset : (float, float)
        Where the first sample lies, in pixels of the frame, x first: the siting.
    alpha : bool
        Whether the last channel is opacity.
    """

    shape: tuple[int, int]
    channels: int
    step: tuple[int, int] = (1, 1)
    offset: tuple[float, float] = (0.0, 0.0)
    alpha: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """The layout of a frame.

    Parameters
    ----------
    groups : tuple of Group
        The first has a sample for every pixel of the frame.
    dtype : numpy.dtype
        Of all samples.
    white : float
        The largest value that a sample may have, and that of opaque: 255, 1023, …
    black : tuple of float
        The components of black, one value for all or one for each, in the groups' order.
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
        """How many pixels apart the samples lie that lie farthest apart, x first."""
        return max(g.step[0] for g in self.groups), max(g.step[1] for g in self.groups)

    @classmethod
    def of_array(
        cls, shape: tuple[int, ...], dtype: np.dtype[Any], whole: tuple[int, ...], *, alpha: bool | None, light: bool
    ) -> Layout:
        """Return the layout of the frames in an array.

        Parameters
        ----------
        shape, dtype
            Of the array.
        whole : tuple of int
            The deformation's shape.
        alpha : bool, optional
            Whether the last channel is opacity; None to have it guessed.
        light : bool
            Whether light is averaged.

        Raises
        ------
        SuppleError
            If the array does not fit the deformation, or its type is none that is sampled.
        """
        if dtype.kind not in "biuf" or dtype.itemsize > 8:
            refuse("source", "an array of bool, integers or floats of up to 64 bits", f"dtype {dtype}")
        axes = len(whole)
        if shape[:axes] != whole or len(shape) not in (axes, axes + 1) or 0 in shape:
            sizes = ", ".join(map(str, whole))
            wanted = f"of shape ({sizes}) or ({sizes}, channels), as the deformation is{colours_hint(whole)}"
            refuse("source", wanted, f"shape {shape}")
        channels = shape[axes] if len(shape) > axes else 1
        if alpha is not None and not isinstance(alpha, bool | np.bool_):
            refuse("alpha", "True or False, or None to have it guessed", alpha)
        straight = bool(alpha) if alpha is not None else channels == 4 and dtype.str[1:] in ("u1", "u2")
        if straight and channels < 2:
            raise SuppleError(f"alpha=True needs a last channel beside the colours, found shape {shape}")
        if light and (dtype.kind == "b" or (dtype.kind in "iu" and dtype.str[1:] not in ("u1", "u2"))):
            raise SuppleError(f"linear_light needs 8 or 16 bit colours or floats, found {dtype}")
        white = float(np.iinfo(dtype).max) if dtype.kind in "iu" else 1.0
        return cls((Group(whole[-2:], channels, alpha=straight),), dtype.newbyteorder("="), white)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Sampling:
    """How frames are sampled; see `supple.Deformation.warp`. `checked` makes it of what a user gives."""

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
        """Return how samples are made, as `supple.Deformation.warp` is asked.

        ``ndim`` is 2 for an image, which has no frames to interpolate between; ``unit`` is that of the tolerance.

        Raises
        ------
        SuppleError
            If something is not known, or does not go with the filter.
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
            refuse("between", '"nearest" under filter="nearest", which keeps values as they are', between)
        return cls(filter, between, averaged, outside, fill, light, tolerance)

    def filled(self, channels: int, dtype: np.dtype[Any]) -> Sampling:
        """Return it with one fill value for each channel, as near as a type has it.

        Raises
        ------
        SuppleError
            If the fill value is no number, or there are more or fewer than channels.
        """
        try:
            values = np.asarray(self.fill, np.float64)
        except (TypeError, ValueError):
            refuse("fill", "a number, or one for each channel", self.fill)
        if values.shape not in ((), (1,), (channels,)) or not np.isfinite(values).all():
            refuse("fill", f"a number, or {channels} of them, one for each channel", self.fill)
        if dtype.kind in "iu":
            values = np.clip(values, np.iinfo(dtype).min, np.iinfo(dtype).max)
        return replace(self, fill=tuple(np.broadcast_to(values, (channels,)).tolist()))


def check_filter(filter: object) -> None:
    """Refuse an unknown filter; SuppleError says which there are."""
    if filter in _GONE:
        raise SuppleError(
            f'filter="{filter}" is gone: "auto", the default, averages just what the map shrinks (docs/sampling.md)'
        )
    choice("filter", filter, tuple(FILTERS))


def check_gradients(value: object, name: str) -> None:
    """Refuse a tensor that requires gradients, which would get none here."""
    if getattr(value, "requires_grad", False) is True:
        raise SuppleError(
            f"{name} is a tensor that wants gradients, found requires_grad=True: supple.torch.warp makes them, and "
            "tensor.detach() does without"
        )


@dataclass(frozen=True, slots=True)
class Work:
    """A deformation, the layout of the frames, and how they are sampled: all that an engine is told.

    Parameters
    ----------
    space : Space
    layout : Layout
    sampling : Sampling
    items : tuple of Space, optional
        Of a batch, whose first axis counts items: the deformation of all of them, or one for each.
    """

    space: Space
    layout: Layout
    sampling: Sampling
    items: tuple[Space, ...] | None = None

    @property
    def fills(self) -> list[npt.NDArray[np.float64]]:
        """The fill values of each group."""
        channels = [g.channels for g in self.layout.groups]
        values = np.broadcast_to(np.asarray(self.sampling.fill, np.float64), sum(channels))
        return np.split(values, np.cumsum(channels)[:-1])


Steps = Generator[tuple[int, Certificate], None, None]
"""How many planes are done, and the accuracy of the map of those that were done since the last step."""


class EngineError(Exception):
    """A device failed at what it does in general: the CPU is to do it.

    ``lost`` says that the device cannot go on with other planes either.
    """

    def __init__(self, reason: str, *, lost: bool = True) -> None:
        super().__init__(reason)
        self.lost = lost


class Planes(Protocol):
    """Planes that are made from the frames in a window, which holds frame k in the slot k modulo its capacity."""

    def begin(self, z: int, first: int, last: int) -> object:
        """Begin a plane that samples the frames ``first`` to ``last``, which are in the window."""

    def finish(self, begun: Any, z: int, first: int, last: int, outs: Sequence[Array]) -> Certificate:
        """Put what was begun, whose frames are still in the window, into an array for each group."""


class Engine(Protocol):
    """A device that samples frames at the source points of every pixel, and moves points.

    Its functions raise `EngineError` where the device fails, and SuppleError, in one sentence, for what it never does.
    """

    @property
    def name(self) -> str:
        """The device, as it is shown to users."""

    @property
    def lead(self) -> int:
        """How many planes of a stream are begun before the first is finished; if any, a thread reads the frames."""

    def slack(self, tolerance: float) -> float:
        """Return by how many frames its source points may lie outside the bounds that a plan knows."""

    def taken(self, value: Any, name: str) -> Any:
        """Return an array as it holds it, with a shape and a dtype; SuppleError if it cannot."""

    def result(self, out: Any, held: Any) -> Any:
        """Return where the result goes: ``out``, if it fits what is `taken` (SuppleError if not), or a new array."""

    def check(self, work: Work) -> None:
        """Raise SuppleError for work that it does not do."""

    def working_dtype(self, dtype: np.dtype[Any]) -> np.dtype[Any]:
        """Return the type that it works on samples of a type in."""

    def view(self, array: Array) -> Array | None:
        """Return an array as the engine takes it, sharing memory; None if the array must be copied first."""

    def warp(self, work: Work, frames: Sequence[Array], outs: Sequence[Array]) -> Steps:
        """Sample frames that are all at hand.

        Parameters
        ----------
        work : Work
        frames, outs : sequence of arrays
            All frames, and where all planes go: an array (count, h, w, channels) for each group, as `view` returns it.

        Yields
        ------
        int
            How many planes are done.
        Certificate
            The accuracy of the map of those that were done since the last time.
        """

    def stream(self, work: Work, window: Sequence[Array]) -> AbstractContextManager[Planes]:
        """Return what makes planes from a window: for each group, an array (capacity, h, w, channels)."""

    def forward(self, space: Space, points: Any, *, matrices: bool = False) -> Any:
        """Return T of points (..., D) in pixels, x first; or, if ``matrices``, ∂T/∂p (..., D, D), in float64."""

    def inverse(self, space: Space, points: Any) -> tuple[Any, Any, Any, Any]:
        """Return T⁻¹ of points (..., D), and for each its residual, its steps, and whether it converged."""

    def inverse_map(self, space: Space, tolerance: float, like: Any = None) -> tuple[Any, Certificate]:
        """Return the source point of every pixel, float32 (*shape, D), as ``like`` is stored, and their accuracy."""


def frames_needed(first: int, last: int, count: int, outside: str) -> tuple[int, int]:
    """Return the frames of the clip that stand for a range of times."""
    if outside == "reflect" and (first < 0 or last >= count):
        seen = slots_of(max(first, last - 2 * count), last, count, outside, count)
        return int(seen.min()), int(seen.max())
    return min(max(first, 0), count - 1), min(max(last, 0), count - 1)


def times_seen(outside: str, count: int, average: bool) -> tuple[float, float]:
    """Return the times beyond which nothing changes any more, as an edge or a constant goes on."""
    beyond = 3.0 + (LONGEST / 2 if average else 0.0)
    if outside == "reflect":
        return -1e9, 1e9
    return -beyond, count - 1.0 + beyond


def slots_of(first: int, last: int, count: int, outside: str, capacity: int) -> npt.NDArray[np.int64]:
    """Return where the frames ``first`` to ``last`` are in a window whose slot k modulo its capacity holds frame k.

    Frames outside the clip are those that stand for them; -1 for a constant.
    """
    k = np.arange(first, last + 1)
    if outside == "reflect":
        k = k % (2 * count)
        k = np.where(k < count, k, 2 * count - 1 - k)
    elif outside == "constant":
        return np.where((k >= 0) & (k < count), k % capacity, -1)
    return np.clip(k, 0, count - 1) % capacity
