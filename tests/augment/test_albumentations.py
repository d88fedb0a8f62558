"""The transforms of Albumentations: its targets, in its conventions."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest

import supple
from tests import reference
from tests.augment.libraries import library

A = library("albumentations")

from supple.augment import moved_boxes
from supple.augment.albumentations import RandomElastic, RandomElastic3D

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (90, 120, 3), np.uint8)
LABELS = RNG.integers(0, 9, (90, 120)).astype(np.uint8)
POINTS = [(30.0, 40.0), (61.5, 22.25), (100.0, 80.0)]
VOLUME = RNG.random((12, 40, 50), np.float32)


def composed(transform: Any, **more: Any) -> Any:
    return A.Compose([transform], seed=5, **more)


def last(transform: Any, shape: tuple[int, ...], **options: Any) -> supple.Deformation:
    recipe = supple.Recipe.from_json(transform.params["recipe"])
    return supple.Deformation.from_recipe(recipe, shape, **options)


def test_all_of_a_sample_is_bent_by_one_draw() -> None:
    transform = RandomElastic(8, (20, 30), 6, p=1)
    boxes = [[20, 10, 60, 50], [0, 0, 120, 90]]
    pipeline = composed(
        transform,
        bbox_params=A.BboxParams("pascal_voc", label_fields=["kinds"]),
        keypoint_params=A.KeypointParams("xy"),
    )
    made = pipeline(
        image=IMAGE, mask=LABELS, masks=[LABELS, LABELS + 1], bboxes=boxes, kinds=[1, 2], keypoints=POINTS,
        images=np.stack([IMAGE, IMAGE[::-1]]),
    )  # fmt: skip
    d = last(transform, IMAGE.shape[:2])
    np.testing.assert_array_equal(made["image"], d.warp(IMAGE, filter="linear"))
    np.testing.assert_array_equal(made["images"][1], d.warp(IMAGE[::-1], filter="linear"))
    np.testing.assert_array_equal(made["mask"], d.warp(LABELS, filter="nearest"))
    np.testing.assert_array_equal(made["masks"][1], made["mask"] + 1)
    truth = reference.forward(reference.carried_out(d), d.domain, POINTS)
    assert np.abs(truth - POINTS).max() > 0.5
    np.testing.assert_allclose(made["keypoints"], truth, atol=1e-4)
    expected = moved_boxes(d, np.array(boxes) - 0.5) + 0.5
    np.testing.assert_allclose(made["bboxes"], expected, atol=1e-3)
    np.testing.assert_allclose(made["bboxes"][1], boxes[1], atol=1e-3)
    none = pipeline(image=IMAGE, bboxes=[], kinds=[], keypoints=[])
    assert (len(none["bboxes"]), len(none["keypoints"])) == (0, 0)
    again = pipeline.__class__([RandomElastic(8, (20, 30), 6, p=1)], seed=5)(image=IMAGE)
    np.testing.assert_array_equal(again["image"], made["image"])


def test_slices_of_a_volume_are_bent_alike() -> None:
    transform = RandomElastic(5, (10, 15), 6, p=1)
    made = composed(transform)(volume=VOLUME, mask3d=(VOLUME > 0.5).astype(np.uint8), volumes=np.stack([VOLUME] * 2))
    d = last(transform, VOLUME.shape[1:])
    expected = np.stack([d.warp(each, filter="linear") for each in VOLUME])
    np.testing.assert_array_equal(made["volume"], expected)
    np.testing.assert_array_equal(made["volumes"][1], expected)
    np.testing.assert_array_equal(made["mask3d"][3], d.warp((VOLUME[3] > 0.5).astype(np.uint8), filter="nearest"))
    assert transform(image=IMAGE, force_apply=True)["image"].shape == IMAGE.shape


def test_volumes_are_bent_in_space() -> None:
    transform = RandomElastic3D(5, (10, 15), 6, spacing=(1, 1, 2.5), p=1)
    points = [(20.0, 20.0, 6.0), (35.0, 15.0, 3.0)]
    labels = (VOLUME > 0.5).astype(np.uint8)
    made = composed(transform, keypoint_params=A.KeypointParams("xyz"))(volume=VOLUME, mask3d=labels, keypoints=points)
    d = last(transform, VOLUME.shape, spacing=(1, 1, 2.5))
    np.testing.assert_array_equal(made["volume"], d.warp(VOLUME, filter="linear"))
    np.testing.assert_array_equal(made["mask3d"], d.warp(labels, filter="nearest"))
    truth = reference.forward(reference.carried_out(d), d.domain, points)
    assert np.abs(truth - points)[:, 2].max() > 0.02
    np.testing.assert_allclose(made["keypoints"], truth, atol=1e-4)


def test_a_draw_is_replayed_and_options_are_written() -> None:
    made = A.ReplayCompose([RandomElastic(8, (20, 30), p=1)])(image=IMAGE)
    replayed = json.loads(json.dumps(made["replay"]))
    np.testing.assert_array_equal(A.ReplayCompose.replay(replayed, image=IMAGE)["image"], made["image"])
    with pytest.raises(supple.SuppleError, match=r"source must be of shape \(90, 120\)"):
        A.ReplayCompose.replay(replayed, image=IMAGE[:, :100])
    transform = RandomElastic(8, (20, 30), (2, 4), border=None, interpolation=cv2.INTER_CUBIC, outside="reflect")
    again = A.from_dict(A.to_dict(transform))
    assert repr(again) == repr(transform)
    assert "max_displacement=8.0, outside='reflect', radius=(20.0, 30.0), strokes=(2, 4)" in repr(again)
    assert sum(RandomElastic(8, 20, p=0.5)(image=IMAGE)["image"] is not IMAGE for _ in range(40)) not in (0, 40)


def test_bad_options_are_refused() -> None:
    with pytest.raises(supple.SuppleError, match="interpolation must be one of 0, 1, 2, found 4"):
        RandomElastic(8, 20, interpolation=cv2.INTER_LANCZOS4)
    with pytest.raises(ValueError, match="outside"):  # of Albumentations, or of Supple where it checks nothing
        RandomElastic(8, 20, outside="wrap")
    with pytest.raises(supple.SuppleError, match=r"^volume must be given to RandomElastic3D \(.*\), found image$"):
        A.Compose([RandomElastic3D(5, 10, p=1)])(image=np.zeros((20, 20, 3), np.uint8))
    with pytest.raises(supple.SuppleError, match="max_displacement must be"):
        RandomElastic(30, 20)
