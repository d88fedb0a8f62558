"""Planes on the GPU: the colours at T⁻¹ of the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.engines.wgpu.kernel import LAYERS, READ, WHOLE_LAYERS, WRITE, Array, pipeline, run
from supple.engines.wgpu.lattice import CHECK, PARTS, Lattice, Range, settings_of
from supple.engines.wgpu.pyramid import Pyramid
from supple.engines.wgpu.samples import STEP, GpuGroup
from supple.engines.wgpu.texels import Layers


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Some rows of some of the source's frames, on the device.

    Parameters
    ----------
    samples : Layers
    pyramid : Pyramid
    frames, rows : (int, int)
        The ranges held: from, to.
    slots : int
        The number of frames in the ring.
    shift : int
        The slot of the first frame.
    """

    samples: Layers
    pyramid: Pyramid
    frames: Range
    rows: Range
    slots: int
    shift: int


def rows_of(picture: GpuGroup, lattice: Lattice) -> Range:
    """Return the range of rows of samples in the cells of a lattice."""
    top, end = (picture.rows * k for k in lattice.part.cells)
    return top, picture.shape[0] if lattice.part.cells[1] == lattice.strokes.cells[1] else min(end, picture.shape[0])


def target_size(picture: GpuGroup, rows: int) -> int:
    """Return the bytes of some rows of samples, as the shader writes them."""
    return rows * picture.format.words(picture.shape[1]) * 4


def colour(
    lattice: Lattice, picture: GpuGroup, frames: int, held: Held, told: Any, target: Any, parts: int = 1
) -> tuple[int, int]:
    """Start to compute the samples of a lattice's part.

    Parameters
    ----------
    lattice : Lattice
        A solved lattice.
    picture : GpuGroup
    frames : int
        The number of frames of the whole source.
    held : Held
        The part of the source on the device.
    told, target : buffers
        Buffers for settings and for the samples.
    parts : int
        The number of pieces; systems end work that takes seconds.

    Returns
    -------
    (int, int)
        The range of rows of samples that are computed: from, to.
    """
    gpu, form, wanted = lattice.strokes.gpu, picture.format, picture.wanted
    top, end = rows_of(picture, lattice)
    settings = settings_of(lattice, wanted.tolerance)
    for name, value in {
        "size": picture.shape[::-1],
        "pitch": picture.step,
        "offset": picture.offset,
        "frames": frames,
        "channels": picture.channels,
        "top": top,
        "tall": end - top,
        "groups": form.threads(picture.shape[1]),
        "held": (*held.frames, *held.rows),
        "slots": held.slots,
        "shift": held.shift,
        "blocks": held.samples.blocks,
        "bounds": picture.bounds,
        "white": wanted.white,
        "times": wanted.times,
        "levels": held.pyramid.count,
        "stride": held.pyramid.stride,
    }.items():
        settings[name] = value
    settings["fill"][0, : picture.channels] = wanted.fill
    mask = lattice.strokes.mask
    buffers = (told, *lattice.buffers[1:], lattice.view, held.samples.view, target, held.pyramid.buffer, mask)
    constants = lattice.strokes.constants | picture.constants() | {"FOLDED": int(held.samples.blocks != (1, 1))}
    whole = np.dtype(form.dtype).kind == "u"
    names = (*PARTS, "texels_whole" if whole else "texels_float")
    kinds = (*CHECK, WHOLE_LAYERS if whole else LAYERS, WRITE, WRITE, READ)
    known, rough = (pipeline(gpu, names, entry, kinds, constants) for entry in ("warp", "solve_and_warp"))
    across = -(-picture.shape[1] * picture.step[0] // STEP)
    down = -(-(end - top) // picture.rows)
    parts = min(parts, down)
    for k in range(parts):
        first, last = down * k // parts, down * (k + 1) // parts
        settings["part"] = first, last if k < parts - 1 else 0xFFFFFFFF
        gpu.device.queue.write_buffer(told, 0, settings)
        run(
            gpu,
            [
                (known, buffers, (across, last - first, lattice.part.count)),
                (rough, buffers, lattice.buffers[6]),
            ],
        )
    return top, end


def unpacked(picture: GpuGroup, words: Array, planes: int, rows: int) -> Array:
    """Return the output of the shader, as samples (planes, rows, samples, channels)."""
    form = picture.format
    found = np.frombuffer(words, form.dtype, planes * target_size(picture, rows) // np.dtype(form.dtype).itemsize)
    return found.reshape(planes, rows, -1, form.channels)[:, :, : picture.shape[1]]
