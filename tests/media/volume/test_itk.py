"""Formats that ITK reads and writes."""

import gzip
import os
from dataclasses import replace

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from supple.errors import SuppleError
from supple.media.volume import check_target, read, write
from tests.media.volume.volumes import SHAPE, agree, by_itk, by_us, image, noise, refused, volume


class TestITKFormats:
    @pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
    def test_what_else_the_header_says_stays(self, tmp_path, suffix):
        made = image(noise("i2", *SHAPE))
        made.SetMetaData("study", "a b c")
        sitk.WriteImage(made, str(tmp_path / f"in{suffix}"))
        known = read(tmp_path / f"in{suffix}")
        write(tmp_path / f"out{suffix}", known.samples, known)
        again = sitk.ReadImage(str(tmp_path / f"out{suffix}"))
        assert again.GetMetaData("study") == "a b c"
        before, after = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("in", "out"))
        head = [
            line
            for line in before[:700].split(b"\n")[:12]
            if not any(known in line for known in (b"encoding", b"NRRD000", b"space directions"))
        ]
        assert all(line in after for line in head)

    @pytest.mark.parametrize("layers", [1, 2])
    def test_extents_of_segments_follow_their_voxels(self, tmp_path, layers):
        samples = np.zeros((*SHAPE, layers) if layers > 1 else SHAPE, np.uint8)
        known = {"Segmentation_ReferenceImageExtentOffset": "3 0 0", "Segment1_Extent": "0 5 0 4 0 3", "0028|0107": "9"}
        known |= {"Segment0_Extent": "0 1 0 1 0 1", "Segment0_LabelValue": "7", "Segment0_Layer": "0", "unit": "no"}
        if layers > 1:
            known |= {"Segment2_Extent": "0 1 0 1 0 1", "Segment2_LabelValue": "7", "Segment2_Layer": "9"}
        like = replace(volume(samples), format="NRRD", header=known)
        moved = samples.copy()
        first, last = (moved[..., 0], moved[..., 1]) if layers > 1 else (moved, moved)
        first[1:3, 2:4, 1:5], last[3, 4, 5] = 7, 1 if layers > 1 else 2
        write(tmp_path / "out.seg.nrrd", moved, like)
        header = read(tmp_path / "out.seg.nrrd").header
        assert header["Segment0_Extent"] == "1 4 2 3 1 2"
        # without a label of its own, a segment is 1, in the layer of its number
        assert header["Segment1_Extent"] == ("5 5 4 4 3 3" if layers > 1 else "0 -1 0 -1 0 -1")
        assert header["Segmentation_ReferenceImageExtentOffset"] == "3 0 0"
        assert not {"Segment2_Extent", "0028|0107"} & set(header)
        write(tmp_path / "crop.nrrd", moved, replace(like, regridded=True))
        assert "Segmentation_ReferenceImageExtentOffset" not in read(tmp_path / "crop.nrrd").header

    def test_a_nrrd_in_ras(self, tmp_path):
        samples = noise("i2", *SHAPE)
        head = "NRRD0004\ntype: short\ndimension: 3\nspace: right-anterior-superior\nsizes: 6 5 4\n"
        head += "space directions: (1,0,0) (0,2,0) (0,0,3)\nendian: little\nencoding: raw\nspace origin: (5,6,7)\n\n"
        (tmp_path / "in.nrrd").write_bytes(head.encode() + samples.tobytes())
        np.testing.assert_array_equal(read(tmp_path / "in.nrrd").samples, samples)
        places = read(tmp_path / "in.nrrd").geometry.to_world([[0, 0, 0], [1, 1, 1]], "RAS")
        np.testing.assert_allclose(places, [[5, 6, 7], [6, 8, 10]])

    def test_the_data_file_has_the_name_that_the_header_tells(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        (tmp_path / "sub").mkdir()
        write(tmp_path / "sub" / "an out.mhd", like.samples, like)
        (tmp_path / "sub").rename(tmp_path / "moved")
        agree(by_us(tmp_path / "moved" / "an out.mhd"), by_itk(tmp_path / "moved" / "an out.mhd"))
        assert (tmp_path / "moved" / "an out.raw").stat().st_size == like.samples.nbytes

    @pytest.mark.parametrize(
        ("suffix", "old", "new", "told"),
        [
            (".mha", "ElementSpacing = 1", "ElementSpacing = 0", "spacing is 0 x"),
            (".mha", "ElementSpacing = 1", "ElementSpacing = -1", "spacing is -1 x"),
            (".mha", "ElementSpacing = 1", "ElementSpacing = nan", "spacing is nan x 2 x 3"),
            (".mha", "DimSize = 6 5 4", "DimSize = 6 -5 4", "its header says 6 x -5 x 4"),
            (".mha", "DimSize = 6 5 4", "DimSize = 60000 50000 40000", "60000 x 50000 x 40000"),
            (".mha", "DimSize = 6 5 4", "DimSize = 6 5 8", "cut short"),
            (".nrrd", "sizes: 6 5 4", "sizes: 6 0 4", "size is zero"),
            (".nrrd", "sizes: 6 5 4", "sizes: 60000 50000 40000", "60000 x 50000 x 40000"),
            (".nrrd", "sizes: 6 5 4", "sizes: 6 5 8", "cut short"),
            (".nrrd", "space directions: (1", "space directions: (0", "spacing is 0 x"),
            (".nrrd", "space directions: (1", "space directions: (nan", "space vector"),
            (".nrrd", "space directions: (1,0,0)", "space directions: (0.01,1,0)", "in a plane"),
            (".nrrd", "type: short", "type: long double", ""),
            (".nrrd", "NRRD0004", "NRXD0004", "no NRRD file"),
        ],
    )
    def test_bad_headers(self, tmp_path, suffix, old, new, told):
        made = sitk.GetImageFromArray(noise("i2", *SHAPE))
        made.SetSpacing((1, 2, 3))
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(made, str(path))
        data = path.read_bytes()
        assert old.encode() in data
        path.write_bytes(data.replace(old.encode(), new.encode()))
        assert told in refused(read, path)

    @pytest.mark.parametrize(
        ("spacings", "told"), [("1 nan 3", "spacing is 1 x nan x 3"), ("1 -2 3", "spacing is 1 x -2 x 3")]
    )
    def test_bad_spacings_of_a_nrrd(self, tmp_path, spacings, told):
        head = f"NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: {spacings}\n"
        head += "endian: little\nencoding: raw\n\n"
        (tmp_path / "in.nrrd").write_bytes(head.encode() + noise("i2", *SHAPE).tobytes())
        assert told in refused(read, tmp_path / "in.nrrd")

    @pytest.mark.parametrize("suffix", [".mhd", ".nhdr"])
    def test_what_is_wrong_with_the_data_file(self, tmp_path, suffix):
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(path))
        data = (tmp_path / "in.raw").read_bytes()
        (tmp_path / "in.raw").write_bytes(data[:-9])
        message = refused(read, path)
        assert "in.raw is cut short to 231" in message
        assert "240 bytes" in message
        (tmp_path / "in.raw").unlink()
        assert "in.raw is missing" in refused(read, path)

    @pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd"])
    def test_damaged_compressed_data(self, tmp_path, suffix):
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(image(noise("i2", 20, 30, 40)), str(path), useCompression=True)
        agree(by_us(path), by_itk(path))
        packed = {".nhdr": tmp_path / "in.raw.gz", ".mhd": tmp_path / "in.zraw"}.get(suffix, path)
        whole = packed.read_bytes()
        for place in (len(whole) // 2, len(whole) - 6):
            damaged = bytearray(whole)
            damaged[place] ^= 0xFF
            packed.write_bytes(damaged)
            message = refused(read, path)
            assert "compressed data is damaged" in message or "cut short" in message
        packed.write_bytes(whole[:-2])
        assert "cut short" in refused(read, path)

    def test_gzip_in_parts(self, tmp_path):
        samples = noise("i2", *SHAPE)
        head = b"NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nendian: little\nencoding: gzip\n\n"
        data = samples.tobytes()
        (tmp_path / "in.nrrd").write_bytes(head + gzip.compress(data[:100]) + gzip.compress(data[100:]))
        np.testing.assert_array_equal(read(tmp_path / "in.nrrd").samples, samples)

    @pytest.mark.parametrize("packed", [False, True])
    @pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd"])
    @pytest.mark.parametrize(("size", "told"), [(b"5", "200 bytes"), (b"7", "280 bytes"), (b"0", "")])
    def test_sizes_other_than_those_of_the_data(self, tmp_path, suffix, packed, size, told):
        path = tmp_path / f"in{suffix}"
        sitk.WriteImage(sitk.GetImageFromArray(noise("i2", *SHAPE)), str(path), useCompression=packed)
        name = b"DimSize = " if suffix.startswith(".m") else b"sizes: "
        assert name + b"6 5 4" in path.read_bytes()
        path.write_bytes(path.read_bytes().replace(name + b"6", name + size))
        message = refused(read, path)
        assert told in message

    @pytest.mark.parametrize(
        ("old", "new", "told"),
        [
            ("(1,0,0)", "(-1e300,0,0)", "spacing is inf x 2 x 3"),
            ("(1,0,0)", "none", "directions are none (0,2,0)"),
            ("origin: (0,0,0)", "origin: (nan,nan,nan)", "origin is (nan,nan,nan)"),
            ("space origin", 'space units: "um" "um" "um"\nspace origin', "unit of length is 'um'"),
        ],
    )
    def test_places_that_would_be_replaced(self, tmp_path, old, new, told):
        made = sitk.GetImageFromArray(noise("i2", *SHAPE))
        made.SetSpacing((1, 2, 3))
        sitk.WriteImage(made, str(tmp_path / "in.nrrd"))
        data = (tmp_path / "in.nrrd").read_bytes()
        assert old.encode() in data
        (tmp_path / "in.nrrd").write_bytes(data.replace(old.encode(), new.encode(), 1))
        assert told in refused(read, tmp_path / "in.nrrd")

    def test_millimetres_are_millimetres(self, tmp_path):
        sitk.WriteImage(image(noise("i2", *SHAPE)), str(tmp_path / "in.nrrd"))
        data = (tmp_path / "in.nrrd").read_bytes()
        units = b'space units: "mm" "mm" "mm"\nspace origin'
        (tmp_path / "in.nrrd").write_bytes(data.replace(b"space origin", units, 1))
        agree(by_us(tmp_path / "in.nrrd"), by_itk(tmp_path / "in.nrrd"))

    def test_a_nrrd_that_tells_no_space(self, tmp_path):
        head = "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: 1 2 3\nendian: little\nencoding: raw\n\n"
        (tmp_path / "in.nrrd").write_bytes(head.encode() + noise("i2", *SHAPE).tobytes())
        geometry = read(tmp_path / "in.nrrd").geometry
        assert (geometry.convention, geometry.spacing) == ("array", (1, 2, 3))

    def test_a_target_whose_data_file_exists(self, tmp_path):
        like = volume(noise("i2", *SHAPE))
        check_target(tmp_path / "out.mhd", like)
        (tmp_path / "out.raw").write_text("precious")
        for refused_by in (check_target, lambda path, like: write(path, like.samples, like)):
            with pytest.raises(SuppleError, match=r"out\.raw exists already"):
                refused_by(tmp_path / "out.mhd", like)
        assert os.listdir(tmp_path) == ["out.raw"]
        assert (tmp_path / "out.raw").read_text() == "precious"
        check_target(tmp_path / "out.mhd", like, force=True)
        check_target(tmp_path / "out.mha", like)

    def test_complex_numbers(self, tmp_path):
        sitk.WriteImage(sitk.GetImageFromArray(np.zeros(SHAPE, "c8")), str(tmp_path / "in.nrrd"))
        assert "complex" in refused(read, tmp_path / "in.nrrd")
