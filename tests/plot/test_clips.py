"""Plots of videos before and after: cuts along time, and sheets of frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation
from supple.plot import clip_sheet, clip_slice, draw_sheet, draw_slice, figure
from supple.plot.clip import evenly
from supple.plot.frame import check_plot
from tests import effort
from tests.refusals import refused

Array = npt.NDArray[Any]


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def shown(axes: Any) -> Array:
    return np.asarray(axes.images[0].get_array())


@pytest.mark.parametrize(("count", "rows"), [(100, 1080), (12, 8), (1, 1), (1600, 30), (1, 1600)])
def test_a_cut_shows_every_frame_and_every_row(count: int, rows: int) -> None:
    before, after = noise(count, rows, 3), noise(count, rows, 3, seed=1)
    made = clip_slice(before, after, 7)
    left, right = made.axes
    for axes, cut, name in ((left, before, "Before"), (right, after, "After")):
        np.testing.assert_array_equal(shown(axes), cut.swapaxes(0, 1))
        assert axes.images[0].get_extent() == [-0.5, count - 0.5, rows - 0.5, -0.5]
        assert axes.images[0].get_interpolation() == "nearest"
        assert axes.get_title(loc="left") == name
    assert left.get_ylabel() == "y (px)"
    assert right.get_xlabel() == "t (frames)"
    assert "x = 7" in made.get_suptitle()


def test_long_cuts_are_averaged() -> None:
    before = noise(4000, 1700, 3)
    seen = shown(clip_slice(before, before, 0).axes[0])
    assert seen.shape == (850, 1334, 3)
    first = np.rint(before[:3].mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(seen[0, 0], first[:2].mean(axis=0), atol=0.51)


def test_a_sheet_has_two_rows_with_the_frames_numbers() -> None:
    before = [(k, noise(20, 30, 3, seed=k)) for k in (0, 5, 9)]
    after = [(k, 255 - frame) for k, frame in before]
    made = clip_sheet(before, after)
    assert [axes.get_title() for axes in made.axes] == ["frame 0", "frame 5", "frame 9"] * 2
    assert [axes.get_ylabel() for axes in made.axes] == ["Before", "", "", "After", "", ""]
    for axes, (_, frame) in zip(made.axes, [*before, *after], strict=True):
        np.testing.assert_array_equal(shown(axes), frame)
        assert axes.images[0].get_interpolation() == "nearest"


@pytest.mark.parametrize(
    ("shape", "columns"), [((1080, 1920, 3), 6), ((1920, 1080, 3), 2), ((1, 1, 3), 1), ((3, 900, 3), 4)]
)
def test_a_sheet_keeps_the_frames_proportions(shape: tuple[int, ...], columns: int) -> None:
    frames = [(k, np.full(shape, 77, np.uint8)) for k in range(columns)]
    made = clip_sheet(frames, frames)
    made.canvas.draw()
    assert (shown(made.axes[0]) == 77).all()
    for axes in made.axes:
        box = axes.get_window_extent()
        assert box.height / box.width == pytest.approx(shape[0] / shape[1], rel=0.02)
    assert made.get_size_inches()[0] <= 25


@pytest.mark.parametrize(
    ("what", "shape"),
    [
        (what, shape)
        for k, what in enumerate(["axes", "stretch", "residual", "grid", "iterations"])
        for n, shape in enumerate([(20, 200), (170, 400), (200, 60)])
        if effort.ALL or (k + n) % 3 == 0
    ],
)
def test_every_word_is_in_the_picture(what: str, shape: tuple[int, int]) -> None:
    height, width = shape
    made = figure(Deformation((8, *shape)).grab((width / 2, height / 2, 4), by=(3, 0, 0), radius=20), what, frame=4)
    made.canvas.draw()
    whole = made.bbox
    for axes in made.axes:
        for text in (axes.yaxis.label, axes.xaxis.label):
            box = text.get_window_extent()
            assert not text.get_text() or (box.y0 >= -1 and box.y1 <= whole.y1 + 1), text.get_text()


def test_frames_evenly_spaced() -> None:
    assert evenly(100, 5) == [0, 25, 50, 74, 99]
    assert evenly(3, 8) == [0, 1, 2]
    assert evenly(1, 4) == [0]
    assert evenly(10, 1) == [0]


def test_both_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    cut, frames = noise(6, 9, 3), [(3, noise(9, 7, 3))]
    for name in ("a.png", "b.svg", "c.pdf"):
        draw_slice(cut, cut, 3, tmp_path / name)
        refused(draw_sheet, frames, frames, tmp_path / name, match="exists")
        draw_sheet(frames, frames, tmp_path / name, force=True)
        refused(check_plot, tmp_path / name, match="exists")
    refused(check_plot, tmp_path / "a.jpg", match=r"must end in \.png, \.svg, \.pdf")
    refused(draw_slice, cut, cut[:5], 3, tmp_path / "d.png", match=r"one shape, found \(6, 9, 3\) and \(5, 9, 3\)")
    refused(draw_sheet, frames, [], tmp_path / "d.png", match="as many frames, found 1 and 0")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.svg", "c.pdf"]
