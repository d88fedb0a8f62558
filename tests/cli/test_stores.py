"""Zarr stores on the command line: bent, planned, described, interrupted and refused."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

zarr = pytest.importorskip("zarr")
pytest.importorskip("dask")

from supple import Recipe, Stroke, warp_file  # noqa: E402
from tests.children import start  # noqa: E402
from tests.cli.commands import Run, done, one_line, told  # noqa: E402

FLAT = ("--grab", "14,12:17,14", "--radius", "5")
DEEP = ("--grab", "14,12,4:16,13,5", "--radius", "3")


def store(name: str, shape: tuple[int, ...], chunk: int = 16, **more: object) -> None:
    values = np.random.default_rng(0).integers(0, 200, shape).astype(np.uint16)
    zarr.create_array(name, data=values, chunks=tuple(min(chunk, size) for size in shape), **more)


def test_a_store_is_bent(run: Run) -> None:
    store("in.zarr", (40, 48))
    status, out, err = run("warp", "in.zarr", "out.zarr", *FLAT, "--json", "--save-recipe", "strokes.json")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    assert (facts["width"], facts["height"], facts["shape"]) == (48, 40, [40, 48])
    assert facts["blocks"] >= 1
    assert facts["done"] == 0
    stroke = Stroke.grab((14, 12), to=(17, 14), radius=5)
    warp_file("in.zarr", "same.zarr", Recipe(strokes=[stroke]))
    assert np.array_equal(zarr.open("out.zarr")[...], zarr.open("same.zarr")[...])
    assert run("warp", "in.zarr", "again.zarr", "--recipe", "strokes.json")[0] == 0
    assert np.array_equal(zarr.open("again.zarr")[...], zarr.open("same.zarr")[...])
    assert run("warp", "in.zarr", "part.zarr", *FLAT[:-1], "12.5%")[0] == 0  # of the shortest side
    assert np.array_equal(zarr.open("part.zarr")[...], zarr.open("same.zarr")[...])


def test_a_field_is_saved(run: Run) -> None:
    store("in.zarr", (20, 40, 48))
    line = ("warp", "in.zarr", "out.zarr", *DEEP, "--save-field", "map.zarr", "--json")
    status, out, err = run(*line)
    assert (status, err) == (0, "")
    told = json.loads(out)["field"]
    noted = zarr.open("map.zarr").attrs["supple"]
    assert told["address"] == "map.zarr"
    assert noted["forward"] == {"tolerance": 0.01, "error": told["forward"]}
    assert 0 < told["forward"] <= 0.0104
    assert noted["inverse"] == {"tolerance": 0.01, "error": told["inverse"]} == {"tolerance": 0.01, "error": 0.0}
    assert (told["blocks"], told["stored"], told["done"]) == (2, 2, 0)
    assert run("check", "map.zarr")[0] == 0
    assert "exists" in one_line(run(*line)[2])
    status, out, _ = run(*line[:-3], "--save-field", "map.nii", "--json", "--force")
    assert (status, json.loads(out)["field"]["inverse"]) == (0, None)
    assert Path("map.nii").is_file()


def test_points_are_moved_on_a_store(run: Run) -> None:
    store("in.zarr", (11, 32, 40))
    Path("cells.csv").write_text("i,j,k\n14,12,4\n39,31,10\n")
    assert run("points", "cells.csv", "moved.csv", "--on", "in.zarr", *DEEP)[0] == 0
    made = np.genfromtxt("moved.csv", delimiter=",", skip_header=1)
    assert np.allclose(made[:, :3], [(16, 13, 5), (39, 31, 10)], atol=0.02)


def test_a_plan_reads_no_sample(run: Run) -> None:
    store("in.zarr", (64, 96))
    for chunk in Path("in.zarr/c").rglob("*"):
        if chunk.is_file():
            chunk.write_bytes(b"nothing that is decoded")
    status, out, err = run("plan", "in.zarr", *FLAT)
    assert (status, err) == (0, "")
    for word in ("output", "blocks", "copies", "to read", "memory"):
        assert word in out
    facts = told(run("plan", "in.zarr", *FLAT, "--crop", "0,0,32,32", "--workers", "1", "--json"))
    assert (facts["shape"], facts["size"], facts["dtype"]) == ([32, 32], 2048, "uint16")
    assert run("plan", "in.png", *FLAT)[0] == 0
    assert "nothing to do" in one_line(run("plan", "in.png")[2])
    assert sorted(os.listdir()) == ["in.png", "in.zarr"]


def test_a_store_is_described(run: Run) -> None:
    store("in.zarr", (3, 40, 48), shards=(3, 32, 32))
    out = done(run("info", "in.zarr"))
    for word in ("Zarr array", "3 x 40 x 48", "uint16", "in chunks of 3 x 16 x 16, in shards of 3 x 32 x 32"):
        assert word in out
    facts = told(run("info", "in.zarr", "--json"))
    assert (facts["kind"], facts["shape"], facts["units"]) == ("store", [3, 40, 48], "pixels")
    assert facts["levels"][0]["shards"] == [3, 32, 32]


@pytest.mark.parametrize("workers", [(), ("--workers", "1")], ids=["threads", "processes"])
def test_an_interrupt_is_one_line_and_the_same_command_goes_on(here: Path, workers: tuple[str, ...]) -> None:
    store("in.zarr", (32, 224, 224), 32)
    line = ("warp", "in.zarr", "out.zarr", *DEEP, "--reach", "none", "--threads", "1")
    process = start(*line, *workers, start_new_session=True)
    end = time.monotonic() + 100
    while not any(path.is_file() for path in Path("out.zarr.partial").rglob("c/*/*/*")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, err = process.communicate(timeout=100)
    assert process.returncode == 130
    assert "blocks of out.zarr are written, the same command goes on" in one_line(err)
    assert "interrupted: " in err
    assert sorted(os.listdir()) == ["in.png", "in.zarr", "out.zarr.partial"]
    out, err = start(*line, "--json").communicate(timeout=300)
    assert json.loads(out)["output"] == "out.zarr", err
    assert sorted(os.listdir()) == ["in.png", "in.zarr", "out.zarr"]
