"""The GPU engine against the slow reference: the rows of the table whose types and channels shaders have."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
import pytest

from supple import Deformation
from supple.engines.wgpu.device import Gpu
from tests.engines.table import Limits, Row, rows

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

TYPES = ("u1", "u2", "i1", "i2", "f2", "f4")
KINDS = ["opacity", "light", "opacity and light"]

# A hundredth of a pixel is what a source point may be off; and the nearest sample may be another one there.
AWAY = Limits(most=0.03, mean=2e-3, margin=0.01)

# Each kind of a shader is compiled anew.
ROWS = [
    *(row for row in rows(["image"], TYPES, few=True) if row.filter == "linear" and row.dtype != "f4"),
    *rows(["image"], ("f4",)),
    *rows(["image, squeezed", "image, local", "image, turned", "image, frozen"], ("u1",), few=True),
    *rows(["clip"], ("u1", "u2"), few=True),
    *rows(["clip, frozen"], ("u1",), few=True),
    *(row for row in rows(["volume", "volume, turned", "volume, frozen"], ("f2",), few=True) if not row.average),
    *rows(["image"], ("u1",), KINDS, few=True),
    *(row for row in rows(["clip"], ("u1",), ["opacity and light"], few=True) if row.filter != "linear"),
]


def by_gpu(d: Deformation, source: npt.NDArray[Any], **options: Any) -> npt.NDArray[Any]:
    return d.warp(source, device="gpu", **options)


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_rows(gpu: Gpu, row: Row) -> None:
    several = row.scene == "image" and (row.filter == "linear" or row.kind != "plain")
    row.check(by_gpu, AWAY, (0, 1, 2, 3, 4) if several else (3, 4) if row.kind != "plain" else (3,))
