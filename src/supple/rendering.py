"""Pictures of volumes: a scene, what it looks like through a camera, and what lies under a pixel of that."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.camera import Camera, View, view_of
from supple.cpu import bricks, raymarch
from supple.cpu.kernel import share
from supple.cpu.sampling import linear_light
from supple.cpu.solid import solve_solid, unmoved
from supple.deformation import Deformation
from supple.domain import choice, integer, number, point, refuse
from supple.engines import gpu_of
from supple.errors import DeviceWarning, SuppleError, ToleranceWarning
from supple.geometry import Geometry
from supple.gpu import raymarch as shading
from supple.gpu.device import Gpu
from supple.gpu.field import fits
from supple.gpu.kernel import failures, trouble
from supple.strokes import STROKE_DTYPE
from supple.transfer import ENTRIES, PRESETS, TransferFunction

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

MODES = ("lattice", "exact", "buffered")
_ROWS = 8  # of a picture, that a core takes at a time
_TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32)
PICKED = 0.9
"""The opacity that a ray has gathered where something is picked."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A volume, seen.

    Parameters
    ----------
    light : float32 array, shape (H, W, 4)
        Linear red, green and blue, already weighted by opacity, and the opacity.
    depth : float64 array, shape (H, W)
        Millimetres from the eye to the first surface; infinity where there is none.
    samples, evaluations : int64 arrays, shape (H, W)
        How many samples each pixel took, and how many evaluations of T with its Jacobian (in the mode ``"exact"``).
    """

    light: npt.NDArray[np.float32]
    depth: Floats
    samples: npt.NDArray[np.int64]
    evaluations: npt.NDArray[np.int64]

    def pixels(self, background: tuple[float, float, float] | None = None) -> npt.NDArray[np.uint8]:
        """As sRGB of 8 bits.

        Parameters
        ----------
        background : (float, float, float), optional
            sRGB from 0 to 1, to make an opaque picture; without it, opacity is kept.

        Returns
        -------
        uint8 array, shape (H, W, 3 or 4)
        """
        alpha = np.clip(self.light[..., 3:], 0, 1)
        if background is None:
            colours = self.light[..., :3] / np.maximum(alpha, 1e-6)
            seen = np.concatenate([_srgb(colours), alpha], axis=-1)
        else:
            behind = linear_light(np.asarray(background, np.float64), 1.0)
            seen = _srgb(self.light[..., :3] + (1 - alpha) * behind)
        return np.asarray(np.rint(seen * 255), np.uint8)


def _srgb(linear: Array) -> Array:
    u = np.clip(linear, 0, 1)
    return np.asarray(np.where(u <= 0.0031308, 12.92 * u, 1.055 * np.power(u, 1 / 2.4) - 0.055))


@dataclass(frozen=True, slots=True, eq=False)
class Pick:
    """What lies under a pixel.

    Parameters
    ----------
    index : (float, float, float)
        The point of the deformed volume, in voxels, x first.
    source : (float, float, float)
        The point of the volume as it was, that is seen there.
    depth : float
        Millimetres from the eye.
    """

    index: tuple[float, float, float]
    source: tuple[float, float, float]
    depth: float


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Scene:
    """A volume to look at, perhaps deformed.

    Parameters
    ----------
    samples : array, shape (Z, H, W)
        Of integers or floats; what is not a number counts as the smallest value.
    geometry : Geometry, optional
        Where its voxels lie: spacing and direction are respected.
    deformation : Deformation, optional
        Of the same shape and spacing.
    transfer : TransferFunction or str
        Or the name of a preset: ``"ct-bone"``, ``"ct-skin"``, ``"mr-head"`` or ``"grey"``.
    density : (float, float), optional
        Values outside are not seen, as when hard structures inside should be.
    mode : str
        How a deformation is seen: by a certified ``"lattice"`` of inverse displacements, ``"exact"`` inversion of every
        sample along every ray, or ``"buffered"``, which warps the volume first.
    step : float, optional
        Millimetres from sample to sample along a ray; the smallest spacing by default.
    shaded : bool
        Whether surfaces are lit, by their gradient.
    tolerance : float
        How far source points may be from the true T⁻¹(q), in voxels.
    device : str
        Who marches along the rays: the ``"cpu"``; the ``"gpu"``, also one that is a program for the CPU; or ``"auto"``:
        a graphics card, where there is one. What it cannot hold, the CPU does.

    Raises
    ------
    SuppleError
        If something does not fit.

    Warns
    -----
    DeviceWarning
        If the GPU failed, so that the CPU does it.
    """

    samples: Array
    geometry: Geometry
    deformation: Deformation | None
    transfer: TransferFunction
    density: tuple[float, float]
    mode: str
    step: float
    shaded: bool
    tolerance: float
    error: float
    """How far source points are from the true T⁻¹(q), in voxels, as far as the checks see."""
    range: tuple[float, float]
    """The smallest and the largest value."""
    _nodes: npt.NDArray[np.float32]
    _per_voxel: float
    _lows: npt.NDArray[np.float32]
    _highs: npt.NDArray[np.float32]
    _skips: npt.NDArray[np.uint8]
    _table: npt.NDArray[np.float32]
    _threshold: float
    _held: shading.Held | None

    def __init__(
        self,
        samples: npt.ArrayLike,
        geometry: Geometry | None = None,
        *,
        deformation: Deformation | None = None,
        transfer: TransferFunction | str = "grey",
        density: tuple[float, float] | None = None,
        mode: str = "lattice",
        step: float | None = None,
        shaded: bool = True,
        tolerance: float = 0.2,
        device: str = "cpu",
    ) -> None:
        choice("mode", mode, MODES)
        gpu = gpu_of(device)
        places = Geometry() if geometry is None else geometry
        given = np.asarray(samples)
        if given.ndim != 3 or 0 in given.shape or given.dtype.kind not in "biuf":
            refuse("samples", "a volume of numbers, (Z, H, W)", f"{given.dtype} of shape {given.shape}")
        known = transfer_function(transfer)
        finest = min(places.spacing)
        step = (
            finest
            if step is None
            else number("step", step, f"millimetres, at least {finest * 1e-3:g}", finest * 1e-3, 1e9)
        )
        tolerance = number("tolerance", tolerance, "a number of voxels above 0", 1e-6, 1e6)
        if deformation is not None:
            if deformation.shape != given.shape:
                refuse("the deformation", f"one of shape {given.shape}, as the volume", f"shape {deformation.shape}")
            if not np.allclose(deformation.domain.spacing, places.spacing):
                refuse("the deformation", f"one of spacing {places.spacing}", deformation.domain.spacing)
            deformation = None if deformation.is_identity else deformation
        nodes, per_voxel, error = unmoved(), 0.0, 0.0
        ready = _prepared(given)
        low, high = float(ready.min()), float(ready.max())  # of the volume as it was, whatever the mode
        if deformation is not None and mode == "buffered":
            ready = deformation.warp(ready[tuple(map(slice, given.shape))], filter="linear", tolerance=tolerance)
            ready, error = _prepared(ready), tolerance
        elif deformation is not None and mode == "lattice":
            solid = solve_solid(deformation.space.table, deformation.space.axes, given.shape, tolerance)
            nodes, per_voxel, error = solid.nodes, 1.0 / solid.step, solid.error
            if error > tolerance:
                off = f"by {error:.2g} voxels" if math.isfinite(error) else "by more than a voxel"
                warnings.warn(
                    f"the lattice may be off {off} somewhere, beyond the tolerance {tolerance:g}: "
                    'mode "exact" or "buffered" is not',
                    ToleranceWarning,
                    stacklevel=2,
                )
        brick = bricks.FINE if per_voxel > 0 else bricks.BRICK
        lows, highs = (np.empty(_bricks(ready.shape, brick), np.float32) for _ in range(2))
        bricks.ranges(ready.reshape(-1), _size(ready), brick, lows, highs)
        values: dict[str, Any] = {
            "samples": ready,
            "geometry": places,
            "deformation": deformation,
            "transfer": known,
            "mode": mode,
            "step": step,
            "shaded": bool(shaded),
            "tolerance": tolerance,
            "error": error,
            "range": (low, high),
            "_nodes": nodes,
            "_per_voxel": per_voxel,
            "_lows": lows,
            "_highs": highs,
            **_seen_through(known, density, (low, high), step),
        }
        values["_skips"] = self._skipped(values)
        values["_held"] = _held(gpu, values) if gpu is not None else None
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def seen_through(self, transfer: TransferFunction | str, density: tuple[float, float] | None = None) -> Scene:
        """The same scene through another transfer function; nothing is inverted or warped anew."""
        made = object.__new__(type(self))
        values = {name: getattr(self, name) for name in self.__slots__}
        known = transfer_function(transfer)
        values |= {"transfer": known, **_seen_through(known, density, self.range, self.step)}
        values["_skips"] = self._skipped(values)
        for name, value in values.items():
            object.__setattr__(made, name, value)
        return made

    @staticmethod
    def _skipped(known: dict[str, Any]) -> npt.NDArray[np.uint8]:
        """How many bricks away the next one is that anything is seen of."""
        table, (low, high) = known["_table"], known["range"]
        bottom, top = known["density"]
        entries = _entries(low, high)
        visible = np.concatenate([[0], np.cumsum(table[:, 3] > 0)])
        lows, highs = np.maximum(known["_lows"], bottom), np.minimum(known["_highs"], top)
        first, last = (np.clip(np.rint((v - low) * entries), 0, ENTRIES - 1).astype(np.int64) for v in (lows, highs))
        seen = (visible[np.maximum(last, first) + 1] > visible[first]) & (lows <= highs)
        if known["_per_voxel"] > 0:
            moved = np.empty(_bricks(known["samples"].shape, bricks.BRICK), np.bool_)
            bricks.moved(seen, bricks.FINE, known["_nodes"], known["_per_voxel"], _size(known["samples"]), moved)
            seen = moved
        return np.asarray(bricks.distances(seen), np.uint8)

    @property
    def is_empty(self) -> bool:
        """Whether no value is seen at all."""
        return self._threshold == math.inf

    def view(self, camera: Camera, size: tuple[int, int]) -> View:
        """The camera before this scene, for a picture of ``size`` (rows, columns)."""
        return view_of(camera, self.samples.shape, self.geometry, size)

    def render(
        self,
        camera: Camera | None = None,
        size: tuple[int, int] = (512, 512),
        *,
        supersampling: int = 1,
        tell: Callable[[int], None] = lambda rows: None,
    ) -> Picture:
        """Take a picture.

        Parameters
        ----------
        camera : Camera, optional
        size : (int, int)
            Rows and columns.
        supersampling : int
            Rays along each side of a pixel, from 1 to 8: smoother outlines.
        tell : function of int
            Called with the number of rows that are done, now and then.
        """
        fine = integer("supersampling", supersampling, "a number of rays along a pixel's side, from 1 to 8", 1, 8)
        view = self.view(camera or Camera(), size)
        height, width = size[0] * fine, size[1] * fine
        columns = (np.arange(width) + 0.5) / fine - 0.5

        def smaller(a: Array, take: Callable[..., Array]) -> Array:
            return take(a.reshape(size[0], fine, size[1], fine, -1), axis=(1, 3)) if fine > 1 else a

        if self._held is not None:
            gpu, wrong = self._held.gpu, False

            def told(rows: int) -> None:
                nonlocal wrong
                wrong = True  # what is raised here is no fault of the GPU's
                tell(rows // fine)
                wrong = False

            try:
                with gpu.lock:
                    light, depth, work = shading.march(
                        self._held, self._look(view), view.packed, (height, width), fine, told
                    )
                return _picture(smaller(light, np.mean), smaller(depth, np.min), smaller(work, np.sum))
            except failures() as error:
                if wrong:
                    raise
                failed = trouble(gpu, error)
            warnings.warn(f"the CPU did what {gpu.name} could not: {failed}", DeviceWarning, stacklevel=2)
        light, depth = np.empty((height, width, 4), np.float32), np.empty((height, width, 2))
        work = np.zeros((height, width, 2), np.int64)
        march = self._marcher(view)

        def rows(top: int) -> None:
            below = min(top + _ROWS, height)
            ys = (np.arange(top, below) + 0.5) / fine - 0.5
            pixels = view.middle(*np.meshgrid(columns, ys)).reshape(-1, 2)
            parts = (a[top:below].reshape(-1, a.shape[-1]) for a in (light, depth, work))
            march(pixels, *parts)

        starts = range(0, height, _ROWS)
        for k in range(0, len(starts), 64):
            share(rows, starts[k : k + 64])
            tell(min(starts[min(k + 63, len(starts) - 1)] + _ROWS, height) // fine)

        return _picture(smaller(light, np.mean), smaller(depth, np.min), smaller(work, np.sum))

    def _look(self, view: View) -> shading.Look:
        low, high = self.range
        return shading.Look(
            self._skips,
            self._table,
            low,
            _entries(low, high),
            self._threshold,
            self.density,
            self.step,
            _light(view),
            self.shaded,
        )

    def _marcher(self, view: View) -> Callable[..., None]:
        """What marches along the rays of pixels, into colours, depths and work; see `supple.cpu.raymarch`."""
        low, high = self.range
        common = (
            self._table,
            np.float32(low),
            np.float32(_entries(low, high)),
            np.float32(self._threshold),
            np.array(self.density, np.float32),
            view.packed,
        )
        rest = (self.step, _light(view), self.shaded)
        flat, size = self.samples.reshape(-1), _size(self.samples)
        if self.mode == "exact" and self.deformation is not None:
            space, finest = self.deformation.space, 1e-3 * min(self.geometry.spacing)
            return lambda pixels, *parts: raymarch.march_exactly(
                flat, size, space.table, space.axes, finest, *common, pixels, *rest, *parts
            )
        lattice = (
            self._nodes,
            np.float32(self._per_voxel),
            raymarch.LATTICE if self._per_voxel > 0 else raymarch.PLAIN,
        )
        return lambda pixels, *parts: raymarch.march(flat, size, *lattice, self._skips, *common, pixels, *rest, *parts)

    def pick(self, camera: Camera, size: tuple[int, int], pixel: tuple[float, float]) -> Pick | None:
        """What a click at a pixel takes hold of.

        Parameters
        ----------
        camera : Camera
        size : (int, int)
            Rows and columns of the picture.
        pixel : (float, float)
            x and y, from the centre of the upper left pixel.

        Returns
        -------
        Pick or None
            The first point along the pixel's ray where the opacity passes 0.9; None where it never does.
        """
        x, y = point("pixel", pixel, (2,))
        view = self.view(camera, size)
        out, depth, work = np.empty((1, 4), np.float32), np.empty((1, 2)), np.zeros((1, 2), np.int64)
        self._marcher(view)(view.middle([x], [y]), out, depth, work)
        if not np.isfinite(depth[0, 1]):
            return None
        at = view.eye + depth[0, 1] * view.direction(x, y) / view.spacing
        source = at if self.deformation is None else self.deformation.inverse(at).points
        return Pick(_triple(at), _triple(source), float(depth[0, 1]))

    def drag(
        self, camera: Camera, size: tuple[int, int], pick: Pick, to: tuple[float, float]
    ) -> tuple[float, float, float]:
        """How far a picked point goes when it is dragged to a pixel: in the camera's plane, at its depth.

        Parameters
        ----------
        camera, size
            As it was picked.
        pick : Pick
        to : (float, float)
            The pixel that the point should be seen at.

        Returns
        -------
        (float, float, float)
            In voxels, x first: ``by`` of a stroke at ``pick.index``.
        """
        x, y = point("to", to, (2,))
        view = self.view(camera, size)
        start = (np.array(pick.index) - view.eye) * view.spacing
        away = float(start @ view.ahead)
        if away <= 0:
            raise SuppleError("the picked point lies behind the camera: pick with the same camera")
        direction = view.direction(x, y)
        end = direction * (away / float(direction @ view.ahead))
        return _triple((end - start) / view.spacing)

    def turned(self, camera: Camera, k: int, count: int) -> Camera:
        """The camera of picture ``k`` of ``count`` on a way around the volume."""
        return replace(camera, azimuth=camera.azimuth + 360.0 * k / count)


def _picture(light: Array, depth: Array, work: Array) -> Picture:
    return Picture(light, depth[..., 0], work[..., 0], work[..., 1])


def _held(gpu: Gpu, known: dict[str, Any]) -> shading.Held | None:
    """A volume on the GPU; None if it does not fit there."""
    deformation = known["deformation"]
    mode, table, axes = shading.PLAIN, np.zeros(0, STROKE_DTYPE), np.zeros((3, 3))
    axes[:, 0], axes[:, 2] = 1.0, known["geometry"].spacing
    if deformation is not None:
        table, axes = deformation.space.table, deformation.space.axes
        mode = {"lattice": shading.LATTICE, "exact": shading.EXACT}.get(known["mode"], shading.PLAIN)
    failed = "" if fits(table) else "strokes of such sizes are beyond its numbers"
    if not failed:
        try:
            with gpu.lock:
                return shading.hold(gpu, known["samples"], known["_nodes"], known["_per_voxel"], mode, table, axes)
        except failures() as error:
            failed = trouble(gpu, error)
    warnings.warn(f"the CPU does what {gpu.name} cannot: {failed}", DeviceWarning, stacklevel=4)
    return None


def transfer_function(given: TransferFunction | str) -> TransferFunction:
    """A transfer function, or the preset of a name."""
    if isinstance(given, TransferFunction):
        return given
    choice("transfer", given, tuple(PRESETS))
    return PRESETS[given]


def _seen_through(
    transfer: TransferFunction, density: tuple[float, float] | None, values: tuple[float, float], step: float
) -> dict[str, Any]:
    low, high = values
    if density is None:
        window = (-math.inf, math.inf)
    else:
        bounds = point("density", density, (2,))
        if bounds[0] >= bounds[1]:
            refuse("density", "two values LO,HI, the lower one first", density)
        window = (bounds[0], bounds[1])
    table = transfer.table(low, high, step)
    entries = np.linspace(low, high, ENTRIES)
    seen = (table[:, 3] > 0) & (entries >= window[0]) & (entries <= window[1])
    # Halfway to the last entry that nothing is seen of, as entries are rounded to.
    first = int(np.argmax(seen)) if seen.any() else 0
    if not seen.any():
        threshold = math.inf
    elif first == 0:
        threshold = -math.inf if window[0] <= low else window[0]
    else:
        threshold = max(window[0], float(entries[first]) - 0.5 * (high - low) / (ENTRIES - 1))
    return {"density": window, "_table": table, "_threshold": threshold}


def _entries(low: float, high: float) -> float:
    """Entries of the table for each unit of value."""
    return (ENTRIES - 1) / (high - low) if high > low else 0.0


def _light(view: View) -> npt.NDArray[np.float32]:
    """A lamp beside the camera, above and to the left."""
    right, down = (axis / np.linalg.norm(axis) for axis in view.packed[3:])
    towards = -view.ahead - 0.35 * right - 0.45 * down
    return np.asarray(towards / np.linalg.norm(towards), np.float32)


def _bricks(shape: tuple[int, ...], brick: int) -> tuple[int, ...]:
    return tuple(-(-max(n - 1, 1) // brick) for n in shape)


def _size(samples: Array) -> npt.NDArray[np.int64]:
    return np.array(samples.shape[::-1], np.int64)


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _prepared(given: Array) -> Array:
    """Samples as the kernels take them: of a type they know, two along each axis at least, and numbers all."""
    if given.dtype.newbyteorder("=") not in _TYPES:
        with np.errstate(over="ignore"):
            given = given.astype(np.float32)
    ready = np.ascontiguousarray(given, given.dtype.newbyteorder("="))
    if ready.dtype.kind == "f" and not np.isfinite(ready).all():
        finite = ready[np.isfinite(ready)]
        bottom, top = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
        ready = np.nan_to_num(ready, nan=bottom, neginf=bottom, posinf=top)
    if min(ready.shape) < 2:
        ready = np.pad(ready, [(0, 1 if n < 2 else 0) for n in ready.shape], mode="edge")
    return ready
