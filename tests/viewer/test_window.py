"""The window, without a screen."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import supple
from supple.errors import ScaleWarning, SuppleError
from supple.files.jobs import Job
from supple.files.options import ClipOptions, VolumeOptions
from supple.files.volumes import deformation_of
from supple.gpu.device import Gpu
from supple.media import image, video, volume
from supple.media.volume import RawLayout
from supple.strokes import Recipe, Stroke
from supple.viewer.window import launch
from tests.clips import decoded, make, rows
from tests.viewer.sessions import near
from tests.viewer.windows import DATA, Hand, beside, opened, small_photo, viewing, wait_for


@pytest.fixture
def photo_view(gpu: Gpu, photo: Path) -> Iterator[tuple[Any, Hand]]:
    view, hand = opened(photo)
    yield view, hand
    view.close()


def test_a_drag_is_a_stroke_and_the_canvas_shows_what_is_exported(
    photo_view: tuple[Any, Hand], photo: Path, state: Path
) -> None:
    view, hand = photo_view
    hand.key("1")
    hand.drag((350, 300), (400, 270))
    (stroke,) = view.recipe.strokes
    np.testing.assert_allclose(stroke.by, (50, -30), atol=1e-9)
    assert view.document.selected == 0
    # The file is what supple warp makes of the saved recipe.
    view.commands.save(state / "strokes.json")
    view.commands.begin_export(state / "bent.png")
    wait_for(lambda: view.commands.export.done)
    view.commands.tick()
    assert view.commands.message == f"saved to {state / 'bent.png'}"
    recipe = Recipe.from_json((state / "strokes.json").read_text(encoding="utf-8"))
    assert recipe == view.recipe
    supple.warp_file(photo, state / "wanted.png", recipe)
    exported, wanted = (image.read(state / name).pixels for name in ("bent.png", "wanted.png"))
    np.testing.assert_array_equal(exported, wanted)
    # And so is the canvas, but that a GPU interpolates linearly.
    supple.warp_file(photo, state / "linear.png", recipe, filter="linear")
    wanted = image.read(state / "linear.png").pixels
    seen, part = beside(view, exported if view.gpu.software else wanted)
    if view.gpu.software:
        np.testing.assert_array_equal(seen, part)
    assert near(seen, part) < 1.0
    assert near(beside(view, image.read(photo).pixels)[1], part) > 10


def test_nothing_is_lost(photo: Path, gpu: Gpu, state: Path) -> None:
    view, hand = opened(photo)
    hand.drag((300, 250), (330, 260))
    kept = view.recipe
    view.commands.tick()
    view.commands.autosave._lock.close()  # as if the process had died
    again, _ = opened(photo)
    assert again.commands.asked.name == "restore"
    assert "not saved the last time (strokes: 1)" in again.commands.asked.text
    assert again.recipe.strokes == ()
    assert again.commands.answer("Restore")
    assert again.recipe == kept
    # What is restored is kept before the offer is put aside.
    assert len(json.loads(again.commands.autosave.place.read_text())["recipe"]["strokes"]) == 1
    # Closing asks; what was saved is not asked for again.
    assert not again.commands.may_close()
    assert again.commands.asked.name == "close"
    again.commands.asked.path = str(state / "saved.json")
    assert again.commands.answer("Save and close")
    assert Recipe.from_json((state / "saved.json").read_text(encoding="utf-8")) == kept
    assert again.commands.may_close()
    again.close()
    last, _ = opened(photo)
    assert last.commands.asked is None
    # A name that is taken is not replaced, unless it is said.
    last.document.add(Stroke.grab((5, 5), by=(1, 1), radius=9))
    last.commands.ask("save")
    last.commands.asked.path = str(state / "saved.json")
    assert not last.commands.answer("Save")
    assert "exists" in last.commands.asked.problem
    assert last.commands.answer("Replace")
    assert not last.document.dirty


def test_a_clip_plays_and_is_bent_in_time(gpu: Gpu, state: Path) -> None:
    view, hand = opened(DATA / "bunny.mp4", Recipe(border=None))
    assert view.stage.film.want(0, 6) or view.stage.film.arrived(30.0)
    hand.key("ArrowRight")
    hand.key("ArrowRight")
    assert view.frame == 2
    hand.press(300, 250)
    hand.wheel(300, 250, -300)
    hand.canvas.draw()
    assert view.frame == 5
    hand.move(320, 250, 1)
    hand.release(320, 250)
    (stroke,) = view.recipe.strokes
    assert stroke.at[2] == 2
    assert stroke.by[2] == pytest.approx(3)
    assert stroke.by[0] > 0
    # A frame of the canvas is that of the file.
    hand.key("1")
    view._changed_at = -10.0
    needed = view.stage.needed(view.document.deformation, view.frame)
    assert view.stage.film.want(*needed) or view.stage.film.arrived(30.0)
    view.document.select(None)
    with video.open_clip(DATA / "bunny.mp4") as clip:
        from supple.engine.stream import make_plan
        from supple.files.clips import deformation_of, sampling_of, streamed, work_on

        d = deformation_of(Job("", "", view.recipe, clip=ClipOptions(time_scale=1.0)), clip)
        work = work_on(clip, (d,), sampling_of(clip))
        ((_, arrays, _),) = streamed(clip, work, make_plan(work, [5]), 2e9)
        wanted = clip.to_rgb(arrays)
    assert near(*beside(view, wanted)) < 4
    hand.key(" ")
    assert view._playing
    end = time.monotonic() + 20
    while view.frame < 9 and time.monotonic() < end:
        hand.canvas.draw()
    assert view.frame >= 9
    view.close()
    assert not view.stage.film._thread.is_alive()


def test_a_clip_is_exported_by_the_time_scale_that_it_is_seen_with(gpu: Gpu, state: Path) -> None:
    make(state / "a.mkv", "ffv1", "yuv444p", count=8)
    stroke = Stroke(at=(30, 20, 3), by=(9, 4, 0.5), radius=12, isotropic=True)  # others have a radius in time
    recipe = Recipe(border=None, strokes=(stroke,))
    view, _ = opened(state / "a.mkv", recipe, time_scale=5.0)
    assert view.document.deformation.domain.spacing == (1, 1, 5)
    view.commands.begin_export(state / "seen.mkv")
    wait_for(lambda: view.commands.export.done)
    view.close()
    for name, scale in (("wanted.mkv", 5.0), ("other.mkv", 1.0)):
        supple.warp_file(state / "a.mkv", state / name, recipe, clip=ClipOptions(time_scale=scale), hold=1)
    seen, wanted, other = ([rows(f) for f in decoded(state / f"{name}.mkv")] for name in ("seen", "wanted", "other"))
    assert seen == wanted != other
    with pytest.raises(supple.SuppleError, match=r"time_scale is for files of clips, and .*head\.nii\.gz is none"):
        opened(DATA / "head.nii.gz", time_scale=2.0)
    with pytest.raises(supple.SuppleError, match="time_scale is for files of clips, and the array is none"):
        opened(np.zeros((4, 4)), time_scale=2.0)
    with pytest.raises(supple.SuppleError, match="time_scale"):
        opened(state / "a.mkv", time_scale=0.0)


def test_voxels_without_a_header_are_shown_and_exported(gpu: Gpu, state: Path) -> None:
    samples = np.random.default_rng(0).integers(0, 900, (12, 14, 16), np.int16)
    (state / "a.raw").write_bytes(samples.astype(">i2").tobytes())
    told = VolumeOptions(layout=RawLayout((16, 14, 12), ">i2", (1.0, 1.5, 2.0)), labels=True)
    recipe = Recipe(border=None, strokes=(Stroke.grab((8, 7, 6), by=(2, 1, 0), radius=5),))
    view, _ = opened(state / "a.raw", recipe, volume=told)
    assert view.stage.spacing == (1.0, 1.5, 2.0)
    view.commands.ask("export")
    assert view.commands.asked.path == str(state / "a-bent.nii.gz")
    assert view.commands.answer("Export")
    wait_for(lambda: view.commands.export.done)
    assert view.commands.export.error is None
    view.close()
    supple.warp_file(state / "a.raw", state / "wanted.nii.gz", recipe, volume=told)
    seen, wanted = (volume.read(state / name).samples for name in ("a-bent.nii.gz", "wanted.nii.gz"))
    np.testing.assert_array_equal(seen, wanted)
    assert (seen != samples).any()
    for source in (small_photo(state), samples):
        with pytest.raises(supple.SuppleError, match=r"volume is for files of volumes, and .* is none"):
            opened(source, volume=VolumeOptions(labels=True))
    with pytest.raises(supple.SuppleError, match="series is for DICOM folders"):
        opened(DATA / "head.nii.gz", volume=VolumeOptions(series="1"))


def test_the_first_strokes_may_be_places_in_space(gpu: Gpu, state: Path) -> None:
    head = volume.read(DATA / "head.nii.gz")
    at = head.geometry.to_world(np.array([45.0, 60, 50]))
    recipe = Recipe(border=None, strokes=(Stroke.grab(tuple(at), by=(4, 0, 2), radius=20),))
    view, _ = opened(DATA / "head.nii.gz", recipe, volume=VolumeOptions(world=True))
    np.testing.assert_allclose(view.document.strokes[0].at, (45, 60, 50), atol=1e-6)
    assert (view.recipe.space, view.recipe.size) == ("RAS", head.sizes)
    np.testing.assert_allclose(view.recipe.strokes[0].at, at, atol=1e-9)
    wanted = deformation_of(Job("", "", recipe, volume=VolumeOptions(world=True)), head)
    assert view.document.deformation.strokes == wanted.strokes


def test_a_recipe_for_another_size_is_scaled_and_told(gpu: Gpu, state: Path) -> None:
    ramp = np.linspace(0, 1, 300, dtype=np.float32) * np.ones((200, 1), np.float32)
    recipe = Recipe(size=(150, 100), strokes=(Stroke.grab((75, 50), by=(10, 0), radius=20),))
    with pytest.warns(ScaleWarning, match="made for 150 x 100, and is scaled for the array, which is 300 x 200"):
        view, _ = opened(ramp, recipe)
    assert view.recipe.strokes == (Stroke(at=(150.5, 100.5), by=(20, 0), radius=40),)
    (state / "small.json").write_text(recipe.to_json(), encoding="utf-8")
    view.commands.open(state / "small.json", sure=True)
    assert view.commands.message.endswith("small.json, scaled to 300 x 200")
    view.close()
    view, _ = opened(ramp, recipe, fit="pixels")
    assert view.recipe.strokes == recipe.strokes


def test_arrays_are_shown_too(gpu: Gpu, state: Path) -> None:
    ramp = np.linspace(0, 1, 300, dtype=np.float32) * np.ones((200, 1), np.float32)
    view, hand = opened(ramp, Recipe(strokes=(Stroke.grab((150, 100), by=(20, 0), radius=40),)))
    assert len(view.recipe.strokes) == 1
    hand.canvas.draw()
    seen = view.pixels()
    assert seen.max() > 200
    with pytest.raises(supple.SuppleError, match="an array is no file"):
        view.commands.begin_export("x.png")
    view.close()
    for bad, what in (
        (np.zeros((2, 3, 4, 5)), "array of numbers"),
        (np.zeros(3), "array of numbers"),
        ("none.png", "no such file"),
    ):
        with pytest.raises(supple.SuppleError, match=what):
            opened(bad)


async def _answer(
    app: Any, path: str, query: str = "", cookie: str = "", kind: str = "http", origin: str = ""
) -> list[Any]:
    said: list[Any] = []

    async def send(message: Any) -> None:
        said.append(message)

    async def receive() -> Any:
        return {"type": f"{kind}.connect"}

    headers = [(b"host", b"127.0.0.1:8000")]
    headers += [(b"cookie", cookie.encode())] if cookie else []
    headers += [(b"origin", origin.encode())] if origin else []
    await app({"type": kind, "path": path, "query_string": query.encode(), "headers": headers}, receive, send)
    return said


def test_who_has_no_token_sees_nothing() -> None:
    from supple.viewer.window.server import guarded

    async def app(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "served"})

    token = "abcdefghij"
    guard = guarded(app, token, "<photo>")
    for query in ("", "token=", "token=abcdefghi", "token=ABCDEFGHIJ", "token=%C3%A9"):
        for path in ("/", "/renderview.js", "/index.html"):
            assert asyncio.run(_answer(guard, path, query))[0]["status"] == 403
    for cookie in ("", "supple-abcdef=x", "supple-abcdef=é", "x=y; supple-abcdef="):
        assert asyncio.run(_answer(guard, "/", cookie=cookie, kind="websocket"))[0]["type"] == "websocket.close"
    begun = asyncio.run(_answer(guard, "/", f"token={token}"))[0]
    assert begun["status"] == 303
    headers = dict(begun["headers"])
    assert headers[b"location"] == b"/"
    assert b"HttpOnly" in headers[b"set-cookie"]
    assert b"SameSite=Strict" in headers[b"set-cookie"]
    cookie = headers[b"set-cookie"].decode().split(";")[0]
    page = asyncio.run(_answer(guard, "/", cookie=cookie))
    assert page[0]["status"] == 200
    assert b"&lt;photo&gt;" in page[1]["body"]
    assert asyncio.run(_answer(guard, "/renderview.js", cookie=cookie)) == [{"type": "served"}]
    assert asyncio.run(_answer(guard, "/", cookie=cookie, kind="websocket")) == [{"type": "served"}]
    # Cookies of other programs on the same host come along, whatever they look like.
    for other in ('foo={"x": 1}', "flag", "n[1]=2", "x=é", 'x="q', "a b=c", "=", ""):
        for cookies in (f"{other}; {cookie}", f"{cookie};{other}"):
            assert asyncio.run(_answer(guard, "/", cookie=cookies))[0]["status"] == 200, cookies
    # And so do ours, from pages of other programs.
    for origin in ("http://127.0.0.1:9999", "http://127.0.0.1", "https://example.org", "null", "http://[", "http://"):
        refused = asyncio.run(_answer(guard, "/", cookie=cookie, kind="websocket", origin=origin))
        assert refused[0]["type"] == "websocket.close", origin
    ours = "http://127.0.0.1:8000"
    assert asyncio.run(_answer(guard, "/", cookie=cookie, kind="websocket", origin=ours)) == [{"type": "served"}]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")
def test_one_interrupt_ends_a_server(gpu: Gpu, photo: Path, state: Path) -> None:
    client = pytest.importorskip("websockets.sync.client")
    with contextlib.ExitStack() as kept, viewing(str(photo), "--serve", folder=state) as process:
        assert process.stdout is not None
        address = process.stdout.readline().removeprefix("open ").strip()
        # Once it answers, the canvas's loop has begun soon after, and has taken Ctrl+C.
        wait_for(lambda: _reached(address.partition("?")[0]))
        token = address.partition("=")[2]
        page = address.partition("?")[0].replace("http", "ws", 1)
        cookie = {"Cookie": f"supple-{token[:6]}={token}"}
        kept.enter_context(client.connect(page, additional_headers=cookie, max_size=None))
        time.sleep(1.0)
    assert process.returncode == 130


def _reached(address: str) -> bool:
    try:
        urllib.request.urlopen(address, timeout=5).close()
    except urllib.error.HTTPError as refused:
        refused.close()
        return refused.code == 403
    except OSError:
        return False
    return True


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("what", ["a frame", "an event"])
def test_an_interrupt_waits_for_what_is_being_done(
    photo_view: tuple[Any, Hand], monkeypatch: pytest.MonkeyPatch, what: str, number: int
) -> None:
    view, hand = photo_view
    owner, name = (view, "_present") if what == "a frame" else (view.tools, "handle")
    done, closed = getattr(owner, name), []

    def close(*told: Any) -> None:
        closed.append(told)
        view.canvas.close()

    def interrupted(*arguments: Any) -> None:
        signal.raise_signal(number)
        assert not closed
        done(*arguments)

    monkeypatch.setattr(owner, name, interrupted)
    before = signal.signal(number, close)
    try:
        if what == "a frame":
            view.draw()
        else:
            hand.send("key_down", key="1")
        assert len(closed) == 1
        assert view.canvas.get_closed()
        assert signal.getsignal(number) is close
    finally:
        signal.signal(number, before)


def test_what_terminates_closes_windows_first() -> None:
    from supple.viewer.window.window import closed_by_signals

    def terminate(number: int, frame: Any) -> None:
        raise InterruptedError(number)

    def run() -> None:
        with closed_by_signals(SimpleNamespace(stop=lambda: told.append("stopped"))):
            signal.raise_signal(signal.SIGTERM)  # what it raised here, rendercanvas would log, and go on
            told.append("ran on")

    told: list[str] = []
    before = signal.signal(signal.SIGTERM, terminate)
    try:
        with pytest.raises(InterruptedError):
            run()
        assert told == ["stopped", "ran on"]
        assert signal.getsignal(signal.SIGTERM) is terminate
    finally:
        signal.signal(signal.SIGTERM, before)


def test_the_panel_says_where_a_stroke_arrives() -> None:
    from supple.viewer.document.words import described

    held = Stroke.grab((15, 20, 4), by=(5, 0, 0), radius=9)
    d = supple.Deformation((9, 60, 90), border=30.0, on_fold="damp").add(held, warn=False)
    d = d.add(Stroke.grab((20, 20, 4), by=(0, 8, 0), radius=9, poisson=0.3, reach=None), warn=False)
    first, second = d.arrivals
    t = 15.5 / 30  # from the face
    short = 5 * (1 - t * (2 - 2 * t**2 + t**3))
    text = described(held, first)
    assert f"arrives at ({20 - short:.1f}, 20.0, 4.0), {short:.3g} short: the fixed border holds it back" in text
    assert f"later strokes move it by {first.moved:.3g}, to (" in text
    assert "bulge" not in text
    text = described(d.strokes[1], second)
    assert "bulge sideways 0.3" in text
    assert "reach: no limit" in text
    assert "later" not in text
    assert "arrives" not in described(held, None)


def test_the_title_says_what_is_unsaved(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    from rendercanvas.offscreen import RenderCanvas

    titles: list[str] = []
    monkeypatch.setattr(RenderCanvas, "set_title", lambda self, title: titles.append(title))
    view, hand = opened(np.zeros((60, 80), np.uint8))
    view.document.add(Stroke.grab((40, 30), to=(44, 30), radius=9))
    hand.canvas.draw()
    hand.canvas.draw()
    view.document.undo()
    hand.canvas.draw()
    name = titles[-1]
    assert name.endswith(" - Supple")
    assert titles[-2:] == [f"\u25cf {name}", name]
    assert titles.count(name) == 2


def test_keys_are_listed_over_the_picture(gpu: Gpu) -> None:
    view, hand = opened(np.full((60, 80), 255, np.uint8))
    bare = hand.canvas.draw().astype(int)
    view.tools.press("F1")
    view.refresh()
    hand.canvas.draw()
    listed = hand.canvas.draw().astype(int)
    changed = np.abs(listed - bare).max(axis=-1) > 60
    assert changed[200:400, 150:550].mean() > 0.8
    view.tools.press("F1")
    view.refresh()
    hand.canvas.draw()
    assert np.abs(hand.canvas.draw().astype(int) - bare)[200:400, 150:550].max() <= 2


def test_a_recipe_is_no_name_of_a_file(photo: Path) -> None:
    with pytest.raises(SuppleError, match="recipe must be a Recipe"):
        launch.opened(photo, "strokes.json", None, None)  # type: ignore[arg-type]
