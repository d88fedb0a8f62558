"""Between the eight nodes of a cell of `supple.cpu.solid`: their numbers four at a time.

A node is sixteen float32: u, ∂p/∂x, ∂p/∂y and ∂p/∂z, each of three coordinates and a 0.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from supple.cpu.vector import data_of, fused, splat, vector_at

_FLOAT, _WHOLE = ir.FloatType(), ir.IntType(64)
_FOUR = ir.VectorType(_FLOAT, 4)


def _loaded(context: Any, builder: Any, kind: Any, nodes: Any, place: Any, row: Any, layer: Any) -> list[list[Any]]:
    """Four vectors of each of the eight nodes; x changes first."""
    data = data_of(context, builder, kind, nodes)
    found = []
    for corner in range(8):
        start = place
        for bit, stride in ((1, ir.Constant(_WHOLE, 16)), (2, row), (4, layer)):
            if corner & bit:
                start = builder.add(start, stride)
        where = [builder.add(start, ir.Constant(_WHOLE, 4 * k)) for k in range(4)]
        found.append([builder.load(vector_at(builder, data, w, 4, _FLOAT), align=4) for w in where])
    return found


def _line(builder: Any, part: Any, a: Any, b: Any) -> Any:
    return fused(builder, part, builder.fsub(b, a), a)


def _numbers(builder: Any, context: Any, values: list[Any]) -> Any:
    return context.make_tuple(builder, types.UniTuple(types.float32, 3), values)


@intrinsic
def displaced(
    typing: Any, nodes: Any, place: Any, row: Any, layer: Any, u: Any, v: Any, w: Any, bu: Any, bv: Any, bw: Any
) -> Any:
    """The displacement at (u, v, w) of a cell.

    ``place`` is where its first node starts in the flat ``nodes``, and ``row`` and ``layer`` how far it is to the next
    along y and z; ``bu`` is half of u (1 - u) h, and so on.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        corners = _loaded(context, builder, signature.args[0], *args[:4])
        parts, bends = ([splat(builder, a, 4) for a in given] for given in (args[4:7], args[7:10]))
        # Along x, then y, then z: what is left of a node is u and the slopes along the axes to come.
        for axis in range(3):
            joined = []
            for a, b in zip(corners[::2], corners[1::2], strict=True):
                line = _line(builder, parts[axis], a[0], b[0])
                value = fused(builder, bends[axis], builder.fsub(a[1], b[1]), line)
                joined.append([value, *(_line(builder, parts[axis], c, d) for c, d in zip(a[2:], b[2:], strict=True))])
            corners = joined
        lanes = [builder.extract_element(corners[0][0], ir.Constant(ir.IntType(32), k)) for k in range(3)]
        return _numbers(builder, context, lanes)

    i, f = types.int64, types.float32
    return types.UniTuple(f, 3)(nodes, i, i, i, f, f, f, f, f, f), generate


@intrinsic
def turned(
    typing: Any, nodes: Any, place: Any, row: Any, layer: Any, u: Any, v: Any, w: Any, fx: Any, fy: Any, fz: Any
) -> Any:
    """(∂p/∂q)ᵀ f at (u, v, w) of a cell, with ∂p/∂q between its nodes; see `displaced`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        corners = [c[1:] for c in _loaded(context, builder, signature.args[0], *args[:4])]
        for part in args[4:7]:
            share = splat(builder, part, 4)
            corners = [
                [_line(builder, share, c, d) for c, d in zip(a, b, strict=True)]
                for a, b in zip(corners[::2], corners[1::2], strict=True)
            ]
        sums = []
        for column in corners[0]:
            total = None
            for k, force in enumerate(args[7:10]):
                lane = builder.extract_element(column, ir.Constant(ir.IntType(32), k))
                total = fused(builder, lane, force, total) if total else builder.fmul(lane, force)
            sums.append(total)
        return _numbers(builder, context, sums)

    i, f = types.int64, types.float32
    return types.UniTuple(f, 3)(nodes, i, i, i, f, f, f, f, f, f), generate
