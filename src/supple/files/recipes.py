"""Reading and writing recipes as JSON files."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from supple.errors import JSON, SuppleError, shown, spelling
from supple.files.options import PathLike
from supple.media.files import check_output, is_store, replacing, unreadable
from supple.media.pictures import SUFFIXES as PICTURES
from supple.media.suffixes import CLIPS, CLIPS_OUT, VOLUMES, VOLUMES_OUT, suffix_of
from supple.media.timecode import PATTERN
from supple.strokes import Recipe

_GIVE = "give a recipe in JSON"
_TIMECODE = re.compile(rf'("name"\s*:\s*)?"({PATTERN})"')
_MEDIA = frozenset({*PICTURES, *CLIPS, *CLIPS_OUT, *VOLUMES, *VOLUMES_OUT})


def is_media_name(path: PathLike) -> bool:
    """Return whether a name has the suffix of an image, a video or a volume, or ends with a slash, as a folder's."""
    return not os.fspath(path).endswith(("/", os.sep)) and suffix_of(path) in _MEDIA


def read_recipe(
    path: PathLike,
    *,
    frames: Callable[[str, str], int] | None = None,
    resolve: Callable[[dict[str, Any]], None] | None = None,
) -> Recipe:
    """Read a recipe from a JSON file; SuppleError, with the file and the fault, if it is invalid.

    ``frames(file, timecode)`` converts a timecode, which may replace the number of a frame, to a frame from 0; its
    first argument is for messages. ``resolve`` is as in `Recipe.from_json`.
    """
    name = shown(path)
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")  # of a pipe, too
    except OSError as error:
        raise unreadable(path, error.strerror or str(error), _GIVE) from error
    except UnicodeDecodeError as error:
        raise unreadable(path, "it is no text", _GIVE) from error
    except ValueError as error:
        raise unreadable(path, "no file can have that name", "check it") from error
    try:
        if frames is not None:
            text = _TIMECODE.sub(lambda code: code[0] if code[1] else str(frames(name, code[2])), text)
        with spelling(JSON):
            return Recipe.from_json(text, resolve=resolve)
    except SuppleError as error:
        raise SuppleError(f"{name}: {error}") from None


def check_recipe_name(path: PathLike, *, force: bool = False) -> None:
    """Raise SuppleError for a name that is one of an image, a video or a volume, or that cannot be written."""
    if is_media_name(path) or is_store(path):
        name, suffix = shown(path), suffix_of(path)
        stem = name[: len(name) - len(suffix)]
        raise SuppleError(f"cannot write {name}: a recipe is JSON, and none is written as {suffix}: use {stem}.json")
    check_output(path, force=force)


def write_recipe(path: PathLike, recipe: Recipe, *, force: bool = False) -> None:
    """Write a recipe as JSON; the file appears whole or not at all."""
    check_recipe_name(path, force=force)
    with replacing(path, force=force) as temporary:
        temporary.write_text(recipe.to_json(), encoding="utf-8")
