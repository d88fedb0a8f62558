"""The values that are sampled: a packed map, the layout of frames, and both with the options as the core takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.sampling import Sampling
from supple.errors import SuppleError, argument, none
from supple.folding.strain import Mask
from supple.space.domain import colours_hint, refuse
from supple.space.geometry import Grid

Array = npt.NDArray[Any]
Tell = Callable[[str, int, int], None]
"""A function that is called with the name of a step, how much of it is done, and how much there is."""


def silent(step: str, done: int, total: int) -> None:
    """Report no progress."""


@dataclass(frozen=True, slots=True)
class Space:
    """The packed strokes and domain, as the core takes them, and the number of frames.

    Parameters
    ----------
    table : ndarray of STROKE_DTYPE
        Strokes, each one-to-one.
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


@dataclass(frozen=True, slots=True)
class Work:
    """What is sampled: a deformation, the layout of the frames, and the sampling options.

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


def work_of(
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    space: Space,
    sampling: Sampling,
    alpha: bool | None = None,
    *,
    finite: bool = True,
) -> Work:
    """Return the work on an array: an image or frames, perhaps with channels last.

    Parameters
    ----------
    shape, dtype
        The shape and the type of the array.
    space : Space
    sampling : Sampling
        Its fill value gets one number for each channel (`Sampling.filled`).
    alpha : bool, optional
        Whether the last channel is opacity; guessed if None.
    finite : bool
        Whether the fill value must be finite.

    Raises
    ------
    SuppleError
        If the array or the fill value does not fit the deformation, or the array's type is not supported.
    """
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        refuse("source", "an array of bool, integers or floats of up to 64 bits", told=f"dtype {dtype}")
    whole = space.whole
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
    if sampling.linear_light and (dtype.kind == "b" or (dtype.kind in "iu" and dtype.str[1:] not in ("u1", "u2"))):
        raise SuppleError(f"{argument('linear_light')} needs 8 or 16 bit colours or floats, found {dtype}")
    white = float(np.iinfo(dtype).max) if dtype.kind in "iu" else 1.0
    layout = Layout((Group(space.shape, channels, alpha=straight),), dtype.newbyteorder("="), white)
    return Work(space, layout, sampling.filled(channels, dtype, finite=finite))


class Deforming(Protocol):
    """An object with a space: a `supple.Deformation`."""

    @property
    def space(self) -> Space:
        """The packed strokes and domain."""


def spaces_of(deformations: Any) -> tuple[Space, ...]:
    """Return the spaces of one deformation, or of several of one shape; SuppleError for other values."""
    wanted = "a Deformation, or a sequence of them, of one shape"
    several = tuple(deformations) if isinstance(deformations, Sequence) else (deformations,)
    spaces = tuple(space for d in several if isinstance(space := getattr(d, "space", None), Space))
    if not spaces or len(spaces) < len(several):
        refuse("deformations", wanted, deformations)
    shapes = [s.whole for s in spaces]
    if len(set(shapes)) > 1:
        other = next(shape for shape in shapes if shape != shapes[0])
        refuse("deformations", wanted, told=f"shapes {shapes[0]} and {other}")
    return spaces


def check_count(spaces: tuple[Space, ...], count: int) -> None:
    """Raise SuppleError unless there is one deformation, or one for each item of a batch."""
    if len(spaces) not in (1, count):
        refuse("deformations", f"one, or one for each of the {count} items", len(spaces))
