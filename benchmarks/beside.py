"""Supple beside other tools, in five jobs: what docs/comparison.md says.

    python benchmarks/beside.py                    prints the tables, in some minutes
    python benchmarks/beside.py --quick            once each, and smaller; its figures mean nothing
    python benchmarks/beside.py --write            keeps the tables in docs/comparison.md
    python benchmarks/beside_pictures.py DIR       makes that page's pictures

GIMP's warp is run by the program gegl, and ImageMagick by its own (on Debian: apt install gegl imagemagick). The others
are in the `bench` extra, except for OpenCV's thin-plate spline, which only opencv-contrib-python has. What is not
installed is left out, with a line.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import reduce
from pathlib import Path

os.environ.setdefault("SUPPLE_THREADS", "2")

import numpy as np
from beside_tools import Array, Floats, Program, Stroke, Supple, Tool, loaded, sampled, saved, tools
from beside_volume import volume
from measure import alone, grid_of, in_turn, kept, machine, psnr, seconds, wall
from scipy import ndimage

import supple

PAGE = Path(__file__).parent.parent / "docs" / "comparison.md"
DATA = Path(supple.__file__).parent / "examples" / "data"
MILD = Stroke((206.0, 142.0), (194.0, 133.0), 24.0)  # the corner of the mouth of the astronaut, on 512²
STRONG = Stroke((206.0, 142.0), (168.0, 113.0), 24.0)  # by two radii, which is the brush's width
WITHIN = 4  # places along each side of a pixel, for truth
MARGIN = 6  # pixels of the border that do not count
FAR, NEAR = 4.0, 1.5  # radii


def arrival(of: Floats, stroke: Stroke) -> Floats:
    """Where the point that was taken hold of is seen: Newton's steps from its target."""
    q = np.array(stroke.end)
    small = 0.25 * np.eye(2)
    for _ in range(50):
        around = sampled(of, np.stack([q, *(q + small), *(q - small)]))
        slope = 2 * (around[1:3] - around[3:5]).T
        q = q - np.clip(np.linalg.lstsq(slope, around[0] - stroke.start, rcond=None)[0], -2, 2)
    return q


def folded(of: Floats) -> int:
    """How many cells between pixels are turned over: one of their two triangles has no area, or a negative one."""

    def areas(a: Floats, b: Floats) -> Floats:
        return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])

    right, down = np.diff(of, axis=1), np.diff(of, axis=0)
    return int(((areas(right[:-1], down[:, :-1]) <= 0) | (areas(right[1:], down[:, 1:]) <= 0)).sum())


def times(ours: Tool, tool: Tool, picture: Array, strokes: Sequence[Stroke], runs: int) -> str:
    """The cells of a tool's whole call: its time, ours in turn, and their ratio; of our own, its time alone."""
    if type(tool) is type(ours):
        return f"{seconds(alone(lambda: ours.warp(picture, strokes), wall, runs).median)} | |"
    return in_turn(lambda: tool.warp(picture, strokes), lambda: ours.warp(picture, strokes), wall, runs)


def dragged(picture: Array, stroke: Stroke, runs: int) -> Iterator[str]:
    """One drag by each tool: where it arrives, what folds, what changes far away, how long it takes."""
    yield (
        "| | misses its target by | folded cells | beyond 4 radii: moved by up to | pixels changed | time | "
        "ours, in turn | × ours |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    shape = (picture.shape[0], picture.shape[1])
    q = grid_of(shape)
    far = np.linalg.norm(q - stroke.start, axis=-1) > FAR * stroke.radius
    far &= np.linalg.norm(q - stroke.end, axis=-1) > FAR * stroke.radius
    ours = Supple()
    for tool in tools():
        if tool.missing:
            yield f"| {tool.name} | {tool.missing} | | | | | | |"
            continue
        of, bent = tool.map(shape, [stroke]), tool.warp(picture, [stroke])
        miss = float(np.linalg.norm(arrival(of, stroke) - stroke.end))
        moved = float(np.linalg.norm(of - q, axis=-1)[far].max())
        changed = float((bent != picture).any(axis=-1)[far].mean())
        yield (
            f"| {tool.name} | {miss:.2f} px | {folded(of)} | {moved:.2f} px | {100 * changed:.0f} % | "
            f"{times(ours, tool, picture, [stroke], runs)} |"
        )


def commands(picture: Array, stroke: Stroke, runs: int) -> Iterator[str]:
    """The same, as a shell runs it: a PNG is read, bent and written."""
    yield "| | time | ours, in turn | × ours |\n|---|---|---|---|"
    with tempfile.TemporaryDirectory() as folder:
        source, out = saved(Path(folder) / "in.png", picture), Path(folder)
        (x0, y0), (x1, y1) = stroke.start, stroke.end
        drag = f"{x0:g},{y0:g}:{x1:g},{y1:g}"
        command = [sys.executable, "-m", "supple", "warp", str(source), str(out / "ours.png"), "--grab", drag]
        command += ["--radius", f"{stroke.radius:g}", "--force", "--quiet"]

        def ours() -> None:
            run(command)

        yield f"| Supple | {seconds(alone(ours, wall, runs).median)} | | |"
        for tool in tools():
            if isinstance(tool, Program) and not tool.missing:
                theirs = tool.command(source, out / "theirs.png", [stroke])
                yield f"| {tool.name} | {in_turn(lambda words=theirs: run(words), ours, wall, runs)} |"


def run(command: list[str]) -> None:
    subprocess.run(command, capture_output=True, check=True)


def ten(height: int, width: int) -> list[Stroke]:
    """Ten strokes, each by six tenths of its radius, in two rows."""
    rng = np.random.default_rng(5)
    radius, found = height / 10, []
    for row in (0.34, 0.66):
        for column in np.linspace(0.18, 0.82, 5):
            x, y = np.array([column * width, row * height]) + rng.uniform(-0.02, 0.02, 2) * height
            angle = rng.uniform(0, 2 * np.pi)
            end = (x + 0.6 * radius * np.cos(angle), y + 0.6 * radius * np.sin(angle))
            found.append(Stroke((float(x), float(y)), (float(end[0]), float(end[1])), radius))
    return found


def halved(name: str, quick: bool) -> tuple[Floats, Array]:
    """A photograph, and what it is averaged down to."""
    full = loaded(DATA / name)
    full = full[: full.shape[0] // 2 * 2, : full.shape[1] // 2 * 2].astype(np.float64)
    if quick:
        full = full[:160, :160]
    blocks = full.reshape(full.shape[0] // 2, 2, full.shape[1] // 2, 2, 3)
    return full, np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def truth(full: Floats, maps: Sequence[Floats]) -> Floats:
    """What is seen of the full photograph in each pixel through maps, the last of which is applied first."""
    height, width = maps[0].shape[:2]
    bands = [ndimage.spline_filter(full[..., k], 3, mode="nearest") for k in range(3)]
    along = (np.arange(WITHIN) + 0.5) / WITHIN - 0.5
    total = np.zeros((height, width, 3))
    for v in along:
        for u in along:
            at = (
                reduce(lambda q, of: sampled(of, q), reversed(maps), grid_of((height, width)) + np.array([u, v])) * 2
                + 0.5
            )
            places = [at[..., 1], at[..., 0]]
            for k, band in enumerate(bands):
                total[..., k] += ndimage.map_coordinates(band, places, order=3, mode="nearest", prefilter=False)
    return total / WITHIN**2


def detail(values: Floats, where: Array) -> float:
    """How strong is what a blur by a pixel would take away."""
    fine = values - ndimage.gaussian_filter(values, (1, 1, 0))
    return float(np.sqrt((fine[where] ** 2).mean()))


def ways(tool: Tool, strokes: list[Stroke]) -> list[tuple[str, list[list[Stroke]]]]:
    """What is sampled once, and what again for each stroke."""
    if tool.points:
        return [(f"{tool.name}, all points at once", [strokes]), (f"{tool.name}, in turn", [[s] for s in strokes])]
    return [(tool.name, [strokes])]


def sharp(quick: bool) -> Iterator[str]:
    """Ten strokes by each tool, against truth under the tool's own map."""
    yield "| | against truth | fine detail, of the truth's | sampled |"
    yield "|---|---|---|---|"
    names = ("astronaut.jpg",) if quick else ("astronaut.jpg", "chelsea.jpg", "coffee.jpg")
    photos = [halved(name, quick) for name in names]
    for tool in tools(many=True):
        if tool.missing:
            yield f"| {tool.name} | {tool.missing} | | |"
            continue
        found: dict[str, list[tuple[float, float, int]]] = {}
        for full, picture in photos:
            shape = (picture.shape[0], picture.shape[1])
            for name, steps in ways(tool, ten(*shape)):
                maps = [tool.map(shape, step) for step in steps]
                bent = reduce(tool.warp, steps, picture).astype(np.float64)
                wanted = truth(full, maps)
                starts = np.array([stroke.start for step in steps for stroke in step])
                away = np.linalg.norm(grid_of(shape)[:, :, None] - starts, axis=-1).min(axis=-1)
                where = away < NEAR * steps[0][0].radius  # the same pixels for all
                edge = np.zeros(shape, bool)
                edge[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
                where &= edge
                kept_detail = detail(bent, where) / detail(wanted, where)
                found.setdefault(name, []).append((psnr(bent[where], wanted[where]), kept_detail, len(steps)))
        for name, each in found.items():
            decibels, fine, count = np.mean(each, axis=0)
            yield f"| {name} | {decibels:.1f} dB | {100 * fine:.0f} % | {'once' if count == 1 else '10 times'} |"


def timed(picture: Array, runs: int) -> Iterator[str]:
    """Ten strokes, sampled once: the time of a whole call."""
    yield "| | time | ours, in turn | × ours |\n|---|---|---|---|"
    ours, strokes = Supple(), ten(picture.shape[0], picture.shape[1])
    for tool in tools(many=True):
        if not tool.missing:
            yield f"| {tool.name} | {times(ours, tool, picture, strokes, runs)} |"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="once each, and smaller")
    parser.add_argument("--write", action="store_true", help="keep the tables in docs/comparison.md")
    asked = parser.parse_args()
    if asked.write and asked.quick:
        parser.error("--write keeps whole tables: leave out --quick")
    runs = 1 if asked.quick else 7
    picture = loaded(DATA / "astronaut.jpg")
    mild, strong = MILD, STRONG
    if asked.quick:
        picture, mild, strong = picture[::2, ::2], MILD.halved(), STRONG.halved()
    print(machine())
    page = PAGE.read_text(encoding="utf-8") if asked.write else ""
    if asked.write:
        page = kept(page, "machine", f"{machine()}; medians of {runs} pairs, of 3 for the volume.")
    jobs = {
        "drag": lambda: dragged(picture, mild, runs),
        "command": lambda: commands(picture, mild, runs),
        "strokes": lambda: sharp(asked.quick),
        "strokes-time": lambda: timed(picture, runs),
        "strong": lambda: dragged(picture, strong, runs),
        "volume": lambda: volume(asked.quick, runs),
    }
    for name, job in jobs.items():
        print(f"\n## {name}\n")
        lines = []
        for line in job():
            print(line, flush=True)
            lines.append(line)
        if asked.write:
            page = kept(page, name, "\n".join(lines))
    if asked.write:
        PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
