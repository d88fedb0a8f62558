"""Make the pictures of the README and the documentation, in docs/images."""

import io
import sys
from pathlib import Path

import pyvips

import supple
from supple.diagnostics import figure
from supple.media import image

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "examples"))
import heart  # noqa: E402


def rendered(deformation: supple.Deformation, what: str, photo: image.Array | None = None) -> pyvips.Image:
    """Draw a plot in memory."""
    with io.BytesIO() as png:
        figure(deformation, what, image=photo).savefig(png, format="png", dpi=80)
        return pyvips.Image.new_from_buffer(png.getvalue(), "").flatten(background=255)


def main() -> None:
    """Make all pictures."""
    folder = HERE / "images"
    folder.mkdir(exist_ok=True)
    photo = image.read(heart.PHOTO).pixels
    d = heart.heart(photo.shape[:2])
    pair = pyvips.Image.arrayjoin(
        [pyvips.Image.new_from_array(pixels) for pixels in (photo, d.warp(photo))], shim=8, background=[255] * 3
    )
    pair.jpegsave(folder / "heart.jpg", Q=84, keep="none")
    rendered(d, "stretch", photo).jpegsave(folder / "stretch.jpg", Q=82, keep="none")
    paper = supple.Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100)
    rendered(paper, "iterations").pngsave(folder / "iterations.png", palette=True, keep="none")


if __name__ == "__main__":
    main()
