"""A folder of its own for each test, and the command in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from supple.cli import command
from supple.media import image
from tests.cli.commands import Run, Said, noise
from tests.cli.inputs import write_inputs


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with one picture, in which commands run."""
    monkeypatch.chdir(tmp_path)
    image.write("in.png", noise(40, 48))
    return tmp_path


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files of all kinds, which stays as it is."""
    folder = tmp_path_factory.mktemp("inputs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_inputs()
    return folder


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process."""

    def run(*arguments: str) -> Said:
        capsys.readouterr()
        status = command(arguments)
        out, err = capsys.readouterr()
        return status, out, err

    return run
