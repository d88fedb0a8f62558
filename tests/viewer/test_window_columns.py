"""What is drawn on the canvas is the picture, column by column: a shift by a pixel is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from supple.gpu.device import Gpu
from supple.viewer.panels.view import TOP, View
from tests.viewer.windows import opened, wait_for


def unmarked(view: View) -> None:
    """Lay out nothing over the picture; the planes of a volume are sampled all the same."""
    if view.slices is not None:
        view.slices.update(view.tools)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["photo", "clip", "volume"])
def test_each_column_is_where_it_belongs(
    gpu: Gpu, kind: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    source: Path = request.getfixturevalue(kind)
    monkeypatch.setattr("supple.viewer.panels.overlay.draw", unmarked)
    monkeypatch.setattr("supple.viewer.panels.view.SETTLED", 0.0)  # nothing is drawn coarser for a while
    view, hand = opened(source)
    if kind != "volume":
        hand.key("1")
    wait_for(lambda: hand.canvas.draw() is not None and view.painter.ready, 30.0, every=0.02)
    width, height = (round(n) for n in view.area)
    seen = hand.canvas.draw()[: TOP + height, :width, :3].astype(int)
    # What is saved of a view is what is on the canvas.
    assert np.abs(seen[TOP:] - view.pixels()).max() <= 1
    if kind == "volume":  # whose planes are compared with exports elsewhere
        return
    picture = view.stage._frame(0.0)[..., :3].astype(int)
    x, y = (int(np.floor(v)) for v in view.tools.view.to_canvas(0, 0))
    rows, columns = picture.shape[:2]
    assert x > 0
    assert y > 0
    for k in (0, columns // 2, columns - 1):
        column = picture[:, k]
        assert np.abs(seen[y : y + rows, x + k] - column).max() <= 1
        assert np.abs(np.diff(picture[:, k - 1 : k + 1], axis=1)).max(initial=99) > 8  # the one beside it is another
    assert np.abs(seen[y : y + rows, x - 1] - seen[TOP, 0]).max() == 0
    assert np.abs(seen[y : y + rows, x + columns] - seen[TOP, 0]).max() == 0
