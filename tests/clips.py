"""Small clips for tests, made with PyAV alone."""

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np

SIZE = (64, 48)


def closed(name, count, shape):
    """Return the properties of a clip that its deformation depends on."""
    return SimpleNamespace(name=name, count=count, layout=SimpleNamespace(shape=shape), display=None)


def noise(pixel_format, size, seed, smooth=False):
    """A frame of random samples, each within what the format allows."""
    width, height = size
    frame = av.VideoFrame(width, height, pixel_format)
    bits = frame.format.components[0].bits
    random = np.random.default_rng(seed)
    for number, plane in enumerate(frame.planes):
        room = plane.buffer_size
        if "f32" in pixel_format or "f16" in pixel_format:
            kind = "<f4" if "f32" in pixel_format else "<f2"
            data = random.random(room // int(kind[-1])).astype(kind)
        elif bits > 8:
            kind = ">u2" if pixel_format.endswith("be") else "<u2"
            raised = 16 - bits if pixel_format[0] == "p" else 0
            data = (random.integers(0, 2**bits, room // 2) << raised).astype(kind)
        elif smooth:
            rows = np.arange(room)[:, None] // plane.line_size
            data = (40 + seed * 3 + number * 20 + rows[:, 0] // 2).astype(np.uint8)
        else:
            data = random.integers(0, 16 if pixel_format.endswith("4_byte") else 256, room).astype(np.uint8)
        plane.update(data.tobytes().ljust(room, b"\0"))
    return frame


def make(
    path,
    codec="libx264",
    pixel_format="yuv420p",
    count=10,
    size=SIZE,
    rate=25,
    times=None,
    base=None,
    options=None,
    container=None,
    smooth=True,
    audio=None,
    audio_start=0,
    subtitles=False,
    attachment=False,
    cover=False,
    chapters=None,
    setup=None,
    tags=None,
    duration=None,
):
    """Write a clip, and return its path; `times` are in ticks of `base`."""
    base = base or Fraction(1, rate)
    with av.open(str(path), "w", format=container) as out:
        out.metadata.update(tags or {})
        stream = out.add_stream(codec, rate=rate, options=dict(options or {}))
        stream.width, stream.height, stream.pix_fmt = *size, pixel_format
        stream.time_base = stream.codec_context.time_base = base
        if setup:
            setup(stream)
        sound = add_sound(out, audio) if audio else None
        words = add_words(out) if subtitles else None
        if attachment:
            out.add_attachment("font.ttf", "application/x-truetype-font", bytes(range(256)) * 4)
        if cover and out.format.name == "matroska":
            out.add_attachment("cover.png", "image/png", png())
        picture = add_cover(out) if cover and out.format.name != "matroska" else None
        if chapters:
            out.set_chapters(chapters)
        out.start_encoding()
        if picture:
            out.mux(picture)
        if words:
            for number in range(2):
                packet = av.Packet(f"word {number}".encode())
                packet.stream, packet.time_base = words, Fraction(1, 1000)
                packet.pts = packet.dts = number * 100
                packet.duration = 80
                out.mux(packet)
        seconds = 0.0
        for number in range(count):
            frame = noise(pixel_format, size, number, smooth)
            frame.time_base = base
            frame.pts = times[number] if times is not None else number
            if duration:
                frame.duration = duration
            out.mux(stream.encode(frame))
            seconds = float(frame.pts * base) + 1 / rate
        out.mux(stream.encode(None))
        if sound:
            add_tone(out, sound, seconds, audio_start)
    return Path(path)


def add_sound(out, codec):
    sound = out.add_stream(codec, rate=48000)
    sound.layout = "mono"
    if codec == "libmp3lame":
        sound.format = "fltp"
    sound.metadata["language"] = "fin"
    return sound


def add_tone(out, sound, seconds, start):
    size = 1024
    kind = sound.codec_context.format.name
    for number in range(max(1, int(seconds * 48000) // size)):
        wave = 0.3 * np.sin((np.arange(size) + number * size) * 0.05)[None]
        data = wave.astype(np.float32)
        if kind[0] == "s":
            bits = int(kind[1:3])
            data = (wave * (2 ** (bits - 1) - 1)).astype(f"i{bits // 8}")
        frame = av.AudioFrame.from_ndarray(data, format=kind, layout="mono")
        frame.sample_rate, frame.time_base = 48000, Fraction(1, 48000)
        frame.pts = number * size + round(start * 48000)
        out.mux(sound.encode(frame))
    out.mux(sound.encode(None))


def add_words(out):
    words = out.add_mux_stream("subrip")
    words.time_base = Fraction(1, 1000)
    words.metadata["language"] = "deu"
    return words


def add_cover(out):
    stream = out.add_mux_stream("png", width=16, height=16)
    stream.disposition = av.stream.Disposition.attached_pic
    stream.metadata.update({"filename": "cover.png", "mimetype": "image/png", "comment": "Cover (front)"})
    packet = av.Packet(png())
    packet.stream, packet.pts, packet.dts, packet.time_base = stream, 0, 0, Fraction(1, 90000)
    return packet


def png():
    context = av.CodecContext.create("png", "w")
    context.width = context.height = 16
    context.pix_fmt, context.time_base = "rgb24", Fraction(1, 25)
    packets = context.encode(noise("rgb24", (16, 16), 0)) + context.encode(None)
    return bytes(packets[0])


def rows(frame):
    """The samples of a frame as bytes, plane by plane, without what pads the lines."""
    planes = []
    for number, plane in enumerate(frame.planes):
        parts = [part for part in frame.format.components if part.plane == number]
        bits = frame.format.padded_bits_per_pixel if not frame.format.is_planar else None
        item = 1 if parts[0].bits <= 8 else 2 if parts[0].bits <= 16 else 4
        length = plane.width * bits // 8 if bits else plane.width * len(parts) * item
        lines = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        planes.append(lines[: plane.height, :length].tobytes())
    return planes


def decoded(path):
    """All frames, by PyAV alone."""
    with av.open(str(path)) as source:
        films = [s for s in source.streams.video if not s.disposition & av.stream.Disposition.attached_pic]
        return list(source.decode(films[0]))


def when(path):
    """The times of all frames, in seconds."""
    return [frame.pts * frame.time_base if frame.time_base else frame.pts for frame in decoded(path)]


def parcels(path, kind):
    """Payload, time and duration in seconds of all packets of the streams of a kind."""
    with av.open(str(path)) as source:
        return [
            (bytes(packet), packet.pts * packet.time_base, (packet.duration or 0) * packet.time_base)
            for packet in source.demux()
            if packet.size and packet.stream.type == kind
        ]
