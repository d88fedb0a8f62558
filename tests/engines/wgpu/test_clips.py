"""Clips and volumes by the GPU engine, against the public CPU engine: streams, files, parts, and failures."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple import Deformation, Recipe, Stroke
from supple.cli import command
from supple.engines.base import LONGEST, Layout, Sampling, Space, Work, slots_of
from supple.engines.choice import engine_for
from supple.engines.native import NATIVE
from supple.engines.wgpu import kernel, planes
from supple.engines.wgpu import warp as warping
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.lattice import SETTINGS
from supple.engines.wgpu.reach import held_of
from supple.errors import DeviceWarning, SuppleError
from supple.geometry import Geometry
from supple.media import image
from supple.media.volume import read as read_volume
from supple.media.volume import write
from supple.media.volume.data import Volume
from supple.pipeline import Plan, make_plan, stream
from tests import clips, reference
from tests.pipeline.streams import LAYOUTS, SHAPE, Clip, bent, layout_of, noise

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

Array = npt.NDArray[Any]

DATA = Path(supple.__file__).parent / "examples" / "data"
STILL = Deformation(SHAPE, border=None, on_fold="damp").grab((25, 20), by=(9, -6), radius=16, reach=None)
LINEAR = Sampling("linear")


def streamed(
    device: str,
    space: Space,
    layout: Layout,
    arrays: Sequence[Array],
    sampling: Sampling = LINEAR,
    memory: float = math.inf,
) -> tuple[list[Array], Plan]:
    """All planes of the output, for each group."""
    engine = engine_for(device, Work(space, layout, sampling))
    plan = make_plan(Work(space, layout, sampling), range(space.count), engine=engine)
    clip = Clip(arrays)
    found: list[list[Array]] = [[] for _ in layout.groups]
    for _, parts, certificate in stream(Work(space, layout, sampling), plan, clip, memory=memory, engine=engine):
        assert certificate.error <= max(sampling.tolerance, 0.01)
        for part, out in zip(parts, found, strict=True):
            out.append(part.copy())
    assert clip.ended
    assert clip.copied == sorted(set(clip.copied))  # each frame is read once
    return [np.stack(out) for out in found], plan


def of_frames(d: Deformation, count: int = 12) -> Space:
    return d.space if d.ndim == 3 else replace(d.space, count=count)


def apart(one: Array, other: Array, white: float) -> Array:
    """How many levels of 255 lie between two arrays."""
    return np.asarray(np.abs(one.astype(np.float64) - other.astype(np.float64)) * (255 / white))


def agree(
    space: Space, layout: Layout, arrays: Sequence[Array], sampling: Sampling = LINEAR, most: float = 2.1
) -> list[Array]:
    """Both engines' results are the same, but for a hundredth of a pixel of noise; return the GPU's."""
    ours, theirs = (streamed(device, space, layout, arrays, sampling)[0] for device in ("cpu", "gpu"))
    for one, other, source in zip(ours, theirs, arrays, strict=True):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        found = apart(one, other, layout.white)
        assert found.max() <= most
        assert (found > 1.01).mean() < 2e-3
        assert apart(one, source, layout.white).max() > 30
    return theirs


@pytest.mark.parametrize("kind", ["4:2:0", "4:2:2 of 10 bits", "4:1:1", "4:4:4 of 12 bits", "grey of floats"])
def test_clips_are_bent_in_time(gpu: Gpu, kind: str) -> None:
    agree(bent().space, LAYOUTS[kind], noise(LAYOUTS[kind]))


@pytest.mark.parametrize(("step", "offset"), [((2, 2), (0.5, 0.5)), ((4, 1), (1.5, 0.0))])
@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.filterwarnings("ignore::supple.MissWarning")
def test_every_component_knows_what_is_frozen(
    gpu: Gpu, step: tuple[int, int], offset: tuple[float, float], timed: bool
) -> None:
    mask = np.zeros(SHAPE, bool)
    mask[12:30, 20:38] = True
    size = (6, *SHAPE) if timed else SHAPE
    d = Deformation(size, time=timed, freeze=supple.Freeze.of(mask, width=6.0))
    d = d.grab((42, 25, 3) if timed else (42, 25), by=(12, -6, 0.0) if timed else (12, -6), radius=14, reach=None)
    layout = layout_of(step, offset, "f4", 1.0)
    places = []  # of the samples of each group, which are what is warped
    for group in layout.groups:
        y, x = (group.step[1 - k] * np.arange(n) + group.offset[1 - k] for k, n in enumerate(group.shape))
        places.append(np.stack(np.meshgrid(x, y), -1))
    arrays = [
        np.broadcast_to(at[..., : group.channels], (6, *group.shape, group.channels)).astype(np.float32)
        for group, at in zip(layout.groups, places, strict=True)
    ]
    found, _ = streamed("gpu", of_frames(d, 6), layout, arrays)
    for at, made, source in zip(places, found, arrays, strict=True):
        still = ((at >= (20, 12)) & (at <= (37, 29))).all(axis=-1)
        np.testing.assert_array_equal(made[:, still], source[:, still])
        points = d.inverse(np.concatenate([at, np.full((*at.shape[:2], 1), 2.0)], -1)[..., : d.ndim]).points[..., :2]
        within = ((points >= at[0, 0]) & (points <= at[-1, -1])).all(axis=-1)
        away = np.abs(made[2] - points[..., : made.shape[-1]])[within]
        assert away.max() < 0.01
        assert np.abs(points - at).max() > 2


@pytest.mark.parametrize("kind", ["4:2:0", "4:4:4 of 12 bits"])
def test_every_frame_is_bent_alike(gpu: Gpu, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[object] = []
    solve = planes.Lattice.solve
    monkeypatch.setattr(planes.Lattice, "solve", lambda *rest: solved.append(rest) or solve(*rest))
    agree(of_frames(STILL), LAYOUTS[kind], noise(LAYOUTS[kind]))
    assert len(solved) <= 2  # once for each plane that is made at the same time


@pytest.mark.parametrize("border", [None, 12.0])
@pytest.mark.parametrize("offset", [(0.5, 0.5), (1.0, 0.0), (0.0, 1.0)])
def test_chroma_lies_where_it_is_sited(gpu: Gpu, offset: tuple[float, float], border: float | None) -> None:
    layout = layout_of(offset=offset)
    d = Deformation(SHAPE, border=border, border_profile="sine", on_fold="damp").grab(
        (60, 36), by=(9, -6), radius=16, reach=None
    )
    made = agree(of_frames(d), layout, noise(layout))
    # And half a pixel is seen: elsewhere, other colours come out.
    other = layout_of(offset=(0.0, 0.5))
    assert apart(made[1], streamed("gpu", of_frames(d), other, noise(layout))[0][1], 255).max() > 8


def test_opacity_of_planes(gpu: Gpu) -> None:
    layout = layout_of(alpha=True)
    chroma = replace(layout.groups[1], channels=3, alpha=True)
    layout = replace(layout, groups=(layout.groups[0], chroma))
    ours, theirs = (streamed(k, bent().space, layout, noise(layout))[0] for k in ("cpu", "gpu"))
    for one, other in zip(ours, theirs, strict=True):
        # Where next to nothing is opaque, colours are those of little.
        assert (apart(one, other, 255)[one[..., -1] > 40] > 2).mean() < 2e-3


@pytest.mark.parametrize("outside", ["constant", "reflect"])
def test_beyond_a_clip_s_ends_and_edges(gpu: Gpu, outside: str) -> None:
    layout = LAYOUTS["4:2:0"]
    d = Deformation((8, *SHAPE), border=None, on_fold="damp").grab(
        (60, 36, 5), by=(-15, -10, -4), radius=25, reach=None
    )
    agree(d.space, layout, noise(layout, 8), Sampling("linear", outside=outside, fill=(40.0, 128.0, 90.0)))


def test_what_is_still_passes_as_it_is(gpu: Gpu) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout, 30)
    d = Deformation((30, *SHAPE), border=64, on_fold="damp").grab(
        (30, 20, 20), by=(5, 3, 2), radius=4, scales=3, reach=None
    )
    found, plan = streamed("gpu", d.space, layout, arrays)
    assert plan.still[:5].all()
    assert not plan.still[18:23].any()
    for part, source in zip(found, arrays, strict=True):
        np.testing.assert_array_equal(part[:5], source[:5])


def test_a_small_stroke_between_nodes_is_not_still(gpu: Gpu) -> None:
    stack = np.random.default_rng(5).integers(0, 255, (9, 48, 64)).astype(np.uint8)
    d = Deformation(stack.shape, border=None, on_fold="flow").grab(
        (24, 24, 4), by=(0.8, 0.5, 0), radius=1.5, scales=3, reach=None
    )
    ours, theirs = (d.warp(stack, filter="linear", device=device) for device in ("cpu", "gpu"))
    assert (ours != stack).any()
    assert apart(ours, theirs, 255).max() <= 2.1


def test_frames_in_a_file_are_the_same(gpu: Gpu) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    for one, other in zip(
        streamed("gpu", bent().space, layout, arrays)[0],
        streamed("gpu", bent().space, layout, arrays, memory=0)[0],
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("timed", [True, False])
def test_a_window_that_is_too_large_goes_in_parts(gpu: Gpu, monkeypatch: pytest.MonkeyPatch, timed: bool) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    space = of_frames(bent() if timed else STILL)
    whole, plan = streamed("gpu", space, layout, arrays)
    reads: list[int] = []
    hold = warping._Work.hold

    def seen(self: Any, frames: Any, rows: Any) -> Any:
        reads.append(rows[1] - rows[0])
        return hold(self, frames, rows)

    monkeypatch.setattr(warping._Work, "hold", seen)
    monkeypatch.setattr(gpu, "texture", 41 * 67 * (plan.capacity - 1) if timed else 41 * 67 - 300)
    parts, _ = streamed("gpu", space, layout, arrays)
    for one, other in zip(parts, whole, strict=True):
        np.testing.assert_array_equal(one, other)
    assert min(reads) < 41  # of luma, some rows at a time


def test_averages_over_time_and_place(gpu: Gpu) -> None:
    t, y, x = np.mgrid[:18, :48, :64]
    pattern = 128 + 60 * np.sin(x / 3.0 + t) + 60 * np.cos(y / 4.0 - 0.7 * t)
    layout = Layout((replace(LAYOUTS["grey of floats"].groups[0], shape=(48, 64)),), np.dtype(np.uint8), 255)
    arrays = [pattern.astype(np.uint8)[..., None]]
    d = Deformation(arrays[0].shape[:3], border=8, on_fold="damp").grab((32, 24, 9), by=(3, 2, 5), radius=9, reach=None)
    for between_frames in ("linear", "cubic"):
        sampling = Sampling("auto", between_frames, time_filter=True)
        made, plain = (
            streamed("gpu", d.space, layout, arrays, s)[0][0].astype(int)
            for s in (sampling, replace(sampling, time_filter=False))
        )
        wanted = reference.warp_frames(
            arrays[0], reference.carried_out(d), d.domain, between=between_frames, time_filter=True
        )
        found = np.abs(made - wanted.astype(int))
        assert (np.abs(made - plain) > 3).mean() > 0.01  # it matters
        assert (found > 1).mean() < 2e-3
        assert found.max() <= 6


def test_a_failure_in_the_middle_ends_in_the_cpu_s_frames(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    space = bent().space
    ours, theirs = (streamed(device, space, layout, arrays)[0] for device in ("cpu", "gpu"))
    calls = 0
    run = planes.run

    def failing(*rest: Any) -> None:
        nonlocal calls
        calls += 1
        if calls > 10:
            raise RuntimeError("Parent device is lost")
        run(*rest)

    monkeypatch.setattr(planes, "run", failing)
    with pytest.warns(DeviceWarning, match="the CPU did what .* could not: Parent device is lost") as told:
        made = streamed("gpu", space, layout, arrays)[0]
    assert len(told) == 1
    for one, mixed, other in zip(ours, made, theirs, strict=True):
        by_cpu = [k for k in range(12) if (mixed[k] == one[k]).all()]
        by_gpu = [k for k in range(12) if (mixed[k] == other[k]).all()]
        assert set(by_cpu) | set(by_gpu) == set(range(12))
        assert 0 in by_gpu
        assert set(range(4, 12)) <= set(by_cpu)


def test_points_that_float32_cannot_solve_are_the_cpu_s(gpu: Gpu) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    fine = replace(LINEAR, tolerance=1e-7)
    space = of_frames(STILL)
    engine = engine_for("gpu", Work(space, layout, fine))
    plan = make_plan(Work(space, layout, fine), range(12), engine=engine)
    made: list[Array] = []
    running = stream(Work(space, layout, fine), plan, Clip(arrays), engine=engine)
    with pytest.warns(DeviceWarning, match="points could not be solved to the tolerance") as told:
        made.extend(parts[0].copy() for _, parts, _ in running)
    assert len(told) == 1
    plan = make_plan(Work(space, layout, fine), range(12))
    ours = [p[0].copy() for _, p, _ in stream(Work(space, layout, fine), plan, Clip(arrays))]
    np.testing.assert_array_equal(np.stack(made), np.stack(ours))


def test_readers_that_fail_in_their_thread(gpu: Gpu) -> None:
    layout = LAYOUTS["4:2:0"]
    space = bent().space
    engine = engine_for("gpu", Work(space, layout, LINEAR))
    plan = make_plan(Work(space, layout, LINEAR), range(12), engine=engine)
    clip = Clip(noise(layout), 5)
    with pytest.raises(SuppleError, match="after 5 frames, where 12 were expected"):
        list(stream(Work(space, layout, LINEAR), plan, clip, engine=engine))
    # Left early, it reads no farther, and leaves no thread behind.
    clip = Clip(noise(layout))
    running = stream(Work(space, layout, LINEAR), plan, clip, engine=engine)
    next(running)
    running.close()
    assert clip.given < 12


def test_a_real_clip(gpu: Gpu) -> None:
    from supple.files.clips import open_clip

    with open_clip(DATA / "bunny.mp4") as opened:
        layout = opened.layout
        arrays = [np.empty((5, *g.shape, g.channels), layout.dtype) for g in layout.groups]
        for k, frame in zip(range(5), opened.frames(), strict=False):
            frame.copy_to([a[k] for a in arrays])
    d = Deformation((5, *layout.shape), border=None, on_fold="damp").grab(
        (320, 180, 2), by=(60, 20, 1.5), radius=120, reach=None
    )
    ours, theirs = (streamed(device, d.space, layout, arrays)[0] for device in ("cpu", "gpu"))
    for one, other in zip(ours, theirs, strict=True):
        found = apart(one, other, 255)
        assert found.max() <= 1
        assert found.mean() < 0.01


def test_a_card_does_what_it_knows(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("supple.engines.choice.open_gpu", lambda software=True: gpu)
    space, layout = bent().space, LAYOUTS["4:2:0"]
    assert engine_for("auto", Work(space, layout, LINEAR)) is not NATIVE
    assert (
        engine_for("auto", Work(Deformation((12, *SHAPE), border=64, on_fold="damp").space, layout, LINEAR)) is NATIVE
    )
    wide = replace(layout, dtype=np.dtype(np.float64))
    assert engine_for("auto", Work(space, wide, LINEAR)) is NATIVE
    with pytest.raises(SuppleError, match='"auto" for samples of float64 in 1 channel'):
        engine_for("gpu", Work(space, wide, LINEAR))
    with pytest.raises(SuppleError, match='"auto" for samples that lie as these do'):
        engine_for("gpu", Work(space, layout_of((3, 3)), LINEAR))


def test_video_files(gpu: Gpu, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = clips.make(tmp_path / "in.mp4", count=6, audio="aac", smooth=False)
    grab = ["--grab", "30,24,3:38,20,4", "--radius", "12", "--filter", "linear", "--lossless"]
    for device in ("cpu", "gpu"):
        assert command(["warp", str(source), str(tmp_path / f"{device}.mkv"), *grab, "--device", device]) == 0
    assert ("is a program that runs on the CPU" in capsys.readouterr().err) == gpu.software
    ours, theirs = (
        np.array([[np.frombuffer(row, np.uint8) for row in clips.rows(frame)[:1]] for frame in found])
        for found in (clips.decoded(tmp_path / f"{device}.mkv") for device in ("cpu", "gpu"))
    )
    assert ours.shape == theirs.shape == (6, 1, 64 * 48)
    assert apart(ours, theirs, 255).max() <= 2
    assert ours.std() > 30
    assert clips.parcels(tmp_path / "gpu.mkv", "audio") == clips.parcels(tmp_path / "cpu.mkv", "audio")


@pytest.mark.parametrize("depth", [8, 16])
def test_image_sequences(gpu: Gpu, tmp_path: Path, depth: int) -> None:
    rng = np.random.default_rng(depth)
    kind = {8: np.uint8, 16: np.uint16}[depth]
    (tmp_path / "in").mkdir()
    for k in range(4):
        image.write(tmp_path / "in" / f"{k:03}.png", rng.integers(0, 2**depth, (40, 50, 3)).astype(kind))
    recipe = Recipe(
        strokes=[Stroke.grab((25, 20, 2), to=(31, 22, 3), radius=9, reach=None)], border=None, on_fold="damp"
    )
    for device in ("cpu", "gpu"):
        supple.warp_file(tmp_path / "in", tmp_path / device, recipe, filter="linear", device=device)
    for k in range(4):
        ours, theirs = (image.read(tmp_path / d / f"{k:03}.png").pixels for d in ("cpu", "gpu"))
        assert ours.dtype == kind
        assert apart(ours, theirs, 2**depth - 1).max() <= 1.6


def written(path: Path, samples: Array) -> Path:
    write(path, samples, Volume(samples, Geometry(convention="RAS")))
    return path


RECIPE = Recipe(
    strokes=[Stroke.grab((22, 20, 15), to=(27, 22, 12), radius=12, reach=None)], border=None, on_fold="damp"
)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.float32])
def test_volume_files(gpu: Gpu, tmp_path: Path, dtype: Any) -> None:
    source = written(tmp_path / "in.nii", np.random.default_rng(1).integers(0, 120, (30, 40, 44)).astype(dtype))
    for device in ("cpu", "gpu"):
        made = supple.warp_file(source, tmp_path / f"{device}.nii", RECIPE, filter="linear", device=device)
        assert made.error <= 0.01  # type: ignore[union-attr]
    ours, theirs = (np.asarray(read_volume(tmp_path / f"{d}.nii").samples) for d in ("cpu", "gpu"))
    assert ours.dtype == theirs.dtype == dtype
    assert apart(ours, theirs, 120).max() <= 2.2
    assert apart(ours, np.asarray(read_volume(source).samples), 120).max() > 100


def test_labels_of_volumes_and_types_that_are_refused(
    gpu: Gpu, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labels = np.random.default_rng(2).choice([3, 40, 200], (30, 40, 44)).astype(np.uint8)
    source = str(written(tmp_path / "in.nii", labels))
    grab = ["--grab", "22,20,15:27,22,12", "--radius", "12", "--border", "none"]
    for device in ("cpu", "gpu"):
        ends = [str(tmp_path / f"{device}.nii"), *grab, "--labels", "--device", device]
        assert command(["warp", source, *ends]) == 0
    ours, theirs = (np.asarray(read_volume(tmp_path / f"{d}.nii").samples) for d in ("cpu", "gpu"))
    assert set(np.unique(theirs)) == {3, 40, 200}
    assert (ours != theirs).mean() < 4e-3
    for kind in (np.int32, np.float64):
        source = str(written(tmp_path / f"{np.dtype(kind)}.nii", labels.astype(kind)))
        capsys.readouterr()
        ends = [str(tmp_path / "x.nii"), *grab, "--device", "gpu", "--save-field", str(tmp_path / "f.nii")]
        assert command(["warp", source, *ends]) == 2
        said = capsys.readouterr().err
        assert f"samples of {np.dtype(kind)} in 1 channel" in said
        assert not (tmp_path / "x.nii").exists()
        assert not (tmp_path / "f.nii").exists()


def test_volumes_that_are_larger_than_a_shader_takes(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    # Samples that lie in a file, in the other order of bytes.
    samples = np.random.default_rng(3).integers(-90, 90, (30, 70, 44)).astype(">i2")
    d = Deformation(samples.shape, border=None, on_fold="damp").grab((22, 30, 15), by=(5, 9, -3), radius=14, reach=None)
    options: dict[str, Any] = {"filter": "linear", "device": "gpu"}
    whole = d.warp(samples, **options)
    assert apart(whole, d.warp(samples, filter="linear"), 180).max() < 2.5
    for binding in (20, 7):  # frames of which all rows fit, and not even those of one plane
        monkeypatch.setattr(gpu, "texture", binding * 70 * 44 * 4)
        np.testing.assert_array_equal(d.warp(samples, **options), whole)


@pytest.fixture(scope="module")
def photo() -> Array:
    return image.read(DATA / "coffee.jpg").pixels[:240, :330]


@pytest.mark.parametrize("way", [{"filter": "linear"}, {"filter": "auto"}, {"filter": "linear", "outside": "reflect"}])
def test_large_pictures_are_made_in_bands(
    gpu: Gpu, photo: Array, monkeypatch: pytest.MonkeyPatch, way: dict[str, Any]
) -> None:
    d = Deformation(photo.shape[:2], border=None, on_fold="flow").grab((160, 90), by=(20, 60), radius=50, reach=None)
    whole = d.warp(photo, device="gpu", **way)
    pieces: list[Any] = []
    colour = warping.colour
    monkeypatch.setattr(warping, "colour", lambda *rest: pieces.append(rest[0].part) or colour(*rest))
    monkeypatch.setattr(gpu, "binding", 330 * 4 * 150)
    monkeypatch.setattr(gpu, "texture", 330 * 4 * 150)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeviceWarning)
        np.testing.assert_array_equal(d.warp(photo, device="gpu", **way), whole)
    assert len(pieces) >= 2
    # Where not even the lattice fits, it is one of some rows at a time.
    pieces.clear()
    monkeypatch.setattr(warping, "NODE", 64 * 30)
    np.testing.assert_array_equal(d.warp(photo, device="gpu", **way), whole)
    assert max(part.tall for part in pieces) < 5
    # One that does not even fit in rows of cells ends in the CPU's result.
    monkeypatch.setattr(gpu, "texture", 330 * 4 * 10)
    with pytest.warns(DeviceWarning, match="more than a shader takes"):
        np.testing.assert_array_equal(d.warp(photo, device="gpu", **way), d.warp(photo, **way))


def test_rows_that_were_not_foreseen_are_fetched(gpu: Gpu, photo: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    d = Deformation(photo.shape[:2], border=None, on_fold="flow").grab((160, 90), by=(20, 60), radius=50, reach=None)
    whole = d.warp(photo, filter="linear", device="gpu")
    monkeypatch.setattr(gpu, "binding", 330 * 4 * 150)
    monkeypatch.setattr(gpu, "texture", 330 * 4 * 150)
    boxes: list[Any] = []
    box_of = warping.box_of

    def too_small(*rest: Any) -> Any:
        frames, (top, end) = box_of(*rest)
        lack = max(0, 20 - int(rest[-1]) * 3)
        boxes.append(lack)
        return frames, (min(top + lack, end - 1), max(end - lack, top + lack + 1))

    monkeypatch.setattr(warping, "box_of", too_small)
    np.testing.assert_array_equal(d.warp(photo, filter="linear", device="gpu"), whole)
    assert min(boxes) < max(boxes)


def test_long_work_is_done_in_pieces(gpu: Gpu, photo: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    d = Deformation(photo.shape[:2], border=None, on_fold="flow").grab((160, 90), by=(20, 60), radius=50, reach=None)
    whole = d.warp(photo, filter="linear", device="gpu")
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    clip, _ = streamed("gpu", bent().space, layout, arrays)
    submitted: list[int] = []
    run = planes.run
    monkeypatch.setattr(planes, "run", lambda *rest: submitted.append(1) or run(*rest))
    monkeypatch.setattr("supple.engines.wgpu.clip.AT_FIRST", 8e3)
    pieces, _ = streamed("gpu", bent().space, layout, arrays)
    assert len(submitted) > 5 * 12
    for one, other in zip(pieces, clip, strict=True):
        np.testing.assert_array_equal(one, other)
    submitted.clear()
    monkeypatch.setattr(warping._Work, "_paced", lambda *rest: None)
    work = warping._Work
    monkeypatch.setattr(warping, "_Work", lambda *rest: work(*rest, limit=9e4))
    np.testing.assert_array_equal(d.warp(photo, filter="linear", device="gpu"), whole)
    assert len(submitted) > 4


def test_what_stands_for_what_lies_outside() -> None:
    for n in (1, 2, 7):
        for low in range(-3 * n, 3 * n):
            for high in range(low, 3 * n):
                for outside in ("edge", "reflect"):
                    first, end = held_of(low, high, 1, n, outside)
                    seen = slots_of(low, high + 1, n, outside, n)
                    assert 0 <= first <= seen.min()
                    assert seen.max() < end <= n
                assert held_of(low, high, 1, n, "constant")[1] <= n


def test_numbers_of_shaders() -> None:
    assert f"const LONGEST = {LONGEST};" in kernel.source("warp")
    assert SETTINGS.itemsize % 16 == 0


# The last: all is compiled anew for the next device.
def test_a_device_that_is_lost_in_the_middle(gpu: Gpu) -> None:
    layout = LAYOUTS["4:2:0"]
    arrays = noise(layout)
    space = bent().space
    ours, _ = streamed("cpu", space, layout, arrays)
    engine = engine_for("gpu", Work(space, layout, LINEAR))
    plan = make_plan(Work(space, layout, LINEAR), range(12), engine=engine)

    def follow() -> None:
        for z, parts, _ in stream(Work(space, layout, LINEAR), plan, Clip(arrays), engine=engine):
            if z == 3:
                engine.gpu.device.destroy()  # type: ignore[attr-defined]
            for part, one in zip(parts, ours, strict=True):
                assert apart(part, one[z], 255).max() <= 2.1
                assert z < 6 or (part == one[z]).all()

    with pytest.warns(DeviceWarning, match="the CPU did what"):
        follow()


def test_what_shrinks_beyond_measure_at_a_border_is_no_hole(gpu: Gpu) -> None:
    """Drivers in software end loops of too many turns, and say nothing."""
    y, x = np.mgrid[:160, :80]
    picture = np.repeat((127 + 100 * np.sin(x / 40) * np.cos(y / 50)).astype(np.uint8)[..., None], 3, 2)
    d = supple.Deformation(picture.shape[:2], border=5, on_fold="damp").grab(
        (30, 80), by=(50, 5), radius=75, reach=None
    )
    wanted = reference.warp(picture, reference.carried_out(d), d.domain)
    assert np.abs(d.warp(picture, device="gpu").astype(int) - wanted).max() <= 8


def test_loops_that_are_ended_are_noticed(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = np.full((64, 64, 3), 99, np.uint8)
    d = supple.Deformation(picture.shape[:2], border=None, on_fold="damp").grab(
        (32, 32), by=(4, 0), radius=12, reach=None
    )
    monkeypatch.setattr("supple.engines.wgpu.lattice.TURNS", 1 << 20)  # more than software carries out
    if not gpu.software:
        pytest.skip("a GPU carries out all of them")
    with pytest.warns(DeviceWarning, match="ends loops of many turns"):
        made = d.warp(picture, filter="linear", device="gpu")
    np.testing.assert_array_equal(made, d.warp(picture, filter="linear"))
