"""What joins the vertices of meshes, beside what VTK has written and reads."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vtk
from vtk.util.numpy_support import numpy_to_vtk

from supple import SuppleError
from supple.media.meshes import Part, PointFile, joined, part_of
from supple.media.points import read_points
from tests import refusals
from tests.media.meshes import made
from tests.media.meshes.contours import circle, structures
from tests.media.meshes.made import KINDS, Floats

PLACES = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 1], [3, 3, 3], [4, 3, 5]], float)


def opened(path: Path) -> PointFile:
    return read_points(path, mesh=True)


def only(path: Path) -> tuple[Floats, Part]:
    read = opened(path)
    (part,) = read.parts()
    return read.points, part


def mixed() -> Any:
    """A triangle, a quadrangle and a pentagon; two lines; and two strips."""
    mesh, points = vtk.vtkPolyData(), vtk.vtkPoints()
    points.SetData(numpy_to_vtk(PLACES, deep=1))
    mesh.SetPoints(points)
    for add, runs in (
        (mesh.SetPolys, ((0, 1, 5), (0, 1, 2, 3), (0, 1, 2, 3, 4))),
        (mesh.SetLines, ((5, 6), (4, 3, 2, 0))),
        (mesh.SetStrips, ((0, 1, 2, 3, 4), (4, 5, 6))),
    ):
        cells = vtk.vtkCellArray()
        for run in runs:
            cells.InsertNextCell(len(run))
            for k in run:
                cells.InsertCellPoint(k)
        add(cells)
    return mesh


def divided(mesh: Any) -> set[tuple[int, ...]]:
    """Triangles of polygons and strips by VTK, each from its lowest corner on, so that their turn is kept."""
    strips = vtk.vtkTriangleFilter()
    strips.SetInputData(mesh)
    strips.PassLinesOff()
    strips.Update()
    return {turned(face) for face in made.faces(strips.GetOutput())}


def turned(face: Any) -> tuple[int, ...]:
    first = int(np.argmin(face))
    return tuple(int(k) for k in np.roll(face, -first))


@pytest.mark.parametrize("kind", KINDS)
def test_triangles_are_those_that_vtk_reads(tmp_path: Path, kind: str) -> None:
    path = made.write(tmp_path / kind, made.surface())
    seen, (points, part) = made.read(path), only(path)
    np.testing.assert_allclose(points[part.triangles], made.points(seen)[np.array(made.faces(seen))], atol=1e-7)
    assert part.lines.shape == (0, 2)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.endswith((".vtk", ".vtp"))])
def test_polygons_lines_and_strips(tmp_path: Path, kind: str) -> None:
    points, part = only(made.write(tmp_path / kind, mixed()))
    np.testing.assert_array_equal(points, PLACES)
    triangles = [turned(face) for face in part.triangles]
    assert {(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 1, 5), (1, 3, 2), (2, 3, 4), (4, 5, 6)} == set(triangles)
    assert len(triangles) == 1 + 2 + 3 + 3 + 1
    assert {turned(face) for face in part.triangles[6:]} <= divided(mixed())  # strips, turned as VTK turns them
    assert part.lines.tolist() == [[5, 6], [4, 3], [3, 2], [2, 0]]


def test_pieces_of_xml_are_one_mesh(tmp_path: Path) -> None:
    path = made.write(tmp_path / "Ascii-None.vtp", made.surface())
    text = path.read_text()
    start, end = text.index("<Piece"), text.index("</Piece>") + len("</Piece>")
    path.write_text(text[:end] + text[start:end] + text[end:])
    points, part = only(path)
    half = len(part.triangles) // 2
    np.testing.assert_array_equal(part.triangles[half:], part.triangles[:half] + len(points) // 2)


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_of_faces_of_many_sizes_and_edges(tmp_path: Path, order: str) -> None:
    faces, edges = [[0, 1, 2], [0, 1, 2, 3], [4, 2, 1]], [[0, 5], [5, 6]]
    head = (
        f"ply\nformat {order} 1.0\nelement vertex 7\nproperty float x\nproperty float y\nproperty double z\n"
        "element face 3\nproperty uchar flag\nproperty list uchar int vertex_indices\nproperty list uchar float uv\n"
        "element edge 2\nproperty int vertex1\nproperty int vertex2\nproperty float long\nend_header\n"
    ).encode()
    if order == "ascii":
        rows = [f"{x} {y} {z}" for x, y, z in PLACES]
        rows += [f"7 {len(f)} {' '.join(map(str, f))} 2 0.5 1e-3" for f in faces] + [f"{a} {b} 0.5" for a, b in edges]
        body = "\n".join(rows).encode() + b"\n"
    else:
        sign = "<" if "little" in order else ">"

        def packed(kind: str, *values: float) -> bytes:
            return np.array(values, sign + kind).tobytes()

        body = b"".join(packed("f4", x, y) + packed("f8", z) for x, y, z in PLACES.tolist())
        for f in faces:
            body += packed("u1", 7, len(f)) + packed("i4", *f) + packed("u1", 2) + packed("f4", 0.5, 1e-3)
        body += b"".join(packed("i4", *edge) + packed("f4", 0.5) for edge in edges)
    path = tmp_path / "in.ply"
    path.write_bytes(head + body)
    _, part = only(path)
    assert part.triangles.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3], [4, 2, 1]]
    assert part.lines.tolist() == edges
    for many in range(len(body) - 40, len(body), 7):  # whatever is missing
        path.write_bytes(head + body[:many])
        if order != "ascii" or many < len(body) - 20:
            with pytest.raises(SuppleError, match=r"^cannot read .*in.ply: it is damaged or cut short"):
                opened(path).parts()


def test_obj_counts_from_both_ends(tmp_path: Path) -> None:
    path = tmp_path / "in.obj"
    rows = [f"v {x} {y} {z}" for x, y, z in PLACES]
    path.write_text("\n".join([*rows[:4], "f 1/1 2/1 -1/3", *rows[4:], "f -1 -2 -3 1", "l 1 2 -1", ""]))
    _, part = only(path)
    assert part.triangles.tolist() == [[0, 1, 3], [6, 5, 4], [6, 4, 0]]
    assert part.lines.tolist() == [[0, 1], [1, 6]]


def test_contours_are_closed_as_they_say_and_have_the_colour_of_their_region(tmp_path: Path) -> None:
    read = opened(structures(tmp_path / "rs.dcm"))
    liver, marks, none = read.parts()
    assert (liver.colour, marks.colour, none.colour) == ((1, 0, 128 / 255), None, None)
    ring = [*range(24), 0]
    rings = [*itertools.pairwise(ring), *((a + 24, b + 24) for a, b in itertools.pairwise(ring))]
    assert [tuple(line) for line in liver.lines.tolist()] == rings
    assert marks.lines.tolist() == [[k, k + 1] for k in range(49, 53)]  # not the point before
    assert len(none.lines) == 0
    np.testing.assert_array_equal(read.points[liver.lines[24:48, 0]], circle(2.5))


def refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert refusals.refused(lambda: opened(path).parts()).startswith(f"cannot read {path}: ")


@pytest.mark.parametrize("kind", ["binary.vtk", "text.vtk", "old.vtk", "Appended-ZLib.vtp", "big.vtp"])
def test_damaged_cells_are_told_in_one_sentence(tmp_path: Path, kind: str) -> None:
    whole = made.write(tmp_path / kind, made.surface()).read_bytes()
    if kind.endswith(".vtk"):
        broken = whole[: whole.index(b"POLYGONS") + (200 if kind == "old.vtk" else 500)]
    else:
        broken = whole.replace(b'"Int64" Name="connectivity"', b'"Float64" Name="connectivity"')
        assert broken != whole
    refused(tmp_path / kind, broken)


def test_runs_are_checked() -> None:
    with pytest.raises(ValueError, match=r"a face or line has vertex 4 of 3"):
        part_of(3, joined([[0, 1, 3]]))
    with pytest.raises(ValueError, match=r"do not have as many corners as it says"):
        part_of(3, lines=([0, 1, 2], [2]))
    assert part_of(3, joined([[0, 1], [2], []])).triangles.shape == (0, 3)


BEYOND = 1 << 64
POLYGONS = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n1 2 3\nPOLYGONS"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", f"v 1 2 3\nv 2 3 4\nv 3 4 5\nf 1 2 {BEYOND}\n"),
        ("a.obj", "v 1 2 3\nf 1 a 1\n"),
        ("b.vtk", f"{POLYGONS} 1 2\n1 {BEYOND}\n"),
        ("c.vtk", f"{POLYGONS} 2 4\n-3 0 0 0\n"),
        ("d.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
                  f"element face 1\nproperty list uchar int vertex_indices\nend_header\n1 2 3\n3 0 0 {BEYOND}\n"),
    ],
)  # fmt: skip
def test_numbers_that_no_cell_has_are_told_in_one_sentence(tmp_path: Path, name: str, text: str) -> None:
    refused(tmp_path / name, text.encode())
