"""Descriptions of files, for `supple info`."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from supple.errors import SuppleError, listing, shown
from supple.files.clips import displayed
from supple.folding.resolved import described, spelled
from supple.media.numbering import is_sequence
from supple.media.pictures import SUFFIXES as PICTURES
from supple.media.suffixes import CLIPS, FORMATS, suffix_of
from supple.media.timecode import Numbering
from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke, spoken

# The names of colour codes in ITU-T H.273.
_PRIMARIES = {1: "BT.709", 4: "BT.470 M", 5: "BT.601 (625)", 6: "BT.601 (525)", 7: "SMPTE 240M", 8: "film"}
_PRIMARIES |= {9: "BT.2020", 10: "XYZ", 11: "DCI-P3", 12: "Display P3", 22: "EBU 3213"}
_TRANSFERS = {1: "BT.709", 4: "gamma 2.2", 5: "gamma 2.8", 6: "BT.601", 7: "SMPTE 240M", 8: "linear"}
_TRANSFERS |= {11: "xvYCC", 13: "sRGB", 14: "BT.2020", 15: "BT.2020", 16: "PQ", 17: "SMPTE 428", 18: "HLG"}
_MATRICES = {0: "RGB", 1: "BT.709", 4: "FCC", 5: "BT.601", 6: "BT.601", 7: "SMPTE 240M", 8: "YCgCo"}
_MATRICES |= {9: "BT.2020", 10: "BT.2020 constant", 14: "ICtCp"}
_TAGS = {"primaries": _PRIMARIES, "transfer": _TRANSFERS, "matrix": _MATRICES}


def describe(name: str, how: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Return the facts on a file, ready for JSON, and the same as text of several lines.

    ``how`` has options of `supple.media.volume.read`. SuppleError if it is no picture, video, image sequence, volume,
    Zarr store or recipe (.json).
    """
    suffix = suffix_of(name)
    if suffix == ".json":
        from supple.files.recipes import read_recipe

        recipe = read_recipe(name)
        return {"file": name, "kind": "recipe", **json.loads(recipe.to_json())}, _recipe(name, recipe)
    from supple.media import volume
    from supple.media.files import is_store

    if is_store(name) and "raw" not in how:
        return _stored(name)
    if {"raw", "series"} & {*how} or volume.is_volume(name):
        facts = volume.info(name, **how)
        if facts.get("format") == "NIfTI" and facts.get("components") == 3:
            facts |= _field(name)
        return {"file": name, "kind": "volume", **facts}, _volume(name, facts)
    if is_sequence(name) and not os.path.isfile(name):
        from supple.media import sequence

        try:
            with sequence.open_clip(name) as clip:
                facts = clip.info()
        except SuppleError as refused:
            if os.path.isdir(name) and (found := _folder(name, refused)) is not None:
                return found
            raise
        return {"file": name, "kind": "sequence", **facts}, _picture(name, facts)
    if suffix in CLIPS:
        return _described_video(name)
    from supple.media.image import info

    try:
        facts = info(name)
    except SuppleError as refused:
        with contextlib.suppress(SuppleError):
            return _described_video(name)
        if "no image of a known kind" in str(refused):
            what = "it is no picture, video, volume or recipe of a known kind"
            raise SuppleError(f"cannot read {shown(name)}: {what}: give one of these") from None
        raise
    if facts["format"] in ("GIF", "PNG") and facts["pages"] != 1:
        return _described_video(name)
    return {"file": name, "kind": "image", **facts}, _picture(name, facts)


def _folder(name: str, refused: SuppleError) -> tuple[dict[str, Any], str] | None:
    """Return the facts on a folder that is ``refused`` as a clip, as `describe` does; None if it holds no media."""
    kinds = {"pictures": PICTURES, "videos": CLIPS, "volumes": FORMATS}
    names = sorted(each.name for each in os.scandir(name) if each.name[0] != "." and each.is_file())
    held = {kind: [each for each in names if suffix_of(each) in suffixes] for kind, suffixes in kinds.items()}
    if not any(held.values()):
        return None
    lines = {kind: f"{len(some)}: {listing([*map(shown, some)], 5)}" for kind, some in held.items() if some}
    lines |= {"as a clip": f"no: {refused}"} if held["pictures"] else {}
    return {"file": name, "kind": "folder", **held}, listed(name, {"format": "folder", **lines})


def _stored(name: str) -> tuple[dict[str, Any], str]:
    """Return the facts on a Zarr array or an OME-Zarr image, as `describe` does, without reading samples."""
    from supple.media.stores.image import open_image

    image = open_image(name)
    grid, unit, n = image.grid, "mm" if image.placed else "pixels", len(image.spatial)
    levels: list[dict[str, Any]] = [
        {
            "path": level.path,
            "shape": list(level.array.shape),
            "chunks": list(level.array.chunks),
            "shards": list(level.array.shards) if level.array.shards else None,
            "scale": list(level.scale),
            "translation": list(level.translation),
        }
        for level in image.levels
    ]
    facts: dict[str, Any] = {
        "file": name,
        "kind": "store",
        "format": f"OME-Zarr {image.version}" if image.version else "Zarr array",
        "zarr": image.levels[0].array.metadata.zarr_format,
        "name": image.name,
        "axes": [{"name": axis.name, "type": axis.kind, "unit": axis.unit} for axis in image.axes],
        "space": list(image.spatial),
        "shape": list(image.shape),
        "dtype": str(image.dtype),
        "bytes": image.dtype.itemsize * math.prod(image.shape),
        "spacing": [float(f"{step:.12g}") for step in grid.spacing],
        "origin": [float(f"{start:.12g}") for start in grid.origin],
        "units": unit,
        "levels": levels,
    }
    told = [f"{axis.name or k}{f' ({axis.unit})' if axis.unit else ''}" for k, axis in enumerate(image.axes)]
    lines = {
        "format": f"{facts['format']}, Zarr format {facts['zarr']}",
        "axes": f"{', '.join(told)}: {'a picture' if len(image.spatial) == 2 else 'a volume'}",
        "size": f"{' x '.join(map(str, image.shape))}, in this order",
        "values": str(image.dtype),
        "bytes": f"{facts['bytes']:,}, decoded",
        "spacing": f"{' x '.join(f'{step:.6g}' for step in grid.spacing)} {unit} along x, y{', z' * (n == 3)}",
        "origin": f"{', '.join(f'{start:.6g}' for start in grid.origin)} {unit}",
    }
    if not image.placed and any(image.levels[0].scale[axis] != 1 for axis in image.spatial):
        lines["spacing"] += ": its axes have no units, and their scale is not used"
    for k, level in enumerate(levels):
        shards = f", in shards of {' x '.join(map(str, level['shards']))}" if level["shards"] else ""
        sizes, chunks = (" x ".join(map(str, level[key])) for key in ("shape", "chunks"))
        lines[f"level {k}"] = f"{sizes}, in chunks of {chunks}{shards}"
    return facts, listed(name, lines)


def _field(name: str) -> dict[str, Any]:
    """Return the facts on the convention of a NIfTI file; empty unless it is certainly a displacement field."""
    from supple.media import transforms

    try:
        known = transforms.convention_in(name)
        kind = transforms.CONVENTIONS[known]
        return {"field": known, "field_holds": kind.holds, "field_space": kind.space}
    except SuppleError:
        return {}


def _described_video(name: str) -> tuple[dict[str, Any], str]:
    from supple.media.video import info

    facts = info(name)
    for tag, names in _TAGS.items():
        facts[tag] = names.get(facts[tag], "unknown" if facts[tag] in (2, 3) else str(facts[tag]))
    facts["last_timecode"] = None
    if not facts["variable"]:
        known = Numbering(name, facts["frames"], facts["rate"], start=facts["timecode"] or "")
        with contextlib.suppress(SuppleError):  # the start timecode does not fit the rate
            facts["last_timecode"] = known.timecode(known.count - 1)
    told = {key: str(value) if isinstance(value, Fraction) else value for key, value in facts.items()}
    return {"file": name, "kind": "video", **told}, _video(name, facts)


def _picture(name: str, facts: Mapping[str, Any]) -> str:
    """Return the description of a picture, or of those of a sequence, which have a ``first`` one."""
    first, kind = facts.get("first"), f" ({facts['interpretation']})" if "interpretation" in facts else ""
    depth = f"{facts['bits']} bit{' float' * facts['dtype'].startswith('float')}" if "bits" in facts else facts["dtype"]
    lines = {
        "format": f"{'pictures, ' if first else ''}{facts['format']}",
        "size": f"{facts['width']} x {facts['height']}",
        "frames": f"{facts['frames']}, from {shown(first)} to {shown(facts['last'])}" if first else None,
        "channels": f"{facts['channels']}{', the last is opacity' if facts['alpha'] else ''}{kind}",
        "depth": depth,
        "profile": None if first else facts["profile"] or "none",
        "bytes": None if first else f"{facts['bytes']:,}",
        "orientation": f"{facts['orientation']}, applied when it is read" if facts.get("orientation", 1) > 1 else None,
        "pages": facts["pages"] if facts.get("pages", 1) > 1 else None,
    }
    if "layers" in facts:
        boxes = ("{2} x {3} from ({0}, {1})".format(*facts[f"{key}_window"]) for key in ("data", "display"))
        lines["layers"] = (
            f"{listing([*map(shown, facts['layers'])], 24)}; compression {' and '.join(facts['compression'])}"
        )
        lines["windows"] = "data {}, display {}".format(*boxes)
    return listed(name, lines)


def _video(name: str, facts: Mapping[str, Any]) -> str:
    rate, how = facts["rate"], displayed(facts["rotation"], facts["mirrored"])
    exact = f" ({rate})" if rate.denominator > 1 else ""
    tags = [f"{tag} {facts[tag]}" for tag in ("range", *_TAGS, "siting") if facts[tag] != "unknown"]
    vary = ", at a variable rate" if facts["variable"] else ""
    first, last, plays = facts["timecode"], facts["last_timecode"], facts["plays"]
    code = first or last
    lines = {
        "format": f"{facts['container']}, {facts['codec']}",
        "size": f"{facts['width']} x {facts['height']}",
        "frames": f"{facts['frames']}, {float(rate):.6g} a second{exact}{vary}, {facts['duration']:.3f} s",
        "pixels": f"{facts['pixel_format']}, {facts['bits']} bit{', with opacity' if facts['alpha'] else ''}",
        "colours": ", ".join(tags) or "not said",
        "display": f"{how} when it is played" if how else None,
        "aspect": None if facts["aspect"] == 1 else f"pixels are {facts['aspect']} as wide as high",
        "fields": f"interlaced, {facts['fields']} field first" if facts["interlaced"] else None,
        "timecode": f"{first or 'none: counted from 00:00:00:00'}{f' to {last}' if last else ''}" if code else None,
        "plays": None if plays is None else f"{plays} times" if plays > 1 else "once" if plays else "for ever",
        **{key: ", ".join(facts[key]) or None for key in ("audio", "subtitles", "other")},
        "chapters": facts["chapters"] or None,
        "damage": "it breaks off: what can be decoded of it is used" if facts["damaged"] else None,
    }
    return listed(name, lines)


def _volume(name: str, facts: Mapping[str, Any]) -> str:
    if "series" in facts and "shape" not in facts:
        lines = {
            f"series {one['number']}": f"{one['slices']} slices, {one['description'] or 'no description'}, {one['uid']}"
            for one in facts["series"]
        }
        return listed(name, {"format": "DICOM, several series: choose by --series", **lines})

    convention, (slope, intercept) = facts["convention"], facts["scaling"]
    lines = {
        "format": facts["format"],
        "size": " x ".join(map(str, facts["shape"])) + (f", {facts['times']} times" if facts["times"] > 1 else ""),
        "spacing": f"{' x '.join(f'{s:.6g}' for s in facts['spacing'])} mm",
        "values": facts["dtype"] + (f", {facts['components']} components" if facts["components"] > 1 else ""),
    }
    if "field" in facts:
        held = f"{facts['field_holds']} in {facts['field_space']}"
        lines["field"] = f"{held}, convention {facts['field']}: supple check tells what it does"
    if convention != "array":
        lines["origin"] = f"{', '.join(f'{x:.6g}' for x in facts['origin'])} ({convention})"
        leaning = f", oblique by up to {facts['oblique']:.3g}°" if facts["oblique"] else ""
        lines["axes"] = f"towards {facts['orientation']}{leaning}"
        if facts["shear"]:
            lines["axes"] += f", sheared: {facts['shear']:.3g}° from right angles to each other"
    if facts["minimum"] is not None:
        low, high = sorted(slope * facts[end] + intercept for end in ("minimum", "maximum"))
        lines["range"] = f"{low:.6g} to {high:.6g} {facts.get('unit', '')}".rstrip()
    if (slope, intercept) != (1.0, 0.0):
        lines["scaling"] = f"{slope:g} times what is stored, and {intercept:g}"
    if facts["nan"]:
        lines["gaps"] = f"{facts['nan']} voxels are not a number"
    if facts["interval"] is not None:
        lines["interval"] = f"{facts['interval']:g} s"
    return listed(name, lines)


def listed(name: str, lines: Mapping[str, object]) -> str:
    """Return facts as text, one line each, without those that are None."""
    told = (f"  {key:<12}{value}" for key, value in lines.items() if value is not None)
    return "\n".join([f"{shown(name)}:", *told])


def _recipe(name: str, recipe: Recipe) -> str:
    widths = recipe.border if isinstance(recipe.border, tuple) else (recipe.border,)
    border = "a tenth of each side" if recipe.border == "auto" else ", ".join(f"{width:g}" for width in widths if width)
    how = recipe.straighten
    straighten = None
    if how is not None:
        done = [f"turn {how.rotate:g}\u00b0"] if how.rotate else []
        done += ["shear {:g}\u00b0, {:g}\u00b0".format(*how.shear)] if any(how.shear) else []
        done += ["keystone " + " ".join(",".join(f"{v:g}" for v in p) for p in how.keystone)] if how.keystone else []
        done += ["size " + " x ".join(map(str, how.scale_to))] if how.scale_to else []
        straighten = "; ".join([*done, how.fit])
    lines = {
        "format": "recipe",
        "made for": "any size" if recipe.size is None else spoken(recipe.size),
        "points": f"millimetres in {recipe.space}" if recipe.is_world else recipe.space or "not said: pixels, usually",
        "border": "free" if recipe.border is None else f"fixed, {border} wide, {recipe.border_profile}",
        "on fold": recipe.on_fold,
        "amount": f"{100 * recipe.amount:g}%",
        "freeze": _mask(recipe.freeze),
        "straighten": straighten,
        "a frame": None if recipe.time_scale is None else f"is worth {recipe.time_scale:g} pixels",
    }
    return listed(name, lines | {f"stroke {i + 1}": _stroke(stroke) for i, stroke in enumerate(recipe.strokes)})


def _mask(mask: Freeze | None) -> str | None:
    return None if mask is None else f"{100 * mask.share:.0f}% of {spoken(mask.samples)}"


def _stroke(s: Stroke) -> str:
    """Return the description of a stroke, with those of its parameters that are not defaults."""
    parts: dict[str, object]
    if s.brush == "freeze":
        parts = {described(s): True, str(_mask(s.matte)): True}
    else:
        parts = {
            described(s): True,
            f"through {len(s.path)} points": s.path,
            f"reach {'none' if s.reach is None else format(s.reach, 'g')}": True,
            f"{s.time_radius or 0:g} frames in time": s.time_radius is not None,
            "as long in time as in space": s.isotropic,
            f"scales {s.scales}": s.brush == "grab",
            f"flat {s.flat:g}": s.flat,
            f"axis {spelled(s.axis or ())}": s.axis is not None,
            f"poisson {s.poisson or 0:g}": s.poisson is not None,
            f"strength {100 * s.strength:g}%": s.strength != 1,
            _motion(s): s.keys,
            f"named {shown(s.name or '')}": s.name is not None and not s.also,
        }
    return ", ".join([*(text for text, said in parts.items() if said), *["hidden"] * s.hidden])


def _motion(stroke: Stroke) -> str:
    """Return the description of the frames in which a stroke moves, turns and grows, or changes its strength."""
    told = []
    for what, names in (("moving", ["at"]), ("turning", ["angle", "scale"]), ("changing its strength", ["strength"])):
        if frames := [key.frame for key in stroke.keys if any(getattr(key, name) is not None for name in names)]:
            several = f"in frames {frames[0]} to {frames[-1]}, {len(frames)} keys"
            told.append(f"{what} {several if len(frames) > 1 else f'from {frames[0]} on'}")
    return ", ".join(told)
