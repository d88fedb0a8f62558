"""Coarser levels of frames on a device: averages of 2 by 2 samples, repeatedly; see levels.wgsl."""

from __future__ import annotations

import contextlib
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.kernel import LAYERS, UNIFORM, WHOLE_LAYERS, WRITE, owned, pipeline, room, run, upload
from supple.engines.wgpu.samples import GpuGroup
from supple.engines.wgpu.texels import Layers

Range = tuple[int, int]

_NAMES = ("pyramid", "levels", "light")
_SETTINGS = np.dtype(
    [
        ("fine", "u4", 2),
        ("coarse", "u4", 2),
        ("start", "u4", 2),
        ("first", "u4", 2),
        ("blocks", "u4", 2),
        ("slot", "u4"),
        ("number", "u4"),
        ("channels", "u4"),
        ("white", "f4"),
        ("unused", "u4", 2),
    ]
)


@dataclass(frozen=True, slots=True)
class _Level:
    """Samples in a row, and the range of rows on the device: from, to."""

    width: int
    rows: Range

    @property
    def tall(self) -> int:
        return self.rows[1] - self.rows[0]


def _levels(picture: GpuGroup, rows: Range) -> list[_Level]:
    """Return the frame and its levels, as far as its rows on the device determine them; the last is a single sample."""
    found = [_Level(picture.shape[1], rows)]
    if picture.wanted.filter != "auto":
        return found
    width, height = picture.shape[1], picture.shape[0]
    while max(width, height) > 1:
        width, height = (width + 1) // 2, (height + 1) // 2
        top, end = found[-1].rows
        found.append(_Level(width, (top // 2, (end + 1) // 2)))
    return found


def size_of(picture: GpuGroup, rows: Range) -> int:
    """Return the bytes of the coarser levels of some rows of a frame."""
    return 4 * picture.channels * sum(level.width * level.tall for level in _levels(picture, rows)[1:])


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Buffers for the coarser levels of some frames.

    Parameters
    ----------
    gpu : Gpu
    picture : GpuGroup
    rows : (int, int)
        The rows of the frames that are on the device: from, to.
    buffer : wgpu.GPUBuffer
    """

    gpu: Gpu
    picture: GpuGroup
    rows: Range
    buffer: Any

    @property
    def count(self) -> int:
        """The number of levels beside the frame itself."""
        return len(_levels(self.picture, self.rows)) - 1

    @property
    def stride(self) -> int:
        """The number of samples from the levels of one slot to the next."""
        return size_of(self.picture, self.rows) // (4 * self.picture.channels)

    def build(self, samples: Layers, slot: int) -> None:
        """Compute the levels of the frame in a slot."""
        gpu, picture = self.gpu, self.picture
        found = _levels(picture, self.rows)
        if len(found) == 1:
            return
        whole = np.dtype(picture.format.dtype).kind == "u"
        names = (*_NAMES, "texels_whole" if whole else "texels_float")
        kinds = (UNIFORM, *[None] * 7, WHOLE_LAYERS if whole else LAYERS, None, WRITE)
        chosen = picture.constants()
        constants = {name: chosen[name] for name in ("ALPHA", "LIGHT", "CHANNELS")}
        made = pipeline(gpu, names, "halve", kinds, constants | {"FOLDED": int(samples.blocks != (1, 1))})
        settings = np.zeros(1, _SETTINGS)
        settings["blocks"], settings["slot"] = samples.blocks, slot
        settings["channels"], settings["white"] = picture.channels, picture.wanted.white
        start = slot * self.stride
        before = start
        passes = []
        with contextlib.ExitStack() as stack:
            for number, (fine, coarse) in enumerate(itertools.pairwise(found), 1):
                settings["number"], settings["start"] = number, (before, start)
                settings["fine"], settings["coarse"] = (fine.width, fine.tall), (coarse.width, coarse.tall)
                settings["first"] = fine.rows[0], coarse.rows[0]
                (told,) = owned(stack, upload(gpu, settings, UNIFORM))
                buffers = (told, *[None] * 7, samples.view, None, self.buffer)
                passes.append((made, buffers, (-(-coarse.width // 8), -(-coarse.tall // 8), 1)))
                before, start = start, start + coarse.width * coarse.tall
            run(gpu, passes)

    def destroy(self) -> None:
        """Free the device memory."""
        self.buffer.destroy()


def pyramid(gpu: Gpu, picture: GpuGroup, rows: Range, slots: int) -> Pyramid:
    """Return buffers for the coarser levels of frames, of which some rows are on the device."""
    return Pyramid(gpu, picture, rows, room(gpu, slots * size_of(picture, rows)))
