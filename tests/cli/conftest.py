"""A folder of its own for each test, and the command in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from supple.cli import command
from supple.media import image
from tests.cli.commands import Run, Said, noise


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with one picture, in which commands run."""
    monkeypatch.chdir(tmp_path)
    image.write("in.png", noise(40, 48))
    return tmp_path


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process."""

    def run(*arguments: str) -> Said:
        capsys.readouterr()
        status = command(arguments)
        out, err = capsys.readouterr()
        return status, out, err

    return run
