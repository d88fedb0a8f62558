"""The largest amounts of each brush in one step are those of docs/brushes.md; and a twist turns all the way."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from supple import Deformation, FoldError, FoldWarning, Stroke, SuppleError
from supple.folding.strain import MARGIN, weakest
from supple.space.domain import Domain
from supple.strokes import pack
from tests.children import ROOT

PAGE = (ROOT / "docs" / "brushes.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ((?:grab|scale|pinch)[^|]*) \| ([\d.]+)[^|]* \| ([\d.]+)[^|]* \|$", PAGE, re.MULTILINE)


def folds(brush: str, amount: float, reach: float | None) -> bool:
    name, _, which = brush.partition(",")
    n = 3 if "volume" in name else 2
    known: dict[str, Any] = {"by": (amount, 0)} if name == "grab" else {"factor": amount}
    scales = int(which.split()[0]) if name == "grab" else 1
    stroke = Stroke(brush=name.split()[0], at=(0,) * n, radius=1, reach=reach, scales=scales, **known)  # type: ignore[arg-type]
    row = pack([stroke], (1.0,) * n)
    return weakest(row, Domain((50,) * n, 1.0, None).packed(), MARGIN - 1, 0.0005)[0] < MARGIN - 1


@pytest.mark.parametrize("row", ROWS, ids=[row[0] for row in ROWS])
def test_the_page_names_the_largest_amounts(row: tuple[str, str, str]) -> None:
    for text, reach in zip(row[1:], (4.0, None), strict=True):
        stated = float(text)
        beyond = 0.98 * stated if "below" in row[0] else 1.015 * stated
        assert not folds(row[0], stated, reach)
        assert folds(row[0], beyond, reach)


def test_the_page_has_all_brushes() -> None:
    assert {row[0].split()[0].strip(",") for row in ROWS} == {"grab", "scale", "pinch"}
    assert len(ROWS) == 8


@pytest.mark.parametrize("border", [None, "auto"])
@pytest.mark.parametrize("turns", [90, -180, 270, 360, -450, 720, 3597])
def test_a_twist_turns_all_the_way(turns: float, border: Any) -> None:
    """Around a whole turn, the map changes little, and material near the pivot is wound up."""
    points = np.array([(100 + r, 100) for r in (0.0, 1e-3, 8.0, 16.0, 24.0, 60.0)])
    near = [Deformation((201, 201), border=border).twist((100, 100), angle=turns + by, radius=24) for by in (-2, 0, 2)]
    before, at, after = (d.forward(points) - 100 for d in near)
    wanted = np.radians(turns)
    np.testing.assert_allclose(at[1], 1e-3 * np.array([np.cos(wanted), np.sin(wanted)]), atol=2e-8)
    assert np.abs(before - after).max() < 3
    rows = near[1].space.table
    assert len(rows) == 1 if border is None else len(rows) >= abs(turns) / 90
    # A point close to the pivot turns by the whole angle, in one step or in several beside a border.
    total = np.degrees(2.5 * rows["p"][:, 0] / rows["radius2"][:, 0] ** 1.5).sum()
    assert total == pytest.approx(turns, abs=1e-9)


def test_too_large_a_twist_is_damped_or_refused_beside_a_border() -> None:
    d = Deformation((201, 201), on_fold="damp")
    with pytest.warns(FoldWarning, match=r"a twist by 360° at .* folds: damped to 0\.24 of it"):
        d = d.twist((100, 100), angle=360, radius=24)
    assert 360 * d.report().damping[0] == pytest.approx(89.4, abs=0.3)
    with pytest.raises(FoldError, match=r"folds: at most a twist by 89\.\d+° does not"):
        Deformation((201, 201), on_fold="error").twist((100, 100), angle=-360 + 720, radius=24)


@pytest.mark.parametrize("normal", [(1, 0, 0), (0, 0, 1), (1, 2, -0.5)])
@pytest.mark.parametrize("stroke", [{"brush": "twist", "angle": 50}, {"brush": "pinch", "factor": 0.6}])
def test_a_mirror_image_of_a_brush_without_an_axis(stroke: dict[str, Any], normal: tuple[float, ...]) -> None:
    """The image of the map is the map of the image, about the default axis, too."""
    made = Stroke(at=(20, 18, 15), radius=6, **stroke)
    n = np.array(normal) / np.linalg.norm(normal)
    mirror = np.eye(3) - 2 * np.outer(n, n)
    centre = np.array((20, 20, 20))
    points = made.at + np.random.default_rng(2).normal(0, 5, (50, 3))
    d = Deformation((41, 41, 41), border=None)
    image = d.add(made.mirrored(tuple(centre), normal)).forward((points - centre) @ mirror + centre)
    np.testing.assert_allclose(image, (d.add(made).forward(points) - centre) @ mirror + centre, atol=1e-9)


@pytest.mark.parametrize(
    ("at", "brush"),
    [
        ((6, 1), {"brush": "twist", "angle": -600, "radius": 30}),
        ((1, 20), {"brush": "pinch", "factor": 0.3, "radius": 100}),
        ((30, 0.3), {"brush": "twist", "angle": -100, "radius": 10}),
    ],
)
def test_what_would_be_squeezed_to_nothing_at_a_border_is_refused(at: Any, brush: Any) -> None:
    """Each step keeps its margin, but so many of them leave a Jacobian of no digits."""
    with pytest.raises(SuppleError, match="squeezes what lies around it"):
        Deformation((64, 64), border=2).add(Stroke(at=at, **brush))
