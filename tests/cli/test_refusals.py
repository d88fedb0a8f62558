"""What the command line cannot do is one line, before any work."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest

import supple
from supple.media import image
from tests.cli.commands import GRAB, Run, noise, one_line


@pytest.mark.parametrize("text", ["130%", "-1", "nan", "some", "", "%"])
def test_a_wrong_amount_is_one_line(run: Run, text: str) -> None:
    status, out, err = run("warp", "in.png", "out.png", *GRAB, f"--amount={text}")
    assert (status, out) == (2, "")
    assert one_line(err).startswith("supple: --amount must be a part of the strokes, from 0% to 100%, or from 0 to 1, ")


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["warp", "in.png", "x.png", *GRAB, "--gpu"], "--device gpu is for render and demo"),
        (["warp", "in.png", "x.png", *GRAB, "--device", "gpu"], "give cpu, cuda (for an NVIDIA GPU) or auto"),
        (["plot", "in.png", "x.png", *GRAB, "--device", "gpu"], "is for warp, render and demo"),
        (["info", "in.png", "--device", "gpu"], "is for warp, render and demo"),
    ],
)
def test_options_of_devices_are_not_taken_for_others(run: Run, arguments: list[str], wanted: str) -> None:
    status, _, err = run(*arguments)
    assert status == 2
    assert wanted in one_line(err)
    assert "Did you mean" not in err


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ([], "--grab X,Y:X,Y"),
        (["--grab", "1,2:3,4"], "--radius"),
        (["--grab"], "--grab"),
        (["--radius", "5"], "--grab"),
        (["--grab", "1,2", "--radius", "5"], "X,Y:X,Y"),
        (["--grab", "1,2:3", "--radius", "5"], "X,Y:X,Y"),
        (["--grab", "1,2:3,4:5,6,7", "--radius", "5"], "X,Y:X,Y"),
        (["--grab", "a,b:c,d", "--radius", "5"], "X,Y:X,Y"),
        (["--grab", "", "--radius", "5"], "X,Y:X,Y"),
        (["--grab", "1,2:3,4\n5", "--radius", "5"], "X,Y:X,Y"),
        (["--grab", "nan,2:3,4", "--radius", "5"], "nan"),
        (["--grab", "1,2:inf,4", "--radius", "5"], "inf"),
        (["--grab", "1,2,3:4,5,6", "--radius", "5"], "2 numbers"),
        (["--grab", "1,2:3,4", "--radius", "nan"], "nan"),
        (["--grab", "1,2:3,4", "--radius", "inf"], "inf"),
        (["--grab", "1,2:3,4", "--radius", "0"], "above 0"),
        (["--grab", "1,2:3,4", "--radius", "-5"], "above 0"),
        (["--grab", "1,2:3,4", "--radius", "abc"], "abc"),
        (["--grab", "1,2:3,4", "--radius"], "--radius"),
        (["--grab", "1,2:3,4", "--radius", "5", "--radius", "6"], "2 times"),
        ([*GRAB, "--poisson", "0.51"], "0.5"),
        ([*GRAB, "--poisson", "nan"], "nan"),
        ([*GRAB, "--scales", "4"], "1, 2 or 3"),
        ([*GRAB, "--scales", "1.5"], "1, 2 or 3"),
        ([*GRAB, "--reach", "0.5"], "reach must be a number of radii from 1"),
        ([*GRAB, "--reach", "nan"], "nan"),
        ([*GRAB, "--reach", "far"], "--reach must be a number of radii from 1, or none, found 'far'"),
        ([*GRAB, "--reach", "4", "--reach", "none"], "2 times"),
        ([*GRAB, "--border-profile", "cubic"], "cubic"),
        ([*GRAB, "--border", "thin"], "thin"),
        ([*GRAB, "--border", "-1"], "border"),
        ([*GRAB, "--on-fold", "pray"], "pray"),
        ([*GRAB, "--filter", "magic"], "magic"),
        ([*GRAB, "--outside", "void"], "void"),
        ([*GRAB, "--fill", "red"], "red"),
        ([*GRAB, "--fill", "1,2"], "fill"),
        ([*GRAB, "--tolerance", "0"], "tolerance"),
        ([*GRAB, "--tolerance", "nan"], "tolerance"),
        ([*GRAB, "--quality", "0"], "quality"),
        ([*GRAB, "--quality", "x"], "quality"),
        ([*GRAB, "--threads", "0"], "--threads"),
        ([*GRAB, "--nope"], "--nope"),
        ([*GRAB, "--recipe", "none.json"], "none.json"),
        ([*GRAB, "--save-recipe", "missing/r.json"], "missing"),
        ([*GRAB, "--save-recipe", "out.png"], "out.png"),
        ([*GRAB, "--filter"], "--filter"),
    ],
)
def test_a_malformed_request_is_one_line(run: Run, options: Sequence[str], wanted: str) -> None:
    status, out, err = run("warp", "in.png", "out.png", *options)
    assert (status, out) == (2, "")
    assert wanted in one_line(err)
    assert os.listdir() == ["in.png"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["wrap"],
        ["warp"],
        ["warp", "in.png", *GRAB],
        ["--nope"],
        ["info"],
        ["plot", "in.png"],
        ["info", "--nope", "in.png"],
    ],
)
def test_a_malformed_command_is_one_line(run: Run, arguments: Sequence[str]) -> None:
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    one_line(err)


@pytest.mark.parametrize("name", ["missing", "empty", "text", "cut", "folder", "cut jpeg"])
def test_what_is_no_picture_is_one_line(run: Run, name: str) -> None:
    whole = Path("in.png").read_bytes()
    made = {"empty": b"", "text": b"hello " * 99, "cut": whole[: len(whole) // 2]}
    if name == "cut jpeg":
        image.write("whole.jpg", noise(60, 60))
        made[name] = Path("whole.jpg").read_bytes()[:900]
    if name in made:
        Path(name).write_bytes(made[name])
    elif name == "folder":
        Path(name).mkdir()
    before = sorted(os.listdir())
    for arguments in (["warp", name, "out.png", *GRAB], ["plot", name, "out.png", *GRAB]):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert name in one_line(err)
        assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    ("target", "wanted"),
    [
        ("out.xyz", ".xyz"),
        ("out", "suffix"),
        ("none/out.png", "none"),
        ("in.png/out.png", "in.png"),
        ("taken.png", "--force"),
        ("in.png", "--force"),
        ("link.png", "--force"),
        ("a\0b.png", "name"),
        ("x" * 300 + ".png", "xxx"),
        ("", "name a file"),
        ("/proc/out.png", "/proc"),
    ],
)
def test_what_cannot_be_written_is_one_line_before_any_work(
    run: Run, monkeypatch: pytest.MonkeyPatch, target: str, wanted: str
) -> None:
    Path("taken.png").write_bytes(b"precious")
    Path("link.png").symlink_to("in.png")
    kept = Path("in.png").read_bytes()
    if target != "/proc/out.png":  # whether that can be written is only found out by writing
        monkeypatch.setattr("supple.files.pictures.read", lambda path: pytest.fail("it was read"))
    status, out, err = run("warp", "in.png", target, *GRAB)
    assert (status, out) == (2, "")
    assert wanted in one_line(err)
    assert Path("taken.png").read_bytes() == b"precious"
    assert Path("in.png").read_bytes() == kept
    assert sorted(os.listdir()) == ["in.png", "link.png", "taken.png"]


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_a_folder_without_rights_is_one_line(run: Run) -> None:
    Path("shut").mkdir(mode=0o555)
    status, out, err = run("warp", "in.png", "shut/out.png", *GRAB)
    assert (status, out) == (2, "")
    assert "shut/out.png" in one_line(err)


def test_a_picture_is_replaced_with_force_through_a_link_too(run: Run) -> None:
    Path("link.png").symlink_to("in.png")
    before = Path("in.png").read_bytes()
    assert run("warp", "in.png", "link.png", *GRAB, "--force") == (0, "", "")
    assert Path("link.png").is_symlink()
    assert Path("in.png").read_bytes() != before
    assert sorted(os.listdir()) == ["in.png", "link.png"]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "JSON"),
        ("[]", "object"),
        ('{"strokes": []}', "supple"),
        ('{"supple": 4, "strokes": []}', "version"),
        ('{"supple": "1", "strokes": []}', "version"),
        ('{"supple": 1, "strokes": [], "boarder": 3}', "boarder"),
        ('{"supple": 1, "strokes": 7}', "strokes"),
        ('{"supple": 1, "strokes": [{"brush": "grab", "at": [1, 2], "by": [1, 1], "radius": "5"}]}', "radius"),
        ('{"supple": 1, "strokes": [{"brush": "grab", "at": [1, 2], "by": [1, 1], "radius": 5, "p": 1}]}', "p"),
        ('{"supple": 1, "strokes": [{"brush": "grab", "at": [1, 2, 3], "by": [1, 1, 1], "radius": 5}]}', "2 numbers"),
        ('{"supple": 1, "strokes": [NaN]}', "NaN"),
        ("\udcff", "text"),
    ],
)
def test_a_wrong_recipe_is_one_line(run: Run, text: str, wanted: str) -> None:
    Path("r.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    status, out, err = run("warp", "in.png", "out.png", "--recipe", "r.json")
    assert (status, out) == (2, "")
    assert wanted in one_line(err)
    assert sorted(os.listdir()) == ["in.png", "r.json"]


def test_recipes_are_not_overwritten(run: Run) -> None:
    Path("r.json").write_text("precious")
    status, _, err = run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json")
    assert status == 2
    assert "--force" in one_line(err)
    assert Path("r.json").read_text() == "precious"
    assert not Path("out.png").exists()
    assert run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json", "--force")[0] == 0
    assert supple.Recipe.from_json(Path("r.json").read_text()).strokes


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["warp"], "give the files: supple warp IN... OUT --grab"),
        (["convert", "x.nii"], "give the files: supple convert IN OUT [--from NAME]"),
        (["points", "a.csv", "b.csv"], "give --on FILE"),
        (["warp", "in.png", "x.png", "--radius"], "--radius needs a value after it"),
        (["plan", "in.png", "out.zarr"], "more names than this command takes: leave out 'out.zarr'"),
        (
            ["wrap", "in.png"],
            'Unknown command "wrap". Did you mean "warp"? The commands are warp, plot, render, points,',
        ),
        (["frob"], "plan, info, view, invert, check, compose, convert, demo (supple --help"),
        (["--versio"], 'Unknown option "--versio"'),
        (["warp", "in.png", "x.png", *GRAB, "--border", "none,3"], "for each axis, found 'none,3'"),
        (
            ["warp", "in.png", "x.png", "--grab", "9,9:12,9", "--grab", "9,9,1:12,9,1", "--radius", "5"],
            "--grab 9,9,1:12,9,1 has points of 3 numbers, and --grab 9,9:12,9 of 2: give all strokes as many",
        ),
    ],
)
def test_what_is_missing_or_too_much_is_said_in_plain_words(run: Run, arguments: list[str], told: str) -> None:
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert told in one_line(err)
    assert not Path("x.png").exists()
