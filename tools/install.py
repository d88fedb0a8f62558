"""Install Supple with some of its extras into this Python, and compile its core at the same time.

``python tools/install.py dev`` is what ``make venv`` runs. With ``--demo``, the core is compiled for this processor
alone, and the gallery is made. ``uv`` is used if it is on the path; else pip.
"""

from __future__ import annotations

import argparse
import collections
import importlib
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import core

# What compiles the core.
TOOLS = {"cmake": "cmake>=3.26", "nanobind": "nanobind>=3", "ninja": "ninja>=1.10"}
NO_NETWORK = "what Supple needs could not be installed: is there a network?"


def install(requirements: Sequence[str], progress: core.Progress, what: str) -> None:
    """Install into this Python: by uv, if there is one and it can, or by pip."""
    pip = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]
    # Python compiles what is imported, when it is.
    commands = [[*pip, "--no-compile", "--no-warn-script-location"]]
    if uv := shutil.which("uv"):
        commands.insert(0, [uv, "pip", "install", "--python", sys.executable])
    last: collections.deque[str] = collections.deque(maxlen=30)
    for command in commands:
        progress.tell(what, "begun")
        with subprocess.Popen(
            [*command, *requirements],
            cwd=core.ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
        ) as child:
            assert child.stdout is not None
            for line in child.stdout:
                last.append(line)
                if found := re.match(r"\s*Collecting ([\w.-]+)", line):
                    progress.tell(what, f"fetching {found[1]}")
                elif line.startswith("Installing collected packages"):
                    progress.tell(what, "unpacking")
        if not child.returncode:
            progress.end(what, "installed")
            return
    progress.end(what, "not installed")
    print(*last, sep="", file=sys.stderr)
    raise core.BuildError(NO_NETWORK)


def compiled(progress: core.Progress, best: bool) -> None:
    """Compile the core."""
    try:
        core.build(best=best, tell=lambda state: progress.tell(core.WHAT, state))
        progress.end(core.WHAT, "compiled")
    except Exception as error:
        progress.end(core.WHAT, "not compiled")
        if isinstance(error, core.BuildError):
            raise
        raise core.BuildError(f"the core: {type(error).__name__}: {error}") from error


def main() -> int:
    """Install, compile, and make the gallery if that is asked for."""
    parser = argparse.ArgumentParser(description="Install Supple with extras, and compile its core meanwhile.")
    parser.add_argument("extras", help="separated by commas; none if everything is installed")
    parser.add_argument("--demo", metavar="DIR", help="make the gallery there; compile for this processor alone")
    options = parser.parse_args()
    progress = core.Progress()
    missing = [requirement for name, requirement in TOOLS.items() if find_spec(name) is None]
    if missing:
        install(missing, progress, "tools for compiling")
        importlib.invalidate_caches()
    with ThreadPoolExecutor(1) as pool:
        compiling = pool.submit(compiled, progress, bool(options.demo))
        if options.extras:
            editable = ["--config-settings", "core=later", "--editable", f".[{options.extras}]"]
            install(editable, progress, "libraries")
    compiling.result()
    if options.demo:
        command = [sys.executable, "-m", "supple", "demo", options.demo, "--force"]
        return subprocess.run(command, cwd=core.ROOT, check=False).returncode
    return 0


if __name__ == "__main__":
    sys.exit(core.ended("install", main))
