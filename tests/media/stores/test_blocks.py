"""Blocks of an output: written, copied as they are compressed, reduced to coarser levels, and found again."""

from __future__ import annotations

import errno
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from supple import SuppleError
from supple.media.stores.image import open_image
from supple.media.stores.levels import reduced
from supple.media.stores.target import Target, create
from tests.media.stores.images import RNG, boxes, described_axes, exact, files, fill, image, metadata, small, whole


@pytest.mark.parametrize("sharded", [False, True])
def test_chunks_are_stored_even_if_empty_and_arrays_go_to_other_processes(sharded: bool, tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", 3, "0.5", shards=(1, 2, 8, 16, 32) if sharded else None)
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    target.write(0, whole(target), np.full(target.arrays[0].shape, 7))  # the fill value
    assert target.is_done(0, whole(target))
    other = pickle.loads(pickle.dumps(target))
    other.reduce(1, whole(other, 1))
    assert target.is_done(1, whole(target, 1))
    array = pickle.loads(pickle.dumps(target.arrays[2]))
    array[...] = 7
    assert target.is_done(2, whole(target, 2))


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("sharded", [False, True])
@pytest.mark.parametrize("remote", [False, True])
def test_blocks_are_copied_as_they_are(form: int, sharded: bool, remote: bool, tmp_path: Path, memory: str) -> None:
    if sharded and form == 2:
        pytest.skip("Zarr 2 has no shards")
    version = {2: "0.4", 3: "0.5"}[form]
    root = memory if remote else str(tmp_path)
    arrays = image(f"{root}/in.zarr", form, version, shards=(1, 2, 8, 16, 32) if sharded else None)
    like = open_image(f"{root}/in.zarr")
    target = create(f"{root}/out.zarr", like, job="a")
    counts = [target.copy(0, box, like.levels[0].array, like.address) for box in boxes(target, 0)]
    assert all(counts)
    assert target.is_done(0, whole(target))
    total = target.copy(1, whole(target, 1), like.levels[1].array, like.address)
    np.testing.assert_array_equal(target.arrays[0][...], arrays[0])
    np.testing.assert_array_equal(target.arrays[1][...], arrays[1])
    if not remote:
        kept, made = files(tmp_path / "in.zarr"), files(tmp_path / "out.zarr.partial")
        chunks = [name for name in kept if name[0] in "01" and not name.endswith((".json", ".zarray", ".zattrs"))]
        assert all(kept[name] == made[name] for name in chunks)
        assert sum(len(kept[name]) for name in chunks) == sum(map(int, filter(None, counts))) + int(total or 0)


@given(
    st.sampled_from(["?", "u1", "i1", "u2", ">i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"]),
    st.lists(st.tuples(st.integers(1, 7), st.integers(1, 3)), min_size=1, max_size=3),
    st.integers(0, 2**32),
)
def test_means_are_exact(dtype: str, axes: list[tuple[int, int]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape, factors = [n for n, _ in axes], [f for _, f in axes]
    kind = np.dtype(dtype)
    if kind.kind in "iu":
        info = np.iinfo(kind)
        values = rng.integers(info.min, info.max, shape, kind.newbyteorder("="), endpoint=True).astype(kind)
        if seed % 3 == 0:
            values = values // max(1, info.max // 3)  # many ties
        values = values.astype(kind)
    else:
        values = rng.normal(0, 2, shape).astype(kind)
    made = reduced(values, factors, "mean")
    assert made.dtype == kind
    np.testing.assert_allclose(made, exact(values, factors), rtol=1e-12 if kind == "f8" else 0, atol=0)
    first = reduced(values, factors, "nearest")
    np.testing.assert_array_equal(first, values[tuple(slice(None, None, f) for f in factors)])


def test_an_incomplete_group_is_left_out_where_the_input_does(tmp_path: Path) -> None:
    attributes = metadata("0.5", described_axes("yx"), [([1, 1], [0, 0]), ([2, 2], [0.5, 0.5])])
    group = zarr.create_group(str(tmp_path / "in.zarr"), attributes=attributes)
    group.create_array("0", shape=(9, 11), dtype="u1", chunks=(4, 4))
    group.create_array("1", shape=(4, 5), dtype="u1", chunks=(4, 4))
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    assert [array.shape for array in target.arrays] == [(9, 11), (4, 5)]
    values = RNG.integers(0, 255, (9, 11), np.uint8)
    fill(target, values)
    np.testing.assert_array_equal(target.arrays[1][...], exact(values[:8, :10], [2, 2]))


def test_a_chunk_without_content_is_not_done(tmp_path: Path) -> None:
    values, like = small(tmp_path / "in.zarr")
    target = create(tmp_path / "out.zarr", like, job="a")
    fill(target, values)
    (tmp_path / "out.zarr.partial" / "0" / "c" / "0" / "0" / "0").write_bytes(b"")
    assert not target.is_done(0, [(0, 2), (0, 4), (0, 4)])
    assert target.is_done(0, [(0, 2), (0, 4), (4, 8)])


@pytest.mark.parametrize("remote", [False, True])
def test_a_store_that_fails_in_the_middle(
    remote: bool, tmp_path: Path, memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from zarr.storage import FsspecStore, LocalStore

    root = memory if remote else str(tmp_path)
    values, like = small(f"{root}/in.zarr")
    target = create(f"{root}/out.zarr", like, job="a")
    kind = FsspecStore if remote else LocalStore
    for error, expected in (
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device: make room"),
        (OSError("bucket is gone"), "bucket is gone: choose another place"),
    ):

        async def failing(self: Any, key: str, value: Any, error: Exception = error) -> None:
            raise error

        with monkeypatch.context() as patched:
            patched.setattr(kind, "set", failing)
            for act in (
                lambda: target.write(0, whole(target), values),
                lambda: target.copy(0, whole(target), like.levels[0].array, like.address),
                lambda: create(f"{root}/other.zarr", like, job="a"),
            ):
                with pytest.raises(SuppleError, match=expected) as told:
                    act()
                assert str(told.value).startswith(f"cannot write {root}/o")
    if not remote:
        assert not (tmp_path / "out.zarr").exists()


def test_a_client_that_remembers_listings_sees_what_others_wrote(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clients of buckets look into their last listing, as this one does."""
    from fsspec.implementations.memory import MemoryFileSystem

    from supple.media.stores import places

    values, like = small(f"{memory}/in.zarr")
    target = create(f"{memory}/out.zarr", like, job="a")
    known: dict[str, bool] = {}
    exists = MemoryFileSystem.exists
    monkeypatch.setattr(MemoryFileSystem, "exists", lambda self, path: known.setdefault(path, exists(self, path)))
    refresh = places.refresh
    for module in (places, sys.modules[Target.__module__]):
        monkeypatch.setattr(module, "refresh", lambda store: (known.clear(), refresh(store)))
    assert not target.is_done(0, whole(target))
    create(f"{memory}/out.zarr", like, job="a").write(0, whole(target), values)
    assert target.is_done(0, whole(target))


@pytest.mark.parametrize("remote", [False, True])
def test_a_source_that_cannot_be_read_is_named(
    remote: bool, tmp_path: Path, memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not the output, to which its chunks are copied."""
    from zarr.storage import FsspecStore, LocalStore

    root = memory if remote else str(tmp_path)
    _, like = small(f"{root}/in.zarr")
    target = create(f"{root}/out.zarr", like, job="a")

    async def failing(self: Any, key: str, *more: Any, **named: Any) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(FsspecStore if remote else LocalStore, "get", failing)
    told = "it cannot be reached" if remote else "its chunks cannot be read"
    with pytest.raises(SuppleError, match=rf"^cannot read {root}/in\.zarr: {told} \(.*Input/output error\): \w+"):
        target.copy(0, whole(target), like.levels[0].array, like.address)
    assert not target.is_done(0, [(0, 2), (0, 4), (0, 4)])
