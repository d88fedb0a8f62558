"""Pixels whose samples lie side by side, as where little is moved: these are read together, as vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from supple.cpu.vector import data_of, splat, vector_at

TOGETHER = 16  # pixels
_WHOLE = ir.IntType(32)


def _counting(step: int) -> Callable[..., bool]:
    @intrinsic
    def counting(typing: Any, numbers: Any, start: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            data, kind = data_of(context, builder, signature.args[0], args[0]), ir.VectorType(_WHOLE, TOGETHER)
            found = builder.load(vector_at(builder, data, args[1], TOGETHER, _WHOLE), align=4)
            first = splat(builder, builder.load(builder.gep(data, [args[1]])), TOGETHER)
            wanted = builder.add(first, ir.Constant(kind, [ir.Constant(_WHOLE, k * step) for k in range(TOGETHER)]))
            off = builder.bitcast(builder.icmp_signed("!=", found, wanted), ir.IntType(TOGETHER))
            return builder.icmp_signed("==", off, ir.Constant(off.type, 0))

        return types.boolean(numbers, types.intp), generate

    return counting


alike, adjacent = _counting(0), _counting(1)
"""``f(numbers, start)``: whether the next TOGETHER int32 from an index on are the same, or count up by one."""


def _joined(context: Any, builder: Any, kinds: Any, args: Any, parts: list[tuple[Any, Any, Any]], bits: int) -> None:
    """The numbers of ``bits`` from items of flat arrays on, side by side in words, into an array from a place on."""
    kind, words = ir.VectorType(_WHOLE, TOGETHER), None
    for k, (array, source, at) in enumerate(parts):
        place = vector_at(builder, data_of(context, builder, array, source), at, TOGETHER, ir.IntType(bits))
        part = builder.zext(builder.load(place, align=1), kind)
        if words is None:
            words = part
        else:
            words = builder.or_(words, builder.shl(part, ir.Constant(kind, [ir.Constant(_WHOLE, k * bits)] * TOGETHER)))
    target = vector_at(builder, data_of(context, builder, kinds[0], args[0]), args[1], TOGETHER, _WHOLE)
    builder.store(words, target, align=4)


@intrinsic
def join_bytes(typing: Any, above: Any, below: Any, start: Any, words: Any, to: Any) -> Any:
    """``above[i]``, ``above[i + 1]``, ``below[i]`` and ``below[i + 1]`` make a word: those for TOGETHER i.

    From ``start`` on, into ``words`` from ``to`` on; all are flat, the sources of bytes.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind, after = signature.args, builder.add(args[2], ir.Constant(args[2].type, 1))
        parts = [(kind[k], args[k], at) for k in (0, 1) for at in (args[2], after)]
        _joined(context, builder, kind[3:], args[3:], parts, 8)
        return context.get_dummy_value()

    return types.void(above, below, types.intp, words, types.intp), generate


@intrinsic
def join_pairs(typing: Any, source: Any, start: Any, after: Any, words: Any, to: Any) -> Any:
    """Numbers of two bytes, and those that come after them, make words: TOGETHER of them.

    They are in ``source`` from the items ``start`` and ``after`` on, and go into ``words`` from ``to`` on.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args
        _joined(context, builder, kind[3:], args[3:], [(kind[0], args[0], at) for at in args[1:3]], 16)
        return context.get_dummy_value()

    i = types.intp
    return types.void(source, i, i, words, i), generate
