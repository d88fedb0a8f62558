"""The interpretation of a clip's samples: colours, chroma siting, rotation, and HDR mastering."""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import av
import av.logging
import numpy as np
from av.filter import Graph

from supple.engine.work import Array
from supple.media.codecs import codec_of
from supple.media.video.planes import Form, Kind, form, pack

LIMITED, FULL = 1, 2  # AVCOL_RANGE_MPEG, AVCOL_RANGE_JPEG
RGB, BT709, UNKNOWN, BT601, BT2020 = 0, 1, 2, 6, 9  # AVColorSpace
_RESERVED = (0, 3)  # of primaries and transfers
_BT2020_PRIMARIES, _PQ, _HLG = 9, 16, 18
_LEVEL, _USUAL = 40, 32  # AV_LOG_VERBOSE reports the chroma siting; AV_LOG_INFO is the default
# the first chroma sample's position, x first: 0 at the top left luma sample, 1 at the middle of its block of pixels
_SITES = {
    "left": (0.0, 1.0), "center": (1.0, 1.0), "topleft": (0.0, 0.0), "top": (1.0, 0.0),
    "bottomleft": (0.0, 2.0), "bottom": (1.0, 2.0),
}  # fmt: skip
_WEIGHTS = {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "fcc": (0.3, 0.11), "smpte240m": (0.212, 0.087)}
_WEIGHTS["bt2020"] = (0.2627, 0.0593)  # of red and blue in luma
_FLAGS = "bicubic+accurate_rnd+full_chroma_int+full_chroma_inp"
_lock = threading.Lock()


@dataclass(frozen=True, slots=True)
class Colour:
    """The colours of a clip, in the codes that FFmpeg shares with ITU-T H.273."""

    range: int = 0  # 0 for unknown
    primaries: int = UNKNOWN
    transfer: int = UNKNOWN
    matrix: int = UNKNOWN
    site: str = ""  # "left", "topleft", ...; empty for unknown

    def full(self, form: Form) -> bool:
        """Return whether samples have full range."""
        return self.range == FULL or form.name.startswith("yuvj") or form.kind.family in ("rgb", "xyz")

    def coefficients(self, height: int) -> int:
        """Return the matrix; by default BT.601 below 720 lines, and BT.709 from there on."""
        if self.matrix in (RGB, UNKNOWN, 3):
            return BT709 if height >= 720 else BT601
        return self.matrix

    def valid(self) -> Colour:
        """Return a copy without values that no encoder accepts."""
        primaries = UNKNOWN if self.primaries in _RESERVED else self.primaries
        transfer = UNKNOWN if self.transfer in _RESERVED else self.transfer
        return replace(
            self, primaries=primaries, transfer=transfer, matrix=UNKNOWN if self.matrix == 3 else self.matrix
        )

    def mark(self, frame: av.VideoFrame) -> None:
        """Tag a frame with the colours."""
        frame.color_range, frame.colorspace = self.range, self.matrix
        frame.color_primaries, frame.color_trc = self.primaries, self.transfer


# Kept: PyAV gives neither chroma siting (test_siting_is_read_and_written) nor the values of side data.
def described(container: av.container.Container, index: int) -> str:
    """Return FFmpeg's description of a stream; some of it, such as the chroma siting, is not available otherwise."""
    with _lock:  # the level is global
        level = av.logging.get_level()
        try:
            av.logging.set_level(av.logging.INFO)
            av.logging.set_libav_level(_LEVEL)
            text: str = container.dumps_format()  # type: ignore[attr-defined]
        finally:
            av.logging.set_libav_level(_USUAL)
            av.logging.set_level(level)
    found = re.search(rf"^ *Stream #0:{index}\b.*?: [A-Z]\w+: (.*)$", text, re.MULTILINE)
    return found.group(1) if found else ""


def named_site(description: str) -> str:
    """Return the chroma siting in a stream's description; empty if it has none."""
    words = ", ".join(re.findall(r"\(([^()]*)\)", description)).split(", ")
    return next((word for word in words if word in _SITES), "")


def sited(colour: Colour, codec: str, kind: Kind) -> str:
    """Return the chroma siting: the file's, or the codec's default.

    Default for 4:2:0: the centre of the pixels for codecs that are `centred`; the top left for HEVC and AV1 with the
    colours of BT.2020; the left for all others (MPEG-2, H.264, HEVC, VP9, AV1).
    """
    x, y = kind.step
    if colour.site:
        return colour.site
    if codec_of(codec).centred and x == y:
        return "center"
    if colour.primaries == _BT2020_PRIMARIES and colour.transfer in (_PQ, _HLG) and codec in ("hevc", "av1"):
        return "topleft"
    return "left"


def siting(site: str, kind: Kind) -> tuple[float, float]:
    """Return the position of the first chroma sample, in pixels of the frame.

    For 4:2:0 at the left, it is (0, 0.5). For 4:2:2 and 4:1:1, it is the leftmost of its pixels, (0, 0); for 4:4:0,
    between two lines, (0, 0.5).
    """
    x, y = kind.step
    across, down = _SITES[site]
    return across * (x - 1) / 2, down * (y - 1) / 2


def black(form: Form, colour: Colour) -> tuple[float, ...]:
    """Return the components of black, in the order of a layout's groups, with an opacity of 0."""
    return painted(form, colour, 0, [0.0] * (3 + form.kind.alpha))


def painted(form: Form, colour: Colour, height: int, values: Sequence[float]) -> tuple[float, ...]:
    """Convert an RGB or grey colour, with values from 0 to the largest sample, to components in the order of `black`.

    Opacity may be the last value.
    """
    kind = form.kind
    colours = 3 if len(values) > 2 else 1
    rgb, opacity = [values[c % colours] for c in range(3)], values[colours:]
    if kind.family in ("rgb", "xyz"):
        return (*rgb, *opacity)
    full = colour.range != LIMITED if kind.family == "gray" else colour.full(form)
    unit = 1.0 if kind.real else 2.0 ** (kind.bits - 8)
    low, luma, chroma = (0.0, kind.white, kind.white) if full or kind.real else (16 * unit, 219 * unit, 224 * unit)
    red, blue = _WEIGHTS.get(_swscale(colour.coefficients(height)), _WEIGHTS["bt601"])
    r, g, b = (value / kind.white for value in rgb)
    y = red * r + (1 - red - blue) * g + blue * b
    if kind.family == "gray":
        return (low + luma * y, *opacity)
    middle = 2.0 ** (kind.bits - 1)
    u, v = (middle + chroma * (c - y) / (2 - 2 * weight) for c, weight in ((b, blue), (r, red)))
    return (low + luma * y, *(opacity if kind.step != (1, 1) else ()), u, v, *opacity)


def to_rgb(arrays: Sequence[Array], staging: Form, colour: Colour, shape: tuple[int, int], deep: bool = False) -> Array:
    """Return a frame as RGB of 8 bits, or of 16 if `deep`, without opacity; its own matrix and range are used."""
    height, width = shape
    if staging.kind.family == "gray" and colour.range == LIMITED:  # libswscale does not support it
        white, low, unit = 65535 if deep else 255, *(level * 2.0 ** (staging.kind.bits - 8) for level in (16, 219))
        grey = np.clip((arrays[0][..., :1] - np.float32(low)) * np.float32(white / unit) + 0.5, 0, white)
        return np.repeat(grey.astype(np.uint16 if deep else np.uint8), 3, axis=2)
    # 16 bits: in 8, libswscale dithers, and very bright colours become black
    wide = deep or staging.kind.family == "yuv" or staging.kind.bits > 8
    goal, item = (form("rgb48le"), "<u2") if wide else (form("rgb24"), "u1")
    assert goal is not None
    frame = recast(arrays, staging, colour, goal, Colour(FULL, matrix=RGB), shape)
    plane: Any = frame.planes[0]
    rows = np.frombuffer(plane, item).reshape(height, -1)
    pixels = rows[:, : 3 * width].reshape(height, width, 3)
    if wide and not deep:
        return ((pixels + np.uint32(128)) // np.uint32(257)).astype(np.uint8)
    return pixels.astype(np.uint16 if deep else np.uint8)


def recast(
    arrays: Sequence[Array], staging: Form, colour: Colour, target: Form, meant: Colour, shape: tuple[int, int]
) -> av.VideoFrame:
    """Return a frame of one pixel format and interpretation from arrays of another."""
    height, width = shape
    yuv = ("yuv", "gray")
    full, wanted = colour.full(staging), meant.full(target)
    if staging.kind.family == "gray":  # libswscale always assumes full range for grey
        full, wanted = True, wanted or not (colour.range == FULL and meant.range == LIMITED)
    source = colour.coefficients(height) if staging.kind.family in yuv else meant.coefficients(height)
    goal = meant.coefficients(height) if target.kind.family in yuv else source
    settings = {
        "in_color_matrix": _swscale(source),
        "out_color_matrix": _swscale(goal),
        "in_range": "full" if full else "limited",
        "out_range": "full" if wanted else "limited",
        "in_chroma_loc": colour.site or "left",
        "out_chroma_loc": meant.site or "left",
        "flags": _FLAGS,
    }
    frame = pack(arrays, staging, av.VideoFrame(width, height, staging.name))
    scale = ":".join(f"{key}={value}" for key, value in settings.items())  # `reformat` would ignore the chroma siting
    made = filtered(frame, ("scale", scale), ("format", f"pix_fmts={target.name}"))
    assert made is not None
    meant.mark(made)
    return made


def filtered(frame: av.VideoFrame, *filters: tuple[str, str]) -> av.VideoFrame | None:
    """Return a frame that has passed filters, each with its arguments; None if they drop it."""
    graph = Graph()
    frame.pts, frame.time_base = 0, Fraction(1, 25)
    first = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    rest = (graph.add(name, arguments or None) for name, arguments in (*filters, ("buffersink", "")))
    graph.link_nodes(first, *rest).configure()
    graph.vpush(frame)
    try:
        return graph.vpull()
    except av.error.BlockingIOError:
        return None


# Kept: PyAV neither reads nor sets which field is first (test_field_order_comes_through).
def first_field(frame: av.VideoFrame) -> str:
    """Return the field of an interlaced frame that is shown first, "top" or "bottom"; else an empty string."""
    if not frame.interlaced_frame:
        return ""
    return "top" if filtered(frame, ("select", "eq(interlace_type,TOPFIRST)")) else "bottom"


def _swscale(matrix: int) -> str:
    """Return libswscale's name of the matrix."""
    return {BT709: "bt709", 4: "fcc", 7: "smpte240m", BT2020: "bt2020", 10: "bt2020"}.get(matrix, "bt601")


@dataclass(frozen=True, slots=True)
class Grading:
    """The mastering display of a clip, and its light level (SMPTE ST 2086, CTA-861.3)."""

    # red x, y, green, blue and white in 1/50000; darkest and brightest in 1/10000 cd/m²
    screen: tuple[int, ...] | None = None
    light: tuple[int, int] | None = None  # MaxCLL and MaxFALL, in cd/m²

    def words(self, names: tuple[str, str]) -> list[str]:
        """Return the values as parameters of an encoder with these names."""
        made, real = [], names[1] == "content-light"  # SVT-AV1 takes real units, others integers in fractions of these
        if self.screen:
            told = [f"{v / 50000:.5f}" if real else f"{v}" for v in self.screen[:8]]
            dark, bright = (f"{v / 10000:.4f}" if real else f"{v}" for v in self.screen[8:])
            red, green, blue, white = (f"({x},{y})" for x, y in zip(told[::2], told[1::2], strict=True))
            made.append(f"{names[0]}=G{green}B{blue}R{red}WP{white}L({bright},{dark})")
        if self.light:
            made.append(f"{names[1]}={self.light[0]},{self.light[1]}")
        return made


def graded(frame: av.VideoFrame) -> Grading | None:
    """Return the mastering data of a frame; None if it has none."""
    screen = light = None
    data = side_data(frame, "MASTERING_DISPLAY_METADATA")
    if data is not None and len(data) >= 88:
        numbers = np.frombuffer(data, "<i4", 22)
        colours, bright = numbers[20], numbers[21]
        ratios = numbers[:20].reshape(10, 2).astype(float)
        if colours and bright and ratios[:, 1].all():
            values = ratios[:, 0] / ratios[:, 1] * np.array([50000.0] * 8 + [10000.0] * 2)
            screen = tuple(round(value) for value in values)
    data = side_data(frame, "CONTENT_LIGHT_LEVEL")
    if data is not None and len(data) >= 8:
        brightest, average = np.frombuffer(data, "<u4", 2)
        light = (int(brightest), int(average))
    return Grading(screen, light) if screen or light else None


def side_data(frame: av.VideoFrame, kind: str) -> bytes | None:
    """Return the bytes of a frame's side data of a kind; None if it has none."""
    try:
        found: Any = frame.side_data
        return bytes(found[kind])
    except (KeyError, ValueError):  # PyAV fails on unknown kinds
        return None
