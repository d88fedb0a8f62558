"""What pictures cost, against OpenCV and the paper's own method, with one stroke and many; and how good they are."""

from __future__ import annotations

import shutil
import statistics
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import quality
import skimage.data
import skimage.transform
import startup
from measure import Row, faster, milliseconds, run, timed
from mesh import rasterize

import supple
from supple.engine import paper
from supple.media.image import write
from supple.space.domain import Border

Array = npt.NDArray[Any]

SIZES = {"512²": (512, 512), "1080p": (1080, 1920), "4K": (2160, 3840)}
FIXED = "default border"

FIRST = """
import numpy as np, supple
rng = np.random.default_rng(0)
d = supple.Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100)
for kind, channels in ((np.uint8, 3), (np.uint16, 3), (np.float32, 3), (np.uint8, 4)):
    d.warp(rng.integers(0, 256, (512, 512, channels)).astype(kind), alpha=channels == 4)
d = supple.Deformation((128, 128, 128)).grab((64, 64, 64), by=(10, 5, -4), radius=30)
d.warp(rng.random((128, 128, 128), np.float32))
"""


def photograph(height: int, width: int) -> Array:
    """Return a photograph of an eye's retina, at the size asked for."""
    return np.ascontiguousarray(cv2.resize(skimage.data.retina(), (width, height)))


def one_stroke(height: int, width: int, border: Border, reach: float | None) -> supple.Deformation:
    """Return one stroke in the middle, of 0.15 of the height, dragged by 0.1 of it."""
    d = supple.Deformation((height, width), border=border)
    return d.grab((width / 2, height / 2), by=(0, 0.1 * height), radius=0.15 * height, reach=reach)


def map_of(deformation: supple.Deformation) -> tuple[Array, Array]:
    points = deformation.inverse_map(tolerance=1e-3)
    return np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])


def remap(image: Array, maps: tuple[Array, Array]) -> Array:
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def one_warp(
    how: str,
    filter: str | None,
    border: Border,
    reach: float | None,
    runs: int,
    bars: tuple[float, ...] = (),
    before: tuple[str, ...] = (),
) -> Iterator[Row]:
    """Compare a whole warp with OpenCV's sampling, at each size; no filter is the default one."""
    asked = {} if filter is None else {"filter": filter}
    for k, (size, (height, width)) in enumerate(SIZES.items()):
        image, d = photograph(height, width), one_stroke(height, width, border, reach)
        maps = map_of(d)
        yield timed(
            f"`warp` of RGB uint8, {size}, one stroke, {how}: ours / `cv2.remap`, linear, map in hand",
            lambda d=d, image=image: d.warp(image, **asked),
            lambda image=image, maps=maps: remap(image, maps),
            runs if height < 2000 else max(3, runs // 2),
            bars[k] if bars else None,
            before=before[k] if before else "",
        )


def whole_warps(runs: int) -> Iterator[Row]:
    """What the issue of speed is about: default settings first."""
    cases: tuple[tuple[str, str | None, Border, float | None, tuple[float, ...], tuple[str, ...]], ...] = (
        (f"default filter, {FIXED}, reach 4", None, "auto", 4.0, (1.8, 1.3, 1.2), ("5.6", "4.0", "3.3")),
        ("default filter, border=None, reach=None", None, None, None, (3.0, 2.0, 1.8), ("5.5", "3.0", "2.6")),
        (f"linear, {FIXED}, reach=None", "linear", "auto", None, (1.25, 1.0, 0.8), ("2.8", "1.9", "1.4")),
    )
    for how, kind, border, reach, bars, before in cases:
        yield from one_warp(how, kind, border, reach, runs, bars, before)


def more_warps(runs: int) -> Iterator[Row]:
    """Other combinations."""
    yield from one_warp(f"default filter, {FIXED}, reach=None", None, "auto", None, runs)
    yield from one_warp("linear, border=None, reach=None", "linear", None, None, runs)
    yield from one_warp("cubic, border=None, reach=None", "cubic", None, None, runs)


def random_strokes(shape: tuple[int, int], border: Border, reach: float | None) -> supple.Deformation:
    """Return 100 strokes in sequence on 1080p; a few of them are damped a little, lest they fold."""
    rng = np.random.default_rng(1)
    many = supple.Deformation(shape, border=border, on_fold="damp")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", supple.FoldWarning)
        for _ in range(100):
            radius, angle = rng.uniform(100, 300), rng.uniform(0, 2 * np.pi)
            drag = radius * rng.uniform(0.05, 0.2) * np.array([np.cos(angle), np.sin(angle)])
            many = many.grab(rng.uniform((200, 200), (1720, 880)), by=drag, radius=radius, reach=reach)
    return many


def strokes_row(
    runs: int, filter: str | None, border: Border, reach: float | None, bar: float | None, before: str
) -> Row:
    """Compare 100 strokes with one, of the same border and reach."""
    image = photograph(1080, 1920)
    many = random_strokes((1080, 1920), border, reach)
    one = supple.Deformation((1080, 1920), border=border).grab((960, 540), by=(0, 60), radius=300, reach=reach)
    asked = {} if filter is None else {"filter": filter}
    how = ", ".join(
        (
            f"{filter or 'default'} filter",
            "free border" if border is None else FIXED,
            "reach=None" if reach is None else f"reach {reach:g}",
        )
    )
    return timed(
        f"100 strokes in sequence at 1080p / one stroke, {how}",
        lambda: many.warp(image, **asked),
        lambda: one.warp(image, **asked),
        runs,
        bar,
        before=before,
    )


def many_strokes(runs: int) -> Iterator[Row]:
    yield strokes_row(runs, None, "auto", 4.0, 4.0, "25")
    yield strokes_row(runs, None, "auto", None, 18.0, "25")


def more_strokes(runs: int) -> Iterator[Row]:
    yield strokes_row(runs, "linear", "auto", 4.0, None, "")
    yield strokes_row(runs, "linear", "auto", None, None, "25 (border of 50)")
    yield strokes_row(runs, "linear", None, None, 4.0, "2.3")


def of_the_paper(border: Border) -> supple.Deformation:
    """Return the stroke of the paper's figure 6.1b."""
    return supple.Deformation((512, 512), border=border).grab((256, 256), by=(0, 90), radius=100, reach=None)


def paper_row(runs: int, border: Border, bar: float, before: str) -> Row:
    """Compare `inverse_map` with the published iteration, in the same core."""
    d = of_the_paper(border)
    table, axes = d.space.table, d.space.axes
    return faster(
        f"`inverse_map`, 512², figure 6.1b, {'free border' if border is None else FIXED}: the paper's method / ours",
        d.inverse_map,
        lambda: paper.inverse_map(table, axes, (512, 512)),
        runs,
        bar,
        before=before,
    )


def against_the_paper(runs: int) -> Iterator[Row]:
    yield paper_row(runs, "auto", 25.0, "13×")


def more_of_the_paper(runs: int) -> Iterator[Row]:
    """The free border, and how exact both are."""
    yield paper_row(runs, None, 30.0, "25×")
    y, x = np.mgrid[:512, :512]
    for border, bar, before in (("auto", None, "199× (border of 50)"), (None, 10.0, "29×")):
        d = of_the_paper(border)
        theirs, _, _ = paper.inverse_map(d.space.table, d.space.axes, (512, 512))
        true = d.inverse(np.stack([x, y], axis=-1)).points
        a, b = (float(np.linalg.norm(points - true, axis=-1).max()) for points in (d.inverse_map(), theirs))
        yield Row(
            f"the same, worst error: the paper's / ours (0.01 px asked), {'free border' if border is None else FIXED}",
            f"{a:.4f} px",
            f"{b:.4f} px",
            f"{b / a:.0f}×",
            "" if bar is None else f"≥ {bar:g}×",
            None if bar is None else b / a >= bar,
            before=before,
        )


def other_ways(runs: int) -> Iterator[Row]:
    """Forward mapping, and scikit-image."""
    image, d = photograph(512, 512), of_the_paper("auto")
    x, y = map_of(d)
    rows, columns = np.mgrid[:512, :512]
    grid, out = np.stack([columns, rows], axis=-1).astype(float), np.empty_like(image)
    places = np.stack([y, x])[..., None].repeat(3, axis=3).astype(np.float64)
    places = np.concatenate([places, np.broadcast_to(np.arange(3.0), (1, 512, 512, 3))])
    few = max(3, runs // 5)
    yield timed(
        "`warp`, linear, 512²: ours / forward mapping on a mesh of triangles",
        lambda: d.warp(image, filter="linear"),
        lambda: rasterize(image, d.forward(grid), out),
        few,
        before="0.28",
    )
    yield timed(
        "`warp`, linear, 512²: ours / `skimage.transform.warp`, map in hand",
        lambda: d.warp(image, filter="linear"),
        lambda: skimage.transform.warp(image, places, order=1, mode="edge", preserve_range=True),
        few,
        before="0.10",
    )


def decibels(what: str, ours: list[float], peer: list[float], least: tuple[float, ...], before: str) -> Row:
    """Return a row of peak signal to noise ratios, all of which must reach theirs."""
    a, b = (" / ".join(f"{value:.2f}" for value in values) + " dB" for values in (ours, peer))
    bar = "≥ " + " / ".join(f"{value:g}" for value in least) + " dB"
    holds = len(ours) == len(least) and all(x >= y for x, y in zip(ours, least, strict=True))
    more = " / ".join(f"{x - y:+.2f}" for x, y in zip(ours, peer, strict=True)) + " dB"
    return Row(what, a, b, more, bar, holds, before=before)


def against_truth() -> Iterator[Row]:
    """Quality, as `benchmarks/quality.py` measures it; the peer is OpenCV's cubic."""
    names = ("`auto`", "`cv2` cubic")
    filters = {name: quality.FILTERS[name] for name in names}
    parts = (
        (quality.MODERATE, "moderate stroke: what moved / where σ₁ > 1.15", (36.8, 37.1), "36.0 / 35.7 dB"),
        (
            quality.STRONG,
            "strong stroke: what moved / where σ₁ > 1.15 / where σ₁ > 2",
            (36.75, 37.0, 38.1),
            "35.8 / 35.9 / 37.4 dB",
        ),
    )
    for stroke, what, least, before in parts:
        values = quality.photographs(stroke, filters)
        what = f"{len(quality.PHOTOGRAPHS)} photographs against truth, default filter, {what}; peer: `cv2.remap`, cubic"
        yield decibels(what, *(values[name] for name in names), least, before)
    plate = quality.zone_plate(filters)
    what = "zone plate as a function against truth, both averaged over pixels, default filter; peer: `cv2.remap`, cubic"
    yield decibels(what, *(plate[name] for name in names), (36.0,), "27.6 dB")


def starting(here: Path, runs: int) -> Iterator[Row]:
    """Processes that start, with all caches of their user empty."""
    imported, named, warped = startup.rows(here, runs)
    yield replace(warped, what=f"whole process of a first-ever {warped.what} / `import numpy, pyvips`", before="61 s")
    begin = startup.started(["-c", FIRST], here / "home")
    seconds = []
    for _ in range(max(3, runs // 3)):
        start = time.perf_counter()
        begin()
        seconds.append(time.perf_counter() - start)
    taken = statistics.median(seconds)
    yield Row(
        "a process that warps its first uint8, uint16, float32 and RGBA uint8 pictures of 512², and a volume of 128³",
        milliseconds(taken),
        bar="≤ 1 s",
        holds=taken <= 1,
        runs=len(seconds),
        before="80 s",
    )
    yield replace(imported, what=f"{imported.what} / `import numpy`", before="3")
    yield replace(named, what=f"{named.what} / `import numpy`", before="3")


def memory(here: Path, quick: bool) -> Iterator[Row]:
    """The peak of a whole command on a large picture, above that of one on a small picture."""
    command = [shutil.which("supple", path=str(Path(sys.executable).parent)) or "supple", "warp"]
    side, tiny, large = 2048 if quick else 8192, here / "tiny.png", here / "large.png"
    cv2.imwrite(str(tiny), photograph(64, 64))
    cv2.imwrite(str(large), photograph(side, side), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    middle = f"{side // 2},{side // 2}"
    stroke = ["--grab", f"{middle}:{side // 2},{side // 2 + side // 8}", "--radius", f"{side // 4}", "--quiet"]
    _, base = run([*command, str(tiny), str(here / "t.png"), "--grab", "32,32:33,33", "--radius", "9", "--quiet"])
    _, peak = run([*command, str(large), str(here / "l.png"), *stroke])
    large.unlink()
    data = 2 * side * side * 3 / 1e6
    yield Row(
        f"peak memory of `supple warp`, {side}² RGB, above one of 64² (input and output: {data:.0f} MB)",
        f"{peak - base:.0f} MB",
        value=f"data {peak - base - data:+.0f} MB",
        bar=f"≤ {data + 100:.0f} MB",
        holds=peak - base <= data + 100,
        before="" if quick else "442 MB",
    )


COPY = """
import sys, pyvips
image = pyvips.Image.new_from_file(sys.argv[1], access="sequential")
image.tiffsave(sys.argv[2], compression=sys.argv[3], predictor="horizontal")
"""


def tiffs(here: Path, quick: bool, runs: int) -> Iterator[Row]:
    """A whole command on 45 megapixels of 16 bits with a sensor's noise, against a copy by libvips."""
    command = [shutil.which("supple", path=str(Path(sys.executable).parent)) or "supple", "warp"]
    height, width = (1376, 2064) if quick else (5504, 8256)
    clean = photograph(height, width) * np.float32(257)
    noise = np.random.default_rng(0).standard_normal(clean.shape, np.float32)
    pixels = np.clip(clean + noise * np.sqrt(6 * clean + 2500), 0, 65535).astype(np.uint16)
    stroke = ["--grab", f"{width // 2},{height // 2}:{width // 2 + 200},{height // 2}", "--radius", f"{height // 5}"]
    for compression in ("deflate", "lzw"):
        source = here / f"{compression}.tif"
        write(source, pixels, compression=compression)
        a, b = str(here / "copy.tif"), str(here / "bent.tif")
        copy = [sys.executable, "-c", COPY, str(source), a, compression]
        pairs = [(run([*command, str(source), b, *stroke, "--force", "--quiet"])[0], run(copy)[0]) for _ in range(runs)]
        ours, peer = (statistics.median(each) for each in zip(*pairs, strict=True))
        ratio = statistics.median(one / other for one, other in pairs)
        what = f"TIFF to TIFF, {width}×{height} RGB uint16, {compression}, whole command: ours / a copy by libvips"
        yield Row(what, f"{ours:.1f} s", f"{peer:.1f} s", f"{ratio:.2f}", "≤ 1.5", ratio <= 1.5, runs=runs)
        source.unlink()


__all__ = [
    "against_the_paper",
    "against_truth",
    "many_strokes",
    "memory",
    "more_of_the_paper",
    "more_strokes",
    "more_warps",
    "other_ways",
    "starting",
    "tiffs",
    "whole_warps",
]
