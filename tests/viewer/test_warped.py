"""Images that the CPU warps for a window: they are what `Deformation.warp` gives, whatever was shown before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple.deformation import Deformation
from supple.engine.work import Mattes
from supple.gpu.device import Gpu, _know_types
from supple.gpu.plate import BACK, OVERLAYS, Plate, Sight, halved
from supple.gpu.screen import SWAPPED, canvas_texture, pixels_of
from supple.space.freezing import Freeze
from supple.strokes import Recipe, Stroke
from supple.viewer.panels.stages import FrameCache, ImageStage, Levels, VideoStage, Warped, changed
from supple.viewer.panels.view import TOP
from tests.clips import make
from tests.viewer.windows import Hand, opened

ROWS, COLUMNS = 300, 410


@pytest.fixture
def noise() -> np.ndarray:
    rng = np.random.default_rng(5)
    made = np.full((ROWS, COLUMNS, 4), 255, np.uint8)
    made[..., :3] = rng.integers(0, 256, (ROWS, COLUMNS, 3))
    return made


def smooth(shape: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    waves = [127 + 100 * np.sin(x / a) * np.cos(y / b) for a, b in ((9, 14), (15, 8), (20, 20))]
    return np.dstack([*waves, np.full(shape, 255.0)]).astype(np.uint8)


def drawn(gpu: Gpu, warped: Warped, d: Deformation, sight: Sight) -> np.ndarray:
    warped.bring(d, sight)
    texture = canvas_texture(gpu, sight.size)
    warped.draw(sight, texture)
    return pixels_of(gpu, texture).astype(int)


def bent(*strokes: Stroke, border: Any = None) -> Deformation:
    return Deformation.from_recipe(Recipe(border=border, strokes=strokes), (ROWS, COLUMNS))


def some_stroke(rng: np.random.Generator) -> Stroke:
    reach = None if rng.random() < 0.1 else 4.0
    by = rng.uniform(-20, 20, 2).tolist()
    return Stroke.grab(rng.uniform(0, 300, 2).tolist(), by=by, radius=rng.uniform(6, 30), reach=reach)


def test_after_any_edit_pixels_are_those_of_the_warp(gpu: Gpu, noise: np.ndarray) -> None:
    rng, warped, strokes, places = np.random.default_rng(6), Warped(gpu, Levels(noise)), [], []
    x0, y0, size = 3, 5, (COLUMNS, ROWS)
    for k in range(60):
        kind = rng.integers(4)
        if kind == 0 and strokes:  # a drag, of any stroke
            i = rng.integers(len(strokes))
            strokes[i] = Stroke.grab(strokes[i].at, by=rng.uniform(-20, 20, 2).tolist(), radius=strokes[i].radius)
        elif kind == 1 and strokes:
            del strokes[rng.integers(len(strokes))]
        elif kind == 2 and len(strokes) > 1:
            strokes.reverse()
        else:
            strokes.append(some_stroke(rng))
        if k % 9 == 8:  # a pan, or a zoom
            x0, y0, size = int(rng.integers(200)), int(rng.integers(150)), (150, 120 + k)
        d = bent(*strokes[-7:])
        seen = drawn(gpu, warped, d, Sight((float(x0), float(y0)), 1.0, size))
        wanted = d.warp(noise, alpha=False)[y0 : y0 + size[1], x0 : x0 + size[0]].astype(int)
        apart = np.abs(seen[: wanted.shape[0], : wanted.shape[1]] - wanted)
        assert apart.max() <= 1
        places.append(np.count_nonzero(apart))
    assert np.median(places) == 0


def test_only_what_a_drag_changes_is_warped(gpu: Gpu, noise: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    warped, sight = Warped(gpu, Levels(noise)), Sight((0.0, 0.0), 1.0, (COLUMNS, ROWS))
    first = Stroke.grab((200, 150), by=(20, 10), radius=30)
    warped.bring(bent(first), sight)
    sizes = []
    warp = warped._warp

    def counted(deformation: Deformation, sight: Sight, k: int, part: tuple[int, int, int, int]) -> None:
        sizes.append((part[2] - part[0], part[3] - part[1]))
        warp(deformation, sight, k, part)

    monkeypatch.setattr(warped, "_warp", counted)
    d = bent(first, Stroke.grab((40, 40), by=(2, 1), radius=5))
    warped.bring(d, sight)
    warped.bring(d, sight)  # nothing is new
    assert len(sizes) == 1
    assert max(sizes[0]) <= 128
    warped.bring(bent(first), sight)
    assert sizes[1] == sizes[0]


def test_after_a_drag_what_it_drew_roughly_is_exact(gpu: Gpu, noise: np.ndarray) -> None:
    held = np.zeros((ROWS, COLUMNS), bool)
    held[100:180, 140:260] = True
    first, frozen = Stroke.grab((150, 120), by=(14, 9), radius=40), Stroke.freeze(Freeze.of(held, width=12), ndim=2)
    warped, rough, exact = (
        Warped(gpu, Levels(noise)),
        *(Sight((0.0, 0.0), 1.0, (COLUMNS, ROWS), solved=solved) for solved in (False, True)),
    )
    drawn(gpu, warped, bent(first, frozen), exact)
    apart = []
    for k in range(4):
        d = bent(first, frozen, Stroke.grab((150 + 20 * k, 210), by=(12, -15), radius=25))
        whole = drawn(gpu, Warped(gpu, Levels(noise)), d, exact)
        off = np.abs(drawn(gpu, warped, d, rough) - whole)
        assert off.mean() < 2
        apart.append(off.max())
        if k % 2:
            off = np.abs(drawn(gpu, warped, d, exact) - whole)
            assert off.max() <= 1
            assert np.count_nonzero(off) < 0.002 * off.size
    assert 1 < max(apart) < 150  # of noise, from pixel to pixel


def test_a_box_holds_all_that_changes() -> None:
    rng, y, x = np.random.default_rng(7), *np.mgrid[:ROWS:3, :COLUMNS:3]
    points = np.stack([x, y], -1).reshape(-1, 2).astype(float)
    for _ in range(40):
        strokes = [some_stroke(rng) for _ in range(5)]
        one = bent(*strokes)
        strokes[rng.integers(5)] = some_stroke(rng)
        other = bent(*strokes[: rng.integers(4, 6)])
        low, high = changed(one.space, other.space)
        moved = np.abs(one.inverse(points).points - other.inverse(points).points).max(axis=-1) > 1e-7
        assert moved.any()
        assert ((points[moved] >= low) & (points[moved] <= high)).all()
    assert np.isinf(changed(bent(border=None).space, bent(border=20.0).space)[0]).all()


def test_rows_that_act_at_once_change_together() -> None:
    first, second = Stroke.grab((60, 60), by=(9, 3), radius=10), Stroke.grab((90, 90), by=(5, 5), radius=10)
    moved = Stroke.grab((95, 90), by=(5, 5), radius=10)
    one, other = bent(first, second, first).space, bent(first, moved, first).space
    assert changed(one, other)[0].min() == 20.0  # the last one reaches what has changed, and carries it on
    one, other = bent(first, second).space, bent(first, moved).space
    assert changed(one, other)[0].min() == 50.0
    for space in (one, other):
        space.table["joined"][1] = 1
    assert changed(one, other)[0].min() == 20.0


@pytest.mark.parametrize("scale", [2.0, 3.0, 5.0, 11.0])
def test_reduced_it_is_the_mean_of_the_warp(gpu: Gpu, scale: float) -> None:
    pixels = np.kron(smooth((300, 400)), np.ones((4, 4, 1), np.uint8))
    d = Deformation(pixels.shape[:2], border=60.0).grab((600, 500), by=(150, -90), radius=180)
    size = (int(1600 / scale), int(1200 / scale))
    origin = (scale - 1) / 2
    warped = Warped(gpu, Levels(pixels))
    seen = drawn(gpu, warped, d, Sight((origin, origin), scale, size))[..., :3]
    whole, n = d.warp(pixels, alpha=False)[..., :3].astype(float), int(scale)
    wanted = whole[: size[1] * n, : size[0] * n].reshape(size[1], n, size[0], n, 3).mean(axis=(1, 3))
    assert np.quantile(np.abs(seen - wanted), 0.98) < 8
    # The level has at least as many pixels as the window.
    level, (first, _, last, _) = warped._place
    assert 2**level < scale or level == 0
    assert last - first >= size[0]


def test_what_is_transparent_lies_on_a_ground(gpu: Gpu) -> None:
    pixels = smooth((ROWS, COLUMNS))
    pixels[:, 200:, 3] = 0
    pixels[:, 200:, :3] = 255  # which is not seen
    d = bent(Stroke.grab((200, 150), by=(30, 0), radius=40))
    seen = drawn(gpu, Warped(gpu, Levels(pixels)), d, Sight((0.0, 0.0), 1.0, (COLUMNS, ROWS)))[..., :3]
    assert {107, 148} == set(np.unique(seen[:, 300:]).tolist())
    wanted = d.warp(pixels, alpha=True)
    solid = wanted[..., 3] == 255
    np.testing.assert_array_equal(seen[solid], wanted[solid][:, :3])
    assert solid[150, 220]
    assert not solid[20, 220]


def test_only_what_has_changed_is_drawn_again(gpu: Gpu) -> None:
    rng, pixels = np.random.default_rng(8), smooth((ROWS, COLUMNS))
    pixels[:, ::3, 3] = 90
    warped, strokes = Warped(gpu, Levels(pixels)), [Stroke.grab((100, 100), by=(9, 4), radius=20)]
    for scale, left in ((1.0, 0.0), (0.3, 40.3), (0.77, -20.5), (1.7, 3.0), (2.6, -30.0)):
        for solved in (False, True):
            sight = Sight((left, 0.4 * left), scale, (250, 180), solved=solved)
            texture = canvas_texture(gpu, sight.size)
            for _ in range(5):
                d = bent(*strokes, some_stroke(rng))
                warped.bring(d, sight)
                warped.draw(sight, texture)
                whole = drawn(gpu, Warped(gpu, Levels(pixels)), d, sight)
                np.testing.assert_array_equal(pixels_of(gpu, texture), whole)
    # What is far from a change stays as it is, whatever it is.
    sight = Sight((0.0, 0.0), 1.0, (COLUMNS, ROWS))
    texture = canvas_texture(gpu, sight.size)
    for by in ((9, 4), (7, 4), (5, 4)):
        d = bent(Stroke.grab((100, 100), by=by, radius=20))
        warped.bring(d, sight)
        warped.draw(sight, texture)
        seen = pixels_of(gpu, texture)
        if by != (9, 4):
            assert (seen[220:, 250:] == 7).all()
            assert np.abs(seen[:180, :180].astype(int) - drawn(gpu, warped, d, sight)[:180, :180]).max() == 0
        red = np.full((ROWS, COLUMNS, 4), 7, np.uint8)
        layout = {"bytes_per_row": 4 * COLUMNS, "rows_per_image": ROWS}
        gpu.device.queue.write_texture({"texture": texture}, red, layout, (COLUMNS, ROWS, 1))


def test_where_shaders_have_drawn_all_is_drawn_again(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "software", False)
    pixels, held = smooth((ROWS, COLUMNS)), np.zeros((ROWS, COLUMNS), bool)
    held[:40, :40] = True
    first, frozen = Stroke.grab((150, 120), by=(14, 9), radius=40), Stroke.freeze(Freeze.of(held, width=12), ndim=2)
    small = Stroke.grab((380, 280), by=(2, 1), radius=5)
    masked, plain, more = bent(first, frozen, first), bent(small), bent(first, frozen, first, small)
    stage, sight = ImageStage(gpu, "it", pixels), Sight((0.0, 0.0), 1.0, (COLUMNS, ROWS))
    texture = canvas_texture(gpu, sight.size)
    assert [isinstance(d.space.freeze, Mattes) for d in (masked, plain, more)] == [True, False, True]
    for d in (masked, plain, more):
        stage.expect((d,), sight)
        stage.draw(d, sight, texture)
    wanted = more.warp(pixels, alpha=False).astype(int)
    assert np.abs(pixels_of(gpu, texture).astype(int) - wanted).max() <= 1


def test_frames_of_a_clip_are_those_of_the_warp(gpu: Gpu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not gpu.software:
        pytest.skip("there is a hardware GPU")
    film = FrameCache(make(tmp_path / "clip.mp4"))
    stage, (width, height) = VideoStage(gpu, film), film.size
    film.want(0, 3)
    assert film.arrived(30.0)
    d = Deformation((height, width), border=None).grab((width / 2, height / 2), by=(9, 4), radius=12)
    texture = canvas_texture(gpu, film.size)

    def seen(time: float, solved: bool) -> tuple[bool, np.ndarray]:
        sight = Sight((0.0, 0.0), 1.0, film.size, time, solved=solved)
        stage.expect((d,), sight)
        assert not stage.solves((d,), sight)
        return stage.draw(d, sight, texture), pixels_of(gpu, texture).astype(int)

    for frame in (1, 3, 2):
        wanted = d.warp(film.get(frame), alpha=False).astype(int)
        for solved, most in ((False, 8), (True, 1)):
            ready, found = seen(frame, solved)
            assert ready
            assert np.abs(found - wanted).max() <= most
    monkeypatch.setattr(film, "get", lambda frame: None)  # the next one is not decoded yet
    ready, kept = seen(3, True)
    assert not ready
    np.testing.assert_array_equal(kept, found)
    sight = Sight((width - 30.0, 10.0), 1.0, (60, 30), 3.0)  # and another part is shown meanwhile
    stage.expect((d,), sight)
    part = canvas_texture(gpu, sight.size)
    assert not stage.draw(d, sight, part)
    np.testing.assert_array_equal(pixels_of(gpu, part)[:, :30], kept[10:40, width - 30 :])
    film.close()


@pytest.mark.parametrize("scale", [0.3, 0.5, 1.0, 1.3, 4.0])
@pytest.mark.parametrize("value", [0, 31, 255])
def test_at_its_edges_a_picture_fades_into_the_ground(gpu: Gpu, scale: float, value: int) -> None:
    pixels = np.full((60, 80, 4), value, np.uint8)
    pixels[..., 3] = 255
    seen = drawn(gpu, Warped(gpu, Levels(pixels)), bent(), Sight((-5.4, -3.7), scale, (150, 100)))[..., :3]
    back = np.rint(255 * np.array(BACK)).astype(int)
    assert (seen >= np.minimum(back, value)).all()
    assert (seen <= np.maximum(back, value)).all()
    inside = seen[
        int(4.7 / scale) + 2 : min(int(63 / scale) - 1, 100), int(6.4 / scale) + 2 : min(int(84 / scale) - 1, 150)
    ]
    assert (inside == value).all()
    assert (seen[0, 0] == back).all()


@pytest.mark.parametrize(("ratio", "size"), [(1.5, (901, 701)), (1.25, (803, 633)), (1.0, (801, 601))])
def test_pictures_are_drawn_at_100_percent_on_any_canvas(gpu: Gpu, ratio: float, size: tuple[int, int]) -> None:
    pixels = smooth((217, 331))
    view, hand = opened(pixels[..., :3], Recipe(border=None), ratio=ratio, size=size)
    hand.key("1")
    assert view.pixels().shape[2] == 3
    for k in range(12):
        view.tools.view = replace(view.tools.view, held=(view.tools.view.zoom, (100 + 7.3 * k, 90 + 5.1 * k)))
        seen = view.pixels().astype(int)
        assert (np.abs(seen - pixels[100, 150, :3]).max(axis=-1) <= 4).any()


def test_textures_that_are_not_drawn_any_more_are_released(gpu: Gpu) -> None:
    warped = Warped(gpu, Levels(smooth((ROWS, COLUMNS))))
    for k in range(9):
        drawn(gpu, warped, bent(), Sight((-50.0, -50.0), 1.0, (600 + k, 500)))
    assert len(warped._drawn) <= 4


@pytest.mark.parametrize("shape", [(6, 8), (7, 9), (1, 5)])
@pytest.mark.parametrize("opaque", [True, False])
def test_half_as_large_a_pixel_is_the_mean_of_four(shape: tuple[int, int], opaque: bool) -> None:
    pixels = np.random.default_rng(4).integers(0, 256, (*shape, 4)).astype(np.uint8)
    if opaque:
        pixels[..., 3] = 255
    even = np.pad(pixels, [(0, n % 2) for n in shape] + [(0, 0)], mode="edge").astype(float)
    four = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2, 4)
    opacity = four[..., 3:].sum(axis=(1, 3))
    colours = (four[..., :3] * four[..., 3:]).sum(axis=(1, 3)) / np.maximum(opacity, 1)
    wanted = np.concatenate([colours, opacity / 4], axis=-1)
    assert np.abs(halved(pixels) - wanted).max() <= 0.5


@pytest.mark.parametrize("overlay", [name for name in OVERLAYS if name])
def test_overlays_are_those_of_a_gpu(gpu: Gpu, overlay: str) -> None:
    pixels, d = smooth((ROWS, COLUMNS)), bent(Stroke.grab((200, 150), by=(30, 10), radius=40), border="auto")
    sight = Sight((10.0, 20.0), 0.7, (400, 300), overlay=overlay, every=16.0)
    seen = drawn(gpu, Warped(gpu, Levels(pixels)), d, sight)
    plate, texture = Plate(gpu, (COLUMNS, ROWS)), canvas_texture(gpu, sight.size)
    plate.put(0, pixels)
    plate.draw(sight, d.space.table, d.space.axes, texture)
    wanted = pixels_of(gpu, texture).astype(int)
    assert np.quantile(np.abs(seen - wanted), 0.98) <= 6
    plain = drawn(gpu, Warped(gpu, Levels(pixels)), d, Sight((10.0, 20.0), 0.7, (400, 300)))
    assert np.abs(seen - plain).max() > 60


def at_actual_size(view: Any, hand: Hand, pixels: np.ndarray) -> np.ndarray:
    """Show the middle of a photograph at 100 %; return the position of the first pixel on the canvas."""
    hand.key("1")
    hand.canvas.draw()
    return np.array(view.tools.view.to_image(0.5, TOP + 0.5)).round().astype(int)


@pytest.mark.parametrize("software", [True, False])
def test_during_a_drag_pixels_are_near_those_of_the_export_and_the_same_after_it(
    gpu: Gpu, monkeypatch: pytest.MonkeyPatch, software: bool
) -> None:
    if not gpu.software and software:
        pytest.skip("there is a hardware GPU")
    monkeypatch.setattr(gpu, "software", software)
    pixels = smooth((900, 1200))
    stroke = Stroke.grab((500, 400), by=(40, 20), radius=60)
    view, hand = opened(pixels[..., :3], Recipe(border=None, strokes=(stroke,)))
    x0, y0 = at_actual_size(view, hand, pixels)
    hand.move(300, 300)
    hand.press(300, 300)
    for k in range(1, 6):
        hand.move(300 + 9 * k, 300 - 5 * k, 1)
        hand.canvas.draw()
        width, height = (int(n) for n in view.area)
        wanted = view.document.deformation.warp(pixels, alpha=False)[y0 : y0 + height, x0 : x0 + width].astype(int)
        if software:  # however slow the device is; the filter is cubic
            assert np.abs(pixels_of(view.gpu, view._textures[0]) - wanted).max() <= 2
    hand.release(345, 275)
    assert len(view.document.strokes) == 2
    seen = view.pixels()
    assert np.quantile(np.abs(seen - wanted[..., :3]), 0.98) <= (0 if software else 5)
    assert not hasattr(view.stage, "_plate") or not software


def test_colours_are_the_same_on_screens_that_swap_red_and_blue(gpu: Gpu) -> None:
    pixels = smooth((ROWS, COLUMNS))[..., :3]
    view, hand = opened(pixels, Recipe(border=None, strokes=(Stroke.grab((200, 150), by=(30, 10), radius=40),)))
    hand.canvas.draw()
    wanted = view.pixels()
    assert (wanted[..., 0] != wanted[..., 2]).any()
    view.painter.format = SWAPPED
    np.testing.assert_array_equal(view.pixels(), wanted)
    assert view.gpu.software == (view.painter.paint(view._shot(moving=False))[0].format == SWAPPED)


def test_types_of_c_are_those_that_cffi_would_parse(gpu: Gpu) -> None:
    from wgpu.backends.wgpu_native._ffi import ffi

    called = "void(WGPUMapAsyncStatus, WGPUStringView, void *, void *)"
    for text in ("WGPULimits *", "WGPUVertexAttribute[]", "uint8_t []", "WGPUAdapter[]", "uintptr_t", called):
        known = ffi._parsed_types.pop(text)
        try:
            parsed = ffi._typeof(text, True)
            assert parsed is known[0] or str(parsed) == str(known[0])
        finally:
            ffi._parsed_types[text] = known
    before = dict(ffi._parsed_types)
    _know_types()
    assert ffi._parsed_types == before
