"""Tracks of each kind of file, against values written by hand; and what is wrong with a file, in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from supple import SuppleError
from supple.media.tracks import Track, read_tracks
from tests.refusals import refused

AE = """Adobe After Effects 8.0 Keyframe Data

\tUnits Per Second\t25
\tSource Width\t64
\tSource Height\t48
\tSource Pixel Aspect Ratio\t1
\tComp Pixel Aspect Ratio\t1

Transform\tAnchor Point
\tFrame\tX pixels\tY pixels\tZ pixels\t
\t0\t1\t2\t0\t

Transform\tPosition
\tFrame\tX pixels\tY pixels\tZ pixels\t
\t0\t32\t24\t0\t
\t3\t34.5\t22\t0\t

Transform\tScale
\tFrame\tX percent\tY percent\tZ percent\t
\t0\t100\t100\t100\t

Effects\tCorner Pin #1\tUpper Left #2
\tFrame\tX pixels\tY pixels\t
\t1\t0.5\t0.5\t

Motion Trackers\tTracker #1\tTrack Point #1\tAttach Point #4
\tFrame\tX pixels\tY pixels\t
\t0\t10\t11\t
\t1\t12\t13\t

End of Keyframe Data
"""

NUKE = """set cut_paste_input [stack 0]
Tracker4 {
 tracks { { 1 31 2 }
 { { 5 1 20 enable e 1 }
 { 3 1 75 name name 1 }
 { 2 1 58 track_x track_x 1 }
 { 2 1 58 track_y track_y 1 } }
 { { {curve K x1 1} "left eye" {curve x1 10.5 11.5 x5 20.5 21.5} {curve x1 40.5 39.5 x5 30.5 29.5} {curve K x1 0} 0 }
   { {curve K x1 1} "right eye" {curve x1 1} {curve x1 2} {curve K x1 0} 0 } } }
 center {{curve x1 3 4} {curve x1 5 6}}
}
CornerPin2D {
 to1 {{curve K x1 0.5 s0 x2 1.5 t1} {curve i x1 47.5 x2 46.5}}
 from1 {0 0}
}
"""


def write(name: str, text: str) -> Path:
    path = Path(name)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "frame,x,y\n0,10,20\n2,12.5,-3\n",
        "\ufeffFrame;X;Y\r\n0;10;20\r\n2;12.5;-3\r\n",
        "# a comment\n\ny\tx\tframe\n-3\t12.5\t2\n20\t10\t0\n",
        'frame x y name\n0 10 20 ""\n2 1.25e1 -3 ""\n',
    ],
)
def test_a_table_with_a_header_is_in_pixels(text: str) -> None:
    assert read_tracks(write("a.csv", text)) == (Track("", ((0, (10, 20)), (2, (12.5, -3)))),)


def test_a_table_may_hold_several_tracks_and_begin_at_any_frame() -> None:
    path = write("a.csv", "name,frame,x,y\nnose,1001,1,2\near,1001,3,4\nnose,1003,5,6\n")
    nose, ear = read_tracks(path, first=1001)
    assert nose == Track("nose", ((0, (1, 2)), (2, (5, 6))))
    assert ear == Track("ear", ((0, (3, 4)),))


def test_a_table_without_a_header_is_asked_about() -> None:
    path = write("track.ascii", "1 32 24\n2 33 23.5\n")
    with pytest.raises(SuppleError, match=r"does not say from where its pixels count: say whether .*--track-from"):
        read_tracks(path)
    assert read_tracks(path, convention="pixels")[0].keys == ((1, (32, 24)), (2, (33, 23.5)))
    # The centre of a frame of 64 x 48 is (32, 24) in both, and (31.5, 23.5) where pixel centres are whole numbers.
    assert read_tracks(path, convention="nuke", height=48)[0].keys == ((0, (31.5, 23.5)), (1, (32.5, 24)))
    assert read_tracks(path, convention="ae")[0].keys == ((1, (31.5, 23.5)), (2, (32.5, 23)))
    with pytest.raises(SuppleError, match="y points up in Nuke, from the lower edge: give the height of the frames"):
        read_tracks(path, convention="nuke")


def test_keyframes_of_after_effects() -> None:
    tracks = {track.name: track.keys for track in read_tracks(write("a.txt", AE))}
    assert tracks == {
        "Position": ((0, (31.5, 23.5)), (3, (34, 21.5))),
        "Corner Pin #1 Upper Left #2": ((1, (0, 0)),),  # the centre of the top left pixel
        "Tracker #1 Track Point #1 Attach Point #4": ((0, (9.5, 10.5)), (1, (11.5, 12.5))),
    }


def test_scripts_of_nuke() -> None:
    tracks = {track.name: track.keys for track in read_tracks(write("a.nk", NUKE), height=lambda: 48)}
    assert tracks == {
        "left eye": ((0, (10, 7)), (1, (11, 8)), (4, (20, 17)), (5, (21, 18))),
        "right eye": ((0, (0.5, 45.5)),),
        "to1": ((0, (0, 0)), (1, (1, 1))),
    }
    (copied,) = read_tracks(write("b.txt", "{{curve x10 1.5 2.5} {curve x10 47.5 46.5}}"), height=48, first=10)
    assert copied == Track("track", ((0, (1, 0)), (1, (2, 1))))


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("\n\n", "it holds no tracks: give a table frame,x,y"),
        ("frame,x,y\n", "it has a header alone"),
        ("time,x,y\n1,2,3\n", "line 1: its columns are 'time, x, y', without one named frame"),
        ("frame,x,x,y\n1,2,3,4\n", "without one named x"),
        ("frame,x,y\n1,2\n", "line 2: it has 2 columns: give 3, as the first line has"),
        ("1,2\n", "line 1: it has 2 columns: give frame, x, y, or a name besides"),
        ("frame,x,y\n1,2,left\n", "line 2: y is 'left': give a number"),
        ("frame,x,y\n1,2,nan\n", "line 2: y is 'nan': give a number"),
        ("frame,x,y\n1,inf,2\n", "line 2: x is inf: give a finite number"),
        ("frame,x,y\n1.5,2,3\n", "line 2: the frame is 1.5: give a whole number"),
        ("frame,x,y\n1,2,3\n1,2,4\n", "line 3: frame 1 is there twice in one track"),
        (AE.split("\n\nTransform\tPosition")[0] + "\n\nEnd of Keyframe Data\n", "none of its keyframes are positions"),
        (AE.replace("End of Keyframe Data\n", ""), "it breaks off before End of Keyframe Data"),
        (AE.replace("34.5\t22", "34.5"), "line 16: it is "),
        ("{{curve x1 1 2} {curve x1 1}}", "track 'track': x has 2 keys, and y 1, of other frames"),
        ("{{curve 1 2} {curve x1 1}}", "track 'track': its curve has a value without a frame"),
        ("rotate {{curve x1 1}}", "none of its curves are of points"),
        ("a\0b", "it is no text"),
        ("", "it is empty"),
    ],
)
def test_what_is_wrong_is_one_line(text: str, wanted: str) -> None:
    path = write("a.txt", text)
    told = refused(read_tracks, path, height=48)
    assert wanted in told
    assert told.startswith("cannot read a.txt: ")


def test_a_convention_that_is_not_that_of_the_file_is_refused() -> None:
    with pytest.raises(SuppleError, match="its positions are those of ae, and nuke was asked for: leave that out"):
        read_tracks(write("a.txt", AE), convention="nuke", height=48)
    wrong: Any = "blender"
    with pytest.raises(SuppleError, match='convention must be "pixels" or "nuke" or "ae"'):
        read_tracks(write("a.txt", AE), convention=wrong)
    with pytest.raises(SuppleError, match=r"cannot read none\.csv: No such file"):
        read_tracks("none.csv")
