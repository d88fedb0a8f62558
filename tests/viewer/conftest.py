"""What tests of windows share."""

from __future__ import annotations

import itertools
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.viewer.windows import Boxes


@pytest.fixture(autouse=True)
def _windows_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No window of one test certifies on during the next, and listens to its warnings; none finds what another left."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    yield
    if windows := sys.modules.get("tests.viewer.windows"):
        windows.close_all()


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """A folder of its own for all."""
    return tmp_path


@pytest.fixture
def boxes(monkeypatch: pytest.MonkeyPatch) -> Boxes:
    """The controls of the last frame."""
    from tests.viewer.windows import watch

    return watch(monkeypatch)


@pytest.fixture
def photo(state: Path) -> Path:
    from tests.viewer.windows import small_photo

    return small_photo(state)


@pytest.fixture(scope="session")
def media(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a clip, and of the head with voxels of 4 mm."""
    import av
    import SimpleITK as sitk  # noqa: N813

    from tests.viewer.windows import DATA

    folder, count = tmp_path_factory.mktemp("media"), 16
    with av.open(str(DATA / "bunny.mp4")) as source, av.open(str(folder / "clip.mp4"), "w") as out:
        stream = out.add_stream("libx264", rate=25, options={"crf": "12", "preset": "fast"})
        stream.width, stream.height, stream.pix_fmt = 640, 360, "yuv420p"
        for frame in itertools.islice(source.decode(video=0), count):
            out.mux(stream.encode(frame.reformat(640, 360)))
        out.mux(stream.encode(None))
    small = sitk.BinShrink(sitk.ReadImage(str(DATA / "head.nii.gz")), (2, 2, 2))
    sitk.WriteImage(small, str(folder / "head.nii.gz"))
    return folder


@pytest.fixture
def clip(media: Path, state: Path) -> Path:
    return Path(shutil.copy(media / "clip.mp4", state))


@pytest.fixture
def volume(media: Path, state: Path) -> Path:
    return Path(shutil.copy(media / "head.nii.gz", state))
