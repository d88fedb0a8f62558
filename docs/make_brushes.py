"""Make the pictures of brushes.md: each brush on a photograph, and what it makes of a grid.

python docs/make_brushes.py
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyvips

import supple
from supple.media import image
from supple.plot.frame import arrows, save, sheet
from supple.plot.measure import grid
from supple.strokes import Stroke

IMAGES = Path(__file__).resolve().parent / "images"
DATA = Path(supple.__file__).parent / "examples" / "data"
PHOTO, CUP = DATA / "chelsea.jpg", DATA / "coffee.jpg"

EYE, NOSE = (171.0, 115.0), (265.0, 243.0)
CORNERS = [(150, 140), (196, 140), (280, 140), (330, 136)]
FROZEN_EYE = np.hypot(np.arange(451) - EYE[0], np.arange(300)[:, None] - EYE[1]) < 34
ON_PHOTO = (
    ("as it was", ()),
    ("grab", (Stroke.grab(NOSE, to=(225, 205), radius=45),)),
    ("twist", (Stroke(brush="twist", at=(240, 150), angle=-50, radius=90),)),
    ("scale by 2", (Stroke(brush="scale", at=EYE, factor=2, radius=42),)),
    ("scale by 0.5", (Stroke(brush="scale", at=NOSE, factor=0.5, radius=50),)),
    ("pinch by 0.5", (Stroke(brush="pinch", at=(240, 150), factor=0.5, radius=100),)),
    ("along a path", (Stroke.grab(NOSE, path=[(300, 235), (320, 200), (300, 165)], radius=40),)),
    ("pull, and four pins", (Stroke.pull([EYE, (302, 112)], by=[(-30, -12), (26, -14)], pins=CORNERS, radius=34),)),
    ("twist, the eye frozen", (Stroke(brush="twist", at=(240, 150), angle=-50, radius=90),)),
)

SIDE, AT, RADIUS = 321, (160.0, 160.0), 36.0
ON_GRIDS = {
    "grab": (
        ("1 scale", {"by": (45, 0)}),
        ("2 scales", {"by": (30, 0), "scales": 2}),
        ("3 scales", {"by": (22, 0), "scales": 3}),
        ("no reach", {"by": (45, 0), "reach": None}),
    ),
    "twist": (("30°", {"angle": 30}), ("90°", {"angle": 90}), ("360°", {"angle": 360}), ("−60°", {"angle": -60})),
    "scale": (("2", {"factor": 2}), ("4", {"factor": 4}), ("0.5", {"factor": 0.5}), ("0.1", {"factor": 0.1})),
    "pinch": (
        ("0.5", {"factor": 0.5}),
        ("2", {"factor": 2}),
        ("0.5, axis (1, 1)", {"factor": 0.5, "axis": (1, 1)}),
        ("0.1", {"factor": 0.1}),
    ),
}
PINS = [(120.0, 160.0), (160.0, 120.0), (200.0, 160.0), (160.0, 200.0)]
WAY = [(150 + 70 * math.cos(t), 160 + 70 * math.sin(t)) for t in np.linspace(math.pi, 0, 60)]
BY_HAND = (
    ("two points pulled", (Stroke.pull([(110, 130), (210, 190)], by=[(35, 20), (-35, -20)], radius=RADIUS),)),
    ("one, with four pins", (Stroke.pull([AT], by=[(24, -24)], pins=PINS, radius=RADIUS),)),
    ("along a path", (Stroke.grab(WAY[0], path=WAY[1:], radius=RADIUS),)),
    ("with its mirror image", Stroke.grab((110, 150), by=(-30, 35), radius=RADIUS).symmetric((160, 0), (1, 0))),
)
PLATEAUS = [(f"flat {p}", (Stroke.grab(AT, by=(45, 0), radius=50, flat=p),)) for p in (0, 0.3, 0.6, 0.9)]
FROZEN = np.hypot(np.arange(SIDE) - 130, (np.arange(SIDE) - 160)[:, None]) < 40
BESIDE = (
    ("grab", (Stroke.grab((200, 160), by=(50, 0), radius=RADIUS),)),
    ("towards it", (Stroke.grab((230, 160), by=(-45, 0), radius=RADIUS),)),
    ("twist", (Stroke(brush="twist", at=(130, 160), angle=80, radius=60),)),
    ("scale", (Stroke(brush="scale", at=(195, 160), factor=2.5, radius=RADIUS),)),
)
COFFEE = np.hypot((np.arange(600) - 288) / 80, (np.arange(400)[:, None] - 145) / 49) < 1
FIRST = Stroke.grab((110, 175), by=(40, -30), radius=45)
SECOND = Stroke.grab((215, 150), by=(-42, 12), radius=45)
HOLD = Stroke.freeze(supple.Freeze.of(FROZEN))
AMONG = (
    ("a grab", (FIRST,)),
    ("the disc frozen, another", (FIRST, HOLD, SECOND)),
    ("both, the disc frozen first", (HOLD, FIRST, SECOND)),
)


def titled(pixels: image.Array, text: str) -> pyvips.Image:
    """Return a picture with a line of text over its corner."""
    made = pyvips.Image.new_from_array(pixels)
    style = 'font-family="sans-serif" font-size="22" fill="white" stroke="black" stroke-width="3" paint-order="stroke"'
    svg = f'<svg width="{made.width}" height="{made.height}"><text x="10" y="26" {style}>{text}</text></svg>'
    return made.composite2(pyvips.Image.svgload_buffer(svg.encode()), "over").flatten()


def on_photo(path: Path) -> None:
    """Write the photograph with a stroke of each brush."""
    photo = image.read(PHOTO).pixels
    pictures = []
    for text, strokes in ON_PHOTO:
        freeze = supple.Freeze.of(FROZEN_EYE, width=24) if "frozen" in text else None
        d = supple.Deformation.from_recipe(supple.Recipe(strokes=strokes, freeze=freeze), photo.shape[:2])
        pictures.append(titled(d.warp(photo), text))
    joined = pyvips.Image.arrayjoin(pictures, across=3, shim=8, background=[255] * 3)
    joined.resize(0.62).webpsave(path, Q=72, effort=6, keep="none")


def under_a_matte(path: Path) -> None:
    """Write a cup of coffee, a matte, and what a stroke does without it and under it."""
    photo, stroke = image.read(CUP).pixels, Stroke.grab((240, 130), by=(60, 22), radius=60)
    matte = supple.Freeze.of(COFFEE, width=10, matte=True)
    plain, under = (
        supple.Deformation(photo.shape[:2]).add(one, warn=False).warp(photo)
        for one in (stroke, replace(stroke, matte=matte))
    )
    shown = np.where(COFFEE[..., None], photo, photo // 4)
    cases = (("as it was", photo), ("the matte", shown), ("a grab", plain), ("under the matte", under))
    parts = [titled(np.ascontiguousarray(pixels[:260, 120:470]), text) for text, pixels in cases]
    joined = pyvips.Image.arrayjoin(parts, across=4, shim=8, background=[255] * 3)
    joined.resize(0.7).webpsave(path, Q=72, effort=6, keep="none")


def on_grids(
    path: Path, cases: Sequence[tuple[str, Sequence[Stroke]]], frozen: image.Array | None = None, *, held: bool = True
) -> None:
    """Write what strokes make of a grid, side by side; what is frozen is tinted, and ``held`` from the beginning."""
    freeze = supple.Freeze.of(frozen) if frozen is not None and held else None
    from matplotlib.collections import LineCollection

    made, panels = sheet(3.1 * len(cases), 3.35, 1, len(cases))
    for axes, (text, strokes) in zip(panels, cases, strict=True):
        d = supple.Deformation.from_recipe(supple.Recipe(strokes=strokes, border=None, freeze=freeze), (SIDE, SIDE))
        axes.add_collection(LineCollection(grid(d, lines=32), colors="#2a6099", linewidths=0.8))
        if frozen is not None:
            axes.contourf(frozen, levels=[0.5, 1], colors="#e07b39", alpha=0.4)
        arrows(axes, d)
        axes.set(xlim=(0, SIDE), ylim=(SIDE, 0), aspect="equal", xticks=[], yticks=[])
        axes.set_title(text, fontsize=12)
    save(made, path.with_suffix(".png"), force=True)
    picture = pyvips.Image.new_from_file(str(path.with_suffix(".png"))).flatten(background=255)
    picture.resize(0.55).webpsave(path, Q=45, effort=6)
    path.with_suffix(".png").unlink()


def main(folder: Path = IMAGES) -> None:
    """Make all of them."""
    on_photo(folder / "brushes.webp")
    for brush, cases in ON_GRIDS.items():
        made = [(text, (Stroke(brush=brush, at=AT, radius=RADIUS, **numbers),)) for text, numbers in cases]  # type: ignore[arg-type]
        on_grids(folder / f"brush-{brush}.webp", made)
    on_grids(folder / "brush-flat.webp", PLATEAUS)
    on_grids(folder / "brush-hand.webp", BY_HAND)
    on_grids(folder / "brush-freeze.webp", BESIDE, FROZEN)
    under_a_matte(folder / "brush-matte.webp")
    on_grids(folder / "brush-freeze-among.webp", AMONG, FROZEN, held=False)


if __name__ == "__main__":
    main()
