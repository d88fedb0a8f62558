"""HEIC, Photoshop's files and camera raw, against their own libraries; without these, one sentence."""

import importlib.util
import warnings

import numpy as np
import pytest
import pyvips
from PIL import Image, ImageCms

import supple
from supple.errors import SuppleError
from supple.files import warp_file
from supple.media.image import info, read

DRAG = supple.Recipe(strokes=[supple.Stroke.grab((30, 20), by=(4, 2), radius=8)])
PIXELS = np.random.default_rng(3).integers(0, 256, (40, 60, 4), np.uint8)
SMOOTH = np.stack([np.add.outer(np.arange(40) * k, np.arange(60)) % 256 for k in (1, 2, 3)], axis=-1).astype(np.uint8)
P3 = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


@pytest.mark.parametrize(
    ("name", "data", "module"),
    [
        ("in.heic", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "pillow_heif"),
        ("in.psd", b"8BPS\0\1" + bytes(40), "psd_tools"),
        ("in.nef", b"II*\0" + bytes(40), "rawpy"),
    ],
)
def test_what_is_missing_or_damaged_is_one_sentence(tmp_path, monkeypatch, name, data, module):
    (tmp_path / name).write_bytes(data)
    if importlib.util.find_spec(module) is not None:
        with pytest.raises(SuppleError, match=f"cannot read .*{name}: .*{module} fails on it"):
            read(tmp_path / name)
    found = importlib.util.find_spec
    monkeypatch.setattr("supple.errors.find_spec", lambda each: None if each == module else found(each))
    with pytest.raises(SuppleError, match=rf"need {module}, .* pip install 'supple\[formats\]'$"):
        read(tmp_path / name)


@pytest.mark.parametrize("suffix", [".heic", ".psd", ".nef", ".dng"])
def test_none_is_written(tmp_path, suffix):
    Image.fromarray(SMOOTH).save(tmp_path / "in.png")
    with pytest.raises(SuppleError, match=f"the suffix {suffix} is no image format: use .png"):
        warp_file(tmp_path / "in.png", tmp_path / f"out{suffix}", DRAG)
    assert not (tmp_path / f"out{suffix}").exists()


class TestHeic:
    @pytest.fixture(autouse=True)
    def heif(self):
        return pytest.importorskip("pillow_heif")

    def saved(self, heif, path, image, **options):
        heif.from_pillow(image).save(path, quality=-1, chroma=444, matrix_coefficients=0, **options)
        return path

    @pytest.mark.parametrize("mode", ["L", "RGB", "RGBA"])
    def test_pixels(self, tmp_path, heif, mode):
        want = {"L": SMOOTH[..., 0], "RGB": SMOOTH, "RGBA": PIXELS}[mode]
        path = self.saved(heif, tmp_path / "in.heic", Image.fromarray(want))
        picture = read(path)
        assert (picture.format, picture.bits, picture.alpha) == ("HEIF", 8, mode == "RGBA")
        np.testing.assert_array_equal(picture.pixels, np.asarray(heif.open_heif(path)))
        assert np.abs(picture.pixels.astype(int) - want).mean() < 1
        assert info(path)["width"] == 60
        warp_file(path, tmp_path / "out.png", DRAG)

    def test_ten_bits(self, tmp_path, heif):
        deep = SMOOTH.astype(np.uint16) << 8
        held = heif.from_bytes("RGB;16", (60, 40), deep.tobytes())
        heif.options.SAVE_HDR_TO_12_BIT = False
        held.save(tmp_path / "in.heic", quality=-1, chroma=444)
        picture = read(tmp_path / "in.heic")
        assert (picture.pixels.dtype, picture.bits) == (np.uint16, 10)
        assert np.abs(picture.pixels.astype(int) - deep).mean() < 600
        assert np.array_equal(picture.pixels & 63, picture.pixels >> 10)  # white is 65535

    def test_profile_orientation_and_exif(self, tmp_path, heif):
        image = Image.fromarray(SMOOTH)
        exif = image.getexif()
        exif[271], exif[274] = "Maker", 6
        self.saved(heif, tmp_path / "in.heic", image, exif=exif.tobytes(), icc_profile=P3)
        picture = read(tmp_path / "in.heic")
        assert picture.icc == P3
        for target in ("out.tif", "out.jpg"):
            warp_file(tmp_path / "in.heic", tmp_path / target, DRAG)
            with Image.open(tmp_path / target) as made:
                assert made.info["icc_profile"] == P3
                assert made.getexif()[271] == "Maker"
                assert made.getexif().get(274, 1) == 1
                assert made.size == picture.pixels.shape[1::-1]


class TestPhotoshop:
    @pytest.fixture(autouse=True)
    def psd(self):
        return pytest.importorskip("psd_tools").PSDImage

    @pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
    def test_pixels(self, tmp_path, psd, mode):
        want = {"L": PIXELS[..., 0], "RGB": PIXELS[..., :3], "CMYK": PIXELS}[mode]
        psd.frompil(Image.fromarray(want, mode) if mode == "CMYK" else Image.fromarray(want)).save(tmp_path / "in.psd")
        picture = read(tmp_path / "in.psd")
        with Image.open(tmp_path / "in.psd") as other:  # which another library reads as well
            np.testing.assert_array_equal(picture.pixels, np.asarray(other))
        assert picture.interpretation == {"L": "b-w", "RGB": "srgb", "CMYK": "cmyk"}[mode]
        warp_file(tmp_path / "in.psd", tmp_path / "out.tif", DRAG)
        assert read(tmp_path / "out.tif").interpretation == picture.interpretation

    def test_opacity(self, tmp_path, psd):
        opacity = PIXELS[..., 3:] / 255
        matted = PIXELS.copy()  # Photoshop stores colours on white
        matted[..., :3] = np.rint(PIXELS[..., :3] * opacity + 255 * (1 - opacity))
        psd.frompil(Image.fromarray(matted)).save(tmp_path / "in.psd")
        picture = read(tmp_path / "in.psd")
        assert picture.alpha
        np.testing.assert_array_equal(picture.pixels[..., 3], PIXELS[..., 3])
        seen = PIXELS[..., 3] > 128
        assert np.abs(picture.pixels[seen].astype(int) - PIXELS[seen]).max() <= 1

    def test_sixteen_bits(self, tmp_path, psd):
        deep = PIXELS[..., :3].astype(np.uint16) * 256 + PIXELS[..., 1:]
        made = psd.new("RGB", (60, 40), depth=16)
        made._record.image_data.set_data([deep[..., k].astype(">u2").tobytes() for k in range(3)], made._record.header)
        made.save(tmp_path / "in.psd")
        picture = read(tmp_path / "in.psd")
        assert (picture.pixels.dtype, picture.bits) == (np.uint16, 16)
        np.testing.assert_array_equal(picture.pixels, deep)


class TestRaw:
    def test_a_mosaic_is_developed(self, tmp_path):
        pytest.importorskip("rawpy")
        tifffile = pytest.importorskip("tifffile")
        # a DNG of RGGB, half red and half blue
        height, width = 64, 96
        mosaic = np.full((height, width), 1000, np.uint16)
        mosaic[0::2, 0 : width // 2 : 2] = 20000
        mosaic[1::2, width // 2 + 1 :: 2] = 20000
        matrix = [10000, 0, 0, 0, 10000, 0, 0, 0, 10000]
        tags = [
            (50706, "B", 4, (1, 4, 0, 0), True),
            (50708, "s", 0, "Maker Model", True),
            (271, "s", 0, "Maker", True),
            (33421, "H", 2, (2, 2), True),
            (33422, "B", 4, (0, 1, 1, 2), True),
            (50717, "I", 1, 32767, True),
            (50721, "2i", 9, [n for value in matrix for n in (value, 10000)], True),
            (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),
            (50778, "H", 1, 21, True),
        ]
        tifffile.imwrite(tmp_path / "in.dng", mosaic, photometric=32803, extratags=tags, metadata=None)
        picture = read(tmp_path / "in.dng")
        assert (picture.pixels.dtype, picture.format, picture.bits) == (np.uint16, "camera raw", 16)
        red, blue = (picture.pixels[16:48, part].mean(axis=(0, 1)) for part in (slice(12, 36), slice(60, 84)))
        assert red[0] > 1.5 * red[1:].max()
        assert blue[2] > 1.5 * blue[:2].max()
        with warnings.catch_warnings(action="error"):
            warp_file(tmp_path / "in.dng", tmp_path / "out.tif", DRAG)
        with Image.open(tmp_path / "out.tif") as made:
            assert made.getexif()[271] == "Maker"
        assert read(tmp_path / "out.tif").icc == bytes(pyvips.Image.profile_load("srgb"))
