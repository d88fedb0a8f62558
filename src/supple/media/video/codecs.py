"""Which encoder writes a clip, and with what settings."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import av

from supple.errors import shown
from supple.media.video.colour import BT601, BT709, LIMITED, UNKNOWN, Colour
from supple.media.video.errors import unwritable

PathLike = str | os.PathLike[str]
SUFFIXES = {
    ".mp4": "mp4",
    ".m4v": "mp4",
    ".mov": "mov",
    ".mkv": "matroska",
    ".webm": "webm",
    ".avi": "avi",
    ".gif": "gif",
}
SUFFIXES_OUT = tuple(suffix for suffix in SUFFIXES if suffix != ".m4v")
_USUAL = {"mp4": "h264", "mov": "h264", "matroska": "h264", "webm": "vp9", "avi": "mpeg4", "gif": "gif"}
_ENCODERS = {
    "h264": "libx264",
    "hevc": "libx265",
    "vp9": "libvpx-vp9",
    "vp8": "libvpx",
    "av1": "libsvtav1",
    "prores": "prores_ks",
    "ffv1": "ffv1",
    "mpeg4": "mpeg4",
    "mpeg2video": "mpeg2video",
    "mjpeg": "mjpeg",
    "png": "png",
    "qtrle": "qtrle",
    "huffyuv": "huffyuv",
    "utvideo": "utvideo",
    "gif": "gif",
}
_ALIASES = {"h265": "hevc", "x264": "h264", "x265": "hevc", "avc": "h264", "mpeg2": "mpeg2video", "vp09": "vp9"}
_CRF = {
    "libx264": (0, 51, 18),
    "libx264rgb": (0, 51, 18),
    "libx265": (0, 51, 20),
    "libvpx-vp9": (0, 63, 24),
    "libvpx": (4, 63, 10),
    "libsvtav1": (1, 63, 25),
}
_SPEEDS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo")
_PRESETS = {
    "libx264": (_SPEEDS, "medium"),
    "libx264rgb": (_SPEEDS, "medium"),
    "libx265": (_SPEEDS, "medium"),
    "libsvtav1": (tuple(str(number) for number in range(14)), "8"),
}
# Codecs without a constant quality of their own: what keeps them near their best.
_COARSE = frozenset(
    ("mpeg4", "mpeg2video", "mpeg1video", "mjpeg", "flv", "h263p", "msmpeg4", "msmpeg4v2", "wmv1", "wmv2")
)
_SPOKEN = frozenset(("h264", "hevc", "vp9", "av1", "mpeg2video", "prores"))  # say themselves what colours mean
_NEVER_FULL = frozenset(("mpeg2video", "vp8", "prores"))
# How those that lose something can be kept from it.
_EXACT = {
    "libx264": {"qp": "0"},  # a crf of 0 is exact in 8 bits only
    "libx264rgb": {"qp": "0"},
    "libx265": {"x265-params": "lossless=1"},
    "libvpx-vp9": {"lossless": "1"},
    "libsvtav1": {"svtav1-params": "lossless=1"},
}
_HASTY, _FINE_CRF = 11, 8  # SVT-AV1 from this preset on, below this crf, writes what no decoder reads
_FINE = {"qmin": "2", "qmax": "3", "b": "400000000", "maxrate": "0"}


@dataclass(frozen=True, slots=True)
class Encoder:
    """An encoder and its settings.

    Parameters
    ----------
    name : str
        What FFmpeg calls it, such as ``"libx264"``.
    codec : str
        What it writes, such as ``"h264"``.
    options : dict
        In FFmpeg's words.
    """

    name: str
    codec: str
    options: dict[str, str]


def container_of(target: PathLike) -> str:
    """Tell the container that a name asks for, by its suffix.

    Raises
    ------
    SuppleError
        The suffix is none of video.
    """
    suffix = Path(target).suffix
    if suffix.lower() not in SUFFIXES:
        found = f"the suffix {shown(suffix)}" if suffix else "a name without suffix"
        raise unwritable(target, f"{found} is no video format", f"use {', '.join(SUFFIXES_OUT)}")
    return SUFFIXES[suffix.lower()]


@lru_cache(maxsize=64)
def _encoder(name: str) -> av.Codec | None:
    try:
        found = av.Codec(name, "w")
    except ValueError:  # UnknownCodecError is one
        return None
    return found if found.type == "video" else None


def _usable(names: Iterable[str], supported: set[str]) -> list[str]:
    return [name for name in names if _ENCODERS[name] in supported and _encoder(_ENCODERS[name])]


def named(target: PathLike, container: str, supported: set[str], codec: str | None, source: str, lossless: bool) -> str:
    """Choose an encoder: the one asked for, or the source's, or what the container is used to.

    Parameters
    ----------
    target : str or os.PathLike
        The file to write, for messages.
    container : str
        Its format.
    supported : set of str
        The codecs that the container can hold.
    codec : str or None
        What was asked for: a codec or an encoder.
    source : str
        The codec of the source.
    lossless : bool
        Whether that codec loses nothing.

    Raises
    ------
    SuppleError
        No encoder has that name, or the container cannot hold what it writes.
    """
    usable = _usable(_ENCODERS, supported)
    advice = f"use {', '.join(usable)}"
    if codec is not None:
        asked = codec.lower()
        asked = _ALIASES.get(asked, asked)
        encoder = _encoder(_ENCODERS.get(asked, asked))
        if encoder is None:
            raise unwritable(target, f"no video encoder is called {shown(codec)}", advice)
        if encoder.name not in supported:
            raise unwritable(target, f"{Path(target).suffix} cannot hold {encoder.canonical_name}", advice)
        return encoder.name
    if source in usable:
        return _ENCODERS[source]
    own = _encoder(source)
    if own is not None and source in supported and source != "rawvideo" and not own.experimental:
        return own.name
    if lossless and "ffv1" in usable and container in ("matroska", "avi"):
        return "ffv1"
    return usual(container)


def usual(container: str) -> str:
    """Name the encoder that a container is used to."""
    return _ENCODERS[_USUAL[container]]


def options(
    target: PathLike,
    encoder: str,
    crf: float | None,
    preset: str | None,
    workers: int,
    container: str,
    lossless: bool = False,
) -> dict[str, str]:
    """Return the settings of an encoder.

    Raises
    ------
    SuppleError
        It knows no constant rate factor or no presets, or not this one; or it cannot keep every value.
    """
    chosen: dict[str, str] = {}
    if lossless:
        chosen |= _exact(target, encoder, crf)
    elif encoder in _CRF:
        low, high, usual = _CRF[encoder]
        quality = usual if crf is None else crf
        if not low <= quality <= high:
            raise unwritable(target, f"crf {crf:g} is none of {encoder}'s", f"choose from {low} (best) to {high}")
        chosen["crf"] = f"{quality:g}"
    elif crf is not None:
        raise unwritable(target, f"{encoder} has no crf", f"leave it out, or use {_have(_CRF)}")
    if encoder in _PRESETS:
        presets, usual_preset = _PRESETS[encoder]
        chosen["preset"] = usual_preset if preset is None else str(preset)
        if chosen["preset"] not in presets:
            raise unwritable(target, f"{encoder} has no preset {shown(str(preset))}", f"use {', '.join(presets)}")
    elif preset is not None:
        raise unwritable(target, f"{encoder} has no presets", f"leave it out, or use {_have(_PRESETS)}")
    if encoder == "libsvtav1" and int(chosen["preset"]) >= _HASTY and float(chosen.get("crf", 0)) < _FINE_CRF:
        when = "if lossless" if lossless else f"below crf {_FINE_CRF}"
        what, or_else = f"{encoder} with preset {chosen['preset']} fails {when}", f", or crf {_FINE_CRF} or more"
        or_else = "" if lossless else or_else
        raise unwritable(target, what, f"use preset {_HASTY - 1} or less{or_else}")
    if encoder in ("libvpx", "libvpx-vp9"):
        chosen |= {"deadline": "good", "cpu-used": "2"}
        chosen |= {"b": "100000000"} if encoder == "libvpx" else {"b": "0", "row-mt": "1"}
    elif encoder in _COARSE:
        chosen |= _FINE
    elif encoder == "ffv1":
        chosen |= {"slicecrc": "1", "g": "1", "strict": "experimental"}
    if encoder == "libx265":
        chosen["x265-params"] = _joined(chosen.get("x265-params"), f"log-level=none:pools={workers}")
    elif encoder == "libsvtav1":
        chosen["svtav1-params"] = _joined(chosen.get("svtav1-params"), f"lp={workers}")
    if container == "avi":  # which keeps one time for each frame
        chosen["bf"] = "0"
    return chosen


def _exact(target: PathLike, encoder: str, crf: float | None) -> dict[str, str]:
    """Return what keeps an encoder from losing anything."""
    if crf is not None:
        raise unwritable(target, f"crf {crf:g} is for what may lose something", "leave out either it or lossless")
    found = _encoder(encoder)
    if encoder in _EXACT:
        return dict(_EXACT[encoder])
    if found is None or encoder == "gif" or found.lossy or not found.lossless:
        codec = found.canonical_name if found else encoder
        raise unwritable(
            target, f"{codec} always loses something", "use ffv1, h264, hevc, vp9 or av1, or leave out lossless"
        )
    return {}


def _joined(*parts: str | None) -> str:
    return ":".join(part for part in parts if part)


def _have(encoders: Iterable[str]) -> str:
    codecs = dict.fromkeys(found.canonical_name for name in encoders if (found := _encoder(name)))
    return f"a codec that has: {', '.join(codecs)}"


def pixel_formats(encoder: str) -> list[str]:
    """Name the pixel formats that an encoder takes; none where it takes any."""
    found = _encoder(encoder)
    return [video.name for video in (found.video_formats or [])] if found else []


def read_as(codec: str, container: str, height: int) -> Colour:
    """Tell what players take samples of YUV for, whatever is meant; what a file can say is left unknown."""
    matrix = UNKNOWN
    if codec in ("mjpeg", "vp8"):
        matrix = BT601
    elif container == "avi" and codec not in _SPOKEN:
        matrix = BT709 if height >= 720 else BT601
    silent = container == "avi" and codec not in _SPOKEN and codec != "mjpeg"
    limited = silent or codec in _NEVER_FULL or (codec == "mpeg4" and container == "mov")
    return Colour(LIMITED if limited else 0, matrix=matrix)
