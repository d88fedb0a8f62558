"""The commands on displacement fields: invert, check, compose and convert."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from supple.cli.console import Console, naming
from supple.cli.options import RunOptions, number
from supple.errors import SuppleError, shown, spelling

if TYPE_CHECKING:
    from supple.fields import Map
    from supple.files.fields import CheckedFile, Input, InvertedFile, Written
    from supple.files.maps import MapFile
    from supple.space.geometry import Grid

MAPS = Group("Maps", sort_key=1)
WRITING = Group("Writing", sort_key=3)

Name = Annotated[str | None, Parameter(group=MAPS, metavar="NAME")]
Image = Annotated[str | None, Parameter(group=MAPS, metavar="FILE")]
Output = Annotated[str | None, Parameter(group=WRITING, metavar="FILE")]


def invert(
    field: Annotated[str, Parameter(name="FIELD")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    convention: Name = None,
    to: Name = None,
    source: Image = None,
    reference: Image = None,
    tolerance: Annotated[float, number("a number of voxels from 1e-9 to 1e9", "N", (1e-9, 1e9), group=MAPS)] = 0.01,
    error: Output = None,
    status: Output = None,
    report: Output = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Invert a displacement field, and say how well.

    Parameters
    ----------
    field
        File of a field, of affine maps, or of several of these, whose inverse is then sampled as one field.
    target
        File to write the inverse to.
    convention
        Convention of FIELD: itk, fsl-relative, … (default: what the file leaves no doubt about).
    to
        Convention of OUT (default: that of FIELD).
    source
        The input (moving) image of FIELD, which FSL's conventions need.
    reference
        Image or field whose grid the inverse gets (default: the grid of FIELD). A B-spline needs it, as its control
        points lie far apart.
    tolerance
        Largest allowed error, in voxels of FIELD.
    error
        Also write an image of the error of each voxel, in millimetres: inf where it is not known; in NIfTI, where
        ITK reads inf as 0, 3.4028235e38.
    status
        Also write an image of what became of each voxel: 0 ok, 1 folded, 2 outside, 3 unconverged.
    report
        Also write the figures to a JSON file.
    """
    console = options.start(field)
    from supple.files.fields import invert_file

    made = invert_file(
        field,
        target,
        convention=convention,
        to=to,
        reference=reference,
        image=source,
        tolerance=tolerance,
        error=error,
        status=status,
        report=report,
        force=options.force,
    )
    _tell(console, options, made, _inverted)


def check(
    field: Annotated[str, Parameter(name="FIELD")],
    inverse: Annotated[str | None, Parameter(name="INVERSE")] = None,
    /,
    *,
    convention: Name = None,
    source: Image = None,
    map: Output = None,
    picture: Output = None,
    plane: Annotated[str | None, Parameter(group=WRITING, metavar="PLANE[:MM]")] = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Check a displacement field: displacement, folds, and how well another one undoes it.

    That it folds is told, and is no error.

    Parameters
    ----------
    field
        File of a field.
    inverse
        File of a field that shall undo it.
    convention
        Convention of both: itk, fsl-relative, … (default: what each file leaves no doubt about).
    source
        The input (moving) image of FIELD, which FSL's conventions need.
    map
        Also write an image of the logarithm of the Jacobian determinant, by central differences: NaN where the
        determinant is not above 0; in NIfTI, where ITK reads NaN as 0, -3.4028235e38.
    picture
        Also draw a slice: the grid, the logarithm of the determinant and the folds (PNG, SVG or PDF).
    plane
        The slice of the picture, of a volume: axial, coronal or sagittal, perhaps at a place in millimetres in LPS, as
        in axial:12.5 (default: the axial one with most folds).
    """
    console = options.start(field)
    from supple.files.fields import check_file

    made = check_file(
        field, inverse, convention=convention, image=source, map=map, picture=picture, plane=plane, force=options.force
    )
    _tell(console, options, made, _checked)


def compose(
    *maps: Annotated[str, Parameter(name="MAP...", required=True, allow_leading_hyphen=True)],
    out: Annotated[str, Parameter(group=WRITING, metavar="FILE")],
    to: Name = None,
    reference: Image = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Make one displacement field of several maps, one after the other.

    Parameters
    ----------
    maps
        Files of fields and affine maps. A point of the output goes through the first one first. After a file,
        --inverse takes its inverse, --convention NAME says what it follows, and --source FILE is the input (moving)
        image that it leads to, which FSL's conventions need.
    out
        File to write.
    to
        Convention of the result (default: that of all maps, or the only one of the suffix).
    reference
        Image or field whose grid the result gets (default: the grid of the first field).
    """
    console = options.start()
    from supple.files.fields import compose_files

    made = compose_files(parse_maps(maps), out, to=to, reference=reference, force=options.force)
    _tell(console, options, made, _written)


def convert(
    source_file: Annotated[str, Parameter(name="IN")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    convention: Annotated[str | None, Parameter(name="--from", group=MAPS, metavar="NAME")] = None,
    to: Name = None,
    source: Image = None,
    reference: Image = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Convert a field or an affine map from one convention to another.

    Parameters
    ----------
    source_file
        File of a field, of an affine map, or of several of these.
    target
        File to write.
    convention
        Convention of IN: itk, fsl-relative, … (default: what the file leaves no doubt about).
    to
        Convention of OUT (default: the only one of its suffix).
    source
        The input (moving) image, which FSL's and FreeSurfer's conventions need; STMaps count in its size (default:
        that of the map).
    reference
        The output (fixed) image: maps are sampled on its grid as one field, unless it is one affine map that OUT holds
        as such.
    """
    console = options.start(source_file)
    from supple.files.fields import convert_file

    with spelling(naming(convention="--from")):
        made = convert_file(
            source_file, target, convention=convention, to=to, image=source, reference=reference, force=options.force
        )
    _tell(console, options, made, _written)


def parse_maps(words: Sequence[str]) -> list[Input]:
    """Parse files and their options from the command line: an option applies to the file before it."""
    from supple.files.fields import Input

    made, rest = list[Input](), iter(words)
    for word in rest:
        name, equals, value = word.partition("=")
        if not word.startswith("-"):
            made.append(Input(word))
            continue
        if name not in ("--inverse", "--convention", "--source") or (name == "--inverse" and equals):
            raise SuppleError(f"Unknown option: {word}. (supple compose --help tells more)")
        if not made:
            raise SuppleError(f"{name} is about the file before it, and there is none: give a file first")
        given: Any = True if name == "--inverse" else value if equals else next(rest, "-")
        if not equals and given is not True and given.startswith("-"):
            raise SuppleError(f"{name} needs a {'name' if name == '--convention' else 'file'} after it")
        if getattr(made[-1], name[2:]):
            raise SuppleError(f"{name} is given twice for {shown(made[-1].path)}: leave one out")
        made[-1] = made[-1]._replace(**{name[2:]: given})
    return made


def _tell(console: Console, options: RunOptions, made: Any, text: Callable[[Any], str]) -> None:
    if options.json:
        console.tell(made.facts())
    elif not options.quiet:
        print(text(made))


def _inverted(made: InvertedFile) -> str:
    lines = [_written(made)]
    if made.counts is not None:
        whole = sum(made.counts.values())
        shares = [f"{count:,} {status} ({_share(count, whole)})" for status, count in made.counts.items()]
        grid = made.target.grid
        unit, what = (_unit(grid), "pixel" if grid.ndim == 2 else "voxel") if grid is not None else ("mm", "voxel")
        lines.append(_line(f"{what}s", ", ".join(shares)))
        worst = f"no {what} is ok" if made.error is None else f"up to {made.error:.2g} {unit} among the ok"
        lines.append(_line("error", f"{worst}; the tolerance is {made.tolerance:g} {what}s"))
    lines.append(_line("time", f"{made.seconds:.2g} s"))
    return "\n".join(lines)


def _written(made: Written) -> str:
    return "\n".join([*(_file(each, "read") for each in made.sources), _file(made.target, "written")])


def _checked(made: CheckedFile) -> str:
    from supple.files.fields import doubt_of

    report = made.report
    grid = report.grid
    unit, space = _unit(grid), " in LPS" if grid.ndim == 3 else ""
    lines = [_file(made.source, "read")]
    if made.inverse is not None:
        lines.append(_file(made.inverse, "read"))
    lines.append(f"{shown(made.source.path)}:")
    lines.append(_line("moves", f"up to {report.largest:.4g} {unit}, {report.mean:.4g} {unit} on average"))
    if report.folds:
        lines.append(
            _line("folds", f"{report.folded:,} of {report.cells:,} cells ({_share(report.folded, report.cells)})")
        )
    else:
        lines.append(_line("folds", f"nowhere: the determinant is above 0 in all of {report.cells:,} cells"))
    if doubt := doubt_of(made.source, report.folded, report.cells):
        lines.append(_line("", doubt))
    place = ", ".join(f"{x + 0.0:.5g}" for x in report.at)
    lines.append(_line("determinant", f"the least is {report.determinant:.4g}, at ({place}) {unit}{space}"))
    share = f"{report.negative:,} of {report.samples:,} samples ({_share(report.negative, report.samples)})"
    lines.append(_line("", f"not above 0 at {share}, by central differences"))
    found = report.consistency
    if found is not None and found.count:
        within = f"99 % within {found.percentile:.3g} {unit}, {found.mean:.3g} {unit} on average"
        rest = f"; {found.outside:,} others are mapped outside" if found.outside else ""
        lines.append(
            _line("consistency", f"{found.largest:.3g} {unit} at most, {within}, of {found.count:,} samples{rest}")
        )
    elif found is not None:
        lines.append(_line("consistency", f"not known: all of {found.outside:,} samples are mapped outside"))
    return "\n".join(lines)


def _file(file: MapFile, verb: str) -> str:
    """Return the description of a file of maps, on several lines."""
    kind, inverted = file.kind, "; inverted" if file.inverse else ""
    lines = [
        f"{shown(file.path)}: {verb} as {kind.label} ({kind.space}, {kind.units}), {file.known}{inverted}",
        _line("direction", f"{'pull' if file.direction.startswith('output') else 'push'}: {file.direction}"),
    ]
    return "\n".join([*lines, *(_line("holds", _map(each, kind.holds)) for each in file.maps)])


def _map(each: Map, holds: str) -> str:
    from supple.fields import Field

    if not isinstance(each, Field):
        return "an affine map"
    grid = each.grid
    sizes = " x ".join(map(str, grid.sizes))
    if grid.ndim == 2:
        return f"a field of {holds}, {sizes} pixels"
    steps, origin = " x ".join(f"{s:.5g}" for s in grid.spacing), ", ".join(f"{x + 0.0:.5g}" for x in grid.origin)
    spline = "" if each.interpolation == "linear" else f", interpolation {each.interpolation}"
    return f"a field of {holds}, {sizes} voxels of {steps} mm, the first at ({origin}) in LPS{spline}"


def _unit(grid: Grid) -> str:
    return "mm" if grid.ndim == 3 else "px"


def _share(count: int, whole: int) -> str:
    return f"{100 * count / whole:.3g} %" if count else "0 %"


def _line(key: str, text: str) -> str:
    return f"  {key:<12}{text}"
