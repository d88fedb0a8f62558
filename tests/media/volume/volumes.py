"""Volumes and files of them, made and read by others than the package."""

import gzip
import struct

import nibabel
import numpy as np
import pydicom
import SimpleITK as sitk  # noqa: N813

from supple.media.volume import Volume, read
from supple.space.geometry import Geometry
from tests import refusals
from tests.media.image.pictures import noise

SPACING, ORIGIN = (0.7, 1.1, 2.3), (-12.5, 33.25, 7.125)
DTYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
PLACED = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd")
VOXELS = ((0, 0, 0), (5, 2, 1), (2, 4, 3))  # x, y, z: within every volume of these tests
SHAPE = (4, 5, 6)


def turned(*, flipped=True):
    """Directions along no axis of the patient; flipped, they are left-handed."""
    axis = np.array([0.3, -0.5, 0.8]) / np.sqrt(0.98)
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) + np.sin(0.6) * cross + (1 - np.cos(0.6)) * cross @ cross
    return turn * ([1, -1, 1] if flipped else [1, 1, 1])


def volume(samples, **options):
    geometry = Geometry(SPACING, ORIGIN, turned(), "LPS")
    return Volume(samples, geometry, "made here", "", **options)


def image(samples, *, flipped=True, vector=False):
    """Make an image with SimpleITK alone."""
    made = sitk.GetImageFromArray(samples, isVector=vector)
    made.SetSpacing(SPACING)
    made.SetOrigin(ORIGIN)
    made.SetDirection(turned(flipped=flipped).ravel().tolist())
    return made


def by_itk(path):
    """The places in LPS of some voxels, and their values, by SimpleITK alone."""
    known = sitk.ReadImage(str(path))
    array = sitk.GetArrayFromImage(known)
    return [known.TransformIndexToPhysicalPoint(v) for v in VOXELS], [array[v[::-1]] for v in VOXELS]


def by_nibabel(path):
    """The places in LPS of some voxels, and their values, by nibabel alone."""
    known = nibabel.load(path)
    places = nibabel.affines.apply_affine(known.affine, VOXELS) * [-1, -1, 1]
    return places, [np.asarray(known.dataobj)[v] for v in VOXELS]


def by_us(path):
    known = read(path)
    return known.geometry.to_lps(VOXELS), [known.rescaled()[v[::-1]] for v in VOXELS]


def agree(*found, atol=1e-4):
    for places, values in found[1:]:
        np.testing.assert_allclose(places, found[0][0], atol=atol)
        np.testing.assert_array_equal(values, found[0][1])


def nifti(path, samples=None, affine=None, change=(), kind=nibabel.Nifti1Image):
    """Write a NIfTI file with nibabel alone, and then overwrite fields of its header."""
    samples = noise("i2", *SHAPE) if samples is None else samples
    affine = np.diag([-1, -1, 1, 1.0]) @ np.array(volume(samples).geometry.matrix) if affine is None else affine
    made = kind(samples.T, affine)
    made.to_filename(path)
    packed = path.suffix == ".gz"
    data = bytearray(gzip.decompress(path.read_bytes()) if packed else path.read_bytes())
    for offset, form, *values in change:
        struct.pack_into(form, data, offset, *values)
    path.write_bytes(gzip.compress(data) if packed else data)
    return path


def item(**values):
    made = pydicom.Dataset()
    for name, value in values.items():
        setattr(made, name, value)
    return made


def save(path, head, *, explicit=True):
    """Write a dataset as a DICOM file."""
    head.file_meta = pydicom.dataset.FileMetaDataset()
    kinds = pydicom.uid.ExplicitVRLittleEndian, pydicom.uid.ImplicitVRLittleEndian
    head.file_meta.TransferSyntaxUID = kinds[not explicit]
    head.save_as(path, enforce_file_format=True)
    return path


def refused(action, path, *arguments, **options):
    """Return the one line that an action is refused with, which must name the file."""
    message = refusals.refused(action, path, *arguments, **options)
    assert message.startswith(f"cannot {action.__name__} ")
    assert "0x" not in message
    assert len(message) < 400
    return message
