"""Text tables of points; writing replaces the coordinates, and keeps all other bytes."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

import numpy as np

from supple.errors import SuppleError
from supple.space.checks import LARGEST, value_shown
from supple.space.geometry import Floats

_MARK = "\ufeff"  # byte order mark, which Excel writes
_SYSTEMS = {"0": "RAS", "RAS": "RAS", "1": "LPS", "LPS": "LPS", "2": "index", "IJK": "index"}
_PLAIN = "-+.0123456789"
_TRIPLES = {"ras": "RAS", "lps": "LPS", "ijk": "index"}
_STATEMENT = re.compile(r"\s*#\s*CoordinateSystem\s*=\s*(.*)", re.IGNORECASE)
_COLUMNS = re.compile(r"\s*#\s*columns\s*=", re.IGNORECASE)
_UNIT = re.compile(r"\s*[(\[].*")
_COUNTED = {"px", "pixel", "voxel", "index", "i", "j", "k"}
_AROUND = re.compile(r"(?:pos|position|coord|point)[ _.-]?([xyzt])|([xyzt])[ _.-]?(?:pos|position|coord|mm|px|voxel)")


class _Record(NamedTuple):
    """A line, or several if quotes hold line breaks; ``cells`` hold the text with its spaces and quotes."""

    line: int
    cells: list[str]
    end: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table that was read: its records, the rows of the header and of points, and the columns of coordinates."""

    mark: str
    records: list[_Record]
    delimiter: str
    header: int | None
    rows: list[int]
    columns: tuple[int, ...]

    def written(self, points: Floats, before: Floats, notes: tuple[str, list[str]] | None) -> str:
        """Return the text with other points, shape (N, 2) or (N, 3), and with ``notes``, (column name, its cells)."""
        records = [list(record.cells) for record in self.records]
        for row, new, old in zip(self.rows, points.tolist(), before.tolist(), strict=True):
            for column, x, was in zip(self.columns, new, old, strict=False):
                if x != was:
                    cell = records[row][column]
                    plain = cell[-1].isdigit() and cell[0] in _PLAIN  # without quotes and spaces
                    records[row][column] = repr(x) if plain else cell.replace(bare(cell), repr(x), 1)
        if notes is not None:
            name, texts = notes
            names = [] if self.header is None else [bare(cell).lower() for cell in records[self.header]]
            at = names.index(name) if name in names else None
            if self.header is not None and at is None:
                records[self.header].append(name)
            for row, note in zip(self.rows, texts, strict=True):
                if at is None:
                    records[row].append(note)
                else:
                    records[row][at] = note
        ends = [record.end for record in self.records]
        return self.mark + "".join(self.delimiter.join(cells) + end for cells, end in zip(records, ends, strict=True))


def parsed(name: str, text: str, *, fcsv: bool) -> tuple[Table, Floats, str, tuple[str, ...], str]:
    """Return a table, its points (N, 2) or (N, 3), their convention and labels, and the source of the convention.

    The source is "said", "mm" or "names" (x, y and z with that unit, or without any), or empty; SuppleError names the
    line at fault.
    """
    plain = text.removeprefix(_MARK)
    lines = _lines(name, plain)
    data = [k for k, (_, line, _) in enumerate(lines) if line.strip() and not _is_comment(line)]
    comments = [k for k, (_, line, _) in enumerate(lines[: data[0] if data else None]) if _is_comment(line)]
    if not data:
        _refuse(name, None, "it holds no points", "give one in each line, x first")
    delimiter = "," if fcsv else max(",;\t", key=re.sub(r'"[^"]*"', "", lines[data[0]][1]).count)
    records = [_Record(number, split(line, delimiter), end) for number, line, end in lines]
    told = "said" if fcsv else ""
    stated = "RAS" if fcsv else "index"  # the defaults of Slicer, and of a table
    for k in comments:
        if statement := _STATEMENT.fullmatch(lines[k][1]):
            said = bare(statement[1].rstrip(", \t")).upper()
            if said not in _SYSTEMS:
                _refuse(name, records[k], f"the coordinate system {value_shown(said)} is unknown", "give LPS or RAS")
            stated, told = _SYSTEMS[said], "said"
    header, columns, convention = _headed(name, records, comments, data, fcsv)
    if not told and header is not None:
        words = (set(re.findall("[a-z]+", bare(records[header].cells[c]).lower())) for c in columns)
        units = {"mm" if "mm" in each else "px" if each & _COUNTED else "" for each in words}
        told = "said" if convention else "mm" if "mm" in units else "names" if units == {""} else "said"
    rows = [k for k in data if k != header]
    if not rows:
        _refuse(name, None, "it holds no points", "give one in each line, below the header")
    wide = len(records[rows[0] if header is None or fcsv else header].cells)
    for row in rows:
        cells = records[row].cells
        if len(cells) <= max(columns) or (not fcsv and len(cells) != wide):
            found = f"it has {len(cells)} cell{'s' if len(cells) != 1 else ''}"
            _refuse(name, records[row], found, f"give {max(columns) + 1 if fcsv else wide}")
    points = _all_numbers([[records[row].cells[c] for row in rows] for c in columns])
    if points is None:  # cell by cell: for quoted numbers, or an error with the line
        points = np.array([[_coordinate(name, records[row], c) for c in columns] for row in rows])
    table = Table(text[: len(text) - len(plain)], records, delimiter, header, rows, columns)
    names = [] if header is None else [bare(cell.lstrip(" \t#")).lower() for cell in records[header].cells]
    label = next((names.index(known) for known in ("label", "name", "id") if known in names), 11 if fcsv else -1)
    lists = (records[row].cells for row in rows)
    labels = tuple(bare(row[label]) if 0 <= label < len(row) else "" for row in lists)
    return table, points, convention or stated, labels, told


def bare(cell: str) -> str:
    """Return the text of a cell without the quotes and spaces around it."""
    return cell.strip().strip('"').strip()


def split(line: str, delimiter: str) -> list[str]:
    """Return a line's cells, with their quotes and spaces."""
    if '"' not in line or _is_comment(line):
        return line.split(delimiter)
    return re.split(rf'{delimiter}(?=(?:[^"]*"[^"]*")*[^"]*$)', line)


def _refuse(name: str, record: _Record | None, found: str, advice: str) -> NoReturn:
    where = "" if record is None else f"line {record.line}: "
    raise SuppleError(f"cannot read {name}: {where}{found}: {advice}")


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _lines(name: str, text: str) -> list[tuple[int, str, str]]:
    """Return lines as (number, text, line ending); lines within quotes are joined."""
    made, held, begun = [], "", 1
    for number, line in enumerate(io.StringIO(text, newline=""), 1):
        begun, held = begun if held else number, held + line
        if _is_comment(held) or held.count('"') % 2 == 0:
            whole = held.rstrip("\r\n")
            made.append((begun, whole, held[len(whole) :]))
            held = ""
    if held:
        raise SuppleError(f"cannot read {name}: line {begun}: a quote is not closed: close it")
    return made


def _number(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(bare(cell))
    except ValueError:
        return None


def _all_numbers(columns: list[list[str]]) -> Floats | None:
    """Convert columns of plain numbers at once, to shape (N, columns); None if any cell is something else."""
    try:
        made = np.array([list(map(float, cells)) for cells in columns]).T
    except ValueError:
        return None
    fine = not any("_" in "".join(cells) for cells in columns) and (np.abs(made) <= LARGEST).all()
    return np.ascontiguousarray(made) if fine else None


def _coordinate(name: str, record: _Record, column: int) -> float:
    cell = record.cells[column]
    value = _number(cell)
    if value is None or not abs(value) <= LARGEST:
        found = f"cell {column + 1} is {value_shown(bare(cell))}"
        _refuse(name, record, found, f"a coordinate is a number from {-LARGEST:g} to {LARGEST:g}")
    return value


def _headed(
    name: str, records: list[_Record], comments: list[int], data: list[int], fcsv: bool
) -> tuple[int | None, tuple[int, ...], str | None]:
    """Return the header row or None, the columns of coordinates, and the convention that their names imply or None."""
    first = records[data[0]]
    numbers = [] if fcsv else [c for c, cell in enumerate(first.cells) if _number(cell) is not None]
    if fcsv:
        rows = [k for k in comments if _COLUMNS.match(records[k].cells[0])][:1]
    else:
        rows = [k for k in comments[-1:] if len(records[k].cells) == len(first.cells)] if numbers else data[:1]
    for k in rows:
        start, *rest = records[k].cells
        axes = _axes(name, records[k], [_COLUMNS.sub("", start).lstrip(" \t#"), *rest])
        if axes is not None and (len(axes[0]) == 3 or not fcsv):
            return None if fcsv else k, *axes
        if fcsv:
            _refuse(name, records[k], "the columns are not x, y and z", "name them so")
        if not numbers:
            found = "neither are there numbers, nor names of columns x and y"
            _refuse(name, first, found, "name them in the first line, with , ; or tabs between")
    if len(numbers) == 1:
        _refuse(name, first, "only one cell is a number", "give x and y, and z or t for volumes and videos")
    return None, tuple(numbers[:3]) or (1, 2, 3), None


def _axes(name: str, record: _Record, names: list[str]) -> tuple[tuple[int, ...], str | None] | None:
    plain = [_UNIT.sub("", bare(cell).lower()) for cell in names]
    loose = [(found[1] or found[2]) if (found := _AROUND.fullmatch(cell)) else cell for cell in plain]
    kinds: list[tuple[list[str], str, str | None]] = [(plain, "xy", None), (loose, "xy", None)]
    kinds += [(plain, *triple) for triple in _TRIPLES.items()]
    for known, axes, convention in kinds:
        if set(axes) <= set(known):
            last = [axis for axis in ("z", "t", "frame") if axis in known][:1] if axes == "xy" else []
            for axis in (*axes, *last):
                if known.count(axis) > 1:
                    _refuse(name, record, f"several columns are named {axis}", "leave the name to one")
            return tuple(known.index(axis) for axis in (*axes, *last)), convention
    return None
