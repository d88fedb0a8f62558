"""Files of all kinds, good and bad, that commands are given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import SimpleITK as sitk  # noqa: N813
import zarr

from supple import Field
from supple.media import image, transforms, volume
from supple.space.geometry import Geometry
from tests import clips
from tests.cli.commands import noise
from tests.files.clip_files import noisy
from tests.media.landmarks import fcsv
from tests.media.transforms.mapping import DATA

PLACE = np.diag([2.0, 2.0, 2.0, 1.0])
FAR = PLACE + np.outer([1, 1, 1, 0], [0, 0, 0, 900.0])
WAVES = np.zeros((9, 8, 7, 1, 3), np.float32)
WAVES[..., 0] = np.sin(np.arange(9) / 3)[:, None, None, None]
GREY = np.arange(504, dtype=np.float32).reshape(9, 8, 7)


def nifti(name: str, values: Any, code: int = 0, matrix: Any = PLACE, dtype: Any = np.float32) -> None:
    made = nibabel.Nifti1Image(np.asarray(values, dtype), matrix)
    made.header["intent_code"] = code
    if matrix is None:
        made.header["sform_code"] = made.header["qform_code"] = 0
    nibabel.save(made, name)


def write_inputs() -> None:
    """Write all of them into the current folder."""
    write_maps()
    write_pictures()
    write_points()
    for name in ("empty.nii", "empty.nii.gz", "empty.npy", "empty.tfm", "photo.jpg", "clip.mp4"):
        Path(name).write_bytes(b"")
    for name in ("folder.nii", "folder"):
        Path(name).mkdir()
    for name in ("taken.mp4", "text.nii.gz", "in.raw", "there.nii"):
        Path(name).write_text("this is text")
    clips.make("in.mp4", count=12)
    noisy("in.mkv", "yuv420p")
    for name, shape in (("in.zarr", (40, 48)), ("there.zarr", (4, 4))):
        zarr.create_array(
            name,
            data=np.arange(np.prod(shape), dtype=np.uint16).reshape(shape),
            chunks=(20, 24) if shape[0] > 4 else shape,
        )


def write_maps() -> None:
    for name, matrix in (("", PLACE), ("far-", FAR), ("nowhere-", None)):
        nifti(f"{name}head.nii", GREY, matrix=matrix)
        nifti(f"{name}u.nii", WAVES, 1007, matrix)
    nifti("code.nii", WAVES, 1002)
    nifti("complex.nii", WAVES, 1007, dtype=np.complex64)
    gapped = WAVES.copy()
    gapped[2, 3, 4] = np.nan
    nifti("nan.nii", gapped, 1007)
    nifti("mask.nii", GREY > 200, dtype=np.uint8)
    nifti("two.nii", WAVES[..., :2], 1007)
    nifti("four.nii", WAVES[..., [0, 1, 2, 0]], 1007)
    whole = Path("u.nii").read_bytes()
    Path("cut.nii").write_bytes(whole[:-9])
    nibabel.save(nibabel.load("u.nii"), "whole.nii.gz")
    Path("cut.nii.gz").write_bytes(Path("whole.nii.gz").read_bytes()[:-20])
    places = np.moveaxis(np.indices((40, 48))[::-1], 0, -1).astype(np.float32)
    np.save("flow.npy", places + np.sin(places / 5))
    Field.from_array(np.sin(places / 5)).write("flow.yml")
    Field.from_array(np.sin(places[:20, :30] / 5)).write("tiny.yml")
    np.save("one.npy", places[..., 0])
    np.save("complex.npy", places.astype(np.complex64))
    places[3, 4] = np.nan
    np.save("nan.npy", places)
    Path("cut.npy").write_bytes(Path("flow.npy").read_bytes()[:-9])
    sitk.WriteTransform(sitk.AffineTransform(3), "a.tfm")
    spline = sitk.BSplineTransformInitializer(sitk.Image([9, 9, 9], sitk.sitkUInt8), [1, 2, 3])
    sitk.WriteTransform(spline, "b.h5")
    field = Field.read("u.nii")
    field.write("u.mha")
    transforms.write("both.h5", [np.eye(4), transforms.Displacements(field.values, field.grid)])
    colours = np.zeros((9, 8, 7), [("R", "u1"), ("G", "u1"), ("B", "u1")])
    nibabel.save(nibabel.Nifti1Image(colours, PLACE), "rgb.nii")
    samples = np.zeros((20, 26, 24), np.int16)
    for name in ("in.nii", "stack.tif"):
        volume.write(name, samples, volume.Volume(samples, Geometry(convention="LPS")))


def write_pictures() -> None:
    image.write("in.png", noise(40, 48), force=True)
    image.write("small.png", noise(20, 30))
    Path("cut.exr").write_bytes((DATA / "stmap-float.exr").read_bytes()[:1500])
    image.write("photo.png", np.zeros((9, 9), np.uint8))
    image.write("square.png", noise(20, 20, 1))
    image.write("labels.png", np.arange(40 * 48, dtype=np.uint8).reshape(40, 48) % 3)
    image.write("clear.png", noise(40, 48, 4))


def write_points() -> None:
    for name, text in {
        "a.csv": "label,x,y\np,12,20\nq,30,20\n",
        "other.csv": "label,x,y\np,12,20\nz,30,20\n",
        "edge.csv": "label,x,y\np,-1,20\nq,30,21\n",
        "d.csv": "x,y\n14,21\n28,21\n",
        "few.csv": "x,y\n14,21\n",
        "same.csv": "x,y\n12,20\n12,20\n",
        "same2.csv": "x,y\n13,20\n12,21\n",
        "seeds.csv": "l,p,s\n1,2,3\n",
        "p.fcsv": fcsv(np.ones((1, 3))),
        "flat.fcsv": fcsv(np.ones((1, 3)), "RAS"),
    }.items():
        Path(name).write_text(text)
