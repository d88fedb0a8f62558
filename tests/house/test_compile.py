"""The core compiles in little time: no file of it takes much longer than nanobind's own."""

from __future__ import annotations

import sys

import pytest

from tests.children import ROOT

BUILD = ROOT / "build" / f"core-{sys.implementation.cache_tag}" / "CMakeFiles"
SOURCES = sorted(path.name for path in (ROOT / "src" / "supple" / "_core").glob("*.cpp"))


def seconds(pattern: str) -> list[float]:
    """Seconds of a processor that the compiler took the last time for each of some objects."""
    return [float(path.read_text("ascii")) for path in BUILD.glob(f"{pattern}.seconds")]


def test_no_file_takes_three_times_as_long_as_the_largest_of_nanobind() -> None:
    known = seconds("nanobind-*/**/*.o")
    longest = {name: max(found) for name in SOURCES if (found := seconds(f"core_*/**/{name}.o"))}
    if not known or not longest or max(known) < 1:  # as where a compiler's results are kept
        pytest.skip("how long the compiler took is not known: the core was not compiled here, by `make core`")
    slow = {name: round(took / max(known), 1) for name, took in longest.items() if took > 3 * max(known)}
    assert not slow, f"times as long as nanobind: {slow}"
