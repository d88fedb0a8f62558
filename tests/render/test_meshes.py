"""Meshes and contours with volumes: what rays meet, what is before and behind, and what moves with the volume."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from supple.cli import command
from supple.errors import OutsideWarning, SuppleError
from supple.files.renders import COLOURS, MeshFile, read_surfaces
from supple.files.volumes import open_volume
from supple.gpu.device import Gpu
from supple.media import image
from supple.media import volume as media
from supple.render.camera import Camera
from supple.render.meshes import Surface
from supple.render.picture import linear_light
from supple.render.scene import Scene
from supple.render.transfer import TransferFunction
from supple.space.geometry import Geometry
from tests.gpu.scenes import apart, pair
from tests.media.meshes import made
from tests.media.meshes.contours import structures
from tests.refusals import refused
from tests.render.scenes import CAMERA, OBLIQUE, SHAPE, ball, bent

Floats = npt.NDArray[np.float64]

SIZE = (37, 46)
STRAIGHT = Geometry((1.0, 1.2, 1.5))
CENTRE = (13.5, 14.5, 11.5)
RED = (1.0, 0.0, 0.0)
NOTHING = np.zeros(SHAPE, np.uint8)
HARD = TransferFunction(((0.49, 0.0, 0.0, 1.0, 0.0), (0.5, 0.0, 0.0, 1.0, 1.0), (1.0, 0.0, 0.0, 1.0, 1.0)))


def bare(*meshes: Surface, **options: Any) -> Scene:
    """Meshes without anything of a volume."""
    return Scene(NOTHING, OBLIQUE, transfer="mr-head", meshes=meshes, **options)


def sphere(radius: float, centre: tuple[float, ...] = CENTRE, fine: int = 3, **options: Any) -> Surface:
    """A subdivided icosahedron, of a radius in the millimetres of OBLIQUE."""
    solid = vtk.vtkPlatonicSolidSource()
    solid.SetSolidTypeToIcosahedron()
    finer = vtk.vtkLinearSubdivisionFilter()
    finer.SetInputConnection(solid.GetOutputPort())
    finer.SetNumberOfSubdivisions(fine)
    clean = vtk.vtkCleanPolyData()
    clean.SetInputConnection(finer.GetOutputPort())
    clean.Update()
    points = vtk_to_numpy(clean.GetOutput().GetPoints().GetData()).astype(float)
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    faces = np.array(made.faces(clean.GetOutput()))
    return Surface(points / OBLIQUE.spacing + centre, faces, **options)


def rays(scene: Scene, camera: Camera, fine: int = 1) -> tuple[Floats, Floats]:
    """The eye, in millimetres along the axes of the volume, and the unit directions of all rays."""
    view = scene.view(camera, SIZE)
    height, width = SIZE[0] * fine, SIZE[1] * fine
    ways = [
        [view.direction((x + 0.5) / fine - 0.5, (y + 0.5) / fine - 0.5) for x in range(width)] for y in range(height)
    ]
    return view.eye * view.spacing, np.array(ways)


def met(eye: Floats, ways: Floats, corners: Floats) -> Floats:
    """Möller and Trumbore (1997): distances to the nearest of some triangles (T, 3, 3), or infinity."""
    nearest = np.full(ways.shape[:-1], np.inf)
    for a, b, c in corners:
        one, other, start = b - a, c - a, eye - a
        across = np.cross(ways, other)
        with np.errstate(divide="ignore", invalid="ignore"):
            over = 1 / (across @ one)
            u = across @ start * over
            v = ways @ np.cross(start, one) * over
            t = np.cross(start, one) @ other * over
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        nearest = np.where(hit, np.minimum(nearest, t), nearest)
    return nearest


@pytest.mark.parametrize("camera", [CAMERA, Camera(200, -40, distance=2.0, field_of_view=110)])
def test_distances_are_those_of_möller_and_trumbore(camera: Camera) -> None:
    rng = np.random.default_rng(3)
    # Of all sizes, around the eye of the second camera as well: some have corners behind it.
    centres = rng.uniform(0, SHAPE[::-1], (60, 1, 3))
    points = (centres + rng.normal(size=(60, 3, 3)) * rng.choice([0.5, 4, 25], (60, 1, 1))).reshape(-1, 3)
    triangles = rng.permutation(180).reshape(60, 3)
    scene = bare(Surface(points, triangles))
    eye, ways = rays(scene, camera)
    wanted = met(eye, ways, (points * OBLIQUE.spacing)[triangles])
    picture = scene.render(camera, SIZE)
    assert np.isfinite(wanted).mean() > 0.2
    np.testing.assert_array_equal(np.isfinite(picture.depth), np.isfinite(wanted))
    np.testing.assert_allclose(picture.depth, wanted, rtol=1e-6)
    np.testing.assert_array_equal(picture.light[..., 3], np.isfinite(wanted))


def test_no_ray_goes_through_between_triangles() -> None:
    # Edges and corners that rays meet exactly, and others.
    for turn in (0.0, 0.3):
        u, v = np.meshgrid(np.arange(-8, 9) * 1.25, np.arange(-8, 9) * 1.25)
        xs, zs = np.cos(turn) * u - np.sin(turn) * v, np.sin(turn) * u + np.cos(turn) * v
        points = np.stack([xs.ravel() + 14, np.full(xs.size, 15.0), zs.ravel() + 12], axis=-1)
        k = np.arange(17 * 16).reshape(16, 17)[:, :16].ravel()
        faces = np.concatenate([np.stack([k, k + 1, k + 18], 1), np.stack([k + 18, k + 17, k], 1)])
        apart = np.random.default_rng(0).permutation(3 * len(faces))  # no two triangles share a vertex
        places = np.empty((len(apart), 3))
        places[apart] = points[faces.ravel()]
        camera = Camera(distance=20, target=(14, 15, 12), field_of_view=20)
        for mesh in (Surface(points, faces), Surface(places, apart.reshape(-1, 3))):
            picture = Scene(NOTHING, meshes=[mesh]).render(camera, (32, 32), supersampling=3)
            np.testing.assert_allclose(picture.light[..., 3], 1, atol=1e-6)


@pytest.mark.parametrize("shaded", [True, False])
def test_light_is_that_of_surfaces_of_the_volume(shaded: bool) -> None:
    # The picture of a ball by its gradients, and by a mesh.
    volume = Scene(ball(9), OBLIQUE, transfer=HARD, step=0.05, shaded=shaded, silhouettes=0.5 if shaded else 0)
    mesh = bare(sphere(9, fine=4, colour=(0, 0, 1)), shaded=shaded, silhouettes=0.5 if shaded else 0)
    one, other = (scene.render(CAMERA, SIZE).light for scene in (volume, mesh))
    both = (one[..., 3] > 0.99) & (other[..., 3] > 0.99)
    assert both.mean() > 0.05
    assert np.quantile(abs(one - other)[both], 0.95) < (0.02 if shaded else 1e-3)
    assert (np.ptp(other[both], axis=0).max() > 0.3) == shaded


def test_edges_are_sharp_and_both_sides_are_lit() -> None:
    corners = np.array([[x, y, z] for z in (6, 18) for y in (8, 22) for x in (8, 20)], float)
    faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    triangles = np.array([[f[0], f[k], f[k + 1]] for f in faces for k in (1, 2)])  # wound at random
    for turned in (triangles, triangles[:, ::-1]):
        light = bare(Surface(corners, turned)).render(Camera(35, 20, distance=9000, field_of_view=1), SIZE).light
        colours = np.unique(np.round(light[light[..., 3] == 1][:, 0], 2))
        assert len(colours) == 3  # a plane has one colour


@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_a_ball_hides_a_smaller_sphere_and_a_larger_one_the_ball(gpu: Gpu, device: str) -> None:
    alone = Scene(ball(8), OBLIQUE, transfer=HARD, step=0.2, device=device)
    before = alone.render(CAMERA, SIZE)
    for radius in (7.5, 8.5):
        scene = Scene(ball(8), OBLIQUE, transfer=HARD, step=0.2, meshes=[sphere(radius, colour=RED)], device=device)
        picture = scene.render(CAMERA, SIZE)
        if radius < 8:
            np.testing.assert_allclose(picture.light, before.light, atol=6e-3)  # rays end at an opacity of 0.995
            continue
        mesh = bare(sphere(radius, colour=RED)).render(CAMERA, SIZE)
        np.testing.assert_allclose(picture.light, mesh.light, atol=1e-6)
        np.testing.assert_allclose(picture.depth, mesh.depth, rtol=1e-6)
        assert picture.samples.sum() < before.samples.sum()


@pytest.mark.parametrize("device", ["cpu", "gpu"])
@pytest.mark.parametrize("step", [0.3, 1.0])
def test_what_is_translucent_is_composited_before_a_mesh(gpu: Gpu, device: str, step: float) -> None:
    fog = TransferFunction(((0.0, 0.0, 1.0, 0.0, 0.1), (1.0, 0.0, 1.0, 0.0, 0.1)))  # of a millimetre
    samples = np.full(SHAPE, 0.5, np.float32)
    samples[0, 0, 0], samples[-1, -1, -1] = 0, 1
    square = np.array([[-90, 9, -90], [90, 14, -90], [90, 14, 90], [-90, 9, 90]], float) + np.array([14, 0, 12])
    mesh = Surface(square, [[0, 1, 2], [2, 3, 0]], colour=RED)
    scene = Scene(samples, STRAIGHT, transfer=fog, step=step, shaded=False, meshes=[mesh], device=device)
    camera = Camera(10, 15)
    picture = scene.render(camera, SIZE)
    eye, ways = rays(scene, camera)
    far = met(eye, ways, (square * STRAIGHT.spacing)[mesh.triangles])
    faces = np.stack([-eye / ways, ((np.array(SHAPE[::-1]) - 1) * STRAIGHT.spacing - eye) / ways])
    near, leave = faces.min(axis=0).max(axis=-1), faces.max(axis=0).min(axis=-1)
    through = np.where(near < leave, np.clip(np.minimum(far, leave) - near, 0, None), 0)
    inside = np.isfinite(far) & (far < leave)
    assert inside.mean() > 0.2
    assert (through[inside] > 3).mean() > 0.5
    clear = 0.9 ** through[inside]
    np.testing.assert_allclose(picture.light[inside][:, 0], clear, atol=2e-5)
    np.testing.assert_allclose(picture.light[inside][:, 1], 1 - clear, atol=2e-5)
    np.testing.assert_allclose(picture.light[inside][:, 3], 1, atol=1e-6)


def test_lines_are_two_pixels_wide_and_hidden() -> None:
    camera = Camera(0, 0, distance=80, target=CENTRE)
    line = Surface([[2, 14.5, 11.5], [25, 14.5, 11.5]], lines=[[0, 1]], colour=RED)
    scene = Scene(NOTHING, transfer="mr-head", meshes=[line])
    for fine in (1, 3):
        light = scene.render(camera, (60, 60), supersampling=fine).light
        np.testing.assert_allclose(light[:, 30, 3].sum(), 2, atol=0.05)
        np.testing.assert_allclose(light[light[..., 3] > 0][:, :3].max(axis=0), RED, atol=1e-6)
    # At its own depth, in perspective: towards the eye, at half of the way on the screen.
    slant = Surface([[5, 0, 11.5], [20, 28, 11.5]], lines=[[0, 1]])
    slanted = Scene(NOTHING, meshes=[slant])
    view = slanted.view(camera, (60, 60))
    depth = slanted.render(camera, (60, 60)).depth
    ys, xs = np.nonzero(np.isfinite(depth))
    assert len(xs) > 20
    for y, x in zip(ys, xs, strict=True):
        at = view.eye + depth[y, x] * view.direction(x, y)
        way = (at[0] - 5) / 15
        assert abs(at[1] - 28 * way) < 2.5
    # Behind what is opaque, and before it.
    solid = Scene(ball(8), STRAIGHT, transfer=HARD, meshes=[line])
    for scene, seen in ((solid, False), (solid.clipped(((None, None), (15, None), (None, None))), True)):
        red = scene.render(camera, (60, 60)).light[..., 0] > 0.9
        assert red[29:31, 16].all()
        assert red[29:31, 30].all() == red.any(axis=0)[28:32].all() == seen


@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_projections_are_behind_meshes(gpu: Gpu, device: str) -> None:
    scene = Scene(ball(8), OBLIQUE, projection="maximum", meshes=[sphere(3, colour=RED)], device=device)
    picture, mesh = scene.render(CAMERA, SIZE), bare(sphere(3, colour=RED)).render(CAMERA, SIZE)
    on = np.isfinite(mesh.depth)
    assert on.sum() > 10
    np.testing.assert_allclose(picture.light[on], mesh.light[on], atol=1e-5)
    np.testing.assert_allclose(picture.depth[on], mesh.depth[on], rtol=1e-6)
    assert (picture.light[~on][:, 0] == picture.light[~on][:, 2]).all()


@pytest.mark.parametrize("mode", ["plain", "exact", "buffered", "hybrid"])
def test_the_gpu_s_picture_is_the_cpu_s(gpu: Gpu, mode: str) -> None:
    given: dict[str, Any] = {"transfer": "grey", "tolerance": 0.05}
    if mode != "plain":
        given |= {"deformation": bent(), "mode": mode}
    contour = Surface(sphere(9).points, lines=np.stack([np.arange(200), np.arange(1, 201)], 1), colour=(1, 1, 0))
    meshes = [sphere(6, colour=RED), contour]
    one, other = (
        scene.render(CAMERA, SIZE, supersampling=2) for scene in pair(ball(8), OBLIQUE, meshes=meshes, **given)
    )
    plain = Scene(ball(8), OBLIQUE, **given).render(CAMERA, SIZE, supersampling=2)
    assert apart(one, plain) < 30
    assert apart(one, other) > 50
    both = np.isfinite(one.depth) & np.isfinite(other.depth)
    assert np.quantile(abs(one.depth[both] - other.depth[both]), 0.95) < 0.01


def test_meshes_are_in_view_and_move_with_the_volume() -> None:
    scene = Scene(ball(5), OBLIQUE, transfer=HARD)
    far = sphere(4, (60.0, 14.5, 11.5))
    wide = Scene(ball(5), OBLIQUE, transfer=HARD, meshes=[far])
    one, other = scene.framed(CAMERA, SIZE), wide.framed(CAMERA, SIZE)
    assert other.distance is not None
    assert one.distance is not None
    assert other.distance > 2 * one.distance
    alpha = bare(far).render(other, SIZE).light[..., 3]
    assert alpha.any()
    assert not alpha[[0, -1]].any()
    assert not alpha[:, [0, -1]].any()
    # By T, exactly, in all modes and after the strokes change.
    small = sphere(4)
    moved = Surface(bent().forward(small.points), small.triangles)
    wanted = bare(moved).render(CAMERA, SIZE)
    for mode in ("exact", "buffered"):
        found = bare(small, deformation=bent(), mode=mode).render(CAMERA, SIZE)
        np.testing.assert_array_equal(found.light, wanted.light)
    np.testing.assert_array_equal(bare(small).deformed(bent()).render(CAMERA, SIZE).depth, wanted.depth)
    assert not np.array_equal(bare(small).render(CAMERA, SIZE).depth, wanted.depth)


@pytest.mark.parametrize(
    ("told", "given"),
    [
        ("points must be finite numbers of shape (N, 3)", {"points": [[1, 2]]}),
        ("points must be finite", {"points": [[1, 2, np.nan]]}),
        ("triangles must be indices of points from 0 to 2", {"triangles": [[0, 1, 3]]}),
        ("triangles must be indices of points, of shape (N, 3)", {"triangles": [[0.0, 1, 2]]}),
        ("lines must be indices of points, of shape (N, 2)", {"lines": [[0, 1, 2]]}),
        ("colour must be", {"colour": (0, 0, 2)}),
    ],
)
def test_a_surface_is_checked(told: str, given: dict[str, Any]) -> None:
    assert refused(Surface, **{"points": np.eye(3), "triangles": [[0, 1, 2]], **given}).startswith(told)
    with pytest.raises(SuppleError, match=r"^meshes must be a sequence of surfaces"):
        Scene(NOTHING, meshes=[np.eye(3)])  # type: ignore[list-item]


class TestFiles:
    @pytest.fixture(autouse=True)
    def here(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        samples = np.where(ball(8) > 0.5, 200, 0).astype(np.int16)
        place = Geometry((1.0, 1.0, 1.2), (-5.0, 6.0, 7.0), convention="LPS")
        media.write("in.nii.gz", samples, media.Volume(samples, place))

    def stored(self, name: str = "in.stl", centre: tuple[float, ...] = CENTRE) -> str:
        x, y, z = open_volume("in.nii.gz").geometry.to_world(np.array(centre), "RAS")
        return made.write(Path(name), made.surface((float(x), float(y), float(z)), 7.0)).name

    def test_a_mesh_is_drawn_where_points_would_move_it(self) -> None:
        bend = ["--grab", "13,14,11:17,14,11", "--radius", "9", "--border", "none"]
        look = [
            "--transfer",
            "mr-head",
            "--size",
            "60x50",
            "--azimuth",
            "40",
            "--distance",
            "120",
            "--target",
            "14,15,12",
        ]
        name, warped = self.stored(), ["--mode", "buffered"]
        assert command(["render", "in.nii.gz", "there.png", "--mesh", f"{name}:#ff8000", *bend, *look, *warped]) == 0
        assert command(["points", name, "moved.stl", "--on", "in.nii.gz", *bend]) == 0
        assert command(["warp", "in.nii.gz", "bent.nii.gz", "--filter", "linear", *bend]) == 0
        assert command(["render", "bent.nii.gz", "moved.png", "--mesh", "moved.stl:#ff8000", *look]) == 0
        assert command(["render", "in.nii.gz", "still.png", "--mesh", f"{name}:#ff8000", *look]) == 0
        one, other, still = (image.read(f"{n}.png").pixels.astype(int) for n in ("there", "moved", "still"))
        orange = one[..., 0] > one[..., 2] + 80
        assert orange.mean() > 0.01
        assert (abs(one - other).max(axis=-1) > 8).mean() < 1e-3
        assert (abs(one - still).max(axis=-1) > 8).mean() > 0.03

    def test_contours_have_the_colours_of_their_regions(self) -> None:
        around = Geometry((2.0, 2.5, 1.0), (-25.0, -40.0, -5.0), convention="LPS")
        media.write("around.nii.gz", NOTHING, media.Volume(NOTHING, around))
        volume = open_volume("around.nii.gz")
        structures(Path("rs.dcm"))
        contours, points = read_surfaces([MeshFile("rs.dcm")], volume)
        assert contours.colour == (1, 0, 128 / 255)
        assert points.colour == COLOURS[1]
        assert (contours.lines.shape, points.lines.shape) == ((48, 2), (4, 2))
        ends = contours.points[contours.lines]
        np.testing.assert_allclose(np.bincount(contours.lines.ravel()), 2)  # closed
        assert np.ptp(ends[..., 2], axis=1).max() < 1e-9  # in planes
        (red,) = {each.colour for each in read_surfaces([MeshFile("rs.dcm", RED)], volume)}
        assert red == RED

    @pytest.mark.parametrize(
        ("given", "told"),
        [
            (["none.stl"], "cannot read none.stl: No such file or directory"),
            (["points.csv"], "cannot read points.csv: the suffix .csv is of no mesh: give a mesh or contours: .stl"),
            (["in.stl:#12"], "--mesh must end in a colour such as #1a1a1e, found '12'"),
            (["bare.obj", "--convention", "LPS"], "cannot read bare.obj: it has no faces, lines or contours: give a"),
            (["tri.obj"], "cannot place tri.obj: it does not say what its numbers are"),
            (["bad.obj", "--convention", "LPS"], "a face or line has vertex 7 of 3"),
        ],
    )
    def test_refusals(self, given: list[str], told: str, capfd: pytest.CaptureFixture[str]) -> None:
        self.stored()
        Path("points.csv").write_text("x,y,z\n1,2,3\n")
        triangle = "v 1 2 3\nv 2 3 4\nv 3 3 1\n"
        for name, rest in (("bare", ""), ("tri", "f 1 2 3\n"), ("bad", "f 1 2 7\n")):
            Path(f"{name}.obj").write_text(triangle + rest)
        assert command(["render", "in.nii.gz", "out.png", "--mesh", *given]) == 2
        said = capfd.readouterr().err
        assert told in said
        assert said.count("\n") == 1
        assert not Path("out.png").exists()

    def test_a_mesh_that_lies_elsewhere_is_told(self) -> None:
        name = self.stored(centre=(500.0, 0.0, 0.0))
        with pytest.warns(OutsideWarning, match=r"^no point of in.stl lies in in.nii.gz: see whether"):
            read_surfaces([MeshFile(name)], open_volume("in.nii.gz"))


def test_light_is_linear() -> None:
    light = bare(sphere(8, colour=(0.5, 0.5, 0.5)), shaded=False).render(CAMERA, SIZE).light
    np.testing.assert_allclose(light[light[..., 3] == 1][:, :3], linear_light((0.5, 0.5, 0.5))[0], rtol=1e-6)
