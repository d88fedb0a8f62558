"""Checks of user input: each returns the value, or raises a SuppleError that names the argument."""

from __future__ import annotations

import copy
import operator
import reprlib
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any, NoReturn, SupportsIndex, TypeVar

import numpy as np
import numpy.typing as npt

from supple.errors import SuppleError, argument, current_spelling, none

T = TypeVar("T")
Vector = tuple[float, ...]
"""One number for each axis, x first."""
Shape = tuple[int, ...]

# Fields contain fifth powers of lengths, which neither overflow nor vanish in float64 within these bounds.
SMALLEST = 1e-30
LARGEST = 1e30
LENGTH = f"a number above 0 (from {SMALLEST:g} to {LARGEST:g})"
LONGEST_AXIS = 2**31 - 1


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:  # Python refuses to print integers of thousands of digits
        digits = int(x.bit_length() * 0.30103) + 1
        return repr(x) if digits <= 20 else f"an integer of about {digits} digits"


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = 60


def value_shown(value: object) -> str:
    """Return a short representation of any value, on one line, for a message."""
    if value is None:
        return none()
    text = " ".join(_SHORT.repr(value.item() if isinstance(value, np.generic) else value).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def refuse(name: str, wanted: str, found: object = None, *, told: str = "") -> NoReturn:
    """Raise SuppleError with the values that ``name`` may have, and the value found or its description ``told``."""
    held = told or current_spelling().typed(name) or value_shown(found)
    raise SuppleError(f"{argument(name)} must be {wanted}, found {held}")


def number(name: str, value: object, wanted: str, low: float, high: float) -> float:
    """Return a real number (no bool) from ``low`` to ``high`` as a float; SuppleError, with ``wanted``, otherwise."""
    # Checking against a protocol such as Real is slow.
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


def items(name: str, value: object, wanted: str, lengths: Shape) -> list[Any]:
    """Return the items of a sequence or 1-D array with one of ``lengths``; SuppleError for other values."""
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    text = isinstance(value, str | bytes | bytearray)
    if text or not isinstance(value, Sequence) or len(value) not in lengths:
        refuse(name, wanted, value)
    return list(value)


def listed(name: str, value: object, wanted: str) -> tuple[Any, ...]:
    """Return the items of any iterable but text; SuppleError for other values."""
    if not isinstance(value, Iterable) or isinstance(value, str | bytes):
        refuse(name, wanted, value)
    return tuple(value)


def assign(frozen: object, **values: object) -> None:
    """Set fields of a frozen dataclass, while it is made."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


def varied(given: T, **values: object) -> T:
    """Return a copy of an object, which may be frozen, with other values of some attributes, which are not checked."""
    made = copy.copy(given)
    assign(made, **values)
    return made


def point(name: str, value: object, lengths: Shape = (2, 3)) -> Vector:
    """Return ``value`` as the coordinates of a point; SuppleError for other values."""
    numbers = items(name, value, f"{' or '.join(map(str, lengths))} numbers, x first", lengths)
    wanted = f"a number from {-LARGEST:g} to {LARGEST:g}"
    return tuple(number(f"{name}[{i}]", x, wanted, -LARGEST, LARGEST) for i, x in enumerate(numbers))


def rows(name: str, value: npt.ArrayLike, columns: int) -> npt.NDArray[np.float64]:
    """Return rows of so many finite numbers, (N, columns), as floats; SuppleError for other values."""
    wanted = f"finite numbers of shape (N, {columns})"
    try:
        given = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        refuse(name, wanted, value)
    if given.size == 0:
        given = given.reshape(0, columns)
    if given.ndim != 2 or given.shape[1] != columns:
        refuse(name, wanted, told=f"shape {given.shape}")
    if not np.isfinite(given).all():
        refuse(name, wanted, told="some that are not finite")
    return given


def choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise SuppleError unless ``value`` is one of ``choices``."""
    if not isinstance(value, str) or value not in choices:
        refuse(name, " or ".join(f'"{known}"' for known in choices), value)


def flag(name: str, value: object) -> bool:
    """Return ``value`` as a bool, also from NumPy's; SuppleError for other values."""
    if not isinstance(value, bool | np.bool_):
        refuse(name, "True or False", value)
    return bool(value)


def colours_hint(shape: Shape) -> str:
    """Return a hint for a message if the last of three axes may be the colour channels."""
    if len(shape) != 3 or shape[2] not in (3, 4):
        return ""
    return f" (if the last axis of {shape} is colours, make the deformation with shape[:2])"


def checked_sizes(name: str, value: object, wanted: str, lengths: Shape) -> Shape:
    """Return ``value`` as numbers of samples along axes, of one of ``lengths``; SuppleError for other values."""
    sizes, within = items(name, value, wanted, lengths), f"an integer from 1 to {LONGEST_AXIS}"
    return tuple(integer(f"{name}[{i}]", size, within, 1, LONGEST_AXIS) for i, size in enumerate(sizes))


def checked_shape(shape: object) -> Shape:
    """Return ``shape`` as two or three sizes; SuppleError for other values."""
    return checked_sizes("shape", shape, "two or three sizes, (H, W), (T, H, W) or (Z, H, W)", (2, 3))


def checked_spacing(spacing: object, ndim: int) -> Vector:
    """Return ``spacing`` as one length for each axis, x first; SuppleError for other values."""
    if isinstance(spacing, Real):
        return (length("spacing", spacing),) * ndim
    wanted = f"one number, or {ndim} of them (x first) for a shape of {ndim} axes"
    steps = items("spacing", spacing, wanted, (ndim,))
    return tuple(length(f"spacing[{i}]", step) for i, step in enumerate(steps))


def library_of(value: object) -> str:
    """Return the library of an image or transform, "SimpleITK" or "nibabel"; "" for other objects."""
    roots = {each.__module__.partition(".")[0] for each in type(value).__mro__}
    known = (("SimpleITK", "GetDimension"), ("nibabel", "dataobj"))
    return next((root for root, has in known if root in roots and hasattr(value, has)), "")
