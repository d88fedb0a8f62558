"""Files of meshes: read, and written with other vertices, beside what VTK reads and writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from supple.media.meshes import PointFile
from supple.media.points import read_points, write_points
from tests import refusals
from tests.media.meshes import made
from tests.media.meshes.made import KINDS, Floats


def opened(path: Path) -> PointFile:
    return read_points(path, mesh=True)


def bent(points: Floats) -> Floats:
    x, y, z = points.T
    return np.stack([2 * x + 5, y + 0.3 * np.sin(3 * z), z + 0.25 * x * y], axis=-1)


def written(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refused(path: Path, text: str | bytes) -> str:
    message = refusals.refused(opened, written(path, text))
    assert message.startswith(f"cannot read {path}: ")
    return message.removeprefix(f"cannot read {path}: ")


class TestVtkReadsIt:
    @pytest.mark.parametrize("kind", KINDS)
    def test_vertices_move_and_all_else_stays(self, tmp_path: Path, kind: str) -> None:
        source = made.write(tmp_path / kind, made.surface())
        before, read = made.read(source), opened(source)
        assert (read.convention, read.told) == ("RAS", "said")
        np.testing.assert_allclose(np.unique(read.points, axis=0), np.unique(made.points(before), axis=0), atol=1e-7)
        turned = read.normals[:, [1, 2, 0]]
        target = tmp_path / f"moved{source.suffix}"
        write_points(target, bent(read.points), read, normals=turned)
        after = made.read(target)
        np.testing.assert_allclose(made.points(after), bent(made.points(before)), rtol=0, atol=2e-6)
        assert made.faces(after) == made.faces(before)
        assert made.arrays(after) == made.arrays(before)
        known, found = made.normals(before), made.normals(after)
        assert (known is None) == (found is None) == (source.suffix in (".stl",))
        if known is not None and found is not None:
            np.testing.assert_allclose(found, known[:, [1, 2, 0]], atol=1e-6)
        assert opened(target).convention == "RAS"
        if source.suffix in (".vtk", ".vtp"):
            length = np.linalg.norm(made.points(after), axis=1)
            assert after.GetPoints().GetData().GetRange(-1) == pytest.approx((length.min(), length.max()), rel=1e-5)
            assert after.GetFieldData().GetAbstractArray("SPACE").GetValue(0) == "RAS"

    @pytest.mark.parametrize("kind", KINDS)
    def test_what_does_not_move_keeps_every_byte(self, tmp_path: Path, kind: str) -> None:
        source = made.write(tmp_path / kind, made.surface((1, 2, 3)))
        read = opened(source)
        write_points(tmp_path / f"same{source.suffix}", read.points, read)
        assert (tmp_path / f"same{source.suffix}").read_bytes() == source.read_bytes()

    @pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "in.obj"])  # which has no end
    def test_damage_is_told_in_one_sentence(self, tmp_path: Path, kind: str) -> None:
        whole = made.write(tmp_path / kind, made.surface()).read_bytes()
        for part in (0.02, 0.06, 0.1, *(() if kind.endswith(".vtk") else (0.45,))):
            refused(tmp_path / f"cut{Path(kind).suffix}", whole[: int(part * len(whole))])


class TestStl:
    @pytest.mark.parametrize("kind", ["binary.stl", "text.stl"])
    def test_facets_that_move_get_their_normals(self, tmp_path: Path, kind: str) -> None:
        source = made.write(tmp_path / kind, made.surface())
        read, target = opened(source), tmp_path / "out.stl"
        assert len(read.points) == 86  # once, though six facets share each
        moved = np.where(read.points[:, :1] > 0.3, bent(read.points), read.points)
        write_points(target, moved, read)
        if kind == "text.stl":
            numbers = [
                line.split()[-3:] for line in target.read_text().splitlines() if "normal" in line or "vertex" in line
            ]
            facets = np.array(numbers, float).reshape(-1, 4, 3)
        else:
            kind_of = np.dtype([("numbers", "<f4", (4, 3)), ("attribute", "<u2")])
            facets = np.frombuffer(target.read_bytes(), kind_of, offset=84)["numbers"].astype(float)
        edges = facets[:, 2:] - facets[:, 1:2]
        across = np.cross(edges[:, 0], edges[:, 1])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        np.testing.assert_allclose(facets[:, 0], across, atol=2e-4)

    def test_attributes_and_what_follows_are_kept(self, tmp_path: Path) -> None:
        facet = np.zeros(2, np.dtype([("numbers", "<f4", (4, 3)), ("attribute", "<u2")]))
        facet["numbers"] = np.random.default_rng(0).normal(size=(2, 4, 3))
        facet["attribute"] = 0x7C1F, 0x83E0  # colours
        data = b"COLOR=\x01\x02\x03\xff".ljust(80, b" ") + (2).to_bytes(4, "little") + facet.tobytes() + b"more"
        read = opened(written(tmp_path / "in.stl", data))
        write_points(tmp_path / "out.stl", read.points + 1, read)
        after = (tmp_path / "out.stl").read_bytes()
        assert (after[:84], after[-4:], len(after)) == (data[:84], b"more", len(data))
        assert np.frombuffer(after, facet.dtype, 2, 84)["attribute"].tolist() == [0x7C1F, 0x83E0]
        assert opened(tmp_path / "out.stl").told == "mesh"


OBJ = """# a comment
mtllib skin.mtl
o head
v 0 0 0 0.5 0.25 1
v  1.50\t0 0 # a corner
v 0 1 0
v 0 0 1
vt 0 0
vt 1 1
vn 0 0 1
vn 0 1 0
g lid
usemtl skin
s 1
f 1/1/1 2/2/1 3/1/2
f -4//-1 -1//-1 -2//-2
l 1 2
"""


class TestObj:
    def test_only_numbers_change(self, tmp_path: Path) -> None:
        read = opened(written(tmp_path / "in.obj", OBJ.replace("\n", "\r\n")))
        assert read.points.tolist() == [[0, 0, 0], [1.5, 0, 0], [0, 1, 0], [0, 0, 1]]
        pairs = sorted(zip(read.normals.tolist(), read.normals_at.tolist(), strict=True))
        assert pairs == [*(([0, 0, 1], k) for k in (0, 1, 2)), *(([0, 1, 0], k) for k in (0, 2, 3))]
        turned = read.normals.copy()
        turned[(read.normals_at == 1)] = 1, 0, 0  # the first normal has three vertices: it gets their mean
        write_points(tmp_path / "out.obj", read.points + [0, 0, 0.25] * (read.points[:, :1] > 1), read, normals=turned)
        mean = np.array([1, 0, 2]) / np.linalg.norm([1, 0, 2])
        text = f"vn {mean[0].item()!r} 0 {mean[2].item()!r}"
        wanted = OBJ.replace("v  1.50\t0 0 #", "v  1.50\t0 0.25 #").replace("vn 0 0 1", text)
        assert (tmp_path / "out.obj").read_bytes().decode() == wanted.replace("\n", "\r\n")

    @pytest.mark.parametrize("end", ["\n", "\r\n"])
    def test_statements_go_on_after_a_backslash(self, tmp_path: Path, end: str) -> None:
        text = "# in C:\\head\\\nv 0 0 0\nv 1 \\\n 0 0 # of D:\\\nv 0 1 0\nvn 0 0 1\n"
        text += "f 1//1 \\\n 2//1 \\\n3//1 # a/b/c\n"
        read = opened(written(tmp_path / "in.obj", text.replace("\n", end)))
        assert read.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        assert read.normals_at.tolist() == [0, 1, 2]
        assert read.parts()[0].triangles.tolist() == [[0, 1, 2]]
        write_points(tmp_path / "out.obj", read.points + [0, 0.5, 0] * (read.points[:, :1] > 0), read)
        wanted = text.replace(" 0 0 # of", " 0.5 0 # of").replace("\n", end)
        assert (tmp_path / "out.obj").read_bytes().decode() == wanted


PLY = """ply
format ascii 1.0
comment by hand
obj_info scanned
element camera 1
property float view
property list uchar int ids
element vertex 3
property uchar red
property float x
property double quality
property float z
property float y
element face 1
property list uchar int vertex_indices
end_header
1 2 7 8
255 0 0.125 0 1
0 1.50 7 0 0
1 0 0 2 0
3 0 1 2
"""


class TestPly:
    def test_properties_and_elements_are_kept(self, tmp_path: Path) -> None:
        read = opened(written(tmp_path / "in.ply", PLY))
        assert read.points.tolist() == [[0, 1, 0], [1.5, 0, 0], [0, 0, 2]]
        write_points(tmp_path / "out.ply", read.points + np.array([[0, 0, 0], [0, 0.5, 0], [1, 0, 0]]), read)
        wanted = PLY.replace("0 1.50 7 0 0\n", "0 1.50 7 0 0.5\n").replace("1 0 0 2 0\n", "1 1.0 0 2 0\n")
        assert (tmp_path / "out.ply").read_text() == wanted

    @pytest.mark.parametrize("order", "<>")
    def test_binary_rows_are_kept(self, tmp_path: Path, order: str) -> None:
        kind = [(name, order + t) for name, t in [("red", "u1"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("q", "i2")]]
        rows = np.array([(9, 1, 2, 3, -5), (8, 4, 5, 6, 300)], kind)
        name = {"<": "little", ">": "big"}[order]
        head = f"ply\nformat binary_{name}_endian 1.0\nelement tag 2\nproperty short a\nelement vertex 2\n"
        head += (
            "property uchar red\n" + "".join(f"property double {x}\n" for x in "xyz") + "property short q\nend_header\n"
        )
        read = opened(written(tmp_path / "in.ply", head.encode() + b"abcd" + rows.tobytes() + b"rest"))
        assert read.points.tolist() == [[1, 2, 3], [4, 5, 6]]
        write_points(tmp_path / "out.ply", read.points / 3, read)
        for axis in "xyz":
            rows[axis] /= 3
        assert (tmp_path / "out.ply").read_bytes() == head.encode() + b"abcd" + rows.tobytes() + b"rest"


FACET = "solid a\n facet normal 0 0 1\n outer loop\n"
STATEMENTS = "v 1 \\\n2 3\nvn 0 0 1\nf 1//1 {}\n"


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.stl", bytes(80) + b"\x09" + bytes(119), "its 200 bytes are not the"),
        ("a.stl", bytes(84), "it holds no vertices"),
        ("a.stl", f"{FACET} vertex 0 0 0\n vertex 1 0 0\n endsolid\n", "its facets are not a normal"),
        ("a.stl", f"{FACET} vertex 0 0 0\n vertex 1e 0 0\n vertex 0 1 0\n endsolid a\n", "it is damaged or cut short"),
        (
            "a.stl",
            f"{FACET} vertex 0 0 nan\n vertex 1 0 0\n vertex 0 1 0\n endsolid a\n",
            "vertex 1 is (0, 0, nan): a coordinate is a number from",
        ),
        ("a.obj", "v 1 2\n", "line 1: a vertex or normal has fewer than three numbers"),
        ("a.obj", "v 1 2 3\ncurv 0 1 1 1\n", "line 2: it has free-form curves or surfaces"),
        ("a.obj", "v 1 2 3\nvn 0 0 1\nf 1//2 1//1 1//1\n", "a face has another normal or vertex"),
        ("a.obj", "v 1 2 3\nvn 0 0 1\nf 1//x 1//1 1//1\n", "it is damaged or cut short"),
        ("a.obj", "v 1 2 a\n", "it is damaged or cut short"),
        ("a.obj", "f 1 2 3\n", "it holds no vertices"),
        *(
            ("a.obj", STATEMENTS.format(face), "line 4: an index is 0, and the first one is 1")
            for face in ("0//1 1//1", "1//0 1//1", "1/0/1 1//1", "1 0", "1 1 00 # all")
        ),
        ("a.ply", "v 1 2 3\n", "it does not begin with the header"),
        ("a.ply", PLY.replace("format ascii 1.0\n", ""), "its header names no format"),
        ("a.ply", PLY.replace("float x", "half x"), "its header has the line 'property half x'"),
        ("a.ply", PLY.replace("float x", "int x"), "the property x of its vertices is not of floats"),
        ("a.ply", PLY.replace("float x", "float u"), "the property x of its vertices is not of floats"),
        ("a.ply", PLY.replace("double quality", "float y"), "a property is there twice"),
        ("a.ply", PLY.replace("0 1.50 7 0 0", "0 1.50 7 0"), "vertex 2 has 4 numbers"),
        ("a.ply", PLY.partition("1 0 0 2 0")[0], "it ends before its 3 vertices do"),
        ("a.ply", PLY.replace("ascii", "binary_little_endian"), "it has lists before the vertices end"),
        ("a.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET FIELD\n", "it holds FIELD: give PolyData"),
        ("a.vtp", '<VTKFile type="UnstructuredGrid"></VTKFile>', "it holds UnstructuredGrid: give PolyData"),
        ("a.vtp", "<svg/>", "it does not begin as XML of VTK does"),
        (
            "a.vtp",
            '<VTKFile type="PolyData" compressor="vtkLZ4DataCompressor"></VTKFile>',
            "it is compressed by vtkLZ4DataCompressor: save it with ZLib, or uncompressed",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, text: str | bytes, told: str) -> None:
    assert refused(tmp_path / name, text).startswith(told)


def test_an_array_that_is_damaged(tmp_path: Path) -> None:
    whole = made.write(tmp_path / "Binary-ZLib.vtp", made.surface()).read_bytes()
    at = whole.index(b'Name="Points"') + 220
    assert "it is damaged" in refused(tmp_path / "bad.vtp", whole[:at] + b"AAAAAAAA" + whole[at + 8 :])
