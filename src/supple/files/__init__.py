"""Files warped to files: images, clips and volumes."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from supple.arrays import check_device
from supple.engine.progress import counted
from supple.errors import SuppleError, argument, shown
from supple.fields import Placed
from supple.files.kinds import Kind, kind_of, refuse_places
from supple.files.options import ClipOptions, GridOptions, PathLike, VolumeOptions
from supple.media.files import check_output, same_file
from supple.space.domain import refuse
from supple.space.geometry import Grid
from supple.strokes import Fit, Recipe

if TYPE_CHECKING:
    from supple.files.clips import WarpedClip
    from supple.files.pictures import Warped
    from supple.files.volumes import WarpedVolume

# The module of a kind of file is loaded when such a file is warped: readers and their libraries take time.


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
        from supple.files.volumes import warp_volume

        with counted(progress, "slices", tell) as counts:
            return warp_volume(
                source, target, recipe, outside=outside, clamp=clamp is not False, options=volume, tell=counts,
                maps=maps, grid=grid, **shared,
            )  # fmt: skip
    shared |= {"outside": outside or "edge", "linear_light": linear_light, "quality": quality, "lossless": lossless}
    if kind == "clip":
        from supple.files.clips import warp_clip

        with counted(progress, also=tell) as counts:
            return warp_clip(source, target, recipe, options=clip, tell=counts, **shared)
    from supple.files.pictures import warp_picture_file

    return warp_picture_file(
        source, target, recipe, clamp=clamp, progress=progress, tell=tell, maps=maps, grid=grid, **shared
    )


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
) -> Kind:
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
    kind = kind_of(source, target, recipe, volume, maps=maps, grid=grid)
    if kind == "volume":
        from supple.files.volumes import check_volume_target

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
    if kind == "clip":
        from supple.files.clips import check_clip_target, refuse_maps

        if clamp is not None:
            raise SuppleError(
                f"{argument('clamp')} is for pictures and volumes, and {shown(source)} is a clip: leave it out"
            )
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
    from supple.files.pictures import check_picture_target

    check_picture_target(target, quality, lossless)
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
    kind = kind_of(source, target, recipe, volume, maps=maps, grid=grid)
    if kind == "volume":
        from supple.media.volume import outline_of

        known = volume or VolumeOptions()
        return outline_of(source, raw=known.layout, series=known.series).grid
    if kind == "clip":
        return None
    from supple.files.grids import picture_grid

    return picture_grid(source)


def _spare(source: PathLike, target: PathLike, kind: str, force: bool) -> None:
    """Raise SuppleError for a target that is the source, unless it may be replaced."""
    if not force and same_file(source, target):
        raise SuppleError(f"{shown(target)} is the {kind} itself: choose another name, or {argument('force', True)}")


def _asked(options: ClipOptions | VolumeOptions | None, usual: ClipOptions | VolumeOptions) -> str:
    """Return the command-line names of the options that are not at their defaults."""
    assert options is not None
    names = [each.name for each in dataclasses.fields(options)]
    return _named([name for name in names if getattr(options, name) != getattr(usual, name)])


def _named(names: Sequence[str]) -> str:
    options = ["--" + {"rate": "fps", "layout": "shape"}.get(name, name).replace("_", "-") for name in names]
    return f"{' and '.join(options)} {'are' if len(options) > 1 else 'is'}"
