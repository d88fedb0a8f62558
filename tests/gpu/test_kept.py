"""What stays on the device between frames is written and bound again only when it changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.gpu.device import Gpu
from supple.gpu.memory import Bound, Kept, download, room, upload
from supple.gpu.shader import module, shader, structure, template

COPY = """
struct Settings {
    count: u32,
    at: vec3f, // at its own alignment
    last: f32,
    matrix: mat3x3f,
}

var<uniform> settings: Settings;
var<storage, read> a: array<u32>;
var<storage, read_write> b: array<u32>;

@compute @workgroup_size(1)
fn copy() {
    for (var k = 0u; k < settings.count; k++) {
        b[k] = a[k];
    }
    b[9] = u32(settings.at.z + settings.last + settings.matrix[2].y);
}
"""


def test_what_changes_is_written_and_only_that(gpu: Gpu, monkeypatch: Any) -> None:
    queue, written = gpu.device.queue, []
    write = queue.write_buffer

    def counted(buffer: Any, start: int, data: Any) -> None:
        written.append(len(data))
        write(buffer, start, data)

    monkeypatch.setattr(queue, "write_buffer", counted)
    kept = Kept(gpu)
    some = np.arange(6, dtype=np.float32)
    first = kept.hold(some)
    assert kept.hold(some.copy()) is first
    assert written == [24]
    some[2] = 7.0
    assert kept.hold(some) is first
    assert kept.hold(some[:3]) is first
    assert written == [24, 24, 12]
    # What does not fit is put elsewhere; what is there is what was given last, whatever was there before.
    more = np.arange(200, dtype=np.float32)
    second = kept.hold(more)
    assert second is not first
    assert second.size >= 800
    assert kept.hold(np.empty(0, np.float32)) is second


def test_what_a_shader_reads_is_what_is_held(gpu: Gpu) -> None:
    kept, copied, text = Kept(gpu), room(gpu, 1024), template(COPY)
    matrix = np.arange(12.0).reshape(3, 4)
    for start in (0, 5):
        given = {"a": kept.hold(np.arange(start, start + 9, dtype=np.uint32)), "b": copied}
        settings = {"count": 9, "at": (1, 2, 300), "last": 40, "matrix": matrix}
        shader(gpu, text, "copy").run((1, 1, 1), settings, given)
        assert download(gpu, copied, np.uint32, 10).tolist() == [*range(start, start + 9), 349]


def test_settings_are_laid_out_as_shaders_read_them() -> None:
    made = structure(COPY, "Settings")
    assert made.fields is not None
    assert {name: made.fields[name][1] for name in made.names or ()} == {"count": 0, "at": 16, "last": 28, "matrix": 32}
    assert made.itemsize == 80


def test_a_group_is_made_anew_for_other_things(gpu: Gpu) -> None:
    made, kept, asked = module(gpu, template(COPY)), Bound(), []
    one, other = ({name: upload(gpu, np.zeros(64, np.float32)) for name in made.kinds} for _ in range(2))

    def make(given: Any) -> Any:
        asked.append(given)
        return made.group(given)

    first = kept.group(one, make)
    assert kept.group(dict(one), make) is first
    assert kept.group({**one, "b": other["b"]}, make) is not first
    assert len(asked) == 2
