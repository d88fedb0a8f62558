"""What `cuda_engine.py` measures of warps that nobody waits for, and of volumes that lie on the host."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from paired import Line, Spread, against, rate, warming
from place import Bench, Events, host, stroke, wall, waves

SLAB = 8  # planes
SMALL = 200  # kernels that are timed where nothing else goes on
WARPS = 5


def handed_over(b: Bench) -> Iterator[Line]:
    """How long the host is kept, and how evenly another stream's small kernels run meanwhile."""
    from numba import cuda

    import supple.cuda
    from supple.engines.cuda.kernel import launched

    place, shape = b.place, (b.side,) * 3
    d = stroke(*shape)
    given = place.put(waves(*shape))

    def started(slab: int | None) -> Any:
        return supple.cuda.start(given, d, filter="linear", slab=slab)

    for slab in (None, SLAB):
        times = []
        for k in range(warming(b.runs) + b.runs):
            begun = time.perf_counter()
            warping = started(slab)
            if k >= warming(b.runs):
                times.append(time.perf_counter() - begun)
            warping.wait()
        taken = Spread.of(times)
        words = "whole" if slab is None else f"in slabs of {slab} planes"
        what = f"{b.volume}, linear, handed over {words}: the host's time"
        yield Line(what, taken, None, taken.map(lambda x: x * 1e3), "ms")

    @cuda.jit  # type: ignore[misc]
    def tick(cell: Any) -> None:
        cell[0] += 1

    cell, stream = cuda.to_device(np.zeros(1, np.int32)), cuda.stream()
    clock = wall if place.dry else Events(stream, beside=True)

    ticking = launched(tick, 1, 1, stream)

    def small() -> None:
        ticking(cell)

    ways: list[tuple[str, Callable[[], Any] | None]] = [
        ("alone", None),
        ("beside a warp handed over whole", lambda: started(None)),
        (f"beside a warp in slabs of {SLAB} planes", lambda: started(SLAB)),
    ]
    expected = 3
    for _ in range(expected):
        small()
    for words, begin in ways:
        seconds = []
        for _ in range(1 if begin is None else WARPS):
            warping = begin() if begin else None
            least = 2 if place.dry else SMALL
            while (len(seconds) < least) if warping is None else not warping.done() or not seconds:
                seconds.append(clock(small))
            if warping is not None:
                warping.wait()
        expected += len(seconds)
        micro = Spread.of(seconds).map(lambda x: x * 1e6)
        note = f"longest {micro.longest:.0f} µs"
        yield Line(f"a small kernel of another stream, {words}", value=micro, unit="µs", note=note)
    assert host(cell)[0] == expected


def host_volume(b: Bench) -> Iterator[Line]:
    """A volume of twice the side that lies on the host, through the GPU and back, against plain copies."""
    from numba import cuda

    n, memory = 2 * b.side, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    while 3 * 4 * n**3 > memory and n > 64:
        n //= 2
    d, samples = stroke(n, n, n), waves(n, n, n)
    out, size = np.empty_like(samples), 2 * samples.nbytes / 1e9
    runs = min(b.runs, 5)

    def ours() -> None:
        d.warp(samples, filter="linear", device="cuda", out=out)

    held = cuda.to_device(samples)

    def copied() -> None:
        held.copy_to_device(samples)
        held.copy_to_host(out)

    what = f"{n}³ float32 on the host, linear, through the GPU"
    yield rate(f"{what}: in and out", ours, size, "GB/s", wall, runs)
    yield against(f"{what} / copies both ways (cudaMemcpy, pageable)", ours, copied, wall, runs)
    yield rate("the copies alone", copied, size, "GB/s", wall, runs)
    part = cuda.pinned_array(max(1, min(samples.size, 1 << 27)), np.float32)
    part[:] = 1
    there = cuda.to_device(part)

    def pinned() -> None:
        there.copy_to_device(part)
        there.copy_to_host(part)

    yield rate(
        "copies both ways of pinned memory, one after the other", pinned, 2 * part.nbytes / 1e9, "GB/s", wall, runs
    )
