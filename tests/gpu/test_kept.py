"""What stays on the device between frames is written and bound again only when it changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from supple.gpu.buffers import Bound, Kept
from supple.gpu.device import Gpu
from supple.gpu.kernel import READ, WRITE, bound, download, pipeline, room, run, upload
from tests.gpu.points import KINDS, compiled


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
    kept, copied = Kept(gpu), room(gpu, 1024)
    code = "@group(0) @binding(0) var<storage, read> a: array<u32>;"
    code += "@group(0) @binding(1) var<storage, read_write> b: array<u32>;"
    code += "@compute @workgroup_size(1) fn copy() { for (var k = 0u; k < 9u; k++) { b[k] = a[k]; } }"
    gpu.pipelines[("copy of nine",)] = gpu.device.create_shader_module(code=code)
    try:
        copying = pipeline(gpu, ("copy of nine",), "copy", (READ, WRITE))
        for start in (0, 5):
            run(gpu, [(copying, [kept.hold(np.arange(start, start + 9, dtype=np.uint32)), copied], (1, 1, 1))])
            assert download(gpu, copied, np.uint32, 9).tolist() == list(range(start, start + 9))
    finally:
        del gpu.pipelines[("copy of nine",)]


def test_a_group_is_made_anew_for_other_things(gpu: Gpu) -> None:
    layout = compiled(gpu, "forward")[1]
    one, other = ([upload(gpu, np.zeros(64, np.float32), k) for k in KINDS] for _ in range(2))
    kept, made = Bound(), 0

    def make(things: Any) -> Any:
        nonlocal made
        made += 1
        return bound(gpu, layout, things)

    first = kept.group(one, lambda: make(one))
    assert kept.group(list(one), lambda: make(one)) is first
    assert kept.group([*one[:6], other[6]], lambda: make([*one[:6], other[6]])) is not first
    assert made == 2
