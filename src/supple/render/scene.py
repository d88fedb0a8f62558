"""Rendered volumes: scenes, their images through a camera, and the voxels under pixels."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.deformation import Deformation
from supple.engine.work import Array
from supple.errors import SuppleError
from supple.gpu import raymarch as shading
from supple.gpu.device import DRAWING, Gpu, failures, gpu_of, trouble
from supple.gpu.solid import Filling, Volume
from supple.render.appearance import (
    PROJECTIONS,
    Seen,
    lamp,
    levelled,
    ranged,
    sampled,
    seen_through,
    skipped,
    summed,
    thinned,
    transfer_function,
    triple,
    warped,
)
from supple.render.box import Box, Clip, Plane, around, box_of, plane_of, seen_points, within
from supple.render.camera import Camera, Projection, camera_of, view_of
from supple.render.device import held_scene, tried
from supple.render.labels import LabelColours
from supple.render.meshes import Surface, nearest, place
from supple.render.picture import Pick, Rendering, colour_of, linear_light
from supple.render.shadows import NEAR, Shade, arriving, shade_of
from supple.render.transfer import Transfer
from supple.space.checks import choice, integer, number, point, refuse, varied
from supple.space.geometry import Geometry

MODES = ("buffered", "exact", "hybrid")
_STORAGE = 0x08  # wgpu.TextureUsage.STORAGE_BINDING
_ROWS = 256  # of an image, between two reports of progress


def check_options(mode: object, projection: object, device: object, silhouettes: object, shadows: object) -> None:
    """Raise SuppleError if an option of a scene is invalid."""
    choice("mode", mode, MODES)
    choice("projection", projection, PROJECTIONS)
    choice("device", device, DRAWING)
    for name, value in (("silhouettes", silhouettes), ("shadows", shadows)):
        number(name, value, "a number from 0 to 1", 0.0, 1.0)


class Scene:
    """A volume to render, with or without a deformation. It is immutable, except for its resources on a GPU.

    Parameters
    ----------
    samples : array, shape (Z, H, W), or (Z, H, W, 3 or 4) of colours
        Integers or floats; NaN counts as the smallest value. Colours are sRGB, with or without an opacity: uint8,
        uint16, or floats from 0 to 1. They are rendered as they are, with the opacity of their luminance.
    geometry : Geometry, optional
        The geometry of the voxels, for spacing and direction.
    deformation : Deformation, optional
        A deformation of the same shape and spacing.
    transfer : TransferFunction, LabelColours or str
        A transfer function, or the name of a preset (`supple.render.transfer.PRESETS`); or colours of labels, for a
        label map, or ``"labels"`` for the built-in ones.
    density : (float, float), optional
        The visible range of values or labels, to show hard structures inside.
    clip : three of (float, float), optional
        The rendered box: for each axis, x first, the range of voxels of the deformed volume, with None where nothing is
        cut away. Its faces show what is inside.
    plane : ((float, float, float), (float, float, float)), optional
        A voxel of the deformed volume, and a direction in LPS: all beyond the plane through the voxel, in that
        direction, is cut away.
    projection : str
        ``"none"``, or the ``"maximum"``, ``"minimum"`` or ``"average"`` value along each ray: opaque and grey, black at
        the lower end of ``density`` and white at the upper one, and by default at the smallest and largest value.
    silhouettes, shadows : float
        How much surfaces darken, from 0 to 1: silhouettes where they are seen edge-on; shadows where the lamp's light
        or, in hollows, the sky's does not arrive.
    mode : str
        The evaluation of the deformation: ``"buffered"`` warps the volume first; ``"exact"`` inverts every sample along
        every ray; ``"hybrid"``, on the GPU, is exact until `fill` has completed the buffer. On the CPU, ``"hybrid"`` is
        ``"buffered"``.
    meshes : sequence of Surface
        Meshes and contours, which move with the volume, exactly by T. They are opaque, and not cut away by ``clip`` and
        ``plane``; projections, which have no depth, are drawn behind them.
    step : float, optional
        The step along a ray, in millimetres; by default, 0.75 of the smallest spacing, and half of that spacing in
        projections and for labels.
    shaded : bool
        Whether surfaces are shaded by their gradient.
    tolerance : float
        The largest distance of source points from T⁻¹(q), in voxels.
    device : str
        The device: the ``"cpu"``; the ``"gpu"``, which may be software; or ``"auto"``: a hardware GPU, if there is one.
        The CPU takes over if the GPU lacks memory.

    Raises
    ------
    SuppleError
        If an argument does not fit.

    Warns
    -----
    DeviceWarning
        If the GPU failed, and the CPU took over.
    """

    shape: tuple[int, ...]
    """The shape of the given volume."""
    samples: Array
    """The volume sampled by the CPU: the original, or the warped one if buffered there."""
    clip: Box
    """The box that is rendered, in voxels of the deformed volume, x first."""
    plane: tuple[float, float, float, float]
    """The plane's unit normal along the volume's axes, and its distance from the first voxel, in millimetres."""
    error: float
    """A bound on the distance of source points from T⁻¹(q), in voxels, from the checks."""
    range: tuple[float, float]
    """The smallest and the largest value or label."""
    labels: Array | None
    """The visible labels of a label map, sorted; ``samples`` are their positions, from 1 on, and 0 elsewhere."""
    device: str
    """The requested device."""
    coarse: int
    """The voxels from sample to sample of a buffer of the CPU: 1, or more for a preview."""
    gpu: Gpu | None
    """The GPU of the rays; None for the CPU."""

    def __init__(
        self,
        samples: npt.ArrayLike,
        geometry: Geometry | None = None,
        *,
        deformation: Deformation | None = None,
        transfer: Transfer | str = "grey",
        density: tuple[float, float] | None = None,
        clip: Clip | None = None,
        plane: Plane | None = None,
        projection: str = "none",
        silhouettes: float = 0.0,
        shadows: float = 0.0,
        meshes: Sequence[Surface] = (),
        mode: str = "buffered",
        step: float | None = None,
        shaded: bool = True,
        tolerance: float = 0.2,
        device: str = "cpu",
    ) -> None:
        check_options(mode, projection, device, silhouettes, shadows)
        places: object = Geometry() if geometry is None else geometry
        if not isinstance(places, Geometry):
            refuse("geometry", "a Geometry", geometry)
        given = np.asarray(samples)
        known_shape = given.ndim == 3 or (given.ndim == 4 and given.shape[3] in (3, 4))
        if not known_shape or 0 in given.shape or given.dtype.kind not in "biuf":
            wanted = "a volume of numbers, (Z, H, W), or of colours, (Z, H, W, 3 or 4)"
            refuse("samples", wanted, told=f"{given.dtype} of shape {given.shape}")
        known = transfer_function(transfer)
        finest = min(places.spacing)
        step = (
            # projections and labels miss values between samples
            finest * (0.75 if projection == "none" and not isinstance(known, LabelColours) else 0.5)
            if step is None
            else number("step", step, f"millimetres from {finest * 1e-3:g} to 1e9", finest * 1e-3, 1e9)
        )
        drawn: Any = meshes
        if not isinstance(drawn, Sequence) or not all(isinstance(mesh, Surface) for mesh in drawn):
            refuse("meshes", "a sequence of surfaces (supple.render.meshes.Surface)", meshes)
        self.shape, self.geometry, self._given = given.shape[:3], places, given
        self.clip, self.plane = box_of(clip, self.shape), plane_of(plane, places)
        self.projection, self.mode, self.device, self.step = projection, mode, device, step
        self.silhouettes, self.shadows = float(silhouettes), float(shadows)
        self.tolerance = number("tolerance", tolerance, "a number of voxels from 1e-6 to 1e6", 1e-6, 1e6)
        self.meshes, self.shaded = tuple(meshes), bool(shaded)
        self._sample(known, density)
        self._deform(deformation, None)

    def __repr__(self) -> str:
        strokes = len(self.deformation.strokes) if self.deformation is not None else 0
        who = self.gpu.name if self.gpu is not None else "cpu"
        return f"<Scene of {self.shape} {self.samples.dtype}, {strokes} strokes, mode {self.mode}, by {who}>"

    def _sample(self, transfer: Transfer, density: tuple[float, float] | None) -> None:
        rest = self.step, self.projection, self.geometry.spacing
        self._original, self._paint, seen = sampled(self._given, transfer, density, *rest)
        self._still_ranges = ranged(self._original)
        self._thin: dict[int, tuple[Array, Array | None]] = {}  # every k-th voxel, and its colours
        self._look_by(seen)

    def _look_by(self, seen: Seen) -> None:
        self._seen, self.transfer, self.density = seen, seen.transfer, seen.density
        self.range, self.labels = seen.range, seen.labels
        self._still = skipped(seen, *self._still_ranges)  # what rays skip of the original

    def _deform(self, given: Deformation | None, volume: Volume | None, coarse: int = 1) -> None:
        """Set all attributes that depend on strokes. ``volume`` is the volume on a GPU, if it is there already."""
        spacing, gpu = self.geometry.spacing, gpu_of(self.device)
        deformation = self.deformation = _checked(given, self.shape, spacing)
        space = deformation.space if deformation is not None else None
        labelled = isinstance(self.transfer, LabelColours)
        self._held: shading.Held | None = None
        if gpu is not None:
            rest = labelled, self._paint, volume if volume is not None and volume.gpu is gpu else None
            work = gpu, self._original, spacing, space, self.mode, self.tolerance, *rest
            self._held = tried(gpu, lambda: held_scene(*work))
        held = self._held
        self.gpu = held.volume.gpu if held is not None else None
        self.samples, self.error, self.coarse = self._original, 0.0, 1
        self._colours = self._paint  # the colours of ``samples``; those of the original
        if deformation is not None and self.mode != "exact":
            self.error = self.tolerance if held is None or held.filling is not None else 0.0
            if held is None:
                self.coarse = coarse
                if coarse not in self._thin:
                    paint = None if self._paint is None else thinned(self._paint, coarse)
                    self._thin[coarse] = thinned(self._original, coarse), paint
                samples, paint = self._thin[coarse]
                self.samples = warped(samples, deformation, labelled, self.tolerance, coarse)
                if paint is not None:
                    self._colours = warped(paint, deformation, labelled, self.tolerance, coarse)
        self._ranges = self._still_ranges if self.samples is self._original else ranged(self.samples)
        self._placed = tuple(place(mesh, deformation, self.geometry) for mesh in self.meshes)
        self._skip()

    def _skip(self) -> None:
        self._skips = self._still if self.samples is self._original else skipped(self._seen, *self._ranges)
        self._filled: npt.NDArray[np.uint8] | None = None  # what rays skip of the buffer on a GPU, once that is filled
        self._darken()

    def _darken(self) -> None:
        self._shade: Shade | None = None
        if self.shadows and self.shaded and self.projection == "none":
            samples = self.samples
            if self.deformation is not None and samples is self._original:  # rays invert the map; shadows do not
                samples = warped(samples, self.deformation, isinstance(self.transfer, LabelColours), NEAR)
            box = tuple((low / self.coarse, high / self.coarse) for low, high in self.clip)
            spacing = tuple(self.coarse * s for s in self.geometry.spacing)
            self._shade = shade_of(samples, self._seen, self.step, box, self.plane, spacing)

    def deformed(self, deformation: Deformation | None, *, coarse: int = 1) -> Scene:
        """Return this scene with other strokes. The volume stays on the GPU.

        Parameters
        ----------
        deformation : Deformation, optional
        coarse : int
            For a preview on the CPU, in a mode with a buffer: only every ``coarse``-th voxel along each axis is warped.
        """
        integer("coarse", coarse, "a number of voxels from 1 to 64", 1, 64)
        made = varied(self)
        made._deform(deformation, self._held.volume if self._held else None, coarse)
        return made

    def seen_through(self, transfer: Transfer | str, density: tuple[float, float] | None = None) -> Scene:
        """Return this scene with another transfer function. Only label maps are inverted and warped again."""
        made, known = varied(self), transfer_function(transfer)
        if isinstance(known, LabelColours) or isinstance(self.transfer, LabelColours):  # samples number visible labels
            made._sample(known, density)
            made._deform(self.deformation, None)
        else:
            known = levelled(known, self._original, self.range)
            made._look_by(seen_through(known, density, self.range, self.step, self.projection))
            made._skip()
        return made

    def clipped(self, clip: Clip | None, plane: Plane | None = None) -> Scene:
        """Return this scene, within another box and before another plane, without inverting or warping again."""
        made = varied(self, clip=box_of(clip, self.shape), plane=plane_of(plane, self.geometry))
        made._darken()
        return made

    @property
    def is_empty(self) -> bool:
        """Return whether no value is visible."""
        return self._seen.threshold == math.inf

    def view(self, camera: Camera | None, size: tuple[int, int]) -> Projection:
        """Return the projection of a camera before this scene, for an image of ``size`` (rows, columns)."""
        return view_of(camera_of(camera), self._original.shape, self.geometry, size)

    @property
    def seen_points(self) -> npt.NDArray[np.float64]:
        """Points around all that is visible, in voxels of the deformed volume, x first, (N, 3)."""
        # Bricks of the original, moved: the same in all modes.
        points = seen_points(self._seen.visible(*self._still_ranges), _core.BRICK, self._original.shape)
        if self.deformation is not None and len(points):
            points = self.deformation.forward(points)
        points = within(points, self.clip, self.plane, self.geometry.spacing, _core.BRICK)
        return np.concatenate(
            [points, *(around(mesh.points) / self.geometry.spacing for mesh in self._placed if len(mesh.points))]
        )

    def framed(self, camera: Camera | None = None, size: tuple[int, int] = (512, 512)) -> Camera:
        """Return the camera; a target or a distance that it lacks is set so that all visible parts are in view."""
        known, points = camera_of(camera), self.seen_points
        view = view_of(known, self._original.shape, self.geometry, size, points)
        target = known.target or triple((points.min(axis=0) + points.max(axis=0)) / 2)
        return replace(known, target=target, distance=float(np.linalg.norm((view.eye - target) * view.spacing)))

    def render(
        self,
        camera: Camera | None = None,
        size: tuple[int, int] = (512, 512),
        *,
        supersampling: int = 1,
        tell: Callable[[int], None] = lambda rows: None,
    ) -> Rendering:
        """Render an image.

        Parameters
        ----------
        camera : Camera, optional
        size : (int, int)
            Rows and columns.
        supersampling : int
            Rays along each side of a pixel, from 1 to 8: smoother outlines.
        tell : function of int
            Called with the number of finished rows: at intervals on the CPU, and once at the end on a GPU.
        """
        fine = integer("supersampling", supersampling, "a number of rays along a pixel's side, from 1 to 8", 1, 8)
        view = self.view(camera, size)
        height, width = size[0] * fine, size[1] * fine
        look = self._look(view)
        ends = self._ends(look, view, fine)
        done, held = None, self._held
        if held is not None:
            done = tried(
                held.volume.gpu,
                lambda: shading.march(
                    held, self._look(view, copied) if (copied := held.filled()) else look, (height, width), fine, ends
                ),
                "the CPU did what {} could not",
            )
        if done is not None:
            light, depth, work = done
            tell(size[0])
        else:
            light, depth = np.empty((height, width, 4), np.float32), np.empty((height, width, 2))
            work = np.zeros((height, width, 2), np.int64)
            columns = (np.arange(width) + 0.5) / fine - 0.5
            for top in range(0, height, _ROWS):
                part = slice(top, min(top + _ROWS, height))
                rows = (np.arange(part.start, part.stop) + 0.5) / fine - 0.5
                own = None if ends is None else ends[part]
                self._march(look, view, columns, rows, (light[part], depth[part], work[part]), own)
                tell(part.stop // fine)
        if fine > 1:

            def blocks(a: Array) -> Array:
                return a.reshape(size[0], fine, size[1], fine, -1)

            light, depth = blocks(light).mean(axis=(1, 3)), blocks(depth).min(axis=(1, 3))
            work = blocks(work).sum(axis=(1, 3))
        return Rendering(light, depth[..., 0], work[..., 0], work[..., 1])

    def draw(
        self,
        texture: Any,
        camera: Camera | None = None,
        size: tuple[int, int] | None = None,
        *,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Render an image into a texture of the GPU, for a window, without downloading it.

        Parameters
        ----------
        texture : wgpu.GPUTexture
            Of ``scene.gpu.device``, format ``rgba8unorm`` and usage ``STORAGE_BINDING``. It receives sRGB.
        camera : Camera, optional
        size : (int, int), optional
            Rows and columns, at the texture's upper left; by default, all of it.
        background : (float, float, float)
            sRGB from 0 to 1.

        Raises
        ------
        SuppleError
            If the scene is not on a GPU, the texture does not fit, or the GPU failed: `render` still works then.
        """
        held = self._held
        if held is None:
            raise SuppleError("a texture is drawn into by a GPU, and this scene has none: use render")
        gpu = held.volume.gpu
        if getattr(texture, "_device", None) is not gpu.device:
            refuse("texture", "made by scene.gpu.device", told=f"{type(texture).__name__} of something else")
        width, height = texture.size[:2]
        view = self.view(camera, size or (height, width))
        rows, columns = view.size
        if texture.format != "rgba8unorm" or not texture.usage & _STORAGE or rows > height or columns > width:
            wanted = f"rgba8unorm, of usage STORAGE_BINDING and {columns} x {rows} pixels or more"
            refuse("texture", wanted, told=f"{texture.format} of {width} x {height}")
        behind = linear_light(colour_of("background", background)).astype(np.float32)
        try:
            with gpu.lock:
                look = self._look(view, held.filled())
                shading.paint(held, look, view.size, behind, texture, self._ends(look, view, 1))
        except failures() as error:
            raise SuppleError(f"{gpu.name} could not draw: {trouble(gpu, error)}: use render") from None

    def fill(self, *, seconds: float = 0.004) -> float:
        """Fill a part of the buffer of a ``"hybrid"`` scene, between two images.

        Parameters
        ----------
        seconds : float
            The approximate time; at least one block of 16³ voxels is filled.

        Returns
        -------
        float
            The filled part, from 0 to 1. For scenes without a buffer it is 1.

        Raises
        ------
        SuppleError
            If an argument is invalid.

        Warns
        -----
        DeviceWarning
            If the GPU failed: a hybrid scene goes on without a buffer, and a buffered one on the CPU.
        """
        held, seconds = self._held, number("seconds", seconds, "a number of seconds from 0", 0.0, 1e9)
        if held is None or held.filling is None or held.filling.part == 1.0:
            return 1.0
        filling = held.filling
        done = tried(
            held.volume.gpu,
            lambda: filling.advance(seconds),
            "the CPU does what {} cannot" if held.whole else "{} does not go on with the buffer",
        )
        if done is None:
            if held.whole:
                self._held = self.gpu = None
            else:
                self._held = replace(held, filling=None)
            return 1.0
        return done

    def _look(self, view: Projection, filled: Filling | None = None) -> shading.Look:
        """Return how rays see the scene's samples, or a buffer on the GPU."""
        seen, light = self._seen, lamp(view)
        skips = self._skips
        if filled is not None:
            skips = self._filled = skipped(seen, *filled.ranges()) if self._filled is None else self._filled
        arrives, placed = arriving(self._shade, light, self.shadows)
        camera, k = view.packed.copy(), self.coarse
        camera[0] /= k  # in samples
        camera[1] *= k
        return shading.Look(
            camera=camera,
            skips=skips,
            table=seen.table,
            sums=summed(seen.table),
            low=seen.low,
            scale=seen.scale,
            threshold=seen.threshold if self.projection == "none" else math.inf,
            top=seen.window[1],
            step=self.step,
            light=triple(light),
            shaded=self.shaded,
            box=np.ascontiguousarray(np.array(self.clip).T / k),
            plane=self.plane,
            silhouettes=self.silhouettes,
            projection=PROJECTIONS.index(self.projection),
            arrives=arrives,
            placed=placed,
            labelled=isinstance(self.transfer, LabelColours),
        )

    def _ends(self, look: shading.Look, view: Projection, fine: int) -> npt.NDArray[np.float32] | None:
        return nearest(self._placed, look, view, fine) if self._placed else None

    def _march(
        self,
        look: shading.Look,
        view: Projection,
        columns: Array,
        rows: Array,
        into: tuple[Array, Array, Array],
        ends: Array | None = None,
    ) -> None:
        """March the rays of columns and rows of pixels by the CPU, into colours, depths and work."""
        bent = None
        if self.deformation is not None and self.samples is self._original:
            bent = self.deformation.space.map
        xs, ys = columns - (view.size[1] - 1) / 2, rows - (view.size[0] - 1) / 2  # from the centre
        _core.draw(self.samples, self._colours, look.core, bent, xs, ys, *into, ends)

    def pick(self, camera: Camera, size: tuple[int, int], pixel: tuple[float, float]) -> Pick | None:
        """Return the voxel under a pixel.

        Parameters
        ----------
        camera : Camera
        size : (int, int)
            Rows and columns of the image.
        pixel : (float, float)
            x and y, from the centre of the upper left pixel.

        Returns
        -------
        Pick or None
            The first point along the pixel's ray with an accumulated opacity of 0.9, ignoring meshes; None if there is
            none.
        """
        x, y = point("pixel", pixel, (2,))
        view = self.view(camera, size)
        light, depth, work = np.empty((1, 1, 4), np.float32), np.empty((1, 1, 2)), np.empty((1, 1, 2), np.int64)
        self._march(self._look(view), view, np.array([x]), np.array([y]), (light, depth, work))
        away = float(depth[0, 0, 1])
        if not math.isfinite(away):
            return None
        at = view.eye + away * view.direction(x, y) / view.spacing
        source = at if self.deformation is None else self.deformation.inverse(at).points
        return Pick(triple(at), triple(source), away)

    def drag(
        self, camera: Camera, size: tuple[int, int], pick: Pick, to: tuple[float, float]
    ) -> tuple[float, float, float]:
        """Return the drag of a picked point to a pixel: in the camera's plane, at its depth.

        Parameters
        ----------
        camera, size
            The arguments of `pick`.
        pick : Pick
        to : (float, float)
            The target pixel of the point.

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
        return triple((end - start) / view.spacing)

    def turned(self, camera: Camera, k: int, count: int) -> Camera:
        """Return the camera of image ``k`` of ``count`` on a turn around the volume."""
        camera = camera_of(camera)
        return replace(camera, azimuth=camera.azimuth + 360.0 * k / count)


def _checked(given: Deformation | None, shape: tuple[int, ...], spacing: tuple[float, ...]) -> Deformation | None:
    """Return the deformation of a scene's volume; None for the identity.

    SuppleError if it is of another shape or spacing, or not of strokes alone.
    """
    deformation: object = given
    if deformation is None:
        return None
    if not isinstance(deformation, Deformation):
        refuse("deformation", "a Deformation", deformation)
    if deformation.shape != shape:
        refuse("the deformation", f"one of shape {shape}, as the volume", told=f"shape {deformation.shape}")
    if deformation.maps:
        raise SuppleError("a scene is bent by strokes alone, found fields or affine maps: warp the volume first")
    if not np.allclose(deformation.domain.spacing, spacing):
        refuse("the deformation", f"one of spacing {spacing}", deformation.domain.spacing)
    return None if deformation.is_identity else deformation
