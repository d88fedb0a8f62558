"""The choice of an encoder's pixel format that is nearest to a clip's, and its losses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from supple.media.files import PathLike, unwritable
from supple.media.video.colour import BT601, BT709, FULL, LIMITED, RGB, UNKNOWN, Colour
from supple.media.video.planes import Form, Kind, form

_CHROMA = {(1, 1): "4:4:4", (2, 1): "4:2:2", (2, 2): "4:2:0", (4, 1): "4:1:1", (4, 4): "4:1:0", (1, 2): "4:4:0"}


@dataclass(frozen=True, slots=True)
class Match:
    """The form in which frames are passed to an encoder."""

    form: Form  # the encoder's pixel format
    colour: Colour  # the interpretation of its samples
    same: bool  # whether samples are unchanged
    lost: str  # losses, except opacity
    opacity: bool  # whether opacity, if any, is lost


@dataclass(frozen=True, slots=True)
class Wish:
    """The requirements on a pixel format."""

    form: Form  # the layout of the frames
    colour: Colour  # the interpretation of their samples
    size: tuple[int, int]  # width and height
    exact: bool = True  # whether to keep all; if not, the players' usual format is as good
    # the players' interpretation of YUV, as far as the file cannot specify it
    read_as: Colour = field(default_factory=Colour)


def match(
    target: PathLike, encoder: str, names: list[str], wish: Wish, asked: str | None, opens: Callable[[Match], bool]
) -> Match:
    """Return the pixel format in which an encoder takes a clip: its own, else the nearest with the least loss.

    `names` are its supported formats, empty for any; `asked` is the user's; `opens` tests if it opens with a match.
    SuppleError if it does not support the user's format, or none at this size.
    """
    source, colour = wish.form, wish.colour
    forms = [found for name in (names or [source.name]) if (found := form(name)) is not None]
    if asked is not None:
        wanted = form(asked) or form(asked + "le")
        if wanted is None or (names and wanted.name not in names):
            usable = ", ".join(found.name for found in forms)
            raise unwritable(target, f"{encoder} does not take the pixel format {asked!r}", f"use {usable}")
        forms = [wanted]
    forms.sort(key=lambda found: _cost(source, colour, found))
    size = "{}x{}".format(*wish.size)
    first: Match | None = None
    for found in forms:
        made = _matched(wish, found)
        if opens(made):
            usual = first is not None and (first.same or (not wish.exact and first.opacity == made.opacity))
            if first is not None and not made.lost and usual:
                made = replace(made, lost=f"{first.form.name}, which {encoder} does not take at {size}")
            return made
        first = first or made
    advice = "use another pixel format" if asked is not None else "use another codec, such as ffv1 in .mkv"
    what = f" in {asked}" if asked is not None else ""
    raise unwritable(target, f"{encoder} does not take frames of {size}{what}", advice)


def _cost(source: Form, colour: Colour, to: Form) -> tuple[float, ...]:
    """Return the sort key of a format: by loss, then by size, then by difference from the source."""
    a, b = source.kind, to.kind
    chroma = (b.step[0] * b.step[1]) / (a.step[0] * a.step[1])
    recoded = colour.full(source) != colour.full(to) and to.name.startswith("yuvj")
    coarser = chroma if _coarser(a, b) else 0.0
    if a.family == "rgb" and b.family == "yuv":  # supported by every player
        coarser = chroma = abs(4 - b.step[0] * b.step[1])
    return (
        float(a.alpha and not b.alpha),
        float(_colourless(a, b)),
        float(_pictured(a, colour) and b.family == "yuv"),
        coarser,
        max(0, _depth(a) - _depth(b)),
        float(recoded),
        float(b.alpha and not a.alpha),
        float(a.family != b.family),
        -chroma,
        _depth(b) - _depth(a),
        float(a.real != b.real),
        float(to.name != source.name),
        float(len({place.plane for place in to.places}) != len({place.plane for place in source.places})),
    )


def _depth(kind: Kind) -> float:
    return {16: 11.5, 32: 24.0}[kind.bits] if kind.real else kind.bits


def _colourless(a: Kind, b: Kind) -> bool:
    return (a.family != "gray" and b.family == "gray") or (a.family == "xyz") != (b.family == "xyz")


def _coarser(a: Kind, b: Kind) -> bool:
    return a.family in ("rgb", "yuv") and b.family == "yuv" and (b.step[0] > a.step[0] or b.step[1] > a.step[1])


def _losses(a: Kind, b: Kind, exact: bool) -> str:
    words = []
    if _colourless(a, b):
        words.append("its colours")
    elif _coarser(a, b):
        words.append(f"detail of colours (to {_CHROMA.get(b.step, 'less')})")
    elif a.family == "yuv" and b.family == "rgb":
        words.append("exact values (to RGB)")
    if exact and a.family == "rgb" and b.family == "yuv":
        words.append("exact values (to YUV)")
    if _depth(b) < _depth(a):
        words.append(f"depth ({a.bits}{' real' if a.real else ''} to {b.bits} bits)")
    return " and ".join(words)


def finer(source: Form, chosen: Match, names: list[str], opens: Callable[[Match], bool]) -> str:
    """Return a pixel format that keeps more than the chosen one; empty if there is none."""

    def cost(kind: Kind) -> tuple[float, ...]:
        chroma = kind.step[0] * kind.step[1] if kind.family == "yuv" and _coarser(source.kind, kind) else 1
        other = source.kind.family == "rgb" != kind.family
        missing = max(0.0, _depth(source.kind) - _depth(kind))
        return (source.kind.alpha and not kind.alpha, _colourless(source.kind, kind), chroma, missing, other)

    found = [each for name in names if (each := form(name)) is not None and name.startswith(("yuv", "gbr", "rgb"))]
    better = [each for each in found if not each.name.startswith("yuvj") and cost(each.kind) < cost(chosen.form.kind)]
    better.sort(key=lambda each: (cost(each.kind), _depth(each.kind)))
    return next((each.name for each in better if opens(replace(chosen, form=each))), "")


def _pictured(kind: Kind, colour: Colour) -> bool:
    """Return whether it is RGB, or the grey of images, which is that of RGB."""
    return kind.family == "rgb" or (kind.family == "gray" and colour.matrix == RGB)


def _matched(wish: Wish, to: Form) -> Match:
    source, colour = wish.form, wish.colour
    whole = to.name.startswith("yuvj")
    same = source.kind == to.kind and not (whole and not colour.full(source))
    meant = colour.valid()
    lost = _losses(source.kind, to.kind, wish.exact)
    if to.kind.family in ("rgb", "xyz"):
        meant = replace(meant, range=FULL if to.kind.family == "rgb" else meant.range, matrix=RGB, site="")
    elif to.kind.family == "gray" and source.kind.family != "gray":
        meant = replace(meant, range=FULL)  # the only grey of libswscale
    elif to.kind.family == "yuv" and _pictured(source.kind, colour):
        meant = replace(meant, range=FULL if whole else LIMITED, matrix=BT709)
    elif meant.matrix == RGB:
        meant = replace(meant, matrix=UNKNOWN)
    if whole or source.name.startswith("yuvj"):
        meant = replace(meant, range=FULL)
    moved = "to full range" if whole and not colour.full(source) else ""
    if to.kind.family == "yuv":
        told = wish.read_as
        if told.range == LIMITED and meant.full(to) and not whole:
            meant, moved = replace(meant, range=LIMITED), "to limited range"
        height = wish.size[1]
        if told.matrix != UNKNOWN and _five(told.matrix) != _five(meant.coefficients(height)):
            meant = replace(meant, matrix=told.matrix)
            moved = moved or "to another matrix"
    if moved and source.kind.family == "yuv":
        same, lost = False, lost or f"exact values ({moved})"
    return Match(to, meant, same, lost, source.kind.alpha and not to.kind.alpha)


def _five(matrix: int) -> int:
    """Return one code for the two of BT.601's matrix."""
    return BT601 if matrix == 5 else matrix
