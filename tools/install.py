"""Install Supple with some of its extras into this Python, and compile its core at the same time.

``python tools/install.py dev`` is what ``make venv`` runs. With ``--demo``, the core is compiled for this processor
alone, and the gallery is made. ``uv`` is used if it is on the path; else pip.
"""

from __future__ import annotations

import argparse
import collections
import importlib
import shutil
import subprocess
import sys
import threading
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import core

# What compiles the core.
TOOLS = {"cmake": "cmake>=3.26", "nanobind": "nanobind>=3", "ninja": "ninja>=1.10"}
NO_NETWORK = "what Supple needs could not be installed: is there a network?"


def install(requirements: Sequence[str], progress: core.Progress, what: str) -> None:
    """Install into this Python."""
    uv = shutil.which("uv")
    if uv:
        command = [uv, "pip", "install", "--python", sys.executable]
    else:
        command = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]
        command += ["--no-compile", "--no-warn-script-location"]
    # Python compiles what is imported, when it is.
    progress.tell(what, "begun")
    last: collections.deque[str] = collections.deque(maxlen=30)
    with subprocess.Popen(
        [*command, *requirements], cwd=core.ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8"
    ) as child:
        assert child.stdout is not None
        for line in child.stdout:
            last.append(line)
            words = line.split()
            if words and words[0] in {"Collecting", "Downloading", "Installing", "Resolved", "Prepared"}:
                progress.tell(what, " ".join(words)[:60])
    if child.returncode:
        print("", *last, sep="\n" if sys.stdout.isatty() else "", file=sys.stderr)
        raise core.BuildError(NO_NETWORK)
    progress.end(what, "installed")


def main() -> int:
    """Install, compile, and make the gallery if that is asked for."""
    parser = argparse.ArgumentParser(description="Install Supple with extras, and compile its core meanwhile.")
    parser.add_argument("extras", help="separated by commas")
    parser.add_argument("--demo", metavar="DIR", help="make the gallery there; compile for this processor alone")
    options = parser.parse_args()
    progress = core.Progress()
    failures: list[core.BuildError] = []

    def compiled() -> None:
        try:
            core.build(best=bool(options.demo), tell=lambda state: progress.tell(core.WHAT, state))
            progress.end(core.WHAT, "compiled")
        except core.BuildError as error:
            failures.append(error)

    try:
        missing = [requirement for name, requirement in TOOLS.items() if find_spec(name) is None]
        if missing:
            install(missing, progress, "tools that compile")
            importlib.invalidate_caches()
        compiler = threading.Thread(target=compiled, daemon=True)
        compiler.start()
        install(["--config-settings", "core=later", "--editable", f".[{options.extras}]"], progress, "libraries")
        compiler.join()
        if failures:
            raise failures[0]
    except core.BuildError as error:
        print(f"install: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ninstall: interrupted; run it again to go on.", file=sys.stderr)
        return 130
    if options.demo:
        command = Path(sys.executable).parent / "supple"
        return subprocess.run([command, "demo", options.demo, "--force"], cwd=core.ROOT, check=False).returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
