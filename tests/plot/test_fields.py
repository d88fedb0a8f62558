"""The picture of a field that was checked: what it shows, and that it is drawn for every shape."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from supple import Field, Grid, SuppleError
from supple.plot import fields as drawn
from supple.plot.fields import draw_check
from tests import effort
from tests.sampled_fields import GRID, sine, smooth


def figure(field: Field, inverse: Field | None = None) -> Any:
    folded, logarithms = field.folded_cells(), field.log_jacobian()
    distances = None if inverse is None else field.distances(inverse)
    report = field.reported(folded, logarithms, distances)
    return drawn._figure(drawn._slice(field, report.grid, folded, logarithms, distances), report, "u.mha")


def titles(made: Any) -> list[str]:
    return [axes.get_title(loc="left") for axes in made.axes if axes.get_title(loc="left")]


def labels(made: Any) -> list[str]:
    return [text.get_text() for legend in made.legends for text in legend.get_texts()]


def test_a_fold_is_shown_from_far_and_near() -> None:
    values = np.zeros((6, 60, 80, 3))
    values[2, 30:40, 40, 0] = -3.0
    field = Field.from_array(values, spacing=(1, 1, 2))
    made = figure(field, field)
    assert [title.partition(":")[0].partition(",")[0] for title in titles(made)] == [
        "Grid", "The same around the folds", "ln det(I + ∂u/∂x)", "|second(first(x)) − x|",
    ]  # fmt: skip
    assert labels(made) == [
        "grid at rest", "moved", "cells that fold", "determinant not above 0, by central differences",
    ]  # fmt: skip
    told = made._suptitle.get_text()
    assert f"{field.check().folded:,} of 23,305 cells fold" in told
    assert "slice 2 (of 0 to 5)" in told
    assert "mm" in told
    near = made.axes[1]
    assert near.get_xlim()[0] < 37 < 40 < near.get_xlim()[1]
    assert near.get_ylim()[1] < 30 < 39 < near.get_ylim()[0]  # y points down


def test_without_folds_the_middle_is_shown() -> None:
    made = figure(smooth(size=0.5))
    assert len(titles(made)) == 2
    assert labels(made) == ["grid at rest", "moved"]
    assert "none of 2,464 cells folds; axial slice 5 (of 0 to 11), at S 44.81 mm" in made._suptitle.get_text()
    (_, shown, *_) = made.axes
    logarithms = smooth(size=0.5).log_jacobian()[5]
    np.testing.assert_array_equal(shown.images[0].get_array(), logarithms[::-1])  # whose second axis leads to A


def test_the_grid_is_drawn_along_its_own_axes() -> None:
    """A displacement along the second axis of a turned grid, which leads to A, moves the lines up."""
    values = np.broadcast_to(2.5 * np.array(GRID.direction)[:, 1], (*GRID.shape, 3))
    seen = drawn._slice(Field(values, GRID), GRID, np.zeros((11, 16, 14), bool), np.zeros(GRID.shape, "f4"), None)
    np.testing.assert_allclose(seen.moved - seen.rest, np.broadcast_to((0, -2.5), seen.rest.shape), atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "size", "suffix"),
    [
        (shape, *how)
        for k, shape in enumerate([(2, 2), (1, 1), (300, 3), (1, 8, 9), (5, 1, 1), (3, 40, 40)])
        for n, how in enumerate([(0.0, ".png"), (3.0, ".svg")])
        if effort.ALL or (k + n) % 2
    ],
)
def test_any_shape_is_drawn(tmp_path: Path, shape: tuple[int, ...], size: float, suffix: str) -> None:
    values = size * np.random.default_rng(0).normal(size=(*shape, len(shape)))
    field = Field(values, Grid(shape))
    folded, logarithms, distances = field.folded_cells(), field.log_jacobian(), field.distances(field)
    report = field.reported(folded, logarithms, distances)
    path = tmp_path / f"p{suffix}"
    draw_check(field, report, folded, logarithms, distances, path)
    assert path.stat().st_size > 5000


def test_a_fifth_that_folds_leaves_the_rest_to_be_seen() -> None:
    rng = np.random.default_rng(1)
    waves = np.stack([gaussian_filter(rng.normal(size=(30, 60, 60)), 4) for _ in range(3)], axis=-1)
    field = Field((9 / waves.std() * waves).astype(np.float32), Grid((30, 60, 60), (2.0, 2.0, 2.0)))
    assert 0.15 < field.folded_cells().mean() < 0.4
    made = figure(field)
    jacobian = next(axes for axes in made.axes if axes.get_title(loc="left").startswith("ln det"))
    jacobian.set(xticks=(), yticks=())
    made.canvas.draw()
    pixels = np.asarray(made.canvas.buffer_rgba())[..., :3].astype(int)
    box = jacobian.get_window_extent()
    part = pixels[len(pixels) - int(box.y1) : len(pixels) - int(box.y0), int(box.x0) : int(box.x1)]
    marked = np.abs(part - (240, 200, 0)).max(axis=2) < 90  # outlines
    black = part.max(axis=2) < 30  # their halos
    assert 0.001 < marked.mean() < 0.08
    assert black.mean() < 0.02


def test_equal_checks_are_equal_pictures_and_are_kept(tmp_path: Path) -> None:
    field = sine(1.5, (40, 126))
    folded, logarithms = field.folded_cells(), field.log_jacobian()
    report = field.reported(folded, logarithms)
    for name in ("a.png", "b.png"):
        draw_check(field, report, folded, logarithms, None, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with pytest.raises(SuppleError, match=r"a.png exists already"):
        draw_check(field, report, folded, logarithms, None, tmp_path / "a.png")
