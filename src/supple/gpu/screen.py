"""Textures for drawing, and their presentation on a screen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.memory import Bound, Kept
from supple.gpu.shader import module, source

Part = tuple[float, float, float, float, float, float, float, float, float]
"""A part of a texture, in fractions of it: x and y of its upper left corner on screen, of its side across, and down.

The last three are the divisor of these, for perspective: at that corner, and its changes across and down.
"""
ALL: Part = (0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)

PLAIN, SWAPPED = "rgba8unorm", "bgra8unorm"


def canvas_texture(gpu: Gpu, size: tuple[int, int], format: str = PLAIN) -> Any:
    """Return a texture of columns and rows, which the screen can read; scenes and plates draw into `PLAIN` ones."""
    usage = "TEXTURE_BINDING|COPY_SRC|COPY_DST" + ("|STORAGE_BINDING" if format == PLAIN else "")
    return gpu.device.create_texture(size=(*size, 1), format=format, usage=usage)


def pixels_of(gpu: Gpu, texture: Any) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the values of a texture, (rows, columns, 4)."""
    width, height = texture.size[:2]
    data = gpu.device.queue.read_texture(
        {"texture": texture}, {"bytes_per_row": 4 * width, "rows_per_image": height}, (width, height, 1)
    )
    return np.frombuffer(data, np.uint8).reshape(height, width, 4)


def composed(gpu: Gpu, size: tuple[int, int], draw: Callable[[Any], None]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the pixels (rows, columns, 4) that ``draw`` draws into a render pass of ``size`` (columns, rows)."""
    onto = gpu.device.create_texture(size=(*size, 1), format=PLAIN, usage="RENDER_ATTACHMENT|COPY_SRC")
    colours = {"view": onto.create_view(), "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 1)}
    encoder = gpu.device.create_command_encoder()
    drawing = encoder.begin_render_pass(color_attachments=[colours])
    draw(drawing)
    drawing.end()
    gpu.device.queue.submit([encoder.finish()])
    return pixels_of(gpu, onto)


def covers(texture: Any, size: tuple[int, ...], part: Part) -> bool:
    """Return whether a part of a texture covers a place of ``size`` (columns, rows) pixel by pixel."""
    return texture.size[:2] == size and max(abs(a - b) for a, b in zip(part, ALL, strict=True)) < 1e-5


class Screen:
    """A painter of textures onto a surface of some format, in sRGB, by the ``"linear"`` or ``"nearest"`` filter."""

    def __init__(self, gpu: Gpu, format: str, filter: str = "linear") -> None:
        self._smooth = gpu.device.create_sampler(mag_filter=filter, min_filter=filter)
        self._module = module(gpu, source("screen"))
        code, layout = self._module.code, self._module.layout
        self._pipelines = {
            split: gpu.device.create_render_pipeline(
                layout=gpu.device.create_pipeline_layout(bind_group_layouts=[layout]),
                vertex={"module": code, "entry_point": "corner"},
                fragment={
                    "module": code,
                    "entry_point": "shown",
                    "targets": [{"format": format}],
                    "constants": {"SPLIT": split},
                },
                primitive={"topology": "triangle-list"},
            )
            for split in (False, True)
        }
        self._settings, self._bound = Kept(gpu), Bound()

    def draw(
        self,
        drawing: Any,
        first: Any,
        second: Any = None,
        split: float = 0.0,
        place: tuple[int, int, int, int] | None = None,
        part: Part = ALL,
    ) -> None:
        """Draw the visible part of a texture, and optionally another one left of the split, from 0 to 1.

        The place on the surface is its left, top, columns and rows; by default, all of it.
        """
        split = split if second is not None else -1.0
        values = self._module.values({"sides": part[2:6], "corner": part[:2], "depth": part[6:], "split": split})
        given = {"settings": self._settings.hold(values), "first": first, "second": second or first}
        drawing.set_pipeline(self._pipelines[second is not None])
        if place is not None:
            drawing.set_viewport(*place, 0.0, 1.0)
        drawing.set_bind_group(0, self._bound.group(given, self._group))
        drawing.draw(3)

    def _group(self, given: Mapping[str, Any]) -> Any:
        views = {name: given[name].create_view() for name in ("first", "second")}
        return self._module.group({**given, **views, "smooth_": self._smooth})
