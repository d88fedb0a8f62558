"""Deformations drawn at random, and the core as tests call it."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st

from supple import Deformation, _core
from supple._core.rows import numbers
from supple.engine.core import plan_of, samplings_of
from supple.engine.sampling import Sampling
from supple.engine.work import Group, Layout, Space, Work
from supple.strokes import Stroke
from tests.children import ROOT

Floats = npt.NDArray[np.float64]
Array = npt.NDArray[Any]

POISSONS = (-math.inf, -5.0, 0.0, 0.4, 0.5)
BORDERS = (None, 1.0, 7.0, 40.0, 500.0)
REACHES = (None, None, 1.0, 2.5, 4.0)


def deformation(rng: np.random.Generator, shape: tuple[int, ...], strokes: int, **domain: Any) -> Deformation:
    """Return strokes of every kind, weak and damped to the fold limit, in the domain and beside it.

    Of three axes, the third is time as often as not.
    """
    more = rng.spawn(1)[0]
    if len(shape) == 3:
        domain = {"time": bool(more.integers(2)), **domain}
    made = {"border": BORDERS[rng.integers(5)], "border_profile": ("quartic", "sine")[rng.integers(2)]}
    made |= {"on_fold": "damp", **domain}
    d = Deformation(shape, **made)
    size, n = np.array(shape[::-1]) - 1.0, len(shape)
    for _ in range(strokes):
        radius = float(np.exp(rng.uniform(math.log(2), math.log(0.5 * max(shape) + 3)))) * min(d.domain.spacing)
        by = rng.normal(size=n)
        by *= radius * np.exp(rng.uniform(math.log(0.05), math.log(5))) / np.linalg.norm(by)
        at, poisson, reach = rng.uniform(-0.1, 1.1, n) * size, float(rng.choice(POISSONS)), REACHES[rng.integers(5)]
        brush = ("grab", "grab", "twist", "scale", "pinch")[rng.integers(5)]
        if brush == "grab":
            by, scales = by / d.domain.spacing, int(rng.integers(1, 4))
            stroke = Stroke.grab(at, by=by, radius=radius, poisson=poisson, scales=scales, reach=reach)
            if reach is not None:
                stroke = replace(stroke, flat=float(more.choice([0.0, 0.0, 0.2, 0.6, 0.9])))
        else:
            stroke = turning(rng, brush, at=at, radius=radius, reach=reach, poisson=poisson)
        if d.domain.time:
            stroke = timed(more, stroke, d.domain.spacing[2])
        d = d.add(stroke, warn=False)
    return d


def timed(rng: np.random.Generator, stroke: Stroke, step: float) -> Stroke:
    """Return a stroke of a clip with a radius in time, or the default, or as it was before; some couple the axes."""
    kind, frames = rng.integers(4), stroke.radius / step * math.exp(rng.uniform(-2.5, 1))
    if stroke.brush == "pinch" and stroke.axis is not None:
        stroke = replace(stroke, axis=(*stroke.axis[:2], 0.0))
    return replace(
        stroke,
        time_radius=None if kind < 2 else frames,
        isotropic=bool(kind == 0),
        poisson=stroke.poisson if rng.integers(2) else None,
    )


def turning(rng: np.random.Generator, brush: Any, **given: Any) -> Stroke:
    """Return an affine brush of any strength and axis."""
    shape: dict[str, Any] = {"factor": float(np.exp(rng.uniform(-2, 2)))}
    if brush == "twist":
        shape = {"angle": float(rng.uniform(-200, 200))}
    if brush == "pinch" or (brush == "twist" and len(given["at"]) == 3):
        shape["axis"] = rng.normal(size=len(given["at"]))
    return Stroke(brush=brush, **shape, **given)


@st.composite
def deformations(draw: st.DrawFn, ndim: int | None = None, most: int = 48, strokes: int = 3) -> Deformation:
    """Draw a deformation of any small shape."""
    n = draw(st.integers(2, 3)) if ndim is None else ndim
    shape = tuple(draw(st.integers(1, most if axis >= n - 2 else 9)) for axis in range(n))
    spacing = draw(st.sampled_from([1.0, 1.0, (0.4, 1.7, 3.0)[:n], 1e-6]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    border = draw(st.sampled_from(BORDERS))
    if border is not None:
        border *= float(np.min(spacing))
    return deformation(rng, shape, draw(st.integers(1, strokes)), spacing=spacing, border=border)


def places(d: Deformation, count: int, seed: int = 0) -> Floats:
    """Return points in the domain, beside it, and on its faces, in samples."""
    rng, size = np.random.default_rng(seed), np.array(d.shape[::-1]) - 1.0
    points = rng.uniform(0, 1, (count, d.ndim)) * size
    beside, faces = slice(0, count // 4), slice(count // 4, count // 2)
    points[beside] = rng.uniform(-0.5, 1.5, points[beside].shape) * (size + 1)
    points[faces] = np.where(
        rng.uniform(size=points[faces].shape) < 0.4, np.rint(points[faces] / size.clip(1)) * size, points[faces]
    )
    return points


def lifted(d: Deformation, points: Floats) -> Floats:
    """Return points as the core takes them: (N, 3), in physical units."""
    made = np.zeros((len(points), 3))
    made[:, : d.ndim] = points * d.domain.spacing
    return made


def plan(d: Deformation, tolerance: float = 0.01, z: float = 0.0, shape: tuple[int, int] | None = None) -> _core.Plan:
    space = d.space if shape is None else replace(d.space, shape=shape)
    return plan_of(space, z, tolerance)


def sampling(frames: Array, out: Array, **how: Any) -> _core.Sampling:
    """Return a sampling of frames (slots, h, w, C) into (h, w, C), plain but for what is said."""
    options = {"filter": "auto", "between": None, "outside": "edge", "average": False, "light": False}
    options |= {"fill": [0.0] * frames.shape[-1], "alpha": False, "step": (1, 1), "offset": (0.0, 0.0)} | how
    if frames.dtype == np.bool_:
        frames, out = frames.view(np.uint8), out.view(np.uint8)
        options["white"] = 1.0
    white = options.get("white", np.iinfo(frames.dtype).max if frames.dtype.kind in "iu" else 1.0)
    group = Group(frames.shape[1:3], frames.shape[-1], options["step"], options["offset"], alpha=options["alpha"])
    known = Sampling(
        options["filter"],
        outside=options["outside"],
        fill=options["fill"],
        linear_light=options["light"],
        between=options["between"],
        time_filter=options["average"],
    )
    space = Space(np.zeros((0, 35)), np.zeros((3, 5)), 3, len(frames), group.shape)
    work = Work(space, Layout((group,), frames.dtype, float(white)), known)
    return samplings_of(work, [frames], [out], len(frames))[0]


def in_a_process(program: str, *, timeout: float = 120, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a program, to which this package and these tests are known."""
    path = os.pathsep.join([str(Path(_core.__path__[0]).parent.parent), str(ROOT)])
    return subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": path, **environment},
        capture_output=True,
        encoding="utf-8",
        timeout=timeout,
        check=False,
    )


__all__ = ["deformation", "deformations", "in_a_process", "lifted", "numbers", "places", "plan", "sampling", "turning"]
