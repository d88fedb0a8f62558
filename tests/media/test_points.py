"""Slicer's files of points, in which nothing else changes; and what is none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from supple.media.points import read_points
from tests.media.landmarks import fcsv, markup, markups, read, rewritten
from tests.refusals import refused


class TestSlicersLists:
    @pytest.mark.parametrize(
        ("said", "convention"),
        [
            ("0", "RAS"),
            ("RAS", "RAS"),
            ("1", "LPS"),
            ("LPS", "LPS"),
            ("2", "index"),
            ("IJK", "index"),
            ("lps,,", "LPS"),
        ],
    )
    def test_coordinate_systems(self, tmp_path: Path, said: str, convention: str) -> None:
        text = fcsv(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), said)
        file = read(tmp_path, text, "in.fcsv")
        np.testing.assert_array_equal(file.points, [[1, 2, 3], [4, 5, 6]])
        assert (file.convention, file.labels, file.kind) == (convention, ("F-0", "F-1"), "fcsv")
        out = rewritten(tmp_path, file, [[1, 2, 3.5], [4, 5, 6]], notes=("error_mm", np.full(2, 9.0)))
        assert out == text.replace("3.0,0,", "3.5,0,")

    def test_old_files(self, tmp_path: Path) -> None:
        text = "# Fiducial List file F.fcsv\n# numPoints = 1\n# columns = label,x,y,z,sel,vis\nF1,-1,2,3,1,1\n"
        file = read(tmp_path, text, "in.fcsv")
        np.testing.assert_array_equal(file.points, [[-1, 2, 3]])
        assert file.convention == "RAS"
        file = read(tmp_path, "F1,-1,2,3,1,1\n", "in.fcsv")
        np.testing.assert_array_equal(file.points, [[-1, 2, 3]])


class TestSlicersMarkups:
    def test_several_with_what_is_not_placed(self, tmp_path: Path) -> None:
        one, two = markup(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])), markup(np.array([[7.0, 8.0, 9.0]]), "RAS")
        one["controlPoints"][0].update(positionStatus="undefined", position=None)
        del two["controlPoints"][0]["positionStatus"]
        file = read(tmp_path, markups(one, two), "in.mrk.json")
        assert (file.convention, file.labels) == ("LPS", ("F-1", "F-0"))
        np.testing.assert_array_equal(file.points, [[4, 5, 6], [-7, -8, 9]])
        found = json.loads(rewritten(tmp_path, file, [[4, 5.5, 6], [-7, -8.25, 9.5]]))
        one["controlPoints"][1]["position"] = [4.0, 5.5, 6.0]
        two["controlPoints"][0]["position"] = [7.0, 8.25, 9.5]
        assert found == json.loads(markups(one, two))

    def test_what_is_derived_is_left_out(self, tmp_path: Path) -> None:
        points = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0, 9.0, 1.0]])
        length = {"name": "length", "enabled": True, "units": "mm", "value": 5.0, "printFormat": "%-#4.4g%s"}
        line = markup(points[:2]) | {"type": "Line", "measurements": [length]}
        plane = markup(points + 50) | {"type": "Plane", "planeType": "3points", "sizeMode": "auto", "size": [9, 9, 0]}
        plane |= {"normal": [0, 0, 1], "center": [1, 1, 1], "baseToNode": [1.0] * 16, "measurements": [length]}
        file = read(tmp_path, markups(line, plane), "in.mrk.json")
        made = json.loads(rewritten(tmp_path, file, file.points + np.eye(5, 3) * [9, 0, 0]))["markups"]
        assert made[0]["measurements"] == [{k: v for k, v in length.items() if k != "value"}]
        assert made[1] == plane  # which has not moved
        made = json.loads(rewritten(tmp_path, file, file.points + 1))["markups"]
        assert not {"normal", "center", "baseToNode", "size"} & set(made[1])
        file = read(tmp_path, markups(line, markup(points[:1]) | {"type": "Plane", "normal": [0, 0, 1]}), "in.mrk.json")
        assert json.loads(rewritten(tmp_path, file, file.points))["markups"][1]["normal"] == [0, 0, 1]
        told = refused(rewritten, tmp_path, file, file.points + 1)
        assert "markup 2 is a Plane of a point and a normal: make it one of three points" in told
        region = markup(points[:1]) | {"type": "ROI", "center": [0.0, 0.0, 0.0], "size": [4.0, 6.0, 8.0]}
        file = read(tmp_path, markups(region), "in.mrk.json")
        assert json.loads(rewritten(tmp_path, file, file.points))["markups"] == [region]
        assert "markup 1 is a region (ROI): mark its corners by" in refused(rewritten, tmp_path, file, file.points + 1)

    def test_the_layout_stays(self, tmp_path: Path) -> None:
        slicers = (
            '{\n    "markups": [\n        {\n            "type": "Line",\n            "controlPoints": [\n'
            '                {\n                    "label": "é [\\n1 ]",\n'
            '                    "position": [1.0, -0.0, 3.0],\n                    "associated": []\n'
            "                }\n            ]\n        }\n    ]\n}\n"
        )
        broken = json.dumps(json.loads(slicers), indent=2, ensure_ascii=False)
        for text in (slicers, broken):
            file = read(tmp_path, text, "in.mrk.json")
            assert file.convention == "LPS"
            assert rewritten(tmp_path, file, file.points) == text
            assert rewritten(tmp_path, file, [[1, 0, 2.5]]) == text.replace("3.0", "2.5")


LIMITS = "a number from -1e+30 to 1e+30"
POINT = '{"position": [1, 2, 3]}'


class TestWhatCannotBeRead:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "it is empty: give a .csv, .tsv, .txt, .fcsv or .mrk.json file"),
            (" \n\n", "it is empty: give a .csv, .tsv, .txt, .fcsv or .mrk.json file"),
            ("# x,y\n", "it holds no points: give one in each line, x first"),
            ("x,y\n", "it holds no points: give one in each line, below the header"),
            (
                "label,remark\na,b\n",
                "line 1: neither are there numbers, nor names of columns x and y: "
                "name them in the first line, with , ; or tabs between",
            ),
            ("# c\n\nid,x\n1,2\n", "line 3: neither are there numbers, nor names of columns x and y: "),
            ("a,1\nb,2\n", "line 1: only one cell is a number: give x and y, and z or t for volumes and videos"),
            ("x,y,x\n1,2,3\n", "line 1: several columns are named x: leave the name to one"),
            ("x,y\n1,2\n3,4,5\n", "line 3: it has 3 cells: give 2"),
            ("x,y\n# c\n1\n", "line 3: it has 1 cell: give 2"),
            ("1,2\n\n3,b\n", f"line 3: cell 2 is 'b': a coordinate is {LIMITS}"),
            ("x,y\n1,\n", f"line 2: cell 2 is '': a coordinate is {LIMITS}"),
            ("x;y\n1;2,5\n", f"line 2: cell 2 is '2,5': a coordinate is {LIMITS}"),
            ("x,y\nnan,1\n", f"line 2: cell 1 is 'nan': a coordinate is {LIMITS}"),
            ("1,inf\n", f"line 1: cell 2 is 'inf': a coordinate is {LIMITS}"),
            ("1,1e31\n", f"line 1: cell 2 is '1e31': a coordinate is {LIMITS}"),
            ('x,y,n\n1,2,a\n3,4,"b\n5,6,c\n', "line 3: a quote is not closed: close it"),
            ("# CoordinateSystem = MNI\n1,2,3\n", "line 1: the coordinate system 'MNI' is unknown: give LPS or RAS"),
            ("x,y\0\n", "it is no text in UTF-8: save it as that"),
        ],
    )
    def test_tables(self, tmp_path: Path, text: str, message: str) -> None:
        (tmp_path / "in.csv").write_text(text)
        said = refused(read_points, tmp_path / "in.csv")
        assert said.startswith(f"cannot read {tmp_path}/in.csv: {message}")
        assert message.endswith(": ") or said.endswith(message)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("# columns = id,x,y\nF,1,2\n", "line 1: the columns are not x, y and z: name them so"),
            ("# columns = id,r,c\nF,1,2\n", "line 1: the columns are not x, y and z: name them so"),
            ("F,1,2\n", "line 1: it has 3 cells: give 4"),
            ("F,1,2,c\n", f"line 1: cell 4 is 'c': a coordinate is {LIMITS}"),
            ("# CoordinateSystem = 7\nF,1,2,3\n", "line 1: the coordinate system '7' is unknown: give LPS or RAS"),
            ("# CoordinateSystem = LPS\n", "it holds no points: give one in each line, x first"),
        ],
    )
    def test_slicers_lists(self, tmp_path: Path, text: str, message: str) -> None:
        (tmp_path / "in.fcsv").write_text(text)
        assert refused(read_points, tmp_path / "in.fcsv") == f"cannot read {tmp_path}/in.fcsv: {message}"

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('{\n"markups": [}', "it is damaged, or no list of markups (Expecting value: line 2"),
            ("[" * 200_000, "it is damaged, or no list of markups ("),
            ("[1]", "it is damaged, or no list of markups ("),
            ('{"markups": []}', "it holds no points that are placed: place some"),
            ('{"markups": [{"controlPoints": []}]}', "it holds no points that are placed: place some"),
            ('{"markups": [3]}', "markup 1: it is damaged"),
            (f'{{"markups": [{{"controlPoints": [{POINT}]}}, {{"type": "Line"}}]}}', "markup 2: it is damaged"),
            ('{"markups": [{"coordinateSystem": "XYZ", "controlPoints": []}]}', "markup 1: it is damaged"),
            ('{"markups": [{"coordinateSystem": {}, "controlPoints": []}]}', "markup 1: it is damaged"),
            ('{"markups": [{"coordinateUnits": "m", "controlPoints": []}]}', "markup 1: it is damaged"),
            ('{"markups": [{"controlPoints": [7]}]}', "markup 1: it is damaged"),
            (f'{{"markups": [{{"controlPoints": [{POINT}, {{}}]}}]}}', "markup 1: it is damaged"),
            *(
                (f'{{"markups": [{{"controlPoints": [{{"position": {bad}}}]}}]}}', "markup 1: it is damaged")
                for bad in ("[1, 2]", "[1, NaN, 2]", "[1, 2, Infinity]", "null")
            ),
        ],
    )
    def test_slicers_markups(self, tmp_path: Path, text: str, message: str) -> None:
        (tmp_path / "in.mrk.json").write_text(text)
        assert refused(read_points, tmp_path / "in.mrk.json").startswith(
            f"cannot read {tmp_path}/in.mrk.json: {message}"
        )

    def test_no_files(self, tmp_path: Path) -> None:
        (tmp_path / "folder.csv").mkdir()
        give = "give a .csv, .tsv, .txt, .fcsv or .mrk.json file"
        for name, message in {
            "none.csv": "No such file or directory: check the name and its rights",
            "folder.csv": f"it is a folder or no plain file: {give}",
            "a\0b.csv": "no file can have that name: check it",
            "a.xlsx": f"the suffix .xlsx is of no file of points: {give}",
            "a": f"a name without suffix is of no file of points: {give}",
        }.items():
            assert refused(read_points, tmp_path / name).endswith(f": {message}")
