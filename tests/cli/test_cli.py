"""The command line: what it does, and how it ends when it cannot."""

from __future__ import annotations

import json
import os
import pty
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import supple
from supple.cli import command, console
from supple.cli.console import Console
from supple.cli.jobs import Crew, Job
from supple.gpu.device import Gpu
from supple.media import image
from tests import clips
from tests.children import HEARING, SOURCE

GRAB = ("--grab", "20,16:23,18", "--radius", "12")
Said = tuple[int, str, str]
Run = Callable[..., Said]


def noise(height: int, width: int, channels: int = 3, dtype: type = np.uint8) -> npt.NDArray[np.uint8]:
    rng = np.random.default_rng(height * 1000 + width)
    top = np.iinfo(dtype).max + 1
    shape = (height, width, channels) if channels > 1 else (height, width)
    return rng.integers(0, top, shape, dtype=dtype)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with one picture, in which commands run."""
    monkeypatch.chdir(tmp_path)
    image.write("in.png", noise(40, 48))
    return tmp_path


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process."""

    def run(*arguments: str) -> Said:
        capsys.readouterr()
        status = command(arguments)
        out, err = capsys.readouterr()
        return status, out, err

    return run


def start(*arguments: str, **options: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "supple", *arguments],
        env={**os.environ, "PYTHONPATH": SOURCE},
        stdout=options.pop("stdout", subprocess.PIPE),
        stderr=subprocess.PIPE,
        encoding="utf-8",
        preexec_fn=options.pop("preexec_fn", HEARING),
        **options,
    )


def finish(process: subprocess.Popen[str]) -> Said:
    out, err = process.communicate(timeout=300)
    return process.returncode, out or "", err


def one_line(text: str) -> str:
    assert text.startswith("supple: "), text
    assert text.count("\n") == 1, text
    assert text.endswith("\n")
    assert "Traceback" not in text
    return text


def test_it_does_what_the_library_does(run: Run) -> None:
    status, out, err = run("warp", "in.png", "out.png", *GRAB, "--scales", "2", "--border", "10")
    assert (status, out, err) == (0, "", "")
    pixels = image.read("in.png").pixels
    d = supple.Deformation((40, 48), border=10).grab((20, 16), to=(23, 18), radius=12, scales=2)
    np.testing.assert_array_equal(image.read("out.png").pixels, d.warp(pixels))


@pytest.mark.parametrize(
    ("options", "strokes"),
    [
        (
            ["--grab", "-3,4.5:10,20", "--radius", "30"],
            [((-3, 4.5), (13, 15.5), 30.0, None, 1)],
        ),
        (
            ["--grab=-3,-4:1e1,2", "--radius=30", "--poisson", "-inf"],
            [((-3, -4), (13, 6), 30.0, -np.inf, 1)],
        ),
        (
            ["--grab", "1,2:3,4", "--grab", "5,6:7,8", "--radius", "9", "--poisson", "-1", "--scales", "3"],
            [((1, 2), (2, 2), 9.0, -1.0, 3), ((5, 6), (2, 2), 9.0, -1.0, 3)],
        ),
        (
            [
                "--grab",
                "1,2:3,4",
                "--radius",
                "9",
                "--scales",
                "1",
                "--grab",
                "5,6:7,8",
                "--radius",
                "8",
                "--scales",
                "2",
            ],
            [((1, 2), (2, 2), 9.0, None, 1), ((5, 6), (2, 2), 8.0, None, 2)],
        ),
    ],
)
def test_what_is_asked_for_is_what_is_saved(run: Run, options: Sequence[str], strokes: Sequence[tuple]) -> None:  # type: ignore[type-arg]
    assert run("warp", "in.png", "out.png", *options, "--save-recipe", "r.json", "--quiet")[0] == 0
    recipe = supple.Recipe.from_json(Path("r.json").read_text())
    assert [(s.at, s.by, s.radius, s.poisson, s.scales) for s in recipe.strokes] == strokes
    assert (recipe.border, recipe.on_fold) == ("auto", "flow")


def test_reach_and_border_profile_are_saved(run: Run) -> None:
    grabs = ["--grab", "1,2:3,4", "--grab", "5,6:7,8", "--radius", "9"]
    for given, reaches in [
        ([], [4.0, 4.0]),
        (["--reach", "2"], [2.0, 2.0]),
        (["--reach", "none", "--reach", "2.5"], [None, 2.5]),
    ]:
        made = run("warp", "in.png", "out.png", *grabs, *given, "--save-recipe", "r.json", "--quiet", "--force")
        assert made[0] == 0
        recipe = supple.Recipe.from_json(Path("r.json").read_text())
        assert [s.reach for s in recipe.strokes] == reaches
        assert recipe.border_profile == "quartic"
    more = ["--recipe", "r.json", "--border-profile", "sine", "--save-recipe", "s.json", "--quiet", "--force"]
    assert run("warp", "in.png", "out.png", *more)[0] == 0
    again = supple.Recipe.from_json(Path("s.json").read_text())
    assert (again.border_profile, again.strokes) == ("sine", recipe.strokes)


def test_a_recipe_makes_the_same_file_again(run: Run) -> None:
    options = ["--border", "none", "--on-fold", "flow", "--poisson", "0.25"]
    first = run("warp", "in.png", "out.png", *GRAB, *options, "--save-recipe", "r.json")
    assert first == (0, "", "")
    assert run("warp", "in.png", "again.png", "--recipe", "r.json") == (0, "", "")
    assert Path("out.png").read_bytes() == Path("again.png").read_bytes()


def test_grabs_come_after_those_of_a_recipe_and_options_override_it(run: Run) -> None:
    run("warp", "in.png", "out.png", *GRAB, "--border", "7", "--on-fold", "flow", "--save-recipe", "r.json")
    more = ["--recipe", "r.json", "--grab", "1,2:3,4", "--radius", "5"]
    assert run("warp", "in.png", "b.png", *more, "--save-recipe", "kept.json")[0] == 0
    kept = supple.Recipe.from_json(Path("kept.json").read_text())
    assert [s.at for s in kept.strokes] == [(20, 16), (1, 2)]
    assert (kept.border, kept.on_fold) == (7, "flow")
    changed = ["--border", "none", "--on-fold", "damp", "--save-recipe", "changed.json"]
    assert run("warp", "in.png", "c.png", *more, *changed)[0] == 0
    recipe = supple.Recipe.from_json(Path("changed.json").read_text())
    assert (recipe.border, recipe.on_fold) == (None, "damp")


def saved(name: str = "r.json") -> supple.Recipe:
    return supple.Recipe.from_json(Path(name).read_text())


def test_a_saved_recipe_knows_its_size_and_fits_others_of_the_same_proportions(run: Run) -> None:
    assert run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json")[0] == 0
    assert (saved().size, saved().space) == ((48, 40), "pixels")
    image.write("big.png", noise(120, 144))
    status, out, err = run("warp", "big.png", "b.png", "--recipe", "r.json", "--save-recipe", "again.json")
    assert (status, out) == (0, "")
    assert err == "supple: the recipe was made for 48 x 40, and is scaled for big.png, which is 144 x 120\n"
    wanted = supple.Deformation.from_recipe(saved().fitted((144, 120)), (120, 144)).warp(noise(120, 144))
    np.testing.assert_array_equal(image.read("b.png").pixels, wanted)
    assert saved("again.json") == saved()


def test_another_size_is_refused_unless_fit_says_how(run: Run) -> None:
    assert run("warp", "in.png", "out.png", *GRAB, "--border", "none", "--save-recipe", "r.json")[0] == 0
    pixels = noise(80, 48)
    image.write("tall.png", pixels)
    recipe = ["--recipe", "r.json"]
    status, out, err = run("warp", "tall.png", "b.png", *recipe)
    assert (status, out) == (2, "")
    assert "made for 48 x 40, and tall.png is 48 x 80, of other proportions: say how it fits" in one_line(err)
    assert not Path("b.png").exists()
    d = supple.Deformation((80, 48), border=None)
    for fit, wanted in (
        ("pixels", d.grab((20, 16), by=(3, 2), radius=12)),
        ("inside", d.grab((20, 36), by=(3, 2), radius=12)),
        ("stretch", d.grab((20, 32.5), by=(3, 4), radius=12 * 2**0.5)),
    ):
        assert run("warp", "tall.png", f"{fit}.png", *recipe, "--fit", fit) == (0, "", "")
        np.testing.assert_array_equal(image.read(f"{fit}.png").pixels, wanted.warp(pixels))
    for given, wanted_text in (
        ([*GRAB, "--fit", "inside"], "--fit is for a recipe that was made for another size"),
        (["--recipe", "loose.json", "--fit", "inside"], "--fit needs the size that the recipe was made for"),
    ):
        Path("loose.json").write_text('{"supple": 2, "strokes": []}')
        status, _, err = run("warp", "tall.png", "b.png", *given)
        assert status == 2
        assert wanted_text in one_line(err)


def test_several_files_share_what_is_saved(run: Run) -> None:
    image.write("tall.png", noise(80, 48))
    assert run("warp", "in.png", "tall.png", "new/", *GRAB, "--save-recipe", "r.json")[0] == 0
    assert (saved().size, saved().space) == (None, "pixels")
    assert run("warp", "in.png", "tall.png", "other/", "--recipe", "r.json") == (0, "", "")


@pytest.mark.parametrize("text", ["30%", "0.3", " 30 %"])
def test_an_amount(run: Run, text: str) -> None:
    grabs = ["--grab", "20,16:26,18", "--grab", "26,18:26,24", "--radius", "8", "--border", "none"]
    assert run("warp", "in.png", "out.png", *grabs, "--amount", text, "--save-recipe", "r.json")[0] == 0
    assert (saved().amount, saved().strokes[0].by) == (0.3, (6, 2))
    d = supple.Deformation.from_recipe(saved(), (40, 48))
    np.testing.assert_allclose(d.strokes[1].at, (21.8, 16.6), atol=1e-6)
    np.testing.assert_array_equal(image.read("out.png").pixels, d.warp(noise(40, 48)))
    assert run("warp", "in.png", "a.png", "--recipe", "r.json", "--amount", "1")[0] == 0
    assert run("warp", "in.png", "b.png", *grabs)[0] == 0
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes()


@pytest.mark.parametrize("text", ["130%", "-1", "nan", "some", "", "%"])
def test_a_wrong_amount_is_one_line(run: Run, text: str) -> None:
    status, out, err = run("warp", "in.png", "out.png", *GRAB, f"--amount={text}")
    assert (status, out) == (2, "")
    assert one_line(err).startswith("supple: --amount must be a part of the strokes, from 0% to 100%, or from 0 to 1, ")


def test_info_tells_what_a_recipe_says(run: Run) -> None:
    strokes = (supple.Stroke(at=(1, 2, 3), by=(4, 5, 6), radius=7, name="left ear", strength=0.5),)
    recipe = supple.Recipe(strokes=strokes, size=(64, 48, 32), space="RAS", amount=0.3)
    Path("r.json").write_text(recipe.to_json())
    status, out, err = run("info", "r.json")
    assert (status, err) == (0, "")
    for wanted in (
        "made for    64 x 48 x 32\n",
        "points      millimetres in RAS\n",
        "amount      30%\n",
        "strength 50%",
    ):
        assert wanted in out
    assert out.rstrip().endswith("named left ear")
    facts = json.loads(run("info", "r.json", "--json")[1])
    assert (facts["size"], facts["space"], facts["amount"]) == ([64, 48, 32], "RAS", 0.3)
    assert (facts["strokes"][0]["name"], facts["strokes"][0]["strength"]) == ("left ear", 0.5)


def test_a_recipe_in_millimetres_is_for_volumes(run: Run) -> None:
    strokes = (supple.Stroke(at=(1, 2, 3), by=(4, 5, 6), radius=7),)
    Path("r.json").write_text(supple.Recipe(strokes=strokes, space="RAS").to_json())
    for verb, target in (("warp", "out.png"), ("plot", "out.svg")):
        status, _, err = run(verb, "in.png", target, "--recipe", "r.json")
        assert status == 2
        assert one_line(err) == (
            "supple: the recipe is in RAS millimetres, and in.png is no volume: give a recipe in pixels\n"
        )


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_without_force_no_bit_changes(run: Run, channels: int, dtype: type) -> None:
    pixels = noise(31, 17, channels, dtype)
    image.write("here.png", pixels)
    assert run("warp", "here.png", "there.png", "--grab", "5,5:5,5", "--radius", "9") == (0, "", "")
    np.testing.assert_array_equal(image.read("there.png").pixels, pixels)


@pytest.mark.parametrize("size", [(1, 1), (1, 37), (37, 1), (2, 2)])
@pytest.mark.parametrize("border", ["none", "50"])
def test_the_smallest_pictures(run: Run, size: tuple[int, int], border: str) -> None:
    image.write("small.png", noise(*size))
    drag = ["--grab", "0,0:3,2", "--radius", "10", "--quiet", "--on-fold", "damp"]
    assert run("warp", "small.png", "o.png", *drag, "--border", border) == (0, "", "")
    assert image.read("o.png").pixels.shape == (*size, 3)


def test_a_stroke_far_outside(run: Run) -> None:
    options = ["--grab", "-1e7,5e6:3,4", "--radius", "20", "--border", "none", "--on-fold", "damp"]
    status, _, err = run("warp", "in.png", "out.png", *options)
    assert status == 2
    assert "starts outside the picture, which has 48 x 40 pixels, and reaches nothing of it" in one_line(err)
    status, _, err = run("warp", "in.png", "out.png", *options, "--reach", "none")
    assert status == 0
    told = err.splitlines()
    assert len(told) == 2
    assert sum("folds: damped" in line for line in told) == sum("starts outside the picture" in line for line in told)
    assert image.read("out.png").pixels.shape == (40, 48, 3)


def test_damping_is_one_line_unless_quiet(run: Run) -> None:
    options = ["--grab", "20,16:40,16", "--radius", "3", "--force", "--on-fold", "damp"]
    status, out, err = run("warp", "in.png", "out.png", *options)
    assert (status, out) == (0, "")
    assert one_line(err).startswith("supple: warning: ")
    assert "--on-fold flow" in err
    assert run("warp", "in.png", "out.png", *options, "--quiet") == (0, "", "")
    status, _, err = run("warp", "in.png", "out.png", *options[:-1], "error")
    assert status == 2
    assert "folds" in one_line(err)


def test_json_tells_what_was_done(run: Run) -> None:
    status, out, err = run("warp", "in.png", "out.png", *GRAB, "--json", "--tolerance", "0.002")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    assert (facts["input"], facts["output"], facts["width"], facts["height"]) == ("in.png", "out.png", 48, 40)
    assert 0 < facts["error"] <= facts["tolerance"] == 0.002
    assert facts["within"] is True
    assert facts["folds"] == 0
    status, out, err = run("warp", "none.png", "x.png", *GRAB, "--json")
    assert status == 2
    assert one_line(err)[8:].strip() == json.loads(out)["error"]


def test_json_tells_who_did_it(run: Run, gpu: Gpu) -> None:
    def device(name: str, *options: str) -> tuple[str, str]:
        status, out, err = run("warp", "in.png", "out.png", *GRAB, "--json", "--force", "--device", name, *options)
        assert status == 0
        return json.loads(out)["device"], err

    assert device("cpu") == ("cpu", "")
    assert device("gpu")[0] == gpu.name
    assert device("auto")[0] == ("cpu" if gpu.software else gpu.name)
    # What it could not do, the CPU did.
    who, err = device("gpu", "--tolerance", "1e-9")
    assert who == "cpu"
    assert "the CPU did what" in err


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["warp", "in.png", "x.png", *GRAB, "--gpu"], "--device gpu is for warp, render and demo"),
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
        (["--grab", "1,2:3,4:5,6", "--radius", "5"], "X,Y:X,Y"),
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
        monkeypatch.setattr("supple.files.read", lambda path: pytest.fail("it was read"))
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
        ('{"supple": 3, "strokes": []}', "version"),
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


def pictures(folder: str) -> None:
    Path(folder, "deep").mkdir(parents=True)
    for i, name in enumerate(["a.png", "b.jpg", "deep/a.png"]):
        image.write(f"{folder}/{name}", noise(30 + i, 30))
    Path(folder, "bad.png").write_text("no picture")
    Path(folder, "notes.txt").write_text("no picture either")


def test_a_folder_goes_into_a_folder(run: Run) -> None:
    pictures("in")
    status, out, err = run("warp", "in", "new/out", *GRAB, "--json", "--save-recipe", "r.json")
    assert status == 2
    assert "in/bad.png" in one_line(err)
    assert sorted(os.listdir("new/out")) == ["a.png", "b.jpg"]
    facts = {line["output"]: line for line in map(json.loads, out.splitlines())}
    assert sorted(facts) == ["new/out/a.png", "new/out/b.jpg", "new/out/bad.png"]
    assert "error" in facts["new/out/bad.png"]
    assert facts["new/out/a.png"]["within"]
    assert run("warp", "in/a.png", "alone.png", "--recipe", "r.json")[0] == 0
    assert Path("alone.png").read_bytes() == Path("new/out/a.png").read_bytes()


def test_a_pattern_goes_into_a_folder_with_the_names_below(run: Run) -> None:
    pictures("in")
    assert run("warp", "in/**/a.png", "out", *GRAB) == (0, "", "")
    assert sorted(str(p) for p in Path("out").rglob("*.png")) == ["out/a.png", "out/deep/a.png"]
    status, _, err = run("warp", "in/*.gif", "out", *GRAB)
    assert status == 2
    assert "in/*.gif" in one_line(err)


def test_several_names_go_into_a_folder(run: Run) -> None:
    pictures("in")
    assert run("warp", "in/a.png", "in/b.jpg", "out", *GRAB) == (0, "", "")
    assert sorted(os.listdir("out")) == ["a.png", "b.jpg"]
    status, _, err = run("warp", "in/a.png", "in/b.jpg", "out", *GRAB)
    assert status == 2
    assert err.count("--force") == err.count("\n") == 2
    status, _, err = run("warp", "in/a.png", "in/deep/a.png", "out", *GRAB)
    assert status == 2
    assert "both" in one_line(err)
    status, _, err = run("warp", "in/a.png", "in/b.jpg", "in.png", *GRAB)
    assert status == 2
    one_line(err)


@pytest.mark.parametrize("given", [["in/a.png", "in/b.jpg"], ["in/*.png"], ["in"]])
def test_several_pictures_do_not_go_into_one(run: Run, given: list[str]) -> None:
    pictures("in")
    os.remove("in/bad.png")
    for target, folder in (("x.png", "x/"), ("deep/X.TIFF", "deep/X/"), ("x%03d.jpg", "bent/"), ("x.nii.gz", "x/")):
        status, _, err = run("warp", *given, target, *GRAB, "--save-recipe", "r.json")
        assert status == 2
        assert f"{target} is the name of one file, and several" in one_line(err)
        assert err.endswith(f"name one, such as {folder}\n")
        assert sorted(os.listdir()) == ["in", "in.png"]
    # A slash says that it is a folder; and so does a folder.
    assert run("warp", *given, "x.png/", *GRAB) == (0, "", "")
    assert run("warp", *given, "x.png", *GRAB, "--force") == (0, "", "")
    assert "a.png" in os.listdir("x.png")


def test_one_picture_goes_into_a_folder_that_is_there(run: Run) -> None:
    Path("out").mkdir()
    assert run("warp", "in.png", "out", *GRAB) == (0, "", "")
    assert os.listdir("out") == ["in.png"]


def test_brackets_in_a_name_are_a_name(run: Run) -> None:
    os.rename("in.png", "in[1].png")
    assert run("warp", "in[1].png", "out[2].png", *GRAB) == (0, "", "")
    assert sorted(os.listdir()) == ["in[1].png", "out[2].png"]


def test_an_error_of_one_of_many_names_it(run: Run) -> None:
    image.write("b.png", noise(30, 30))
    status, _, err = run("warp", "in.png", "b.png", "out", "--grab", "9,9:19,9", "--radius", "1", "--on-fold", "error")
    assert status == 2
    assert sorted(line.split(":")[1].strip() for line in err.splitlines()) == ["b.png", "in.png"]


def test_info(run: Run) -> None:
    status, out, err = run("info", "in.png")
    assert (status, err) == (0, "")
    assert "48 x 40" in out
    run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json")
    status, out, err = run("info", "in.png", "r.json", "--json")
    assert (status, err) == (0, "")
    picture, recipe = map(json.loads, out.splitlines())
    assert (picture["kind"], picture["width"], picture["height"]) == ("image", 48, 40)
    assert (recipe["kind"], recipe["strokes"][0]["radius"]) == ("recipe", 12)
    status, out, err = run("info", "r.json")
    assert "(20, 16) to (23, 18)" in out
    status, out, err = run("info", "none.png")
    assert (status, out) == (2, "")
    one_line(err)


def test_info_of_what_is_nothing_known(run: Run) -> None:
    Path("README.md").write_text("# Words")
    status, out, err = run("info", "README.md")
    assert (status, out) == (2, "")
    assert one_line(err) == (
        "supple: cannot read README.md: it is no picture, video, volume or recipe of a known kind: give one of these\n"
    )
    Path("cut.png").write_bytes(Path("in.png").read_bytes()[:60])
    assert "no picture, video" not in run("info", "cut.png")[2]


def test_info_says_that_a_rate_varies(run: Run) -> None:
    clips.make("a.mkv", times=[0, 1, 2, 9, 10, 11, 12, 13, 14, 15])
    clips.make("b.mkv")
    assert "at a variable rate" in run("info", "a.mkv")[1]
    assert "variable" not in run("info", "b.mkv")[1]


@pytest.mark.parametrize("what", ["grid", "stretch"])
def test_plot(run: Run, what: str) -> None:
    assert run("plot", "in.png", "plot.png", *GRAB, "--what", what) == (0, "", "")
    assert image.info("plot.png")["format"] == "PNG"
    status, _, err = run("plot", "in.png", "plot.png", *GRAB)
    assert status == 2
    assert "--force" in one_line(err)
    status, _, err = run("plot", "in.png", "plot.xyz", *GRAB)
    assert status == 2
    assert ".xyz" in one_line(err)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ([], "warp"),
        (["--help"], "--radius 100"),
        (["warp", "--help"], "--save-recipe"),
        (["plot", "--help"], "--what"),
        (["--version"], f"supple {supple.__version__}"),
    ],
)
def test_help(run: Run, arguments: Sequence[str], wanted: str) -> None:
    status, out, err = run(*arguments)
    assert (status, err) == (0, "")
    assert wanted in out


@pytest.fixture
def viewed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What windows are asked to show; none is opened."""
    shown: list[tuple[Any, ...]] = []

    def show(source: str, recipe: Any = None, *, toolkit: str, options: Any) -> None:
        shown.append((source, recipe, options))

    monkeypatch.setattr("supple.viewer.launch.show", show)
    return shown


def test_a_clip_is_viewed_by_a_time_scale(run: Run, viewed: list[tuple[Any, ...]]) -> None:
    assert run("view", "in.mkv", "--time-scale", "2.5") == (0, "", "")
    ((source, recipe, options),) = viewed
    assert (source, recipe, options.time_scale) == ("in.mkv", None, 2.5)
    for bad in ("0", "nan", "x"):
        status, _, err = run("view", "in.mkv", "--time-scale", bad)
        assert status == 2
        assert f"--time-scale must be a number of pixels above 0, found '{bad}'" in one_line(err)
    assert len(viewed) == 1


def test_a_volume_is_viewed_as_it_is_warped(run: Run, viewed: list[tuple[Any, ...]]) -> None:
    layout = ["--shape", "6,5,4", "--dtype", "<i2", "--spacing", "1,2,3"]
    assert run("view", "in.raw", *layout) == (0, "", "")
    assert run("view", "in", "--series", "2", "--labels") == (0, "", "")
    assert run("view", "in.nii", "--grab", "1,2,3:1,2,4", "--radius", "3", "--world") == (0, "", "")
    raw, series, placed = (options for _, _, options in viewed)
    known = raw.export["volume"].layout
    assert (known.shape, known.dtype, known.spacing) == ((6, 5, 4), "<i2", (1.0, 2.0, 3.0))
    assert (series.export["volume"].series, series.export["volume"].labels) == ("2", True)
    assert placed.volume.world
    assert not placed.export["volume"].world
    for bad, text in ((["--shape", "6,5,4"], "both --shape X,Y,Z and --dtype"), (["--world"], "--world is about")):
        status, _, err = run("view", "in.raw", *bad)
        assert status == 2
        assert text in one_line(err)


def test_a_fault_of_ours_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*given: object, **options: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.delenv("SUPPLE_DEBUG", raising=False)
    monkeypatch.setattr("supple.files.warp_file", fail)
    status, out, err = run("warp", "in.png", "out.png", *GRAB)
    assert (status, out) == (1, "")
    assert "report it" in one_line(err)
    Path("out").mkdir()
    status, out, err = run("warp", "in.png", "out", *GRAB)
    assert status == 1
    one_line(err)
    monkeypatch.setenv("SUPPLE_DEBUG", "1")
    with pytest.raises(RuntimeError):
        run("warp", "in.png", "out.png", *GRAB)


def test_a_process_ends_as_it_should(here: Path) -> None:
    assert finish(start("warp", "in.png", "out.png", *GRAB, "--json"))[0] == 0
    status, out, err = finish(start("warp", "in.png", "out.png", *GRAB))
    assert (status, out) == (2, "")
    assert "--force" in one_line(err)


def test_a_full_disk_leaves_nothing(here: Path) -> None:
    def little() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    image.write("in.png", noise(200, 300), force=True)
    status, out, err = finish(start("warp", "in.png", "out.png", *GRAB, preexec_fn=little))
    assert (status, out) == (2, "")
    assert "out.png" in one_line(err)
    assert os.listdir() == ["in.png"]


def when_it_writes(process: subprocess.Popen[str], folder: str, number: int) -> None:
    end = time.monotonic() + 200
    while not any(p.name.startswith(".") and p.stat().st_size for p in Path(folder).iterdir()):
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.002)
    process.send_signal(number)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_in_mid_write_leaves_nothing(here: Path, number: int, status: int) -> None:
    image.write("big.tif", noise(3000, 4000))
    Path("out").mkdir()
    process = start("warp", "big.tif", "out/big.png", *GRAB)
    when_it_writes(process, "out", number)
    ended, out, err = finish(process)
    assert (ended, out) == (status, "")
    one_line(err)
    assert os.listdir("out") == []


def test_an_interrupt_among_many_leaves_whole_files(here: Path) -> None:
    os.mkdir("in")
    for i in range(6):
        image.write(f"in/{i}.tif", noise(1200, 1000))
    os.mkdir("out")
    process = start("warp", "in/*.tif", "out", *GRAB)
    when_it_writes(process, "out", signal.SIGINT)
    ended, out, err = finish(process)
    assert (ended, out) == (130, "")
    one_line(err)
    done = os.listdir("out")
    assert len(done) < 6
    for name in done:
        assert image.read(f"out/{name}").pixels.shape == (1200, 1000, 3)


def test_output_that_nobody_reads_is_no_error(here: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        status, _, err = finish(start("info", "in.png", stdout=writing))
    finally:
        os.close(writing)
    assert (status, err) == (141, "")


def test_output_that_finds_no_room_is_one_line(here: Path) -> None:
    with open("/dev/full", "w") as full:
        status, _, err = finish(start("info", "in.png", stdout=full))
    assert status == 2
    one_line(err)


def test_progress_is_for_terminals(here: Path) -> None:
    pictures("in")
    terminal, inside = pty.openpty()
    command_line = [sys.executable, "-m", "supple", "warp", "in", "out", *GRAB]
    environment = {**os.environ, "PYTHONPATH": SOURCE, "TERM": "xterm", "COLUMNS": "90"}
    process = subprocess.Popen(command_line, env=environment, stdout=subprocess.DEVNULL, stderr=inside)
    os.close(inside)
    shown = b""
    while select.select([terminal], [], [], 200)[0]:
        try:
            got = os.read(terminal, 4096)
        except OSError:  # all is read
            break
        if not got:
            break
        shown += got
    os.close(terminal)
    assert process.wait() == 2
    assert b"3/3" in shown
    assert b"supple: cannot read in/bad.png" in shown


def test_an_interrupt_that_another_thread_is_given_is_heard(capsys: pytest.CaptureFixture[str]) -> None:
    given = []

    def work(job: Job, step: Callable[[str], None]) -> None:
        time.sleep(0.5)  # until it is waited for
        given.append(time.monotonic())
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)  # as systems do now and then
        while time.monotonic() < given[0] + 30:
            step("read")  # raises once all is stopped
            time.sleep(0.01)

    def warp(console: Console) -> None:
        Crew(1).work([(Path("in.png"), Path("out.png"))], work, console, lambda job, message: None)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert console.run(warp) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - given[0] < 10
    assert capsys.readouterr() == ("", "supple: interrupted\n")
