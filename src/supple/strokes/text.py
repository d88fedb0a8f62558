"""The JSON of recipes: strict, one stroke a line."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NoReturn, get_args

from supple.errors import SuppleError
from supple.space.checks import choice, integer, point, refuse, value_shown
from supple.space.freezing import Freeze
from supple.space.straighten import Straighten
from supple.strokes.keys import Key
from supple.strokes.stroke import Brush, Stroke
from supple.strokes.table import POISSON

VERSION = 3

# Keys added after version 1.
_NEW = (
    "border_profile", "reach", "size", "space", "amount", "time_scale", "name", "strength", "to", "angle", "factor",
    "axis", "also", "path", "keys", "freeze",
)  # fmt: skip
_NEWER = ("chord", "isotropic", "time_radius", "flat", "matte", "straighten")  # and after version 2
_OF_KEYS = ("angle", "scale")  # the same, of the keys of strokes


def written(members: Mapping[str, object], strokes: Iterable[Stroke]) -> str:
    """Return the text of a recipe of some fields and strokes; fields that are None are left out, but for the border."""
    strokes = list(strokes)
    # Twists and strokes in time differ from those of version 2; mattes, plateaus, keys that turn or scale are new.
    world = members.get("space") in ("LPS", "RAS")
    turning = any((key.angle, key.scale) != (None, None) for stroke in strokes for key in stroke.keys)
    newer = any(
        stroke.brush == "twist" or (stroke.ndim == 3 and not world) or stroke.isotropic
        or stroke.time_radius is not None or stroke.flat or stroke.matte or not 0 <= stroke.strength <= 1
        for stroke in strokes
    )  # fmt: skip
    most = float(str(members["amount"]))
    version = VERSION if turning or newer or members.get("straighten") or not 0 <= most <= 1 else 2
    head = {"supple": version, **{k: v for k, v in members.items() if v is not None or k == "border"}}
    lines = [f"  {_dump(key)}: {_dump(_plain(value))}" for key, value in head.items()]
    entries = ",\n".join(f"    {_dump(_entry(stroke))}" for stroke in strokes)
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
    _check_keys("the recipe", data, _known(names, version), ["strokes"])
    if version == 1:
        data = {"border": 50.0, "on_fold": "damp", **data, "border_profile": "sine"}
    if not isinstance(data["strokes"], list):
        refuse("strokes", "a list", data["strokes"])
    if data.get("freeze") is not None:
        data["freeze"] = Freeze.from_entry(data["freeze"])
    if data.get("straighten") is not None:
        if not isinstance(entry := data["straighten"], dict):
            refuse("straighten", "a JSON object", entry)
        _check_keys("straighten", entry, [each.name for each in fields(Straighten)], [])
        try:
            data["straighten"] = Straighten(**entry)
        except SuppleError as error:
            raise SuppleError(f"straighten: {error}") from None
    world = data.get("space") in ("LPS", "RAS")
    data["strokes"] = [_stroke(f"strokes[{i}]", entry, version, world) for i, entry in enumerate(data["strokes"])]
    return data


def _plain(value: object) -> object:
    """Return a value as JSON has it: whole numbers without a fraction, and lists."""
    if isinstance(value, Freeze):
        return value.entry()
    if isinstance(value, Straighten):
        usual = Straighten()
        known = {each.name: getattr(value, each.name) for each in fields(value)}
        return {name: _plain(x) for name, x in known.items() if x != getattr(usual, name)}
    if isinstance(value, tuple):
        return [_plain(x) for x in value]
    if not isinstance(value, float) or not value.is_integer() or abs(value) >= 2**53:
        return value
    return value if value == 0 and math.copysign(1, value) < 0 else int(value)


def _dump(value: object) -> str:
    return json.dumps(value, allow_nan=False)


def _entry(stroke: Stroke) -> dict[str, object]:
    shape: dict[str, object] = {"by": stroke.by}
    if stroke.brush != "grab":
        shape = {name: x for name, x in (("angle", stroke.angle), ("factor", stroke.factor)) if x is not None}
    shape.update({name: x for name, x in (("also", stroke.also), ("path", stroke.path)) if x})
    if stroke.axis is not None:
        shape["axis"] = stroke.axis
    shape.update({name: True for name in ("chord", "isotropic") if getattr(stroke, name)})
    entry: dict[str, object] = {
        "brush": stroke.brush,
        "at": stroke.at,
        **shape,
        "radius": stroke.radius,
        "scales": stroke.scales,
        "reach": stroke.reach,
        **({} if stroke.time_radius is None else {"time_radius": stroke.time_radius}),
        **({"flat": stroke.flat} if stroke.flat else {}),
        "poisson": "-inf" if stroke.poisson == -math.inf else stroke.poisson,
        "strength": stroke.strength,
    }
    if stroke.hidden:
        entry["hidden"] = True
    if stroke.name is not None:
        entry["name"] = stroke.name
    if stroke.matte is not None:
        entry["matte"] = stroke.matte
    if stroke.keys:
        entry["keys"] = [_key_entry(key) for key in stroke.keys]
    return {name: _plain(value) for name, value in entry.items()}


def _key_entry(key: Key) -> dict[str, object]:
    entry = {field.name: getattr(key, field.name) for field in fields(Key)}
    return {name: _plain(value) for name, value in entry.items() if value is not None}


def _known(names: Iterable[str], version: int) -> list[str]:
    """Return the keys of a version."""
    return [name for name in names if (version > 1 or name not in _NEW) and (version > 2 or name not in _NEWER)]


def _stroke(where: str, entry: object, version: int, world: bool) -> Stroke:
    if not isinstance(entry, dict):
        refuse(where, "a JSON object", entry)
    known, end = (
        _known([field.name for field in fields(Stroke)], version),
        "to" if "to" in entry and version > 1 else "by",
    )
    if "brush" in entry:
        choice(f"{where}: brush", entry["brush"], get_args(Brush))
    needed = {"twist": "angle", "scale": "factor", "pinch": "factor", "freeze": "matte"}.get(
        str(entry.get("brush")), end
    )
    _check_keys(where, entry, [*known, "to"] if version > 1 else known, ["brush", "at", needed, "radius"])
    if end == "to":
        if "by" in entry:
            raise SuppleError(f'{where} takes one of "to" and "by", found both')
        entry = {**entry, "by": _drag(where, entry["at"], entry["to"])}
        del entry["to"]
    if version == 1:
        entry = {"poisson": POISSON, **entry, "reach": None}
    if version < 3 and entry["brush"] == "twist":
        entry = {**entry, "chord": True}
    if version < 3 and not world and isinstance(entry["at"], list) and len(entry["at"]) == 3:
        entry = {**entry, "isotropic": True}
    if entry.get("poisson") == "-inf":
        entry["poisson"] = -math.inf
    if "keys" in entry:
        entry = {**entry, "keys": _keys(where, entry["keys"], version)}
    try:
        if entry.get("matte") is not None:
            entry = {**entry, "matte": Freeze.from_entry(entry["matte"], "matte")}
        return Stroke(**entry)
    except SuppleError as error:
        raise SuppleError(f"{where}: {error}") from None


def _keys(where: str, entries: object, version: int) -> list[Key]:
    if not isinstance(entries, list):
        refuse(f"{where}: keys", "a list of objects with a frame", entries)
    made = []
    for i, entry in enumerate(entries):
        name = f"{where}: keys[{i}]"
        if not isinstance(entry, dict):
            refuse(name, "an object with a frame, at, strength, angle or scale", entry)
        known = [field.name for field in fields(Key) if version > 2 or field.name not in _OF_KEYS]
        if new := next((key for key in entry if key in _OF_KEYS and key not in known), None):
            raise SuppleError(
                f'unknown key {value_shown(new)} in {name}: it is of version {VERSION} ("supple": {VERSION})'
            )
        _check_keys(name, entry, known, ["frame"])
        try:
            made.append(Key(**entry))
        except SuppleError as error:
            raise SuppleError(f"{name}: {error}") from None
    return made


def _drag(where: str, at: object, to: object) -> tuple[float, ...]:
    try:
        start = point("at", at)
        return tuple(b - a for a, b in zip(start, point("to", to, (len(start),)), strict=True))
    except SuppleError as error:
        raise SuppleError(f"{where}: {error}") from None


def _check_keys(where: str, entry: dict[str, object], known: list[str], required: list[str]) -> None:
    for key in entry:
        if key not in known:
            import difflib

            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}"
            if key in (*_NEW, *_NEWER):
                version = 2 if key in _NEW else VERSION
                hint = f'it is of version {version} ("supple": {version})'
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
