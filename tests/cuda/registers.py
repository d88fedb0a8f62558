"""What kernels take of a GPU's threads: registers, and bytes of the stack and of spills, as its compiler says.

``python -m tests.cuda.registers`` writes the table beside this file anew.
"""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from supple.cuda.programs import Program, compiled
from supple.cuda.warp import MAP

TABLE = Path(__file__).with_name("registers.md")
ARCHS = (75, 90, 100)
FILTERS = {"nearest": 0, "linear": 1, "cubic": 2, "auto": 3, "map": MAP}
Used = tuple[int, int, int]  # registers, stack, spills


def painting(unit: str, n: int, composed: bool, sample: str, number: str, together: int, name: str) -> Program:
    """A kernel that paints, as it is compiled by default."""
    between = int(n == 3 and name not in ("nearest", "map"))
    return Program(unit, n, composed, sample, number, together, FILTERS[name], between)


def rows() -> dict[str, tuple[Program, int]]:
    """All kernels of points and of the lattice on all architectures; of those that paint, the filters and sums."""
    made: dict[str, tuple[Program, int]] = {}
    for arch in ARCHS:
        for n in (2, 3):
            for composed in (False, True):
                for unit in ("points", "nodes", "cells"):
                    made[f"{unit} {n}-D {'composite' if composed else 'strokes'} sm_{arch}"] = (
                        Program(unit, n, composed), arch,
                    )  # fmt: skip
            for unit in ("fill", "rough"):
                made[f"{unit} {n}-D auto float sm_{arch}"] = painting(unit, n, False, "float", "float", 1, "auto"), arch
    for n in (2, 3):
        for name in FILTERS:
            made[f"fill {n}-D {name} float sm_90"] = painting("fill", n, False, "float", "float", 1, name), 90
        for sample, number in (("uint8_t", "float"), ("double", "double")):
            made[f"fill {n}-D auto {sample}, four channels sm_90"] = (
                painting("fill", n, False, sample, number, 4, "auto"), 90,
            )  # fmt: skip
        made[f"rough {n}-D auto uint8_t, composite sm_90"] = (
            painting("rough", n, True, "uint8_t", "float", 4, "auto"), 90,
        )  # fmt: skip
    return made


def used(program: Program, arch: int) -> Used:
    """Compile a program; SuppleError or CudaError if it does not."""
    _, log = compiled(program, arch, "-v")
    part = log[log.index(f"entry function '{program.unit}'") :]
    registers = re.search(r"Used (\d+) registers", part)
    found = re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", part)
    assert registers is not None
    assert found is not None
    return int(registers[1]), int(found[1]), max(int(found[2]), int(found[3]))


def known() -> dict[str, Used]:
    """The table."""
    found = {}
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4 and cells[1].isdigit():
            found[cells[0]] = int(cells[1]), int(cells[2]), int(cells[3])
    return found


def main() -> None:
    """Write the table."""
    wanted = rows()
    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(wanted, pool.map(lambda row: used(*row), wanted.values()), strict=True))
    lines = ["| kernel | registers | stack, bytes | spills, bytes |", "|---|--:|--:|--:|"]
    lines += [f"| {name} | {' | '.join(map(str, numbers))} |" for name, numbers in found.items()]
    text = "What kernels take of a thread, by NVRTC 13: `python -m tests.cuda.registers` writes this anew.\n\n"
    TABLE.write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
