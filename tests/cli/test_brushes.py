"""Strokes of all brushes on the command line, in the order in which they are given."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from supple import Deformation, Recipe, Stroke
from supple.cli.options_strokes import in_order
from supple.errors import SuppleError
from supple.media import image, volume
from supple.space.geometry import Geometry
from tests.cli.commands import Run, done, one_line, told


def saved(run: Run, *options: str) -> Recipe:
    """Return the recipe that a command line makes."""
    done(run("warp", "in.png", "out.png", *options, "--save-recipe", "r.json", "--force", "--quiet"))
    return Recipe.from_json(Path("r.json").read_text())


MIXED = (
    *("--pinch", "20,12:0.8", "--grab", "20,16:23,18", "--twist=18,20:-25", "--scale", "30,22:1.2"),
    *("--pinch", "26,20:1.1:1,-2", "--grab", "12,30:13,28"),
)


def test_strokes_keep_the_order_of_the_command_line(run: Run) -> None:
    found = saved(run, "--radius", "9", *MIXED, "--reach", "3")
    assert found.strokes == (
        Stroke(brush="pinch", at=(20, 12), factor=0.8, radius=9, reach=3),
        Stroke.grab((20, 16), to=(23, 18), radius=9, reach=3),
        Stroke(brush="twist", at=(18, 20), angle=-25, radius=9, reach=3),
        Stroke(brush="scale", at=(30, 22), factor=1.2, radius=9, reach=3),
        Stroke(brush="pinch", at=(26, 20), factor=1.1, axis=(1, -2), radius=9, reach=3),
        Stroke.grab((12, 30), to=(13, 28), radius=9, reach=3),
    )
    d = Deformation.from_recipe(found, (40, 48))
    np.testing.assert_array_equal(image.read("out.png").pixels, d.warp(image.read("in.png").pixels))


def test_settings_are_given_once_or_for_each(run: Run) -> None:
    radii = [str(r) for r in (5, 6, 7, 8, 9, 10)]
    options = [x for r in radii for x in ("--radius", r)]
    reaches = ("none", "2", "3", "4", "5", "6")
    more = ("--border-profile", "sine", *(f"--reach={reach}" for reach in reaches))
    found = saved(run, *MIXED, *options, "--scales", "2", "--scales", "3", "--poisson", "0.3", *more)
    assert [s.radius for s in found.strokes] == [5, 6, 7, 8, 9, 10]
    assert [s.scales for s in found.strokes] == [1, 2, 1, 1, 1, 3]
    assert {s.poisson for s in found.strokes} == {0.3}
    assert ([s.reach for s in found.strokes], found.border_profile) == ([None, 2, 3, 4, 5, 6], "sine")
    once = saved(run, *MIXED, "--radius", "9", "--scales", "2")
    assert [s.scales for s in once.strokes] == [1, 2, 1, 1, 1, 2]


def test_what_a_recipe_does_in_words(run: Run) -> None:
    Path("r.json").write_text(Recipe(strokes=_strokes()).to_json())
    text = run("info", "r.json")[1]
    assert [line.split(maxsplit=2)[2] for line in text.splitlines()[-6:]] == [
        "a drag by (3, 3, 3) at (1, 2, 3) with radius 9, reach 4, scales 2",
        "a twist by 30° at (1, 2, 3) with radius 9, reach 4, axis (0, 1, 0)",
        "a scale by 1.5 at (1, 2, 3) with radius 9, reach none",
        "a pinch by 0.5 at (1, 2, 3) with radius 9, reach 4, axis (20, -20, 0), poisson 0.3, hidden",
        "a drag by (0, 0, 0) at (1, 2, 3) with radius 9, through 2 points, reach 4, scales 1",
        "a pull of 2 handles with radius 9, reach 4, scales 1",
    ]
    assert json.loads(run("info", "r.json", "--json")[1])["strokes"][1]["axis"] == [0, 1, 0]


def _strokes() -> tuple[Stroke, ...]:
    at = (1.0, 2.0, 3.0)
    return (
        Stroke.grab(at, to=(4, 5, 6), radius=9, scales=2),
        Stroke(brush="twist", at=at, angle=30, axis=(0, 1, 0), radius=9),
        Stroke(brush="scale", at=at, factor=1.5, radius=9, reach=None),
        Stroke(brush="pinch", at=at, factor=0.5, axis=(20, -20, 0), radius=9, poisson=0.3, hidden=True),
        Stroke(at=at, by=(0, 0, 0), path=((5, 2, 3), (5, 5, 3)), radius=9),
        Stroke(at=at, by=(0, 0, 1), also=(((7, 7, 7), (0, 0, 0)),), radius=9),
    )


def test_the_order_is_never_guessed() -> None:
    values = {"--grab": ["1,2:3,4"], "--twist": ["1,2:30"]}
    arguments = ["--twist", "1,2:30", "in", "--grab=1,2:3,4"]
    assert in_order(arguments, values) == [("--twist", "1,2:30"), ("--grab", "1,2:3,4")]
    given = ["--grab", "1,2:3,4"]
    for arguments in (given, [*given, "--", "--twist", "1,2:30"], ["--grab", "--twist", "1,2:30"]):
        with pytest.raises(SuppleError, match=r"the place of --(twist|grab) among the options is in doubt"):
            in_order(arguments, values)


def points_of(name: str, *rows: str) -> str:
    Path(name).write_text("\n".join(("label,x,y", *rows, "")))
    return name


def test_a_pull_of_two_files(run: Run) -> None:
    points_of("a.csv", "p,12,20", "q,30,20", "r,20,30")
    points_of("b.csv", "r,20,30", "q,28,21", "p,14,21")
    found = saved(run, "--pull", "a.csv:b.csv", "--radius", "8", "--grab", "20,10:21,11", "--radius", "5")
    pull = Stroke.pull([(12, 20), (30, 20)], to=[(14, 21), (28, 21)], pins=[(20, 30)], radius=8)
    pull = replace(pull, name="a.csv:b.csv")
    assert found.strokes == (pull, Stroke.grab((20, 10), to=(21, 11), radius=5))
    d = Deformation.from_recipe(found, (40, 48))
    np.testing.assert_array_equal(image.read("out.png").pixels, d.warp(image.read("in.png").pixels))
    Path("c.csv").write_text("x,y\n14,21\n28,21\n20,30\n")
    Path("d.csv").write_text("x,y\n12,20\n30,20\n20,30\n")
    assert saved(run, "--pull", "d.csv:c.csv", "--radius", "8").strokes == (replace(pull, name="d.csv:c.csv"),)


PLACE = Geometry((0.8, 0.8, 2.5), (5.0, -7.0, 3.0), np.diag([1.0, -1.0, 1.0]), "RAS")
BEFORE, AFTER = np.array([[10, 12, 9.0], [30, 30, 15]]), np.array([[11, 13, 10.0], [30, 30, 15]])
STIFF = ("--radius", "12")


def table(name: str, header: str, points: object) -> None:
    rows = [",".join(map(repr, row)) for row in np.asarray(points).tolist()]
    Path(name).write_text("\n".join([*([header] if header else []), *rows, ""]))


@pytest.fixture
def head(run: Run) -> Run:
    """A volume in space, and its points in tables that say differently what they are."""
    samples = np.random.default_rng(1).integers(0, 255, (30, 60, 60), np.uint8)
    volume.write("head.nii", samples, volume.Volume(samples, PLACE))
    for name, points in (("a", BEFORE), ("b", AFTER)):
        table(f"{name}-plain.csv", "", points)
        table(f"{name}-xyz.csv", "x,y,z", points)
        table(f"{name}-ijk.csv", "i,j,k", points)
        for space, header in (("LPS", "l,p,s"), ("RAS", "r,a,s")):
            table(f"{name}-{space}.csv", header, PLACE.to_world(points, space))
            table(f"{name}-{space}-plain.csv", "", PLACE.to_world(points, space))
            table(f"{name}-{space}-xyz.csv", "x,y,z", PLACE.to_world(points, space))
    return run


@pytest.mark.parametrize(
    ("options", "warned"),
    [
        (["--pull", "a-plain.csv:b-plain.csv", "--convention", "index"], ""),
        (["--pull", "a-xyz.csv:b-xyz.csv"], "x, y and z of a-xyz.csv are taken for voxels, counted from 0"),
        (["--pull", "a-ijk.csv:b-ijk.csv"], ""),
        (["--pull", "a-LPS.csv:b-LPS.csv"], ""),
        (["--pull", "a-LPS.csv:b-RAS.csv"], ""),
        (["--pull", "a-RAS.csv:b-LPS-plain.csv", "--convention", "LPS"], ""),
        (["--pull", "a-LPS-plain.csv:b-LPS-plain.csv", "--convention", "LPS"], ""),
        (["--pull", "a-LPS-xyz.csv:b-LPS-xyz.csv", "--convention", "LPS", "--world"], ""),
        (["--pull", "a-LPS.csv:b-LPS.csv", "--world"], ""),
    ],
)
def test_a_pull_of_a_volume_goes_by_what_its_tables_say(head: Run, options: list[str], warned: str) -> None:
    status, _, err = head("warp", "head.nii", "out.nii", *options, *STIFF)
    assert status == 0, err
    assert warned in err if warned else "warning" not in err
    wanted = Deformation((30, 60, 60), spacing=PLACE.spacing).pull(BEFORE, to=AFTER, radius=12)
    wanted_samples = wanted.warp(volume.read("head.nii").samples, between="cubic", time_filter=True, clamp=True)
    off = np.abs(np.subtract(volume.read("out.nii").samples, wanted_samples, dtype=float))
    assert (off > 1).mean() < 1e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--pull", "a-plain.csv:b-plain.csv"], "cannot place a-plain.csv: it does not say what its numbers are: give"),
        (
            ["--pull", "a-LPS-xyz.csv:b-LPS-xyz.csv", "--world"],
            "it does not say what its numbers are: give --convention LPS or RAS (millimetres)",
        ),
        (["--pull", "a-ijk.csv:b-ijk.csv", "--world"], "a-ijk.csv is in voxels, and --world is for points in"),
        (["--pull", "a-ijk.csv:b-LPS.csv"], "b-LPS.csv is in millimetres, and a-ijk.csv in voxels: give both in one"),
        (["--pull", "a-RAS.csv:b-RAS.csv", "--convention", "LPS"], "it says that it is in RAS, and LPS was asked for"),
        (["--pull", "a-LPS.csv:b-LPS.csv", "--convention", "itk"], "give one, or LPS, RAS or index of points"),
        (["--grab", "9,9,9:9,9,8", "--convention", "LPS"], "--convention of points is of tables of --pull, and there"),
        (
            ["--pull", "a-LPS.csv:b-LPS.csv", "--twist", "20,20,9:30"],
            "--pull a-LPS.csv:b-LPS.csv is in millimetres, and --twist 20,20,9:30 is in voxels: give all points in",
        ),
    ],
)
def test_a_pull_of_a_volume_is_never_guessed(head: Run, options: list[str], message: str) -> None:
    for command in (("warp", "head.nii", "out.nii"), ("plan", "head.nii")):
        status, _, err = head(*command, *options, *STIFF)
        assert status == 2
        assert message in one_line(err)
    assert not Path("out.nii").exists()


def test_pulls_in_millimetres_mix_with_others_in_millimetres(head: Run) -> None:
    at = ",".join(map(repr, PLACE.to_world(BEFORE[1], "RAS").tolist()))
    options = ("--pull", "a-LPS.csv:b-LPS.csv", "--twist", f"{at}:20", "--world", *STIFF)
    status, _, err = head("warp", "head.nii", "out.nii", *options, "--save-recipe", "r.json")
    assert status == 0, err
    made = Recipe.from_json(Path("r.json").read_text())
    assert made.space == "RAS"
    np.testing.assert_allclose([p for p, _ in made.strokes[0].handles], PLACE.to_world(BEFORE, "RAS"))
    assert head("warp", "head.nii", "again.nii", "--recipe", "r.json")[0] == 0
    assert Path("again.nii").read_bytes() == Path("out.nii").read_bytes()
    pull = ("--pull", "a-RAS.csv:b-LPS.csv")
    Path("lps.json").write_text(Recipe(strokes=(Stroke.scale((0, 0, 9), factor=1.2, radius=9),), space="LPS").to_json())
    status, _, err = head(
        "warp", "head.nii", "more.nii", "--recipe", "lps.json", *pull, *STIFF, "--save-recipe", "s.json"
    )
    assert status == 0, err
    made = Recipe.from_json(Path("s.json").read_text())
    np.testing.assert_allclose(made.strokes[1].at, PLACE.to_world(BEFORE[0], "LPS"))


def test_other_commands_take_the_convention_of_a_pull(head: Run) -> None:
    pull = ("--pull", "a-plain.csv:b-plain.csv", *STIFF)
    for command in (
        ("points", "a-plain.csv", "moved.csv", "--on", "head.nii"),
        ("render", "head.nii", "out.png", "--size", "32x32"),
    ):
        status, _, err = head(*command, *pull)
        assert (status, "does not say what its numbers are" in err) == (2, True)
        status, _, err = head(*command, *pull, "--convention", "index")
        assert status == 0, err
    np.testing.assert_allclose(np.loadtxt("moved.csv", delimiter=",")[:, :3], AFTER, atol=1e-6)


def test_a_point_that_is_carried_away_is_one_sentence(run: Run) -> None:
    strokes = ("--grab", "16,16:22,16", "--grab", "24,22:24,28", "--radius", "8")
    status, out, err = run("warp", "in.png", "out.png", *strokes, "--json")
    assert status == 0
    assert "stroke 2 of 2, a drag by (0, 6) at (24, 22) with radius 8, carries the point of stroke 1" in one_line(err)
    first, second = json.loads(out)["arrivals"]
    assert f"away by {first['moved']:.3g} pixels" in err
    assert (first["carried_by"], second["carried_by"]) == (1, None)
    status, _, err = run("warp", "in.png", "strict.png", *strokes, "--strict")
    assert status == 2
    assert "carries the point of stroke 1" in one_line(err)
    assert not Path("strict.png").exists()


TILTED = (22, 0), (39, -5)


@pytest.mark.parametrize(
    ("mirror", "line"), [("25", ((25, 0), (1, 0))), ("22,0:27,39", TILTED), ("27,39:22,0", TILTED)]
)
def test_a_mirror_makes_each_stroke_on_the_other_side(
    run: Run, here: Path, mirror: str, line: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    strokes = ("--grab", "12,16:15,18", "--twist", "14,28:20", "--radius", "5", "--mirror", mirror)
    made = saved(run, *strokes, "--pinch", "12,20:0.8").strokes
    given = [
        Stroke.grab((12, 16), to=(15, 18), radius=5),
        Stroke.twist((14, 28), angle=20, radius=5),
        Stroke.pinch((12, 20), factor=0.8, radius=5),
    ]
    wanted = [one for stroke in given for one in stroke.symmetric(*line)]
    assert [stroke.brush for stroke in made] == ["grab", "twist", "twist", "pinch", "pinch"]
    for one, other in zip(made, wanted, strict=True):
        np.testing.assert_allclose(one.handles, other.handles, atol=1e-9)
        assert (one.angle, one.factor) == (other.angle, other.factor)
    flat = saved(run, "--grab", "12,16:15,18", "--radius", "5", "--flat", "0.5", "--mirror", mirror).strokes
    assert [stroke.flat for stroke in flat] == [0.5, 0.5]
    np.testing.assert_allclose(flat[1].at, flat[0].mirrored(*line).at)
    more = (*strokes, "--affine", "1,0,2,0,1,0", "--pinch", "12,20:0.8", "--json")
    assert told(run("warp", "in.png", "more.png", *more))["maps"][0]["after"] == 3  # a pull, and two twists


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--mirror", "x"), "--mirror must be X, a column of pixels, or X,Y:X,Y"),
        (("--mirror", "1,2"), "--mirror must be X, a column of pixels, or X,Y:X,Y"),
        (("--mirror", "1,2:1,2"), "--mirror must be X, a column of pixels, or X,Y:X,Y"),
        (("--mirror", "nan"), "--mirror must be X, a column of pixels, or X,Y:X,Y"),
        (("--mirror", "20", "--grab", "20,5:22,6:24,8"), "two images there: begin beside it"),
        (("--mirror", "20", "--grab", "20,5:25,5"), "starts on the line of --mirror 20, and its mirror image drags it"),
    ],
)
def test_no_mirror_is_one_line(run: Run, here: Path, arguments: tuple[str, ...], said: str) -> None:
    status, _, err = run("warp", "in.png", "out.png", "--grab", "12,16:15,18", "--radius", "5", *arguments)
    assert status == 2
    assert said in one_line(err)


def test_a_matte_is_mirrored_about_an_upright_or_a_level_line(run: Run, here: Path) -> None:
    height, width = image.read("in.png").pixels.shape[:2]
    image.write("matte.png", np.full((height, width), 255, np.uint8))
    strokes = ("--grab", "12,16:15,18", "--radius", "5", "--matte", "matte.png", "--mirror")
    status, _, err = run("warp", "in.png", "out.png", *strokes, "22,0:27,39")
    assert status == 2
    assert "--mirror must be along an axis for a stroke with a matte" in one_line(err)
    assert run("warp", "in.png", "out.png", *strokes, "22,5:27,5")[0] == 0


def test_a_push_is_one_pull_in_its_place_among_others(run: Run, here: Path) -> None:
    options = ("--grab", "12,16:15,18", "--push", "30,5:30,20:32,34:-3", "--radius", "6", "--radius", "5")
    grab, push = saved(run, *options).strokes
    assert push == Stroke.push([(30, 5), (30, 20), (32, 34)], by=-3, radius=5)
    assert grab.brush == "grab"
    for text, said in (
        ("30,5:-3", "--push must be X,Y:X,Y:BY, two points or more and how far"),
        ("30,5:30,20", "--push must be X,Y:X,Y:BY"),
        ("30,5:30,5:4", "--push 30,5:30,5:4: path must be two points or more"),
        ("1,2,3:4,5,6:2", "--push must be X,Y:X,Y:BY"),
    ):
        status, _, err = run("warp", "in.png", "no.png", "--push", text, "--radius", "5")
        assert (status, said in one_line(err)) == (2, True), err
