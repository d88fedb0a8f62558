"""The CUDA engine: `make bench-cuda`, or `python benchmarks/cuda_engine.py [--quick] [--json FILE]`.

Each time is that of a whole call (for ours: the map of the deformation, its certificate and the samples), by CUDA
events, in turn with a peer that has its map in hand. Both results are compared before. First calls are those of
processes of their own. `--dry` goes through all of it on a machine without a GPU: on one that is played in memory, with
tiny arrays; its times mean nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from measure import HEAD, Line, Spread, against, missed, rate, took
from place import Bench, Place, host, play, stroke, waves

if TYPE_CHECKING:
    import supple

Array = npt.NDArray[Any]

PAPER = "the paper: 430–2,180 ms, on its GPU"
CLOSE = 1e-3  # of the range


def strokes(count: int, *shape: int) -> supple.Deformation:
    """Many, each of its own."""
    import supple

    rng = np.random.default_rng(count)
    size = np.array(shape[::-1]) - 1.0
    d = supple.Deformation(shape, border=None)
    warnings.simplefilter("ignore", supple.MissWarning)  # they meet
    for _ in range(count):
        by = rng.normal(0, 0.01, len(shape)) * size
        d = d.grab(rng.uniform(0.2, 0.8, len(shape)) * size, by=by, radius=float(rng.uniform(0.1, 0.3) * size.min()))
    return d


def normalised(points: Array, shape: tuple[int, ...]) -> Array:
    """Source points, x first, as grid_sample takes them with align_corners=True."""
    last = np.array(shape[::-1], np.float32) - 1
    return np.asarray(2 * points / last - 1, np.float32)


def agree(what: str, ours: Any, peer: Any) -> None:
    """Both results must be the same, as far as their source points are; ours is as the peer's lies."""
    apart = float(np.abs(host(ours) - host(peer)).max())
    if not apart <= CLOSE:
        raise ValueError(f"{what}: the results are {apart:.3g} apart, more than {CLOSE:g}")


def one_volume(b: Bench) -> Iterator[Line]:
    """A volume, one stroke."""
    place, shape = b.place, (b.side,) * 3
    d, samples = stroke(*shape), waves(*shape)
    given = place.put(samples)
    yield took(f"{b.volume}, one stroke, linear, whole warp", lambda: d.warp(given, filter="linear"), place.clock,
               b.runs, 2.5, PAPER)  # fmt: skip
    if not place.dry:
        yield memory(b, d, given)
    for more in ({"filter": "cubic"}, {"filter": "auto"}, {"filter": "linear", "tolerance": 1e-3}):
        words = more["filter"] + (", tolerance 1e-3" if "tolerance" in more else "")
        yield took(f"the same, {words}", lambda more=more: d.warp(given, **more), place.clock, b.runs)
    many = strokes(20, *shape)
    yield took("the same, linear, 20 strokes", lambda: many.warp(given, filter="linear"), place.clock, b.runs)
    labels = place.put((samples * 5).astype(np.uint8))
    words = f"{b.side}³ uint8 labels, one stroke, nearest"
    yield took(words, lambda: d.warp(labels, filter="nearest"), place.clock, b.runs)


def memory(b: Bench, d: supple.Deformation, given: Any) -> Line:
    """What a warp takes of the GPU's memory at most, with its source and its result, in volumes."""
    from supple.cuda.device import call, driver, open_device

    with open_device().current():
        pool = call("cuDeviceGetDefaultMemPool", call("cuDeviceGet", 0))
        high = driver().CUmemPool_attribute.CU_MEMPOOL_ATTR_USED_MEM_HIGH
        call("cuMemPoolSetAttribute", pool, high, driver().cuuint64_t(0))
        d.warp(given, filter="linear")
        beside = int(call("cuMemPoolGetAttribute", pool, high))
    volume = 4 * b.side**3
    own = b.place.kind == "own"  # whose arrays are in the pool
    most = beside / volume + (0 if own else 2)
    return Line("the same, memory", value=Spread.of(most), unit="volumes", bar=2.2)


def volume_against_torch(b: Bench) -> Iterator[Line]:
    """torch.nn.functional.grid_sample, with the grid in hand."""
    place, shape = b.place, (b.side,) * 3
    what = f"{b.volume}, one stroke, linear / torch grid_sample with the grid in hand"
    if "torch" in place.missing:
        yield Line(what, bar=1.0, note=place.missing["torch"])
        return
    from torch.nn.functional import grid_sample

    d, samples = stroke(*shape), waves(*shape)
    given, tensor = place.put(samples, "torch"), place.peers(samples, "torch")[None, None]
    grid = place.peers(normalised(d.inverse_map(), shape), "torch")[None]

    def ours() -> Any:
        return d.warp(given, filter="linear")

    def peer() -> Any:
        return grid_sample(tensor, grid, mode="bilinear", padding_mode="border", align_corners=True)

    agree(what, ours(), peer()[0, 0])
    yield against(what, ours, peer, place.clock, b.runs, 1.0)


def volume_against_cupy(b: Bench) -> Iterator[Line]:
    """cupyx.scipy.ndimage.map_coordinates, with the map in hand."""
    place, shape = b.place, (b.side,) * 3
    what = f"{b.volume}, one stroke, linear / cupyx map_coordinates(order=1) with the map in hand"
    if "cupy" in place.missing:
        yield Line(what, note=place.missing["cupy"])
        return
    if place.dry:
        from scipy.ndimage import map_coordinates
    else:
        from cupyx.scipy.ndimage import map_coordinates
    d, samples = stroke(*shape), waves(*shape)
    given, source = place.put(samples, "cupy"), place.peers(samples, "cupy")
    points = place.peers(np.ascontiguousarray(np.moveaxis(d.inverse_map(), -1, 0)[::-1]), "cupy")

    def ours() -> Any:
        return d.warp(given, filter="linear")

    def peer() -> Any:
        return map_coordinates(source, points, order=1, mode="nearest")

    agree(what, ours(), peer())
    yield against(what, ours, peer, place.clock, b.runs)


def clip_in_time(b: Bench) -> Iterator[Line]:
    """Frames, bent in x, y and t."""
    import supple

    count, height, width = b.clip
    frame = (255 * waves(height, width, 3)).astype(np.uint8)
    frames = np.stack([np.roll(frame, 2 * k, axis=1) for k in range(count)])
    middle = (width / 2, height / 2, count / 2)
    d = supple.Deformation(b.clip, border=None)
    d = d.grab(middle, by=(width / 10, 0, count / 16), radius=height / 3.6)
    given = b.place.put(frames)
    what = f"{width}×{height}×{count} RGB uint8, warped in time, linear"
    yield rate(what, lambda: d.warp(given, filter="linear"), count, "frames/s", b.place.clock, b.runs, 12_000)
    more: dict[str, Any] = {"filter": "auto", "time_filter": True}
    words = "the same, auto, averaged over the time that a pixel covers"
    yield rate(words, lambda: d.warp(given, **more), count, "frames/s", b.place.clock, b.runs)


def batch(b: Bench) -> Iterator[Line]:
    """Pictures, a deformation each, against both peers; in the layout of those: channels first."""
    import supple

    place, (count, side) = b.place, b.batch
    what = f"batch of {count} × {side}² RGB float32, a deformation each, linear"
    names = {"torch": "torch grid_sample with the grids in hand", "kornia": "kornia remap with the maps in hand"}
    if "torch" in place.missing:
        for name, words in names.items():
            yield Line(f"{what} / {words}", bar=2.0 if name == "torch" else None, note=place.missing[name])
        return
    from torch.nn.functional import grid_sample

    ds = [
        supple.Deformation((side, side)).grab(
            (side * (0.4 + 0.2 * k / count), side / 2), by=(side / 12, side / 20), radius=side / 5
        )
        for k in range(count)
    ]
    points = np.stack([d.inverse_map() for d in ds])
    pictures = np.stack([np.stack([waves(side, side, phase=k + c) for c in range(3)]) for k in range(count)])
    tensor = place.peers(pictures, "torch")
    last = np.ascontiguousarray(pictures.transpose(0, 2, 3, 1))
    given = place.put(last) if place.dry else tensor.permute(0, 2, 3, 1)

    def ours() -> Any:
        return supple.warp_batch(given, ds, filter="linear")

    grid = place.peers(normalised(points, (side, side)), "torch")

    def sampled() -> Any:
        return grid_sample(tensor, grid, mode="bilinear", padding_mode="border", align_corners=True)

    agree(what, ours(), sampled().permute(0, 2, 3, 1))
    yield against(f"{what} / {names['torch']}", ours, sampled, place.clock, b.runs, 2.0)
    if "kornia" in place.missing:
        yield Line(f"{what} / {names['kornia']}", note=place.missing["kornia"])
    else:
        from kornia.geometry.transform import remap

        xs, ys = (place.peers(np.ascontiguousarray(points[..., k]), "torch") for k in (0, 1))

        def remapped() -> Any:
            return remap(tensor, xs, ys, mode="bilinear", padding_mode="border", align_corners=True)

        agree(what, ours(), remapped().permute(0, 2, 3, 1))
        yield against(f"{what} / {names['kornia']}", ours, remapped, place.clock, b.runs)
    dense = place.put(last, "torch")
    words = "the same, channels last in memory / torch grid_sample, channels first"
    yield against(words, lambda: supple.warp_batch(dense, ds, filter="linear"), sampled, place.clock, b.runs)
    one = ds[0]
    words = "the same, one deformation for all / torch grid_sample with the grids in hand"
    yield against(words, lambda: supple.warp_batch(given, one, filter="linear"), sampled, place.clock, b.runs)


def parts() -> dict[str, Callable[[Bench], Iterator[Line]]]:
    """What is measured, by name."""
    from cuda_beside import first_calls, handed_over, host_volume

    return {
        "volume": one_volume,
        "torch": volume_against_torch,
        "cupy": volume_against_cupy,
        "clip": clip_in_time,
        "batch": batch,
        "streams": handed_over,
        "host": host_volume,
        "first": first_calls,
    }


def main() -> int:
    """Print the table; 1 if a bar is missed, or there is no GPU."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer runs, and smaller")
    parser.add_argument("--dry", action="store_true", help="without a GPU, tiny: whether it runs at all")
    known = parts()
    parser.add_argument("--only", nargs="+", choices=known, default=list(known), help="which parts (all)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all numbers too, in seconds and ratios")
    asked = parser.parse_args()
    if asked.dry:
        play()
    import supple
    from supple.cuda.device import open_device

    warnings.simplefilter("ignore", supple.FoldWarning)
    try:
        open_device()
    except supple.SuppleError as error:
        print(f"benchmarks/cuda_engine.py: {error}", file=sys.stderr)
        return 1
    place = Place(asked.dry)
    sizes = {False: (25, 512, (118, 1080, 1920), (64, 512)), True: (15, 256, (30, 540, 960), (16, 256))}[asked.quick]
    bench = Bench(place, *((1, 6, (3, 8, 8), (2, 8)) if asked.dry else sizes))
    about, lines, broken = place.about(), [], False
    if asked.dry:
        print("A dry run: its times mean nothing.\n")
    print(", ".join(v if k == "gpu" else f"{k} {v}" for k, v in about.items()) + f"\n\n{HEAD}", flush=True)
    for name in asked.only:
        try:
            for line in known[name](bench):
                lines.append(line)
                print(line, flush=True)
        except Exception as error:  # the other parts are still worth their time
            traceback.print_exc()
            lines.append(Line(name, note=f"failed: {' '.join(str(error).split()) or type(error).__name__}"))
            print(lines[-1], flush=True)
            broken = True
        finally:
            place.freed()
    if asked.json:
        told = {"machine": about, "quick": asked.quick, "dry": asked.dry, "lines": [line.told() for line in lines]}
        asked.json.write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return int(broken or (not asked.dry and missed(lines)))


if __name__ == "__main__":
    sys.exit(main())
