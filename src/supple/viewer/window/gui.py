"""Dear ImGui on a canvas: its events, its layout, and its drawing in few calls."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from imgui_bundle import imgui
from wgpu.utils.imgui import ImguiRenderer

from supple.engines.wgpu.buffers import Kept
from supple.engines.wgpu.device import Gpu
from supple.engines.wgpu.kernel import UNIFORM
from supple.viewer.panels import theme

_SETTINGS = np.dtype([("origin", "f4", 2), ("size", "f4", 2)])
_SHADER = """
override LINEAR: bool; // whether the screen takes linear light

struct Settings { origin: vec2f, size: vec2f }
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
    if (LINEAR) {
        return vec4f(pow(c.rgb, vec3f(2.2)), c.a);
    }
    return c;
}
"""
_OVER = {"src_factor": "src-alpha", "dst_factor": "one-minus-src-alpha", "operation": "add"}
_INDEX = {2: "uint16", 4: "uint32"}[imgui.INDEX_SIZE]


class _Layer:
    """A context of Dear ImGui, what was laid out in it last, and its vertices on the device."""

    def __init__(self, device: Any, context: Any, io: imgui.IO, work: Callable[[], None]) -> None:
        self._device, self._context, self.io, self._work = device, context, io, work
        self._bytes, self.buffer, self.indices = bytearray(), None, 0
        self._laid = time.perf_counter()
        self.data: Any = None
        self._lists: list[Any] = []
        self._commands: list[tuple[Any, ...]] | None = None
        # ImGui closes open scopes after an error, and the window survives.
        io.config_error_recovery_enable_assert = False
        io.config_error_recovery_enable_tooltip = False

    def lay(self, size: tuple[float, float], ratio: float) -> str:
        """Lay it out, for a canvas of a logical size; return the error, or an empty text."""
        imgui.set_current_context(self._context)
        self.io.display_size, self.io.display_framebuffer_scale = imgui.ImVec2(*size), imgui.ImVec2(ratio, ratio)
        now = time.perf_counter()
        self.io.delta_time, self._laid = max(now - self._laid, 1e-4), now
        imgui.new_frame()
        trouble = ""
        try:
            self._work()
        except Exception as error:  # any error: strokes may be unsaved
            trouble = " ".join(f"{type(error).__name__}: {error}".split())
        finally:
            imgui.render()
        self.data = imgui.get_draw_data()
        self._lists, self._commands = list(self.data.cmd_lists), None
        self._write()
        return trouble

    @property
    def commands(self) -> list[tuple[Any, ...]]:
        """Of each command: where it may draw, its texture, how many indices, and the first index and vertex.

        They are for after textures are updated, which get their numbers then.
        """
        if self._commands is None:
            self._commands, corner, index = [], 0, 0
            for part in self._lists:
                for each in part.cmd_buffer:
                    clip, which = each.clip_rect, each.tex_ref.get_tex_id()
                    first, base = index + each.idx_offset, corner + each.vtx_offset
                    if each.elem_count:
                        self._commands.append(((clip.x, clip.y, clip.z, clip.w), which, each.elem_count, first, base))
                corner += part.vtx_buffer.size()
                index += part.idx_buffer.size()
        return self._commands

    def _write(self) -> None:
        """Write vertices, and then the indices of triangles."""
        vectors = [(part.vtx_buffer, imgui.VERTEX_SIZE) for part in self._lists]
        vectors += [(part.idx_buffer, imgui.INDEX_SIZE) for part in self._lists]
        sizes = [vector.size() * size for vector, size in vectors]
        self.indices = sum(sizes[: len(self._lists)])
        end = sum(sizes)  # vertices have 20 bytes: indices begin at a whole word
        if end == 0:
            return
        if len(self._bytes) < end + 4:
            self._bytes = bytearray(2 * end + 4)
            self.buffer = self._device.create_buffer(size=len(self._bytes) & ~3, usage="VERTEX|INDEX|COPY_DST")
        place = ctypes.addressof(ctypes.c_char.from_buffer(self._bytes))
        for (vector, _), size in zip(vectors, sizes, strict=True):
            ctypes.memmove(place, vector.data_address(), size)
            place += size
        self._device.queue.write_buffer(self.buffer, 0, memoryview(self._bytes)[: -(-end // 4) * 4])


class Gui:
    """Controls and marks on a canvas, laid out by functions, drawn in the canvas's format, with the canvas's events.

    The marks lie on the picture, below the controls, and are laid out for each frame. They have no events, and a
    context of their own. Both draw with textures of letters, and with pictures by their numbers.
    """

    def __init__(
        self,
        gpu: Gpu,
        canvas: Any,
        format: str,
        controls: Callable[[], None],
        marks: Callable[[], None],
        pictures: Mapping[int, Any],
    ) -> None:
        self._canvas, self._pictures = canvas, pictures
        # Used for its event handling only: its drawing creates a bind group for each clip rectangle (wgpu 0.32).
        self._renderer = ImguiRenderer(gpu.device, canvas, format)
        self.trouble = ""  # the error of the last layout
        io = self._renderer.backend.io
        theme.apply(io)
        self._controls = _Layer(gpu.device, self._renderer.imgui_context, io, controls)
        context = imgui.create_context(io.fonts)
        imgui.set_current_context(context)
        own = imgui.get_io()
        own.set_ini_filename("")
        own.backend_flags = io.backend_flags
        theme.style()
        self._marks = _Layer(gpu.device, context, own, marks)
        imgui.set_current_context(self._renderer.imgui_context)
        self._told = Kept(gpu, UNIFORM)
        self._device = gpu.device
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
                "constants": {"LINEAR": format.endswith("srgb")},
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

    def lay(self, *, all: bool) -> None:
        """Lay out the marks, and the controls if all is to be."""
        size, ratio = self._canvas.get_logical_size(), self._canvas.get_pixel_ratio()
        trouble = self._controls.lay(size, ratio) if all else ""  # first: the letters are theirs
        self.trouble = trouble or self._marks.lay(size, ratio)
        imgui.set_current_context(self._renderer.imgui_context)

    def draw(self, drawing: Any) -> None:
        """Draw what is laid out into a render pass."""
        for layer in (self._marks, self._controls):
            for texture in layer.data.textures or ():
                if texture.status != imgui.ImTextureStatus.ok:
                    self._update(texture)
        data = self._controls.data
        ratio, (left, top), (wide, high) = data.framebuffer_scale, data.display_pos, data.display_size
        columns, rows = int(wide * ratio.x), int(high * ratio.y)
        if columns <= 0 or rows <= 0:
            return
        self._told.hold(np.array([((left, top), (wide, high))], _SETTINGS))
        drawing.set_viewport(0, 0, columns, rows, 0, 1)
        drawing.set_pipeline(self._pipeline)
        drawing.set_bind_group(0, self._common)
        for layer in (self._marks, self._controls):
            if layer.buffer is not None:
                self._draw(drawing, layer, columns, rows)

    def _draw(self, drawing: Any, layer: _Layer, columns: int, rows: int) -> None:
        ratio, (left, top) = layer.data.framebuffer_scale, layer.data.display_pos
        drawing.set_vertex_buffer(0, layer.buffer)
        drawing.set_index_buffer(layer.buffer, _INDEX, layer.indices)
        bound, cut = 0, (0, 0, 0, 0)
        for clip, which, count, first, base in layer.commands:
            x, y = max(int((clip[0] - left) * ratio.x), 0), max(int((clip[1] - top) * ratio.y), 0)
            width = min(int((clip[2] - left) * ratio.x), columns) - x
            height = min(int((clip[3] - top) * ratio.y), rows) - y
            if width <= 0 or height <= 0:
                continue
            if which != bound:
                bound = which
                drawing.set_bind_group(1, self._group(which))
            if cut != (x, y, width, height):
                cut = x, y, width, height
                drawing.set_scissor_rect(*cut)
            drawing.draw_indexed(count, 1, first, base, 0)

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
