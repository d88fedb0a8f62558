"""Dear ImGui on a canvas: its events, its layout, and its drawing in few calls."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from imgui_bundle import imgui
from wgpu.utils.imgui import ImguiRenderer

from supple.engines.wgpu.buffers import Kept
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.kernel import UNIFORM
from supple.viewer.panels import theme

_SETTINGS = np.dtype([("origin", "f4", 2), ("size", "f4", 2), ("gamma", "f4"), ("unused", "f4", 3)])
_SHADER = """
struct Settings { origin: vec2f, size: vec2f, gamma: f32 }
struct Corner { @builtin(position) position: vec4f, @location(0) at: vec2f, @location(1) colour: vec4f }

@group(0) @binding(0) var<uniform> settings: Settings;
@group(0) @binding(1) var smooth_: sampler;
@group(1) @binding(0) var letters: texture_2d<f32>;

@vertex
fn corner(@location(0) place: vec2f, @location(1) at: vec2f, @location(2) colour: vec4f) -> Corner {
    let p = 2.0 * (place - settings.origin) / settings.size - 1.0;
    return Corner(vec4f(p.x, -p.y, 0.0, 1.0), at, colour);
}

@fragment
fn inked(corner: Corner) -> @location(0) vec4f {
    let c = corner.colour * textureSample(letters, smooth_, corner.at);
    return vec4f(pow(c.rgb, vec3f(settings.gamma)), c.a);
}
"""
_OVER = {"src_factor": "src-alpha", "dst_factor": "one-minus-src-alpha", "operation": "add"}
_INDEX = {2: "uint16", 4: "uint32"}[imgui.INDEX_SIZE]


class Gui:
    """Controls laid out by a function in each frame, drawn in the canvas's format, with the canvas's events.

    They draw with textures of letters, and with pictures by their numbers.
    """

    def __init__(
        self, gpu: Gpu, canvas: Any, format: str, controls: Callable[[], None], pictures: Mapping[int, Any]
    ) -> None:
        self._canvas, self._controls, self._pictures = canvas, controls, pictures
        # Used for its event handling only: its drawing creates a bind group for each clip rectangle (wgpu 0.32).
        self._renderer = ImguiRenderer(gpu.device, canvas, format)
        self.trouble = ""  # the error of the last layout
        io = self._renderer.backend.io
        # ImGui closes open scopes after an error, and the window survives.
        io.config_error_recovery_enable_assert = False
        io.config_error_recovery_enable_tooltip = False
        theme.apply(io)
        self._device, self._gamma = gpu.device, 2.2 if format.endswith("srgb") else 1.0
        self._told, self._bytes, self._buffer = Kept(gpu, UNIFORM), bytearray(), None
        self._letters: dict[int, tuple[Any, Any]] = {}  # textures, and their bind groups
        self._drawn: dict[int, tuple[Any, Any]] = {}  # likewise, of pictures
        module = self._device.create_shader_module(code=_SHADER)
        shapes = zip(("float32x2", "float32x2", "unorm8x4"), (0, 8, 16), strict=True)
        attributes = [{"format": f, "offset": o, "shader_location": k} for k, (f, o) in enumerate(shapes)]
        self._pipeline = self._device.create_render_pipeline(
            layout="auto",
            vertex={
                "module": module,
                "entry_point": "corner",
                "buffers": [{"array_stride": imgui.VERTEX_SIZE, "step_mode": "vertex", "attributes": attributes}],
            },
            fragment={
                "module": module,
                "entry_point": "inked",
                "targets": [{"format": format, "blend": {"color": _OVER, "alpha": _OVER | {"src_factor": "one"}}}],
            },
            primitive={"topology": "triangle-list"},
        )
        smooth = self._device.create_sampler(mag_filter="linear", min_filter="linear")
        self._common = self._device.create_bind_group(
            layout=self._pipeline.get_bind_group_layout(0),
            entries=[
                {"binding": 0, "resource": {"buffer": self._told.hold(np.zeros(1, _SETTINGS))}},
                {"binding": 1, "resource": smooth},
            ],
        )

    def release(self) -> None:
        """Pass the next event on, whatever was under the pointer in the last frame."""
        imgui.set_current_context(self._renderer.imgui_context)
        if not imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
            self._renderer.backend.io.want_capture_mouse = False

    def lay(self) -> None:
        """Run the layout function, and prepare its drawing."""
        imgui.set_current_context(self._renderer.imgui_context)
        ratio, io = self._canvas.get_pixel_ratio(), self._renderer.backend.io
        io.display_size = self._canvas.get_logical_size()
        io.display_framebuffer_scale = ratio, ratio
        imgui.new_frame()
        self.trouble = ""
        try:
            self._controls()
        except Exception as error:  # any error: strokes may be unsaved
            self.trouble = " ".join(f"{type(error).__name__}: {error}".split())
        finally:
            imgui.render()

    def draw(self, drawing: Any) -> None:
        """Draw the layout into a render pass."""
        data = imgui.get_draw_data()
        for texture in data.textures or ():
            if texture.status != imgui.ImTextureStatus.ok:
                self._update(texture)
        ratio, (left, top), (wide, high) = data.framebuffer_scale, data.display_pos, data.display_size
        columns, rows = int(wide * ratio.x), int(high * ratio.y)
        lists = list(data.cmd_lists)
        if columns <= 0 or rows <= 0 or not lists:
            return
        self._told.hold(np.array([((left, top), (wide, high), self._gamma, (0, 0, 0))], _SETTINGS))
        indices = self._write(lists)
        drawing.set_viewport(0, 0, columns, rows, 0, 1)
        drawing.set_pipeline(self._pipeline)
        drawing.set_vertex_buffer(0, self._buffer)
        drawing.set_index_buffer(self._buffer, _INDEX, indices)
        drawing.set_bind_group(0, self._common)
        corner, index, bound = 0, 0, 0
        for part in lists:
            for command in part.cmd_buffer:
                clip = command.clip_rect
                x, y = max(int((clip.x - left) * ratio.x), 0), max(int((clip.y - top) * ratio.y), 0)
                width = min(int((clip.z - left) * ratio.x), columns) - x
                height = min(int((clip.w - top) * ratio.y), rows) - y
                if width <= 0 or height <= 0 or not command.elem_count:
                    continue
                which = command.tex_ref.get_tex_id()
                if which != bound:
                    bound = which
                    drawing.set_bind_group(1, self._group(which))
                drawing.set_scissor_rect(x, y, width, height)
                first, base = index + command.idx_offset, corner + command.vtx_offset
                drawing.draw_indexed(command.elem_count, 1, first, base, 0)
            corner += part.vtx_buffer.size()
            index += part.idx_buffer.size()

    def _group(self, which: int) -> Any:
        """Return the bind group of a texture."""
        if which in self._letters:
            return self._letters[which][1]
        texture = self._pictures[which]
        if which not in self._drawn or self._drawn[which][0] is not texture:
            self._drawn[which] = self._bound(texture)
        return self._drawn[which][1]

    def _bound(self, texture: Any) -> tuple[Any, Any]:
        """Return a texture, and a bind group for it."""
        layout, entries = self._pipeline.get_bind_group_layout(1), [{"binding": 0, "resource": texture.create_view()}]
        return texture, self._device.create_bind_group(layout=layout, entries=entries)

    def _write(self, lists: list[Any]) -> int:
        """Write vertices, and then the indices of triangles; return the offset of the indices."""
        vectors = [(part.vtx_buffer, imgui.VERTEX_SIZE) for part in lists]
        vectors += [(part.idx_buffer, imgui.INDEX_SIZE) for part in lists]
        sizes = [vector.size() * size for vector, size in vectors]
        begin: int = sum(sizes[: len(lists)])
        end = begin + sum(sizes[len(lists) :])  # vertices have 20 bytes: indices begin at a whole word
        if len(self._bytes) < end + 4:
            self._bytes = bytearray(2 * end + 4)
            self._buffer = self._device.create_buffer(size=len(self._bytes) & ~3, usage="VERTEX|INDEX|COPY_DST")
        place = ctypes.addressof(ctypes.c_char.from_buffer(self._bytes))
        for (vector, _), size in zip(vectors, sizes, strict=True):
            ctypes.memmove(place, vector.data_address(), size)
            place += size
        self._device.queue.write_buffer(self._buffer, 0, memoryview(self._bytes)[: -(-end // 4) * 4])
        return begin

    def _update(self, texture: imgui.ImTextureData) -> None:
        """Create, update or destroy a texture of letters, as requested."""
        status = imgui.ImTextureStatus
        if texture.status == status.want_destroy:
            if texture.unused_frames > 0:
                which = texture.get_tex_id()
                self._letters.pop(which, None)
                texture.set_tex_id(0)
                texture.set_status(status.destroyed)
            return
        size = texture.width, texture.height, 1
        if texture.status == status.want_create:
            made = self._device.create_texture(size=size, format="rgba8unorm", usage="COPY_DST|TEXTURE_BINDING")
            which = max(self._letters, default=0) + 1
            texture.set_tex_id(which)
            self._letters[which] = self._bound(made)
        # The whole texture: new letters are rare.
        self._device.queue.write_texture(
            {"texture": self._letters[texture.get_tex_id()][0]},
            texture.get_pixels_array(),
            {"bytes_per_row": 4 * texture.width, "rows_per_image": texture.height},
            size,
        )
        texture.set_status(status.ok)
