"""The stages of a window, one for each kind of media: each draws itself, through strokes, into a texture."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.deformation import Deformation
from supple.errors import SuppleError
from supple.gpu.device import Gpu
from supple.gpu.plate import BACK, Plate, Sight
from supple.media.image import Picture
from supple.media.volume import Volume
from supple.render.box import Box
from supple.render.camera import Camera
from supple.render.labels import LabelColours
from supple.render.picture import Pick
from supple.render.scene import Scene
from supple.render.transfer import LABELS, Transfer
from supple.viewer.document.background import heard
from supple.viewer.document.state import Kind
from supple.viewer.panels.frame_cache import FrameCache
from supple.viewer.panels.transforms import on_screen, usual_of
from supple.viewer.panels.warped import Levels, Warped
from supple.viewer.tools.viewport import turn_of

Pixels = npt.NDArray[np.uint8]
Point = tuple[float, ...]
Span = tuple[int, int]
SLOW = 0.5  # seconds: what takes longer is announced


class ImageStage:
    """A photograph."""

    kind: Kind = "image"

    def __init__(self, gpu: Gpu, name: str, source: Picture | Pixels) -> None:
        self._gpu, self._given = gpu, source
        self.transform = usual_of(source) if isinstance(source, Picture) else ""
        """The view transform, one of `TRANSFORMS`."""
        layers = source.layers if isinstance(source, Picture) else None
        self.turn = turn_of(0.0, None if layers is None else layers.aspect)
        """The map of displacements in the image to those that are shown."""
        self._lay()
        height, width = self.pixels.shape[:2]
        self.shape: tuple[int, ...] = (height, width)
        self.spacing: tuple[float, ...] = (1.0, 1.0)
        self._name(name, (width, height))

    def _lay(self) -> None:
        """Make the pixels, and hold them on the device."""
        given = self._given
        whole = given if isinstance(given, Picture) else Picture(given, alpha=True)
        self.pixels = on_screen(whole, self.transform)
        self._by_cpu = self._gpu.software  # which itself warps faster than shaders on it
        if self._by_cpu:
            levels = Levels(self.pixels)
            self._warped = [Warped(self._gpu, levels), Warped(self._gpu, levels)]  # the result, and its base beside it
        else:
            self._plate = Plate(self._gpu, self.pixels.shape[1::-1])
            self._plate.put(0, self.pixels)

    def set_transform(self, name: str) -> None:
        """Set the view transform."""
        self.transform = name
        self._lay()

    def _name(self, name: str, size: tuple[int, int]) -> None:
        self.name, self.size = name, size
        self.trouble = ""  # the reason why the display is incomplete
        self._under: tuple[Deformation, Point, Point] | None = None

    def solves(self, sight: Sight) -> bool:
        """Return whether drawing solves for T⁻¹, which takes a slow device long."""
        return not self._by_cpu or bool(sight.overlay)

    def expect(self, deformations: tuple[Deformation, ...], sight: Sight) -> None:
        """Prepare the next drawing: warp the image, where the device does not."""
        if self._by_cpu:
            for deformation, warped in zip(deformations, self._warped, strict=False):
                warped.bring(deformation, sight)

    def draw(self, deformation: Deformation, sight: Sight, texture: Any, encoder: Any = None) -> bool:
        """Draw the visible part, or record it into an encoder; return whether it is complete."""
        if self._by_cpu:
            next(warped for warped in self._warped if warped.shown is deformation).draw(sight, texture, encoder)
        else:
            self._drawn(deformation, sight, texture, encoder)
        return True

    def _drawn(self, deformation: Deformation, sight: Sight, texture: Any, encoder: Any) -> None:
        """Draw by the device, which warps."""
        space = deformation.space
        self._plate.draw(sight, space.table, space.axes, texture, encoder, space.freeze)

    def value(self, point: tuple[float, float], time: float, deformation: Deformation | None = None) -> str:
        """Return the value of the pixel at a point of a frame, through strokes if they are given."""
        x, y, frame = self._source(deformation, (*point, time))
        pixels, x, y = self._frame(frame), math.floor(x + 0.5), math.floor(y + 0.5)
        if pixels is None or not (0 <= x < pixels.shape[1] and 0 <= y < pixels.shape[0]):
            return ""
        r, g, b, a = (int(v) for v in pixels[y, x])
        return f"{r} {g} {b}" if a == 255 else f"{r} {g} {b}, opacity {a / 255:.2f}"

    def _frame(self, frame: float) -> Pixels | None:
        return self.pixels

    def _source(self, deformation: Deformation | None, point: Point) -> Point:
        """Return the point T⁻¹(x), or x without strokes; the last one is cached."""
        if deformation is None or deformation.is_identity:
            return point
        last = self._under
        if last is None or last[0] is not deformation or last[1] != point:
            made = deformation.inverse(np.array([point[: deformation.ndim]], np.float64)).points[0]
            last = self._under = deformation, point, (*map(float, made), *point[deformation.ndim :])
        return last[2]


class VideoStage(ImageStage):
    """A clip."""

    kind = "video"

    def __init__(self, gpu: Gpu, film: FrameCache, time_scale: float = 1.0) -> None:
        self.film, self.rate, self.transform, self.turn = film, film.rate, film.transform, film.turn
        width, height = film.size
        self.shape, self.spacing = (film.count, height, width), (1.0, 1.0, time_scale)
        slots = max(2, min(film.most, Plate.most(gpu, film.size), film.count))
        self._name(film.name, film.size)
        self._plate = Plate(gpu, film.size, film.count, slots)
        self._by_cpu = False
        self._spans: dict[tuple[Deformation, float], Span] = {}

    def set_transform(self, name: str) -> None:
        """Set the view transform; frames are decoded again."""
        self.transform = name
        self.film.set_transform(name)
        self._plate.earliest = self._plate.held = 0

    def expect(self, deformations: tuple[Deformation, ...], sight: Sight) -> None:
        """Prepare the next drawing: request its frames together, since separate requests might displace each other."""
        time = sight.time
        needed = {(d, time): self._spans.get((d, time)) or self.needed(d, time) for d in deformations}
        self._spans, self.trouble, slots = needed, "", self._plate.slots
        most = max(last - first + 1 for first, last in needed.values())
        if most > slots:
            self.trouble = f"needs {most} frames at once, and {slots} are kept: export shows it whole"
        first, *others = (self._kept(span) for span in needed.values())
        self.film.want(*first, *others)

    def _kept(self, span: Span) -> Span:
        """Return as many frames as fit the device."""
        return span[0], min(span[1], span[0] + self._plate.slots - 1)

    def draw(self, deformation: Deformation, sight: Sight, texture: Any, encoder: Any = None) -> bool:
        """Draw the visible part of an expected frame, or record it into an encoder; return whether it is complete."""
        first, last = self._kept(self._spans[deformation, sight.time])
        ready = self._laid(first, last)
        if self._plate.held:
            self._drawn(deformation, sight, texture, encoder)
        if ready:
            return True
        self.trouble = self.film.error or self.trouble
        return bool(self.film.error)

    def _laid(self, first: int, last: int) -> bool:
        """Upload frames to the device; return whether all are there."""
        plate = self._plate
        for k in range(first, last + 1):
            if plate.earliest <= k < plate.earliest + plate.held:
                continue
            pixels = self.film.get(k)
            if pixels is None:
                return False
            plate.put(k, pixels)
        return True

    def needed(self, deformation: Deformation, time: float) -> tuple[int, int]:
        """Return the range of frames read for a frame, from points of a grid."""
        low = high = time
        if not deformation.is_identity and deformation.ndim == 3:
            width, height = self.size
            xs, ys = np.linspace(0, width - 1, 24), np.linspace(0, height - 1, 14)
            grid = np.stack(np.meshgrid(xs, ys, [time]), -1).reshape(-1, 3)
            times = deformation.inverse(grid).points[:, 2]
            low, high = float(times.min()), float(times.max())
            margin = 0.1 * (high - low)
            low, high = low - margin, high + margin
        last = self.film.count - 1
        return min(max(math.floor(low), 0), last), min(max(math.floor(high) + 1, 0), last)

    def _frame(self, frame: float) -> Pixels | None:
        return self.film.get(min(max(round(frame), 0), self.film.count - 1))


class VolumeStage:
    """A volume with a transfer function; of a series, one volume."""

    kind: Kind = "volume"

    def __init__(self, gpu: Gpu, volume: Volume, transfer: Transfer | str, samples: Any = None) -> None:
        self.name, self.volume = volume.name, volume
        self.preset = transfer if isinstance(transfer, str) else ""
        # Computed tomography is recognized by its values, as its preset is.
        labels = self.preset == LABELS or isinstance(transfer, LabelColours)
        self.unit = "HU" if self.preset.startswith("ct-") else "label" if labels else ""  # of values
        self.density: tuple[float, float] | None = None
        self.clip: Box | None = None
        self.mode = "hybrid"
        self._gpu = gpu
        self._samples = volume.rescaled() if samples is None else samples
        self.scene = self._made(transfer)
        self.shape, self.spacing = self.scene.shape, tuple(volume.geometry.spacing)
        counts, _ = np.histogram(self._samples, 96, self.scene.range)
        self.histogram = np.log1p(counts).astype(np.float32)  # logarithms of voxel counts by value
        self._plain = self.scene
        self._bent: dict[int, tuple[Deformation, Scene, str]] = {}  # the result (0), and its base (1); and a warning
        self.trouble = self.warned = ""  # a remark on the displayed image
        self._seconds = {False: 0.0, True: math.inf}  # of the last map without a freeze mask, and with one

    def _made(self, transfer: Transfer | str) -> Scene:
        device = "gpu" if self._gpu.software else "auto"
        scene = Scene(
            self._samples,
            self.volume.geometry,
            transfer=transfer,
            density=self.density,
            clip=self.clip,
            mode=self.mode,
            device=device,
        )
        if scene._held is None:
            raise SuppleError(f"{self.name} is more than a shader takes of {self._gpu.name}")
        return scene

    def set_mode(self, mode: str) -> None:
        """Set the mode of rendering."""
        self.mode = mode
        self._plain = self._made(self.scene.transfer)
        self.scene, self._bent = self._plain, {}

    def deform(self, deformation: Deformation, beside: int = 0) -> Scene:
        """Return the scene with strokes, of the result or of its base; the last one of each is cached."""
        if deformation.is_identity:
            return self._plain
        known = self._known(deformation)
        if known is None:
            said = [""]
            begun = time.perf_counter()
            with heard(lambda text, kind: said.append(text)):
                scene = self._plain.deformed(deformation)
            known = deformation, scene, said[-1]
            self._seconds[deformation.space.freeze is not None] = time.perf_counter() - begun
        self._bent[beside] = known
        if not beside:
            _, self.scene, self.warned = known
        return known[1]

    def _known(self, deformation: Deformation) -> tuple[Deformation, Scene, str] | None:
        return next((known for known in self._bent.values() if known[0] is deformation), None)

    def is_slow(self, deformation: Deformation) -> bool:
        """Return whether drawing through strokes would take long: as the last ones did, unless these are known."""
        if deformation.is_identity or self._known(deformation) is not None:
            return False
        return self._seconds[deformation.space.freeze is not None] > SLOW

    def on_canvas(self, deformation: Deformation) -> Scene:
        """Return the scene with strokes; the one before, which is still seen, while that would take long."""
        return self.scene if self.is_slow(deformation) else self.deform(deformation)

    def look(self, transfer: Transfer | str, density: tuple[float, float] | None) -> None:
        """Set another transfer function."""
        self.preset, self.density = transfer if isinstance(transfer, str) else "", density
        self._change(lambda scene: scene.seen_through(transfer, density))

    def cut(self, clip: Box | None) -> None:
        """Render the volume within another box; all of it for None."""
        self.clip = clip
        self._change(lambda scene: scene.clipped(clip))

    def _change(self, change: Callable[[Scene], Scene]) -> None:
        self._plain = change(self._plain)
        self._bent = {k: (made, change(scene), said) for k, (made, scene, said) in self._bent.items()}
        self.scene = self._bent[0][1] if 0 in self._bent else self._plain

    def draw(
        self,
        deformation: Deformation,
        camera: Camera,
        size: tuple[int, int],
        texture: Any,
        overlay: str = "",
        beside: int = 0,
    ) -> None:
        """Render into a texture of columns and rows; by the CPU, without an overlay, what the device cannot."""
        scene, (columns, rows) = self.deform(deformation, beside), size
        if scene.gpu is not None:
            scene.draw(texture, camera, (rows, columns), background=BACK, overlay=overlay)
            return
        pixels = np.full((rows, columns, 4), 255, np.uint8)
        pixels[..., :3] = scene.render(camera, (rows, columns)).pixels(BACK)
        filled(self._gpu, texture, pixels)

    def fill(self, deformation: Deformation, seconds: float) -> float:
        """Fill a part of the buffer; return the filled part."""
        if deformation.is_identity:
            return 1.0
        return self.deform(deformation).fill(seconds=seconds)

    def value(self, pick: Pick) -> Any:
        """Return the value of a picked voxel."""
        last = [n - 1 for n in reversed(self.shape)]
        x, y, z = np.clip(np.floor(np.array(pick.source) + 0.5), 0, last).astype(int)
        return self._samples[z, y, x]

    def place(self, point: Point) -> str:
        """Return the position of a voxel on screen, in millimetres."""
        geometry = self.volume.geometry
        place = ", ".join(f"{round(v, 1) + 0.0:.1f}" for v in geometry.to_world(point).tolist())
        return f"({place}) mm {geometry.convention}"


def filled(gpu: Gpu, texture: Any, pixels: Pixels) -> Any:
    """Return a texture with pixels (rows, columns, 4): the given one, or a new one if there is none of their size."""
    rows, columns = pixels.shape[:2]
    if texture is None or texture.size[:2] != (columns, rows):
        usage = "TEXTURE_BINDING|COPY_DST"
        texture = gpu.device.create_texture(size=(columns, rows, 1), format="rgba8unorm", usage=usage)
    layout = {"bytes_per_row": 4 * columns, "rows_per_image": rows}
    gpu.device.queue.write_texture({"texture": texture}, pixels, layout, (columns, rows, 1))
    return texture
