"""The table's scenes are what they are said to be, so that its rows show what they should."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engine.table import CLIP, PLANE, SCENES, places, rows, scene


@pytest.mark.parametrize(("name", "shape", "sides"), [("image", PLANE, 2), ("clip", CLIP, 5), ("small clip", None, 3)])
def test_points_come_from_outside(name: str, shape: tuple[int, ...] | None, sides: int) -> None:
    size = np.array(shape or scene(name).shape)[::-1] - 1
    points = places(name).points.reshape(-1, len(size))
    away = np.concatenate([-points.min(axis=0), points.max(axis=0) - size])
    assert (away > 1).sum() >= sides
    if len(size) == 3:
        assert (away[[2, 5]] > 1).any()  # beyond an end, too
        assert name != "clip" or (away[[2, 5]] > 1).all()


def test_maps_shrink_and_magnify() -> None:
    for name in ("image", "clip"):
        sizes = np.linalg.svd(places(name).matrices[..., :2, :2], compute_uv=False)
        assert sizes.max() > 1.5
        assert sizes.min() < 0.75
    squeezed = np.linalg.svd(places("image, squeezed").matrices, compute_uv=False)
    assert squeezed[..., 1].max() ** 2 > 4  # so that averages are of a pyramid
    assert np.linalg.norm(places("clip, hurried").matrices[..., 2, :], axis=-1).max() > 2


def test_parts_are_left_alone() -> None:
    for name in SCENES:
        touched = places(name).touched
        assert touched.any()
        assert touched.all() == ("local" not in name and "frozen" not in name), name


def test_rows_have_names_of_their_own() -> None:
    made = rows(SCENES, kinds=["plain", "opacity", "light", "opacity and light"])
    assert len({str(row) for row in made}) == len(made)
    few = rows(["image", "clip"], few=True)
    for one, other in (("dtype", "filter"), ("filter", "outside"), ("dtype", "outside")):
        met = {(getattr(row, one), getattr(row, other)) for row in few}
        assert len(met) == len({a for a, _ in met}) * len({b for _, b in met})
