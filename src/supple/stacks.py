"""Frames or slices that are all at hand, in memory or mapped to it: planes side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.certificate import Certificate
from supple.streaming import Layout, Sampling, Space, samplings_of, step_of
from supple.strokes import numbers

Array = npt.NDArray[Any]

TOGETHER = 8  # planes for each thread, between which a caller hears how far it is


def warp_stack(
    space: Space,
    layout: Layout,
    sampling: Sampling,
    planes: Sequence[int],
    sources: Sequence[Array],
    outs: Sequence[Array],
) -> Iterator[tuple[int, Certificate]]:
    """Warp a clip or a volume whose frames can be read in any order.

    Unlike `supple.streaming.stream`, it needs no plan, as nothing has to be held: each plane finds the frames it needs.

    Parameters
    ----------
    space, layout, sampling
        What to do, with what.
    planes : sequence of int
        Which planes of the output are wanted.
    sources : sequence of arrays
        All frames, one array (T, h, w, channels) for each group: contiguous, of the layout's type.
    outs : sequence of arrays
        Where the planes go, in the order of ``planes``: one array (len(planes), h, w, channels) for each group.

    Yields
    ------
    int
        How many planes are done.
    Certificate
        How exact the map is of those that were done since the last time.
    """
    step = step_of(layout)
    together = TOGETHER * _core.threads()
    table, frames = numbers(space.table), [np.asarray(source) for source in sources]
    for start in range(0, len(planes), together):
        some = planes[start : start + together]
        parts = [np.asarray(out[start : start + len(some)]) for out in outs]
        height, width = space.planned(step)
        given = samplings_of(space, layout, sampling, frames, parts, space.count)
        error, evaluations = _core.warp_stack(table, space.axes, height, width, list(some), sampling.tolerance, given)
        yield start + len(some), Certificate(error, evaluations)
