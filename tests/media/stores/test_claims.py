"""The place of an output: taken, kept from others, given back to the same job, and left whole."""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import zarr

from supple import SuppleError
from supple.media.stores.image import open_image
from supple.media.stores.places import Place, overlap
from supple.media.stores.target import create
from tests.media.stores.images import RNG, boxes, child, files, fill, image, part, small, whole
from tests.refusals import refused


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
    with pytest.raises(
        SuppleError, match=r"is the unfinished output of another job: choose .*force=True, which starts anew"
    ):
        create(out, like, job="two")
    assert create(out, like, job="one", force=True).is_done(0, box)
    refused(create, out, like, shape=(4, 5, 5), job="one", match="of another job")
    anew = create(out, like, job="two", force=True)
    assert not anew.is_done(0, box)
    fill(anew, values)
    anew.finish()
    refused(create, out, like, job="two", match=r"exists already: choose another name, or force=True")
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
        refused(create, address, like, job="a", force=force, match=expected)
    assert (tmp_path / "photos" / "one.png").read_text() == "one"
    assert (tmp_path / "a.zarr.partial" / "one.png").read_text() == "one"
    assert fsspec.filesystem("memory").cat(f"{memory}/photos/one.png") == b"one"
    refused(create, tmp_path / "no" / "out.zarr", like, job="a", force=force, match="there is no folder")


def test_spellings_of_a_place(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "real")
    same = (
        ("memory://a/b", "memory:///a/b/"),
        ("s3://a/b", "s3a://a/b"),
        (str(tmp_path / "link"), (tmp_path / "real").as_uri()),
        ("zip://a::s3://b", "zip://a::s3a://b/"),
    )
    for one, other in same:
        assert Place(one).parts == Place(other).parts
        assert overlap(one, other) == "same"
    apart = (
        ("memory://a/b", "s3://a/b"),
        ("memory://a/b", "memory://a/bc"),
        ("memory://a/b", "/a/b"),
        ("sftp://one/a", "sftp://two/a"),
        ("nothing://a/b", "nothing://a/c"),
    )
    for one, other in apart:
        assert Place(one).parts != Place(other).parts
        assert not overlap(one, other)
    assert overlap("nothing://a/b", "nothing://a") == "inside"
    assert overlap(tmp_path / "link", tmp_path) == ""  # which is no store
    assert overlap(tmp_path, tmp_path / "link" / "in.zarr") == "around"


def test_an_input_is_not_overwritten_in_place(memory: str) -> None:
    _, like = small(f"{memory}/in.zarr")
    with pytest.raises(SuppleError, match=r"it is the input too: choose another place$"):
        create(f"simplecache::{memory}/in.zarr/", like, job="a", force=True)


def test_an_output_in_a_folder_does_not_reach_into_its_input(tmp_path: Path) -> None:
    group = zarr.create_group(str(tmp_path / "data.zarr"))
    group.create_array("other", data=np.ones(3))
    values, like = small(tmp_path / "data.zarr" / "in.zarr")
    (tmp_path / "link").symlink_to(tmp_path / "data.zarr")
    before = files(tmp_path)
    inside = tmp_path / "link" / "in.zarr"
    for address, told in (
        (tmp_path / "data.zarr", "the input lies in it"),
        (tmp_path / "link", "the input lies in it"),
        ((tmp_path / "link").as_uri(), "the input lies in it"),
        (inside / "0", "it lies in the input"),
        (inside / "new.zarr", "it lies in the input"),
    ):
        with pytest.raises(
            SuppleError, match=f"^cannot write {re.escape(str(address))}: {told}: choose another place$"
        ):
            create(address, like, job="a", force=True)
    assert files(tmp_path) == before
    fill(create(inside.with_name("beside.zarr"), like, job="a"), values)


def test_an_output_may_lie_beside_the_slices_it_is_made_of(tmp_path: Path) -> None:
    """A folder of slices is no store."""
    _, like = small(tmp_path / "in.zarr")
    (tmp_path / "slices").mkdir()
    create(tmp_path / "slices" / "out.zarr", dataclasses.replace(like, address=str(tmp_path / "slices")), job="a")


@pytest.mark.parametrize("name", ["in.zarr", "link.zarr"])
def test_an_input_that_is_a_folder_is_replaced_at_the_end(name: str, tmp_path: Path) -> None:
    values, like = small(tmp_path / "in.zarr")
    (tmp_path / "link.zarr").symlink_to("in.zarr")
    target = create(tmp_path / name, like, job="a", force=True)
    for box in boxes(target, 0):
        target.write(0, box, part(like.levels[0].array, box) // 2)
    target.finish()
    np.testing.assert_array_equal(open_image(tmp_path / "in.zarr").levels[0].array[...], values // 2)
    assert sorted(os.listdir(tmp_path)) == ["in.zarr", "link.zarr"]
    assert (tmp_path / "link.zarr").is_symlink()


WRITER = """
    import sys
    import numpy as np
    from supple.media.stores.image import open_image
    from supple.media.stores.target import create
    target = create(sys.argv[2], open_image(sys.argv[1]), job="a")
    rng = np.random.default_rng(1)
    n = target.blocks[0][1]
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
    for wait in (0.0, 0.05, 0.11, 0.5, 2.0, 8.0):  # slow machines need longer for a shard
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
            assert part(target.arrays[0], box).shape == (16, *target.blocks[0][1:])
        if seen and wait > 0.1:
            break
    assert seen
    # what a killed writer leaves is no part of the output
    spare = next(path for path in (tmp_path / "out.zarr.partial" / "0").rglob("*") if path.is_file())
    spare.with_name(f"3.{'0' * 32}.partial").write_bytes(b"half")
    values = RNG.integers(0, 60000, (16, 256, 256)).astype(np.uint16)
    fill(target, values)
    target.finish()
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values)
    assert sorted(files(out)) == sorted(files(tmp_path / "in.zarr"))


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


class Stopped(Exception):  # noqa: N818
    """An interrupt. Python's own would end the thread in which zarr waits for stores."""


@pytest.mark.parametrize("remote", [False, True])
def test_a_clearing_that_was_interrupted_begins_again(
    remote: bool, tmp_path: Path, memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from supple.media.stores import target

    root = memory if remote else str(tmp_path)
    values, like = small(f"{root}/in.zarr")
    out = f"{root}/out.zarr"
    fill(create(out, like, job="one"), values)

    def stopped(*_: object) -> None:
        raise Stopped

    with monkeypatch.context() as patched:
        patched.setattr(target, "_clear", stopped)
        with pytest.raises(Stopped):
            create(out, like, job="two", force=True)
    for job in ("one", "two"):
        refused(create, out, like, job=job, match="unfinished output of another job")
    second = create(out, like, job="two", force=True)
    assert not second.begun
    assert not any(second.is_done(0, box) for box in boxes(second, 0))
    fill(second, values + 1)
    second.finish()
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values + 1)


def test_where_objects_may_be_incomplete_nothing_is_continued(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from supple.media.stores import places

    values, like = small(f"{memory}/in.zarr")
    create(f"{memory}/out.zarr", like, job="a").write(0, [(0, 4), (0, 9), (0, 9)], values)
    monkeypatch.setattr(places, "_ATOMIC", set())
    anew = create(f"{memory}/out.zarr", like, job="a")
    assert not any(anew.is_done(0, box) for box in boxes(anew, 0))
