"""What a file holds, in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from supple.media.files import shown
from supple.strokes import Recipe


def describe(name: str) -> tuple[dict[str, Any], str]:
    """Describe a picture, or a recipe.

    Parameters
    ----------
    name : str
        A picture file; or a recipe, whose name ends in .json.

    Returns
    -------
    dict
        The facts, ready for JSON.
    str
        The same for people, on several lines.

    Raises
    ------
    SuppleError
        If it is neither.
    """
    if Path(name).suffix.lower() == ".json":
        from supple.files import read_recipe

        recipe = read_recipe(name)
        return {"file": name, "kind": "recipe", **json.loads(recipe.to_json())}, _recipe(name, recipe)
    from supple.media.image import info

    facts = info(name)
    return {"file": name, "kind": "image", **facts}, _picture(name, facts)


def _picture(name: str, facts: dict[str, Any]) -> str:
    channels = int(facts["channels"])
    depth = f"{facts['bits']} bit{' float' if str(facts['dtype']).startswith('float') else ''}"
    lines = {
        "format": facts["format"],
        "size": f"{facts['width']} x {facts['height']}",
        "channels": f"{channels}{', the last is opacity' if facts['alpha'] else ''} ({facts['interpretation']})",
        "depth": depth,
        "profile": facts["profile"] or "none",
        "bytes": f"{facts['bytes']:,}",
    }
    if facts["orientation"] != 1:
        lines["orientation"] = f"{facts['orientation']}, applied when it is read"
    if facts["pages"] != 1:
        lines["pages"] = f"{facts['pages']}, of which one is read"
    return "\n".join([f"{shown(name)}:", *(f"  {key:<12}{value}" for key, value in lines.items())])


def _recipe(name: str, recipe: Recipe) -> str:
    border = "free" if recipe.border is None else f"fixed, {recipe.border:g} px wide"
    lines = [f"{shown(name)}:", "  recipe", f"  border      {border}", f"  on fold     {recipe.on_fold}"]
    for i, s in enumerate(recipe.strokes):
        to = tuple(a + b for a, b in zip(s.at, s.by, strict=True))
        points = " to ".join("(" + ", ".join(f"{x:g}" for x in point) + ")" for point in (s.at, to))
        kind = f"radius {s.radius:g}, poisson {s.poisson:g}, scales {s.scales}"
        lines.append(f"  stroke {i + 1:<5}{s.brush} {points}, {kind}")
    return "\n".join(lines)
