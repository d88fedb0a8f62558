"""Freeze masks on the command line: pictures, labels of volumes, clips and stores."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, Freeze, Recipe, Stroke, SuppleError
from supple.media import image, volume
from supple.space.geometry import Geometry
from tests.cli.commands import Run, done, noise, one_line, told

GRAB = ("--grab", "20,16:25,18", "--radius", "12")


def disc(height: int = 40, width: int = 48) -> npt.NDArray[np.bool_]:
    return np.asarray(np.hypot(*np.ogrid[-20 : height - 20, -32 : width - 32]) < 7)


def test_frozen_pixels_stay(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    done(run("warp", "in.png", "out.png", "--freeze", "mask.png", *GRAB, "--save-recipe", "r.json"))
    source, out = (image.read(name).pixels for name in ("in.png", "out.png"))
    assert (out[disc()] == source[disc()]).all()
    assert (out != source).any()
    d = Deformation((40, 48), freeze=disc()).grab((20, 16), to=(25, 18), radius=12)
    np.testing.assert_array_equal(out, d.warp(source))
    assert run("warp", "in.png", "again.png", "--recipe", "r.json")[0] == 0
    assert Path("again.png").read_bytes() == Path("out.png").read_bytes()
    assert Recipe.from_json(Path("r.json").read_text()) == replace(d.recipe, space="pixels")
    assert "freeze      " in run("info", "r.json")[1]


def test_what_a_picture_may_be(run: Run) -> None:
    grey = np.where(disc(), 255, 0).astype(np.uint8)
    wanted = Freeze.of(disc())
    made = {
        "rgb.png": np.stack([grey] * 3, -1),
        "deep.tif": grey.astype(np.uint16) * 257,
        "two.png": np.where(disc(), 9, 3).astype(np.uint8),
        "opaque.png": np.stack([grey] * 3 + [np.full_like(grey, 255)], -1),
    }
    for name, pixels in made.items():
        image.write(name, pixels)
        assert run("warp", "in.png", "out.png", "--freeze", name, *GRAB, "--save-recipe", "r.json", "--force")[0] == 0
        assert Recipe.from_json(Path("r.json").read_text()).freeze == wanted
    labels = np.where(disc(), 7, 2).astype(np.uint8)
    labels[:4] = 5
    image.write("labels.png", labels)
    command = ("warp", "in.png", "out.png", "--save-recipe", "r.json", "--force", "--freeze")
    assert run(*command, "labels.png:7", *GRAB)[0] == 0
    assert Recipe.from_json(Path("r.json").read_text()).freeze == wanted
    assert run(*command, "labels.png:7", *GRAB, "--freeze-width", "12")[0] == 0
    assert Recipe.from_json(Path("r.json").read_text()).freeze == Freeze.of(disc(), width=12)


def test_a_mask_that_freezes_nothing_is_told(run: Run) -> None:
    image.write("black.png", np.zeros((40, 48), np.uint8))
    status, out, err = run("warp", "in.png", "out.png", "--freeze", "black.png", *GRAB, "--json")
    assert status == 0
    said = "nothing is frozen in black.png: all of it is black, and white is frozen"
    assert one_line(err) == f"supple: warning: {said}\n"
    assert json.loads(out)["warnings"] == [said]
    samples = np.zeros((5, 6, 7), np.uint8)
    volume.write("empty.nii", samples, volume.Volume(samples, PLACE))
    command = ("warp", "empty.nii", "out.nii", "--freeze", "empty.nii", "--grab", "3,3,2:3,4,2", "--radius", "6")
    assert "nothing is frozen in empty.nii: all of it is 0, and all but 0 is frozen" in run(*command)[2]


def test_a_drag_of_what_is_frozen_is_told(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    command = ("warp", "in.png", "out.png", "--freeze", "mask.png", "--grab", "32,20:40,20", "--radius", "9")
    status, out, err = run(*command, "--json")
    assert status == 0
    assert "ends 8 pixels short: what is frozen holds it back" in err
    assert json.loads(out)["arrivals"][0]["cause"] == "freeze"
    command = ("warp", "in.png", "out.png", "--freeze", "mask.png", "--grab", "32,20:32.8,20", "--radius", "12")
    status, _, err = run(*command, "--on-fold", "error", "--force")
    assert status != 0
    assert "what is frozen holds it back" in one_line(err)


def test_a_mask_of_the_large_picture_is_not_scaled_with_the_recipe(run: Run) -> None:
    Path("r.json").write_text(Deformation((40, 48)).grab((20, 16), to=(25, 18), radius=12).recipe.to_json())
    large, mask = noise(80, 96), np.kron(disc(), np.ones((2, 2))).astype(bool)
    image.write("large.png", large)
    image.write("mask.png", np.where(mask, 255, 0).astype(np.uint8))
    image.write("other.png", np.where(mask[:70], 255, 0).astype(np.uint8))
    command, rest = ("warp", "large.png", "out.png"), ("--recipe", "r.json", "--force")
    for fit in ((), ("--fit", "stretch"), ("--fit", "inside"), ("--fit", "pixels")):
        assert run(*command, "--freeze", "mask.png", *rest, *fit)[0] == 0
        out = image.read("out.png").pixels
        assert (out[mask] == large[mask]).all()
        assert (out != large).any()
        status, _, err = run(*command, "--freeze", "other.png", *rest, *fit)
        assert status != 0
        assert "the freeze mask other.png is of 96 x 70 samples" in err


PLACE = Geometry((1.0, 1.0, 2.0), (5.0, -7.0, 3.0), np.diag([1.0, -1.0, 1.0]), "LPS")


def labelled(run: Run) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    samples = noise(30 * 20, 24, 1).reshape(20, 30, 24)
    labels = np.zeros((20, 30, 24), np.uint8)
    labels[4:12, 8:18, 4:12] = 3
    labels[14:] = 1
    volume.write("ct.nii", samples, volume.Volume(samples, PLACE))
    volume.write("labels.nii", labels, volume.Volume(labels, PLACE))
    elsewhere = Geometry((1.0, 1.0, 2.0), (9.0, -7.0, 3.0), np.diag([1.0, -1.0, 1.0]), "LPS")
    volume.write("elsewhere.nii", labels, volume.Volume(labels, elsewhere))
    return samples, labels


def test_a_label_of_a_volume(run: Run) -> None:
    samples, labels = labelled(run)
    grab = ("--grab", "14,12,8:18,12,9", "--radius", "6")
    command = ("warp", "ct.nii", "out.nii", "--force", "--freeze")
    done(run(*command, "labels.nii:3", *grab))
    out = volume.read("out.nii").samples
    assert (out[labels == 3] == samples[labels == 3]).all()
    assert (out[labels == 0] != samples[labels == 0]).any()
    status, _, err = run(*command, "labels.nii", *grab)  # all but 0
    assert status == 0, err
    assert (volume.read("out.nii").samples[labels > 0] == samples[labels > 0]).all()
    status, _, err = run(*command, "elsewhere.nii:3", *grab)
    assert status != 0
    assert "the freeze mask elsewhere.nii lies elsewhere in space: its corners are up to 4 voxels" in one_line(err)


def test_in_millimetres(run: Run) -> None:
    """A recipe in space has the mask in voxels."""
    samples, labels = labelled(run)
    command = ("warp", "ct.nii", "out.nii", "--world", "--freeze", "labels.nii:3", "--grab", "-9,19,19:-5,19,21")
    done(run(*command, "--radius", "6", "--save-recipe", "r.json"))
    out = volume.read("out.nii").samples
    assert (out[labels == 3] == samples[labels == 3]).all()
    assert run("warp", "ct.nii", "again.nii", "--recipe", "r.json")[0] == 0
    np.testing.assert_array_equal(volume.read("again.nii").samples, out)


def test_recipes_keep_masks_and_refuse_damaged_ones() -> None:
    recipe = Recipe(strokes=(Stroke.grab((5, 5), by=(1, 1), radius=3),), freeze=Freeze.of(disc()))
    assert Recipe.from_json(recipe.to_json()) == recipe
    data = json.loads(recipe.to_json())
    for wrong in (3, {}, {**data["freeze"], "values": "%"}, {**data["freeze"], "size": [9, 9]}):
        with pytest.raises(SuppleError, match="freeze"):
            Recipe.from_json(json.dumps({**data, "freeze": wrong}))
    with pytest.raises(SuppleError, match="freeze must be a Freeze"):
        replace(recipe, freeze=disc())  # type: ignore[arg-type]


def test_a_freeze_stands_where_it_is_given(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    before, after = ("--grab", "28,16:33,18"), ("--grab", "36,26:31,22")
    rest = ("--radius", "9", "--force", "--save-recipe", "r.json")
    freeze = ("--freeze", "mask.png")
    done(run("warp", "in.png", "state.png", *before, *rest))
    facts = told(run("warp", "in.png", "out.png", *before, *freeze, *after, *rest, "--json"))
    state, made, source = (image.read(name).pixels for name in ("state.png", "out.png", "in.png"))
    np.testing.assert_array_equal(made[disc()], state[disc()])
    assert (state[disc()] != source[disc()]).any()
    assert (made != state).any()
    d = Deformation((40, 48)).grab((28, 16), to=(33, 18), radius=9).freeze(disc())
    with warnings.catch_warnings(action="ignore"):
        d = d.grab((36, 26), to=(31, 22), radius=9)
    np.testing.assert_array_equal(made, d.warp(source))
    recipe = Recipe.from_json(Path("r.json").read_text())
    assert recipe.strokes == d.strokes
    assert facts["strokes"] == 3
    assert "stroke 2    a freeze at (32, 20), 10% of 48 x 40" in run("info", "r.json")[1]
    # After a recipe, and before a map that stands between strokes.
    Path("first.json").write_text(Deformation((40, 48)).grab((28, 16), to=(33, 18), radius=9).recipe.to_json())
    assert run("warp", "in.png", "again.png", "--recipe", "first.json", *freeze, *after, *rest)[0] == 0
    np.testing.assert_array_equal(image.read("again.png").pixels, made)
    assert run("warp", "in.png", "beside.png", *freeze, "--recipe", "first.json", *after, *rest)[0] == 0
    assert Recipe.from_json(Path("r.json").read_text()).freeze == Freeze.of(disc())
    assert (image.read("beside.png").pixels[disc()] == source[disc()]).all()
    shift = ("--affine", "1,0,2,0,1,1")
    done(run("warp", "in.png", "out.png", *before, *freeze, *shift, *after, "--radius", "9", "--force"))
    one = Deformation((40, 48)).grab((28, 16), to=(33, 18), radius=9).freeze(disc()).affine([[1, 0, 2], [0, 1, 1]])
    with warnings.catch_warnings(action="ignore"):
        one = one.grab((36, 26), to=(31, 22), radius=9)
    np.testing.assert_array_equal(image.read("out.png").pixels, one.warp(source))
    # Thawed, all moves again.
    done(run("warp", "in.png", "out.png", *freeze, *before, "--freeze", "none", *after, *rest))
    kinds = [stroke.brush for stroke in Recipe.from_json(Path("r.json").read_text()).strokes]
    assert kinds == ["grab", "freeze", "grab"]
    assert (image.read("out.png").pixels[disc()] != source[disc()]).any()


def test_each_stroke_has_its_strength(run: Run) -> None:
    two = ("--grab", "28,16:33,18", "--grab", "10,30:12,30", "--radius", "5", "--strength", "50%", "--strength=200%")
    assert run("warp", "in.png", "out.png", *two, "--save-recipe", "r.json")[0] == 0
    assert [stroke.strength for stroke in Recipe.from_json(Path("r.json").read_text()).strokes] == [0.5, 2.0]


def test_a_freeze_between_a_recipe_without_strokes_and_a_map(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    Path("empty.json").write_text('{"supple": 3, "border": "auto", "strokes": []}')
    rest = ("--affine", "1,0,4,0,1,0", "--freeze", "mask.png", *GRAB, "--json")
    plain = run("warp", "in.png", "plain.png", *rest)
    beside = run("warp", "in.png", "beside.png", "--recipe", "empty.json", *rest)
    assert plain[0] == beside[0] == 0, (plain[2], beside[2])
    assert Path("plain.png").read_bytes() == Path("beside.png").read_bytes()


def test_a_recipe_s_freeze_is_thawed(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    first = ("--grab", "10,10:12,11", "--radius", "6")
    saved = run("warp", "in.png", "a.png", *first, "--freeze", "mask.png", *first[:2], "--save-recipe", "r.json")
    assert saved[0] == 0, saved[2]
    done(run("warp", "in.png", "b.png", "--recipe", "r.json", "--freeze", "none", *GRAB))
