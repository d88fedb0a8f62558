"""Picture formats beyond the usual ones: what is in them comes out, and goes back in."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from supple.media.image import read

Array = npt.NDArray[Any]


def smooth(height: int, width: int) -> Array:
    y, x = np.mgrid[:height, :width]
    return np.stack([3 * x, 4 * y, 255 - 2 * x], axis=-1).astype(np.uint8)


def tiff(entries: dict[int, tuple[int, ...]], data: bytes) -> bytes:
    """A TIFF of one strip, with these tags of 16 bits."""
    tags = {**entries, 273: (512,), 279: (len(data),)}
    table, behind = struct.pack("<H", len(tags)), b""
    for tag, values in sorted(tags.items()):
        kind, text = (4, "<I") if tag in (273, 279) else (3, f"<{len(values)}H")
        value = struct.pack(text, *values)
        if len(value) > 4:
            value, behind = struct.pack("<I", 256 + len(behind)), behind + value
        table += struct.pack("<HHI", tag, kind, len(values)) + value.ljust(4, b"\0")
    head = b"II*\0" + struct.pack("<I", 8) + table + bytes(4)
    return (head.ljust(256, b"\0") + behind).ljust(512, b"\0") + data


def ycbcr(rgb: Array, step: int) -> bytes:
    """A TIFF in YCbCr without compression, with chroma of every pixel, or of every second one."""
    height, width = rgb.shape[:2]
    luma = rgb @ [0.299, 0.587, 0.114]
    chroma = np.stack([(rgb[..., 2] - luma) / 1.772 + 128, (rgb[..., 0] - luma) / 1.402 + 128], axis=-1)
    blocks = (height // step, step, width // step, step)
    luma = luma.reshape(blocks).swapaxes(1, 2).reshape(height // step, width // step, step * step)
    chroma = chroma.reshape(*blocks, 2).mean(axis=(1, 3))
    data = np.rint(np.concatenate([luma, chroma], axis=-1)).clip(0, 255).astype(np.uint8).tobytes()
    size = {256: (width,), 257: (height,), 258: (8, 8, 8), 259: (1,), 262: (6,), 277: (3,), 278: (height,)}
    return tiff({**size, 274: (6,), 530: (step, step)}, data)


@pytest.mark.parametrize(("step", "most"), [(1, 2), (2, 4)])
def test_a_tiff_in_ycbcr_has_its_colours(tmp_path: Path, step: int, most: int) -> None:
    pixels = smooth(60, 80)
    (tmp_path / "in.tif").write_bytes(ycbcr(pixels, step))
    picture = read(tmp_path / "in.tif")
    assert (picture.format, picture.bits, picture.alpha) == ("TIFF", 8, False)
    upright = np.rot90(pixels, -1)  # as its orientation says
    assert picture.pixels.shape == upright.shape
    assert np.abs(picture.pixels.astype(int) - upright).max() <= most


def test_a_tiff_in_ycbcr_that_pillow_wrote(tmp_path: Path) -> None:
    pixels = smooth(60, 80)
    image = Image.fromarray(pixels)
    image.convert("YCbCr").save(tmp_path / "plain.tif")
    image.save(tmp_path / "jpeg.tif", compression="jpeg", quality=98)
    for name in ("plain.tif", "jpeg.tif"):
        assert np.abs(read(tmp_path / name).pixels.astype(int) - pixels).mean() < 3
