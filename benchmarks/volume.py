"""What volumes cost: against SciPy, SimpleITK and VTK; and pictures of them in three ways."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from measure import Line, against, alone, cpu, figure, grid_of, psnr, seconds, wall
from pictures import DATA, named, peak_above
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


def field_of(d: supple.Deformation, sources: Array) -> Any:
    """Return a transform by a displacement field, of float64 as SimpleITK has them."""
    return sitk.DisplacementFieldTransform(sitk.GetImageFromArray(sources - grid_of(d.shape), isVector=True))


def against_scipy(runs: int, n: int, border: Border) -> Line:
    """Deform float32, linear, against sampling with the map in hand; both write to arrays that are there."""
    volume, d = noise(n), bent(n, border)
    out, theirs = np.empty_like(volume), np.empty_like(volume)
    places = np.ascontiguousarray(np.moveaxis(d.inverse_map(), -1, 0)[::-1])
    return against(
        f"{n}³ float32, one stroke, {named({'filter': 'linear'}, border, None)}: ours / `scipy` map_coordinates, map "
        "in hand, its one thread",
        lambda: d.warp(volume, filter="linear", out=out),
        lambda: ndimage.map_coordinates(volume, places, output=theirs, order=1, mode="nearest"),
        wall,
        runs,
        0.1,
    )


def against_itk(runs: int, n: int, kind: type, options: dict[str, Any], border: Border, bar: float | None) -> Line:
    """Deform a volume against SimpleITK's linear resampling with the field made, two threads each."""
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(2)
    volume, d = (noise(n) * (1000 if kind is np.int16 else 1)).astype(kind), bent(n, border)
    image, transform = sitk.GetImageFromArray(volume), field_of(d, d.inverse_map())
    return against(
        f"{n}³ {np.dtype(kind)}, one stroke, {named(options, border, None)}: "
        "ours / SimpleITK Resample, linear, field made",
        lambda: d.warp(volume, **options),
        lambda: sitk.Resample(image, image, transform, sitk.sitkLinear, 0.0),
        wall,
        runs,
        bar,
    )


def whole_warps(runs: int, n: int) -> Iterator[Line]:
    """Deforming a volume, map and all."""
    yield against_itk(runs, n, np.int16, {}, "auto", 0.5)
    yield against_scipy(runs, n, "auto")


def more_warps(runs: int, sizes: tuple[int, ...]) -> Iterator[Line]:
    """Free borders, and float32 against SimpleITK."""
    yield against_scipy(runs, sizes[-1], None)
    for n in sizes:
        yield against_itk(runs, n, np.float32, {"filter": "linear"}, "auto", None)
        yield against_itk(runs, n, np.float32, {"filter": "linear"}, None, 0.4)


def borders(runs: int) -> Iterator[Line]:
    """The default border against a free one, for the same stroke in short, thin and long domains."""
    thin = (8, 270, 480), (40, 270, 480), (300, 135, 240), (12, 256, 256), (20, 256, 256)
    for shape in (*thin, (128, 128, 128), (300, 12000)):
        size, radius = np.array(shape[::-1]) - 1.0, 0.2 * min(shape[-2:])
        by = np.eye(len(shape))[0] * 0.5 * radius
        samples = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
        out = np.empty_like(samples)
        both = [supple.Deformation(shape, border=b).grab(size / 2, by=by, radius=radius) for b in ("auto", None)]
        works = [lambda d=d, samples=samples, out=out: d.warp(samples, out=out) for d in both]
        what = f"`warp` of uint8, {'×'.join(map(str, shape))}, radius {radius:.0f}, drag {radius / 2:.0f}"
        yield against(f"{what}: default border / free border", *works, wall, runs, 2.0)


def inverted_fields(runs: int, n: int) -> Iterator[Line]:
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

    yield against(
        f"{n}³ float32, one stroke, linear, default border: ours / SimpleITK InvertDisplacementField + Resample",
        lambda: d.warp(volume, filter="linear"),
        theirs,
        wall,
        runs,
        1 / 250,
        warm=0,
    )
    truth = d.inverse(grid).points
    off = float(np.linalg.norm(found[0] + grid - truth, axis=-1).max())
    own = d.report().error
    what = "the same, worst error of the inverse, in voxels: ours / SimpleITK's"
    yield figure(what, own / off, "×", 0.01, ours=f"{own:.4f}", peer=f"{off:.2f}")


def registered_points(runs: int) -> Iterator[Line]:
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
        work = partial(d.certified, points, inverse=inverse)
        way = "back: 20 strokes are solved" if inverse else "forward: the field is solved"
        what = f"{n:,} points through an affine map, a field and 20 strokes, {way}; CPU time, each with its error"
        taken = alone(work, cpu, runs)
        yield Line(what, taken, f"error ≤ {work().error.max():.1g} mm", taken, "s", bar=1)


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


def pictures(runs: int) -> Iterator[Line]:
    """Pictures of 512² of the head, as it is and bent: warped first, and with every sample inverted."""
    volume = head()
    scene = Scene(volume, FACE, transfer=PRESETS["mr-head"], step=1.0)
    yield against(
        "picture of 512² of the 181×217×181 head, step of a voxel, shaded: ours / VTK's fixed point ray caster",
        lambda: scene.render(CAMERA),
        vtk_picture(volume, scene),
        wall,
        runs,
        0.6,
    )
    d = supple.Deformation(volume.shape).grab((90, 190, 70), by=(25, 20, 0), radius=35)
    exact = Scene(volume, FACE, deformation=d, transfer=PRESETS["mr-head"], mode="exact")
    start = time.perf_counter()
    made = Scene(volume, FACE, deformation=d, transfer=PRESETS["mr-head"])
    spent = seconds(time.perf_counter() - start)
    yield against(
        f"the same head with a stroke: buffered (made before, in {spent}) / exact, every sample inverted",
        lambda: made.render(CAMERA),
        lambda: exact.render(CAMERA),
        wall,
        runs,
        0.2,
    )
    seen, true = (s.render(CAMERA).pixels((0.1, 0.1, 0.1)) for s in (made, exact))
    yield figure("the same, buffered against exact", psnr(seen, true), "dB", -35)


def grain() -> Iterator[Line]:
    """Pictures of 400² at the default step against a tenth of it, where shells of values and surfaces show grain."""
    volume = open_volume(DATA / "head.nii.gz")
    for density, least in ((None, -38.0), ((60.0, 120.0), None), ((90.0, 110.0), None)):
        made = []
        for step in (None, 0.1 * min(volume.geometry.spacing)):
            scene = Scene(volume.samples, volume.geometry, transfer="mr-head", density=density, step=step)
            camera = scene.framed(Camera(40, 20), (400, 400))
            made.append(scene.render(camera, (400, 400)).pixels((0.0, 0.0, 0.0)))
        values = "" if density is None else " of values from {:g} to {:g}".format(*density)
        what = f"picture of 400² of the shipped head{values}, default step against a tenth of it"
        yield figure(what, psnr(*made), "dB", least)


def memory(here: Path, quick: bool) -> Iterator[Line]:
    """The peak of a whole command on a large volume, above that of one on a small volume."""
    commands, sizes = [], ((32, 32, 32), (200, 256, 256) if quick else (500, 512, 512))
    for shape in sizes:
        samples = np.zeros(shape, np.int16)
        samples[:, ::7, ::5] = 100
        source = here / f"{shape[0]}.nii"
        media.write(source, samples, media.Volume(samples, Geometry()))
        start, end = (",".join(str(n // 2 + by) for n in reversed(shape)) for by in (0, 3))
        stroke = ["--grab", f"{start}:{end}", "--radius", "9", "--filter", "linear", "--force"]
        commands.append([str(source), str(here / "o.nii"), *stroke])
    data = 2 * samples.nbytes / 1e6
    yield peak_above(f"{'×'.join(map(str, shape))} int16, above one of 32³", commands, data, 200)
    source.unlink()
