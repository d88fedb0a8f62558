"""How quickly Supple starts: `python benchmarks/startup.py [--runs N]`.

Each run is a fresh process, in turn with that of the peer: importing the package and its main names against importing
NumPy, and a whole `supple warp` of a photograph of 512² against importing NumPy and pyvips. All caches of a user are
empty in each run; bytecode is there, as an installation leaves it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pyvips
from measure import Row, machine, timed

import supple

DATA = Path(supple.__file__).parent / "examples" / "data"
STROKE = ["--grab", "256,256:256,346", "--radius", "100"]


def started(arguments: list[str], home: Path) -> Callable[[], None]:
    """Return what runs a fresh interpreter whose user has no caches; it must succeed."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}

    def run() -> None:
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir()
        subprocess.run([sys.executable, *arguments], env=environment, stdout=subprocess.DEVNULL, check=True)

    return run


def rows(here: Path, runs: int) -> list[Row]:
    """Measure both, in pairs."""
    photograph, target = here / "photo.png", here / "out.png"
    pyvips.Image.new_from_file(str(DATA / "astronaut.jpg")).pngsave(str(photograph))
    home = here / "home"
    names = "import supple; supple.Deformation; supple.Recipe"
    warp = ["-m", "supple", "warp", str(photograph), str(target), *STROKE, "--force"]
    return [
        timed(what, started(ours, home), started(["-c", f"import {peer}"], home), runs, bar)
        for what, ours, peer, bar in (
            ("`import supple`", ["-c", "import supple"], "numpy", 1.3),
            (f"`{names}`", ["-c", names], "numpy", 1.3),
            ("`supple warp photo.png out.png`, 512²", warp, "numpy, pyvips", 3.0),
        )
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=15, help="pairs of processes (15)")
    asked = parser.parse_args()
    print(f"{machine()}\n\n| what | ours | peer | median ratio | bar | runs |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        made = rows(Path(folder), asked.runs)
    for row in made:
        holds = "" if row.holds else " (missed)"
        print(f"| {row.what} | {row.ours} | {row.peer} | {row.value} | {row.bar}{holds} | {row.runs} |")
    return 0 if all(row.holds for row in made) else 1


if __name__ == "__main__":
    sys.exit(main())
