"""What pictures cost, against OpenCV and the paper's own method, with one stroke and many; and how good they are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pyvips
import quality
import skimage.data
import skimage.transform
from measure import Line, against, alone, figure, run, wall

import supple
from supple.engine import paper
from supple.media.image import write
from supple.space.domain import Border

Array = npt.NDArray[Any]

DATA = Path(supple.__file__).parent / "examples" / "data"
COMMAND = [shutil.which("supple", path=str(Path(sys.executable).parent)) or "supple", "warp"]
SIZES = {"512²": (512, 512), "1080p": (1080, 1920), "4K": (2160, 3840)}

Warps = tuple[tuple[dict[str, Any], Border, float | None, tuple[float | None, ...]], ...]
"""Options, border, reach, and bars: of each size, or of 100 strokes."""

REACHED: Warps = (
    ({}, "auto", 4.0, (1.8, 1.3, 1.2)),
    ({}, None, None, (3.0, 2.0, 1.8)),
    ({"filter": "linear"}, "auto", None, (1.25, 1.0, 0.8)),
)
MORE: Warps = (
    ({}, "auto", None, (None,) * 3),
    ({"filter": "linear"}, None, None, (None,) * 3),
    ({"filter": "cubic"}, None, None, (None,) * 3),
)
STROKES: Warps = (({}, "auto", 4.0, (4.0,)), ({}, "auto", None, (18.0,)))
MORE_STROKES: Warps = (
    ({"filter": "linear"}, "auto", 4.0, (None,)),
    ({"filter": "linear"}, "auto", None, (None,)),
    ({"filter": "linear"}, None, None, (4.0,)),
)

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


def named(options: dict[str, Any], border: Border, reach: float | None) -> str:
    """Return what a warp is asked for, in words."""
    words = "free border" if border is None else "default border"
    return f"{options.get('filter', 'default')} filter, {words}, reach{'=None' if reach is None else f' {reach:g}'}"


def one_warp(runs: int, cases: Warps) -> Iterator[Line]:
    """Compare a whole warp with OpenCV's sampling, at each size."""
    for options, border, reach, bars in cases:
        for (size, (height, width)), bar in zip(SIZES.items(), bars, strict=True):
            image, d = photograph(height, width), supple.Deformation((height, width), border=border)
            d = d.grab((width / 2, height / 2), by=(0, 0.1 * height), radius=0.15 * height, reach=reach)
            maps = np.moveaxis(d.inverse_map(tolerance=1e-3), -1, 0).copy()
            yield against(
                f"`warp` of RGB uint8, {size}, one stroke, {named(options, border, reach)}: "
                "ours / `cv2.remap`, linear, map in hand",
                lambda d=d, image=image, options=options: d.warp(image, **options),
                lambda image=image, maps=maps: cv2.remap(
                    image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
                ),
                wall,
                runs if height < 2000 else max(3, runs // 2),
                bar,
            )


def random_strokes(border: Border, reach: float | None) -> supple.Deformation:
    """Return 100 strokes in sequence on 1080p; a few of them are damped a little, lest they fold."""
    rng = np.random.default_rng(1)
    many = supple.Deformation((1080, 1920), border=border, on_fold="damp")
    for _ in range(100):
        radius, angle = rng.uniform(100, 300), rng.uniform(0, 2 * np.pi)
        drag = radius * rng.uniform(0.05, 0.2) * np.array([np.cos(angle), np.sin(angle)])
        at = rng.uniform((200, 200), (1720, 880))
        many = many.add(supple.Stroke.grab(at, by=drag, radius=radius, reach=reach), warn=False)
    return many


def many_strokes(runs: int, cases: Warps) -> Iterator[Line]:
    """Compare 100 strokes with one, of the same border and reach."""
    image = photograph(1080, 1920)
    for options, border, reach, (bar,) in cases:
        many = random_strokes(border, reach)
        one = supple.Deformation((1080, 1920), border=border).grab((960, 540), by=(0, 60), radius=300, reach=reach)
        yield against(
            f"100 strokes in sequence at 1080p / one stroke, {named(options, border, reach)}",
            lambda many=many, options=options: many.warp(image, **options),
            lambda one=one, options=options: one.warp(image, **options),
            wall,
            runs,
            bar,
        )


def of_the_paper(runs: int, border: Border, least: float) -> Line:
    """Compare `inverse_map` with the published iteration, in the same core, on the stroke of figure 6.1b."""
    d = supple.Deformation((512, 512), border=border).grab((256, 256), by=(0, 90), radius=100, reach=None)
    table, axes = d.space.table, d.space.axes
    y, x = np.mgrid[:512, :512]
    true = d.inverse(np.stack([x, y], axis=-1)).points
    both = d.inverse_map(), paper.inverse_map(table, axes, (512, 512))[0]
    ours, theirs = (f"{np.linalg.norm(points - true, axis=-1).max():.4f} px" for points in both)
    return against(
        f"`inverse_map`, 512², figure 6.1b, {'free' if border is None else 'default'} border: ours / the paper's "
        f"method; off by at most {ours} / {theirs}",
        d.inverse_map,
        lambda: paper.inverse_map(table, axes, (512, 512)),
        wall,
        runs,
        1 / least,
    )


def another_way(runs: int) -> Iterator[Line]:
    """Compare with scikit-image."""
    image = photograph(512, 512)
    d = supple.Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100, reach=None)
    places = np.moveaxis(d.inverse_map(tolerance=1e-3)[..., ::-1], -1, 0)[..., None].repeat(3, axis=3)
    places = np.concatenate([places, np.broadcast_to(np.arange(3.0), (1, 512, 512, 3))])
    yield against(
        "`warp`, linear, 512²: ours / `skimage.transform.warp`, map in hand",
        lambda: d.warp(image, filter="linear"),
        lambda: skimage.transform.warp(image, places, order=1, mode="edge", preserve_range=True),
        wall,
        runs,
    )


def against_truth() -> Iterator[Line]:
    """Quality, as `benchmarks/quality.py` measures it; the peer is OpenCV's cubic."""
    names = ("`auto`", "`cv2` cubic")
    found = quality.measured({name: quality.FILTERS[name] for name in names})
    regions = ("what moved", "where σ₁ > 1.15", "where σ₁ > 2")
    for picture, values in found.items():
        both = (values[name] for name in names)
        for ours, peer, least, region in zip(*both, quality.BARS[picture], regions, strict=False):
            what = f"{picture}, {region}, against truth, default filter; peer: `cv2.remap`, cubic"
            yield figure(what, ours, "dB", -least, peer=f"{peer:.2f} dB")


def started(arguments: list[str], home: Path) -> Callable[[], None]:
    """Return what runs a fresh interpreter whose user has no caches; bytecode is there, as installations leave it."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}

    def begin() -> None:
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir()
        subprocess.run([sys.executable, *arguments], env=environment, stdout=subprocess.DEVNULL, check=True)

    return begin


def starting(here: Path, runs: int) -> Iterator[Line]:
    """Processes that start, in turn with those of peers."""
    photo, home = here / "photo.png", here / "home"
    pyvips.Image.new_from_file(str(DATA / "astronaut.jpg")).pngsave(str(photo))
    names = "import supple; supple.Deformation; supple.Recipe"
    warp = ["-m", "supple", "warp", str(photo), str(here / "out.png"), "--grab", "256,256:256,346", "--radius", "100"]
    for what, ours, peer, bar in (
        ("whole process of a first-ever `supple warp photo.png out.png`, 512²", [*warp, "--force"], "numpy, pyvips", 3),
        ("`import supple`", ["-c", "import supple"], "numpy", 1.3),
        (f"`{names}`", ["-c", names], "numpy", 1.3),
    ):
        words = f"{what} / `import {peer}`"
        yield against(words, started(ours, home), started(["-c", f"import {peer}"], home), wall, runs, bar, warm=1)
    what = "a process that warps its first uint8, uint16, float32 and RGBA uint8 pictures of 512², and a volume of 128³"
    yield Line(what, value=alone(started(["-c", FIRST], home), wall, max(3, runs // 3)), unit="s", bar=1)


def peak_above(what: str, commands: Iterable[list[str]], data: float, room: float) -> Line:
    """Return a line of the peak memory of a second command above that of a first one, for some megabytes of data."""
    base, peak = (min(run([*COMMAND, *words])[1] for _ in range(2)) for words in commands)
    words = f"peak memory of `supple warp`, {what} (input and output: {data:.0f} MB)"
    return figure(words, peak - base, "MB", round(data + room))


def memory(here: Path, quick: bool) -> Iterator[Line]:
    """The peak of a whole command on a large picture, above that of one on a small picture."""
    side, commands = 2048 if quick else 8192, []
    for n in (64, side):
        source, middle = here / f"{n}.png", f"{n // 2},{n // 2}"
        cv2.imwrite(str(source), photograph(n, n), [cv2.IMWRITE_PNG_COMPRESSION, 1])
        stroke = ["--grab", f"{middle}:{n // 2},{n // 2 + n // 8}", "--radius", f"{n // 4}", "--quiet", "--force"]
        commands.append([str(source), str(here / "out.png"), *stroke])
    yield peak_above(f"{side}² RGB, above one of 64²", commands, 2 * side * side * 3 / 1e6, 100)
    source.unlink()


COPY = """
import sys, pyvips
image = pyvips.Image.new_from_file(sys.argv[1], access="sequential")
image.tiffsave(sys.argv[2], compression=sys.argv[3], predictor="horizontal")
"""


def tiffs(here: Path, quick: bool, runs: int) -> Iterator[Line]:
    """A whole command on 45 megapixels of 16 bits with a sensor's noise, against a copy by libvips."""
    height, width = (1376, 2064) if quick else (5504, 8256)
    clean = photograph(height, width) * np.float32(257)
    noise = np.random.default_rng(0).standard_normal(clean.shape, np.float32)
    pixels = np.clip(clean + noise * np.sqrt(6 * clean + 2500), 0, 65535).astype(np.uint16)
    stroke = ["--grab", f"{width // 2},{height // 2}:{width // 2 + 200},{height // 2}", "--radius", f"{height // 5}"]
    for compression in ("deflate", "lzw"):
        source = here / f"{compression}.tif"
        write(source, pixels, compression=compression)
        ours = [*COMMAND, str(source), str(here / "bent.tif"), *stroke, "--force", "--quiet"]
        copy = [sys.executable, "-c", COPY, str(source), str(here / "copy.tif"), compression]
        what = f"TIFF to TIFF, {width}×{height} RGB uint16, {compression}, whole command: ours / a copy by libvips"
        yield against(what, lambda words=ours: run(words), lambda words=copy: run(words), wall, runs, 1.5, warm=0)
        source.unlink()
