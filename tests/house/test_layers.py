"""The import rule (data flows one way, and the check that says so bites), and the version."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests.children import ROOT


def lint_imports(root: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command as run; run()",
            "--no-cache",
        ],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root / "src")},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )


def test_imports_against_the_rule_are_found(tmp_path: Path) -> None:
    """And no others, so that the source as it is keeps the rule."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    for module, line in (
        ("errors.py", "import supple.space.domain\n"),
        ("strokes/stroke.py", "from supple import cli\n"),
        ("space/domain.py", "def late() -> None:\n    import supple.deformation\n"),
        ("_core/bad.py", "import supple.media\n"),
        ("engine/core.py", "import supple.arrays\n"),
    ):
        with (tmp_path / "src" / "supple" / module).open("a") as file:
            file.write(f"\n\n{line}")
    result = lint_imports(tmp_path)
    assert result.returncode == 1, result.stdout + result.stderr
    assert "Data flows one way BROKEN" in result.stdout
    assert sorted(re.findall(r"^(\S+) is not allowed to import (\S+):$", result.stdout, re.MULTILINE)) == [
        ("supple._core", "supple.media"),
        ("supple.engine", "supple.arrays"),
        ("supple.errors", "supple.space"),
        ("supple.space", "supple.deformation"),
        ("supple.strokes", "supple.cli"),
    ]
    assert "The window's rooms, one above the other KEPT" in result.stdout


def test_the_citation_is_of_this_version() -> None:
    init = (ROOT / "src" / "supple" / "__init__.py").read_text(encoding="utf-8")
    version = re.findall(r'^__version__ = "(.+)"$', init, re.MULTILINE)
    assert version == re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert len(version) == 1


def test_torch_is_asked_for_only_by_those_who_ask_for_it() -> None:
    program = """
import sys
import supple
supple.Deformation((3, 3)).grab((1, 1), by=(0.1, 0), radius=2).warp
assert "torch" not in sys.modules
sys.modules["torch"] = None  # as if it were not installed
try:
    import supple.torch
except ImportError as error:
    print(error)
"""
    result = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert result.stdout == "supple.torch needs PyTorch, which is not installed: pip install torch\n", result.stderr


def test_media_import_each_other_in_no_circle() -> None:
    """Not even late, or for types alone."""
    source = ROOT / "src"
    files = {
        ".".join(path.relative_to(source).with_suffix("").parts).removesuffix(".__init__"): path
        for path in (source / "supple" / "media").rglob("*.py")
    }
    below: dict[str, set[str]] = {}
    for name, path in files.items():
        found = [node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.ImportFrom)]
        pairs = {(f"{node.module}.{each.name}", str(node.module)) for node in found for each in node.names}
        below[name] = {one if one in files else other for one, other in pairs if {one, other} & set(files)}
    while gone := {name for name, needed in below.items() if not needed & set(below)}:
        below = {name: needed for name, needed in below.items() if name not in gone}
    assert not below
