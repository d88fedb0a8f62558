"""Options of fields, affine maps and output grids, in the order in which they are given."""

import itertools
import os
import re
import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from supple.cli.options import COORDINATES
from supple.errors import OutsideWarning, SuppleError, shown

if TYPE_CHECKING:
    from supple.cli.console import Console
    from supple.cli.options_strokes import StrokeOptions
    from supple.fields import Placed
    from supple.files.jobs import Job
    from supple.files.options import GridOptions
    from supple.space.affine import Affine
    from supple.space.geometry import Grid
    from supple.strokes import Recipe

PathLike = str | os.PathLike[str]

MAPS = Group("Fields and affine maps", sort_key=1.3)
OUTPUT = Group("Output grid", sort_key=1.6)

Reference = Annotated[str | None, Parameter(group=MAPS, metavar="FILE")]

OTHERS = "--field FILE, --affine FILE, --crop BOX, --resample S, --reference FILE or "
"""What `supple warp` does without strokes."""

_ON_PIXELS = ("opencv", "stmap")
_AFFINE = "6 numbers (pictures) or 12 (volumes), the rows of its matrix, or a file"
_NUMBERS = re.compile(r"[-+\d.eE,\s]*\d[-+\d.eE,\s]*")


@Parameter(name="*")
@dataclass(kw_only=True, eq=False, repr=False)
class MapOptions:
    """Options of maps that are no strokes.

    Parameters
    ----------
    field
        Apply a displacement field, or all maps of a file, after the strokes, --field and --affine before it. As
        resampling programs take it: from a point of the output to the point of the input that is seen there.
    affine
        Apply an affine map, in the same order and direction: a file, or the rows of its matrix: 6 numbers in pixels
        for pictures, 12 in millimetres (LPS) for volumes.
    inverse
        Apply the inverse of the --field or --affine before it. In supple points, before these or without them: move
        points back, from the output to the input.
    convention
        The convention of the file of the --field or --affine before it: itk, fsl-relative, … (default: the one that
        the file shows). Of tables of points, and of meshes, that do not name theirs: LPS or RAS in millimetres, or
        index, which is voxels; in supple warp, of those of the --pull before it.
    """

    field: Annotated[list[str], Parameter(group=MAPS, metavar="FILE", show_default=False)] = ()  # type: ignore[assignment]
    affine: Annotated[
        list[str], Parameter(group=MAPS, metavar="FILE|NUMBERS", show_default=False, allow_leading_hyphen=True)
    ] = ()  # type: ignore[assignment]
    inverse: Annotated[int, Parameter(group=MAPS, count=True, show_default=False)] = 0
    convention: Annotated[list[str], Parameter(group=MAPS, metavar="NAME", show_default=False)] = ()  # type: ignore[assignment]

    @property
    def any(self) -> bool:
        """Return whether there is a map."""
        return bool(self.field or self.affine)

    @property
    def dangling(self) -> bool:
        """Return whether there is something said of maps, but no map."""
        return bool(self.inverse or self.convention) and not self.any

    @property
    def conventions(self) -> dict[str, list[str]]:
        """The values of --convention, and of the options here that one may be about."""
        return {"--field": self.field, "--affine": self.affine, "--convention": self.convention}

    @property
    def coordinates(self) -> str | None:
        """The coordinates of all points that do not name theirs, where --convention may say these: LPS, RAS, index."""
        found = {COORDINATES[name.lower()] for name in self.convention if name.lower() in COORDINATES}
        if len(found) > 1:
            raise SuppleError(f"--convention of points is given as {' and '.join(sorted(found))}: leave one out")
        return found.pop() if found else None

    def to_maps(
        self,
        arguments: Sequence[str],
        recipe: "Recipe | None",
        strokes: "StrokeOptions",
        output: "OutputOptions | None" = None,
        *,
        reference: str | None = None,
        points: bool = False,
    ) -> "Maps":
        """Return the maps among the strokes of a command line.

        ``recipe`` has the ``strokes`` of the command line after those of its file. ``output`` is the grid of the
        output, of a command that writes on another one than the input's; ``reference`` is the image on whose grid
        others show what they do. With ``points``, --inverse before all maps is about points, which are then moved back.
        """
        from supple.cli.options_strokes import in_order

        given = strokes.given
        found = in_order(arguments, {**self.conventions, **given})
        sizes = strokes.parts(arguments)
        parts = iter(sizes)
        first = 0 if recipe is None else len(recipe.strokes) - sum(sizes)
        entries: list[_Entry] = []
        before, seen, pull, back = 0, False, False, False
        for option, value in found:
            if option == "--freeze" and not seen:
                before += next(parts)  # before all strokes, of which it is none
                continue
            pull = option == "--pull" or (pull and option not in ("--field", "--affine"))
            if option == "--recipe" or (option in given and not seen):
                before, seen = before + first * (not seen), True
            if option in given:
                before += next(parts)
            elif option in ("--field", "--affine"):
                entries.append(_Entry(option, value, before))
            elif option == "--convention" and (pull if output is not None else value.lower() in COORDINATES):
                continue  # of the points
            elif option == "--inverse" and points and not entries:
                back = True
            elif option == "--convention" and output is None and not entries:
                raise SuppleError(f"--convention of points must be LPS, RAS or index, found {value!r}")
            elif option in ("--inverse", "--convention") and not entries:
                what = "--field, --affine or --pull" if option == "--convention" else "--field or --affine"
                raise SuppleError(f"{option} is for the {what} before it, and there is none: give one")
            elif option == "--inverse":
                if entries[-1].inverse:
                    raise SuppleError(f"{entries[-1].told} has two --inverse: leave out one, or both")
                entries[-1].inverse = True
            elif option == "--convention":
                if entries[-1].convention is not None:
                    raise SuppleError(f"{entries[-1].told} has two --convention: leave out one")
                entries[-1].convention = value
        for entry in entries:
            if entry.convention is not None and entry.is_numbers:
                raise SuppleError(f"--convention is for files, and {entry.told} is none: leave it out")
        return Maps(entries, reference if output is None else output.onto, back=back)


@Parameter(name="*")
@dataclass(kw_only=True, eq=False, repr=False)
class OutputOptions:
    """Options of the grid of the output.

    Parameters
    ----------
    reference
        Write the result on the grid of another image: of a volume, its place in space; of a picture, its size.
    fixed
        Like --reference, and the strokes are on that grid, too: as supple view --fixed saves them.
    crop
        Write only a part of the grid: its first sample, and its size. It equals that part of the whole, bit for bit.
    resample
        Write the result with another spacing: in millimetres, for pictures in pixels of the input. It comes after
        --reference, and before --crop.
    """

    reference: Annotated[str | None, Parameter(group=OUTPUT, metavar="FILE")] = None
    fixed: Annotated[str | None, Parameter(group=OUTPUT, metavar="FILE")] = None
    crop: Annotated[str | None, Parameter(group=OUTPUT, metavar="X,Y,W,H|X,Y,Z,W,H,D", allow_leading_hyphen=True)] = (
        None
    )
    resample: Annotated[str | None, Parameter(group=OUTPUT, metavar="S|SX,SY[,SZ]", allow_leading_hyphen=True)] = None

    @property
    def onto(self) -> str | None:
        """The image whose grid it is."""
        if self.fixed is not None and self.reference is not None:
            raise SuppleError("--fixed and --reference name the same grid: leave --reference out")
        return self.fixed or self.reference

    def to_grid(self) -> "GridOptions | None":
        """Return the grid of the output as the library takes it."""
        from supple.cli.options import parse_integer, parse_number
        from supple.files.options import GridOptions

        if self.onto is None and self.crop is None and self.resample is None:
            return None
        box = steps = None
        if self.crop is not None:
            wanted = "X,Y,W,H for a picture, or X,Y,Z,W,H,D for a volume"
            box = [parse_integer("--crop", part, wanted) for part in self.crop.split(",")]
        if self.resample is not None:
            wanted = "a spacing S, or one for each axis, SX,SY or SX,SY,SZ"
            steps = [parse_number("--resample", part, wanted) for part in self.resample.split(",")]
        spacing = steps if steps is None or len(steps) > 1 else steps[0]
        return GridOptions(self.onto, box, spacing, strokes=self.fixed is not None)


@dataclass(slots=True)
class _Entry:
    """A --field or an --affine, and what is said of it."""

    option: str
    text: str
    after: int
    inverse: bool = False
    convention: str | None = None

    @property
    def is_numbers(self) -> bool:
        return self.option == "--affine" and _NUMBERS.fullmatch(self.text) is not None

    @property
    def told(self) -> str:
        return f"{self.option} {self.text}" if self.is_numbers else f"{self.option} {shown(self.text)}"

    def read(self, here: "Grid | None", there: "Grid | None", *, last: bool) -> "tuple[list[Placed], str | None]":
        """Return the maps in the order of the elements of a deformation, and the convention of the file.

        Of these elements, the last is the first of the output's. ``here`` is the grid of the image that a point of the
        output is led to, and ``there`` that of the image that it comes from, as far as they are known: they are if this
        is the first entry, or the ``last``, whose other image --reference may name.
        """
        from supple import fields
        from supple.files import maps
        from supple.media.transforms import MissingGridError

        if self.is_numbers:
            return [fields.Placed(self._affine(), self.inverse, self.after, name=self.told)], None
        if self.option == "--affine" and "," in self.text and not os.path.exists(self.text):
            raise SuppleError(f"--affine must be {_AFFINE}, found {self.text!r}")
        source, reference = (there, here) if self.inverse else (here, there)
        try:
            file = maps.read_file(self.text, self.convention, source=source, reference=reference)
        except MissingGridError as error:
            known = here is not None and last
            advice = "give it by --reference" if known else "convert it by itself first (supple convert)"
            raise SuppleError(f"{str(error).rpartition(': ')[0]}: {advice}") from None
        found = file.maps
        if self.option == "--affine" and any(isinstance(each, fields.Field) for each in found):
            raise SuppleError(f"{shown(self.text)} holds a field, and --affine is for affine maps: give it by --field")
        placed = [fields.Placed(each, self.inverse, self.after, name=shown(self.text)) for each in found]
        return placed if self.inverse else placed[::-1], file.convention

    def _affine(self) -> "Affine":
        from supple.space.affine import Affine

        try:
            numbers = [float(part) for part in self.text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (6, 12):
            raise SuppleError(f"--affine must be {_AFFINE}, found {self.text!r}")
        width = 3 if len(numbers) == 6 else 4
        try:
            return Affine([numbers[k : k + width] for k in range(0, len(numbers), width)])
        except SuppleError as error:
            raise SuppleError(f"{self.told}: {error}") from None


class Maps:
    """The maps among the strokes of a command, read when the grid of an input is known.

    Of several inputs on one grid, files are read once.
    """

    def __init__(self, entries: Sequence[_Entry], reference: str | None = None, *, back: bool = False) -> None:
        self._entries = list(entries)
        self.reference = reference
        self.back = back
        self._lock = threading.Lock()
        self._known: tuple[Grid | None, list[tuple[list[Placed], str | None]]] | None = None

    def __bool__(self) -> bool:
        return bool(self._entries)

    def output(self, source: "Grid") -> "Grid":
        """Return the grid of the output, of an input on ``source``: that of the reference, or the same."""
        from supple.files.grids import reference_grid

        return source if self.reference is None else reference_grid(self.reference, source.ndim)

    @property
    def ndim(self) -> int | None:
        """The number of axes, as far as the command line alone tells it."""
        counts = [3 if entry.text.count(",") == 11 else 2 for entry in self._entries if entry.is_numbers]
        return counts[0] if counts else None

    def read(self, source: "Grid | None") -> "tuple[Placed, ...]":
        """Return the maps for an input on this grid, in the order in which they apply."""
        if not self._entries:
            return ()
        return tuple(placed for some, _ in self._read(source) for placed in some)

    def _read(self, source: "Grid | None") -> "list[tuple[list[Placed], str | None]]":
        from supple.files import maps

        with self._lock:
            if self._known is None or self._known[0] != source:
                fixed, refused = None, None
                try:
                    if self.reference is not None and source is not None:
                        fixed = self.output(source)
                except SuppleError as error:
                    refused = error  # unless it is not needed: pages become a volume by what the maps are
                most = len(self._entries) - 1
                ends = [(source if k == 0 else None, fixed if k == most else None) for k in range(most + 1)]
                try:
                    read = [
                        entry.read(*known, last=k == most)
                        for k, (entry, known) in enumerate(zip(self._entries, ends, strict=True))
                    ]
                except SuppleError:
                    if refused is not None:
                        raise refused from None
                    raise
                self._known = source, [(maps.lifted(some, form, source), form) for some, form in read]
            return self._known[1]

    def placed(self, console: "Console", job: "Job") -> "Job":
        """Return a job with the maps, on the grid of its file; tell of each."""
        from supple.files.clips import refuse_maps

        if not self._entries:
            return job
        own = job.medium.grid
        if own is not None and any(each.map.ndim != own.ndim for each in self.read(own)):
            job = replace(job, maps=self.read(own))  # by which pages may become a volume
            own = job.medium.grid
        if own is None:
            refuse_maps(job.source)
        return replace(job, maps=self.on(console, own, job.medium.name, job.grid))

    def on(
        self, console: "Console", source: "Grid", name: str, grid: "GridOptions | None" = None
    ) -> "tuple[Placed, ...]":
        """Return the maps for an input on this grid, and tell of each; refuse what does not fit it."""
        from supple.files.grids import grid_on

        maps = self.read(source)
        grid_on(grid, source, name, maps)
        self.check_sizes(source, name)
        for facts in self.facts(source):
            console.note(describe_map(facts))
        return maps

    def check_sizes(self, source: "Grid", name: str) -> None:
        """Refuse maps that have a value for each pixel of a picture, and are not of its size.

        Each map leads from one picture to the next, from the input to the output, and has the size of the one after it,
        or, if it is inverted, of the one before it. Only the first and the last are known: of another one, a warning is
        given unless it is of a size that occurs.
        """
        from supple.fields import Field

        if source.ndim != 2:
            return
        output = self.output(source)
        ends = {0: (source, name), len(self._entries): (output, shown(self.reference or name))}
        within: dict[int, list[tuple[_Entry, Grid]]] = {}
        for k, (entry, (placed, convention)) in enumerate(zip(self._entries, self._read(source), strict=True)):
            held = placed[0].map if placed else None
            # one that does not begin at the first pixel is of more than the picture, or of a part
            if convention not in _ON_PIXELS or not isinstance(held, Field) or any(held.grid.origin):
                continue
            at = k if entry.inverse else k + 1
            if at not in ends:
                within.setdefault(at, []).append((entry, held.grid))
            elif held.grid.shape != ends[at][0].shape:
                picture, whose = ends[at]
                what = "which it is applied to" if at == 0 else "on whose pixels the result is written"
                raise SuppleError(
                    f"{shown(entry.text)} is a map of {_size(held.grid)} pixels, and {whose}, {what}, has "
                    f"{_size(picture)}: give a {'map of its size' if at == 0 else 'picture of its size by --reference'}"
                )
        known = {source.shape, output.shape}
        for found in within.values():
            for (one, first), (other, second) in itertools.pairwise(found):
                if first.shape != second.shape:
                    raise SuppleError(
                        f"{shown(one.text)} is a map of {_size(first)} pixels, and {shown(other.text)}, which takes "
                        f"what it makes, of {_size(second)}: give maps of one size"
                    )
            if len(found) == 1 and found[0][1].shape not in known:
                entry, grid = found[0]
                warnings.warn(
                    f"{shown(entry.text)} is a map of {_size(grid)} pixels, and {name} has {_size(source)}: beyond its "
                    "edges, it goes on as there",
                    OutsideWarning,
                    stacklevel=2,
                )

    def facts(self, source: "Grid | None") -> list[dict[str, Any]]:
        """Return what is told of each map, as JSON holds it."""
        return [
            _facts(entry, placed, convention)
            for entry, (some, convention) in zip(self._entries, self._read(source), strict=True)
            for placed in some
        ]


def _size(grid: "Grid") -> str:
    return " x ".join(map(str, grid.sizes))


def _facts(entry: _Entry, placed: "Placed", convention: str | None) -> dict[str, Any]:
    from supple.fields import Field

    held = placed.map
    facts: dict[str, Any] = {
        "file": None if entry.is_numbers else entry.text,
        "kind": "field" if isinstance(held, Field) else "affine",
        "convention": convention,
        "direction": "inverse" if entry.inverse else "pull",
        "after": entry.after,
        "units": "mm" if held.ndim == 3 else "pixels",
    }
    if isinstance(held, Field):
        return {**facts, "grid": grid_facts(held.grid), "interpolation": held.interpolation, "beyond": held.beyond}
    return {**facts, "matrix": held.matrix.tolist()}


def grid_facts(grid: "Grid") -> dict[str, Any]:
    """Return a grid as JSON holds it."""
    return {
        "size": list(grid.sizes),
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": [list(row) for row in grid.direction],
    }


def describe_map(facts: dict[str, Any]) -> str:
    """Return what is told of a map, in a line."""
    unit = "mm in LPS" if facts["units"] == "mm" else "pixels"
    what = (
        "an affine map" if facts["kind"] == "affine" else f"a field on {describe_grid(facts['grid'], facts['units'])}"
    )
    name = "--affine" if facts["file"] is None else shown(facts["file"])
    convention = "" if facts["convention"] is None else f", convention {facts['convention']}"
    direction = "inverted" if facts["direction"] == "inverse" else "from the output to the input"
    place = f", after stroke {facts['after']}" if facts["after"] else ""
    return f"{name}: {what}, in {unit}{convention}, {direction}{place}"


def describe_grid(facts: dict[str, Any], units: str) -> str:
    """Return what is told of a grid, in words."""
    sizes, steps, origin = (" x ".join(f"{x + 0.0:g}" for x in facts[name]) for name in ("size", "spacing", "origin"))
    return f"{sizes} samples, spacing {steps} {units}, from ({origin.replace(' x ', ', ')})"


def say_background(
    console: "Console", target: str | os.PathLike[str], source: str | os.PathLike[str], value: float | None
) -> None:
    """Say what is written where a map leads out of the input, if that was not asked for."""
    if value is not None:
        console.note(
            f"what lies outside of {shown(source)} is {value:g} in {shown(target)}: --fill V, or --outside edge, asks "
            "for something else"
        )
