"""Make the pictures of the README and the documentation, in docs/images.

python docs/make_images.py [how-to] [augmentation] [labels] [smooth] [planes] [colours] [straightened]     all, or some

The wall needs scikit-image.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyvips
import SimpleITK as sitk  # noqa: N813
from scipy import ndimage

import supple
from supple.augment import RandomElastic, apply
from supple.files.jobs import Job
from supple.files.options import VolumeOptions
from supple.files.plots import plot_file
from supple.files.tracking import follow_tracks
from supple.files.volumes import open_volume
from supple.media import image
from supple.media.faces import read_faces
from supple.plot import figure
from supple.render.annotate import annotated
from supple.render.camera import Camera
from supple.render.labels import LabelColours, palette
from supple.render.meshes import Surface
from supple.render.scene import Scene
from supple.space.straighten import FRAMES

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "examples"))
import asymmetry  # noqa: E402
import head  # noqa: E402
import heart  # noqa: E402
import modes  # noqa: E402
import smile  # noqa: E402

WHITE, RED = [255] * 3, (230, 50, 40)
DATA = Path(supple.__file__).parent / "examples" / "data"


def rendered(deformation: supple.Deformation, what: str, photo: image.Array | None = None) -> pyvips.Image:
    """Draw a plot in memory."""
    with io.BytesIO() as png:
        figure(deformation, what, image=photo).savefig(png, format="png", dpi=80)
        return pyvips.Image.new_from_buffer(png.getvalue(), "").flatten(background=255)


def bunny_smiles(folder: Path) -> None:
    """One frame of the clip, before and after, from near by."""
    ((_, sulks),) = smile.frames_of(smile.CLIP, (smile.FRAME,))
    smiles = supple.Deformation.from_recipe(smile.recipe(smile.SMILE), sulks.shape[:2]).warp(sulks)
    faces = [np.ascontiguousarray(pixels[smile.FACE]) for pixels in (sulks, smiles)]
    pair = [pyvips.Image.new_from_array(face).resize(2.5, kernel="cubic") for face in faces]
    pyvips.Image.arrayjoin(pair, shim=8, background=WHITE).jpegsave(folder / "smile.jpg", Q=80, keep="none")


def followed(folder: Path) -> None:
    """An arm that swings down: in the clip, and delayed, with the mixture of frames, and along the motion."""
    before = np.array([pixels for _, pixels in smile.frames_of(smile.CLIP, range(64))])
    d = supple.Deformation(before.shape[:3], spacing=(1, 1, 10), time=True)
    d = d.grab((350, 140, 32), by=(0, 0, 8), radius=130)
    late = [d.warp(before, between=between)[38] for between in ("linear", "flow")]
    parts = [np.ascontiguousarray(frame[170:350, 40:280]) for frame in (before[34], *late)]
    row = [pyvips.Image.new_from_array(part).resize(1.5, kernel="cubic") for part in parts]
    pyvips.Image.arrayjoin(row, shim=8, background=WHITE).jpegsave(folder / "flow.jpg", Q=80, keep="none")


def time_filtered(folder: Path) -> None:
    """An arm that comes down within a few frames, delayed so that time is compressed there, without and with a filter.

    Above a column of pixels over time, below a frame.
    """
    before = np.array([pixels for _, pixels in smile.frames_of(smile.CLIP, range(64))])
    d = supple.Deformation(before.shape[:3], spacing=(1, 1, 8), border=None)
    d = d.grab((110, 190, 26), by=(0, 0, 24), radius=96)
    after, filtered = d.warp(before), d.warp(before, time_filter=True)
    cuts = [np.swapaxes(clip[24:64, 110:300, 110], 0, 1) for clip in (before, after, filtered)]
    frames = [clip[k, 110:300, 10:210] for clip, k in ((before, 37), (after, 51), (filtered, 51))]
    rows = [
        *(
            pyvips.Image.new_from_array(np.ascontiguousarray(cut)).resize(7.5, vscale=1, kernel="nearest")
            for cut in cuts
        ),
        *(pyvips.Image.new_from_array(np.ascontiguousarray(frame)).resize(1.5, kernel="cubic") for frame in frames),
    ]
    halves = [pyvips.Image.arrayjoin(rows[k : k + 3], shim=8, background=WHITE) for k in (0, 3)]
    joined = halves[0].join(halves[1], "vertical", shim=8, background=WHITE)
    joined.jpegsave(folder / "time.jpg", Q=80, keep="none")


def nose_followed(folder: Path) -> None:
    """Five frames of the clip, and what they are with a stroke that follows the nose."""
    still = supple.Recipe(strokes=[supple.Stroke.scale((345, 58), factor=1.8, radius=24)])
    recipe = follow_tracks(still, None, smile.CLIP, frame=10)
    before = dict(smile.frames_of(smile.CLIP, (0, 20, 36, 45, 62)))
    after = [
        supple.Deformation.from_recipe(recipe.at_frame(k), pixels.shape[:2]).warp(pixels)
        for k, pixels in before.items()
    ]
    side_by_side(
        folder / "track.webp", [shown(pixels[24:184, 280:430], 1.2) for pixels in (*before.values(), *after)], 5
    )


def volumes_bent(folder: Path) -> None:
    """What the examples of volumes show."""
    with tempfile.TemporaryDirectory() as name:
        made = Path(name)
        for example in (head, asymmetry, modes):
            example.main(made)
        for what, scale in (("head", 0.75), ("asymmetry", 0.75), ("inversions", 0.5)):
            picture = pyvips.Image.new_from_file(str(made / f"{what}.png"))
            picture = picture.flatten(background=255) if picture.hasalpha() else picture
            picture.resize(scale).jpegsave(folder / f"{what}.jpg", Q=80, keep="none")


def cut_open(folder: Path) -> None:
    """The head without an eighth, and the half of it that a density window leaves."""
    whole = open_volume(DATA / "head.nii.gz")
    scene = Scene(whole.samples, whole.geometry, transfer="mr-head")
    inner = scene.seen_through("mr-head", density=(90, 254))
    made = (
        (scene.clipped(((None, None), (None, 70), (None, 60))), Camera(30, 25)),
        (inner.clipped(((None, 45), (None, None), (None, None))), Camera(-60, 10)),
    )
    size = (400, 400)
    pictures = [
        part.render(part.framed(camera, size), size, supersampling=2).pixels((1.0, 1.0, 1.0)) for part, camera in made
    ]
    side_by_side(folder / "cut-open.webp", [shown(pixels, 1.0) for pixels in pictures])


def marked(folder: Path) -> None:
    """The head with a scale bar and letters, obliquely and from above."""
    whole = open_volume(DATA / "head.nii.gz")
    scene, size = Scene(whole.samples, whole.geometry, transfer="mr-head"), (400, 400)
    pictures = []
    for camera in (Camera(38, 12, distance=560), Camera(180, 90, distance=560)):
        pixels = scene.render(camera, size, supersampling=2).pixels((0.16, 0.17, 0.2))
        pictures.append(shown(annotated(pixels, scene.view(camera, size), scene.geometry), 1.0))
    side_by_side(folder / "annotated.webp", pictures)


def looks(folder: Path) -> None:
    """The head as it is, with silhouettes, and cut by a plane; and its projections, all framed."""
    whole, size = open_volume(DATA / "head.nii.gz"), (300, 300)
    made: list[tuple[Camera, dict[str, Any]]] = [
        (Camera(38, 12), {}),
        (Camera(38, 12), {"silhouettes": 0.8}),
        (Camera(38, 25), {"plane": ((45, 60, 60), (0.5, -0.7, 0.7))}),
        (Camera(90), {"projection": "average", "clip": ((42, 48), (None, None), (None, None))}),
        (Camera(38, 12), {"projection": "maximum", "density": (40, 254)}),
        (
            Camera(elevation=90),
            {"projection": "minimum", "density": (0, 200), "clip": ((18, 72), (22, 92), (44, 52))},
        ),
    ]
    pictures = []
    for camera, options in made:
        scene = Scene(whole.samples, whole.geometry, transfer="mr-head", **options)
        pixels = scene.render(scene.framed(camera, size), size, supersampling=2).pixels((1.0, 1.0, 1.0))
        pictures.append(shown(pixels, 1.0))
    side_by_side(folder / "looks.webp", pictures, 3)


def beside_vtk(folder: Path) -> None:
    """The head, cut open, in a window of values, and with shadows: above as Supple draws it, below as VTK does."""
    whole, size = open_volume(DATA / "head.nii.gz"), (300, 300)
    made: list[tuple[Camera, dict[str, Any]]] = [
        (Camera(38, 12), {}),
        (Camera(30, 25), {"clip": ((None, None), (None, 70), (None, 60))}),
        (Camera(40, 20), {"density": (90, 110)}),
        (Camera(-48, 8), {"shadows": 1.0}),
    ]
    ours, theirs = [], []
    for camera, options in made:
        scene = Scene(whole.samples, whole.geometry, transfer="mr-head", **options)
        camera = scene.framed(camera, size)
        ours.append(shown(scene.render(camera, size).pixels((1.0, 1.0, 1.0)), 1.0))
        theirs.append(shown(by_vtk(scene, camera, size), 1.0))
    side_by_side(folder / "beside-vtk.webp", [*ours, *theirs], len(made))


def by_vtk(scene: Scene, camera: Camera, size: tuple[int, int]) -> image.Array:
    """Return what VTK's ray caster on the processor draws by default, shaded, with the same camera and colours."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    data = vtk.vtkImageData()
    data.SetDimensions(*scene.shape[::-1])
    data.SetSpacing(*scene.geometry.spacing)
    data.GetPointData().SetScalars(numpy_to_vtk(scene.samples.ravel(), deep=True))
    mapper = vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputData(data)
    mapper.SetNumberOfThreads(2)
    mapper.IntermixIntersectingGeometryOff()
    for k, (low, high) in enumerate(scene.clip):
        last = scene.shape[2 - k] - 1
        for place, way in ((low, 1.0), (high, -1.0)):
            if 0 < place < last:
                plane = vtk.vtkPlane()
                plane.SetOrigin(*([place * s for s in scene.geometry.spacing]))
                plane.SetNormal(*(way if j == k else 0.0 for j in range(3)))
                mapper.AddClippingPlane(plane)
    (low, high), (bottom, top) = scene.range, scene.density
    known = scene.transfer if bottom == -np.inf else scene.transfer.within((bottom, top), low, high)  # type: ignore[union-attr]
    colours, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
    for value, red, green, blue, alpha in known.points:  # type: ignore[union-attr]
        place = low + value * (high - low)
        colours.AddRGBPoint(place, red, green, blue)
        opacity.AddPoint(place, alpha)
    look, actor = vtk.vtkVolumeProperty(), vtk.vtkVolume()
    look.SetColor(colours)
    look.SetScalarOpacity(opacity)
    look.ShadeOn()
    look.SetInterpolationTypeToLinear()
    actor.SetMapper(mapper)
    actor.SetProperty(look)
    renderer, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
    renderer.AddVolume(actor)
    renderer.SetBackground(1, 1, 1)
    window.SetOffScreenRendering(1)
    window.SetSize(size[1], size[0])
    window.AddRenderer(renderer)
    view, seat = scene.view(camera, size), renderer.GetActiveCamera()
    eye = view.eye * view.spacing
    seat.SetPosition(*eye)
    seat.SetFocalPoint(*(eye + 100 * view.ahead))
    seat.SetViewUp(*-view.packed[4])
    seat.SetViewAngle(camera.field_of_view)
    renderer.ResetCameraClippingRange()
    window.Render()
    taken = vtk.vtkWindowToImageFilter()
    taken.SetInput(window)
    taken.ReadFrontBufferOff()
    taken.Update()
    pixels = vtk_to_numpy(taken.GetOutput().GetPointData().GetScalars())
    return np.ascontiguousarray(pixels.reshape(*size, -1)[::-1, :, :3])


def shadows(folder: Path) -> None:
    """The head as it is, and with a dent, without and with shadows."""
    whole, size = open_volume(DATA / "head.nii.gz"), (360, 360)
    d = supple.Deformation(whole.samples.shape, spacing=whole.geometry.spacing, border=30)
    dent = d.grab((40, 86, 65), to=(44, 63, 53), radius=36)
    pictures = []
    for camera, deformation in ((Camera(-48, 8), None), (Camera(38, 12), dent)):
        for strength in (0.0, 1.0):
            scene = Scene(whole.samples, whole.geometry, deformation=deformation, transfer="mr-head", shadows=strength)
            pixels = scene.render(scene.framed(camera, size), size, supersampling=2).pixels((1.0, 1.0, 1.0))
            pictures.append(shown(pixels, 1.0))
    side_by_side(folder / "shadows.webp", pictures, 2)


def meshes(folder: Path) -> None:
    """A brain in the opened head; and a tumour, in contours of a margin, at a slanted cut, before and after strokes."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    whole, brain = (open_volume(DATA / f"{name}.nii.gz") for name in ("head", "brain"))
    grid = vtk.vtkImageData()
    grid.SetDimensions(*brain.sizes)
    grid.GetPointData().SetScalars(numpy_to_vtk(brain.samples.ravel().astype(np.float32), deep=1))
    smooth, edges = vtk.vtkImageGaussianSmooth(), vtk.vtkFlyingEdges3D()
    smooth.SetInputData(grid)
    smooth.SetStandardDeviation(1)
    edges.SetInputConnection(smooth.GetOutputPort())
    edges.SetValue(0, 0.5)

    def drawn(source: Any, colour: tuple[float, float, float]) -> Surface:
        source.Update()
        found, cells = source.GetOutput(), {}
        for name, each, corners in (("triangles", found.GetPolys(), 3), ("lines", found.GetLines(), 2)):
            cells[name] = vtk_to_numpy(each.GetConnectivityArray()).reshape(-1, corners)
        return Surface(vtk_to_numpy(found.GetPoints().GetData()), **cells, colour=colour)

    tumour, margin = vtk.vtkSphereSource(), vtk.vtkSphereSource()
    for ball, radius in ((tumour, 6), (margin, 12)):
        ball.SetThetaResolution(48)
        ball.SetPhiResolution(48)
        ball.SetRadius(radius)
        ball.SetCenter(55, 64, 63.2)
    rings, plane = vtk.vtkCutter(), vtk.vtkPlane()
    rings.SetInputConnection(margin.GetOutputPort())
    plane.SetNormal(0, 0, 1)
    rings.SetCutFunction(plane)
    rings.GenerateValues(7, 55.0, 74.0)
    marks = [drawn(rings, (0.1, 0.3, 0.6)), drawn(tumour, (1.0, 0.2, 0.2))]
    d = supple.Deformation(whole.samples.shape, spacing=whole.geometry.spacing, border=30)
    d = d.grab((55, 64, 63), by=(-13, -3, -6), radius=28)
    cut: dict[str, Any] = {"meshes": marks, "plane": ((45, 60, 60), (0.5, -0.7, 0.7))}
    made: list[tuple[Camera, dict[str, Any]]] = [
        (Camera(38, 30), {"meshes": [drawn(edges, (0.87, 0.68, 0.62))], "clip": (*[(None, None)] * 2, (None, 46))}),
        (Camera(38, 25), cut),
        (Camera(38, 25), cut | {"deformation": d}),
    ]
    pictures, size = [], (300, 300)
    for camera, options in made:
        scene = Scene(whole.samples, whole.geometry, transfer="mr-head", **options)
        near = replace(scene.framed(camera, size), distance=490)
        pictures.append(shown(scene.render(near, size, supersampling=2).pixels((1.0, 1.0, 1.0)), 1.0))
    side_by_side(folder / "meshes.webp", pictures)


def parts_of_head() -> image.Array:
    """Labels: 1 the head, 2 and 3 the halves of the brain, 4 what of it lies low, 5 the ventricles."""
    head, brain = (open_volume(DATA / f"{name}.nii.gz").samples for name in ("head", "brain"))
    inside = brain > 0
    z, _, x = np.indices(head.shape)
    made = ndimage.binary_fill_holes(ndimage.binary_closing(head > 25, iterations=4)).astype(np.uint8)
    made[inside] = np.where(z < 25, 4, np.where(x < 45.5, 2, 3))[inside]
    dark, _ = ndimage.label(ndimage.binary_opening(ndimage.binary_erosion(inside, iterations=7) & (head < 45)))
    made[dark == 1 + np.bincount(dark.ravel())[1:].argmax()] = 5
    return made


def labelled(folder: Path) -> None:
    """Parts of the head, cut open, and through translucent ones."""
    geometry, size = open_volume(DATA / "head.nii.gz").geometry, (400, 400)
    scene = Scene(parts_of_head(), geometry, transfer="labels")
    opacity = {1: 0.006, 2: 0.015}
    clear = LabelColours({k: (*palette(k).tolist(), opacity.get(k, 1.0)) for k in range(1, 6)})
    made = (
        (scene.clipped(((None, None), (None, 70), (None, 60))), Camera(30, 25)),
        (scene.seen_through(clear), Camera(50, 15)),
    )
    pictures = [part.render(part.framed(c, size), size, supersampling=2).pixels((1.0, 1.0, 1.0)) for part, c in made]
    side_by_side(folder / "labels.webp", [shown(pixels, 1.0) for pixels in pictures])


def kept_labels(folder: Path) -> None:
    """A slice of the parts of the head, pulled and resampled to a fifth of the spacing: nearest, and smooth."""
    labels = parts_of_head()
    grid = supple.Grid(labels.shape, (2.0, 2.0, 2.0))
    d = supple.Deformation(grid).grab((45, 60, 45), by=(9, 5, 0), radius=24)
    fine = grid.resampled((0.4, 0.4, 2.0)).crop((130, 190, 45), (210, 210, 1))
    colours = np.array([(0, 0, 0), *(palette(k) for k in range(1, 6))])
    made = [
        np.rint(255 * colours[d.warp(labels, filter=name, grid=fine)[0]]).astype(np.uint8)
        for name in ("nearest", "labels")
    ]
    side_by_side(folder / "labels-smooth.webp", [shown(pixels, 2, "nearest") for pixels in made])


def planes_drawn(folder: Path) -> None:
    """A plane of the head whose forehead is pressed in, as supple plot draws it."""
    stroke = supple.Stroke.grab((0, 71, 53), to=(0, 59, 49), radius=40)
    with tempfile.TemporaryDirectory() as place:
        png = Path(place) / "plot.png"
        options = VolumeOptions(world=True)
        plot_file(Job(DATA / "head.nii.gz", png, supple.Recipe(strokes=(stroke,)), volume=options), plane="sagittal:0")
        pyvips.Image.new_from_file(str(png)).flatten(background=WHITE).resize(0.6).webpsave(
            folder / "plot-volume.webp", Q=80, effort=6, keep="none"
        )


def tinted(folder: Path) -> None:
    """The head in colours of tissue, cut open, and bent."""
    head, brain = (open_volume(DATA / f"{name}.nii.gz") for name in ("head", "brain"))
    skin = ((0, 8, 6, 10), (40, 120, 40, 34), (90, 176, 84, 66), (140, 214, 150, 104), (250, 252, 232, 196))
    grey = ((0, 30, 16, 24), (45, 90, 44, 48), (75, 176, 128, 122), (95, 214, 180, 164), (115, 244, 232, 216))
    outer, inner = (
        np.stack([np.interp(head.samples, [s[0] for s in stops], [s[c] for s in stops]) for c in (1, 2, 3)], axis=-1)
        for stops in (skin, grey)
    )
    part = ndimage.gaussian_filter(brain.samples.astype(np.float32), 0.7)[..., None]
    scene = Scene(np.rint(outer + part * (inner - outer)).astype(np.uint8), head.geometry, transfer="mr-head")
    d = supple.Deformation(scene.shape, spacing=head.geometry.spacing, border=30)
    bent, size = scene.deformed(d.grab((40, 86, 65), to=(44, 63, 53), radius=36)), (400, 400)
    made = (
        (scene.clipped(((None, None), (None, 70), (None, 60))), Camera(30, 25)),
        (bent.clipped(((45, None), (None, None), (None, None))), Camera(60, 12)),
    )
    pictures = [cut.render(cut.framed(c, size), size, supersampling=2).pixels((1.0, 1.0, 1.0)) for cut, c in made]
    side_by_side(folder / "colours.webp", [shown(pixels, 1.0) for pixels in pictures])


def shown(pixels: image.Array, scale: float, kernel: str = "cubic") -> pyvips.Image:
    """An array as a picture, enlarged."""
    return pyvips.Image.new_from_array(np.ascontiguousarray(pixels)).resize(scale, kernel=kernel)


def side_by_side(path: Path, pictures: list[pyvips.Image], across: int = 0) -> None:
    """Write pictures in rows of `across`, or in one row."""
    joined = pyvips.Image.arrayjoin(pictures, across=across or len(pictures), shim=8, background=WHITE)
    joined.webpsave(path, Q=80, effort=6, keep="none")


def bowed_wall() -> pyvips.Image:
    """Bricks as a wide lens shows them: the photograph of scikit-image (CC0), with a barrel distortion."""
    import skimage.data

    bricks = pyvips.Image.new_from_array(skimage.data.brick()).colourspace("srgb")
    places = pyvips.Image.xyz(400, 400) - 199.5
    wider = (places[0] ** 2 + places[1] ** 2) * 3e-6 + 1
    return bricks.mapim(places * wider + 255.5, interpolate=pyvips.Interpolate.new("bicubic"))


def ruled(pixels: image.Array, top: float, bottom: float) -> pyvips.Image:
    """A part of the wall, enlarged, with a straight line in it, dashed, from `x = top` to `x = bottom`."""
    ends = (f"{2 * x - 19} {y}" for x, y in ((top, 0), (bottom, 720)))
    style = 'stroke="#ff2d20" stroke-width="2.5" stroke-dasharray="16 26"'
    line = f'<svg width="440" height="720"><path d="M{next(ends)} L{next(ends)}" {style}/></svg>'
    part = shown(pixels[20:380, 10:230], 2)
    return part.composite2(pyvips.Image.svgload_buffer(line.encode()), "over").flatten().resize(0.75)


def outlined(head: image.Array, mask: image.Array) -> pyvips.Image:
    """A slice, the front above, with the outline of a mask in red."""
    grey = shown(head[::-1], 4).numpy().astype(np.float64)
    pixels = np.repeat(np.clip(1.4 * grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    inside = mask[::-1].repeat(4, axis=0).repeat(4, axis=1) > 0
    inner = inside & np.roll(inside, 2, 0) & np.roll(inside, -2, 0) & np.roll(inside, 2, 1) & np.roll(inside, -2, 1)
    pixels[inside & ~inner] = RED
    return pyvips.Image.new_from_array(pixels)


def coloured(values: image.Array) -> pyvips.Image:
    """A slice of the label map, in greys; what is no label in red."""
    pixels = np.empty((*values.shape, 3), np.uint8)
    pixels[:] = RED
    for label, grey in LABELS.items():
        pixels[values == label] = grey
    return shown(pixels[::-1], 4, kernel="nearest")


LABELS = {0: 0, 10: 90, 40: 160, 90: 235}  # background, fluid, grey matter, white matter


def inputs(folder: Path) -> None:
    """What the commands of how-to.md start from."""
    for source, name in (("astronaut.jpg", "portrait.jpg"), ("bunny.mp4", "clip.mp4"), ("coffee.jpg", "photo.jpg")):
        shutil.copy(DATA / source, folder / name)
    bowed_wall().pngsave(folder / "wall.png")
    (folder / "bow.csv").write_text("x,y\n102,100\n95,200\n93.5,300\n")
    (folder / "line.csv").write_text("x,y\n110,100\n106,200\n102,300\n")
    (folder / "before.csv").write_text("label,x,y\nleft,186,148\nright,265,148\nnose,225,120\n")
    (folder / "after.csv").write_text("label,x,y\nnose,225,120\nleft,190,147\nright,261,147\n")
    (folder / "nose.csv").write_text("frame,x,y\n10,330,160\n30,342,153\n")
    portraits(folder)
    face = np.hypot((np.arange(512) - 225) / 75, (np.arange(512)[:, None] - 115) / 95) < 1
    image.write(folder / "mask.png", np.where(face, 255, 0).astype(np.uint8))
    head, brain = (sitk.ReadImage(str(DATA / f"{name}.nii.gz")) for name in ("head", "brain"))
    values, mask = sitk.GetArrayFromImage(head), sitk.GetArrayFromImage(brain)
    off = supple.Deformation(mask.shape, spacing=(2, 2, 2)).grab((17, 89, 40), by=(4, -5, 0), radius=30, scales=2)
    tissue = np.digitize(values, (60, 95)).astype(np.uint8)
    labels = np.where(mask > 0, np.array([10, 40, 90], np.uint8)[tissue], 0).astype(np.uint8)
    for name, array in (("atlas", off.warp(mask, filter="nearest")), ("labels", labels)):
        made = sitk.GetImageFromArray(array)
        made.CopyInformation(brain)
        sitk.WriteImage(made, str(folder / f"{name}.nii.gz"))


def portraits(folder: Path) -> None:
    """Five pictures of a face, each with its landmarks: of other sizes and tilts, and one mirrored."""
    (folder / "portraits").mkdir()
    (folder / "landmarks").mkdir()
    photo = pyvips.Image.new_from_file(str(DATA / "astronaut.jpg"))
    (face,) = read_faces(DATA / "astronaut.pts", (photo.width, photo.height))
    for k, (side, tilt, size) in enumerate(
        ((225, 0, 480), (190, -9, 360), (180, 12, 600), (200, 6, 420), (212, -5, 300))
    ):
        turn = size / side * np.array([[np.cos(np.radians(tilt)), -np.sin(np.radians(tilt))], [0, 0]])
        turn[1] = -turn[0, 1], turn[0, 0]
        turn = turn if k < 4 else np.diag([-1, 1]) @ turn
        shift = np.array([size / 2, 0.46 * size]) - turn @ (225, 112)
        made = photo.affine(
            turn.ravel().tolist(), odx=shift[0], ody=shift[1], oarea=[0, 0, size, size],
            interpolate=pyvips.Interpolate.new("bicubic"),
        )  # fmt: skip
        made.jpegsave(str(folder / "portraits" / f"{k + 1}.jpg"), Q=95)
        rows = [f"{name},{x:.1f},{y:.1f}" for name, at in face.items() for x, y in [turn @ at + shift]]
        (folder / "landmarks" / f"{k + 1}.csv").write_text("\n".join(["name,x,y", *rows, ""]))


def how_to(folder: Path) -> None:
    """What the commands of how-to.md make."""
    page = (HERE / "how-to.md").read_text(encoding="utf-8").replace("\\\n", " ")
    with tempfile.TemporaryDirectory() as name:
        made = Path(name)
        inputs(made)
        shutil.copytree(made, made / "python")
        here: dict[str, Any] = {}
        with contextlib.chdir(made / "python"):
            exec("\n".join(re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)), here)
        for command in re.findall(r"^supple (.*)$", page, re.MULTILINE):
            subprocess.run([sys.executable, "-m", "supple", *shlex.split(command)], cwd=made, check=True)
        mixing = "warp labels.nii.gz mixed.nii.gz --grab 45,98,40:45,91,40 --radius 30 --quiet"
        subprocess.run([sys.executable, "-m", "supple", *mixing.split()], cwd=made, check=True)

        portrait, slim, wide = (image.read(made / f"{n}.jpg").pixels for n in ("portrait", "slim", "open"))
        face, eyes = np.s_[40:205, 150:295], np.s_[82:124, 183:267]
        side_by_side(folder / "how-to-cheek.webp", [shown(pixels[face], 2.6) for pixels in (portrait, slim)])
        side_by_side(folder / "how-to-eye.webp", [shown(pixels[eyes], 4.8) for pixels in (portrait, wide)])
        names = [f"{k}.jpg" for k in range(1, 6)]
        many = [image.read(made / where / name).pixels for where in ("portraits", "retouched") for name in names]
        side_by_side(folder / "how-to-faces.webp", [shown(pixels, 230 / len(pixels)) for pixels in many], across=5)
        lines = (("wall", 110.7, 94.7), ("straight", 113.7, 97.9))
        walls = [ruled(image.read(made / f"{n}.png").pixels, top, bottom) for n, top, bottom in lines]
        side_by_side(folder / "how-to-line.webp", walls)

        clips = [smile.frames_of(made / f"{n}.mp4", (34, 41, 50)) for n in ("clip", "late")]
        side_by_side(folder / "how-to-clip.webp", [shown(p, 0.45) for clip in clips for _, p in clip], across=3)

        head = open_volume(DATA / "head.nii.gz").samples[40]
        masks = [open_volume(made / f"{n}.nii.gz").samples[40] for n in ("atlas", "corrected")]
        side_by_side(folder / "how-to-atlas.webp", [outlined(head, mask) for mask in masks])
        maps = [open_volume(made / f"{n}.nii.gz").samples[40] for n in ("labels", "mixed", "bent-labels")]
        side_by_side(folder / "how-to-labels.webp", [coloured(values) for values in maps])

    photos, masks = ([here[one], *here[many]] for one, many in (("photo", "images"), ("mask", "masks")))
    rows = [*(shown(p, 0.36) for p in photos), *(shown(255 * m, 0.36).colourspace("srgb") for m in masks)]
    side_by_side(folder / "how-to-training.webp", rows, across=4)


def augmented(folder: Path) -> None:
    """Three draws of a photograph, with a grid, key points and a box; and of a slice of the head, with labels."""
    photo = image.read(DATA / "astronaut.jpg").pixels.copy()
    for line in range(15, 512, 32):
        photo[line : line + 2] = photo[:, line : line + 2] = 255
    known = {"points": [(203, 110), (247, 109), (225, 128)], "boxes": [(147, 10, 300, 230)]}
    augment = RandomElastic(max_displacement=48, radius=(50, 110), strokes=(8, 12))
    rows: tuple[list[pyvips.Image], list[pyvips.Image]] = ([], [])
    for made in (
        apply(supple.Deformation((512, 512)), photo, **known),
        *(augment(photo, seed=s, **known) for s in (3, 5, 6)),
    ):
        (x0, y0, x1, y1) = made.boxes[0]
        marks = "".join(f'<circle cx="{x + 0.5}" cy="{y + 0.5}" r="6" fill="#ffd400"/>' for x, y in made.points)
        place = f'x="{x0}" y="{y0}" width="{x1 - x0}" height="{y1 - y0}"'
        drawn = (
            f'<svg width="512" height="512"><rect {place} fill="none" stroke="#ff2d20" stroke-width="5"/>{marks}</svg>'
        )
        over = pyvips.Image.svgload_buffer(drawn.encode())
        rows[0].append(pyvips.Image.new_from_array(made.image).composite2(over, "over").flatten().resize(0.4))
    head, brain = (open_volume(DATA / f"{name}.nii.gz").samples for name in ("head", "brain"))
    augment = RandomElastic(max_displacement=25, radius=(25, 45), strokes=(20, 30))
    draws = [augment(head, labels=brain, seed=s, shape=head.shape, spacing=(2, 2, 2)) for s in (2, 4, 6)]
    for values, labels in ((head, brain), *((made.image, made.labels) for made in draws)):
        rows[1].append(outlined(values[40], labels[40]).resize(0.4 * 512 / (4 * head.shape[2])))
    joined = [pyvips.Image.arrayjoin(row, across=4, shim=8, background=WHITE) for row in rows]
    both = joined[0].join(joined[1], "vertical", shim=8, background=WHITE)
    both.webpsave(folder / "augmentation.webp", Q=70, effort=6, keep="none")


def straightened(folder: Path) -> None:
    """A photograph as it was, and turned, in the three frames; what is empty is chequered."""
    photo = image.read(DATA / "chelsea.jpg").pixels
    clear = np.dstack([photo, np.full(photo.shape[:2], 255, np.uint8)])
    made = [clear, *(supple.Deformation(photo.shape[:2]).straighten(rotate=8, fit=fit).warp(clear) for fit in FRAMES)]
    pictures = []
    for pixels in made:
        height, width = pixels.shape[:2]
        squares = np.kron(
            (np.indices((height // 12 + 1, width // 12 + 1)).sum(axis=0) % 2) * 40 + 200, np.ones((12, 12))
        )
        grey = np.repeat(squares[:height, :width, None], 3, axis=2).astype(np.uint8)
        below, over = (pyvips.Image.new_from_array(a).copy(interpretation="srgb") for a in (grey, pixels))
        pictures.append(
            below.composite2(over, "over")
            .flatten()
            .resize(0.62)
            .gravity("centre", 304, 224, extend="background", background=WHITE)
        )
    side_by_side(folder / "straighten.webp", pictures, across=4)


def main() -> None:
    """Make all pictures."""
    folder = HERE / "images"
    folder.mkdir(exist_ok=True)
    pages = {
        "how-to": how_to,
        "augmentation": augmented,
        "labels": labelled,
        "smooth": kept_labels,
        "planes": planes_drawn,
        "colours": tinted,
    }
    pages["straightened"] = straightened
    for page in sys.argv[1:] or pages:
        pages[page](folder)
    if sys.argv[1:]:
        return
    photo = image.read(heart.PHOTO).pixels
    d = heart.heart(photo.shape[:2])
    pair = pyvips.Image.arrayjoin(
        [pyvips.Image.new_from_array(pixels) for pixels in (photo, d.warp(photo))], shim=8, background=WHITE
    )
    pair.jpegsave(folder / "heart.jpg", Q=84, keep="none")
    rendered(d, "stretch", photo).jpegsave(folder / "stretch.jpg", Q=82, keep="none")
    paper = supple.Deformation((512, 512)).grab((256, 256), by=(0, 90), radius=100, reach=None)
    bunny_smiles(folder)
    followed(folder)
    time_filtered(folder)
    nose_followed(folder)
    volumes_bent(folder)
    cut_open(folder)
    marked(folder)
    looks(folder)
    beside_vtk(folder)
    shadows(folder)
    meshes(folder)
    rendered(paper, "iterations").pngsave(folder / "iterations.png", palette=True, keep="none")


if __name__ == "__main__":
    main()
