"""Scenes of the gallery: images, clips and volumes, each made by one command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from supple.space.domain import Border
from supple.strokes import FoldPolicy, Recipe, Stroke

DISTANCE = 480
"""The distance from the camera to the centre of a volume, in millimetres."""
BACKGROUND = "1a1a1e"
HEAD = "head.nii.gz"
INSIDE = "inside.nii.gz"
"""The mask of the brain in the head."""
_DENT = ((40, 86, 65, 44, 63, 53, 36),)


@dataclass(frozen=True, slots=True)
class Shot:
    """A command: a photograph, a clip or a volume, strokes, and the name of the output.

    Parameters
    ----------
    name : str
        The name of the output, without suffix.
    caption : str
    source : str
        The photograph, the clip, or the volume.
    grabs : tuple of (x, y, x, y, radius), or (x, y, t, x, y, t, radius), or with z for t
    scales : int
    time_radius : float or None
    border : "auto", float, sequence of float or None
    on_fold : str
    outside : str
    cut : int
        The percentage of a photograph's width that the page shows unchanged, at first.
    """

    name: str
    caption: str
    source: str
    grabs: tuple[tuple[int, ...], ...]
    scales: int = 1
    time_radius: float | None = None
    border: Border = "auto"
    on_fold: FoldPolicy = "flow"
    outside: str = "edge"
    cut: int = 50

    @property
    def target(self) -> str:
        """The name of the output file."""
        return f"{self.name}.jpg"

    @property
    def verb(self) -> str:
        """The command of the output."""
        return "warp"

    @property
    def recipe(self) -> Recipe:
        """The strokes as a recipe of the library."""
        known: dict[str, Any] = {"scales": self.scales, "time_radius": self.time_radius}
        strokes = [Stroke.grab(a, to=b, radius=r, **known) for a, b, r in map(_split, self.grabs)]
        return Recipe(border=self.border, on_fold=self.on_fold, strokes=tuple(strokes))

    @property
    def command(self) -> str:
        """The strokes as arguments of the command line."""
        alike = len({grab[-1] for grab in self.grabs}) == 1
        lines = [f"supple {self.verb} {self.source} {self.target}"]
        for a, b, r in map(_split, self.grabs):
            places = ":".join(",".join(map(str, point)) for point in (a, b))
            lines.append(f"--grab {places}" + ("" if alike else f" --radius {r}"))
        rest = [f"--radius {self.grabs[0][-1]}"] if alike else []
        rest += self._options()
        long = self.verb == "render"
        lines += rest if long or not rest else [" ".join(rest)]
        return (" \\\n  " if long or len(self.grabs) > 1 else " ").join(lines)

    def _options(self) -> list[str]:
        found = []
        if self.scales != 1:
            found.append(f"--scales {self.scales}")
        if self.time_radius is not None:
            found.append(f"--time-radius {self.time_radius:g}")
        if self.border != "auto":
            found.append(f"--border {'none' if self.border is None else self.border}")
        if self.on_fold != "flow":
            found.append(f"--on-fold {self.on_fold}")
        if self.outside != "edge":
            found.append(f"--outside {self.outside}")
        return found


@dataclass(frozen=True, slots=True)
class Take(Shot):
    """A scene of a clip.

    Parameters
    ----------
    frames : tuple of int
        The frames shown side by side; the middle one stands for the clip until it plays.
    area : (x, y, width, height)
        The visible part of the frames.
    row : int, optional
        A row of pixels to plot over time.
    """

    frames: tuple[int, ...] = ()
    area: tuple[int, int, int, int] = (0, 0, 0, 0)
    row: int | None = None

    @property
    def target(self) -> str:
        """The name of the output file."""
        return f"{self.name}.mp4"


@dataclass(frozen=True, slots=True)
class Look(Shot):
    """An image of a volume, or a turntable.

    Parameters
    ----------
    azimuth, elevation : int
        The initial position of the camera, in degrees.
    size : int
        The size of the image, in pixels.
    smooth : int
        Rays along each side of a pixel.
    density : (int, int), optional
        The visible range of values.
    turntable : int
        The number of images of a turntable; a single image if 0.
    """

    azimuth: int = 38
    elevation: int = 12
    size: int = 560
    smooth: int = 2
    density: tuple[int, int] | None = None
    turntable: int = 0

    @property
    def target(self) -> str:
        """The name of the output file."""
        return f"{self.name}.mp4" if self.turntable else f"{self.name}.jpg"

    @property
    def verb(self) -> str:
        """The command of the output."""
        return "render"

    def _options(self) -> list[str]:
        found = Shot._options(self)
        found.append(f"--azimuth {self.azimuth} --elevation {self.elevation} --distance {DISTANCE}")
        found.append(f"--size {self.size}x{self.size} --background {BACKGROUND}")
        found += [f"--smooth {self.smooth}"] if self.smooth != 1 else []
        found += [f"--density {self.density[0]},{self.density[1]}"] if self.density is not None else []
        return [*found, f"--turntable {self.turntable}"] if self.turntable else found


def _split(grab: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Return the start and the end of a grab, and its radius."""
    half = len(grab) // 2
    return grab[:half], grab[half:-1], grab[-1]


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene of one or two shots."""

    title: str
    text: str
    shots: tuple[Shot, ...]


SCENES = (
    Scene(
        "A wider look, and a smile",
        "Six short strokes, one after the other, as in retouching: four open the eyes, two raise the corners of the "
        "mouth. However many there are, the photograph is sampled once, so that the fur stays as sharp as it was.",
        (
            Shot(
                "cat",
                "Six strokes in sequence.",
                "chelsea.jpg",
                (
                    (168, 86, 164, 68, 42),
                    (172, 146, 176, 158, 42),
                    (318, 112, 320, 96, 42),
                    (318, 162, 320, 173, 42),
                    (225, 262, 205, 246, 34),
                    (300, 262, 322, 244, 34),
                ),
                scales=3,
            ),
        ),
    ),
    Scene(
        "Stronger than the material",
        "A drag of 135 pixels with a brush of 28 would fold the picture over itself. By default it arrives in smaller "
        "steps, none of which folds. With --on-fold damp it goes as far as one step may, and a warning says how far.",
        (
            Shot("cup-flow", "All the way.", "coffee.jpg", ((215, 285, 90, 335, 28),), cut=10),
            Shot("cup-damp", "One step.", "coffee.jpg", ((215, 285, 90, 335, 28),), on_fold="damp", cut=10),
        ),
    ),
    Scene(
        "A shuttle of rubber",
        "Bi-scale brushes keep to themselves: the model bends, and its surroundings hardly notice.",
        (
            Shot(
                "shuttle",
                "Three strokes that flow.",
                "astronaut.jpg",
                ((417, 25, 345, 60, 60), (415, 130, 450, 120, 60), (385, 60, 352, 45, 40)),
                scales=2,
                border=10,
            ),
        ),
    ),
    Scene(
        "Edges that stay, edges that go",
        "The edges of a picture stay where they are, and the strokes fade towards them over a tenth of each side. With "
        "--border none they move as well, and --outside says what appears from beyond: here the mirror image.",
        (
            Shot("table-fixed", "The border is fixed.", "coffee.jpg", ((290, 200, 370, 200, 120),), cut=6),
            Shot(
                "table-free",
                "The border is free.",
                "coffee.jpg",
                ((290, 200, 370, 200, 120),),
                border=None,
                outside="reflect",
                cut=6,
            ),
        ),
    ),
    Scene(
        "A smile that comes and goes",
        "Strokes may have a time as well. Two raise the corners of the mouth around frame 46 of this clip, two more "
        "around frame 54, where the head has turned a little, and before and after that he sulks as ever. In time, "
        "their radius is six frames.",
        (
            Take(
                "smile",
                "Four strokes in space and time.",
                "bunny.mp4",
                (
                    (328, 157, 46, 319, 148, 46, 16),
                    (366, 145, 46, 371, 136, 46, 14),
                    (336, 155, 54, 327, 146, 54, 16),
                    (376, 143, 54, 382, 134, 54, 14),
                ),
                scales=2,
                time_radius=6,
                frames=(40, 43, 46, 49, 52, 55, 58),
                area=(260, 80, 160, 120),
            ),
        ),
    ),
    Scene(
        "A head that is late",
        "What is dragged along time happens later, there only: the arms come down while he still yawns, and his "
        "head follows half a second behind. Where two times meet, each pixel has its own.",
        (
            Take(
                "late",
                "One stroke along time, by 14 frames.",
                "bunny.mp4",
                ((350, 120, 38, 350, 120, 52, 60),),
                scales=2,
                frames=(36, 39, 42, 45, 48),
                area=(140, 0, 420, 360),
                row=120,
            ),
        ),
    ),
    Scene(
        "A head, outside and inside",
        "A volume bends like anything else, in millimetres: what is inside follows. The whole head is warped once, "
        "and seen by rays from any side. Of the brain, a density window shows what is brighter than the fluid around "
        "it.",
        (
            Look("head", "One stroke of 52 mm.", HEAD, _DENT, border=30),
            Look("brain", "The same, inside.", INSIDE, _DENT, border=30, cut=10, density=(45, 254)),
            Look("turn", "Once around", HEAD, _DENT, border=30, size=360, smooth=1, turntable=60),
        ),
    ),
)
