"""What commands find: a picture, and files of all kinds."""

from __future__ import annotations

from pathlib import Path

import pytest

from supple.media import image
from tests.cli.commands import noise
from tests.cli.inputs import write_inputs


@pytest.fixture
def here(here: Path) -> Path:
    """A folder with one picture, in which commands run."""
    image.write("in.png", noise(40, 48))
    return here


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files of all kinds, which stays as it is."""
    folder = tmp_path_factory.mktemp("inputs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_inputs()
    return folder
