"""What the window writes: files beside a crash, and exports in the background."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import FoldWarning, ToleranceWarning
from supple.files import warp_file
from supple.media.image import write
from supple.strokes import Recipe, Stroke
from supple.viewer.document.background import Task, heard
from supple.viewer.document.editing import Document
from supple.viewer.document.files import Autosave, found, set_aside
from tests.clips import make

ONE = Stroke(at=(20, 20), by=(3, 0.1), radius=9)
TWO = Stroke(at=(30, 20), by=(0, 1 / 3), radius=9, hidden=True)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write(tmp_path / "a.png", np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8))
    return tmp_path / "a.png"


def crash(auto: Autosave) -> None:
    """What the system does when a window dies: its lock is gone, and its file stays."""
    if auto._lock is not None:
        auto._lock.close()


class TestAutosave:
    def test_after_a_crash(self, source: Path, tmp_path: Path) -> None:
        document, clock = Document((40, 60)), Clock()
        auto = Autosave(source, document, tmp_path / "state", clock)
        auto.tick()
        assert not (tmp_path / "state").exists()  # nothing was done
        document.add(ONE)
        document.add(TWO)
        auto.tick()
        assert found(source, tmp_path / "state") is None  # it lives
        crash(auto)
        left = found(source, tmp_path / "state")
        assert left is not None
        assert left.recipe == document.recipe
        assert left.same
        assert abs(left.saved - time.time()) < 60
        assert found(tmp_path / "b.png", tmp_path / "state") is None
        set_aside(left.place, "kept")
        assert found(source, tmp_path / "state") is None
        assert [p.suffix for p in (tmp_path / "state").iterdir()] == [".kept"]

    def test_not_after_a_clean_end(self, source: Path, tmp_path: Path) -> None:
        document = Document((40, 60))
        auto = Autosave(source, document, tmp_path)
        document.add(ONE)
        auto.tick()
        auto.clear()
        assert list(tmp_path.iterdir()) == [source]
        document.undo()
        auto.tick()
        assert found(source, tmp_path) is None

    def test_at_most_every_second(self, source: Path, tmp_path: Path) -> None:
        document, clock = Document((40, 60)), Clock()
        auto = Autosave(source, document, tmp_path, clock)
        document.add(ONE)
        auto.tick()
        first = auto.place.read_bytes()
        document.add(TWO)
        clock.now += 0.5
        auto.tick()
        assert auto.place.read_bytes() == first
        clock.now += 0.6
        document.begin_drag()
        auto.tick()
        assert auto.place.read_bytes() == first
        document.abandon()
        auto.tick()
        assert auto.place.read_bytes() != first
        inode = auto.place.stat().st_mtime_ns
        clock.now += 5
        auto.tick()  # nothing is new
        assert auto.place.stat().st_mtime_ns == inode
        auto.clear()

    def test_what_is_saved_needs_no_keeping(self, source: Path, tmp_path: Path) -> None:
        document, clock = Document((40, 60)), Clock()
        auto = Autosave(source, document, tmp_path, clock)
        document.add(ONE)
        auto.tick()
        document.mark_saved()
        clock.now += 2
        auto.tick()
        crash(auto)
        assert found(source, tmp_path) is None
        assert not auto.place.exists()

    def test_two_windows(self, source: Path, tmp_path: Path) -> None:
        documents = [Document((40, 60)) for _ in range(2)]
        autos = [Autosave(source, document, tmp_path) for document in documents]
        documents[0].add(ONE)
        documents[1].add(TWO)
        for auto in autos:
            auto.tick()
        crash(autos[0])
        link = tmp_path / "link.png"
        link.symlink_to(source)
        left = found(link, tmp_path)
        assert left is not None
        assert left.recipe == documents[0].recipe
        autos[1].clear()
        assert found(source, tmp_path) == left
        set_aside(left.place, "kept")

    def test_the_latest_is_given_back(self, source: Path, tmp_path: Path) -> None:
        for stroke in (ONE, TWO):
            document = Document((40, 60))
            auto = Autosave(source, document, tmp_path)
            document.add(stroke)
            auto.tick()
            crash(auto)
        left = found(source, tmp_path)
        assert left is not None
        assert left.recipe.strokes == (TWO,)
        set_aside(left.place, "kept")
        left = found(source, tmp_path)
        assert left is not None
        assert left.recipe.strokes == (ONE,)

    def test_a_source_that_has_changed(self, source: Path, tmp_path: Path) -> None:
        document = Document((40, 60))
        auto = Autosave(source, document, tmp_path)
        document.add(ONE)
        auto.tick()
        crash(auto)
        os.utime(source, (1, 1))
        left = found(source, tmp_path)
        assert left is not None
        assert not left.same

    @pytest.mark.parametrize("bad", ["", '{"supple_autosave": 1, "rec', "[]", '{"supple_autosave": 1}', "[" * 99999])
    def test_bad_files_are_set_aside(self, bad: str, source: Path, tmp_path: Path) -> None:
        auto = Autosave(source, Document((40, 60)), tmp_path / "state")
        (tmp_path / "state").mkdir()
        auto.place.write_text(bad)
        assert found(source, tmp_path / "state") is None
        (left,) = (tmp_path / "state").glob("*.bad")
        assert left.read_text() == bad
        auto.clear()
        assert left.exists()

    def test_files_of_other_releases_stay(self, source: Path, tmp_path: Path) -> None:
        auto = Autosave(source, Document((40, 60)), tmp_path)
        auto.place.write_text('{"supple_autosave": 2, "new": []}')
        assert found(source, tmp_path) is None
        assert auto.place.exists()

    def test_what_cannot_be_written_is_told_and_tried_again(self, source: Path, tmp_path: Path) -> None:
        (tmp_path / "state").write_text("in the way")
        document, clock = Document((40, 60)), Clock()
        auto = Autosave(source, document, tmp_path / "state", clock)
        document.add(ONE)
        auto.tick()
        assert auto.trouble
        assert "\n" not in auto.trouble
        (tmp_path / "state").unlink()
        clock.now += 2
        auto.tick()
        assert auto.trouble is None
        assert json.loads(auto.place.read_text())["recipe"]["strokes"][0]["at"] == [20, 20]
        auto.clear()

    def test_a_window_that_is_killed(self, source: Path, tmp_path: Path) -> None:
        script = (
            "import os, sys; from supple.viewer.document.files import *; from supple.strokes import Stroke\n"
            "d = Document((40, 60)); a = Autosave(sys.argv[1], d, sys.argv[2])\n"
            "d.add(Stroke(at=(20, 20), by=(3, 0.1), radius=9)); a.tick(); os._exit(9)"
        )
        env = {**os.environ, "PYTHONPATH": str(Path(supple.__file__).parent.parent)}
        done = subprocess.run([sys.executable, "-c", script, source, tmp_path / "state"], env=env, check=False)
        assert done.returncode == 9
        left = found(source, tmp_path / "state")
        assert left is not None
        assert left.recipe.strokes == (ONE,)

    def test_where_it_is_by_default(self, source: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        pytest.importorskip("platformdirs")
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
        place = Autosave(source, Document((40, 60))).place
        assert place.parent.name == "autosave"
        if sys.platform == "linux":
            assert tmp_path in place.parents


class TestHeard:
    def test_each_thread_hears_its_own(self, recwarn: pytest.WarningsRecorder) -> None:
        told: dict[str, list[str]] = {"a": [], "b": []}
        begun, end = threading.Barrier(3), threading.Barrier(3)

        def work(name: str) -> None:
            with heard(lambda text, kind: told[name].append(f"{kind.__name__}: {text}")):
                begun.wait(10)
                for _ in range(2):
                    warnings.warn(f"of {name}", ToleranceWarning, stacklevel=1)
                helper = threading.Thread(target=lambda: warnings.warn("of a helper", UserWarning, stacklevel=1))
                if name == "b":
                    helper.start()
                    helper.join()
                end.wait(10)

        before = warnings.showwarning
        threads = [threading.Thread(target=work, args=(name,)) for name in told]
        for thread in threads:
            thread.start()
        begun.wait(10)
        warnings.warn("of the window", UserWarning, stacklevel=1)
        end.wait(10)
        for thread in threads:
            thread.join(10)
        assert [text for text in told["a"] if "helper" not in text] == ["ToleranceWarning: of a"] * 2
        assert [text for text in told["b"] if "helper" not in text] == ["ToleranceWarning: of b"] * 2
        assert sum("of a helper" in text for texts in told.values() for text in texts) == 1
        assert [str(w.message) for w in recwarn.list] == ["of the window"]
        assert warnings.showwarning is before

    def test_ends_in_any_order(self) -> None:
        before, filters = warnings.showwarning, list(warnings.filters)
        told: list[str] = []
        first, second = (heard(lambda text, kind: told.append(text)) for _ in range(2))
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        warnings.warn("x", UserWarning, stacklevel=1)
        second.__exit__(None, None, None)
        assert told == ["x"]
        assert warnings.showwarning is before
        assert list(warnings.filters) == filters


def begun(source: Path, target: Path, recipe: Recipe, *, warp: Any = warp_file, **options: Any) -> Task:
    return Task(partial(warp, source, target, recipe, **options), target)


def finished(export: Task) -> Task:
    assert export.join(120)
    return export


class TestExport:
    def test_a_picture(self, source: Path, tmp_path: Path) -> None:
        strong = Stroke(at=(30, 20), by=(40, 0), radius=5)
        recipe = Recipe(border=None, on_fold="damp", strokes=(ONE, TWO, strong))
        export = finished(begun(source, tmp_path / "b.png", recipe))
        assert (export.error, export.progress, export.text, export.cancelled) == (None, 1, "done", False)
        first, second = export.warnings
        assert "damped" in first
        assert "carries the point of stroke 1" in second
        with pytest.warns(FoldWarning):
            warp_file(source, tmp_path / "c.png", recipe)
        assert (tmp_path / "b.png").read_bytes() == (tmp_path / "c.png").read_bytes()
        assert export.result.target == tmp_path / "b.png"

    def test_a_clip_tells_how_far_it_is(self, tmp_path: Path) -> None:
        clip = tmp_path / "a.mkv"
        make(clip, count=8)
        seen: list[tuple[float, str]] = []

        def watched(*args: Any, tell: Any, **rest: Any) -> object:
            def told(*step: Any) -> None:
                tell(*step)
                seen.append((export.progress, export.text))

            assert ready.wait(10)
            return warp_file(*args, tell=told, **rest)

        recipe = Recipe(border=None, strokes=(Stroke(at=(20, 20, 3), by=(5, 0, 1), radius=15),))
        ready = threading.Event()
        export = begun(clip, tmp_path / "b.mkv", recipe, warp=watched)
        ready.set()
        finished(export)
        assert export.error is None
        assert [p for p, _ in seen] == sorted(p for p, _ in seen)
        assert seen[0] == (0, "starting")
        assert "warping 4 of 8" in [text for _, text in seen]
        assert len({p for p, _ in seen}) > 8

    @pytest.mark.parametrize("part", ["read", "warp", "write"])
    def test_is_cancelled(self, part: str, source: Path, tmp_path: Path) -> None:
        def stopped(*args: Any, tell: Any, **rest: Any) -> object:
            def told(step: str, done: int, total: int) -> None:
                if step == part:
                    export.cancel()
                tell(step, done, total)

            ready.wait(10)
            return warp_file(*args, tell=told, **rest)

        ready = threading.Event()
        export = begun(source, tmp_path / "b.png", Recipe(border=None, strokes=(ONE,)), warp=stopped)
        ready.set()
        finished(export)
        assert (export.cancelled, export.error, export.text, export.result) == (True, None, "cancelled", None)
        assert sorted(tmp_path.iterdir()) == [source]

    def test_fails_in_a_line(self, source: Path, tmp_path: Path) -> None:
        before = source.read_bytes()
        export = finished(begun(source, source, Recipe(strokes=(ONE,))))
        assert export.error is not None
        assert "is the picture itself" in export.error
        assert source.read_bytes() == before

        def broken(*args: Any, **rest: Any) -> None:
            raise RuntimeError("two\n lines")

        export = finished(begun(source, tmp_path / "b.png", Recipe(), warp=broken))
        assert (export.error, export.text, export.done) == ("RuntimeError: two lines",) * 2 + (True,)

    def test_never_goes_back(self, source: Path, tmp_path: Path) -> None:
        seen: list[float] = []

        def muddled(*args: Any, tell: Any, **rest: Any) -> None:
            ready.wait(10)
            for step in [("read", 0, 1), ("warp", 9, 10), ("plan", 1, 10), ("warp", 10, 10), ("write", 0, 1)]:
                tell(*step)
                seen.append(export.progress)

        ready = threading.Event()
        export = begun(source, tmp_path / "b.png", Recipe(), warp=muddled)
        ready.set()
        finished(export)
        assert seen == sorted(seen)
        assert 0.5 < seen[1] < seen[-1] < 1
