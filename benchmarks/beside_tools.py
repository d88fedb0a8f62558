"""What `beside.py` sets beside Supple: each tool bends a picture by strokes as its own users would, and tells its map.

A tool that is not installed says so in a line. Points are (x, y) in pixels, (0, 0) is the centre of the top left one.
A map says for each pixel of the result which point of the picture it shows: (H, W, 2), float64.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvips
from measure import grid_of
from scipy import ndimage

import supple

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
Point = tuple[float, float]

FREE = 2.5  # in radii: how far from a stroke the points that are to stay begin
APART = 2.0  # in radii: how far apart they are


@dataclass(frozen=True)
class Stroke:
    """A point that is taken hold of, and where it is to arrive."""

    start: Point
    end: Point
    radius: float

    def halved(self) -> Stroke:
        """On every second pixel."""
        (x0, y0), (x1, y1) = self.start, self.end
        return Stroke((x0 / 2, y0 / 2), (x1 / 2, y1 / 2), self.radius / 2)


def staying(shape: tuple[int, int], strokes: Sequence[Stroke]) -> list[Point]:
    """Points that are to stay, for tools that move all that is not held: a grid, away from all strokes."""
    radius = strokes[0].radius
    counts = [max(2, round((n - 1) / (APART * radius)) + 1) for n in shape]
    ys, xs = (np.linspace(0, n - 1, count) for n, count in zip(shape, counts, strict=True))
    grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    ends = np.array([point for stroke in strokes for point in (stroke.start, stroke.end)])
    far = np.linalg.norm(grid[:, None] - ends, axis=-1).min(axis=1) > FREE * radius
    return [(float(x), float(y)) for x, y in grid[far]]


def pairs(shape: tuple[int, int], strokes: Sequence[Stroke]) -> tuple[Array, Array]:
    """Where points are, and where they are to be: those of the strokes, and those that stay."""
    stay = staying(shape, strokes)
    return np.array([s.start for s in strokes] + stay), np.array([s.end for s in strokes] + stay)


def sampled(of: Floats, at: Floats) -> Floats:
    """A map at any points: the displacement between pixels is a cubic spline."""
    moved = of - grid_of(of.shape[:2])
    places = [at[..., 1], at[..., 0]]
    return at + np.stack([ndimage.map_coordinates(moved[..., k], places, order=3, mode="nearest") for k in (0, 1)], -1)


class Tool:
    """A way to bend pictures by strokes."""

    name = ""
    missing = ""  # in place of a measurement, why there is none
    points = False  # whether it moves points to points: then a stroke in turn samples again

    def warp(self, picture: Array, strokes: Sequence[Stroke]) -> Array:
        """The picture, uint8 RGB, bent by all strokes, sampled as often as the tool does so."""
        raise NotImplementedError

    def map(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Floats:
        """Which point each pixel shows."""
        raise NotImplementedError


class Supple(Tool):
    name = "Supple"

    def deformation(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> supple.Deformation:
        d = supple.Deformation(shape)
        for stroke in strokes:
            grab = supple.Stroke.grab(stroke.start, to=stroke.end, radius=stroke.radius)
            d = d.add(grab, warn=False)  # at random: some carry others' points away
        return d

    def warp(self, picture: Array, strokes: Sequence[Stroke]) -> Array:
        return self.deformation((picture.shape[0], picture.shape[1]), strokes).warp(picture)

    def map(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Floats:
        return np.asarray(self.deformation(shape, strokes).inverse_map(tolerance=1e-3), np.float64)


class Pull(Supple):
    """All strokes at once, as pairs of points."""

    name = "Supple, all points at once"

    def deformation(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> supple.Deformation:
        starts, ends = [s.start for s in strokes], [s.end for s in strokes]
        return supple.Deformation(shape).pull(starts, to=ends, radius=strokes[0].radius)


def saved(path: Path, values: Array) -> Path:
    """Write a picture as PNG or TIFF."""
    pyvips.Image.new_from_array(np.ascontiguousarray(values)).write_to_file(str(path))
    return path


def loaded(path: Path) -> Array:
    """Read a picture's first three bands."""
    return np.asarray(pyvips.Image.new_from_file(str(path))[:3].numpy())


def ramps(height: int, width: int) -> Array:
    """A picture of its own coordinates, from 0 to 1."""
    x, y = np.moveaxis((grid_of((height, width)) + 0.5) / (width, height), -1, 0)
    return np.stack([x, y, np.full_like(x, 0.5)], axis=-1).astype(np.float32)


class Program(Tool):
    """A tool that reads and writes files."""

    def command(self, source: Path, target: Path, strokes: Sequence[Stroke]) -> list[str]:
        """The command that bends one file to another, as a shell would run it."""
        raise NotImplementedError

    def run(self, source: Path, target: Path, strokes: Sequence[Stroke]) -> None:
        command = self.command(source, target, strokes)
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        if done.returncode or not target.exists():
            raise RuntimeError(f"{command[0]} failed: {done.stderr.strip()[:200]}")

    def warp(self, picture: Array, strokes: Sequence[Stroke]) -> Array:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "out.png"
            self.run(saved(Path(folder) / "in.png", picture), target, strokes)
            bent = loaded(target)
        return (np.rint(bent / 257) if bent.dtype == np.uint16 else bent).astype(np.uint8)


class Gimp(Program):
    """GIMP's warp tool, by the program of its library: brushes that move, at full strength, and GIMP's hardness.

    All strokes are nodes that pass displacements on, as one session of GIMP's tool has them: the picture is sampled
    once. NoHalo is the sharpest of its samplers here, and cubic GIMP's default. A stroke writes pairs of floats to a
    copy of what it is given, whatever its format, so that has to be a picture of two floats; GIMP's own is.
    """

    size = 4.0  # the brush's diameter, in radii

    def __init__(self, sampler: str = "nohalo") -> None:
        self.sampler, self.name = sampler, f"GIMP's warp, {sampler}"
        if shutil.which("gegl") is None:
            self.missing = "the program gegl is not installed"

    def command(self, source: Path, target: Path, strokes: Sequence[Stroke]) -> list[str]:
        image = pyvips.Image.new_from_file(str(source))
        graph = target.with_suffix(".xml")
        graph.write_text(self.graph(source, (image.height, image.width), strokes), encoding="utf-8")
        return ["gegl", str(graph), "-o", str(target)]

    def graph(self, source: Path, shape: tuple[int, int], strokes: Sequence[Stroke]) -> str:
        def node(operation: str, inside: str = "", **values: object) -> str:
            asked = "".join(f"<param name='{name}'>{value}</param>" for name, value in values.items())
            return f"<node operation='gegl:{operation}'><params>{asked}</params>{inside}</node>"

        brushes = []
        for s in reversed(strokes):
            (x0, y0), (x1, y1) = ((x + 0.5, y + 0.5) for x, y in (s.start, s.end))
            path = f"M{x0},{y0} L{x1},{y1}"
            hand = {"strength": 100, "size": self.size * s.radius, "hardness": 0.5, "spacing": 0.02}
            brushes.append(node("warp", stroke=path, behavior="move", **hand))
        nothing = node("convert-format", format="YA float") + node("crop", width=shape[1], height=shape[0])
        nothing += node("color", value="rgba(0,0,0,0)")
        moved = node(
            "map-relative", "".join(brushes) + nothing, **{"sampler-type": self.sampler, "abyss-policy": "clamp"}
        )
        return f"<gegl>{moved}{node('load', path=source)}</gegl>"

    def map(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Floats:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "out.tiff"
            self.run(saved(Path(folder) / "in.tiff", ramps(*shape)), target, strokes)
            return loaded(target)[..., :2].astype(np.float64) * (shape[1], shape[0]) - 0.5


class Magick(Program):
    """ImageMagick's `-distort Shepards`, which moves points to points, by inverse distances; its sharpest filter."""

    name, points = "ImageMagick, Shepards", True
    how = ("-virtual-pixel", "edge", "-filter", "LanczosSharp", "-distort", "Shepards")

    def __init__(self) -> None:
        if not self.program:
            self.missing = "ImageMagick is not installed"

    @cached_property
    def program(self) -> str:
        """`magick`, or what it was called before; other programs are called `convert`, too."""
        for name in ("magick", "convert-im6.q16", "convert"):
            if shutil.which(name):
                said = subprocess.run([name, "-version"], capture_output=True, text=True, check=False).stdout
                if "ImageMagick" in said:
                    return name
        return ""

    def command(self, source: Path, target: Path, strokes: Sequence[Stroke]) -> list[str]:
        image = pyvips.Image.new_from_file(str(source))
        start, end = pairs((image.height, image.width), strokes)
        words = " ".join(
            f"{x0 + 0.5:.3f},{y0 + 0.5:.3f} {x1 + 0.5:.3f},{y1 + 0.5:.3f}"
            for (x0, y0), (x1, y1) in zip(start, end, strict=True)
        )
        return [self.program, str(source), *self.how, words, str(target)]

    def map(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Floats:
        """By its documented formula; a picture of coordinates of 16 bits agreed within 0.05 pixels."""
        start, end = pairs(shape, strokes)
        q = grid_of(shape)
        weight = 1 / np.maximum(((q[:, :, None] - end) ** 2).sum(axis=-1), 1e-12)
        return np.asarray(q + np.einsum("hwk,kc->hwc", weight, start - end) / weight.sum(axis=-1)[..., None])


class Spline(Tool):
    """scikit-image's thin-plate spline through all points, sampled by its cubic."""

    name, points = "scikit-image, thin plate", True

    def __init__(self) -> None:
        try:
            self.transform = importlib.import_module("skimage.transform")
        except ImportError:
            self.missing = "scikit-image is not installed"

    def fitted(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Any:
        start, end = pairs(shape, strokes)
        kind = self.transform.ThinPlateSplineTransform  # from the result to the picture
        if hasattr(kind, "from_estimate"):
            return kind.from_estimate(end, start)
        tps = kind()
        tps.estimate(end, start)
        return tps

    def warp(self, picture: Array, strokes: Sequence[Stroke]) -> Array:
        tps = self.fitted((picture.shape[0], picture.shape[1]), strokes)
        bent = self.transform.warp(picture, tps, order=3, mode="edge", preserve_range=True)
        return np.clip(np.rint(bent), 0, 255).astype(np.uint8)

    def map(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Floats:
        q = grid_of(shape)
        return np.asarray(self.fitted(shape, strokes)(q.reshape(-1, 2)), np.float64).reshape(q.shape)


class OpenCV(Tool):
    """OpenCV's thin-plate spline, which is in its contributed modules, sampled by its cubic."""

    name, points = "OpenCV, thin plate", True

    def __init__(self) -> None:
        try:
            self.cv2 = importlib.import_module("cv2")
        except ImportError:
            self.missing = "OpenCV is not installed"
            return
        if not hasattr(self.cv2, "createThinPlateSplineShapeTransformer"):
            self.missing = "its thin-plate spline is only in opencv-contrib-python"

    def bent(self, values: Array, strokes: Sequence[Stroke]) -> Array:
        start, end = pairs((values.shape[0], values.shape[1]), strokes)
        tps = self.cv2.createThinPlateSplineShapeTransformer()
        matches = [self.cv2.DMatch(k, k, 0) for k in range(len(start))]
        tps.estimateTransformation(end[None].astype(np.float32), start[None].astype(np.float32), matches)
        return np.asarray(tps.warpImage(values, None, self.cv2.INTER_CUBIC, self.cv2.BORDER_REPLICATE))

    def warp(self, picture: Array, strokes: Sequence[Stroke]) -> Array:
        return self.bent(picture, strokes)

    def map(self, shape: tuple[int, int], strokes: Sequence[Stroke]) -> Floats:
        wide = np.pad(grid_of(shape), ((0, 0), (0, 0), (0, 1)))
        return self.bent(wide.astype(np.float32), strokes)[..., :2].astype(np.float64)


def tools(*, many: bool = False) -> tuple[Tool, ...]:
    """Ours first; for many strokes, also all of them at once."""
    return Supple(), *([Pull()] if many else []), Gimp(), Gimp("cubic"), Magick(), Spline(), OpenCV()
