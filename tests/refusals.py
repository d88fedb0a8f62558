"""What is refused, in one line."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from supple.errors import SuppleError


def refused(action: Callable[..., object], *args: object, match: str | None = None, **options: object) -> str:
    """Return the one line that an action is refused with."""
    with pytest.raises(SuppleError, match=match) as caught:
        action(*args, **options)
    message = str(caught.value)
    assert message.isprintable()
    return message
