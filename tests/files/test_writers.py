"""Whatever writes a file: it replaces none unasked, leaves what was there if it fails, and obeys the umask."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from supple import Recipe, SuppleError
from supple.files.recipes import write_recipe
from supple.media import image, transforms, video, volume
from supple.media.points import read_points, write_points
from supple.space.geometry import Geometry, Grid
from tests import clips
from tests.children import full_disk
from tests.media.landmarks import fcsv
from tests.media.video.copies import arrays_of
from tests.refusals import refused

RNG = np.random.default_rng(0)
PIXELS = RNG.integers(0, 256, (160, 160, 3), np.uint8)
VOXELS = RNG.integers(0, 60_000, (20, 40, 50), np.uint16)
FIELD = transforms.Displacements(RNG.normal(size=(9, 20, 30, 3)), Grid((9, 20, 30)))
FLAT = transforms.Displacements(RNG.normal(size=(40, 50, 2)), Grid((40, 50)))
POINTS = {".csv": "x,y,z\n1,2,3\n", ".fcsv": fcsv(np.ones((1, 3))), ".obj": "# SPACE=RAS\nv 1 2 3\n"}


def film(path: Path, force: bool) -> None:
    source = path.parent.with_name("source.mkv")
    with video.open_clip(source) as clip, clip.writer(path, force=force) as sink:
        for k, frame in enumerate(clip.frames()):
            sink.write(arrays_of(clip, frame), k)


def points(path: Path, force: bool) -> None:
    source = path.parent.with_name(f"in{path.suffix}")
    if not source.exists():
        source.write_text(POINTS[path.suffix])
    read = read_points(source, mesh=path.suffix == ".obj")
    write_points(path, read.points + 1, read, force=force)


WRITERS: dict[str, tuple[tuple[str, ...], Callable[[Path, bool], object]]] = {
    "picture": (
        (".png", ".jpg", ".tif", ".webp", ".avif", ".exr", ".bmp", ".jp2"),
        lambda path, force: image.write(path, PIXELS / np.float32(9) if path.suffix == ".exr" else PIXELS, force=force),
    ),
    "volume": (
        volume.SUFFIXES_OUT,
        lambda path, force: volume.write(
            path,
            held := VOXELS.astype("i4" if ".mg" in path.suffix else "u2"),
            volume.Volume(held, Geometry()),
            force=force,
        ),
    ),
    "field": (
        transforms.SUFFIXES_OUT,
        lambda path, force: transforms.write_field(path, FIELD.values, Geometry(), force=force),
    ),
    "map": (
        (".tfm", ".h5", ".1D"),
        lambda path, force: transforms.write(path, [np.eye(4)], force=force),
    ),
    "flat map": (
        (".npy", ".npz", ".yml", ".xml", ".exr"),
        lambda path, force: transforms.write(path, [FLAT], force=force),
    ),
    "film": ((".mp4", ".mkv", ".avi", ".gif", ".mov", ".webm"), film),
    "points": (tuple(POINTS), points),
    "recipe": ((".json",), lambda path, force: write_recipe(path, Recipe(), force=force)),
}
CASES = [(kind, suffix) for kind, (suffixes, _) in WRITERS.items() for suffix in suffixes]


# What libraries say in words of their own.
FULL = {".exr": "File too large", ".nrrd": "(failed to write|not written|too large)"}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clips.make(tmp_path_factory.mktemp("source") / "source.mkv", "ffv1", smooth=False, count=8)


@pytest.fixture
def folder(tmp_path: Path, source: Path) -> Path:
    """An empty folder, with a film beside it."""
    os.link(source, tmp_path / "source.mkv")
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.filterwarnings("ignore::UserWarning")  # of what a format does not hold
@pytest.mark.parametrize(("kind", "suffix"), CASES)
def test_what_is_there_stays_unless_the_new_file_is_whole(folder: Path, kind: str, suffix: str) -> None:
    write, path = WRITERS[kind][1], folder / f"out{suffix}"
    before = os.umask(0o026)
    try:
        write(path, False)
    finally:
        os.umask(before)
    made = names(folder)
    assert made == {path.name} | ({"out.raw"} if suffix == ".mhd" else set())
    assert {stat.S_IMODE((folder / name).stat().st_mode) for name in made} == {0o640}
    size = max((folder / name).stat().st_size for name in made)
    for name in made:
        (folder / name).write_bytes(b"old")
    with pytest.raises(SuppleError, match=r"out\.\S+ exists already: choose another name, or force=True$"):
        write(path, False)
    full = f"^cannot write .*({FULL.get(suffix, 'File too large: make room or choose another place$')})"
    for room in (0, size // 2, *((size - 1,) if kind != "film" else ())):
        with full_disk(room):
            refused(write, path, True, match=full)
        assert names(folder) == made
        assert all((folder / name).read_bytes() == b"old" for name in made)
    write(path, True)
    assert names(folder) == made
    assert path.read_bytes() != b"old"
