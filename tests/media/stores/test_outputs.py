"""Outputs like a stored image: their metadata, on another grid as well."""

from __future__ import annotations

import json
import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zarr

from supple import SuppleError
from supple.media.stores.image import open_image
from supple.media.stores.target import create
from tests.effort import pairs
from tests.media.stores.images import VERSIONS, described_axes, files, fill, image, metadata, plain_json, whole


@pytest.mark.parametrize(
    ("where", "stored", "sharded"),
    pairs(
        ["folder", "memory", "file"], VERSIONS, [False, True], where=lambda _, stored, deep: stored[0] == 3 or not deep
    ),
)
def test_round_trips_of_images(where: str, stored: tuple[int, str], sharded: bool, tmp_path: Path, memory: str) -> None:
    form, version = stored
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
    np.testing.assert_allclose(like.grid.spacing, (0.00025, 0.0005, 0.002), rtol=1e-12)
    assert like.grid.origin == (0, 0, 0)
    assert like.grid.shape == like.shape[2:] == (6, 19, 30)
    target = create(out, like, job="a")
    assert target.blocks[0] == ((1, 2, 8, 16, 32) if sharded else (1, 2, 4, 8, 16))
    assert target.factors == ((1,) * 5, (1, 1, 1, 2, 2), (1, 1, 1, 2, 2))
    assert not target.is_done(0, whole(target))
    with pytest.raises(SuppleError, match="unfinished"):
        open_image(f"{out}.partial" if where != "memory" else out)
    with pytest.raises(SuppleError, match="unfinished"):
        open_image(f"{out}.partial/0" if where != "memory" else f"{out}/0")
    fill(target, before[0])
    for level in range(3):
        assert target.is_done(level, whole(target, level))
    target.finish()
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


@pytest.mark.parametrize(("form", "version"), VERSIONS)
@pytest.mark.parametrize("centred", [False, True])
def test_another_grid_has_its_scale_and_translation_on_each_level(
    form: int, version: str, centred: bool, tmp_path: Path
) -> None:
    image(tmp_path / "in.zarr", form, version, centred=centred)
    like = open_image(tmp_path / "in.zarr")
    target = create(
        tmp_path / "out.zarr",
        like,
        shape=(6, 25, 33),
        scale=(0.5, 1, 1, 1.5, 3),
        translation=(0, 0, 7, -2, 0.25),
        job="a",
    )
    shapes = [(2, 2, 6, 25, 33), (2, 2, 6, 13, 17), (2, 2, 6, 7, 9)]
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
    np.testing.assert_allclose(again.grid.spacing, (0.003, 0.0015, 0.001))
    np.testing.assert_allclose(again.grid.origin, (0.00025, -0.002, 0.007))


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
    told = json.loads((target.site.folder / ".zattrs").read_text())["multiscales"][0]
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


def test_levels_of_no_whole_factors_become_smaller_by_the_next(tmp_path: Path) -> None:
    attributes = metadata("0.5", described_axes("yx"), [([1, 1], [0, 0]), ([1.5, 1.5], [0, 0])])
    group = zarr.create_group(str(tmp_path / "in.zarr"), attributes=attributes)
    group.create_array("0", shape=(30, 30), dtype="u1")
    group.create_array("1", shape=(20, 20), dtype="u1")
    target = create(tmp_path / "out.zarr", open_image(tmp_path / "in.zarr"), job="a")
    assert [array.shape for array in target.arrays] == [(30, 30), (15, 15)]
    fill(target, np.ones((30, 30)))
    target.finish()
    assert [level.scale for level in open_image(tmp_path / "out.zarr").levels] == [(1, 1), (2, 2)]


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
