"""A volume beside a fixed one in the window: compared, marked, pulled where a registration failed, and exported."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.fields import Field, Placed
from supple.files import warp_file
from supple.files.recipes import read_recipe
from supple.gpu.device import Gpu
from supple.media import volume as volumes
from supple.space.affine import Affine
from supple.strokes import Recipe, Stroke
from supple.viewer.panels import overlay
from supple.viewer.panels.view import LINE, TOP, WIDE
from supple.viewer.tools.comparing import MODES, Comparison
from supple.viewer.tools.planes import FIXED, RENDERED
from supple.viewer.window.launch import SIZE
from tests.viewer.windows import DATA, Boxes, Hand, a_screen, imgui, opened, viewing, wait_for, written

OFF = np.array([6.0, -5.0, 4.0])  # millimetres, in LPS, by which the field is wrong
PLACE = np.array([[0.96, 0.28, 0.0, 40.0], [-0.28, 0.96, 0.0, -15.0], [0.0, 0.0, 1.0, 8.0]])  # of the moving head
WRONG = (22, 27, 26)  # the voxel of the fixed head about which it is


@pytest.fixture
def heads(volume: Path, tmp_path: Path) -> dict[str, Any]:
    """A head of 4 mm, the same head on another grid elsewhere, and a registration that fails at a place."""
    fixed = sitk.ReadImage(str(volume), sitk.sitkFloat32)
    affine = sitk.AffineTransform(3)
    affine.SetMatrix(PLACE[:, :3].ravel().tolist())
    affine.SetTranslation(PLACE[:, 3].tolist())
    grid = sitk.Image([66, 72, 60], sitk.sitkFloat32)
    grid.SetSpacing((3.6, 3.6, 4.0))
    grid.SetDirection(np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]).ravel().tolist())
    middle = fixed.TransformContinuousIndexToPhysicalPoint([(n - 1) / 2 for n in fixed.GetSize()])
    corner = np.array(grid.TransformContinuousIndexToPhysicalPoint([32.5, 35.5, 29.5]))
    grid.SetOrigin((np.array(affine.TransformPoint(middle)) - corner).tolist())
    moving = sitk.Resample(fixed, grid, affine.GetInverse(), sitk.sitkBSpline, 0.0)
    sitk.WriteImage(
        sitk.Cast(sitk.Clamp(moving, sitk.sitkFloat32, 0, 255), sitk.sitkUInt8), str(tmp_path / "moving.nii.gz")
    )
    own = volumes.outline_of(volume).grid
    places = own.positions(np.moveaxis(np.indices(own.shape)[::-1], 0, -1))
    away = np.linalg.norm(places - own.positions(WRONG), axis=-1)
    field = Field((np.exp(-((away / 18) ** 2))[..., None] * OFF).astype(np.float32), own)
    field.write(tmp_path / "1Warp.nii.gz", "itk")
    maps = (Placed(Affine(PLACE), name="affine"), Placed(field, name="1Warp"))
    return {"moving": tmp_path / "moving.nii.gz", "fixed": volume, "maps": maps, "grid": own}


def registered(heads: dict[str, Any], recipe: Recipe | None = None, **options: Any) -> tuple[Any, Hand]:
    recipe = recipe or Recipe(border=None)
    return opened(heads["moving"], recipe, maps=heads["maps"], fixed=heads["fixed"], **options)


def true(heads: dict[str, Any], point: Any) -> Any:
    """Where a voxel of the fixed head is in the moving one, in millimetres."""
    return heads["grid"].positions(point) @ PLACE[:, :3].T + PLACE[:, 3]


def test_planes_are_those_of_the_export_beside_those_of_the_fixed_volume(gpu: Gpu, heads: Any, tmp_path: Path) -> None:
    recipe = Recipe(border=None, strokes=(Stroke.grab((22, 27, 26), by=(1, -2, 1), radius=20),))
    view, hand = registered(heads, recipe)
    tools = view.tools
    assert set(tools.places) == {0, 1, 2, 4, 5, 6}
    options = supple.GridOptions(heads["fixed"], strokes=True)
    warp_file(heads["moving"], tmp_path / "bent.nii.gz", recipe, maps=heads["maps"], grid=options)
    wanted, fixed = (volumes.read(path).samples for path in (tmp_path / "bent.nii.gz", heads["fixed"]))
    assert wanted.std() > 20
    for axis, index in ((0, 22), (1, 27), (2, 26)):
        made = view.slices.sampled(view.document.deformation, axis, index)
        np.testing.assert_array_equal(made, np.take(wanted, index, axis=2 - axis))
        # Where the registration holds, it is the fixed head.
        before = view.slices.sampled(None, axis, index).astype(float)
        there = np.take(fixed, index, axis=2 - axis).astype(float)
        assert np.corrcoef(before.ravel(), there.ravel())[0, 1] > 0.97
    seen = hand.canvas.draw()
    for k in range(3):  # six panes, whose pictures are much alike
        one, other = (cut(seen, tools.places[each]) for each in (k, k + FIXED))
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.85
        assert one.std() > 20
    # One that is large has the fixed one beside it, and the rendering the canvas to itself.
    hand.key("3")
    assert set(tools.places) == {2, 2 + FIXED}
    hand.key("4")
    assert set(tools.places) == {RENDERED}


def cut(pixels: Any, place: tuple[float, float, float, float]) -> Any:
    left, top, width, height = map(round, place)
    return pixels[top + 30 : top + height - 40, left + 20 : left + width - 20, :3].astype(float)


def test_both_are_compared_in_one_picture(gpu: Gpu, heads: Any) -> None:
    view, hand = registered(heads)
    tools, pictures = view.tools, {}
    for mode in (*list(MODES)[1:], "beside"):
        hand.key("x")
        assert tools.comparison.mode == mode
        hand.canvas.draw()
        pictures[mode] = cut(hand.canvas.draw(), tools.places[0])
    assert RENDERED not in tools.places
    coloured = np.ptp(pictures["colours"], axis=-1)
    assert np.ptp(pictures["blend"], axis=-1).mean() < 0.3 * coloured.mean()
    grey = np.median(pictures["difference"])
    assert 120 < grey < 135
    assert (np.abs(pictures["difference"] - grey) > 15).mean() < 0.3


def test_a_checkerboard_has_squares_of_millimetres_and_a_blend_a_share() -> None:
    bent, fixed = (np.full((30, 40, 4), level, np.uint8) for level in (100, 200))
    made = Comparison((0, 1), "checkerboard", {"checkerboard": 20.0}).compared(bent, fixed, (4.0, 2.0))
    assert [int(made[r, c, 0]) for r, c in ((0, 0), (0, 9), (0, 10), (4, 0), (5, 0), (5, 10))] == [
        100, 100, 200, 100, 200, 100,
    ]  # fmt: skip
    made = Comparison((0, 1), "blend", {"blend": 0.25}).compared(bent, fixed, (1, 1))
    assert (made[..., :3] == 125).all()
    made = Comparison((0, 1), "difference", {"difference": 0.5}).compared(bent, fixed, (1, 1))
    assert (made[..., :3] == 102).all()  # 127.5 - 25


def test_what_a_registration_missed_is_pulled_by_landmarks_and_exported_as_one_field(
    gpu: Gpu, heads: Any, tmp_path: Path, boxes: Boxes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job: pairs by clicks, a pull, a drag, the recipe, and one field, by which ITK maps the points."""
    view, hand = registered(heads, size=(1280, 800))
    tools, document = view.tools, view.document
    tools.sight = tools.sight.at(WRONG, tools.sizes)
    hand.canvas.draw()
    # What is at WRONG in the fixed head is seen elsewhere in the moving one, as the field is wrong there.
    through = supple.Deformation(heads["grid"], border=None).behind(heads["maps"])
    where = through.forward(heads["grid"].indices(true(heads, WRONG)))
    assert 6 < np.linalg.norm((where - WRONG) * 4.0) < 10
    hand.key("l")
    hand.key("Escape")
    assert not tools.marking
    hand.key("l")
    assert "click a point in the bent volume" in overlay.status(view)
    axial = tools.pane(0)
    tools.sight = tools.sight.at(tuple(where), tools.sizes)
    hand.canvas.draw()
    hand.click(tools.pane(0).to_canvas(tuple(where)))
    assert "same point in the fixed volume" in overlay.status(view)
    assert view.document.state.marks.open == 0
    tools.sight = tools.sight.at(WRONG, tools.sizes)
    hand.canvas.draw()
    hand.click(tools.pane(FIXED).to_canvas(WRONG))
    assert not tools.marking
    assert axial.plane.name == "axial"
    (residual,) = view.document.state.marks.residuals(document.deformation)
    # Undo takes back a click as it does a stroke.
    assert [state.made_by for state in document.steps[1:]] == ["Set landmark 1"] * 2
    shown = []
    for step in (document.undo, document.undo, document.redo, document.redo):
        step()
        shown.append((view.document.state.marks.names, len(view.document.state.marks.pairs)))
    assert shown == [(("1",), 0), ((), 0), (("1",), 0), (("1",), 1)]
    assert residual == pytest.approx(np.linalg.norm((np.round(where[2]) - where[2], 0, 0)) * 4 + 8.4, abs=2.0)
    view.sections["Brush"] = False
    for _ in range(3):
        hand.canvas.draw()
    tools.radius = 30.0
    hand.click(boxes.place("Pull them together"))
    assert len(document.strokes) == 1
    assert view.document.state.marks.residuals(document.deformation)[0] < 0.01
    # Another place is corrected by a drag in the plane, as any stroke; undo takes it back, and redo makes it again.
    start = tools.pane(2).to_canvas((22, 40, 26))
    hand.drag(start, (start[0] + 12, start[1]))
    assert len(document.strokes) == 2
    hand.key("z", "Control")
    assert len(document.strokes) == 1
    view.commands.save(tmp_path / "strokes.json")
    # The field is chosen in the dialog, with its convention.
    view.commands.ask("export")
    hand.canvas.draw()
    hand.canvas.draw()
    assert view.commands.asked.path.endswith("moving-bent.nii.gz")
    chosen(monkeypatch, "##write", 1)
    hand.canvas.draw()
    assert view.commands.field == "itk"
    assert view.commands.asked.path.endswith("moving-field.nii.gz")
    view.commands.asked.path = str(tmp_path / "field.nii.gz")
    view.commands.answer("Export")
    wait_for(lambda: view.commands.export.done)
    assert view.commands.export.error is None
    led = sitk.DisplacementFieldTransform(sitk.ReadImage(str(tmp_path / "field.nii.gz"), sitk.sitkVectorFloat64))
    place = heads["grid"].positions(WRONG)
    assert (
        np.linalg.norm(np.array(led.TransformPoint(place.tolist())) - true(heads, WRONG)) < 2.2
    )  # a click, to a pixel
    assert np.linalg.norm(np.array(through_field(heads, place)) - true(heads, WRONG)) > 6
    # The recipe and the command make the same volume as the window.
    recipe = read_recipe(tmp_path / "strokes.json")
    options = supple.GridOptions(heads["fixed"], strokes=True)
    warp_file(heads["moving"], tmp_path / "bent.nii.gz", recipe, maps=heads["maps"], grid=options)
    view.commands.field = None
    view.commands.begin_export(tmp_path / "window.nii.gz")
    wait_for(lambda: view.commands.export.done)
    one, other = (volumes.read(tmp_path / f"{name}.nii.gz").samples for name in ("bent", "window"))
    np.testing.assert_array_equal(one, other)


def test_the_command_opens_both_on_a_screen_for_a_real_pointer(gpu: Gpu, heads: Any, tmp_path: Path) -> None:
    pytest.importorskip("glfw")
    saved = tmp_path / "moving.recipe.json"
    place = ",".join(f"{x:g}" for x in PLACE.ravel())
    words = [str(heads["moving"]), "--affine", place, "--field", str(tmp_path / "1Warp.nii.gz")]
    words += ["--fixed", str(heads["fixed"])]
    with a_screen(tmp_path / "screen") as mouse, viewing(*words, folder=tmp_path, display=mouse.display) as process:
        seen = mouse.settled()
        across = (SIZE[0] - WIDE - 4) // 3  # of three planes, above those of the fixed head
        high = (SIZE[1] - TOP - LINE - 2) // 2
        one, other = (seen[top + 40 : top + high - 40, 20 : across - 20].astype(float) for top in (TOP, TOP + high + 2))
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.85
        middle = across // 2, TOP + high // 2
        mouse.drag(middle, (middle[0] + 20, middle[1] - 10))
        mouse.filed("ctrl+s", saved)
        assert process.poll() is None
    recipe = read_recipe(saved)
    assert recipe.size == heads["grid"].sizes
    assert recipe.strokes[0].by[2] == 0
    assert np.linalg.norm(recipe.strokes[0].by) > 1


def chosen(patch: pytest.MonkeyPatch, name: str, index: int) -> None:
    """Choose a row of a list in the next frame, as a click on it does."""
    draw, rest = imgui.combo, [name]

    def drawn(label: str, now: int, items: Any) -> tuple[bool, int]:
        made = draw(label, now, items)
        return (True, index) if rest and rest[0] == label and rest.pop() else made

    patch.setattr(imgui, "combo", drawn)


def through_field(heads: Any, place: Any) -> Any:
    """Where the registration by itself leads a place of the fixed head."""
    led = supple.Deformation(heads["grid"], border=None).field(heads["maps"][1].map)
    found = heads["grid"].positions(led.inverse(heads["grid"].indices(place)).points)
    return found @ PLACE[:, :3].T + PLACE[:, 3]


def test_pairs_come_from_files_and_are_listed_with_their_residuals(gpu: Gpu, heads: Any, tmp_path: Path) -> None:
    points = np.array([[22, 27, 26], [30, 20, 24], [15, 33, 30]])
    for name, values in (("moving", true(heads, points)), ("fixed", heads["grid"].positions(points))):
        rows = [f"{k},{x},{y},{z}" for k, (x, y, z) in zip("abc", values.tolist(), strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["name,l,p,s", *rows]) + "\n")
    files = {"points": tmp_path / "moving.csv", "fixed_points": tmp_path / "fixed.csv"}
    view, hand = registered(heads, size=(1280, 800), **files)
    marks, document = view.document.state.marks, view.document
    assert marks.names == ("a", "b", "c")
    before = marks.residuals(document.deformation)
    assert before[0] == pytest.approx(np.linalg.norm(OFF), abs=2.0)
    view.tools.radius = 30.0
    stroke = marks.pull(document.deformation, view.tools.next_stroke)
    document.begin_drag()
    assert document.preview(stroke)
    document.commit()
    assert marks.residuals(document.deformation).max() < 0.01
    hand.canvas.draw()
    document.mark(marks.without(1), "Remove landmark b")
    assert view.document.state.marks.names == ("a", "c")
    # They come back from the tables that they are saved to.
    document.mark_saved()
    assert not view.commands.may_close()
    assert view.commands.asked.text == "There are landmarks that were not saved."
    view.commands.ask("save landmarks")
    assert view.commands.asked.path.endswith("moving-landmarks.csv")
    view.commands.asked.path = str(tmp_path / "m.txt")
    assert not view.commands.answer("Save")
    assert "in tables: choose a name that ends in .csv" in view.commands.asked.problem
    view.commands.asked.path = str(tmp_path / "m.csv")
    assert view.commands.answer("Save")
    assert view.commands.may_close()
    files = {"points": tmp_path / "m.csv", "fixed_points": tmp_path / "m-fixed.csv"}
    back = registered(heads, **files)[0].document.state.marks
    assert back.names == ("a", "c")
    np.testing.assert_allclose(back.points, view.document.state.marks.points, atol=1e-3)
    np.testing.assert_allclose(back.fixed, view.document.state.marks.fixed, atol=1e-9)
    (tmp_path / "two.csv").write_text("l,p,s\n0,0,0\n1,1,1\n2,2,2\n3,3,3\n4,4,4\n")
    (tmp_path / "named.csv").write_text("name,l,p,s\nq,0,0,0\n")
    with pytest.raises(supple.SuppleError, match="5 and 1 landmarks, whose names do not match"):
        registered(heads, points=tmp_path / "two.csv", fixed_points=tmp_path / "named.csv")


@pytest.mark.parametrize(
    ("table", "name"),
    [
        ('0 0 0 0 0 0 0 "Clear"\n1 255 0 0 1 1 1 "Grey and white"\n', "Grey and white"),
        ("# FreeSurfer\n0 Unknown 0 0 0 0\n1 Left-Cerebrum 255 0 0 0\n", "Left-Cerebrum"),
    ],
)
def test_labels_lie_over_an_image_with_their_names(gpu: Gpu, tmp_path: Path, table: str, name: str) -> None:
    (tmp_path / "labels.txt").write_text(table)
    recipe = Recipe(border=None, strokes=(Stroke.grab((45, 60, 40), by=(0, -8, 0), radius=30),))
    options = {"segmentation": DATA / "brain.nii.gz", "label_colours": tmp_path / "labels.txt"}
    view, hand = opened(DATA / "head.nii.gz", recipe, size=(1280, 800), **options)
    tools, over = view.tools, view.slices.segmentation
    assert over.colours.names[1] == name
    labels = volumes.read(DATA / "brain.nii.gz").samples
    bent = view.document.deformation.warp(labels, filter="nearest")
    assert (bent != labels).any()
    plane = tools.planes[2]
    made = view.slices._over.sampled(view.document.deformation, plane.axis, 45)
    np.testing.assert_array_equal(made, bent[:, :, 45])
    tools.sight = tools.sight.at((45, 60, 40), tools.sizes)
    hand.canvas.draw()
    hand.move(*tools.pane(2).to_canvas((45, 52, 40)))
    assert f"label 1 ({name})" in overlay.status(view)
    seen = cut(hand.canvas.draw(), tools.places[2])
    reddish = (seen[..., 0] - seen[..., 1] > 40).mean()
    assert reddish > 0.05
    over.hidden.add(1)
    view.refresh()
    hand.canvas.draw()
    seen = cut(hand.canvas.draw(), tools.places[2])
    assert (seen[..., 0] - seen[..., 1] > 40).mean() < 0.1 * reddish


def test_names_of_a_segmentation_of_slicer_are_listed(gpu: Gpu, tmp_path: Path) -> None:
    image = sitk.ReadImage(str(DATA / "brain.nii.gz"))
    for key, value in (("ID", "s0"), ("Name", "Brain"), ("LabelValue", "1"), ("Color", "0 1 0")):
        image.SetMetaData(f"Segment0_{key}", value)
    sitk.WriteImage(image, str(tmp_path / "brain.seg.nrrd"))
    view, hand = opened(DATA / "head.nii.gz", segmentation=tmp_path / "brain.seg.nrrd", size=(1280, 800))
    known = view.slices.segmentation
    assert (known.labels, known.colours.names) == ((1,), {1: "Brain"})
    assert known.shades[0].tolist() == [0, 1, 0, 1]
    hand.canvas.draw()


def test_wrong_files_are_refused_in_a_line(gpu: Gpu, heads: Any, tmp_path: Path) -> None:
    with pytest.raises(supple.SuppleError, match=r"^fixed is for files of volumes, and .*coffee.jpg is none"):
        opened(DATA / "coffee.jpg", fixed=heads["fixed"])
    with pytest.raises(supple.SuppleError, match="fixed_points are those of a fixed volume, and there is none"):
        opened(heads["moving"], fixed_points=tmp_path / "x.csv")
    maps = (Placed(Affine([[1, 0, 0, 900], [0, 1, 0, 0], [0, 0, 1, 0]])),)
    with pytest.raises(
        supple.SuppleError, match=r"nothing of .*moving.nii.gz lies within .*head.nii.gz: give the affine"
    ):
        opened(heads["moving"], maps=maps, fixed=heads["fixed"])
    away = sitk.ReadImage(str(DATA / "brain.nii.gz"))
    away.SetOrigin((900, 0, 0))
    sitk.WriteImage(away, str(tmp_path / "away.nii.gz"))
    with pytest.raises(supple.SuppleError, match=r"away.nii.gz and .*head.nii.gz, .* do not overlap: from \("):
        opened(DATA / "head.nii.gz", segmentation=tmp_path / "away.nii.gz")
    with pytest.raises(supple.SuppleError, match="label_colours is a colour table"):
        opened(heads["moving"], label_colours="grey")


def test_no_line_of_the_crosshair_lies_on_a_letter(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    view, hand = opened(DATA / "head.nii.gz")
    tools = view.tools
    boxes = written(monkeypatch)
    lines: list[tuple[float, float, float, float]] = []
    crosshair = overlay._crosshair

    class Watched:
        def add_line(self, a: Any, b: Any, *rest: Any) -> None:
            lines.append((min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1])))

    monkeypatch.setattr(overlay, "_crosshair", lambda tools, drawn, *rest: crosshair(tools, Watched(), *rest))
    middle = (45, 54, 45)
    for cross in (middle, (45, 54, 88), (45, 0, 45), (0, 54, 45), (90, 108, 0)):
        tools.sight = tools.sight.at(cross, tools.sizes)
        lines.clear()
        boxes.clear()
        view.refresh()
        hand.canvas.draw()
        letters = [box for box in boxes if re.fullmatch("[RLAPSI]", box[0])]
        assert len(letters) == 12
        assert len(lines) >= 9
        for _, left, top, right, bottom in letters:
            assert not any(a <= right and c >= left and b <= bottom and d >= top for a, b, c, d in lines)


def test_landmarks_inside_say_how_deep_they_are(gpu: Gpu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = ["name,i,j,k", "nose,45,108,26", "AC,45,63,36", "PC,45,49,37", "far,45,50,36", "other,45,51,38"]
    (tmp_path / "marks.csv").write_text("\n".join(rows) + "\n")
    view, hand = opened(DATA / "head.nii.gz", points=tmp_path / "marks.csv", size=(1280, 800))
    boxes = written(monkeypatch)
    hand.key("4")
    hand.move(1, 1)
    view.refresh()
    hand.canvas.draw()
    deep = {said.split("  ")[0]: float(said.split()[-3]) for said, *_ in boxes if said.endswith("mm deep")}
    assert set(deep) == {"AC", "PC", "far", "other"}
    assert deep["PC"] - deep["AC"] == pytest.approx(2 * 14, abs=8)  # the next voxels lie behind it, from the front
    names = [box for box in boxes if box[0].split("  ")[0] in (*deep, "nose")]
    assert len(names) == 5
    for k, (said, left, top, right, bottom) in enumerate(names):
        for other, a, b, c, d in names[k + 1 :]:
            assert left >= c or a >= right or top >= d or b >= bottom, (said, other)


def test_an_oblique_volume_is_reformatted_along_the_patients_axes(
    gpu: Gpu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planes along LPS are those that SimpleITK resamples; a drag in one is a stroke in voxels that stays in it."""
    image = sitk.ReadImage(str(DATA / "head.nii.gz"), sitk.sitkInt16)
    angle = np.radians(17.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]])
    image.SetDirection((turn @ tilt @ np.reshape(image.GetDirection(), (3, 3))).ravel().tolist())
    sitk.WriteImage(image, str(tmp_path / "oblique.nii.gz"))
    recipe = Recipe(border=None, strokes=(Stroke.grab((45, 60, 40), by=(3, -6, 4), radius=20),))
    view, hand = opened(tmp_path / "oblique.nii.gz", recipe, size=(1280, 800))
    tools = view.tools
    boxes = written(monkeypatch)
    hand.key("1")
    view.refresh()
    hand.canvas.draw()
    assert any(re.fullmatch(r"z 45   [SI] [0-9.]+ mm   oblique by [0-9.]+\u00b0", said) for said, *_ in boxes)
    hand.key("1")
    hand.canvas.draw()
    places = [box for box in boxes if re.fullmatch(r".*[SIAPLR] [0-9.]+ mm.*", box[0])]
    assert {said[0] for said, *_ in places} == set("xyz")  # shorter, and none is left out
    tools.reformat(True)
    hand.canvas.draw()
    assert re.fullmatch(r"[SI] [0-9.]+ mm", overlay._lies(tools, tools.pane(0))[0])
    grid = tools.upright.grid
    assert np.allclose(np.abs(np.array(grid.direction)), np.eye(3), atol=1e-12)
    bent = warp_file(tmp_path / "oblique.nii.gz", tmp_path / "bent.nii.gz", recipe)
    like = sitk.Image(list(grid.sizes), sitk.sitkInt16)
    like.SetSpacing(grid.spacing)
    like.SetOrigin(grid.origin)
    like.SetDirection(np.array(grid.direction).ravel().tolist())
    wanted = sitk.GetArrayFromImage(
        sitk.Resample(sitk.ReadImage(str(bent.target)), like, sitk.Transform(), sitk.sitkLinear)
    )
    for k in range(3):
        pane = tools.pane(k)
        axis, index = pane.plane.axis, pane.index[pane.plane.axis]
        made = view.slices.sampled(view.document.deformation, axis, index).astype(float)
        there = np.take(wanted, index, axis=2 - axis).astype(float)
        assert np.corrcoef(made.ravel(), there.ravel())[0, 1] > 0.99
    # A point of the plane is where it is seen, and a drag to the right goes along the patient's axis.
    left, top, width, height = tools.places[0]
    at = left + 0.5 * width, top + 0.4 * height
    hand.move(*at)
    point = tools.hover
    assert tools.pane(0).to_canvas(point) == pytest.approx(at)
    hand.drag(at, (at[0] + 30, at[1]))
    stroke = view.document.strokes[-1]
    geometry = view.document.geometry
    ends = [geometry.to_lps(stroke.at), geometry.to_lps(np.add(stroke.at, stroke.by))]
    assert ends[1] - ends[0] == pytest.approx((30 / tools.pane(0).scale, 0, 0), abs=1e-6)
    before = tools.sight.cross
    hand.wheel(*at, -100.0)
    gone = geometry.to_lps(tools.sight.cross) - geometry.to_lps(before)
    assert gone == pytest.approx((0, 0, grid.spacing[2]), abs=1e-6)
    tools.reformat(False)
    hand.canvas.draw()


def test_strokes_in_millimetres_are_listed_in_millimetres(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    geometry = volumes.outline_of(DATA / "head.nii.gz").geometry
    at = geometry.to_world((45, 60, 40), "RAS").tolist()
    recipe = Recipe(border=None, space="RAS", strokes=(Stroke.grab(at, by=(0, 12, 0), radius=20),))
    view, hand = opened(DATA / "head.nii.gz", recipe, size=(1280, 800))
    said: list[str] = []
    draw = imgui.selectable
    monkeypatch.setattr(imgui, "selectable", lambda label, *a, **b: said.append(label) or draw(label, *a, **b))
    hand.canvas.draw()
    x, y, z = at
    assert f"Grab ({x:.0f}, {y:.0f}, {z:.0f}) mm, radius 20##row" in said
    document = view.document
    moved = document.as_edited(document.as_saved(document.strokes[0]))
    np.testing.assert_allclose(moved.at, document.strokes[0].at, atol=1e-12)
    np.testing.assert_allclose(document.place(document.strokes[0].at), at, atol=1e-9)
