"""Labels rendered with a colour each, and volumes in their own colours, against slow references and flat phantoms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple import _core
from supple.errors import SuppleError, VolumeWarning
from supple.files.jobs import Job
from supple.files.options import VolumeOptions
from supple.files.renders import RenderOptions, render_file
from supple.render.appearance import largest
from supple.render.camera import Camera
from supple.render.labels import LabelColours, labels_in, numbered, palette
from supple.render.picture import Rendering
from supple.render.scene import Scene
from supple.render.transfer import TransferFunction, transfer_of
from supple.space.geometry import Geometry
from tests.refusals import refused

Floats = npt.NDArray[np.float64]

SHAPE, SIZE = (20, 24, 22), (60, 60)
GEOMETRY = Geometry(spacing=(1.0, 1.2, 1.5))
CAMERA = Camera(35, 20, roll=10)
OPAQUE = TransferFunction(((59, 0, 0, 0, 0), (60, 0, 0, 0, 1), (255.0, 0, 0, 0, 1)))
MODES = ("plain", "exact", "buffered")


def regions(seed: int = 0, count: int = 4) -> npt.NDArray[np.uint8]:
    """The nearest of some points: regions of labels from 0 on."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 1, (3 * count, 3)) * SHAPE
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), axis=-1)
    away = np.linalg.norm(grid[..., None, :] - places, axis=-1)
    return np.asarray(away.argmin(axis=-1) % count, np.uint8)


def two(outer: int = 1, inner: int = 3) -> npt.NDArray[np.uint16]:
    """A ball in 0, of two halves."""
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in SHAPE), indexing="ij")
    made = np.where(x + 0.5 * y > 1, inner, outer)
    return np.where(x**2 + (1.2 * y) ** 2 + (1.5 * z) ** 2 < 8.5**2, made, 0).astype(np.uint16)


def bent() -> supple.Deformation:
    d = supple.Deformation(SHAPE, spacing=GEOMETRY.spacing, border=None, on_fold="damp")
    return d.grab((11, 12, 10), by=(5, -4, 3), radius=9)


def scene_of(samples: npt.NDArray[Any], mode: str = "plain", **options: Any) -> Scene:
    known: dict[str, Any] = {"transfer": "labels", **options}
    if mode != "plain":
        known |= {"mode": mode, "deformation": bent()}
    return Scene(samples, GEOMETRY, **known)


def colours_of(picture: Rendering) -> set[tuple[int, ...]]:
    pixels = picture.pixels()
    return {tuple(row) for row in pixels[pixels[..., 3] > 0].tolist()}


def table_colours(colours: LabelColours, labels: list[int]) -> set[tuple[int, ...]]:
    return {tuple(np.rint(255 * row).astype(int).tolist()) for row in colours.of(labels)}


def near(one: Rendering, other: Rendering) -> float:
    """The part of pixels in which something is seen that differ by less than a tenth of the range."""
    a, b = (p.pixels((0.5, 0.5, 0.5)).astype(float) for p in (one, other))
    seen = (one.light[..., 3] > 0) | (other.light[..., 3] > 0)
    return float((np.abs(a - b).max(axis=-1) < 26)[seen].mean())


# ---- samples -------------------------------------------------------------------------------------------------------


def test_a_label_is_the_heaviest_of_the_visible_ones_and_its_slope_that_of_the_smoothed_region() -> None:
    labels = regions()
    points = np.random.default_rng(1).uniform(0, 1, (30, 3)) * (np.array(SHAPE[::-1]) - 1)
    points[::9, 0], points[4::9, 2] = 0, SHAPE[0] - 1  # at faces
    points = points.astype(np.float32).astype(np.float64)
    found = np.empty((len(points), 4), np.float32)
    _core.look_up(labels, points.astype(np.float32), found, labelled=True)

    def smoothed(p: Floats, own: int) -> float:
        """How far a label reaches, 0, with the others at -0.2 and what is not seen at -1: by wide B-splines."""
        total = 0.0
        first = np.floor(p).astype(int) - 2
        for step in np.ndindex(6, 6, 6):
            x, y, z = np.clip(first + step, 0, np.array(SHAPE[::-1]) - 1)
            away = np.abs(p - (first + step)) / 1.5
            weight = np.where(away < 1, 2 / 3 - away**2 + away**3 / 2, np.maximum(2 - away, 0) ** 3 / 6).prod()
            total += weight * (0.0 if labels[z, y, x] == own else -0.2 if labels[z, y, x] else -1.0)
        return total

    checked = 0
    for p, (label, *slope) in zip(points, found.tolist(), strict=True):
        cell = np.minimum(np.floor(p).astype(int), np.array(SHAPE[::-1]) - 2)
        weights = np.zeros(4)
        for step in np.ndindex(2, 2, 2):
            x, y, z = cell + step
            weights[labels[z, y, x]] += np.where(step, p - cell, 1 - (p - cell)).prod()
        best = 0 if weights[0] >= 0.5 else 1 + int(weights[1:].argmax())
        others = np.sort(weights[1:])
        if abs(weights[0] - 0.5) < 1e-4 or (best and others[-1] - others[-2] < 1e-4):
            continue
        checked += 1
        assert label == best
        inner = np.clip(p, 1e-3, np.array(SHAPE[::-1]) - 1 - 1e-3)
        if (inner != p).any():
            continue
        for axis in range(3):
            e = np.eye(3)[axis] * 1e-4
            change = 1.5 * (smoothed(p + e, best) - smoothed(p - e, best)) / 2e-4  # from knot to knot
            assert abs(slope[axis] - change) < 2e-4
    assert checked > 24


def test_within_a_region_there_is_no_slope_at_all() -> None:
    found = np.empty((500, 4), np.float32)
    points = np.random.default_rng(5).uniform(0, 1, (500, 3)) * (np.array(SHAPE[::-1]) - 1)
    _core.look_up(np.full(SHAPE, 7, np.uint16), points.astype(np.float32), found, labelled=True)
    assert (found[:, 0] == 7).all()
    assert not found[:, 1:].any()


@pytest.mark.parametrize("dtype", ["uint8", "int16", "int64", "float64"])
def test_visible_labels_are_numbered_in_order(dtype: str) -> None:
    known = {"uint8": [0, 3, 200], "int16": [0, -5, 7, 30000], "float64": [0, 2, 1 << 40], "int64": [0, 9, 1 << 50]}
    drawn = np.random.default_rng(2).choice(known[dtype], (5, 6, 7)).astype(dtype)
    labels = labels_in(drawn)
    assert labels.tolist() == [k for k in np.unique(drawn).tolist() if k]
    visible = labels[labels > 0][-2:]
    made = numbered(drawn, visible)
    for k, label in enumerate(visible.tolist(), 1):
        np.testing.assert_array_equal(made == k, drawn == label)
    np.testing.assert_array_equal(made == 0, ~np.isin(drawn, visible))


def test_fractions_are_no_labels() -> None:
    with pytest.raises(SuppleError, match=r"labels must be whole numbers .* found 0.5"):
        Scene(np.full((4, 5, 6), 0.5, np.float32), transfer="labels")
    with pytest.raises(SuppleError, match=r"labels, .Z, H, W., for colours of labels"):
        Scene(np.zeros((4, 5, 6, 3), np.uint8), transfer="labels")
    with pytest.raises(SuppleError, match=r"a projection .maximum. is of values, and labels have none"):
        Scene(two(), transfer="labels", projection="maximum")


# ---- pictures ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_opaque_labels_have_their_two_colours_and_no_third(mode: str) -> None:
    picture = scene_of(two(), mode, shaded=False).render(CAMERA, SIZE)
    assert colours_of(picture) == table_colours(LabelColours(), [1, 3])


def test_hidden_labels_do_not_show_at_surfaces_of_others() -> None:
    labels = regions()
    colours = LabelColours({1: (1, 0, 0, 1), 3: (0, 0, 1, 1)})
    for density, kept in ((None, [1, 3]), ((2, 9), [3]), ((3, 3), [3])):
        scene = scene_of(labels, transfer=colours, density=density, shaded=False)
        assert scene.labels is not None
        assert scene.labels.tolist() == kept
        assert colours_of(scene.render(CAMERA, SIZE)) == table_colours(colours, kept)
    assert scene_of(labels, transfer=colours, density=(5, 9)).is_empty


@pytest.mark.parametrize("kind", ["labels", "colours"])
def test_a_deformed_scene_is_that_of_the_warped_volume(kind: str) -> None:
    samples: npt.NDArray[Any] = two() if kind == "labels" else cube(np.uint8, 4)[0]
    options: dict[str, Any] = {"transfer": "labels" if kind == "labels" else OPAQUE, "shaded": False, "step": 1.5}
    pictures = {m: scene_of(samples, m, **options).render(CAMERA, SIZE) for m in MODES}
    assert near(pictures["exact"], pictures["buffered"]) > 0.85
    assert near(pictures["exact"], pictures["plain"]) < 0.82
    warped = bent().warp(samples, filter="nearest" if kind == "labels" else "linear")
    assert near(pictures["buffered"], scene_of(warped, **options).render(CAMERA, SIZE)) > 0.999


def test_the_surface_of_a_ball_is_smooth_and_lit_as_one() -> None:
    n, radius = 41, 15.0
    away = np.linalg.norm(np.stack(np.meshgrid(*[np.arange(n) - 20.0] * 3, indexing="ij")), axis=0)
    scene = Scene((away < radius).astype(np.uint8), transfer="labels")
    camera, size = Camera(0, 0, distance=400, field_of_view=5), (61, 61)
    picture, view = scene.render(camera, size), scene.view(camera, size)
    lamp, wanted, found, off = scene._look(view).light, [], [], []
    tint = LabelColours().table([1], 1.0)[0, 1]
    for y, x in np.ndindex(61, 61):
        if np.hypot(x - 30, y - 30) > 20:
            continue
        along = view.direction(x, y)
        at = view.eye + picture.depth[y, x] * along - 20
        off.append(np.linalg.norm(at) - radius)
        normal, half = at / np.linalg.norm(at), lamp - along
        shine = 0.2 * (normal @ half / np.linalg.norm(half)) ** 16
        wanted.append(tint * (0.15 + 0.8 * abs(normal @ lamp)) + shine)
        found.append(picture.light[y, x, 1])
    assert len(off) > 1000
    assert np.abs(off).mean() < 0.25  # voxels
    assert np.sqrt(np.mean(np.subtract(found, wanted) ** 2)) < 0.5 * np.std(wanted)


def test_another_look_at_labels_is_that_of_a_new_scene() -> None:
    labels, colours = regions(), LabelColours({1: (1, 0, 0, 1), 2: (0, 1, 0, 0.2)})
    scene = scene_of(labels, "buffered", transfer="grey", step=0.5)
    for transfer in ("labels", colours, "grey"):
        scene = scene.seen_through(transfer)
        wanted = scene_of(labels, "buffered", transfer=transfer, step=0.5)
        np.testing.assert_array_equal(scene.render(CAMERA, SIZE).light, wanted.render(CAMERA, SIZE).light)


def test_the_largest_part_of_labels_and_of_colours() -> None:
    labels = np.zeros(SHAPE, np.int32)
    labels[2:4, 2:4, 2:4], labels[8:14, 8:14, 8:11], labels[8:14, 8:14, 11:14] = 5, 5, 9
    kept = largest(labels, "labels")
    assert kept.dtype == labels.dtype
    np.testing.assert_array_equal(kept, np.where(np.arange(SHAPE[0])[:, None, None] > 5, labels, 0))
    colours = np.stack([labels * 20] * 3, axis=-1).astype(np.uint8)
    np.testing.assert_array_equal(largest(colours, OPAQUE), np.stack([kept * 20] * 3, axis=-1))


# ---- tables of colours ---------------------------------------------------------------------------------------------


def test_tables_of_slicer_freesurfer_and_itk_snap_are_read() -> None:
    slicer = LabelColours.from_text("# Table\n0 background 0 0 0 0\n1 tissue 128 174 128 255\n7 a b 255 0 51 51\n")
    assert slicer.colours == {0: (0, 0, 0, 0), 1: (128 / 255, 174 / 255, 128 / 255, 1), 7: (1, 0, 0.2, 0.2)}
    lut = LabelColours.from_text("\n#No. Name: R G B A\n0   Unknown  0 0 0 0\n17  Left-Hippocampus 220 216 20 0\n")
    np.testing.assert_allclose(lut.of([0, 17, 18]), [[0] * 4, [220 / 255, 216 / 255, 20 / 255, 1], [0] * 4])
    snap = '    0     0    0    0        0  0  0    "Clear Label"\n    2   255  0  51  0.4  1  1  "Label \'2\'"\n'
    snap += '3 1 2 3 1 0 1 "hidden"\n'
    read = LabelColours.from_text(snap).of([2, 3])
    np.testing.assert_allclose(read, [[1, 0, 0.2, 0.4], [1 / 255, 2 / 255, 3 / 255, 0]])
    assert LabelColours.from_text(snap.splitlines()[2]).of([3])[0, 3] == 0  # all of ITK-SNAP's may be hidden


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("1 tissue 1 2", "t.ctbl, line 1, is '1 tissue 1 2': a colour table has lines of a label"),
        ("# x\n1 a 256 0 0 255", "t.ctbl, line 2, .* must not exceed 255"),
        ('1 1 1 1 . 1 1 "a"', "t.ctbl, line 1, is .*: a colour table has lines"),
        ('1 1 1 1 2.5 1 1 "a"', "t.ctbl, line 1, .* must not exceed 255"),
        ("1 a 1 0 0 255\n1 b 1 0 0 255", "t.ctbl, line 2, gives label 1 another time"),
        ("# nothing", "t.ctbl has no colours"),
    ],
)
def test_other_tables_are_refused_with_their_line(text: str, told: str) -> None:
    refused(LabelColours.from_text, text, "t.ctbl", match=told)


def test_a_table_that_is_written_is_read_as_it_was(tmp_path: Path) -> None:
    labels = [3, 1 << 30, 5]
    (tmp_path / "a.ctbl").write_text(LabelColours().to_ctbl(labels))
    read = transfer_of(tmp_path / "a.ctbl")
    assert isinstance(read, LabelColours)
    np.testing.assert_allclose(read.of(labels), LabelColours().of(labels), atol=0.5 / 255 + 1e-9)
    refused(transfer_of, tmp_path / "none.ctbl", match=r"cannot read .*none.ctbl.*name a colour table")
    (tmp_path / "a.ctbl").write_bytes(b"1 \xff 0 0 0 255\n")
    refused(transfer_of, tmp_path / "a.ctbl", match="UTF-8")


def test_colours_of_the_palette_are_distinct_and_do_not_change() -> None:
    known = palette(np.arange(1, 41))
    away = np.linalg.norm(known[:, None] - known, axis=-1) + 9 * np.eye(40)
    assert away.min() > 0.05
    assert away[:8, :8].min() > 0.15
    assert known.min() >= 0
    assert known.max() <= 1
    np.testing.assert_allclose(palette(7), known[6], atol=1e-12)


# ---- volumes of colours --------------------------------------------------------------------------------------------


def cube(dtype: Any, channels: int = 3) -> tuple[npt.NDArray[Any], dict[str, tuple[int, ...]]]:
    """A block whose faces have a colour each, three voxels deep; around it, there is black."""
    made = np.zeros((*SHAPE, channels), np.uint8)
    faces = {"front": (200, 30, 60), "left": (20, 160, 40), "top": (90, 100, 250)}
    made[3:17, 4:20, 4:18, :3] = 128
    made[3:17, 4:7, 4:18, :3], made[3:17, 7:20, 15:18, :3] = faces["front"], faces["left"]
    made[14:17, 7:20, 4:15, :3] = faces["top"]
    if channels == 4:
        made[..., 3] = np.where(made[..., :3].any(axis=-1), 255, 0)
        made[made[..., 3] == 0] = (255, 255, 255, 0)  # not seen, and not mixed in
    if dtype == np.uint8:
        return made, faces
    return (made * np.uint16(257) if dtype == np.uint16 else made / dtype(255)).astype(dtype), faces


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_faces_of_a_block_have_their_colours(dtype: Any, channels: int) -> None:
    samples, faces = cube(dtype, channels)
    scale = 257.0 if dtype != np.uint8 else 1.0
    points = tuple((p[0] * scale, *p[1:]) for p in OPAQUE.points)
    scene = scene_of(samples, transfer=TransferFunction(points), shaded=False, step=1.5)  # type: ignore[arg-type]
    for camera, name in ((Camera(0, 0), "front"), (Camera(90, 0), "left"), (Camera(0, 90), "top")):
        pixels = scene.render(camera, SIZE).pixels()
        assert np.abs(pixels[30, 30].astype(int) - (*faces[name], 255)).max() <= 1, name
    options: dict[str, Any] = {"transfer": scene.transfer, "shaded": False, "step": 1.5}
    moved = scene_of(samples, "exact", **options).render(Camera(0, 0), SIZE).pixels()  # once: colours end in black
    assert np.abs(moved[30, 30].astype(int) - (*faces["front"], 255)).max() <= 1


@pytest.mark.parametrize(
    ("samples", "told"),
    [
        (np.zeros((4, 5, 6, 3), np.int16), "int16 from 0 to 0"),
        (np.linspace(-2, 3, 360, dtype=np.float32).reshape(4, 5, 6, 3), "float32 from -2 to 3"),
        (np.zeros((4, 5, 6, 2), np.uint8), r"uint8 of shape \(4, 5, 6, 2\)"),
    ],
)
def test_what_are_no_colours_is_refused(samples: npt.NDArray[Any], told: str) -> None:
    refused(Scene, samples, match=told)


SEGMENTS = {
    "Segment0_ID": "Segment_1", "Segment0_LabelValue": "3", "Segment0_Color": "0.5 0.25 1",
    "Segment1_ID": "Segment_2", "Segment1_LabelValue": "1", "Segment1_Color": "1 0 0",
    "Segment2_ID": "Segment_3", "Segment2_LabelValue": "7",
}  # fmt: skip


def test_a_segmentation_has_the_colours_of_its_segments(tmp_path: Path) -> None:
    labels = two()
    labels[:3] = 7
    labels[-3:] = 9
    image = sitk.GetImageFromArray(labels)
    for name, text in SEGMENTS.items():
        image.SetMetaData(name, text)
    sitk.WriteImage(image, str(tmp_path / "parts.seg.nrrd"))
    scene = render_file(Job(tmp_path / "parts.seg.nrrd", tmp_path / "a.png"), options=RenderOptions(size=SIZE))
    assert isinstance(scene.transfer, LabelColours)
    assert scene.transfer.colours == {
        1: (1.0, 0.0, 0.0, 1.0), 3: (0.5, 0.25, 1.0, 1.0),
        7: pytest.approx((*palette(7), 1.0)), 9: pytest.approx((*palette(9), 1.0)),
    }  # fmt: skip
    # Also without --labels, nobody takes them for values.
    with pytest.warns(VolumeWarning, match=r"parts.seg.nrrd is a label map, and its labels are mixed"):
        supple.warp_file(tmp_path / "parts.seg.nrrd", tmp_path / "b.seg.nrrd", strokes(), force=True)
    supple.warp_file(
        tmp_path / "parts.seg.nrrd", tmp_path / "b.seg.nrrd", strokes(), force=True, volume=VolumeOptions(labels=True)
    )
    kept = sitk.ReadImage(str(tmp_path / "b.seg.nrrd"))
    assert {name: kept.GetMetaData(name) for name in SEGMENTS} == SEGMENTS


def test_layers_of_segments_are_no_colours(tmp_path: Path) -> None:
    image = sitk.GetImageFromArray(np.stack([two().astype("u1")] * 3, axis=-1), isVector=True)
    image.SetMetaData("Segment0_LabelValue", "1")
    sitk.WriteImage(image, str(tmp_path / "layers.seg.nrrd"))
    with pytest.raises(SuppleError, match=r"layers.seg.nrrd is a segmentation in 3 layers"):
        render_file(Job(tmp_path / "layers.seg.nrrd", tmp_path / "a.png"))
    with pytest.warns(VolumeWarning, match=r"layers.seg.nrrd is a label map"):
        supple.warp_file(tmp_path / "layers.seg.nrrd", tmp_path / "b.nrrd", strokes())


@pytest.mark.parametrize(("name", "text"), [("LabelValue", "one"), ("Color", "1 0"), ("Color", "red")])
def test_segments_that_are_listed_wrongly_are_told(name: str, text: str) -> None:
    with pytest.raises(SuppleError, match=rf"segment 4 has .*{text}.*: these should be"):
        LabelColours.of_segments({"Segment4_ID": "a", f"Segment4_{name}": text}, [1])


def strokes() -> supple.Recipe:
    return supple.Recipe(border=None, strokes=(supple.Stroke(at=(11, 12, 10), by=(3, -2, 1), radius=9),))


def test_labels_below_zero_and_far_apart_have_colours_of_their_own() -> None:
    many = np.array([-6, 1, 2, 30000, 60000, 10000, 20000, 40000])
    colours = palette(many)
    for k in range(len(many)):
        away = np.abs(np.delete(colours, k, axis=0) - colours[k]).max(axis=1)
        assert away.min() > 0.02
    read = LabelColours.from_text(LabelColours().to_ctbl(many))
    np.testing.assert_allclose(read.of(many)[:, :3], colours, atol=0.5 / 255 + 1e-9)
    refused(labels_in, np.array([[[1, 1 << 63]]], np.uint64), match="labels must be whole numbers up to")
