"""A volume on a device, with room for a deformed one beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.kernel import SIGNED_SOLID, SOLID, WHOLE_SOLID, Array
from supple.gpu.texels import put_solid, solid

_KINDS = {"u": (WHOLE_SOLID, "voxels_whole"), "i": (SIGNED_SOLID, "voxels_signed"), "f": (SOLID, "voxels_float")}


@dataclass(slots=True, eq=False)
class Volume:
    """Samples on a device.

    Parameters
    ----------
    gpu : Gpu
    samples : wgpu.GPUTexture
    view : wgpu.GPUTextureView
    size : (int, int, int)
        Voxels, x first.
    kind, reader : str
        The kind of the texture for pipelines, and the name of the shader that reads it.
    labelled : bool
        Whether samples are numbers of labels, which are not mixed.
    colours : wgpu.GPUTexture or None
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
    view: Any
    size: tuple[int, int, int]
    kind: str
    reader: str
    labelled: bool = False
    colours: Any = None
    warped: Any = None
    full: bool = False
    owner: object = None

    @property
    def constants(self) -> dict[str, int]:
        """The constants of shaders that sample it."""
        return {"LABELLED": int(self.labelled), "COLOURED": int(self.colours is not None)}


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
    made = solid(gpu, (depth, height, width), samples.dtype)
    put_solid(gpu, made, samples)
    kind, reader = _KINDS[samples.dtype.kind]
    paint = None
    if colours is not None:
        deep = colours.dtype == np.uint16
        paint = solid(gpu, (depth, height, width), np.float16 if deep else np.uint8, 4, unit=True)
        put_solid(gpu, paint, (colours * np.float32(1 / 65535)).astype(np.float16) if deep else colours)
    return Volume(gpu, made, made.create_view(), (width, height, depth), kind, reader, labelled, paint)


def beside(volume: Volume) -> bool:
    """Return whether there is room for a deformed volume; the first call allocates it."""
    if volume.warped is None and not volume.full:
        wide, high, deep = volume.size
        usage = "STORAGE_BINDING|COPY_SRC|COPY_DST"
        try:
            volume.warped = solid(volume.gpu, (deep, high, wide), np.float32, usage=usage)
        except MemoryError:
            volume.full = True
    return volume.warped is not None
