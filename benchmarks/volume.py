"""What volumes cost: against SciPy, SimpleITK and VTK; and pictures of them in three ways."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from measure import Row, faster, milliseconds, run, timed
from reference import psnr
from scipy import ndimage

import supple
from supple.files.volumes import open_volume
from supple.media import volume as media
from supple.render.camera import Camera
from supple.render.scene import Scene
from supple.render.transfer import PRESETS
from supple.space.domain import Border
from supple.space.geometry import Geometry

Array = npt.NDArray[Any]

DATA = Path(supple.__file__).parent / "examples" / "data"
FACE = Geometry(direction=np.diag([-1.0, -1.0, 1.0]), convention="RAS")
CAMERA = Camera(30, 10)


def head() -> npt.NDArray[np.uint8]:
    """The shipped head, enlarged to a millimetre: 181 x 217 x 181 voxels."""
    small = media.read(DATA / "head.nii.gz").samples
    return np.rint(ndimage.zoom(small.astype(np.float32), 2 - 1 / np.array(small.shape), order=1)).astype(np.uint8)


def noise(n: int) -> npt.NDArray[np.float32]:
    rng = np.random.default_rng(0)
    return ndimage.gaussian_filter(rng.random((n, n, n), np.float32), 1.5)


def bent(n: int, border: Border) -> supple.Deformation:
    d = supple.Deformation((n, n, n), border=border)
    return d.grab((n / 2, n / 2, n / 2), by=(0.08 * n, 0.04 * n, -0.03 * n), radius=0.24 * n, reach=None)


def named(border: Border) -> str:
    return "free border" if border is None else "default border"


def grid_of(shape: tuple[int, ...]) -> Array:
    """Return the points of all voxels, x first."""
    return np.stack(np.meshgrid(*(np.arange(float(n)) for n in shape), indexing="ij")[::-1], axis=-1)


def field_of(d: supple.Deformation, sources: Array) -> Any:
    """Return a transform by a displacement field, of float64 as SimpleITK has them."""
    return sitk.DisplacementFieldTransform(sitk.GetImageFromArray(sources - grid_of(d.shape), isVector=True))


def against_scipy(runs: int, n: int, border: Border, bar: float, before: str) -> Row:
    """Deform float32, linear, against sampling with the map in hand; both write to arrays that are there."""
    volume, d = noise(n), bent(n, border)
    out, theirs = np.empty_like(volume), np.empty_like(volume)
    places = np.ascontiguousarray(np.moveaxis(d.inverse_map(), -1, 0)[::-1])
    return timed(
        f"{n}³ float32, one stroke, linear, {named(border)}, reach=None: ours / `scipy` map_coordinates, map in hand, "
        "its one thread",
        lambda: d.warp(volume, filter="linear", out=out),
        lambda: ndimage.map_coordinates(volume, places, output=theirs, order=1, mode="nearest"),
        runs,
        bar,
        before=before,
    )


def against_itk(
    runs: int, n: int, kind: type, filter: str | None, border: Border, bar: float | None, before: str
) -> Row:
    """Deform a volume against SimpleITK's linear resampling with the field made, two threads each."""
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(2)
    volume, d = (noise(n) * (1000 if kind is np.int16 else 1)).astype(kind), bent(n, border)
    image, transform = sitk.GetImageFromArray(volume), field_of(d, d.inverse_map())
    asked = {} if filter is None else {"filter": filter}
    return timed(
        f"{n}³ {np.dtype(kind)}, one stroke, {filter or 'default'} filter, {named(border)}, reach=None: "
        "ours / SimpleITK Resample, linear, field made",
        lambda: d.warp(volume, **asked),
        lambda: sitk.Resample(image, image, transform, sitk.sitkLinear, 0.0),
        runs,
        bar,
        before=before,
    )


def whole_warps(runs: int, n: int) -> Iterator[Row]:
    """Deforming a volume, map and all."""
    yield against_itk(runs, n, np.int16, None, "auto", 0.5, "0.6")
    yield against_scipy(runs, n, "auto", 0.1, "0.16")


def more_warps(runs: int, sizes: tuple[int, ...]) -> Iterator[Row]:
    """Free borders, and float32 against SimpleITK."""
    yield against_scipy(runs, sizes[-1], None, 0.1, "0.09")
    figures = {(128, "auto"): "0.36", (128, None): "0.28", (256, "auto"): "0.18", (256, None): "0.10"}
    for n in sizes:
        for border in ("auto", None):
            bar = 0.4 if border is None else None
            yield against_itk(runs, n, np.float32, "linear", border, bar, figures[n, border])


def borders(runs: int) -> Iterator[Row]:
    """The default border against a free one, for the same stroke in short, thin and long domains."""
    for shape, part, before in (
        ((8, 270, 480), 0.2, ""),
        ((40, 270, 480), 0.2, "9–14"),
        ((300, 135, 240), 0.2, ""),
        ((12, 256, 256), 0.2, "17–46"),
        ((20, 256, 256), 0.2, "17–46"),
        ((128, 128, 128), 0.2, ""),
        ((300, 12000), 0.2, ""),
    ):
        size = np.array(shape[::-1]) - 1.0
        radius = part * min(shape[-2:])
        by = np.eye(len(shape))[0] * 0.5 * radius
        made = [supple.Deformation(shape, border=b).grab(tuple(size / 2), by=tuple(by), radius=radius)
                for b in ("auto", None)]  # fmt: skip
        samples = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
        outs = [np.empty_like(samples) for _ in made]
        yield timed(
            f"`warp` of uint8, {'×'.join(map(str, shape))}, radius {radius:.0f}, drag {radius / 2:.0f}: "
            "default border / free border",
            lambda made=made, samples=samples, outs=outs: made[0].warp(samples, out=outs[0]),
            lambda made=made, samples=samples, outs=outs: made[1].warp(samples, out=outs[1]),
            runs,
            2.0,
            before=before,
        )


def inverted_fields(runs: int, n: int) -> Iterator[Row]:
    """Against inverting a displacement field and resampling by it."""
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(2)
    volume, d = noise(n), bent(n, "auto")
    image, grid = sitk.GetImageFromArray(volume), grid_of(d.shape)
    forward = sitk.GetImageFromArray(d.forward(grid) - grid, isVector=True)
    found: list[Any] = []

    def theirs() -> None:
        # As exact as ours is asked to be; by default it stops after 10 iterations.
        inverse = sitk.InvertDisplacementField(forward, 200, 0.01, 0.001, True)
        found[:] = [sitk.GetArrayFromImage(inverse)]
        sitk.Resample(image, image, sitk.DisplacementFieldTransform(inverse), sitk.sitkLinear, 0.0)

    yield faster(
        f"{n}³ float32, one stroke, linear, {named('auto')}: SimpleITK InvertDisplacementField + Resample / ours",
        lambda: d.warp(volume, filter="linear"),
        theirs,
        runs,
        250.0,
        before="707×",
        warm=False,
    )
    truth = d.inverse(grid).points
    off = float(np.linalg.norm(found[0] + grid - truth, axis=-1).max())
    own = d.report().error
    yield Row(
        "the same, worst error of the inverse: SimpleITK's / ours, in voxels",
        f"{own:.4f}",
        f"{off:.2f}",
        f"{off / own:.0f}×",
        "≥ 100×",
        off / own >= 100,
        before="518×",
    )


def registered_points(runs: int) -> Iterator[Row]:
    """Landmarks through an affine map, a field and strokes, both ways: CPU time, as one of the two solves the field."""
    rng, n = np.random.default_rng(0), 100_000
    grid = supple.Grid((160, 192, 160), (1.2, 1.0, 1.1), (-90.0, -120.0, -70.0))
    waves = np.stack([ndimage.gaussian_filter(rng.normal(size=grid.shape), 10) for _ in range(3)], axis=-1)
    field = supple.Field((6 / np.abs(waves).max() * waves).astype(np.float32), grid)
    d = supple.Deformation(grid).affine([[1, 0.05, 0, 3], [0, 1, 0, -2], [0, 0, 1, 1]]).field(field)
    for at in rng.uniform(30, 130, (20, 3)).tolist():
        d = d.add(supple.Stroke.grab(at, by=(rng.normal(size=3) * 4).tolist(), radius=25), warn=False)
    points = rng.uniform(20, 140, (n, 3))
    for inverse in (False, True):
        taken = []
        for _ in range(runs):
            began = time.process_time()
            found = d.certified(points, inverse=inverse)
            taken.append(time.process_time() - began)
        middle, worst = float(np.median(taken)), found.error.max()
        way = "back: 20 strokes are solved" if inverse else "forward: the field is solved"
        yield Row(
            f"{n:,} points through an affine map, a field and 20 strokes, {way}; CPU time, each with its error",
            f"{milliseconds(middle)}, error ≤ {worst:.1g} mm", bar="≤ 1 s", holds=middle <= 1, runs=runs,
        )  # fmt: skip


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


def pictures(runs: int) -> Iterator[Row]:
    """Pictures of 512² of the head, as it is and bent."""
    volume = head()
    scene = Scene(volume, FACE, transfer=PRESETS["mr-head"], step=1.0)
    yield timed(
        "picture of 512² of the 181×217×181 head, step of a voxel, shaded: ours / VTK's fixed point ray caster",
        lambda: scene.render(CAMERA),
        vtk_picture(volume, scene),
        runs,
        0.6,
        before="0.69",
    )
    yield from against_exact(runs, volume)


def grain() -> Iterator[Row]:
    """Pictures of 400² at the default step against a tenth of it, where shells of values and surfaces show grain."""
    volume = open_volume(DATA / "head.nii.gz")
    for name, density, least in (("", None, 38.0), (" of values from 60 to 120", (60.0, 120.0), None), (
        " of values from 90 to 110", (90.0, 110.0), None,
    )):  # fmt: skip
        made = []
        for step in (None, 0.1 * min(volume.geometry.spacing)):
            scene = Scene(volume.samples, volume.geometry, transfer="mr-head", density=density, step=step)
            camera = scene.framed(Camera(40, 20), (400, 400))
            made.append(scene.render(camera, (400, 400)).pixels((0.0, 0.0, 0.0)).astype(np.float64))
        quality = psnr(*made)
        yield Row(
            f"picture of 400² of the shipped head{name}, default step against a tenth of it",
            f"{quality:.1f} dB",
            bar=f"≥ {least:g} dB" if least else "",
            holds=quality >= least if least else None,
        )


def against_exact(runs: int, volume: Array) -> Iterator[Row]:
    """Compare drawing the bent head, warped first, with inverting every sample: in time, and in what is seen."""
    d = supple.Deformation(volume.shape).grab((90, 190, 70), by=(25, 20, 0), radius=35)
    exact = Scene(volume, FACE, deformation=d, transfer=PRESETS["mr-head"], mode="exact")
    start = time.perf_counter()
    scene = Scene(volume, FACE, deformation=d, transfer=PRESETS["mr-head"])
    made = milliseconds(time.perf_counter() - start)
    yield faster(
        f"the same head with a stroke: exact, every sample inverted / buffered (made before, in {made})",
        lambda: scene.render(CAMERA),
        lambda: exact.render(CAMERA),
        runs,
        5.0,
        before="8.5×",
    )
    seen, true = (s.render(CAMERA).pixels((0.1, 0.1, 0.1)).astype(np.float64) for s in (scene, exact))
    quality = psnr(seen, true)
    yield Row(
        "the same, buffered against exact",
        f"{quality:.1f} dB",
        bar="≥ 35 dB",
        holds=quality >= 35.0,
        before="44.5 dB",
    )


def memory(here: Path, quick: bool) -> Iterator[Row]:
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
    yield Row(
        f"peak memory of `supple warp`, {'×'.join(map(str, sizes[1]))} int16, "
        f"above one of 32³ (input and output: {data:.0f} MB)",
        f"{more:.0f} MB",
        value=f"data {more - data:+.0f} MB",
        bar=f"≤ {data + 200:.0f} MB",
        holds=more <= data + 200,
        runs=2,
        before="" if quick else "530 MB",
    )


__all__ = ["borders", "inverted_fields", "memory", "more_warps", "pictures", "whole_warps"]
