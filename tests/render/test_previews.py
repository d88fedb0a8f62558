"""Previews of a warped volume: every so many voxels of it, before the same camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import supple
from supple import Deformation
from supple.errors import SuppleError
from supple.files.volumes import open_volume
from supple.render.camera import Camera
from supple.render.scene import Scene

DATA = Path(supple.__file__).parent / "examples" / "data"


def bent() -> tuple[Scene, Deformation, Camera]:
    head = open_volume(DATA / "head.nii.gz")
    scene = Scene(head.samples, head.geometry, transfer="mr-head", mode="buffered", shadows=0.5)
    deformation = Deformation(head.samples.shape, spacing=head.geometry.spacing).grab(
        (40, 86, 65), to=(44, 63, 53), radius=36
    )
    return scene, deformation, scene.framed(Camera(azimuth=30), (120, 120))


@pytest.mark.parametrize(("coarse", "off"), [(1, 0.0), (2, 0.02), (4, 0.06)])
def test_every_so_many_voxels_show_the_same_in_the_same_place(coarse: int, off: float) -> None:
    scene, deformation, camera = bent()
    whole, rough = scene.deformed(deformation), scene.deformed(deformation, coarse=coarse)
    assert rough.coarse == coarse
    one, other = (each.render(camera, (120, 120)).light for each in (whole, rough))
    assert np.abs(one - other).mean() <= off
    picks = [each.pick(camera, (120, 120), (60, 50)) for each in (whole, rough)]
    assert picks[0] is not None
    assert picks[1] is not None
    np.testing.assert_allclose(picks[1].index, picks[0].index, atol=0.75 * coarse - 0.7)
    assert rough.view(camera, (120, 120)).distance == whole.view(camera, (120, 120)).distance


def test_they_are_cut_where_the_whole_is() -> None:
    scene, deformation, camera = bent()
    box = ((20.0, 70.0), (10.0, 60.0), (13.0, 81.0))
    one, other = (scene.clipped(box).deformed(deformation, coarse=k).render(camera, (120, 120)).depth for k in (1, 3))
    both = np.isfinite(one) & np.isfinite(other)
    assert (np.isfinite(one) ^ np.isfinite(other)).mean() < 0.02
    assert np.median(np.abs(one[both] - other[both])) < 0.5


def test_labels_and_colours_have_them_too() -> None:
    z, y, x = np.mgrid[:20, :21, :22]
    labels = np.where((x - 10) ** 2 + (y - 10) ** 2 + (z - 9) ** 2 < 50, 3, 0).astype(np.uint8)
    colours = np.zeros((*labels.shape, 3), np.uint8)
    colours[labels == 3] = 200, 40, 90
    deformation = Deformation(labels.shape).grab((10, 3, 9), by=(2, 0, 1), radius=5)
    for samples, transfer in ((labels, "labels"), (colours, "grey")):
        scene = Scene(samples, transfer=transfer)
        one, other = (scene.deformed(deformation, coarse=k).render(Camera(azimuth=20), (60, 60)).light for k in (1, 2))
        assert one[..., 3].max() > 0.5
        assert np.abs(one - other).mean() < 0.03


def test_no_voxels_at_all_are_refused() -> None:
    scene, deformation, _ = bent()
    with pytest.raises(SuppleError, match="coarse must be a number of voxels from 1 to 64, found 0"):
        scene.deformed(deformation, coarse=0)
