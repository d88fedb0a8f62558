"""Images and frames of clips alike: types, layouts, sizes of numbers, threads, refusals; see the engines' table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from supple import Deformation, SuppleError, ToleranceWarning
from supple.engine.sampling import Certificate
from tests import effort
from tests.engine.arrays import CLIP, FILTERS, IMAGE, RULES, bent, noise

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")
Shape = tuple[int, ...]
DTYPES = ["bool", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"]
MEDIA = pytest.mark.parametrize("shape", [IMAGE, CLIP], ids=["image", "clip"])


@pytest.mark.parametrize("dtype", [">u2", ">i2", ">f2", ">f4", ">f8"])
def test_the_order_of_bytes_makes_no_difference(dtype: str) -> None:
    source = noise(dtype, 3, CLIP)
    native = source.astype(np.dtype(dtype).newbyteorder("="))
    for name in FILTERS:
        out = bent(CLIP).warp(source, filter=name)
        assert out.dtype == source.dtype
        np.testing.assert_array_equal(out, bent(CLIP).warp(native, filter=name))


@MEDIA
@pytest.mark.filterwarnings("ignore::supple.ToleranceWarning")  # float32 does not count so far
@pytest.mark.parametrize("size", [1e9, 1e30])
def test_as_far_outside_as_numbers_go(shape: Shape, size: float) -> None:
    shape = (3, 280) if shape == IMAGE else (3, 5, 50)
    at, by = [0.5 * n for n in shape[::-1]], (size, size / 3, -size / 5)[: len(shape)]
    d = Deformation(shape, border=None, on_fold="damp").grab(at, by=by, radius=size / 2, reach=None)
    corner = (0, 0) if len(shape) == 2 else (-1, 0, 0)
    for channels, dtype, name in effort.pairs([1, 3], ["u1", "f4"], FILTERS):
        source = noise(dtype, channels, d.shape)
        how: dict[str, Any] = {"filter": name, "alpha": False, "time_filter": len(shape) == 3 and name == "auto"}
        made = d.warp(source, outside="edge", **how).astype(float)
        np.testing.assert_allclose(made, np.broadcast_to(source[corner], made.shape), rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(d.warp(source, outside="constant", fill=7, **how), 7, rtol=1e-5)
        made = d.warp(source, outside="reflect", **how).astype(float)
        assert np.isfinite(made).all()
        assert np.abs(made).max() <= 1.6 * np.abs(source.astype(float)).max()


@MEDIA
@pytest.mark.parametrize("filter", FILTERS)
def test_arrays_of_any_layout(shape: Shape, filter: str, tmp_path: Path) -> None:
    d, n = bent(shape), len(shape)
    wide = np.random.default_rng(4).uniform(size=(*[2 * size for size in shape], 6)).astype(np.float32)
    half = (slice(None, None, 2),) * (n + 1)
    base = np.ascontiguousarray(wide[half])
    expected = d.warp(base, filter=filter)
    frozen = base.copy()
    frozen.flags.writeable = False
    base.tofile(tmp_path / "source")
    layouts = {
        "strided": wide[half],
        "reversed": np.ascontiguousarray(base[::-1, ::-1])[::-1, ::-1],
        "Fortran": np.asfortranarray(base),
        "transposed": np.moveaxis(np.ascontiguousarray(np.moveaxis(base, -1, 0)), 0, -1),
        "big-endian": base.astype(">f4"),
        "frozen": frozen,
        "mapped": np.memmap(tmp_path / "source", np.float32, "r", shape=base.shape),
        "unaligned": np.frombuffer(b"?" + base.tobytes(), np.uint8)[1:].view(np.float32).reshape(base.shape),
    }
    for name, source in layouts.items():
        before = source.tobytes()
        out = d.warp(source, filter=filter)
        assert out.dtype == source.dtype, name
        assert out.flags.c_contiguous, name
        np.testing.assert_array_equal(out, expected, err_msg=name)
        assert source.tobytes() == before, name
        for order in ("C", "F"):
            given = np.full(source.shape, 7, source.dtype, order=order)
            assert d.warp(source, filter=filter, out=given) is given
            np.testing.assert_array_equal(given, expected, err_msg=name)
    whole = np.full(wide.shape, 7, np.float32)
    d.warp(base, filter=filter, out=whole[half])
    np.testing.assert_array_equal(whole[half], expected)
    assert (whole[1::2] == 7).all()
    written = np.memmap(tmp_path / "out", np.float32, "w+", shape=base.shape)
    assert d.warp(layouts["mapped"], filter=filter, out=written) is written
    written.flush()
    np.testing.assert_array_equal(np.fromfile(tmp_path / "out", np.float32).reshape(base.shape), expected)
    grey = d.warp(base[..., 0], filter=filter)
    assert grey.shape == shape
    np.testing.assert_array_equal(grey, d.warp(base[..., :1], filter=filter)[..., 0])


@MEDIA
@pytest.mark.parametrize("dtype", [*DTYPES, ">u2", ">i4", ">f2", ">f4", ">f8"])
def test_without_a_stroke_or_force_no_bit_changes(shape: Shape, dtype: str) -> None:
    """Any bits at all: NaNs of all kinds, infinities, subnormal numbers, zeros of both signs."""
    kind, n = np.dtype(dtype), len(shape)
    free, held = (Deformation(shape, border=border, on_fold="damp") for border in (None, 64))
    none = held.grab([3] * n, to=[3] * n, radius=5, reach=None).grab([5] * n, by=[-0.0] * n, radius=1, reach=None)
    still = [held, free.grab([3] * n, by=[0] * n, radius=5, reach=None), none]
    for channels in (1, 4):
        raw = np.random.default_rng(2).integers(0, 256, math.prod(shape) * channels * kind.itemsize, np.uint8)
        source = (raw & 1 if kind == np.bool_ else raw).view(kind).reshape(*shape, channels)
        if kind.kind == "f":
            source[0].flat[:5] = [np.nan, -np.inf, np.inf, -0.0, np.finfo(kind).smallest_subnormal]
        before = source.tobytes()
        for d, name, rule in effort.pairs(still, FILTERS, RULES):
            assert d.is_identity
            out = d.warp(source, filter=name, outside=rule, time_filter=n == 3)
            assert out.dtype == source.dtype
            assert out.tobytes() == before
            assert not np.may_share_memory(out, source)
        flipped = source[::-1, ::-1]
        assert held.warp(flipped).tobytes() == flipped.tobytes()
        assert source.tobytes() == before


GOOD = {shape: np.zeros((*shape, 3), np.uint8) for shape in (IMAGE, CLIP)}


def refused(shape: Shape) -> list[tuple[dict[str, Any], str]]:
    """Return what neither an image nor a clip takes."""
    good = GOOD[shape]
    sources: list[tuple[Any, str]] = [
        (np.zeros((*shape[:-1], shape[-1] + 1, 3), np.uint8), "source"),
        (np.zeros(shape[::-1], np.uint8), "source"),
        (np.zeros((shape[0] + 1, *shape[1:]), np.uint8), "source"),
        (np.zeros(shape[1:], np.uint8), "source"),
        (np.zeros((*shape, 3, 1), np.uint8), "source"),
        (np.zeros((*shape, 0), np.uint8), "source"),
        (np.zeros(shape, complex), "dtype complex128"),
        (np.zeros(shape, object), "dtype object"),
        (np.zeros(shape, "U3"), "dtype <U3"),
        (np.zeros(shape, "M8[s]"), "dtype datetime64"),
        (np.zeros(shape, [("r", "u1")]), "dtype"),
        (None, "dtype object"),
        ("photo.png", "the name of a file"),
        ([[1, 2], [3]], "source must be an array"),
        (3, "shape"),
    ]
    options: dict[str, list[Any]] = {
        "filter must be": ["lanczos", None],
        "outside must be": ["wrap"],
        "tolerance must be": [0, -1.0, math.nan, math.inf, "0.1"],
        "fill must be": [(1, 2), math.nan, math.inf, [1, math.inf, 3], "black", [[1, 2, 3]]],
        "linear_light must be": [1],
        "sampling must be a Sampling": ["linear"],
        "out must be": [good[..., 0], good.astype(np.uint16), good.astype(np.int8), [[0]]],
        "out must not overlap": [good, good[::-1]],
    }
    alone = [(np.zeros(shape, np.uint8), "alpha"), (np.zeros((*shape, 1), np.uint8), "alpha")]
    dark = [(np.zeros(shape, kind), "linear_light") for kind in (bool, np.int16, np.uint32)]
    return [
        *(({"source": source}, message) for source, message in sources),
        *(({message.split()[0]: value}, message) for message, values in options.items() for value in values),
        *(({"source": source, name: True}, name) for source, name in (*alone, *dark)),
    ]


BOTH = [(shape, *case) for shape in (IMAGE, CLIP) for case in refused(shape)]
FRAMES: list[tuple[dict[str, Any], str]] = [
    ({"between": "quintic"}, "between must be"),
    ({"between": 1}, "between must be"),
    ({"filter": "nearest", "between": "linear"}, "between must be"),
    ({"source": lambda p: p[:, 0]}, "dtype object"),
]
PICTURES: list[tuple[dict[str, Any], str]] = [
    ({"time_filter": True}, "time_filter must be left out for an image"),
    ({"between": "linear"}, "between must be left out for an image"),
]


@pytest.mark.parametrize(
    ("shape", "how", "message"), [*BOTH, *((CLIP, *case) for case in FRAMES), *((IMAGE, *case) for case in PICTURES)]
)
def test_refusals(shape: Shape, how: dict[str, Any], message: str) -> None:
    for d in (bent(shape), Deformation(shape, border=64, on_fold="damp")):
        with pytest.raises(SuppleError, match=message):
            d.warp(**{"source": GOOD[shape], **how})
    assert not GOOD[shape].any()


@MEDIA
def test_a_result_is_written_where_it_can_be(shape: Shape) -> None:
    frozen = np.zeros_like(GOOD[shape])
    frozen.flags.writeable = False
    with pytest.raises(SuppleError, match="read-only"):
        bent(shape).warp(GOOD[shape], out=frozen)
    np.testing.assert_array_equal(bent(shape).warp(GOOD[shape].tolist()), 0)  # what NumPy makes an array of will do


@pytest.mark.parametrize(("shape", "unit"), [((30, 40), "px"), ((12, 30, 40), "voxels")])
def test_what_is_off_is_told_in_the_samples_of_its_kind(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, ...], unit: str
) -> None:
    monkeypatch.setattr("supple.arrays.warp_array", lambda source, *_, **__: (source, Certificate(0.5, 1.0)))
    with pytest.warns(ToleranceWarning, match=rf"^the map may be off by 0.5 {unit} somewhere"):
        Deformation(shape).warp(np.zeros(shape, np.float32))
