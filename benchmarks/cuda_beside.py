"""What `cuda_engine.py` measures of first calls, warps that nobody waits for, and volumes that lie on the host."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from measure import WARMING, Line, Spread, against, rate, wall
from place import Bench, Events, stroke, waves

SLAB = 8  # planes
SMALL = 200  # kernels that are timed where nothing else goes on
WARPS = 5
FIRST = """
import sys, time
import supple
from place import play, sent, stroke, waves

dry, *shape = (int(word) for word in sys.argv[1:])
if dry:
    play()
d, given = stroke(*shape), sent(waves(*shape))
begun = time.perf_counter()
d.warp(given)
print(time.perf_counter() - begun)
"""


def first_calls(b: Bench) -> Iterator[Line]:
    """The first warp of a process, of an array that is on the GPU: kernels are compiled, or read from the cache."""
    runs = 1 if b.place.dry else 3

    def first(shape: tuple[int, ...], cache: str) -> float:
        words = [sys.executable, "-c", FIRST, str(int(b.place.dry)), *map(str, shape)]
        around = {**os.environ, "SUPPLE_CACHE": cache, "PYTHONPATH": os.pathsep.join(sys.path)}
        done = subprocess.run(words, env=around, stdout=subprocess.PIPE, check=True)
        return float(done.stdout.split()[-1])

    for words, shape in (("a picture", b.batch[1:] * 2), ("a volume", (b.side // 2,) * 3)):
        empty, full = [], []
        for _ in range(runs):
            with tempfile.TemporaryDirectory() as cache:
                empty.append(first(shape, cache))
                full.append(first(shape, cache))
        for state, bar, taken in (("empty", 2.0, empty), ("full", 0.3, full)):
            what = f"first call of a process: {words} of float32, auto; the cache is {state}"
            yield Line(what, value=Spread.of(*taken), unit="s", bar=bar)


def handed_over(b: Bench) -> Iterator[Line]:
    """How long the host is kept, and how evenly another stream's small kernels run meanwhile."""
    import supple.cuda
    from supple.cuda.device import open_device
    from supple.cuda.programs import SOME, Program, launch, prepare, record

    place, shape = b.place, (b.side,) * 3
    d = stroke(*shape)
    given = place.put(waves(*shape))

    def started(slab: int | None) -> Any:
        return supple.cuda.start(given, d, filter="linear", slab=slab)

    for slab in (None, SLAB):
        times = []
        for _ in range(WARMING + b.runs):
            begun = time.perf_counter()
            warping = started(slab)
            times.append(time.perf_counter() - begun)
            warping.wait()
        taken = Spread.of(*times[WARMING:])
        words = "whole" if slab is None else f"in slabs of {slab} planes"
        what = f"{b.volume}, linear, handed over {words}: the host's time"
        yield Line(what, taken, "", taken.map(lambda x: x * 1e3), "ms")

    gpu = open_device()
    stream = gpu.stream()
    kernel, none = prepare(gpu, Program("points", 2, False)), record(SOME)  # of no points: a block with nothing to do
    clock = wall if place.dry else Events(stream.handle, beside=True)

    def small() -> None:
        with gpu.current():
            launch(kernel, none, stream, 1)

    ways: list[tuple[str, Callable[[], Any] | None]] = [
        ("alone", None),
        ("beside a warp handed over whole", lambda: started(None)),
        (f"beside a warp in slabs of {SLAB} planes", lambda: started(SLAB)),
    ]
    for _ in range(3):
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
        micro = Spread.of(*seconds).map(lambda x: x * 1e6)
        note = f"longest {micro.longest:.0f} µs"
        yield Line(f"a small kernel of another stream, {words}", value=micro, unit="µs", note=note)


def host_volume(b: Bench) -> Iterator[Line]:
    """A volume of twice the side that lies on the host, through the GPU and back, against plain copies."""
    from supple.cuda.device import Memory, Pinned, Stream, open_device

    n, memory = 2 * b.side, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    while 3 * 4 * n**3 > memory and n > 64:
        n //= 2
    d, samples = stroke(n, n, n), waves(n, n, n)
    out, size = np.empty_like(samples), 2 * samples.nbytes / 1e9
    runs = min(b.runs, 5)

    def ours() -> None:
        d.warp(samples, filter="linear", device="cuda", out=out)

    gpu, stream = open_device(), Stream(0)

    def both_ways(there: Memory, source: Any, target: Any) -> Callable[[], None]:
        def copied() -> None:
            with gpu.current():
                there.upload(source)
                there.download(target)
                stream.synchronize()

        return copied

    what = f"{n}³ float32 on the host, linear, through the GPU"
    yield rate(f"{what}: in and out", ours, size, "GB/s", wall, runs)
    with gpu.current():
        held = Memory(samples.nbytes, stream)
    copied = both_ways(held, samples, out)
    yield against(f"{what} / copies both ways (pageable memory)", ours, copied, wall, runs)
    yield rate("the copies alone", copied, size, "GB/s", wall, runs)
    with gpu.current():
        pinned = Pinned(min(samples.nbytes, 1 << 29))
    part = pinned.bytes
    part[:] = 1
    words = "copies both ways of pinned memory, one after the other"
    yield rate(words, both_ways(held, part, part), 2 * part.nbytes / 1e9, "GB/s", wall, runs)
