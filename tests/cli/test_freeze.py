"""Freeze masks on the command line: pictures, labels of volumes, clips and stores."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation, Freeze, Recipe, Stroke, SuppleError
from supple.media import image, volume
from supple.space.geometry import Geometry
from tests.cli.commands import Run, noise, one_line

GRAB = ("--grab", "20,16:25,18", "--radius", "12")


def disc(height: int = 40, width: int = 48) -> npt.NDArray[np.bool_]:
    return np.asarray(np.hypot(*np.ogrid[-20 : height - 20, -32 : width - 32]) < 7)


def test_frozen_pixels_stay(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    status, _, err = run("warp", "in.png", "out.png", *GRAB, "--freeze", "mask.png", "--save-recipe", "r.json")
    assert status == 0, err
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
        assert run("warp", "in.png", "out.png", *GRAB, "--freeze", name, "--save-recipe", "r.json", "--force")[0] == 0
        assert Recipe.from_json(Path("r.json").read_text()).freeze == wanted
    labels = np.where(disc(), 7, 2).astype(np.uint8)
    labels[:4] = 5
    image.write("labels.png", labels)
    command = ("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json", "--force", "--freeze")
    assert run(*command, "labels.png:7")[0] == 0
    assert Recipe.from_json(Path("r.json").read_text()).freeze == wanted
    assert run(*command, "labels.png:7", "--freeze-width", "12")[0] == 0
    assert Recipe.from_json(Path("r.json").read_text()).freeze == Freeze.of(disc(), width=12)


def test_a_mask_that_freezes_nothing_is_told(run: Run) -> None:
    image.write("black.png", np.zeros((40, 48), np.uint8))
    status, out, err = run("warp", "in.png", "out.png", *GRAB, "--freeze", "black.png", "--json")
    assert status == 0
    said = "nothing is frozen in black.png: all of it is black, and white is frozen"
    assert one_line(err) == f"supple: warning: {said}\n"
    assert json.loads(out)["warnings"] == [said]
    samples = np.zeros((5, 6, 7), np.uint8)
    volume.write("empty.nii", samples, volume.Volume(samples, PLACE))
    command = ("warp", "empty.nii", "out.nii", "--grab", "3,3,2:3,4,2", "--radius", "6", "--freeze", "empty.nii")
    assert "nothing is frozen in empty.nii: all of it is 0, and all but 0 is frozen" in run(*command)[2]


def test_a_drag_of_what_is_frozen_is_told(run: Run) -> None:
    image.write("mask.png", np.where(disc(), 255, 0).astype(np.uint8))
    command = ("warp", "in.png", "out.png", "--grab", "32,20:40,20", "--radius", "9", "--freeze", "mask.png")
    status, out, err = run(*command, "--json")
    assert status == 0
    assert "ends 8 pixels short: what is frozen holds it back" in err
    assert json.loads(out)["arrivals"][0]["cause"] == "freeze"
    command = ("warp", "in.png", "out.png", "--grab", "32,20:32.8,20", "--radius", "12", "--freeze", "mask.png")
    status, _, err = run(*command, "--on-fold", "error", "--force")
    assert status != 0
    assert "what is frozen holds it back" in one_line(err)


def test_a_mask_goes_with_its_recipe_to_another_size(run: Run) -> None:
    d = Deformation((40, 48), freeze=disc()).grab((20, 16), to=(25, 18), radius=12)
    Path("r.json").write_text(d.recipe.to_json())
    image.write("large.png", noise(80, 96))
    assert run("warp", "large.png", "out.png", "--recipe", "r.json")[0] == 0
    source, out = (image.read(name).pixels for name in ("large.png", "out.png"))
    inner = np.kron(disc(), np.ones((2, 2))).astype(bool)
    assert (out[inner] == source[inner]).all()
    image.write("wide.png", noise(40, 90))
    assert run("warp", "wide.png", "wide-out.png", "--recipe", "r.json", "--fit", "pixels")[0] == 0
    source, out = (image.read(name).pixels for name in ("wide.png", "wide-out.png"))
    assert (out[:, :48][disc()] == source[:, :48][disc()]).all()


def test_a_mask_of_the_large_picture_is_not_scaled_with_the_recipe(run: Run) -> None:
    Path("r.json").write_text(Deformation((40, 48)).grab((20, 16), to=(25, 18), radius=12).recipe.to_json())
    large, mask = noise(80, 96), np.kron(disc(), np.ones((2, 2))).astype(bool)
    image.write("large.png", large)
    image.write("mask.png", np.where(mask, 255, 0).astype(np.uint8))
    image.write("other.png", np.where(mask[:70], 255, 0).astype(np.uint8))
    command = ("warp", "large.png", "out.png", "--recipe", "r.json", "--force")
    for fit in ((), ("--fit", "stretch"), ("--fit", "inside"), ("--fit", "pixels")):
        assert run(*command, *fit, "--freeze", "mask.png")[0] == 0
        out = image.read("out.png").pixels
        assert (out[mask] == large[mask]).all()
        assert (out != large).any()
        status, _, err = run(*command, *fit, "--freeze", "other.png")
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
    command = ("warp", "ct.nii", "out.nii", "--grab", "14,12,8:18,12,9", "--radius", "6", "--force", "--freeze")
    status, _, err = run(*command, "labels.nii:3")
    assert status == 0, err
    out = volume.read("out.nii").samples
    assert (out[labels == 3] == samples[labels == 3]).all()
    assert (out[labels == 0] != samples[labels == 0]).any()
    status, _, err = run(*command, "labels.nii")  # all but 0
    assert status == 0, err
    assert (volume.read("out.nii").samples[labels > 0] == samples[labels > 0]).all()
    status, _, err = run(*command, "elsewhere.nii:3")
    assert status != 0
    assert "the freeze mask elsewhere.nii lies elsewhere in space: its corners are up to 4 voxels" in one_line(err)


def test_in_millimetres(run: Run) -> None:
    """A recipe in space has the mask in voxels."""
    samples, labels = labelled(run)
    command = ("warp", "ct.nii", "out.nii", "--world", "--grab", "-9,19,19:-5,19,21", "--radius", "6")
    status, _, err = run(*command, "--freeze", "labels.nii:3", "--save-recipe", "r.json")
    assert status == 0, err
    out = volume.read("out.nii").samples
    assert (out[labels == 3] == samples[labels == 3]).all()
    assert run("warp", "ct.nii", "again.nii", "--recipe", "r.json")[0] == 0
    np.testing.assert_array_equal(volume.read("again.nii").samples, out)


def test_a_store_has_the_same(run: Run) -> None:
    zarr = pytest.importorskip("zarr")
    samples, labels = labelled(run)
    grab = ("--grab", "14,12,8:18,12,9", "--radius", "6", "--freeze", "labels.nii:3")
    assert run("warp", "ct.nii", "out.nii", *grab)[0] == 0
    status, _, err = run("warp", "ct.nii", "out.zarr", *grab)
    assert status == 0, err
    made = np.asarray(zarr.open(str(Path("out.zarr")), mode="r")["0"])
    assert (made.reshape(samples.shape)[labels == 3] == samples[labels == 3]).all()


def test_recipes_keep_masks_and_refuse_damaged_ones() -> None:
    recipe = Recipe(strokes=(Stroke.grab((5, 5), by=(1, 1), radius=3),), freeze=Freeze.of(disc()))
    assert Recipe.from_json(recipe.to_json()) == recipe
    data = json.loads(recipe.to_json())
    for wrong in (3, {}, {**data["freeze"], "values": "%"}, {**data["freeze"], "size": [9, 9]}):
        with pytest.raises(SuppleError, match="freeze"):
            Recipe.from_json(json.dumps({**data, "freeze": wrong}))
    with pytest.raises(SuppleError, match="freeze must be a Freeze"):
        replace(recipe, freeze=disc())  # type: ignore[arg-type]
