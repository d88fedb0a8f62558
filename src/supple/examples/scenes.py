"""Scenes of the gallery: images, clips and volumes, each made by one command."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, ClassVar

from supple.space.domain import Border
from supple.strokes import FoldPolicy, Recipe, Stroke

DISTANCE = 480
"""The distance from the camera to the centre of a volume, in millimetres."""
BACKGROUND = "1a1a1e"
HEAD = "head.nii.gz"
INSIDE = "inside.nii.gz"
"""The mask of the brain in the head."""


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
        The percentage of a photograph's width that the page first shows unchanged.
    """

    verb: ClassVar[str] = "warp"
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

    verb: ClassVar[str] = "render"
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


def _read() -> tuple[Scene, ...]:
    """Return the scenes of ``data/scenes.toml``; "none" is None there."""
    kinds = {"photograph": Shot, "clip": Take, "volume": Look}
    text = (files("supple.examples") / "data" / "scenes.toml").read_text("utf-8")

    def made(value: Any) -> Any:
        return tuple(map(made, value)) if isinstance(value, list) else None if value == "none" else value

    return tuple(
        Scene(
            scene["title"],
            scene["text"],
            tuple(kinds[shot.pop("kind")](**{k: made(v) for k, v in shot.items()}) for shot in scene["shots"]),
        )
        for scene in tomllib.loads(text)["scene"]
    )


SCENES = _read()
