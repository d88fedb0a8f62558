"""The transforms of TorchIO: subjects, their histories, and recipes that fit their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.media import volume
from tests.augment.libraries import library

tio = library("torchio")
import torch

from supple.augment.torchio import Elastic, RandomElastic

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")


def subject() -> Any:
    head = tio.ScalarImage(HEAD)
    labels = tio.LabelMap(tensor=(head.data // 50).to(torch.int16), affine=head.affine)
    return tio.Subject(head=head, labels=labels, name="a head")


def test_images_and_labels_of_a_subject_are_bent_by_one_draw(tmp_path: Path) -> None:
    given, transform = subject(), RandomElastic(15, (25, 40), 6)
    torch.manual_seed(3)
    made = transform(given)
    (elastic,) = made.history
    assert isinstance(elastic, Elastic)
    (tmp_path / "strokes.json").write_text(elastic.recipe, encoding="utf-8")
    words = ["--recipe", str(tmp_path / "strokes.json"), "--filter", "linear", "--strict"]
    assert command(["warp", str(HEAD), str(tmp_path / "bent.nii.gz"), *words]) == 0
    bent = tio.ScalarImage(tmp_path / "bent.nii.gz")
    assert not torch.equal(made.head.data, given.head.data)
    np.testing.assert_array_equal(made.head.data.numpy(), bent.data.numpy())  # as the command bends the file
    voxels = volume.read(HEAD).samples
    d = supple.Deformation.from_recipe(supple.Recipe.from_json(elastic.recipe), voxels.shape, spacing=(2, 2, 2))
    expected = d.warp((voxels // 50).astype(np.int16), filter="nearest")
    np.testing.assert_array_equal(made.labels.data.numpy()[0].T, expected)
    assert made.labels.data.dtype == torch.int16
    assert made["name"] == "a head"
    again = made.get_composed_history()(given)
    assert torch.equal(again.head.data, made.head.data)
    assert torch.equal(again.labels.data, made.labels.data)
    torch.manual_seed(3)
    assert torch.equal(transform(given).head.data, made.head.data)
    assert not torch.equal(transform(given).head.data, made.head.data)


def test_a_subject_is_bent_back_by_the_exact_inverse() -> None:
    given, flip = subject(), tio.RandomFlip(flip_probability=1)
    bent = RandomElastic(15, (25, 40), 6)(given)
    back = flip(bent).apply_inverse_transform()
    d = supple.Deformation.from_recipe(
        supple.Recipe.from_json(bent.history[0].recipe), given.head.data[0].numpy().T.shape, spacing=(2, 2, 2)
    )
    expected = d.warp(bent.head.data[0].numpy().T, filter="linear", inverse=True)
    np.testing.assert_array_equal(back.head.data[0].numpy().T, expected)
    assert set(np.unique(back.labels.data)) <= set(np.unique(given.labels.data))
    off, before = ((one.head.data.float() - given.head.data).abs().mean() for one in (back, bent))
    assert off < 0.5 * before
    assert "invert=True" in repr(bent.history[0].inverse())


def test_a_picture_is_bent_in_its_plane() -> None:
    rng = np.random.default_rng(0)
    image = tio.ScalarImage(tensor=torch.from_numpy(rng.random((3, 60, 40, 1), np.float32)))
    made = RandomElastic(5, (10, 15), 6)(tio.Subject(image=image))
    recipe = supple.Recipe.from_json(made.history[0].recipe)
    assert recipe.size == (60, 40)
    d = supple.Deformation.from_recipe(recipe, (40, 60))
    expected = d.warp(image.data[..., 0].permute(2, 1, 0).numpy(), filter="linear")
    np.testing.assert_allclose(made.image.data[..., 0].permute(2, 1, 0).numpy(), expected, atol=1e-6)


def test_conventions_of_its_transforms_hold() -> None:
    given = subject()
    made = RandomElastic(15, (25, 40), 6, include=["head"])(given)
    assert torch.equal(made.labels.data, given.labels.data)
    assert not torch.equal(made.head.data, given.head.data)
    assert RandomElastic(15, 25, p=0)(given) is given
    assert RandomElastic(5, 10)(torch.rand(1, 30, 20, 10)).shape == (1, 30, 20, 10)
    with pytest.raises(supple.SuppleError, match="the recipe was made for"):
        made.history[0](tio.Subject(image=tio.ScalarImage(tensor=torch.rand(1, 30, 20, 10))))
    with pytest.raises(supple.SuppleError, match='outside must be "edge" or "constant" or "reflect", found'):
        RandomElastic(5, 10, outside="zeros")
    with pytest.raises(supple.SuppleError, match="image_interpolation must be one of nearest, linear, cubic"):
        RandomElastic(5, 10, image_interpolation="gaussian")
