"""A volume on a device, with room for a deformed one beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.kernel import Array, room, upload

FORMATS = {"u1": 0, "i1": 1, "u2": 2, "i2": 3, "f4": 4}


@dataclass(slots=True, eq=False)
class Volume:
    """Samples on a device.

    Parameters
    ----------
    gpu : Gpu
    samples
        The buffer: the volume and, behind it, room for another.
    size : (int, int, int)
        Voxels, x first.
    pitch : int
        Samples from row to row: rows begin with words of their own.
    format : int
        Of the samples, as shaders count them.
    bounds : (float, float)
        The least and the largest value of their type; 0 of floats.
    warped : int
        At which sample the other volume begins; 0 where there is no room for one.
    owner : object
        What stands for whom the other volume belongs to, if to anybody: see `supple.gpu.fill.Filling`.
    """

    gpu: Gpu
    samples: Any
    size: tuple[int, int, int]
    pitch: int
    format: int
    bounds: tuple[float, float]
    warped: int
    owner: object = None


def hold(gpu: Gpu, samples: Array, *, twice: bool) -> Volume:
    """Put a volume on the device.

    Parameters
    ----------
    gpu : Gpu
    samples : array (Z, H, W), two along each axis at least
        Of 8 or 16 bits, or float32.
    twice : bool
        Whether with room for a deformed one.

    Raises
    ------
    MemoryError
        If that is more than a shader takes.
    """
    depth, height, width = samples.shape
    in_word = 4 // samples.itemsize
    pitch = -(-width // in_word) * in_word
    size = depth * height * pitch * samples.itemsize * (2 if twice else 1)
    if size > gpu.binding:
        beside = " and a deformed one" if twice else ""
        raise MemoryError(
            f"a volume of {samples.nbytes >> 20} MB{beside} is more than a shader takes, {gpu.binding >> 20} MB"
        )
    rows = samples if pitch == width else np.pad(samples, ((0, 0), (0, 0), (0, pitch - width)))
    if twice:
        made = room(gpu, size)
        gpu.device.queue.write_buffer(made, 0, np.ascontiguousarray(rows).reshape(-1).view(np.uint8))
    else:
        made = upload(gpu, rows)
    kind = samples.dtype
    bounds = (float(np.iinfo(kind).min), float(np.iinfo(kind).max)) if kind.kind in "iu" else (0.0, 0.0)
    return Volume(
        gpu,
        made,
        (width, height, depth),
        pitch,
        FORMATS[kind.str[1:]],
        bounds,
        depth * height * pitch if twice else 0,
    )
