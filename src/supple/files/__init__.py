"""Warping image, clip and volume files to files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from supple.engine.sampling import Sampling
from supple.engine.work import Tell, silent
from supple.fields import Placed
from supple.files.jobs import Job, Warped
from supple.files.options import ClipOptions, GridOptions, PathLike, Running, VolumeOptions
from supple.strokes import Fit, Recipe

__all__ = ["Job", "Warped", "warp_file"]


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
    compression: str | None = None,
    device: str = "cpu",
    force: bool = False,
    progress: bool | Callable[[str], None] = False,
    tell: Tell | None = None,
    clip: ClipOptions | None = None,
    volume: VolumeOptions | None = None,
    fit: Fit | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
    frames: tuple[int, int] | None = None,
    frame: int | None = None,
    hold: int | None = None,
    between: str | None = None,
    running: Running | None = None,
    save_field: PathLike | None = None,
) -> Warped:
    """Warp an image file, a video, an image sequence, a volume, or a Zarr store.

    An image keeps profile, EXIF, XMP and resolution; a video everything that its new container can hold; a volume its
    position in space, its scaling and, in the same format, its header. Colours are premultiplied for filtering. The
    target appears whole or not at all.

    A store keeps its format: chunks, shards, codecs, levels and metadata; a volume or a picture becomes an OME-Zarr
    image of version 0.5. It is written block by block, and after an interruption, the same call resumes the work. The
    result equals that of `Deformation.warp` on each channel, bit for bit. Label images in an OME-Zarr image, on its
    grid, are warped with it, and keep their labels.

    Parameters
    ----------
    source : str or os.PathLike
        An image (PNG, JPEG, TIFF, WebP, AVIF, GIF, OpenEXR, DPX, SGI, Radiance, JPEG 2000, BMP, TGA, PNM; HEIC, PSD
        and camera raw with the extra ``formats``); a video; a pattern such as ``frames/%05d.png``, or a folder of
        images; a volume in NIfTI, NRRD, MetaImage, a stack of TIFF pages, ``.dat``, or a folder of DICOM slices; a Zarr
        array or an OME-Zarr image, in a folder or at a URL of fsspec (``s3://``, ``gs://``, ``memory://``, ...). With
        two axes of space, a store is a picture, in pixels; with three, a volume, in millimetres if its axes have units.
        Other axes are carried along. If strokes have points of two numbers, each plane of a volume is a picture.
    target : str or os.PathLike
        The output; its suffix determines the format: one of those of images, except GIF; for clips, MP4, MOV, MKV,
        WebM, AVI, GIF, WebP or APNG, or a pattern or a folder for images; for volumes, NIfTI, NRRD, MetaImage or TIFF;
        for DICOM, also DICOM: a folder for slices, or a ``.dcm`` for a multi-frame file; for stores, volumes and
        pictures, ``.zarr``, or a URL: then uncompressed NIfTI and raw voxels are memory-mapped, tiles and strips of a
        TIFF are read when needed, and each process holds other volumes and pictures in memory.
    recipe : Recipe
        The strokes, the border and the fold policy. Strokes with a time, x, y and t in frames, warp the clip; strokes
        without one warp each frame alike, and each page of a TIFF; those with keys move from frame to frame. In
        volumes, points are voxels, x, y and z, and lengths millimetres.
    filter, tolerance, fill, linear_light
        As in `supple.Sampling`.
    outside : str, optional
        The boundary mode, as in `supple.Sampling`; by default ``"edge"``. For volumes on the grid of a reference, the
        default is ``"constant"``, with the fill value of `supple.files.volumes.background_of`.
    clamp : bool, optional
        Whether to clamp to the range of the source; by default, for volumes and images of floats.
    quality : int, optional
        From 1 to 100, for JPEG, WebP and AVIF; by default that of the source, from JPEG to JPEG.
    lossless : bool
        Whether to write without loss, in WebP and AVIF too; a video with FFV1 or the named codec.
    compression : str, optional
        The compression of lossless pictures, as in `supple.media.image.write`; ``"fast"`` is the fastest.
    device : str
        The device, as in `Deformation.warp`.
    force : bool
        Whether to replace an existing file, even the source.
    progress : bool or function
        Whether to show progress on a terminal; or a function, which is called before each stage with its name,
        ``"read"``, ``"warp"`` and ``"write"``. If it raises, no file is written. For a clip, ``"write"`` comes first,
        and then ``"plan"`` and ``"warp"`` for every frame; with strokes that move, ``"plan"`` comes first. For a store,
        they are ``"field"``, ``"plan"``, ``"warp"`` and ``"reduce"``.
    tell : function of (str, int, int), optional
        Called like ``progress``, but with the finished and the total number of frames, slices, blocks, or stages of an
        image.
    clip : ClipOptions, optional
        Options for clips.
    volume : VolumeOptions, optional
        Options for volumes.
    fit : str, optional
        The scaling of a recipe made for another size, as in `Recipe.fitted`: ``"pixels"``, ``"stretch"`` or
        ``"inside"``. By default, it is scaled if the proportions are the same; otherwise, it is an error.
    maps : sequence of Placed, optional
        Fields and affine maps before, between and after the strokes of the recipe, by their `Placed.after`: in
        millimetres in LPS for volumes, in pixels for pictures. Not for clips.
    grid : GridOptions, optional
        The grid of the output: that of another image, a part, or of another spacing. Not for clips.
    frames, frame, hold, between : optional
        As in `ClipOptions`, whose values they replace: the part of a clip that is bent, ``(first, last)``; the one
        frame that is written as a picture, for which only the frames that it needs are decoded; the number of frames at
        each end that keep every bit; and the interpolation between frames.
    running : Running, optional
        Where the blocks of a store are computed: by default, on threads of this process.
    save_field : str or os.PathLike, optional
        A file for the map from the output to its source points. Of a picture: an STMap (``.exr``, ``.tif``), or a map
        for ``cv2.remap`` (``.npy``, ``.npz``, ``.xml``, ``.yml``). Of a volume: the displacement field for SimpleITK,
        ANTs and 3D Slicer; if the output is a Zarr store, also an OME-Zarr (``.zarr``) with both directions.

    Returns
    -------
    Warped

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
    shot = {"frames": frames, "frame": frame, "hold": hold, "between": between}
    known = replace(clip or ClipOptions(), **{name: value for name, value in shot.items() if value is not None})  # type: ignore[arg-type]
    return Job(
        source, target, recipe, Sampling(filter, tolerance, outside or "edge", fill, linear_light), outside, clamp,
        quality, lossless, device, force, known, volume or VolumeOptions(), fit, maps, grid,
        compression, running or Running(), save_field,
    ).warp(progress, tell or silent)  # fmt: skip
