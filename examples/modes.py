"""Two modes of rendering a deformed volume, and their cost (paper, tables 5.1 and 6.1, and figure 5.5).

python modes.py [FOLDER [VOLUME]]     any CT, or the MR head that comes along
"""

import sys
import time
from pathlib import Path

import numpy as np
from head import BACKGROUND, DRAGS, HEAD, bent, layers

import supple
from supple.media import image
from supple.plot.draw import draw_inversions
from supple.render.camera import Camera
from supple.render.scene import Scene

CAMERA, SIZE, TOLERANCE = Camera(azimuth=38, elevation=12, distance=480), (500, 500), 0.05


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / max(np.mean((a.astype(float) - b) ** 2), 1e-6)))


def of_planes(d: supple.Deformation) -> int:
    """Return the evaluations of T and its Jacobian for all planes of an image, some frames or a volume."""
    return round(d.report(tolerance=TOLERANCE).evaluations * np.prod(d.shape))


def main(folder: Path, path: Path = HEAD) -> None:
    geometry, (skin, *_) = layers(path)
    d = bent(skin.samples.shape, geometry, DRAGS["moderate"])
    spent = {"buffered": of_planes(d)}
    pictures: dict[str, np.ndarray] = {}
    print(f"{'mode':9} {'prepared, s':>12} {'view, s':>8} {'evaluations of T':>17} {'PSNR to exact, dB':>18}")
    for mode in ("exact", "buffered"):
        begun = time.perf_counter()
        scene = Scene(skin.samples, geometry, deformation=d, transfer=skin.transfer, density=skin.density, mode=mode)
        ready = time.perf_counter()
        picture = scene.render(CAMERA, SIZE)
        done = time.perf_counter()
        if mode == "exact":
            spent[mode] = int(picture.evaluations.sum())
            most = int(picture.evaluations.max())
            draw_inversions(picture.evaluations, folder / "inversions.png", force=True)
        pictures[mode] = picture.pixels(BACKGROUND)
        near = f"{psnr(pictures[mode], pictures['exact']):.1f}" if mode != "exact" else "–"
        print(f"{mode:9} {ready - begun:12.2f} {done - ready:8.2f} {spent[mode]:17,} {near:>18}")
    image.write(folder / "modes.png", np.hstack(list(pictures.values())), force=True)

    photo = supple.Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100)
    clip = supple.Deformation((3, 1080, 1920), border=None).grab((960, 540, 1), by=(200, 0, 0), radius=300)
    width, height = SIZE[::-1]
    print(f"\n{'evaluations of T for':26} {'in the paper':>32} {'here':>12}")
    for name, paper, count in (
        ("a picture of 512 × 512", (512, 512, 15), of_planes(photo)),
        ("a frame of 1920 × 1080", (1920, 1080, 15), of_planes(clip) // 3),
        ("a view, 1000 × 1000", (1000, 1000, 150, 15), None),
        (f"a view, {width} × {height}: exact", None, spent["exact"]),
        ("any view: buffered", None, spent["buffered"]),
    ):
        theirs = f"{'*'.join(map(str, paper))} = {np.prod(paper):,}" if paper else ""
        print(f"{name:26} {theirs:>32} {'' if count is None else format(count, ','):>12}")
    print(f"at most {most} for one ray")


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:] or ["."]))
