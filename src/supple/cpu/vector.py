"""What the compiler does not turn into vector instructions by itself: weighted sums, and pixels of four bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic


def _pointer(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _at(builder: Any, pointer: Any, index: Any, lanes: int, element: Any) -> Any:
    return builder.bitcast(builder.gep(pointer, [index]), ir.VectorType(element, lanes).as_pointer())


def _splat(builder: Any, value: Any, lanes: int) -> Any:
    vector = ir.VectorType(value.type, lanes)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def _fused(builder: Any, a: Any, b: Any, c: Any) -> Any:
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))


def _signature(tile: Any, table: Any, out: Any) -> Any:
    i = types.intp
    return types.void(tile, i, i, table, i, i, out, i)


def four_channels(count: int) -> Callable[..., None]:
    """Makes ``f(tile, at, stride, table, along, down, out, to)`` for flat arrays of one type.

    It puts ``Σ_j Σ_i table[down + j] table[along + i] tile[4 (at + j stride + i) + c]``, ``count`` terms in each
    sum, into ``out[to + c]`` for four channels c.
    """

    @intrinsic
    def weighted(
        typing: Any, tile: Any, at: Any, stride: Any, table: Any, along: Any, down: Any, out: Any, to: Any
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            samples, at_, stride_, weights, along_, down_, target, to_ = args
            data = _pointer(context, builder, kind[0], samples)
            rows = _pointer(context, builder, kind[3], weights)
            element = context.get_data_type(kind[0].dtype)
            size = context.get_abi_sizeof(element)
            whole = ir.IntType(64)

            def weight(start: Any, k: int) -> Any:
                value = builder.load(builder.gep(rows, [builder.add(start, ir.Constant(whole, k))]))
                return _splat(builder, value, 4)

            across = [weight(along_, i) for i in range(count)]
            total = None
            for j in range(count):
                start = builder.add(at_, builder.mul(stride_, ir.Constant(whole, j)))
                start = builder.shl(start, ir.Constant(whole, 2))
                line = None
                for i in range(count):
                    place = _at(builder, data, builder.add(start, ir.Constant(whole, 4 * i)), 4, element)
                    value = builder.load(place, align=size)
                    line = _fused(builder, value, across[i], line) if line else builder.fmul(value, across[i])
                below = weight(down_, j)
                total = _fused(builder, line, below, total) if total else builder.fmul(line, below)
            place = _at(builder, _pointer(context, builder, kind[6], target), to_, 4, element)
            builder.store(total, place, align=size)
            return context.get_dummy_value()

        return _signature(tile, table, out), generate

    return weighted


def one_channel(count: int) -> Callable[..., None]:
    """The same for one channel: ``tile[at + j stride + i]`` into ``out[to]``; ``count`` is even."""

    @intrinsic
    def weighted(
        typing: Any, tile: Any, at: Any, stride: Any, table: Any, along: Any, down: Any, out: Any, to: Any
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            samples, at_, stride_, weights, along_, down_, target, to_ = args
            data = _pointer(context, builder, kind[0], samples)
            rows = _pointer(context, builder, kind[3], weights)
            element = context.get_data_type(kind[0].dtype)
            size = context.get_abi_sizeof(element)
            whole = ir.IntType(64)
            # Columns are summed first, in groups of four and two.
            groups = [(0, 4), (4, 2)] if count == 6 else [(0, count)]
            totals: list[Any] = [None] * len(groups)
            for j in range(count):
                start = builder.add(at_, builder.mul(stride_, ir.Constant(whole, j)))
                down_j = builder.load(builder.gep(rows, [builder.add(down_, ir.Constant(whole, j))]))
                for g, (first, lanes) in enumerate(groups):
                    place = _at(builder, data, builder.add(start, ir.Constant(whole, first)), lanes, element)
                    value, below = builder.load(place, align=size), _splat(builder, down_j, lanes)
                    totals[g] = _fused(builder, value, below, totals[g]) if totals[g] else builder.fmul(value, below)
            total = ir.Constant(element, 0.0)
            for (first, lanes), columns in zip(groups, totals, strict=True):
                place = _at(builder, rows, builder.add(along_, ir.Constant(whole, first)), lanes, element)
                product = builder.fmul(columns, builder.load(place, align=size))
                for lane in range(lanes):
                    part = builder.extract_element(product, ir.Constant(ir.IntType(32), lane))
                    total = builder.fadd(total, part)
            builder.store(total, builder.gep(_pointer(context, builder, kind[6], target), [to_]))
            return context.get_dummy_value()

        return _signature(tile, table, out), generate

    return weighted


@intrinsic
def spread_bytes(typing: Any, source: Any, start: Any, values: Any, at: Any) -> Any:
    """Four bytes from ``source[start]`` on, flat, become the four numbers from ``values[at]`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args
        element = context.get_data_type(kind[2].dtype)
        place = _at(builder, _pointer(context, builder, kind[0], args[0]), args[1], 4, ir.IntType(8))
        numbers = builder.uitofp(
            builder.zext(builder.load(place, align=1), ir.VectorType(ir.IntType(32), 4)),
            ir.VectorType(element, 4),
        )
        target = _at(builder, _pointer(context, builder, kind[2], args[2]), args[3], 4, element)
        builder.store(numbers, target, align=context.get_abi_sizeof(element))
        return context.get_dummy_value()

    return types.void(source, types.intp, values, types.intp), generate


@intrinsic
def gather_bytes(typing: Any, values: Any, at: Any, target: Any, to: Any) -> Any:
    """The reverse: four numbers, from 0 to 255, cut off to whole ones, become four bytes from ``target[to]`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args
        element = context.get_data_type(kind[0].dtype)
        place = _at(builder, _pointer(context, builder, kind[0], args[0]), args[1], 4, element)
        numbers = builder.load(place, align=context.get_abi_sizeof(element))
        whole = builder.fptosi(numbers, ir.VectorType(ir.IntType(32), 4))
        place = _at(builder, _pointer(context, builder, kind[2], args[2]), args[3], 4, ir.IntType(8))
        builder.store(builder.trunc(whole, ir.VectorType(ir.IntType(8), 4)), place, align=1)
        return context.get_dummy_value()

    return types.void(values, types.intp, target, types.intp), generate
