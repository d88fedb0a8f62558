"""Freezing and thawing by hand: in pictures, clips and volumes."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.media import image as images
from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke
from supple.viewer.document.words import described, step
from supple.viewer.panels.overlay import status
from supple.viewer.panels.view import TOP
from supple.viewer.tools.gestures import Tools
from tests.viewer.sessions import recipe_in, warped
from tests.viewer.test_tools_slices import bench, middle
from tests.viewer.test_window_brushes import both
from tests.viewer.tools import arrived, clip, down, drag, image, move, press, up, wheel
from tests.viewer.windows import Hand, opened

pytest.importorskip("rendercanvas")
pytest.importorskip("imgui_bundle")


def state(tools: Tools[Any]) -> tuple[object, bytes]:
    return tools.document.state.content, tools.document.deformation.space.table.tobytes()


def mask(tools: Tools[Any]) -> np.ndarray:
    """m at all samples."""
    found = tools.document.state.rest.freeze
    assert found is not None
    return found.shown(tools.document.shape[-found.ndim :])


def names(tools: Tools[Any]) -> list[str]:
    steps = tools.document.steps
    return [step(a, b) for a, b in itertools.pairwise(steps)]


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
        made, frozen = tools.document.deformation.warp(source), mask(tools) == 0
        np.testing.assert_array_equal(made[frozen], source[frozen])
        assert (made != source).any()

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
        tools = image(Stroke(at=(100, 50), by=(20, 0), radius=20, also=(((200, 100), (0, 10)),)), on_fold="flow")
        document = tools.document
        press(tools, "c")
        drag(tools, (201, 101), (203, 101))
        assert tools.status is None
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
    np.testing.assert_array_equal(tools.document.deformation.forward(points), points)
    assert recipe_round(tools) == tools.document.state.rest.freeze


def recipe_round(tools: Tools[Any]) -> Freeze | None:
    """The freeze mask after the recipe was saved and read."""
    return Recipe.from_json(tools.document.recipe.to_json()).freeze


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
    assert recipe_round(tools) == tools.document.state.rest.freeze


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
    frozen = view.recipe.freeze.shown(made.shape[:2]) == 0
    assert frozen.sum() > 2000
    np.testing.assert_array_equal(made[frozen], source[frozen])
    assert (made != source).any()
    # What is on screen is what is exported.
    left, top = (round(v) for v in np.subtract(view.tools.view.to_canvas(0, 0), (0, TOP)))
    shown = view.pixels()[top : top + made.shape[0], left : left + made.shape[1]]
    assert np.abs(shown.astype(int) - made).max() <= 1


def test_buttons_thaw_and_invert(gpu: Gpu, grey_photo: Path) -> None:
    from supple.viewer.panels.actions import ACTIONS

    view, hand = opened(grey_photo)
    assert not ACTIONS["thaw all"].able(view)
    hand.key("c")
    hand.drag((350, 300), (400, 300))
    made = view.recipe.freeze
    ACTIONS["invert frozen"].do(view)
    assert view.recipe.freeze == made.inverted
    screen(hand)
    ACTIONS["thaw all"].do(view)
    assert view.recipe.freeze is None
    assert not view.commands.message
    for _ in range(3):
        view.document.undo()
    assert not view.document.can_undo


def test_a_clip_is_shown_as_it_is_exported(gpu: Gpu, clip: Path) -> None:
    from tests.clips import decoded
    from tests.viewer.windows import wait_for

    view, hand = opened(clip)
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
    shown = view.pixels().astype(int)
    bent = view.document.deformation
    frames = np.stack([view.stage.film.get(k)[..., :3] for k in range(3)])
    full = np.concatenate([frames, np.repeat(frames[-1:], view.stage.film.count - 3, 0)])
    wanted = bent.warp(full)[0].astype(int)
    left, top = (round(v) for v in np.subtract(view.tools.view.to_canvas(0, 0), (0, TOP)))
    height, width = (min(a, b) for a, b in zip(wanted.shape, shown.shape[:2], strict=False))
    x, y = max(left, 0), max(top, 0)
    crop = wanted[y - top : height, x - left : width]
    part = shown[y : y + crop.shape[0], x : x + crop.shape[1]]
    crop = crop[: part.shape[0], : part.shape[1]]
    assert np.abs(part - crop).mean() < 0.6
    assert np.abs(crop - full[0][y - top :, x - left :][: crop.shape[0], : crop.shape[1]]).mean() > 1
    both_made, both_wanted = both(view, clip, "wanted.mp4")
    for one, other in zip(decoded(both_made), decoded(both_wanted), strict=True):
        np.testing.assert_array_equal(one.to_ndarray(), other.to_ndarray())


def test_what_takes_long_is_announced(gpu: Gpu, volume: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    view, hand = opened(volume)
    hand.drag((160, 150), (175, 150))
    hand.key("c")
    hand.move(200, 150)
    hand.press(200, 150)
    hand.move(205, 150, 1)
    view._changed_at = -10.0
    hand.canvas.draw()
    assert view.stage._seconds[True] == np.inf  # what the mask costs is not known yet
    hand.release(205, 150)
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
    hand.move(100, 150)
    hand.press(100, 150)
    hand.move(120, 150, 1)
    hand.canvas.draw()
    assert view.document.dragging
    assert view.stage.is_slow(view.document.deformation)
    view._changed_at = -10.0
    for _ in range(2):
        hand.canvas.draw()
    assert view.stage._bent[0][0] is view.document.deformation
    hand.release(120, 150)


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
    assert view.stage.scene.gpu is not None
    # All views are drawn, the rendering as well.
    left, top, width, height = view.tools.places[3]
    assert np.ptp(view.pixels()[int(top) : int(top + height), int(left) : int(left + width)]) > 100
    paths = both(view, volume, "wanted.nii.gz")
    made, wanted = (sitk.GetArrayFromImage(sitk.ReadImage(str(path))) for path in paths)
    np.testing.assert_array_equal(made, wanted)
    view.document.set_freeze(None)
    screen(hand)
    assert view._gui.trouble == ""
