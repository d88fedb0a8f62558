"""Warping pictures from file to file, and writing their maps."""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from supple.arrays import warp_picture
from supple.deformation import Deformation
from supple.engine.core import inverse_map
from supple.engine.work import Space, Tell
from supple.errors import SuppleError, argument, shown, warn
from supple.fields import warn_of_maps
from supple.files.grids import check_straightened, grid_on
from supple.files.jobs import Job, Warped
from supple.files.options import PathLike
from supple.folding.resolved import warn_of_still
from supple.media.files import check_output, replacing
from supple.media.image import (
    ImageWarning,
    Picture,
    check_options,
    check_target,
    read,
    warn_of_exact,
    with_opacity,
    write,
)
from supple.media.pictures import OUT
from supple.space.geometry import Grid
from supple.strokes import fit_recipe

# Conventions of maps are imported only where one is written, to keep the command fast.


def check(job: Job) -> None:
    """Raise SuppleError for an invalid target or option, before an image is read."""
    check_target(job.target)
    check_options(job.target, quality=job.quality, lossless=job.lossless, compression=job.compression)
    check_output(job.target, force=job.force)
    if job.save_field is not None:
        _convention(job.save_field)


def warp(job: Job, tell: Tell) -> Warped:
    """Warp an image, as in `supple.warp_file`."""
    with contextlib.ExitStack() as stack:  # the map is renamed together with the image
        place = None if job.save_field is None else stack.enter_context(replacing(job.save_field, force=job.force))
        return _warp(job, tell, place)


def _warp(job: Job, tell: Tell, place: PathLike | None) -> Warped:
    source, target, maps, name, sampling = job.source, job.target, job.maps, job.medium.name, job.sampling
    tell("read", 0, 3)
    picture = read(source, pages=_format(target) == "TIFF", whole=_format(target) == "OpenEXR")
    tell("warp", 1, 3)
    layers = picture.layers
    height, width = len(picture.pixels) // picture.pages, picture.pixels.shape[1]
    own = held = Grid((height, width) if layers is None else layers.shown)
    fitted = fit_recipe(job.recipe, own.sizes, job.fit, name)
    straighten, fitted = fitted.straighten, replace(fitted, straighten=None)
    if layers is not None and layers.box != layers.display:  # points are relative to the display window
        held = Grid((height, width), origin=layers.corner)
        fitted = fitted.placed([-x for x in layers.corner], held.sizes)
    deformation = Deformation.from_recipe(fitted, held, maps=maps, warn=False)
    result = own
    if straighten is not None:
        check_straightened(job.grid)
        deformation = deformation.straighten(straighten, sizes=own.sizes)
        result = deformation.output
    regrid = grid_on(job.grid, result, name, maps) or (None if result == own else result)
    warn_of_still(job.recipe.strokes)
    made = Warped(Path(source), Path(target), "picture", (deformation,), sampling.tolerance)
    space = replace(deformation.space_on(regrid), count=picture.pages)
    if place is not None:
        _write_map(place, deformation.space_on(regrid or (None if held == own else own)), held, own, sampling.tolerance)
    encoded = job.quality is not None or job.lossless or job.compression is not None
    if space.is_identity and not encoded and _format(source) == _format(target):
        # Encoding a lossy image again would change it.
        tell("write", 2, 3)
        with replacing(target, force=job.force) as place:
            shutil.copyfile(source, place)
        return made
    if straighten is not None and straighten.has_gaps and job.outside is None:
        sampling = replace(sampling, outside="constant")
        picture = with_opacity(picture, target)
        if not picture.alpha:
            what = "holds no opacity, and the empty corners are black"
            warn(f"{shown(target)} {what}: {argument('fill')} names a colour", ImageWarning)
    bounded = picture.pixels.dtype.kind == "f" if job.clamp is None else job.clamp
    options: dict[str, Any] = {"clamp": bounded, "device": job.device, "name": name}
    groups = ((False, ()),) if layers is None else layers.groups
    own_how, *others = (replace(sampling, filter="nearest") if exact else sampling for exact, _ in groups)
    picture, found = warp_picture(picture, space, own_how, regridded=regrid is not None, **options)
    if layers is not None:
        arrays = [picture.pixels]
        for array, how in zip(layers.arrays[1:], others, strict=True):  # with the fill value 0
            how = replace(how, fill=0.0)
            arrays.append(warp_picture(Picture(array), space, how, regridded=False, **options)[0].pixels)
        layers = layers if regrid is None else layers.sized(picture.pixels.shape[:2])
        layers = replace(layers, arrays=tuple(arrays))
        picture = replace(picture, _header={**picture._header, "exr": layers})
        warn_of_exact(layers)
    warn_of_maps(found, sampling.tolerance, maps)
    tell("write", 2, 3)
    write(target, picture, quality=job.quality, lossless=job.lossless, compression=job.compression, force=job.force)
    return replace(
        made, error=found.error, grid=regrid, own=None if held == own else own, folded=found.folded,
        outside=found.outside, unsolved=found.unknown,
    )  # fmt: skip


def _convention(path: PathLike) -> str:
    """Return the convention of a map to write, from its suffix."""
    from supple.media.transforms.pictures import REMAP, STMAP_OUT

    suffix = Path(path).suffix.lower()
    if found := [name for name, suffixes in {"stmap": STMAP_OUT, "opencv": REMAP}.items() if suffix in suffixes]:
        return found[0]
    raise SuppleError(
        f"{shown(path)} is no map of a picture: name an STMap ({', '.join(STMAP_OUT)}), or a map for cv2.remap "
        f"({', '.join(REMAP)})"
    )


def _write_map(place: PathLike, space: Space, held: Grid, own: Grid, tolerance: float) -> None:
    """Write the source position of each pixel of the output, or of an EXR's display window, in pixels of ``own``."""
    from supple.media import transforms
    from supple.media.transforms.pictures import displacements

    points, _ = inverse_map(space, tolerance, np.float64)
    points += held.origin
    made = displacements(place, points[..., 0], points[..., 1])
    transforms.write(place, [made], _convention(place), source=own, force=True)


def _format(path: PathLike) -> str:
    """Return the name of the image format of a file name's suffix."""
    known = OUT.get(Path(path).suffix.lower())
    return known.name if known is not None else ""
