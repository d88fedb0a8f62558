"""A head made asymmetric, and corrected again (paper, figures 5.2 and 6.9): outside, inside, and in numbers.

One stroke flattens the back of the head on the left, as in plagiocephaly. The correction does not use that stroke: at
five places there, the picked surface point is dragged to the mirror image of the right side. All are sampled once.

    python asymmetry.py [FOLDER [VOLUME]]     any CT, or the MR head that comes along
"""

import sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813
from head import BACKGROUND, HEAD, Layer, layers

from supple import Deformation, Stroke
from supple.media import image
from supple.render.camera import Camera
from supple.render.scene import Scene
from supple.space.geometry import Geometry

FLAT, PUSH, RADIUS = (145, 12), (-10, -28, 0), 50  # azimuth and elevation; millimetres along LPS
PLACES = ((160, 25), (128, 25), (135, -5), (158, 0), (120, 5))
REACH = 40  # of the correcting strokes, in millimetres
SIZE, CENTRE, ABOVE = (360, 360), (179.5, 179.5), Camera(azimuth=180, elevation=65, distance=480)


def inside(layer: Layer, samples: np.ndarray) -> np.ndarray:
    """Return the mask of the interior of the largest object, slice by slice: heads are open below."""
    slices = [sitk.GetImageFromArray(part) for part in (samples >= layer.density[0]).astype(np.uint8)]
    solid = sitk.JoinSeries([sitk.BinaryFillhole(part) for part in slices])
    solid = sitk.BinaryMorphologicalOpening(solid, [2, 2, 2])  # without parts that only touch it
    pieces = sitk.RelabelComponent(sitk.ConnectedComponent(solid), sortByObjectSize=True)
    return sitk.GetArrayFromImage(pieces) == 1


def mirrored(places: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Return the mirror images of points in LPS about a plane, all ``p`` with ``p @ (1, a, b) = c``."""
    normal = np.array([1, *plane[1:]])
    return places - 2 * np.multiply.outer((places @ normal - plane[0]) / (normal @ normal), normal)


def one_sided(mask: np.ndarray, geometry: Geometry, plane: np.ndarray, every: int = 1) -> float:
    """Return the fraction of a volume without a counterpart beyond the plane."""
    points = geometry.to_lps(np.argwhere(mask)[::every, ::-1])
    found = np.rint(geometry.from_lps(mirrored(points, plane))).astype(int)
    x, y, z = found[((found >= 0) & (found < mask.shape[::-1])).all(axis=1)].T
    return 1 - np.count_nonzero(mask[z, y, x]) / len(x)


def midplane(mask: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Return the plane about which a head is most symmetric, by smaller and smaller steps."""
    plane = np.array([geometry.to_lps(np.argwhere(mask)[:, ::-1].mean(axis=0))[0], 0, 0])
    step = np.array([8, 0.1, 0.1])
    while step[0] > 0.2:
        tries = [plane, *(plane + sign * step * axis for axis in np.eye(3) for sign in (-1, 1))]
        best = int(np.argmin([one_sided(mask, geometry, tried, every=53) for tried in tries]))
        plane, step = tries[best], step if best else step / 2
    return plane


def main(folder: Path, path: Path = HEAD) -> None:
    geometry, seen = layers(path)
    mask = inside(seen[0], seen[0].samples)
    solid = Layer("head", mask.astype(np.uint8), "grey", (0.5, 1))  # the surface for picking, in any volume
    plane = midplane(mask, geometry)
    centre = geometry.to_lps(np.argwhere(mask)[:, ::-1].mean(axis=0))
    middle = geometry.from_lps((centre + mirrored(centre, plane)) / 2)

    def scene(layer: Layer, d: Deformation) -> Scene:
        return Scene(layer.samples, geometry, deformation=d, transfer=layer.transfer, density=layer.density)

    def held(d: Deformation, azimuth: float, elevation: float) -> np.ndarray:
        camera = Camera(azimuth=azimuth, elevation=elevation, target=middle)
        return geometry.to_lps(scene(solid, d).pick(camera, SIZE, CENTRE).index)

    head = Deformation(mask.shape, spacing=geometry.spacing, border=30)
    start = held(head, *FLAT)
    flat = head.grab(geometry.from_lps(start), to=geometry.from_lps(start + PUSH), radius=RADIUS)
    mended = flat
    for azimuth, elevation in PLACES:
        start, end = held(mended, azimuth, elevation), mirrored(held(mended, -azimuth, elevation), plane)
        print(f"from {np.round(start)} to {np.round(end)}, {np.linalg.norm(end - start):.1f} mm")
        drag = Stroke.grab(geometry.from_lps(start), to=geometry.from_lps(end), radius=REACH)
        mended = mended.add(drag, warn=False)  # what was pushed in is carried back, on purpose

    states = {"original": head, "flattened": flat, "corrected": mended}
    rows = []
    for layer in (seen[0], seen[-1]):  # skin and bone
        views = [scene(layer, d).render(ABOVE, SIZE, supersampling=2) for d in states.values()]
        rows.append(np.hstack([view.pixels(BACKGROUND) for view in views]))
        for name, d in states.items():
            part = one_sided(inside(layer, d.warp(layer.samples, filter="linear")), geometry, plane)
            print(f"{layer.name}, {name}: {100 * part:.1f} % of the volume on one side only")
    image.write(folder / "asymmetry.png", np.vstack(rows), force=True)


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:] or ["."]))
