"""The transforms of MONAI: arrays and dictionaries, in its conventions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import supple
from tests import reference
from tests.augment.libraries import library

monai, monai_data = library("monai.transforms"), library("monai.data")
import torch
from monai.data import MetaTensor

from supple.augment import moved_boxes
from supple.augment.monai import RandElastic, RandElasticd

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"
SIZE = (50, 40, 30)
RNG = np.random.default_rng(0)
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")


def sample() -> dict[str, Any]:
    affine = np.diag([1.0, 1.0, 2.0, 1.0])
    return {
        "image": MetaTensor(torch.from_numpy(RNG.random((2, *SIZE), np.float32)), affine=affine),
        "label": MetaTensor(torch.from_numpy(RNG.integers(0, 5, (1, *SIZE)).astype(np.uint8)), affine=affine),
        "points": np.array([[20.0, 15.0, 10.0], [30.0, 25.0, 20.0]]),
        "boxes": torch.tensor([[10.0, 5.0, 5.0, 40.0, 30.0, 20.0], [0.0, 0.0, 0.0, 50.0, 40.0, 30.0]]),
        "name": "a sample",
    }


def test_all_of_a_dictionary_is_bent_by_one_draw() -> None:
    keys = {"point_keys": "points", "box_keys": ["boxes"]}
    transform = RandElasticd(["image", "label"], 9, (12, 20), 8, prob=1, mode=["bilinear", "nearest"], **keys)
    given = sample()
    made = monai.Compose([transform]).set_random_state(7)(given)
    d = transform.deformation
    assert d is not None
    assert d.shape == SIZE[::-1]
    assert d.domain.spacing == (1, 1, 2)
    for k in range(2):
        expected = d.warp(given["image"][k].numpy().T, filter="linear")
        np.testing.assert_allclose(made["image"][k].numpy().T, expected, atol=1e-6)
    expected = d.warp(given["label"][0].numpy().T, filter="nearest")
    np.testing.assert_array_equal(made["label"][0].numpy().T, expected)
    assert isinstance(made["image"], MetaTensor)
    assert torch.equal(made["image"].affine, given["image"].affine)
    assert made["label"].dtype == torch.uint8
    truth = reference.forward(reference.carried_out(d), d.domain, given["points"])
    assert np.abs(truth - given["points"]).max() > 0.5
    np.testing.assert_allclose(np.asarray(made["points"]), truth, atol=1e-6)
    boxes = moved_boxes(d, given["boxes"].numpy() - 0.5) + 0.5
    np.testing.assert_allclose(made["boxes"].numpy(), boxes, atol=1e-4)
    np.testing.assert_allclose(made["boxes"][1].numpy(), (0, 0, 0, 50, 40, 30), atol=1e-4)
    assert made["name"] == "a sample"


def test_its_random_state_draws() -> None:
    image = torch.from_numpy(RNG.random((3, 60, 80), np.float32))
    transform = RandElastic(9, (15, 25), 8, prob=1)
    one = transform.set_random_state(3)(image)
    assert torch.equal(transform(image, randomize=False), one)
    assert not torch.equal(transform(image), one)
    assert torch.equal(transform.set_random_state(3)(image), one)
    assert transform.deformation is not None
    assert transform.deformation.shape == (80, 60)  # the first axis is x
    expected = transform.deformation.warp(image[1].numpy().T, filter="linear")
    np.testing.assert_allclose(one[1].numpy().T, expected, atol=1e-6)
    half = RandElastic(9, (15, 25), prob=0.5).set_random_state(1)
    assert sum(torch.equal(half(image), image) for _ in range(40)) not in (0, 40)
    assert np.array_equal(RandElastic(9, 15, prob=0)(image.numpy()), image)


def test_what_is_bent_is_bent_back_by_the_exact_inverse() -> None:
    keys = {"point_keys": "points", "box_keys": ["boxes"]}
    bend = RandElasticd(["image", "label"], 9, (12, 20), 8, prob=1, mode=["bilinear", "nearest"], **keys)
    transform, given = monai.Compose([bend, monai.RandFlipd(["image", "label"], prob=1)]).set_random_state(7), sample()
    made = transform(given)
    d, spatial = bend.deformation, monai.RandFlipd(["image", "label"], prob=1).flipper
    assert d is not None
    back = transform.inverse(made)
    assert not back["image"].applied_operations
    np.testing.assert_allclose(np.asarray(back["points"]), given["points"], atol=1e-6)
    bent = spatial(made["image"])[0].numpy().T  # without the flip
    seen = reference.forward(reference.carried_out(d), d.domain, reference.grid(d.shape)).reshape(-1, 3)
    expected = ndimage.map_coordinates(bent.astype(float), seen[:, ::-1].T, order=1, mode="nearest")
    np.testing.assert_allclose(back["image"][0].numpy().T.ravel(), expected, atol=0.03)
    assert set(np.unique(back["label"])) <= set(np.unique(given["label"]))
    low, high = np.split(back["boxes"].numpy(), 2, axis=1)
    first = np.split(given["boxes"].numpy(), 2, axis=1)
    assert (low <= first[0] + 0.05).all()
    assert (high >= first[1] - 0.05).all()
    none = monai.Compose([RandElasticd(["image"], 9, 15, prob=0)])
    assert torch.equal(none.inverse(none(given))["image"], given["image"])


def test_items_of_a_batch_are_bent_back() -> None:
    transform, image = RandElastic(9, (15, 25), 8, prob=1), MetaTensor(torch.rand(2, 40, 30))
    items = monai_data.decollate_batch(monai_data.list_data_collate([transform(image), transform(image)]))
    for one in items:
        recipe = supple.Recipe.from_json(one.applied_operations[0]["extra_info"]["recipe"])
        d = supple.Deformation.from_recipe(recipe, (30, 40), warn=False, say=lambda *_: None)
        expected = d.warp(one[0].numpy().T, filter="linear", inverse=True)
        np.testing.assert_allclose(transform.inverse(one)[0].numpy().T, expected, atol=1e-6)


def test_a_file_that_it_reads_has_the_recipe(tmp_path: Path) -> None:
    from supple.media import volume

    read = [monai.LoadImaged("head"), monai.EnsureChannelFirstd("head")]
    transform = RandElasticd("head", 15, (25, 40), 6, prob=1)
    made = monai.Compose([*read, transform]).set_random_state(1)({"head": HEAD})
    assert transform.deformation is not None
    voxels = volume.read(HEAD).samples.astype(np.float32)
    recipe = supple.Recipe.from_json(transform.deformation.recipe.to_json())
    d = supple.Deformation.from_recipe(recipe, voxels.shape, spacing=(2, 2, 2))
    np.testing.assert_array_equal(made["head"][0].numpy().T, d.warp(voxels, filter="linear"))


def test_keys_are_checked() -> None:
    given = sample()
    one = RandElasticd(["image", "other"], 5, 15, prob=1, allow_missing_keys=True, point_keys="none")
    assert set(one(given)) == set(given)
    with pytest.raises(KeyError, match="other"):
        RandElasticd(["image", "other"], 5, 15, prob=1)(given)
    with pytest.raises(KeyError, match="Key `none` of transform `RandElasticd` was missing"):
        RandElasticd(["image"], 5, 15, prob=1, point_keys="none")(given)
    with pytest.raises(supple.SuppleError, match=r"img must be of spatial size \(50, 40, 30\), as the first image"):
        RandElasticd(["image", "label"], 5, 15, prob=1)({**given, "label": given["label"][:, 1:]})
    with pytest.raises(supple.SuppleError, match="mode must be one of nearest, bilinear, bicubic, found 'area'"):
        RandElasticd(["image"], 5, 15, mode="area")
    with pytest.raises(supple.SuppleError, match="img must be of shape"):
        RandElastic(5, 15, prob=1)(torch.zeros(3, 4))
