"""Random deformations by `supple.augment`, beside the elastic transforms of the libraries that it has transforms for.

    python benchmarks/augment.py                            prints the tables of docs/augmentation.md, in some minutes
    SUPPLE_THREADS=8 python benchmarks/augment.py --wall    on eight threads each, by the clock on the wall

The libraries are those of the `augment` extra; what is not installed is left out, with a line. Each is called as its
users call it, with its own defaults but for how far and how smoothly it moves, on the same picture or volume, with
labels, in turn with ours. The time is that of the process on its CPUs, so that what else runs on the machine counts
little.

The error of key points: pictures of the coordinates x and y are bent with them, so that the picture shows, where a key
point is said to be, where it was.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# One thread each, as in a worker, unless another number is set; before libraries that read it are imported.
os.environ.setdefault("SUPPLE_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", os.environ["SUPPLE_THREADS"])
os.environ.setdefault("ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS", os.environ["SUPPLE_THREADS"])

import numpy as np
from measure import HEAD, Line, Work, against, alone, cpu, missed, seconds, wall
from scipy import ndimage

import supple
from supple.augment import RandomElastic
from supple.media import image, volume

DATA = Path(supple.__file__).parent / "examples" / "data"
RADIUS, FARTHEST = (40.0, 80.0), 15.0  # of pictures of 512 pixels
VOXELS, MILLIMETRES = (15.0, 30.0), 7.5  # of volumes of 128
AND_BACK = "; ours with its inverse"
THREADS = int(os.environ["SUPPLE_THREADS"])
Points = np.ndarray
PairOf = tuple[str, Callable[[], tuple[Work, Work]], Callable[[], tuple[float, float]] | None]


def picture() -> np.ndarray:
    photo = image.read(DATA / "astronaut.jpg").pixels
    assert photo.shape == (512, 512, 3)
    return photo


def head() -> np.ndarray:
    samples = volume.read(DATA / "head.nii.gz").samples
    made = ndimage.zoom(samples.astype(np.float32), [128 / n for n in samples.shape], order=1)
    assert made.shape == (128, 128, 128)
    return made


def points(shape: tuple[int, ...]) -> Points:
    size = np.array(shape[::-1])
    return np.random.default_rng(0).uniform(0.15 * size, 0.85 * size, (100, len(size)))


def ramps() -> np.ndarray:
    y, x = np.mgrid[:512, :512].astype(np.float32)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def error(shown: np.ndarray, said: Points, asked: Points) -> float:
    """Return the largest distance of what is shown at key points from what it should be, in pixels."""
    seen = [ndimage.map_coordinates(shown[..., k].astype(float), said[:, ::-1].T, order=3) for k in (0, 1)]
    inside = np.all((said > 2) & (said < 509), axis=1)  # those that have left the picture are seen nowhere
    return float(np.linalg.norm(np.stack(seen, -1) - asked, axis=1)[inside].max())


def albumentations() -> Iterator[PairOf]:
    import albumentations as A  # noqa: N812
    import cv2

    from supple.augment import albumentations as ours

    cv2.setNumThreads(THREADS)
    photo = picture()
    labels = (photo[..., 0] > 128).astype(np.uint8)
    mine = A.Compose([ours.RandomElastic(FARTHEST, RADIUS, p=1)], keypoint_params=A.KeypointParams("xy"), seed=1)
    # Displacements have a deviation of alpha / (2 √π sigma) pixels; the approximate ones, of a box, of alpha / 17.
    for note, more in (("", {"alpha": 1500}), (", approximate", {"alpha": 130, "approximate": True})):
        theirs = A.Compose([A.ElasticTransform(sigma=50, p=1, **more)], keypoint_params=A.KeypointParams("xy"), seed=1)

        def works(theirs: Any = theirs) -> tuple[Work, Work]:
            both = [lambda t=t: t(image=photo, mask=labels, keypoints=[]) for t in (mine, theirs)]
            return both[0], both[1]

        def errors(theirs: Any = theirs) -> tuple[float, float]:
            asked, found = points((512, 512)), []
            for t in (mine, theirs):
                made = t(image=ramps(), keypoints=np.column_stack([asked, np.arange(100)]))
                kept = np.array(made["keypoints"])
                found.append(error(made["image"], kept[:, :2], asked[kept[:, 2].astype(int)]))
            return found[0], found[1]

        yield f"Albumentations ElasticTransform{note}", works, errors


def torchvision() -> Iterator[PairOf]:
    import torch
    from torchvision import tv_tensors
    from torchvision.transforms import v2

    from supple.augment import torchvision as ours

    photo = picture()
    sample = {
        "image": tv_tensors.Image(torch.from_numpy(photo).permute(2, 0, 1).contiguous()),
        "mask": tv_tensors.Mask(torch.from_numpy(photo[..., 0] > 128)),
    }
    mine = ours.RandomElastic(FARTHEST, RADIUS)

    def errors(theirs: Any) -> tuple[float, float]:
        asked, found = points((512, 512)), []
        shown = tv_tensors.Image(torch.from_numpy(ramps()).permute(2, 0, 1))
        for t in (mine, theirs):
            made, said = t(shown, tv_tensors.KeyPoints(torch.from_numpy(asked), canvas_size=(512, 512)))
            found.append(error(made.permute(1, 2, 0).numpy(), said.numpy(), asked))
        return found[0], found[1]

    # Displacements have a deviation of alpha / (4 √(3 π) sigma) pixels. By default, they are wrinkles.
    for note, more in ((", its defaults", {}), ("", {"alpha": 2000.0, "sigma": 20.0})):
        theirs = v2.ElasticTransform(**more)
        works = (lambda: mine(sample), lambda theirs=theirs: theirs(sample))
        yield f"torchvision v2 ElasticTransform{note}", lambda works=works: works, lambda t=theirs: errors(t)


def monai() -> Iterator[PairOf]:
    import torch
    from monai.transforms import Rand2DElasticd, Rand3DElasticd

    from supple.augment import monai as ours

    photo, scan = picture().astype(np.float32), head()
    keys, modes = ["image", "label"], ["bilinear", "nearest"]
    flat = {"image": torch.from_numpy(photo).permute(2, 0, 1).contiguous()}
    flat["label"] = (flat["image"][:1] > 128).float()
    deep = {"image": torch.from_numpy(scan)[None]}
    deep["label"] = (deep["image"] > 50).float()
    for name, theirs, size, sample in (
        ("Rand2DElastic", Rand2DElasticd(keys, (50, 50), (5, 15), prob=1, mode=modes), (FARTHEST, RADIUS), flat),
        ("Rand3DElastic", Rand3DElasticd(keys, (8, 10), (100, 200), prob=1, mode=modes), (MILLIMETRES, VOXELS), deep),
    ):
        mine = ours.RandElasticd(keys, *size, prob=1, mode=modes)

        def works(mine: Any = mine, theirs: Any = theirs, sample: Any = sample) -> tuple[Work, Work]:
            return lambda: mine(dict(sample)), lambda: theirs(dict(sample))

        yield f"MONAI {name}", works, None
    there = ours.RandElasticd(keys, MILLIMETRES, VOXELS, prob=1, mode=modes)  # the last theirs is that of volumes
    both = (lambda: there.inverse(there(dict(deep))), lambda: theirs(dict(deep)))
    yield f"MONAI {name}{AND_BACK}", lambda: both, None


def torchio() -> Iterator[PairOf]:
    import torch
    import torchio as tio

    from supple.augment import torchio as ours

    data = torch.from_numpy(head())[None]
    subject = tio.Subject(image=tio.ScalarImage(tensor=data), labels=tio.LabelMap(tensor=(data > 50).to(torch.uint8)))
    mine, theirs = ours.RandomElastic(MILLIMETRES, VOXELS), tio.RandomElasticDeformation(max_displacement=MILLIMETRES)
    name, bend = "TorchIO RandomElasticDeformation", lambda: theirs(subject)
    yield name, lambda: (lambda: mine(subject), bend), None
    yield f"{name}{AND_BACK}", lambda: (lambda: mine(subject).apply_inverse_transform(), bend), None


def main() -> int:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--runs", type=int, default=15)
    given.add_argument("--wall", action="store_true", help="by the clock on the wall")
    options = given.parse_args()
    warnings.simplefilter("ignore")
    runs, clock = options.runs, wall if options.wall else cpu
    if find_spec("torch"):
        import torch

        torch.set_num_threads(THREADS)
    lines, exact = [], []
    for name, rows in (
        ("albumentations", albumentations), ("torchvision", torchvision), ("monai", monai), ("torchio", torchio)
    ):  # fmt: skip
        if find_spec(name) is None:
            lines.append(Line(name, bar=1.0, note=f"not installed: pip install {name}"))
            continue
        for what, works, errors in rows():
            ours, theirs = works()
            bar = 0.2 if what.endswith(AND_BACK) else 1.0
            lines.append(against(f"{what} ({version(name)})", ours, theirs, clock, runs, bar))
            print(lines[-1], flush=True)
            if errors is not None:
                mine, other = (max(found) for found in zip(*(errors() for _ in range(min(runs, 5))), strict=True))
                exact.append(f"| {what} | {mine:.4f} px | {other:.3g} px |")
    drawing = RandomElastic(FARTHEST, RADIUS)
    own = alone(lambda: drawing.draw((512, 512)), clock, 5 * runs)
    print("\n".join(["", HEAD, *map(str, lines), "", "| key points | ours | theirs |", "|---|---|---|", *exact]))
    spent = "wall" if options.wall else "CPU"
    print(f"\nOf ours, the draw takes {seconds(own.median)}. {THREADS} thread(s), {spent} time, {runs} runs.")
    return int(missed(lines))


if __name__ == "__main__":
    sys.exit(main())
