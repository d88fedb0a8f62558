"""Clips in files, and what the command line said of them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

import supple
import supple.media.video
from supple.media import image
from tests import clips

TIMED = supple.Recipe(border=None, strokes=(supple.Stroke.grab((30, 20, 3), to=(33, 22, 8), radius=10),))
FLAT = supple.Recipe(border=10, strokes=(supple.Stroke.grab((30, 20), to=(34, 23), radius=12),))
GRAB = ("--grab", "30,20,3:33,22,8", "--radius", "10", "--border", "none")
GRAB_2D = ("--grab", "30,20:34,23", "--radius", "12", "--border", "10")
Array = npt.NDArray[Any]
Run = Callable[..., tuple[int, str, str]]


def noisy(name: str, pixel_format: str = "yuv444p", count: int = 12, **options: Any) -> str:
    clips.make(name, "ffv1", pixel_format, count=count, smooth=False, **options)
    return name


def pictures(
    folder: str, count: int = 6, names: str = "{:03d}.png", dtype: type = np.uint8, channels: int = 3, first: int = 1
) -> Array:
    """Write numbered pictures of noise; return their pixels."""
    os.makedirs(folder, exist_ok=True)
    top = np.iinfo(dtype).max + 1
    frames = np.random.default_rng(count).integers(0, top, (count, 48, 64, channels), dtype=dtype)
    for k, frame in enumerate(frames):
        image.write(f"{folder}/{names.format(k + first)}", frame)
    return frames


def stack(path: str) -> Array:
    """All frames of a clip whose planes are alike, as (T, H, W) or (T, H, W, planes)."""
    frames = []
    for frame in clips.decoded(path):
        wide = frame.format.components[0].bits > 8
        planes = [np.frombuffer(row, "<u2" if wide else np.uint8) for row in clips.rows(frame)]
        frames.append(np.stack([plane.reshape(frame.height, frame.width) for plane in planes], axis=-1))
    found = np.stack(frames)
    return found[..., 0].copy() if found.shape[-1] == 1 else found


def refused(said: tuple[int, str, str], wanted: str) -> None:
    status, out, err = said
    assert (status, out) == (2, ""), err
    assert err.startswith("supple: ")
    assert err.count("\n") == 1
    assert "fault" not in err
    assert wanted in err


def same_frames(one: str, two: str) -> None:
    a, b = clips.decoded(one), clips.decoded(two)
    assert len(a) == len(b)
    for left, right in zip(a, b, strict=True):
        assert left.format.name == right.format.name
        assert clips.rows(left) == clips.rows(right)
