"""Options for fields and affine maps, which apply in the order given, and for output grids."""

import os
import re
import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from supple.cli.console import say_convention
from supple.cli.options import COORDINATES, Texts, options_of, parse_numbers, parse_sizes, text
from supple.errors import OutsideWarning, SuppleError, shown, warn

if TYPE_CHECKING:
    from supple.cli.console import Console
    from supple.fields import Placed
    from supple.files.jobs import Job, Warped
    from supple.files.options import GridOptions
    from supple.space.affine import Affine
    from supple.space.geometry import Grid

PathLike = str | os.PathLike[str]

MAPS = Group("Fields and affine maps", sort_key=1.3)
OUTPUT = Group("Output grid", sort_key=1.6)

Reference = Annotated[str | None, Parameter(group=MAPS, metavar="FILE")]

_ON_PIXELS = ("opencv", "stmap")
_AFFINE = "6 numbers (pictures) or 12 (volumes), the rows of its matrix, or a file"
_NUMBERS = re.compile(r"[-+\d.eE,\s]*\d[-+\d.eE,\s]*")


@options_of()
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
        index, which is voxels.
    """

    field: Annotated[Texts, Parameter(group=MAPS, metavar="FILE")] = ()
    affine: Annotated[Texts, text("FILE|NUMBERS", group=MAPS)] = ()
    inverse: Annotated[int, Parameter(group=MAPS, count=True, show_default=False)] = 0
    convention: Annotated[Texts, Parameter(group=MAPS, metavar="NAME")] = ()

    @property
    def given(self) -> dict[str, Texts]:
        """The values of the options whose order matters."""
        return {"--field": self.field, "--affine": self.affine, "--convention": self.convention}

    @property
    def coordinates(self) -> str | None:
        """The coordinates in --convention for points without their own: LPS, RAS, index or None."""
        found = {COORDINATES[name.lower()] for name in self.convention if name.lower() in COORDINATES}
        if len(found) > 1:
            raise SuppleError(f"--convention of points is given as {' and '.join(sorted(found))}: leave one out")
        return found.pop() if found else None


@options_of()
class GridArguments:
    """Options of the grid of the output.

    Parameters
    ----------
    reference
        Write the result on the grid of another image: of a volume, its place in space; of a picture, its size.
    crop
        Write only a part of the grid: its first sample, and its size. It equals that part of the whole, bit for bit.
    resample
        Write the result with another spacing: in millimetres, for pictures in pixels of the input. It comes after
        --reference, and before --crop.
    """

    reference: Annotated[str | None, Parameter(group=OUTPUT, metavar="FILE")] = None
    crop: Annotated[str | None, text("X,Y,W,H|X,Y,Z,W,H,D", group=OUTPUT)] = None
    resample: Annotated[str | None, text("S|SX,SY[,SZ]", group=OUTPUT)] = None

    @property
    def onto(self) -> str | None:
        """The image whose grid the output has; None if not given."""
        return self.reference

    def to_grid(self) -> "GridOptions | None":
        """Return the options of the output grid for the library; None if none is given."""
        from supple.files.options import GridOptions

        if self.onto is None and self.crop is None and self.resample is None:
            return None
        box = steps = None
        if self.crop is not None:
            wanted = "X,Y,W,H for a picture, or X,Y,Z,W,H,D for a volume"
            box = parse_sizes("--crop", self.crop, wanted, (4, 6))
        if self.resample is not None:
            wanted = "a spacing S above 0, or one for each axis, SX,SY or SX,SY,SZ"
            steps = parse_numbers("--resample", self.resample, wanted, ends=(5e-324, 1e308))
        spacing = steps if steps is None or len(steps) > 1 else steps[0]
        return GridOptions(self.onto, box, spacing, strokes=self.onto != self.reference)


@options_of()
class OutputOptions(GridArguments):
    """Options of the grid of the output, and of the strokes.

    Parameters
    ----------
    fixed
        Like --reference, and the strokes are on that grid, too: as supple view --fixed saves them.
    """

    fixed: Annotated[str | None, Parameter(group=OUTPUT, metavar="FILE")] = None

    @property
    def onto(self) -> str | None:
        """The image whose grid the output has; None if not given."""
        if self.fixed is not None and self.reference is not None:
            raise SuppleError("--fixed and --reference name the same grid: leave --reference out")
        return self.fixed or self.reference


@dataclass(slots=True)
class _Entry:
    """A --field or an --affine, with the options after it."""

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
        """Return the maps in the order of a deformation's elements, and the convention of the file.

        The last element applies first to a point of the output. ``here`` is the grid of the image on the input side of
        the entry, known for the first entry; ``there`` is that of the image on its output side, known for the ``last``
        entry if --reference names it. Unknown grids are None.
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

        numbers = parse_numbers("--affine", self.text, _AFFINE, (6, 12))
        width = 3 if len(numbers) == 6 else 4
        try:
            return Affine([numbers[k : k + width] for k in range(0, len(numbers), width)])
        except SuppleError as error:
            raise SuppleError(f"{self.told}: {error}") from None


_Read = tuple[_Entry, list["Placed"], str | None]


class Maps:
    """The maps among the strokes of a command, which are read when the grid of an input is known.

    For several inputs on one grid, files are read once.
    """

    def __init__(self, reference: str | None = None) -> None:
        self._entries: list[_Entry] = []
        self.reference = reference
        self.back = False
        self._lock = threading.Lock()
        self._known: tuple[Grid | None, list[_Read]] | None = None

    def add(self, option: str, value: str, after: int, *, back: bool) -> None:
        """Add the next option of the command line: a map, which follows ``after`` strokes, or an option of a map.

        With ``back``, an --inverse before all maps means that points are mapped from the output to the input.
        """
        last = self._entries[-1] if self._entries else None
        if option in ("--field", "--affine"):
            self._entries.append(_Entry(option, value, after))
        elif option == "--convention" and value.lower() in COORDINATES:
            pass  # a convention of points
        elif option == "--inverse" and back and last is None:
            self.back = True
        elif last is None:
            of_points = ", or LPS, RAS or index of points" if option == "--convention" else ""
            raise SuppleError(
                f"{option} is for the --field or --affine before it, and there is none: give one{of_points}"
            )
        elif getattr(last, option[2:]):
            raise SuppleError(f"{last.told} has two {option}: leave out one")
        elif option == "--inverse":
            last.inverse = True
        elif last.is_numbers:
            raise SuppleError(f"--convention is for files, and {last.told} is none: leave it out")
        else:
            last.convention = value

    def __bool__(self) -> bool:
        return bool(self._entries)

    def output(self, source: "Grid") -> "Grid":
        """Return the grid of the output for an input on ``source``: that of the reference, or ``source``."""
        from supple.files.grids import reference_grid

        return source if self.reference is None else reference_grid(self.reference, source.ndim)

    def read(self, source: "Grid | None") -> "tuple[Placed, ...]":
        """Return the maps for an input on this grid, in the order in which they apply."""
        return tuple(placed for _, some, _ in self._read(source) for placed in some)

    def _read(self, source: "Grid | None") -> "list[_Read]":
        """Return each entry, its maps, and the convention of its file."""
        from supple.files import maps

        with self._lock:
            if self._known is None or self._known[0] != source:
                fixed, refused = None, None
                try:
                    if self.reference is not None and source is not None:
                        fixed = self.output(source)
                except SuppleError as error:
                    refused = error  # raised only if needed: the maps may show that pages are a volume
                read = list[_Read]()
                most = len(self._entries) - 1
                for k, entry in enumerate(self._entries):
                    try:
                        ends = source if k == 0 else None, fixed if k == most else None
                        some, form = entry.read(*ends, last=k == most)
                    except SuppleError as error:
                        raise (refused or error) from None
                    read.append((entry, maps.lifted(some, form, source), form))
                self._known = source, read
            return self._known[1]

    def placed(self, console: "Console", job: "Job") -> "Job":
        """Return a job with the maps, read for the grid of its file; print each."""
        from supple.files.clips import refuse_maps

        if not self:
            return job
        own = job.medium.grid
        if own is not None and any(each.map.ndim != own.ndim for each in self.read(own)):
            job = replace(job, maps=self.read(own))  # with these, pages may become a volume
            own = job.medium.grid
        if own is None:
            refuse_maps(job.source)
        return replace(job, maps=self.on(console, own, job.medium.name, job.grid))

    def on(
        self, console: "Console", source: "Grid", name: str, grid: "GridOptions | None" = None
    ) -> "tuple[Placed, ...]":
        """Return the maps for an input on this grid, and print each; SuppleError if one does not fit the grid."""
        from supple.files.grids import grid_on

        maps = self.read(source)
        grid_on(grid, source, name, maps)
        self.check_sizes(source, name)
        for facts in self.facts(source):
            console.note(describe_map(facts))
        return maps

    def check_sizes(self, source: "Grid", name: str) -> None:
        """Raise SuppleError for maps with a value for each pixel whose size is not that of their picture.

        Maps lead from picture to picture, from the input to the output. Each has the size of the picture after it, or,
        if it is inverted, of the one before it. Only the sizes of the input and the output are known: for a picture
        between them, a warning is given unless the size occurs elsewhere.
        """
        from supple.fields import Field

        if source.ndim != 2:
            return
        output, most = self.output(source), len(self._entries)
        within: dict[int, tuple[str, Grid]] = {}
        for k, (entry, placed, convention) in enumerate(self._read(source)):
            held = placed[0].map if placed else None
            # a map with another origin covers more than the picture, or a part of it
            if convention not in _ON_PIXELS or not isinstance(held, Field) or any(held.grid.origin):
                continue
            at, told = k if entry.inverse else k + 1, f"{shown(entry.text)} is a map of {_size(held.grid)} pixels, and"
            if at == 0 and held.grid.shape != source.shape:
                raise SuppleError(f"{told} {name}, which it is applied to, has {_size(source)}: give a map of its size")
            if at == most and held.grid.shape != output.shape:
                raise SuppleError(
                    f"{told} {shown(self.reference or name)}, on whose pixels the result is written, has "
                    f"{_size(output)}: give a picture of its size by --reference"
                )
            other, grid = within.pop(at, ("", held.grid))
            if grid.shape != held.grid.shape:
                raise SuppleError(
                    f"{other} is a map of {_size(grid)} pixels, and {shown(entry.text)}, which takes what it makes, of "
                    f"{_size(held.grid)}: give maps of one size"
                )
            if not other and 0 < at < most:
                within[at] = shown(entry.text), held.grid
        for told, grid in within.values():
            if grid.shape not in (source.shape, output.shape):
                warn(
                    f"{told} is a map of {_size(grid)} pixels, and {name} has {_size(source)}: beyond its edges, it "
                    "goes on as there",
                    OutsideWarning,
                )

    def facts(self, source: "Grid | None") -> list[dict[str, Any]]:
        """Return the facts on each map, ready for JSON."""
        read = self._read(source)
        return [_facts(entry, placed, convention) for entry, some, convention in read for placed in some]


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
    """Return the facts on a grid, ready for JSON."""
    return {
        "size": list(grid.sizes),
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": [list(row) for row in grid.direction],
    }


def describe_map(facts: dict[str, Any]) -> str:
    """Return the description of a map, in one line."""
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
    """Return the description of a grid, in words."""
    sizes, steps, origin = (" x ".join(f"{x + 0.0:g}" for x in facts[name]) for name in ("size", "spacing", "origin"))
    return f"{sizes} samples, spacing {steps} {units}, from ({origin.replace(' x ', ', ')})"


def say_output(
    console: "Console", made: "Warped", grid: "Grid | None", target: object, source: object, world: bool
) -> None:
    """Print the grid of a result if it was given, the convention of its points, and the fill value outside the input.

    The fill value is printed only if it was chosen automatically.
    """
    target, source = shown(str(target)), shown(str(source))
    if grid is not None:
        units = "mm" if made.geometry is not None and made.geometry.convention != "array" else "pixels"
        console.note(f"{target} is written on {describe_grid(grid_facts(grid), units)}")
    if made.background is not None:
        console.note(
            f"what lies outside of {source} is {made.background:g} in {target}: --fill V, or --outside edge, asks for "
            "something else"
        )
    say_convention(console, world, made.geometry, source)


def output_facts(made: "Warped") -> dict[str, Any]:
    """Return the facts on the grid of a result, and on the effects of maps, ready for JSON."""
    facts: dict[str, Any] = {}
    if made.background is not None:
        facts["background"] = made.background
    if made.grid is not None:
        facts["grid"] = grid_facts(made.grid)
    if made.deformation.maps:
        facts |= {"folded": made.folded, "outside": made.outside, "unsolved": made.unsolved}
    return facts
