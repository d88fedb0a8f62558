"""Make the pictures of the window in docs/images: a real window without a screen, and a hand, drawn where it moves.

python docs/make_moving.py [photo] [clip] [volume]      films; all, by default; a hardware GPU helps, and is not needed
python docs/make_moving.py [panel] [slices] [history]   pictures that stand still
python docs/make_moving.py registration FOLDER          two of a registration, from the files of benchmarks/heads.py
"""

import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyvips
from rendercanvas.offscreen import RenderCanvas

import supple
from supple.strokes import Recipe
from supple.viewer.panels import view as views
from supple.viewer.window import window as windows
from supple.viewer.window.launch import opened
from supple.viewer.window.options import ViewOptions

HERE = Path(__file__).resolve().parent
DATA = Path(supple.__file__).parent / "examples" / "data"
SIZE, RATE = (900, 540), 12
LEFT, RIGHT = 1, 2
POINTER = """<svg xmlns="http://www.w3.org/2000/svg" width="64" height="64"><circle cx="24" cy="24" r="{halo}"
fill="#fff" fill-opacity="0.45"/><path d="M24 24 l0 22 l5.2 -4.6 l3.4 7.8 l4.2 -1.8 l-3.4 -7.6 l7 -0.4 z"
fill="#fff" stroke="#000" stroke-width="1.5"/></svg>"""
Pair = tuple[float, float]


class Clock:
    """The time of the pictures, which is not that of the machine that makes them."""

    now = 100.0

    def perf_counter(self) -> float:
        """Seconds."""
        return self.now


class Still:
    """A loop in which nothing happens by itself."""

    def call_later(self, seconds: float, work: Callable[[], None]) -> None:
        """Do nothing."""


class Hand:
    """A hand at a window, and what was filmed of it."""

    def __init__(
        self,
        source: Path,
        recipe: Recipe | None = None,
        size: tuple[int, int] = SIZE,
        ratio: float = 1.0,
        options: ViewOptions | None = None,
    ) -> None:
        self.clock = views.time = windows.time = Clock()  # type: ignore[attr-defined]
        self.canvas = RenderCanvas(size=size, pixel_ratio=ratio)
        self.view: Any = opened(source, recipe, self.canvas, Still(), options=options or ViewOptions())
        self.canvas.set_title("")
        self.view.hinted = True  # the first hints lie over pictures
        self.place: Pair = (SIZE[0] * 0.3, SIZE[1] * 0.8)
        self.buttons: tuple[int, ...] = ()
        self.says = ""
        self.frames: list[np.ndarray] = []
        self.canvas.draw()  # which lays the picture out
        paint = self.view.painter.paint
        # All is drawn in full, as a hardware GPU does.
        self.view.painter.paint = lambda shot, *more: paint(
            replace(shot, sight=replace(shot.sight, solved=True)), *more
        )

    def send(self, kind: str, **event: Any) -> None:
        """Let something happen where the hand is."""
        self.clock.now += 1e-4
        common = {"event_type": kind, "modifiers": (), "time_stamp": self.clock.now, "ntouches": 0, "touches": {}}
        x, y = self.place
        self.canvas.submit_event(common | {"x": x, "y": y, "buttons": self.buttons} | event)
        self.canvas._process_events()

    def draw(self) -> np.ndarray:
        """Draw the window, in full."""
        view = self.view
        if view.stage.kind == "video":
            view.stage.film.want(*view.stage.needed(view.document.deformation, view.frame))
            assert view.stage.film.arrived(60.0)
        view.painter.coarse = 1
        view._changed_at = 0.0
        return np.asarray(self.canvas.draw())[..., :3]

    def shoot(self, seconds: float) -> None:
        """Film what is there for a time."""
        for _ in range(max(1, round(seconds * RATE))):
            self.clock.now += 1 / RATE
            if self.view.stage.kind != "volume":
                self.draw()  # what the last event changed in the panel is seen in the second
            self.frames.append(self.pointed(self.draw()))

    def pointed(self, pixels: np.ndarray) -> np.ndarray:
        """A frame with the pointer, and what the hand does beside it."""
        picture = pyvips.Image.new_from_array(np.ascontiguousarray(pixels)).copy(interpretation="srgb")
        x, y = (round(v) for v in self.place)
        arrow = pyvips.Image.svgload_buffer(POINTER.format(halo=16 if self.buttons else 0).encode())
        picture = picture.composite(arrow, "over", x=x - 24, y=y - 24)
        if self.says:
            words = self.says.replace("&", "&amp;")
            text = pyvips.Image.text(f'<span foreground="white">{words}</span>', font="sans 11", dpi=96, rgba=True)
            back = (pyvips.Image.black(text.width + 16, text.height + 12, bands=3) + 20).cast("uchar")
            label = back.bandjoin(210).copy(interpretation="srgb").composite(text, "over", x=8, y=6)
            left = min(x + 24, int(self.view.area[0]) - label.width - 4)
            picture = picture.composite(label, "over", x=left, y=y + 28)
        return np.asarray(picture[:3].numpy())

    def move(self, to: Pair, seconds: float = 0.7) -> None:
        """Go to a place, slowly at first and at last."""
        start, count = self.place, max(1, round(seconds * RATE))
        for k in range(1, count + 1):
            part = 0.5 - 0.5 * np.cos(np.pi * k / count)
            self.place = tuple(a + part * (b - a) for a, b in zip(start, to, strict=True))  # type: ignore[assignment]
            self.send("pointer_move", button=0)
            self.shoot(1 / RATE)

    def press(self, button: int = LEFT) -> None:
        """Press a button."""
        self.buttons = (button,)
        self.send("pointer_down", button=button)
        self.shoot(0.25)

    def release(self) -> None:
        """Let go."""
        (button,), self.buttons = self.buttons, ()
        self.send("pointer_up", button=button)
        self.says = ""
        self.shoot(0.25)

    def wheel(self, notches: int, says: str, *modifiers: str) -> None:
        """Turn the wheel, a notch each frame; up is above 0."""
        self.says = says
        for _ in range(abs(notches)):
            self.send("wheel", dx=0.0, dy=-100.0 * np.sign(notches), modifiers=modifiers)
            self.shoot(1 / RATE)
        self.says = ""

    def key(self, key: str, says: str, seconds: float, held: bool = False) -> None:
        """Press a key, and film it for a time; or hold it as long."""
        self.says = says
        self.send("key_down", key=key)
        if not held:
            self.send("key_up", key=key)
        self.shoot(seconds)
        if held:
            self.send("key_up", key=key)
        self.says = ""

    def drag(self, start: Pair, end: Pair, seconds: float = 0.9, button: int = LEFT, says: str = "drag") -> None:
        """Go somewhere, and drag from there."""
        self.move(start)
        self.says = says
        self.press(button)
        self.move(end, seconds)
        self.release()

    def certified(self) -> None:
        """Wait until the error is measured, which takes no time in the picture."""
        if self.view.stage.kind == "volume":  # it is known at once
            return
        while self.view.certifier.report(self.view.document.deformation) is None:
            pass

    def write(self, path: Path, quality: int) -> None:
        """Write what was filmed; equal frames take no room."""
        frames = [pyvips.Image.new_from_array(frame).copy(interpretation="srgb") for frame in self.frames]
        tall = pyvips.Image.arrayjoin(frames, across=1).copy()
        tall.set_type(pyvips.GValue.gint_type, "page-height", SIZE[1])
        tall.set_type(pyvips.GValue.array_int_type, "delay", [round(1000 / RATE)] * len(frames))
        tall.set_type(pyvips.GValue.gint_type, "loop", 0)
        # What is left of earlier frames shows as blocks, but for whole ones now and then.
        tall.webpsave(path, Q=quality, effort=5, kmin=RATE // 2, kmax=RATE, keep="none")
        print(f"{path.name}: {len(frames)} frames, {path.stat().st_size / 1e6:.2f} MB")
        self.view.close()

    def complete(self) -> None:
        """Wait until the rendering of a volume is whole, which takes no time in the picture."""
        while self.view.stage.kind == "volume" and self.view.filled < 1.0:
            self.canvas.draw()

    def still(self, path: Path, quality: int) -> None:
        """Write what is seen now."""
        self.complete()
        self.certified()
        self.picture(path, quality)
        self.view.close()

    def picture(self, path: Path, quality: int) -> None:
        """Write the canvas as it is."""
        for _ in range(3):  # the panel answers in the second
            pixels = self.draw()
        picture = pyvips.Image.new_from_array(np.ascontiguousarray(pixels)).copy(interpretation="srgb")
        picture.webpsave(path, Q=quality, effort=6, keep="none")
        print(f"{path.name}: {picture.width} x {picture.height}, {path.stat().st_size / 1e3:.0f} kB")


def photo(path: Path) -> None:
    """A cup becomes a heart: four drags, with the brush that each of them needs."""
    hand = Hand(DATA / "coffee.jpg")
    tools = hand.view.tools
    tools.scales = 2

    def pull(at: Pair, by: Pair, notches: int) -> None:
        hand.move(tools.view.to_canvas(*at))
        if notches:
            hand.wheel(notches, "wheel: radius")
        hand.says = "drag"
        hand.press()
        hand.move(tools.view.to_canvas(at[0] + by[0], at[1] + by[1]), 0.9)
        hand.release()

    pull((290, 24), (0, 44), -4)
    pull((290, 206), (0, 42), 6)
    pull((222, 48), (-16, -10), -3)
    pull((358, 48), (16, -10), 0)
    hand.move((540, 470))
    hand.certified()
    hand.shoot(0.8)
    hand.key("\\", "\\ held: the original", 1.0, held=True)
    hand.shoot(1.2)
    hand.write(path, 42)


def clip(path: Path) -> None:
    """A pixel is taken, carried through time by the wheel, and bent; then it plays."""
    hand = Hand(DATA / "bunny.mp4", Recipe(border=None))
    view = hand.view
    view.tools.playback.seek(38)
    view.tools.radius = 60.0
    place = view.tools.view.to_canvas
    hand.shoot(0.4)
    hand.move(place(350, 120))
    hand.says = "taken"
    hand.press()
    hand.wheel(10, "wheel: through time")
    hand.says = "drag"
    hand.move(place(385, 95), 0.9)
    hand.shoot(0.3)
    hand.release()
    hand.move((480, 380))
    hand.key("Home", "Home", 0.3)
    hand.key(" ", "Space: play", 64 / view.stage.rate)
    hand.shoot(0.8)
    hand.write(path, 65)


def volume(path: Path) -> None:
    """A head is pulled in a plane, which all views show; then its rendering is pulled, and turned."""
    hand = Hand(DATA / "head.nii.gz", Recipe(border=None))  # it reaches up to its borders
    tools = hand.view.tools

    def seen(*point: float) -> Pair:
        return tools.pane(2).to_canvas(point)

    hand.shoot(0.4)
    hand.drag(seen(45, 100, 28), seen(45, 101, 40), 1.2, says="drag: in a plane, seen in all")
    hand.complete()
    hand.shoot(0.6)
    hand.key("4", "4: the rendering alone", 0.8)
    width, height = tools.place[2:]
    hand.drag((0.9 * width, 0.8 * height), (0.6 * width, 0.75 * height), 1.0, says="beside it: turn")
    hand.move((0.5 * width, 0.35 * height))
    hand.wheel(-4, "Shift+wheel: radius", "Shift")
    hand.drag((0.5 * width, 0.3 * height), (0.5 * width, 0.16 * height), 1.2)
    hand.complete()
    hand.drag((0.5 * width, 0.5 * height), (0.8 * width, 0.55 * height), 1.4, button=RIGHT, says="right button: turn")
    hand.shoot(1.0)
    hand.write(path, 70)


def panel(path: Path) -> None:
    """A cup, symmetric about a line that was moved to its middle, on a large screen."""
    hand = Hand(DATA / "coffee.jpg", size=(1600, 1000))
    tools = hand.view.tools

    def drag(start: Pair, end: Pair) -> None:
        hand.drag(tools.view.to_canvas(*start), tools.view.to_canvas(*end), 0.1)

    hand.key("m", "", 0.1)
    at, y = tools.grip
    hand.drag((at, y), (tools.view.to_canvas(290, 0)[0], y), 0.1)
    tools.radius = 45.0
    drag((206, 60), (188, 48))
    tools.radius, tools.scales = 30.0, 2
    drag((290, 16), (290, 54))
    hand.key("t", "", 0.1)
    tools.radius = 40.0
    drag((370, 300), (388, 300))
    hand.view.document.select(0)
    hand.key("g", "", 0.1)
    hand.move(tools.view.to_canvas(420, 120))
    hand.still(path, 62)


def slices(path: Path) -> None:
    """A head with landmarks, pulled in the sagittal plane, on a small screen."""
    with tempfile.TemporaryDirectory() as folder:
        marks = Path(folder) / "marks.csv"
        marks.write_text("name,i,j,k\nnasion,45,104,28\nAC,45,63,36\nPC,45,49,37\n")
        hand = Hand(DATA / "head.nii.gz", Recipe(border=None), (1280, 720), options=ViewOptions(points=marks))
        place = hand.view.tools.pane(2).to_canvas
        hand.drag(place((45, 92, 44)), place((45, 84, 51)), 0.1)
        hand.move(hand.view.tools.pane(2).to_canvas((45, 70, 36)))
        hand.still(path, 75)


def history(path: Path) -> None:
    """A clip on a screen of small pixels: steps that were undone."""
    hand = Hand(DATA / "bunny.mp4", Recipe(border=None), (1280, 720), 2.0)
    view, document = hand.view, hand.view.document
    view.sections |= {"Brush": False, "View": False, "History": True}
    view.tools.playback.seek(38)
    view.tools.radius = 30.0
    for key, at, by in (("g", (350, 120), (30, -20)), ("w", (330, 90), (20, 0)), ("n", (250, 200), (0, 20))):
        hand.key(key, "", 0.1)
        start = view.tools.view.to_canvas(*at)
        hand.drag(start, (start[0] + by[0], start[1] + by[1]), 0.1)
    document.hide(2)
    document.replace(0, replace(document.strokes[0], radius=36.0))
    document.undo()
    hand.move(view.tools.view.to_canvas(200, 230))
    hand.still(path, 60)


PAIRS = (
    ((76.4, 72.8), (76.5, 68.5)),
    ((72.4, 67.4), (72.5, 63.1)),
    ((60.4, 50.2), (62.4, 54.7)),
    ((59.7, 69.5), (60.8, 67.1)),
)
"""Voxels y and z of the corpus callosum in the plane x = 60: of the registered head, and of the fixed one."""


def registration(path: Path, folder: Path) -> None:
    """A registration is corrected by pairs of landmarks and a drag, and written as one field."""
    from supple.fields import Field, Placed, read_maps

    maps = [
        Placed(each, name=name) for name in ("0GenericAffine.mat", "1Warp.nii.gz") for each in read_maps(folder / name)
    ]
    options = ViewOptions(maps=tuple(maps), fixed=folder / "fixed.nii.gz")
    hand = Hand(folder / "moving.nii.gz", Recipe(border=None), (1280, 800), options=options)
    view, tools, document = hand.view, hand.view.tools, hand.view.document
    view.sections |= {"Brush": False, "Volume": False, "View": False}
    hand.key("3", "", 0.1)
    tools.sight = tools.sight.at((60.0, 72.0, 62.0), tools.sizes)
    hand.draw()
    hand.move(tools.pane(2).to_canvas((60.0, 72.0, 62.0)), 0.1)
    hand.wheel(6, "", "Control")
    seen = [(view.document.deformation, view.slices.sampled(None, 0, 60), view.slices._fixed.sampled(None, 0, 60))]

    def click(k: int, y: float, z: float) -> None:
        hand.move(tools.pane(k).to_canvas((60.0, y, z)), 0.1)
        hand.press()
        hand.release()

    for one, other in PAIRS:
        hand.key("l", "", 0.1)
        click(2, *one)
        click(6, *other)
    marks = view.landmarks
    assert marks is not None
    print("residuals before, mm:", marks.residuals(document.deformation).round(2).tolist())
    tools.radius = 14.0
    hand.move((300.0, 780.0), 0.1)
    hand.picture(path.with_name("window-pairs.webp"), 70)
    stroke = marks.pull(document.deformation, tools.next_stroke)
    document.begin_drag()
    assert document.preview(stroke)
    document.commit()
    print("residuals after, mm:", marks.residuals(document.deformation).round(4).tolist())
    tools.compare("colours")
    hand.draw()
    tools.radius = 8.0
    hand.drag(tools.pane(2).to_canvas((60.0, 84.6, 47.4)), tools.pane(2).to_canvas((60.0, 86.0, 47.4)), 0.2)
    after = view.slices.sampled(document.deformation, 0, 60)
    part = np.s_[48:78, 56:92]
    for name, values in (("before", seen[0][1]), ("after", after)):
        both = np.corrcoef(values[part].ravel(), seen[0][2][part].ravel())[0, 1]
        print(f"correlation of both heads about the corpus callosum, {name}: {both:.3f}")
    hand.key("b", "", 0.1)
    hand.move((300.0, 780.0), 0.1)
    hand.picture(path, 70)
    for name, convention in (
        ("recipe.json", ""),
        ("2Corrected.nii.gz", "itk"),
        ("2Corrected_fsl.nii.gz", "fsl-relative"),
    ):
        if not convention:
            view.commands.save(folder / name, force=True)
            continue
        view.commands.field = convention
        view.commands.begin_export(folder / name, force=True)
        assert view.commands.export.join(600)
        assert view.commands.export.error is None, view.commands.export.error
    report = Field.read(folder / "2Corrected.nii.gz", "itk").check()
    print("one field:", report)
    view.close()


PICTURES: dict[str, Callable[[Path], None]] = {
    "photo": photo,
    "clip": clip,
    "volume": volume,
    "panel": panel,
    "slices": slices,
    "history": history,
}


def main(names: list[str]) -> None:
    """Make them."""
    with tempfile.TemporaryDirectory() as state:
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_CONFIG_HOME"] = state
        if names[:1] == ["registration"]:
            registration(HERE / "images" / "window-registration.webp", Path(names[1]))
            return
        for name in names or PICTURES:
            PICTURES[name](HERE / "images" / f"window-{name}.webp")


if __name__ == "__main__":
    main(sys.argv[1:])
