"""Big Buck Bunny sulks, and smiles instead: on one frame, and over a clip (paper, figure 1.1).

On a frame, two strokes raise the corners of the mouth. In a clip, the same strokes have a time as well: they come and
go around it, and a second pair takes over where the head has moved on. Run it with a folder for what it writes.
"""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.clips import ClipOptions, open_clip
from supple.diagnostics import draw_sheet
from supple.files import warp_file
from supple.media import image

CLIP = Path(supple.__file__).parent / "data" / "bunny.mp4"  # 64 frames of the film
FRAME, FACE = 46, np.s_[80:200, 260:420]
SMILE = [((328, 157), (-10, -10), 16), ((366, 145), (6, -10), 14)]  # a corner, where it goes, radius
SMILES = [((328, 157, 46), (-9, -9, 0), 16), ((366, 145, 46), (5, -9, 0), 14)]
SMILES += [((336, 155, 54), (-9, -9, 0), 16), ((376, 143, 54), (6, -9, 0), 14)]


def recipe(grabs: list) -> supple.Recipe:
    return supple.Recipe(strokes=[supple.Stroke.grab(at, by=by, radius=r, scales=2) for at, by, r in grabs])


def frames(path: Path) -> np.ndarray:
    with open_clip(path) as clip:
        arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
        return np.array([clip.to_rgb(arrays) for frame in clip.frames() if frame.copy_to(arrays) is None])


def main(folder: Path) -> None:
    sulks = frames(CLIP)
    d = supple.Deformation.from_recipe(recipe(SMILE), sulks.shape[1:3])
    smiles = d.warp(sulks[FRAME])
    pair = np.hstack([sulks[FRAME][FACE], smiles[FACE]])
    image.write(folder / "smile.png", pair.repeat(4, axis=0).repeat(4, axis=1), force=True)
    print(f"one frame: every source point within {d.report().error:.4f} px")

    options = ClipOptions(time_scale=2.5)  # a frame counts as 2.5 pixels: 16 pixels are felt for about 6 frames
    made = warp_file(CLIP, folder / "smile.mp4", recipe(SMILES), clip=options, force=True)
    print(f"the clip: {made.frames} frames, {made.still} left as they were, {made.held} held at once")
    after = frames(folder / "smile.mp4")
    shown = range(40, 61, 3)
    draw_sheet(*([(k, clip[k][FACE]) for k in shown] for clip in (sulks, after)), folder / "smiles.png", force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
