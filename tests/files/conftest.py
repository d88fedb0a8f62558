"""A folder of its own for each test, and the command in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from supple.cli import command
from tests.files.clip_files import Run


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process."""

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        status = command(arguments)
        out, err = capsys.readouterr()
        return status, out, err

    return run
