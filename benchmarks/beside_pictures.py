"""The pictures of docs/comparison.md: `python benchmarks/beside_pictures.py docs/images`. They need matplotlib."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import beside_volume as volume
import numpy as np
import pyvips
from beside import DATA, STRONG, halved, ten, truth
from beside_tools import Array, Tool, loaded, tools
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from measure import grid_of
from scipy import ndimage

import supple
from supple.media import volume as media

FACE = np.s_[50:200, 135:295]


def there() -> list[Tool]:
    """What is installed; one of two that show the same."""
    return [
        tool for tool in tools() if not tool.missing and not tool.name.endswith("cubic") and "OpenCV" not in tool.name
    ]


def short(tool: Tool) -> str:
    return tool.name.partition(",")[0]


def panels(count: int, width: float, height: float) -> tuple[Figure, list]:
    """A row of pictures, with room for a title above each."""
    figure = Figure(figsize=(width * count, height + 0.3), dpi=100, facecolor="white")
    axes = figure.subplots(1, count, squeeze=False)[0]
    figure.subplots_adjust(0.004, 0.004, 0.996, height / (height + 0.3), 0.03)
    for axis in axes:
        axis.set_axis_off()
    return figure, list(axes)


def written(figure: Figure, path: Path) -> None:
    with io.BytesIO() as png:
        figure.savefig(png, format="png")
        pyvips.Image.new_from_buffer(png.getvalue(), "").flatten(background=255).webpsave(
            path, Q=72, effort=6, keep="none"
        )


def pulled(folder: Path) -> None:
    """The strong drag, and the grid that it makes of the pixels: what folds and what moves."""
    picture = loaded(DATA / "astronaut.jpg")
    shape = (picture.shape[0], picture.shape[1])
    chosen = there()
    figure, axes = panels(len(chosen) + 1, 2.1, 1.97)
    axes[0].imshow(picture[FACE], interpolation="bicubic")
    axes[0].set_title("before, and the drag", fontsize=10)
    start, end = (np.subtract(p, (FACE[1].start, FACE[0].start)) for p in (STRONG.start, STRONG.end))
    axes[0].annotate("", end, start, arrowprops={"arrowstyle": "->", "color": "#20e0ff", "lw": 2})
    for axis, tool in zip(axes[1:], chosen, strict=True):
        axis.imshow(tool.warp(picture, [STRONG])[FACE], interpolation="bicubic")
        axis.plot(*end, "o", mfc="none", mec="#20e0ff", ms=9, mew=1.5)
        axis.set_title(short(tool), fontsize=10)
    written(figure, folder / "beside-drag.webp")
    figure, axes = panels(len(chosen), 2.4, 2.4)
    for axis, tool in zip(axes, chosen, strict=True):
        moved = np.linalg.norm(tool.map(shape, [STRONG]) - grid_of(shape), axis=-1)
        axis.imshow(np.maximum(moved, 0.01), norm=LogNorm(0.01, 50), cmap="magma")
        axis.set_title(short(tool), fontsize=10)
    written(figure, folder / "beside-moved.webp")


def strokes(folder: Path) -> None:
    """Ten strokes, near by: truth is that of ours, as the others' maps differ a little."""
    full, picture = halved("chelsea.jpg", False)
    shape = (picture.shape[0], picture.shape[1])
    each = ten(*shape)
    part = np.s_[26:86, 34:104]
    shown: list[tuple[str, Array]] = []
    for tool in there():
        turns: list[Sequence] = [[stroke] for stroke in each] if tool.points else [each]
        if not shown:
            shown.append(("truth, of ours", truth(full, [tool.map(shape, each)])))
        shown.append((short(tool) + (", in turn" if len(turns) > 1 else ""), reduce(tool.warp, turns, picture)))
    figure, axes = panels(len(shown), 2.3, 1.97)
    for axis, (name, values) in zip(axes, shown, strict=True):
        axis.imshow(np.clip(values, 0, 255).astype(np.uint8)[part], interpolation="nearest")
        axis.set_title(name, fontsize=10)
    written(figure, folder / "beside-strokes.webp")


def head(folder: Path) -> None:
    """A slice of the head, bent by both, and what SimpleITK's inverse is off by."""
    import SimpleITK as sitk  # noqa: N813

    samples = media.read(Path(supple.__file__).parent / volume.DATA).samples
    x = round(float(volume.START[0]))
    back, forth = volume.itk(sitk, samples, False)()
    places = np.moveaxis(back, -1, 0)[::-1]
    theirs = ndimage.map_coordinates(samples.astype(np.float32), places, order=1, mode="nearest")
    d = volume.ours(samples.shape)
    shown = {"before, and the move": samples, "Supple": d.warp(samples, filter="linear"), "SimpleITK": theirs}
    figure, axes = panels(5, 2.1, 1.75)
    for axis, (name, values) in zip(axes, shown.items(), strict=False):
        axis.imshow(values[:, :, x], origin="lower", cmap="gray", interpolation="bicubic")
        axis.set_title(name, fontsize=10)
    start = volume.START[1:]
    axes[0].annotate("", start + volume.BY[1:], start, arrowprops={"arrowstyle": "->", "color": "#20e0ff", "lw": 2})
    off = np.linalg.norm(d.forward(d.inverse_map()) - grid_of(samples.shape), axis=-1) * volume.SPACING
    errors = {"Supple's inverse is off by": off, "SimpleITK's, by its defaults": volume.returned(back, forth)}
    for axis, (name, values) in zip(axes[3:], errors.items(), strict=True):
        axis.imshow(np.maximum(values[:, :, x], 0.001), origin="lower", norm=LogNorm(0.001, 10), cmap="magma")
        axis.set_title(name, fontsize=10)
    written(figure, folder / "beside-volume.webp")


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for each in (pulled, strokes, head):
        each(folder)
