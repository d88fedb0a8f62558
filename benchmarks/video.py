"""What videos cost: against OpenCV, and against encoding alone. Clips are made from the shipped one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt
from measure import Line, against, figure, run, wall
from pictures import COMMAND, DATA, named

import supple
from supple.engine.core import plan_of, samplings_of
from supple.engine.sampling import Sampling
from supple.engine.work import Group, Layout, Work
from supple.files import warp_file
from supple.space.domain import Border

Array = npt.NDArray[Any]


def encoder(target: Any, width: int, height: int, preset: str) -> Any:
    """Return a stream of H.264 in 4:2:0."""
    stream = target.add_stream("libx264", rate=25, options={"crf": "18", "preset": preset})
    stream.width, stream.height, stream.pix_fmt, stream.thread_count = width, height, "yuv420p", 2
    return stream


def enlarged(target: Path, count: int, width: int, height: int, preset: str = "medium") -> Path:
    """Write the shipped clip at another size and length, forwards and backwards in turn."""
    with av.open(str(DATA / "bunny.mp4")) as source:
        frames = [f.reformat(width, height, "yuv420p", interpolation="BICUBIC") for f in source.decode(video=0)]
    turns = [*range(len(frames)), *range(len(frames) - 2, 0, -1)]
    with av.open(str(target), "w") as made:
        stream = encoder(made, width, height, preset)
        for k in range(count):
            frame = frames[turns[k % len(turns)]]
            frame.pts, frame.time_base, frame.pict_type = k, Fraction(1, 25), av.video.frame.PictureType.NONE
            made.mux(stream.encode(frame))
        made.mux(stream.encode(None))
    return target


def transcode(source: Path, target: Path) -> None:
    """Decode and encode, with the settings that ours has, and nothing between."""
    with av.open(str(source)) as clip, av.open(str(target), "w") as made:
        film = clip.streams.video[0]
        film.thread_count, film.thread_type = 2, "AUTO"
        stream = encoder(made, film.width, film.height, "medium")
        for frame in clip.decode(film):
            frame.pict_type = av.video.frame.PictureType.NONE
            made.mux(stream.encode(frame))
        made.mux(stream.encode(None))


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


def one_frame(runs: int, options: dict[str, Any], border: Border, bar: float | None) -> Line:
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
    sampling = Sampling(**options)
    outs = [np.empty(a.shape[1:], a.dtype) for a in (luma, chroma)]

    def ours() -> None:
        plan = plan_of(d.space, z, sampling.tolerance, layout.step)
        for each in samplings_of(Work(d.space, layout, sampling), [luma, chroma], outs, count):
            plan.sample(each)

    what = f"one frame of 1080p 4:2:0 bent in time, {named(options, border, None)}: "
    what += "ours / `cv2.remap` of the planes of two frames, maps in hand, blended"
    return against(what, ours, plain_resampling(luma[..., 0], chroma, points), wall, runs, bar)


def clip(
    here: Path,
    runs: int,
    count: int,
    grab: tuple[tuple[float, ...], tuple[float, ...], float],
    bar: float | None,
    **options: Any,
) -> Line:
    """Compare a clip from file to file, by a grab's position, drag and radius, with decoding and encoding alone."""
    source = here / f"clip{count}.mp4"
    if not source.exists():
        enlarged(source, count, 1920, 1080)
    at, by, radius = grab
    recipe = supple.Recipe(strokes=[supple.Stroke.grab(at, by=by, radius=radius)])
    how = f"{named(options, 'auto', 4.0)}, a drag by ({', '.join(f'{v:g}' for v in by)}), radius {radius:g}"
    return against(
        f"1080p 4:2:0, H.264, {count} frames, file to file, {how}: ours / decoding and encoding",
        lambda: warp_file(source, here / "ours.mp4", recipe, force=True, **options),
        lambda: transcode(source, here / "theirs.mp4"),
        wall,
        runs,
        bar,
        warm=0,
    )


def whole_clip(here: Path, runs: int, count: int, bar: float | None, **options: Any) -> Line:
    """A clip every frame of which moves."""
    return clip(here, runs, count, ((960.0, 540.0, (count - 1) / 2), (40.0, 0.0, count / 6), 120), bar, **options)


def short_clips(here: Path, runs: int) -> Iterator[Line]:
    """Of 40 frames, whose border in time is narrow: a large drag, and ordinary ones, in the plane and in time."""
    for radius, by in ((200, (60.0, 40.0, 10.0)), (108, (60.0, 40.0, 0.0)), (108, (40.0, 0.0, 8.0))):
        yield clip(here, runs, 40, ((900, 500, 15), by, radius), 1.35)


def memory(here: Path) -> Line:
    """Ten times the length."""
    peaks = []
    for count in (150, 1500):
        source = enlarged(here / f"long{count}.mp4", count, 640, 360, "veryfast")
        stroke = ["--grab", "320,180,60:340,180,80", "--radius", "60", "--preset", "veryfast", "--force", "--quiet"]
        peaks.append(min(run([*COMMAND, str(source), str(here / "o.mp4"), *stroke])[1] for _ in range(2)))
    what = "peak memory of `supple warp`, 640×360: 1500 frames / 150 frames"
    return figure(what, peaks[1] / peaks[0], "×", 1.05, ours=f"{peaks[1]:.0f} MB", peer=f"{peaks[0]:.0f} MB")


def certified() -> Iterator[Line]:
    """The error of the map, measured at every pixel of every frame."""
    for border in ("auto", None):
        d = supple.Deformation((60, 270, 480), border=border)
        d = d.grab((240, 135, 30), by=(20, 10, 15), radius=60, reach=None)
        what = f"certified error of the map, 480×270×60, bent in x, y and t, {named({}, border, None)}"
        yield figure(what, d.report().error, "pixels and frames", 0.01)
