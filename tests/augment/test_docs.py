"""The libraries' parts of docs/augmentation.md are run where the library is installed."""

from __future__ import annotations

import re
import warnings

import pytest

from tests.augment.libraries import library
from tests.children import ROOT

PAGE = (ROOT / "docs" / "augmentation.md").read_text(encoding="utf-8")
FENCE = re.compile(r"^```py\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PARTS = {part.partition("\n")[0]: code for part in PAGE.split("\n## ") for code in FENCE.findall(part)}


def test_each_library_has_a_part() -> None:
    assert list(PARTS) == ["torchvision", "Albumentations", "MONAI", "TorchIO"]


@pytest.mark.parametrize("name", PARTS)
def test_a_part_runs(name: str) -> None:
    try:
        library(name.lower())
    except pytest.skip.Exception as skipped:
        pytest.skip(str(skipped))
    with warnings.catch_warnings(action="ignore"):  # those of the library
        exec(compile(PARTS[name], f"docs/augmentation.md, {name}", "exec"), {})
