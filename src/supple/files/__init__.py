"""Files warped to files: images, clips and volumes."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from supple.arrays import check_device, warp_picture
from supple.deformation import Deformation, Report
from supple.engine.progress import counted, staged
from supple.engine.sampling import Sampling, warn_of
from supple.errors import SuppleError, shown
from supple.fields import Placed, folds_of, only_name
from supple.files.clips import SUFFIXES_OUT as CLIPS_OUT
from supple.files.clips import (
    ClipOptions,
    WarpedClip,
    check_clip_target,
    is_clip,
    refuse_maps,
    refuse_places,
    warp_clip,
)
from supple.files.grids import GridOptions, arrivals_on, grid_on, picture_grid
from supple.files.volumes import VolumeOptions, WarpedVolume, check_volume_target, is_volume_job, warp_volume
from supple.folding.resolved import warn_of_still
from supple.media.codecs import SUFFIXES as CLIPS
from supple.media.files import check_output, replacing, same_file
from supple.media.image import SUFFIXES as SUFFIXES_IN
from supple.media.image import Picture, check_quality, check_target, read, warn_of_exact, write
from supple.media.volume import SUFFIXES as VOLUMES
from supple.media.volume import SUFFIXES_OUT as VOLUMES_OUT
from supple.media.volume import grid_of as volume_grid
from supple.media.volume import suffix_of
from supple.space.domain import refuse
from supple.space.geometry import Grid
from supple.strokes import Fit, Recipe, fit_recipe

PathLike = str | os.PathLike[str]
_MEDIA = frozenset({*SUFFIXES_IN, *CLIPS, *CLIPS_OUT, *VOLUMES, *VOLUMES_OUT})
_PARTS = ("read", "warp", "write")


@dataclass(frozen=True, slots=True)
class Warped:
    """A file that was written.

    Parameters
    ----------
    source, target : pathlib.Path
        The input and the output file.
    deformation : Deformation
        The strokes, on the source's shape.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in pixels.
    grid : Grid, optional
        The grid of the output, if it is not that of the input.
    own : Grid, optional
        The grid of the input as it is shown, if it is not that of the deformation: an OpenEXR may have pixels beyond.
    folded, outside, unsolved : int
        The numbers of the points solved at which a field folds, to which no point of a field's grid is mapped, and for
        which no solution was found.
    """

    source: Path
    target: Path
    deformation: Deformation
    tolerance: float
    grid: Grid | None = None
    folded: int = 0
    outside: int = 0
    unsolved: int = 0
    own: Grid | None = None

    def report(self) -> Report:
        """Return the report on the strokes and the certified error of the map, which is solved again."""
        made = self.deformation.report(tolerance=self.tolerance, grid=self.grid)
        return replace(made, arrivals=arrivals_on(self.own, self.deformation.grid, made.arrivals))


def warp_file(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str | None = None,
    fill: float | Sequence[float] = 0.0,
    linear_light: bool = False,
    clamp: bool | None = None,
    quality: int | None = None,
    lossless: bool = False,
    device: str = "cpu",
    force: bool = False,
    progress: bool | Callable[[str], None] = False,
    tell: Callable[[str, int, int], None] | None = None,
    clip: ClipOptions | None = None,
    volume: VolumeOptions | None = None,
    fit: Fit | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Warped | WarpedClip | WarpedVolume:
    """Warp an image file, a video, an image sequence, or a volume.

    An image keeps profile, EXIF, XMP and resolution; a video all that its new container can hold; a volume its position
    in space, its scaling and, in the same format, its header. Opacity is filtered as opacity. The target appears whole,
    or not at all.

    Parameters
    ----------
    source : str or os.PathLike
        An image (PNG, JPEG, TIFF, WebP, AVIF, GIF, OpenEXR, DPX, SGI, Radiance, JPEG 2000, BMP, TGA, PNM); a video; a
        pattern such as ``frames/%05d.png``, or a folder of images; a volume in NIfTI, NRRD, MetaImage, a stack of TIFF
        pages, ``.dat``, or a folder of DICOM slices.
    target : str or os.PathLike
        The output; its suffix determines the format: one of those of images, except GIF; for clips, MP4, MOV, MKV,
        WebM, AVI or GIF, or a pattern or a folder for images; for volumes, NIfTI, NRRD, MetaImage or TIFF;
        for DICOM, also DICOM: a folder for slices, or a ``.dcm`` for a file of many frames.
    recipe : Recipe
        The strokes, the border and the fold policy. Strokes with a time, x, y and t in frames, warp the clip; strokes
        without one warp each frame alike, and each page of a TIFF; those with keys move from frame to frame. In
        volumes, points are voxels, x, y and z, and lengths millimetres.
    filter, tolerance, fill, linear_light
        As in `Deformation.warp`.
    outside : str, optional
        As in `Deformation.warp`; by default ``"edge"``. Of volumes on the grid of a reference, it is
        ``"constant"``, with what `supple.files.volumes.background_of` returns as the fill value.
    clamp : bool, optional
        Whether to clamp to the range of the source; by default, for volumes and images of floats.
    quality : int, optional
        From 1 to 100, for JPEG, WebP and AVIF.
    lossless : bool
        Whether to write without loss, in WebP and AVIF too; a video with FFV1 or the named codec.
    device : str
        The device, as in `Deformation.warp`.
    force : bool
        Whether an existing file may be replaced, even the source.
    progress : bool or function
        Whether to show progress on a terminal. Or a function, which is called before each stage with its name,
        ``"read"``, ``"warp"`` and ``"write"``: an exception in it ends the work without a file. For a clip, ``"write"``
        comes first, and then ``"plan"`` and ``"warp"`` for every frame; with strokes that move, ``"plan"`` comes first.
    tell : function of (str, int, int), optional
        Called like ``progress``, also with the finished and the total number of frames or slices; for an image, of
        stages.
    clip : ClipOptions, optional
        Options for clips.
    volume : VolumeOptions, optional
        Options for volumes.
    fit : str, optional
        The scaling of a recipe made for another size, as in `Recipe.fitted`: ``"pixels"``, ``"stretch"`` or
        ``"inside"``. By default, it is scaled if the proportions are the same, and refused otherwise.
    maps : sequence of Placed, optional
        Fields and affine maps before, between and after the strokes of the recipe, by their `Placed.after`: in
        millimetres in LPS for volumes, in pixels for pictures. Not for clips.
    grid : GridOptions, optional
        The grid of the output: that of another image, a part, or of another spacing. Not for clips.

    Returns
    -------
    Warped, WarpedClip or WarpedVolume

    Raises
    ------
    SuppleError
        If the source cannot be read, the target cannot be written (checked before any work if possible), or the recipe
        does not fit the image.

    Examples
    --------
    >>> recipe = Recipe(strokes=[Stroke.grab((256, 256), to=(256, 346), radius=100)])  # doctest: +SKIP
    >>> warp_file("photo.jpg", "bent.jpg", recipe).report().error  # doctest: +SKIP
    """
    kind = check_job(
        source,
        target,
        recipe,
        linear_light=linear_light,
        clamp=clamp,
        quality=quality,
        lossless=lossless,
        force=force,
        clip=clip,
        volume=volume,
        maps=maps,
        grid=grid,
    )
    check_device(device, "clips" if kind == "clip" else "")
    shared: dict[str, Any] = {"filter": filter, "tolerance": tolerance, "fill": fill, "fit": fit, "force": force}
    shared["device"] = device
    if kind == "volume":
        with counted(progress, "slices", tell) as counts:
            return warp_volume(
                source, target, recipe, outside=outside, clamp=clamp is not False, options=volume, tell=counts,
                maps=maps, grid=grid, **shared,
            )  # fmt: skip
    if kind == "clip":
        with counted(progress, also=tell) as counts:
            return warp_clip(
                source, target, recipe, outside=outside or "edge", linear_light=linear_light, quality=quality,
                lossless=lossless, options=clip, tell=counts, **shared,
            )  # fmt: skip
    with contextlib.nullcontext(progress) if callable(progress) else staged(source, progress) as show:

        def begin(part: str) -> None:
            show(part)
            if tell is not None:
                tell(part, _PARTS.index(part), len(_PARTS))

        begin("read")
        picture = read(source, pages=_suffix(target) == ".tiff", whole=_suffix(target) == ".exr")
        begin("warp")
        layers = picture.layers
        height, width = len(picture.pixels) // picture.pages, picture.pixels.shape[1]
        own = Grid((height, width) if layers is None else layers.shown)
        fitted = fit_recipe(recipe, own.sizes, fit, shown(source))
        regrid = grid_on(grid, own, shown(source), maps)
        held = own
        if layers is not None and layers.box != layers.display:  # points count from the display window's first pixel
            held = Grid((height, width), origin=layers.corner)
            fitted = fitted.placed([-x for x in layers.corner], held.sizes)
        deformation = Deformation.from_recipe(fitted, held, maps=maps, warn=False)
        warn_of_still(recipe.strokes)
        space = replace(deformation.space_on(regrid), count=picture.pages)
        if space.is_identity and quality is None and not lossless and _suffix(source) == _suffix(target):
            # Encoding a lossy image again would change it.
            begin("write")
            with replacing(target, force=force) as place:
                shutil.copyfile(source, place)
            return Warped(Path(source), Path(target), deformation, tolerance)
        sampling = Sampling.checked(
            2, filter=filter, tolerance=tolerance, outside=outside or "edge", fill=fill, linear_light=linear_light
        )
        bounded = picture.pixels.dtype.kind == "f" if clamp is None else clamp
        nearest, groups = replace(sampling, filter="nearest"), () if layers is None else layers.groups
        options: dict[str, Any] = {"clamp": bounded, "device": device, "name": shown(source)}
        exact = nearest if groups and groups[0][0] else sampling
        picture, found = warp_picture(picture, space, exact, regridded=regrid is not None, **options)
        if layers is not None:  # of the others, what is outside is 0
            others = [replace(nearest if exact else sampling, fill=0.0) for exact, _ in groups[1:]]
            pairs = zip(layers.arrays[1:], others, strict=True)
            arrays = [warp_picture(Picture(a), space, how, regridded=False, **options)[0].pixels for a, how in pairs]
            layers = layers if regrid is None else layers.sized(picture.pixels.shape[:2])
            layers = replace(layers, arrays=(picture.pixels, *arrays))
            picture = replace(picture, _header={**picture._header, "exr": layers})
            warn_of_exact(layers)
        warn_of(found, tolerance, 3, folds_of(maps), only_name(maps))
        begin("write")
        write(target, picture.pixels, like=picture, quality=quality, lossless=lossless, force=force)
    points = found.folded, found.outside, found.unknown
    return Warped(Path(source), Path(target), deformation, tolerance, regrid, *points, None if held == own else own)


def check_job(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    *,
    linear_light: bool = False,
    clamp: bool | None = None,
    quality: int | None = None,
    lossless: bool = False,
    force: bool = False,
    clip: ClipOptions | None = None,
    volume: VolumeOptions | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Literal["picture", "clip", "volume"]:
    """Return the kind of a file to warp; raise all errors that can be found before it is read.

    Parameters
    ----------
    source, target, recipe, linear_light, clamp, quality, lossless, force, clip, volume, maps, grid
        As in `warp_file`.

    Returns
    -------
    str
        ``"picture"``, ``"clip"`` or ``"volume"``.

    Raises
    ------
    SuppleError
        If that kind cannot be written under the target's suffix, or in its folder; or if an option is for another kind.
    """
    given: object = maps  # user input of any type
    if not isinstance(given, Sequence) or not all(isinstance(each, Placed) for each in given):
        refuse("maps", "a sequence of Placed", maps)
    if grid is not None and not isinstance(grid, GridOptions):
        refuse("grid", "GridOptions, or left out", grid)
    if is_volume_job(source, target, recipe, volume, maps=maps, grid=grid):
        if quality is not None or lossless or linear_light or clip not in (None, ClipOptions()):
            flags = {"quality": quality is not None, "lossless": lossless, "linear_light": linear_light}
            given = [name for name, asked in flags.items() if asked]
            asked = _named(given) if given else _asked(clip, ClipOptions())
            raise SuppleError(f"{shown(source)} is a volume, and {asked} for pictures or videos: leave that out")
        if not os.path.isdir(target):  # which is not replaced
            _spare(source, target, "volume", force)
        check_volume_target(source, target, volume or VolumeOptions(), force=force)
        return "volume"
    refuse_places(recipe, source)
    if volume is not None and volume != VolumeOptions():
        asked = _asked(volume, VolumeOptions())
        raise SuppleError(f"{shown(source)} is no volume, and {asked} for volumes: leave that out")
    if is_clip(source, target, recipe):
        if clamp is not None:
            raise SuppleError(f"clamp is for pictures and volumes, and {shown(source)} is a clip: leave it out")
        if maps or grid not in (None, GridOptions()):
            refuse_maps(source)
        _spare(source, target, "clip", force)
        check_clip_target(source, target, clip or ClipOptions(), quality=quality, force=force)
        return "clip"
    if recipe.moves:
        raise SuppleError(
            f"{shown(source)} is taken for a picture, and strokes with keys move from frame to frame: give a clip, or "
            "the recipe of one frame"
        )
    if clip not in (None, ClipOptions()):
        raise SuppleError(
            f"{shown(source)} is taken for a picture, and {_asked(clip, ClipOptions())} for clips: leave that out"
        )
    check_target(target)
    _check_options(target, quality, lossless)
    _spare(source, target, "picture", force)
    check_output(target, force=force)
    return "picture"


def grid_of(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    *,
    volume: VolumeOptions | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Grid | None:
    """Return the grid of a file that `warp_file` would warp with these arguments; None of a clip.

    Raises
    ------
    SuppleError
        If the file cannot be read.
    """
    if is_volume_job(source, target, recipe, volume, maps=maps, grid=grid):
        known = volume or VolumeOptions()
        return volume_grid(source, raw=known.layout, series=known.series)
    return None if is_clip(source, target, recipe) else picture_grid(source)


def _spare(source: PathLike, target: PathLike, kind: str, force: bool) -> None:
    """Raise SuppleError for a target that is the source, unless it may be replaced."""
    if not force and same_file(source, target):
        raise SuppleError(f"{shown(target)} is the {kind} itself: pass --force (force=True) to replace it")


def _asked(options: ClipOptions | VolumeOptions | None, usual: ClipOptions | VolumeOptions) -> str:
    """Return the command-line names of the options that are not at their defaults."""
    assert options is not None
    names = [each.name for each in dataclasses.fields(options)]
    return _named([name for name in names if getattr(options, name) != getattr(usual, name)])


def _named(names: Sequence[str]) -> str:
    options = ["--" + {"rate": "fps", "layout": "shape"}.get(name, name).replace("_", "-") for name in names]
    return f"{' and '.join(options)} {'are' if len(options) > 1 else 'is'}"


def _suffix(path: PathLike) -> str:
    suffix = Path(path).suffix.lower()
    return {".jpeg": ".jpg", ".tif": ".tiff"}.get(suffix, suffix)


def is_media_name(path: PathLike) -> bool:
    """Return whether a name has the suffix of an image, a video or a volume; with a trailing slash, it is a folder."""
    return not os.fspath(path).endswith(("/", os.sep)) and suffix_of(path) in _MEDIA


def read_recipe(path: PathLike) -> Recipe:
    """Read a recipe from a JSON file.

    Raises
    ------
    SuppleError
        If the file cannot be read, or is not a recipe; the message names the file and the fault.
    """
    name = shown(path)
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise SuppleError(f"cannot read {name}: {error.strerror}: give a recipe in JSON") from error
    except UnicodeDecodeError as error:
        raise SuppleError(f"cannot read {name}: it is no text: give a recipe in JSON") from error
    except ValueError as error:
        raise SuppleError(f"cannot read {name}: no file can have that name: check it") from error
    try:
        return Recipe.from_json(text)
    except SuppleError as error:
        raise SuppleError(f"{name}: {str(error).replace('None', 'null')}") from None


def check_recipe_name(path: PathLike, *, force: bool = False) -> None:
    """Raise SuppleError for a file name that is not fit for a recipe.

    Raises
    ------
    SuppleError
        If it has the suffix of an image, a video or a volume, exists and `force` is false, or cannot be written.
    """
    if is_media_name(path):
        name, suffix = shown(path), suffix_of(path)
        stem = name[: len(name) - len(suffix)]
        raise SuppleError(f"cannot write {name}: a recipe is JSON, and none is written as {suffix}: use {stem}.json")
    check_output(path, force=force)


def write_recipe(path: PathLike, recipe: Recipe, *, force: bool = False) -> None:
    """Write a recipe as JSON; the file appears whole or not at all.

    Raises
    ------
    SuppleError
        As in `check_recipe_name`.
    """
    check_recipe_name(path, force=force)
    with replacing(path, force=force) as temporary:
        temporary.write_text(recipe.to_json(), encoding="utf-8")


def _check_options(target: PathLike, quality: int | None, lossless: bool) -> None:
    name = shown(target)
    check_quality(target, quality)
    if lossless and Path(target).suffix.lower() in (".jpg", ".jpeg"):
        raise SuppleError(f"cannot write {name} without loss: JPEG always loses: write PNG, TIFF, WebP or AVIF")
