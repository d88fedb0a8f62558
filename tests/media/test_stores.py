"""Zarr stores: opened, and created like another, so that blocks can be written by others and work goes on."""

from __future__ import annotations

import errno
import functools
import http.server
import json
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from supple import SuppleError
from supple.media.stores import StoredImage, Target, create, open_image
from supple.media.stores.pyramid import Step, reduced, step_of
from tests.children import SOURCE

Array = npt.NDArray[Any]
Json = dict[str, Any]

RNG = np.random.default_rng(0)
KINDS = {"t": "time", "c": "channel", "z": "space", "y": "space", "x": "space"}
VERSIONS = [(2, "0.4"), (3, "0.5"), (3, "0.6")]


@pytest.fixture
def memory() -> Iterator[str]:
    """An address in memory, empty."""
    fsspec = pytest.importorskip("fsspec")
    address = f"memory://supple-{os.urandom(4).hex()}"
    yield address
    fs = fsspec.filesystem("memory")
    if fs.exists(address):
        fs.rm(address, recursive=True)


def described_axes(names: str, unit: str | None = "micrometer") -> list[Json]:
    told = {"time": {"unit": "second"}, "channel": {}, "space": {"unit": unit} if unit else {}}
    return [{"name": name, "type": KINDS[name], **told[KINDS[name]]} for name in names]


def metadata(version: str, axes: list[Json], levels: list[tuple[list[float], list[float]]], **more: Any) -> Json:
    """Return the attributes of an image of one of the versions, written from the specification."""
    steps = [
        [{"type": "scale", "scale": scale}, {"type": "translation", "translation": offset}] for scale, offset in levels
    ]
    if version == "0.6":
        image: Json = {
            "name": "cells",
            "coordinateSystems": [{"name": "physical", "axes": axes}],
            "datasets": [
                {
                    "path": str(k),
                    "coordinateTransformations": [
                        {
                            "type": "sequence",
                            "transformations": one,
                            "input": {"path": str(k)},
                            "output": {"name": "physical"},
                        }
                    ],
                }
                for k, one in enumerate(steps)
            ],
        }
    else:
        image = {
            "name": "cells",
            "axes": axes,
            "datasets": [{"path": str(k), "coordinateTransformations": one} for k, one in enumerate(steps)],
        }
    if version == "0.4":
        return {"multiscales": [{"version": "0.4", **image}], **more}
    return {"ome": {"version": version, "multiscales": [image], **more}}


def image(
    address: str | Path,
    form: int,
    version: str,
    *,
    names: str = "tczyx",
    shape: tuple[int, ...] = (2, 2, 6, 19, 30),
    chunks: tuple[int, ...] = (1, 2, 4, 8, 16),
    shards: tuple[int, ...] | None = None,
    count: int = 3,
    centred: bool = True,
    dtype: str = "uint16",
    unit: str | None = "micrometer",
) -> list[Array]:
    """Write an image whose levels are half as large in the plane, and return them."""
    scale = [{"t": 0.5, "c": 1.0, "z": 2.0, "y": 0.5, "x": 0.25}[name] for name in names]
    levels, arrays = [], []
    values = RNG.integers(0, 2**16, shape).astype(dtype)
    for k in range(count):
        factor = [2**k if name in "yx" else 1 for name in names]
        offset = [(f - 1) / 2 * s if centred else 0.0 for f, s in zip(factor, scale, strict=True)]
        levels.append(([f * s for f, s in zip(factor, scale, strict=True)], offset))
        arrays.append(values if k == 0 else reduced(arrays[-1], [2 if name in "yx" else 1 for name in names], "mean"))
    attributes = metadata(version, described_axes(names, unit), levels, omero={"channels": [{"color": "FFFFFF"}]})
    group = zarr.create_group(str(address), zarr_format=form, attributes=attributes)
    for k, one in enumerate(arrays):
        made = group.create_array(
            str(k),
            shape=one.shape,
            dtype=one.dtype,
            chunks=chunks,
            shards=shards,
            fill_value=7,
            **(
                {"dimension_names": list(names)}
                if form == 3
                else {"chunk_key_encoding": {"name": "v2", "separator": "/"}}
            ),
        )
        made[...] = one
    return arrays


def boxes(target: Target, level: int) -> list[list[tuple[int, int]]]:
    """Return all blocks of a level."""
    shape = target.arrays[level].shape
    axes = [
        [(a, min(a + n, size)) for a in range(0, size, n)] for size, n in zip(shape, target.blocks[level], strict=True)
    ]
    return [list(box) for box in product(*axes)]


def whole(target: Target, level: int = 0) -> list[tuple[int, int]]:
    return [(0, size) for size in target.arrays[level].shape]


def part(array: Any, box: list[tuple[int, int]]) -> Array:
    return np.asarray(array[tuple(slice(a, b) for a, b in box)])


def fill(target: Target, values: Array) -> None:
    """Write all levels, block by block."""
    for level in range(len(target.arrays)):
        for box in boxes(target, level):
            if level == 0:
                target.write(0, box, part(values, box))
            else:
                target.reduce(level, box)


def files(path: Path) -> dict[str, bytes]:
    return {str(one.relative_to(path)): one.read_bytes() for one in sorted(path.rglob("*")) if one.is_file()}


def plain_json(value: Any) -> Any:
    return json.loads(json.dumps(value))


@pytest.mark.parametrize("where", ["folder", "memory", "file"])
@pytest.mark.parametrize(("form", "version"), VERSIONS)
@pytest.mark.parametrize("sharded", [False, True])
def test_round_trips_of_images(where: str, form: int, version: str, sharded: bool, tmp_path: Path, memory: str) -> None:
    if sharded and form == 2:
        pytest.skip("Zarr 2 has no shards")
    root = {"folder": str(tmp_path), "memory": memory, "file": tmp_path.as_uri()}[where]
    source, out = f"{root}/in.zarr", f"{root}/out.zarr"
    # zarr's own file:// makes no folders
    made = tmp_path / "in.zarr" if where == "file" else source
    before = image(made, form, version, shards=(1, 2, 8, 16, 32) if sharded else None)
    like = open_image(source)
    assert (like.version, like.name, like.spatial) == (version, "cells", (2, 3, 4))
    assert [axis.name for axis in like.axes] == list("tczyx")
    assert [axis.kind for axis in like.axes] == ["time", "channel", "space", "space", "space"]
    assert [axis.unit for axis in like.axes] == ["second", None, "micrometer", "micrometer", "micrometer"]
    np.testing.assert_allclose(like.spacing, (0.00025, 0.0005, 0.002), rtol=1e-12)
    assert like.origin == (0, 0, 0)
    assert like.grid.shape == like.shape[2:] == (6, 19, 30)
    target = create(out, like, job="a")
    assert target.block == ((1, 2, 8, 16, 32) if sharded else (1, 2, 4, 8, 16))
    assert target.factors == ((1,) * 5, (1, 1, 1, 2, 2), (1, 1, 1, 2, 2))
    assert not target.is_done(0, whole(target))
    with pytest.raises(SuppleError, match="unfinished"):
        open_image(f"{out}.partial" if where != "memory" else out)
    with pytest.raises(SuppleError, match="unfinished"):
        open_image(f"{out}.partial/0" if where != "memory" else f"{out}/0")
    fill(target, before[0])
    for level in range(3):
        assert target.is_done(level, whole(target, level))
    assert target.finish() == out
    again = open_image(out)
    for one, other, values in zip(like.levels, again.levels, before, strict=True):
        np.testing.assert_array_equal(other.array[...], values)
        told = [dict(level.array.metadata.to_dict()) for level in (one, other)]
        assert told[0] == told[1]
        assert (one.path, one.scale, one.translation) == (other.path, other.scale, other.translation)
    assert again.axes == like.axes
    assert plain_json(again.attributes) == plain_json(like.attributes)
    opened = zarr.open(out, mode="r")
    np.testing.assert_array_equal(opened["0"][...], before[0])
    if where != "memory":
        assert sorted(os.listdir(tmp_path)) == ["in.zarr", "out.zarr"]
        assert sorted(files(tmp_path / "in.zarr")) == sorted(files(tmp_path / "out.zarr"))


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("shape", [(9, 11), (5, 9, 11), (2, 3, 5, 9, 11)])
def test_round_trips_of_plain_arrays(form: int, shape: tuple[int, ...], tmp_path: Path, memory: str) -> None:
    for root in (str(tmp_path), memory):
        values = RNG.normal(size=shape).astype(">f4" if form == 2 else "f4")
        made = zarr.create_array(
            f"{root}/a.zarr",
            data=values,
            chunks=(4,) * len(shape),
            zarr_format=form,
            fill_value=np.nan,
            attributes={"by": "me"},
        )
        assert made.ndim == len(shape)
        like = open_image(f"{root}/a.zarr")
        space = min(len(shape), 3)
        assert (like.version, like.levels[0].path, len(like.levels)) == ("", "", 1)
        assert like.spatial == tuple(range(len(shape) - space, len(shape)))
        assert [axis.kind for axis in like.axes] == [""] * (len(shape) - space) + ["space"] * space
        assert like.spacing == (1.0,) * space
        if len(shape) > 2:
            assert open_image(f"{root}/a.zarr", ndim=2).spatial == (len(shape) - 2, len(shape) - 1)
        target = create(f"{root}/b.zarr", like, job="")
        fill(target, values)
        target.finish()
        again = open_image(f"{root}/b.zarr")
        np.testing.assert_array_equal(again.levels[0].array[...], values)
        assert again.levels[0].array.metadata.to_dict().keys() == made.metadata.to_dict().keys()
        assert dict(again.attributes) == {"by": "me"}
        assert np.isnan(again.levels[0].array.fill_value)
    assert (tmp_path / "b.zarr" / ("zarr.json" if form == 3 else ".zarray")).is_file()


def test_an_array_of_an_image_is_a_plain_array(tmp_path: Path) -> None:
    (values, *_) = image(tmp_path / "in.zarr", 3, "0.5")
    one = open_image(tmp_path / "in.zarr" / "0")
    assert (one.version, one.spatial, [axis.name for axis in one.axes]) == ("", (2, 3, 4), list("tczyx"))
    np.testing.assert_array_equal(one.levels[0].array[...], values)
    other = open_image(f"{(tmp_path / 'in.zarr').as_uri()}/0")
    assert other.shape == one.shape


def test_an_image_over_http(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    (values, *_) = image(tmp_path / "in.zarr", 3, "0.5")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        root = f"http://127.0.0.1:{server.server_port}"
        found = open_image(f"{root}/in.zarr")
        np.testing.assert_array_equal(found.levels[0].array[0, 0], values[0, 0])
        with pytest.raises(SuppleError, match="there is no Zarr array or group"):
            open_image(f"{root}/no.zarr")
        with pytest.raises(SuppleError, match="cannot write"):
            create(f"{root}/out.zarr", found, job="a")
        server.shutdown()


@pytest.mark.parametrize(("form", "version"), VERSIONS)
@pytest.mark.parametrize("centred", [False, True])
def test_another_grid_has_its_scale_and_translation_on_each_level(
    form: int, version: str, centred: bool, tmp_path: Path
) -> None:
    image(tmp_path / "in.zarr", form, version, centred=centred)
    like = open_image(tmp_path / "in.zarr")
    target = create(
        tmp_path / "out.zarr", like, shape=(6, 41, 81), scale=(1, 1.5, 3), translation=(7, -2, 0.25), job="a"
    )
    shapes = [(2, 2, 6, 41, 81), (2, 2, 6, 21, 41), (2, 2, 6, 11, 21)]
    assert [array.shape for array in target.arrays] == shapes
    values = np.arange(np.prod(shapes[0])).reshape(shapes[0]) % 60_000
    fill(target, values.astype(np.uint16))
    target.finish()
    # by hand: a level's first sample is the mean of f of the finest, the middle of which is (f - 1) / 2 after the first
    expected = [
        ([0.5, 1, 1, 1.5 * f, 3 * f], [0, 0, 7, -2 + (f - 1) / 2 * 1.5, 0.25 + (f - 1) / 2 * 3]) for f in (1, 2, 4)
    ]
    if not centred:
        expected = [(scale, [0, 0, 7, -2, 0.25]) for scale, _ in expected]
    told = json.loads((tmp_path / "out.zarr" / (".zattrs" if form == 2 else "zarr.json")).read_text())
    attributes = told if form == 2 else told["attributes"]
    more = {"omero": {"channels": [{"color": "FFFFFF"}]}}
    assert attributes == plain_json(metadata(version, described_axes("tczyx"), expected, **more))
    again = open_image(tmp_path / "out.zarr")
    np.testing.assert_allclose(again.spacing, (0.003, 0.0015, 0.001))
    np.testing.assert_allclose(again.origin, (0.00025, -0.002, 0.007))
    assert again.level_grid(1).shape == (6, 21, 41)


def test_no_translation_is_written_where_there_is_none_and_what_all_levels_share_is_theirs(tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", 2, "0.4", centred=False)
    attributes = json.loads((tmp_path / "in.zarr" / ".zattrs").read_text())
    listed = attributes["multiscales"][0]
    for one in listed["datasets"]:
        one["coordinateTransformations"] = one["coordinateTransformations"][:1]
    listed["coordinateTransformations"] = [{"type": "scale", "scale": [10, 1, 1, 1, 1]}]
    listed["type"] = "gaussian"
    (tmp_path / "in.zarr" / ".zattrs").write_text(json.dumps(attributes))
    like = open_image(tmp_path / "in.zarr")
    assert like.levels[1].scale == (5, 1, 2, 1, 0.5)
    target = create(tmp_path / "out.zarr", like, shape=(6, 19, 29), job="a")
    told = target.image.attributes["multiscales"][0]
    assert "coordinateTransformations" not in told
    assert "type" not in told
    steps = [one["coordinateTransformations"] for one in told["datasets"]]
    assert steps == [[{"type": "scale", "scale": [5, 1, 2, 0.5 * f, 0.25 * f]}] for f in (1, 2, 4)]


def test_levels_that_would_be_the_one_before_are_left_out(tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", 3, "0.5")
    like = open_image(tmp_path / "in.zarr")
    target = create(tmp_path / "out.zarr", like, shape=(6, 2, 1), job="a")
    assert [array.shape for array in target.arrays] == [(2, 2, 6, 2, 1), (2, 2, 6, 1, 1)]
    fill(target, np.ones((2, 2, 6, 2, 1)))
    target.finish()
    assert len(open_image(tmp_path / "out.zarr").levels) == 2


@pytest.mark.parametrize("form", [2, 3])
def test_chunks_of_ones_own(form: int, tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", form, {2: "0.4", 3: "0.5"}[form])
    like = open_image(tmp_path / "in.zarr")
    target = create(tmp_path / "out.zarr", like, chunks=(10, 20, 30), job="a")
    assert target.blocks == ((2, 2, 10, 20, 30),) * 3
    if form == 3:
        image(tmp_path / "shards.zarr", 3, "0.5", shards=(1, 2, 8, 16, 32))
        target = create(tmp_path / "b.zarr", open_image(tmp_path / "shards.zarr"), chunks=(1, 1, 5, 5, 10), job="a")
        assert target.arrays[0].chunks == (1, 1, 5, 5, 10)
        assert target.block == (1, 2, 10, 15, 30)
        fill(target, np.ones(target.arrays[0].shape))
        target.finish()


def test_positions_by_names_and_orientation(tmp_path: Path) -> None:
    """An image whose axes are x, y, z in array order, and one whose patient lies otherwise."""
    axes = [{"name": name, "type": "space", "unit": "meter"} for name in "xyz"]
    group = zarr.create_group(
        str(tmp_path / "a.zarr"), attributes=metadata("0.5", axes, [([0.001, 0.002, 0.003], [0.1, 0.2, 0.3])])
    )
    group.create_array("0", shape=(5, 6, 7), dtype="u1")
    grid = open_image(tmp_path / "a.zarr").grid
    np.testing.assert_allclose(grid.positions([2, 1, 3]), (100 + 3 * 1, 200 + 1 * 2, 300 + 2 * 3))
    for axis, value in zip(axes, ("left-to-right", "posterior-to-anterior", "inferior-to-superior"), strict=True):
        axis["orientation"] = {"type": "anatomical", "value": value}  # type: ignore[assignment]
    group.attrs.put(metadata("0.5", axes, [([0.001, 0.002, 0.003], [0.1, 0.2, 0.3])]))
    grid = open_image(tmp_path / "a.zarr").grid
    np.testing.assert_allclose(grid.positions([2, 1, 3]), (-103, -202, 306))


def test_without_units_all_is_in_pixels(tmp_path: Path) -> None:
    for k, unit in enumerate((None, "pixel")):
        image(tmp_path / f"{k}.zarr", 3, "0.5", unit=unit)
        found = open_image(tmp_path / f"{k}.zarr")
        assert (found.spacing, found.origin) == ((1, 1, 1), (0, 0, 0))
        assert (found.level_grid(1).spacing, found.level_grid(1).origin) == ((2, 2, 1), (0.5, 0.5, 0))
        assert open_image(tmp_path / f"{k}.zarr", ndim=2).grid.shape == (19, 30)


def break_metadata(change: Any) -> Any:
    """Return a function that changes an image's attributes."""

    def broken(path: Path) -> None:
        told = json.loads((path / "zarr.json").read_text())
        change(told["attributes"]["ome"])
        (path / "zarr.json").write_text(json.dumps(told))

    return broken


def axis_of(k: int, **more: Any) -> Any:
    def change(ome: Json) -> None:
        ome["multiscales"][0]["axes"][k].update(more)

    return break_metadata(change)


def array_metadata(**more: Any) -> Any:
    def change(path: Path) -> None:
        told = json.loads((path / "0" / "zarr.json").read_text())
        told.update(more)
        (path / "0" / "zarr.json").write_text(json.dumps(told))

    return change


def steps_of(steps: Any) -> Any:
    return break_metadata(lambda ome: ome["multiscales"][0]["datasets"][1].update(coordinateTransformations=steps))


def swapped(ome: Json) -> None:
    ome["multiscales"][0]["axes"][1:3] = ome["multiscales"][0]["axes"][2:0:-1]


def multiscale(key: str, value: Any) -> Any:
    return break_metadata(lambda ome: ome["multiscales"][0].update({key: value}))


BAD = {
    "no image": (
        break_metadata(lambda ome: ome.pop("multiscales")),
        r"holds the arrays 0, 1, 2: give one .*/in.zarr/0",
    ),
    "empty": (break_metadata(lambda ome: ome.update(multiscales=[])), "multiscales are no list of images"),
    "version": (break_metadata(lambda ome: ome.update(version="0.2")), r"it is of OME-Zarr 0.2: use 0.4, 0.5 or 0.6"),
    "no axes": (multiscale("axes", None), "does not describe its axes"),
    "strings": (multiscale("axes", list("tczyx")), "does not describe its axes"),
    "no datasets": (multiscale("datasets", []), "has no datasets"),
    "too few axes": (break_metadata(lambda o: o["multiscales"][0]["axes"].pop(0)), "give 4 numbers"),
    "fewer axes": (
        break_metadata(
            lambda o: o["multiscales"][0].update(
                axes=described_axes("zyx"),
                datasets=[{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1, 1, 1]}]}],
            )
        ),
        "has the axes z, y, x, and its array 0 has 5",
    ),
    "order": (break_metadata(swapped), r"its axes are t \(time\), z \(space\), c \(channel\).*in the order time"),
    "type": (axis_of(2, type="spice"), "its axis z is of the type 'spice': use time, channel or space"),
    "field": (axis_of(1, type="displacement"), "of the type 'displacement'"),
    "twice": (axis_of(1, name="t"), "are named t, t, z, y, x"),
    "no name": (axis_of(1, name=None), "has no name"),
    "unit": (axis_of(2, unit="furlong"), "its axis z has the unit 'furlong': name a length"),
    "unit type": (axis_of(2, unit=3), "its axis z has the unit 3"),
    "units in part": (axis_of(2, unit=None), r"units only in part: z \(none\), y \(micrometer\)"),
    "no steps": (steps_of([]), "level 1 has no coordinateTransformations: add a scale"),
    "odd steps": (steps_of("scale"), "level 1 are no list"),
    "rotation": (steps_of([{"type": "rotation"}]), "level 1 has a transformation of the type 'rotation'"),
    "scale": (steps_of([{"type": "scale", "scale": [1, 1, 1, 1, -1]}]), "give 5 numbers above 0"),
    "path scale": (steps_of([{"type": "scale", "path": "a"}]), "the scale of its level 1 is None"),
    "translation": (
        steps_of([{"type": "scale", "scale": [1] * 5}, {"type": "translation", "translation": [0] * 4 + ["a"]}]),
        "give 5 finite numbers",
    ),
    "levels": (break_metadata(lambda o: o["multiscales"][0]["datasets"].reverse()), "from the finest to the coarsest"),
    "missing level": (
        break_metadata(lambda o: o["multiscales"][0]["datasets"][2].update(path="7")),
        "lacks its array 7",
    ),
    "outside": (
        break_metadata(lambda o: o["multiscales"][0]["datasets"][2].update(path="../7")),
        "have the path '../7'",
    ),
    "complex": (array_metadata(data_type="complex64", fill_value=[0, 0]), "its array 0 is of complex64"),
    "other type": (array_metadata(data_type="uint8"), "levels 0 and 1 are of uint8 and uint16"),
    "codec": (array_metadata(codecs=[{"name": "bytes"}, {"name": "wavelet"}]), "'wavelet', which is not available"),
    "damaged": (lambda path: (path / "0" / "zarr.json").write_text("{"), "its array 0 is damaged"),
    "damaged group": (lambda path: (path / "zarr.json").write_text("{"), "it is damaged"),
    "no group": (lambda path: (path / "zarr.json").unlink(), "there is no Zarr array or group"),
    "unfinished": (
        lambda path: (path / "supple.json").write_text('{"program": "supple", "state": "unfinished", "job": "a"}'),
        "it is an unfinished output of Supple",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_opened_is_told_in_one_sentence(name: str, tmp_path: Path) -> None:
    spoil, expected = BAD[name]
    image(tmp_path / "in.zarr", 3, "0.5", shape=(1, 1, 4, 8, 8))
    spoil(tmp_path / "in.zarr")
    with pytest.raises(SuppleError, match=expected) as told:
        open_image(tmp_path / "in.zarr")
    assert str(told.value).startswith("cannot read ")
    assert "in.zarr" in str(told.value)
    assert "\n" not in str(told.value)


def test_other_things_that_cannot_be_opened(tmp_path: Path, memory: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    zarr.create_array(str(tmp_path / "line.zarr"), shape=(5,), dtype="u1")
    zarr.create_array(str(tmp_path / "none.zarr"), shape=(0, 5), dtype="u1")
    zarr.create_group(str(tmp_path / "group.zarr"), zarr_format=2)
    zarr.create_group(str(tmp_path / "nested.zarr")).create_group("series")
    array = zarr.create_array(str(tmp_path / "old.zarr"), shape=(5, 5), dtype="u1", zarr_format=2)
    assert array.shape == (5, 5)
    told = json.loads((tmp_path / "old.zarr" / ".zarray").read_text()) | {"compressor": {"id": "wavelet"}}
    (tmp_path / "old.zarr" / ".zarray").write_text(json.dumps(told))
    for address, expected in (
        (tmp_path / "no.zarr", "there is no such folder"),
        (tmp_path / "file", "it is no folder"),
        (tmp_path / "empty", "there is no Zarr array or group"),
        (f"{memory}/no.zarr", "there is no Zarr array or group"),
        ("nothing://x/y.zarr", "nothing"),
        (tmp_path / "line.zarr", "the array has 1 axes"),
        (tmp_path / "none.zarr", r"shape \(0, 5\)"),
        (tmp_path / "group.zarr", "a group without an image: give"),
        (tmp_path / "nested.zarr", "holds the groups series: give one of them"),
        (tmp_path / "old.zarr", "'wavelet', which is not available"),
    ):
        with pytest.raises(SuppleError, match=expected) as found:
            open_image(address)
        assert "\n" not in str(found.value)
    image(tmp_path / "in.zarr", 3, "0.5", names="yx", shape=(9, 9), chunks=(4, 4), count=1)
    with pytest.raises(SuppleError, match="has 2 axes of space: give at most 2 for ndim"):
        open_image(tmp_path / "in.zarr", ndim=3)
    with pytest.raises(SuppleError, match="ndim must be 2 or 3, not 4"):
        open_image(tmp_path / "in.zarr", ndim=4)


def test_an_input_of_no_whole_factors_is_refused(tmp_path: Path) -> None:
    attributes = metadata("0.5", described_axes("yx"), [([1, 1], [0, 0]), ([1.5, 1.5], [0, 0])])
    group = zarr.create_group(str(tmp_path / "in.zarr"), attributes=attributes)
    group.create_array("0", shape=(30, 30), dtype="u1")
    group.create_array("1", shape=(20, 20), dtype="u1")
    with pytest.raises(
        SuppleError, match="30 samples along y become 20: give an image whose levels are smaller by whole"
    ):
        create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    assert os.listdir(tmp_path) == ["in.zarr"]


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"shape": (3, 4)}, "shape must be 3 integers above 0"),
        ({"shape": (3, 4, 0)}, "shape must be 3"),
        ({"shape": (3, 4, 1.5)}, "shape must be 3"),
        ({"scale": (1, 2, 0)}, "scale must be 5 numbers above 0"),
        ({"scale": 3}, "scale must be 5"),
        ({"translation": (1, 2, float("nan"))}, "translation must be 5 finite numbers"),
        ({"chunks": (1,) * 6}, "chunks must be 5 integers"),
    ],
)
def test_arguments_that_do_not_fit(more: Json, expected: str, tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", 3, "0.5")
    with pytest.raises(SuppleError, match=expected):
        create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a", **more)
    assert os.listdir(tmp_path) == ["in.zarr"]


def small(path: str | Path) -> tuple[Array, StoredImage]:
    (values,) = image(path, 3, "0.5", names="zyx", shape=(4, 9, 9), chunks=(2, 4, 4), count=1)
    return values, open_image(path)


@pytest.mark.parametrize("remote", [False, True])
def test_existing_outputs_and_other_jobs(remote: bool, tmp_path: Path, memory: str) -> None:
    root = memory if remote else str(tmp_path)
    values, like = small(f"{root}/in.zarr")
    out, box = f"{root}/out.zarr", [(0, 2), (0, 4), (0, 4)]
    first = create(out, like, job="one")
    first.write(0, box, part(values, box))
    again = create(out, like, job="one")
    assert again.is_done(0, box)
    assert not again.is_done(0, whole(again))
    with pytest.raises(SuppleError, match=r"is the unfinished output of another job: choose .*--force starts anew"):
        create(out, like, job="two")
    assert create(out, like, job="one", force=True).is_done(0, box)
    with pytest.raises(SuppleError, match="of another job"):
        create(out, like, shape=(4, 5, 5), job="one")
    anew = create(out, like, job="two", force=True)
    assert not anew.is_done(0, box)
    fill(anew, values)
    anew.finish()
    with pytest.raises(SuppleError, match=r"exists already: pass --force \(force=True\) to replace it"):
        create(out, like, job="two")
    other = create(out, like, job="three", force=True)
    assert not other.is_done(0, box)
    if not remote:
        np.testing.assert_array_equal(open_image(out).levels[0].array[...], values)
    fill(other, values + 1)
    other.finish()
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values + 1)
    if not remote:
        assert sorted(os.listdir(tmp_path)) == ["in.zarr", "out.zarr"]
        assert not (tmp_path / "out.zarr" / "supple.json").exists()


@pytest.mark.parametrize("force", [False, True])
def test_what_is_no_store_is_never_replaced(force: bool, tmp_path: Path, memory: str) -> None:
    _, like = small(tmp_path / "in.zarr")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "one.png").write_text("one")
    (tmp_path / "a.zarr.partial").mkdir()
    (tmp_path / "a.zarr.partial" / "one.png").write_text("one")
    (tmp_path / "file.zarr").write_text("one")
    fsspec = pytest.importorskip("fsspec")
    fsspec.filesystem("memory").pipe(f"{memory}/photos/one.png", b"one")
    for address in (tmp_path / "photos", tmp_path / "a.zarr", tmp_path / "file.zarr", f"{memory}/photos"):
        expected = "no Zarr store|in the way" if force else "exists already|in the way"
        with pytest.raises(SuppleError, match=expected):
            create(address, like, job="a", force=force)
    assert (tmp_path / "photos" / "one.png").read_text() == "one"
    assert (tmp_path / "a.zarr.partial" / "one.png").read_text() == "one"
    assert fsspec.filesystem("memory").cat(f"{memory}/photos/one.png") == b"one"
    with pytest.raises(SuppleError, match="there is no folder"):
        create(tmp_path / "no" / "out.zarr", like, job="a", force=force)


def test_an_input_is_not_overwritten_in_place(memory: str) -> None:
    values, like = small(f"{memory}/in.zarr")
    for address in (f"{memory}/in.zarr", f"{memory}/in.zarr/", memory):
        with pytest.raises(SuppleError, match="it is the input too"):
            create(address, like, job="a", force=True)
    np.testing.assert_array_equal(like.levels[0].array[...], values)


def test_an_input_that_is_a_folder_is_replaced_at_the_end(tmp_path: Path) -> None:
    values, like = small(tmp_path / "in.zarr")
    target = create(tmp_path / "in.zarr", like, job="a", force=True)
    for box in boxes(target, 0):
        target.write(0, box, part(like.levels[0].array, box) // 2)
    target.finish()
    np.testing.assert_array_equal(open_image(tmp_path / "in.zarr").levels[0].array[...], values // 2)
    assert os.listdir(tmp_path) == ["in.zarr"]


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
    with pytest.raises(SuppleError, match=r"is not aligned to blocks of \(1, 2, "):
        target.is_done(0, [(0, 1), (0, 2), (0, 4), (0, 8), (0, 15)])
    with pytest.raises(SuppleError, match="level must be from 1 to 2, not 0"):
        target.reduce(0, whole(target))


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
    counts = [target.copy(0, box, like.levels[0]) for box in boxes(target, 0)]
    assert all(counts)
    assert target.is_done(0, whole(target))
    total = target.copy(1, whole(target, 1), like.levels[1])
    np.testing.assert_array_equal(target.arrays[0][...], arrays[0])
    np.testing.assert_array_equal(target.arrays[1][...], arrays[1])
    if not remote:
        kept, made = files(tmp_path / "in.zarr"), files(tmp_path / "out.zarr.partial")
        chunks = [name for name in kept if name[0] in "01" and not name.endswith((".json", ".zarray", ".zattrs"))]
        assert all(kept[name] == made[name] for name in chunks)
        assert sum(len(kept[name]) for name in chunks) == sum(map(int, filter(None, counts))) + int(total or 0)


def test_blocks_that_are_stored_otherwise_are_not_copied(tmp_path: Path) -> None:
    values, like = small(tmp_path / "in.zarr")
    target = create(tmp_path / "out.zarr", like, job="a")
    box = [(0, 2), (0, 4), (0, 4)]

    def other(name: str, **more: Any) -> Any:
        made = {"shape": (4, 9, 9), "dtype": "u2", "chunks": (2, 4, 4), "fill_value": 7} | more
        zarr.create_array(str(tmp_path / name), **made)
        return open_image(tmp_path / name).levels[0]

    assert target.copy(0, box, other("same")) == 0
    assert not target.is_done(0, box)
    assert target.copy(0, box, like.levels[0])
    for k, more in enumerate(
        (
            {"dtype": "i2"},
            {"chunks": (2, 4, 5)},
            {"fill_value": 0},
            {"compressors": None},
            {"zarr_format": 2},
            {"chunks": (1, 2, 2), "shards": (2, 4, 4)},
            {"shape": (1, 9, 9)},
            {"shape": (1, 4, 9, 9), "chunks": (1, 2, 4, 4)},
        )
    ):
        assert target.copy(0, box, other(str(k), **more)) is None
    # another encoding of keys is no other encoding of chunks
    flat = other("flat", chunk_key_encoding={"name": "v2", "separator": "."})
    writable = zarr.open_array(str(tmp_path / "flat"), mode="r+")
    writable[...] = values
    assert target.copy(0, whole(target), flat)
    np.testing.assert_array_equal(target.arrays[0][...], values)


def test_nan_as_fill_value_is_equal_to_itself(tmp_path: Path) -> None:
    for name in ("a", "b"):
        zarr.create_array(str(tmp_path / name), data=np.ones((4, 4), np.float32), chunks=(2, 2), fill_value=np.nan)
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "a"), job="a")
    assert create(tmp_path / "out.zarr", open_image(tmp_path / "a"), job="a").copy(
        0, whole(target), open_image(tmp_path / "b").levels[0]
    )


def exact(values: Array, factors: list[int]) -> Array:
    """Means by whole numbers of Python, or in float64, one after the other."""
    shape = [-(-n // f) for n, f in zip(values.shape, factors, strict=True)]
    made = np.empty(shape, values.dtype)
    for place in np.ndindex(*shape):
        group = values[tuple(slice(i * f, (i + 1) * f) for i, f in zip(place, factors, strict=True))]
        if values.dtype.kind == "f":
            made[place] = group.astype(np.float64).mean()
        else:
            total, n = sum(int(x) for x in group.ravel()), group.size
            low, rest = divmod(total, n)
            made[place] = low + (2 * rest > n or (2 * rest == n and low % 2 == 1))
    return made


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


def test_steps_between_levels() -> None:
    assert step_of(1000, 500, 2.0) == Step(2, False)
    assert step_of(1001, 501, 2.0) == Step(2, False)
    assert step_of(1001, 500, 2.002) == Step(2, True)
    assert step_of(1000, 500, 1.0) == Step(2, False)  # the scale is wrong
    assert step_of(1, 1, 2.0) == Step(2, False)
    assert step_of(1, 1, 1.0) == Step(1, False)
    assert step_of(30, 20, 1.5) is None
    assert step_of(81, 27, 3.0) == Step(3, False)


def test_an_incomplete_group_is_left_out_where_the_input_does(tmp_path: Path) -> None:
    attributes = metadata("0.5", described_axes("yx"), [([1, 1], [0, 0]), ([2, 2], [0.5, 0.5])])
    group = zarr.create_group(str(tmp_path / "in.zarr"), attributes=attributes)
    group.create_array("0", shape=(9, 11), dtype="u1", chunks=(4, 4))
    group.create_array("1", shape=(4, 5), dtype="u1", chunks=(4, 4))
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), shape=(7, 13), job="a")
    assert [array.shape for array in target.arrays] == [(7, 13), (3, 6)]
    values = RNG.integers(0, 255, (7, 13), np.uint8)
    fill(target, values)
    np.testing.assert_array_equal(target.arrays[1][...], exact(values[:6, :12], [2, 2]))


def test_labels_are_reduced_to_first_samples(tmp_path: Path) -> None:
    (values, *_) = image(tmp_path / "in.zarr", 3, "0.5", count=2)
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    target.write(0, whole(target), values)
    for box in boxes(target, 1):
        target.reduce(1, box, "nearest")
    np.testing.assert_array_equal(target.arrays[1][...], values[..., ::2, ::2])


def child(code: str, *arguments: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": SOURCE}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


WRITER = """
    import sys
    import numpy as np
    from supple.media.stores import create, open_image
    target = create(sys.argv[2], open_image(sys.argv[1]), job="a")
    rng = np.random.default_rng(1)
    n = target.block[1]
    print("go", flush=True)
    while True:
        for a in range(0, 256, n):
            for b in range(0, 256, n):
                target.write(0, [(0, 16), (a, a + n), (b, b + n)], rng.integers(0, 60000, (16, n, n)))
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are killed by a signal of POSIX")
@pytest.mark.parametrize("sharded", [False, True])
def test_what_is_done_decodes_after_writers_were_killed(sharded: bool, tmp_path: Path) -> None:
    image(
        tmp_path / "in.zarr",
        3,
        "0.5",
        names="zyx",
        shape=(16, 256, 256),
        chunks=(16, 32, 32),
        shards=(16, 64, 64) if sharded else None,
        count=1,
    )
    like = open_image(tmp_path / "in.zarr")
    out = tmp_path / "out.zarr"
    seen = 0
    for wait in (0.0, 0.02, 0.05, 0.11):
        with child(WRITER, tmp_path / "in.zarr", out) as writer:
            assert writer.stdout is not None
            assert writer.stdout.readline() == "go\n"
            time.sleep(wait)
            os.kill(writer.pid, signal.SIGKILL)
        target = create(out, like, job="a")
        done = [box for box in boxes(target, 0) if target.is_done(0, box)]
        assert len(done) >= seen
        seen = len(done)
        for box in done:
            assert part(target.arrays[0], box).shape == (16, *target.block[1:])
    assert seen
    # what a killed writer leaves is no part of the output
    spare = next(path for path in (tmp_path / "out.zarr.partial" / "0").rglob("*") if path.is_file())
    spare.with_name(f"3.{'0' * 32}.partial").write_bytes(b"half")
    values = RNG.integers(0, 60000, (16, 256, 256)).astype(np.uint16)
    fill(target, values)
    target.finish()
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values)
    assert sorted(files(out)) == sorted(files(tmp_path / "in.zarr"))


def test_a_chunk_without_content_is_not_done(tmp_path: Path) -> None:
    values, like = small(tmp_path / "in.zarr")
    target = create(tmp_path / "out.zarr", like, job="a")
    fill(target, values)
    (tmp_path / "out.zarr.partial" / "0" / "c" / "0" / "0" / "0").write_bytes(b"")
    assert not target.is_done(0, [(0, 2), (0, 4), (0, 4)])
    assert target.is_done(0, [(0, 2), (0, 4), (4, 8)])


def test_a_writer_that_was_killed_before_all_metadata_were_there(tmp_path: Path) -> None:
    values, like = small(tmp_path / "in.zarr")
    partial = tmp_path / "out.zarr.partial"
    create(tmp_path / "out.zarr", like, job="a")
    (partial / "0" / "zarr.json").unlink()
    create(tmp_path / "out.zarr", like, job="a")
    for path in (partial / "supple.json", partial / "0" / "zarr.json", partial / "zarr.json"):
        path.unlink()
    (partial / "0").rmdir()
    (partial / f"supple.{'0' * 32}.partial").write_text("{")
    target = create(tmp_path / "out.zarr", like, job="b")
    fill(target, values)
    target.finish()
    assert sorted(files(tmp_path / "out.zarr")) == sorted(files(tmp_path / "in.zarr"))


@pytest.mark.parametrize("step", ["old", "new", "marker"])
def test_a_finish_that_was_interrupted_is_finished_again(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupt comes instead of one of the renames, or of the last removal."""
    values, like = small(tmp_path / "in.zarr")
    small(tmp_path / "out.zarr")
    target = create(tmp_path / "out.zarr", like, job="a", force=True)
    fill(target, values + 1)
    calls = {"rename": 0}
    rename, unlink = os.rename, os.unlink

    def counted(before: Any, after: Any) -> None:
        calls["rename"] += 1
        if calls["rename"] == {"old": 1, "new": 2, "marker": 9}[step]:
            raise KeyboardInterrupt
        rename(before, after)

    def removed(path: Any, **more: Any) -> None:
        if step == "marker":
            raise KeyboardInterrupt
        unlink(path, **more)

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", counted)
        patched.setattr(os, "unlink", removed)
        with pytest.raises(KeyboardInterrupt):
            target.finish()
    if step != "marker":
        again = create(tmp_path / "out.zarr", like, job="a", force=True)
        assert again.is_done(0, whole(again))
        again.finish()
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], values + 1)
    assert not (tmp_path / "out.zarr.partial").exists()


class Stopped(Exception):  # noqa: N818
    """An interrupt. Python's own would end the thread in which zarr waits for stores."""


def test_a_clearing_that_was_interrupted_begins_again(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from zarr.storage import FsspecStore

    values, like = small(f"{memory}/in.zarr")
    out = f"{memory}/out.zarr"
    first = create(out, like, job="one")
    fill(first, values)
    first.finish()
    delete, calls = FsspecStore.delete_dir, []

    async def counted(self: Any, key: str) -> None:
        calls.append(key)
        if len(calls) == 2:
            raise Stopped
        await delete(self, key)

    with monkeypatch.context() as patched:
        patched.setattr(FsspecStore, "delete_dir", counted)
        with pytest.raises(Stopped):
            create(out, like, job="two", force=True)
    with pytest.raises(SuppleError, match="unfinished"):
        open_image(out)
    second = create(out, like, job="two")
    assert not any(second.is_done(0, box) for box in boxes(second, 0))
    fill(second, values + 1)
    second.finish()
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values + 1)


def test_where_objects_may_be_incomplete_nothing_is_continued(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.media.stores import places

    values, like = small(f"{memory}/in.zarr")
    create(f"{memory}/out.zarr", like, job="a").write(0, [(0, 4), (0, 9), (0, 9)], values)
    monkeypatch.setattr(places, "_ATOMIC", set())
    with pytest.raises(SuppleError, match=r"objects there may be incomplete: .*--force starts anew"):
        create(f"{memory}/out.zarr", like, job="a")
    anew = create(f"{memory}/out.zarr", like, job="a", force=True)
    assert not any(anew.is_done(0, box) for box in boxes(anew, 0))


LIMITED = """
    import resource, signal, sys
    import numpy as np
    from supple import SuppleError
    from supple.media.stores import create, open_image
    target = create(sys.argv[2], open_image(sys.argv[1]), job="a")
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
    try:
        target.write(0, [(0, 4), (0, 99), (0, 99)], np.random.default_rng(0).integers(0, 60000, (4, 99, 99)))
        target.finish()
    except SuppleError as error:
        print(error)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits are POSIX's")
def test_a_full_disk_is_told_in_one_sentence_and_nothing_is_renamed(tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", 3, "0.5", names="zyx", shape=(4, 99, 99), chunks=(2, 50, 50), count=1)
    with child(LIMITED, tmp_path / "in.zarr", tmp_path / "out.zarr") as process:
        out, err = process.communicate()
    assert not err
    assert (
        out == f"cannot write {tmp_path / 'out.zarr'}: {os.strerror(errno.EFBIG)}: make room or choose another place\n"
    )
    assert sorted(os.listdir(tmp_path)) == ["in.zarr", "out.zarr.partial"]
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    assert not any(target.is_done(0, box) for box in boxes(target, 0))


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
        (PermissionError(errno.EACCES, "Permission denied"), "Permission denied: choose a place"),
        (OSError("bucket is gone"), "bucket is gone: choose another place"),
    ):

        async def failing(self: Any, key: str, value: Any, error: Exception = error) -> None:
            raise error

        with monkeypatch.context() as patched:
            patched.setattr(kind, "set", failing)
            for act in (
                lambda: target.write(0, whole(target), values),
                lambda: target.copy(0, whole(target), like.levels[0]),
                lambda: create(f"{root}/other.zarr", like, job="a"),
            ):
                with pytest.raises(SuppleError, match=expected) as told:
                    act()
                assert str(told.value).startswith(f"cannot write {root}/o")
    if not remote:
        assert not (tmp_path / "out.zarr").exists()


def test_without_zarr(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple import errors

    monkeypatch.setattr(errors, "find_spec", lambda name: None)
    with pytest.raises(
        SuppleError, match=r"Zarr stores need zarr, which is not installed: pip install 'supple\[zarr\]'"
    ):
        open_image(tmp_path)


def test_levels_of_other_paths(tmp_path: Path) -> None:
    """Some programs nest their levels in groups."""
    for form, version in VERSIONS[:2]:
        attributes = metadata(version, described_axes("yx"), [([1, 1], [0, 0]), ([2, 2], [0.5, 0.5])])
        listed = (attributes.get("ome") or attributes)["multiscales"][0]["datasets"]
        group = zarr.create_group(str(tmp_path / f"{form}.zarr"), zarr_format=form)
        for k, size in enumerate((8, 4)):
            listed[k]["path"] = f"scale{k}/image"
            group.create_array(f"scale{k}/image", data=np.full((size, size), k, np.uint8))
        group.attrs.put(attributes)
        like = open_image(tmp_path / f"{form}.zarr")
        target = create(tmp_path / f"{form}-out.zarr", like, job="a")
        fill(target, np.ones((8, 8)))
        target.finish()
        opened = zarr.open_group(str(tmp_path / f"{form}-out.zarr"), mode="r")
        assert opened["scale1/image"][...].tolist() == [[1] * 4] * 4
        assert sorted(opened["scale0"].keys()) == ["image"]
        for one, other in pairwise(open_image(tmp_path / f"{form}-out.zarr").levels):
            assert (one.path, other.path) == ("scale0/image", "scale1/image")


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


def test_an_address_that_is_not_reached(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from zarr.storage import FsspecStore

    async def failing(self: Any, key: str, *more: Any, **named: Any) -> None:
        raise PermissionError("Forbidden")

    small(f"{memory}/in.zarr")
    monkeypatch.setattr(FsspecStore, "get", failing)
    with pytest.raises(SuppleError, match=r"it cannot be reached \(Forbidden\): check the address, your rights"):
        open_image(f"{memory}/in.zarr")


@pytest.mark.filterwarnings("ignore:Numcodecs codecs are not in the Zarr version 3")
def test_codecs_of_numcodecs_are_looked_for_at_once(tmp_path: Path) -> None:
    """Zarr itself looks for them at the first chunk."""
    values = np.arange(64, dtype=np.uint16).reshape(8, 8)
    codec = zarr.codecs.numcodecs.BZ2(level=1)
    zarr.create_array(str(tmp_path / "in.zarr"), data=values, chunks=(4, 4), compressors=[codec])
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    fill(target, values)
    target.finish()
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], values)
    told = json.loads((tmp_path / "in.zarr" / "zarr.json").read_text())
    told["codecs"] = [{"name": "numcodecs.pcodec", "configuration": {}}]
    (tmp_path / "in.zarr" / "zarr.json").write_text(json.dumps(told))
    try:
        import pcodec
    except ImportError:
        with pytest.raises(SuppleError, match="'pcodec', which is not available: install that codec"):
            open_image(tmp_path / "in.zarr")
    else:
        assert pcodec
