"""Pictures in folders, and the clips that they are."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvips

from supple.media.image import write
from supple.media.sequence import Pictures

Array = npt.NDArray[Any]
SRGB = bytes(pyvips.Operation.call("profile_load", "srgb"))


def picture(k: int, shape: tuple[int, ...] = (6, 8, 3), dtype: str = "u1") -> Array:
    made = np.random.default_rng(k).integers(0, 256, shape)
    return (made / 255).astype(dtype) if dtype == "f4" else (made * (257 if dtype == "u2" else 1)).astype(dtype)


def save(folder: Path, names: Sequence[str], **options: Any) -> list[Array]:
    folder.mkdir(parents=True, exist_ok=True)
    made = [picture(k, **options) for k in range(len(names))]
    for name, pixels in zip(names, made, strict=True):
        write(folder / name, pixels)
    return made


def numbers(first: int, last: int) -> list[str]:
    return [f"{k:05d}.png" for k in range(first, last + 1)]


def empty(clip: Pictures) -> list[Array]:
    return [np.empty((*group.shape, group.channels), clip.layout.dtype) for group in clip.layout.groups]


def frames_of(clip: Pictures) -> list[Array]:
    read_all = []
    for frame in clip.frames():
        arrays = empty(clip)
        frame.copy_to(arrays)
        read_all.append(arrays[0])
    return read_all


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))
