"""A cut becomes a transition: one place is advanced in time (paper, figure 6.4).

A clip of 50 × 50 pixels and 100 frames turns from black to red at once. The paper counts from 1: its frame 52 is
number 51 here, and its p0 = (50, 50, 50), a corner of the picture, is (49, 49, 49). f = (0, 0, −30), ε = 50.
"""

import sys
from pathlib import Path

import numpy as np

import supple
from supple.plot import draw_sheet

TURNS, SIZE = 51, 50


def first(redness: np.ndarray, part: float) -> int:
    return int(np.argmax(redness > part))


def main(folder: Path) -> None:
    clip = np.zeros((100, SIZE, SIZE, 3), np.uint8)
    clip[TURNS:, ..., 0] = 255
    d = supple.Deformation(clip.shape[:3], border=64, on_fold="damp")
    d = d.grab((49, 49, 49), by=(0, 0, -30), radius=50, reach=None)
    bent = d.warp(clip)

    red = bent[..., 0] / 255
    half = SIZE // 2
    for name, redness in (
        ("held corner", red[:, 49, 49]),
        ("centre", red[:, half, half]),
        ("far corner", red[:, 0, 0]),
        ("whole picture", red.mean(axis=(1, 2))),
    ):
        frames = ", ".join(str(first(redness, part)) for part in (0.05, 0.5, 0.95))
        print(f"{name}: more than 5, 50, 95 % red from frames {frames} on; it was {TURNS}")
    seen = d.forward((half, half, TURNS - 0.5))[2]
    print(f"exactly, the centre is half red at t = {seen:.2f}; damping {d.report().damping[0]:.3f}")

    shown = range(14, 55, 5)
    sheets = ([(k, frames[k]) for k in shown] for frames in (clip, bent))
    draw_sheet(*sheets, folder / "transition.png", force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
