"""Opening windows: on a screen, in a notebook, or in a browser elsewhere."""

from __future__ import annotations

import contextlib
import os
import secrets
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from supple.domain import choice, length, point
from supple.engines.wgpu.device import Gpu, open_gpu
from supple.errors import SuppleError, shown
from supple.files.clips import is_clip, open_clip
from supple.files.renders import default_transfer
from supple.files.volumes import VolumeOptions, in_space, is_volume_job, open_volume
from supple.geometry import Geometry
from supple.media.image import read
from supple.media.volume import Volume
from supple.strokes import Fit, Recipe, fit_recipe
from supple.viewer.document.editing import Document
from supple.viewer.panels.frame_cache import FrameCache
from supple.viewer.panels.stages import ImageStage, VideoStage, VolumeStage, on_screen
from supple.viewer.panels.stages import shown as as_pixels
from supple.viewer.tools.brushes import ImageTools, VideoTools, VolumeTools
from supple.viewer.tools.gestures import Pair
from supple.viewer.tools.playback import Playback
from supple.viewer.window import qt

if TYPE_CHECKING:
    from supple.viewer.window.window import Window

SIZE = (1280, 800)
_NO_SCREEN = "no screen was found for a window: --serve shows it in a browser"
Source = str | os.PathLike[str] | npt.NDArray[Any]
Spacing = tuple[float, float, float]
_EVEN = (1.0, 1.0, 1.0)
_PLAIN = VolumeOptions()


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """How what is shown is read."""

    spacing: Spacing = _EVEN  # of the voxels of an array, in millimetres, x first
    time_scale: float = 1.0  # of a clip, how many pixels a frame is worth to the brush
    volume: VolumeOptions = _PLAIN  # of its file; and whether the first strokes are in places in space
    fit: Fit | None = None  # of the first strokes, if they were made for another size, as `supple.warp_file` takes it

    def __post_init__(self) -> None:
        length("time_scale", self.time_scale)

    @property
    def export(self) -> dict[str, Any]:
        """The arguments with which `supple.warp_file` makes the picture that is seen."""
        # Strokes are indices here, whatever the first ones were.
        return {"volume": replace(self.volume, world=False)}


_USUAL = ViewOptions()


def stage_of(gpu: Gpu, source: Source, options: ViewOptions = _USUAL) -> ImageStage | VolumeStage:
    """Open the stage of a file, or of an array: a picture (H, W[, C]) or a volume (Z, H, W) more than 4 voxels wide.

    Raises
    ------
    SuppleError
        If it cannot be read, is more than the GPU takes, or is not of the kind that the options are for.
    """
    if isinstance(source, str | os.PathLike):
        name = shown(source)
        if not os.path.exists(source) and "%" not in os.fspath(source):
            raise SuppleError(f"cannot read {name}: there is no such file: check the name")
        if is_volume_job(source, "", Recipe(), options.volume):
            _suits(name, options, volume=True)
            volume = open_volume(source, options.volume)
            samples = volume.rescaled()
            if volume.series:
                samples = samples[0]
            elif samples.ndim > 3:
                raise SuppleError(f"{volume.name} has {samples.shape[3]} components, and pictures are of one")
            return VolumeStage(gpu, volume, default_transfer(volume), samples)
        moves = _moves(source)
        _suits(name, options, moves=moves)
        if moves:
            return VideoStage(gpu, FrameCache(source), options.time_scale)
        pixels = on_screen(read(source))
    else:
        name, array = "the array", np.asarray(source)
        if array.ndim not in (2, 3) or 0 in array.shape or array.dtype.kind not in "biuf":
            raise SuppleError(
                "what is shown is an array of numbers, of a picture (H, W) or (H, W, C) or of a volume (Z, H, W), or a "
                f"file, of a clip too: found {array.dtype} {array.shape}"
            )
        _suits(name, options)
        if array.ndim == 3 and array.shape[2] > 4:
            x, y, z = (length("spacing", v) for v in point("spacing", options.spacing, (3,)))
            volume = Volume(array, Geometry(spacing=(x, y, z)), name, "array")
            return VolumeStage(gpu, volume, default_transfer(volume))
        pixels = as_pixels(array)
    try:
        return ImageStage(gpu, name, pixels)
    except MemoryError as error:
        raise SuppleError(f"{name} cannot be shown: {error}") from None


def _moves(source: str | os.PathLike[str]) -> bool:
    """Return whether a file, a folder or a pattern is a clip; a GIF is one where it has several frames."""
    if Path(source).suffix.lower() == ".gif" and os.path.isfile(source):
        with contextlib.suppress(SuppleError), open_clip(source) as clip:
            return bool(clip.count > 1)
    return is_clip(source, "x.mp4" if os.path.isdir(source) else "", Recipe())


def _suits(name: str, options: ViewOptions, *, moves: bool = False, volume: bool = False) -> None:
    """Refuse a time scale where there is no time, and what is for the files of volumes where there is none."""
    if options.volume != _PLAIN and not volume:
        raise SuppleError(f"{name} is no file of a volume, and what was asked of it is for those: leave that out")
    if options.time_scale != 1.0 and not moves:
        raise SuppleError(f"time_scale is for clips, and {name} is none: leave it out")


def tools_of(stage: ImageStage | VolumeStage, document: Document, size: Pair) -> ImageTools | VolumeTools:
    """Return the tools for a stage."""
    if isinstance(stage, VideoStage):
        return VideoTools(document, Playback(stage.film.count, stage.rate, stage.film.starts), size)
    if isinstance(stage, ImageStage):
        return ImageTools(document, size)
    tools: VolumeTools = VolumeTools(
        document,
        stage.volume.geometry,
        size,
        lambda x, y: stage.deform(document.deformation).pick(tools.camera, tools.stage.size, (x, y)),
        lambda pick, to: stage.deform(document.deformation).drag(tools.camera, tools.stage.size, pick, to),
    )
    return tools


def opened(
    source: Source, recipe: Recipe | None, canvas: Any, loop: Any, gpu: Gpu | None = None, options: ViewOptions = _USUAL
) -> Window:
    """A view of a source on a canvas.

    Raises
    ------
    SuppleError
        If the source or the recipe does not fit, there is no GPU, or a part of the window is not installed.
    """
    with _installed():
        from supple.viewer.window.window import Window
    gpu = gpu or _gpu()
    stage = stage_of(gpu, source, options)
    recipe, geometry = recipe or Recipe(), None
    if isinstance(stage, VolumeStage):
        geometry = stage.volume.geometry
        recipe = in_space(recipe, geometry, stage.name, options.volume.world)
    if stage.kind != "video" or options.fit == "pixels":  # what a frame is worth would have to grow along
        recipe = fit_recipe(recipe, stage.shape[::-1], options.fit, stage.name)
    document = Document(stage.shape, stage.spacing, recipe, kind=stage.kind, geometry=geometry)
    tools = tools_of(stage, document, canvas.get_logical_size())
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    made = Window(stage, document, tools, canvas, gpu, path, options.export, loop.call_later)
    canvas.set_title(f"{stage.name} - Supple")
    return made


def _gpu() -> Gpu:
    """The GPU, which a window cannot do without."""
    try:
        return open_gpu()
    except SuppleError as error:
        raise SuppleError(str(error).removesuffix("; device cpu needs none")) from None


@contextlib.contextmanager
def _installed() -> Iterator[None]:
    """Refuse what needs a part of the window that is not installed."""
    try:
        yield
    except ImportError as error:
        missing = error.name or error
        raise SuppleError(f"the window needs {missing}, which is not installed: pip install 'supple[view]'") from None


def on_screen_of(toolkit: str) -> tuple[Any, Any]:
    """The canvas and the loop of a toolkit: ``"glfw"`` or ``"qt"``.

    Raises
    ------
    SuppleError
        If it is not installed, or there is no screen.
    """
    choice("toolkit", toolkit, ("glfw", "qt"))
    with _installed():
        if toolkit == "glfw":
            import glfw

            if not glfw.init():
                raise SuppleError(_NO_SCREEN)
            from rendercanvas.glfw import RenderCanvas, loop
        else:
            RenderCanvas, loop = qt.toolkit()
            if not qt.has_screen():
                raise SuppleError(_NO_SCREEN)
    return RenderCanvas, loop


def show(
    source: Source,
    recipe: Recipe | None = None,
    *,
    toolkit: str = "glfw",
    size: tuple[int, int] = SIZE,
    options: ViewOptions = _USUAL,
) -> Window:
    """Open a window, and come back when it is closed.

    Parameters
    ----------
    source, recipe
        As `view` takes them.
    toolkit : str
        ``"glfw"``, or ``"qt"`` where PySide6 or PyQt6 is installed.
    size : (int, int)
        Columns and rows of the window.
    options : ViewOptions
        How the source is read.

    Returns
    -------
    Window
        ``view.recipe`` is what was done.
    """
    canvas_type, loop = on_screen_of(toolkit)
    gpu = _gpu()
    canvas = canvas_type(size=size, title="Supple", max_fps=60, update_mode="ondemand", vsync=False)
    try:
        made = opened(source, recipe, canvas, loop, gpu, options)
    except SuppleError:
        canvas.close()
        raise
    if toolkit == "glfw":
        _ask_before_closing(canvas, made)
    else:
        qt.attend(canvas, made)
    loop.run()
    if canvas.get_closed():  # where a loop runs already, as in a notebook of Qt, the window stays
        made.close()
    return made


def _ask_before_closing(canvas: Any, view: Window) -> None:
    """Ask before strokes are lost, and open the files that are dropped on the window."""
    import glfw

    def closing(window: Any) -> None:
        if not view.commands.may_close():
            glfw.set_window_should_close(window, 0)
            canvas.request_draw()

    def dropped(window: Any, paths: Any) -> None:
        view.drop([str(path) for path in paths])

    glfw.set_window_close_callback(canvas._window, closing)
    glfw.set_drop_callback(canvas._window, dropped)  # type: ignore[arg-type]


def in_notebook() -> bool:
    """Return whether this is a notebook."""
    ipython = sys.modules.get("IPython")  # which a notebook has imported
    return ipython is not None and type(ipython.get_ipython()).__name__ == "ZMQInteractiveShell"


def view(
    source: Source,
    recipe: Recipe | None = None,
    *,
    spacing: Spacing = _EVEN,
    time_scale: float = 1.0,
    volume: VolumeOptions | None = None,
) -> Window:
    """Bend a photograph, a clip or a volume by hand.

    In a notebook, what is returned is a widget. Elsewhere, a window is opened, and this comes back when it is closed.

    Parameters
    ----------
    source : str, os.PathLike or array
        A file; or the array of a picture, (H, W) or (H, W, C) of up to 4 channels, or of a volume, (Z, H, W).
    recipe : Recipe, optional
        Strokes that there are at first.
    spacing : (float, float, float)
        Of the voxels of an array, in millimetres, x first.
    time_scale : float
        Of a clip, how many pixels a frame is worth to the brush, as ``supple warp --time-scale`` takes it.
    volume : VolumeOptions, optional
        What is particular to the file of a volume, as `supple.warp_file` takes it.

    Returns
    -------
    Window
        ``view.recipe`` is what was done, and ``view.on_change`` calls a function with it whenever it changes.

    Raises
    ------
    SuppleError
        If the source or the recipe does not fit, there is no GPU, or a part of the window is not installed.
    """
    options = ViewOptions(spacing, time_scale, volume or _PLAIN)
    if not in_notebook():
        return show(source, recipe, options=options)
    with _installed():
        from rendercanvas.anywidget import RenderCanvas, loop
    canvas = RenderCanvas(size=(960, 600), max_fps=30, update_mode="ondemand")
    canvas.set_css_width("calc(100% - 4px)")  # of the cell, with its frame
    return opened(source, recipe, canvas, loop, options=options)


def serve(
    source: Source,
    recipe: Recipe | None = None,
    *,
    port: int = 0,
    tell: Callable[[str], None] = print,
    options: ViewOptions = _USUAL,
) -> None:
    """Show the window in a browser, also one of another machine, until it is interrupted.

    It is bound to this machine alone, and open to those who have the token in its address: from another machine, it is
    reached through a tunnel (``ssh -L``).

    Parameters
    ----------
    source, recipe, options
        As `show` takes them.
    port : int
        0 for any that is free.
    tell : function
        Called with the address.
    """
    with _installed():
        from rendercanvas.http import RenderCanvas, asgi, loop

        from supple.viewer.window import server
    with contextlib.closing(server.listening(port)) as listener:
        canvas = RenderCanvas(max_fps=30, update_mode="ondemand")
        with contextlib.closing(opened(source, recipe, canvas, loop, options=options)) as made:
            token = secrets.token_urlsafe(24)
            tell(f"http://{server.HOST}:{listener.getsockname()[1]}/?token={token}")
            app = server.guarded(asgi, token, f"{made.stage.name} - Supple")
            server.serve(app, listener, canvas.get_closed)
