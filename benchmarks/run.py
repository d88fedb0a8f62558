"""All benchmarks, in one command: `make bench`, or `python benchmarks/run.py [--quick] [--only PART ...] [--write]`.

Each time is compared with a peer that runs in turn with it, with two threads each; the ratio is the median of the
ratios of those pairs. Rows are printed as they are measured. `--write` keeps the tables in docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path

os.environ["SUPPLE_THREADS"] = "2"

import cv2
import pictures
import video
import volume
from measure import HEAD, Line, Spread, kept, machine, missed, shown

import supple

Part = Callable[[], Iterable[Line]]

PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"
PEERS = ("numpy", "opencv-python-headless", "scikit-image", "pyvips", "av", "scipy", "simpleitk", "vtk")


def by_hand(demo: float | None, tests: float | None) -> list[Line]:
    """Return lines of what was measured with a clock, in seconds, if it is given."""
    cases = (("`make demo` from a fresh clone, installing included", demo, 120), ("`make test`", tests, 480))
    return [Line(what, value=None if taken is None else Spread.of(taken), unit="s", bar=most, note="by hand")
            for what, taken, most in cases]  # fmt: skip


def parts(here: Path, runs: int, quick: bool) -> tuple[dict[str, Part], dict[str, Part]]:
    """Return what is measured, by name: what was to be reached, then the rest; ``runs`` are those of a quick thing."""
    some, few = max(5, runs // 3), max(2, runs // 10)
    frames = 60 if quick else 132
    linear = {"filter": "linear"}
    first: dict[str, Part] = {
        "start": lambda: pictures.starting(here, some),
        "warp": lambda: pictures.one_warp(runs, pictures.REACHED),
        "quality": pictures.against_truth,
        "strokes": lambda: pictures.many_strokes(some, pictures.STROKES),
        "frame": lambda: [video.one_frame(runs, {}, "auto", 1.7)],
        "clip": lambda: [video.whole_clip(here, few, frames, 1.35)],
        "short-clips": lambda: video.short_clips(here, few),
        "borders": lambda: volume.borders(some),
        "volume": lambda: volume.whole_warps(some, 128 if quick else 256),
        "picture": lambda: volume.pictures(some),
        "paper": lambda: [pictures.of_the_paper(some, "auto", 25)],
    }
    rest: dict[str, Part] = {
        "warp-more": lambda: pictures.one_warp(max(5, runs // 2), pictures.MORE),
        "strokes-more": lambda: pictures.many_strokes(some, pictures.MORE_STROKES),
        "paper-more": lambda: [pictures.of_the_paper(some, None, 30)],
        "others": lambda: pictures.another_way(few),
        "memory": lambda: pictures.memory(here, quick),
        "tiffs": lambda: pictures.tiffs(here, quick, 1 if quick else 3),
        "frame-more": lambda: (
            video.one_frame(runs, *case) for case in (({}, None, None), (linear, "auto", None), (linear, None, 1.0))
        ),
        "clip-more": lambda: [video.whole_clip(here, few, frames, None, **linear)],
        "clip-memory": lambda: [video.memory(here)],
        "certified": video.certified,
        "volume-more": lambda: volume.more_warps(some, (128,) if quick else (128, 256)),
        "inverted": lambda: volume.inverted_fields(few, 64 if quick else 128),
        "points": lambda: volume.registered_points(some),
        "grain": volume.grain,
        "volume-memory": lambda: volume.memory(here, quick),
    }
    return first, rest


def main() -> int:
    """Print the tables; 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer runs, and smaller files and volumes")
    names = [name for table in parts(Path(), 31, False) for name in table]
    parser.add_argument("--only", nargs="+", metavar="PART", choices=names, help=f"of: {' '.join(names)}")
    parser.add_argument("--demo", type=float, metavar="SECONDS", help="what `make demo` took, from a fresh clone")
    parser.add_argument("--tests", type=float, metavar="SECONDS", help="what `make test` took")
    parser.add_argument("--write", action="store_true", help="keep the tables in docs/benchmarks.md")
    asked = parser.parse_args()
    if asked.write and (asked.quick or asked.only):
        parser.error("--write keeps whole tables: leave out --quick and --only")
    cv2.setNumThreads(2)
    warnings.simplefilter("error", supple.FoldWarning)
    warnings.filterwarnings("ignore", category=DeprecationWarning)  # VTK's own
    about = f"{machine()}; {', '.join(f'{name} {version(name)}' for name in PEERS)}"
    print(about)
    tables = []
    with tempfile.TemporaryDirectory() as folder:
        both = parts(Path(folder), 7 if asked.quick else 31, asked.quick)
        for title, table in zip(("What was to be reached", "The rest"), both, strict=True):
            chosen = [part for name, part in table.items() if not asked.only or name in asked.only]
            if chosen:
                print(f"\n## {title}\n\n{HEAD}", flush=True)
            tables.append([line for part in chosen for line in shown(part())])
            if table is both[0] and not asked.only:
                tables[0] += shown(by_hand(asked.demo, asked.tests))
    lines = [line for table in tables for line in table]
    short = [f"- {line.what}" for line in lines if line.holds is False]
    print(f"\n{len(lines)} lines; bars missed: {len(short)}", *short, sep="\n")
    if asked.write:
        page = PAGE.read_text(encoding="utf-8")
        for name, text in (
            ("machine", f"{about}."),
            *((name, "\n".join([HEAD, *map(str, t)])) for name, t in zip(("reached", "rest"), tables, strict=True)),
        ):
            page = kept(page, name, text)
        PAGE.write_text(page, encoding="utf-8")
        print(f"written: {PAGE}")
    return int(missed(lines))


if __name__ == "__main__":
    sys.exit(main())
