"""Random strokes for training data: one draw bends an image, its labels, its key points and its boxes, and never folds.

A draw is a `Deformation` of grabs at random points, in random directions, one after the other. Each is weakened, if
necessary, until a bound proves that the symmetric part of I + J has no eigenvalue below 0.3 at any point
(`supple.folding.strain`): then each grab, and so the draw, is one-to-one, whatever the random numbers.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from supple import _core
from supple._core.rows import numbers
from supple.deformation import Deformation
from supple.engine.sampling import Sampling, SamplingFields
from supple.folding.resolved import FLOW_GAP, FLOW_MARGIN, Table, beta_at
from supple.folding.strain import weakest
from supple.space.checks import assign, integer, items, length, number, refuse, rows
from supple.space.domain import Border, checked_border
from supple.space.geometry import Floats, Grid
from supple.strokes import Stroke, pack

Seed = int | np.random.Generator | None

MOST_STROKES = 1000
_LINEAR = Sampling("linear")
SLACK = 0.85  # of max_displacement: the most at sampled points; in between, it may be more
_EDGE, _FACE = 16, 8  # points per radius along the edges of boxes, and on the faces of those in volumes
_CHANNELS = 4  # a last axis of up to so many is taken for channels


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """An image and its annotations, bent by one deformation; None for what was not given.

    Parameters
    ----------
    image : array of shape (H, W[, C]) or (Z, H, W[, C])
        Of the type of the given image.
    labels : array of shape (H, W[, C]) or (Z, H, W[, C])
        Of the type of the given labels, without new values.
    points : float64 array, shape (N, D)
        In samples, x first.
    boxes : float64 array, shape (N, 2 D)
        The boxes around the bent boxes: their lower corners, and their upper ones, in the coordinates of points.
    deformation : Deformation
        The random deformation: ``deformation.recipe.to_json()`` is its recipe.
    """

    image: npt.NDArray[Any] | None
    labels: npt.NDArray[Any] | None
    points: Floats | None
    boxes: Floats | None
    deformation: Deformation


@dataclass(frozen=True, slots=True)
class RandomElastic:
    """Random elastic deformations of pictures and volumes, which never fold.

    A value: it has no random state of its own, and may be shared by threads and processes.

    Parameters
    ----------
    max_displacement : float
        The most that points move, in physical units: pixels, unless a picture or volume has a spacing. At most the
        smallest radius. At the sampled points, a radius apart, the displacement is limited to 85 % of it.
    radius : float or (float, float)
        The radius of the strokes, in physical units, or the range from which each is drawn: small ones make
        wrinkles, large ones bend the whole.
    strokes : int or (int, int)
        The number of strokes, or its range, including both ends.
    border : "auto", float, sequence of float or None
        The width of the fixed border, as in `Deformation`: nothing leaves the picture, and nothing comes in. None: the
        border is free.

    Examples
    --------
    >>> import numpy as np
    >>> augment = RandomElastic(max_displacement=12, radius=(30, 60))
    >>> made = augment(np.zeros((256, 256, 3), np.uint8), points=[(100, 120)], seed=7)
    >>> made.image.shape, made.points.shape
    ((256, 256, 3), (1, 2))
    """

    max_displacement: float
    radius: float | tuple[float, float]
    strokes: int | tuple[int, int] = (3, 6)
    border: Border = "auto"

    def __post_init__(self) -> None:
        radius = _range("radius", self.radius)
        low, high = (length(f"radius[{i}]" if radius[0] != radius[1] else "radius", r) for i, r in enumerate(radius))
        if low > high:
            refuse("radius", "a number, or two in ascending order", self.radius)
        counts = _range("strokes", self.strokes)
        wanted = f"a whole number from 0 to {MOST_STROKES}, or two in ascending order"
        least, most = (integer("strokes", n, wanted, 0, MOST_STROKES) for n in counts)
        if least > most:
            refuse("strokes", wanted, self.strokes)
        wanted = f"a number from 0 to {low:g}, the smallest radius"
        largest = number("max_displacement", self.max_displacement, wanted, 0.0, low)
        border = checked_border(self.border)
        assign(self, max_displacement=largest, radius=(low, high), strokes=(least, most), border=border)

    def draw(
        self, shape: Sequence[int] | Grid, seed: Seed = None, *, spacing: float | Sequence[float] = 1.0
    ) -> Deformation:
        """Return a random deformation.

        Parameters
        ----------
        shape : sequence of int or Grid
            ``(H, W)`` or ``(Z, H, W)``; or the grid of a picture or volume, which has its spacing.
        seed : int or numpy.random.Generator, optional
            The same number draws the same deformation; a generator, the next one. By default, a new one every time,
            in every process.
        spacing : float or sequence of float
            Physical units per sample, x first.

        Returns
        -------
        Deformation
            Its ``recipe`` applies it again: by `Deformation.from_recipe`, or ``supple warp --recipe``.
        """
        one_thread_in_workers()
        if seed is not None and not isinstance(seed, np.random.Generator):
            seed = integer("seed", seed, "a whole number from 0, or a numpy.random.Generator", 0, 2**128)
        rng = np.random.default_rng(seed)
        still = Deformation(shape, border=self.border, spacing=spacing)
        domain, axes = still.domain, still.domain.packed()
        (least, most), (small, large) = _range("strokes", self.strokes), _range("radius", self.radius)
        low, high = np.array(domain.faces).T
        steps, count = np.array(domain.spacing), int(rng.integers(least, most, endpoint=True))
        radii, starts = rng.uniform(small, large, count), rng.uniform(low, high, (count, domain.ndim))
        directions = rng.normal(size=(count, domain.ndim)) * (high > low)
        lengths = self.max_displacement * rng.uniform(size=(count, 1))
        forces = directions * (lengths / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9))
        strokes = [
            Stroke.grab(at, by=by, radius=radius)
            for at, by, radius in zip((starts / steps).tolist(), (forces / steps).tolist(), radii.tolist(), strict=True)
            if any(by)
        ]
        if not strokes:
            return still
        table = pack(strokes, domain.spacing)
        for k in range(len(table)):  # limit each to what needs no more than one step
            lower, _ = weakest(table[k : k + 1], axes, FLOW_MARGIN - 1, FLOW_GAP)
            if lower < FLOW_MARGIN - 1:
                table["force"][k] *= (1 - FLOW_MARGIN) * (1 - 1.2 * FLOW_GAP) / -lower
        points, longest = _looked_at(table["pivot"][:, : domain.ndim], radii, low, high), SLACK * self.max_displacement
        while (farthest := _farthest(table, still, points)) > longest:
            table["force"] *= 0.99 * longest / farthest  # where they add up, all are weakened
        # A force moves its point less near a fixed border. A flow would compensate for that, so ask it for no more.
        drags = table["force"] * beta_at(table["pivot"], axes)
        made = still
        for stroke, drag in zip(strokes, drags[:, : domain.ndim] / steps, strict=True):
            made = made.add(replace(stroke, by=tuple(drag.tolist())), warn=False)
        return made

    def __call__(
        self,
        image: npt.ArrayLike,
        *,
        labels: npt.ArrayLike | None = None,
        points: npt.ArrayLike | None = None,
        boxes: npt.ArrayLike | None = None,
        seed: Seed = None,
        shape: Sequence[int] | Grid | None = None,
        spacing: float | Sequence[float] = 1.0,
        sampling: Sampling = _LINEAR,
        **options: Unpack[SamplingFields],
    ) -> Sample:
        """Draw a deformation, and apply it to an image and its annotations.

        Parameters
        ----------
        image : array of shape (H, W[, C]) or (Z, H, W[, C])
        labels, points, boxes, sampling, **options
            As in `apply`.
        seed, spacing
            As in `draw`.
        shape : sequence of int or Grid, optional
            The axes of space, as in `draw`. By default, all axes, without a last one of up to four channels.

        Raises
        ------
        SuppleError
            If an argument does not fit; or if the image has three axes, the last with more than four entries, and
            no ``shape`` says whether it is a volume.
        """
        array = np.asarray(image)
        if shape is None:
            shape = _shape_of(array)
        d = self.draw(shape, seed, spacing=spacing)
        return apply(d, array, labels=labels, points=points, boxes=boxes, sampling=sampling, **options)


def apply(
    deformation: Deformation,
    image: npt.ArrayLike | None = None,
    *,
    labels: npt.ArrayLike | None = None,
    points: npt.ArrayLike | None = None,
    boxes: npt.ArrayLike | None = None,
    sampling: Sampling = _LINEAR,
    **options: Unpack[SamplingFields],
) -> Sample:
    """Apply a deformation to an image and its annotations.

    Parameters
    ----------
    deformation : Deformation
        The result of `RandomElastic.draw`, or of `Deformation.from_recipe` with its recipe.
    image : array of shape (H, W[, C]) or (Z, H, W[, C]), optional
    labels : array of shape (H, W[, C]) or (Z, H, W[, C]), optional
        Sampled by the nearest label.
    points : array_like, shape (N, D), optional
        In samples, x first: the first sample is at 0.
    boxes : array_like, shape (N, 2 D), optional
        As in `moved_boxes`.
    sampling : Sampling, optional
        How the image is sampled, by ``filter="linear"`` by default; further keywords replace its fields. Labels have
        the same boundary mode.
    """
    one_thread_in_workers()
    if not isinstance(deformation, Deformation):
        refuse("deformation", "a Deformation (RandomElastic.draw returns one)", deformation)
    sampling = Sampling.of(sampling, options, deformation.ndim)
    if labels is not None and (found := np.shape(labels))[: deformation.ndim] != deformation.shape:
        refuse("labels", f"of shape {deformation.shape}, with or without channels", told=f"shape {found}")
    return Sample(
        # The last of four channels need not be opacity.
        None if image is None else deformation.warp(np.asarray(image), sampling=sampling, alpha=False),
        None
        if labels is None
        else deformation.warp(np.asarray(labels), filter="nearest", outside=sampling.outside, alpha=False),
        None if points is None else deformation.forward(rows("points", points, deformation.ndim)),
        None if boxes is None else moved_boxes(deformation, boxes),
        deformation,
    )


def moved_boxes(deformation: Deformation, boxes: npt.ArrayLike, *, inverse: bool = False) -> Floats:
    """Return the smallest boxes around bent boxes.

    A bent box may reach farthest between its corners, so points along its edges (in a volume, on its faces) are moved:
    a sixteenth (an eighth) of the smallest radius apart, where strokes reach.

    Parameters
    ----------
    deformation : Deformation
    boxes : array_like, shape (N, 2 D)
        The lower corner and the upper one, in the coordinates of points: ``(x0, y0, x1, y1)`` or ``(x0, y0, z0, x1, y1,
        z1)``. The box around a whole picture is ``(-0.5, -0.5, W - 0.5, H - 0.5)``.
    inverse : bool
        Whether they are bent by T⁻¹ in place of T.

    Returns
    -------
    float64 array, shape (N, 2 D)
    """
    n = deformation.ndim
    given = rows("boxes", boxes, 2 * n)
    low, high = given[:, :n], given[:, n:]
    if np.any(low > high):
        k = int(np.argmax(np.any(low > high, axis=1)))
        refuse(f"boxes[{k}]", "a lower corner and an upper one", given[k].tolist())
    if not len(given) or deformation.is_identity:
        return given.copy()
    spacing = np.array(deformation.domain.spacing)
    parts = _EDGE if n == 2 else _FACE
    step = min((stroke.radius / parts for stroke in deformation.strokes), default=math.inf)
    step = max(step, 0.5 * spacing.min()) if not deformation.maps else 0.5 * float(spacing.min())
    counts, reached = np.ceil((high - low) * spacing / step).astype(int) + 1, _reached(deformation)
    followed = [_outline(*box, reached) for box in zip(low, high, counts, strict=True)]
    edges = np.concatenate(followed)
    moved = deformation.inverse(edges).points if inverse else deformation.forward(edges)
    firsts = np.cumsum([0, *(len(some) for some in followed[:-1])])
    return np.concatenate([np.minimum.reduceat(moved, firsts), np.maximum.reduceat(moved, firsts)], axis=1)


def one_thread_in_workers() -> None:
    """Limit warps to one thread in a process that `multiprocessing` started, such as a worker of a ``DataLoader``.

    There are usually as many workers as cores; ``SUPPLE_THREADS`` sets another number.
    """
    if multiprocessing.parent_process() is not None:
        os.environ.setdefault("SUPPLE_THREADS", "1")


def _range(name: str, value: Any) -> tuple[Any, Any]:
    """Return both ends of a range; they are equal for a number."""
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        low, high = items(name, value, "a number, or two in ascending order", (2,))
        return low, high
    return value, value


def _looked_at(starts: Floats, radii: Floats, low: Floats, high: Floats) -> Floats:
    """Return points of the domain where strokes reach, a radius apart, and denser at their starts; (N, 3), x first."""
    ndim = starts.shape[1]
    offsets = np.concatenate([_lattice([np.arange(-3.0, 4.0)] * ndim), _lattice([np.array([-0.5, 0.0, 0.5])] * ndim)])
    points = np.clip(starts[:, None] + radii[:, None, None] * offsets, low, high).reshape(-1, ndim)
    made = np.zeros((len(points), 3))
    made[:, :ndim] = points
    return made


def _farthest(table: Table, still: Deformation, points: Floats) -> float:
    """Return the largest displacement of points (N, 3) by strokes, in physical units."""
    moved, _ = _core.forward(numbers(table), still.space.axes, points, False, None)
    return float(np.sqrt(np.square(moved - points).sum(axis=1).max()))


def _lattice(axes: Sequence[Floats]) -> Floats:
    """Return the points of the grid with these coordinates along each axis, x first."""
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(axes))


def _outline(low: Floats, high: Floats, counts: npt.NDArray[np.int_], reached: list[tuple[Floats, Floats]]) -> Floats:
    """Return points on the edges of a box in the plane, or on the faces of one in space, x first.

    Points outside all boxes ``reached`` do not move, and one of them is enough for an edge or a face.
    """
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    sides = []
    for k, end in itertools.product(range(len(axes)), (0, -1)):
        side = [axis[[end]] if i == k else axis for i, axis in enumerate(axes)]
        moved = np.zeros([len(axis) for axis in side], np.bool_)
        for first, last in reached:
            ends = zip(side, first, last, strict=True)
            moved[tuple(slice(axis.searchsorted(a), axis.searchsorted(b, "right")) for axis, a, b in ends)] = True
        moved.flat[moved.argmin()] = True
        sides.append(np.stack([axis[at] for axis, at in zip(side, moved.nonzero(), strict=True)], axis=-1))
    return np.concatenate(sides)


def _reached(deformation: Deformation) -> list[tuple[Floats, Floats]]:
    """Return the corners of boxes, in samples, beyond which no point moves."""
    n, everywhere = deformation.ndim, np.full(deformation.ndim, np.inf)
    if deformation.maps:
        return [(-everywhere, everywhere)]
    spacing, table = np.array(deformation.domain.spacing), deformation.space.table
    pivots, reaches = table["pivot"][:, :n], table["reach"][:, None]
    return list(zip((pivots - reaches) / spacing, (pivots + reaches) / spacing, strict=True))


def _shape_of(array: npt.NDArray[Any]) -> tuple[int, ...]:
    """Return the axes of space of an image; SuppleError if these are not clear."""
    shape = array.shape
    if array.ndim in (3, 4) and 0 < shape[-1] <= _CHANNELS:
        return shape[:-1]
    if array.ndim == 3:
        wanted = f"given for an image of shape {shape}: {shape} for a volume, {shape[:2]} for {shape[2]} channels"
        refuse("shape", wanted, told="none")
    if array.ndim != 2:
        refuse("image", "of shape (H, W[, C]) or (Z, H, W[, C])", told=f"shape {shape}")
    return shape
