"""The domain of a deformation: its shape, spacing and border."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, SupportsIndex, get_args

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, none
from supple.space.checks import (
    LARGEST,
    LENGTH,
    SMALLEST,
    Vector,
    assign,
    checked_shape,
    checked_spacing,
    choice,
    flag,
    items,
    length,
    number,
    refuse,
)
from supple.space.freezing import Freeze

AUTO = 0.1  # the border's width for border="auto", as a fraction of each axis' extent

Border = Literal["auto"] | float | Vector | None
BorderProfile = Literal["quartic", "sine"]
PROFILE_CODES: dict[str, float] = {"quartic": 0.0, "sine": 1.0}
"""The codes of the border profiles in the packed domain."""
FREE = (0.0, 0.0, -1.0, 1.0, 0.0)
"""An axis without a border, in the layout of `Domain.packed`."""


def checked_border(border: object) -> Border:
    """Return ``border`` as "auto", a width, one for each axis, or None if free; SuppleError for other values."""
    if border is None:
        return None
    if isinstance(border, str) and border == "auto":
        return "auto"
    if isinstance(border, Sequence | np.ndarray) and not isinstance(border, str | bytes):
        widths = items("border", border, "one width, or one for each axis, x first", (2, 3))
        return tuple(length(f"border[{i}]", width) for i, width in enumerate(widths))
    wanted = f'"auto", {LENGTH}, one for each axis, or {none()} for a free border'
    return number("border", border, wanted, SMALLEST, LARGEST)


def check_border_profile(profile: object) -> None:
    """Raise SuppleError unless ``profile`` names a profile of the fixed border."""
    choice("border_profile", profile, get_args(BorderProfile))


def border_factor(t: npt.ArrayLike, profile: float) -> npt.NDArray[np.float64]:
    """Return β at a distance from a face, given as the fraction ``t`` of the border's width; see `PROFILE_CODES`."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(np.sin(np.pi / 2 * t) if profile == PROFILE_CODES["sine"] else t * (2 - 2 * t**2 + t**3))


@dataclass(frozen=True, slots=True, init=False)
class Domain:
    """The grid of samples that is deformed: an image, a video or a volume.

    Parameters
    ----------
    shape : sequence of int
        The array's shape: ``(H, W)``, ``(T, H, W)`` or ``(Z, H, W)``, without colour.
    spacing : float or sequence of float
        Physical units per pixel, frame or voxel; one for all axes, or one for each, in the order of a point:
        x first.
    border : "auto", float, sequence of float or None
        The width σ over which displacement fades to 0 at the border: in physical units, one for all axes or one
        for each, x first; ``"auto"``: a tenth of each axis' extent; None: the border is free.
    border_profile : str
        The profile, at the distance tσ from a face: 2t - 2t³ + t⁴ (``"quartic"``), which has two continuous
        derivatives at t = 1, or sin(πt/2) (``"sine"``, the paper's). The quartic's faces are the outer edges of the
        samples, -½ and n - ½, so that it is independent of the resolution of an image; the sine's are the centres of
        the outermost samples, as in the paper.
    time : bool
        Whether the first of three axes is time. A drag along time alone, without a Poisson ratio, then has no
        displacement across it.
    freeze : Freeze, optional
        The freeze mask, of as many axes; for a clip, it may have two axes and apply to every frame.
    """

    shape: tuple[int, ...]
    spacing: Vector
    border: Border
    border_profile: BorderProfile
    time: bool
    freeze: Freeze | None

    def __init__(
        self,
        shape: Sequence[SupportsIndex],
        spacing: float | Sequence[float] | npt.NDArray[Any] = 1.0,
        border: float | Sequence[float] | Literal["auto"] | None = "auto",
        border_profile: BorderProfile = "quartic",
        time: bool = False,
        freeze: Freeze | None = None,
    ) -> None:
        sizes, checked = checked_shape(shape), checked_border(border)
        if isinstance(checked, tuple) and len(checked) != len(sizes):
            refuse("border", f"one width, or {len(sizes)} of them (x first) for a shape of {len(sizes)} axes", border)
        if isinstance(checked, tuple) and len(set(checked)) == 1:  # domains with equal widths compare equal
            checked = checked[0]
        if flag("time", time) and len(sizes) == 2:
            refuse("time", "False for a shape of two axes, which is an image", time)
        check_border_profile(border_profile)
        if freeze is not None and freeze.ndim != len(sizes) and not (time and freeze.ndim == 2):
            held, kind = "a picture" if freeze.ndim == 2 else "a volume", "picture" if len(sizes) == 2 else "volume"
            raise SuppleError(f"{freeze.told} is {held}, and what is deformed is none: give a {kind} of its size")
        if freeze is not None and freeze.samples != sizes[::-1][: freeze.ndim]:
            wanted, found = (" x ".join(map(str, size)) for size in (sizes[::-1][: freeze.ndim], freeze.samples))
            raise SuppleError(
                f"{freeze.told} is of {found} samples, and what is deformed of {wanted}: give a mask of its size"
            )
        spacing = checked_spacing(spacing, len(sizes))
        assign(self, shape=sizes, spacing=spacing, border=checked, time=bool(time), freeze=freeze)
        assign(self, border_profile=border_profile)

    @property
    def ndim(self) -> int:
        """The number of coordinates of a point: 2 or 3."""
        return len(self.shape)

    @property
    def faces(self) -> tuple[tuple[float, float], ...]:
        """The coordinates of the two faces along each axis, in physical units, x first.

        An axis of one sample has no extent: both its faces are at the sample.
        """
        out = 0.0 if self.border_profile == "sine" else 0.5  # samples beyond the centres of the outermost ones
        return tuple(
            (-out * step, (n - 1 + out) * step) if n > 1 else (0.0, 0.0)
            for n, step in zip(reversed(self.shape), self.spacing, strict=True)
        )

    @property
    def extent(self) -> Vector:
        """The distance from face to face, in physical units, x first."""
        return tuple(last - first for first, last in self.faces)

    @property
    def border_widths(self) -> Vector | None:
        """The width of the fixed border along each axis, in physical units, x first; None if it is free."""
        if self.border is None:
            return None
        if self.border == "auto":
            return tuple(AUTO * extent for extent in self.extent)
        wanted = self.border if isinstance(self.border, tuple) else (self.border,) * self.ndim
        return tuple(min(width, extent / 2) for width, extent in zip(wanted, self.extent, strict=True))

    def stretched(self, factor: float) -> Domain:
        """Return the domain of a clip with its time axis, and the border along it, longer by a factor."""
        border = self.border
        if isinstance(border, float | tuple):
            x, y, along = border if isinstance(border, tuple) else (border,) * 3
            border = (x, y, along * factor)
        spacing = (*self.spacing[:2], self.spacing[2] * factor)
        return Domain(self.shape, spacing, border, self.border_profile, self.time, self.freeze)

    def frozen(self, freeze: Freeze | None) -> Domain:
        """Return the domain with another freeze mask."""
        return Domain(self.shape, self.spacing, self.border, self.border_profile, self.time, freeze)

    def packed(self) -> npt.NDArray[np.float64]:
        """Return the domain in the layout of the core.

        Returns
        -------
        ndarray of float64, shape (3, 5)
            One row ``(first, last, sigma, spacing, profile)`` for each of x, y and z, in physical units. ``first`` and
            ``last`` are the faces. ``sigma`` is the width of the fixed border, at most half the extent (0 for an axis
            of one sample, which has no displacement), and -1 where the axis is free. An image is free along z, and has
            no extent there. ``profile`` is the border's: 0 for the quartic, 1 for the sine.
        """
        rows = np.array([FREE] * 3)
        rows[:, 4] = PROFILE_CODES[self.border_profile]
        widths = self.border_widths or (-1.0,) * self.ndim
        for row, faces, sigma, step in zip(rows, self.faces, widths, self.spacing, strict=False):
            row[:4] = *faces, sigma, step
        return rows
