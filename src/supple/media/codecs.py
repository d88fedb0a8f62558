"""The tables of video containers, codecs, and encoders with their options."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

Options = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Container:
    """A kind of file."""

    name: str  # in FFmpeg
    suffixes: tuple[str, ...]  # the first is the default
    usual: str  # the default codec
    exact: str = ""  # the codec for lossless output
    keeping: str = ""  # the codec if the source's is lossless, but cannot be written
    longest: float = math.inf  # ticks of the longest frame
    tick: Fraction = Fraction(0)  # seconds; 0 for any
    chapters: bool = True  # whether it holds chapters
    rotation: bool = True  # whether it holds the rotation for display
    fields: bool = True  # whether it holds the order of fields, of any codec
    counted: bool = False  # whether it has one rate instead of times, and no colour tags
    mp4: bool = False  # whether it holds the pixel aspect ratio itself, and adds up the durations of packets
    attachments: bool = False  # whether it holds files, and a cover as one of these
    timecode: bool = True  # whether it holds the timecode of the first frame
    loops: bool = False  # whether it stores the number of times that it plays
    refused: frozenset[str] = frozenset()  # codecs that FFmpeg lists for it, and then refuses
    streams: frozenset[str] | None = None  # the supported codecs: others would be written, but hardly play
    options: Options = field(default_factory=dict)  # for every encoder


_WEBM = frozenset(("vp8", "vp9", "av1", "opus", "vorbis", "webvtt"))
# fmt: off
CONTAINERS = (
    Container("mp4", (".mp4", ".m4v"), "h264", "ffv1", longest=2**31 - 1, mp4=True),
    Container("mov", (".mov",), "h264", "h264", longest=2**31 - 1, mp4=True, refused=frozenset(("vp8", "vp9", "av1"))),
    Container("matroska", (".mkv",), "h264", "ffv1", "ffv1", attachments=True, refused=frozenset(("rv10", "rv20"))),
    Container("webm", (".webm",), "vp9", fields=False, streams=_WEBM),
    Container("avi", (".avi",), "mpeg4", "ffv1", "ffv1", chapters=False, rotation=False, fields=False, counted=True,
              options={"bf": "0"}),
    Container("gif", (".gif",), "gif", longest=65535, tick=Fraction(1, 100), chapters=False, rotation=False,
              fields=False, timecode=False, loops=True),
)
# fmt: on
_ALL = frozenset(container.name for container in CONTAINERS)


@dataclass(frozen=True, slots=True)
class Codec:
    """A codec, for any encoder or decoder."""

    encoder: str = ""  # the default encoder; empty if there is none
    colours: bool = False  # whether its stream has colour tags
    aspect: bool = False  # whether it has the pixel aspect ratio
    limited_in: frozenset[str] = frozenset()  # containers in which players ignore its full range
    opaque_in: frozenset[str] = frozenset()  # containers in which its opacity is lost
    opacity: str = ""  # the decoder that keeps opacity if FFmpeg's own drops it
    bt601: bool = False  # whether players assume the matrix of BT.601
    centred: bool = False  # whether the chroma of 4:2:0 is sited in the centre of its pixels
    # whether key frames depend only on the stream header, and may follow those of another encoder
    alone: bool = False
    hides: bool = False  # whether it has packets without a visible frame


_OPAQUE = _ALL - {"matroska", "webm"}
CODECS = {
    "h264": Codec("libx264", colours=True, aspect=True),
    "hevc": Codec("libx265", colours=True, aspect=True, opaque_in=_ALL),
    "vp9": Codec("libvpx-vp9", colours=True, opaque_in=_OPAQUE, opacity="libvpx-vp9", hides=True),
    "vp8": Codec("libvpx", limited_in=_ALL, opaque_in=_OPAQUE, opacity="libvpx", bt601=True, centred=True, hides=True),
    "av1": Codec("libsvtav1", colours=True, hides=True),
    "prores": Codec("prores_ks", colours=True, limited_in=_ALL, alone=True),
    "ffv1": Codec("ffv1", alone=True),
    "dnxhd": Codec(alone=True),
    "mpeg4": Codec("mpeg4", aspect=True, limited_in=frozenset(("mov",))),
    "mpeg2video": Codec("mpeg2video", colours=True, aspect=True, limited_in=_ALL),
    "mjpeg": Codec("mjpeg", aspect=True, bt601=True, centred=True, alone=True),
    "png": Codec("png", centred=True),
    "qtrle": Codec("qtrle"),
    "huffyuv": Codec("huffyuv"),
    "utvideo": Codec("utvideo"),
    "gif": Codec("gif"),
    "mpeg1video": Codec(aspect=True, centred=True),
    **dict.fromkeys(("jpeg2000", "webp", "theora", "h263", "h261", "flv1"), Codec(centred=True)),
}
ALIASES = {"h265": "hevc", "x264": "h264", "x265": "hevc", "avc": "h264", "mpeg2": "mpeg2video", "vp09": "vp9"}


@dataclass(frozen=True, slots=True)
class Encoder:
    """An encoder and its settings, in FFmpeg's terms."""

    name: str  # in FFmpeg
    codec: str  # the codec of its output
    crf: tuple[float, float, float] | None = None  # the best, the worst and the default constant rate factor
    drawn: float | None = None  # the default factor for drawings, which have no noise
    presets: tuple[str, ...] = ()  # of speed
    preset: str = ""  # the default preset
    options: Options = field(default_factory=dict)  # for all output
    exact: Options | None = None  # the options for lossless output
    params: str = ""  # the option for the encoder's own parameters
    threads: str = ""  # the parameters for the number of threads
    graded: tuple[str, str] | None = None  # the parameters of HDR: mastering display, and brightest pixel
    # whether it takes any times; others count frames, and times are set on their packets afterwards
    timed: bool = False
    profiles: Options = field(default_factory=dict)  # names of the profiles that FFmpeg decodes
    fields: bool = False  # whether it codes interlaced frames


_SPEEDS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo")
_FINE = {"qmin": "2", "qmax": "3", "b": "400000000", "maxrate": "0"}  # near the best quality, without a crf
_VPX = {"deadline": "good", "cpu-used": "2"}
_X264 = Encoder(
    "libx264rgb", "h264", (0, 51, 18), presets=_SPEEDS, preset="medium", exact={"qp": "0"}, timed=True, fields=True
)
_PRORES = {"Proxy": "proxy", "LT": "lt", "Standard": "standard", "HQ": "hq", "4444": "4444", "XQ": "4444xq"}
# fmt: off
_ROWS = (
    replace(_X264, name="libx264", drawn=16, params="x264-params", graded=("mastering-display", "cll")),
    _X264,  # exact by its qp: a crf of 0 is exact in 8 bits only
    Encoder("libx265", "hevc", (0, 51, 20), presets=_SPEEDS, preset="medium", exact={"x265-params": "lossless=1"},
            params="x265-params", threads="log-level=none:pools={}", graded=("master-display", "max-cll"), timed=True),
    Encoder("libvpx-vp9", "vp9", (0, 63, 24), drawn=20, options={**_VPX, "b": "0", "row-mt": "1"},
            exact={"lossless": "1"}, timed=True),
    Encoder("libvpx", "vp8", (4, 63, 10), options={**_VPX, "b": "100000000"}, timed=True),
    Encoder("libsvtav1", "av1", (1, 63, 25), presets=tuple(map(str, range(14))), preset="8",
            exact={"svtav1-params": "lossless=1"}, params="svtav1-params", threads="lp={}",
            graded=("mastering-display", "content-light"), timed=True),
    Encoder("prores_ks", "prores", profiles=_PRORES, fields=True),
    Encoder("dnxhd", "dnxhd", profiles={"DNXHR LB": "dnxhr_lb", "DNXHR SQ": "dnxhr_sq"}, fields=True),
    Encoder("ffv1", "ffv1", options={"slicecrc": "1", "g": "1", "strict": "experimental"}, exact={}, fields=True),
    Encoder("flv", "flv1", options=_FINE),
    Encoder("msmpeg4", "msmpeg4v3", options=_FINE),
    Encoder("dvvideo", "dvvideo", fields=True),
    *(Encoder(name, name, options=_FINE, fields=name in ("mpeg4", "mpeg2video"))
      for name in ("mpeg4", "mpeg2video", "mpeg1video", "mjpeg", "h263p", "msmpeg4v2", "wmv1", "wmv2")),
)
# fmt: on
ENCODERS = {encoder.name: encoder for encoder in _ROWS}
HASTY, FINE_CRF = 11, 8  # from this preset on and below this crf, SVT-AV1 writes streams that no decoder reads

# The pixel formats of images as frames: by dtype, for one to four channels.
STILLS = {
    "uint8": ("gray", "ya8", "rgb24", "rgba"),
    "uint16": ("gray16le", "ya16le", "rgb48le", "rgba64le"),
    "float32": ("grayf32le", "yaf32le", "gbrpf32le", "gbrapf32le"),
}
USUAL_BITS = 10  # the most that players support: lossy codecs use no more for images


def codec_of(name: str) -> Codec:
    """Return the entry of a codec; an empty one if it is not in the table."""
    return CODECS.get(name, Codec())
