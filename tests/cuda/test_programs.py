"""Kernels compile for every GPU without one, are kept on disk, and take no more of its threads than the table says."""

from __future__ import annotations

from pathlib import Path

import pytest

from supple.cuda import programs
from supple.cuda.device import CudaError
from supple.cuda.programs import UNITS, Program, compiled, folder, kept, sources
from supple.cuda.warp import _TYPES
from tests.cuda.driver import REAL
from tests.cuda.registers import known, rows, used
from tests.effort import soak

pytest.importorskip("cuda.bindings")
SMALL = Program("fill", 2, False, "float", "float", 1, 1)


def test_the_table_has_all_kernels() -> None:
    assert list(known()) == list(rows())


# A compiler takes seconds for each. Of all kernels, on the oldest and the newest GPUs, by both kinds of maps, and by
# auto, with which no type is compiled below:
FEW = ("cells 2-D composite sm_75", "fill 3-D auto float sm_100")
slow = soak("all kernels compiled for GPUs of three kinds, and each type by every filter")
KERNELS = [pytest.param(name, marks=() if REAL or name in FEW else slow) for name in rows()]
SAMPLES = sorted({sample for sample, _ in _TYPES.values()})
FILLS = [
    pytest.param(sample, number, marks=() if REAL or (number < 3 and k == 3 * number) else slow)
    for k, sample in enumerate(SAMPLES)
    for number in range(4)
]


@pytest.mark.parametrize("name", KERNELS)
def test_registers_and_spills(name: str) -> None:
    registers, stack, spills = used(*rows()[name])
    wanted = known()[name]
    assert registers <= 255
    # Another compiler may do it a little otherwise.
    assert registers <= 1.15 * wanted[0] + 8
    assert stack <= 1.15 * wanted[1] + 64
    assert spills <= 1.15 * wanted[2] + 64


@pytest.mark.parametrize(("sample", "filter"), FILLS)
def test_every_type_compiles(sample: str, filter: int) -> None:
    number = dict(_TYPES.values())[sample]
    rare = int(filter == 2)
    program = Program("fill", 3, False, sample, number, 1 if filter % 2 else 4, filter, int(filter > 0), rare, rare)
    code, log = compiled(program, 80)
    assert code[1:4] == b"ELF"
    assert "warning" not in log
    # An empty log is one byte, and Python shares all bytes of length 1: written to, a space is no space anywhere.
    assert chr(32).encode()[0] == 32


def test_headers_are_those_that_are_included() -> None:
    headers = dict(sources())
    assert list(headers)[-1] == "kernels.cu"
    assert '#include "' not in headers.pop("kernels.cu")
    core = {"stroke.hpp", "newton.hpp", "patch.hpp", "footprint.hpp", "field.hpp", "freeze.hpp"}
    assert core | {"paint.hpp", "points.hpp"} <= set(headers)
    assert not {"plan.hpp", "vectors.hpp", "threads.hpp"} & set(headers)
    for header in headers.values():
        assert "std::" not in header.split("#if !defined(__CUDACC_RTC__)")[0].replace("no std::", "")


def test_programs_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_CACHE", str(tmp_path / "cache"))
    assert folder() == tmp_path / "cache"
    code = kept(SMALL, 90)
    (path,) = folder().iterdir()
    assert path.name.startswith("fill-sm_90-")
    assert path.read_bytes() == code
    monkeypatch.setattr(programs, "compiled", lambda *given: pytest.fail("it was compiled again"))
    assert kept(SMALL, 90) == code


def test_what_has_changed_is_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_CACHE", str(tmp_path))
    asked: list[tuple[Program, int]] = []

    def made(program: Program, arch: int) -> tuple[bytes, str]:
        asked.append((program, arch))
        return b"code", ""

    monkeypatch.setattr(programs, "compiled", made)
    kept(SMALL, 90)
    kept(SMALL, 80)
    changed = {name: text + " " for name, text in sources().items()}
    monkeypatch.setattr(programs, "sources", lambda: changed)
    kept(SMALL, 90)
    kept(SMALL, 90)
    assert asked == [(SMALL, 90), (SMALL, 80), (SMALL, 90)]


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SUPPLE_CACHE", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(programs, "compiled", lambda program, arch: (b"code", ""))
    assert kept(SMALL, 90) == b"code"


def test_what_does_not_compile_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "sources", lambda: {"kernels.cu": "int x = ;"})
    with pytest.raises(CudaError, match=r"(?s)^NVRTC: .*NVRTC_ERROR_COMPILATION.*error"):
        compiled(SMALL, 90)
    assert f"UNIT={UNITS.index('points')}" in Program("points", 2).macros
