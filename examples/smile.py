"""Big Buck Bunny sulks, and smiles instead: on one frame, and over a clip (paper, figure 1.1).

On a frame, two strokes raise the corners of the mouth. In a clip, strokes may have a time as well: they come and go
around it, and a second pair takes over where the head has moved on.
"""

import sys
from collections.abc import Container
from pathlib import Path

import numpy as np

import supple
from supple.files import warp_file
from supple.files.clips import open_clip
from supple.media import image
from supple.plot import draw_sheet

CLIP = Path(supple.__file__).parent / "examples" / "data" / "bunny.mp4"
FRAME, FACE = 46, np.s_[80:200, 260:420]
SMILE = [((328, 157), (-10, -10), 16), ((366, 145), (6, -10), 14)]  # a corner of the mouth, its drag, radius
SMILES = [((328, 157, 46), (-9, -9, 0), 16), ((366, 145, 46), (5, -9, 0), 14)]
SMILES += [((336, 155, 54), (-9, -9, 0), 16), ((376, 143, 54), (6, -9, 0), 14)]


def recipe(grabs: list[tuple]) -> supple.Recipe:
    frames = {"time_radius": 6} if len(grabs[0][0]) == 3 else {}
    return supple.Recipe(strokes=[supple.Stroke.grab(at, by=by, radius=r, scales=2, **frames) for at, by, r in grabs])


def frames_of(path: Path, wanted: Container[int]) -> list[tuple[int, np.ndarray]]:
    with open_clip(path) as clip:
        arrays = [np.empty((*group.shape, group.channels), clip.layout.dtype) for group in clip.layout.groups]
        found = []
        for k, frame in enumerate(clip.frames()):
            if k in wanted:
                frame.copy_to(arrays)
                found.append((k, clip.to_rgb(arrays)))
    return found


def main(folder: Path) -> None:
    ((_, sulks),) = frames_of(CLIP, (FRAME,))
    d = supple.Deformation.from_recipe(recipe(SMILE), sulks.shape[:2])
    pair = np.hstack([sulks[FACE], d.warp(sulks)[FACE]])
    image.write(folder / "smile.png", pair.repeat(4, axis=0).repeat(4, axis=1), force=True)
    print(f"one frame: every source point within {d.report().error:.4f} px")

    made = warp_file(CLIP, folder / "smile.mp4", recipe(SMILES), force=True)
    print(f"{made.frames} frames, {made.held} held at once; the map within {made.error:.4f} px and frames")
    sheets = (frames_of(path, range(40, 61, 3)) for path in (CLIP, made.target))
    draw_sheet(*([(k, pixels[FACE]) for k, pixels in some] for some in sheets), folder / "smiles.png", force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
