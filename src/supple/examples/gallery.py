"""A small gallery of Supple's applications."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from html import escape
from importlib.resources import as_file, files
from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt

from supple.errors import MissWarning, SuppleError, argument, shown
from supple.examples.scenes import BACKGROUND, DISTANCE, HEAD, INSIDE, SCENES, Look, Shot, Take
from supple.files import warp_file
from supple.files.clips import open_clip
from supple.files.jobs import Job
from supple.files.renders import RenderOptions, render_file
from supple.gpu.device import gpu_of
from supple.media.files import replacing
from supple.media.image import info, read, write
from supple.media.volume import read as read_volume
from supple.media.volume import write as write_volume
from supple.plot import draw_sheet, draw_slice, plot
from supple.render.camera import Camera
from supple.render.scene import Scene as Solid

PAGE = "index.html"
_CREDITS = (
    "Photographs: Chelsea the cat by Stéfan van der Walt (CC0); a cup of espresso by Rachel Michetti, courtesy of "
    "Pikolo Espresso Bar (CC0); the astronaut Eileen Collins by NASA (public domain). All from scikit-image. Clip: an "
    "excerpt from Big Buck Bunny, © copyright Blender Foundation, www.bigbuckbunny.org (CC BY 3.0), and what Supple "
    "makes of it. Head: Colin27, copyright (C) 1993–2009 Louis Collins, McConnell Brain Imaging Centre, Montreal "
    "Neurological Institute, McGill University; permission to use, copy, modify and distribute it is granted, provided "
    "that this notice appears in all copies."
)
_PLOTS = {
    "stretch": "Where the picture grows and shrinks.",
    "grid": "Straight lines, bent.",
}

Colours = npt.NDArray[np.uint8]


def write_gallery(
    folder: str | os.PathLike[str],
    *,
    force: bool = False,
    device: str = "cpu",
    written: Callable[[Path], None] | None = None,
) -> Path:
    """Write photographs, a clip and a volume, their warped versions, plots, and a page that shows them.

    Parameters
    ----------
    folder : str or os.PathLike
        The folder, created if it is missing. An existing gallery is replaced; other files are kept.
    force : bool
        Whether to write into a folder with other contents, and replace files of the same names.
    device : str
        The device that renders volumes: ``"cpu"``, ``"gpu"`` or ``"auto"``; the page names it.
    written : function, optional
        Called with the path of each warped picture, clip or rendering once it is written: photographs come first.

    Returns
    -------
    pathlib.Path
        The path of the page.

    Raises
    ------
    SuppleError
        If the folder has other contents, or cannot be written.
    """
    gpu = gpu_of(device)
    maker = "the CPU" if gpu is None else f"the CPU, and views of volumes by the GPU {gpu.name}, through {gpu.backend}"
    place = _prepared(Path(folder), force)
    for name in dict.fromkeys(shot.source for scene in SCENES for shot in scene.shots):
        if name == INSIDE:  # the head, 0 outside the brain's mask
            data = files("supple.examples") / "data"
            with as_file(data / HEAD) as head, as_file(data / "brain.nii.gz") as marks:
                volume = read_volume(head)
                alone = np.where(read_volume(marks).samples > 0, volume.samples, 0).astype(volume.samples.dtype)
                write_volume(place / name, alone, volume, force=True)
            continue
        with replacing(place / name, force=True) as temporary:
            temporary.write_bytes((files("supple.examples") / "data" / name).read_bytes())
    sections = []
    for scene in SCENES:
        shots = "".join(_made(place, shot, device, written or (lambda path: None)) for shot in scene.shots)
        above = f"<h2>{escape(scene.title)}</h2>\n<p>{escape(scene.text)}</p>"
        sections.append(f"<section>\n{above}\n{shots}</section>")
    template = (files("supple.examples") / "data" / "gallery.html").read_text(encoding="utf-8")
    page = Template(template).substitute(sections="\n".join(sections), credits=escape(_CREDITS), maker=escape(maker))
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
        text = f"cannot write to the folder {shown(folder)}: {error.strerror}: choose another place"
        raise SuppleError(text) from error
    except ValueError as error:
        raise SuppleError(f"no folder can be called {shown(folder)}: choose another name") from error
    if not (empty or force):
        text = f"{shown(folder)} is not empty: choose another folder, or {argument('force', True)} to write there"
        raise SuppleError(text)
    return folder


def _made(place: Path, shot: Shot, device: str, written: Callable[[Path], None]) -> str:
    if isinstance(shot, Look):
        text = _look(place, shot, device)
    else:
        text = _take(place, shot) if isinstance(shot, Take) else _shot(place, shot)
    written(place / shot.target)
    return text


def _shot(place: Path, shot: Shot) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MissWarning)
        made = warp_file(place / shot.source, place / shot.target, shot.recipe, outside=shot.outside, force=True)
    said = [str(w.message).partition(" (on_fold")[0] for w in caught if issubclass(w.category, MissWarning)]
    image = read(place / shot.source).pixels
    plots = []
    for what, text in _PLOTS.items():
        name = f"{shot.name}-{what}.png"
        plot(made.deformation, what, place / name, image=image, force=True)
        plots.append(_figure(place, name, text))
    report = made.report()
    steps = f" The strokes take {report.applied} steps." if report.applied > report.strokes else ""
    facts = f"<b>Error at most {report.error:.4f} px</b>, certified at every pixel. <b>{report.folds} folds</b>.{steps}"
    compared = _compared(shot, shot.source, *made.deformation.shape)
    return (
        f'<div class="shot">\n{compared}{_explained(shot, facts, said)}</div>\n'
        f'<div class="plots">\n{"".join(plots)}</div>\n'
    )


def _take(place: Path, take: Take) -> str:
    source, target = place / take.source, place / take.target
    made = warp_file(source, target, take.recipe, force=True)
    before, after = _frames(source), _frames(target)
    x, y, width, height = take.area
    parts = ([(k, clip[k][y : y + height, x : x + width]) for k in take.frames] for clip in (before, after))
    draw_sheet(next(parts), next(parts), place / f"{take.name}-sheet.png", force=True)
    plots = [_figure(place, f"{take.name}-sheet.png", "Some frames, before and after.")]
    if take.row is not None:
        rows = (np.stack([frame[take.row] for frame in clip]) for clip in (before, after))
        draw_slice(next(rows), next(rows), take.row, place / f"{take.name}-slice.png", axis="y", force=True)
        plots.append(_figure(place, f"{take.name}-slice.png", f"What the row y = {take.row} shows over time."))
    still = take.frames[len(take.frames) // 2]
    videos = [
        _video(place, name, f"{take.name}-{when.lower()}.jpg", clip[still], when)
        for clip, name, when in ((before, take.source, "Before"), (after, take.target, "After"))
    ]
    facts = (
        f"<b>Error at most {made.error:.4f} px and frames</b>, by the checks of the map. {made.frames} frames, "
        f"{made.held} of them held at once."
    )
    return (
        f'<div class="clips">\n{"".join(videos)}</div>\n{_explained(take, facts, [])}'
        f'<div class="plots">\n{"".join(plots)}</div>\n'
    )


def _look(place: Path, look: Look, device: str) -> str:
    red, green, blue = bytes.fromhex(BACKGROUND)
    view = RenderOptions(
        camera=Camera(azimuth=look.azimuth, elevation=look.elevation, distance=DISTANCE),
        size=(look.size, look.size),
        background=(red / 255, green / 255, blue / 255),
        supersampling=look.smooth,
        density=look.density,
        turntable=look.turntable or None,
        device=device,
    )
    source, target = place / look.source, place / look.target
    made = render_file(Job(source, target, look.recipe, force=True), options=view)
    if look.turntable:
        still = made.render(view.camera, view.size).pixels(view.background)
        video = _video(place, look.target, f"{look.name}.jpg", still, look.caption)
        return f'<div class="shot">\n{video}{_explained(look, _facts(made), [])}</div>\n'
    before, work = f"{look.name}-before.jpg", f"{look.name}-inversions.png"
    render_file(Job(source, place / before, force=True), options=view)
    compared = f"{_compared(look, before, *view.size)}{_explained(look, _facts(made), [])}"
    if look.density is not None:
        return f'<div class="shot">\n{compared}</div>\n'
    counted = replace(view, mode="exact", what="inversions", supersampling=1, background=None)
    render_file(Job(source, place / work, look.recipe, force=True), options=counted)
    plot = _figure(
        place, work, "How often the map is evaluated for each ray of an exact rendering (it inverts all samples)."
    )
    return f'<div class="shot">\n{compared}</div>\n<div class="plots small">\n{plot}</div>\n'


def _facts(made: Solid) -> str:
    assert made.deformation is not None
    resolution = made.deformation.resolution()
    steps = f" The stroke takes {resolution['applied']} steps." if resolution["applied"] > 1 else ""
    return f"<b>Source points within {made.error:g} voxels</b>, by the checks of the warp.{steps}"


def _video(place: Path, name: str, poster: str, still: Colours, when: str) -> str:
    write(place / poster, still, force=True)
    height, width = still.shape[:2]
    return (
        f'<figure><video src="{name}" poster="{poster}" width="{width}" height="{height}" muted loop controls '
        f'playsinline preload="metadata" aria-label="{when}."></video><figcaption>{when}</figcaption></figure>\n'
    )


def _frames(path: Path) -> list[Colours]:
    with open_clip(path) as clip:
        arrays = [np.empty((*group.shape, group.channels), clip.layout.dtype) for group in clip.layout.groups]
        found = []
        for frame in clip.frames():
            frame.copy_to(arrays)
            found.append(clip.to_rgb(arrays))
    return found


def _figure(place: Path, name: str, text: str) -> str:
    facts = info(place / name)
    width, height = facts["width"], facts["height"]
    return (
        f'<figure style="--shape: {width} / {height}"><a href="{name}"><img src="{name}" width="{width}" '
        f'height="{height}" loading="lazy" alt="{text}"></a><figcaption>{text}</figcaption></figure>\n'
    )


def _compared(shot: Shot, before: str, height: int, width: int) -> str:
    size = f'width="{width}" height="{height}"'
    return (
        f'<figure><div class="pair"><img src="{shot.target}" {size} alt="{escape(shot.caption)}">'
        f'<img class="before" src="{before}" {size} alt="As it was.">'
        f'<div class="edge"></div><span>before</span><span>after</span>'
        f'<input type="range" min="0" max="100" value="{shot.cut}" step="0.1" aria-label="before and after"></div>'
        f"<figcaption>{escape(shot.caption)}</figcaption></figure>\n"
    )


def _explained(shot: Shot, facts: str, said: list[str]) -> str:
    lines = "".join(f'\n<span class="said">supple: warning: {escape(text)}</span>' for text in said)
    return f'<div class="told">\n<pre>{escape(shot.command)}{lines}</pre>\n<p class="facts">{facts}</p>\n</div>\n'
