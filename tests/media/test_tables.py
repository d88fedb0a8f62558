"""Tables of points, in which nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from supple.media.points import read_points, write_points
from tests.media.landmarks import read, rewritten


class TestTables:
    @pytest.mark.parametrize(
        ("text", "points", "convention", "labels"),
        [
            ("x,y\n1,2\n3.5,-4e1\n", [[1, 2], [3.5, -40]], "index", ("", "")),
            ("label,X,Y,Z\na,1,2,3\n", [[1, 2, 3]], "index", ("a",)),
            ('"name";"z";"y (mm)";"x"\r\n"a;b";3;2;1\r\n', [[1, 2, 3]], "index", ("a;b",)),
            ("# a note\nname,x,y\nb,1,2\n", [[1, 2]], "index", ("b",)),
            ("id\tpos_x\ty_pos\tt\n7\t1\t2\t3", [[1, 2, 3]], "index", ("7",)),
            ("x,y,z,t,label\n1,2,3,0,a\n", [[1, 2, 3]], "index", ("a",)),
            ("frame,y,x\n3,2,1\n", [[1, 2, 3]], "index", ("",)),
            ("label,r,a,s,defined\na,1,2,3,1\n", [[1, 2, 3]], "RAS", ("a",)),
            ("label,l,p,s\na,1,2,3\n", [[1, 2, 3]], "LPS", ("a",)),
            ("k,j,i\n3,2,1\n", [[1, 2, 3]], "index", ("",)),
            ("a,1,2,3,4\nb,5,6,7,8\n", [[1, 2, 3], [5, 6, 7]], "index", ("", "")),
            ("1;2\n", [[1, 2]], "index", ("",)),
            ("# of a head\n\n# x,y,who\n1,2,me\n\n# end\n3,4,you\n", [[1, 2], [3, 4]], "index", ("", "")),
            ("# id,z,y,x\n9,3,2,1\n", [[1, 2, 3]], "index", ("9",)),
            ("# CoordinateSystem = LPS\nx,y,z\n1,2,3\n", [[1, 2, 3]], "LPS", ("",)),
            ("\ufeffx,y\n1,2\n", [[1, 2]], "index", ("",)),
            ("\ufeff1,2\n", [[1, 2]], "index", ("",)),
            ('x,y,note\n1,2,"two\nlines, and ""quotes"""\n3,4,\n', [[1, 2], [3, 4]], "index", ("", "")),
            ("x,y,x_mm,y_mm\n1,2,10,20\n", [[1, 2]], "index", ("",)),
        ],
    )
    def test_of_many_kinds(
        self, tmp_path: Path, text: str, points: list[list[float]], convention: str, labels: tuple[str, ...]
    ) -> None:
        file = read(tmp_path, text)
        np.testing.assert_array_equal(file.points, points)
        assert (file.convention, file.labels, file.kind) == (convention, labels, "CSV")
        assert rewritten(tmp_path, file, file.points) == text

    def test_only_what_moved_is_written_anew(self, tmp_path: Path) -> None:
        text = '\ufeff# a, "b\r\n"id";"x"; "y";z \r\n1;" 1.50";2.0;0x\r\n\r\nb;3;+4;"é"\n'
        file = read(tmp_path, text.replace("z ", "note").replace("0x", "x, y"))
        out = rewritten(tmp_path, file, [[1.5, 0.1], [1 / 3, 4]])
        assert out == '\ufeff# a, "b\r\n"id";"x"; "y";note\r\n1;" 1.50";0.1;x, y\r\n\r\nb;0.3333333333333333;+4;"é"\n'

    def test_notes(self, tmp_path: Path) -> None:
        for text, expected in {
            "x,y\n1,2\n3,4": "x,y,error_mm\n1,2,0.5\n3,4,1.23e-07",
            "x;Error_mm;y\n1;old;2\n3;;4\n": "x;Error_mm;y\n1;0.5;2\n3;1.23e-07;4\n",
            "# x\ty\n1\t2\n3\t4\n": "# x\ty\terror_mm\n1\t2\t0.5\n3\t4\t1.23e-07\n",
            "1,2\r\n# c\r\n3,4\r\n": "1,2,0.5\r\n# c\r\n3,4,1.23e-07\r\n",
        }.items():
            file, notes = read(tmp_path, text), ("error_mm", np.array([0.5, 1.2345e-7]))
            assert rewritten(tmp_path, file, file.points, notes=notes) == expected

    def test_bytes_that_are_not_utf8_come_through(self, tmp_path: Path) -> None:
        (tmp_path / "in.csv").write_bytes(b"name,x,y\nM\xfcller,1,2\n")
        write_points(tmp_path / "out.csv", [[3, 2]], read_points(tmp_path / "in.csv"))
        assert (tmp_path / "out.csv").read_bytes() == b"name,x,y\nM\xfcller,3.0,2\n"
