"""Zarr stores warped block by block: equal to the whole, copied where nothing moves, and continued."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

zarr = pytest.importorskip("zarr")
pytest.importorskip("dask")

from supple import Affine, Recipe, Stroke, SuppleError  # noqa: E402
from supple.errors import VolumeWarning  # noqa: E402
from supple.fields import Placed  # noqa: E402
from supple.files import Warped, stores, tasks, warp_file  # noqa: E402
from supple.files.jobs import Job  # noqa: E402
from supple.files.options import GridOptions, Running, VolumeOptions  # noqa: E402
from supple.files.stores import plan_file  # noqa: E402
from supple.files.tasks import runner_of  # noqa: E402
from supple.media.stores.image import open_image  # noqa: E402
from supple.media.stores.levels import reduced  # noqa: E402
from supple.media.stores.target import Target  # noqa: E402
from tests.children import ROOT, SOURCE  # noqa: E402
from tests.media.stores.images import image  # noqa: E402

Array = npt.NDArray[Any]

RNG = np.random.default_rng(5)
FLAT = Recipe(strokes=[Stroke.grab((14, 12), to=(17, 14), radius=3)])
DEEP = Recipe(strokes=[Stroke.grab((14, 12, 4), to=(16, 13, 5), radius=2)])


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Tasks of a few chunks, in an empty folder."""
    monkeypatch.setattr(stores, "TASK", 1 << 12)
    monkeypatch.chdir(tmp_path)


def plain(name: str, values: Array, chunks: tuple[int, ...], **more: Any) -> Array:
    made = zarr.create_array(name, shape=values.shape, dtype=values.dtype, chunks=chunks, **more)
    made[...] = values
    return values


def ome(name: str, version: str, axes: str, shape: tuple[int, ...], chunks: tuple[int, ...], **more: Any) -> Array:
    """Write an image whose levels are half as large in the plane; return the finest."""
    options = {"count": 2, "scale": 1.0, "unit": "millimeter"} | more
    form = 2 if version == "0.4" else 3
    return image(name, form, version, names=axes, shape=shape, chunks=chunks, **options)[0]


def whole(made: Warped, values: Array, **options: Any) -> Array:
    """Return what `Deformation.warp` makes of each picture or volume in memory."""
    deformation, n = made.deformation, made.deformation.ndim
    sampling = {"between": "cubic", "time_filter": True} if n == 3 else {}
    items = values.reshape(-1, *values.shape[-n:])
    out = [deformation.warp(one, grid=made.grid, **{**sampling, **options}) for one in items]
    return np.array(out).reshape(*values.shape[:-n], *out[0].shape)


def arrays(name: str) -> list[Array]:
    return [np.asarray(level.array[...]) for level in open_image(name).levels]


CASES = {
    "flat": ("yx", (40, 46), (16, 16), None),
    "flat-carried": ("tcyx", (2, 3, 30, 41), (1, 2, 16, 16), None),
    "flat-sharded": ("cyx", (2, 34, 40), (1, 8, 8), (2, 16, 24)),
    "deep": ("zyx", (9, 28, 30), (4, 16, 16), None),
    "deep-carried": ("tczyx", (2, 2, 8, 28, 30), (1, 1, 4, 16, 16), None),
    "deep-sharded": ("zyx", (8, 28, 36), (4, 8, 16), (4, 16, 32)),
}


@pytest.mark.parametrize("version", ["", "0.4", "0.5"])
@pytest.mark.parametrize("case", CASES)
def test_stores_are_warped_as_arrays_are(version: str, case: str) -> None:
    axes, shape, chunks, shards = CASES[case]
    if shards and version == "0.4":
        pytest.skip("Zarr format 2 has no shards")
    recipe = DEEP if "z" in axes else FLAT
    if version:
        values = ome("in.zarr", version, axes, shape, chunks, shards=shards)
    else:
        values = plain("in.zarr", RNG.random(shape).astype(np.float32), chunks, shards=shards)
    made = warp_file("in.zarr", "out.zarr", recipe)
    levels = arrays("out.zarr")
    assert np.array_equal(levels[0], whole(made, values))
    assert not np.array_equal(levels[0], values)
    assert made.blocks > 1
    for fine, coarse in itertools.pairwise(levels):
        assert np.array_equal(coarse, reduced(fine, [2 if n in "yx" else 1 for n in axes], "mean"))
    source, target = zarr.open("in.zarr"), zarr.open("out.zarr")
    assert dict(source.attrs) == dict(target.attrs)
    assert sorted(os.listdir()) == ["in.zarr", "out.zarr"]


def test_labels_are_kept_in_all_levels() -> None:
    values = ome("in.zarr", "0.5", "zyx", (8, 28, 30), (4, 16, 16))
    warp_file("in.zarr", "out.zarr", DEEP, volume=VolumeOptions(labels=True))
    fine, coarse = arrays("out.zarr")
    assert np.array_equal(coarse, fine[:, ::2, ::2])
    assert set(np.unique(fine)) <= set(np.unique(values))
    with pytest.raises(SuppleError, match='labels needs filter "nearest"'):
        warp_file("in.zarr", "more.zarr", DEEP, filter="linear", volume=VolumeOptions(labels=True))


@pytest.mark.parametrize(
    "grid",
    [GridOptions(crop=(12, 3, 1, 21, 30, 7)), GridOptions(resample=(2.0, 1.5, 1.0)), GridOptions(crop=(9, 9, 20, 20))],
    ids=["crop", "resample", "flat crop"],
)
def test_other_grids(grid: GridOptions) -> None:
    flat = grid.ndim == 2
    values = ome("in.zarr", "0.5", "yx" if flat else "zyx", (10, 40, 44)[flat:], (4, 16, 16)[flat:])
    made = warp_file("in.zarr", "out.zarr", FLAT if flat else DEEP, grid=grid)
    fine = arrays("out.zarr")[0]
    assert np.array_equal(fine, whole(made, values))
    written = open_image("out.zarr")
    assert made.grid is not None
    assert written.grid.sizes == made.grid.sizes
    if not flat:
        assert np.allclose(written.grid.matrix, made.grid.matrix)
        plain_recipe = Recipe(strokes=[Stroke.grab((1, 1, 1), to=(1, 1, 1), radius=1)])
        warp_file("in.zarr", "same.zarr", plain_recipe, grid=GridOptions(reference="out.zarr"))
        assert open_image("same.zarr").grid.sizes == written.grid.sizes


def test_affine_maps_and_positions_in_space() -> None:
    values = ome("in.zarr", "0.5", "zyx", (8, 30, 34), (4, 16, 16))
    turn = Affine([[1, 0.05, 0, -1], [-0.05, 1, 0, 1.5], [0, 0, 1, 0.3]])
    made = warp_file("in.zarr", "out.zarr", DEEP, maps=[Placed(turn, after=1)])
    assert np.array_equal(arrays("out.zarr")[0], whole(made, values))
    world = warp_file("in.zarr", "world.zarr", DEEP, volume=VolumeOptions(world=True))
    assert world.geometry is not None
    assert world.geometry.convention == "LPS"


def chunk_files(folder: str) -> dict[str, bytes]:
    return {
        os.path.relpath(os.path.join(root, name), folder): Path(root, name).read_bytes()
        for root, _, names in os.walk(folder)
        for name in names
        if name[0].isdigit() or "c" in Path(root).parts
    }


def test_blocks_beyond_the_strokes_are_copied_as_they_are_stored() -> None:
    plain("in.zarr", RNG.integers(0, 9, (64, 96)).astype(np.uint8), (16, 16))
    broken = Path("in.zarr/c/3/5")
    broken.write_bytes(b"not decoded")
    Path("in.zarr/c/2/5").unlink()
    made = warp_file("in.zarr", "out.zarr", FLAT)
    assert 0 < made.copied < made.blocks
    before, after = chunk_files("in.zarr"), chunk_files("out.zarr")
    assert set(before) == set(after)
    same = [name for name in before if before[name] == after[name]]
    assert "c/3/5" in same
    assert len(same) >= made.copied


def test_in_memory(memory: str) -> None:
    values = RNG.random((40, 44)).astype(np.float32)
    plain(f"{memory}/in.zarr", values, (16, 16))
    made = warp_file(f"{memory}/in.zarr", f"{memory}/out.zarr", FLAT)
    assert np.array_equal(arrays(f"{memory}/out.zarr")[0], whole(made, values))
    with pytest.raises(SuppleError, match="memory of this process"):
        warp_file(f"{memory}/in.zarr", "out.zarr", FLAT, running=Running(workers=2))
    assert not os.path.exists("out.zarr")


KILLED = """
import os, signal, sys
from supple import Recipe, Stroke
from supple.files import stores, warp_file
stores.TASK = 1 << 12
real, calls = stores._write_block, []
def killing(work, item):
    calls.append(item)
    if len(calls) > 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(work, item)
stores._write_block = killing
warp_file("in.zarr", "out.zarr", Recipe.from_json(sys.argv[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_a_killed_job_goes_on(version: str) -> None:
    values = ome("in.zarr", version, "zyx", (8, 28, 30), (4, 16, 16))
    child = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(KILLED), DEEP.to_json()],
        env={**os.environ, "PYTHONPATH": SOURCE, "SUPPLE_THREADS": "1"},
        capture_output=True,
        check=False,
    )
    assert child.returncode == -signal.SIGKILL, child.stderr
    assert sorted(os.listdir()) == ["in.zarr", "out.zarr.partial"]
    with pytest.raises(SuppleError, match="unfinished output of another job"):
        warp_file("in.zarr", "out.zarr", DEEP, filter="linear")
    made = warp_file("in.zarr", "out.zarr", DEEP)
    assert 0 < made.done < made.blocks
    assert np.array_equal(arrays("out.zarr")[0], whole(made, values))
    assert sorted(os.listdir()) == ["in.zarr", "out.zarr"]


def test_a_damaged_chunk_is_one_sentence_and_the_rest_is_kept() -> None:
    values = plain("in.zarr", RNG.integers(0, 9, (64, 96)).astype(np.uint8), (16, 16))
    chunk = Path("in.zarr/c/0/0")
    whole_chunk = chunk.read_bytes()
    chunk.write_bytes(whole_chunk[:-5])
    with pytest.raises(SuppleError, match=r"^cannot read in.zarr: samples of it cannot be decoded, at 0:"):
        warp_file("in.zarr", "out.zarr", FLAT)
    assert not os.path.exists("out.zarr")
    chunk.write_bytes(whole_chunk)
    made = warp_file("in.zarr", "out.zarr", FLAT)
    assert np.array_equal(arrays("out.zarr")[0], whole(made, values))


def test_a_turned_reference_is_refused() -> None:
    nibabel = pytest.importorskip("nibabel")
    ome("in.zarr", "0.5", "zyx", (8, 20, 24), (4, 16, 16))
    turned = np.eye(4)
    turned[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    nibabel.save(nibabel.Nifti1Image(np.zeros((20, 20, 8), np.float32), turned), "turned.nii")
    with pytest.raises(SuppleError, match="turned against those of the input"):
        warp_file("in.zarr", "out.zarr", DEEP, grid=GridOptions(reference="turned.nii"))


def test_processes_make_the_same() -> None:
    pytest.importorskip("distributed")
    values = ome("in.zarr", "0.5", "zyx", (8, 28, 30), (4, 16, 16))
    turn = Affine([[1, 0.05, 0, -1], [-0.05, 1, 0, 1.5], [0, 0, 1, 0.3]])
    made = warp_file("in.zarr", "out.zarr", DEEP, maps=[Placed(turn)], running=Running(workers=2))
    fine, coarse = arrays("out.zarr")
    assert np.array_equal(fine, whole(made, values))
    assert np.array_equal(coarse, reduced(fine, [1, 2, 2], "mean"))


def ends(job: str, item: int) -> int:
    if item == 3:
        os._exit(1)
    return item


def test_workers_that_end_are_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    import dask

    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{SOURCE}")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        tasks.runner_of(Running(workers=1)) as runner,
        pytest.raises(SuppleError, match="ended again and again at the same block"),
    ):
        runner.each(ends, "job", range(6), lambda: None)


def test_a_worker_that_does_not_see_the_folders(tmp_path: Path) -> None:
    plain("in.zarr", RNG.random((40, 40)).astype(np.float32), (16, 16))

    def moved(step: str, done: int, total: int) -> None:
        if step == "plan" and os.path.exists("in.zarr"):
            shutil.move("in.zarr", "away.zarr")

    with pytest.raises(SuppleError, match=r"in\.zarr is gone, or a worker does not see it"):
        warp_file("in.zarr", "out.zarr", FLAT, tell=moved)


def test_a_plan_says_what_the_job_does() -> None:
    plain("in.zarr", RNG.random((64, 96)).astype(np.float32), (16, 16))
    told = plan_file(Job("in.zarr", "", FLAT))
    shutil.rmtree("in.zarr/c")  # no sample is read
    assert plan_file(Job("in.zarr", "", FLAT)) == told
    plain("in.zarr", RNG.random((64, 96)).astype(np.float32), (16, 16), overwrite=True)
    made = warp_file("in.zarr", "out.zarr", FLAT)
    assert (told.blocks, told.copied) == (made.blocks, made.copied)
    assert told.size == 64 * 96 * 4
    assert told.read > 0
    assert told.memory > told.tasks * 16 * 16 * 4


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            concurrent.futures.CancelledError("task-1"),
            "the workers were lost (their scheduler ended): start them again",
        ),
        (asyncio.CancelledError(), "the workers were lost (their scheduler ended)"),
        (ConnectionError("reset by peer"), "the workers were lost (reset by peer)"),
        (ModuleNotFoundError("No module named 'supple'"), "install the same versions of Supple"),
        (SuppleError("a sentence"), "a sentence"),
    ],
)
def test_what_happens_to_a_cluster_is_one_sentence(error: BaseException, told: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(SuppleError, match=re.escape(told)), tasks._Distributed(None, "the workers")._failing():
        raise error


def test_lengths_in_another_unit_are_told() -> None:
    ome("in.zarr", "0.5", "zyx", (9, 28, 30), (4, 16, 16), unit="micrometer")
    drag = Stroke.grab((14, 12, 4), to=(16, 13, 5), radius=0.002)
    warp_file("in.zarr", "fine.zarr", Recipe(strokes=[drag]))
    for radius, words in (
        (2.0, r"2 mm is 66\.7 times in\.zarr, of 0\.03 x 0\.028 x 0\.009 mm"),
        (5e-5, r"0\.05 times"),
    ):
        with pytest.warns(VolumeWarning, match=words), contextlib.suppress(SuppleError):
            plan_file(Job("in.zarr", "", Recipe(strokes=[replace(drag, radius=radius)])))


@pytest.mark.parametrize("unit", ["um", "\u00b5m", "micron"])
def test_units_that_many_files_have(unit: str) -> None:
    ome("in.zarr", "0.5", "zyx", (9, 28, 30), (4, 16, 16), unit=unit)
    assert np.allclose(open_image("in.zarr").grid.spacing, 1e-3)


def test_labels_are_not_mixed_in_silence() -> None:
    values = ome("in.zarr", "0.5", "zyx", (9, 28, 30), (4, 16, 16))
    areas = np.repeat(np.repeat(values[:, ::10, ::11], 10, 1), 11, 2)
    zarr.open_group("in.zarr")["0"][...] = areas
    with pytest.warns(VolumeWarning, match="in.zarr looks like a label map"):
        warp_file("in.zarr", "mixed.zarr", DEEP)
    made = warp_file("in.zarr", "kept.zarr", DEEP, volume=VolumeOptions(labels=True))
    assert np.isin(arrays(made.target)[0], areas).all()


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_label_images_are_bent_with_their_image(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ome("in.zarr", version, "tzyx", (2, 9, 28, 30), (1, 4, 16, 16))
    names = ["nuclei", "coarse"]
    listed = {"labels": names} if version == "0.4" else {"ome": {"version": version, "labels": names}}
    zarr.open_group("in.zarr").create_group("labels", attributes=listed)
    values = ome("in.zarr/labels/nuclei", version, "zyx", (9, 28, 30), (4, 16, 16))
    ome("in.zarr/labels/coarse", version, "zyx", (9, 14, 15), (4, 16, 16))
    with monkeypatch.context() as patch:
        patch.setattr(Target, "finish", stopped)
        with pytest.raises(KeyboardInterrupt), pytest.warns(VolumeWarning, match="coarse"):
            warp_file("in.zarr", "out.zarr", DEEP)
    label = Path("in.zarr/labels/nuclei/.zgroup" if version == "0.4" else "in.zarr/labels/nuclei/zarr.json")
    os.utime(label, ns=(0, 0))  # as if it had been replaced meanwhile: it is begun anew
    with pytest.warns(
        VolumeWarning, match=r"label image coarse of in.zarr is not carried over \(it is on another grid"
    ):
        made = warp_file("in.zarr", "out.zarr", DEEP)
    assert made.labels == ("nuclei",)
    found = arrays("out.zarr/labels/nuclei")
    assert np.array_equal(found[0], made.deformation.warp(values, filter="nearest", between="nearest"))
    assert np.array_equal(found[1], found[0][:, ::2, ::2])
    assert open_image("out.zarr").labels == ("nuclei",)
    label = zarr.open_group("in.zarr/labels/nuclei")
    label.attrs["image-label" if version == "0.4" else "ome"] = {**label.attrs.get("ome", {}), "image-label": {}}
    with pytest.warns(VolumeWarning, match="nuclei is a label map, and its labels are mixed"):
        warp_file("in.zarr/labels/nuclei", "label.zarr", DEEP)


def test_label_images_that_cannot_be_bent_are_told_before_any_work() -> None:
    ome("in.zarr", "0.5", "zyx", (9, 28, 30), (4, 16, 16))
    ome("evil.zarr", "0.5", "zyx", (9, 28, 30), (4, 16, 16))
    names = ["gone", "flat", "real", "../../evil.zarr"]
    zarr.open_group("in.zarr").create_group("labels", attributes={"ome": {"version": "0.5", "labels": names}})
    ome("in.zarr/labels/flat", "0.5", "yx", (40, 44), (16, 16))
    ome("in.zarr/labels/real", "0.5", "zyx", (9, 28, 30), (4, 16, 16), dtype="float32")
    with pytest.warns(VolumeWarning) as told:
        made = warp_file("in.zarr", "out.zarr", DEEP)
    assert made.labels == ()
    said = [str(each.message) for each in told]
    for name, why in zip(names, ("gone", "2 axes of space", "it holds float32", "no plain name"), strict=True):
        assert any(f"label image {name} of in.zarr is not carried over (" in text and why in text for text in said)
    assert sorted(os.listdir()) == ["evil.zarr", "in.zarr", "out.zarr"]


def test_labels_outside_are_background() -> None:
    ome("in.zarr", "0.5", "zyx", (9, 28, 30), (4, 16, 16))
    zarr.open_group("in.zarr").create_group("labels", attributes={"ome": {"version": "0.5", "labels": ["nuclei"]}})
    ome("in.zarr/labels/nuclei", "0.5", "zyx", (9, 28, 30), (4, 16, 16), dtype="uint8")
    shift = Placed(Affine(np.c_[np.eye(3), (60, 0, 0)]))
    with warnings.catch_warnings(action="ignore"):
        made = warp_file("in.zarr", "out.zarr", Recipe(strokes=[]), maps=(shift,), outside="constant", fill=300)
    assert set(np.unique(arrays(made.target)[0])) == {300}
    assert set(np.unique(arrays("out.zarr/labels/nuclei")[0])) == {0}


def test_a_fill_of_scaled_samples_is_a_true_value() -> None:
    plain(
        "in.zarr", RNG.integers(0, 9, (40, 44), np.int16), (16, 16), attributes={"scale_factor": 0.5, "add_offset": -9}
    )
    away = Placed(Affine([[1, 0, 60], [0, 1, 0]]))
    warp_file("in.zarr", "out.zarr", Recipe(strokes=[]), maps=(away,), outside="constant", fill=-1)
    out = zarr.open_array("out.zarr", mode="r")
    assert set(np.unique(out[...])) == {16}
    assert dict(out.attrs)["scale_factor"] == 0.5
    with pytest.raises(SuppleError, match=r"fill must be from -16393 to 16374\.5, which in\.zarr can hold"):
        warp_file("in.zarr", "no.zarr", Recipe(strokes=[]), maps=(away,), outside="constant", fill=20000)


def stopped(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_axes_of_space_in_another_order_are_refused() -> None:
    ome("in.zarr", "0.5", "xy", (40, 44), (16, 16))
    with pytest.raises(SuppleError, match=r"in\.zarr: its axes of space are x, y, in this order: store them .* y, x"):
        warp_file("in.zarr", "out.zarr", FLAT)


def test_no_task_goes_on_after_an_error() -> None:
    begun, ready = itertools.count(), []

    def work(_: object, item: int) -> None:
        if next(begun) == 0:
            raise SuppleError("this one")
        time.sleep(0.2)
        ready.append(item)

    with runner_of(Running()) as runner, pytest.raises(SuppleError, match="this one"):
        runner.each(work, None, range(100), lambda: None)
    count = len(ready)
    assert count < 50
    time.sleep(0.5)
    assert len(ready) == count


def test_a_field_whose_place_another_job_has_leaves_no_output() -> None:
    plain("in.zarr", RNG.integers(0, 250, (64, 64), np.uint8), (16, 16))
    os.mkdir("map.zarr.partial")
    Path("map.zarr.partial/supple.json").write_text('{"program": "supple", "state": "unfinished", "job": "b"}')
    with pytest.raises(SuppleError, match=r"map\.zarr.*is the unfinished output of another job"):
        warp_file("in.zarr", "out.zarr", FLAT, save_field="map.zarr")
    assert sorted(os.listdir()) == ["in.zarr", "map.zarr.partial"]
    warp_file("in.zarr", "out.zarr", FLAT, save_field="map.zarr", force=True)
    assert sorted(os.listdir()) == ["in.zarr", "map.zarr", "out.zarr"]
