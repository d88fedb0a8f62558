"""How much of what could be tested is: under sanitizers, where all is slow, one case in some."""

from __future__ import annotations

import os

from hypothesis import settings

EVERY = int(os.environ.get("SUPPLE_TEST_EVERY", "1"))


def examples(most: int) -> settings:
    """Return how many examples are drawn of a property."""
    return settings(max_examples=max(3, most // EVERY))
