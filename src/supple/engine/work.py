"""Arguments of sampling, in the core's form: a packed map, the layout of frames, and a job of both, with options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import STROKE_DTYPE
from supple.engine.sampling import Sampling
from supple.errors import SuppleError, argument, none
from supple.space.checks import Shape, Vector, colours_hint, refuse
from supple.space.domain import Domain
from supple.space.freezing import Freeze
from supple.space.geometry import Grid

Array = npt.NDArray[Any]
Tell = Callable[[str, int, int], None]
"""A function that is called with the name of a step, how much of it is done, and how much there is."""


def silent(step: str, done: int, total: int) -> None:
    """Report no progress."""


class Mask(_core.Freeze):
    """A freeze mask as the core takes it, with its coefficients for shaders and CUDA; relative to an origin."""

    def __init__(self, freeze: Freeze, spacing: Vector, origin: Vector) -> None:
        values, first, self.step = freeze.packed(spacing)
        self.first: npt.NDArray[np.float64] = first - origin
        self.coefficients = freeze.coefficients.reshape(values.shape)
        super().__init__(values.astype(np.float32), self.first.tolist(), self.step.tolist())
        self.made_of = freeze, spacing, origin

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments: the core's objects stay in their process."""
        return _mask, self.made_of


@lru_cache(maxsize=16)
def _mask(freeze: Freeze, spacing: Vector, origin: Vector) -> Mask | None:
    return None if freeze.is_free else Mask(freeze, spacing, origin)


def mask_of(domain: Domain, origin: Vector = (0.0, 0.0, 0.0)) -> Mask | None:
    """Return a domain's freeze mask as the core takes it, or None if nothing is frozen.

    Points are relative to the origin, in physical units.
    """
    return None if domain.freeze is None else _mask(domain.freeze, domain.spacing, origin)


class Mattes(_core.Freeze):
    """The masks of strokes, by the numbers in their rows; the first is for strokes without a mask of their own.

    ``freezes`` are the freezes between strokes, in order: the row before which each stands, and the number of its mask.
    Shaders use the first mask only.
    """

    def __init__(self, masks: tuple[Mask | None, ...], freezes: tuple[tuple[int, int], ...] = ()) -> None:
        super().__init__(np.ones((1, 1, 1), np.float32), [0.0] * 3, [1.0] * 3)
        self.masks, self.freezes = masks, freezes
        self.stand_for(list(masks), list(freezes))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments, as those of `Mask`."""
        return _mattes, (self.masks, self.freezes)

    @classmethod
    def adding(cls, before: Mask | Mattes | None, mask: Mask | None, row: int | None = None) -> tuple[Mattes, int]:
        """Return the masks with one more, and its number; with a ``row``, as a freeze that stands before it."""
        masks, freezes = (before.masks, before.freezes) if isinstance(before, Mattes) else ((before,), ())
        if mask not in masks[1:]:
            masks = (*masks, mask)
        number = 1 + masks[1:].index(mask)
        return _mattes(masks, freezes if row is None else (*freezes, (row, number))), number


@lru_cache(maxsize=16)
def _mattes(masks: tuple[Mask | None, ...], freezes: tuple[tuple[int, int], ...]) -> Mattes:
    return Mattes(masks, freezes)


def seen_from(freeze: Mask | Mattes | None, origin: Vector) -> Mask | Mattes | None:
    """Return a mask, or masks, for points relative to an origin, in physical units."""
    if isinstance(freeze, Mattes):
        masks = (None if mask is None else _mask(*mask.made_of[:2], origin) for mask in freeze.masks)
        return _mattes(tuple(masks), freeze.freezes)
    return None if freeze is None else _mask(*freeze.made_of[:2], origin)


def shown_mask(freeze: Mask | Mattes | None) -> Mask | None:
    """Return the mask that shaders take."""
    return freeze.masks[0] if isinstance(freeze, Mattes) else freeze


def refuse_mattes(space: Space, where: str) -> None:
    """Raise SuppleError if strokes have several masks, where only one is supported."""
    if isinstance(space.freeze, Mattes):
        what = "a freeze stands between strokes" if space.freeze.freezes else "strokes have mattes"
        raise SuppleError(f"{what}, which {where} does not take: leave them out, or use the CPU")


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """The map as the core takes it, and the number and shape of frames.

    ``rows`` are the strokes, each one-to-one (`supple._core.rows`), and ``axes`` the packed domain: a row (first, last,
    sigma, spacing, profile) for each axis, x first (`Domain.packed`). ``ndim`` is 2 for a map of an image, or of
    each of ``count`` frames; 3 for a map through a clip or a volume. ``shape`` is (rows, columns). ``composite`` is
    the whole map, if there is more to it than strokes: affine maps, fields, or another ``grid`` of the output.
    ``freeze`` is the mask of the strokes, or the masks.
    """

    rows: npt.NDArray[np.float64]
    axes: npt.NDArray[np.float64]
    ndim: int
    count: int
    shape: tuple[int, int]
    composite: _core.Composite | None = None
    grid: Grid | None = None
    freeze: Mask | Mattes | None = None

    @property
    def map(self) -> _core.Map:
        """The map of points."""
        return _core.Map(self.rows, self.axes, self.ndim, self.freeze, self.composite)

    @property
    def table(self) -> npt.NDArray[np.void]:
        """The strokes, with named columns."""
        return self.rows.view(STROKE_DTYPE)[:, 0]

    @property
    def whole(self) -> Shape:
        """The shape of the arrays: of one image, or of all frames."""
        return self.shape if self.ndim == 2 and self.count == 1 else (self.count, *self.shape)

    @property
    def is_identity(self) -> bool:
        """Return whether the map is the identity: no strokes, or none with any force."""
        return self.rows.size == 0 and self.is_plain

    @property
    def is_plain(self) -> bool:
        """Return whether the map has strokes alone, and the output the grid of the input."""
        return self.composite is None and self.grid is None

    @property
    def out(self) -> Shape:
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


@lru_cache(maxsize=16)
def on_grid(space: Space, grid: Grid) -> Space:
    """Return a map with another grid of the output; of the most recent ones, the same object."""
    return replace(space, grid=grid)


@dataclass(frozen=True, slots=True)
class Group:
    """The components of a frame that share a grid of samples: arrays of shape (rows, samples, channels).

    ``step`` and ``offset`` are the pixels of the frame from one sample to the next, and the position of the first one,
    x first: (2, 2) and the siting for the chroma of 4:2:0. ``alpha`` says whether the last channel is opacity,
    ``exact`` whether samples are those of the nearest pixel and frame, whatever the filter is.
    """

    shape: tuple[int, int]
    channels: int
    step: tuple[int, int] = (1, 1)
    offset: tuple[float, float] = (0.0, 0.0)
    alpha: bool = False
    exact: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """The layout of a frame: its groups, the first of which has a sample for every pixel, and the type of samples.

    ``white`` is the largest sample value, which is also that of full opacity: 255, 1023, …; ``black``, the components
    of black: one value for all, or one for each in the order of the groups.
    """

    groups: tuple[Group, ...]
    dtype: np.dtype[Any]
    white: float
    black: Vector = (0.0,)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame, in pixels."""
        return self.groups[0].shape

    @property
    def step(self) -> tuple[int, int]:
        """The largest spacing of the samples of any group, in pixels, x first."""
        along, down = zip(*(group.step for group in self.groups), strict=True)
        return max(along), max(down)


@dataclass(frozen=True, slots=True)
class Work:
    """One job: a map, the layout of the frames, and how they are sampled.

    ``items`` are the maps of a batch: one for all items, or one for each; or of a clip, one for each frame. ``bent``
    are the indices of the frames that are warped, by default all; others are copied.
    """

    space: Space
    layout: Layout
    sampling: Sampling
    items: tuple[Space, ...] | None = None
    bent: range | None = None

    @property
    def spaces(self) -> tuple[Space, ...]:
        """The maps: one for all frames, or one for each."""
        return self.items or (self.space,)

    @property
    def is_identity(self) -> bool:
        """Return whether all maps are the identity."""
        return all(space.is_identity for space in self.spaces)


def work_of(
    shape: Shape,
    dtype: np.dtype[Any],
    space: Space,
    sampling: Sampling,
    alpha: bool | None = None,
    *,
    finite: bool = True,
    items: tuple[Space, ...] | None = None,
) -> Work:
    """Return the work on an array of a shape and type: an image or frames, perhaps with channels last.

    ``alpha`` says whether the last channel is opacity; it is guessed if None. A fill value other than 0 gets one number
    for each channel, which must be ``finite`` unless that is False. SuppleError if the array, or the fill value, does
    not fit.
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
    if sampling.fill != 0.0:  # the default fits all
        sampling = replace(sampling, fill=sampling.fills(channels, dtype, finite=finite))
    return Work(space, layout, sampling, items)


class Deforming(Protocol):
    """An object with a space: a `supple.Deformation`."""

    @property
    def space(self) -> Space:
        """The packed strokes and domain."""


def spaces_of(deformations: Any) -> tuple[Space, ...]:
    """Return the spaces of one deformation, or of several of one shape; SuppleError for other values."""
    wanted = "a Deformation, or a sequence of them, of one shape"
    several = deformations if isinstance(deformations, Sequence) else (deformations,)
    spaces: tuple[Any, ...] = tuple([getattr(d, "space", None) for d in several])
    if {type(space) for space in spaces} != {Space}:
        refuse("deformations", wanted, deformations)
    if len(set(map(attrgetter("ndim", "count", "shape"), spaces))) > 1:
        refuse("deformations", wanted, told="shapes {} and {}".format(*dict.fromkeys(s.whole for s in spaces)))
    return spaces


def check_count(spaces: tuple[Space, ...], count: int) -> None:
    """Raise SuppleError unless there is one deformation, or one for each item of a batch."""
    if len(spaces) not in (1, count):
        refuse("deformations", f"one, or one for each of the {count} items", len(spaces))
