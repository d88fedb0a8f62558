"""What the compiler does not turn into vector instructions by itself: weighted sums, and pixels of four bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def vector_at(builder: Any, pointer: Any, index: Any, lanes: int, element: Any) -> Any:
    return builder.bitcast(builder.gep(pointer, [index]), ir.VectorType(element, lanes).as_pointer())


def splat(builder: Any, value: Any, lanes: int) -> Any:
    vector = ir.VectorType(value.type, lanes)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def fused(builder: Any, a: Any, b: Any, c: Any) -> Any:
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
            data = data_of(context, builder, kind[0], samples)
            rows = data_of(context, builder, kind[3], weights)
            element = context.get_data_type(kind[0].dtype)
            size = context.get_abi_sizeof(element)
            whole = ir.IntType(64)

            def weight(start: Any, k: int) -> Any:
                value = builder.load(builder.gep(rows, [builder.add(start, ir.Constant(whole, k))]))
                return splat(builder, value, 4)

            across = [weight(along_, i) for i in range(count)]
            total = None
            for j in range(count):
                start = builder.add(at_, builder.mul(stride_, ir.Constant(whole, j)))
                start = builder.shl(start, ir.Constant(whole, 2))
                line = None
                for i in range(count):
                    place = vector_at(builder, data, builder.add(start, ir.Constant(whole, 4 * i)), 4, element)
                    value = builder.load(place, align=size)
                    line = fused(builder, value, across[i], line) if line else builder.fmul(value, across[i])
                below = weight(down_, j)
                total = fused(builder, line, below, total) if total else builder.fmul(line, below)
            place = vector_at(builder, data_of(context, builder, kind[6], target), to_, 4, element)
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
            data = data_of(context, builder, kind[0], samples)
            rows = data_of(context, builder, kind[3], weights)
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
                    place = vector_at(builder, data, builder.add(start, ir.Constant(whole, first)), lanes, element)
                    value, below = builder.load(place, align=size), splat(builder, down_j, lanes)
                    totals[g] = fused(builder, value, below, totals[g]) if totals[g] else builder.fmul(value, below)
            total = ir.Constant(element, 0.0)
            for (first, lanes), columns in zip(groups, totals, strict=True):
                place = vector_at(builder, rows, builder.add(along_, ir.Constant(whole, first)), lanes, element)
                product = builder.fmul(columns, builder.load(place, align=size))
                for lane in range(lanes):
                    part = builder.extract_element(product, ir.Constant(ir.IntType(32), lane))
                    total = builder.fadd(total, part)
            builder.store(total, builder.gep(data_of(context, builder, kind[6], target), [to_]))
            return context.get_dummy_value()

        return _signature(tile, table, out), generate

    return weighted


@intrinsic
def spread_bytes(typing: Any, source: Any, start: Any, values: Any, at: Any) -> Any:
    """Four bytes from ``source[start]`` on, flat, become the four numbers from ``values[at]`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args
        element = context.get_data_type(kind[2].dtype)
        place = vector_at(builder, data_of(context, builder, kind[0], args[0]), args[1], 4, ir.IntType(8))
        numbers = builder.uitofp(
            builder.zext(builder.load(place, align=1), ir.VectorType(ir.IntType(32), 4)),
            ir.VectorType(element, 4),
        )
        target = vector_at(builder, data_of(context, builder, kind[2], args[2]), args[3], 4, element)
        builder.store(numbers, target, align=context.get_abi_sizeof(element))
        return context.get_dummy_value()

    return types.void(source, types.intp, values, types.intp), generate


@intrinsic
def gather_bytes(typing: Any, values: Any, at: Any, target: Any, to: Any) -> Any:
    """The reverse: four numbers, from 0 to 255, cut off to whole ones, become four bytes from ``target[to]`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args
        element = context.get_data_type(kind[0].dtype)
        place = vector_at(builder, data_of(context, builder, kind[0], args[0]), args[1], 4, element)
        numbers = builder.load(place, align=context.get_abi_sizeof(element))
        whole = builder.fptosi(numbers, ir.VectorType(ir.IntType(32), 4))
        place = vector_at(builder, data_of(context, builder, kind[2], args[2]), args[3], 4, ir.IntType(8))
        builder.store(builder.trunc(whole, ir.VectorType(ir.IntType(8), 4)), place, align=1)
        return context.get_dummy_value()

    return types.void(values, types.intp, target, types.intp), generate


def reader(size: int) -> Callable[..., Any]:
    """Makes ``f(source, start)``, reading ``size`` bytes (2, 4 or 8) from an item of a flat array on as a number."""
    wide = types.uint64 if size == 8 else types.uint32

    @intrinsic
    def read(typing: Any, source: Any, start: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = builder.gep(data_of(context, builder, signature.args[0], args[0]), [args[1]])
            number = builder.load(builder.bitcast(place, ir.IntType(8 * size).as_pointer()), align=1)
            return builder.zext(number, ir.IntType(32)) if size < 4 else number

        return wide(source, types.intp), generate

    return read


@intrinsic
def prefetch(typing: Any, source: Any, start: Any) -> Any:
    """Fetch what lies around an item of a flat array into the cache; it need not be in the array."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.gep(data_of(context, builder, signature.args[0], args[0]), [args[1]])
        place = builder.bitcast(place, ir.IntType(8).as_pointer())
        whole = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(8).as_pointer(), whole, whole, whole])
        function = builder.module.declare_intrinsic("llvm.prefetch.p0", (), kind)
        builder.call(function, [place, ir.Constant(whole, 0), ir.Constant(whole, 3), ir.Constant(whole, 1)])
        return context.get_dummy_value()

    return types.void(source, types.intp), generate


def numbers_at(builder: Any, kind: Any, pointer: Any, at: Any, lanes: int, element: Any, number: Any) -> Any:
    """``lanes`` samples of a type from an index on, as a vector of numbers."""
    size = element.width // 8 if isinstance(element, ir.IntType) else (8 if isinstance(element, ir.DoubleType) else 4)
    value = builder.load(vector_at(builder, pointer, at, lanes, element), align=size)
    if not isinstance(element, ir.IntType):
        return value if element == number else builder.fpext(value, ir.VectorType(number, lanes))
    signed = bool(kind.dtype.signed)
    if element.width < 32:
        widen = builder.sext if signed else builder.zext
        value, signed = widen(value, ir.VectorType(ir.IntType(32), lanes)), True
    convert = builder.sitofp if signed else builder.uitofp
    return convert(value, ir.VectorType(number, lanes))


def _pick(builder: Any, vector: Any, lanes: list[int]) -> Any:
    whole = ir.IntType(32)
    order = ir.Constant(ir.VectorType(whole, len(lanes)), [ir.Constant(whole, k) for k in lanes])
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), order)


def _sum(builder: Any, vector: Any, channels: int) -> list[Any]:
    """The sums of a vector's lanes, those of each channel."""
    lanes = vector.type.count
    while lanes > channels:
        lanes //= 2
        low, high = _pick(builder, vector, list(range(lanes))), _pick(builder, vector, list(range(lanes, 2 * lanes)))
        vector = builder.fadd(low, high)
    return [builder.extract_element(vector, ir.Constant(ir.IntType(32), c)) for c in range(channels)]


def _stencil(
    context: Any, builder: Any, kind: Any, args: Any, across: Any, down: Any, taps: int, channels: int
) -> None:
    """The weighted sum of ``taps`` by ``taps`` pixels in each of two frames, mixed; one for each channel.

    ``args`` begins with the samples, where the frames' pixels start in them, and the stride of rows, and ends with
    the second frame's share, and with the array and the place that the sums go to.
    """
    element, number = (context.get_data_type(kind[k].dtype) for k in (0, -2))
    pointer, bases, stride, share = data_of(context, builder, kind[0], args[0]), args[1:3], args[3], args[-3]
    whole = ir.IntType(64)
    padded = 4 if taps == 4 else 8
    lanes = padded * channels if channels < 3 else 4
    rows = [_pick(builder, down, [j] * lanes) for j in range(taps)]
    columns = [_pick(builder, across, [i] * 4) for i in range(taps)] if channels > 2 else []
    frames = []
    for base in bases:  # of two frames
        total = None
        for j in range(taps):
            at = builder.add(base, builder.mul(stride, ir.Constant(whole, j)))
            if channels < 3:
                line = numbers_at(builder, kind[0], pointer, at, lanes, element, number)
            else:
                line = None
                for i in range(taps):
                    place = builder.add(at, ir.Constant(whole, i * channels))
                    value = numbers_at(builder, kind[0], pointer, place, 4, element, number)
                    line = fused(builder, value, columns[i], line) if line else builder.fmul(value, columns[i])
            total = fused(builder, line, rows[j], total) if total else builder.fmul(line, rows[j])
        frames.append(total)
    blended = fused(builder, builder.fsub(frames[1], frames[0]), splat(builder, share, lanes), frames[0])
    if channels > 2:
        sums = [builder.extract_element(blended, ir.Constant(ir.IntType(32), c)) for c in range(channels)]
    else:
        spread = _pick(builder, across, [i // channels for i in range(lanes)])
        sums = _sum(builder, builder.fmul(blended, spread), channels)
    target = data_of(context, builder, kind[-2], args[-2])
    for c, value in enumerate(sums):
        builder.store(value, builder.gep(target, [builder.add(args[-1], ir.Constant(whole, c))]))


def cubic_stencil(channels: int) -> Callable[..., None]:
    """Makes ``f(samples, here, there, stride, x, y, share, out, to)`` for flat arrays of frames.

    It puts Catmull and Rom's interpolants of four by four pixels in two frames, the first ones at ``here`` and
    ``there``, mixed, into ``out[to:]``: one number for each channel. The second frame has a ``share``. ``x`` and ``y``
    are how far it is from the second pixel to the third; all weights are of ``out``'s type.
    """

    @intrinsic
    def weighted(
        typing: Any, samples: Any, here: Any, there: Any, stride: Any, x: Any, y: Any, share: Any, out: Any, to: Any
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            number = context.get_data_type(kind[7].dtype)

            def vector(values: list[float]) -> Any:
                return ir.Constant(ir.VectorType(number, 4), [ir.Constant(number, v) for v in values])

            def weights(part: Any) -> Any:
                t = splat(builder, part, 4)
                value = fused(builder, vector([-0.5, 1.5, -1.5, 0.5]), t, vector([1.0, -2.5, 2.0, -0.5]))
                value = fused(builder, value, t, vector([-0.5, 0.0, 0.5, 0.0]))
                return fused(builder, value, t, vector([0.0, 1.0, 0.0, 0.0]))

            _stencil(context, builder, kind, args, weights(args[4]), weights(args[5]), 4, channels)
            return context.get_dummy_value()

        i = types.intp
        return types.void(samples, i, i, i, out.dtype, out.dtype, out.dtype, out, i), generate

    return weighted


def table_stencil(channels: int) -> Callable[..., None]:
    """The same of six by six pixels, with weights from a table: ``f(…, stride, table, along, down, share, out, to)``.

    The weights of columns and rows start at ``along`` and ``down``. Two pixels more are read on the right.
    """

    @intrinsic
    def weighted(
        typing: Any,
        samples: Any,
        here: Any,
        there: Any,
        stride: Any,
        table: Any,
        along: Any,
        down: Any,
        share: Any,
        out: Any,
        to: Any,
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            number = context.get_data_type(kind[8].dtype)
            data = data_of(context, builder, kind[4], args[4])

            def weights(start: Any) -> Any:
                whole = ir.IntType(64)
                size = context.get_abi_sizeof(number)
                first = builder.load(vector_at(builder, data, start, 4, number), align=size)
                rest = builder.load(
                    vector_at(builder, data, builder.add(start, ir.Constant(whole, 4)), 2, number), align=size
                )
                zeros = ir.Constant(ir.VectorType(number, 2), [ir.Constant(number, 0.0)] * 2)
                order = [ir.Constant(ir.IntType(32), k) for k in range(4)]
                rest = builder.shuffle_vector(rest, zeros, ir.Constant(ir.VectorType(ir.IntType(32), 4), order))
                order = [ir.Constant(ir.IntType(32), k) for k in range(8)]
                return builder.shuffle_vector(first, rest, ir.Constant(ir.VectorType(ir.IntType(32), 8), order))

            _stencil(context, builder, kind, args, weights(args[5]), weights(args[6]), 6, channels)
            return context.get_dummy_value()

        i = types.intp
        return types.void(samples, i, i, i, table, i, i, out.dtype, out, i), generate

    return weighted


@intrinsic
def write_cubic(typing: Any, out: Any, at: Any, start: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Eight values of a + b s + c s² + d s³, from s = ``start`` on, into a flat array of float32 from ``at`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        number = ir.FloatType()
        kind = ir.VectorType(number, 8)
        steps = ir.Constant(kind, [ir.Constant(number, float(k)) for k in range(8)])
        s = builder.fadd(splat(builder, args[2], 8), steps)
        value = splat(builder, args[6], 8)
        for k in (5, 4, 3):
            value = fused(builder, value, s, splat(builder, args[k], 8))
        place = vector_at(builder, data_of(context, builder, signature.args[0], args[0]), args[1], 8, number)
        builder.store(value, place, align=4)
        return context.get_dummy_value()

    f = types.float32
    return types.void(out, types.intp, f, f, f, f, f), generate
