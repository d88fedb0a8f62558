"""Test the lowest and the newest version of each dependency that pyproject.toml admits.

An environment for each, in build/versions, is kept for the next time; tests/versions says what is tried there.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib

import core

PLACE = core.ROOT / "build" / "versions"
TESTS = ("pytest>=8.4", "pytest-timeout>=2.3", "pytest-xdist>=3.6", "hypothesis>=6.100")
NOT_INSTALLED = 3
RESOLUTIONS = {"lowest": "lowest-direct", "newest": "highest"}


def requirements() -> list[str]:
    """Return what Supple needs with all that a window, a clip, a volume or a store takes."""
    project = tomllib.loads((core.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    (named,) = extras["all"]
    names = re.fullmatch(r"supple\[(.*)\]", named)[1].split(",")  # type: ignore[index]
    return sorted({*project["dependencies"], *(line for name in names for line in extras[name]), *TESTS})


def main() -> int:
    """Make the environments, and run the tests in each."""
    PLACE.mkdir(parents=True, exist_ok=True)
    listed = PLACE / "requirements.txt"
    listed.write_text("\n".join(requirements()) + "\n", encoding="utf-8")
    failed = []
    for name, resolution in RESOLUTIONS.items():
        place = PLACE / name
        uv = [sys.executable, "-m", "uv", "--quiet"]
        made = [*uv, "venv", "--allow-existing", "--python", sys.executable, str(place)]
        python = place / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
        filled = [*uv, "pip", "install", "--upgrade", "--python", str(python), "--resolution", resolution]
        for command in (made, [*filled, "--requirement", str(listed)]):
            if subprocess.run(command, check=False).returncode:
                print(
                    f"versions: the {name} were not installed, as is said above: is there a network?", file=sys.stderr
                )
                return NOT_INSTALLED
        print(f"With the {name} versions:", flush=True)
        # Old versions warn of what newer ones of others deprecate.
        tested = [str(python), "-m", "pytest", "-q", "-W", "default", "-p", "no:cacheprovider", "--timeout", "120"]
        environment = {**os.environ, "PYTHONPATH": str(core.ROOT / "src"), "PYTEST_ADDOPTS": ""}
        if subprocess.run([*tested, "tests/versions"], cwd=core.ROOT, env=environment, check=False).returncode:
            failed.append(name)
    if failed:
        print(f"versions: tests fail with the {' and the '.join(failed)} versions.", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
