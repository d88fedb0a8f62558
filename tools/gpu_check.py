"""Test and time all that an NVIDIA GPU does, in minutes: ``make gpu-check``, or ``python tools/gpu_check.py``.

For machines that are there for a short time, without a network: ``--wheels`` names a folder with what this Python lacks
(wheels, one of Supple's among them, and Debian's packages of the Vulkan loader). Tests run side by side; benchmarks run
one after the other, when the GPU has nothing else to do. Each part has a log in the folder of results, and a line in
its table. Both are written as they come: a part that is cut off keeps the names of what has passed and failed.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MODULES = ROOT / "src" / "supple" / "_core"
HEAD = "| part | | passed | failed | skipped | s |\n|---|---|---|---|---|---|"
LOOKED_IN = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")  # by the loader, for drivers
ELSEWHERE = "/usr/local/nvidia/share/vulkan/icd.d"  # where containers have NVIDIA's
MOST = 6  # workers of pytest
STATES = "PASSED|FAILED|ERROR|SKIPPED"


@dataclass(frozen=True)
class Part:
    """A command, and the seconds that it may take."""

    name: str
    command: tuple[str, ...]
    seconds: float
    environment: dict[str, str] = field(default_factory=dict)

    def log(self, results: Path) -> Path:
        """Return the file that it writes to."""
        return results / f"{re.sub('[^a-z]+', '-', self.name.lower()).strip('-')}.log"


def pytest(name: str, *words: str, seconds: float, workers: int = 0, **environment: str) -> Part:
    """Tests, whose names are written when they end."""
    spread = ("-n", str(workers), "--dist", "load") if workers else ()
    command = (sys.executable, "-m", "pytest", "-v", "--tb=short", "-p", "no:cacheprovider", *spread, *words)
    return Part(name, command, seconds, environment)


def tests(simulated: bool, seconds: float) -> list[Part]:
    """In the order of their worth: a real GPU's first."""
    cuda = {} if simulated else {"SUPPLE_TEST_CUDA": "1"}
    few = max(1, min(MOST, (os.cpu_count() or 2) // 3))
    sized = ("tests/cuda/test_at_size.py", "tests/cuda/test_kinds_at_size.py")
    rest = ("tests/cuda", *(f"--ignore={name}" for name in (*sized, "tests/cuda/test_programs.py")))
    parts = [
        pytest("CUDA at size", *sized, seconds=seconds, workers=few, **cuda),
        pytest("CUDA, the rest", *rest, seconds=seconds, workers=few, **cuda),
        pytest("drawing", "tests/gpu", seconds=seconds, workers=few, SUPPLE_TEST_GPU="1"),
    ]
    watcher = shutil.which("compute-sanitizer")
    if watcher and not simulated:
        watched = pytest("compute-sanitizer", "tests/cuda/test_memory.py", seconds=seconds, **cuda)
        before = (watcher, "--tool", "memcheck", "--report-api-errors", "no", "--error-exitcode", "1")
        parts.insert(2, Part(watched.name, (*before, *watched.command), seconds, watched.environment))
    return parts


def benchmarks(simulated: bool, seconds: float, results: Path) -> list[Part]:
    """Of few runs."""
    cuda = ["benchmarks/cuda_engine.py", "--json", str(results / "cuda.json")]
    cuda += ["--dry"] * simulated
    drawing = ["benchmarks/gpu.py", *["--quick"] * simulated]
    named = {"CUDA's benchmark": cuda, "drawing's benchmark": drawing}
    return [Part(name, (sys.executable, *command), seconds) for name, command in named.items()]


def unpacked(wheels: Path | None, folder: Path) -> dict[str, str]:
    """Install what is carried along into a folder; return what programs must find in their environment."""
    around = {**os.environ, "PYTHONUNBUFFERED": "1"}
    paths = [str(ROOT / "src"), str(ROOT / "benchmarks"), str(ROOT)]
    if wheels is not None:
        carried = [str(path) for path in sorted(wheels.glob("*.whl")) if not path.name.startswith("supple-")]
        site = folder / "site"
        if carried:
            command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-compile",
                       "--upgrade", "--target", str(site), *carried]  # fmt: skip
            subprocess.run(command, check=True)
            paths.append(str(site))
        for ours in wheels.glob("supple-*.whl"):
            with zipfile.ZipFile(ours) as wheel:
                for name in wheel.namelist():
                    if name.startswith("supple/_core/") and name.endswith(".so"):
                        (MODULES / Path(name).name).write_bytes(wheel.read(name))
        libraries = folder / "libraries"
        for package in wheels.glob("*.deb"):
            subprocess.run(["dpkg", "-x", str(package), str(libraries)], check=True)
        found = sorted({str(path.parent) for path in libraries.rglob("*.so*")})
        around["LD_LIBRARY_PATH"] = os.pathsep.join([*found, *filter(None, [os.environ.get("LD_LIBRARY_PATH")])])
    # Without a driver among those that the loader looks for, one that containers have elsewhere.
    usual, others = (
        [*chain(*(Path(place).glob("*nvidia*.json") for place in each))] for each in (LOOKED_IN, [ELSEWHERE])
    )
    if others and not usual:
        around.setdefault("VK_DRIVER_FILES", str(others[0]))
    around["PYTHONPATH"] = os.pathsep.join([*paths, *filter(None, [os.environ.get("PYTHONPATH")])])
    return around


def built(around: dict[str, str]) -> None:
    """Compile the core, unless this Python can load it."""
    loads = subprocess.run([sys.executable, "-c", "import supple"], env=around, capture_output=True, check=False)
    if loads.returncode:
        subprocess.run([sys.executable, str(ROOT / "tools" / "core.py"), "--best"], env=around, check=True)


def ran(part: Part, around: dict[str, str], results: Path, until: float) -> str:
    """Run a part; return its line of the table."""
    log = part.log(results)
    begun, limit = time.monotonic(), min(part.seconds, until - time.monotonic())
    if limit < 5:
        return f"| {part.name} | **no time left** | | | | |"
    with log.open("w") as file:
        running = subprocess.Popen(part.command, cwd=ROOT, env={**around, **part.environment}, stdout=file,
                                   stderr=subprocess.STDOUT, start_new_session=True)  # fmt: skip
        try:
            state = "passed" if running.wait(limit) == 0 else "**failed**"
        except subprocess.TimeoutExpired:
            state = "**cut off**"
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)
            running.wait()
    text = log.read_text(errors="replace")
    # A line "file::test STATE", or of a worker "[gw0] [ 1%] STATE file::test".
    found = re.findall(rf"^(?:\[.*?\] \[.*?\] ({STATES}) (.*?)\s*|(\S.*?::.*?) ({STATES}).*)$", text, re.MULTILINE)
    ended = {(first or fourth, second or third) for first, second, third, fourth in found}
    counts = [sum(state in states for state, _ in ended) for states in (("PASSED",), ("FAILED", "ERROR"), ("SKIPPED",))]
    cells = [str(count) if count else "" for count in counts]
    return f"| {part.name} | {state} | {' | '.join(cells)} | {time.monotonic() - begun:.0f} |"


def main() -> int:
    """Run all; 1 if something failed, or was cut off."""
    parser = argparse.ArgumentParser(description="Test and time all that an NVIDIA GPU does.")
    parser.add_argument("--wheels", type=Path, metavar="DIR", help="what this Python and this machine lack")
    parser.add_argument("--results", type=Path, default=ROOT / "build" / "gpu-check", metavar="DIR")
    parser.add_argument("--minutes", type=float, default=8.0, help="after which all is ended (8)")
    parser.add_argument(
        "--simulated", action="store_true", help="without a GPU: CUDA is simulated, and benchmarks tiny"
    )
    asked = parser.parse_args()
    results: Path = asked.results.resolve()
    results.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    until = begun + 60 * asked.minutes
    around = unpacked(asked.wheels and asked.wheels.resolve(), ROOT / "build" / "gpu-check")
    built(around)
    lines: list[str] = []

    def write(line: str) -> None:
        lines.append(line)
        (results / "table.md").write_text("\n".join([HEAD, *lines, ""]), encoding="utf-8")
        print(line, flush=True)

    print(HEAD, flush=True)
    write(f"| what is installed | | | | | {time.monotonic() - begun:.0f} |")
    whole = 60 * asked.minutes
    parts = tests(asked.simulated, whole / 2)
    with ThreadPoolExecutor(1 if asked.simulated else len(parts)) as pool:
        for line in pool.map(lambda part: ran(part, around, results, until), parts):
            write(line)
    for part in benchmarks(asked.simulated, whole / 2, results):
        write(ran(part, around, results, until))
        print(part.log(results).read_text(errors="replace"), flush=True)
    for log in sorted(results.glob("*.log")):
        failed = re.findall(
            r"^(?:FAILED|ERROR) tests/.*$|^\[.*\] (?:FAILED|ERROR) .*$", log.read_text(errors="replace"), re.M
        )
        for line in dict.fromkeys(failed):
            print(f"{log.stem}: {line}"[:200], flush=True)
    return int("**" in "".join(lines))


if __name__ == "__main__":
    sys.exit(main())
