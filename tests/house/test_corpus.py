"""What the core makes of arrays stays as it is, bit for bit; see `corpus.py`, which knows more outputs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any

import pytest

from supple import _core
from tests import corpus

known = json.loads(corpus.KNOWN.read_text())


@pytest.mark.skipif(_core.isa != "v3", reason="the last bits are those of x86-64-v3")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "make"), list(corpus.arrays()), ids=lambda x: x if isinstance(x, str) else "")
def test_arrays(name: str, make: Callable[[], Any]) -> None:
    assert corpus.hashed(make()) == known[name]


@pytest.mark.parametrize("name", corpus.ERRORS)
def test_errors(name: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.symlink(corpus.DATA / "astronaut.jpg", "in.jpg")
    (tmp_path / "empty.json").write_text("{}")
    assert corpus.hashed(corpus.said(corpus.ERRORS[name])) == known[f"says {name}"]
