"""Between the eight nodes of a cell of `supple.cpu.solid`: their numbers four at a time.

A node is sixteen float32: u, ∂p/∂x, ∂p/∂y and ∂p/∂z, each of three coordinates and a 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from supple.cpu.vector import data_of, fused, splat, vector_at

_FLOAT, _WHOLE = ir.FloatType(), ir.IntType(64)
_FOUR = ir.VectorType(_FLOAT, 4)


def _loaded(context: Any, builder: Any, kind: Any, where: Sequence[Any], first: int, lanes: int) -> list[Any]:
    """``lanes`` numbers of each of the eight nodes, from the ``first`` on; x changes first."""
    nodes, place, row, layer = where
    data = data_of(context, builder, kind, nodes)
    found = []
    for corner in range(8):
        start = builder.add(place, ir.Constant(_WHOLE, first + 16 * (corner & 1)))
        for bit, stride in ((2, row), (4, layer)):
            if corner & bit:
                start = builder.add(start, stride)
        found.append(builder.load(vector_at(builder, data, start, lanes, _FLOAT), align=4))
    return found


def _half(builder: Any, vector: Any, which: int) -> Any:
    whole = ir.IntType(32)
    lanes = ir.Constant(ir.VectorType(whole, 4), [ir.Constant(whole, 4 * which + k) for k in range(4)])
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), lanes)


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
        # Eight at a time: u beside ∂p/∂x, and ∂p/∂y beside ∂p/∂z.
        values, slopes = (_loaded(context, builder, signature.args[0], args[:4], first, 8) for first in (0, 8))
        parts = [splat(builder, a, 8) for a in args[4:7]]
        narrow, bends = ([splat(builder, a, 4) for a in given] for given in (args[4:7], args[7:10]))

        def across(axis: int, a: Any, b: Any) -> tuple[Any, Any]:
            change = builder.fsub(b, a)
            return change, fused(builder, parts[axis], change, a)

        def bent(axis: int, value: Any, change: Any) -> Any:
            return fused(builder, builder.fneg(bends[axis]), change, value)

        # Along x, then y, then z: what is left of a node is u and the slopes along the axes to come.
        u, g = [], []
        for k in range(0, 8, 2):
            change, line = across(0, values[k], values[k + 1])
            u.append(bent(0, _half(builder, line, 0), _half(builder, change, 1)))
            g.append(across(0, slopes[k], slopes[k + 1])[1])
        for k in range(2):
            change, g[k] = across(1, g[2 * k], g[2 * k + 1])
            line = _line(builder, narrow[1], u[2 * k], u[2 * k + 1])
            u[k] = bent(1, line, _half(builder, change, 0))
        change = builder.fsub(_half(builder, g[1], 1), _half(builder, g[0], 1))
        total = bent(2, _line(builder, narrow[2], u[0], u[1]), change)
        lanes = [builder.extract_element(total, ir.Constant(ir.IntType(32), k)) for k in range(3)]
        return _numbers(builder, context, lanes)

    i, f = types.int64, types.float32
    return types.UniTuple(f, 3)(nodes, i, i, i, f, f, f, f, f, f), generate


@intrinsic
def turned(
    typing: Any, nodes: Any, place: Any, row: Any, layer: Any, u: Any, v: Any, w: Any, fx: Any, fy: Any, fz: Any
) -> Any:
    """(∂p/∂q)ᵀ f at (u, v, w) of a cell, with ∂p/∂q between its nodes; see `displaced`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        columns = []
        for first, lanes in ((4, 4), (8, 8)):
            corners = _loaded(context, builder, signature.args[0], args[:4], first, lanes)
            for part in args[4:7]:
                share = splat(builder, part, lanes)
                corners = [_line(builder, share, a, b) for a, b in zip(corners[::2], corners[1::2], strict=True)]
            columns.append(corners[0])
        sums = []
        for column in (columns[0], _half(builder, columns[1], 0), _half(builder, columns[1], 1)):
            total = None
            for k, force in enumerate(args[7:10]):
                lane = builder.extract_element(column, ir.Constant(ir.IntType(32), k))
                total = fused(builder, lane, force, total) if total else builder.fmul(lane, force)
            sums.append(total)
        return _numbers(builder, context, sums)

    i, f = types.int64, types.float32
    return types.UniTuple(f, 3)(nodes, i, i, i, f, f, f, f, f, f), generate
