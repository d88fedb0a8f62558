"""What pip calls: scikit-build-core, with Zig's compiler where the machine has none, and plain editable installs.

An editable install is a path in a .pth file and the core compiled in place (``-C core=later`` leaves that to
``make core``); PYTHONPATH can name another tree before it.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import os
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import core
from scikit_build_core import build as scikit

Settings = dict[str, list[str] | str] | None

build_sdist = scikit.build_sdist
get_requires_for_build_sdist = scikit.get_requires_for_build_sdist
prepare_metadata_for_build_wheel = scikit.prepare_metadata_for_build_wheel


@contextlib.contextmanager
def _one_sentence() -> Iterator[None]:
    try:
        yield
    except (core.BuildError, KeyboardInterrupt) as error:
        print(f"\nsupple: {error or 'the build was interrupted.'}", file=sys.stderr)
        raise SystemExit(1) from None


def _later(settings: Settings) -> bool:
    return (settings or {}).get("core") == "later"


def _ours(settings: Settings) -> Settings:
    """Return the settings without those that scikit-build-core would not know."""
    return {name: value for name, value in (settings or {}).items() if name != "core"}


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """Add a compiler to what is needed, if the machine has none."""
    with _one_sentence():
        needed = [] if core.machine_compiler() else [core.ZIGLANG]
    return [*scikit.get_requires_for_build_wheel(_ours(config_settings)), *needed]


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """Need the same, unless the core is compiled later."""
    return [] if _later(config_settings) else get_requires_for_build_wheel(config_settings)


def build_wheel(wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None) -> str:
    """Build a wheel with the compiler that there is."""
    with _one_sentence(), tempfile.TemporaryDirectory() as scripts:
        core.need_headers()
        os.environ.update((core.machine_compiler() or core.zig()).environment(Path(scripts)))
        try:
            return scikit.build_wheel(wheel_directory, _ours(config_settings), metadata_directory)
        except SystemExit:
            raise core.BuildError("the native core could not be compiled; the first error is above.") from None


def prepare_metadata_for_build_editable(metadata_directory: str, config_settings: Settings = None) -> str:
    """Prepare the metadata, which are those of the wheel; they need no CMake."""
    settings = {**(_ours(config_settings) or {}), "wheel.cmake": "false", "wheel.py-api": "py3"}
    return scikit.prepare_metadata_for_build_wheel(metadata_directory, settings)


def build_editable(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """Compile the core in place, and make a wheel of nothing but the path to the sources."""
    if not _later(config_settings):
        with _one_sentence(), tempfile.TemporaryDirectory() as folder:
            # What pip brings for this build is gone after it, so that no build could go on from here.
            core.build(folder=Path(folder, "build"))
    with tempfile.TemporaryDirectory() as folder:
        info = Path(folder, prepare_metadata_for_build_editable(folder, config_settings))
        name = f"{info.name.removesuffix('.dist-info')}-py3-none-any.whl"
        files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in info.rglob("*") if path.is_file()}
        files[f"{info.name}/WHEEL"] = (
            b"Wheel-Version: 1.0\nGenerator: supple\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        files["_supple_editable.pth"] = f"{core.ROOT / 'src'}\n".encode()
        record = []
        with zipfile.ZipFile(Path(wheel_directory, name), "w") as wheel:
            for path, content in files.items():
                wheel.writestr(path, content)
                digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
                record.append(f"{path},sha256={digest},{len(content)}")
            wheel.writestr(f"{info.name}/RECORD", "\n".join([*record, f"{info.name}/RECORD,,", ""]))
    return name
