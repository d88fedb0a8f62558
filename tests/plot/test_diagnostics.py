"""Diagnostics: the numbers behind the pictures, the published method as a baseline, and the files."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, Stroke, SuppleError
from supple.engine import paper
from supple.media.image import Picture
from supple.plot import WHATS, figure, plot
from supple.plot.frame import background, paths
from supple.plot.measure import footprints, grid, iterations, residual, sources, spacing_of, stretch
from tests import effort
from tests.children import SOURCE
from tests.refusals import refused

FIG_6_1B = Deformation((512, 512), border=None, on_fold="damp").grab((256, 256), by=(0, 90), radius=100, reach=None)
VIDEO = Deformation((30, 48, 64), border=8, spacing=(1.0, 1.0, 1.5), on_fold="damp").grab(
    (30, 20, 14), by=(4, 3, 4.5), radius=15, reach=None
)
SMALL = (
    Deformation((60, 80), border=12, on_fold="damp")
    .grab((30, 25), by=(9, 11), radius=20, reach=None)
    .grab((50, 30), by=(-8, 3), radius=15, reach=None)
)


def pixels(shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    return np.stack(np.meshgrid(np.arange(float(shape[1])), np.arange(float(shape[0]))), axis=-1)


@functools.cache
def published(deformation: Deformation, **options: Any) -> tuple[npt.NDArray[Any], ...]:
    height, width = deformation.shape[-2:]
    return paper.inverse_map(deformation.space.table, deformation.space.axes, (height, width), **options)


def test_the_published_method_does_as_published() -> None:
    points, counts, residuals = published(FIG_6_1B)
    error = np.linalg.norm(points - FIG_6_1B.inverse(pixels((512, 512))).points, axis=-1)
    assert points.dtype == np.float32
    assert residuals.max() < 0.1
    assert error.max() == pytest.approx(0.155, abs=0.001)
    assert np.percentile(counts[156:356, 156:356], [1, 99]) == pytest.approx([9, 16], abs=1)
    assert counts.max() == 17
    assert (counts >= 9).mean() > 0.8


FLAT = Deformation((60, 80), border=12, spacing=(1.0, 1.5), on_fold="damp").grab(
    (30, 25), by=(6, 4), radius=20, reach=None
)


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize(
    ("d", "q"),
    [
        *((FIG_6_1B, q) for q in [(285.0, 301.0), (256.0, 256.0), (240.0, 400.0), (330.0, 200.0), (0.0, 0.0)]),
        (VIDEO, (31.0, 22.0, 17.0)),
    ],
)
def test_its_matrix_and_step_are_as_written_there(d: Deformation, q: tuple[float, ...], corrected: bool) -> None:
    p, steps, unit = np.array(q), 0, np.array(d.domain.spacing)  # it works in physical units
    while np.linalg.norm(d.forward(p) - q) >= 0.1:
        J = (d.jacobian(p) - np.eye(d.ndim)) * unit[:, None] / unit
        A = J.T @ J + (J.T + J if corrected else 2 * J.T) + np.eye(d.ndim)
        b = -(J.T + np.eye(d.ndim)) @ ((d.forward(p) - q) * unit)
        p, steps = p + 0.5 * np.linalg.solve(A, b) / unit, steps + 1
    points, counts, _ = published(d, corrected=corrected, **({"z": q[2]} if d.ndim == 3 else {}))
    x, y = map(int, q[:2])
    assert counts[y, x] == steps > 3
    np.testing.assert_allclose(points[y, x], p, atol=1e-4)


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize(
    ("d", "frame"),
    [
        (FLAT.grab((50, 30), by=(-5, 3), radius=15, scales=3, reach=None), None),
        (VIDEO.grab((40, 30, 10), by=(-5, 3, -4), radius=12, scales=2, reach=None), 17),
    ],
)
def test_it_undoes_a_sequence_with_a_fixed_border_and_any_spacing(
    d: Deformation, frame: int | None, corrected: bool
) -> None:
    more = {} if frame is None else {"z": float(frame)}
    points, counts, residuals = published(d, tolerance=1e-7, limit=3000, corrected=corrected, **more)
    q = pixels(d.shape) if frame is None else plane(frame)
    np.testing.assert_allclose(points, d.inverse(q).points, atol=2e-5)
    np.testing.assert_allclose(residuals, np.linalg.norm(d.forward(points) - q, axis=-1), atol=1e-9)
    assert counts.max() > 20


def test_it_says_where_it_has_not_converged() -> None:
    points, counts, residuals = published(FIG_6_1B, limit=5)
    assert counts.max() == 5
    off = np.linalg.norm(FIG_6_1B.forward(points) - pixels((512, 512)), axis=-1)
    np.testing.assert_allclose(residuals, off, atol=1e-4)
    assert (residuals >= 0.1).mean() > 0.9


def test_every_so_many_pixels_are_those_of_all() -> None:
    full, some = published(SMALL), published(SMALL, every=7)
    for a, b in zip(full, some, strict=True):
        np.testing.assert_array_equal(a[::7, ::7], b)


def test_iterations_compare_both() -> None:
    found = iterations(FIG_6_1B)
    assert found.every == 1
    assert found.unconverged == 0
    assert found.published_error.max() == pytest.approx(0.155, abs=0.001)
    # Hardly more evaluations than Newton's method has steps from q: it looks at where it arrives, too.
    p = q = pixels((512, 512))[::8, ::8]
    steps = np.zeros(q.shape[:2])
    while (going := np.linalg.norm(off := FIG_6_1B.forward(p) - q, axis=-1) >= 1e-9).any():
        p = np.where(going[..., None], p - np.linalg.solve(FIG_6_1B.jacobian(p), off[..., None])[..., 0], p)
        steps += going
    more = found.ours[::8, ::8] - steps
    assert 1 <= more.min() <= more.mean() <= 2.05
    assert found.ours.mean() < 0.6 * found.published.mean()
    assert found.residual.max() < 1e-6


@pytest.mark.parametrize("deformation", [FIG_6_1B, SMALL, Deformation((60, 80), border=64, on_fold="damp")])
def test_the_residual_is_that_of_the_map_and_within_its_bound(deformation: Deformation) -> None:
    found = residual(deformation, tolerance=0.003)
    assert found.distance.max() <= found.bound <= found.tolerance == 0.003
    assert found.bound == deformation.report(tolerance=0.003).error
    assert found.unconverged == 0
    exact = deformation.inverse(pixels(deformation.shape)).points
    shown = np.linalg.norm(deformation.inverse_map(tolerance=0.003) - exact, axis=-1)
    np.testing.assert_allclose(found.distance, shown, atol=1e-4)


@pytest.mark.parametrize(("d", "frame"), [(SMALL, None), (VIDEO, 16)])
def test_stretch_is_the_slope_of_the_map(d: Deformation, frame: int | None) -> None:
    q = pixels(d.shape) if frame is None else plane(frame)
    p, h = d.inverse(q).points[2:-2, 2:-2], 1e-5
    for values, axis in zip(stretch(d, frame), (1, 0, 2), strict=False):
        step = np.eye(d.ndim)[axis] * h
        slope = (d.forward(p + step) - d.forward(p - step))[..., axis] / (2 * h)
        np.testing.assert_allclose(values[2:-2, 2:-2], slope, atol=1e-5)
    assert len(stretch(d, frame)) == d.ndim


@pytest.mark.parametrize(("d", "frame"), [(SMALL, None), (VIDEO, 16)])
def test_footprints_are_singular_values_of_the_inverse(d: Deformation, frame: int | None) -> None:
    """Of a frame, within the picture."""
    found = footprints(d, frame)
    p = d.inverse(pixels(d.shape) if frame is None else plane(frame)).points
    _, values, right = np.linalg.svd(np.linalg.inv(d.jacobian(p))[..., :2, :2])
    np.testing.assert_allclose(found.major, values[..., 0], rtol=1e-10)
    np.testing.assert_allclose(found.minor, values[..., 1], rtol=1e-9)
    long = values[..., 0] > 1.01 * values[..., 1]
    assert np.abs((right[..., 0, :] * found.direction).sum(-1))[long].min() > 1 - 1e-9


def test_grid_lines_are_the_inputs_lines() -> None:
    lines = grid(SMALL, lines=8)
    assert len(lines) == 9 + 7
    for line in lines:
        back = SMALL.inverse(line).points
        assert np.ptp(back, axis=0).min() < 1e-6
    np.testing.assert_allclose(SMALL.inverse(lines[0]).points[[0, -1]], [[-0.5, -0.5], [-0.5, 59.5]], atol=1e-6)


def test_a_large_image_is_looked_at_here_and_there() -> None:
    assert spacing_of((1024, 1024)) == 1
    for shape in ((1025, 1024), (8192, 8192), (1, 5_000_000), (40_000, 30_001)):
        every = spacing_of(shape)
        assert np.prod([-(-n // every) for n in shape]) <= 1 << 20 < np.prod([-(-n // (every - 1)) for n in shape])
    d = Deformation((3000, 40), border=64, on_fold="damp").grab((20, 1500), by=(0, 60), radius=80, reach=None)
    assert stretch(d)[0].shape == (3000, 40)
    large = Deformation((1100, 1000), border=64, on_fold="damp").grab((500, 500), by=(40, 30), radius=200, reach=None)
    found = residual(large)
    assert found.every == 2
    assert found.distance.shape == (550, 500)
    full = np.linalg.norm(large.inverse_map() - large.inverse(pixels((1100, 1000))).points, axis=-1)
    np.testing.assert_allclose(found.distance, full[::2, ::2], atol=2e-4)


@pytest.mark.parametrize("what", WHATS)
def test_every_plot_is_written(what: str, tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    names = ["a.png", "b.svg", "c.PDF"] if what == "grid" or effort.ALL else ["a.png"]
    for name in names:
        plot(SMALL, what, tmp_path / name, image=image)
        assert (tmp_path / name).stat().st_size > 5000
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    refused(plot, SMALL, what, tmp_path / "a.png", match="exists")
    if effort.ALL or WHATS.index(what) % 2:
        plot(Deformation((60, 80), border=64, on_fold="damp"), what, tmp_path / "a.png", force=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == names


@pytest.mark.parametrize(
    ("what", "shape"),
    [
        (what, shape)
        for k, what in enumerate(WHATS)
        for n, shape in enumerate([(1, 1), (1, 30), (30, 1), (2, 400)])
        if effort.ALL or (k + n) % 4 == 0
    ],
)
def test_odd_shapes_are_drawn(what: str, shape: tuple[int, int], tmp_path: Path) -> None:
    stroke = Stroke.grab((3, 0), by=(2, 1), radius=10, reach=None)
    d = Deformation(shape, border=None, on_fold="damp").add(stroke, warn=False)
    plot(d, what, tmp_path / "a.png", image=np.ones(shape))


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (np.full((60, 80), 51, np.uint8), 0.2),
        (np.full((60, 80, 1), 13107, np.uint16), 0.2),
        (np.full((60, 80, 3), 0.2, np.float32), 0.2),
        (np.ones((60, 80), np.bool_), 1.0),
        (np.concatenate([np.full((60, 80, 3), 0, np.uint8), np.full((60, 80, 1), 204, np.uint8)], 2), 0.2),
        (np.full((60, 80), np.nan), 0.0),
        (np.full((60, 80), -7, np.int16), 0.0),
    ],
)
def test_any_image_can_lie_below(image: npt.NDArray[Any], expected: float) -> None:
    shown = background(Deformation((60, 80), border=64, on_fold="damp"), image)
    assert shown.shape == (60, 80, 3)
    np.testing.assert_allclose(shown, expected, atol=1e-6)


def test_a_picture_in_inks_lies_below_in_its_colours() -> None:
    inks = np.full((40, 60, 4), (0, 255, 255, 0), np.uint8)  # red, without black
    below = background(Deformation((40, 60)), Picture(inks, interpretation="cmyk"))
    assert below.shape == (40, 60, 3)
    assert below[0, 0, 0] > 0.7
    assert below[0, 0, 1:].max() < 0.3


def test_values_beyond_a_unit_are_spread() -> None:
    image = np.linspace(-1000, 3000, 4800).reshape(60, 80)
    shown = background(Deformation((60, 80), border=64, on_fold="damp"), image)
    np.testing.assert_allclose(shown[..., 0], (image + 1000) / 4000, atol=1e-6)


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    refused(plot, SMALL, "heat", tmp_path / "a.png", match=r'what must be "iterations" or .*, found \'heat\'')
    with pytest.raises(SuppleError, match="three axes"):
        plot(Deformation((5, 60, 80), border=64, on_fold="damp"), "grid", tmp_path / "a.png")
    refused(plot, SMALL, "grid", tmp_path / "a.gif", match=r"must end in \.png, \.svg, \.pdf")
    refused(plot, SMALL, "grid", tmp_path / "missing" / "a.png", match="folder")
    refused(plot, SMALL, "grid", tmp_path / "a.png", image=np.zeros((61, 80)), match="shape")
    refused(plot, SMALL, "grid", tmp_path / "a.png", image=np.zeros((60, 80, 5)), match="grey, RGB or RGBA")
    assert list(tmp_path.iterdir()) == []


def plane(k: float) -> npt.NDArray[np.float64]:
    q = pixels(VIDEO.shape[1:])
    return np.concatenate([q, np.full((*q.shape[:2], 1), k)], axis=-1)


def test_a_frame_is_measured_as_a_plane_of_the_video() -> None:
    found = residual(VIDEO, 16, tolerance=0.003)
    assert 0 < found.distance.max() <= found.bound <= found.tolerance == 0.003
    shown = np.linalg.norm(VIDEO.inverse_map(tolerance=0.003)[16] - VIDEO.inverse(plane(16)).points, axis=-1)
    np.testing.assert_allclose(found.distance, shown, atol=1e-4)
    assert residual(Deformation((4, 20, 30), border=64, on_fold="damp"), 2).bound == 0
    work = iterations(VIDEO, 16)
    assert work.unconverged == 0
    assert work.published_error.max() < 0.3
    assert work.residual.max() < 1e-6
    assert 0 < work.lattice < 0.5 * work.ours.mean()
    every, points = sources(VIDEO, 16)
    assert every == 1
    np.testing.assert_allclose(VIDEO.forward(points), plane(16), atol=1e-6)


@pytest.mark.parametrize("what", WHATS)
def test_every_plot_of_a_frame_is_written(what: str, tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    for k, below in ((0, None), (29, image[..., 0]), (16, image)) if what == "grid" or effort.ALL else ():
        plot(VIDEO, what, tmp_path / "a.png", image=below, frame=k, force=True)
    stroke = Stroke.grab((3, 0, 0), by=(0, 0, 2), radius=10, reach=None)
    odd = [
        Deformation(shape, border=None, on_fold="damp").add(stroke, warn=False)
        for shape in ((1, 1, 1), (4, 1, 30), (4, 30, 1))
    ]
    odd.append(Deformation((3, 48, 64), border=64, on_fold="damp"))  # at rest
    for d in odd if effort.ALL else odd[WHATS.index(what) % 4 :][:1]:
        plot(d, what, tmp_path / "odd.png", frame=0, force=True)
    panels = {"iterations": 6, "residual": 3, "stretch": 4, "axes": 3, "grid": 2}
    assert len(figure(VIDEO, what, image=image, frame=16).axes) == panels[what]


def test_frames_that_are_not_there_are_refused(tmp_path: Path) -> None:
    for k in (-1, 30, 1.5, "1", True):
        refused(plot, VIDEO, "grid", tmp_path / "a.png", frame=k, match="frame must be a frame from 0 to 29, found")
    refused(plot, VIDEO, "grid", tmp_path / "a.png", match=r"three axes: say which by frame=0")
    refused(plot, SMALL, "grid", tmp_path / "a.png", frame=0, match="frame is for videos")
    with pytest.raises(SuppleError, match=r"frame to plot on must be of shape \(48, 64\[, C\]\), found \(30, 48, 64\)"):
        plot(VIDEO, "grid", tmp_path / "a.png", frame=0, image=np.zeros(VIDEO.shape))
    assert list(tmp_path.iterdir()) == []


def test_pyplot_stays_out_of_it() -> None:
    code = (
        "import sys; from supple.plot import figure; from supple import Deformation\n"
        "assert 'matplotlib' not in sys.modules\n"
        "figure(Deformation((20, 20)), 'grid')\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": SOURCE})
    assert figure(SMALL, "grid").axes[0].get_ylim() == (59.5, -0.5)


def test_a_plot_shows_what_each_brush_does() -> None:
    """Where the points around a pivot go; a twist turns them about it, and a scale moves them away from it."""
    d = Deformation((60, 80), spacing=2).twist((40, 30), angle=50, radius=20).scale((40, 30), factor=0.6, radius=20)
    d = d.pinch((40, 30), factor=2, radius=20).twist((40, 30), angle=0, radius=20).grab((5, 5), by=(3, 4), radius=9)
    twist, scale, pinch, still, grab = (paths(d, stroke) for stroke in d.strokes)
    for path, stroke in ((p, s) for found, s in zip((twist, scale, pinch), d.strokes, strict=False) for p in found):
        free = Deformation((60, 80), spacing=2, border=None).add(stroke)
        np.testing.assert_allclose(path[-1], free.forward(path[0]), atol=1e-9)
        assert np.hypot(*(path[0] - (40, 30))) == pytest.approx(7.5)
    assert (still, len(twist), len(grab)) == ([], 6, 1)
    np.testing.assert_array_equal(grab[0], [(5, 5), (8, 9)])
    for path in twist:
        (x, y), (u, v) = path[[0, 1]] - (40, 30)
        assert x * v - y * u > 0  # from x towards y
        np.testing.assert_allclose(np.hypot(*(path - (40, 30)).T), 7.5, rtol=0.2)
    for path in scale:
        assert (np.diff(np.hypot(*(path - (40, 30)).T)) < 0).all()
    assert len(figure(d, "grid").axes[0].patches) == 3 * 6 + 1
    pull = paths(d, Stroke(at=(5, 5), by=(3, 4), also=(((9, 9), (0, 0)), ((8, 7), (-1, 0))), radius=9))
    np.testing.assert_array_equal(pull, [[(5, 5), (8, 9)], [(8, 7), (7, 7)]])
    along = paths(d, Stroke(at=(5, 5), by=(0, 0), path=((9, 9), (8, 3)), radius=9))
    np.testing.assert_array_equal(along, [[(5, 5), (9, 9), (8, 3), (5, 5)]])


def test_a_clip_shows_where_a_brush_is_in_time() -> None:
    d = VIDEO.twist((30, 20, 14), angle=30, radius=9).scale((30, 20, 20), factor=1.5, radius=9)
    texts = [text.get_text() for text in figure(d, "grid", frame=14).axes[0].texts]
    assert texts == ["t 14 → 18.5", "t 14", "t 20"]
