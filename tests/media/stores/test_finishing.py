"""Outputs that are finished: held until then, never by two, and never without the old one or the new."""

from __future__ import annotations

import functools
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple import SuppleError
from supple.media.stores.image import open_image
from supple.media.stores.target import create, holding
from tests.effort import pairs
from tests.media.stores.images import child, files, fill, small, whole

HOLDER = """
    import sys
    from supple.media.stores.image import open_image
    from supple.media.stores.target import create, holding
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


@pytest.mark.parametrize("gone", ["all", "marker", "job"])
def test_what_is_there_no_more_is_not_published(gone: str, tmp_path: Path) -> None:
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
        (partial / "supple.json").unlink()
    before = files(tmp_path)
    with pytest.raises(SuppleError, match=f"^cannot write {tmp_path / 'out.zarr'}: {GONE}: look"):
        target.finish()
    assert files(tmp_path) == before
    assert (gone == "all") != partial.exists()


@pytest.mark.parametrize(
    ("step", "name", "own"), pairs(["old", "new", "marker"], ["out.zarr", "link.zarr", "image"], [False, True])
)
def test_an_interrupt_of_finishing_loses_nothing(
    step: str, name: str, own: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes instead of one of the renames, or of the last removal."""
    out = tmp_path / name
    real = tmp_path / "out.zarr" if name == "link.zarr" else out
    if name == "link.zarr":
        out.symlink_to(real)
    old, _ = small(real)
    values, like = (old, open_image(out)) if own else small(tmp_path / "in.zarr")
    target = create(out, like, job="a", force=True)
    fill(target, values + 1)
    call = {"old": real, "new": tmp_path / f"{real.name}.partial", "marker": real / "supple.lock"}[step]
    rename, unlink = os.rename, os.unlink

    def interrupted(act: Callable[..., None], path: Any, *rest: Any, **more: Any) -> None:
        if Path(path) == call:
            raise KeyboardInterrupt
        act(path, *rest, **more)

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", functools.partial(interrupted, rename))
        patched.setattr(os, "unlink", functools.partial(interrupted, unlink))
        with pytest.raises(KeyboardInterrupt):
            target.finish()
    if step != "marker":
        with pytest.raises(SuppleError, match="exists already"):
            create(out, like, job="a")
        np.testing.assert_array_equal(open_image(out).levels[0].array[...], old)
        with holding():
            second = create(out, open_image(out if own else tmp_path / "in.zarr"), job="a", force=True)
            assert second.is_done(0, whole(second))
            second.finish()
        assert {one.name for one in tmp_path.iterdir()} <= {"in.zarr", name, real.name}
    np.testing.assert_array_equal(open_image(out).levels[0].array[...], values + 1)


def test_outputs_appear_together_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rename that is refused puts the old ones back."""
    values, like = small(tmp_path / "in.zarr")
    old, _ = small(tmp_path / "two.zarr")
    targets = [create(tmp_path / name, like, job="a", force=True) for name in ("one.zarr", "two.zarr")]
    for target in targets:
        fill(target, values + 1)
    rename = os.rename

    def refused(before: Any, after: Any) -> None:
        if str(before).endswith("two.zarr.partial"):
            raise PermissionError(13, "Permission denied")
        rename(before, after)

    with monkeypatch.context() as patched:
        patched.setattr(os, "rename", refused)
        with pytest.raises(SuppleError, match="Permission denied: choose a place"):
            targets[0].finish(targets[1])
    np.testing.assert_array_equal(open_image(tmp_path / "two.zarr").levels[0].array[...], old)
    assert not (tmp_path / "one.zarr").exists()
    targets[0].finish(targets[1])
    np.testing.assert_array_equal(open_image(tmp_path / "two.zarr").levels[0].array[...], values + 1)
    assert sorted(os.listdir(tmp_path)) == ["in.zarr", "one.zarr", "two.zarr"]
