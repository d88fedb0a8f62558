"""The search for NaN and infinite samples."""

from __future__ import annotations

import numpy as np
import pytest

from supple import _core, arrays


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("count", [0, 1, 7, 8, 33, 32768, 70001])
def test_every_sample_is_seen(dtype: type, count: int) -> None:
    samples = np.random.default_rng(count).uniform(-1, 1, count).astype(dtype) * np.finfo(dtype).max
    assert _core.finite(samples)
    for at in {0, count // 2, count - 1} if count else ():
        for value in (np.nan, np.inf, -np.inf):
            spoiled = samples.copy()
            spoiled[at] = value
            assert not _core.finite(spoiled), (at, value)


def test_integers_are_finite() -> None:
    assert _core.finite(np.full((3, 5), 255, np.uint8))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_samples_may_lie_anywhere(dtype: type) -> None:
    """Between those of its size, too: then, the core does not read them."""
    memory = np.zeros(40 * np.dtype(dtype).itemsize + 1, np.uint8)
    samples = memory[1:].view(dtype)
    assert not samples.flags.aligned
    assert not arrays._has_gaps(samples)
    samples[-1] = np.nan
    assert arrays._has_gaps(samples)
