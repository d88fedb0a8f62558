"""OME-Zarr transformations: points go where ngff-zarr and ITK move them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import zarr

from supple import SuppleError
from supple.media.transforms import Displacements, read, write
from supple.space.geometry import Grid
from tests import refusals
from tests.media.transforms.mapping import mapped

Array = npt.NDArray[Any]
Json = dict[str, Any]

DATA = Path(__file__).parent / "data"
POINTS = json.loads((DATA / "points.json").read_text())
RNG = np.random.default_rng(0)


def axes(names: str, unit: str | None = "micrometer", **more: Any) -> list[Json]:
    return [{"name": name, "type": "space", **({"unit": unit} if unit else {}), **more} for name in names]


def scene(path: Path, transformation: Json, before: list[Json], after: list[Json], form: int = 3) -> Path:
    """Write a scene with one transformation, and its folder anew."""
    shutil.rmtree(path, ignore_errors=True)
    systems = [{"name": "in", "axes": before}, {"name": "out", "axes": after}]
    ends = {"input": {"name": "in"}, "output": {"name": "out"}}
    ome = {
        "version": "0.6",
        "scene": {"coordinateSystems": systems, "coordinateTransformations": [transformation | ends]},
    }
    zarr.create_group(str(path), zarr_format=form, attributes={"ome": ome})
    return path


def field_of(path: Path, name: str, array: Array, axes: list[Json], step: Json) -> None:
    """Add a field, as a multiscale image of one level."""
    dataset = {"path": "s0", "coordinateTransformations": [step | {"input": {"path": "s0"}, "output": {"name": "own"}}]}
    image = {"coordinateSystems": [{"name": "own", "axes": axes}], "datasets": [dataset]}
    group = zarr.open_group(str(path)).create_group(name, attributes={"ome": {"multiscales": [image]}})
    group.create_array("s0", shape=array.shape, dtype=array.dtype)[...] = array


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize(("name", "what"), [("declared", "field"), ("scene", "both")])
def test_what_ngff_zarr_wrote(n: int, name: str, what: str) -> None:
    told = POINTS[str(n)]
    contents = read(DATA / f"{name}-{n}d.zarr")
    assert [type(one) for one in contents] == [Displacements, np.ndarray][: len(contents)]
    seen = mapped(contents, np.array(told["points"]) / 1000) * 1000
    assert np.abs(seen - told[what]).max() < 1e-9


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("turned", [False, True])
def test_round_trips(n: int, turned: bool, tmp_path: Path) -> None:
    shape = (4, 5, 6)[-n:]
    direction = np.linalg.qr(RNG.normal(size=(n, n)))[0] if turned else None
    grid = Grid(shape, (0.8, 1.1, 1.7)[:n], (-3.0, 5.0, 11.0)[:n], direction)
    field = Displacements(RNG.normal(size=(*shape, n)), grid)
    matrix = np.eye(n + 1)
    matrix[:-1] += RNG.normal(0, 0.1, (n, n + 1))
    points = grid.positions(RNG.uniform(0.5, 1, (20, n)) * (np.array(grid.sizes) - 1.5))
    for contents in ([field], [matrix, field], [field, matrix, field], [matrix]):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.zarr"
        write(path, contents)
        again = read(path)
        assert np.abs(mapped(again, points) - mapped(contents, points)).max() < 1e-12
        assert [type(one) for one in again] == [type(one) for one in contents]
        for one in again:
            if isinstance(one, Displacements):
                np.testing.assert_allclose(one.values, field.values, rtol=0, atol=1e-14 if turned else 0)
                np.testing.assert_allclose(one.grid.matrix, grid.matrix, rtol=0, atol=1e-14 if turned else 0)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def rotation(n: int, angle: float = 0.5) -> Array:
    made = np.eye(n + 1)
    for k in range(n - 1):
        step = np.eye(n + 1)
        step[k : k + 2, k : k + 2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        made = made @ step
    made[:-1, -1] = RNG.normal(0, 5, n)
    return made


def plain(n: int) -> Displacements:
    """A field along the axes of space, of voxels of three sizes."""
    shape = (4, 5, 6)[-n:]
    return Displacements(RNG.normal(size=(*shape, n)), Grid(shape, (0.8, 1.1, 1.7)[:n], (-3.0, 5.0, 11.0)[:n]))


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_field_between_a_matrix_and_its_inverse_is_one_field(n: int, dtype: Any, tmp_path: Path) -> None:
    """Positions by SciPy, through the three maps as they were written."""
    field = plain(n)._replace(interpolation="cubic")
    field = field._replace(values=field.values.astype(dtype))
    turn, stretch = rotation(n), np.diag([*[2.5] * n, 1])
    matrices = [turn, turn @ np.diag([-1, *[1] * n]), turn @ stretch, turn @ np.diag([2, *[3] * (n - 1), 1])]
    inner = field.grid.positions(RNG.uniform(0, 1, (50, n)) * (np.array(field.grid.sizes) - 1))
    for k, after in enumerate(matrices):
        contents = [np.linalg.inv(after), field, after]
        path = tmp_path / f"{k}.zarr"
        write(path, contents)
        (again,) = read(path)
        assert isinstance(again, Displacements)
        assert (again.values.dtype, again.interpolation) == (dtype, "cubic")
        points = inner @ after[:-1, :-1].T + after[:-1, -1]
        exact = 1e-5 if dtype is np.float32 else 1e-12
        assert np.abs(mapped([again], points) - mapped(contents, points)).max() < exact
        index = np.moveaxis(np.indices(field.grid.shape)[::-1], 0, -1)
        meant = field.grid.positions(index) @ after[:-1, :-1].T + after[:-1, -1]
        assert np.abs(again.grid.positions(index) - meant).max() < 1e-12


def test_a_matrix_of_several_steps_is_one(tmp_path: Path) -> None:
    field, turn = plain(3), rotation(3)
    back, shift = np.linalg.inv(turn), np.eye(4)
    shift[:3, 3] = 3, 4, 5
    write(tmp_path / "a.zarr", [shift, back, field, turn, back, field, turn, shift])
    assert [type(one) for one in read(tmp_path / "a.zarr")] == [np.ndarray, Displacements, Displacements, np.ndarray]
    write(tmp_path / "b.zarr", [back, np.linalg.inv(shift), field, shift @ turn])
    assert len(read(tmp_path / "b.zarr")) == 3
    write(tmp_path / "c.zarr", [back, np.linalg.inv(shift), field, turn @ shift])
    (one,) = read(tmp_path / "c.zarr")
    points = (turn @ shift @ [*field.grid.positions([1.5, 2.5, 1.5]), 1])[:3]
    parts = [back, np.linalg.inv(shift), field, turn @ shift]
    np.testing.assert_allclose(mapped([one], [points]), mapped(parts, [points]), atol=1e-12)


@pytest.mark.parametrize("n", [2, 3])
def test_other_sequences_stay_several_maps(n: int, tmp_path: Path) -> None:
    field, turn = plain(n), rotation(n)
    back = np.linalg.inv(turn)
    nearly, far = turn.copy(), turn.copy()
    nearly[0, -1] += 1e-5
    far[:-1, :-1] @= rotation(n, 1e-5)[:-1, :-1]
    sheared = turn.copy()
    sheared[:-1, :-1] @= np.triu(np.full((n, n), 0.1), 1) + np.eye(n)
    small = Displacements(np.ones((*[1] * n, n)), Grid([1] * n))  # one voxel at 0, which rotations leave there
    around = np.eye(n + 1)
    around[:-1, :-1] = turn[:-1, :-1]
    for k, contents in enumerate(
        [
            [back, field, nearly],
            [back, field, far],
            [back, field, back],
            [turn, field],
            [field, turn],
            [np.linalg.inv(sheared), field, sheared],
            [np.eye(n + 1), small, around],
            [back, field, field, turn],
        ]
    ):
        path = tmp_path / f"{k}.zarr"
        write(path, contents)
        again = read(path)
        assert [type(one) for one in again] == [type(one) for one in contents], k
        for one, other in zip(again, contents, strict=True):
            if isinstance(one, Displacements):
                assert isinstance(other, Displacements)
                np.testing.assert_array_equal(one.values, other.values)
            else:
                np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)


def test_what_is_kept_of_a_field(tmp_path: Path) -> None:
    field = Displacements(np.float32(RNG.normal(size=(4, 5, 6, 3))), Grid((4, 5, 6)), "cubic")
    write(tmp_path / "a.zarr", [field])
    (again,) = read(tmp_path / "a.zarr")
    assert isinstance(again, Displacements)
    assert again.interpolation == "cubic"
    assert again.values.dtype == np.float32
    with pytest.raises(SuppleError, match="exists already"):
        write(tmp_path / "a.zarr", [field])
    write(tmp_path / "a.zarr", [np.eye(3)], force=True)
    np.testing.assert_array_equal(read(tmp_path / "a.zarr")[0], np.eye(3))
    (tmp_path / "b.zarr").mkdir()
    (tmp_path / "b.zarr" / "letter").touch()
    with pytest.raises(SuppleError, match="is no Zarr store"):
        write(tmp_path / "b.zarr", [field], force=True)
    assert (tmp_path / "b.zarr" / "letter").exists()


def test_matrices_stand_in_the_order_of_axes(tmp_path: Path) -> None:
    """The examples of the specification, with y first."""
    affine = {"type": "affine", "affine": [[1, 2, 3], [4, 5, 6]]}  # y = j + 2 i + 3, x = 4 j + 5 i + 6
    wanted = np.array([[5, 4, 6], [2, 1, 3], [0, 0, 1.0]])
    (read_back,) = read(scene(tmp_path / "a.zarr", affine, axes("ji", None), axes("yx", None)))
    np.testing.assert_array_equal(read_back, wanted)
    for kind, more, matrix in [
        ("identity", {}, np.eye(3)),
        ("scale", {"scale": [2, 3.12]}, np.diag([3.12, 2, 1])),
        ("translation", {"translation": [9, -1]}, np.array([[1, 0, -1], [0, 1, 9], [0, 0, 1.0]])),
        ("rotation", {"rotation": [[0, -1], [1, 0]]}, np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])),
        ("mapAxis", {"mapAxis": [1, 0]}, np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1.0]])),
        (
            "sequence",
            {
                "transformations": [
                    {"type": "translation", "translation": [0.1, 0.9]},
                    {"type": "scale", "scale": [2, 3]},
                ]
            },
            np.array([[3, 0, 2.7], [0, 2, 0.2], [0, 0, 1]]),
        ),
        (
            "byDimension",
            {
                "transformations": [
                    {"transformation": {"type": "scale", "scale": [2]}, "inputAxes": [0], "outputAxes": [1]},
                    {
                        "transformation": {"type": "translation", "translation": [5]},
                        "input_axes": [1],
                        "output_axes": [0],
                    },
                ]
            },
            np.array([[0, 2, 0], [1, 0, 5], [0, 0, 1.0]]),
        ),
    ]:
        path = scene(tmp_path / "b.zarr", {"type": kind, **more}, axes("yx", None), axes("yx", None))
        np.testing.assert_allclose(read(path)[0], matrix, atol=1e-12, err_msg=kind)


def test_parameters_in_an_array(tmp_path: Path) -> None:
    path = scene(tmp_path / "a.zarr", {"type": "affine", "path": "matrix"}, axes("yx", None), axes("yx", None))
    made = zarr.open_group(str(path)).create_array("matrix", shape=(2, 3), dtype="f8")
    made[...] = [[1, 2, 3], [4, 5, 6]]
    np.testing.assert_array_equal(read(path)[0], [[5, 4, 6], [2, 1, 3], [0, 0, 1]])


def test_units_and_orders_of_axes(tmp_path: Path) -> None:
    shift = {"type": "translation", "translation": [1, 2, 3]}
    (made,) = read(scene(tmp_path / "a.zarr", shift, axes("zyx"), axes("zyx")))
    np.testing.assert_allclose(made[:3, 3], [3e-3, 2e-3, 1e-3])
    np.testing.assert_allclose(made[:3, :3], np.eye(3))
    (made,) = read(scene(tmp_path / "a.zarr", shift, axes("zyx"), axes("zyx", None)))  # as the other
    np.testing.assert_allclose(made[:3, 3], [3e-3, 2e-3, 1e-3])
    (made,) = read(scene(tmp_path / "a.zarr", shift, axes("xyz", "meter"), axes("xyz", "inch")))
    np.testing.assert_allclose(made @ [1000, 0, 0, 1], [2 * 25.4, 2 * 25.4, 3 * 25.4, 1])
    (made,) = read(scene(tmp_path / "a.zarr", {"type": "identity"}, axes("xyz"), axes("zyx")))
    np.testing.assert_allclose(made @ [1, 2, 3, 1], [3, 2, 1, 1])
    ras = [
        axis | {"orientation": {"type": "anatomical", "value": value}}
        for axis, value in zip(
            axes("zyx", "millimeter"), ["inferior-to-superior", "posterior-to-anterior", "left-to-right"], strict=True
        )
    ]
    (made,) = read(scene(tmp_path / "a.zarr", shift, ras, ras))
    np.testing.assert_allclose(made[:3, 3], [-3, -2, 1])


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("kind", ["displacements", "coordinates"])
def test_fields_along_the_last_axis(kind: str, form: int, tmp_path: Path) -> None:
    """Of displacements and of positions, in Zarr of both formats."""
    vectors = RNG.normal(size=(4, 5, 6, 3))  # z first
    at = np.stack(np.indices((4, 5, 6)), -1) * [2, 3, 4] + [10, 20, 30]
    stored = vectors if kind == "displacements" else vectors + at
    own = [*axes("zyx"), {"name": "d", "type": kind[:-1], "discrete": True}]
    step = {
        "type": "sequence",
        "transformations": [
            {"type": "scale", "scale": [2, 3, 4, 1]},
            {"type": "translation", "translation": [10, 20, 30, 0]},
        ],
    }
    path = scene(tmp_path / "a.zarr", {"type": kind, "path": "a/field"}, axes("zyx"), axes("zyx"), form)
    field_of(path, "a/field", stored, own, step)
    (field,) = read(path)
    assert isinstance(field, Displacements)
    np.testing.assert_allclose(field.values, vectors[..., ::-1] / 1000, atol=1e-12)
    np.testing.assert_allclose(field.grid.spacing, [4e-3, 3e-3, 2e-3])
    np.testing.assert_allclose(field.grid.origin, [30e-3, 20e-3, 10e-3])


def test_a_field_with_x_first(tmp_path: Path) -> None:
    vectors = RNG.normal(size=(3, 6, 5, 4))
    own = [{"name": "d", "type": "displacement"}, *axes("xyz", "millimeter")]
    path = scene(tmp_path / "a.zarr", {"type": "displacements", "path": "f"}, own[1:], own[1:])
    field_of(path, "f", vectors, own, {"type": "scale", "scale": [1, 4, 3, 2]})
    (field,) = read(path)
    assert isinstance(field, Displacements)
    assert field.grid.shape == (4, 5, 6)
    assert field.grid.spacing == (4, 3, 2)
    np.testing.assert_array_equal(field.values, vectors.transpose(3, 2, 1, 0))
    np.testing.assert_array_equal(field.grid.direction, np.eye(3))


def test_what_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    plain = axes("yx")

    def refused(match: str, transformation: Json | None = None, before: Any = plain, after: Any = plain) -> None:
        if transformation is not None:
            scene(path, transformation, before, after)
        assert "a.zarr" in refusals.refused(read, path, match=match)

    refused("there is no such folder")
    path.mkdir()
    refused("there is no Zarr array or group")
    (path / "zarr.json").write_text('{"zarr_format": 3, "node_')
    refused("it is damaged")
    identity = {"type": "identity"}
    refused("has the unit 'parrot'", identity, axes("yx", "parrot"))
    refused("its axes are t, x, of the type time too", identity, [{"name": "t", "type": "time"}, *axes("x")])
    refused("its axes are x: give", identity, axes("x"), axes("x"))
    refused("its input has 3 axes, its output 2", identity, axes("zyx"))
    refused("of the type 'warp' here: use identity", {"type": "warp"})
    refused("its scale has 3 rows, and its space 2 axes", {"type": "scale", "scale": [1, 2, 3]})
    refused("a matrix of shape", {"type": "affine", "affine": [[1, 0], [0, 1]]})
    refused("holds NaN", {"type": "scale", "scale": [1, float("nan")]})
    refused("incomplete or malformed", {"type": "scale"})
    refused("incomplete or malformed", {"type": "sequence", "transformations": 3})
    refused("it lacks 'nowhere'", {"type": "displacements", "path": "nowhere"})
    refused("outside of it", {"type": "displacements", "path": "../b"})
    parts = [{"transformation": {"type": "displacements", "path": "f"}, "inputAxes": [0], "outputAxes": [0]}]
    refused("of the type 'displacements' here", {"type": "byDimension", "transformations": parts})

    own = [*plain, {"name": "d", "type": "displacement"}]
    step = {"type": "scale", "scale": [1, 1, 1]}
    good = RNG.normal(size=(4, 5, 2))
    holes = good.copy()
    holes[1, 1] = np.nan
    turn = [[1, 1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
    for match, array, listed, steps, kind, how in [
        (r"shape \(4, 5, 1\)", good[..., :1], own, step, "displacements", None),
        ("axes of the types .*displacement", good, own, step, "coordinates", None),
        ("is of complex128", good * 1j, own, step, "displacements", None),
        ("holds NaN", holes, own, step, "displacements", None),
        ("do not fit its axes", good, own, {"type": "scale", "scale": [0, 1, 1]}, "displacements", None),
        ("at right angles", good, own, {"type": "affine", "affine": turn}, "displacements", None),
        ("interpolated by 'nearest'", good, own, step, "displacements", "nearest"),
    ]:
        scene(path, {"type": kind, "path": "f", **({"interpolation": how} if how else {})}, plain, plain)
        field_of(path, "f", array, listed, steps)
        refused(match)

    group = zarr.open_group(str(path))
    whole = dict(group.attrs["ome"]["scene"])
    group.attrs["ome"] = {"scene": whole | {"coordinateTransformations": [identity, {"type": "scale", "name": "b"}]}}
    refused(r"holds 2 transformations \(identity, b\)")
    group.attrs["ome"] = {"scene": whole | {"coordinateSystems": whole["coordinateSystems"][:1]}}
    refused("does not describe the coordinate system 'out'")
    group.attrs["ome"] = {"version": "0.6"}
    refused("holds no coordinateTransformations")


def test_a_field_cut_short(tmp_path: Path) -> None:
    shutil.copytree(DATA / "declared-3d.zarr", tmp_path / "a.zarr")
    (chunk,) = [path for path in (tmp_path / "a.zarr").rglob("*") if path.is_file() and path.name.isdigit()]
    chunk.write_bytes(chunk.read_bytes()[:50])
    with pytest.raises(SuppleError, match=r"a.zarr: its field .* is damaged or cut short"):
        read(tmp_path / "a.zarr")


def test_what_no_store_holds_is_not_written(tmp_path: Path) -> None:
    grid = Grid((4, 5, 6))
    values = np.zeros((4, 5, 6, 3))
    for contents, match in [
        ([], "parts of no dimensions"),
        ([np.eye(3), np.eye(4)], r"parts of \[2, 3\] dimensions"),
        ([Displacements(values, grid, "bspline")], "coefficients of a spline"),
        ([Displacements(values * np.nan, grid)], "NaN or infinity"),
    ]:
        with pytest.raises(SuppleError, match=match):
            write(tmp_path / "a.zarr", contents)
    with pytest.raises(SuppleError, match="there is no folder"):
        write(tmp_path / "b" / "a.zarr", [np.eye(3)])
    assert not list(tmp_path.iterdir())
