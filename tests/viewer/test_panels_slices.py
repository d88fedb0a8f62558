"""The planes of a volume as they are sampled, shaded and seen."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.files.options import VolumeOptions
from supple.gpu.device import Gpu
from supple.media import image
from supple.media import volume as volumes
from supple.render.camera import Camera
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.slices import SOFT_TISSUE, first_window, turned
from supple.viewer.panels.view import TOP
from supple.viewer.tools.planes import RENDERED, planes_of
from supple.viewer.window.options import ViewOptions
from tests import effort
from tests.viewer.windows import DATA, Boxes, opened, written

PULL = Stroke.grab((45, 60, 50), by=(6, -12, 8), radius=25)


def plane_of(array: np.ndarray[Any, Any], axis: int, index: int) -> np.ndarray[Any, Any]:
    return np.take(array, index, axis=2 - axis)


@pytest.mark.parametrize("labels", [False, True])
def test_planes_are_those_of_the_exported_volume(gpu: Gpu, tmp_path: Path, labels: bool) -> None:
    source = DATA / ("brain.nii.gz" if labels else "head.nii.gz")
    options = VolumeOptions(labels=labels)
    recipe = Recipe(strokes=(PULL,))
    view, _ = opened(source, recipe, volume=options)
    supple.warp_file(source, tmp_path / "bent.nii.gz", recipe, volume=options)
    wanted, before = volumes.read(tmp_path / "bent.nii.gz").samples, volumes.read(source).samples
    for axis, index in ((0, 45), (0, 3), (1, 60), (1, 107), (2, 50), (2, 90)):
        made = view.slices.sampled(view.document.deformation, axis, index)
        np.testing.assert_array_equal(made, plane_of(wanted, axis, index))
        np.testing.assert_array_equal(view.slices.sampled(None, axis, index), plane_of(before, axis, index))
    assert (plane_of(wanted, 0, 45) != plane_of(before, 0, 45)).mean() > 0.01


def test_scaled_values_are_those_of_the_exported_volume(gpu: Gpu, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    import nibabel

    stored = rng.integers(0, 3000, (20, 24, 22), np.int16)
    made = nibabel.Nifti1Image(stored, np.diag([1.5, 1.5, 2.0, 1.0]))
    made.header.set_slope_inter(1.0, -1024.0)
    made.to_filename(tmp_path / "ct.nii.gz")
    recipe = Recipe(strokes=(Stroke.grab((10, 12, 11), by=(2, 0, 1), radius=6),))
    view, hand = opened(tmp_path / "ct.nii.gz", recipe)
    assert view.stage.unit == "HU"
    assert view.tools.sight.window == SOFT_TISSUE
    supple.warp_file(tmp_path / "ct.nii.gz", tmp_path / "bent.nii.gz", recipe)
    wanted = volumes.read(tmp_path / "bent.nii.gz").rescaled()
    for axis in range(3):
        np.testing.assert_array_equal(
            view.slices.sampled(view.document.deformation, axis, 11), plane_of(wanted, axis, 11)
        )
    left, top, width, height = view.tools.places[0]
    hand.move(left + 0.4 * width, top + 0.45 * height)
    said = status(view)
    x, y, z = (round(v) for v in view.tools.hover)
    assert f"|   {wanted[z, y, x]:.6g} HU   |" in said


def test_a_ct_is_rendered_without_its_table_unless_it_is_asked_for(gpu: Gpu, boxes: Boxes) -> None:
    _, y, x = np.mgrid[:30, :40, :50]
    samples = np.where((y - 18) ** 2 + (x - 25) ** 2 / 4 < 81, 40, -1000).astype(np.int16)
    samples[:, 31, 8:42] = 300
    view, hand = opened(samples, spacing=(10, 10, 10))
    stage = view.stage
    hand.canvas.draw()
    assert view.slices.sampled(None, 2, 15)[31, 25] == 300  # planes have all
    for table in (False, True, False):
        assert stage.table == table
        assert stage.scene.samples[15, 31, 25] == (300 if table else -1000)
        hand.click(boxes.place(next(name for name in boxes if name.startswith("Table"))))


def status(view: Any) -> str:
    from supple.viewer.panels import overlay

    return overlay.status(view)


def test_the_canvas_shows_planes_the_way_they_are_seen(gpu: Gpu, tmp_path: Path) -> None:
    """Each voxel's centre has the grey of its value, in each plane, before and after."""
    view, hand = opened(DATA / "head.nii.gz", Recipe(strokes=(PULL,)), size=(960, 664))
    tools, bent = view.tools, view.document.deformation
    view.write(str(tmp_path / "seen.png"), True)
    seen = image.read(tmp_path / "seen.png").pixels
    canvas = hand.canvas.draw()
    low, high = tools.sight.window
    for k, plane in enumerate(tools.planes):
        pane, values = tools.pane(k), view.slices.sampled(bent, plane.axis, tools.index[plane.axis])
        assert pane.scale * 2 > 2.5  # pixels of a voxel
        rest = sorted((plane.across, plane.down), reverse=True)
        for step in range(8, 80, 7):
            point = [float(v) for v in tools.index]
            point[plane.across], point[plane.down] = float(step), float(step + 3)
            x, y = pane.to_canvas(tuple(point))
            grey = 255 * (values[int(point[rest[0]]), int(point[rest[1]])] - low) / (high - low)
            y -= TOP
            found = seen[int(y), int(x)].astype(float)
            around = np.ptp(seen[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3].astype(float))
            assert found == pytest.approx(np.full(3, min(max(grey, 0), 255)), abs=3 + 0.5 * around)
    # What is saved is what is on the canvas, but for what lies over it.
    area = np.s_[TOP : TOP + seen.shape[0], : seen.shape[1]]
    assert (np.abs(canvas[area][..., :3].astype(int) - seen.astype(int)).max(axis=-1) > 8).mean() < 0.05
    hand.key("b")
    hand.canvas.draw()
    view.write(str(tmp_path / "split.png"), True)
    split = image.read(tmp_path / "split.png").pixels.astype(int)
    left, top, width, height = (int(v) for v in tools.places[2])
    top -= TOP
    before, after = np.s_[top : top + height, left : left + width // 2 - 4], np.s_[top:, left + width // 2 + 4 :]
    assert np.abs(split[after] - seen[after]).max() <= 1
    assert np.abs(split[before] - seen[before]).mean() > 0.1


def test_the_anatomy_is_where_the_letters_say(gpu: Gpu) -> None:
    """A point at the left, in front and above is at the right of coronal planes, and at the left of sagittal ones."""
    head = volumes.read(DATA / "head.nii.gz")
    geometry = head.geometry
    axial, coronal, sagittal = planes_of(geometry)
    marked = np.zeros(head.samples.shape, np.uint8)
    x, y, z = np.rint(geometry.from_lps((20.0, -60.0, 40.0))).astype(int)  # left, in front, above
    marked[z, y, x] = 1
    for plane, wanted in ((axial, (0, 1)), (coronal, (0, 1)), (sagittal, (0, 0))):
        index = (x, y, z)[plane.axis]
        rows, columns = np.nonzero(turned(plane_of(marked, plane.axis, index), plane))
        height, width = turned(plane_of(marked, plane.axis, index), plane).shape
        assert (int(rows[0] > height / 2), int(columns[0] > width / 2)) == wanted


def test_labels_are_coloured_named_and_not_mixed(gpu: Gpu, tmp_path: Path) -> None:
    labels = np.zeros((24, 26, 28), np.uint8)
    labels[6:18, 6:18, 6:14], labels[6:18, 6:18, 14:22] = 1, 2
    written = sitk.GetImageFromArray(labels)
    for key, text in {"Segment0_LabelValue": "2", "Segment0_Name": "putamen", "Segment0_Color": "1 0.2 0"}.items():
        written.SetMetaData(key, text)
    sitk.WriteImage(written, str(tmp_path / "parts.nrrd"))
    recipe = Recipe(strokes=(Stroke.grab((14, 12, 12), by=(2, 1, 0), radius=6),))
    view, hand = opened(tmp_path / "parts.nrrd", recipe, volume=VolumeOptions(labels=True))
    made = view.slices.sampled(view.document.deformation, 2, 12)
    assert set(np.unique(made)) == {0, 1, 2}
    colours = view.slices.shaded(made, (0.0, 1.0))[..., :3]
    assert len(np.unique(colours.reshape(-1, 3), axis=0)) == 3
    assert (colours[made == 0] == 0).all()
    assert (colours[made == 2] == (255, 51, 0)).all()
    for value, told in ((2, "label 2 (putamen)"), (1, "label 1")):
        rows, columns = np.nonzero(made == value)
        middle = len(rows) // 2
        hand.move(*view.tools.pane(0).to_canvas((float(columns[middle]), float(rows[middle]), 12.0)))
        assert f"|   {told}   |" in status(view)
    view.document.mark_saved()
    seen = view.stage.scene.transfer.of([1, 2])[:, :3]  # the rendering has the same colours
    assert [colours[made == k][0].tolist() for k in (1, 2)] == np.rint(255 * seen).tolist()
    for look, density in (("grey", None), ("labels", (2, 2))):
        view.stage.look(look, density)
        view.refresh()
        hand.canvas.draw()
        assert view._gui.trouble == ""
    assert view.stage.scene.labels.tolist() == [2]


def test_the_status_tells_the_place_of_the_voxel_under_the_pointer(gpu: Gpu) -> None:
    view, hand = opened(DATA / "head.nii.gz")
    head = volumes.read(DATA / "head.nii.gz")
    for k in range(3):
        left, top, width, height = view.tools.places[k]
        hand.move(left + 0.55 * width, top + 0.6 * height)
        said = status(view)
        found = re.search(r"x (\S+)  y (\S+)  z (\S+)   \|   (\S+)   \|   \((\S+), (\S+), (\S+)\) mm RAS", said)
        assert found is not None, said
        index = view.tools.hover
        np.testing.assert_allclose([float(v) for v in found.groups()[:3]], index, atol=0.06)
        x, y, z = np.floor(np.array(index) + 0.5).astype(int)
        assert float(found[4]) == head.samples[z, y, x]
        np.testing.assert_allclose([float(v) for v in found.groups()[4:]], head.geometry.to_world(index), atol=0.06)
    hand.key("\\")
    assert view.tools.pane_under is not None


def test_a_hidden_rendering_is_not_drawn_and_comes_back(gpu: Gpu) -> None:
    view, hand = opened(DATA / "head.nii.gz")
    four = hand.canvas.draw()
    hand.key("1")
    hand.canvas.draw()
    assert view._shot(moving=False).sight.size == (1, 1)
    hand.key("1")
    hand.move(1, 1)
    back = hand.canvas.draw()
    left, top, width, height = (int(v) for v in view.tools.places[RENDERED])
    part = np.s_[top + 24 : top + height - 60, left : left + width]
    assert np.abs(back[part].astype(int) - four[part].astype(int)).max() < 8
    assert view.tools.view == Camera()


def test_a_click_on_the_cube_that_is_drawn_looks_from_there(gpu: Gpu) -> None:
    view, hand = opened(DATA / "head.nii.gz", size=(900, 600))
    view.tools.view = Camera(30, 20)
    for face in view.tools.cube:
        hand.move(5, 40)
        x, y = (np.array(face.middle) + 0.6 * (np.array(face.corners[0]) - face.middle)).astype(int)
        shade = hand.canvas.draw()[y, x, :3]
        assert np.ptp(shade) == 0  # grey, and lit
        assert 100 < shade[0] < 230
        hand.move(x, y)
        hovered = hand.canvas.draw()[y, x, :3].astype(int)
        assert hovered[2] > hovered[0] + 60  # blue under the pointer
        view.tools.view = Camera(30, 20)
        hand.click((x, y))
        assert (view.tools.view.azimuth, view.tools.view.elevation) == (face.azimuth, face.elevation)
        view.tools.view = Camera(30, 20)
    assert view.document.strokes == ()


def test_the_first_window_holds_most_values(gpu: Gpu) -> None:
    head = volumes.read(DATA / "head.nii.gz")
    low, high = first_window(head, "")
    assert low == head.samples.min()
    assert 0.98 < (head.samples <= high).mean() <= 1
    flat = volumes.Volume(np.full((3, 3, 3), np.nan, np.float32), head.geometry)
    assert first_window(flat, "") == (0.0, 1.0)


def test_slow_planes_wait_until_the_pointer_rests(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    view, hand = opened(DATA / "head.nii.gz")
    monkeypatch.setattr("supple.viewer.panels.slices.AT_ONCE", 0.0)
    tools, asked = view.tools, []
    sampled = view.slices.sampled
    monkeypatch.setattr(view.slices, "sampled", lambda d, axis, index: asked.append(axis) or sampled(d, axis, index))
    left, top, width, height = tools.places[0]
    x, y = left + width / 2, top + height / 2
    hand.move(x, y)
    hand.press(x, y)
    hand.canvas.draw()  # the crosshair has moved
    asked.clear()
    hand.move(x + 20, y, 1)
    hand.canvas.draw()
    assert tools.dragging
    assert set(asked) == {2}  # the axial plane
    monkeypatch.setattr("supple.viewer.panels.view.SETTLED", 0.0)  # it rests
    hand.canvas.draw()
    assert set(asked) == {0, 1, 2}
    asked.clear()
    hand.move(x + 40, y, 1)
    hand.release(x + 40, y)
    hand.canvas.draw()
    assert set(asked) == {0, 1, 2}


NOSE = (45.0, 96.0, 40.0)


def marked(pixels: np.ndarray[Any, Any], place: tuple[float, float]) -> bool:
    """Whether a landmark is drawn at a place of the canvas."""
    x, y = round(place[0]), round(place[1])
    near = pixels[y - 2 : y + 3, x - 2 : x + 3, :3].astype(int)
    return bool((np.abs(near - (0x60, 0xD0, 0xF0)).max(axis=-1) < 12).mean() > 0.5)


def test_landmarks_are_shown_before_and_after(gpu: Gpu, tmp_path: Path) -> None:
    head = volumes.read(DATA / "head.nii.gz")
    x, y, z = head.geometry.to_world(NOSE)
    (tmp_path / "marks.csv").write_text(f"name,r,a,s\nnasion,{x},{y},{z}\n")
    recipe = Recipe(border=None, strokes=(Stroke.grab(NOSE, by=(0, -6, 6), radius=20),))
    view, hand = opened(DATA / "head.nii.gz", recipe, points=tmp_path / "marks.csv")
    assert view.document.state.marks.names == ("nasion",)
    after = view.document.state.marks.moved(view.document.deformation)[0]
    np.testing.assert_allclose(after, (45, 90, 46), atol=0.01)
    tools = view.tools
    tools.sight = tools.sight.at(tuple(after), tools.sizes)
    hand.move(1, 1)
    view.refresh()
    seen = hand.canvas.draw()
    assert all(marked(seen, tools.pane(k).to_canvas(tuple(after))) for k in range(3))
    x, y = (round(v) for v in tools.projected(tuple(after)))  # it is within the head: hollow, and said how deep
    edge = seen[y - 6 : y + 7, x - 6 : x + 7, :3].astype(int)
    assert not marked(seen, (x, y))
    assert (edge[..., 2] - edge[..., 0] > 20).sum() >= 12
    hand.send("key_down", key="\\")
    tools.sight = tools.sight.at(NOSE, tools.sizes)
    view.refresh()
    seen = hand.canvas.draw()
    assert all(marked(seen, tools.pane(k).to_canvas(NOSE)) for k in range(3))
    assert not marked(seen, tools.pane(0).to_canvas(tuple(after)))
    hand.send("key_up", key="\\")
    tools.sight = tools.sight.at((45, 60, 40), tools.sizes)  # far from the coronal plane
    seen = hand.canvas.draw()
    assert not marked(seen, tools.pane(1).to_canvas(tuple(after)))


@pytest.mark.parametrize(
    "size",
    [
        (1280, 720),
        (640, 480),
        *(pytest.param(size, marks=effort.soak("words in other windows")) for size in [(1600, 1000), (900, 540)]),
    ],
)
def test_no_words_lie_on_others(
    gpu: Gpu, size: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "marks.csv").write_text("name,i,j,k\nnasion,45,104,28\nAC,45,63,36\nPC,45,49,37\n")
    view, hand = opened(DATA / "head.nii.gz", Recipe(border=None), size=size, points=tmp_path / "marks.csv")
    boxes = written(monkeypatch)
    hand.move(1, 1)
    view.tools.sight = view.tools.sight.at((87, 71, 34), view.tools.sizes)  # long words: A 17.0 mm
    view.refresh()
    hand.canvas.draw()
    assert {"nasion", "AC", "PC", "axial", "50 mm"} <= {said.split("  ")[0] for said, *_ in boxes}
    for k, (said, left, top, right, bottom) in enumerate(boxes):
        for other, a, b, c, d in boxes[k + 1 :]:
            assert left >= c or a >= right or top >= d or b >= bottom, (said, other)


def test_landmarks_are_for_volumes(gpu: Gpu, tmp_path: Path) -> None:
    (tmp_path / "marks.csv").write_text("i,j,k\n1,2,3\n")
    with pytest.raises(supple.SuppleError, match=r"^points is for files of volumes, and .*coffee.jpg is none"):
        opened(DATA / "coffee.jpg", points=tmp_path / "marks.csv")
    with pytest.raises(supple.SuppleError, match="convention is that of points, and there are none"):
        opened(DATA / "head.nii.gz", convention="RAS")


def test_a_script_shows_landmarks_as_the_command_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from supple.viewer.window import launch

    taken: list[ViewOptions] = []
    monkeypatch.setattr(launch, "show", lambda source, recipe, *, options: taken.append(options))
    supple.view(DATA / "head.nii.gz", points=tmp_path / "marks.csv", convention="RAS")
    assert (taken[0].points, taken[0].convention) == (tmp_path / "marks.csv", "RAS")


def test_the_curve_is_the_opacity_of_the_transfer_function(gpu: Gpu) -> None:
    from supple.render.transfer import TransferFunction
    from supple.viewer.panels.volume import _opacities as opacities

    view, hand = opened(DATA / "head.nii.gz", size=(468, 1400))
    hand.canvas.draw()
    assert view._gui.trouble == ""
    transfer = view.stage.scene.transfer
    assert isinstance(transfer, TransferFunction)
    known = opacities(view.stage, transfer, 246)  # a point for each value
    assert view.stage.scene.range == (0, 245)
    places, parts = zip(*[(245 * p[0], p[4]) for p in transfer.points], strict=True)
    np.testing.assert_allclose(known, np.interp(np.arange(246), places, parts), atol=2e-3)
