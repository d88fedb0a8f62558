"""Images as warps take and give them: types, opacity, layouts, what lies outside, refusals; see the engines' table."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pydicom
import pytest
import pyvips
import SimpleITK
from PIL import Image

from supple import Deformation, SuppleError
from supple.media.volume import Volume
from supple.space.geometry import Geometry
from tests import reference
from tests.engine.arrays import FILTERS, IMAGE, RULES, bent, exact, noise, same, top_of

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")
DTYPES = ["bool", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"]
CHANNELS = [1, 2, 3, 4, 5, 9]
PRINTED = ["linear", "cubic"]
AVERAGES = ["auto"]
FINE = 1e-5


def test_the_last_of_four_channels_of_8_or_16_bits_is_opacity_unless_told() -> None:
    d = bent()
    for dtype in DTYPES:
        for channels in CHANNELS:
            source = np.abs(noise("f8", channels)) % 1 * top_of(dtype)
            source = source.astype(dtype)
            weighed = channels == 4 and dtype in ("u1", "u2")
            np.testing.assert_array_equal(d.warp(source), d.warp(source, alpha=weighed))
            if channels == 4 and dtype != "bool":
                assert (d.warp(source, alpha=False) != d.warp(source, alpha=True)).any()


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4", "f8"])
def test_an_opaque_picture_is_as_one_without_opacity(dtype: str) -> None:
    top = top_of(dtype)
    colours = (np.random.default_rng(1).uniform(0, top, (*IMAGE, 3))).astype(dtype)
    opaque = np.dstack([colours, np.full(IMAGE, top, dtype)])
    for name in FILTERS:
        for rule in ("edge", "reflect"):
            plain = bent().warp(colours, filter=name, outside=rule)
            weighed = bent().warp(opaque, filter=name, outside=rule, alpha=True)
            assert weighed.dtype == plain.dtype
            off = np.abs(weighed[..., :3].astype(np.float64) - plain).max()
            assert off <= (1 if dtype in ("u1", "u2") else 1e-5)
            assert (np.abs(weighed[..., 3].astype(np.float64) - top) <= 1e-6 * top).all()


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
@pytest.mark.parametrize("filter", FILTERS)
def test_what_is_clear_colours_nothing(dtype: str, filter: str) -> None:
    """A red shape on clear green has no green fringe."""
    top = top_of(dtype)
    source = np.zeros((*IMAGE, 4), dtype)
    source[:, :35], source[:, 35:] = (top, 0, 0, top), (0, top, 0, 0)
    out = bent().warp(source, filter=filter, alpha=True).astype(np.float64) / top
    assert (out >= 0).all()
    assert (out[..., 3] <= 1).all()
    seen = out[..., 3] > 0.01
    assert np.abs(out[seen][:, 1]).max() <= 1e-6
    assert out[seen][:, 0].min() > 1 - 1e-5
    assert (~seen).any()


def test_an_edge_of_opacity_has_no_halo() -> None:
    """Where opacity overshoots, the colours that it weighs do as well."""
    for dtype, grey in (("u1", 100), ("u2", 30_000), ("f8", 0.4)):
        source = np.full((*IMAGE, 4), grey, dtype)
        source[:, :35, 3], source[:, 35:, 3] = top_of(dtype), 0
        for name in FILTERS:
            out = bent().warp(source, filter=name)
            seen = out[..., 3] > 0.01 * top_of(dtype)
            assert np.abs(out[seen][:, :3].astype(np.float64) - grey).max() <= 1e-4 * grey


@pytest.mark.parametrize("dtype", ["i8", "u8"])
def test_opacity_of_64_bits(dtype: str) -> None:
    source = np.full((*IMAGE, 3), np.iinfo(dtype).max, dtype)
    for name in FILTERS:
        out = bent().warp(source, filter=name, alpha=True).astype(np.float64)
        assert np.abs(out / top_of(dtype) - 1).max() < 1e-9


@pytest.mark.parametrize("dtype", DTYPES)
def test_constants_stay_constant(dtype: str) -> None:
    kind = np.dtype(dtype)
    values: list[Any] = [0, 77, 3.1416]
    if kind == np.bool_:
        values = [False, True]
    elif kind.kind in "iu":
        limits = np.iinfo(kind)
        values = [limits.min, limits.max, 0, 77]
    for value in values:
        for channels in (1, 3, 5):
            source = np.full((*IMAGE, channels), value, kind)
            for name in FILTERS:
                for alpha in {False, channels > 1 and kind.kind != "i" and kind.itemsize < 8}:
                    out = bent().warp(source, filter=name, alpha=alpha)
                    numbers = out.astype(np.float64)
                    wide = abs(int(value)) >= 2**50
                    if name == "nearest" or (kind.kind != "f" and not wide and not alpha):
                        np.testing.assert_array_equal(out, source)
                    elif alpha and kind.kind == "f":
                        # More than opaque is opaque.
                        assert np.isfinite(numbers).all()
                        assert numbers[..., -1].max() <= 1
                    else:
                        leeway = {"f2": 2e-3, "i4": 1e-14, "u4": 1e-14, "i8": 1e-14, "u8": 1e-14, "f8": 1e-14}.get(
                            dtype, 2e-6
                        )
                        visible = numbers[..., :-1] if alpha and value == 0 else numbers
                        assert np.abs(visible - float(value)).max() <= leeway * abs(float(value))


@pytest.mark.parametrize("filter", FILTERS)
def test_light_of_one_colour_is_that_colour(filter: str) -> None:
    ramp = np.broadcast_to(np.arange(256, dtype=np.uint8)[:, None, None], (256, 20, 3))
    d = Deformation((256, 20), border=64, on_fold="damp").grab((10, 128), by=(3, 0), radius=40, reach=None)
    for value in (0, 1, 10, 100, 254, 255):
        flat = np.full((*IMAGE, 3), value, np.uint8)
        np.testing.assert_array_equal(bent().warp(flat, filter=filter, linear_light=True), flat)
    assert np.abs(d.warp(ramp, filter=filter, linear_light=True).astype(int) - ramp).max() < 40
    # Fine black and white lines are as bright as half their light, not as half their values.
    lines = np.zeros((64, 256), np.uint8)
    lines[:, ::2] = 255
    squeezed = Deformation((64, 256), border=None, on_fold="flow").grab((40, 32), to=(150, 32), radius=25, reach=None)
    if filter in AVERAGES:
        where = (30, slice(155, 165))
        dark, bright = (squeezed.warp(lines, filter=filter, linear_light=lit)[where].mean() for lit in (False, True))
        assert dark == pytest.approx(127.5, abs=12)
        assert bright == pytest.approx(188, abs=12)


@pytest.mark.parametrize("filter", FILTERS)
def test_what_lies_outside(filter: str) -> None:
    away = Deformation((40, 50), border=None, on_fold="damp").grab(
        (25, 20), by=(30, 0), radius=1e7, reach=None
    )  # all of it, 30 to the right
    source = np.random.default_rng(6).integers(1, 255, (40, 50, 3), np.uint8)
    edge = away.warp(source, filter=filter, outside="edge")
    np.testing.assert_array_equal(edge[:, :27], np.broadcast_to(edge[:, :1], (40, 27, 3)))
    if filter in ("nearest", "linear", "cubic", "auto"):  # the others average over the pixel itself
        np.testing.assert_allclose(edge[:, 0], source[:, 0], atol=1)
    constant = away.warp(source, filter=filter, outside="constant", fill=(9, 99, 199))
    np.testing.assert_array_equal(constant[:, :27], np.broadcast_to(np.uint8([9, 99, 199]), (40, 27, 3)))
    np.testing.assert_array_equal(away.warp(source, filter=filter, outside="constant")[:, :27], 0)
    mirrored = away.warp(source, filter=filter, outside="reflect")
    if filter in ("nearest", "linear", "cubic", "auto"):
        np.testing.assert_allclose(mirrored[:, :30], source[:, 29::-1], atol=1)
        np.testing.assert_allclose(mirrored[:, 30:], source[:, :20], atol=1)
    np.testing.assert_allclose(edge[3:-3, 34:], mirrored[3:-3, 34:], atol=1)
    # Rounded and bounded as the source's values are.
    assert (away.warp(source, filter=filter, outside="constant", fill=1e6)[:, :27] == 255).all() or filter == "nearest"


SIZES = [(1, 1), (1, 2), (1, 50), (50, 1), (2, 2), (3, 33), (32, 32), (33, 33), (5, 257), (4, 300)]


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("rule", RULES)
def test_sizes(shape: tuple[int, int], rule: str) -> None:
    d = Deformation(shape, border=None, on_fold="damp").grab(
        np.array(shape[::-1]) * 0.4, by=(2.3, -1.2), radius=9, reach=None
    )
    for channels in (1, 3, 4):
        source = noise("u1", channels, shape)
        for name in FILTERS:
            out = d.warp(source, filter=name, outside=rule, fill=70, alpha=False, tolerance=FINE)
            assert out.shape == source.shape
            if name in PRINTED:
                expected = reference.sample(source, exact(d), filter=name, outside=rule, fill=70)
                same(out, expected.astype(np.float64), 255, 2e-4)
            # Results do not depend on what is in the memory that they are written to.
            given = np.full_like(source, 77)
            d.warp(source, filter=name, outside=rule, fill=70, alpha=False, tolerance=FINE, out=given)
            np.testing.assert_array_equal(given, out)
    fixed = Deformation(shape, border=64, on_fold="damp").grab((0, 0), by=(2, 1), radius=3, reach=None)
    assert fixed.warp(np.full(shape, 9, np.uint8)).min() == 9


def test_what_holds_an_array_is_no_array(tmp_path: Path) -> None:
    """NumPy would make a list of numbers, or an object, of these."""
    samples = np.zeros((6, 7, 8), np.int16)
    d = Deformation(samples.shape).grab((3, 3, 3), to=(4, 3, 3), radius=3)
    image = SimpleITK.GetImageFromArray(samples)
    proxied = nibabel.Nifti1Image(samples.T, np.eye(4))
    for given, told in (
        ([image], "one of SimpleITK.SimpleITK.Image: give its array"),
        ([proxied], "one of nibabel.nifti1.Nifti1Image: give its array"),
        (pydicom.Dataset(), "one of pydicom.dataset.Dataset: give its array"),
        (Volume(samples, Geometry()), "one of supple.media.volume.data.Volume: give its array"),
        ("in.nii", "the name of a file: supple.warp_file warps files"),
        (tmp_path / "in.nii", "the name of a file"),
    ):
        with pytest.raises(SuppleError, match=f"^source must be an array, found {re.escape(told)}"):
            d.warp(given)
    np.testing.assert_array_equal(d.warp(SimpleITK.GetArrayViewFromImage(image)), samples)
    np.testing.assert_array_equal(d.warp(np.asanyarray(proxied.dataobj).T), samples)
    nibabel.save(proxied, tmp_path / "in.nii")
    flat = Deformation((7, 8), border=None).grab((3, 3), to=(4, 3), radius=3)
    proxy = nibabel.load(tmp_path / "in.nii").dataobj  # NumPy reads it
    assert Deformation(proxy.shape).warp(proxy).shape == (8, 7, 6)
    with pytest.raises(SuppleError, match="a picture of the mode P, whose numbers do not mix"):
        flat.warp(Image.new("P", (8, 7)))
    assert flat.warp(Image.new("RGB", (8, 7))).shape == (7, 8, 3)
    assert flat.warp(pyvips.Image.black(8, 7)).shape == (7, 8)
