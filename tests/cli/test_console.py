"""What the command line says: warnings in JSON and as errors, where strokes arrive, and how a batch ends."""

from __future__ import annotations

import ast
import functools
import json
import os
import re
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest

import supple.files.clips
import supple.files.volumes
from supple.errors import SuppleError, ToleranceWarning, argument
from supple.files.recipes import read_recipe
from supple.media import image
from tests import clips
from tests.children import SOURCE
from tests.cli.commands import Run

HEAD = Path(SOURCE) / "supple" / "examples" / "data" / "head.nii.gz"
FOLDS = ("--radius", "6", "--on-fold", "damp")
MEDIA = {
    "picture": ("in.png", "out.png", ("--grab", "20,16:36,16", *FOLDS)),
    "clip": ("in.mkv", "out.mkv", ("--grab", "30,20:46,20", *FOLDS)),
    "volume": (str(HEAD), "out.nii.gz", ("--grab", "45,60,50:60,60,50", "--radius", "10", "--on-fold", "damp")),
}


def noise(seed: int) -> npt.NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (40, 48, 3), dtype=np.uint8)


@pytest.fixture(autouse=True)
def _files(here: Path) -> None:
    """A picture, a clip and six pictures."""
    os.mkdir("many")
    for k in range(6):
        image.write(f"many/{k}.png", noise(k))
    clips.make("in.mkv")


@pytest.mark.parametrize("medium", MEDIA)
def test_json_holds_the_warnings_and_where_strokes_arrive(run: Run, medium: str) -> None:
    source, target, strokes = MEDIA[medium]
    status, out, err = run("warp", source, target, *strokes, "--json")
    facts = json.loads(out)
    assert status == 0
    assert len(facts["warnings"]) == 1
    assert f"supple: warning: {facts['warnings'][0]}\n" == err
    [arrival] = facts["arrivals"]
    assert set(arrival) == {"target", "arrived", "final", "miss", "moved", "cause", "also", "carried_by"}
    assert (arrival["cause"], arrival["also"]) == ("fold", [])
    assert arrival["miss"] == pytest.approx(np.linalg.norm(np.subtract(arrival["target"], arrival["arrived"])))
    assert f"{arrival['miss'] * (2 if medium == 'volume' else 1):.3g} " in facts["warnings"][0]  # of 2 mm
    quiet = run("warp", source, target, *strokes, "--json", "--force", "--quiet")
    assert quiet[2] == ""
    assert json.loads(quiet[1])["warnings"] == facts["warnings"]


def test_json_of_plots_and_renderings(run: Run) -> None:
    held_back = ("--grab", "2,16:6,16", "--radius", "12", "--border", "10", "--on-fold", "damp")
    for name, more in (("in.png", ()), ("in.mkv", ("--frame", "2"))):
        status, out, err = run("plot", name, f"{name}.svg", *held_back, *more, "--json")
        facts = json.loads(out)
        assert status == 0
        assert facts["arrivals"][0]["cause"] == "border"
        assert [f"supple: warning: {text}" for text in facts["warnings"]] == err.splitlines()
        assert "the fixed border holds it back" in err
    grab = ("--grab", "2,60,50:8,60,50", "--radius", "30", "--border", "20", "--on-fold", "damp")
    status, out, err = run("render", str(HEAD), "r.png", *grab, "--size", "32x32", "--json")
    facts = json.loads(out)
    assert status == 0
    assert facts["arrivals"][0]["cause"] == "border"
    assert [f"supple: warning: {text}" for text in facts["warnings"]] == err.splitlines()


def test_each_warning_of_a_batch_begins_with_its_file(run: Run) -> None:
    os.symlink("../in.mkv", "many/clip.mkv")
    Path("many/no.png").write_bytes(b"nothing")
    strokes = ("--grab", "5,5:6,6", "--grab", "20,16:36,16", *FOLDS, "--json", "--threads", "3")
    status, out, err = run("warp", "many", "bent", *strokes)
    assert status == 2
    told = {facts["input"]: facts for facts in map(json.loads, out.splitlines())}
    assert len(told) == 8
    bad = told.pop("many/no.png")
    assert "cannot read" in bad["error"]
    assert bad["warnings"] == []
    for name, facts in told.items():
        [text] = facts["warnings"]
        assert text.startswith(f"{name}: stroke 2 of 2: a drag by (16, 0)")
        assert f"supple: warning: {text}\n" in err
    assert len(err.splitlines()) == 9


@pytest.mark.parametrize("medium", MEDIA)
def test_strict_makes_warnings_errors(run: Run, medium: str) -> None:
    source, target, strokes = MEDIA[medium]
    status, out, err = run("warp", source, target, *strokes, "--strict", "--json")
    assert status == 2
    assert err.startswith(f"supple: {source}: a drag by ")
    assert err.endswith("(--strict: warnings are errors)\n")
    assert err.count("\n") == 1
    facts = json.loads(out)
    assert facts["error"] == err[len("supple: ") : -1]
    assert len(facts["warnings"]) == 1
    assert not os.path.exists(target)
    assert sorted(os.listdir()) == ["in.mkv", "in.png", "many"]


@pytest.mark.parametrize(
    ("medium", "module", "name"),
    [("clip", supple.files.clips, "warn_of"), ("volume", supple.files.volumes, "warn_of_maps")],
)
def test_strict_holds_for_warnings_after_the_last_frame(
    run: Run, monkeypatch: pytest.MonkeyPatch, medium: str, module: ModuleType, name: str
) -> None:
    source, target, strokes = MEDIA[medium]
    Path(target).write_bytes(b"mine")

    def warn_of(*_: object, **__: object) -> None:
        warnings.warn("the map may be off", ToleranceWarning, stacklevel=2)

    monkeypatch.setattr(module, name, warn_of)
    status, _, err = run("warp", source, target, *strokes[:-1], "flow", "--strict", "--force")
    assert status == 2
    assert err == f"supple: {source}: the map may be off (--strict: warnings are errors)\n"
    assert Path(target).read_bytes() == b"mine"
    assert sorted(os.listdir()) == sorted(["in.mkv", "in.png", "many", target])


def test_strict_holds_for_what_the_writer_warns_of(run: Run) -> None:
    image.write("deep.png", noise(1).astype(np.uint16) * 200)
    grab = ("--grab", "20,16:22,16", "--radius", "12", "--strict")
    status, _, err = run("warp", "deep.png", "out.jpg", *grab)
    assert status == 2
    assert err == (
        "supple: out.jpg: JPEG holds 8 bits a channel, and the 16 of the pixels are rounded "
        "(--strict: warnings are errors)\n"
    )
    os.mkdir("frames")
    image.write("frames/other.png", noise(1))
    status, _, err = run("warp", "in.mkv", "frames", *grab)
    assert status == 2
    assert "also holds 1 other pictures" in err
    assert os.listdir("frames") == ["other.png"]


def test_strict_goes_on_with_the_other_files_of_a_batch(run: Run) -> None:
    image.write("many/2.png", np.tile(noise(1), (4, 4, 1)), force=True)
    strokes = ("--grab", "100,80:116,80", "--radius", "20", "--reach", "none", "--on-fold", "damp", "--strict")
    status, _, err = run("warp", "many", "bent", *strokes)
    assert status == 2
    assert os.listdir("bent") == ["2.png"]
    *lines, last = err.splitlines()
    assert all(line.startswith("supple: many/") for line in lines)
    assert len(lines) == 5
    assert last == (
        "supple: 1 of 6 files written into bent, 5 failed: many/0.png, many/1.png, many/3.png, many/4.png, many/5.png"
    )


@pytest.mark.parametrize("value", ["abc", "0", "-2", "2x", "²"])
def test_a_number_of_threads_that_is_none_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    grab = ("--grab", "20,16:22,16", "--radius", "12")
    monkeypatch.setenv("SUPPLE_THREADS", value)
    status, _, err = run("warp", "in.png", "out.png", *grab)
    assert status == 2
    wanted = "the environment variable SUPPLE_THREADS must be a number of threads from 1, found"
    assert err == f"supple: {wanted} {value!r}\n"
    monkeypatch.setenv("VIPS_CONCURRENCY", "1")  # which the option sets
    assert run("warp", "in.png", "out.png", *grab, "--threads", "2") == (0, "", "")


def test_a_tolerance_that_float32_does_not_hold_is_told(run: Run) -> None:
    grab = ("--grab", "20,16:22,16", "--radius", "12")
    status, out, err = run("warp", "in.png", "out.png", *grab, "--tolerance", "1e-9", "--json")
    assert status == 0
    [text] = json.loads(out)["warnings"]
    assert err == f"supple: warning: {text}\n"
    assert text.startswith("--tolerance 1e-9 is not reached everywhere: source points are float32")
    assert run("warp", "in.png", "b.png", *grab, "--tolerance", "1e-9", "--strict")[0] == 2
    assert not os.path.exists("b.png")
    assert run("warp", "in.png", "c.png", *grab, "--tolerance", "0.0003") == (0, "", "")


# What only Python asks for, and says: the command has none of it.
FOR_PYTHON = (
    "a Recipe (Recipe.from_json reads one)",
    "Deformation(supple.grid_of(image)",
    "a Recipe, as Recipe.from_json reads one",
    "requires_grad=True",
    "True or False",
    "alpha=True needs",
    "False for a shape of two axes",
    "on_change: ",
    "X must be False for",
    "X must be a Field (Field.from_array",
    "read_maps(path) reads them (supple compose",
    "give its pixel_array",
    "supple.warp_file warps files",
    "Field Inverted Placed compose",  # the public names of a module
    *("left_eye", "nose_tip", "n_points", "face_landmarks"),  # as files and strokes name landmarks
    # names that other programs have
    "opencv_storage",
    "mri_warp_convert",
    "lta_convert",
    "fnirtfileutils",
)
PYTHON = re.compile(r"\bNone\b|\bTrue\b|\bFalse\b|(?<![\w-])[a-z]+_\w+|\b[a-z_]+=|\w\(\)|\(\.\.\.\)")
NUMBERED = ("number", "integer", "length", "point", "refuse", "choice")


@functools.cache
def messages(path: Path) -> list[str]:
    """What the calls in a module raise or warn with, as far as it stands there; values are left out."""

    def text(node: ast.AST) -> str:
        if isinstance(node, ast.JoinedStr):
            return "".join(text(value) for value in node.values)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return node.value
        return "X" if isinstance(node, ast.FormattedValue) else ""

    found: list[str] = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            given = [text(argument) for argument in node.args]
            if name in NUMBERED and given and given[0]:
                found.append(f"X must be {' '.join(filter(None, given[1:]))}, found X")
            elif name.endswith("Error") or name in ("warn", "_warn", "say", "unreadable", "unwritable"):
                found += filter(None, given)
        elif isinstance(node, ast.Assign):
            found += (said for part in ast.walk(node.value) if " " in (said := text(part)) and "\n" not in said)
    return found


def test_no_message_names_an_argument_by_itself() -> None:
    left = {}
    for path in (Path(SOURCE) / "supple").rglob("*.py"):
        if path.parent.name in ("augment", "cuda", "torch") or path.name in ("console.py", "gallery.py", "errors.py"):
            continue  # called from Python alone; how arguments are named; HTML
        for text in messages(path):
            if PYTHON.search(text) and not any(known in text for known in FOR_PYTHON):
                left[text] = path.name
    assert left == {}


def test_recipes_read_side_by_side_leave_the_spelling_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    path.write_text('{"supple": 2, "strokes": null}')

    def refused(_: int) -> str:
        with pytest.raises(SuppleError) as caught:
            read_recipe(path)
        return str(caught.value)

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            messages = set(pool.map(refused, range(400)))
    finally:
        sys.setswitchinterval(before)
    assert messages == {f"{path}: strokes must be a list, found null"}
    assert argument("on_fold", "flow") == "on_fold='flow'"


def test_a_warning_is_spelt_for_who_reads_it(run: Run) -> None:
    grab = ("--grab", "20,16:60,16", "--radius", "3")
    strong = supple.Stroke.grab((20, 16), to=(60, 16), radius=3)
    with pytest.raises(SuppleError, match=r"\(on_fold='flow' goes all the way"):
        supple.Deformation((32, 40), on_fold="error").add(strong)
    status, _, err = run("warp", "in.png", "b.png", *grab, "--on-fold", "error")
    assert status == 2
    assert "(--on-fold flow goes all the way" in err
    with pytest.raises(SuppleError, match=r"\(on_fold='flow' goes all the way"):
        supple.Deformation((32, 40), on_fold="error").add(strong)
