"""What warping arrays that are larger than memory costs: `supple.dask.warp`.

    python benchmarks/large.py              the sizes of docs/benchmarks.md: an hour on two cores, and 200 MB of disk
    python benchmarks/large.py --quick      a look at whether it works, in a minute; its figures mean nothing
    python benchmarks/large.py --only reads memory

    reads     bytes that are read, against those of the chunks that blocks need and of the whole source; the sizes of
              blocks, chunks and shards matter, and the kind of array (Zarr's, or Dask's)
    memory    peak memory of one process with two threads, for 2 GB and for 16 GB, whose samples are made when they are
              read; the result is summed, and dropped
    workers   two worker processes of one thread each against one, on 4 GB
    peer      `dask_image.ndinterp.affine_transform` against ours, with linear samples, on the same map and the same
              Dask array, alternating; both have two threads
    model     what the model of docs/large.md needs: planning, sampling, and what a task costs

The stroke is wide and strong, and reaches nearly all of the volume, so that few blocks are copies.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Threads are Dask's: with more for each task, there would be more threads than cores.
os.environ.setdefault("SUPPLE_THREADS", "1")

import dask
import dask.array as da
import numpy as np
import numpy.typing as npt
import zarr
from measure import HEAD, Line, Spread, against, figure, machine, missed, run, shown, wall
from zarr.storage import LocalStore, WrapperStore

import supple
from supple.blocks import Warp, boxes_of
from supple.dask import warp
from supple.engine.sampling import Sampling

Array = npt.NDArray[Any]
THREADS = 2
ROOM = 1.1  # times the memory for 2 GB that 16 GB may take


@dataclass(frozen=True)
class Sizes:
    """Sides of volumes and blocks."""

    reads: int
    memory: tuple[int, int]
    workers: int
    peer: int
    block: int
    runs: int


FULL = Sizes(reads=512, memory=(1024, 2048), workers=1280, peer=512, block=256, runs=5)
QUICK = Sizes(reads=128, memory=(96, 160), workers=160, peer=128, block=64, runs=1)


class Made:
    """A volume of uint16 whose samples are made when they are read: of any size, and of none."""

    dtype = np.dtype(np.uint16)

    def __init__(self, side: int, block: int) -> None:
        self.shape, self.chunks = (side,) * 3, (block,) * 3

    def __getitem__(self, key: tuple[slice, ...]) -> Array:
        z, y, x = (np.arange(*each.indices(size)) for each, size in zip(key, self.shape, strict=True))
        return np.asarray(((7 * z)[:, None] ^ (5 * y)).astype(np.uint16)[..., None] + (3 * x).astype(np.uint16))


class Counting(WrapperStore[Any]):
    """A store that counts what is read from it."""

    read = 0

    async def get(self, *given: Any, **named: Any) -> Any:
        found = await self._store.get(*given, **named)
        Counting.read += 0 if found is None else len(found)
        return found


def stroke(side: int) -> supple.Deformation:
    """A drag of a hundredth of the side that reaches nearly all."""
    middle, by = (side / 2,) * 3, (side / 100, side / 150, -side / 200)
    return supple.Deformation((side,) * 3).grab(middle, by=by, radius=side / 5, reach=None)


def summed(made: da.Array, **options: Any) -> int:
    """Compute an array of which nothing is kept but its sum."""
    return int(made.sum().compute(**options))


def reads(sizes: Sizes, here: Path) -> Iterator[Line]:
    """Lines of the bytes read from Zarr stores, without compression."""
    side = sizes.reads
    deformation = stroke(side)
    quarter, whole = side // 8, side // 2
    # What a block is, what a chunk is, and what a shard is.
    cases = [(quarter, quarter, 0), (2 * quarter, quarter, 0), (whole, quarter, 0), (whole, quarter, whole)]
    for block, chunk, shard in cases:
        path = here / f"{block}-{chunk}-{shard}.zarr"
        more = {"shards": (shard,) * 3} if shard else {}
        array = zarr.create_array(
            str(path), shape=(side,) * 3, dtype="u2", chunks=(chunk,) * 3, compressors=None, fill_value=0, **more
        )
        array[...] = Made(side, block)[:, :, :] | 1  # no chunk is empty, and left out
        source = zarr.open_array(Counting(LocalStore(path, read_only=True)), mode="r")
        made = warp(source, deformation, chunks=block)
        planned, _ = Warp(deformation, Sampling()).plan(list(boxes_of(made.chunks)))
        parts = sum(2 * int(np.prod([b - a for a, b in one.part])) for one in planned)
        met = sum(
            2 * int(np.prod([min(-(-b // chunk) * chunk, side) - a // chunk * chunk for a, b in one.part]))
            for one in planned
        )
        Counting.read = 0
        summed(made, scheduler="threads", num_workers=THREADS)
        total, of_all = Counting.read, 2 * side**3
        kind = f"chunks of {chunk}³" + (f" in shards of {shard}³" if shard else "")
        what = f"{side}³ uint16, blocks of {block}³, {kind}: bytes read / those of the chunks needed"
        yield figure(what, total / met, "×", 1.05, ours=f"{total / 1e6:.0f} MB", peer=f"{met / 1e6:.0f} MB")
        for name, size in (("of the parts that blocks read", parts), ("of the source", of_all)):
            yield figure(f"the same: / those {name}", total / size, "×", peer=f"{size / 1e6:.0f} MB")
        if block == chunk:
            Counting.read = 0
            summed(warp(da.from_zarr(source), deformation), scheduler="threads", num_workers=THREADS)
            what = "as a Dask array, whose chunks are shared: / those of the source"
            yield figure(what, Counting.read / of_all, "×")


def memory(sizes: Sizes, here: Path) -> Iterator[Line]:
    """Lines of the peak memory of processes that warp volumes of two sizes."""
    peaks = []
    for side in sizes.memory:
        seconds, peak = run([sys.executable, __file__, "--child", str(side), "--block", str(sizes.block)])
        peaks.append(peak)
        what = f"peak memory of a process, {side}³ uint16 ({2 * side**3 / 1e9:.3g} GB), blocks of {sizes.block}³"
        yield figure(what, peak, "MB", note=f"{seconds:.0f} s")
    yield figure("the second / the first", peaks[1] / peaks[0], "×", ROOM)


def child(side: int, block: int) -> None:
    """Warp a volume and drop the result, in this process."""
    summed(warp(Made(side, block), stroke(side)), scheduler="threads", num_workers=THREADS)


def workers(sizes: Sizes, here: Path) -> Iterator[Line]:
    """A row of the time that two workers take, against one."""
    from distributed import Client, LocalCluster

    side = sizes.workers
    source, deformation = Made(side, sizes.block), stroke(side)
    options = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with (
        LocalCluster(n_workers=2, **options) as both, LocalCluster(n_workers=1, **options) as single,
        Client(both, set_as_default=False) as two, Client(single, set_as_default=False) as one,
    ):  # fmt: skip

        def by(client: Any) -> None:
            with client.as_current(), dask.config.set(scheduler=client.get):
                summed(warp(source, deformation))

        what = f"{side}³ uint16 ({2 * side**3 / 1e9:.2g} GB), blocks of {sizes.block}³: two workers / one"
        yield against(what, lambda: by(two), lambda: by(one), wall, max(1, sizes.runs // 2), 0.6, warm=0)


def peer(sizes: Sizes, here: Path) -> Iterator[Line]:
    """Lines that compare an affine map with dask-image's."""
    from dask_image import ndinterp

    side, block = sizes.peer, sizes.block // 2
    rng = np.random.default_rng(1)
    source = da.from_array(rng.random((side,) * 3, np.float32), block)
    matrix = np.eye(3, 4) + 0.03 * rng.normal(size=(3, 4))
    matrix[:, 3] = 3, -2, 4
    deformation = supple.Deformation((side,) * 3, border=None).affine(matrix)
    linear, shift = matrix[::-1, 2::-1], matrix[::-1, 3]  # of indices z, y, x
    kept: dict[str, Array] = {}
    options: dict[str, Any] = {"scheduler": "threads", "num_workers": THREADS}

    def ours() -> None:
        with dask.config.set(**options):
            kept["ours"] = warp(source, deformation, filter="linear").compute()

    def theirs() -> None:
        made = ndinterp.affine_transform(
            source, linear, offset=shift, order=1, mode="nearest", output_chunks=(block,) * 3
        )
        kept["theirs"] = made.compute(**options)

    what = f"{side}³ float32, blocks of {block}³, an affine map, linear: ours / `dask_image.ndinterp.affine_transform`"
    yield against(what, ours, theirs, wall, sizes.runs)
    inside = (slice(side // 8, -side // 8),) * 3
    off = float(np.abs(kept["ours"] - kept["theirs"])[inside].max())
    yield figure("the same: the two differ by at most", off, "of values from 0 to 1")


def model(sizes: Sizes, here: Path) -> Iterator[Line]:
    """Lines of the parameters of the model, on one thread."""
    side, block = sizes.reads, sizes.block
    deformation = stroke(side)
    job = Warp(deformation, Sampling())
    whole = list(boxes_of([(block,) * (side // block)] * 3))
    planned: list[Any] = []
    plans = wall(lambda: planned.extend(job.plan(whole)[0])) / len(whole)
    source, taken = Made(side, block), []
    for one in planned[:4]:
        part = source[tuple(slice(*each) for each in one.part)][None]
        taken.append(1e9 * wall(lambda part=part, one=one: job.block(part, one)) / block**3)
    yield figure(f"planning a block of {block}³", 1e3 * plans, "ms")
    yield figure("the same, for each voxel", 1e9 * plans / block**3, "ns")
    what = "sampling, uint16, default filter, its map anew, for each voxel"
    yield Line(what, value=Spread.of(*taken), unit="ns")
    # Blocks so small that little is left but the tasks.
    many, made = 24, []
    tiny = supple.Deformation((8 * many,) * 3, border=None).grab((4, 4, 4), by=(0.5, 0, 0), radius=2, reach=2)
    planning = wall(lambda: made.append(warp(Made(8 * many, 8), tiny)))
    carried = wall(lambda: summed(made[0], scheduler="threads", num_workers=1))
    for what, spent in ((f"a graph of {many**3} blocks of 8³: planned and made", planning), ("carried out", carried)):
        yield figure(f"{what}, for each block", 1e6 * spent / many**3, "µs")


PARTS: dict[str, Callable[[Sizes, Path], Iterable[Line]]] = {
    "reads": reads,
    "memory": memory,
    "workers": workers,
    "peer": peer,
    "model": model,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that it works")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS), help="which parts (all)")
    parser.add_argument("--data", type=Path, help="a folder with room for the arrays (a temporary one)")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--block", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    if asked.child:
        child(asked.child, asked.block)
        return 0
    sizes = QUICK if asked.quick else FULL
    made = []
    print(f"{machine()}, Dask {dask.__version__}, Zarr {zarr.__version__}\n\n{HEAD}", flush=True)
    for name in asked.only:
        with tempfile.TemporaryDirectory(dir=asked.data) as folder:
            made += shown(PARTS[name](sizes, Path(folder)))
    return int(missed(made) and not asked.quick)


if __name__ == "__main__":
    sys.exit(main())
