"""Names of image sequences: numbered images, and the images of a folder."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

from supple.errors import SuppleError, shown
from supple.media.files import PathLike
from supple.media.pictures import SUFFIXES

_NUMBER = re.compile("%(?:0[1-9][0-9]?)?d")
_SIGNS = re.compile(r"#{2,}|@{2,}|(?<=[._-])#(?=\.)|\$F[1-9]?(?=\.)")


def is_sequence(path: PathLike) -> bool:
    """Return whether a name is a sequence: a folder, or a pattern with a number, such as ``frames/%05d.png``."""
    text = os.fspath(path)
    return text.endswith(("/", os.sep)) or has_number(text) or os.path.isdir(text)


def has_number(path: PathLike) -> bool:
    """Return whether a name is a pattern."""
    return bool(_NUMBER.search(Path(percent(path)).name)) and not os.path.isdir(path)


def percent(path: PathLike) -> str:
    """Return a pattern in the form ``f.%04d.exr``; given are this, ``f.####.exr``, ``f.@@@@.exr`` or ``f.$F4.exr``."""
    text = os.fspath(path)
    folder, name = os.path.split(text)
    found = list(_SIGNS.finditer(name))
    if not found or _NUMBER.search(name) or os.path.lexists(text):
        return text
    signs, (start, end) = found[-1][0], found[-1].span()
    width = (int(signs[2:] or 1)) if signs[0] == "$" else len(signs)
    return os.path.join(folder, f"{name[:start]}%{f'0{width}' if width > 1 else ''}d{name[end:]}")


def of_star(path: str) -> str | None:
    """Return the pattern of numbered images, ``f.%04d.exr``, for ``f.*.exr``; None if they are not numbered."""
    folder, name = os.path.split(path)
    before, _, after = name.partition("*")
    found = [n for n in _names_in(Path(folder)) if n.startswith(before) and n.endswith(after)]
    digits = [n[len(before) : len(n) - len(after)] for n in found]
    if not digits or not all(each.isascii() and each.isdecimal() for each in digits):
        return None
    widths = {len(each) for each in digits}
    width = widths.pop() if len(widths) == 1 else 1
    return os.path.join(folder, f"{before}%{f'0{width}' if width > 1 else ''}d{after}")


def first_number(paths: list[Path]) -> int | None:
    """Return the number at the end of the first name, if the others are consecutive."""
    numbers = [int(found[-1]) if (found := re.findall("[0-9]+", path.stem)) else None for path in paths]
    start = numbers[0]
    return start if start is not None and numbers == list(range(start, start + len(paths))) else None


def spelling(pattern: str, whole: str) -> Callable[[int], str]:
    """Return the function that formats a number in a pattern."""
    if len(_NUMBER.findall(pattern)) > 1 or "%" in _NUMBER.sub("", pattern):
        raise SuppleError(f"{shown(whole)} must hold one number, as %d or %05d, and no other percent sign")
    return lambda number: pattern % number


def matching(text: str) -> tuple[list[Path], list[int], Callable[[int], str]]:
    """Return the images that match a pattern, in order, with their numbers."""
    path = Path(percent(text))
    spell = spelling(path.name, text)
    before, after = _NUMBER.split(path.name)
    numbers = []
    for name in _names_in(path.parent):
        digits = name[len(before) : len(name) - len(after)]
        fits = name.startswith(before) and name.endswith(after) and digits.isascii() and digits.isdecimal()
        if fits and spell(int(digits)) == name:
            numbers.append(int(digits))
    numbers.sort()
    return [path.parent / spell(number) for number in numbers], numbers, spell


def numbered(text: str) -> tuple[list[Path], int]:
    """Return the images that match a pattern, and the first number; SuppleError if one is missing."""
    paths, numbers, spell = matching(text)
    if not paths:
        raise SuppleError(f"no picture is named {shown(text)}: check the pattern")
    for place, number in enumerate(numbers):
        missing = numbers[0] + place
        if number != missing:
            name = shown(Path(text).parent / spell(missing))
            text = f"{name} is missing between {shown(paths[0])} and {shown(paths[-1])}"
            raise SuppleError(f"{text}: add it, or give a folder that holds the frames alone")
    return paths, numbers[0]


def pictures_in(folder: Path) -> list[Path]:
    """Return the images of a folder, the 9th before the 10th."""
    names = [n for n in _names_in(folder) if Path(n).suffix.lower() in SUFFIXES and os.path.isfile(folder / n)]
    if not names:
        told = f"the folder {shown(folder)} holds no pictures or DICOM slices"
        raise SuppleError(f"{told}: give another, or a pattern such as %05d.png")
    return [folder / name for name in sorted(names, key=_natural)]


def _names_in(folder: Path) -> list[str]:
    try:
        return [name for name in os.listdir(folder) if not name.startswith(".")]
    except OSError as error:
        raise SuppleError(f"cannot read the folder {shown(folder)}: {error.strerror}: check its name") from error
    except ValueError as error:
        raise SuppleError(f"cannot read {shown(folder)}: no folder can have that name: check it") from error


def _natural(name: str) -> tuple[list[str | int], str]:
    parts = re.split("([0-9]+)", name.lower())
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], name
