"""A warp from file to file: its parameters, the checks before any work, and the result."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from supple.arrays import check_device
from supple.deformation import Arrival, Deformation, Report
from supple.engine.progress import counted, staged
from supple.engine.sampling import DEFAULT, Sampling
from supple.engine.work import Tell, silent
from supple.errors import SuppleError, argument, shown
from supple.fields import Placed
from supple.files.options import ClipOptions, GridOptions, PathLike, Running, VolumeOptions
from supple.media.files import check_output, is_store, same_file
from supple.media.medium import Kind, Medium, opened
from supple.space.checks import integer, refuse
from supple.space.geometry import Geometry, Grid
from supple.strokes import Fit, Recipe

if TYPE_CHECKING:
    from supple.files.transforms import SavedField

# The modules that check and warp each kind of file; imported when needed, since readers take time to import.
_MODULES: dict[Kind, str] = {kind: f"supple.files.{kind}s" for kind in ("picture", "clip", "volume", "store")}
_SEEN: tuple[Kind, ...] = ("picture", "clip")
OPTIONS: dict[str, tuple[object, tuple[Kind, ...]]] = {
    "quality": (None, _SEEN),
    "lossless": (False, _SEEN),
    "compression": (None, _SEEN),
    "linear_light": (False, _SEEN),
    "clamp": (None, ("picture", "volume")),
    "clip": (ClipOptions(), ("clip",)),
    "volume": (VolumeOptions(), ("volume", "store")),
    "running": (Running(), ("store",)),
    "save_field": (None, ("picture", "volume", "store")),
}
"""Options that apply only to some kinds of files: their defaults, and these kinds."""


@dataclass(frozen=True, eq=False)
class Job:
    """A warp of a file to another one; parameters as in `supple.files.warp_file`.

    ``outside`` is the boundary mode of ``sampling`` if the caller gave one, and None otherwise.
    """

    source: PathLike
    target: PathLike
    recipe: Recipe = field(default_factory=Recipe)
    sampling: Sampling = DEFAULT
    outside: str | None = None
    clamp: bool | None = None
    quality: int | None = None
    lossless: bool = False
    device: str = "cpu"
    force: bool = False
    clip: ClipOptions = field(default_factory=ClipOptions)
    volume: VolumeOptions = field(default_factory=VolumeOptions)
    fit: Fit | None = None
    maps: Sequence[Placed] = ()
    grid: GridOptions | None = None
    compression: str | None = None
    running: Running = field(default_factory=Running)
    save_field: PathLike | None = None

    def __post_init__(self) -> None:
        recipe: object = self.recipe  # user input of any type
        if not isinstance(recipe, Recipe):
            refuse("recipe", "a Recipe (that of a Deformation d is d.recipe)", recipe)
        given: object = self.maps
        if not isinstance(given, Sequence) or not all(isinstance(each, Placed) for each in given):
            refuse("maps", "a sequence of Placed", given)
        if self.grid is not None and not isinstance(self.grid, GridOptions):
            refuse("grid", "GridOptions, or left out", self.grid)

    @property
    def linear_light(self) -> bool:
        """True if values are averaged in linear light."""
        return self.sampling.linear_light

    @cached_property
    def medium(self) -> Medium:
        """The source with its kind."""
        self.volume.check(self.source)
        axes = [*(each.ndim for each in self.recipe.strokes[:1]), *(each.map.ndim for each in self.maps[:1])]
        axes += [self.grid.ndim] if self.grid is not None and self.grid.ndim is not None else []
        shot = self.clip
        moves = self.recipe.moves or any(each.ndim == 3 for each in self.recipe.strokes[:1])
        moves |= shot.hold != 0 or shot.frame is not None or shot.frames is not None
        return opened(
            self.source,
            self.target,
            axes=max(axes, default=None),
            moves=moves,
            how=self.volume.how,
        )

    def check_options(self) -> None:
        """Raise SuppleError for options that the kind of file does not have."""
        medium = self.medium
        name = medium.name if medium.kind != "store" or is_store(self.source) else "the output"
        noun = "Zarr store" if medium.kind == "store" else medium.kind
        if medium.kind not in ("volume", "store"):
            refuse_places(self.recipe, self.source)
        for option, (usual, kinds) in OPTIONS.items():
            value = getattr(self, option)
            if medium.kind not in kinds and value != usual:
                where = " and ".join(f"{kind}s" for kind in kinds if kind != "store") or "Zarr stores"
                raise SuppleError(f"{asked(option, value)} is for {where}, and {name} is a {noun}: leave it out")
        if self.grid is not None and self.grid.strokes and medium.kind != "volume":
            raise SuppleError(f"{argument('fixed')} is for volumes, and {name} is a {noun}: leave it out")
        if medium.kind != "picture" and self.recipe.straighten is not None:
            raise SuppleError(f"straightening is for pictures, and {name} is a {noun}: leave it out")
        if medium.kind == "picture" and self.recipe.moves:
            moving = "strokes with keys move" if any(each.keys for each in self.recipe.strokes) else "the matte moves"
            raise SuppleError(
                f"{medium.name} is taken for a picture, and {moving} from frame to frame: give a clip, or what is of "
                "one frame"
            )

    def check(self) -> Medium:
        """Raise all errors that can be found before the source is read; return the source with its kind."""
        medium = self.medium
        self.check_options()
        if not self.force and same_file(self.source, self.target) and not Path(self.source).is_dir():
            name, instead = shown(self.target), argument("force", True)
            raise SuppleError(f"{name} is the {medium.kind} itself: choose another name, or {instead}")
        import_module(_MODULES[medium.kind]).check(self)
        if self.save_field is not None and medium.kind != "store":
            own = os.fspath(check_output(self.save_field, force=self.force))
            if own in map(os.path.realpath, (self.source, self.target)):
                what = f"cannot be the field and a {medium.kind} too"
                raise SuppleError(f"{shown(self.save_field)} {what}: give it another name")
        check_device(self.device, f"{medium.kind}s" if medium.kind in ("clip", "store") else "")
        return medium

    def warp(self, progress: bool | Callable[[str], None] = False, tell: Tell = silent) -> Warped:
        """Warp the file; parameters as in `supple.files.warp_file`."""
        kind = self.check().kind
        if kind == "picture" and not callable(progress):
            shows = staged(self.source, progress)
        else:
            shows = counted(progress, {"volume": "slices", "store": "blocks"}.get(kind, "frames"))
        with shows as show:

            def both(step: str, done: int, total: int) -> None:
                show(step, done, total)
                tell(step, done, total)

            made: Warped = import_module(_MODULES[kind]).warp(self, both)
        return made


def asked(name: str, value: object) -> str:
    """Return an option as the user writes it; of a group such as `ClipOptions`, the first that is not its default."""
    if not isinstance(value, ClipOptions | VolumeOptions | Running):
        return argument(name, value) if isinstance(value, bool) else argument(name)
    usual = type(value)()
    return argument(next(each.name for each in fields(value) if getattr(value, each.name) != getattr(usual, each.name)))


def refuse_places(recipe: Recipe, source: PathLike) -> None:
    """Raise SuppleError for a recipe in millimetres, unless it is for a volume."""
    if recipe.is_world:
        raise SuppleError(
            f"the recipe is in {recipe.space} millimetres, and {shown(source)} is no volume: give a recipe in pixels"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Warped:
    """The result of a warp from file to file.

    Parameters
    ----------
    source, target : pathlib.Path or str
        The input and the output file; for a store, their addresses.
    kind : str
        ``"picture"``, ``"clip"``, ``"volume"`` or ``"store"``.
    deformations : tuple of Deformation
        The strokes on the grid of the input, or on the upright grid around a sheared volume (`Grid.upright`). For a
        clip without strokes in time, on the grid of a frame; if strokes move from frame to frame, one for each frame.
    tolerance : float
        The largest distance of a source point from T⁻¹(q), in pixels, voxels and frames.
    error : float
        The error estimate from the checks of the map, in the same unit; `report` measures it.
    frames : int
        The number of frames of a clip, or of the volumes of a series.
    still, copied, held : int
        For a clip, the numbers of unchanged frames; of frames whose packets or files were copied instead of encoded
        again; and of frames in memory at once. For a store, ``copied`` blocks are those whose compressed chunks were.
    geometry : Geometry, optional
        The geometry of a volume.
    grid : Grid, optional
        The grid of the output, if it is not that of the input.
    own : Grid, optional
        The grid to which points of the input refer, if not the deformation's, such as an OpenEXR's display window.
    folded, outside, unsolved : int
        The numbers of solved points where a field folds; to which no point of a field's grid is mapped; and for which
        no solution was found.
    between : str
        The interpolation between frames; empty if no sample lies between frames.
    background : float, optional
        The scaled fill value outside a volume, if it was chosen automatically.
    shape : tuple of int
        The shape of a store along all axes; this and the next are of stores alone.
    levels, blocks, done : int
        The number of levels; of blocks of the finest one; and of those that an interrupted job had already written.
    labels : tuple of str
        The names of the label images that were warped with it.
    read, copied_bytes : int
        The decoded bytes that were read, without copies, where a chunk counts as often as it was read; and the
        compressed bytes of the copied chunks.
    field : SavedField, optional
        The map that was saved with it.
    """

    source: Path | str
    target: Path | str
    kind: Kind
    deformations: tuple[Deformation, ...]
    tolerance: float
    error: float = 0.0
    frames: int = 1
    still: int = 0
    copied: int = 0
    held: int = 0
    geometry: Geometry | None = None
    grid: Grid | None = None
    own: Grid | None = None
    folded: int = 0
    outside: int = 0
    unsolved: int = 0
    between: str = ""
    background: float | None = None
    shape: tuple[int, ...] = ()
    levels: int = 0
    labels: tuple[str, ...] = ()
    blocks: int = 0
    done: int = 0
    read: int = 0
    copied_bytes: int = 0
    field: SavedField | None = None

    @property
    def deformation(self) -> Deformation:
        """The first of `deformations`."""
        return self.deformations[0]

    @property
    def arrivals(self) -> tuple[Arrival, ...]:
        """For each stroke, the target of its point, and the position where it arrived, in samples of the input."""
        return arrivals_on(self.own, self.deformation.grid, self.deformation.arrivals)

    def report(self, frame: int = 0) -> Report:
        """Return the report on the strokes and the certified error, measured at every sample; this is slow.

        If strokes move from frame to frame, ``frame`` is the one that is measured.
        """
        most = len(self.deformations) - 1
        k = integer("frame", frame, f"from 0 to {most}", 0, most) if most else 0
        grid = self.own if self.grid is None and self.kind == "volume" else self.grid
        deformation = self.deformations[k]
        made = deformation.report(tolerance=self.tolerance, grid=grid)
        return replace(made, arrivals=arrivals_on(self.own, deformation.grid, made.arrivals))


def arrivals_on(own: Grid | None, grid: Grid, arrivals: tuple[Arrival, ...]) -> tuple[Arrival, ...]:
    """Return the arrivals of strokes on ``grid`` in samples of the input's grid ``own``, if that differs (not None)."""
    return arrivals if own is None else tuple(arrival.on(own, grid) for arrival in arrivals)
