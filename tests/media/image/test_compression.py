"""Quality and compression: chosen, or as the source has them."""

import numpy as np
import pytest
import pyvips

import supple
from supple.errors import SuppleError
from supple.files import warp_file
from supple.media.image import ImageWarning, read, write

DRAG = supple.Recipe(strokes=[supple.Stroke.grab((60, 50), by=(6, 3), radius=16)])


def photograph(dtype=np.uint8, size=(120, 160)):
    """A smooth picture with noise."""
    height, width = size
    y, x = np.mgrid[:height, :width] / height
    smooth = np.stack([np.sin(3 * x + k) * np.cos(2 * y) for k in range(3)], axis=-1) * 90 + 128
    noisy = smooth + np.random.default_rng(0).normal(0, 4, smooth.shape)
    return np.rint(np.clip(noisy * (257 if dtype == np.uint16 else 1), 0, np.iinfo(dtype).max)).astype(dtype)


def tables(path):
    """The quantization tables of a JPEG, as Pillow has them."""
    from PIL import Image

    with Image.open(path) as image:
        return image.quantization, image.info.get("progressive", 0), image.layer[0][1:3]


@pytest.mark.parametrize("quality", [3, 50, 88, 100])
@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("subsampled", ["on", "off"])
def test_a_jpeg_stays_as_it_is_coded(tmp_path, quality, progressive, subsampled):
    image = pyvips.Image.new_from_array(photograph())
    image.jpegsave(tmp_path / "in.jpg", Q=quality, interlace=progressive, subsample_mode=subsampled)
    warp_file(tmp_path / "in.jpg", tmp_path / "out.jpg", DRAG)
    assert tables(tmp_path / "out.jpg") == tables(tmp_path / "in.jpg")
    image.jpegsave(tmp_path / "other.jpg", Q=41)
    warp_file(tmp_path / "in.jpg", tmp_path / "out.jpg", DRAG, quality=41, force=True)
    assert tables(tmp_path / "out.jpg")[0] == tables(tmp_path / "other.jpg")[0]


def test_the_nearest_quality_is_that_of_another_program(tmp_path):
    from PIL import Image

    steps = [min(255, 3 + k // 3) for k in range(64)]  # no table of libjpeg's
    Image.fromarray(photograph()).save(tmp_path / "in.jpg", qtables=[steps, steps])
    write(tmp_path / "out.jpg", read(tmp_path / "in.jpg"))
    mine = np.array(tables(tmp_path / "out.jpg")[0][0])
    for quality in range(1, 101):
        pyvips.Image.black(8, 8, bands=3).jpegsave(tmp_path / "try.jpg", Q=quality)
        other = np.array(tables(tmp_path / "try.jpg")[0][0])
        assert np.abs(mine - steps).sum() <= np.abs(other - steps).sum()


def test_a_png_that_becomes_a_jpeg_has_the_usual_quality(tmp_path):
    write(tmp_path / "in.png", photograph())
    warp_file(tmp_path / "in.png", tmp_path / "out.jpg", DRAG)
    pyvips.Image.black(8, 8, bands=3).jpegsave(tmp_path / "try.jpg", Q=95)
    assert tables(tmp_path / "out.jpg")[0] == tables(tmp_path / "try.jpg")[0]


@pytest.mark.parametrize("icc", [False, True])
@pytest.mark.parametrize("lossless", [False, True])
def test_a_webp_stays_without_loss(tmp_path, lossless, icc):
    profile = {"profile": "srgb"} if icc else {}
    pyvips.Image.new_from_array(photograph()).webpsave(tmp_path / "in.webp", lossless=lossless, **profile)
    picture = read(tmp_path / "in.webp")
    write(tmp_path / "out.webp", picture)
    assert np.array_equal(read(tmp_path / "out.webp").pixels, picture.pixels) == lossless
    write(tmp_path / "small.webp", picture, quality=20)
    assert not np.array_equal(read(tmp_path / "small.webp").pixels, picture.pixels)


def test_an_interlaced_png_stays_so(tmp_path):
    for interlace in (False, True):
        pyvips.Image.new_from_array(photograph()).pngsave(tmp_path / "in.png", interlace=interlace)
        write(tmp_path / "out.png", read(tmp_path / "in.png"), force=True)
        assert (tmp_path / "out.png").read_bytes()[28] == interlace


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_levels_and_methods_lose_nothing(tmp_path, suffix, dtype):
    pixels, sizes = photograph(dtype), {}
    ways = ["none", "deflate", "0", "1", "9", "fast", *(["lzw", "packbits"] if suffix == ".tif" else [])]
    for how in ways:
        write(tmp_path / f"{how}{suffix}", pixels, compression=how)
        np.testing.assert_array_equal(read(tmp_path / f"{how}{suffix}").pixels, pixels)
        sizes[how] = (tmp_path / f"{how}{suffix}").stat().st_size
    assert sizes["none"] == sizes["0"] > max(sizes["deflate"], sizes["9"])
    assert sizes["fast"] == sizes["none" if dtype == np.uint16 else "1"]


def test_a_tiff_keeps_its_compression_unless_another_is_named(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    write(tmp_path / "in.tif", photograph(), compression="lzw")
    for how, code in ((None, 5), ("deflate", 8), ("none", 1), ("packbits", 32773), ("fast", 8)):
        warp_file(tmp_path / "in.tif", tmp_path / "out.tif", DRAG, compression=how, force=True)
        with tifffile.TiffFile(tmp_path / "out.tif") as file:
            assert file.pages[0].compression == code


@pytest.mark.parametrize("suffix", [".webp", ".avif"])
def test_fast_is_for_what_loses_nothing(tmp_path, suffix):
    write(tmp_path / f"a{suffix}", photograph(), lossless=True, compression="fast")
    write(tmp_path / f"b{suffix}", photograph(), lossless=True)
    np.testing.assert_array_equal(read(tmp_path / f"a{suffix}").pixels, photograph())
    assert (tmp_path / f"a{suffix}").stat().st_size > (tmp_path / f"b{suffix}").stat().st_size
    with pytest.warns(ImageWarning, match="fast changes nothing in .* with loss"):
        write(tmp_path / f"c{suffix}", photograph(), compression="fast")


@pytest.mark.parametrize(
    ("target", "how", "said"),
    [
        ("out.jpg", "fast", "compression='fast'? is none of JPEG: leave it out|compression fast is none of JPEG"),
        ("out.png", "lzw", "is none of PNG: choose from none, deflate, 0"),
        ("out.tif", "10", "is none of TIFF: choose from none, deflate, lzw, packbits, 0"),
        ("out.webp", "9", "is none of WebP: choose from fast"),
    ],
)
def test_what_a_format_does_not_have(tmp_path, target, how, said):
    write(tmp_path / "in.png", photograph())
    with pytest.raises(SuppleError, match=said):
        warp_file(tmp_path / "in.png", tmp_path / target, DRAG, compression=how)
    assert not (tmp_path / target).exists()


def test_an_unbent_picture_is_compressed_anew_if_that_is_asked_for(tmp_path):
    write(tmp_path / "in.png", photograph())
    warp_file(tmp_path / "in.png", tmp_path / "out.png", supple.Recipe(), compression="none")
    assert (tmp_path / "out.png").stat().st_size > photograph().nbytes


@pytest.mark.parametrize(("subsampling", "kept"), [(0, 0), (1, 0), (2, 2)])
def test_chroma_of_a_jpeg_loses_no_resolution(tmp_path, subsampling, kept):
    Image, JpegImagePlugin = pytest.importorskip("PIL.Image"), pytest.importorskip("PIL.JpegImagePlugin")

    pixels = np.random.default_rng(3).integers(0, 255, (48, 64, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "in.jpg", quality=90, subsampling=subsampling)
    write(tmp_path / "out.jpg", read(tmp_path / "in.jpg"))
    with Image.open(tmp_path / "out.jpg") as made:
        assert JpegImagePlugin.get_sampling(made) == kept
