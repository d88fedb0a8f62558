"""Labels by their shares: against the samples of one picture for each label, in slow NumPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import gaussian_filter

import supple
from supple import Deformation, SuppleError
from supple.engine.sampling import Sampling
from tests.effort import pairs
from tests.reference import arrays as slow
from tests.reference.motion import carried_out

Array = npt.NDArray[Any]


def regions(shape: tuple[int, ...], count: int, dtype: str = "uint8", seed: int = 0) -> Array:
    """Smooth regions of labels that are not neighbours in value."""
    rng = np.random.default_rng(seed)
    heights = np.stack([gaussian_filter(rng.normal(size=shape), 2.5) for _ in range(count)])
    return (heights.argmax(axis=0) * 37 % 101).astype(dtype)


def shares(labels: Array, warp: Any, fill: float | None = None) -> tuple[Array, Array]:
    """Return the labels of the largest shares, and by how much they are larger than the next ones."""
    known = np.unique(labels if fill is None else np.append(labels.ravel(), labels.dtype.type(fill)))
    found = warp((labels[..., None] == known).astype(np.float32), known == fill)  # the map is solved once for all
    two = np.sort(found, axis=-1)[..., -2:]
    return known[found.argmax(axis=-1)], two[..., 1] - two[..., 0]


def close(ours: Array, theirs: Array, margin: Array) -> None:
    """They are equal but where two shares are as good as equal: the reference solves the map exactly."""
    wrong = ours != theirs
    assert (margin[wrong] < 0.05).all()
    assert wrong.mean() < 0.005


@pytest.mark.parametrize("outside", ["edge", "constant", "reflect"])
def test_an_image_against_slow_numpy(outside: str) -> None:
    d = Deformation((70, 90), border=None).grab((40, 30), by=(14, -9), radius=18).scale((60, 45), factor=0.4, radius=15)
    labels = regions(d.shape, 7)
    fill = 37.0 if outside == "constant" else None
    made = d.warp(labels, filter="labels", outside=outside, fill=fill or 0.0)
    assert made.dtype == labels.dtype
    theirs, margin = shares(labels, lambda one, f: slow.warp(one, carried_out(d), d.domain, "auto", outside, f), fill)
    close(made, theirs, margin)
    assert (made != d.warp(labels, filter="nearest", outside=outside, fill=fill or 0.0)).mean() > 0.005


def test_a_volume_against_slow_numpy() -> None:
    d = Deformation((14, 24, 22), border=None).grab((11, 12, 7), by=(3, 2, -2), radius=6)
    labels = regions(d.shape, 5, "int16") - 50
    made = d.warp(labels, filter="labels")

    def warp(one: Array, _: Array) -> Array:
        return slow.warp_frames(one, carried_out(d), d.domain, "auto", "cubic", time_filter=True)

    theirs, margin = shares(labels, warp)
    close(made, theirs, margin)


@pytest.mark.parametrize(
    ("dtype", "shape", "channels"),
    pairs(["bool", "uint16", "int32", "float32", "f8", ">i2"], [(60, 130), (11, 50, 36)], [0, 2]),
)
def test_every_type_has_the_labels_of_one_warp_for_each(dtype: str, shape: tuple[int, ...], channels: int) -> None:
    d = Deformation(shape).grab([n * 0.4 for n in shape[::-1]], by=[6, -5, 3][: len(shape)], radius=16)
    labels = regions(shape, 2 if dtype == "bool" else 40, "uint8")
    labels = (labels > 0 if dtype == "bool" else labels).astype(dtype)
    given = np.stack([labels, labels[::-1]], axis=-1) if channels else labels
    made = d.warp(given, filter="labels")
    assert made.dtype == given.dtype
    how: dict[str, Any] = {"between": "cubic", "time_filter": True} if len(shape) == 3 else {}
    theirs, _ = shares(labels, lambda one, _: d.warp(one, **how))
    np.testing.assert_array_equal(made[..., 0] if channels else made, theirs)
    assert set(np.unique(made)) <= set(np.unique(given))


def test_parts_are_those_of_the_whole() -> None:
    d = Deformation((40, 70, 66)).grab((30, 35, 20), by=(8, -6, 4), radius=14)
    labels = regions(d.shape, 12)
    whole = d.warp(labels, filter="labels")
    for first, sizes in (((3, 5, 7), (40, 30, 20)), ((0, 0, 31), (66, 70, 2)), ((33, 1, 0), (1, 69, 40))):
        part = d.warp(labels, filter="labels", grid=d.grid.crop(first, sizes))
        x, y, z = (slice(a, a + n) for a, n in zip(first, sizes, strict=True))
        np.testing.assert_array_equal(part, whole[z, y, x])


def test_what_nothing_moves_stays_whatever_its_size() -> None:
    """A label of one voxel survives the identity beside a stroke; far from it, no label changes."""
    d = Deformation((30, 60, 60)).grab((15, 15, 15), by=(3, 0, 0), radius=4)
    labels = np.random.default_rng(0).integers(0, 200, d.shape, dtype=np.uint8)
    made = d.warp(labels, filter="labels")
    np.testing.assert_array_equal(made[:, 40:, 40:], labels[:, 40:, 40:])
    assert (made != labels).any()


def test_lazy_arrays(tmp_path: Path) -> None:
    dask = pytest.importorskip("dask.array")
    from supple.dask import warp

    d = Deformation((20, 50, 60)).grab((30, 25, 10), by=(6, -4, 2), radius=12)
    labels = regions(d.shape, 9)
    lazy = warp(dask.from_array(labels, chunks=(7, 20, 25)), d, filter="labels")
    np.testing.assert_array_equal(lazy.compute(), d.warp(labels, filter="labels"))


def test_what_is_refused() -> None:
    d = Deformation((20, 30)).grab((12, 10), by=(2, 0), radius=5)
    with pytest.raises(SuppleError, match="source must be an array of labels, which are finite, found NaN"):
        d.warp(np.full((20, 30), np.nan), filter="labels")
    with pytest.raises(SuppleError, match="labels are no colours: leave linear_light out"):
        Sampling("labels", linear_light=True)
    torch = pytest.importorskip("torch")
    from supple.torch import warp

    with pytest.raises(SuppleError, match=r'filter must be "auto", "cubic", "linear" or "nearest" for tensors'):
        warp(torch.zeros(20, 30), d, filter="labels")


def test_a_clip_in_a_file_has_no_labels(tmp_path: Path) -> None:
    from supple.files import warp_file
    from supple.media import image

    recipe = supple.Recipe(strokes=(supple.Stroke.grab((9, 9), by=(2, 0), radius=5),))
    for k in range(3):
        image.write(tmp_path / f"{k}.png", np.zeros((20, 30), np.uint8))
    with pytest.raises(SuppleError, match=r'filter must be "auto", "cubic", "linear" or "nearest" for a clip'):
        warp_file(f"{tmp_path}/%d.png", f"{tmp_path}/out%d.png", recipe, filter="labels")
