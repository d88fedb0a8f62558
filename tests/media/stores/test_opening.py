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
from supple.media.stores import create, open_image
from tests.media.stores.images import Json, image, metadata, small


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
        r"holds 0, 1, 2: give one .*/in.zarr/0",
    ),
    "empty": (
        break_metadata(lambda ome: ome.update(multiscales=[])),
        "malformed .IndexError",
    ),
    "version": (break_metadata(lambda ome: ome.update(version="0.2")), r"it is of OME-Zarr 0.2: use 0.4, 0.5 or 0.6"),
    "no axes": (multiscale("axes", None), "incomplete or malformed"),
    "no datasets": (multiscale("datasets", []), "its image has no datasets"),
    "too few axes": (
        break_metadata(lambda o: o["multiscales"][0]["axes"].pop(0)),
        "axes c, z, y, x, and its array 0 has 5",
    ),
    "order": (break_metadata(swapped), r"its axes are t \(time\), z \(space\), c \(channel\).*in the order time"),
    "type": (axis_of(2, type="spice"), "its axis z is of the type 'spice': use time, channel or space"),
    "field": (axis_of(1, type="displacement"), "of the type 'displacement'"),
    "twice": (axis_of(1, name="t"), "are named t, t, z, y, x"),
    "no name": (break_metadata(lambda o: o["multiscales"][0]["axes"][1].pop("name")), "malformed .KeyError: 'name'"),
    "unit": (axis_of(2, unit="furlong"), "its axis z has the unit 'furlong': name a length"),
    "units in part": (axis_of(2, unit=None), r"units only in part: z \(none\), y \(micrometer\)"),
    "no steps": (steps_of([]), "level 1 has no coordinateTransformations: add a scale"),
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
    "other type": (array_metadata(data_type="uint8"), "levels 0 and 1 are of uint8 in Zarr format 3 and uint16"),
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
    assert str(told.value).count("cannot read") == 1


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
        with pytest.raises(SuppleError, match=expected) as found:
            open_image(address)
        assert "\n" not in str(found.value)
    image(tmp_path / "in.zarr", 3, "0.5", names="yx", shape=(9, 9), chunks=(4, 4), count=1)
    with pytest.raises(SuppleError, match="has 2 axes of space: give at most 2 for ndim"):
        open_image(tmp_path / "in.zarr", ndim=3)


def test_an_address_that_is_not_reached(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from zarr.storage import FsspecStore

    async def failing(self: Any, key: str, *more: Any, **named: Any) -> None:
        raise PermissionError("Forbidden")

    small(f"{memory}/in.zarr")
    monkeypatch.setattr(FsspecStore, "get", failing)
    with pytest.raises(SuppleError, match=r"it cannot be reached \(Forbidden\): check the address, your rights"):
        open_image(f"{memory}/in.zarr")


def test_colons_alone_make_no_address(tmp_path: Path) -> None:
    """A name may hold ``::``, which chains addresses."""
    small(tmp_path / "in.zarr")
    (tmp_path / "in.zarr").rename(tmp_path / "a::b.zarr")
    assert open_image(tmp_path / "a::b.zarr").shape == (4, 9, 9)
    (tmp_path / "a::b.png").write_text("")
    assert not is_store(tmp_path / "a::b.png")
    assert is_store("simplecache::memory://a")
