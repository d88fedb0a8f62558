"""Stores, opened: their axes, positions and levels, and what cannot be opened."""

from __future__ import annotations

import functools
import http.server
import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from supple import SuppleError
from supple.media.files import is_store
from supple.media.stores.image import open_image
from supple.media.stores.target import create
from tests.media.stores.images import Json, image, metadata, small
from tests.refusals import refused


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
        assert (found.grid.spacing, found.grid.origin) == ((1, 1, 1), (0, 0, 0))
        assert open_image(tmp_path / f"{k}.zarr", ndim=2).grid.shape == (19, 30)


GONE = object()


def changed(path: Path, place: str, value: Any) -> None:
    """Set what stands at a place in the attributes of an image, or delete it; a function is given what is there."""
    told = json.loads((path / "zarr.json").read_text())
    *steps, last = (int(step) if step.isdigit() else step for step in place.split("/"))
    at = told["attributes"]["ome"]
    for step in steps:
        at = at[step]
    if value is GONE:
        del at[last]
    else:
        at[last] = value(at[last]) if callable(value) else value
    (path / "zarr.json").write_text(json.dumps(told))


IMAGE = "multiscales/0"
STEPS = f"{IMAGE}/datasets/1/coordinateTransformations"
SCALE: Json = {"type": "scale", "scale": [1] * 5}
# Places in the metadata of an image, what is put there, and what is said.
BAD: list[tuple[str, Any, str]] = [
    ("multiscales", GONE, r"holds 0, 1, 2: give one .*/in.zarr/0"),
    ("multiscales", [], "malformed .IndexError"),
    ("version", "0.2", r"it is of OME-Zarr 0.2: use 0.4, 0.5 or 0.6"),
    (f"{IMAGE}/axes", None, "incomplete or malformed"),
    (f"{IMAGE}/datasets", [], "malformed .IndexError"),
    (f"{IMAGE}/axes/0", GONE, "axes c, z, y, x, and its array 0 has 5"),
    (f"{IMAGE}/axes", lambda a: [a[0], a[2], a[1], *a[3:]], r"its axes are t \(time\), z \(space\), c .*order time"),
    (f"{IMAGE}/axes/2/type", "spice", r"its axes are .*z \(spice\)"),
    (f"{IMAGE}/axes/1/name", GONE, "malformed .KeyError: 'name'"),
    (f"{IMAGE}/axes/2/unit", "furlong", "its axis z has the unit 'furlong': name a length"),
    (f"{IMAGE}/axes/2/unit", None, r"units only in part: z \(none\), y \(micrometer\)"),
    (STEPS, [{"type": "rotation"}], "level 1 has a transformation of the type 'rotation'"),
    (STEPS, [{"type": "scale", "scale": [1, 1, 1, 1, -1]}], "give 5 numbers above 0"),
    (STEPS, [{"type": "scale", "path": "a"}], "the scale of its level 1 is None"),
    (STEPS, [SCALE, {"type": "translation", "translation": [0, 0, 0, 0, "a"]}], "give 5 finite numbers"),
    (f"{IMAGE}/datasets", lambda levels: levels[::-1], "from the finest to the coarsest"),
    (f"{IMAGE}/datasets/2/path", "7", "its array 7 is missing or damaged"),
    (f"{IMAGE}/datasets/2/path", "../7", "have the path '../7'"),
]
# Files of an image, what is changed in them or all that they hold then, and what is said.
FILES: list[tuple[str, Json | str | None, str]] = [
    ("0/zarr.json", {"data_type": "complex64", "fill_value": [0, 0]}, "its array 0 is of complex64"),
    ("0/zarr.json", {"codecs": [{"name": "bytes"}, {"name": "wavelet"}]}, "'wavelet', which is not available"),
    ("0/zarr.json", "{", "its array 0 is missing or damaged"),
    ("zarr.json", "{", "it is damaged"),
    ("zarr.json", None, "there is no Zarr array or group"),
    ("supple.json", '{"program": "supple", "state": "unfinished", "job": "a"}', "it is an unfinished output of Supple"),
]


@pytest.mark.parametrize(("place", "value", "expected"), [*BAD, *FILES])
def test_what_cannot_be_opened_is_told_in_one_sentence(place: str, value: Any, expected: str, tmp_path: Path) -> None:
    image(tmp_path / "in.zarr", 3, "0.5", shape=(1, 1, 4, 8, 8))
    file = tmp_path / "in.zarr" / place
    if not place.endswith(".json"):
        changed(tmp_path / "in.zarr", place, value)
    elif value is None:
        file.unlink()
    else:
        file.write_text(value if isinstance(value, str) else json.dumps(json.loads(file.read_text()) | value))
    told = refused(open_image, tmp_path / "in.zarr", match=expected)
    assert told.startswith("cannot read ")
    assert "in.zarr" in told
    assert told.count("cannot read") == 1


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
        (tmp_path / "nested.zarr", "holds series: give one of them"),
        (tmp_path / "old.zarr", "'wavelet', which is not available"),
    ):
        refused(open_image, address, match=expected)
    image(tmp_path / "in.zarr", 3, "0.5", names="yx", shape=(9, 9), chunks=(4, 4), count=1)
    with pytest.raises(SuppleError, match="has 2 axes of space: give at most 2 for ndim"):
        open_image(tmp_path / "in.zarr", ndim=3)


def test_colons_alone_make_no_address(tmp_path: Path) -> None:
    """A name may hold ``::``, which chains addresses."""
    small(tmp_path / "in.zarr")
    (tmp_path / "in.zarr").rename(tmp_path / "a::b.zarr")
    assert open_image(tmp_path / "a::b.zarr").shape == (4, 9, 9)
    (tmp_path / "a::b.png").write_text("")
    assert not is_store(tmp_path / "a::b.png")
    assert is_store("simplecache::memory://a")
