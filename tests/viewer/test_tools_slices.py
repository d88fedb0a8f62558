"""The planes of a volume: which way round they are seen, and what hands do in them."""

from __future__ import annotations

import numpy as np
import pytest

from supple.space.geometry import Geometry
from supple.strokes import Recipe, Stroke
from supple.viewer.document.editing import Document
from supple.viewer.tools.planes import RENDERED, planes_of
from supple.viewer.tools.volumes import VolumeTools
from tests.viewer.tools import MIDDLE, RIGHT, click, down, drag, move, press, up, wheel

AXIAL, CORONAL, SAGITTAL = 0, 1, 2
RAS = np.diag([-1.0, -1.0, 1.0])
MOST = (1000.0, 800.0)


def bench(direction: np.ndarray = RAS, convention: str = "RAS", *strokes: Stroke) -> VolumeTools:
    """A volume of 60 x 50 x 40 voxels of 1 x 2 x 3 mm, before nobody's camera."""
    geometry = Geometry((1, 2, 3), (0, 0, 0), direction, convention)
    document = Document((40, 50, 60), (1, 2, 3), Recipe(border=None), kind="volume", geometry=geometry)
    for stroke in strokes:
        document.add(stroke)
    return VolumeTools(document, geometry, MOST, lambda x, y: None, lambda pick, to: (0.0, 0.0, 0.0), (0.0, 100.0))


def middle(tools: VolumeTools, k: int) -> tuple[float, float]:
    left, top, width, height = tools.places[k]
    return left + width / 2, top + height / 2


def is_at_right(tools: VolumeTools, k: int, axis: int, way: int) -> bool:
    """Whether a step along an axis of the patient, in LPS, leads to the right."""
    pane, start = tools.pane(k), np.array(tools.index, float)
    step = np.zeros(3)
    step[axis] = 10.0 * way
    there = tools.geometry.from_lps(tools.geometry.to_lps(start) + step)
    return pane.to_canvas(tuple(there))[0] > pane.to_canvas(tuple(start))[0] + 1


@pytest.mark.parametrize("flips", [(1, 1, 1), (-1, -1, 1), (-1, 1, -1)])
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_planes_are_seen_as_by_radiologists_however_the_voxels_lie(order: tuple[int, ...], flips: tuple[int]) -> None:
    direction = np.zeros((3, 3))
    for axis, (row, sign) in enumerate(zip(order, flips, strict=True)):
        direction[row, axis] = sign
    tools = bench(direction, "LPS")
    axial, coronal, sagittal = tools.planes
    assert [plane.name for plane in tools.planes] == ["axial", "coronal", "sagittal"]
    assert axial.sides == ("R", "L", "A", "P")
    assert coronal.sides == ("R", "L", "S", "I")
    assert sagittal.sides == ("A", "P", "S", "I")
    assert [order[plane.axis] for plane in tools.planes] == [2, 1, 0]
    assert is_at_right(tools, AXIAL, 0, 1)  # the patient's left
    assert is_at_right(tools, CORONAL, 0, 1)
    assert is_at_right(tools, SAGITTAL, 1, 1)  # the back
    pane, step = tools.pane(CORONAL), np.array([0.0, 0.0, 10.0])
    above = tools.geometry.from_lps(tools.geometry.to_lps(tools.index) + step)
    assert pane.to_canvas(tuple(above))[1] < pane.to_canvas(tools.index)[1]


def test_oblique_volumes_are_named_by_what_is_nearest_and_others_by_their_axes() -> None:
    a = np.radians(25)
    turned = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ RAS
    assert [plane.sides for plane in planes_of(Geometry((1, 1, 1), (0, 0, 0), turned, "RAS"))] == [
        plane.sides for plane in planes_of(Geometry((1, 1, 1), (0, 0, 0), RAS, "RAS"))
    ]
    plain = planes_of(Geometry())
    assert [plane.name for plane in plain] == ["xy", "xz", "yz"]
    assert plain[0].sides == ("-x", "+x", "-y", "+y")
    assert plain[2].sides == ("-y", "+y", "+z", "-z")


def test_a_point_of_a_plane_is_where_it_is_seen_and_millimetres_are_square() -> None:
    tools = bench()
    wheel(tools, -300, "Control", x=100, y=90)
    for k, plane in enumerate(tools.planes):
        pane = tools.pane(k)
        x, y = middle(tools, k)
        point = pane.to_point(x + 30, y - 20)
        assert pane.to_canvas(point) == pytest.approx((x + 30, y - 20))
        away = (np.array(point) - pane.to_point(x, y)) * tools.geometry.spacing
        assert abs(away[plane.across]) == pytest.approx(30 / pane.scale)
        assert abs(away[plane.down]) == pytest.approx(20 / pane.scale)
        assert point[plane.axis] == pane.index[plane.axis]


@pytest.mark.parametrize("k", [AXIAL, CORONAL, SAGITTAL])
def test_a_drag_in_a_plane_stays_in_it(k: int) -> None:
    tools = bench()
    tools.radius = 9.0
    x, y = middle(tools, k)
    pane = tools.pane(k)
    start, end = pane.to_point(x + 5, y), pane.to_point(x + 45, y - 30)
    drag(tools, (x + 5, y), (x + 20, y - 10), (x + 45, y - 30))
    (stroke,) = tools.document.strokes
    assert stroke.at == pytest.approx(start)
    assert stroke.by == pytest.approx(np.subtract(end, start))
    assert stroke.by[pane.plane.axis] == 0
    assert stroke.radius == 9.0
    assert tools.sight.cross == pytest.approx(start)  # so that the other planes show it, too
    # Its end is there, and can be dragged on; in another plane, it is not.
    drag(tools, (x + 45, y - 30), (x + 45, y))
    assert tools.document.strokes[0].by == pytest.approx(np.subtract(pane.to_point(x + 45, y), start), abs=1e-6)
    assert len(tools.document.strokes) == 1
    tools.step(k, 2)
    assert tools.handles() == []


def test_a_drag_goes_on_in_its_plane_over_the_others() -> None:
    tools = bench()
    x, y = middle(tools, AXIAL)
    wheel(tools, -600, "Control", x=x, y=y)  # so large that the volume goes on beyond its view
    (left, top, width, height), pane = tools.places[AXIAL], tools.pane(AXIAL)
    far = left + width + 20, top + height + 10
    assert tools.places[SAGITTAL][0] < far[0]
    before = tools.sight
    down(tools, x, y)
    move(tools, *far)
    assert tools.document.strokes[0].by == pytest.approx(np.subtract(pane.to_point(*far), pane.to_point(x, y)))
    press(tools, "Escape")
    up(tools, *far)
    assert tools.document.strokes == ()
    assert tools.sight == before


def test_a_click_moves_the_crosshair_and_selects_what_is_there() -> None:
    tools = bench()
    x, y = middle(tools, CORONAL)
    pane = tools.pane(CORONAL)
    click(tools, x + 40, y - 25)
    wanted = tools.sight.at(pane.to_point(x + 40, y - 25), tools.sizes).cross
    assert tools.sight.cross == pytest.approx(wanted)
    assert tools.index[1] == pane.index[1]
    assert tools.document.strokes == ()
    tools.document.add(Stroke.grab(tuple(map(float, tools.index)), by=(0, 0, 0.5), radius=5))
    tools.document.select(None)
    place, before = tools.pane(CORONAL).to_canvas(tools.index), tools.index
    click(tools, *place)
    assert tools.document.selected == 0
    assert tools.index == before


def test_shift_and_drag_moves_the_crosshair_and_escape_puts_it_back() -> None:
    tools = bench()
    (x, y), pane, before = middle(tools, SAGITTAL), tools.pane(SAGITTAL), tools.sight
    down(tools, x, y, "Shift")
    move(tools, x + 30, y + 10, "Shift")
    assert tools.sight.cross == pytest.approx(pane.to_point(x + 30, y + 10))
    press(tools, "Escape")
    assert tools.sight == before
    up(tools, x + 30, y + 10)
    drag(tools, (x, y), (x + 9000, y), modifiers=("Shift",))
    assert tools.sight.cross[1] in (0.0, 49.0)  # the end of the volume
    assert tools.document.strokes == ()


def test_the_wheel_scrolls_zooms_or_widens_the_brush() -> None:
    tools = bench()
    x, y = middle(tools, AXIAL)
    wheel(tools, -200, x=x, y=y)
    assert tools.index == (30, 25, 22)  # forward is to the head
    x, y = middle(tools, CORONAL)
    wheel(tools, -100, x=x, y=y)
    lps = [tools.geometry.to_lps((30, k, 22))[1] for k in (25, tools.index[1])]
    assert lps[1] < lps[0]  # and to the front
    for key, k in (("ArrowUp", 1), ("ArrowDown", -1)):
        at = tools.index[1]
        press(tools, key)
        assert tools.index[1] == at + k
    point, scale = tools.pane(CORONAL).to_point(x + 50, y), tools.pane(CORONAL).scale
    wheel(tools, -100, "Control", x=x + 50, y=y)
    assert tools.pane(CORONAL).scale == pytest.approx(1.2 * scale)
    assert tools.pane(CORONAL).to_canvas(point) == pytest.approx((x + 50, y))
    radius, index = tools.radius, tools.index
    wheel(tools, -100, "Shift", x=x, y=y)
    assert tools.radius == pytest.approx(1.1 * radius)
    assert tools.index == index
    wheel(tools, 1e9, x=x, y=y)
    assert tools.index[1] in (0, 49)
    tools.sight = tools.sight.levelled(2.0, 0.5)
    press(tools, "0")
    assert tools.sight.window == (0, 100)
    assert tools.pane(CORONAL).scale == pytest.approx(scale)


def test_right_drags_change_contrast_and_brightness() -> None:
    tools = bench()
    x, y = middle(tools, AXIAL)
    drag(tools, (x, y), (x, y - 50), button=RIGHT)
    assert tools.sight.window == pytest.approx((-25, 75))
    drag(tools, (x, y), (x + 200, y), button=RIGHT)
    low, high = tools.sight.window
    assert high - low == pytest.approx(100 * np.e)
    assert low + high == pytest.approx(50)
    assert tools.document.strokes == ()


def test_middle_drags_and_drags_beside_the_volume_move_all_planes() -> None:
    tools = bench()
    x, y = middle(tools, AXIAL)
    point = tools.pane(AXIAL).to_point(x, y)
    drag(tools, (x, y), (x + 30, y + 12), button=MIDDLE)
    assert tools.pane(AXIAL).to_canvas(point) == pytest.approx((x + 30, y + 12))
    a, b = middle(tools, CORONAL)
    assert tools.pane(CORONAL).to_canvas((point[0], 0, tools.sight.middle[2]))[0] == pytest.approx(a + 30)
    left, top, _, _ = tools.places[AXIAL]
    drag(tools, (left + 3, top + 40), (left + 3, top + 28))
    assert tools.pane(AXIAL).to_canvas(point) == pytest.approx((x + 30, y))
    assert tools.document.strokes == ()
    assert b > 0


def test_a_view_is_enlarged_by_its_key_or_its_button_and_put_back() -> None:
    tools = bench()
    for key, k in (("1", AXIAL), ("2", CORONAL), ("3", SAGITTAL), ("4", RENDERED)):
        press(tools, key)
        assert tools.places == {k: (0, 0, *MOST)}
        assert tools.active == k
        press(tools, key)
        assert len(tools.places) == 4
    for k in range(4):
        left, top, width, height = tools.button(k)
        click(tools, left + width / 2, top + height / 2)
        assert list(tools.places) == [k]
        left, top, width, height = tools.button(k)
        click(tools, left + width / 2, top + height / 2)
        assert len(tools.places) == 4
    assert tools.document.strokes == ()


def test_the_ring_and_the_hover_are_those_of_the_view_under_the_pointer() -> None:
    tools = bench()
    tools.radius = 12.0
    x, y = middle(tools, SAGITTAL)
    move(tools, x, y, buttons=())
    pane = tools.pane(SAGITTAL)
    assert tools.hover == pytest.approx(pane.to_point(x, y))
    assert tools.ring == pytest.approx(12 * pane.scale)
    left, top, _, _ = tools.places[SAGITTAL]
    move(tools, left + 2, top + 40, buttons=())
    assert tools.hover is None
    assert tools.ring is None
    move(tools, *middle(tools, RENDERED), buttons=())
    assert tools.pane_under is None


def test_the_split_has_a_knob_in_each_view() -> None:
    tools = bench()
    press(tools, "b")
    x, y = middle(tools, CORONAL)
    move(tools, x, y, buttons=())
    assert tools.knob_in(tools.place) == pytest.approx((x, y))
    left, _, width, _ = tools.places[CORONAL]
    drag(tools, (x, y), (left + 0.25 * width, y))
    assert tools.split == pytest.approx(0.25)
    assert tools.document.strokes == ()


def test_the_planes_follow_the_size_of_the_canvas() -> None:
    tools = bench()
    tools.handle({"event_type": "resize", "width": 600, "height": 500, "pixel_ratio": 1})
    assert tools.places[RENDERED][0] + tools.places[RENDERED][2] == 600
    assert tools.corner == tools.places[RENDERED][:2]
    for k in (AXIAL, CORONAL, SAGITTAL):
        pane = tools.pane(k)
        left, top, width, height = pane.place
        x, y, wide, high = pane.box
        assert left < x
        assert x + wide < left + width
        assert top < y
        assert y + high < top + height
