"""Volumes drawn by a GPU, which is named: `make bench-gpu`, or `python benchmarks/gpu.py [--quick]`."""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measure import milliseconds

import supple
from supple.files.volumes import open_volume
from supple.gpu.device import open_gpu
from supple.gpu.solid import Filling, beside, hold
from supple.media.volume import Volume
from supple.render.camera import Camera
from supple.render.device import lattice_of
from supple.render.scene import MODES, Scene

DATA = Path(supple.__file__).parent / "examples" / "data"


def timed(work: Callable[[], object], runs: int) -> float:
    """The median time of some work, in seconds; the first time compiles, and is not counted."""
    times = []
    for _ in range(runs + 1):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])


def row(what: str, work: Callable[[], object], cpu: Callable[[], object] | None, runs: int) -> str:
    other = milliseconds(timed(cpu, runs)) if cpu is not None else ""
    return f"| {what} | {milliseconds(timed(work, runs))} | {other} | {runs} |"


def frame(scene: Scene, camera: Camera, size: tuple[int, int], runs: int) -> float:
    """The median time of a picture, in seconds; one before it is not counted."""
    return timed(lambda: scene.render(camera, size), runs)


def ways(name: str, head: Volume, look: dict[str, Any], camera: Camera, size: tuple[int, int]) -> str:
    """The modes beside one another, as in the paper's table 6.1: frames, and what a buffer takes."""
    scenes, made = {}, {}
    for mode in MODES:
        for _ in range(2):  # the first time compiles
            start = time.perf_counter()
            scenes[mode] = Scene(head.samples, head.geometry, mode=mode, step=1.0, device="gpu", **look)
            made[mode] = time.perf_counter() - start
    still = {mode: frame(scenes[mode], camera, size, 3) for mode in MODES}
    scene, frames, done = scenes["hybrid"], [], 0.0
    while done < 1:
        start = time.perf_counter()
        done = scene.fill(seconds=max(0.004, 0.05 * still["hybrid"]))
        scene.render(camera, size)
        frames.append(time.perf_counter() - start)
    longest = max(frames) / still["hybrid"]
    cells = [
        milliseconds(still["exact"]),
        milliseconds(still["buffered"]),
        milliseconds(made["buffered"]),
        milliseconds(still["hybrid"]),
        milliseconds(made["hybrid"]),
        f"{milliseconds(statistics.median(frames))} (longest {longest:.2f}× the one before)",
        f"{milliseconds(sum(frames))}, {len(frames)} frames",
        milliseconds(frame(scene, camera, size, 3)),
    ]
    return f"| {name} | " + " | ".join(cells) + " |"


def filled(n: int, runs: int) -> str:
    """A whole buffer, from a volume that is on the GPU already: the lattice, and all bricks."""
    gpu = open_gpu()
    samples = np.random.default_rng(0).random((n, n, n), np.float32)
    space = (
        supple.Deformation(samples.shape, border=None)
        .grab((n / 2, n / 2, n / 2), by=(n / 16, 0, 0), radius=n / 5)
        .space
    )
    held = hold(gpu, samples)
    assert beside(held)

    def work() -> None:
        lattice = lattice_of(gpu, space, 0.05)
        Filling(held, lattice, polished=lattice.error > 0.05, tolerance=0.05).advance(1e9)

    return row(f"buffer of a {n}³ float32 volume: lattice and bricks", work, None, runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="once each, and smaller")
    quick = parser.parse_args().quick
    runs, scale = (1, 4) if quick else (5, 1)
    warnings.simplefilter("ignore", supple.FoldWarning)
    gpu = open_gpu()
    print(f"{gpu.name}, {gpu.backend}\n")
    print("| what | whole call | by the CPU | runs |\n|---|---|---|---|")
    head = open_volume(DATA / "head.nii.gz")
    size = (1000 // scale, 1000 // scale)
    camera = Camera(azimuth=38, elevation=12, distance=480)
    bent = supple.Deformation(head.samples.shape, spacing=head.geometry.spacing, border=30)
    bent = bent.grab((40, 86, 65), to=(44, 63, 53), radius=36)
    for mode in ("exact", "buffered"):
        scenes = [
            Scene(head.samples, head.geometry, deformation=bent, transfer="mr-head", mode=mode, step=1.0, device=device)
            for device in ("gpu", "cpu")
        ]
        print(
            row(
                f"view of the head, {size[1]}×{size[0]}, {mode}",
                lambda scenes=scenes: scenes[0].render(camera, size),  # type: ignore[misc]
                lambda scenes=scenes: scenes[1].render(camera, size),  # type: ignore[misc]
                runs,
            )
        )
    print(filled(n=512 // scale, runs=1 if gpu.software else runs))
    print(f"\nThe modes, {size[1] // 2}×{size[0] // 2}:\n")
    print("| seen | exact | buffered | made in | hybrid | made in | while it fills | filled after | and then |")
    print("|---|" + "---|" * 8)
    half = (size[0] // 2, size[1] // 2)
    brain = {"deformation": bent, "transfer": "mr-head", "density": (110.0, 254.0)}
    print(ways("the head", head, {"deformation": bent, "transfer": "mr-head"}, camera, half))
    print(ways("what is bright in it", head, brain, camera, half))


if __name__ == "__main__":
    main()
