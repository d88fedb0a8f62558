"""What retouchers do, by hand alone, each within a minute: where points of the picture go."""

from __future__ import annotations

import pytest

import supple
from supple.gpu.device import Gpu
from tests.viewer.windows import DATA, Boxes, opened

AXIS = "m |220,178>225,105"  # from the chin to the nose
BEND = "w 171,115>195,115 318,136>342,136 g 225,250>225,275"
Ends = dict[tuple[int, int], tuple[float, float]]
JOBS: dict[str, tuple[str, str, Ends]] = {
    "slim a face": ("astronaut", f"{AXIS} [*4 182,135>188,134", {(182, 135): (188, 134), (264, 141): (258.2, 139.2)}),
    "bend a handle": (
        "coffee",
        "c [*2 185,205>262,225>330,250 f [*4 213,300>195,312>176,312>160,300",
        {(213, 300): (160, 300), (262, 225): (262, 225)},
    ),
    "bloat eyes and pucker a nose": (
        "chelsea",
        "w 171,115>185,115 318,136>332,136 p 245,190>256,190",
        {(171, 115): (171, 115), (181, 115): (183.4, 115), (318, 126): (318, 123.6), (245, 180): (245, 181.4)},
    ),
    "restore, undo": (
        "astronaut",
        "305,330>345,330 r 330,290>335,330>330,360 Control+z Control+y",
        {(305, 330): (305.8, 330.1)},
    ),
    "freeze, and push beside it": (
        "astronaut",
        "c [*3 425,20>425,160>430,300 a [*6 366,400>356,330>335,280",
        {(425, 160): (425, 160), (356, 330): (347.5, 333)},
    ),
    "protect the eyes": (
        "astronaut",
        "c [*9 196,101>214,101 238,104>256,104 g ]*7 181,130>188,130 270,130>263,130",
        {(203, 101): (203, 101), (246, 104): (246, 104), (181, 130): (186.9, 130)},
    ),
    "level, and slim": (
        "coffee",
        "y 100,100>300,120 g 180,150>190,151",
        {(100, 100): (53.5, 94.9), (300, 120): (254.1, 94.9)},
    ),
    "a tilted axis": (
        "astronaut",
        f"{AXIS} [*9 w 204,101>210,101",
        {(212, 101): (212.8, 101), (237, 104): (236.2, 104)},
    ),
    "all brushes": (
        "coffee",
        "t 60,80>90,85 p 160,80>190,85 n 260,80>290,85 s 60,80>90,85 m g 150,330>170,320 m d 210,300>220,310",
        {(60, 80): (60, 80), (150, 330): (170, 320)},
    ),
    "half of everything": ("chelsea", f"{BEND} amount=50", {(225, 250): (225, 262.5)}),
}


@pytest.mark.parametrize(("picture", "hands", "ends"), JOBS.values(), ids=JOBS)
def test_a_job_by_hand(gpu: Gpu, picture: str, hands: str, ends: Ends, boxes: Boxes) -> None:
    view, hand = opened(DATA / f"{picture}.jpg", size=(1000, 640))
    tools = view.tools
    assert tools.radius == min(view.document.shape) / 12
    assert 4 * len(hands.split()) < 60  # seconds, of which a drag takes two
    for word in hands.split():
        key, _, number = word.partition("*" if "*" in word else "=")
        places = word.strip("|").split(">") if "," in word else []
        way = [tools.view.to_canvas(*map(float, place.split(","))) for place in places]
        if word[0] == "|":
            (x, y), (a, b) = way
            for knob in ("grip", "tilt"):
                at = getattr(tools, knob)
                hand.draw(at, (x + (a - x) * (at[1] - y) / (b - y), at[1]))
        elif way:
            hand.draw(*way)
        elif "=" in word:
            hand.modifiers = ("Control",)
            hand.send("key_down", key="Control")
            hand.click(boxes.place(f"##{key}"))
            hand.modifiers = ()
            hand.send("key_up", key="Control")
            for letter in number:
                hand.send("char", data=letter)
            hand.key("Enter")
            for _ in range(6):
                hand.canvas.draw()
        else:
            for _ in range(int(number or 1)):
                hand.key(*reversed(key.split("+")))
    for i in range(len(view.document.strokes)):
        view.document.select(i)
        hand.canvas.draw()  # the panel shows each by its numbers
    assert view._gui.trouble == ""
    bent = supple.Deformation.from_recipe(view.recipe, view.document.shape)
    for place, end in ends.items():
        assert bent.forward(place) == pytest.approx(end, abs=0.2)
