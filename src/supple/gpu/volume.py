"""A volume on a device, with room for a deformed one beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.memory import Array, solid, uploaded


@dataclass(slots=True, eq=False)
class Volume:
    """Samples on a device.

    Parameters
    ----------
    gpu : Gpu
    samples : wgpu.GPUTextureView
    size : (int, int, int)
        Voxels, x first.
    voxel : str
        The type of samples in shaders: f32, i32 or u32.
    labelled : bool
        Whether samples are numbers of labels, which are not mixed.
    colours : wgpu.GPUTextureView or None
        The voxels' own colours, sRGB and opacity.
    warped : wgpu.GPUTexture or None
        The texture for a deformed volume, in float32: see `beside`.
    full : bool
        Whether its allocation failed.
    owner : object
        The key of the filling that owns that texture, if any: see `supple.gpu.fill.Filling`.
    """

    gpu: Gpu
    samples: Any
    size: tuple[int, int, int]
    voxel: str
    labelled: bool = False
    colours: Any = None
    warped: Any = None
    full: bool = False
    owner: object = None


def hold(gpu: Gpu, samples: Array, labelled: bool = False, colours: Array | None = None) -> Volume:
    """Upload a volume to the device.

    Parameters
    ----------
    gpu : Gpu
    samples : array (Z, H, W), two along each axis at least
        Samples of 8 or 16 bits, or float32.
    labelled : bool
        Whether they are numbers of labels.
    colours : uint8 or uint16 array (Z, H, W, 4), optional
        The voxels' own colours. Of 16 bits, eleven are kept.

    Raises
    ------
    MemoryError
        If the volume exceeds the largest texture, or there is no room for it.
    """
    depth, height, width = samples.shape
    view = uploaded(gpu, samples).create_view()
    paint = None
    if colours is not None:
        deep = colours.dtype == np.uint16
        paint = uploaded(gpu, (colours * np.float32(1 / 65535)).astype(np.float16) if deep else colours).create_view()
    voxel = {"u": "u32", "i": "i32", "f": "f32"}[samples.dtype.kind]
    return Volume(gpu, view, (width, height, depth), voxel, labelled, paint)


def beside(volume: Volume) -> bool:
    """Return whether there is room for a deformed volume; the first call allocates it."""
    if volume.warped is None and not volume.full:
        usage = "STORAGE_BINDING|COPY_SRC|COPY_DST"
        try:
            volume.warped = solid(volume.gpu, volume.size[::-1], np.float32, usage=usage)
        except MemoryError:
            volume.full = True
    return volume.warped is not None
