"""How much of what could be tested is: pairs of options and few examples, unless all are asked for by `make soak`."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import settings

ALL = os.environ.get("SUPPLE_TEST_ALL") == "1"
EVERY = int(os.environ.get("SUPPLE_TEST_EVERY", "1"))  # under sanitizers, where all is slow, one case in some
CASES = 16  # and of a test at most so many cases

left_out = 0
"""How many rows of full products this process knows of that are not tested in it."""


def examples(count: int) -> settings:
    """Return settings by which a property is tried with ``count`` examples; ten times as many in `make soak`."""
    return settings(max_examples=10 * count if ALL else max(3, count // EVERY))


def pairs(*axes: Sequence[Any], where: Callable[..., bool] | None = None) -> list[tuple[Any, ...]]:
    """Return rows of options, so that any two values of different axes are together in some row.

    In `make soak`, these are all rows. ``where``, given the values of a row, returns whether there is such a row.
    """
    global left_out
    product = [row for row in itertools.product(*axes) if where is None or where(*row)]
    assert product, "no row is admitted"
    if ALL:
        return product
    met = [{(*at, *(row[k] for k in at)) for at in itertools.combinations(range(len(axes)), 2)} for row in product]
    missing = set().union(*met)
    chosen = []
    while missing:  # greedily: the row with most that is missing
        best = max(range(len(product)), key=lambda k: len(met[k] & missing))
        missing -= met[best]
        chosen.append(best)
    left_out += len(product) - len(chosen)
    return [product[k] for k in sorted(chosen)]


def soak(covers: str) -> pytest.MarkDecorator:
    """Mark a test that is slow, and finds what others would hardly miss; ``covers`` says in a few words what."""
    return pytest.mark.skipif(not ALL, reason=f"only in make soak: {covers}")
