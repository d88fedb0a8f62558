"""What several files of tests share."""

from __future__ import annotations

import copy
import gc
import os
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cyclopts
import hypothesis
import pytest

from supple.errors import SuppleError
from supple.gpu.device import Gpu, open_gpu
from tests import effort

# No test fails because a machine is slow; a fixed number of examples, so that none takes longer on some day.
hypothesis.settings.register_profile("supple", deadline=None, max_examples=300 if effort.ALL else 30)
hypothesis.settings.load_profile("supple")

# Workers fill all processors: threads of PyTorch would only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

LEFT_OUT = pytest.StashKey[int]()

# A worker has a file at a time: those that take longest are begun first, so that none of them is waited for at the end.
LONGEST = (
    "viewer/test_window_browser.py",
    "engine/test_core.py",
    "viewer/test_freezing.py",
    "viewer/test_panels_slices.py",
    "viewer/test_panels.py",
    "viewer/test_panels_parts.py",
    "gpu/test_rendering.py",
    "viewer/test_window_pointer.py",
    "cuda/test_programs.py",
    "files/test_stores.py",
    "house/test_docs.py",
    "plot/test_diagnostics.py",
    "files/test_clip_commands.py",
    "engine/test_frames.py",
    "examples/test_gallery.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; under sanitizers, leave out most cases of a test that has many."""
    if effort.EVERY > 1:
        kept: dict[str, int] = {}
        for item in sorted(items, key=lambda item: zlib.crc32(item.nodeid.encode())):
            test = item.nodeid.partition("[")[0]
            kept[test] = kept.get(test, 0) + 1
            if kept[test] > effort.CASES:
                items.remove(item)
    turn = {Path(__file__).parent / name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: turn.get(item.path, len(turn)))


def pytest_collection_finish() -> None:
    """What is imported stays: it need not be looked through whenever something is freed."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Give what this worker left out to the process that reports."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = effort.left_out


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Keep what a worker left out: all collect the same files."""
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", 0)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Say what is left out; slow tests are listed with what was skipped."""
    rows = config.stash.get(LEFT_OUT, effort.left_out)
    if rows and effort.EVERY == 1:
        terminalreporter.write_line(
            f"Of options, every pair was tested; the {rows} other combinations are left out: make soak tests all"
        )


@pytest.fixture(scope="session", autouse=True)
def _options_read_once() -> Iterator[None]:
    """Read the options of a command from its signature once: it takes 20 ms, and there are a thousand command lines."""
    read, known = cyclopts.App.assemble_argument_collection, dict[Any, Any]()

    def fresh(app: cyclopts.App, **options: Any) -> Any:
        key = app.default_command, *options.items()
        if key not in known:
            known[key] = read(app, **options)
        copies = {id(argument): copy.copy(argument) for argument in known[key]}
        for argument in copies.values():
            argument.tokens = []
            argument.children = type(known[key])(copies[id(child)] for child in argument.children)
        return type(known[key])(copies.values())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cyclopts.App, "assemble_argument_collection", fresh)
        yield


@pytest.fixture(scope="module", autouse=True)
def _collected() -> Iterator[None]:
    """Free what a file leaves behind in this thread: windows and contexts of Dear ImGui abort in another one."""
    yield
    if "imgui_bundle" in sys.modules:
        gc.collect()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run a command line in this process: its status, and what it said on both streams."""
    from supple.cli import command

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        return command(arguments), *capsys.readouterr()

    return run


@pytest.fixture
def gpu() -> Gpu:
    """Whatever adapter there is, opened; where SUPPLE_TEST_GPU is set, there must be one."""
    try:
        return open_gpu()
    except SuppleError as error:
        if os.environ.get("SUPPLE_TEST_GPU") == "1":
            raise
        pytest.skip(str(error))


@pytest.fixture
def memory() -> Iterator[str]:
    """An address in memory, empty."""
    fsspec = pytest.importorskip("fsspec")
    address = f"memory://supple-{os.urandom(4).hex()}"
    yield address
    fs = fsspec.filesystem("memory")
    if fs.exists(address):
        fs.rm(address, recursive=True)
