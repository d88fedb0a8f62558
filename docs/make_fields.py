"""Make the pictures of fields.md, and the figures of its table: where a registration of two heads folds.

    python docs/make_fields.py --fixed ch2.nii.gz --moving ds000031_sub-01_ses-006_run-001_T1w.nii.gz

Without heads, it makes the picture of `supple check` alone, of examples/invert_field.py, in a few seconds.

The heads are those of benchmarks/fields.py, whose --help says where to get them, and the field is its `demons`, kept in
the same folder. On two cores, placing and registering the heads takes two minutes, and ITK's three inversions, whose
errors are kept as well, take four; with both there, it is less than one.
"""

import argparse
import io
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvips
import SimpleITK as sitk  # noqa: N813
from matplotlib import colormaps
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap, LogNorm, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import supple
from supple.fields import FOLDED, OK, OUTSIDE, UNCONVERGED
from supple.files.fields import check_file

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE.parent / "examples"))
import fields  # noqa: E402
import heads  # noqa: E402
import invert_field  # noqa: E402

Array = npt.NDArray[Any]

YELLOW, RED, BLUE = "#f5c800", "#e03020", "#2080e0"
WRONG = ListedColormap(colormaps["plasma"](np.linspace(0.25, 1, 256)))
COLOURS = {FOLDED: YELLOW, UNCONVERGED: RED, OUTSIDE: BLUE}
# Iterations, and the thresholds of the mean and of the largest error, in voxels; ITK stops when one is met. Its default
# is the first one, with the displacement at the border set to zero, which adds errors of up to 11 voxels there.
WAYS = {
    "10 iterations": (10, 0.001, 0.1),
    "100 iterations": (100, 0.001, 0.01),
    "100 iterations, the largest error decides": (100, 0.0, 0.01),
}
MIDLINE = 128  # the sagittal slice between the hemispheres, and the part of it that is shown
PART_Z, PART_Y = slice(86, 152), slice(86, 180)
AXIAL, ROW = 113, 119  # a slice through the thalami, and a line from side to side in it
TWICE = 127.8  # where more than one of its points goes
NEAR_Y, NEAR_X = slice(104, 138), slice(109, 146)


def truth(path: Path, name: str) -> tuple[Array, Array]:
    """Return the error of ITK's inverse in voxels, and where it leads out of the grid; kept beside the field."""
    kept = path.with_name(f"{path.stem}_itk_{'-'.join(name.replace(',', '').split())}.npz")
    if not kept.exists():
        times, mean, largest = WAYS[name]
        image = fields.itk_read(path)
        inverse: Any = sitk.InvertDisplacementField(image, times, largest, mean, False)
        found = fields.truth(*map(sitk.GetArrayViewFromImage, (image, inverse)), image.GetSpacing()[0])
        np.savez_compressed(kept, error=found.error, outside=found.outside)
    with np.load(kept) as found:
        return found["error"], found["outside"]


def row(name: str, error: Array, outside: Array, status: Array) -> str:
    """Return a row of the table of fields.md."""
    wrong = (error > fields.TOLERANCE) & ~outside
    well = wrong & (status == OK)
    told = f"{wrong.sum():,} ({100 * wrong.sum() / (~outside).sum():.2g} %)"
    worst = [error[where].max(initial=0.0) for where in (~outside, ~outside & (status == OK))]
    return f"| {name} | {told} | {well.sum():,} | {worst[0]:.2g} | {worst[1]:.2g} |"


def around(*parts: slice) -> tuple[float, float, float, float]:
    """Return the edges of the pixels of a part, of its columns and then of its rows."""
    (top, bottom), (left, right) = ((part.start - 0.5, part.stop - 0.5) for part in parts)
    return left, right, top, bottom


def painted(axes: Any, head: Array, box: tuple[float, ...], name: str) -> None:
    """Draw a slice of a head in grey."""
    axes.imshow(head, cmap="gray", vmin=0, vmax=1.6 * np.percentile(head, 90), origin="lower", extent=box)
    axes.set_title(name, fontsize=11, loc="left")
    axes.set(xticks=[], yticks=[])


def flat(values: Array, code: int, colour: str) -> Array:
    """Return a picture (H, W, 4) of what has a code, in a colour."""
    return np.where((values == code)[..., None], to_rgba(colour), 0.0)


def saved(figure: Figure, path: Path) -> None:
    """Write a figure as WebP."""
    with io.BytesIO() as png:
        figure.savefig(png, format="png")
        drawn = pyvips.Image.new_from_buffer(png.getvalue(), "").flatten(background=255)
        drawn.webpsave(str(path), Q=66, effort=6, keep="none")


def checked(path: Path) -> None:
    """What `supple check --picture` draws of an example."""
    with tempfile.TemporaryDirectory() as name:
        invert_field.main(Path(name))
        picture = f"{name}/warp.png"
        check_file(f"{name}/warp.nii.gz", picture=picture)
        drawn = pyvips.Image.new_from_file(picture).flatten(background=255)
        drawn.resize(1120 / drawn.width).webpsave(str(path), Q=56, effort=6, keep="none")


def slices(path: Path, folded: Array, status: Array, errors: dict[str, Array]) -> Figure:
    """Between the hemispheres: where the field folds, what Supple's inverse says, and how wrong ITK's is."""
    fixed, moving = (
        sitk.GetArrayFromImage(sitk.ReadImage(str(path.with_name(f"{name}_256.nii"))))[PART_Z, PART_Y, MIDLINE]
        for name in ("fixed", "moving")
    )
    made = Figure(figsize=(10.6, 8.3), dpi=100, layout="constrained")
    (first, second), below = made.subplots(2, 2)
    box = around(PART_Z, PART_Y)
    painted(first, fixed, box, "The field folds here, in the fixed head")
    beside = (folded[..., MIDLINE - 1] | folded[..., MIDLINE])[PART_Z, PART_Y]
    first.imshow(flat(beside, 1, YELLOW), origin="lower", extent=[x + 0.5 for x in box])
    first.set(xlim=box[:2], ylim=box[2:])
    painted(second, moving, box, "Supple’s inverse: its status, in the moving head")
    legend = {FOLDED: "folded: more than one point", UNCONVERGED: "unconverged: no point found"}
    for code, colour in COLOURS.items():
        second.imshow(flat(status[PART_Z, PART_Y, MIDLINE], code, colour), origin="lower", extent=box)
    seen = status[PART_Z, PART_Y, MIDLINE]
    handles = [Patch(color=COLOURS[code], label=label) for code, label in legend.items() if (seen == code).any()]
    second.legend(handles=handles, loc="lower right", framealpha=0.9, title="all else: ok", alignment="left")
    titles = ("ITK’s inverse, 10 iterations (its default): off by …", "ITK’s inverse, 100 iterations: off by …")
    for axes, name, way in zip(below, titles, WAYS, strict=False):
        painted(axes, moving, box, name)
        error = errors[way][PART_Z, PART_Y, MIDLINE]
        drawn = axes.imshow(
            np.ma.masked_less(error, 0.01), cmap=WRONG, norm=LogNorm(0.01, 10), origin="lower", extent=box
        )
    bar = made.colorbar(drawn, ax=list(below), location="bottom", shrink=0.6, aspect=40, pad=0.02)
    bar.set_label("voxels, back by the inverse and forth by the field (no colour: at most 0.01)")
    bar.set_ticks([0.01, 0.1, 1, 10], labels=["0.01", "0.1", "1", "10"])
    return made


def near(path: Path, field: supple.Field, folded: Array) -> Figure:
    """A fold from near: the grid that passes over itself, and one row of it as a curve."""
    moving = sitk.GetArrayFromImage(sitk.ReadImage(str(path.with_name("moving_256.nii"))))
    made = Figure(figsize=(10.6, 5.2), dpi=100, layout="constrained")
    left, right = made.subplots(1, 2)
    box = around(NEAR_Y, NEAR_X)
    painted(left, moving[AXIAL, NEAR_Y, NEAR_X], box, "Where the voxels of the fixed head go, in the moving head")
    wide = np.s_[NEAR_Y.start - 12 : NEAR_Y.stop + 12, NEAR_X.start - 12 : NEAR_X.stop + 12]
    rest = np.stack(np.meshgrid(np.arange(256), np.arange(256)), axis=-1)[wide]
    grid = rest + field.values[(AXIAL, *wide)][..., :2] / field.grid.spacing[0]
    left.add_collection(LineCollection([*grid, *grid.swapaxes(0, 1)], colors="#2ec4ff", linewidths=0.8))
    cells = (folded[AXIAL - 1] | folded[AXIAL])[wide][:-1, :-1]
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)[cells]
    left.add_collection(
        PolyCollection(list(corners), facecolors=YELLOW, edgecolors="#8a6d00", linewidths=0.5, zorder=3)
    )
    (line,) = left.plot(*grid[ROW - wide[0].start].T, color=RED, linewidth=1.8, zorder=4)
    left.set(xlim=box[:2], ylim=box[:1:-1])
    line.set_label("the row on the right")
    left.legend(handles=[Patch(color=YELLOW, label="cells that fold"), line], loc="lower left", framealpha=0.9)

    x = np.arange(NEAR_X.start, NEAR_X.stop)
    to = x + field.values[AXIAL, ROW, NEAR_X, 0] / field.grid.spacing[0]
    for k in np.flatnonzero(np.diff(to) < 0):
        right.plot(x[k : k + 2], to[k : k + 2], color=YELLOW, linewidth=7, zorder=1, solid_capstyle="butt")
    right.plot(x, to, color=RED, linewidth=1.8)
    crossed = np.flatnonzero((to[:-1] < TWICE) != (to[1:] < TWICE))
    roots = x[crossed] + (TWICE - to[crossed]) / (to[crossed + 1] - to[crossed])
    right.axhline(TWICE, color="#33628d", linewidth=1, linestyle="--")
    right.plot(roots, [TWICE] * len(roots), "o", color="#33628d", markersize=7, zorder=5)
    right.annotate(
        f"{len(roots)} points of the fixed head\ngo to {TWICE:g}: which one\nis the inverse?",
        (roots[1], TWICE), (116, 133),
        color="#33628d", arrowprops={"arrowstyle": "-", "color": "#33628d"}, fontsize=11,
    )  # fmt: skip
    right.set(xlabel="x, in the fixed head (voxels)", ylabel="x + u(x), in the moving head")
    right.set_title("Along that row: where the curve falls, the field folds", fontsize=11, loc="left")
    right.grid(color="#e8e8e8")
    right.spines[["top", "right"]].set_visible(False)
    return made


def main() -> None:
    """Make the pictures, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fixed", type=Path, help="a head")
    parser.add_argument("--moving", type=Path, help="another head")
    parser.add_argument("--data", type=Path, default=fields.cache(), help=f"where fields are kept ({fields.cache()})")
    asked = parser.parse_args()
    checked(HERE / "images" / "field-check.webp")
    if asked.fixed is None or asked.moving is None:
        return
    folder = asked.data / heads.named(asked.fixed, asked.moving)
    path = heads.made(folder, asked.fixed, asked.moving, 256, ["demons"])["demons"]
    field = supple.Field.read(path)
    inverse = field.invert()
    print(inverse.counts)
    print(field.check())
    found = {name: truth(path, name) for name in WAYS}
    for name, (error, outside) in found.items():
        print(row(f"ITK, {name}", error, outside, inverse.status))
    ours = fields.truth(field.values, inverse.field.values, field.grid.spacing[0])
    print(row("Supple", ours.error, ours.outside, inverse.status))

    folded = field.folded_cells()
    folded = np.pad(folded, ((0, 1),) * 3)  # as many as samples
    slices_of = slices(path, folded, inverse.status, {name: np.where(o, 0, e) for name, (e, o) in found.items()})
    saved(slices_of, HERE / "images" / "field-folds.webp")
    saved(near(path, field, folded), HERE / "images" / "field-fold-near.webp")


if __name__ == "__main__":
    main()
