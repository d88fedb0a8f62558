"""Pixels whose samples lie side by side: against NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from supple.cpu import adjacent
from supple.cpu.adjacent import TOGETHER


@njit
def _counting(numbers: Any, start: int) -> Any:
    return adjacent.alike(numbers, start), adjacent.adjacent(numbers, start)


@njit
def _bytes(above: Any, below: Any, start: int, words: Any, to: int) -> None:
    adjacent.join_bytes(above, below, start, words, to)


@njit
def _pairs(source: Any, start: int, after: int, words: Any, to: int) -> None:
    adjacent.join_pairs(source, start, after, words, to)


def test_numbers_that_count_up_or_are_the_same() -> None:
    for step in (0, 1):
        for start in (0, 3):
            numbers = np.full(TOGETHER + 5, -7, np.int32)
            numbers[start : start + TOGETHER] = -2 + step * np.arange(TOGETHER)
            assert _counting(numbers, start) == (step == 0, step == 1)
            for k in range(TOGETHER):
                for off in (-1, 1, 2**20):
                    other = numbers.copy()
                    other[start + k] += off
                    assert _counting(other, start) == (False, False)


def test_words_are_made_of_neighbours() -> None:
    rng = np.random.default_rng(0)
    above, below = rng.integers(0, 256, (2, 50), dtype=np.uint8)
    words: npt.NDArray[np.uint32] = np.zeros(40, np.uint32)
    for start, to in ((0, 0), (5, 1), (50 - TOGETHER - 1, 40 - TOGETHER)):
        words[:] = 7
        _bytes(above, below, start, words, to)
        k = start + np.arange(TOGETHER)
        a, b, c, d = (row[k + j].astype(np.uint32) for row in (above, below) for j in (0, 1))
        np.testing.assert_array_equal(words[to : to + TOGETHER], a | b << 8 | c << 16 | d << 24)
        assert (np.delete(words, np.arange(to, to + TOGETHER)) == 7).all()


def test_pairs_of_bytes_and_numbers_of_16_bits_make_words() -> None:
    rng = np.random.default_rng(1)
    octets, deep = rng.integers(0, 256, 90, dtype=np.uint8), rng.integers(0, 65536, 45, dtype=np.uint16)
    words: npt.NDArray[np.uint32] = np.zeros(TOGETHER + 2, np.uint32)
    for source, scale in ((octets, 2), (deep, 1)):
        numbers = source.view(np.uint16).astype(np.uint32)
        for first in (0, 3, 45 - TOGETHER - 1):
            _pairs(source, first * scale, (first + 1) * scale, words, 2)
            k = first + np.arange(TOGETHER)
            np.testing.assert_array_equal(words[2:], numbers[k] | numbers[k + 1] << 16)
    odd = octets[1:]  # two bytes may begin anywhere
    _pairs(odd, 0, 2, words, 0)
    numbers = octets[1:-1].view(np.uint16).astype(np.uint32)
    np.testing.assert_array_equal(words[:TOGETHER], numbers[:TOGETHER] | numbers[1 : TOGETHER + 1] << 16)
