"""A small gallery: what Supple is for, with pictures to look at."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from supple.console import as_options
from supple.diagnostics import plot
from supple.errors import FoldWarning, SuppleError
from supple.files import Warped, warp_file
from supple.media.files import replacing, shown
from supple.media.image import info, read
from supple.strokes import FoldPolicy, Recipe, Stroke

PAGE = "index.html"
_CREDITS = (
    "Photographs: Chelsea the cat by Stéfan van der Walt (CC0); a cup of espresso by Rachel Michetti, courtesy of "
    "Pikolo Espresso Bar (CC0); the astronaut Eileen Collins by NASA (public domain). All from scikit-image."
)
_PLOTS = {
    "stretch": "Where the picture grows and shrinks.",
    "grid": "Straight lines, bent.",
}


@dataclass(frozen=True, slots=True)
class Shot:
    """One command: a photograph, strokes, and the name of the picture that they make.

    Parameters
    ----------
    name : str
        Of the picture, without suffix.
    caption : str
    source : str
        The photograph.
    grabs : tuple of (x, y, x, y, radius)
    scales : int
    border : float or None
    on_fold : str
    outside : str
    cut : int
        How much of the width the page shows as it was, at first, in percent.
    """

    name: str
    caption: str
    source: str
    grabs: tuple[tuple[int, int, int, int, int], ...]
    scales: int = 1
    border: float | None = 50
    on_fold: FoldPolicy = "damp"
    outside: str = "edge"
    cut: int = 50

    @property
    def recipe(self) -> Recipe:
        """The strokes as the library takes them."""
        strokes = [Stroke.grab((a, b), to=(c, d), radius=r, scales=self.scales) for a, b, c, d, r in self.grabs]
        return Recipe(border=self.border, on_fold=self.on_fold, strokes=tuple(strokes))

    @property
    def command(self) -> str:
        """The strokes as the command line takes them."""
        alike = len({r for *_, r in self.grabs}) == 1
        lines = [f"supple warp {self.source} {self.name}.jpg"]
        lines += [f"--grab {a},{b}:{c},{d}" + ("" if alike else f" --radius {r}") for a, b, c, d, r in self.grabs]
        rest = [f"--radius {self.grabs[0][-1]}"] if alike else []
        if self.scales != 1:
            rest.append(f"--scales {self.scales}")
        if self.border != 50:
            rest.append(f"--border {'none' if self.border is None else format(self.border, 'g')}")
        if self.on_fold != "damp":
            rest.append(f"--on-fold {self.on_fold}")
        if self.outside != "edge":
            rest.append(f"--outside {self.outside}")
        lines += [" ".join(rest)] if rest else []
        return (" \\\n  " if len(self.grabs) > 1 else " ").join(lines)


@dataclass(frozen=True, slots=True)
class Scene:
    """What one or two shots show."""

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
            ),
        ),
    ),
    Scene(
        "Stronger than the material",
        "A drag of 135 pixels with a brush of 28 would fold the picture over itself. By default it is damped to what "
        "is safe, with a warning. With --on-fold flow it arrives, in smaller steps, and nothing folds either.",
        (
            Shot("cup-damp", "Damped to what is safe.", "coffee.jpg", ((215, 285, 90, 335, 28),), cut=10),
            Shot("cup-flow", "All the way.", "coffee.jpg", ((215, 285, 90, 335, 28),), on_fold="flow", cut=10),
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
                on_fold="flow",
            ),
        ),
    ),
    Scene(
        "Edges that stay, edges that go",
        "The edges of a picture stay where they are, and the strokes fade towards them over 50 pixels. With --border "
        "none they move as well, and --outside says what appears from beyond: here the mirror image.",
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
)


def write_gallery(
    folder: str | os.PathLike[str], *, force: bool = False, progress: Callable[[str], None] | None = None
) -> Path:
    """Write photographs, what strokes make of them, plots, and a page that shows them.

    Parameters
    ----------
    folder : str or os.PathLike
        Made if it is missing. A gallery that is there already is written anew; nothing else is touched.
    force : bool
        Whether to write into a folder that holds something else, and replace files that have the same names.
    progress : function, optional
        Called with the name of each picture before it is made.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    SuppleError
        If the folder holds something else, or cannot be written.
    """
    place = _prepared(Path(folder), force)
    for name in dict.fromkeys(shot.source for scene in SCENES for shot in scene.shots):
        with replacing(place / name, force=True) as temporary:
            temporary.write_bytes((files("supple") / "data" / name).read_bytes())
    sections = [_section(place, scene, progress or (lambda name: None)) for scene in SCENES]
    template = (files("supple") / "data" / "gallery.html").read_text(encoding="utf-8")
    page = Template(template).substitute(sections="\n".join(sections), credits=escape(_CREDITS))
    with replacing(place / PAGE, force=True) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return place / PAGE


def _prepared(folder: Path, force: bool) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        empty = next(folder.iterdir(), None) is None
    except FileExistsError as error:
        raise SuppleError(f"{shown(folder)} is no folder: choose another name") from error
    except OSError as error:
        raise SuppleError(
            f"cannot write to the folder {shown(folder)}: {error.strerror}: choose another place"
        ) from error
    except ValueError as error:
        raise SuppleError(f"no folder can be called {shown(folder)}: choose another name") from error
    if not (empty or force):
        raise SuppleError(
            f"{shown(folder)} is not empty: choose another folder, or pass --force (force=True) to write there"
        )
    return folder


def _section(place: Path, scene: Scene, tell: Callable[[str], None]) -> str:
    shots = "".join(_shot(place, shot, tell) for shot in scene.shots)
    return f"<section>\n<h2>{escape(scene.title)}</h2>\n<p>{escape(scene.text)}</p>\n{shots}</section>"


def _shot(place: Path, shot: Shot, tell: Callable[[str], None]) -> str:
    tell(f"{shot.name}.jpg")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FoldWarning)
        made = warp_file(place / shot.source, place / f"{shot.name}.jpg", shot.recipe, outside=shot.outside, force=True)
    said = [as_options(str(w.message)) for w in caught if issubclass(w.category, FoldWarning)]
    image = read(place / shot.source).pixels
    plots = []
    for what, text in _PLOTS.items():
        name = f"{shot.name}-{what}.png"
        plot(made.deformation, what, place / name, image=image, force=True)
        facts = info(place / name)
        width, height = facts["width"], facts["height"]
        plots.append(
            f'<figure style="--shape: {width} / {height}"><a href="{name}"><img src="{name}" width="{width}" '
            f'height="{height}" loading="lazy" alt="{text}"></a><figcaption>{text}</figcaption></figure>\n'
        )
    return (
        f'<div class="shot">\n{_compared(shot, made)}{_explained(shot, made, said)}</div>\n'
        f'<div class="plots">\n{"".join(plots)}</div>\n'
    )


def _compared(shot: Shot, made: Warped) -> str:
    height, width = made.deformation.shape
    size = f'width="{width}" height="{height}"'
    return (
        f'<figure><div class="pair"><img src="{shot.name}.jpg" {size} alt="{escape(shot.caption)}">'
        f'<img class="before" src="{shot.source}" {size} alt="The photograph.">'
        f'<div class="edge"></div><span>before</span><span>after</span>'
        f'<input type="range" min="0" max="100" value="{shot.cut}" step="0.1" aria-label="before and after"></div>'
        f"<figcaption>{escape(shot.caption)}</figcaption></figure>\n"
    )


def _explained(shot: Shot, made: Warped, said: list[str]) -> str:
    report = made.report()
    lines = "".join(f'\n<span class="said">supple: warning: {escape(text)}</span>' for text in said)
    steps = f" The strokes take {report.applied} steps." if report.applied > report.strokes else ""
    return (
        f'<div class="told">\n<pre>{escape(shot.command)}{lines}</pre>\n'
        f'<p class="facts"><b>Error at most {report.error:.4f} px</b>, certified at every pixel. '
        f"<b>{report.folds} folds</b>.{steps}</p>\n</div>\n"
    )
