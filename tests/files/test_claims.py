"""Jobs that meet: the same command twice at once, a place that another job has, and no request in vain."""

from __future__ import annotations

import os
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
