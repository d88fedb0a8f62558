"""What volumes cost: against SciPy, SimpleITK and VTK; and pictures of them in three ways."""

from __future__ import annotations

import shutil
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from measure import Row, milliseconds, pair, run, timed
from reference import psnr
from scipy import ndimage

import supple
from supple.camera import Camera
from supple.geometry import Geometry
from supple.media import volume as media
from supple.rendering import MODES, Scene
from supple.transfer import PRESETS

Array = npt.NDArray[Any]

DATA = Path(supple.__file__).parent / "data"
FACE = Geometry(direction=np.diag([-1.0, -1.0, 1.0]), convention="RAS")
CAMERA = Camera(30, 10)


def head() -> npt.NDArray[np.uint8]:
    """The shipped head, enlarged to a millimetre: 181 x 217 x 181 voxels."""
    small = media.read(DATA / "head.nii.gz").samples
    return np.rint(ndimage.zoom(small.astype(np.float32), 2 - 1 / np.array(small.shape), order=1)).astype(np.uint8)


def noise(n: int) -> npt.NDArray[np.float32]:
    rng = np.random.default_rng(0)
    return ndimage.gaussian_filter(rng.random((n, n, n), np.float32), 1.5)


def bent(n: int, border: float | None) -> supple.Deformation:
    d = supple.Deformation((n, n, n), border=border)
    return d.grab((n / 2, n / 2, n / 2), by=(0.08 * n, 0.04 * n, -0.03 * n), radius=0.24 * n)


def field_of(d: supple.Deformation, sources: Array) -> Any:
    """A transform by a displacement field, of float64 as SimpleITK has them."""
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in d.shape), indexing="ij")[::-1], axis=-1)
    return sitk.DisplacementFieldTransform(sitk.GetImageFromArray((sources - grid).astype(np.float64), isVector=True))


def whole_warps(runs: int, quick: bool) -> list[Row]:
    """Deforming a volume of float32, against resampling it with the map made."""
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(2)
    rows = []
    sizes = (128,) if quick else (128, 256)
    for n in sizes:
        volume = noise(n)
        image = sitk.GetImageFromArray(volume)
        for border in (None, 50.0):
            d, out = bent(n, border), np.empty_like(volume)
            sources = d.inverse_map()
            places = np.ascontiguousarray(np.moveaxis(sources, -1, 0)[::-1])
            transform = field_of(d, sources)
            name = f"{n}³ float32, one stroke, linear, {'free border' if border is None else 'fixed border of 50'}"

            def ours(d: supple.Deformation = d, volume: Array = volume, out: Array = out) -> None:
                d.warp(volume, filter="linear", out=out)

            def scipy(volume: Array = volume, places: Array = places) -> None:
                ndimage.map_coordinates(volume, places, order=1, mode="nearest")

            def itk(image: Any = image, transform: Any = transform) -> None:
                sitk.Resample(image, image, transform, sitk.sitkLinear, 0.0)

            free = border is None
            if n == sizes[-1]:
                bar = 0.10 if free else None
                rows.append(
                    timed(f"{name}: ours / scipy map_coordinates, map made, one thread", ours, scipy, runs, bar)
                )
            rows.append(
                timed(f"{name}: ours / SimpleITK Resample, field made", ours, itk, runs, 0.40 if free else None)
            )
    return rows


def inverted_fields(runs: int, quick: bool) -> list[Row]:
    """Against inverting a displacement field and resampling by it."""
    n = 64 if quick else 128
    volume = noise(n)
    image = sitk.GetImageFromArray(volume)
    d = bent(n, 50.0)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in d.shape), indexing="ij")[::-1], axis=-1).astype(np.float64)
    forward = sitk.GetImageFromArray(d.forward(grid) - grid, isVector=True)
    found: list[Any] = []

    def theirs() -> None:
        # As exact as ours is asked to be; by default it stops after 10 iterations.
        inverse = sitk.InvertDisplacementField(forward, 200, 0.01, 0.001, True)
        found[:] = [sitk.GetArrayFromImage(inverse)]
        sitk.Resample(image, image, sitk.DisplacementFieldTransform(inverse), sitk.sitkLinear, 0.0)

    out = np.empty_like(volume)
    a, b, ratio = pair(lambda: d.warp(volume, filter="linear", out=out), theirs, runs)
    truth = d.inverse(grid).points
    off = float(np.linalg.norm(found[0] + grid - truth, axis=-1).max())
    own = d.report().error
    what = f"{n}³ float32, one stroke, linear, fixed border of 50"
    return [
        Row(
            f"{what}: SimpleITK InvertDisplacementField + Resample / ours",
            milliseconds(a),
            milliseconds(b),
            f"{1 / ratio:.0f}×",
            "≥ 250×",
            1 / ratio >= 250,
            runs,
        ),
        Row(
            "the same, worst error of the inverse: SimpleITK's / ours, in voxels",
            f"{own:.4f}",
            f"{off:.2f}",
            f"{off / own:.0f}×",
            "≥ 100×",
            off / own >= 100,
            1,
        ),
    ]


def vtk_picture(volume: Array, scene: Scene) -> Callable[[], None]:
    """What draws the same by VTK's ray caster on the processor: same camera, transfer function, step, and shading."""
    import vtk
    from vtk.util import numpy_support

    vtk.vtkObject.GlobalWarningDisplayOff()
    vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)
    data = vtk.vtkImageData()
    data.SetDimensions(*volume.shape[::-1])
    data.GetPointData().SetScalars(numpy_support.numpy_to_vtk(volume.ravel(), deep=True))
    mapper = vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputData(data)
    mapper.SetSampleDistance(scene.step)
    mapper.SetInteractiveSampleDistance(scene.step)
    mapper.AutoAdjustSampleDistancesOff()
    mapper.SetImageSampleDistance(1.0)
    mapper.SetMinimumImageSampleDistance(1.0)
    mapper.SetMaximumImageSampleDistance(1.0)
    mapper.SetNumberOfThreads(2)
    mapper.IntermixIntersectingGeometryOff()
    colours, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
    low, high = scene.range
    for value, red, green, blue, alpha in scene.transfer.points:
        place = low + value * (high - low) if scene.transfer.relative else value
        colours.AddRGBPoint(place, red, green, blue)
        opacity.AddPoint(place, alpha)
    look = vtk.vtkVolumeProperty()
    look.SetColor(colours)
    look.SetScalarOpacity(opacity)
    look.ShadeOn()
    look.SetInterpolationTypeToLinear()
    actor = vtk.vtkVolume()
    actor.SetMapper(mapper)
    actor.SetProperty(look)
    renderer, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
    renderer.AddVolume(actor)
    window.SetOffScreenRendering(1)
    window.SetSize(512, 512)
    window.AddRenderer(renderer)
    view, camera = scene.view(CAMERA, (512, 512)), renderer.GetActiveCamera()
    camera.SetPosition(*view.eye)
    camera.SetFocalPoint(*(view.eye + 100 * view.ahead))
    camera.SetViewUp(*-view.packed[4])
    camera.SetViewAngle(CAMERA.field_of_view)
    renderer.ResetCameraClippingRange()

    def draw() -> None:
        camera.Modified()
        mapper.Modified()
        window.Render()

    return draw


def pictures(runs: int) -> list[Row]:
    """Pictures of 512² of the head."""
    volume = head()
    scene = Scene(volume, FACE, transfer=PRESETS["mr-head"], step=1.0)
    rows = [
        timed(
            "picture of 512² of the 181×217×181 head, step of a voxel, shaded: ours / VTK's fixed point ray caster",
            lambda: scene.render(CAMERA),
            vtk_picture(volume, scene),
            runs,
            1.0,
        )
    ]
    d = supple.Deformation(volume.shape).grab((90, 190, 70), by=(25, 20, 0), radius=35)
    scenes, taken, made = {}, {}, {}
    for mode in MODES[:3]:
        made[mode] = 0.0
        for _ in range(2):  # the first one compiles
            start = time.perf_counter()
            scenes[mode] = Scene(volume, FACE, deformation=d, transfer=PRESETS["mr-head"], mode=mode)
            made[mode] = time.perf_counter() - start
        taken[mode] = scenes[mode].render(CAMERA)
    seen = {mode: picture.pixels((0.1, 0.1, 0.1)).astype(np.float64) for mode, picture in taken.items()}
    for mode, bar in (("lattice", 5.0), ("buffered", None)):
        a, b, ratio = pair(lambda mode=mode: scenes[mode].render(CAMERA), lambda: scenes["exact"].render(CAMERA), runs)
        rows.append(
            Row(
                f"the same head with a stroke: exact, every sample inverted / {mode} (made before, in "
                f"{milliseconds(made[mode])})",
                milliseconds(a),
                milliseconds(b),
                f"{1 / ratio:.1f}×",
                f"≥ {bar:g}×" if bar else "",
                1 / ratio >= bar if bar else None,
                runs,
            )
        )
        quality = psnr(seen[mode], seen["exact"])
        wanted = 45.0 if mode == "lattice" else None
        rows.append(
            Row(
                f"the same, {mode} against exact",
                f"{quality:.1f} dB",
                "",
                "",
                f"≥ {wanted:g} dB" if wanted else "",
                quality >= wanted if wanted else None,
                1,
            )
        )
    return rows


def memory(here: Path, quick: bool) -> list[Row]:
    """The peak of a whole command on a large volume, above that of one on a small volume."""
    command = [shutil.which("supple", path=str(Path(sys.executable).parent)) or "supple", "warp"]
    peaks, sizes = [], ((32, 32, 32), (200, 256, 256) if quick else (500, 512, 512))
    for k, shape in enumerate(sizes):
        samples = np.zeros(shape, np.int16)
        samples[:, ::7, ::5] = 100
        source = here / f"{k}.nii"
        media.write(source, samples, media.Volume(samples, Geometry()))
        middle = ",".join(str(n // 2) for n in reversed(shape))
        grab = ["--grab", f"{middle}:{','.join(str(n // 2 + 3) for n in reversed(shape))}", "--radius", "9"]
        peaks.append(
            min(
                run([*command, str(source), str(here / "o.nii"), *grab, "--filter", "linear", "--force"])[1]
                for _ in range(2)
            )
        )
        source.unlink()
    data = 2 * int(np.prod(sizes[1])) * 2 / 1e6
    more = peaks[1] - peaks[0]
    return [
        Row(
            f"peak memory of `supple warp`, {'×'.join(map(str, sizes[1]))} int16, "
            f"above one of 32³ (input and output: {data:.0f} MB)",
            f"{more:.0f} MB",
            "",
            f"data {more - data:+.0f} MB",
            f"≤ {data + 200:.0f} MB",
            more <= data + 200,
            2,
        )
    ]


def all_rows(here: Path, runs: int, quick: bool) -> list[Callable[[], list[Row]]]:
    warnings.simplefilter("ignore", DeprecationWarning)  # VTK's own
    return [
        lambda: whole_warps(max(5, runs // 3), quick),
        lambda: inverted_fields(1 if quick else 3, quick),
        lambda: pictures(max(5, runs // 3)),
        lambda: memory(here, quick),
    ]


__all__ = ["all_rows"]
