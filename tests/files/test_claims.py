"""Jobs that meet: the same command twice at once, a place that another job has, and no request in vain."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

zarr = pytest.importorskip("zarr")
pytest.importorskip("dask")
fsspec = pytest.importorskip("fsspec")

from supple import Recipe, Stroke, SuppleError  # noqa: E402
from supple.files import plans, stores  # noqa: E402
from supple.files.options import VolumeOptions  # noqa: E402
from supple.files.stores import warp_store  # noqa: E402
from tests.children import SOURCE  # noqa: E402

FLAT = Recipe(strokes=[Stroke.grab((14, 12), to=(17, 14), radius=3)])


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Tasks of a few chunks, in an empty folder."""
    monkeypatch.setattr(plans, "TASK", 1 << 10)
    monkeypatch.chdir(tmp_path)


def picture(name: str, seed: int = 0) -> np.ndarray[Any, Any]:
    values = np.random.default_rng(seed).integers(0, 250, (64, 64)).astype(np.uint8)
    zarr.create_array(name, data=values, chunks=(16, 16))
    return values


WAITING = """
import sys
from supple import Recipe
from supple.files import plans, stores
plans.TASK = 1 << 10
real = stores._write_block
def waiting(work, item):
    if not told:
        told.append(item)
        print("begun", flush=True)
        sys.stdin.read()
    return real(work, item)
told = []
stores._write_block = waiting
stores.warp_store("in.zarr", "out.zarr", Recipe.from_json(sys.argv[1]), force=sys.argv[2] == "force")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="nothing is held there")
@pytest.mark.parametrize("force", [False, True])
def test_the_same_command_twice_at_once(force: bool) -> None:
    picture("in.zarr")
    if force:
        picture("out.zarr", 1)
    expected = warp_store("in.zarr", "expected.zarr", FLAT)
    assert expected.blocks > 1
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(WAITING), FLAT.to_json(), "force" if force else ""],
        env={**os.environ, "PYTHONPATH": SOURCE, "SUPPLE_THREADS": "1"},
        text=True,
        **pipes,
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "begun\n"
        for recipe in (FLAT, Recipe()):
            with pytest.raises(SuppleError, match=r"^cannot write out\.zarr: it is being written by another process: "):
                warp_store("in.zarr", "out.zarr", recipe, force=True)
        _, said = first.communicate("")
        assert first.returncode == 0, said
    assert sorted(os.listdir()) == ["expected.zarr", "in.zarr", "out.zarr"]
    assert np.array_equal(zarr.open("out.zarr")[...], zarr.open("expected.zarr")[...])
    assert sorted(os.listdir("out.zarr")) == ["c", "zarr.json"]


def test_a_field_whose_place_another_job_has_leaves_no_output() -> None:
    picture("in.zarr")
    options = VolumeOptions(save_field="map.zarr")
    os.mkdir("map.zarr.partial")
    Path("map.zarr.partial/supple.json").write_text('{"program": "supple", "state": "unfinished", "job": "b"}')
    with pytest.raises(SuppleError, match=r"map\.zarr.*is the unfinished output of another job"):
        warp_store("in.zarr", "out.zarr", FLAT, options=options)
    assert sorted(os.listdir()) == ["in.zarr", "map.zarr.partial"]
    warp_store("in.zarr", "out.zarr", FLAT, options=options, force=True)
    assert sorted(os.listdir()) == ["in.zarr", "map.zarr", "out.zarr"]


def test_an_output_that_is_new_is_not_asked_for_its_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    from zarr.storage import FsspecStore

    root = f"memory://supple-{os.urandom(4).hex()}"
    picture(f"{root}/in.zarr")
    asked: list[str] = []
    exists = FsspecStore.exists

    async def counted(self: Any, key: str) -> bool:
        asked.append(key)
        return bool(await exists(self, key))

    async def listed(*_: Any, **__: Any) -> None:
        raise AssertionError("it is listed")

    monkeypatch.setattr(FsspecStore, "exists", counted)
    warp_store(f"{root}/in.zarr", f"{root}/out.zarr", FLAT)
    assert not asked
    monkeypatch.setattr(stores, "_write_levels", lambda *rest: 1 / 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            warp_store(f"{root}/in.zarr", f"{root}/more.zarr", FLAT)
        for name in ("list", "list_dir", "list_prefix"):  # what goes on asks for each block: there may be millions
            monkeypatch.setattr(FsspecStore, name, listed)
    assert set(asked) == {f"c/{y}/{x}" for y in range(4) for x in range(4)}


def test_another_spelling_of_the_input_goes_on() -> None:
    name = f"supple-{os.urandom(4).hex()}/in.zarr"
    picture(f"memory://{name}")
    os.mkdir("real")
    picture("real/in.zarr")
    os.symlink("real", "link")
    for before, after in (
        (f"memory://{name}", f"memory:///{name}/"),
        ("real/in.zarr", os.path.abspath("link/in.zarr")),
    ):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(stores, "_write_levels", lambda *rest: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                warp_store(before, "out.zarr", FLAT)
        made = warp_store(after, "out.zarr", FLAT)
        assert made.done == made.blocks
        warp_store(before, "out.zarr", FLAT, force=True)
        assert np.array_equal(zarr.open(before)[40:], zarr.open("out.zarr")[40:])
        os.rename("out.zarr", f"{len(before)}.zarr")
