"""Pictures of every kind on the screen: their colours, by their profile and the meaning of their channels."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvips
from PIL import Image, ImageCms

from supple.gpu.device import Gpu
from supple.media.image import read
from supple.viewer.panels.transforms import on_screen
from supple.viewer.panels.view import TOP
from tests.viewer.windows import opened, wait_for

Array = np.ndarray[Any, Any]

Y, X = np.mgrid[:40, :60]
RGB = np.stack([80 + X * 2, 90 + Y * 2, 170 - X], -1).astype(np.uint8)
OPACITY = (X * 4).astype(np.uint8)
CMYK = np.stack([30 + X * 2, 40 + Y * 3, 150 - X * 2, X + Y], -1).astype(np.uint8)
P3, PRESS = (bytes(pyvips.Operation.call("profile_load", name)) for name in ("p3", "cmyk"))


def grey_profile(gamma: float) -> bytes:
    """A profile of grey with a power curve."""
    curve = struct.pack(">4sIIH", b"curv", 0, 1, round(gamma * 256)) + b"\0\0"
    white = struct.pack(">4sIiii", b"XYZ ", 0, 63190, 65536, 54061)
    at = 128 + 4 + 2 * 12
    tags = struct.pack(">I4sII4sII", 2, b"kTRC", at, len(curve), b"wtpt", at + len(curve), len(white))
    body = tags + curve + white
    head = struct.pack(">I4xI4s4s4s12x4s28xiii48x", 128 + len(body), 0x02400000, b"mntr", b"GRAY", b"XYZ ", b"acsp",
                       63190, 65536, 54061)  # fmt: skip
    return head + body


def save(path: Path, pixels: Array, kind: str, icc: bytes | None = None, **fields: int) -> Path:
    made = pyvips.Image.new_from_array(pixels).copy(interpretation=kind)
    if icc is not None:
        made.set_type(pyvips.GValue.blob_type, "icc-profile-data", icc)
    for name, value in fields.items():
        made.set_type(pyvips.GValue.gint_type, name, value)
    made.write_to_file(str(path))
    return path


def by_profile(pixels: Array, mode: str, icc: bytes) -> Array:
    """The colours of a profile in sRGB, by another program."""
    source, srgb = ImageCms.ImageCmsProfile(io.BytesIO(icc)), ImageCms.createProfile("sRGB")
    made = ImageCms.profileToProfile(Image.fromarray(pixels, mode), source, srgb, 1, "RGB")
    return np.asarray(made)


def of_lab(lab: Array) -> Array:
    """sRGB of CIE Lab under D65, by its definition."""
    f = (lab[..., 0] + 16) / 116
    f = np.stack([f + lab[..., 1] / 500, f, f - lab[..., 2] / 200], -1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * (0.95047, 1.0, 1.08883)
    light = xyz @ np.linalg.inv([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]).T
    light = np.clip(light, 0, 1)
    return np.rint(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def deep(pixels: Array) -> Array:
    return pixels.astype(np.uint16) * 257


LAB = np.stack([20 + X, Y - 20.0, X - 30.0], -1)
DULL = 255 * (1.055 * (RGB[..., 0] / 255) ** (1.8 / 2.4) - 0.055)  # grey of gamma 1.8 in sRGB
KINDS: dict[str, tuple[Any, ...]] = {
    "profile.png": (RGB, "srgb", P3, by_profile(RGB, "RGB", P3)),
    "profile.jpg": (RGB, "srgb", P3, by_profile(RGB, "RGB", P3)),
    "profile16.png": (deep(RGB), "rgb16", P3, by_profile(RGB, "RGB", P3)),
    "profile_float.tif": ((RGB / 255).astype(np.float32), "scrgb", P3, by_profile(RGB, "RGB", P3)),
    "profile_alpha.png": (np.dstack([RGB, OPACITY]), "srgb", P3, np.dstack([by_profile(RGB, "RGB", P3), OPACITY])),
    "profile_alpha16.tif": (
        deep(np.dstack([RGB, OPACITY])), "rgb16", P3, np.dstack([by_profile(RGB, "RGB", P3), OPACITY]),
    ),
    "profile_grey.png": (RGB[..., :1], "b-w", grey_profile(1.8), DULL[..., None]),
    "profile_grey16.tif": (deep(RGB[..., :1]), "grey16", grey_profile(1.8), DULL[..., None]),
    "no_profile.png": (RGB, "srgb", b"nonsense" * 40, RGB),
    "other_profile.tif": (RGB, "srgb", PRESS, RGB),
    "cmyk.tif": (CMYK, "cmyk", PRESS, by_profile(CMYK, "CMYK", PRESS)),
    "cmyk.jpg": (CMYK, "cmyk", PRESS, by_profile(CMYK, "CMYK", PRESS)),
    "cmyk16.tif": (deep(CMYK), "cmyk", PRESS, by_profile(CMYK, "CMYK", PRESS)),
    "cmyk_plain.tif": (CMYK, "cmyk", None, by_profile(CMYK, "CMYK", PRESS)),
    "cmyk_plain.jpg": (CMYK, "cmyk", None, by_profile(CMYK, "CMYK", PRESS)),
    "cmyk_alpha.tif": (
        np.dstack([CMYK, OPACITY]), "cmyk", PRESS, np.dstack([by_profile(CMYK, "CMYK", PRESS), OPACITY]),
    ),
    "lab.tif": (LAB.astype(np.float32), "lab", None, of_lab(LAB)),
    "labs.tif": (np.rint(LAB * (327.67, 256, 256)).astype(np.int16), "labs", None, of_lab(LAB)),
    "rgb16.png": (deep(RGB), "rgb16", None, RGB),
    "grey.png": (RGB[..., :1], "b-w", None, RGB[..., :1]),
    "grey16.tif": (deep(RGB[..., :1]), "grey16", None, RGB[..., :1]),
    "float.tif": ((RGB / 255).astype(np.float32), "scrgb", None, RGB),
    "double.tif": (RGB[..., 0] / 255, "b-w", None, RGB[..., :1]),
    "alpha.png": (np.dstack([RGB, OPACITY]), "srgb", None, np.dstack([RGB, OPACITY])),
    "grey_alpha.png": (np.dstack([RGB[..., 0], OPACITY]), "b-w", None, np.dstack([*[RGB[..., 0]] * 3, OPACITY])),
    "whole.tif": (RGB[..., 0].astype(np.int32) * 1000 - 7, "b-w", None, (RGB[..., :1] - 80.0) * (255 / 118)),
    "webp.webp": (RGB, "srgb", P3, by_profile(RGB, "RGB", P3)),
    "avif.avif": (RGB, "srgb", None, RGB),
}  # fmt: skip
LOSSY = {".jpg": 14.0, ".webp": 30.0, ".avif": 14.0}


@pytest.mark.parametrize("name", KINDS)
def test_colours(tmp_path: Path, name: str) -> None:
    pixels, kind, icc, wanted = KINDS[name]
    seen = on_screen(read(save(tmp_path / name, pixels, kind, icc))).astype(float)
    assert seen.shape == (40, 60, 4)
    colours = wanted[..., :3]
    np.testing.assert_allclose(seen[..., :3] - colours, 0, atol=LOSSY.get(Path(name).suffix, 2.0))
    assert np.abs(seen[..., :3] - colours).mean() < 4
    np.testing.assert_allclose(seen[..., 3], wanted[..., 3] if wanted.shape[2] == 4 else 255, atol=0.5)


@pytest.mark.parametrize("name", ["palette.png", "palette.gif", "bits.png", "bits.tif"])
def test_few_colours(tmp_path: Path, name: str) -> None:
    picture = Image.fromarray(RGB[..., 0] > 110) if "bits" in name else Image.fromarray(RGB).quantize(16)
    picture.save(tmp_path / name)
    np.testing.assert_array_equal(on_screen(read(tmp_path / name))[..., :3], np.asarray(picture.convert("RGB")))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(tmp_path: Path, orientation: int) -> None:
    path = save(tmp_path / "turned.tif", RGB, "srgb", P3, orientation=orientation)
    turns = {2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
             5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_270, 7: Image.Transpose.TRANSVERSE,
             8: Image.Transpose.ROTATE_90}  # fmt: skip
    upright = Image.fromarray(by_profile(RGB, "RGB", P3))
    upright = upright.transpose(turns[orientation]) if orientation > 1 else upright
    np.testing.assert_allclose(on_screen(read(path))[..., :3], np.asarray(upright), atol=1)


@pytest.mark.parametrize("name", ["profile.png", "cmyk.jpg", "labs.tif", "profile_alpha16.tif", "profile_grey.png"])
def test_a_window_shows_it_and_exports_its_values(gpu: Gpu, tmp_path: Path, name: str) -> None:
    pixels, kind, icc, wanted = KINDS[name]
    path = save(tmp_path / name, pixels, kind, icc)
    view, hand = opened(path)
    hand.key("1")
    place = view.tools.view.to_canvas(0, 0)
    left, top = round(place[0]), round(place[1])
    seen = view.pixels()[top - TOP + 10 : top - TOP + 30, left + 10 : left + 50].astype(float)
    colours = np.broadcast_to(wanted[..., :3], (40, 60, 3))[10:30, 10:50].astype(float)
    if wanted.shape[2] == 3 or name.endswith("grey.png"):
        np.testing.assert_allclose(seen, colours, atol=LOSSY.get(path.suffix, 2.0) + 1)
    target = tmp_path / f"out{'.tif' if path.suffix == '.jpg' else path.suffix}"
    hand.drag((place[0] + 30, place[1] + 20), (place[0] + 34, place[1] + 20))
    assert len(view.recipe.strokes) == 1
    view.commands.begin_export(target)
    wait_for(lambda: view.commands.export.done)
    assert view.commands.export.error is None
    before, after = read(path), read(target)
    assert (after.interpretation, after.alpha, after.icc) == (before.interpretation, before.alpha, before.icc)
    assert after.pixels.shape == before.pixels.shape
    np.testing.assert_array_equal(after.pixels[0, 0], before.pixels[0, 0])  # the border is fixed
    assert not np.array_equal(after.pixels, before.pixels)
