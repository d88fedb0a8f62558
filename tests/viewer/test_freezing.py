"""Freezing and thawing by hand: in pictures, clips and volumes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.media import image as images
from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke
from supple.viewer.document.words import described, frozen, listed
from supple.viewer.panels import stages
from supple.viewer.panels.overlay import status
from supple.viewer.panels.view import TOP
from supple.viewer.tools.gestures import Tools
from tests.viewer.sessions import recipe_in, warped
from tests.viewer.test_tools_slices import bench, middle
from tests.viewer.test_window_brushes import both
from tests.viewer.tools import arrived, clip, down, drag, image, move, press, state, up, wheel
from tests.viewer.windows import Boxes, Hand, beside, opened


def mask(tools: Tools[Any]) -> np.ndarray:
    """m at all samples."""
    found = tools.document.frozen
    assert found is not None
    return found.shown(tools.document.shape[-found.ndim :])


def names(tools: Tools[Any]) -> list[str]:
    return [state.made_by for state in tools.document.steps[1:]]


def within(tools: Tools[Any], points: list[tuple[float, ...]], radius: float) -> np.ndarray:
    """The samples of a picture that a brush went over."""
    y, x = np.indices(tools.document.shape[-2:])
    return np.any([(x - a) ** 2 + (y - b) ** 2 <= radius**2 for a, b, *_ in points], axis=0)


class TestMasks:
    @pytest.mark.parametrize(("shape", "spacing"), [((40, 90), (1.0, 1.0)), ((12, 40, 30), (1.0, 1.0, 3.0))])
    def test_a_mask_without_anything_is_that_of_an_empty_array(self, shape: Any, spacing: Any) -> None:
        made = Freeze.free(shape, spacing)
        assert made == Freeze.of(np.zeros(shape, bool), spacing=spacing)
        assert made.is_free
        assert made.inverted == Freeze.of(np.ones(shape, bool), spacing=spacing)
        assert not made.inverted.is_free

    def test_a_ball_is_painted_and_free_again(self) -> None:
        shape, spacing, at = (20, 40, 30), (1.0, 1.0, 2.0), (12.0, 20.0, 10.0)
        free = Freeze.free(shape, spacing)
        made = free.painted(at, 6, spacing)
        z, y, x = np.indices(shape)
        ball = (x - 12) ** 2 + (y - 20) ** 2 + 4 * (z - 10) ** 2 <= 36
        seen = made.shown(shape)
        assert (seen[ball] == 0).all()
        assert seen[0, 0, 0] == 1
        np.testing.assert_allclose(made.inverted.shown(shape), 1 - seen, atol=1e-6)
        assert made.inverted.inverted == made
        assert made.painted(at, 60, spacing, frozen=False) == free
        assert made.painted((500.0, 0.0, 0.0), 6, spacing) is made
        np.testing.assert_allclose(made.at([range(30), [17.0], range(20)])[:, 0], seen[:, 17], atol=1e-6)


class TestPictures:
    def test_a_drag_freezes_what_the_ring_goes_over_and_is_one_step(self) -> None:
        tools = image(Stroke.grab((100, 50), by=(20, 5), radius=30))
        tools.radius = 12
        before, bent = state(tools), tools.document.deformation
        press(tools, "c")
        down(tools, 241, 121)
        for x in (260, 300, 321):
            move(tools, x, 121)
            assert state(tools) == before  # strokes are resolved at its end
            assert tools.document.deformation is bent
            assert tools.mask is not None
        up(tools, 321, 121)
        way = [(x, 60.0) for x in np.linspace(120, 160, 30)]
        assert (mask(tools)[within(tools, way, 11.8)] == 0).all()
        assert names(tools) == ["Freeze"]
        assert tools.status is None
        after = state(tools)
        assert after != before
        press(tools, "z", "Control")
        assert state(tools) == before
        press(tools, "y", "Control")
        assert state(tools) == after
        rng = np.random.default_rng(1)
        source = rng.integers(0, 256, (200, 300, 3), dtype=np.uint8)
        # It stays as it is now, whatever follows; and painting on changes the same item of the list.
        press(tools, "g")
        drag(tools, (321, 181), (331, 131))
        made, held = tools.document.deformation.warp(source), mask(tools) == 0
        np.testing.assert_array_equal(made[held], bent.warp(source)[held])
        assert (made[held] != source[held]).any()
        assert (made != bent.warp(source)).any()
        assert [stroke.brush for stroke in tools.document.strokes] == ["grab", "freeze", "grab"]
        assert listed(tools.document.strokes[1]) == f"Freeze: {frozen(tools.document.freeze)}"
        press(tools, "c")
        drag(tools, (101, 121), (121, 121))
        drag(tools, (101, 131), (121, 131))
        assert [stroke.brush for stroke in tools.document.strokes] == ["grab", "freeze", "grab", "freeze"]
        assert names(tools) == ["Freeze", "Grab at (160, 90)", "Freeze", "Freeze"]
        tools.document.hide(1)
        free = tools.document.deformation.warp(source)
        assert (free[held] != made[held]).any()
        tools.document.hide(3)
        assert tools.mask is None
        assert tools.document.recipe == Recipe.from_json(tools.document.recipe.to_json())

    def test_a_click_freezes_and_thawing_brings_all_back(self) -> None:
        tools = image(Stroke.grab((100, 50), by=(20, 5), radius=30))
        before = state(tools)
        tools.radius = 15
        press(tools, "c")
        drag(tools, (201, 101), (201, 101))
        assert (mask(tools)[within(tools, [(100, 50)], 15)] == 0).all()
        press(tools, "v")
        drag(tools, (201, 101), (203, 101))
        assert names(tools) == ["Freeze", "Thaw"]
        tools.radius = 60
        drag(tools, (201, 101), (203, 101))
        assert tools.document.state.rest.freeze is None
        assert names(tools)[-1] == "Thaw everything"
        assert state(tools) == before
        drag(tools, (201, 101), (203, 101))  # nothing is frozen
        assert len(names(tools)) == 3

    @pytest.mark.parametrize("key", ["c", "v"])
    def test_shift_is_the_reverse(self, key: str) -> None:
        tools = image()
        tools.radius = 20
        press(tools, "c" if key == "v" else "v")
        drag(tools, (201, 101), (205, 101), modifiers=() if key == "v" else ("Shift",))
        press(tools, key)
        tools.radius = 60
        drag(tools, (201, 101), (205, 101), modifiers=("Shift",) if key == "c" else ())
        assert tools.document.state.rest.freeze is None

    @pytest.mark.parametrize("keys", [("Escape",), ("z", "Control")])
    def test_a_drag_that_is_abandoned_freezes_nothing(self, keys: tuple[str, ...]) -> None:
        tools = image()
        press(tools, "c")
        down(tools, 201, 101)
        move(tools, 221, 101)
        press(tools, *keys)
        assert tools.mask is None
        up(tools, 221, 101)
        assert tools.document.state.rest.freeze is None
        assert names(tools) == []

    def test_the_wheel_is_the_radius_and_handles_are_not_grabbed(self) -> None:
        tools = image(Stroke.grab((100, 50), by=(20, 0), radius=30))
        tools.document.select(0)
        tools.radius = 10
        press(tools, "c")
        down(tools, 201, 101)
        wheel(tools, -700)
        assert tools.radius > 19
        move(tools, 202, 101)
        up(tools, 202, 101)
        assert tools.document.strokes[0].at == (100, 50)
        assert (mask(tools)[within(tools, [(100, 50)], 9.9)] == 0).all()

    def test_what_is_symmetric_is_frozen_on_both_sides(self) -> None:
        tools = image()
        tools.radius = 12
        press(tools, "m")
        press(tools, "c")
        drag(tools, (101, 121), (121, 121))
        seen = mask(tools)
        assert seen[60, 55] == 0
        assert seen[60, 299 - 55] == 0
        assert seen[60, 150] == 1

    def test_a_drag_of_what_is_frozen_says_what_holds_it_back(self) -> None:
        tools = image(on_fold="flow")
        tools.radius = 20
        press(tools, "c")
        drag(tools, (201, 101), (203, 101))
        press(tools, "g")
        drag(tools, (201, 101), (261, 101))
        assert "frozen" in (tools.status or "")  # said at the press, and until the next one
        drag(tools, (501, 301), (521, 301))
        assert tools.status is None
        assert arrived(tools, 0) == (100, 50)
        document = tools.document
        said = "ends 30 pixels short: what is frozen holds it back"
        assert said in (document.deformation.warnings[0] or "")
        assert "30 short: what is frozen holds it back" in described(document.strokes[0], document.arrival(0))

    def test_what_is_frozen_lets_go_of_one_of_several_points(self) -> None:
        tools = image(on_fold="flow")
        document = tools.document
        press(tools, "c")
        drag(tools, (201, 101), (203, 101))
        assert tools.status is None
        document.add(Stroke(at=(100, 50), by=(20, 0), radius=20, also=(((200, 100), (0, 10)),)))
        assert arrived(tools, 0) == (100, 50)
        assert "(100, 50), is let go" in (document.deformation.warnings[0] or "")
        np.testing.assert_allclose(document.deformation.forward((200, 100)), (200, 110), atol=1e-6)

    def test_words(self) -> None:
        tools = image()
        document = tools.document
        half = np.zeros(document.shape, bool)
        half[:, :150] = True
        document.set_freeze(Freeze.of(half))
        document.set_freeze(document.freeze.inverted)
        document.set_freeze(Freeze.free(document.shape, (1.0, 1.0)).painted((10, 10), 2, (1.0, 1.0)))
        document.set_freeze(None)
        document.set_freeze(document.freeze.inverted)
        kinds = ["Freeze", "Invert what is frozen", "Freeze and thaw", "Thaw everything", "Invert what is frozen"]
        assert names(tools) == kinds
        with pytest.raises(SuppleError, match="of 300 x 200"):
            document.set_freeze(Freeze.of(np.ones((20, 30), bool)))


def test_a_clip_is_frozen_in_all_frames() -> None:
    tools = clip(Stroke.grab((100, 50, 10), by=(20, 5, 2), radius=30))
    tools.radius = 12
    tools.playback.seek(4)
    press(tools, "c")
    down(tools, 201, 101)
    wheel(tools, -100)  # no drag through time
    press(tools, "ArrowRight")
    assert tools.playback.frame == 4
    move(tools, 221, 101)
    up(tools, 221, 101)
    assert mask(tools).shape == tools.document.shape[1:]
    points = np.array([(x, 50.0, t) for x in (100, 105, 110) for t in range(0, 20, 5)])
    before = tools.document.deformation
    tools.document.add(Stroke.grab((130, 50, 10), by=(-20, 5, 2), radius=30))
    after = tools.document.deformation
    np.testing.assert_array_equal(after.inverse(points).points, before.inverse(points).points)
    assert np.abs(after.inverse((130, 50, 10)).points - before.inverse((130, 50, 10)).points).max() > 1
    assert recipe_round(tools) == tools.document.frozen


def recipe_round(tools: Tools[Any]) -> Freeze | None:
    """The freeze mask after the recipe was saved and read."""
    read = Recipe.from_json(tools.document.recipe.to_json())
    return next((stroke.matte for stroke in read.strokes if stroke.brush == "freeze"), read.freeze)


def test_a_ball_of_a_volume_is_frozen_in_a_plane() -> None:
    tools = bench()
    x, y = middle(tools, 0)
    tools.radius = 9
    press(tools, "c")
    drag(tools, (x, y), (x + 2, y))
    point = np.array(tools.sight.cross)
    away = np.indices(tools.document.shape)[::-1] - point[:, None, None, None]
    ball = ((away * np.array(tools.geometry.spacing)[:, None, None, None]) ** 2).sum(axis=0) <= 8.5**2
    assert (mask(tools)[ball] == 0).all()
    assert ball.any(axis=(1, 2)).sum() > 1
    assert mask(tools).max() == 1
    assert recipe_round(tools) == tools.document.frozen


def red(seen: np.ndarray, at: tuple[int, int]) -> bool:
    """Whether there is a veil at a place of a window."""
    r, g, b = seen[at[1] - 3 : at[1] + 4, at[0] - 3 : at[0] + 4].astype(int).reshape(-1, 3).mean(axis=0)
    return bool(r > 40 + max(g, b))


def screen(hand: Hand) -> np.ndarray:
    for _ in range(3):
        made = np.asarray(hand.canvas.draw())
    return made[..., :3]


@pytest.fixture
def grey_photo(state: Path) -> Path:
    y, x = np.indices((380, 560))
    images.write(
        state / "photo.png", np.repeat((110 + 20 * np.sin(x / 7) * np.cos(y / 9))[..., None], 3, 2).astype("u1")
    )
    return state / "photo.png"


def test_a_photograph_is_frozen_by_hand(gpu: Gpu, grey_photo: Path) -> None:
    view, hand = opened(grey_photo)
    hand.key("1")
    hand.key("g")
    view.tools.radius = 50
    hand.drag((250, 250), (290, 260))
    hand.key("c")
    view.tools.radius = 30
    hand.drag((350, 300), (400, 300))
    hand.move(20, 20)
    seen = screen(hand)
    assert view._gui.trouble == ""
    assert red(seen, (375, 300))
    assert not red(seen, (250, 400))
    # With any brush, in any colour; it is not part of the view.
    hand.key("g")
    assert red(screen(hand), (375, 300))
    colour, view.veil_colour = view.veil_colour, (0.0, 1.0, 0.0, 0.5)
    seen = screen(hand)[300, 375].astype(int)
    assert seen[1] > seen[0] + 40
    view.veil_colour = (0.0, 1.0, 0.0, 0.0)
    assert np.ptp(screen(hand)[300, 375].astype(int)) < 20
    view.veil_colour = colour
    hand.send("key_down", key="\\")
    assert not red(screen(hand), (375, 300))
    hand.send("key_up", key="\\")
    assert not red(view.pixels(), (375, 300))
    bent, wanted = both(view, grey_photo, "wanted.png")
    made, source = images.read(bent).pixels, images.read(grey_photo).pixels
    np.testing.assert_array_equal(made, images.read(wanted).pixels)
    frozen = view.document.freeze.shown(made.shape[:2]) == 0
    assert frozen.sum() > 2000
    state = Deformation.from_recipe(replace(view.recipe, strokes=view.recipe.strokes[:1]), made.shape[:2])
    np.testing.assert_array_equal(made[frozen], state.warp(source)[frozen])
    assert [stroke.brush for stroke in view.recipe.strokes] == ["grab", "freeze"]
    # Then a stroke across its edge.
    view.overlay = ""
    hand.key("g")
    view.tools.radius = 50
    hand.drag((330, 280), (300, 250))
    hand.move(20, 20)
    screen(hand)
    made = view.document.deformation.warp(source)
    np.testing.assert_array_equal(made[frozen], state.warp(source)[frozen])
    assert (made != state.warp(source)).any()
    assert view._gui.trouble == view.stage.trouble == ""
    # What is on screen is what is exported.
    assert np.abs(np.subtract(*beside(view, made))).max() <= 1


def test_a_clip_is_shown_as_it_is_exported(gpu: Gpu, clip: Path) -> None:
    from tests.clips import decoded
    from tests.viewer.windows import wait_for

    view, hand = opened(clip)
    view.document.set_hold(0)
    wait_for(lambda: hand.canvas.draw() is not None and view.painter.ready, 60)
    hand.key("1")
    hand.key("c")
    view.tools.radius = 40
    hand.drag((300, 330), (330, 330))
    saved = clip.with_name("empty.json")
    view.commands.save(saved)
    assert recipe_in(saved).freeze == view.recipe.freeze
    for one, other in zip(decoded(warped(clip, "still.mp4", saved)), decoded(clip), strict=True):
        assert one.to_ndarray().shape == other.to_ndarray().shape  # a mask alone moves nothing, and is no error
    hand.key("g")
    hand.drag((200, 300), (230, 300))
    assert view._gui.trouble == ""
    bent = view.document.deformation
    frames = np.stack([view.stage.film.get(k)[..., :3] for k in range(3)])
    full = np.concatenate([frames, np.repeat(frames[-1:], view.stage.film.count - 3, 0)])
    shown, wanted = beside(view, bent.warp(full)[0])
    assert np.abs(shown - wanted).mean() < 0.6
    assert np.abs(beside(view, full[0])[1] - wanted).mean() > 1
    both_made, both_wanted = both(view, clip, "wanted.mp4")
    for one, other in zip(decoded(both_made), decoded(both_wanted), strict=True):
        np.testing.assert_array_equal(one.to_ndarray(), other.to_ndarray())


def test_what_takes_long_is_announced(gpu: Gpu, volume: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "software", False)  # whose scenes have no previews
    monkeypatch.setattr(stages, "time", SimpleNamespace(perf_counter=lambda: 0.0))  # however busy the machine is
    view, hand = opened(volume, size=(588, 330))
    hand.drag((60, 80), (66, 80))
    hand.key("c")
    hand.move(75, 80)
    hand.press(75, 80)
    hand.move(77, 80, 1)
    view._changed_at = -10.0
    hand.canvas.draw()
    assert view.stage._seconds[True] == np.inf  # what the mask costs is not known yet
    hand.release(77, 80)
    hand.canvas.draw()
    assert not view.computing  # it moves nothing yet
    view.document.add(Stroke.grab(tuple(view.tools.sight.cross), by=(5, 0, 0), radius=30))
    hand.canvas.draw()
    assert view.computing
    assert status(view) == "computing \u2026"
    assert view.stage._bent[0][0] is not view.document.deformation
    hand.canvas.draw()
    assert not view.computing
    assert view.stage._bent[0][0] is view.document.deformation
    # In a drag, such an image waits until the pointer rests.
    view.stage._seconds[True] = 2.0
    hand.key("g")
    hand.move(40, 80)
    hand.press(40, 80)
    hand.move(48, 80, 1)
    hand.canvas.draw()
    assert view.document.dragging
    assert view.stage.is_slow(view.document.deformation)
    view._changed_at = -10.0
    for _ in range(2):
        hand.canvas.draw()
    assert view.stage._bent[0][0] is view.document.deformation
    hand.release(48, 80)


def test_a_volume_is_frozen_in_a_plane_and_rendered(gpu: Gpu, volume: Path) -> None:
    import SimpleITK as sitk  # noqa: N813

    view, hand = opened(volume)
    hand.drag((160, 150), (175, 150))
    hand.key("c")
    view.tools.radius = 25
    hand.drag((200, 150), (205, 150))
    hand.move(20, 500)
    seen = screen(hand)
    assert view._gui.trouble == ""
    assert red(seen, (192, 142))
    assert view.tools.status is None
    assert (view.stage.scene.gpu is None) == gpu.software
    # All views are drawn, the rendering as well.
    left, top, width, height = view.tools.places[3]
    assert np.ptp(view.pixels()[int(top) : int(top + height), int(left) : int(left + width)]) > 100
    paths = both(view, volume, "wanted.nii.gz")
    made, wanted = (sitk.GetArrayFromImage(sitk.ReadImage(str(path))) for path in paths)
    np.testing.assert_array_equal(made, wanted)
    view.document.set_freeze(None)
    screen(hand)
    assert view._gui.trouble == ""


def crossed(shape: tuple[int, int]) -> tuple[Stroke, Stroke, Stroke]:
    """A stroke, a freeze of a part of what it moves, and a stroke across its edge, of a picture of a shape."""
    y, x = np.indices(shape)
    mask = Freeze.of(np.hypot(x - 0.4 * shape[1], y - 0.5 * shape[0]) < 0.15 * shape[0])
    at = 0.4 * shape[1], 0.45 * shape[0]
    radius = 0.2 * shape[0]
    first = Stroke.grab(at, by=(0.1 * shape[0], 0), radius=radius)
    return first, Stroke.freeze(mask), Stroke.grab((at[0] + radius, at[1]), by=(0, -0.1 * shape[0]), radius=radius)


def test_a_gpu_leaves_several_masks_to_the_cpu(gpu: Gpu) -> None:
    from supple.gpu.plate import Sight
    from supple.gpu.screen import canvas_texture, pixels_of
    from supple.viewer.panels.stages import ImageStage

    source = np.random.default_rng(4).integers(0, 256, (150, 210, 4), np.uint8)
    source[..., 3] = 255
    stage = ImageStage(replace(gpu, software=False), "a.png", source)
    d, sight = (
        Deformation.from_recipe(Recipe(strokes=crossed((150, 210))), (150, 210)),
        Sight((0.0, 0.0), 1.0, (210, 150)),
    )
    texture = canvas_texture(gpu, sight.size)
    wanted = d.warp(source, alpha=False).astype(int)
    for one, off in ((d.without_strokes().grab((50, 50), by=(9, 3), radius=20), None), (d, 1)):
        stage.expect((one,), sight)
        assert stage.draw(one, sight, texture)
        apart = np.abs(pixels_of(gpu, texture).astype(int)[..., :3] - wanted[..., :3])
        assert (apart.max() <= 1) == (off == 1)
        assert stage.trouble == ""
    stage.expect((d,), replace(sight, overlay="grid"))
    assert stage.trouble == "the overlay leaves out freezes after the first stroke, and mattes"


def test_frames_of_a_clip_show_a_freeze_among_strokes(gpu: Gpu, clip: Path) -> None:
    from tests.viewer.windows import wait_for

    view, hand = opened(clip)
    wait_for(lambda: hand.canvas.draw() is not None and view.painter.ready, 60)
    hand.key("1")
    view.document.timed = False
    for stroke in crossed(view.stage.shape[1:]):
        view.document.add(stroke)
    view.document.select(None)
    for _ in range(3):
        hand.canvas.draw()
    assert view._gui.trouble == view.stage.trouble == ""
    wanted = view.document.deformation.warp(view.stage.film.get(view.tools.playback.frame)[..., :3]).astype(int)
    left, top = (math.floor(v) for v in np.subtract(view.tools.view.to_canvas(0, 0), (0, TOP)))
    assert min(left, top) >= 0
    part = view.pixels()[top : top + wanted.shape[0], left : left + wanted.shape[1], :3].astype(int)
    assert np.abs(part - wanted[: part.shape[0], : part.shape[1]]).max() <= 1
    # In time, that is not shown, and said.
    timed, _ = opened(clip)
    for stroke in crossed(view.stage.shape[1:]):
        timed.document.add(replace(stroke, at=(*stroke.at, 2.0), by=(*stroke.by, 0.0)[: 3 * bool(any(stroke.by))]))
    timed.canvas.draw()
    assert "are not shown: export has them" in timed.stage.trouble


def test_a_freeze_in_the_list(gpu: Gpu, grey_photo: Path) -> None:
    strokes = crossed((380, 560))
    view, hand = opened(grey_photo, Recipe(strokes=strokes))
    view.document.select(1)
    for _ in range(2):
        hand.canvas.draw()
    assert view._gui.trouble == ""
    assert described(strokes[1], None) == (
        f"Freeze: {frozen(view.document.freeze)}\nlater strokes move nothing there, earlier ones keep their effect"
    )
    assert {i for i, _ in view.document.tracks()} == {0, 2}
    view.document.move(1, 0)  # now it holds the original
    first = view.document.deformation.warp(images.read(grey_photo).pixels)
    mask = view.document.freeze.shown(first.shape[:2]) == 0
    np.testing.assert_array_equal(first[mask], images.read(grey_photo).pixels[mask])
    view.document.set_freeze(None)  # at the end of the list
    assert [stroke.brush for stroke in view.document.strokes] == ["freeze", "grab", "grab", "freeze"]
    assert listed(view.document.strokes[-1]) == "Thaw everything"
    assert view.document.frozen is None
    assert names(view.tools) == ["Move stroke 2 earlier", "Thaw everything"]
    view.document.set_freeze(None)
    assert len(view.document.steps) == 3


class TestAmounts:
    def test_one_drag_of_all_strokes_is_one_step(self) -> None:
        tools = image(Stroke.grab((100, 50), by=(20, 5), radius=30), Stroke.grab((120, 55), by=(0, 10), radius=20))
        document = tools.document
        document.begin_drag()
        for part in (0.5, 1.7, -1.0):
            assert document.preview_rest(amount=part)
            np.testing.assert_allclose(
                document.deformation.forward((100, 50)), (100 + 20 * part, 50 + 15 * part), atol=1e-6
            )
        document.commit()
        assert names(tools) == ["Amount -100%"]
        assert document.recipe.amount == -1
        document.undo()
        assert document.recipe.amount == 1
        document.begin_drag()
        document.preview_rest(amount=1.5)
        document.abandon()
        assert document.recipe.amount == 1

    @pytest.mark.parametrize("part", [2.0, 0.5, -1.0])
    def test_what_is_drawn_at_an_amount_is_what_is_seen(self, part: float) -> None:
        tools = image(Stroke.grab((100, 50), by=(10, 5), radius=30))
        document = tools.document
        document.begin_drag()
        document.preview_rest(amount=part)
        document.commit()
        press(tools, "g")
        drag(tools, (401, 201), (421, 211))
        np.testing.assert_allclose(document.deformation.forward((200, 100)), (210, 105), atol=0.05)
        assert document.strokes[1].by == pytest.approx((10 / part, 5 / part), rel=0.01)

    def test_the_sliders(self, gpu: Gpu, grey_photo: Path, boxes: Boxes) -> None:
        view, hand = opened(
            grey_photo, Recipe(strokes=(Stroke.grab((400, 190), by=(100, 0), radius=60),)), size=(900, 1300)
        )
        view.document.select(0)
        view.own = True
        for _ in range(2):
            hand.canvas.draw()

        def at(name: str, part: float) -> tuple[float, float]:
            return boxes.at(name, (part + 1) / 3)

        hand.drag(at("##strength", 1.0), at("##strength", -0.5))
        assert view.document.strokes[0].strength == pytest.approx(-0.5, abs=0.2)
        hand.drag(at("##strength", -0.5), at("##strength", 2.0))
        assert view.document.strokes[0].strength == pytest.approx(2.0, abs=0.05)
        assert view.document.warning(0).startswith("200% of Grab at (400, 190) by (100, 0)")
        assert view._gui.trouble == ""
        hand.drag(at("##amount", 1.0), at("##amount", 0.5))
        assert view.document.recipe.amount == pytest.approx(0.5, abs=0.2)
        assert view.document.warning(0) is None
        assert not view.document.dragging
        assert [state.made_by.partition(" ")[0] for state in view.document.steps[1:]] == [
            "Strength",
            "Strength",
            "Amount",
        ]
