"""FreeSurfer's .mgz and .mgh: against nibabel, and through whole commands."""

from __future__ import annotations

import gzip
from pathlib import Path

import nibabel
import numpy as np
import pytest

import supple
from supple import SuppleError
from supple.files import warp_file
from supple.files.options import GridOptions, VolumeOptions
from supple.media.volume import info, is_volume, outline_of, read, write
from supple.media.volume.mgh import _TYPES
from tests import refusals
from tests.media.volume import volumes

SHAPE = (9, 7, 5)  # x first
TAGS = b"\x00\x00\x00\x03\x00\x00\x00\x00\x00\x00\x00\x04mri_"  # a command line, as FreeSurfer notes it


def affine() -> np.ndarray:
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn * (0.8, 1.1, 2.5), (-31.5, 20.25, 7.75)
    return made


def theirs(path: Path, dtype: str = "float32", *, frames: int = 1, tags: bytes = TAGS) -> nibabel.MGHImage:
    data = (np.random.default_rng(0).normal(size=(*SHAPE, frames)[: 3 + (frames > 1)]) * 100).astype(dtype)
    made = nibabel.MGHImage(data, affine())
    if frames > 1:
        made.header["tr"] = 2500
    made.header["te"], made.header["flip_angle"] = 3.5, 0.25
    nibabel.save(made, path)
    whole = (gzip.decompress(path.read_bytes()) if path.suffix == ".mgz" else path.read_bytes()) + tags
    path.write_bytes(gzip.compress(whole) if path.suffix == ".mgz" else whole)
    return made


@pytest.mark.parametrize("dtype", _TYPES)
@pytest.mark.parametrize("suffix", [".mgz", ".mgh"])
@pytest.mark.parametrize("frames", [1, 3])
def test_there_and_back_every_byte_is_kept(tmp_path: Path, dtype: str, suffix: str, frames: int) -> None:
    path, out = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    wanted = theirs(path, dtype, frames=frames)
    volume = read(path)
    np.testing.assert_array_equal(volume.samples, np.asarray(wanted.dataobj).T)
    assert (volume.samples.dtype, volume.format, volume.series) == (np.dtype(dtype), "MGH", frames > 1)
    assert volume.interval == (2.5 if frames > 1 else 1.0)
    index = np.array([(0, 0, 0), (8, 6, 4), (2, 5, 1)])
    ras = nibabel.affines.apply_affine(wanted.affine, index)
    np.testing.assert_allclose(volume.geometry.to_world(index, "RAS"), ras, atol=1e-4)
    write(out, volume.samples, volume)
    one, two = ((gzip.decompress(p.read_bytes()) if suffix == ".mgz" else p.read_bytes()) for p in (path, out))
    assert one == two
    assert is_volume(path)
    assert outline_of(path).geometry.matrix == pytest.approx(volume.geometry.matrix)
    assert info(path)["format"] == "MGH"


@pytest.mark.parametrize("suffix", [".mgz", ".mgh"])
@pytest.mark.parametrize("series", [False, True])
def test_what_comes_from_other_formats_is_as_nibabel_reads_it(tmp_path: Path, suffix: str, series: bool) -> None:
    samples = volumes.noise("i2", *((3,) if series else ()), *volumes.SHAPE)
    like = volumes.volume(samples, series=series, interval=0.5) if series else volumes.volume(samples)
    write(tmp_path / f"out{suffix}", samples, like)
    data = (tmp_path / f"out{suffix}").read_bytes()
    found = nibabel.MGHImage.from_bytes(gzip.decompress(data) if suffix == ".mgz" else data)
    np.testing.assert_array_equal(np.asarray(found.dataobj), samples.T)
    places = nibabel.affines.apply_affine(found.affine, volumes.VOXELS)
    np.testing.assert_allclose(places * (-1, -1, 1), like.geometry.to_lps(volumes.VOXELS), atol=1e-4)
    assert not series or found.header["tr"] == 500


def test_a_warp_keeps_header_and_place_and_takes_those_of_a_reference(tmp_path: Path) -> None:
    source = tmp_path / "in.mgz"
    theirs(source)
    recipe = supple.Recipe(strokes=(supple.Stroke.grab((4, 3, 2), by=(1, 0, 0), radius=4),))
    made = warp_file(source, tmp_path / "bent.mgz", recipe)
    bent, before = read(tmp_path / "bent.mgz"), read(source)
    np.testing.assert_array_equal(bent.geometry.matrix, before.geometry.matrix)
    assert bent.header[0].binaryblock == before.header[0].binaryblock
    assert bent.header[1] == TAGS
    assert (bent.samples != before.samples).any()
    wanted = made.deformation.warp(before.samples, between="cubic", time_filter=True, clamp=True)
    np.testing.assert_array_equal(bent.samples, wanted)
    other = warp_file(source, tmp_path / "on.mgz", supple.Recipe(), grid=GridOptions(resample=1.0))
    found = nibabel.load(tmp_path / "on.mgz")
    assert other.grid is not None
    np.testing.assert_allclose(np.diag([-1, -1, 1, 1]) @ found.affine, other.grid.matrix, atol=1e-4)
    assert found.shape == other.grid.sizes
    assert found.header["te"] == 3.5
    labels = tmp_path / "aseg.mgz"
    theirs(labels, "int32")
    warp_file(labels, tmp_path / "bent-aseg.mgz", recipe, volume=VolumeOptions(labels="smooth"))
    assert set(np.unique(read(tmp_path / "bent-aseg.mgz").samples)) <= set(np.unique(read(labels).samples))


def test_what_the_format_does_not_hold_is_refused(tmp_path: Path) -> None:
    for samples, text in (
        (volumes.noise("u2", *volumes.SHAPE), "FreeSurfer's files hold no uint16 values, but uint8, int16, int32"),
        (volumes.noise("u1", *volumes.SHAPE, 3), "has 3 values for each voxel: use .nii.gz"),
    ):
        with pytest.raises(SuppleError, match=text):
            write(tmp_path / "out.mgz", samples, volumes.volume(samples))
    assert not (tmp_path / "out.mgz").exists()


def test_damage_is_told_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "in.mgh"
    theirs(path)
    data = path.read_bytes()
    for damaged, text in (
        (data[:200], "it is no .mgz or .mgh file"),
        (b"PNG!" + data[4:], "it is no .mgz or .mgh file"),
        (data[:900], "its header promises 1544 bytes, and it has 900"),
        (data[:20] + (99).to_bytes(4, "big") + data[24:], "voxels of type 99"),
        (data[:4] + bytes(4) + data[8:], "it holds 0 x 7 x 5 x 1 voxels"),
        (data[:30] + b"\x7f\xc0\0\0" * 15 + data[90:], "its spacing is nan x nan x nan"),
    ):
        path.write_bytes(damaged)
        refusals.refused(read, path, match=f"^cannot read .*in.mgh: .*{text}")
    packed = tmp_path / "in.mgz"
    packed.write_bytes(gzip.compress(data)[:-400])
    with pytest.raises(SuppleError, match=r"in.mgz: it is cut short"):
        read(packed)
