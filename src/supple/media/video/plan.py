"""How a clip will be written: all that is asked for, settled and tried before there is a file."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import av
import numpy as np

from supple.engines.workers import threads as all_threads
from supple.errors import SuppleError, shown
from supple.media.video.codecs import Encoder, container_of, named, options, pixel_formats, read_as, usual
from supple.media.video.colour import Colour, Grading, sited
from supple.media.video.errors import ClipWarning, unwritable
from supple.media.video.pixel_format import Match, Wish, finer, match
from supple.media.video.planes import Form, Kind, form

if TYPE_CHECKING:
    from supple.media.video.probe import Reel

PathLike = str | os.PathLike[str]
# Encoders that take any times. The others count frames, and their packets are given the times afterwards.
_TIMED = frozenset(("libx264", "libx264rgb", "libx265", "libvpx", "libvpx-vp9", "libsvtav1"))
_FINEST = 1_000_000  # ticks a second that they are trusted with
_TICKS = 50_000_000  # a second, the most in MP4
_DELAYED = 3  # frames: x265 says nonsense of when fewer are decoded, if it may reorder them
_SLICED = 16  # pixels that a frame must have along each side for FFV1 to cut it
_USUAL = 10  # bits, the most that players are used to
# Codecs that say themselves how wide a pixel is; Matroska and AVI cannot be told through PyAV.
_ASPECT = frozenset(("h264", "hevc", "mpeg4", "mpeg2video", "mpeg1video", "mjpeg"))
_GRADED = {"libx264": "x264-params", "libx265": "x265-params", "libsvtav1": "svtav1-params"}
_PRORES = {"Proxy": "proxy", "LT": "lt", "Standard": "standard", "HQ": "hq", "4444": "4444", "XQ": "4444xq"}
_PACES = 8  # times as many ticks as frames that AVI is given, so that frames keep their times
UPRIGHT_ONLY = frozenset(("avi", "gif"))
os.environ.setdefault("SVT_LOG", "0")  # it writes to the terminal otherwise


class WritePlan:
    """How a clip will be written, with all that can be refused refused.

    Parameters
    ----------
    reel : Reel
        What is written.
    target : str or os.PathLike
        The file to write.
    codec, crf, preset, pixel_format : optional
        What was asked for.
    workers : int
        How many threads encode.
    lossless : bool
        Whether every value is to be kept.
    """

    def __init__(
        self,
        reel: Reel,
        target: PathLike,
        codec: str | None,
        crf: float | None,
        preset: str | None,
        pixel_format: str | None,
        workers: int,
        lossless: bool = False,
    ) -> None:
        self.reel, self.target, self.workers, self.lossless = reel, target, workers, lossless
        self.container = container_of(target)
        supported = av.open(os.devnull, "w", format=self.container).supported_codecs
        exact = lossless and codec is None and self.container not in ("gif", "webm")
        name = named(target, self.container, supported, "ffv1" if exact else codec, reel.codec, reel.lossless)
        self._use(name, options(target, name, crf, preset, workers, self.container, lossless))
        self.base = self._base()
        self._asked = pixel_format
        if name == "gif":
            if pixel_format not in (None, "pal8"):
                raise unwritable(target, f"gif does not take the pixel format {pixel_format!r}", "use pal8")
            rgba = Form("pal8", Kind("rgb", (1, 1), 8, True, False), (), np.dtype(np.uint8))
            self.match = Match(rgba, Colour(), False, "", False)
        else:
            try:
                self.match = self._matched(pixel_format)
            except SuppleError:
                other = usual(self.container)
                if (codec, crf, preset, pixel_format) != (None,) * 4 or other == name:
                    raise
                self._use(other, options(target, other, None, None, workers, self.container))
                self.match = self._matched(None)
                self.warn(f"is written as {self.encoder.codec}: {reel.codec} cannot be written as the source has it")
        self._require_exact()
        if reel.stills and reel.form.kind.real and not self.match.form.kind.real:
            what = f"{self.encoder.codec} cannot hold the floating point of {reel.name}"
            first = "" if reel.form.kind.alpha else "use codec ffv1 in .mkv, or "
            raise unwritable(target, what, f"{first}convert the pictures to 16 bits first")
        self._warn_of_losses()
        kind = self.match.form.kind
        site = sited(reel.colour, reel.codec, reel.form.kind)
        if self.match.same and kind.step != (1, 1) and site != self.colour.site:  # codecs are used to different ones
            self.match = replace(self.match, colour=replace(self.match.colour, site=site))

    def _use(self, name: str, settings: dict[str, str]) -> None:
        """Take an encoder."""
        found = av.Codec(name, "w")
        self.encoder = Encoder(name, found.canonical_name, settings)
        self._lossy = (found.lossy or not found.lossless) and not self.lossless

    def _matched(self, asked: str | None) -> Match:
        """Choose the pixel format."""
        reel, encoder, lossy = self.reel, self.encoder, self._lossy
        names = self._formats()
        told = read_as(encoder.codec, self.container, reel.height)
        if reel.stills and lossy and asked is None:
            kinds = {each: found.kind for each in names if (found := form(each))}
            names = [each for each, kind in kinds.items() if kind.family == "yuv" and kind.bits <= _USUAL] or names
        size = (reel.width, reel.height)
        wish = Wish(reel.form, reel.colour, size, not (reel.stills and lossy), told if lossy else Colour())
        if encoder.name == "ffv1" and min(size) < _SLICED and not (asked or self._takes(reel.form, reel.colour)):
            encoder.options.update({"level": "1", "slices": "1"})  # too small to be cut into slices
        try:
            made = match(self.target, encoder.name, names, wish, asked, self._opens)
        except SuppleError:
            if self._starts():
                raise
            what = f"{encoder.name} cannot be started here: it needs a device or a driver that is missing"
            raise unwritable(self.target, what, "use another codec, such as h264 or ffv1") from None
        strange = made.colour.full(made.form) or made.colour.coefficients(reel.height) not in (told.matrix, 5)
        if not lossy and made.form.kind.family == "yuv" and told != Colour() and strange:
            self.warn("cannot say what its colours mean, and may look different")
        return made

    def _warn_of_losses(self) -> None:
        reel, lost = self.reel, self.match.lost
        if lost and not (reel.stills and self._asked):
            found = finer(reel.form, self.match, self._formats(), self._opens)
            advice = f": --pixel-format {found} keeps more" if found and not self._asked else ""
            self.warn(f"loses {lost}{advice}" if ", which" not in lost else f"is not in {lost}")
        if reel.grading != Grading() and self.encoder.name not in _GRADED:
            self.warn(f"loses the light levels of HDR, which {self.encoder.codec} cannot hold: hevc, h264 and av1 can")
        sound = reel.source is not None and any(stream.type == "audio" for stream in reel.source.streams)
        if sound and self.container == "avi" and self.encoder.codec in ("h264", "hevc"):
            # measured: they take its first frame for a delayed one, whoever wrote it
            self.warn("is out of step by a frame in players that rest on FFmpeg: use codec mpeg4, or .mkv")
        for what in reel.unheld:
            self.warn(f"cannot hold {what}")
        square = reel.aspect in (None, Fraction(1))
        if not square and self.container not in ("mp4", "mov") and self.encoder.codec not in _ASPECT:
            self.warn(f"cannot say that pixels are {reel.aspect} as wide as high: they are left as they are stored")
        if reel.matrix and self.container in UPRIGHT_ONLY:
            self.warn("cannot say which way up it is shown: it is left as it is stored")

    def _base(self) -> Fraction:
        """Choose the unit of the file's time stamps."""
        if self.container == "avi":
            rate, pace = self.reel.rate, self.reel.pace
            return 1 / (pace if rate < pace <= _PACES * rate else rate)
        return Fraction(1, 100) if self.container == "gif" else self.reel.base

    @property
    def colour(self) -> Colour:
        """The colours of the encoded samples, with the place of chroma, which the file need not say."""
        chosen = self.match
        return replace(chosen.colour, site=sited(chosen.colour, self.encoder.codec, chosen.form.kind))

    @property
    def timed(self) -> bool:
        """Return whether the encoder is given the times of frames, and not their numbers."""
        return self.encoder.name in _TIMED and self.container != "avi" and self.base.denominator <= _FINEST

    def warn(self, what: str) -> None:
        """Warn of what does not come through."""
        warnings.warn(f"{shown(self.target)} {what}", ClipWarning, stacklevel=3)

    def settle(self, context: av.VideoCodecContext, chosen: Match) -> None:
        """Give an encoder its settings."""
        reel = self.reel
        context.width, context.height, context.pix_fmt = reel.width, reel.height, chosen.form.name
        context.framerate = reel.rate.limit_denominator(1 << 20)
        context.time_base = reel.base if self.timed else 1 / reel.rate.limit_denominator(1 << 20)
        context.thread_count = self.workers
        if reel.aspect:
            context.sample_aspect_ratio = reel.aspect
        colour = chosen.colour
        context.color_range, context.colorspace = colour.range, colour.matrix
        context.color_primaries, context.color_trc = colour.primaries, colour.transfer
        if reel.field_order > 1:
            context.field_order = reel.field_order
        context.options = dict(self.encoder.options)
        self._extras(context, chosen)

    def _extras(self, context: av.VideoCodecContext, chosen: Match) -> None:
        reel, settings = self.reel, context.options
        if chosen.colour.site and chosen.form.kind.step != (1, 1):
            settings["chroma_sample_location"] = chosen.colour.site
        if self.encoder.name == "libx265" and reel.count < _DELAYED:
            settings["x265-params"] += ":bframes=0"
        if self.encoder.name == "dnxhd":
            settings["profile"] = _dnxhr(reel.profile, chosen.form.kind)
        if self.encoder.name == "prores_ks" and reel.codec == "prores" and chosen.same:
            settings["profile"] = _PRORES.get(reel.profile, "auto")
        key = _GRADED.get(self.encoder.name)
        if key:
            extra = reel.grading.svt() if key == "svtav1-params" else reel.grading.x265()
            if key == "x264-params":
                extra = extra.replace("master-display", "mastering-display").replace("max-cll", "cll")
                if reel.field_order in (2, 4, 3, 5):
                    extra = ":".join(filter(None, (extra, "tff=1" if reel.field_order in (2, 4) else "bff=1")))
            joined = ":".join(part for part in (settings.get(key, ""), extra) if part)
            if joined:
                settings[key] = joined
        if self.encoder.codec == "hevc" and self.container in ("mp4", "mov"):
            context.codec_tag = "hvc1"  # what QuickTime plays

    def _formats(self) -> list[str]:
        """Name the pixel formats that the encoder takes, and the container can hold."""
        names = pixel_formats(self.encoder.name)
        if self.encoder.codec in ("vp8", "vp9") and self.container not in ("matroska", "webm"):
            return [name for name in names if not ((found := form(name)) and found.kind.alpha)]
        return names

    def _require_exact(self) -> None:
        """Refuse what would not be lossless, if that was asked for."""
        lost = self.match.lost
        if self.lossless and lost and ", which" not in lost:
            advice = "leave out lossless" if self.encoder.name == "ffv1" else "use ffv1 in .mkv, or leave out lossless"
            raise unwritable(self.target, f"{self.encoder.codec} loses {lost}", advice)

    def _starts(self) -> bool:
        """Return whether the encoder opens at all."""
        context = av.CodecContext.create(self.encoder.name, "w")
        assert isinstance(context, av.VideoCodecContext)
        context.width, context.height, context.time_base = 1280, 720, Fraction(1, 25)
        for name in pixel_formats(self.encoder.name) or ["yuv420p"]:
            context.pix_fmt = name
            with contextlib.suppress(av.FFmpegError, ValueError):
                context.open()
                return True
        return False

    def _takes(self, own: Form, colour: Colour) -> bool:
        """Return whether the encoder opens for the pixel format that there is."""
        return self._opens(Match(own, colour, True, "", False))

    def _opens(self, chosen: Match) -> bool:
        """Try whether the encoder opens."""
        context = av.CodecContext.create(self.encoder.name, "w")
        assert isinstance(context, av.VideoCodecContext)
        self.settle(context, chosen)
        try:
            context.open()
        except (av.FFmpegError, ValueError):
            return False
        return True


def _dnxhr(profile: str, kind: Kind) -> str:
    """Choose a profile of DNxHR, which takes any size: the source's if it can hold the pixels, else the best."""
    if kind.step == (1, 1):
        return "dnxhr_444"
    if kind.bits > 8:
        return "dnxhr_hqx"
    known = {"DNXHR LB": "dnxhr_lb", "DNXHR SQ": "dnxhr_sq"}
    return known.get(profile, "dnxhr_hq")


def timescale(reel: Reel) -> int:
    """Choose the ticks in which MP4 says when a stream begins: such that nothing is rounded, if there are."""
    streams = reel.source.streams if reel.source else ()
    bases = [reel.base, *(stream.time_base for stream in streams if stream.type in ("audio", "video"))]
    exact = math.lcm(1000, *(base.denominator for base in bases if base))
    return exact if exact <= _TICKS else 90000


def workers(threads: int | None) -> int:
    """Return how many threads a codec may use."""
    return threads if threads else all_threads()
