"""Warps by Dask: equal to `Deformation.warp` bit for bit and lazy."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple.blocks import Warp, boxes_of
from supple.engine.sampling import Sampling
from supple.errors import FoldWarning, OutsideWarning, SuppleError
from tests.fields import drawn
from tests.strokes import refusal

da = pytest.importorskip("dask.array")
zarr = pytest.importorskip("zarr")
dask = pytest.importorskip("dask")

import cloudpickle  # noqa: E402

from supple.dask import warp  # noqa: E402

Array = npt.NDArray[Any]
RNG = np.random.default_rng(17)
SHAPE = (40, 70, 90)
VOLUME = RNG.integers(0, 4000, SHAPE, np.uint16)


@pytest.fixture(scope="module")
def bend() -> supple.Deformation:
    return supple.Deformation(SHAPE).grab((45, 35, 20), by=(5, -3, 2), radius=9, reach=3)


@pytest.fixture(scope="module")
def bent(bend: supple.Deformation) -> Array:
    return bend.warp(VOLUME)


def assert_equal(made: Any, expected: Array) -> None:
    got = np.asarray(made.compute(scheduler="threads", num_workers=2))
    assert (made.shape, made.dtype) == (expected.shape, expected.dtype)
    assert (got.shape, got.dtype) == (expected.shape, expected.dtype)
    assert got.tobytes() == expected.tobytes()


class Recording:
    """An array that is read slice by slice, and notes what was read."""

    def __init__(self, array: Array) -> None:
        self.array, self.shape, self.dtype = array, array.shape, array.dtype
        self.reads: list[tuple[tuple[int, int], ...]] = []

    def __getitem__(self, key: tuple[slice, ...]) -> Array:
        self.reads.append(tuple((each.start, each.stop) for each in key))
        return self.array[key]


def stored(tmp_path: Path, array: Array, **options: Any) -> Any:
    made = zarr.create_array(str(tmp_path / "array.zarr"), shape=array.shape, dtype=array.dtype, **options)
    made[...] = array
    return made


# Sources.


@pytest.mark.parametrize(
    "chunks", [(16, 32, 32), (40, 70, 90), ((7, 33), (70,), (1, 89)), 23], ids=["even", "one", "uneven", "cubes"]
)
def test_dask_arrays(bend: supple.Deformation, bent: Array, chunks: Any) -> None:
    source = da.from_array(VOLUME, chunks)
    made = warp(source, bend)
    assert made.chunks == source.chunks
    assert_equal(made, bent)


@pytest.mark.parametrize(
    ("options", "blocks"),
    [
        ({"zarr_format": 2, "chunks": (16, 32, 32)}, (3, 3, 3)),
        ({"zarr_format": 3, "chunks": (16, 32, 32)}, (3, 3, 3)),
        ({"zarr_format": 3, "chunks": (8, 16, 16), "shards": (24, 32, 64)}, (2, 3, 2)),
    ],
    ids=["v2", "v3", "sharded"],
)
def test_zarr_arrays(
    bend: supple.Deformation, bent: Array, tmp_path: Path, options: dict[str, Any], blocks: tuple[int, ...]
) -> None:
    made = warp(stored(tmp_path, VOLUME, **options), bend)
    assert made.numblocks == blocks  # of a sharded array, shards: what is written at once
    assert_equal(made, bent)


def test_numpy_arrays_and_memory_maps(bend: supple.Deformation, bent: Array, tmp_path: Path) -> None:
    assert warp(VOLUME, bend).numblocks == (1, 1, 1)
    assert_equal(warp(VOLUME, bend), bent)
    np.save(tmp_path / "volume.npy", VOLUME)
    mapped = np.load(tmp_path / "volume.npy", mmap_mode="r")
    assert_equal(warp(mapped, bend, chunks=(20, 64, 64)), bent)
    assert_equal(warp(VOLUME[::-1, :, ::-1], bend, chunks=32), bend.warp(VOLUME[::-1, :, ::-1]))


# Axes.


def test_axes_before_are_carried_along_and_axes_after_are_channels() -> None:
    d = supple.Deformation((30, 40)).grab((15, 12), by=(4, 2), radius=7)
    source = RNG.random((2, 3, 30, 40), np.float32)
    expected = np.stack([[d.warp(each) for each in row] for row in source])
    for array in (source, da.from_array(source, (1, 2, 16, 20)), da.from_array(source, (2, 3, 30, 40))):
        assert_equal(warp(array, d), expected)
    assert warp(source, d, chunks=16).chunks == ((1, 1), (1, 1, 1), (16, 14), (16, 16, 8))
    assert warp(source, d, chunks=(2, 3, 16, 40)).numblocks == (1, 1, 2, 1)
    for count in (1, 3, 4):
        picture = RNG.integers(0, 256, (30, 40, count), np.uint8)
        made = warp(da.from_array(picture, (16, 16, 1)), d)
        assert made.chunks == ((16, 14), (16, 16, 8), (count,))
        assert_equal(made, d.warp(picture))
    pictures = RNG.integers(0, 256, (2, 30, 40, 4), np.uint8)
    assert_equal(warp(pictures, d, chunks=16, alpha=False), np.stack([d.warp(each, alpha=False) for each in pictures]))


def test_axes_can_be_named() -> None:
    d = supple.Deformation((20, 20)).grab((8, 9), by=(3, 1), radius=5)
    source = RNG.random((20, 20, 20), np.float32)
    carried = np.stack([d.warp(each) for each in source])
    assert_equal(warp(source, d), carried)  # the last ones, where both would do
    assert_equal(warp(source, d, axes=(-2, -1)), carried)
    assert_equal(warp(source, d, axes=(0, 1)), d.warp(source))


# Grids.


@pytest.mark.parametrize("spacing", [0.6, 2.5])
def test_other_grids(bend: supple.Deformation, spacing: float) -> None:
    grid = bend.grid.resampled(spacing)
    expected = bend.warp(VOLUME, grid=grid)
    for made in (warp(da.from_array(VOLUME, 32), bend, grid), warp(VOLUME, bend, grid, 25)):
        assert made.shape == grid.shape
        assert_equal(made, expected)


# xarray.


def test_xarray_keeps_what_is_not_bent(bend: supple.Deformation, bent: Array) -> None:
    xarray = pytest.importorskip("xarray")
    coords = {"t": [1.5, 3.5], "c": ("t", ["a", "b"]), "z": np.arange(40) * 0.5, "scale": 3.0}
    source = xarray.DataArray(
        da.from_array(np.stack([VOLUME, VOLUME[::-1]]), (1, 20, 35, 90)),
        coords, ("t", "z", "y", "x"), "cells", {"unit": "mm"},
    )  # fmt: skip
    made = warp(source, bend)
    assert isinstance(made.data, da.Array)
    assert made.chunks == source.chunks
    assert (made.name, made.attrs, made.dims) == ("cells", {"unit": "mm"}, ("t", "z", "y", "x"))
    assert made.coords.to_dataset().identical(source.coords.to_dataset())
    assert np.array_equal(made.values, np.stack([bent, bend.warp(VOLUME[::-1])]))
    assert "history" not in source.attrs


def test_xarray_on_another_grid() -> None:
    xarray = pytest.importorskip("xarray")
    own = supple.Grid((40, 50), (2.0, 0.5), (10.0, -3.0))
    d = supple.Deformation(own, border=None).affine(np.c_[np.eye(2), (1, 1)])
    source = xarray.DataArray(
        RNG.random((3, 40, 50)), {"t": [0, 1, 2], "y": np.arange(40) * 0.5 - 3, "here": ("x", np.arange(50))},
        ("t", "y", "x"),
    )  # fmt: skip
    grid = supple.Grid((20, 30), (1.0, 0.25), (30.0, 2.0))
    made = warp(source, d, grid)
    assert set(made.coords) == {"t", "y", "x"}
    assert np.array_equal(made.x, 30 + np.arange(30.0))
    assert np.array_equal(made.y, 2 + 0.25 * np.arange(20))
    assert np.array_equal(made.values, np.stack([d.warp(each, grid=grid) for each in source.values]))
    turned = supple.Grid((20, 30), 1.0, (30.0, 2.0), [[0.6, -0.8], [0.8, 0.6]])
    assert set(warp(source, d, turned).coords) == {"t"}
    # A part of what was there has the coordinates of that part.
    part = warp(source, d, own.crop((7, 5), (20, 12)), {"y": 6})
    assert part.chunks == ((1, 1, 1), (6, 6), (20,))
    assert part.name is None
    here = source.isel(y=slice(5, 17), x=slice(7, 27))
    assert part.coords.to_dataset().identical(here.coords.to_dataset())
    with pytest.raises(SuppleError, match="chunks must be sizes by the names of the axes, t, y, x"):
        warp(source, d, chunks={"z": 4})


# Laziness.


def test_each_task_reads_its_part_and_nothing_is_read_before(bend: supple.Deformation, bent: Array) -> None:
    source = Recording(VOLUME)
    made = warp(source, bend, chunks=(20, 32, 32))
    assert not source.reads
    planned, _ = Warp(bend, Sampling()).plan(list(boxes_of(made.chunks)))
    one = made.blocks[1, 1, 1].compute(scheduler="synchronous")
    assert np.array_equal(one, bent[20:, 32:64, 32:64])
    assert source.reads == [planned[3 * 3 + 3 + 1].part]
    assert_equal(made, bent)
    assert sorted(source.reads[1:]) == sorted(block.part for block in planned)


def test_a_chunk_is_computed_once_and_only_if_it_is_needed(bend: supple.Deformation, bent: Array) -> None:
    seen: list[Any] = []

    def made(block: Array, block_info: Any = None) -> Array:
        seen.append(tuple(block_info[0]["chunk-location"]))
        return block

    source = da.from_array(VOLUME, (20, 35, 45)).map_blocks(made, dtype="u2", meta=np.empty((0, 0, 0), "u2"))
    assert_equal(warp(source, bend), bent)
    assert sorted(seen) == [(z, y, x) for z in range(2) for y in range(2) for x in range(2)]
    seen.clear()
    # Beyond the reach, a block is a copy of its own chunk.
    far = supple.Deformation(SHAPE).grab((12, 12, 10), by=(2, 0, 0), radius=4, reach=2)
    warp(source, far).blocks[1, 1, 1].compute(scheduler="synchronous")
    assert seen == [(1, 1, 1)]


def test_the_graph_is_small_and_a_field_is_in_it_once(tmp_path: Path) -> None:
    source = stored(tmp_path, np.zeros((96, 96, 96), np.uint8), chunks=(48, 48, 48))
    d = supple.Deformation((96, 96, 96)).grab((45, 35, 20), by=(5, -3, 2), radius=9)
    graph = dict(warp(source, d, chunks=12).dask)
    assert len(graph) == 8**3 + 2
    assert len(cloudpickle.dumps(graph)) / len(graph) < 1500
    field = drawn(np.random.default_rng(1), supple.Grid((40, 40, 40), 2.5), 0.2)
    held = len(pickle.dumps(field))
    made = warp(source, supple.Deformation((96, 96, 96), border=None).field(field), chunks=48)
    assert len(cloudpickle.dumps(dict(made.dask))) < held + 50_000


def test_names_are_of_what_is_warped(bend: supple.Deformation) -> None:
    source = da.from_array(VOLUME, 32)
    first = warp(source, bend)
    assert warp(source, bend).name == first.name
    others = [
        warp(source, bend, filter="linear"), warp(source, bend, chunks=20), warp(source + 1, bend),
        warp(source, bend, bend.grid.resampled(2.0)), warp(source, bend.without_strokes()),
    ]  # fmt: skip
    assert len({first.name, *(each.name for each in others)}) == 6


# Warnings and refusals.


def test_warnings_come_at_once_and_name_the_line_that_warps() -> None:
    xarray = pytest.importorskip("xarray")
    x = np.zeros((40, 50, 2))
    x[..., 0] = 12 * np.sin(np.arange(50) / 3)
    d = supple.Deformation((40, 50), border=None)
    with pytest.warns(FoldWarning):
        folded = d.field(supple.Field.from_array(x), inverse=True)
    source = np.zeros((40, 50))
    for array in (source, xarray.DataArray(source, dims=("y", "x"))):
        with warnings.catch_warnings(record=True, action="always") as caught:
            made = warp(array, folded, chunks=20)
        assert {each.category for each in caught} & {FoldWarning, OutsideWarning}
        assert {each.filename for each in caught} == {__file__}
        made.compute(scheduler="synchronous")  # says it no more


PICTURE = np.zeros((40, 50))


@pytest.mark.parametrize(
    ("array", "options", "words"),
    [
        ([[1, 2]], {}, "array must be an array with a shape"),
        ("volume.zarr", {}, "array must be an array with a shape"),
        (PICTURE[:30], {}, r"has shape \(40, 50\), and the array \(30, 50\)"),
        (np.zeros((40, 50, 2, 2)), {}, "the last axes must be those"),
        (np.zeros((0, 40, 50)), {}, "array must be an array with samples"),
        (PICTURE.astype(complex), {}, "complex128"),
        (PICTURE.astype("M8[s]"), {}, "datetime64"),
        (PICTURE, {"chunks": 0}, "chunks must be sizes that fit"),
        (PICTURE, {"chunks": "7 cats"}, "chunks must be sizes that fit"),
        (PICTURE, {"chunks": ((20, 21), (25, 25))}, "do not add up"),
        (PICTURE, {"chunks": object()}, "chunks must be sizes that fit"),
        (PICTURE, {"axes": "yx"}, "2 axes side by side"),
        (PICTURE, {"axes": (1, 0)}, "2 axes side by side"),

        (np.zeros((30, 40, 50)), {"axes": (0, 1)}, r"axes \(0, 1\) of the array have \(30, 40\)"),
        (PICTURE, {"grid": (40, 50)}, "a Grid of 2 axes"),
        (PICTURE, {"grid": supple.Grid((4, 5, 6))}, "a Grid of 2 axes"),
        (PICTURE, {"fill": (1, 2)}, "fill must be a number"),
        (PICTURE, {"alpha": True}, "a last channel"),

    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_at_once(array: Any, options: dict[str, Any], words: str) -> None:
    d = supple.Deformation((40, 50)).grab((20, 15), by=(4, 1), radius=8)
    message = refusal(lambda: warp(array, d, **options))
    with pytest.raises(SuppleError, match=words):
        warp(array, d, **options)
    assert "\n" not in message


def test_other_refusals() -> None:
    xarray = pytest.importorskip("xarray")
    d = supple.Deformation((40, 50))
    assert "choose a variable" in refusal(lambda: warp(xarray.Dataset({"a": (("y", "x"), PICTURE)}), d))
    assert "deformation must be a Deformation" in refusal(lambda: warp(PICTURE, (40, 50)))  # type: ignore[arg-type]
    unknown = da.from_array(PICTURE)
    assert "nan" in refusal(lambda: warp(unknown[unknown[:, 0] >= 0], d))


# A cluster.
