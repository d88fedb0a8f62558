"""Make the pictures of the README and the documentation, in docs/images."""

import io
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyvips

import supple
from supple.diagnostics import figure
from supple.media import image

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "examples"))
import asymmetry  # noqa: E402
import head  # noqa: E402
import heart  # noqa: E402
import modes  # noqa: E402
import smile  # noqa: E402

WHITE = [255] * 3


def rendered(deformation: supple.Deformation, what: str, photo: image.Array | None = None) -> pyvips.Image:
    """Draw a plot in memory."""
    with io.BytesIO() as png:
        figure(deformation, what, image=photo).savefig(png, format="png", dpi=80)
        return pyvips.Image.new_from_buffer(png.getvalue(), "").flatten(background=255)


def bunny_smiles(folder: Path) -> None:
    """One frame of the clip, before and after, from near by."""
    ((_, sulks),) = smile.frames_of(smile.CLIP, (smile.FRAME,))
    smiles = supple.Deformation.from_recipe(smile.recipe(smile.SMILE), sulks.shape[:2]).warp(sulks)
    faces = [np.ascontiguousarray(pixels[smile.FACE]) for pixels in (sulks, smiles)]
    pair = [pyvips.Image.new_from_array(face).resize(2.5, kernel="cubic") for face in faces]
    pyvips.Image.arrayjoin(pair, shim=8, background=WHITE).jpegsave(folder / "smile.jpg", Q=80, keep="none")


def time_filtered(folder: Path) -> None:
    """An arm that comes down within a few frames, delayed so that time is compressed there, without and with a filter.

    Above a column of pixels over time, below a frame.
    """
    before = np.array([pixels for _, pixels in smile.frames_of(smile.CLIP, range(64))])
    d = supple.Deformation(before.shape[:3], spacing=(1, 1, 8), border=None)
    d = d.grab((110, 190, 26), by=(0, 0, 24), radius=96)
    after, filtered = d.warp(before), d.warp(before, time_filter=True)
    cuts = [np.swapaxes(clip[24:64, 110:300, 110], 0, 1) for clip in (before, after, filtered)]
    frames = [clip[k, 110:300, 10:210] for clip, k in ((before, 37), (after, 51), (filtered, 51))]
    rows = [
        *(
            pyvips.Image.new_from_array(np.ascontiguousarray(cut)).resize(7.5, vscale=1, kernel="nearest")
            for cut in cuts
        ),
        *(pyvips.Image.new_from_array(np.ascontiguousarray(frame)).resize(1.5, kernel="cubic") for frame in frames),
    ]
    halves = [pyvips.Image.arrayjoin(rows[k : k + 3], shim=8, background=WHITE) for k in (0, 3)]
    joined = halves[0].join(halves[1], "vertical", shim=8, background=WHITE)
    joined.jpegsave(folder / "time.jpg", Q=80, keep="none")


def volumes_bent(folder: Path) -> None:
    """What the examples of volumes show."""
    with tempfile.TemporaryDirectory() as name:
        made = Path(name)
        for example in (head, asymmetry, modes):
            example.main(made)
        for what, scale in (("head", 0.75), ("asymmetry", 0.75), ("inversions", 0.5)):
            picture = pyvips.Image.new_from_file(str(made / f"{what}.png"))
            picture = picture.flatten(background=255) if picture.hasalpha() else picture
            picture.resize(scale).jpegsave(folder / f"{what}.jpg", Q=80, keep="none")


def main() -> None:
    """Make all pictures."""
    folder = HERE / "images"
    folder.mkdir(exist_ok=True)
    photo = image.read(heart.PHOTO).pixels
    d = heart.heart(photo.shape[:2])
    pair = pyvips.Image.arrayjoin(
        [pyvips.Image.new_from_array(pixels) for pixels in (photo, d.warp(photo))], shim=8, background=WHITE
    )
    pair.jpegsave(folder / "heart.jpg", Q=84, keep="none")
    rendered(d, "stretch", photo).jpegsave(folder / "stretch.jpg", Q=82, keep="none")
    paper = supple.Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100)
    bunny_smiles(folder)
    time_filtered(folder)
    volumes_bent(folder)
    rendered(paper, "iterations").pngsave(folder / "iterations.png", palette=True, keep="none")


if __name__ == "__main__":
    main()
