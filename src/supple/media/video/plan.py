"""The plan of a clip's output: all settings, resolved and tested before there is a file."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import av
import numpy as np

from supple._core import threads as all_threads
from supple.errors import SuppleError, argument, shown, warn
from supple.media.base import ClipWarning, FrameSource
from supple.media.codecs import (
    ALIASES,
    CODECS,
    CONTAINERS,
    ENCODERS,
    FINE_CRF,
    HASTY,
    USUAL_BITS,
    Container,
    Encoder,
    codec_of,
)
from supple.media.files import PathLike, check_suffix, unwritable
from supple.media.suffixes import CLIPS_OUT
from supple.media.video.colour import BT601, BT709, FULL, LIMITED, RGB, UNKNOWN, Colour, sited
from supple.media.video.planes import Form, Kind, form

_FINEST = 1_000_000  # the finest ticks a second that encoders handle well
_TICKS = 50_000_000  # a second, the most in MP4
_DELAYED = 3  # frames: in shorter clips, x265 reports wrong decoding times, unless reordering is off
_TIMECODE = re.compile(r"\d+:\d\d:\d\d([:;.])(\d+)")
_USUAL = "ffv1 in .mkv"  # where nothing else is lossless
_SLICED = 16  # the smallest width and height that FFV1 can slice
_PACES = 8  # ticks for each frame in AVI, so that frames keep their times
_CHROMA = {(1, 1): "4:4:4", (2, 1): "4:2:2", (2, 2): "4:2:0", (4, 1): "4:1:1", (4, 4): "4:1:0", (1, 2): "4:4:0"}
os.environ.setdefault("SVT_LOG", "0")  # otherwise it prints to the terminal


def container_of(target: PathLike) -> Container:
    """Return the container for a file name, by its suffix; SuppleError if it is not a video format."""
    suffix, known = Path(target).suffix, {suffix: each for each in CONTAINERS for suffix in each.suffixes}
    check_suffix(target, suffix, known, "is no video format", f"use {', '.join(CLIPS_OUT)}")
    return known[suffix.lower()]


@lru_cache(maxsize=64)
def _found(name: str) -> av.Codec | None:
    try:
        found = av.Codec(name, "w")
    except ValueError:  # the base class of UnknownCodecError
        return None
    return found if found.type == "video" else None


def _usable(container: Container) -> dict[str, str]:
    """Return the codecs of the table that a container can hold, with their available encoders."""
    held = _held(container)
    return {name: row.encoder for name, row in CODECS.items() if row.encoder in held and _found(row.encoder)}


def _held(container: Container) -> set[str]:
    """Return the encoders whose output a container holds."""
    with av.open(os.devnull, "w", format=container.name) as trial:
        listed = trial.supported_codecs
    return {name for name in listed if (found := _found(name)) and found.canonical_name not in container.refused}


def _joined(*parts: str | None) -> str:
    return ":".join(part for part in parts if part)


def _having(container: Container, what: str) -> str:
    """Return the codecs that a container can hold and whose encoder has a property, an attribute of `Encoder`."""
    found = {name: getattr(ENCODERS.get(encoder), what, None) for name, encoder in _usable(container).items()}
    return ", ".join(name for name, value in found.items() if value not in (None, ()))


def _without(container: Container, what: str) -> str:
    """Return advice for an option that an encoder does not have."""
    others = _having(container, what)
    return "leave it out" + (f", or use a codec that has: {others}" if others else "")


def _read_as(name: str, container: Container, height: int) -> Colour:
    """Return how players interpret YUV samples, as far as the file has no tags for it; the rest is unknown."""
    codec, matrix = codec_of(name), UNKNOWN
    silent = container.counted and not codec.colours
    if codec.bt601:
        matrix = BT601
    elif silent:
        matrix = BT709 if height >= 720 else BT601
    limited = container.name in codec.limited_in or (silent and not codec.bt601)
    return Colour(LIMITED if limited else 0, matrix=matrix)


@dataclass(frozen=True, slots=True)
class Match:
    """The form in which frames are passed to an encoder."""

    form: Form  # the encoder's pixel format
    colour: Colour  # the interpretation of its samples
    same: bool  # whether samples are unchanged
    lost: Sequence[str] = ()  # losses other than opacity, in words
    opacity: bool = False  # whether opacity, if any, is lost
    instead: str = ""  # why a nearer pixel format is not used, in words


class WritePlan:
    """The settings of a clip's output, all checked.

    ``codec`` names a codec or an encoder, such as ``"h264"``, ``"libx264"``, ``"ffv1"``: by default that of the source,
    or the default of the container; ``crf`` is its constant rate factor (lower is better), and ``preset`` its speed
    preset. ``pixel_format`` is by default that of the source, or the nearest that the codec supports; lossy codecs
    write images as YUV, 4:2:0 if possible, in the limited range of BT.709. With ``lossless``, the codec is FFV1, unless
    one is named. SuppleError if an option is not supported; a `ClipWarning` if a part of the source cannot be kept.
    """

    def __init__(
        self,
        video: FrameSource,
        target: PathLike,
        *,
        codec: str | None = None,
        crf: float | None = None,
        preset: str | None = None,
        pixel_format: str | None = None,
        threads: int | None = None,
        lossless: bool = False,
    ) -> None:
        self.video, self.target, self.lossless = video, target, lossless
        self.workers = threads or all_threads()
        self.container = container_of(target)
        wanted = (self.container.exact or None) if lossless and codec is None else codec
        name = self._named(wanted)
        self._use(name, crf, preset)
        self.base = self._base()
        self._asked, self._why = pixel_format, ""
        if name == "gif":
            if pixel_format not in (None, "pal8"):
                raise unwritable(target, f"gif does not take the pixel format {pixel_format!r}", "use pal8")
            rgba = Form("pal8", Kind("rgb", (1, 1), 8, True, False), (), np.dtype(np.uint8))
            self.match = Match(rgba, Colour(), False, _depths(video.form.kind, rgba.kind))
        else:
            try:
                self.match = self._matched(pixel_format)
            except SuppleError:
                other = CODECS[self.container.usual].encoder
                if (codec, crf, preset, pixel_format) != (None,) * 4 or other == name:
                    raise
                self._use(other, None, None)
                self.match = self._matched(None)
                self._why = f"{video.codec} cannot be written as the source has it"
        if self.lossless and self.match.lost:
            advice = "leave out lossless" if self.encoder.name == "ffv1" else "use ffv1 in .mkv, or leave out lossless"
            raise unwritable(target, f"{self.encoder.codec} loses {' and '.join(self.match.lost)}", advice)
        self._say_codec(codec)
        if video.stills and video.form.kind.real and not self.match.form.kind.real:
            what = f"{self.encoder.codec} cannot hold the floating point of {video.name}"
            first = "" if video.form.kind.alpha else "use codec ffv1 in .mkv, or "
            raise unwritable(target, what, f"{first}convert the pictures to 16 bits first")
        self._warn_of_losses()
        kind = self.match.form.kind
        site = sited(video.colour, video.codec, video.form.kind)
        if self.match.same and kind.step != (1, 1) and site != self.colour.site:  # default sitings of codecs differ
            self.match = replace(self.match, colour=replace(self.match.colour, site=site))

    def _say_codec(self, asked: str | None) -> None:
        """Warn if the codec is neither the source's nor the user's; not for GIF, or containers of few codecs (WebM)."""
        used, source = self.encoder.codec, self.video.codec
        expected = used in (source, "gif", "ffv1") or source in ("", "gif")
        if asked or self.lossless or expected or (self.container.streams and not self.video.lossless):
            return
        own = _found(codec_of(source).encoder or source)
        only = f"{source} is only read" if own is None or own.name in _held(self.container) else ""
        self.warn(f"is written as {used}: {self._why or only or f'{Path(self.target).suffix} cannot hold {source}'}")

    def _named(self, codec: str | None) -> str:
        """Return an encoder: the user's, or the source's, or the container's default.

        SuppleError for an unknown encoder, or if the container does not support its codec.
        """
        container, source = self.container, self.video.codec
        held, usable = _held(container), _usable(container)
        if codec is not None:
            advice = f"use {_having(container, 'exact') or _USUAL if self.lossless else ', '.join(usable)}"
            asked = ALIASES.get(codec.lower(), codec.lower())
            encoder = _found(codec_of(asked).encoder or asked)
            if encoder is None:
                raise unwritable(self.target, f"no video encoder is called {shown(codec)}", advice)
            if encoder.name not in held:
                raise unwritable(
                    self.target, f"{Path(self.target).suffix} cannot hold {encoder.canonical_name}", advice
                )
            return encoder.name
        if source in usable:
            return usable[source]
        own = _found(source)
        if own is not None and own.name in held and source != "rawvideo" and not own.experimental:
            return own.name
        return usable.get(container.keeping if self.video.lossless else "") or CODECS[container.usual].encoder

    def _use(self, name: str, crf: float | None, preset: str | None) -> None:
        """Set the encoder and its options; SuppleError if it lacks the crf or the preset, or cannot be lossless."""
        found = av.Codec(name, "w")
        self.encoder = encoder = ENCODERS.get(name) or Encoder(name, found.canonical_name)
        self.fields = self.video.fields if encoder.fields else ""  # of frames that are coded as fields
        self._lossy = (found.lossy or not found.lossless) and not self.lossless
        container, target = self.container, self.target
        self.options = chosen = {**encoder.options, **container.options}
        if self.lossless:
            if crf is not None:
                what = f"crf {crf:g} is for what may lose something"
                raise unwritable(target, what, "leave out either it or lossless")
            if encoder.exact is None and (name == "gif" or found.lossy or not found.lossless):
                advice = f"use {_having(container, 'exact') or _USUAL}, or leave out lossless"
                raise unwritable(target, f"{encoder.codec} always loses something", advice)
            chosen |= encoder.exact or {}
        elif encoder.crf:
            low, high, usual = encoder.crf
            quality = usual if crf is None else crf
            if not low <= quality <= high:
                raise unwritable(target, f"crf {crf:g} is none of {name}'s", f"choose from {low} (best) to {high}")
            chosen["crf"] = f"{quality:g}"
        elif crf is not None:
            raise unwritable(target, f"{name} has no crf", _without(container, "crf"))
        if encoder.presets:
            chosen["preset"] = encoder.preset if preset is None else str(preset)
            if chosen["preset"] not in encoder.presets:
                what = f"{name} has no preset {shown(str(preset))}"
                raise unwritable(target, what, f"use {', '.join(encoder.presets)}")
        elif preset is not None:
            raise unwritable(target, f"{name} has no presets", _without(container, "presets"))
        if name == "libsvtav1" and int(chosen["preset"]) >= HASTY and float(chosen.get("crf", 0)) < FINE_CRF:
            what = f"{name} with preset {chosen['preset']} fails if lossless, or below crf {FINE_CRF}"
            raise unwritable(target, what, f"use preset {HASTY - 1} or less")
        if encoder.threads:
            chosen[encoder.params] = _joined(chosen.get(encoder.params), encoder.threads.format(self.workers))

    def _matched(self, asked: str | None) -> Match:
        """Return the pixel format that is chosen for the encoder, as a `Match`."""
        video, encoder, lossy = self.video, self.encoder, self._lossy
        names = self._formats()
        told = _read_as(encoder.codec, self.container, video.height)
        if video.stills and lossy and asked is None:
            kinds = {each: found.kind for each in names if (found := form(each))}
            names = [each for each, kind in kinds.items() if kind.family == "yuv" and kind.bits <= USUAL_BITS] or names
        size = (video.width, video.height)
        if (
            encoder.name == "ffv1"
            and min(size) < _SLICED
            and not (asked or self.opens(Match(video.form, video.colour, True)))
        ):
            self.options.update({"level": "1", "slices": "1"})  # too small for slices
        try:
            made = _nearest(self, names, asked, not (video.stills and lossy), told if lossy else Colour())
            if self.fields and made.instead:
                raise unwritable(self.target, made.instead, "leave out fields")
        except SuppleError:
            if self.fields:  # encoders support interlacing in some sizes only
                self.fields = ""
                return self._matched(asked)
            raise
        strange = made.colour.full(made.form) or made.colour.coefficients(video.height) not in (told.matrix, 5)
        if not lossy and made.form.kind.family == "yuv" and told != Colour() and strange:
            self.warn("cannot say what its colours mean, and may look different")
        return made

    def _warn_of_losses(self) -> None:
        video, lost, self.depth = self.video, self.match.lost, ""  # depth: warned of once a frame uses these bits
        if self.match.instead:
            self.warn(f"is not in {self.match.instead}")
        elif lost and not (video.stills and self._asked):
            found = "" if self._asked else self._finer()
            text = f"loses {' and '.join(lost)}" + (f": {argument('pixel_format', found)} keeps more" if found else "")
            if lost[0].startswith("depth") and not video.stills and not video.form.kind.real:
                self.depth = text
            else:
                self.warn(text)
        if video.grading and not self.encoder.graded:
            others = _having(self.container, "graded")
            advice = f": {argument('codec')} {others.replace(', ', ' or ')} keeps them" if others else ""
            self.warn(f"loses the light levels of HDR, which {self.encoder.codec} cannot hold{advice}")
        sound = video.source is not None and any(stream.type == "audio" for stream in video.source.streams)
        if sound and self.container.counted and self.encoder.codec in ("h264", "hevc"):
            # measured: players take the first frame for a delayed one, with any encoder
            self.warn("is out of step by a frame in players that rest on FFmpeg: use codec mpeg4, or .mkv")
        for what in video.unheld:
            self.warn(f"cannot hold {what}")
        self.timecode = video.timecode if self._says_time() else ""
        if video.timecode and not self.timecode:
            self.warn(f"cannot hold the timecode {video.timecode}: it is left out")
        if video.plays not in (None, 1) and not self.container.loops:
            often = f"{video.plays} times" if video.plays else "over and over"
            self.warn(f"cannot say that it plays {often}: players show it once")
        if video.fields and not self.fields and (self.encoder.fields or not self.container.fields):
            self.warn(f"cannot say that frames are interlaced, {video.fields} field first")
        square = video.aspect in (None, Fraction(1))
        if not square and not self.container.mp4 and not codec_of(self.encoder.codec).aspect:
            self.warn(f"cannot say that pixels are {video.aspect} as wide as high: they are left as they are stored")
        if video.matrix and not self.container.rotation:
            self.warn("cannot say which way up it is shown: it is left as it is stored")

    def _finer(self) -> str:
        """Return a pixel format that keeps more than the chosen one; empty if there is none."""
        source = self.video.form.kind

        def cost(kind: Kind) -> tuple[bool, int]:
            return source.alpha and not kind.alpha, len(_losses(source, kind, True))

        named = (name for name in self._formats() if name.startswith(("yuv4", "yuva4", "gbr", "rgb")))
        better = [each for name in named if (each := form(name)) and cost(each.kind) < cost(self.match.form.kind)]
        better.sort(key=lambda each: (cost(each.kind), abs(_depth(source) - _depth(each.kind))))
        return next((each.name for each in better if self.opens(replace(self.match, form=each))), "")

    def _says_time(self) -> bool:
        """Return whether the file can hold the timecode, which counts frames at a whole rate."""
        rate, found = round(self.video.rate), _TIMECODE.fullmatch(self.video.timecode)
        if not found or not self.container.mp4:
            return self.container.timecode
        return int(found[2]) < rate and (found[1] == ":" or rate % 30 == 0)

    def muxing(self) -> dict[str, str]:
        """Return the options of the container."""
        video = self.video
        if self.container.loops:  # GIF counts repetitions
            return {"loop": str(video.plays - 1 if video.plays else 0) if video.plays != 1 else "-1"}
        if not self.container.mp4:
            return {}
        tags = video.source.metadata if video.source else {}
        own = any(key.startswith("com.") for key in tags)  # keys that MP4 stores only with this flag
        return {"movie_timescale": str(timescale(video))} | ({"movflags": "use_metadata_tags"} if own else {})

    def _base(self) -> Fraction:
        """Return the unit of the file's time stamps."""
        if self.container.counted:
            rate, pace = self.video.rate, self.video.pace
            return 1 / (pace if rate < pace <= _PACES * rate else rate)
        return self.container.tick or self.video.base

    @property
    def colour(self) -> Colour:
        """The colours of the encoded samples, with the chroma siting, even where the file has no tag."""
        chosen = self.match
        return replace(chosen.colour, site=sited(chosen.colour, self.encoder.codec, chosen.form.kind))

    @property
    def timed(self) -> bool:
        """True if the encoder is given the times of frames, false if their numbers."""
        return self.encoder.timed and not self.container.counted and self.base.denominator <= _FINEST

    def warn(self, what: str) -> None:
        """Warn of a loss."""
        warn(f"{shown(self.target)} {what}", ClipWarning)

    def settle(self, context: av.VideoCodecContext, chosen: Match) -> None:
        """Apply the settings to an encoder's context."""
        video = self.video
        context.width, context.height, context.pix_fmt = video.width, video.height, chosen.form.name
        context.framerate = video.rate.limit_denominator(1 << 20)
        context.time_base = video.base if self.timed else 1 / video.rate.limit_denominator(1 << 20)
        context.thread_count = self.workers
        if video.aspect:
            context.sample_aspect_ratio = video.aspect
        colour = chosen.colour
        context.color_range, context.colorspace = colour.range, colour.matrix
        context.color_primaries, context.color_trc = colour.primaries, colour.transfer
        context.options = dict(self.options)
        if video.fields:
            context.field_order = video.field_order
        if self.fields:
            context.options["flags"] = "+ildct+ilme"
        settings = context.options
        if chosen.colour.site and chosen.form.kind.step != (1, 1):
            settings["chroma_sample_location"] = chosen.colour.site
        if self.encoder.name == "libx265" and video.count < _DELAYED:
            settings["x265-params"] += ":bframes=0"
        if self.encoder.name == "libvpx" and chosen.form.kind.alpha:
            settings["auto-alt-ref"] = "0"  # cannot be combined with opacity
        if self.encoder.name == "dnxhd":
            # DNxHR supports any size: the source's profile if it can hold the pixels, else the best one
            kind, usual = chosen.form.kind, self.encoder.profiles.get(video.profile, "dnxhr_hq")
            settings["profile"] = "dnxhr_444" if kind.step == (1, 1) else "dnxhr_hqx" if kind.bits > 8 else usual
            if self.fields:  # DNxHR has no interlacing, DNxHD only in one size
                settings.update({"profile": "dnxhd", "b": "185M" if video.rate <= 25 else "220M"})
        if self.encoder.name == "prores_ks" and video.codec == "prores" and chosen.same:
            settings["profile"] = self.encoder.profiles.get(video.profile, "auto")
        if video.grading and self.encoder.graded:
            key = self.encoder.params
            settings[key] = _joined(settings.get(key), *video.grading.words(self.encoder.graded))
        if self.encoder.codec == "hevc" and self.container.mp4:
            context.codec_tag = "hvc1"  # for QuickTime

    def _formats(self) -> list[str]:
        """Return the pixel formats that the encoder takes, and the container can hold; none if it takes any."""
        encoder = _found(self.encoder.name)
        names = [video.name for video in (encoder and encoder.video_formats) or []]
        if self.container.name in codec_of(self.encoder.codec).opaque_in:
            return [name for name in names if not ((found := form(name)) and found.kind.alpha)]
        return names

    def opens(self, chosen: Match) -> bool:
        """Return whether the encoder can be opened with a match."""
        context = av.CodecContext.create(self.encoder.name, "w")
        assert isinstance(context, av.VideoCodecContext)
        self.settle(context, chosen)
        try:
            open_encoder(context)
        except (av.FFmpegError, ValueError):
            return False
        return True


def open_encoder(context: av.VideoCodecContext) -> None:
    """Open an encoder, and restore the scheduling policy of this thread.

    As root, SVT-AV1 gives the calling thread real-time priority, which would starve its own worker threads.
    """
    if not hasattr(os, "sched_getscheduler"):
        context.open()
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        context.open()
    finally:
        if os.sched_getscheduler(0) != policy:
            os.sched_setscheduler(0, policy, parameters)


def timescale(video: FrameSource) -> int:
    """Return the ticks a second for the start times of an MP4's streams, such that none is rounded, if possible."""
    streams = video.source.streams if video.source else ()
    bases = [video.base, *(stream.time_base for stream in streams if stream.type in ("audio", "video"))]
    exact = math.lcm(1000, *(base.denominator for base in bases if base))
    return exact if exact <= _TICKS else 90000


def _nearest(plan: WritePlan, names: list[str], asked: str | None, exact: bool, read_as: Colour) -> Match:
    """Return the pixel format for an encoder: the clip's own, else the one with the least loss.

    `names` are the encoder's formats, empty for any; `asked` is the user's. `exact` is false if another format does not
    count as a loss, as for images. Players interpret YUV as `read_as`, where the file cannot specify it. SuppleError if
    the encoder does not support the user's format, or none at this size.
    """
    source, colour, encoder, target = plan.video.form, plan.video.colour, plan.encoder.name, plan.target
    forms = [found for name in (names or [source.name]) if (found := form(name)) is not None]
    if asked is not None:
        wanted = form(asked) or form(asked + "le")
        if wanted is None or (names and wanted.name not in names):
            usable = ", ".join(found.name for found in forms)
            raise unwritable(target, f"{encoder} does not take the pixel format {asked!r}", f"use {usable}")
        forms = [wanted]
    forms.sort(key=lambda found: _cost(source, colour, found))
    size = f"{plan.video.width}x{plan.video.height}"
    first: Match | None = None
    for found in forms:
        made = _matched(plan.video, found, exact, read_as)
        if plan.opens(made):
            usual = first is not None and (first.same or (not exact and first.opacity == made.opacity))
            if first is not None and not made.lost and usual:
                made = replace(made, instead=f"{first.form.name}, which {encoder} does not take at {size}")
            return made
        first = first or made
    advice = "use another pixel format" if asked is not None else "use another codec, such as ffv1 in .mkv"
    what = f" in {asked}" if asked is not None else ""
    raise unwritable(target, f"{encoder} does not take frames of {size}{what}, or cannot start here", advice)


def _cost(source: Form, colour: Colour, to: Form) -> tuple[float, ...]:
    """Return the sort key of a format: by loss, then by size, then by difference from the source."""
    a, b = source.kind, to.kind
    chroma = (b.step[0] * b.step[1]) / (a.step[0] * a.step[1])
    recoded = colour.full(source) != colour.full(to) and to.name.startswith("yuvj")
    coarser = chroma if _coarser(a, b) else 0.0
    if a.family == "rgb" and b.family == "yuv":  # the nearest to 4:2:0, which every player supports
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
        float(to.name != source.name),
        float(len({place.plane for place in to.places}) != len({place.plane for place in source.places})),
    )


def _depth(kind: Kind) -> float:
    return {16: 11.5, 32: 24.0}[kind.bits] if kind.real else kind.bits


def _colourless(a: Kind, b: Kind) -> bool:
    return (a.family != "gray" and b.family == "gray") or (a.family == "xyz") != (b.family == "xyz")


def _coarser(a: Kind, b: Kind) -> bool:
    return a.family in ("rgb", "yuv") and b.family == "yuv" and (b.step[0] > a.step[0] or b.step[1] > a.step[1])


def _losses(a: Kind, b: Kind, exact: bool) -> list[str]:
    words = []
    if _colourless(a, b):
        words.append("its colours")
    elif _coarser(a, b):
        words.append(f"detail of colours (to {_CHROMA.get(b.step, 'less')})")
    elif a.family == "yuv" and b.family == "rgb":
        words.append("exact values (to RGB)")
    if exact and a.family == "rgb" and b.family == "yuv":
        words.append("exact values (to YUV)")
    return words + _depths(a, b)


def _depths(a: Kind, b: Kind) -> list[str]:
    return [f"depth ({a.bits}{' real' if a.real else ''} to {b.bits} bits)"] if _depth(b) < _depth(a) else []


def _pictured(kind: Kind, colour: Colour) -> bool:
    """Return whether samples are RGB, or grey in the range of RGB, as in images."""
    return kind.family == "rgb" or (kind.family == "gray" and colour.matrix == RGB)


def _matched(video: FrameSource, to: Form, exact: bool, told: Colour) -> Match:
    source, colour = video.form, video.colour
    whole = to.name.startswith("yuvj")
    same = source.kind == to.kind and not (whole and not colour.full(source))
    meant = colour.valid()
    lost = _losses(source.kind, to.kind, exact)
    if to.kind.family in ("rgb", "xyz"):
        meant = replace(meant, range=FULL if to.kind.family == "rgb" else meant.range, matrix=RGB, site="")
    elif to.kind.family == "gray" and source.kind.family != "gray":
        meant = replace(meant, range=FULL)  # libswscale supports grey only in full range
    elif to.kind.family == "yuv" and _pictured(source.kind, colour):
        meant = replace(meant, range=FULL if whole else LIMITED, matrix=BT709)
    elif meant.matrix == RGB:
        meant = replace(meant, matrix=UNKNOWN)
    if whole or source.name.startswith("yuvj"):
        meant = replace(meant, range=FULL)
    moved = "to full range" if whole and not colour.full(source) else ""
    if to.kind.family == "yuv":
        if told.range == LIMITED and meant.full(to) and not whole:
            meant, moved = replace(meant, range=LIMITED), "to limited range"
        if told.matrix != UNKNOWN and _five(told.matrix) != _five(meant.coefficients(video.height)):
            meant = replace(meant, matrix=told.matrix)
            moved = moved or "to another matrix"
    if moved and source.kind.family == "yuv":
        same, lost = False, lost or [f"exact values ({moved})"]
    return Match(to, meant, same, lost, source.kind.alpha and not to.kind.alpha)


def _five(matrix: int) -> int:
    """Return one code for BT.601's matrix, which has two (5 and 6)."""
    return BT601 if matrix == 5 else matrix
