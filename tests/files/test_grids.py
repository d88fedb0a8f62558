"""Fields, affine maps and other grids, from file to file."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import numpy.typing as npt
import pytest
import pyvips
import SimpleITK
from scipy import ndimage

from supple import (
    Affine,
    Deformation,
    Field,
    FoldWarning,
    Grid,
    GridOptions,
    OutsideWarning,
    Placed,
    Recipe,
    Stroke,
    SuppleError,
)
from supple.files import Job, warp_file
from supple.files.grids import output_grid
from supple.media import image
from supple.media import volume as media
from supple.space.geometry import Geometry
from tests.refusals import refused

SHAPE = (14, 18, 16)
DIRECTION = np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]) @ np.diag([1.0, -1.0, 1.0])
OBLIQUE = Geometry((0.9, 1.1, 2.0), (10.0, -20.0, 30.0), DIRECTION, "LPS")
EMPTY = Recipe()
FLAT = Recipe(border=6, strokes=(Stroke.grab((30, 20), to=(34, 22), radius=12),))
SOLID = Recipe(border=5.0, strokes=(Stroke.grab((7, 9, 6), by=(2, -1, 1), radius=6),))


def voxels(dtype: Any = np.float32, shape: tuple[int, ...] = SHAPE, seed: int = 0) -> npt.NDArray[Any]:
    rng = np.random.default_rng(seed)
    values = ndimage.gaussian_filter(rng.normal(size=shape), [1.0] * 3 + [0.0] * (len(shape) - 3))
    return ((values - values.min()) / np.ptp(values) * 200).astype(dtype)


def stored(name: str, samples: npt.NDArray[Any], geometry: Geometry = OBLIQUE, **facts: Any) -> npt.NDArray[Any]:
    media.write(name, samples, media.Volume(samples, geometry, **facts))
    return samples


def field(grid: Grid, size: float = 1.5, seed: int = 1) -> Field:
    rng = np.random.default_rng(seed)
    values = ndimage.gaussian_filter(rng.normal(size=(*grid.shape, grid.ndim)), [3.0] * grid.ndim + [0])
    return Field((values * size / np.abs(values).max()).astype(np.float32), grid)


def around(grid: Grid, n: int = 9) -> Grid:
    """A coarse grid around another one."""
    extent = np.multiply(grid.sizes, grid.spacing)
    steps = extent * 1.2 / (n - 1)
    centre = grid.positions((np.array(grid.sizes) - 1) / 2)
    origin = centre - np.array(grid.direction) @ (steps * (n - 1) / 2)
    return Grid((n,) * grid.ndim, steps.tolist(), origin.tolist(), grid.direction)


def pictured(name: str, *shape: int, dtype: type = np.uint8) -> npt.NDArray[Any]:
    rng = np.random.default_rng(5)
    top = np.iinfo(dtype).max + 1 if np.dtype(dtype).kind in "iu" else 200
    pixels = rng.integers(0, top, shape).astype(dtype)
    image.write(name, pixels)
    return pixels


class TestMapsOnFiles:
    @pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
    def test_a_field_as_itk_applies_it(self, here: Path, suffix: str) -> None:
        samples = stored(f"in{suffix}", voxels())
        given = field(around(OBLIQUE.grid(SHAPE)))
        done = warp_file(
            f"in{suffix}", f"out{suffix}", EMPTY, filter="linear", tolerance=1e-4, maps=[Placed(given)], clamp=False
        )
        held = SimpleITK.GetImageFromArray(given.values.astype(np.float64), isVector=True)
        held.SetSpacing(given.grid.spacing)
        held.SetOrigin(given.grid.origin)
        held.SetDirection(np.ravel(given.grid.direction).tolist())
        read = SimpleITK.ReadImage(f"in{suffix}")
        wanted = SimpleITK.GetArrayFromImage(
            SimpleITK.Resample(read, read, SimpleITK.DisplacementFieldTransform(held), SimpleITK.sitkLinear, -1e4)
        )
        made = media.read(f"out{suffix}").samples
        inside = wanted > -1e4
        assert inside.mean() > 0.7
        slope = max(np.abs(np.diff(samples, axis=k)).max() for k in range(3))
        np.testing.assert_allclose(made[inside], wanted[inside], atol=2e-3 * slope, rtol=0)
        assert (done.grid, done.folded, done.unsolved) == (None, 0, 0)
        assert done.report().within

    def test_maps_among_strokes(self, here: Path) -> None:
        samples = stored("in.nii", voxels())
        two = replace(SOLID, strokes=(*SOLID.strokes, Stroke.grab((5, 5, 5), by=(0, 2, 0), radius=6)))
        given = field(around(OBLIQUE.grid(SHAPE)))
        turn = Affine([[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, -1]])
        maps = [Placed(turn), Placed(given, True, after=1), Placed(turn, True, after=2)]
        done = warp_file("in.nii", "out.nii", two, maps=maps, clamp=False)
        grid = media.outline_of("in.nii").grid
        d = Deformation(grid, border=5.0).affine(turn).add(two.strokes[0]).field(given, inverse=True)
        d = d.add(two.strokes[1]).affine(turn, inverse=True)
        assert done.deformation.space.composite is not None
        np.testing.assert_array_equal(media.read("out.nii").samples, d.warp(samples, between="cubic", time_filter=True))
        assert done.report() == d.report()

    def test_nothing_is_copied_where_a_map_is_given(self, here: Path) -> None:
        pictured("in.png", 40, 50, 3)
        stored("in.nii", voxels())
        shift = Affine([[1, 0, 1], [0, 1, 0]])
        warp_file("in.png", "out.png", EMPTY, maps=[Placed(shift)], filter="nearest")
        np.testing.assert_array_equal(image.read("out.png").pixels[:, :-1], image.read("in.png").pixels[:, 1:])
        warp_file("in.png", "same.png", EMPTY, grid=GridOptions())
        assert Path("same.png").read_bytes() == Path("in.png").read_bytes()
        warp_file("in.nii", "same.nii", EMPTY, grid=GridOptions(reference="in.nii"))
        assert Path("same.nii").read_bytes() == Path("in.nii").read_bytes()
        warp_file("in.nii", "part.nii", EMPTY, grid=GridOptions(crop=(0, 0, 0, 16, 18, 13)))
        np.testing.assert_array_equal(media.read("part.nii").samples, media.read("in.nii").samples[:13])

    def test_all_pages_alike(self, here: Path) -> None:
        rng = np.random.default_rng(5)
        pages = rng.integers(0, 256, (3, 20, 30), dtype=np.uint8)
        tall = pyvips.Image.new_from_array(pages.reshape(60, 30))
        tall.tiffsave("in.tif", page_height=20)
        given = field(around(Grid((20, 30))))
        options = GridOptions(crop=(3, 4, 20, 10))
        warp_file("in.tif", "out.tif", EMPTY, maps=[Placed(given)], grid=options)
        made = image.read("out.tif", pages=True)
        assert (made.pages, made.pixels.shape) == (3, (30, 20))
        d = Deformation((20, 30)).field(given)
        for page, wanted in zip(made.pixels.reshape(3, 10, 20), pages, strict=True):
            np.testing.assert_array_equal(page, d.warp(wanted)[4:14, 3:23])
        solid = Placed(field(around(Grid((3, 20, 30)))))
        assert Job("in.tif", "x.tif", EMPTY, maps=[solid]).medium.kind == "volume"
        assert Job("in.tif", "x.tif", EMPTY, grid=GridOptions(crop=(0, 0, 0, 2, 2, 2))).medium.kind == "volume"
        assert Job("in.tif", "x.tif", EMPTY, maps=[Placed(given)]).medium.kind == "picture"

    def test_warnings_of_folds(self, here: Path) -> None:
        grid = media.outline_of(_named("in.nii")).grid
        values = np.zeros((*grid.shape, 3), np.float32)
        values[:, :, 8:] = -6.0 * np.array(grid.direction)[:, 0]
        placed = Placed(Field(values, grid), True, name="u.nii")
        said = (
            r"^u\.nii folds in [\d,]+ of its 3,315 cells: where folds are mapped to, the inverse is one of several "
            r"points(; \d+ of the points found lie in a part that is turned over)?"
            r"(; for \d+ of them there is a guess, as no solution was found)? "
            r"\(the statuses of supple invert show where\)$"
        )
        own = {"save_field": "field.mha"}  # of the same map: it is not told of twice
        with warnings.catch_warnings(record=True, action="always") as caught:
            done = warp_file("in.nii", "out.nii", EMPTY, maps=[placed], filter="linear", **own)
        assert done.folded + done.unsolved > 0
        assert {each.category for each in caught} <= {FoldWarning, OutsideWarning}
        (text,) = (str(each.message) for each in caught if each.category is FoldWarning)
        assert re.match(said, text), text
        pictured("in.png", 40, 50)
        flat = np.zeros((40, 50, 2), np.float32)
        flat[:, 25:, 0] = -6.0
        maps = [Placed(Field(flat, Grid((40, 50))), True, after=1)]
        with warnings.catch_warnings(record=True, action="always") as caught:
            picture = warp_file("in.png", "out.png", FLAT, maps=maps)
        (text,) = (str(each.message) for each in caught if each.category is FoldWarning)
        assert text.startswith("the field folds in 39 of its 1,911 cells: ")
        assert picture.folded + picture.unsolved > 0
        with warnings.catch_warnings(action="error", category=FoldWarning):
            # which would be that of the field once more
            picture.report()

    def test_a_field_that_is_saved(self, here: Path) -> None:
        """On another grid: the saved field does by ITK what the warp did."""
        samples = stored("in.nii", voxels())
        turn = Placed(Affine([[1, 0, 0, 2.5], [0, 1, 0.1, 0], [0, 0, 1, -1]]))
        maps = [turn, Placed(field(around(OBLIQUE.grid(SHAPE))))]
        grid = GridOptions(resample=1.3, crop=(1, 1, 1, 8, 8, 12))
        warp_file(
            "in.nii", "out.nii", EMPTY, maps=maps, grid=grid, save_field="field.mha", filter="linear", tolerance=1e-4,
            clamp=False,
        )  # fmt: skip
        saved = SimpleITK.ReadImage("field.mha", SimpleITK.sitkVectorFloat64)
        like = SimpleITK.ReadImage("out.nii")
        np.testing.assert_allclose(saved.GetOrigin(), like.GetOrigin(), atol=1e-4)
        transform = SimpleITK.DisplacementFieldTransform(saved)
        wanted = SimpleITK.GetArrayFromImage(
            SimpleITK.Resample(SimpleITK.ReadImage("in.nii"), like, transform, SimpleITK.sitkLinear, -1e4)
        )
        inside = wanted > -1e4
        assert inside.mean() > 0.5
        slope = max(np.abs(np.diff(samples, axis=k)).max() for k in range(3))
        made = SimpleITK.GetArrayFromImage(like)
        np.testing.assert_allclose(made[inside], wanted[inside], atol=2e-3 * slope, rtol=0)


def _named(name: str) -> str:
    stored(name, voxels())
    return name


class TestGrids:
    @pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
    @pytest.mark.parametrize("maps", [False, True])
    def test_a_part_is_that_part_of_the_whole(self, here: Path, dtype: type, maps: bool) -> None:
        stored("in.nii.gz", voxels(dtype))
        given = [Placed(field(around(OBLIQUE.grid(SHAPE))), after=1)] if maps else []
        warp_file("in.nii.gz", "whole.nii.gz", SOLID, maps=given)
        warp_file("in.nii.gz", "part.nii.gz", SOLID, maps=given, grid=GridOptions(crop=(3, 2, 5, 9, 12, 6)))
        whole, part = (media.read(f"{name}.nii.gz") for name in ("whole", "part"))
        np.testing.assert_array_equal(part.samples, whole.samples[5:11, 2:14, 3:12])
        np.testing.assert_allclose(part.geometry.to_lps((0, 0, 0)), whole.geometry.to_lps((3, 2, 5)), atol=1e-4)
        resampled = GridOptions(resample=(1.0, 0.7, 1.5))
        box = (2, 5, 1, 10, 15, 9)
        warp_file("in.nii.gz", "fine.nii.gz", SOLID, maps=given, grid=resampled)
        warp_file("in.nii.gz", "piece.nii.gz", SOLID, maps=given, grid=replace(resampled, crop=box))
        fine, piece = (media.read(f"{name}.nii.gz").samples for name in ("fine", "piece"))
        np.testing.assert_array_equal(piece, fine[1:10, 5:20, 2:12])

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
    def test_a_part_of_a_picture(self, here: Path, dtype: type) -> None:
        pictured("in.tif", 40, 50, 3, dtype=dtype)
        given = [Placed(field(around(Grid((40, 50)))), after=1)]
        for maps in ((), given):
            warp_file("in.tif", "whole.tif", FLAT, maps=maps, force=True)
            warp_file("in.tif", "part.tif", FLAT, maps=maps, grid=GridOptions(crop=(11, 7, 30, 21)), force=True)
            whole, part = (image.read(f"{name}.tif").pixels for name in ("whole", "part"))
            np.testing.assert_array_equal(part, whole[7:28, 11:41])

    @pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".mhd"])
    @pytest.mark.parametrize("source", [".nii", ".nrrd", ".mha"])
    def test_the_place_that_is_written(self, here: Path, source: str, suffix: str) -> None:
        stored(f"in{source}", voxels())
        for options in (
            GridOptions(crop=(3, 2, 5, 9, 12, 6)),
            GridOptions(resample=0.8),
            GridOptions(resample=(0.8, 2.0, 1.5), crop=(1, 2, 3, 4, 5, 6)),
        ):
            done = warp_file(f"in{source}", f"out{suffix}", SOLID, grid=options, force=True, filter="linear")
            grid = output_grid(options, media.outline_of(f"in{source}").grid)
            assert done.grid == grid
            read = SimpleITK.ReadImage(f"out{suffix}")
            assert read.GetSize() == grid.sizes
            np.testing.assert_allclose(read.GetSpacing(), grid.spacing, rtol=1e-5)
            np.testing.assert_allclose(read.GetOrigin(), grid.origin, atol=1e-4)
            np.testing.assert_allclose(np.reshape(read.GetDirection(), (3, 3)), grid.direction, atol=1e-5)
            assert media.outline_of(f"out{suffix}").grid.is_same_space(grid)

    def test_a_reference(self, here: Path) -> None:
        """As SimpleITK resamples onto another image, of another type and another place."""
        stored("in.nii.gz", voxels())
        turned = Geometry((1.3, 0.8, 1.9), (12.0, -18.0, 28.0), np.eye(3)[[1, 0, 2]], "LPS")
        stored("ref.nrrd", np.zeros((9, 12, 11, 3), np.uint8), turned)
        warp_file(
            "in.nii.gz", "out.nii.gz", EMPTY, filter="linear", grid=GridOptions(reference="ref.nrrd"), clamp=False,
            outside="constant", fill=-5,
        )  # fmt: skip
        read, like = SimpleITK.ReadImage("in.nii.gz"), SimpleITK.ReadImage("ref.nrrd")
        wanted = SimpleITK.Resample(read, like, SimpleITK.Transform(), SimpleITK.sitkLinear, -5.0)
        made = SimpleITK.ReadImage("out.nii.gz")
        np.testing.assert_allclose(made.GetOrigin(), like.GetOrigin(), atol=1e-4)
        np.testing.assert_allclose(made.GetDirection(), like.GetDirection(), atol=1e-5)
        seen, known = SimpleITK.GetArrayFromImage(made), SimpleITK.GetArrayFromImage(wanted)
        inside = known != -5
        assert 0.1 < inside.mean() < 1
        close = np.isclose(seen, known, atol=0.02)
        assert close[ndimage.binary_erosion(inside, iterations=1)].all()

    def test_the_rest_of_a_header_is_kept(self, here: Path) -> None:
        header = nibabel.Nifti1Header()
        affine = np.diag([-0.0009, 0.0011, 0.002, 1.0])
        affine[:3, 3] = 0.01, 0.02, -0.03
        made = nibabel.Nifti1Image(voxels(np.int16), affine, header)
        made.header.set_xyzt_units("meter", "sec")
        made.set_qform(affine, 1)
        made.set_sform(affine, 4)
        made.header["descrip"] = b"a head"
        made.header["slice_end"], made.header["slice_code"] = 13, 1
        made.header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", b"kept"))
        nibabel.save(made, "in.nii")
        warp_file("in.nii", "out.nii", EMPTY, grid=GridOptions(crop=(2, 3, 4, 5, 6, 7)))
        seen = nibabel.load("out.nii")
        np.testing.assert_allclose(seen.affine @ (0, 0, 0, 1), affine @ (2, 3, 4, 1), rtol=1e-5)
        assert seen.shape == (5, 6, 7)
        assert [int(seen.header[name]) for name in ("qform_code", "sform_code", "slice_end")] == [1, 4, 0]
        np.testing.assert_allclose(seen.header.get_qform(), seen.header.get_sform(), atol=1e-7)
        assert seen.header.get_xyzt_units() == ("meter", "sec")
        assert bytes(seen.header["descrip"]).startswith(b"a head")
        assert seen.header.extensions[0].get_content() == b"kept"
        np.testing.assert_array_equal(np.asarray(seen.dataobj), np.asarray(made.dataobj)[2:7, 3:9, 4:11])

    def test_a_volume_without_a_place(self, here: Path) -> None:
        made = nibabel.Nifti1Image(voxels(np.int16).T, None)
        made.header.set_zooms((1.0, 2.0, 3.0))
        nibabel.save(made, "in.nii")
        warp_file("in.nii", "out.nii", EMPTY, grid=GridOptions(resample=2.0))
        seen = nibabel.load("out.nii").header
        assert [int(seen[name]) for name in ("qform_code", "sform_code")] == [0, 0]
        assert seen.get_zooms() == (2.0, 2.0, 2.0)
        assert nibabel.load("out.nii").shape == (8, 18, 21)
        stored("ref.nii", np.zeros((4, 5, 6), np.uint8), Geometry((1, 1, 1), (1.0, 2.0, 3.0), np.eye(3), "LPS"))
        warp_file("in.nii", "there.nii", EMPTY, grid=GridOptions(reference="ref.nii"))
        assert media.outline_of("there.nii").grid.is_same_space(media.outline_of("ref.nii").grid)

    def test_pictures_of_another_size(self, here: Path) -> None:
        pixels = pictured("in.png", 40, 50, 3)
        pictured("ref.png", 20, 70)
        warp_file("in.png", "out.png", EMPTY, grid=GridOptions(reference="ref.png"), outside="constant", fill=9)
        made = image.read("out.png").pixels
        np.testing.assert_array_equal(made[:, :50], pixels[:20])
        assert (made[:, 51:] == 9).all()
        done = warp_file("in.png", "small.png", FLAT, grid=GridOptions(resample=2))
        made = image.read("small.png").pixels
        grid = Grid((40, 50)).resampled(2.0)
        np.testing.assert_array_equal(made, Deformation.from_recipe(FLAT, (40, 50)).warp(pixels, grid=grid))
        assert made.shape == (20, 25, 3)
        assert done.report().within

    def test_what_a_picture_carries(self, here: Path) -> None:
        """The profile and the texts stay; the size that EXIF tells is the new one."""
        held = pyvips.Image.new_from_array(np.full((40, 50, 3), 99, np.uint8)).copy(interpretation="srgb")
        held = held.copy(xres=11.811, yres=11.811)
        for name, value in (("exif-ifd0-Artist", "Ada"), ("exif-ifd2-PixelXDimension", "50")):
            held.set_type(pyvips.GValue.gstr_type, name, value)
        held.jpegsave("in.jpg", profile="srgb")
        for name in ("out.jpg", "out.tif"):
            warp_file("in.jpg", name, EMPTY, grid=GridOptions(crop=(3, 5, 30, 20)))
            seen = image.read(name)
            assert seen.icc is not None
            assert seen.pixels.shape == (20, 30, 3)
        told = pyvips.Image.new_from_file("out.jpg")
        assert told.get("exif-ifd0-Artist").startswith("Ada")
        assert told.get("exif-ifd2-PixelXDimension").startswith("30 ")
        assert told.get("exif-ifd2-PixelYDimension").startswith("20 ")
        assert round(told.xres, 2) == 11.81


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "said"),
        [
            ({"crop": (1, 2, 3)}, "crop must be X,Y,W,H for a picture"),
            ({"crop": (1, 2, 0, 3)}, "indices from 0 and sizes from 1, found 0"),
            ({"crop": (-1, 2, 1, 3)}, "found -1"),
            ({"crop": (1.5, 2, 1, 3)}, "found 1.5"),
            ({"resample": 0}, "resample must be a spacing above 0"),
            ({"resample": "2"}, "resample must be a spacing above 0"),
            ({"resample": (1, -1)}, "resample must be a spacing above 0"),
        ],
    )
    def test_options(self, options: dict[str, Any], said: str) -> None:
        refused(GridOptions, **options, match=said)

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            ({"maps": [3]}, r"maps must be a sequence of Placed, found \[3\]"),
            ({"device": "gpu"}, r'device must be "cpu", "cuda" .* or "auto", found .gpu.'),
            ({"fit": "crop"}, r"^fit must be .pixels. or .stretch. or .inside., found 'crop'"),
        ],
    )
    def test_arguments(self, here: Path, options: dict[str, Any], said: str) -> None:
        pictured("in.png", 40, 50, 3)
        refused(warp_file, "in.png", "out.png", replace(FLAT, size=(25, 20)), **options, match=said)
        assert not Path("out.png").exists()

    def test_pictures_of_scenes_and_of_the_published_method(self) -> None:
        from supple.plot import measure
        from supple.render.scene import Scene

        shift = Affine([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]])
        with pytest.raises(SuppleError, match="a scene is bent by strokes alone"):
            Scene(voxels(), deformation=Deformation(SHAPE).affine(shift))
        flat = Deformation((40, 50)).affine([[1, 0, 1], [0, 1, 0]])
        refused(measure.iterations, flat, match="the published method inverts strokes alone")
        errors = measure.residual(flat)
        assert errors.distance.max() < 1e-6
        np.testing.assert_allclose(measure.sources(flat)[1][3, 4], (5, 3))
        np.testing.assert_allclose(measure.stretch(flat), 1.0)
        np.testing.assert_allclose(measure.footprints(flat).major, 1.0)
        assert measure.grid(flat)[0][0, 0] == pytest.approx(-1.5)
        with pytest.raises(SuppleError, match="leave straightening out"):
            measure.residual(Deformation((40, 50)).straighten(rotate=30, fit="pad"))
