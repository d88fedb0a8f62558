"""Rendering volume files as images and turntables, with meshes and contours from files."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from supple.arrays import warp_array
from supple.engine.sampling import Sampling
from supple.engine.work import Array, Tell
from supple.errors import OutsideWarning, SuppleError, VolumeWarning, argument, shown, warn
from supple.fields import warn_of_maps
from supple.files.grids import grid_on
from supple.files.jobs import Job
from supple.files.landmarks import convention_of, warn_of_frame
from supple.files.volumes import background_of, deformation_of, is_of_labels, open_volume
from supple.media import image, pictures, turntable
from supple.media.files import PathLike, check_output, check_outputs, check_suffix, replacing, replacing_all
from supple.media.meshes import KINDS
from supple.media.numbering import has_number, spelling
from supple.media.points import read_points
from supple.media.volume import Volume
from supple.render.appearance import cropped, fixed, is_hounsfield, largest, without_table
from supple.render.box import Clip, Plane
from supple.render.camera import Camera
from supple.render.labels import LabelColours, labels_in
from supple.render.meshes import Surface
from supple.render.picture import Rendering, are_colours, colour_of
from supple.render.scene import Scene, check_options
from supple.render.transfer import HOUNSFIELD, LABELS, SUFFIXES, Transfer, transfer_of
from supple.space.checks import choice, integer, number
from supple.space.geometry import check_upright

WHATS = ("picture", "inversions")
_OF_SCENE = ("density", "clip", "plane", "projection", "silhouettes", "shadows", "step", "shaded", "device")
_TABLE = ".ctbl"
_LABEL_INTENT = 1002  # NIFTI_INTENT_LABEL
_RATE = 24.0  # pictures a second
LIGHTLESS = (".png", ".tif", ".tiff", ".webp", ".avif")  # formats with opacity, whose background may be transparent
Colour = tuple[float, float, float]
COLOURS = (
    (0.31, 0.66, 0.87), (0.95, 0.76, 0.31), (0.42, 0.75, 0.41), (0.82, 0.42, 0.65), (0.94, 0.54, 0.29),
    (0.56, 0.49, 0.76),
)  # fmt: skip
"""sRGB colours for meshes without a colour, used in turn."""
_FARTHEST = 1e7  # voxels


@dataclass(frozen=True, slots=True)
class MeshFile:
    """A mesh or contours in a file, and their colour."""

    path: PathLike  # .stl, .obj, .ply, .vtk (PolyData), .vtp; or a structure set of DICOM, .dcm
    colour: Colour | None = None  # sRGB from 0 to 1; by default, that of a structure set's region, or of `COLOURS`


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Options of a rendered volume.

    Parameters
    ----------
    transfer : str, TransferFunction or LabelColours, optional
        A preset's name, or a file: JSON, 3D Slicer's (``.vp``), or a colour table of labels (``.ctbl``, ``.txt``); by
        default, the preset that fits the values, and the colours of ``"labels"`` for a label map.
    density : (float, float), optional
        The visible range of values or labels.
    clip : three of (float, float), optional
        The voxels that are rendered, as in `supple.render.scene.Scene`.
    crop : three of (float, float), optional
        The voxels of the unwarped volume that are rendered; strokes move them: see `supple.render.appearance.cropped`.
    plane, projection, silhouettes, shadows
        As in `supple.render.scene.Scene`.
    meshes : sequence of MeshFile
        Meshes and contours that are rendered with the volume, and move with it.
    convention : str, optional
        The convention of meshes without their own, as in `read_surfaces`.
    table : bool
        Whether CT presets also show parts apart from the body: see `supple.render.appearance.without_table`.
    largest : bool
        Whether only the largest connected part of what is visible is rendered (`supple.render.appearance.largest`).
    camera : Camera
        The camera; by default, everything visible is in view.
    size : (int, int)
        Rows and columns of the image.
    step : float, optional
        The step along a ray, in millimetres; by default, as in `supple.render.scene.Scene`.
    mode : str
        ``"buffered"`` or ``"exact"``: see `supple.render.scene.Scene`. ``"hybrid"`` is ``"buffered"`` here.
    shaded : bool
    annotate : bool
        Whether a scale bar and the letters of the patient's sides are drawn: `supple.render.annotate.annotated`.
    legend : bool
        Whether the names of labels are listed with their colours, at the upper left.
    background : (float, float, float), optional
        sRGB from 0 to 1; by default, images are transparent where they are empty, and videos black.
    supersampling : int
        Rays along each side of a pixel.
    turntable : int, optional
        The number of images of a turntable, which is written as a video or as numbered images.
    rate : float, optional
        Images a second of that video; by default, 24.
    what : str
        ``"picture"``, or ``"inversions"``: the number of evaluations of T⁻¹ along each ray.
    time : int
        The volume of a series, from 0.
    device : str
        ``"cpu"``, ``"gpu"`` or ``"auto"``; see `supple.render.scene.Scene`.
    save_transfer : str or os.PathLike, optional
        A file for the transfer function that is used: ``.json``, or ``.vp`` for 3D Slicer; for labels, ``.ctbl``.
    """

    transfer: Transfer | PathLike | None = None
    density: tuple[float, float] | None = None
    clip: Clip | None = None
    crop: Clip | None = None
    plane: Plane | None = None
    meshes: Sequence[MeshFile] = ()
    convention: str | None = None
    table: bool = False
    largest: bool = False
    projection: str = "none"
    silhouettes: float = 0.0
    shadows: float = 0.0
    camera: Camera = field(default_factory=Camera)
    size: tuple[int, int] = (512, 512)
    step: float | None = None
    mode: str = "buffered"
    shaded: bool = True
    annotate: bool = False
    legend: bool = False
    background: tuple[float, float, float] | None = None
    supersampling: int = 1
    turntable: int | None = None
    rate: float | None = None
    what: str = "picture"
    time: int = 0
    device: str = "cpu"
    save_transfer: PathLike | None = None

    def __post_init__(self) -> None:
        check_options(self.mode, self.projection, self.device, self.silhouettes, self.shadows)
        choice("what", self.what, WHATS)
        told = f"a projection ({self.projection}) is of all values along a ray, in grey"
        if self.projection != "none":
            names = ("transfer", "save_transfer", "crop", "silhouettes", "shadows")
            given = [argument(name) for name in names if getattr(self, name)] + ["unshaded"] * (not self.shaded)
            if given:
                raise SuppleError(f"{told}: leave {given[0]} out")
        if not self.shaded and (self.silhouettes or self.shadows):
            raise SuppleError("silhouettes and shadows are of shaded surfaces: leave unshaded out, or them")
        for k, pixels in enumerate(self.size):
            integer(f"size[{k}]", pixels, "a number of pixels from 1 to 16384", 1, 16384)
        integer("supersampling", self.supersampling, "a number of rays along a pixel's side, from 1 to 8", 1, 8)
        if self.turntable is not None:
            integer("turntable", self.turntable, "a number of pictures from 2 to 100000", 2, 100_000)
        if self.background is not None:
            colour_of("background", self.background)
        if self.rate is not None:
            number("rate", self.rate, "from 0.001 to 10000 pictures a second", 1e-3, 1e4)
            if self.turntable is None:
                raise SuppleError(f"{argument('rate')} is of a turntable's video, and this is a picture: leave it out")
        if self.what == "inversions":
            for name in ("meshes", "shadows", "silhouettes", "turntable", "annotate", "legend", "background"):
                if getattr(self, name):
                    raise SuppleError(f"inversions are drawn as one plot, of the volume alone: leave {name} out")


def read_surfaces(given: Sequence[MeshFile], volume: Volume, convention: str | None = None) -> tuple[Surface, ...]:
    """Return the surfaces and contours of files, in voxels of a volume.

    ``convention`` is that of files without their own: ``"LPS"`` or ``"RAS"`` in millimetres, or ``"index"``.
    SuppleError if a file cannot be read, has neither faces nor lines, or cannot be placed in the volume; OutsideWarning
    if none of a file's points lies in it.
    """
    if convention is not None:
        choice("convention", convention, ("LPS", "RAS", "index"))
    made: list[Surface] = []
    for each in given:
        advice = f"give a mesh or contours: {', '.join(KINDS)}"
        check_suffix(each.path, os.path.splitext(each.path)[1], KINDS, "is of no mesh", advice, "read")
        read = read_points(each.path, mesh=True)
        warn_of_frame(each.path, volume)
        known = convention_of(read, convention if read.told == "mesh" else None, volume.geometry.convention)
        points = read.points if known == "index" else volume.geometry.from_world(read.points, known)
        parts = read.parts()
        if len(points) and np.abs(points).max() > _FARTHEST:
            text = f"{read.name} has a vertex {np.abs(points).max():.2g} voxels away: give a whole copy of it"
            raise SuppleError(text)
        if ((points < -0.5) | (points > np.array(volume.sizes) - 0.5)).any(axis=1).all():
            text = f"no point of {read.name} lies in {volume.name}"
            warn(f"{text}: see whether its coordinates are of that volume", OutsideWarning)
        for part in parts:
            colour = each.colour or part.colour or COLOURS[len(made) % len(COLOURS)]
            used = np.zeros(len(points), np.bool_)  # points of no face or line are invisible
            for corners in (part.triangles, part.lines):
                used[corners] = True
            order = np.cumsum(used) - 1
            if used.any():
                made.append(Surface(points[used], order[part.triangles], order[part.lines], colour))
    return tuple(made)


def default_transfer(volume: Volume) -> Transfer | str:
    """Return the preset for a volume's values, or the colours of its segments.

    CT is recognized by air at -1000 Hounsfield units; a label map by the intent code of a NIfTI file, or by its values:
    few integers from 0, in large areas. Segments have the colours of their file; SuppleError if their list is invalid.
    """
    if volume.is_segmentation:
        try:
            return LabelColours.of_segments(volume.header, labels_in(volume.samples))
        except SuppleError as error:
            raise SuppleError(f"{volume.name}: {error}") from None
    if _is_of_labels(volume):
        return LABELS
    values = volume.samples
    known = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    if known.size == 0:
        return "mr-head"
    slope, intercept = volume.scaling
    low, high = sorted(slope * float(v) + intercept for v in (known.min(), known.max()))
    return "ct-skin" if is_hounsfield(low, high) else "mr-head"


def _is_of_labels(volume: Volume) -> bool:
    if volume.components != 1:
        return False
    if volume.format == "NIfTI" and int(volume.header["intent_code"]) == _LABEL_INTENT:
        with contextlib.suppress(SuppleError):  # for values that are not integers
            labels_in(volume.rescaled())
            return True
    return is_of_labels(volume) and volume.samples.min() >= 0 and volume.scaling == (1.0, 0.0)


def scene_of(volume: Volume, job: Job, known: RenderOptions) -> Scene:
    """Return the scene of the volume of a job, with its strokes. With maps, the volume itself is warped first.

    With a reference, the warped volume is on its grid. SuppleError if the volume has several components that are not
    colours, or an argument does not fit.
    """
    samples = volume.rescaled()
    if volume.series:
        last = len(samples) - 1
        wanted = f"the number of a volume of {volume.name}, from 0 to {last}"
        samples = samples[integer("time", known.time, wanted, 0, last)]
    elif known.time:
        raise SuppleError(f"{volume.name} is one volume, and {argument('time')} is for series: leave it out")
    elif volume.is_segmentation and volume.components > 1:
        text = f"{volume.name} is a segmentation in {volume.components} layers, and a picture is of one label for each"
        raise SuppleError(f"{text} voxel: let 3D Slicer export it as a label map, or collapse its layers")
    elif samples.ndim > 3 and not are_colours(samples):
        held = f"{samples.shape[3]} components of {samples.dtype}"
        text = f"{volume.name} has {held}, and pictures are of one value or of colours, RGB or RGBA in uint8, uint16 or"
        raise SuppleError(f"{text} floats from 0 to 1: take one component out of it")
    maps, grid = job.maps, grid_on(job.grid, volume.grid, volume.name, job.maps) if job.grid is not None else None
    geometry = volume.geometry if grid is None else grid.geometry("LPS")
    aim, shown_sizes = known.camera.target, volume.sizes if grid is None else grid.sizes
    if aim is not None and not all(-0.5 <= x <= n - 0.5 for x, n in zip(aim, shown_sizes, strict=True)):
        spoken, end = (", ".join(f"{x:g}" for x in given) for given in (aim, (n - 1 for n in shown_sizes)))
        text = f"{argument('target')} must be a voxel of {volume.name}, from (0, 0, 0) to ({end}), found ({spoken})"
        raise SuppleError(text)
    deformation = None
    if job.recipe.strokes or maps or grid is not None:
        deformation = deformation_of(job, volume)
    warped = bool(maps) or grid is not None
    if warped and known.mode != "buffered":
        raise SuppleError(f"with fields and affine maps, the volume is warped first: leave mode {known.mode} out")
    given = known.transfer if known.transfer is not None else default_transfer(volume)
    if known.projection != "none":
        given = "grey"  # projections show values alone
    transfer = given if isinstance(given, Transfer) else transfer_of(given)
    if isinstance(transfer, LabelColours):
        _check_labels(samples, transfer, volume.name)
    meshes = read_surfaces(known.meshes, volume, known.convention)
    has_air = samples.ndim == 3 and float(samples.min()) <= -800  # in Hounsfield units
    if isinstance(given, str) and given in HOUNSFIELD and has_air and not (known.table or known.largest):
        samples, apart = without_table(samples, volume.geometry.spacing)
        if apart > 0:
            text = (
                f"{100 * apart:.2g} % of what is as dense as skin in {volume.name} is thin and lies beside the body, as"
            )
            text = f"{text} a table or a head holder does, and is left out: {argument('table')} shows it"
            warn(text, VolumeWarning)
    if known.crop is not None or known.largest:
        transfer = fixed(samples, transfer)
    if known.crop is not None:
        samples = cropped(samples, known.crop, transfer, known.density)
    if known.largest:
        samples = largest(samples, transfer, known.density)
    if warped and deformation is not None:
        labels = isinstance(transfer, LabelColours)
        fill = 0.0 if samples.ndim > 3 else background_of(volume, labels=labels)
        mixed = "nearest" if labels else "linear"
        sampling = Sampling(filter=mixed, outside="constant", fill=fill)
        samples, certificate = warp_array(samples, deformation.space_on(grid, volume.grid), sampling)
        warn_of_maps(certificate, sampling.tolerance, deformation.maps)
        onto, own = grid or volume.grid, deformation.grid
        places = [deformation.forward(own.indices(volume.grid.positions(m.points))) for m in meshes]
        meshes = tuple(
            Surface(onto.indices(own.positions(p)), m.triangles, m.lines, m.colour)
            for m, p in zip(meshes, places, strict=True)
        )
        deformation = None
    shared = {name: getattr(known, name) for name in _OF_SCENE}
    shared["mode"] = "buffered" if known.mode == "hybrid" else known.mode
    return Scene(samples, geometry, deformation=deformation, transfer=transfer, meshes=meshes, **shared)


def _check_labels(samples: Array, transfer: LabelColours, name: str) -> None:
    """Raise SuppleError if a volume's values are not labels; warn of labels without a colour."""
    if samples.ndim != 3:
        raise SuppleError(f"{name} holds colours, and a label map has one number for each voxel: use another transfer")
    try:
        found = labels_in(samples)
    except SuppleError as error:
        raise SuppleError(f"{name}: {error}") from None
    missing = [str(k) for k in found.tolist() if transfer.colours is not None and k not in transfer.colours]
    if missing:
        told = f"{', '.join(missing[:8])}{' and others' if len(missing) > 8 else ''}"
        warn(f"labels of {name} without a colour are not seen: {told}", VolumeWarning)


def _saved(scene: Scene, path: PathLike, name: str) -> str:
    """Return the contents of a file for a scene's transfer function, in the format of the suffix."""
    suffix, transfer = Path(path).suffix.lower(), scene.transfer
    if isinstance(transfer, LabelColours) and scene.labels is not None:
        if suffix != _TABLE:
            raise SuppleError(f"{shown(path)}: the colours of {name} are those of labels: save them as {_TABLE}")
        return transfer.to_ctbl(scene.labels)
    if suffix == _TABLE or isinstance(transfer, LabelColours):
        text = f"{shown(path)}: {name} is no label map, and {_TABLE} has colours of labels: save .json or .vp"
        raise SuppleError(text)
    used = transfer if scene.density == (-math.inf, math.inf) else transfer.within(scene.density, *scene.range)
    return used.to_vp(*scene.range) if suffix == ".vp" else used.to_json()


def render_file(
    job: Job, options: RenderOptions | None = None, *, tell: Tell = lambda step, done, total: None
) -> Scene:
    """Render an image or a turntable of a volume file.

    Parameters
    ----------
    job : Job
        Of these: ``source``, a volume; ``target``, an image; or for a turntable a video (MP4, MOV, MKV, WebM, GIF), or
        a name with a number in it, such as ``%03d.png``; ``recipe``, ``maps`` and ``grid``, a reference alone, to warp
        the volume; ``volume``, ``fit``, ``force``. With maps, the volume is warped before it is rendered, by the CPU.
    options : RenderOptions, optional
    tell : function
        Called with ``"render"``, the finished and the total amount of work.

    Returns
    -------
    Scene

    Raises
    ------
    SuppleError
        If the source cannot be read, the target cannot be written (checked before any work if possible), or an argument
        does not fit.
    """
    known, source, target, force = options or RenderOptions(), job.source, job.target, job.force
    suffix = Path(target).suffix.lower()
    count = known.turntable or 0
    _check_target(target, suffix, known, force)
    if (saved := known.save_transfer) is not None:
        advice = f"use {', '.join(SUFFIXES)}, or {_TABLE} for labels"
        check_suffix(saved, Path(saved).suffix, (*SUFFIXES, _TABLE), "is none of a transfer function", advice)
        check_output(saved, force=force)
        if os.path.exists(saved):
            try:
                transfer_of(os.fspath(saved))
            except SuppleError:  # for instance a recipe
                told = f"{shown(saved)} is there, and no transfer function"
                raise SuppleError(f"{told}: it is not replaced; give another name") from None
    given = open_volume(source, job.volume)
    check_upright(given.geometry, given.name, "a rendering")
    scene = scene_of(given, job, known)
    if scene.is_empty:
        low, high = scene.range
        text = f"nothing is seen of {given.name}: its values go from {low:g} to {high:g}, and the transfer function,"
        raise SuppleError(f"{text} density and crop leave all of them out: choose others")
    if isinstance(known.transfer, str) and known.transfer in HOUNSFIELD and scene.range[0] >= 0:
        told = f"{known.transfer} is of Hounsfield units, where air is -1000 and water 0"
        low, high = scene.range
        text = f"{told}, and the values of {given.name} go from {low:g} to {high:g}: mr-head is of any units"
        warn(text, VolumeWarning)
    if known.legend and scene.labels is None:
        text = f"{argument('legend')} lists the labels of a segmentation, and {given.name} is rendered by its values"
        raise SuppleError(f"{text}: leave it out, or choose transfer labels")
    camera = scene.framed(known.camera, known.size)

    def marked(pixels: npt.NDArray[np.uint8], seen: Camera) -> npt.NDArray[np.uint8]:
        if not known.annotate and not known.legend:
            return pixels
        from supple.render.annotate import annotated, entries_of

        entries = []
        if known.legend and isinstance(scene.transfer, LabelColours) and scene.labels is not None:
            entries = entries_of(scene.transfer, scene.labels)
        view = scene.view(seen, known.size)
        return annotated(pixels, view, scene.geometry, legend=entries, marks=known.annotate)

    def pictures(opaque: bool) -> Iterator[Array]:
        behind = known.background or ((0.0, 0.0, 0.0) if opaque else None)
        for k in range(count):
            turned = scene.turned(camera, k, count)
            picture = scene.render(turned, known.size, supersampling=known.supersampling)
            if k == 0:
                _warn_of_view(picture, known, given.name)
            yield marked(picture.pixels(behind), turned)
            tell("render", k + 1, count)

    with contextlib.ExitStack() as stack:
        if known.save_transfer is not None:  # written together with the pictures
            place = stack.enter_context(replacing(known.save_transfer, force=force))
            place.write_text(_saved(scene, known.save_transfer, given.name), encoding="utf-8")
        if not count:
            advance: Callable[[int], None] = lambda rows: tell("render", rows, known.size[0])  # noqa: E731
            picture = scene.render(camera, known.size, supersampling=known.supersampling, tell=advance)
            _warn_of_view(picture, known, given.name)
            if known.what == "inversions":
                from supple.plot.draw import draw_inversions

                inverted = job.recipe.strokes and known.mode == "exact"
                draw_inversions(picture.samples, target, what="inversions" if inverted else "samples", force=force)
            else:
                behind = known.background if suffix in LIGHTLESS else known.background or (0.0, 0.0, 0.0)
                image.write(target, marked(picture.pixels(behind), camera), force=force)
        elif turntable.is_one(target):
            turntable.write_turntable(target, pictures(True), known.size, rate=known.rate or _RATE, force=force)
        else:
            path = Path(target)
            spell = spelling(path.name, os.fspath(target))
            check_outputs((path.parent / spell(k) for k in range(count)), force=force)
            with replacing_all(path.parent, force=force) as folder:
                for k, pixels in enumerate(pictures(suffix not in LIGHTLESS)):
                    image.write(folder / spell(k), pixels)
    return scene


def _warn_of_view(picture: Rendering, known: RenderOptions, name: str) -> None:
    """Warn if nothing is in view, or if the camera is inside an opaque part."""
    if not picture.light[..., 3].any():
        told = "what is cut away, or where the camera looks, leaves it out"
        warn(f"nothing is seen of {name}: {told}", VolumeWarning)
    elif known.projection == "none" and not picture.depth.any():
        told = "give another distance or target, or cut away what is before it by clip or plane"
        warn(f"the camera stands within what is visible of {name}: {told}", VolumeWarning)


def _check_target(target: PathLike, suffix: str, known: RenderOptions, force: bool) -> None:
    name, many = shown(target), known.turntable is not None
    if known.annotate or known.legend:
        from supple.render.annotate import check_annotated

        check_annotated(known.size)
    if many and turntable.is_one(target):
        turntable.check_turntable(target, known.size, known.rate or _RATE)
        check_output(target, force=force)
        return
    if many and not has_number(target):
        text = f"a turntable is many pictures, and {name} is one: name a video ({', '.join(turntable.SUFFIXES)})"
        raise SuppleError(f"{text} or a pattern, such as turn-%03d.png")
    if many and known.rate is not None:
        raise SuppleError(f"{argument('rate')} is of a video, and {name} names pictures: leave it out")
    if not many and has_number(target):
        text = f"{name} names many pictures: give {argument('turntable')} with their number, or a name without one"
        raise SuppleError(text)
    if not many and turntable.is_one(target) and suffix not in pictures.OUT:
        raise SuppleError(f"{name} is a video: give {argument('turntable')} with the number of its pictures")
    if known.what == "inversions":
        from supple.plot.frame import check_plot

        check_plot(target, force=force)
        return
    image.check_target(target)
    if not many:
        check_output(target, force=force)
