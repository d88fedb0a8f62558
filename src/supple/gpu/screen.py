"""Textures that are drawn into, and how they come onto a screen."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.kernel import UNIFORM, source, upload

_SETTINGS = np.dtype([("split", "f4"), ("line", "f4"), ("linear", "u4"), ("unused", "u4")])


def canvas_texture(gpu: Gpu, size: tuple[int, int]) -> Any:
    """A texture of columns and rows that scenes and plates can be drawn into, and the screen read."""
    return gpu.device.create_texture(
        size=(*size, 1), format="rgba8unorm", usage="STORAGE_BINDING|TEXTURE_BINDING|COPY_SRC"
    )


def pixels_of(gpu: Gpu, texture: Any) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """What a texture holds, (rows, columns, 4)."""
    width, height = texture.size[:2]
    data = gpu.device.queue.read_texture(
        {"texture": texture}, {"bytes_per_row": 4 * width, "rows_per_image": height}, (width, height, 1)
    )
    return np.frombuffer(data, np.uint8).reshape(height, width, 4)


class Screen:
    """Puts textures onto what a window presents.

    Parameters
    ----------
    gpu : Gpu
    format : str
        Of what the window presents.
    """

    def __init__(self, gpu: Gpu, format: str) -> None:
        self._gpu, self._linear = gpu, format.endswith("srgb")
        self._smooth = gpu.device.create_sampler(mag_filter="linear", min_filter="linear")
        module = gpu.device.create_shader_module(code=source("screen"))
        self._pipeline = gpu.device.create_render_pipeline(
            layout="auto",
            vertex={"module": module, "entry_point": "corner"},
            fragment={"module": module, "entry_point": "shown", "targets": [{"format": format}]},
            primitive={"topology": "triangle-list"},
        )

    def present(
        self,
        view: Any,
        first: Any,
        second: Any = None,
        split: float = 0.0,
        place: tuple[int, int, int, int] | None = None,
    ) -> None:
        """Draw a texture, and another one left of where the split is, from 0 to 1.

        Parameters
        ----------
        view : wgpu.GPUTextureView
            What the window presents.
        first, second : wgpu.GPUTexture
        split : float
        place : (int, int, int, int), optional
            Where on the screen: left, top, columns and rows; all of it, by default.
        """
        settings = np.zeros(1, _SETTINGS)
        settings["split"] = split if second is not None else -1.0
        settings["line"] = 0.001
        settings["linear"] = self._linear
        told = upload(self._gpu, settings, UNIFORM)
        entries: list[dict[str, Any]] = [
            {"binding": 0, "resource": {"buffer": told}},
            {"binding": 1, "resource": first.create_view()},
            {"binding": 2, "resource": (second or first).create_view()},
            {"binding": 3, "resource": self._smooth},
        ]
        group = self._gpu.device.create_bind_group(layout=self._pipeline.get_bind_group_layout(0), entries=entries)
        encoder = self._gpu.device.create_command_encoder()
        drawing = encoder.begin_render_pass(
            color_attachments=[{"view": view, "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 1)}]
        )
        drawing.set_pipeline(self._pipeline)
        if place is not None:
            width, height = view.texture.size[:2]
            left, top = min(place[0], width - 1), min(place[1], height - 1)
            drawing.set_viewport(left, top, min(place[2], width - left), min(place[3], height - top), 0.0, 1.0)
        drawing.set_bind_group(0, group)
        drawing.draw(3)
        drawing.end()
        self._gpu.device.queue.submit([encoder.finish()])
