"""Pictures warped from file to file."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from supple.arrays import warp_picture
from supple.deformation import Deformation, Report
from supple.engine.progress import staged
from supple.engine.sampling import Sampling, warn_of
from supple.errors import SuppleError, shown
from supple.fields import Placed, folds_of, only_name
from supple.files.grids import arrivals_on, grid_on
from supple.files.options import GridOptions, PathLike
from supple.folding.resolved import warn_of_still
from supple.media.files import replacing
from supple.media.image import Picture, check_quality, check_target, read, warn_of_exact, write
from supple.space.geometry import Grid
from supple.strokes import Fit, Recipe, fit_recipe

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


def warp_picture_file(
    source: PathLike,
    target: PathLike,
    recipe: Recipe,
    *,
    filter: str = "auto",
    tolerance: float = 0.01,
    outside: str = "edge",
    fill: float | Sequence[float] = 0.0,
    linear_light: bool = False,
    clamp: bool | None = None,
    quality: int | None = None,
    lossless: bool = False,
    device: str = "cpu",
    force: bool = False,
    progress: bool | Callable[[str], None] = False,
    tell: Callable[[str, int, int], None] | None = None,
    fit: Fit | None = None,
    maps: Sequence[Placed] = (),
    grid: GridOptions | None = None,
) -> Warped:
    """Warp an image, as in `supple.warp_file`."""
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
        sampling = Sampling(filter, tolerance, outside, fill, linear_light)
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


def check_picture_target(target: PathLike, quality: int | None, lossless: bool) -> None:
    """Raise SuppleError for an invalid target or option, before an image is read."""
    check_target(target)
    check_quality(target, quality)
    if lossless and Path(target).suffix.lower() in (".jpg", ".jpeg"):
        raise SuppleError(
            f"cannot write {shown(target)} without loss: JPEG always loses: write PNG, TIFF, WebP or AVIF"
        )


def _suffix(path: PathLike) -> str:
    suffix = Path(path).suffix.lower()
    return {".jpeg": ".jpg", ".tif": ".tiff"}.get(suffix, suffix)
