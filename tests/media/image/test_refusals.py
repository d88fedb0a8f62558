"""What cannot be read or written is said, and leaves nothing."""

import os
import struct
import subprocess
import sys
import textwrap
import zlib
from pathlib import Path

import numpy as np
import pytest
import pyvips

from supple.media.image import ImageWarning, check_target, info, read, write
from supple.media.pictures import SUFFIXES_OUT
from tests.children import SOURCE
from tests.media.image.pictures import FORMATS, SAVERS, noise, smooth
from tests.refusals import refused


def run(code, *arguments):
    """Run a program in a process of its own, and return its exit status and output."""
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": SOURCE}
    done = subprocess.run(command, capture_output=True, encoding="utf-8", env=environment)
    return done.returncode, done.stdout + done.stderr


class TestWhatCannotBeRead:
    @pytest.mark.parametrize("suffix", [*FORMATS, ".gif"])
    def test_damaged_files(self, tmp_path, suffix, capfd):
        pixels = noise("u1", 90, 120, 3)
        image = pyvips.Image.new_from_array(pixels, interpretation="srgb")
        options = {"compression": "av1"} if suffix == ".avif" else {}
        image.write_to_file(str(tmp_path / f"whole{suffix}"), **options)
        data = (tmp_path / f"whole{suffix}").read_bytes()
        path = tmp_path / f"cut{suffix}"
        for length in (1, 4, 11, 50, len(data) // 3, len(data) - 40):
            path.write_bytes(data[:length])
            message = refused(read, path)
            assert message.startswith(f"cannot read {path}: it is ")
            assert len(message) < 400
        path.write_bytes(data[:20] + bytes(len(data) - 20))
        refused(read, path)
        assert capfd.readouterr() == ("", "")

    def test_holes_in_the_data(self, tmp_path):
        image = pyvips.Image.new_from_array(noise("u1", 400, 300, 3), interpretation="srgb")
        image.tiffsave(str(tmp_path / "in.tif"), compression="lzw")
        data = (tmp_path / "in.tif").read_bytes()
        (tmp_path / "in.tif").write_bytes(data[: len(data) // 2] + bytes(200) + data[len(data) // 2 + 200 :])
        assert "it is damaged" in refused(read, tmp_path / "in.tif")
        image.jpegsave(str(tmp_path / "in.jpg"))
        data = (tmp_path / "in.jpg").read_bytes()
        middle = len(data) // 2
        for hole in (b"\xff\xd3", b"\xff\xc4\x00", bytes([255, 1, 255, 9] * 50)):
            (tmp_path / "hole.jpg").write_bytes(data[:middle] + hole + data[middle + len(hole) :])
            with pytest.warns(ImageWarning, match=r"hole.jpg is damaged \(Corrupt JPEG data.*parts of it may be wrong"):
                read(tmp_path / "hole.jpg")
        assert read(tmp_path / "in.jpg").pixels.shape == (400, 300, 3)

    def test_a_tiff_whose_last_pages_are_cut(self, tmp_path):
        page = pyvips.Image.new_from_array(noise("u1", 40, 60), interpretation="b-w")
        tall = pyvips.Image.arrayjoin([page] * 4, across=1)
        tall.set_type(pyvips.GValue.gint_type, "page-height", 40)
        tall.tiffsave(str(tmp_path / "in.tif"))
        data = (tmp_path / "in.tif").read_bytes()
        (tmp_path / "in.tif").write_bytes(data[: len(data) * 7 // 10])
        assert "it is damaged" in refused(lambda path: read(path, pages=True), tmp_path / "in.tif")

    @pytest.mark.parametrize(
        "data",
        [
            b"Dear diary,\n",
            bytes(1000),
            b"3 2\n1 2 3\n4 5 6\n",
            b"1,2\n3,4\n",
            b"\xff\xd8",
            b"RIFF....WAVEfmt ",
            b"\0\0\0\x0cJXL \r\n\x87\n" + bytes(100),
            b"\x80\x2a\x5f\xd7" + bytes(4000),  # Cineon
        ],
    )
    @pytest.mark.parametrize("suffix", [".png", ".csv", ".mat", ".v"])
    def test_other_files(self, tmp_path, data, suffix, capfd):
        path = tmp_path / f"in{suffix}"
        path.write_bytes(data)
        for action in (read, info):
            assert refused(action, path).startswith(f"cannot read {path}: it is ")
        assert capfd.readouterr() == ("", "")

    def test_no_files(self, tmp_path):
        (tmp_path / "empty.png").touch()
        given = "give a PNG, JPEG, TIFF, WebP, AVIF or GIF file"
        for name, message in {
            "empty.png": f"it is empty: {given}",
            "": f"it is a folder or no plain file: {given}",
            "none.png": "No such file or directory: check the name and its rights",
            "empty.png/in.png": "Not a directory: check the name and its rights",
            "a\0b.png": "no file can have that name: check it",
        }.items():
            for action in (read, info):
                assert refused(action, tmp_path / name).endswith(f": {message}")

    def test_more_pixels_than_memory(self, tmp_path):
        write(tmp_path / "in.png", smooth(8, 8))
        data = (tmp_path / "in.png").read_bytes()
        header = b"IHDR" + struct.pack(">II", 5_000_000, 5_000_000) + data[24:29]
        check = struct.pack(">I", zlib.crc32(header))
        (tmp_path / "in.png").write_bytes(data[:12] + header + check + data[33:])
        assert refused(read, tmp_path / "in.png").endswith("it is too large for the memory: cut it into parts")


CONVERT = "convert to uint8, uint16 or, for TIFF, float32"
SIDE = "pixels on a side, and the image has"


class TestWhatCannotBeWritten:
    def test_unknown_suffixes(self, tmp_path):
        known = (
            "use .png, .apng, .jpg, .jpeg, .tif, .tiff, .webp, .avif, .exr, .dpx, .sgi, .hdr, .pfm, .pgm, .ppm, .bmp"
        )
        known += ", .tga, .jp2"
        assert ", ".join(SUFFIXES_OUT) in known
        assert refused(check_target, "out.gif") == (
            f"cannot write out.gif: the suffix .gif is no image format: {known}"
        )
        assert refused(check_target, "out") == f"cannot write out: a name without suffix is no image format: {known}"
        refused(write, tmp_path / "out.pcx", smooth(8, 8))
        for suffix in SUFFIXES_OUT:
            check_target(f"out{suffix.upper()}")

    @pytest.mark.parametrize(
        ("suffix", "pixels", "message"),
        [
            (".jpg", noise("u1", 9, 9, 4), "JPEG holds no transparency: write PNG, TIFF, WebP or AVIF"),
            (".png", noise("f4", 9, 9), "PNG takes no float32 values: write a TIFF"),
            (".avif", noise("i2", 9, 9, 3), "AVIF takes no int16 values: write a TIFF"),
            (".tif", noise("u8", 9, 9), f"TIFF takes no uint64 values: {CONVERT}"),
            (".png", np.ones((9, 9), bool), f"PNG takes no bool values: {CONVERT}"),
            (".png", noise("u1", 9, 9, 5), "PNG does not hold 5 channels: write a TIFF"),
            (".jpg", np.zeros((2, 65_501), "u1"), f"JPEG ends at 65500 {SIDE} 65501 x 2: write a TIFF"),
            (".exr", noise("u1", 9, 9, 3), "OpenEXR takes no uint8 values: write a TIFF"),
            (".hdr", noise("f4", 9, 9), "Radiance does not hold 1 channel: write a TIFF"),
            (".bmp", noise("f4", 9, 9, 3), "BMP takes no float32 values: write a TIFF"),
            (".jp2", noise("u1", 9, 9, 4), "JPEG 2000 holds no transparency: write PNG, TIFF, WebP or AVIF"),
            (".png", np.zeros((0, 9), "u1"), "an image has shape (H, W) or (H, W, C), and not (0, 9)"),
            (".png", np.zeros((1, 2, 3, 4), "u1"), "an image has shape (H, W) or (H, W, C), and not (1, 2, 3, 4)"),
        ],
    )
    def test_more_than_a_format_holds(self, tmp_path, suffix, pixels, message):
        path = tmp_path / f"out{suffix}"
        assert refused(write, path, pixels) == f"cannot write {path}: {message}"
        assert os.listdir(tmp_path) == []

    def test_the_largest_that_formats_hold(self, tmp_path):
        for suffix, side in ((".jpg", 65_500), (".webp", 16_383)):
            write(tmp_path / f"out{suffix}", np.zeros((2, side), "u1"))
            assert read(tmp_path / f"out{suffix}").pixels.shape[1] == side

    @pytest.mark.parametrize(
        "options",
        [{"quality": 0}, {"quality": 101}, {"quality": -5}, {"quality": float("nan")}, {"lossless": True}],
    )
    def test_impossible_settings(self, tmp_path, options):
        refused(write, tmp_path / "out.jpg", smooth(8, 8), **options)
        assert os.listdir(tmp_path) == []

    @pytest.mark.parametrize("suffix", FORMATS)
    def test_a_failure_in_mid_write_is_told_in_words_of_libvips(self, tmp_path, monkeypatch, suffix):
        def fail(_image, filename, **_options):
            Path(os.fsdecode(filename)).write_bytes(b"half")
            raise pyvips.Error("no", "vips2png: it broke\nand more\n")

        monkeypatch.setattr(pyvips.Image, SAVERS[suffix], fail, raising=False)
        message = refused(write, tmp_path / f"out{suffix}", smooth(8, 8))
        assert message.endswith("(it broke): try another format")
        assert os.listdir(tmp_path) == []


class TestHouseKeeping:
    @pytest.mark.parametrize("name", ["a[page=1].png", "é ü.png", "-o.png", "new\nline.png", "n\udcff.png"])
    def test_any_name_will_do(self, tmp_path, name):
        try:
            (tmp_path / name).touch()
            (tmp_path / name).unlink()
        except OSError:
            pytest.skip("this file system does not take the name")
        write(tmp_path / name, smooth(8, 8))
        np.testing.assert_array_equal(read(tmp_path / name).pixels, smooth(8, 8))
        assert refused(write, tmp_path / name, smooth(8, 8)).isprintable()

    @pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="reads Linux's account of memory")
    @pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
    def test_memory_holds_the_image_once(self, tmp_path, suffix):
        code = """
            import re, sys
            from supple.media.image import read, write

            def peak():
                with open("/proc/self/status") as file:
                    return int(re.search(r"VmHWM:\\s+(\\d+)", file.read())[1]) / 1024

            small, large, out = sys.argv[1:]
            write(out, read(small).pixels)
            before = peak()
            picture = read(large)
            write(out, picture.pixels, like=picture, force=True)
            print(peak() - before - picture.pixels.nbytes / 2**20)
        """
        ramp = pyvips.Image.xyz(4096, 4096)
        image = (ramp.bandjoin(ramp[0] + ramp[1]) / 32).cast("uchar").copy(interpretation="srgb")
        getattr(image, SAVERS[suffix])(str(tmp_path / f"large{suffix}"))
        write(tmp_path / f"small{suffix}", smooth(8, 8))
        status, output = run(code, tmp_path / f"small{suffix}", tmp_path / f"large{suffix}", tmp_path / f"out{suffix}")
        assert status == 0, output
        assert float(output) < 30  # a second copy would take 48
