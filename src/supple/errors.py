"""Exceptions and warnings, and how their messages name arguments."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar, copy_context
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

_ANY: Any = object()  # marks an argument that is named without a value


@dataclass(frozen=True)
class Spelling:
    """How those who read messages name arguments: in Python, on the command line, in a file or in a window.

    Parameters
    ----------
    argument : function of (str, object)
        Returns the spelling of an argument, given its name and its value: the name alone if that is `Spelling.ANY`.
    none : str
        The spelling of None.
    first : int
        The number of the first frame of a clip.
    stroke : function of Stroke, optional
        Returns the name of a stroke; by default, its brush with all its numbers.
    typed : function of str, optional
        Returns the text that was typed for an argument; empty if that is not known.
    """

    ANY = _ANY
    argument: Callable[[str, object], str]
    none: str = "None"
    first: int = 0
    stroke: Callable[[Any], str] | None = None
    typed: Callable[[str], str] = lambda name: ""


PYTHON = Spelling(lambda name, value: name if value is _ANY else f"{name}={value!r}")
JSON = Spelling(lambda name, value: name if value is _ANY else f'"{name}": {value!r}', "null")
_face = PYTHON  # the default of all threads
_here: ContextVar[Spelling | None] = ContextVar("spelling", default=None)
_Line = tuple[str, int, str, dict[Any, Any]]
_starter: ContextVar[_Line | None] = ContextVar("starter", default=None)  # what started this thread


def current_spelling() -> Spelling:
    """Return the spelling of arguments that is in effect."""
    return _here.get() or _face


@contextlib.contextmanager
def spelling(how: Spelling) -> Iterator[None]:
    """Name arguments in another way in the messages of this context."""
    token = _here.set(how)
    try:
        yield
    finally:
        _here.reset(token)


@contextlib.contextmanager
def counting(first: int | None) -> Iterator[None]:
    """Count the frames of a clip from another number, by default 0, in the messages of this context."""
    with spelling(replace(current_spelling(), first=first or 0)):
        yield


@contextlib.contextmanager
def facing(how: Spelling) -> Iterator[None]:
    """Name arguments in another way in the messages of all threads, as the command does while it runs."""
    global _face
    before, _face = _face, how
    try:
        yield
    finally:
        _face = before


def argument(name: str, value: object = _ANY) -> str:
    """Return an argument, with its value if given, as spelled for the reader: ``on_fold='flow'``."""
    return current_spelling().argument(name, value)


def numbered(frame: float) -> float:
    """Return the number that messages give a frame, from its index (0 is the first)."""
    return frame + current_spelling().first


def listing(names: Sequence[str], most: int) -> str:
    """Return up to ``most`` of the names as text, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def none() -> str:
    """Return the spelling of None."""
    return current_spelling().none


class SuppleError(ValueError):
    """An invalid request; the message says in one sentence what was given and what is possible.

    All functions raise it for arguments that are invalid, or do not fit each other.
    """


def need(extra: str, what: str, *modules: str) -> None:
    """Raise SuppleError, with the command that installs the extra, if one of its modules is missing."""
    for module in modules:
        if find_spec(module) is None:
            raise SuppleError(f"{what} need {module}, which is not installed: pip install 'supple[{extra}]'")


def needed(extra: str, what: str, module: str) -> Any:
    """Return a module, imported at the first use; SuppleError as by `need`."""
    need(extra, what, module)
    return import_module(module)


class FoldError(SuppleError):
    """A stroke would fold the image over itself, or be held back by the border, and the policy is ``"error"``."""


class MissWarning(UserWarning):
    """A stroke's point ends more than half a pixel from its target, or a later stroke carries it away from there.

    The point of a twist, a scale or a pinch has no target. No warning is given of a later stroke that begins at the
    point (within a tenth of its radius), that is the mirror image of the one before it, or that restores or smooths.
    """


class FoldWarning(MissWarning):
    """A stroke was too strong, and was damped so that the map does not fold."""


class DeviceWarning(UserWarning):
    """A GPU failed, and the CPU took over."""


class OutsideWarning(UserWarning):
    """A stroke starts outside the image, the clip or the volume, or moves nothing; or a map may be of another size."""


class TrackWarning(UserWarning):
    """A tracked point is lost before the clip ends, or begins; the message says in which frame, and why."""


class ScaleWarning(UserWarning):
    """A recipe was made for another size of the same proportions, and was scaled."""


class LayerWarning(UserWarning):
    """Channels of a picture are sampled by the nearest pixel, since their averages would mean nothing."""


class ToleranceWarning(UserWarning):
    """The inverse map is not within the tolerance everywhere."""


class VolumeWarning(UserWarning):
    """A volume's files contradict each other, or hold more than images; the message says how they were read."""


class FreezeWarning(UserWarning):
    """A freeze mask freezes nothing."""


class GapWarning(UserWarning):
    """Voxels are not finite numbers, and spread to their neighbours."""


def aside(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function for another thread: it runs in a copy of this context, and warnings name this caller's line."""
    context = copy_context()
    context.run(_starter.set, _caller())
    return partial(context.run, function)


def warn(text: str, category: type[Warning]) -> None:
    """Warn, with the line of the first caller outside Supple."""
    file, line, name, seen = _caller()
    warnings.warn_explicit(text, category, file, line, name, seen)


def _caller() -> _Line:
    """Return the file, the line, the module, and the module's warnings of the first caller outside Supple."""
    if (known := _starter.get()) is not None:
        return known
    frame = sys._getframe()
    # These call what Supple decorates or defines: properties that are cached, contexts, and functions with gradients.
    own = ("supple", "contextlib", "functools", "torch")
    while frame.f_back is not None and (frame.f_globals.get("__name__") or "").partition(".")[0] in own:
        frame = frame.f_back
    name, seen = frame.f_globals.get("__name__") or "<string>", frame.f_globals.setdefault("__warningregistry__", {})
    return frame.f_code.co_filename, frame.f_lineno, name, seen


def said(error: BaseException) -> str:
    """Return the first line of an error's message, or its type if it has none."""
    return (str(error).splitlines() or [""])[0] or type(error).__name__


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path for one line of text: quoted if it is empty or has unprintable characters."""
    text = os.fspath(path)
    return text if text and text.isprintable() else ascii(text)
