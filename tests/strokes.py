"""Strokes for tests, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from supple.strokes import Recipe, Stroke
from tests.refusals import refused


def grab(**changes: Any) -> Stroke:
    return Stroke(**{"at": (256, 256), "by": (0, 90), "radius": 100, **changes})


def refusal(call: Callable[[], object]) -> str:
    """The message with which a call is refused, checked to be one plain sentence."""
    message = refused(call)
    assert 10 < len(message) < 300
    return message


coordinates = st.floats(-1e30, 1e30)
ratios = st.floats(max_value=0.5, allow_nan=False, allow_infinity=True)


@st.composite
def recipes(draw: st.DrawFn) -> Recipe:
    ndim = draw(st.sampled_from([2, 3]))
    points = st.tuples(*[coordinates] * ndim)
    axes, factors = st.none() | points.filter(any), st.floats(0.01, 100)
    shapes: dict[str, dict[str, st.SearchStrategy[Any]]] = {
        "grab": {"by": points, "scales": st.sampled_from([1, 2, 3])},
        "twist": {"angle": st.floats(-3600, 3600), "axis": axes if ndim == 3 else st.none()},
        "scale": {"factor": factors},
        "pinch": {"factor": factors, "axis": axes},
    }
    strokes = st.one_of(
        st.builds(
            Stroke,
            brush=st.just(brush),
            at=points,
            radius=st.floats(1e-30, 1e30),
            poisson=st.none() | ratios,
            reach=st.none() | st.floats(1, 1e30),
            hidden=st.booleans(),
            name=st.none() | st.text(),
            strength=st.floats(0, 1),
            isotropic=st.booleans() if ndim == 3 else st.just(False),
            **shape,
        )
        for brush, shape in shapes.items()
    )
    space: Any = draw(st.sampled_from([None, "pixels", "LPS", "RAS"] if ndim == 3 else [None, "pixels"]))
    return Recipe(
        border=draw(st.none() | st.just("auto") | st.floats(1e-30, 1e30)),
        size=draw(st.none() | st.tuples(*[st.integers(1, 2**31 - 1)] * ndim)),
        space=space,
        amount=draw(st.floats(0, 1)),
        border_profile=draw(st.sampled_from(["quartic", "sine"])),
        on_fold=draw(st.sampled_from(["damp", "flow", "error"])),
        strokes=tuple(draw(st.lists(strokes, max_size=5))),
    )
