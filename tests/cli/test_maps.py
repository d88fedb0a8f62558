"""Fields and affine maps in all commands that deform: points, render, plot and the window, as in supple warp."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import nibabel
import numpy as np
import numpy.typing as npt
import pydicom
import pytest
import SimpleITK as sitk  # noqa: N813
from scipy.ndimage import gaussian_filter

import supple
from supple import Affine, Deformation
from supple.fields import Placed
from supple.files.volumes import background_of
from supple.media import image
from supple.media import volume as media
from supple.media.points import read_points
from supple.space.geometry import Geometry
from supple.viewer.panels.layers import Registration
from supple.viewer.window.options import ViewOptions
from supple.viewer.window.volumes import placed
from tests.cli.commands import Run, told

SHAPE = (20, 24, 22)
PLACE = Geometry((4.0, 4.0, 4.0), (-45.0, -40.0, -30.0), np.eye(3), "LPS")
SEEDS = np.array([[7.0, 10.0, -3.0], [-12.0, 20.0, 13.0], [5.0, 5.0, 5.0]])
STROKE = ("--grab", "11,12,10:13,12,10", "--radius", "20")


@pytest.fixture
def composite(here: Path) -> sitk.Transform:
    """The registration of a moving volume: first a field, then an affine map; in ITK's file, composite.h5."""
    rng = np.random.default_rng(3)
    waves = np.stack([gaussian_filter(rng.normal(size=SHAPE), 4) * 90 for _ in range(3)], axis=-1)
    field = sitk.GetImageFromArray(waves, isVector=True)
    field.SetSpacing(PLACE.spacing)
    field.SetOrigin(PLACE.origin)
    turn = sitk.AffineTransform(3)
    turn.SetMatrix([1.05, 0.08, -0.03, -0.06, 0.97, 0.1, 0.02, -0.09, 1.02])
    turn.SetTranslation([3, -7, 5])
    turn.SetCenter([4, -10, 12])
    made = sitk.CompositeTransform([turn, sitk.DisplacementFieldTransform(field)])
    sitk.WriteTransform(made, "composite.h5")
    samples = gaussian_filter(rng.normal(size=SHAPE), 2).astype(np.float32)
    media.write("fixed.nii.gz", samples, media.Volume(samples, PLACE))
    _table("seeds.csv", SEEDS)
    return made


def _table(name: str, points: npt.NDArray[np.float64]) -> None:
    Path(name).write_text("l,p,s\n" + "".join(",".join(map(repr, row)) + "\n" for row in points.tolist()))


def through(transform: sitk.Transform, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([transform.TransformPoint(p) for p in points.tolist()])


def test_points_go_where_the_picture_goes(run: Run, composite: sitk.Transform) -> None:
    """Strokes and maps in any order are the map of supple warp; --inverse before them leads back."""
    grid = media.outline_of("fixed.nii.gz").grid
    field, turn = supple.read_maps("composite.h5")
    d = Deformation(grid).grab((11, 12, 10), to=(13, 12, 10), radius=20)
    d = d.affine(turn).field(field)  # type: ignore[arg-type]
    options = ("--on", "fixed.nii.gz", *STROKE, "--field", "composite.h5")
    assert run("points", "seeds.csv", "there.csv", *options)[0] == 0
    there = read_points("there.csv").points
    np.testing.assert_allclose(there, grid.positions(d.forward(grid.indices(SEEDS))), atol=1e-6)
    assert run("points", "there.csv", "back.csv", "--inverse", *options)[0] == 0
    np.testing.assert_allclose(read_points("back.csv").points, SEEDS, atol=1e-6)


def test_pictures_and_their_points(run: Run) -> None:
    Path("p.csv").write_text("x,y\n10,12\n")
    facts = told(run("points", "p.csv", "q.csv", "--on", "in.png", "--affine", "1,0,2,0,1,-3", "--json"))
    np.testing.assert_allclose(read_points("q.csv").points[:, :2], [[8, 15]], atol=1e-9)
    assert facts["displaced"][0] == pytest.approx(13**0.5)
    assert run("plot", "in.png", "plot.png", "--affine", "1,0.02,2,-0.02,1,-3")[0] == 0
    assert image.read("plot.png").pixels.std() > 5


def test_strokes_before_maps_are_not_for_the_window(run: Run, composite: sitk.Transform) -> None:
    status, _, err = run("view", "fixed.nii.gz", *STROKE, "--field", "composite.h5")
    assert (status, err.splitlines()[-1]) == (
        2,
        "supple: in the window, strokes come after fields and affine maps: give these first",
    )


def test_the_window_shows_a_volume_through_its_maps() -> None:
    samples = np.zeros((6, 8, 9), np.int16)
    samples[3, 4, 5] = 100
    shift = Affine([[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0]])
    volume = media.Volume(samples, Geometry((2.0, 1.0, 1.0), convention="LPS"), scaling=(2.0, -10.0))
    known = Registration(volume, Deformation(volume.grid, border=None), (Placed(shift),))
    seen = placed(known, ViewOptions())
    assert seen.rescaled()[3, 4, 4] == 190.0
    assert np.count_nonzero(seen.samples) == 1
    exported = ViewOptions(maps=(Placed(shift),)).export["maps"]
    assert exported == (Placed(shift),)


@pytest.mark.parametrize("n", [2, 3])
def test_ties_at_the_faces_of_a_field_are_decided_as_by_itk(n: int) -> None:
    """The near face of the first sample is of the grid, and the far face of the last one is not."""
    sizes = [5, 6, 4][:n]
    values = np.zeros((*sizes[::-1], n))
    values[..., 0] = 1.0
    theirs = sitk.DisplacementFieldTransform(sitk.GetImageFromArray(values, isVector=True))
    d = Deformation((20,) * n, border=None).field(supple.Field(values, supple.Grid(sizes[::-1])))
    for axis, size in enumerate(sizes):
        for place in (-0.5, size - 0.5, -0.5 - 1e-6, size - 0.5 - 1e-6):
            point = [2.0] * n
            point[axis] = place
            wanted = theirs.TransformPoint(point)
            np.testing.assert_allclose(d.inverse(np.array(point)).points, wanted, atol=1e-9, err_msg=str(point))
            assert (wanted[0] == point[0]) == (place in (size - 0.5, -0.5 - 1e-6))


def _put(name: str, samples: npt.NDArray[np.generic], shift: float = 0.0, **known: object) -> None:
    place = Geometry((1.0, 1.0, 1.0), (shift, 0.0, 0.0), np.eye(3), "LPS")
    media.write(name, samples, media.Volume(samples, place, **known))  # type: ignore[arg-type]


TURN = ("--affine", "0.9,0.2,0,1,-0.2,0.9,0,2,0,0,1,0")


@pytest.mark.parametrize("maps", [(), TURN])
def test_what_lies_outside_of_a_volume_is_a_constant_on_the_grid_of_a_reference(
    run: Run, maps: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(1)
    _put("moving.nii.gz", rng.integers(-700, 900, (8, 10, 12)).astype(np.int16), 3.0)
    _put("fixed.nii.gz", np.zeros((10, 12, 30), np.uint8))
    least = int(media.read("moving.nii.gz").samples.min())
    reference = (*maps, "--reference", "fixed.nii.gz")
    status, out, err = run("warp", "moving.nii.gz", "seen.nii.gz", *reference, "--json")
    assert status == 0, err
    assert json.loads(out)["background"] == least
    assert f"what lies outside of moving.nii.gz is {least} in seen.nii.gz" in err
    assert "warning" not in err
    seen = media.read("seen.nii.gz").samples
    np.testing.assert_array_equal(seen[:, :, 20:], least)
    assert run("warp", "moving.nii.gz", "strict.nii.gz", *reference, "--strict")[0] == 0
    for options, value in ((("--outside", "edge"), None), (("--fill", "7"), 7), (("--outside=constant",), 0)):
        status, out, err = run("warp", "moving.nii.gz", "other.nii.gz", *reference, *options, "--json", "--force")
        assert (status, "background" in json.loads(out), "what lies outside" in err) == (0, False, False)
        far = media.read("other.nii.gz").samples[:, :, 22:]
        assert (far == value).all() if value is not None else far.std() > 50
    status, out, _ = run("warp", "moving.nii.gz", "own.nii.gz", *TURN, "--json")
    assert (status, "background" in json.loads(out)) == (0, False)


def test_the_constant_is_scaled_and_of_labels_it_is_0(run: Run) -> None:
    counts = np.random.default_rng(1).integers(10, 90, (8, 10, 12)).astype(np.int16)
    _put("fixed.nii.gz", np.zeros((8, 10, 30), np.uint8))
    _put("plain.nii", counts)
    header = nibabel.load("plain.nii").header
    raw = bytearray(Path("plain.nii").read_bytes())
    raw[112:120] = np.array([2.0, -1000.0], header["scl_slope"].dtype.newbyteorder(header.endianness)).tobytes()
    Path("scaled.nii").write_bytes(raw)
    facts = told(run("warp", "scaled.nii", "out.nii", "--reference", "fixed.nii.gz", "--json"))
    assert facts["background"] == 2.0 * counts.min() - 1000
    assert (media.read("out.nii").rescaled()[..., 15:] == 2.0 * counts.min() - 1000).all()
    status, out, _ = run("warp", "plain.nii", "labels.nii", "--reference", "fixed.nii.gz", "--json", "--labels")
    assert (status, json.loads(out)["background"]) == (0, 0.0)
    assert (media.read("labels.nii").samples[..., 15:] == 0).all()
    for source in ("plain.nii", "plain.zarr"):
        if source == "plain.zarr":
            assert run("warp", "plain.nii", source, "--resample", "1")[0] == 0
        target = f"{Path(source).suffix[1:]}-out.zarr"
        facts = told(run("warp", source, target, "--reference", "fixed.nii.gz", "--json"))
        assert facts["background"] == (counts.min() if source == "plain.nii" else 0)


def test_the_padding_of_dicom_lies_outside(tmp_path: Path) -> None:
    head = pydicom.Dataset()
    head.PixelPaddingValue, head.RescaleSlope, head.RescaleIntercept = 24, "1", "-1024"
    head.file_meta = pydicom.dataset.FileMetaDataset()
    head.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    head.file_meta.MediaStorageSOPClassUID = head.SOPClassUID = pydicom.uid.CTImageStorage
    head.file_meta.MediaStorageSOPInstanceUID = head.SOPInstanceUID = pydicom.uid.generate_uid()
    head.add_new(0x00280103, "US", 0)
    path = str(tmp_path / "slice.dcm")
    head.save_as(path, enforce_file_format=True)
    samples = np.full((2, 3, 4), 40, np.int16)
    volume = media.Volume(samples, PLACE, format="DICOM", header=(path,))
    assert background_of(volume) == -1000.0
    assert background_of(volume, labels=True) == 0.0
    assert background_of(replace(volume, format="NIfTI")) == 40.0


def test_labels_are_those_of_the_largest_share_or_the_nearest(run: Run) -> None:
    rng = np.random.default_rng(2)
    labels = (gaussian_filter(rng.normal(size=(4, *SHAPE)), (0, 2, 2, 2)).argmax(axis=0) * 11).astype(np.uint8)
    media.write("regions.nii.gz", labels, media.Volume(labels, PLACE))
    d = Deformation(media.outline_of("regions.nii.gz").grid).grab((11, 12, 10), to=(13, 12, 10), radius=20)
    for words, name in ((("--labels", "smooth"), "labels"), (("--labels", "nearest"), "nearest")):
        status, _, err = run("warp", "regions.nii.gz", f"{name}.nii.gz", *STROKE, *words)
        assert status == 0, err
        assert "mixed" not in err
        np.testing.assert_array_equal(media.read(f"{name}.nii.gz").samples, d.warp(labels, filter=name))
    assert run("warp", "--labels", "regions.nii.gz", "bare.nii.gz", *STROKE)[0] == 0
    np.testing.assert_array_equal(media.read("bare.nii.gz").samples, media.read("nearest.nii.gz").samples)
    assert (media.read("bare.nii.gz").samples != media.read("regions.nii.gz").samples).any()
    zarr = pytest.importorskip("zarr")
    for source, target in (("regions.nii.gz", "labels.zarr"), ("labels.zarr", "again.zarr")):
        assert run("warp", source, target, *STROKE, "--labels", "smooth")[0] == 0
    first, second = (zarr.open(name) for name in ("labels.zarr", "again.zarr"))
    found = [each["0"] if hasattr(each, "keys") else each for each in (first, second)]
    np.testing.assert_array_equal(found[0][...], d.warp(labels, filter="labels"))
    np.testing.assert_array_equal(found[1][...], d.warp(found[0][...], filter="labels"))
    status, _, err = run("warp", "regions.nii.gz", "no.nii.gz", *STROKE, "--labels", "smooth", "--filter", "linear")
    assert (status, err) == (
        2,
        'supple: --labels needs filter "auto", which keeps values as they are, found "linear"\n',
    )
