"""The domain of a deformation: its shape, spacing and border; and checks of user input."""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, NoReturn, SupportsIndex, get_args

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument, none

if TYPE_CHECKING:
    from supple.space.freezing import Freeze

# Fields contain fifth powers of lengths, which neither overflow nor vanish in float64 within these bounds.
SMALLEST = 1e-30
LARGEST = 1e30
LENGTH = f"a number above 0 (from {SMALLEST:g} to {LARGEST:g})"
LONGEST_AXIS = 2**31 - 1
AUTO = 0.1  # the border's width for border="auto", as a fraction of each axis' extent

Border = Literal["auto"] | float | tuple[float, ...] | None
BorderProfile = Literal["quartic", "sine"]
PROFILE_CODES: dict[str, float] = {"quartic": 0.0, "sine": 1.0}
"""The codes of the border profiles in the packed domain."""
FREE = (0.0, 0.0, -1.0, 1.0, 0.0)
"""An axis without a border, in the layout of `Domain.packed`."""


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        if x.bit_length() <= 64:
            return repr(x)
        # Python refuses to print integers of more than a few thousand digits.
        return f"an integer of about {int(x.bit_length() * 0.30103) + 1} digits"


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = 60


def value_shown(value: object) -> str:
    """Return a short representation of any value, on one line, for a message."""
    if value is None:
        return none()
    text = " ".join(_SHORT.repr(value.item() if isinstance(value, np.generic) else value).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def refuse(name: str, wanted: str, found: object = None, *, told: str = "") -> NoReturn:
    """Raise SuppleError with the values that ``name`` may have and the value found, or what is ``told`` of it."""
    raise SuppleError(f"{argument(name)} must be {wanted}, found {told or value_shown(found)}")


def number(name: str, value: object, wanted: str, low: float, high: float) -> float:
    """Return a real number (no bool) from ``low`` to ``high`` as a float; SuppleError with what is ``wanted``."""
    # A protocol check is slow.
    if type(value) is not float and (isinstance(value, bool) or not isinstance(value, Real)):
        refuse(name, wanted, value)
    try:
        checked = float(value)
    except OverflowError:
        refuse(name, wanted, value)
    if not low <= checked <= high:
        refuse(name, wanted, value)
    return checked


def length(name: str, value: object) -> float:
    """Return ``value`` as a length above 0; SuppleError for other values."""
    return number(name, value, LENGTH, SMALLEST, LARGEST)


def integer(name: str, value: object, wanted: str, low: int, high: int) -> int:
    """Return ``value`` as an int from ``low`` to ``high``; SuppleError for other values."""
    if type(value) is not int and (isinstance(value, bool) or not isinstance(value, SupportsIndex)):
        refuse(name, wanted, value)
    try:
        checked = operator.index(value)
    except TypeError:  # an array of several numbers has __index__ too
        refuse(name, wanted, value)
    if not low <= checked <= high:
        refuse(name, wanted, value)
    return checked


def items(name: str, value: object, wanted: str, lengths: tuple[int, ...]) -> list[Any]:
    """Return the items of a sequence or 1-D array with one of ``lengths``; SuppleError for other values."""
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    text = isinstance(value, str | bytes | bytearray)
    if text or not isinstance(value, Sequence) or len(value) not in lengths:
        refuse(name, wanted, value)
    return list(value)


def point(name: str, value: object, lengths: tuple[int, ...] = (2, 3)) -> tuple[float, ...]:
    """Return ``value`` as the coordinates of a point; SuppleError for other values."""
    numbers = items(name, value, f"{' or '.join(map(str, lengths))} numbers, x first", lengths)
    wanted = f"a number from {-LARGEST:g} to {LARGEST:g}"
    return tuple(number(f"{name}[{i}]", x, wanted, -LARGEST, LARGEST) for i, x in enumerate(numbers))


def choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise SuppleError unless ``value`` is one of ``choices``."""
    if not isinstance(value, str) or value not in choices:
        refuse(name, " or ".join(f'"{known}"' for known in choices), value)


def flag(name: str, value: object) -> bool:
    """Return ``value`` as a bool, also from NumPy's; SuppleError for other values."""
    if not isinstance(value, bool | np.bool_):
        refuse(name, "True or False", value)
    return bool(value)


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
    """Return β at the distance ``t`` from a face, over the border's width; ``profile`` as in `PROFILE_CODES`."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(np.sin(np.pi / 2 * t) if profile == PROFILE_CODES["sine"] else t * (2 - 2 * t**2 + t**3))


def colours_hint(shape: tuple[int, ...]) -> str:
    """Return a hint for the message if the last of three axes may be colours."""
    if len(shape) != 3 or shape[2] not in (3, 4):
        return ""
    return f" (if the last axis of {shape} is colours, make the deformation with shape[:2])"


def checked_shape(shape: object) -> tuple[int, ...]:
    """Return ``shape`` as two or three sizes; SuppleError for other values."""
    wanted = "two or three sizes, (H, W), (T, H, W) or (Z, H, W)"
    sizes = items("shape", shape, wanted, (2, 3))
    within = f"an integer from 1 to {LONGEST_AXIS}"
    return tuple(integer(f"shape[{i}]", size, within, 1, LONGEST_AXIS) for i, size in enumerate(sizes))


def checked_spacing(spacing: object, ndim: int) -> tuple[float, ...]:
    """Return ``spacing`` as one length for each axis, x first; SuppleError for other values."""
    if isinstance(spacing, Real):
        return (length("spacing", spacing),) * ndim
    wanted = f"one number, or {ndim} of them (x first) for a shape of {ndim} axes"
    steps = items("spacing", spacing, wanted, (ndim,))
    return tuple(length(f"spacing[{i}]", step) for i, step in enumerate(steps))


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
        The freeze mask, of as many axes; or of two for a clip, in each of whose frames it is the same.
    """

    shape: tuple[int, ...]
    spacing: tuple[float, ...]
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
        sizes = checked_shape(shape)
        object.__setattr__(self, "shape", sizes)
        object.__setattr__(self, "spacing", checked_spacing(spacing, len(sizes)))
        checked = checked_border(border)
        if isinstance(checked, tuple) and len(checked) != len(sizes):
            refuse("border", f"one width, or {len(sizes)} of them (x first) for a shape of {len(sizes)} axes", border)
        if isinstance(checked, tuple) and len(set(checked)) == 1:  # equal domains compare equal
            checked = checked[0]
        object.__setattr__(self, "border", checked)
        if flag("time", time) and len(sizes) == 2:
            refuse("time", "False for a shape of two axes, which is an image", time)
        object.__setattr__(self, "time", bool(time))
        check_border_profile(border_profile)
        object.__setattr__(self, "border_profile", border_profile)
        if freeze is not None and freeze.ndim != len(sizes) and not (time and freeze.ndim == 2):
            held, kind = "a picture" if freeze.ndim == 2 else "a volume", "picture" if len(sizes) == 2 else "volume"
            raise SuppleError(f"{freeze.told} is {held}, and what is deformed is none: give a {kind} of its size")
        if freeze is not None and freeze.samples != sizes[::-1][: freeze.ndim]:
            wanted, found = (" x ".join(map(str, size)) for size in (sizes[::-1][: freeze.ndim], freeze.samples))
            raise SuppleError(
                f"{freeze.told} is of {found} samples, and what is deformed of {wanted}: give a mask of its size"
            )
        object.__setattr__(self, "freeze", freeze)

    @property
    def ndim(self) -> int:
        """The number of coordinates of a point: 2 or 3."""
        return len(self.shape)

    @property
    def faces(self) -> tuple[tuple[float, float], ...]:
        """The coordinates of the two faces along each axis, in physical units, x first.

        An axis of one sample has no extent: both its faces are at the sample.
        """
        out = 0.0 if self.border_profile == "sine" else 0.5  # of a sample, beyond the centres of the outermost
        return tuple(
            (-out * step, (n - 1 + out) * step) if n > 1 else (0.0, 0.0)
            for n, step in zip(reversed(self.shape), self.spacing, strict=True)
        )

    @property
    def extent(self) -> tuple[float, ...]:
        """The distance from face to face, in physical units, x first."""
        return tuple(last - first for first, last in self.faces)

    @property
    def border_widths(self) -> tuple[float, ...] | None:
        """The width of the fixed border along each axis, in physical units, x first; None if it is free."""
        if self.border is None:
            return None
        if self.border == "auto":
            return tuple(AUTO * extent for extent in self.extent)
        wanted = self.border if isinstance(self.border, tuple) else (self.border,) * self.ndim
        return tuple(min(width, extent / 2) for width, extent in zip(wanted, self.extent, strict=True))

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
