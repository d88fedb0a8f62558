"""Outputs that are finished: held until then, never by two, and never without the old one or the new."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from supple import SuppleError
from supple.media.files import is_store
from supple.media.stores import Target, check_free, create, create_arrays, holding, open_image
from tests.media.stores.images import Array, child, files, fill, small, whole

HOLDER = """
    import sys
    from supple.media.stores import create, holding, open_image
    with holding():
        create(sys.argv[2], open_image(sys.argv[1]), job="a")
        print("held", flush=True)
        sys.stdin.read()
"""
GONE = "what was written is there no more, since another process has finished or replaced it"


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="nothing is held on Windows")
@pytest.mark.parametrize("ends", ["killed", "ended"])
def test_a_folder_is_held_until_its_process_ends(ends: str, tmp_path: Path) -> None:
    _, like = small(tmp_path / "in.zarr")
    out = tmp_path / "out.zarr"
    with child(HOLDER, tmp_path / "in.zarr", out) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        before = files(tmp_path)
        for job, force in (("a", False), ("a", True), ("b", True)):
            with (
                holding(),
                pytest.raises(SuppleError, match=r"^cannot write \S+: it is being written by another process: wait"),
            ):
                create(out, like, job=job, force=force)
        assert files(tmp_path) == before
        if ends == "killed":
            process.kill()
        else:
            process.communicate("")
    with holding():
        assert create(out, like, job="a").begun
    with holding():
        assert create(out, like, job="a").begun


def test_it_is_held_for_other_jobs_of_one_process_as_well(tmp_path: Path) -> None:
    """A job that failed lets go, though its error may be kept."""
    values, like = small(tmp_path / "in.zarr")

    @holding()
    def failing() -> None:
        create(tmp_path / "out.zarr", like, job="a")
        raise KeyError

    with pytest.raises(KeyError) as kept:
        failing()
    assert kept.tb is not None
    with holding():
        again = create(tmp_path / "out.zarr", like, job="a")
        fill(again, values)
        again.finish()
        # what is finished has its name; another may begin, which makes its own
        create(tmp_path / "out.zarr", like, job="b", force=True)
    assert sorted(files(tmp_path / "in.zarr")) == sorted(files(tmp_path / "out.zarr"))


@pytest.mark.parametrize("gone", ["all", "marker", "metadata", "level", "job"])
@pytest.mark.parametrize("keep", [False, True])
def test_what_is_there_no_more_is_not_published(gone: str, keep: bool, tmp_path: Path) -> None:
    """Two processes that wrote the same: the other one has finished, and the last blocks of this one came later."""
    values, like = small(tmp_path / "in.zarr")
    partial = tmp_path / "out.zarr.partial"
    small(tmp_path / "out.zarr")
    target = create(tmp_path / "out.zarr", like, job="a", force=True)
    fill(target, values)
    if gone == "all":
        shutil.rmtree(partial)
    elif gone == "job":
        (partial / "supple.json").write_text('{"program": "supple", "state": "unfinished", "job": "b"}')
    else:
        (partial / {"marker": "supple.json", "metadata": "zarr.json", "level": "0/zarr.json"}[gone]).unlink()
    before = files(tmp_path)
    with pytest.raises(SuppleError, match=f"^cannot write {tmp_path / 'out.zarr'}: {GONE}: look"):
        target.finish(keep=keep)
    assert files(tmp_path) == before
    assert (gone == "all") != partial.exists()


def test_an_output_that_another_job_has_taken_at_an_address_stays_unfinished(memory: str) -> None:
    values, like = small(f"{memory}/in.zarr")
    first = create(f"{memory}/out.zarr", like, job="one")
    fill(first, values)
    create(f"{memory}/out.zarr", like, job="two", force=True)
    with pytest.raises(SuppleError, match=GONE):
        first.finish()
    with pytest.raises(SuppleError, match="unfinished"):
        open_image(f"{memory}/out.zarr")


def test_an_output_that_appears_while_its_folder_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process has finished it between the first look and the lock: nothing is left beside it."""
    from supple.media.stores import claims

    values, like = small(tmp_path / "in.zarr")
    hold = claims._hold

    def late(place: Any, folder: Path) -> None:
        shutil.copytree(tmp_path / "in.zarr", tmp_path / "out.zarr")
        hold(place, folder)

    monkeypatch.setattr(claims, "_hold", late)
    with holding(), pytest.raises(SuppleError, match="exists already"):
        create(tmp_path / "out.zarr", like, job="a")
    assert sorted(os.listdir(tmp_path)) == ["in.zarr", "out.zarr"]
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], values)


def test_another_job_that_begins_while_its_folder_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And is killed, with a block written: that is its own, and stays."""
    from supple.media.stores import claims

    values, like = small(tmp_path / "in.zarr")
    hold, calls = claims._hold, []

    def late(place: Any, folder: Path) -> None:
        calls.append(folder)
        if len(calls) == 1:
            with holding():
                other = create(tmp_path / "out.zarr", like, job="b")
                other.write(0, whole(other), values)
        hold(place, folder)

    monkeypatch.setattr(claims, "_hold", late)
    with holding(), pytest.raises(SuppleError, match="is the unfinished output of another job"):
        create(tmp_path / "out.zarr", like, job="a")
    other = create(tmp_path / "out.zarr", like, job="b")
    assert other.is_done(0, whole(other))
    other.finish()
    assert sorted(files(tmp_path / "in.zarr")) == sorted(files(tmp_path / "out.zarr"))


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="nothing is held on Windows")
def test_a_folder_that_gets_its_name_while_it_is_locked_is_not_the_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process has finished it in that moment: what is locked is in an output now."""
    from supple.media.stores import claims

    values, like = small(tmp_path / "in.zarr")
    small(tmp_path / "out.zarr")
    lock, calls = claims.locked, []

    def late(path: Path) -> Any:
        calls.append(path)
        file = lock(path)
        if len(calls) == 1:
            path.parent.rename(tmp_path / "moved")
        return file

    monkeypatch.setattr(claims, "locked", late)
    with holding():
        target = create(tmp_path / "out.zarr", like, job="a", force=True)
        fill(target, values + 1)
        assert lock(tmp_path / "out.zarr.partial" / "supple.lock") is None
        target.finish()
    assert len(calls) == 2
    assert os.listdir(tmp_path / "moved") == ["supple.lock"]
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], values + 1)


def killed_at(number: int, name: str, act: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> None:
    """Do something, in which one call of the system's is where the process ends."""
    real, calls = getattr(os, name), []

    def counted(*arguments: Any, **more: Any) -> None:
        if name == "rename" and not str(arguments[1]).endswith((".zarr", ".supple", "image")):
            return real(*arguments, **more)
        calls.append(arguments)
        if len(calls) == number:
            raise KeyboardInterrupt
        return real(*arguments, **more)

    with monkeypatch.context() as patched:
        patched.setattr(os, name, counted)
        with pytest.raises(KeyboardInterrupt):
            act()


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("name", ["out.zarr", "link.zarr", "image"])
@pytest.mark.parametrize("step", ["old", "new", "marker"])
def test_a_process_that_is_killed_while_it_finishes_loses_nothing(
    step: str, name: str, own: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupt comes instead of one of the renames, or of the last removal."""
    out = tmp_path / name
    real = tmp_path / "out.zarr" if name == "link.zarr" else out
    if name == "link.zarr":
        out.symlink_to(real)
    old, _ = small(real)
    values, like = (old, open_image(out)) if own else small(tmp_path / "in.zarr")
    target = create(out, like, job="a", force=True)
    fill(target, values + 1)
    if step == "marker":
        killed_at(1, "unlink", target.finish, monkeypatch)
    else:
        killed_at({"old": 1, "new": 2}[step], "rename", target.finish, monkeypatch)
        assert real.exists() == (step == "old")
        before = files(tmp_path)
        assert is_store(out)
        with pytest.raises(SuppleError, match="exists already"):
            create(out, like, job="a")
        np.testing.assert_array_equal(open_image(out).levels[0].array[...], old)
        if step == "new":
            again = {key.replace(f".{real.name}.supple", real.name): data for key, data in before.items()}
            assert files(tmp_path) == again
        with holding():
            second = create(out, open_image(out if own else tmp_path / "in.zarr"), job="a", force=True)
            assert second.is_done(0, whole(second))
            second.finish()
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values + 1)
    if step != "marker":
        assert {one.name for one in tmp_path.iterdir()} <= {"in.zarr", name, real.name}


def test_opening_alone_gives_an_output_its_name_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, like = small(tmp_path / "out.zarr")
    target = create(tmp_path / "out.zarr", like, job="a", force=True)
    fill(target, old + 1)
    killed_at(2, "rename", target.finish, monkeypatch)
    assert sorted(os.listdir(tmp_path)) == [".out.zarr.supple", "out.zarr.partial"]
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], old)
    assert sorted(os.listdir(tmp_path)) == ["out.zarr", "out.zarr.partial"]
    with pytest.raises(SuppleError, match="no such folder"):
        open_image(tmp_path / "other.zarr")


def test_what_was_replaced_is_not_put_back_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A removal that was interrupted leaves a part of a store: its name says nothing to anybody."""
    values, like = small(tmp_path / "in.zarr")
    small(tmp_path / "out.zarr")
    target = create(tmp_path / "out.zarr", like, job="a", force=True)
    fill(target, values)
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", lambda *rest, **more: None)
        target.finish()
    shutil.rmtree(tmp_path / "out.zarr")
    assert not is_store(tmp_path / "out")
    with pytest.raises(SuppleError, match="no such folder"):
        open_image(tmp_path / "out.zarr")


def test_a_rename_that_is_refused_puts_the_old_one_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values, like = small(tmp_path / "in.zarr")
    old, _ = small(tmp_path / "out.zarr")
    target = create(tmp_path / "out.zarr", like, job="a", force=True)
    fill(target, values + 1)
    rename = os.rename

    def refused(before: Any, after: Any) -> None:
        if str(before).endswith("out.zarr.partial"):
            raise PermissionError(13, "Permission denied")
        rename(before, after)

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", refused)
        with pytest.raises(SuppleError, match="Permission denied: choose a place"):
            target.finish()
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], old)
    target.finish()
    np.testing.assert_array_equal(open_image(tmp_path / "out.zarr").levels[0].array[...], values + 1)
    assert sorted(os.listdir(tmp_path)) == ["in.zarr", "out.zarr"]


def prepared(address: str | Path, values: Array, job: str, *, force: bool = False) -> Target:
    """Return an output of prepared metadata: those of an array in a group, as fields are."""
    group = b'{"zarr_format": 3, "node_type": "group", "attributes": {}}'
    memory: dict[str, Any] = {}
    zarr.create_array(memory, name="f", data=values[None], chunks=(1, 2, 4, 4))
    told = {"zarr.json": group, "f/zarr.json": bytes(memory["f/zarr.json"].to_bytes())}
    return create_arrays(address, told, ["f"], force=force, job=job)


@pytest.mark.parametrize("remote", [False, True])
def test_prepared_outputs_are_held_and_asked_for_at_once(remote: bool, tmp_path: Path, memory: str) -> None:
    values, _ = small(tmp_path / "in.zarr")
    out = f"{memory}/field.zarr" if remote else tmp_path / "field.zarr"
    check_free(out, "a", False)
    with holding():
        target = prepared(out, values, "a")
        assert not target.begun
        target.write(0, whole(target), values[None])
    check_free(out, "a", False)
    check_free(out, "b", True)
    before = files(tmp_path)
    with pytest.raises(SuppleError, match="is the unfinished output of another job: choose another name, or --force"):
        check_free(out, "b", False)
    assert files(tmp_path) == before
    with holding():
        again = prepared(out, values, "a")
        assert again.begun
        assert again.is_done(0, whole(again))
        again.finish(keep=True)
    check_free(out, "a", False)
    assert prepared(out, values, "a").complete
    again.forget()
    with pytest.raises(SuppleError, match="exists already"):
        check_free(out, "a", False)
    if not remote:
        assert sorted(os.listdir(tmp_path / "field.zarr")) == ["f", "zarr.json"]
