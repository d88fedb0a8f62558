"""Build the native core in place, into src/supple/_core: ``python tools/core.py [--best | --debug | --sanitize]``.

It needs nanobind, CMake and Ninja (all from PyPI), Python's headers, and a C++20 compiler: that of the machine, or
Zig's (``ziglang`` on PyPI), which is installed if there is no other.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CORE = Path("src", "supple", "_core")
ZIGLANG = "ziglang>=0.13"
WHAT = "core in C++"
COMPILERS = ["clang-cl"] if sys.platform == "win32" else ["c++", "g++", "clang++"]
SANITIZED = [
    *(f"tests/cuda/test_{name}.py" for name in ("brushes", "driver", "large", "maps", "parity")),
    "tests/test_blocks.py", "tests/core", "tests/engine/test_core.py",
]  # fmt: skip
EVERY = 11  # of many cases that differ little, how many are one under sanitizers
GLIBC = "2.28"  # the oldest that what Zig builds runs with: RHEL 8, Debian 10, Ubuntu 18.10

# What a compiler must be able to do.
PROBE = """
#include <bit>
#include <concepts>
#include <span>
#include <vector>
template <std::floating_point T> T sum(std::span<const T> s) { T t = 0; for (T x : s) t += x; return t; }
int main() { std::vector<double> v{1, 2}; return std::popcount(3u) + int(sum<double>(v)); }
"""


class BuildError(Exception):
    """The core cannot be built; the message says in one sentence why, and what to do."""


class Progress:
    """What is going on, by name: on a terminal one line that is written anew, elsewhere a line now and then."""

    SECONDS = 10.0  # between two lines

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._said = -self.SECONDS
        self._states: dict[str, str] = {}
        self._anew = sys.stdout.isatty()

    def tell(self, what: str, state: str) -> None:
        """Say how far something is."""
        self._states[what] = state
        if self._anew or time.monotonic() > self._said + self.SECONDS:
            self._said = time.monotonic()
            self._print("; ".join(f"{name}: {state}" for name, state in [*self._states.items()]))

    def end(self, what: str, state: str) -> None:
        """Say that something has ended, in a line of its own, if it was begun."""
        if self._states.pop(what, None) is not None:
            self._print(f"{what}: {state}", "\n")

    def _print(self, text: str, end: str = "") -> None:
        line = f"[{time.monotonic() - self._begun:3.0f} s] {text}"
        if self._anew:
            print(f"\r\033[K{line[: shutil.get_terminal_size().columns - 1]}", end=end, flush=True)
        else:
            print(line, flush=True)


@dataclass(frozen=True)
class Compiler:
    """A C++ compiler, as a command; Zig brings an archiver of its own."""

    command: tuple[str, ...]
    zig: bool = False

    def environment(self, scripts: Path) -> dict[str, str]:
        """Return what makes CMake use it; scripts for that are written to a folder that must outlive the build."""
        if not self.zig:
            return {"CXX": shlex.join(self.command)}
        scripts.mkdir(parents=True, exist_ok=True)
        for name in ("c++", "ar", "ranlib"):
            script = scripts / name
            text = f'#!/bin/sh\nexec nice -n 5 {shlex.join([*self.command, name])} "$@"\n'
            if not script.exists() or script.read_text() != text:
                script.write_text(text)
                script.chmod(0o755)
        defined = f"-DCMAKE_AR={scripts / 'ar'} -DCMAKE_RANLIB={scripts / 'ranlib'}"
        if sys.platform == "linux":
            target = f"{platform.machine()}-linux-gnu.{GLIBC}"
            # At its first link, Zig builds a C++ library: a minute of one processor. A link of nothing, with the flags
            # of a release, begins that at once. What is compiled meanwhile is nice to it; CMake, with the target as a
            # variable, tests the compiler without links; those of the core wait, as Zig locks its cache.
            defined += f" -DCMAKE_CXX_COMPILER_TARGET={target} -DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY"
            defined += " -DCMAKE_CXX_FLAGS_RELEASE_INIT=-s"  # without what debuggers read, Zig's default
            (scripts / "nothing.cpp").touch()
            flags = f"--target={target} -O3 -s -shared nothing.cpp -o nothing"
            command = [*self.command, "c++", *flags.split()]
            subprocess.Popen(command, cwd=scripts, stderr=subprocess.DEVNULL)
        return {"CXX": str(scripts / "c++"), "CMAKE_ARGS": f"{os.environ.get('CMAKE_ARGS', '')} {defined}".strip()}


def _compiles(command: Sequence[str]) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "probe.cpp")
        source.write_text(PROBE)
        level = ["-march=x86-64-v3"] if platform.machine() == "x86_64" else []
        if Path(command[0]).stem.endswith("clang-cl"):
            arguments = ["/std:c++20", "/EHsc", "probe.cpp"]
        else:
            arguments = ["-std=c++20", *level, "probe.cpp", "-o", "probe"]
        try:
            result = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, check=False)
        except OSError:
            return False
        return result.returncode == 0


def machine_compiler() -> Compiler | None:
    """Return the machine's own compiler: what CXX names ("zig": none), else the first that understands C++20."""
    chosen = os.environ.get("CXX", "")
    if chosen == "zig":
        return None
    if chosen:
        command = tuple(shlex.split(chosen))
        if not _compiles(command):
            raise BuildError(f"CXX={chosen} does not compile C++20: name another, or unset it.")
        return Compiler(command)
    for name in COMPILERS:
        found = shutil.which(name)
        if found and _compiles([found]):
            return Compiler((found,))
    return None


def zig() -> Compiler:
    """Return Zig's compiler, installed for this Python if it is not there."""
    if find_spec("ziglang") is None:
        print("No C++20 compiler is found: installing Zig's", flush=True)
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", ZIGLANG]
        if subprocess.run(command, check=False).returncode:
            raise BuildError(
                "There is no C++20 compiler, and pip could not install Zig's: is there a network? "
                "(Debian and Ubuntu have one: apt install g++)"
            )
        importlib.invalidate_caches()
    spec = find_spec("ziglang")
    if spec is None or not spec.submodule_search_locations:
        raise BuildError("There is no C++20 compiler: on Debian and Ubuntu, apt install g++.")
    return Compiler((str(Path(spec.submodule_search_locations[0], "zig")),), zig=True)


def need_headers() -> None:
    """Refuse a Python that no extension can be compiled for."""
    folder = sysconfig.get_path("include")
    if not Path(folder, "Python.h").exists():
        raise BuildError(
            f"Python's headers are missing ({folder}/Python.h): on Debian and Ubuntu, apt install python3-dev."
        )


def _tool(name: str) -> str:
    """Return where CMake or Ninja is: beside this Python, or on the path."""
    beside = shutil.which(name, path=sysconfig.get_path("scripts"))
    found = beside or shutil.which(name)
    if not found:
        raise BuildError(f"{name} is missing: pip install {name}.")
    return found


def _compile(ninja: str, where: Path, target: str, environment: Mapping[str, str], tell: Callable[[str], None]) -> None:
    """Compile what changed; what Ninja says of its progress is told, and nothing else shown but errors."""
    command = [ninja, "-C", str(where), target]
    environment = {**environment, "NINJA_STATUS": "[%f of %t] "}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, encoding="utf-8", errors="replace"
    ) as child:
        assert child.stdout is not None
        for line in child.stdout:
            if done := re.match(r"\[(\d+) of (\d+)\]", line):
                if done[1] != "0":
                    tell(f"{done[1]} of {done[2]} files compiled")
            elif not line.startswith("ninja: "):
                print("\r\033[K" if sys.stdout.isatty() else "", line, sep="", end="", file=sys.stderr, flush=True)
    if child.returncode:
        raise BuildError("The core does not compile: the first error is above.")


def _best(ninja: str, where: Path, output: Path) -> str:
    """Return the target of the best instruction set that this processor runs; what tells that is compiled."""
    built = next((ROOT / output).glob("cpu*.pyd" if sys.platform == "win32" else "cpu*.so"))
    spec = spec_from_file_location("cpu", built)
    assert spec is not None
    assert spec.loader is not None
    cpu = module_from_spec(spec)
    spec.loader.exec_module(cpu)
    listed = subprocess.run([ninja, "-C", str(where), "-t", "targets", "all"], capture_output=True, check=True).stdout
    targets = {line.partition(":")[0] for line in listed.decode().splitlines()}
    return next((f"core_{isa}" for isa in cpu.isas() if f"core_{isa}" in targets), "all")


def build(
    kind: str = "release",
    output: Path = CORE,
    *,
    folder: Path | None = None,
    best: bool = False,
    tell: Callable[[str], None] = lambda state: None,
) -> None:
    """Compile what changed, and put the modules into ``output``.

    Parameters
    ----------
    kind
        ``"release"``, ``"debug"`` (-O1 -g) or ``"sanitize"`` (for one instruction set, -O1, with address and
        undefined-behaviour sanitizers).
    output
        A folder, relative to the root.
    folder
        Where CMake works; by default one for each Python, in build/.
    best
        Whether to compile for the best instruction set of this processor alone.
    tell
        Called with how far it is.
    """
    need_headers()
    nanobind = find_spec("nanobind")
    if nanobind is None:
        raise BuildError("nanobind is missing: pip install nanobind.")
    what = "sanitize" if kind == "sanitize" else "core"
    where = folder or ROOT / "build" / f"{what}-{sys.implementation.cache_tag}"
    cmake, ninja = _tool("cmake"), _tool("ninja")
    launcher = ""
    if folder is None and os.name == "posix" and "CMAKE_CXX_COMPILER_LAUNCHER" not in os.environ:
        # For tests/house/test_compile.py: Ninja's log has time on the clock, which other processes lengthen.
        launcher = f"{sys.executable};-S;{ROOT / 'tools' / 'timed.py'}"
    # A configured folder is good for as long as all that it was configured with.
    wanted = {
        "kind": kind,
        "output": str(ROOT / output),
        "python": [sys.executable, sys.version],
        "nanobind": str(nanobind.origin),
        "tools": [cmake, ninja],
        "compilers": [shutil.which(name) for name in COMPILERS],
        "launcher": launcher,
        "environment": {k: os.environ.get(k, "") for k in ("CXX", "CXXFLAGS", "LDFLAGS", "CMAKE_ARGS")},
    }
    stamp = where / "configured.json"
    environment = dict(os.environ)
    known = json.loads(stamp.read_text()) if stamp.exists() else {}
    if known.get("wanted") != wanted or not (where / "build.ninja").exists():
        shutil.rmtree(where, ignore_errors=True)
        where.mkdir(parents=True)
        compiler = machine_compiler()
        if compiler is None and kind == "sanitize":
            raise BuildError("The sanitizers need GCC or Clang: on Debian and Ubuntu, apt install g++.")
        environment |= (compiler or zig()).environment(where / "zig")
        command = [cmake, "-S", str(ROOT), "-B", str(where), "-G", "Ninja", "--log-level=WARNING"]
        options = {
            "CMAKE_MAKE_PROGRAM": ninja,
            "CMAKE_BUILD_TYPE": "Release" if kind == "release" else "Debug",
            "Python_EXECUTABLE": sys.executable,
            "SUPPLE_OUTPUT": str(ROOT / output),
            "SUPPLE_SANITIZE": "ON" if kind == "sanitize" else "OFF",
        }
        if launcher:
            options["CMAKE_CXX_COMPILER_LAUNCHER"] = launcher
        command += [f"-D{name}={value}" for name, value in options.items()]
        command += shlex.split(environment.get("CMAKE_ARGS", ""))
        tell("prepared")
        # What goes well is not shown; errors go to standard error.
        if subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=False).returncode:
            raise BuildError("CMake could not prepare the build of the core: what is missing is said above.")
        stamp.write_text(json.dumps({"wanted": wanted}))
    target = "all"
    if best:
        _compile(ninja, where, "cpu", environment, tell)
        target = _best(ninja, where, output)
    _compile(ninja, where, target, environment, tell)


def shadow(folder: Path) -> None:
    """Make a package in ``folder`` that is this one, but for the compiled modules in its core."""
    package = folder / "supple"
    core = package / "_core"
    core.mkdir(parents=True, exist_ok=True)
    for source, target in ((ROOT / "src" / "supple", package), (ROOT / CORE, core)):
        for old in target.iterdir():
            if old.is_symlink():
                old.unlink()
        for file in source.iterdir():
            if file.name not in {"_core", "__pycache__"} and file.suffix not in {".so", ".pyd", ".cpp", ".hpp"}:
                (target / file.name).symlink_to(file)


def sanitize(tests: Sequence[str]) -> int:
    """Build with sanitizers, and run the core's tests; return 0 if nothing is found."""
    folder = Path("build", "sanitized")
    shadow(ROOT / folder)
    build("sanitize", folder / "supple" / "_core")
    (built,) = (path for path in (ROOT / folder / "supple" / "_core").glob("*.so") if not path.name.startswith("cpu."))
    compiler = machine_compiler()
    assert compiler is not None
    libraries = []
    for name in ("libasan.so", "libubsan.so", f"libclang_rt.asan-{platform.machine()}.so", "libclang_rt.asan.so"):
        result = subprocess.run(
            [*compiler.command, f"-print-file-name={name}"], capture_output=True, encoding="utf-8", check=True
        )
        path = result.stdout.strip()
        if Path(path).is_absolute() and Path(path).exists():
            libraries.append(path)
    if not libraries:
        raise BuildError("The compiler's sanitizer libraries are missing: on Debian and Ubuntu, apt install libasan8.")
    options = "halt_on_error=1:abort_on_error=1:print_stacktrace=1"
    environment = {
        **os.environ,
        "LD_PRELOAD": " ".join(libraries),
        # All of Python's objects are of this allocator: of the calls that made them, it keeps the last few.
        "ASAN_OPTIONS": f"{options}:detect_leaks=0:detect_stack_use_after_return=1:malloc_context_size=4",
        "UBSAN_OPTIONS": options,
        "PYTHONMALLOC": "malloc",  # so that Python's objects are watched as well
        "PYTHONPATH": str(ROOT / folder),
        "PYTHONDONTWRITEBYTECODE": "1",
        "SUPPLE_TEST_EVERY": str(EVERY),
        # The kernels for CUDA, compiled for this machine.
        "SUPPLE_TEST_KERNELS": "-O0 -g1 -fsanitize=address,undefined,float-cast-overflow "
        "-fno-sanitize=null,object-size,pointer-overflow -fno-sanitize-recover=all "
        "--param asan-instrumentation-with-call-threshold=0",
    }
    print(
        f"Watching memory and undefined behaviour: the core ({built.stem.partition('.')[0]}), and kernels for CUDA, "
        f"compiled for this processor; some cases of {', '.join(tests or SANITIZED)}",
        flush=True,
    )
    # Reports are written by C, past what Python's sys.stderr is: of a test that they end, pytest would keep them.
    command = [sys.executable, "-m", "pytest", "-q", "--capture=sys", "-p", "no:cacheprovider"]
    command += ["-n", "logical", "--dist", "loadfile", "-o", f"pythonpath={folder}"]
    if subprocess.run(
        [*command, *(tests or [*SANITIZED, "--ignore=tests/core/test_reference.py"])],  # which is NumPy alone
        cwd=ROOT,
        env=environment,
        check=False,
    ).returncode:
        raise BuildError("A test failed, or the sanitizers found an error, which is above.")
    return 0


def ended(name: str, work: Callable[[], int]) -> int:
    """Return the exit status of some work; what it could not do is one line."""
    try:
        return work()
    except BuildError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"\n{name}: interrupted; run it again to go on.", file=sys.stderr)
        return 130


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description="Build the native core in place.")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--best", action="store_true", help="for the best instruction set of this processor alone")
    how.add_argument("--debug", action="store_true", help="with -O1 -g and checks, for a debugger")
    how.add_argument("--sanitize", action="store_true", help="with sanitizers, elsewhere, and run its tests")
    parser.add_argument("tests", nargs="*", help="which tests, with --sanitize; by default the core's")
    options = parser.parse_args()
    if options.sanitize:
        return sanitize(options.tests)
    progress = Progress()
    kind = "debug" if options.debug else "release"
    build(kind, best=options.best, tell=lambda state: progress.tell(WHAT, state))
    progress.end(WHAT, "compiled")
    return 0


if __name__ == "__main__":
    sys.exit(ended("core", main))
