"""The command line: what it does."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import supple
from supple.media import image
from tests.cli.commands import GRAB, Run, noise, one_line


@pytest.mark.parametrize(
    ("options", "strokes"),
    [
        ("--grab -3,4.5:10,20 --radius 30", [((-3, 4.5), (13, 15.5), 30.0, None, 1)]),
        ("--grab=-3,-4:1e1,2 --radius=30 --poisson -inf", [((-3, -4), (13, 6), 30.0, -np.inf, 1)]),
        (
            "--grab 1,2:3,4 --grab 5,6:7,8 --radius 9 --poisson -1 --scales 3",
            [((1, 2), (2, 2), 9.0, -1.0, 3), ((5, 6), (2, 2), 9.0, -1.0, 3)],
        ),
        (
            "--grab 1,2:3,4 --radius 9 --scales 1 --grab 5,6:7,8 --radius 8 --scales 2",
            [((1, 2), (2, 2), 9.0, None, 1), ((5, 6), (2, 2), 8.0, None, 2)],
        ),
    ],
)
def test_what_is_asked_for_is_what_is_saved(run: Run, options: str, strokes: Sequence[tuple]) -> None:  # type: ignore[type-arg]
    assert run("warp", "in.png", "out.png", *options.split(), "--save-recipe", "r.json", "--quiet")[0] == 0
    recipe = supple.Recipe.from_json(Path("r.json").read_text())
    assert [(s.at, s.by, s.radius, s.poisson, s.scales) for s in recipe.strokes] == strokes
    assert (recipe.border, recipe.on_fold) == ("auto", "flow")


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
    assert run("warp", "in.png", "tall.png", "other/", "--recipe", "r.json", "--quiet") == (0, "", "")


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


@pytest.mark.parametrize("size", [(1, 1), (1, 37), (37, 1), (2, 2)])
@pytest.mark.parametrize("border", ["none", "50"])
def test_the_smallest_pictures(run: Run, size: tuple[int, int], border: str) -> None:
    image.write("small.png", noise(*size))
    drag = ["--grab", "0,0:3,2", "--radius", "10", "--quiet", "--on-fold", "damp"]
    assert run("warp", "small.png", "o.png", *drag, "--border", border) == (0, "", "")
    assert image.read("o.png").pixels.shape == (*size, 3)


def test_json_tells_what_was_done(run: Run) -> None:
    status, out, err = run("warp", "in.png", "out.png", *GRAB, "--json", "--tolerance", "0.002")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    assert (facts["input"], facts["output"], facts["width"], facts["height"]) == ("in.png", "out.png", 48, 40)
    assert 0 < facts["error"] <= facts["tolerance"] == 0.002
    assert facts["within"] is True
    assert (facts["folds"], facts["device"]) == (0, "cpu")
    status, out, err = run("warp", "none.png", "x.png", *GRAB, "--json")
    assert status == 2
    assert one_line(err)[8:].strip() == json.loads(out)["error"]
