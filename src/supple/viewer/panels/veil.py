"""The veil over what is frozen, or its outline: a texture for the picture, and for each plane of a volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from imgui_bundle import imgui

from supple.gpu.device import Gpu
from supple.space.freezing import Freeze
from supple.viewer.panels import theme
from supple.viewer.panels.stages import filled
from supple.viewer.tools.drags import Pair

_FIRST = 1 << 20  # the number of the first texture: those of letters have low ones
_OUTER = 0.5  # coefficients from the outermost ones to the edges of a texture, whose texels are at coefficients


class Veil:
    """Textures whose opacity is 1 - m, or 4 m (1 - m), at every coefficient of the freeze mask; made anew with that."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self.textures: dict[int, Any] = {}
        """Textures by the numbers under which ImGui knows them."""
        self._known: dict[int, tuple[Freeze, int, bool]] = {}

    def draw(
        self,
        lines: imgui.ImDrawList,
        mask: Freeze,
        sizes: Sequence[int],
        seen: Callable[[tuple[float, ...]], Pair],
        axes: tuple[int, int, int] = (2, 0, 1),
        index: int = 0,
        *,
        outline: bool = False,
    ) -> None:
        """Draw the veil over a picture, or over a plane of a volume.

        Parameters
        ----------
        lines : imgui.ImDrawList
        mask : Freeze
        sizes : sequence of int
            Samples along each axis, x first.
        seen : function
            Returns the position of a point on the canvas.
        axes : (int, int, int)
            The axis of the plane's normal, the one across it and the one down, x is 0.
        index : int
            The place of the plane along its normal, in samples.
        outline : bool
            Whether to draw its edge alone, which leaves the colours of the picture as they are.
        """
        normal, across, down = axes
        which = _FIRST + normal
        if self._known.get(which) != (mask, index, outline):
            self._upload(which, mask, axes, index, outline)
            self._known[which] = mask, index, outline
        low, high = [0.0] * len(sizes), [0.0] * len(sizes)
        ends = [-0.5] * len(sizes), [n - 0.5 for n in sizes]
        for k in (across, down):
            low[k], high[k] = ends[0][k], ends[1][k]
            if mask.size[k] > 1:
                low[k] = mask.first[k] - mask.step[k] * _OUTER
                high[k] = mask.first[k] + mask.step[k] * (mask.size[k] - _OUTER)
        (a, b), (c, d) = (seen(tuple(end)) for end in ends)
        lines.push_clip_rect((min(a, c), min(b, d)), (max(a, c), max(b, d)), True)
        right, left = low.copy(), high.copy()
        right[across], left[across] = high[across], low[across]
        first, second, third, fourth = (seen(tuple(corner)) for corner in (low, right, high, left))
        lines.add_image_quad(imgui.ImTextureRef(which), first, second, third, fourth, col=theme.VEIL)
        lines.pop_clip_rect()

    def _upload(self, which: int, mask: Freeze, axes: tuple[int, int, int], index: int, outline: bool) -> None:
        normal, across, down = axes
        places: list[Any] = [
            np.zeros(1) if n == 1 else first + step * np.arange(1, n - 1)
            for n, first, step in zip(mask.size, mask.first, mask.step, strict=True)
        ]
        if mask.ndim == 3:
            places[normal] = np.array([float(index)])
        shade = mask.at(places)
        if mask.ndim == 3:
            shade = shade.squeeze(2 - normal)
        if down < across:
            shade = shade.T
        shade = np.pad(shade, 1, mode="edge")  # at its very edge, a texture repeats
        pixels = np.full((*shade.shape, 4), 255, np.uint8)
        veil = 1 - np.clip(shade, 0, 1)
        pixels[..., 3] = np.rint(255 * (4 * veil * (1 - veil) if outline else veil))
        self.textures[which] = filled(self._gpu, self.textures.get(which), pixels)
