"""What a GPU draws, which is named: `make bench-gpu`, or `python benchmarks/gpu.py [--quick]`.

Frames with a bar are drawn into a texture, as the window does: many are submitted, and then waited for.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measure import HEAD, Line, Spread, alone, seconds, shown, took, wall
from scipy import ndimage

import supple
from supple.files.volumes import open_volume
from supple.gpu.device import open_gpu
from supple.gpu.memory import wait
from supple.gpu.plate import Plate, Sight
from supple.gpu.screen import canvas_texture
from supple.gpu.solid import Filling, beside, hold, hold_strokes
from supple.media.volume import Volume
from supple.render.camera import Camera
from supple.render.scene import MODES, Scene

DATA = Path(supple.__file__).parent / "examples" / "data"


def ways(name: str, head: Volume, look: dict[str, Any], camera: Camera, size: tuple[int, int]) -> str:
    """The modes beside one another, as in the paper's table 6.1: frames, and what a buffer takes."""
    scenes, made, still = {}, {}, {}
    for mode in MODES:

        def make(mode: str = mode) -> None:
            scenes[mode] = Scene(head.samples, head.geometry, mode=mode, step=1.0, device="gpu", **look)

        make()  # compiles
        made[mode] = wall(make)
        still[mode] = alone(lambda mode=mode: scenes[mode].render(camera, size), wall, 3).median
    scene, frames, parts = scenes["hybrid"], [], [0.0]

    def filling() -> None:
        parts.append(scene.fill(seconds=max(0.004, 0.05 * still["hybrid"])))
        scene.render(camera, size)

    while parts[-1] < 1:
        frames.append(wall(filling))
    middle, longest = seconds(statistics.median(frames)), max(frames) / still["hybrid"]
    cells = [seconds(still["exact"]), *(seconds(x[mode]) for mode in ("buffered", "hybrid") for x in (still, made))]
    cells += [f"{middle} (longest {longest:.2f}× the one before)", f"{seconds(sum(frames))}, {len(frames)} frames"]
    cells.append(seconds(alone(lambda: scene.render(camera, size), wall, 3).median))
    return f"| {name} | " + " | ".join(cells) + " |"


def filled(n: int, runs: int) -> Line:
    """A whole buffer, from a volume that is on the GPU already."""
    gpu = open_gpu()
    d = supple.Deformation((n, n, n), border=None)
    space = d.grab((n / 2, n / 2, n / 2), by=(n / 16, 0, 0), radius=n / 5).space
    held = hold(gpu, np.random.default_rng(0).random((n, n, n), np.float32))
    assert beside(held)

    def work() -> None:
        Filling(held, hold_strokes(gpu, space.table, space.axes), 0.05).advance(1e9)

    return took(f"buffer of a {n}³ float32 volume", work, wall, runs)


def rate(what: str, draw: Callable[[int], object], count: int, runs: int, bar: float | None = None) -> Line:
    """The row of a frame rate: ``draw`` submits frame k; the GPU is waited for after ``count`` of them."""
    gpu = open_gpu()

    def frames() -> None:
        for n in range(count):
            draw(n)
        wait(gpu)

    frames()  # compiles, and is not counted
    found = Spread.of(*(count / wall(frames) for _ in range(runs)))
    return Line(what, value=found, unit="frames/s", bar=None if bar is None else -bar, note=f"of {count} frames")


def window(size: tuple[int, int], bar: float, count: int, runs: int) -> list[Line]:
    """A picture as large as the window, with a stroke: solved at each pixel, and while it is dragged."""
    gpu, (width, height) = open_gpu(), size
    plate, texture = Plate(gpu, size), canvas_texture(gpu, size)
    plate.put(0, np.random.default_rng(0).integers(0, 256, (height, width, 4), np.uint8))
    bent = supple.Deformation((height, width)).grab(
        (width / 2, height / 2), by=(width / 12, height / 12), radius=height / 4
    )
    table, axes = bent.space.table, bent.space.axes

    def frame(sight: Sight) -> Callable[[int], object]:
        return lambda n: plate.draw(sight, table, axes, texture)

    whole = Sight((0.0, 0.0), 1.0, size)
    dragged = Sight((0.0, 0.0), 1.0, size, solved=False)
    return [
        rate(f"a picture in the window, {width}×{height}", frame(whole), count, runs, bar),
        rate("the same, while it is dragged", frame(dragged), count, runs),
    ]


def played(size: tuple[int, int], slots: int, count: int, runs: int) -> Line:
    """A clip that is bent in time, from the memory of the GPU, frame by frame."""
    gpu, (width, height) = open_gpu(), size
    slots = min(slots, Plate.most(gpu, size))
    plate, texture = Plate(gpu, size, slots, slots), canvas_texture(gpu, size)
    rng = np.random.default_rng(0)
    for k in range(slots):
        plate.put(k, rng.integers(0, 256, (height, width, 4), np.uint8))
    bent = supple.Deformation((slots, height, width), time=True).grab(
        (width / 2, height / 2, slots / 2), by=(width / 12, 0, slots / 8), radius=height / 4
    )
    table, axes = bent.space.table, bent.space.axes

    def frame(n: int) -> None:
        plate.draw(Sight((0.0, 0.0), 1.0, size, n % slots), table, axes, texture)

    return rate(f"a clip bent in time, {slots} frames of {width}×{height} in memory", frame, count, runs, 500)


def large_head(side: int, size: tuple[int, int], count: int, runs: int) -> list[Line]:
    """The head with so many voxels along each side, and a stroke, which may change with each frame."""
    head = open_volume(DATA / "head.nii.gz").samples
    scale = side / np.array(head.shape)
    samples = ndimage.zoom(head.astype(np.float32), scale, order=1).astype(head.dtype)
    look: dict[str, Any] = {"transfer": "mr-head", "step": 1.0, "device": "gpu"}
    camera = Camera(azimuth=38, elevation=12, distance=2.2 * side)
    place, to = (np.array(at) * scale[::-1] for at in ((40, 86, 65), (44, 63, 53)))

    def bent(part: float) -> supple.Deformation:
        return supple.Deformation(samples.shape, border=side / 6).grab(
            place, by=part * (to - place), radius=36 * side / 128
        )

    drags = [bent(0.5 + 0.5 * k / count) for k in range(count)]
    lines = []
    for mode, bar in (("exact", 10.0), ("buffered", None), ("hybrid", 60.0)):
        scene = Scene(samples, deformation=drags[-1], mode=mode, **look)
        texture = canvas_texture(scene.gpu, size)

        def still(n: int, scene: Scene = scene, texture: Any = texture) -> None:
            scene.draw(texture, camera)

        def dragged(n: int, scene: Scene = scene, texture: Any = texture) -> None:
            scene.deformed(drags[n]).draw(texture, camera)

        what = f"the head, {side}³, {mode}, {size[0]}×{size[1]}"
        lines.append(rate(what, still, count, runs, bar if mode == "exact" else None))
        if mode != "buffered":
            words = f"{what}, a stroke that changes with each frame"
            lines.append(rate(words, dragged, count, runs, bar if mode == "hybrid" else None))
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="once each, and smaller")
    quick = parser.parse_args().quick
    runs, scale = (1, 4) if quick else (5, 1)
    warnings.simplefilter("ignore", supple.FoldWarning)
    gpu = open_gpu()
    print(f"{gpu.name}, {gpu.backend}\n")
    print(HEAD, flush=True)
    count = 3 if gpu.software else 200
    for size, bar in (((1920, 1080), 1000.0), ((3840, 2160), 300.0)):
        shown(window((size[0] // scale, size[1] // scale), bar, count, runs))
    shown([played((1920 // scale, 1080 // scale), 40, count, runs)])
    side = 128 if gpu.software or quick else 512
    shown(large_head(side, (500 // scale, 500 // scale), max(2, count // 20), min(runs, 3)))
    head = open_volume(DATA / "head.nii.gz")
    size = (1000 // scale, 1000 // scale)
    camera = Camera(azimuth=38, elevation=12, distance=480)
    bent = supple.Deformation(head.samples.shape, spacing=head.geometry.spacing, border=30)
    bent = bent.grab((40, 86, 65), to=(44, 63, 53), radius=36)
    look: dict[str, Any] = {"deformation": bent, "transfer": "mr-head"}
    for mode in ("exact", "buffered"):
        for device in ("gpu", "cpu"):
            scene = Scene(head.samples, head.geometry, mode=mode, step=1.0, device=device, **look)
            what = f"view of the head, {size[1]}×{size[0]}, {mode}, by the {device.upper()}"
            shown([took(what, lambda scene=scene: scene.render(camera, size), wall, runs)])
    shown([filled(512 // scale, 1 if gpu.software else runs)])
    print(f"\nThe modes, {size[1] // 2}×{size[0] // 2}:\n")
    print("| seen | exact | buffered | made in | hybrid | made in | while it fills | filled after | and then |")
    print("|---|" + "---|" * 8)
    half = (size[0] // 2, size[1] // 2)
    print(ways("the head", head, look, camera, half))
    print(ways("what is bright in it", head, look | {"density": (110.0, 254.0)}, camera, half))


if __name__ == "__main__":
    main()
