"""The native engine against the slow reference: every row of the table."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy.typing as npt
import pytest

from supple import Deformation
from tests.effort import EVERY
from tests.engines.table import CLEAR, Limits, Row, rows

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

IMAGES = [
    *rows(["image", "image, squeezed", "image, local"]),
    *rows(["image"], CLEAR, ["opacity", "light", "opacity and light"]),
    *rows(["image, turned", "image, frozen"], few=True),
]
CLIPS = [
    *rows(["clip"], ("bool", "u1", "u2", "i2", "f2", "f4", "f8")),
    *rows(["clip, hurried", "clip, local", "volume", "volume, turned", "clip, frozen", "volume, frozen"], few=True),
    *rows(["clip"], CLEAR, ["opacity", "light", "opacity and light"], few=True),
]

# One row in some: no multiple of the table's other sides.
IMAGES, CLIPS = IMAGES[::EVERY], CLIPS[::EVERY]

# Types whose rows are the same otherwise: the reference is asked for all of them together.
BESIDE: dict[Row, list[str]] = defaultdict(list)
for _row in (*IMAGES, *CLIPS):
    BESIDE[replace(_row, dtype="")].append(_row.dtype)


def native(d: Deformation, source: npt.NDArray[Any], **options: Any) -> npt.NDArray[Any]:
    return d.warp(source, tolerance=1e-5, **options)


@pytest.mark.parametrize("row", IMAGES, ids=str)
def test_images(row: Row) -> None:
    row.check(native, Limits(), types=tuple(BESIDE[replace(row, dtype="")]))


@pytest.mark.parametrize("row", CLIPS, ids=str)
def test_clips(row: Row) -> None:
    # How fast time runs is interpolated between nodes.
    limits = Limits(5e-3, 2e-4) if row.average else Limits(3e-4)
    row.check(native, limits, (0, 1, 2, 3, 4, 5), tuple(BESIDE[replace(row, dtype="")]))
