"""The start of windows: on a screen, in a notebook, or in a remote browser."""

from __future__ import annotations

import contextlib
import os
import secrets
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.errors import SuppleError, argument, shown
from supple.fields import Placed
from supple.files.clips import parts_of, refuse_maps
from supple.files.jobs import Job
from supple.files.options import VolumeOptions
from supple.files.renders import default_transfer
from supple.files.volumes import in_space
from supple.gpu.device import Gpu, open_gpu
from supple.media import medium
from supple.media.image import Picture, read
from supple.media.volume import Volume
from supple.render.camera import Camera
from supple.space.checks import integer, length, point, refuse
from supple.space.geometry import Geometry, Grid
from supple.strokes import Recipe, fit_recipe
from supple.viewer.document.editing import Document
from supple.viewer.panels.slices import first_window
from supple.viewer.panels.stages import FrameCache, ImageStage, VideoStage, VolumeStage
from supple.viewer.panels.transforms import shown as as_pixels
from supple.viewer.tools.brushes import ImageTools, VideoTools
from supple.viewer.tools.drawing import Pair
from supple.viewer.tools.playback import Playback
from supple.viewer.tools.volumes import VolumeTools
from supple.viewer.window import dialogs
from supple.viewer.window.options import EVEN, PLAIN, Spacing, ViewOptions
from supple.viewer.window.volumes import OPTIONS, comparison_of, landmarks_of, volume_stage, write_landmarks

if TYPE_CHECKING:
    from supple.viewer.window.window import Window

SIZE = (1280, 800)
Source = str | os.PathLike[str] | npt.NDArray[Any]
_USUAL = ViewOptions()


def _exists(source: Source) -> None:
    """Raise SuppleError for a file that does not exist; patterns of image sequences are checked later."""
    if isinstance(source, str | os.PathLike) and "%" not in os.fspath(source) and not os.path.exists(source):
        raise SuppleError(f"cannot read {shown(source)}: there is no such file: check the name")


def stage_of(gpu: Gpu, source: Source, options: ViewOptions = _USUAL) -> ImageStage | VolumeStage:
    """Open the stage of a file, or of an array: an image (H, W[, C]) or a volume (Z, H, W) more than 4 voxels wide.

    SuppleError if it cannot be read, does not fit the GPU, or is of another kind than the options.
    """
    if isinstance(source, str | os.PathLike):
        name = shown(source)
        if Job(source, "", Recipe(), volume=options.volume, maps=options.maps).medium.kind in ("volume", "store"):
            _suits(name, options, "volume")
            return volume_stage(gpu, source, options)
        moves = _moves(source)
        _suits(name, options, "clip" if moves else "picture")
        if moves:
            if options.maps:
                refuse_maps(source)
            return VideoStage(gpu, FrameCache(source), options.time_scale)
        picture = read(source)
        pictured: Picture | npt.NDArray[np.uint8] = picture
        if options.maps:
            grid = Grid(picture.pixels.shape[:2])
            pictured = Deformation.from_recipe(Recipe(), grid, maps=options.maps).warp(picture)
    else:
        name, array = "the array", np.asarray(source)
        if options.maps:
            raise SuppleError("fields and affine maps are shown with files, and an array has none: warp it first")
        if array.ndim not in (2, 3) or 0 in array.shape or array.dtype.kind not in "biuf":
            raise SuppleError(
                "what is shown is an array of numbers, of a picture (H, W) or (H, W, C) or of a volume (Z, H, W), or a "
                f"file, of a clip too: found {array.dtype} {array.shape}"
            )
        deep = array.ndim == 3 and array.shape[2] > 4
        _suits(name, replace(options, points=None) if deep else options, "array")
        if deep:
            x, y, z = (length("spacing", v) for v in point("spacing", options.spacing, (3,)))
            volume = Volume(array, Geometry(spacing=(x, y, z)), name, "array")
            return VolumeStage(gpu, volume, default_transfer(volume))
        pictured = as_pixels(array)
    try:
        return ImageStage(gpu, name, pictured)
    except MemoryError as error:
        raise SuppleError(f"{name} cannot be shown: {error}") from None


def _moves(source: str | os.PathLike[str]) -> bool:
    """Return whether a file, a folder or a pattern is a clip; a GIF, PNG or WebP is one if it has several frames."""
    kind = medium.opened(source, "x.mp4" if os.path.isdir(source) else "").kind
    if kind == "clip" and Path(source).suffix.lower() != ".gif":
        return True
    return kind != "volume" and medium.is_animated(source)


_ONLY = {"time_scale": "clip", "frame": "clip", "volume": "volume", "points": "volume"} | dict.fromkeys(
    OPTIONS, "volume"
)
"""For each option that suits one kind of file only, that kind."""


def _suits(name: str, options: ViewOptions, kind: str) -> None:
    """Raise SuppleError for options that are for files of another kind."""
    for option, only in _ONLY.items():
        if only != kind and getattr(options, option) != getattr(_USUAL, option):
            raise SuppleError(f"{argument(option)} is for files of {only}s, and {name} is none: leave it out")


def tools_of(stage: ImageStage | VolumeStage, document: Document, size: Pair) -> ImageTools | VolumeTools:
    """Return the tools for a stage."""
    if isinstance(stage, VideoStage):
        playback = Playback(stage.film.count, stage.rate, stage.film.starts)
        return VideoTools(document, playback, size, turn=stage.turn)
    if isinstance(stage, ImageStage):
        return ImageTools(document, size, turn=stage.turn)

    def placed() -> Camera:
        return tools.stage.placed(tools.view)

    tools: VolumeTools = VolumeTools(
        document,
        stage.volume.geometry,
        size,
        lambda x, y: stage.on_canvas(document.deformation).pick(placed(), tools.stage.size, (x, y)),
        lambda pick, to: stage.on_canvas(document.deformation).drag(placed(), tools.stage.size, pick, to),
        first_window(stage.volume, stage.unit),
        stage.scene.seen_points,
        comparison_of(stage),
    )
    return tools


def opened(
    source: Source, recipe: object, canvas: Any, loop: Any, gpu: Gpu | None = None, options: ViewOptions = _USUAL
) -> Window:
    """Return the window of a source on a canvas.

    SuppleError if the source or the recipe does not fit, there is no GPU, or a part of the window is not installed.
    """
    with _installed():
        from supple.viewer.window.window import Window
    if not isinstance(recipe := recipe or Recipe(), Recipe):
        refuse("recipe", "a Recipe, as Recipe.from_json reads one", recipe)
    _exists(source)  # before the GPU, which may be missing, too
    gpu = gpu or _gpu()
    stage = stage_of(gpu, source, options)
    geometry = None
    if isinstance(stage, VolumeStage):
        geometry = stage.volume.geometry
        recipe = in_space(recipe, geometry, stage.name, options.volume.world)
    size, in_time = stage.shape[::-1], stage.kind == "video"
    if in_time and recipe.strokes and recipe.strokes[0].ndim == 2:
        size, in_time = size[:2], False
    if not in_time or options.fit == "pixels":  # the length of a frame would have to be scaled
        recipe = fit_recipe(recipe, size, options.fit, stage.name)
    marks = landmarks_of(stage, options) if isinstance(stage, VolumeStage) else None
    hold = int(stage.kind == "video" and any(parts_of(stage.shape[0], 1)))  # 0 if no frame would be left for strokes
    document = Document(stage.shape, stage.spacing, recipe, kind=stage.kind, geometry=geometry, hold=hold, marks=marks)
    tools = tools_of(stage, document, canvas.get_logical_size())
    if options.frame is not None and isinstance(tools, VideoTools):
        last = tools.playback.count - 1
        tools.playback.seek(integer("frame", options.frame, f"from 0 to {last}", 0, last))
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    window = Window(stage, document, tools, canvas, gpu, path, options.export, loop.call_later)
    if isinstance(stage, VolumeStage):
        window.commands.write_marks = partial(write_landmarks, stage, document)
    return window


def _gpu() -> Gpu:
    try:
        return open_gpu()
    except SuppleError as error:
        raise SuppleError(str(error).removesuffix(f"; {argument('device', 'cpu')} needs none")) from None


@contextlib.contextmanager
def _installed() -> Iterator[None]:
    try:
        yield
    except ImportError as error:
        missing = error.name or error
        raise SuppleError(f"the window needs {missing}, which is not installed: pip install 'supple[view]'") from None


def show(
    source: Source,
    recipe: Recipe | None = None,
    *,
    size: tuple[int, int] = SIZE,
    options: ViewOptions = _USUAL,
) -> Window:
    """Open a window of ``size`` (columns, rows), and return it when it is closed; source and recipe as in `view`."""
    _exists(source)
    with _installed():
        import glfw

        if not glfw.init():
            raise SuppleError("no screen was found for a window: --serve shows it in a browser")
        from rendercanvas.glfw import RenderCanvas, loop
    gpu = _gpu()
    canvas = RenderCanvas(size=size, title="Supple", max_fps=60, update_mode="ondemand", vsync=False)
    try:
        made = opened(source, recipe, canvas, loop, gpu, options)
    except SuppleError:
        canvas.close()
        raise
    made.commands.choose = dialogs.chooser()
    _ask_before_closing(canvas, made)
    from supple.viewer.window.window import closed_by_signals

    with closed_by_signals(loop):
        loop.run()
        if canvas.get_closed():  # if a loop is running, as in a notebook, the window stays
            made.close()
    return made


def _ask_before_closing(canvas: Any, view: Window) -> None:
    import glfw

    def closing(window: Any) -> None:
        if not view.commands.may_close():
            glfw.set_window_should_close(window, 0)
            canvas.request_draw()

    view.copy_text = partial(glfw.set_clipboard_string, canvas._window)
    glfw.set_window_close_callback(canvas._window, closing)
    glfw.set_drop_callback(canvas._window, lambda _, paths: view.drop([*map(str, paths)]))  # type: ignore[arg-type,misc]


def in_notebook() -> bool:
    """Return whether this process is a notebook."""
    ipython = sys.modules.get("IPython")  # imported by a notebook
    return ipython is not None and type(ipython.get_ipython()).__name__ == "ZMQInteractiveShell"


def view(
    source: Source,
    recipe: Recipe | None = None,
    *,
    spacing: Spacing = EVEN,
    time_scale: float = 1.0,
    volume: VolumeOptions | None = None,
    points: str | os.PathLike[str] | None = None,
    convention: str | None = None,
    maps: Sequence[Placed] = (),
    **more: Any,
) -> Window:
    """Warp a photograph, a clip or a volume by hand.

    Returns a widget in a notebook. Elsewhere, it opens a window, and returns when it is closed.

    Parameters
    ----------
    source : str, os.PathLike or array
        A file; or the array of an image, (H, W) or (H, W, C) of up to 4 channels, or of a volume, (Z, H, W).
    recipe : Recipe, optional
        The first strokes.
    spacing : (float, float, float)
        The spacing of an array's voxels, in millimetres, x first.
    time_scale : float
        The length of a clip's frame in pixels, for the brush, as in ``supple warp --time-scale``.
    volume : VolumeOptions, optional
        Options for volume files, as in `supple.warp_file`.
    points : str or os.PathLike, optional
        A file of landmarks, which are shown in a volume, as by ``supple view --points``.
    convention : str, optional
        The coordinates of a table of landmarks that does not name them: ``"LPS"``, ``"RAS"`` or ``"index"``.
    maps : sequence of Placed, optional
        Fields and affine maps, as in `supple.warp_file`, through which the file is seen; strokes come after them.
    **more
        ``fixed``, ``fixed_points``, ``segmentation``, ``label_colours``: files, as of ``supple view``, for volumes.

    Returns
    -------
    Window
        ``view.recipe`` is the result, and ``view.on_change`` calls a function after each change of it.

    Raises
    ------
    SuppleError
        If the source or the recipe does not fit, there is no GPU, or a part of the window is not installed.
    """
    options = ViewOptions(
        spacing, time_scale, volume or PLAIN, points=points, convention=convention, maps=tuple(maps), **more
    )
    if not in_notebook():
        return show(source, recipe, options=options)
    with _installed():
        from rendercanvas.anywidget import JS, RenderCanvas, loop

        from supple.viewer.window.server import KEYS

        widget = type("Widget", (RenderCanvas,), {"_esm": JS + KEYS})
    canvas = widget(size=(960, 600), max_fps=30, update_mode="ondemand")
    canvas.set_css_width("calc(100% - 4px)")  # of the cell, with its frame
    made = opened(source, recipe, canvas, loop, options=options)
    made.commands.windows = False
    return made


def serve(
    source: Source,
    recipe: Recipe | None = None,
    *,
    port: int = 0,
    tell: Callable[[str], None] = print,
    options: ViewOptions = _USUAL,
) -> None:
    """Show the window in a browser, on this or another machine, until it is interrupted; ``tell`` gets the address.

    It listens on this machine only, at any free port for 0, and requires the token in its address: from another
    machine, it is reached through a tunnel (``ssh -L``).
    """
    with _installed():
        from rendercanvas.http import RenderCanvas, asgi, loop

        from supple.viewer.window import server
    with contextlib.closing(server.listening(port)) as listener:
        canvas = RenderCanvas(max_fps=30, update_mode="ondemand")
        with contextlib.closing(opened(source, recipe, canvas, loop, options=options)) as made:
            made.commands.windows = False
            token = secrets.token_urlsafe(24)
            tell(f"http://{server.HOST}:{listener.getsockname()[1]}/?token={token}")
            app = server.guarded(asgi, token, f"{made.stage.name} - Supple")
            server.serve(app, listener, canvas.get_closed)
