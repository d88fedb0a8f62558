"""Tensors against the slow reference: the rows of the table whose types PyTorch has, with channels first."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from supple import Deformation
from tests.engine.table import Limits, Row, rows

if os.environ.get("SUPPLE_TEST_TORCH") == "1":
    import torch
else:
    torch = pytest.importorskip("torch")

import supple.torch as bending
from supple.engine import core
from supple.torch.engine import inverse

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

# What is frozen is in test_freeze.py.
ROWS = [
    *rows(["image", "image, local", "image, turned"], ("bool", "u1", "i2", "f4", "f8"), few=True),
    *(row for row in rows(["clip", "volume", "volume, turned"], ("u1", "f4"), few=True) if not row.average),
]


def by_torch(d: Deformation, source: npt.NDArray[Any], **options: Any) -> npt.NDArray[Any]:
    for what in ("alpha", "time_filter"):
        options.pop(what, None)
    bare = source.ndim == d.ndim
    tensor = torch.from_numpy(source if bare else np.ascontiguousarray(np.moveaxis(source, -1, 0)))
    made = bending.warp(tensor, d, tolerance=1e-5, **options).detach().numpy()
    return made if bare else np.moveaxis(made, 0, -1)


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_rows(row: Row) -> None:
    row.check(by_torch, Limits(3e-4), (0, 1, 3))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int16])
def test_a_constant_is_one_of_the_type(dtype: torch.dtype) -> None:
    d = Deformation((23, 31), border=None).grab((10, 9), by=(7, 5), radius=12)
    flat = torch.full((23, 31), 100, dtype=dtype)
    most, least = torch.iinfo(dtype).max, torch.iinfo(dtype).min
    for beyond, within in ((1e30, most), (-1e30, least)):
        found = [bending.warp(flat, d, outside="constant", fill=fill) for fill in (beyond, within)]
        assert torch.equal(*found)


def test_points_are_those_of_the_core() -> None:
    d = Deformation((20, 31)).grab((10, 9), by=(4, 3), radius=9).grab((20, 12), by=(-3, 2), radius=7)
    points = np.random.default_rng(4).uniform(2, 17, (6, 5, 2))
    wanted, _ = core.inverse(d.space, points)
    for found, one in zip(inverse(d.space, torch.from_numpy(points)), wanted, strict=True):
        np.testing.assert_array_equal(found.numpy(), one)
