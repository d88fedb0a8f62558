"""The JSON of recipes: strict, one stroke a line."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NoReturn, TypeVar, get_args

from supple.errors import SuppleError
from supple.space.checks import choice, integer, point, refuse, value_shown
from supple.space.freezing import Freeze
from supple.space.straighten import Straighten
from supple.strokes.keys import Key
from supple.strokes.stroke import Brush, Stroke
from supple.strokes.table import POISSON

VERSION = 3
T = TypeVar("T", Key, Straighten)

# The members of a stroke that are always written; others only if they differ from the default; all in this order.
_ALWAYS = ("brush", "at", "radius", "scales", "reach", "poisson", "strength")
_ORDER = (
    "brush", "at", "by", "angle", "factor", "also", "path", "axis", "chord", "isotropic", "radius", "scales", "reach",
    "time_radius", "flat", "poisson", "strength", "hidden", "name", "matte", "keys",
)  # fmt: skip


def written(members: Mapping[str, object], strokes: Iterable[Stroke]) -> str:
    """Return the text of a recipe from its fields and strokes; fields that are None are left out, except the border."""
    head = {"supple": VERSION, **{k: v for k, v in members.items() if v is not None or k == "border"}}
    lines = [f"  {_dump(key)}: {_dump(value)}" for key, value in head.items()]
    entries = ",\n".join(f"    {_dump(stroke)}" for stroke in strokes)
    lines.append(f'  "strokes": [\n{entries}\n  ]' if entries else '  "strokes": []')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def read(text: str, names: Sequence[str], resolve: Callable[[dict[str, Any]], None] | None = None) -> dict[str, Any]:
    """Return the fields of a recipe from its text, by their names; `Recipe` checks all but the strokes."""
    data = _parse(text)
    if not isinstance(data, dict):
        refuse("a recipe", "a JSON object", data)
    if resolve is not None:
        resolve(data)
    if "supple" not in data:
        raise SuppleError(f'the key "supple", a recipe\'s version ({VERSION}), is missing in {value_shown(data)}')
    version = integer('"supple"', data.pop("supple"), "1, 2 or 3 (the versions that this release reads)", 1, VERSION)
    _check_keys("the recipe", data, names, ["strokes"])
    if version == 1:
        data = {"border": 50.0, "border_profile": "sine", "on_fold": "damp", **data}
    if not isinstance(data["strokes"], list):
        refuse("strokes", "a list", data["strokes"])
    if data.get("freeze") is not None:
        data["freeze"] = Freeze.from_entry(data["freeze"])
    if data.get("straighten") is not None:
        data["straighten"] = _made(Straighten, "straighten", data["straighten"])
    world = data.get("space") in ("LPS", "RAS")
    data["strokes"] = [_stroke(f"strokes[{i}]", entry, version, world) for i, entry in enumerate(data["strokes"])]
    return data


def _plain(value: Any) -> object:
    """Return a value as JSON has it: whole numbers without a fraction, lists, and objects of fields that differ."""
    if isinstance(value, Freeze):
        return value.entry()
    if isinstance(value, Stroke):
        usual = {each.name: each.default for each in fields(value)}
        usual["by"] = () if value.brush == "grab" else value.by
        value = {k: x for k in _ORDER if (x := getattr(value, k)) != usual[k] or k in _ALWAYS}
    elif isinstance(value, Key | Straighten):
        value = {each.name: x for each in fields(value) if (x := getattr(value, each.name)) != each.default}
    if isinstance(value, dict):
        return {key: _plain(x) for key, x in value.items()}
    if isinstance(value, tuple):
        return [_plain(x) for x in value]
    if value == -math.inf:
        return "-inf"
    if not isinstance(value, float) or not value.is_integer() or abs(value) >= 2**53:
        return value
    return value if value == 0 and math.copysign(1, value) < 0 else int(value)


def _dump(value: object) -> str:
    return json.dumps(_plain(value), allow_nan=False)


def _made(kind: type[T], where: str, entry: object, *required: str) -> T:
    """Return a value from the JSON object of its fields."""
    if not isinstance(entry, dict):
        refuse(where, "a JSON object", entry)
    _check_keys(where, entry, [each.name for each in fields(kind)], required)
    try:
        return kind(**entry)
    except SuppleError as error:
        raise SuppleError(f"{where}: {error}") from None


def _stroke(where: str, entry: object, version: int, world: bool) -> Stroke:
    if not isinstance(entry, dict):
        refuse(where, "a JSON object", entry)
    if "brush" in entry:
        choice(f"{where}: brush", entry["brush"], get_args(Brush))
    brush, end = entry.get("brush"), "to" if "to" in entry else "by"
    needed = {"twist": "angle", "scale": "factor", "pinch": "factor", "freeze": "matte"}.get(str(brush), end)
    _check_keys(where, entry, [*_ORDER, "to"], ["brush", "at", needed, "radius"])
    usual: dict[str, object] = {"poisson": POISSON, "reach": None} if version == 1 else {}
    if version < 3 and brush == "twist":
        usual["chord"] = True
    if version < 3 and not world and isinstance(entry["at"], list) and len(entry["at"]) == 3:
        usual["isotropic"] = True
    entry = {**usual, **entry}
    try:
        if end == "to":
            if "by" in entry:
                raise SuppleError('a grab takes one of "to" and "by", found both')
            start = point("at", entry["at"])
            entry["by"] = tuple(b - a for a, b in zip(start, point("to", entry.pop("to"), (len(start),)), strict=True))
        if entry.get("poisson") == "-inf":
            entry["poisson"] = -math.inf
        if isinstance(keys := entry.get("keys"), list):
            entry["keys"] = [_made(Key, f"keys[{i}]", key, "frame") for i, key in enumerate(keys)]
        if entry.get("matte") is not None:
            entry["matte"] = Freeze.from_entry(entry["matte"], "matte")
        return Stroke(**entry)
    except SuppleError as error:
        raise SuppleError(f"{where}: {error}") from None


def _check_keys(where: str, entry: dict[str, object], known: Sequence[str], required: Sequence[str]) -> None:
    for key in entry:
        if key not in known:
            import difflib

            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}"
            raise SuppleError(f"unknown key {value_shown(key)} in {where}: {hint}")
    for key in required:
        if key not in entry:
            raise SuppleError(f'the key "{key}" is missing in {where}')


def _parse(text: str) -> Any:
    if not isinstance(text, str):
        refuse("a recipe", "text in JSON", text)
    try:
        return json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant, parse_int=_parse_int)
    except json.JSONDecodeError as error:
        reason = f"{error.msg} at line {error.lineno}, column {error.colno}"
    except RecursionError:
        reason = "it is nested too deeply"
    raise SuppleError(f"a recipe must be JSON: {reason}")


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    twice = [key for key, n in Counter(key for key, _ in pairs).items() if n > 1]
    if twice:
        raise SuppleError(f"the key {value_shown(twice[0])} is given twice in one object of the recipe")
    return dict(pairs)


def _no_constant(token: str) -> NoReturn:
    raise SuppleError(f'a recipe must be strict JSON, found {token} (an infinite poisson is written "-inf")')


def _parse_int(digits: str) -> float:
    # Python refuses to read integers of thousands of digits; as a float, such a number is out of bounds.
    return int(digits) if len(digits) < 100 else float(digits)
