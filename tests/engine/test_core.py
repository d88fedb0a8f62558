"""The native engine against the slow reference: the rows of the table."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy.typing as npt
import pytest

from supple import Deformation
from tests.effort import ALL, EVERY
from tests.engine.table import CLEAR, Limits, Row, rows

pytestmark = pytest.mark.filterwarnings("ignore::supple.FoldWarning")

PLANES = ["image", "image, squeezed", "image, local", "image, turned", "image, frozen"]
STACKS = ["clip", "clip, hurried", "clip, local", "clip, frozen", "volume", "volume, turned", "volume, frozen"]
KINDS = ["opacity", "light", "opacity and light"]
IMAGES = [*rows(PLANES, few=True), *rows(["image"], CLEAR, KINDS, few=True)]
CLIPS = [*rows(STACKS, few=True), *rows(["clip"], CLEAR, KINDS, few=True)]

IMAGES, CLIPS = IMAGES[:: -(-EVERY // 2)], CLIPS[:: -(-EVERY // 2)]

# Types whose rows are the same otherwise: the reference is asked for all of them together.
BESIDE: dict[Row, list[str]] = defaultdict(list)
for _row in (*IMAGES, *CLIPS):
    BESIDE[replace(_row, dtype="")].append(_row.dtype)


def numbers(k: int, row: Row) -> tuple[int, ...] | None:
    """Return how many channels the kth row is tested with: every second one has every second number."""
    return None if ALL or row.kind != "plain" else ((0, 1, 3), (2, 4, 5, 9))[k % 2]


def native(d: Deformation, source: npt.NDArray[Any], **options: Any) -> npt.NDArray[Any]:
    return d.warp(source, tolerance=1e-5, **options)


@pytest.mark.parametrize(("k", "row"), list(enumerate(IMAGES)), ids=str)
def test_images(k: int, row: Row) -> None:
    row.check(native, Limits(), numbers(k, row), tuple(BESIDE[replace(row, dtype="")]))


@pytest.mark.parametrize(("k", "row"), list(enumerate(CLIPS)), ids=str)
def test_clips(k: int, row: Row) -> None:
    # How fast time runs is interpolated between nodes.
    limits = Limits(5e-3, 2e-4) if row.average else Limits(3e-4)
    row.check(native, limits, numbers(k, row), tuple(BESIDE[replace(row, dtype="")]))
