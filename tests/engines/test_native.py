"""The native engine against the slow reference: every row of the table."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
import pytest

from supple import Deformation
from tests.engines.table import CLEAR, TYPES, Limits, Row, rows

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")


def native(d: Deformation, source: npt.NDArray[Any], **options: Any) -> npt.NDArray[Any]:
    return d.warp(source, tolerance=1e-5, **options)


ROWS = [
    *rows(["image", "image, squeezed", "image, local"]),
    *rows(["image"], CLEAR, ["opacity", "light", "opacity and light"]),
]


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_images(row: Row) -> None:
    row.check(native, Limits(), types=TYPES)


CLIP_TYPES = ("bool", "u1", "u2", "i2", "f2", "f4", "f8")
CLIPS = [
    *rows(["clip"], CLIP_TYPES),
    *rows(["clip, hurried", "clip, local", "volume"], few=True),
    *rows(["clip"], CLEAR, ["opacity", "light", "opacity and light"], few=True),
]


@pytest.mark.parametrize("row", CLIPS, ids=str)
def test_clips(row: Row) -> None:
    # How fast time runs is interpolated between nodes.
    row.check(
        native,
        Limits(5e-3, 2e-4) if row.average else Limits(3e-4),
        (0, 1, 2, 3, 4, 5),
        CLIP_TYPES if row.scene == "clip" else TYPES,
    )
