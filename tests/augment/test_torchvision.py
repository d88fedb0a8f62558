"""The transform of torchvision: samples of its kinds, in its conventions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import supple
from tests import reference
from tests.augment.libraries import library

torchvision = library("torchvision")
import torch
from torchvision import tv_tensors
from torchvision.transforms import v2

from supple.augment import moved_boxes
from supple.augment.torchvision import RandomElastic

SIZE = (90, 120)
POINTS = torch.tensor([[30.0, 40.0], [61.5, 22.25], [100.0, 80.0]])


def sample() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "image": tv_tensors.Image(torch.from_numpy(rng.integers(0, 256, (3, *SIZE), np.uint8))),
        "video": tv_tensors.Video(torch.from_numpy(rng.random((2, 3, *SIZE), np.float32))),
        "mask": tv_tensors.Mask(torch.from_numpy(rng.integers(0, 9, SIZE))),
        "points": tv_tensors.KeyPoints(POINTS, canvas_size=SIZE),
        "boxes": tv_tensors.BoundingBoxes(
            torch.tensor([[20.0, 10.0, 60.0, 50.0], [0.0, 0.0, 120.0, 90.0]]), format="XYXY", canvas_size=SIZE
        ),
        "name": "a sample",
        "more": torch.zeros(4),
    }


def drawn(seed: int = 3) -> tuple[supple.Deformation, dict[str, Any], dict[str, Any]]:
    transform = RandomElastic(8, (20, 30), 6)
    torch.manual_seed(seed)
    given = sample()
    made = v2.Compose([transform])(given)
    torch.manual_seed(seed)
    return transform.make_params([given["image"]])["deformation"], given, made


def test_all_of_a_sample_is_bent_by_one_draw() -> None:
    d, given, made = drawn()
    assert {key: type(value) for key, value in made.items()} == {key: type(value) for key, value in given.items()}
    for key, kind in (("image", "linear"), ("video", "linear"), ("mask", "nearest")):
        planes = given[key].numpy().reshape(-1, *SIZE)
        expected = np.stack([d.warp(plane, filter=kind) for plane in planes]).reshape(given[key].shape)
        np.testing.assert_allclose(made[key].numpy(), expected, atol=1e-6)
        assert made[key].dtype == given[key].dtype
    truth = reference.forward(reference.carried_out(d), d.domain, POINTS.numpy())
    assert np.abs(truth - POINTS.numpy()).max() > 0.5
    np.testing.assert_allclose(made["points"].numpy(), truth, atol=1e-4)
    assert made["name"] == "a sample"
    assert made["more"] is given["more"]


def test_boxes_keep_their_format_and_the_edge_at_0() -> None:
    d, given, made = drawn()
    expected = moved_boxes(d, given["boxes"].numpy() - 0.5) + 0.5
    np.testing.assert_allclose(made["boxes"].numpy(), expected, atol=1e-4)
    np.testing.assert_allclose(made["boxes"].numpy()[1], (0, 0, 120, 90), atol=1e-4)
    for kind in ("XYWH", "CXCYWH"):
        boxes = v2.functional.convert_bounding_box_format(given["boxes"], new_format=kind)
        torch.manual_seed(3)
        bent = RandomElastic(8, (20, 30), 6)({**given, "boxes": boxes})["boxes"]
        assert bent.format.value == kind
        assert bent.canvas_size == SIZE
        back = v2.functional.convert_bounding_box_format(bent, new_format="XYXY")
        np.testing.assert_allclose(back.numpy(), made["boxes"].numpy(), atol=1e-4)
    whole = tv_tensors.BoundingBoxes(torch.tensor([[20, 10, 60, 50]]), format="XYXY", canvas_size=SIZE)
    torch.manual_seed(3)
    bent = RandomElastic(8, (20, 30), 6)({**given, "boxes": whole})["boxes"]
    assert bent.dtype == torch.int64
    np.testing.assert_array_equal(bent.numpy()[0], np.round(made["boxes"].numpy()[0]))
    turned = tv_tensors.BoundingBoxes(torch.tensor([[20.0, 10, 60, 50, 10]]), format="CXCYWHR", canvas_size=SIZE)
    with pytest.raises(supple.SuppleError, match="boxes of format CXCYWHR have a rotation"):
        RandomElastic(8, 20)({**given, "boxes": turned})


def test_plain_tensors_and_pil_images_are_images() -> None:
    transform, image = (
        RandomElastic(8, (20, 30), 6, interpolation="bicubic"),
        sample()["image"].as_subclass(torch.Tensor),
    )
    torch.manual_seed(1)
    made = transform(image)
    assert type(made) is torch.Tensor
    torch.manual_seed(1)
    picture = transform(v2.functional.to_pil_image(image))
    np.testing.assert_array_equal(v2.functional.pil_to_tensor(picture).numpy(), made.numpy())
    torch.manual_seed(2)
    assert not torch.equal(transform(image), made)


def test_options_are_told_and_checked() -> None:
    told = repr(RandomElastic(8, (20, 30)))
    assert "max_displacement=8.0, radius=(20.0, 30.0), strokes=(3, 6), border=auto, interpolation=bilinear" in told
    assert RandomElastic(8, 20, interpolation=v2.InterpolationMode.NEAREST).interpolation == "nearest"
    with pytest.raises(
        supple.SuppleError, match="interpolation must be one of nearest, bilinear, bicubic, found 'box'"
    ):
        RandomElastic(8, 20, interpolation="box")
    with pytest.raises(supple.SuppleError, match='outside must be "edge" or "constant" or "reflect", found'):
        RandomElastic(8, 20, outside="zeros")
    with pytest.raises(supple.SuppleError, match="max_displacement must be"):
        RandomElastic(30, 20)
