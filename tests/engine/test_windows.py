"""The window of frames that a stream holds: in memory or in a file, and what is left when it ends early."""

from __future__ import annotations

import errno
import gc
import math
import os
import tempfile
import tracemalloc
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple import Deformation, SuppleError
from supple.engine import memory as buffering
from supple.engine.sampling import Sampling
from supple.engine.stream import make_plan, stream
from supple.engine.work import Group, Layout, Work
from tests.engine.streams import COUNT, LAYOUTS, Array, Clip, Frame, bent, layout_of, noise, streamed
from tests.refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


def kept(monkeypatch: pytest.MonkeyPatch, folder: Path) -> list[Any]:
    """The temporary files that are made, in a folder of the test's own."""
    made: list[Any] = []
    create = tempfile.TemporaryFile

    def spy(*args: Any, **options: Any) -> Any:
        made.append(create(*args, **options))
        return made[-1]

    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(tempfile, "TemporaryFile", spy)
    return made


WORK = Work(bent().space, LAYOUTS["4:2:0"], Sampling())


def running(frames: Any, memory: float = 0) -> Any:
    """Return what streams a bent clip, and holds its window in a file where there is no memory."""
    return stream(WORK, make_plan(WORK, range(COUNT)), frames, memory=memory)


def test_what_does_not_fit_in_memory_is_in_a_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = kept(monkeypatch, tmp_path)
    d = bent()
    for kind, layout in LAYOUTS.items():
        arrays = noise(layout)
        for name in ("linear", "auto"):
            expected, plan, _ = streamed(d.space, layout, arrays, Sampling(name))
            size = plan.capacity * sum(math.prod((*g.shape, g.channels)) for g in layout.groups)
            size *= layout.dtype.itemsize
            assert not made, kind
            streamed(d.space, layout, arrays, Sampling(name), memory=size)
            assert not made
            for memory in (0, size - 1):
                found, _, _ = streamed(d.space, layout, arrays, Sampling(name), memory=memory)
                for part, other in zip(found, expected, strict=True):
                    np.testing.assert_array_equal(part, other)
                (file,) = made
                assert file.closed
                made.clear()
                assert not list(tmp_path.iterdir())


def test_the_motion_between_frames_counts_as_they_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    made, sizes = kept(monkeypatch, tmp_path), []
    shape, count = (90, 110), 8
    y, x = np.mgrid[: shape[0], : shape[1]]
    frames = np.stack([128 + 90 * np.sin((x - 2 * k) / 6) * np.sin(y / 7) for k in range(count)]).astype(np.uint8)
    layout, sampling = Layout((Group(shape, 1),), np.dtype("u1"), 255), Sampling(between="flow")
    d = Deformation((count, *shape), border=None, time=True).grab((55, 45, 4), by=(0, 0, 1.5), radius=20)
    expected, plan, _ = streamed(d.space, layout, [frames[..., None]], sampling)
    assert not made
    window = plan.capacity * math.prod(shape)
    fields = plan.capacity * math.prod(-(-n // 4) for n in shape) * 16
    reserve = buffering.reserve
    monkeypatch.setattr(buffering, "reserve", lambda file, size: (sizes.append(size), reserve(file, size)))
    for most, wanted in (
        (window + fields, []),
        (window + fields - 1, [fields]),
        (window, [fields]),
        (0, [window, fields]),
    ):
        found, _, _ = streamed(d.space, layout, [frames[..., None]], sampling, memory=most)
        np.testing.assert_array_equal(found[0], expected[0])
        assert sizes == wanted
        sizes.clear()
    plain, _, _ = streamed(d.space, layout, [frames[..., None]], Sampling(between="linear"))
    assert (plain[0] != expected[0]).any()


@pytest.mark.parametrize("allocates", [True, False])
def test_the_file_has_its_size_before_it_is_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, allocates: bool
) -> None:
    if not allocates:
        monkeypatch.delattr(os, "posix_fallocate", raising=False)
    made = kept(monkeypatch, tmp_path)
    given = running(Clip(noise(WORK.layout)))
    next(given)
    found = os.fstat(made[0].fileno())
    assert found.st_size == make_plan(WORK, range(COUNT)).capacity * (41 * 67 + 21 * 34 * 2)
    assert found.st_blocks * 512 >= found.st_size
    given.close()
    assert made[0].closed
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["allocate", "write", "create"])
def test_a_full_disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kind: str) -> None:
    made = kept(monkeypatch, tmp_path)

    def full(*args: Any, **options: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if kind == "allocate":
        monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    elif kind == "create":
        monkeypatch.setattr(tempfile, "TemporaryFile", full)
    else:
        monkeypatch.delattr(os, "posix_fallocate", raising=False)
        create = tempfile.TemporaryFile

        class Full:
            def __init__(self, file: Any) -> None:
                self.file = file

            def __enter__(self) -> Full:
                return self

            def __exit__(self, *args: object) -> None:
                self.file.close()

            def __getattr__(self, name: str) -> Any:
                return full if name in ("write", "flush") else getattr(self.file, name)

        monkeypatch.setattr(tempfile, "TemporaryFile", lambda **options: Full(create(**options)))
    clip = Clip(noise(WORK.layout))
    assert "TMPDIR" in refused(list, running(clip), match="No space left on device")
    assert all(file.closed for file in made)
    assert not list(tmp_path.iterdir())
    assert clip.given == 0


def test_no_folder_for_the_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    refused(list, running(Clip(noise(WORK.layout))), match="TMPDIR")


@pytest.mark.parametrize("memory", [math.inf, 0])
def test_a_stream_that_is_left_early_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, memory: float
) -> None:
    made = kept(monkeypatch, tmp_path)
    clip = Clip(noise(WORK.layout))
    given = running(clip, memory)
    assert not made
    assert clip.given == 0  # nothing happens before it is asked for
    z, parts, _ = next(given)
    assert z == 0
    watched = [weakref.ref(part) for part in parts]
    assert len(made) == (memory == 0)
    given.close()
    del parts
    gc.collect()
    assert all(file.closed for file in made)
    assert not list(tmp_path.iterdir())
    assert all(ref() is None for ref in watched)
    assert clip.given < COUNT
    with pytest.raises(StopIteration):
        next(given)


@pytest.mark.parametrize("memory", [math.inf, 0])
@pytest.mark.parametrize("have", [0, 1, 5, COUNT - 1])
def test_a_clip_that_ends_early(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, have: int, memory: float) -> None:
    made = kept(monkeypatch, tmp_path)
    arrays = noise(WORK.layout)
    whole, plan, _ = streamed(WORK.space, WORK.layout, arrays)
    seen = []

    def follow() -> None:
        for z, parts, _ in running(Clip(arrays, have), memory):
            np.testing.assert_array_equal(parts[0], whole[0][z])
            seen.append(z)

    with pytest.raises(SuppleError, match=f"after {have} frames, where {COUNT} were expected"):
        follow()
    assert seen == [z for z in range(COUNT) if plan.read[z] < have]
    assert all(file.closed for file in made)
    assert not list(tmp_path.iterdir())


def test_a_reader_that_fails() -> None:
    """Its error comes through as it is."""

    def frames() -> Iterator[Frame]:
        yield from list(Clip(noise(WORK.layout)))[:0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(running(frames(), math.inf))


class Endless:
    """Frames that are made when they are asked for."""

    def __init__(self, count: int, layout: Layout) -> None:
        self.count, self.layout = count, layout

    def __iter__(self) -> Iterator[Made]:
        return (Made(k) for k in range(self.count))


class Made:
    def __init__(self, index: int) -> None:
        self.index = index

    def copy_to(self, arrays: Sequence[Array]) -> None:
        for array in arrays:
            array[...] = 20 + self.index % 200


def peak(count: int) -> tuple[int, int]:
    """The most memory that is taken while a clip streams, and the frames of its window."""
    shape = (64, 96)
    layout = layout_of(shape=shape)
    d = Deformation((count, *shape), border=None, on_fold="damp").grab(
        (40, 30, 50), by=(5, 4, 20), radius=25, reach=None
    )
    gc.collect()
    tracemalloc.start()
    try:
        plan = make_plan(Work(d.space, layout, Sampling("linear")), range(count))
        for z, parts, _ in stream(Work(d.space, layout, Sampling("linear")), plan, Endless(count, layout)):
            assert parts[0].dtype == np.uint8, z
        return tracemalloc.get_traced_memory()[1], plan.capacity
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("supple.engine.stream._KEPT", 0)  # lattices are bounded by themselves
    peak(100)  # whatever is made once
    (short, window), (long, same_window) = peak(100), peak(500)
    frame = 64 * 96 * 3 // 2
    assert same_window == window < 40
    assert window * frame < short
    assert long - short < 400 * 600  # a plan's own numbers: not a tenth of the frames


def test_the_window_is_as_long_as_the_strokes_reach() -> None:
    for by in (2, 8, 20):
        sizes = []
        for count in (100, 400):
            d = Deformation((count, 40, 60), border=None, on_fold="damp").grab(
                (30, 20, 50), by=(0, 0, by), radius=40, reach=None
            )
            plan = make_plan(Work(d.space, layout_of(shape=(40, 60)), Sampling("linear")), range(count))
            sizes.append(plan.capacity)
        assert sizes[0] == sizes[1]
        assert by <= sizes[0] <= by + 4
