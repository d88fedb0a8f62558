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


def _loaded(builder: Any, pointer: Any, index: Any, lanes: int, element: Any) -> Any:
    size = 8 if isinstance(element, ir.DoubleType) else 4
    return builder.load(vector_at(builder, pointer, index, lanes, element), align=size)


def _pick(builder: Any, vector: Any, lanes: list[int]) -> Any:
    whole = ir.IntType(32)
    order = ir.Constant(ir.VectorType(whole, len(lanes)), [ir.Constant(whole, k) for k in lanes])
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), order)


def _box_weights(context: Any, builder: Any, kinds: Any, args: Any, padded: int, apart: int) -> tuple[Any, Any]:
    """What columns and rows weigh: a table's entries, and how far off they are times how they change.

    ``args`` are the table, the places of the two entries in it, an array, and where in it the first of four numbers
    ``apart`` from each other is: the steps from the entry by place and by width, along x and along y.
    """
    number = context.get_data_type(kinds[0].dtype)
    table, rests = data_of(context, builder, kinds[0], args[0]), data_of(context, builder, kinds[3], args[3])
    whole = ir.IntType(64)

    def rest(k: int) -> Any:
        value = builder.load(builder.gep(rests, [builder.add(args[4], ir.Constant(whole, k * apart))]))
        return splat(builder, value if value.type == number else builder.fpext(value, number), padded)

    def weights(start: Any, first: int) -> Any:
        value, by_place, by_width = (
            _loaded(builder, table, builder.add(start, ir.Constant(whole, k * padded)), padded, number)
            for k in range(3)
        )
        return fused(builder, by_width, rest(first + 1), fused(builder, by_place, rest(first), value))

    return weights(args[1], 0), weights(args[2], 2)


def _add_pixels(builder: Any, data: Any, at: Any, stride: Any, across: Any, down: Any, count: int) -> Any:
    """``Σ_j Σ_i down_j across_i`` of ``count`` by ``count`` pixels of four numbers.

    Columns are summed first, two at a time, and those of even and odd rows apart: what waits for nothing is done
    while the rest waits.
    """
    element = across.type.element
    whole = ir.IntType(64)
    starts = [
        builder.shl(builder.add(at, builder.mul(stride, ir.Constant(whole, j))), ir.Constant(whole, 2))
        for j in range(count)
    ]
    totals: dict[int, Any] = {}
    for i in range(0, count, 2):
        size = min(2, count - i)
        sums: list[Any] = [None, None]
        for j, start in enumerate(starts):
            value = _loaded(builder, data, builder.add(start, ir.Constant(whole, 4 * i)), 4 * size, element)
            row = _pick(builder, down, [j] * 4 * size)
            before = sums[j % 2]
            sums[j % 2] = fused(builder, value, row, before) if before else builder.fmul(value, row)
        column = _pick(builder, across, [i + k // 4 for k in range(4 * size)])
        both, before = builder.fadd(*sums), totals.get(size)
        totals[size] = fused(builder, both, column, before) if before else builder.fmul(both, column)
    pairs = totals[2]
    total = builder.fadd(_pick(builder, pairs, [0, 1, 2, 3]), _pick(builder, pairs, [4, 5, 6, 7]))
    return builder.fadd(total, totals[1]) if 1 in totals else total


def _add_samples(builder: Any, data: Any, at: Any, stride: Any, across: Any, down: Any, count: int) -> Any:
    """The same of pixels of one number; ``count`` is even. Columns are summed first, in groups of four and two."""
    element = across.type.element
    whole = ir.IntType(64)
    total = ir.Constant(element, 0.0)
    for first, lanes in [(0, 4), (4, 2)] if count == 6 else [(0, count)]:
        columns = None
        for j in range(count):
            start = builder.add(builder.add(at, builder.mul(stride, ir.Constant(whole, j))), ir.Constant(whole, first))
            value, row = _loaded(builder, data, start, lanes, element), _pick(builder, down, [j] * lanes)
            columns = fused(builder, value, row, columns) if columns else builder.fmul(value, row)
        product = builder.fmul(columns, _pick(builder, across, list(range(first, first + lanes))))
        for lane in range(lanes):
            total = builder.fadd(total, builder.extract_element(product, ir.Constant(ir.IntType(32), lane)))
    return total


def _polynomials(builder: Any, powers: list[list[float]], t: Any, number: Any) -> Any:
    """A vector of polynomials of ``t``, the highest power first."""
    lanes = len(powers[0])
    value, *others = (ir.Constant(ir.VectorType(number, lanes), [ir.Constant(number, v) for v in p]) for p in powers)
    at = splat(builder, t if t.type == number else builder.fpext(t, number), lanes)
    for other in others:
        value = fused(builder, value, at, other)
    return value


_LINEAR = [[-1.0, 1.0], [1.0, 0.0]]
_CUBIC = [[-0.5, 1.5, -1.5, 0.5], [1.0, -2.5, 2.0, -0.5], [-0.5, 0.0, 0.5, 0.0], [0.0, 1.0, 0.0, 0.0]]


def _interpolated(count: int, add: Callable[..., Any]) -> Callable[..., None]:
    @intrinsic
    def weighted(typing: Any, tile: Any, at: Any, stride: Any, x: Any, y: Any, out: Any, to: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            element, powers = context.get_data_type(kind[0].dtype), _LINEAR if count == 2 else _CUBIC
            across, below = (_polynomials(builder, powers, t, element) for t in args[3:5])
            data = data_of(context, builder, kind[0], args[0])
            _store(context, builder, kind[5], args[5:], add(builder, data, args[1], args[2], across, below, count))
            return context.get_dummy_value()

        i = types.intp
        return types.void(tile, i, i, x, y, out, i), generate

    return weighted


def _boxed(count: int, padded: int, apart: int, add: Callable[..., Any]) -> Callable[..., None]:
    @intrinsic
    def boxed(
        typing: Any,
        tile: Any,
        at: Any,
        stride: Any,
        table: Any,
        along: Any,
        down: Any,
        rests: Any,
        rest: Any,
        out: Any,
        to: Any,
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            across, below = _box_weights(context, builder, kind[3:7], args[3:8], padded, apart)
            data = data_of(context, builder, kind[0], args[0])
            _store(context, builder, kind[8], args[8:], add(builder, data, args[1], args[2], across, below, count))
            return context.get_dummy_value()

        i = types.intp
        return types.void(tile, i, i, table, i, i, rests, i, out, i), generate

    return boxed


def _store(context: Any, builder: Any, kind: Any, target: Any, value: Any) -> None:
    """Keep a number or a vector in an array, from a place on."""
    place = builder.gep(data_of(context, builder, kind, target[0]), [target[1]])
    size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    builder.store(value, builder.bitcast(place, value.type.as_pointer()), align=size)


def four_channels(count: int) -> Callable[..., None]:
    """Makes ``f(tile, at, stride, x, y, out, to)`` for flat arrays of one type: an interpolation.

    It puts ``Σ_j Σ_i w_j(y) w_i(x) tile[4 (at + j stride + i) + c]`` into ``out[to + c]`` for four channels c. Of two
    terms in each sum it is linear, of four Catmull and Rom's; ``x`` and ``y`` are how far a point is from the pixel
    before it, the first or the second one.
    """
    return _interpolated(count, _add_pixels)


def one_channel(count: int) -> Callable[..., None]:
    """The same for one channel: ``tile[at + j stride + i]`` into ``out[to]``."""
    return _interpolated(count, _add_samples)


def four_boxed(count: int, padded: int, apart: int) -> Callable[..., None]:
    """Makes ``f(tile, at, stride, table, along, down, rests, rest, out, to)``: averages over boxes.

    As `four_channels`, with the weights of a table (`supple.cpu.footprint.weights`), whose entries for columns and
    rows start at ``along`` and ``down``: ``padded`` weights and as many derivatives by place and by width. How many
    steps a pixel is away from the entries, by place and by width along x and along y, is from ``rests[rest]`` on,
    ``apart`` from each other.
    """
    return _boxed(count, padded, apart, _add_pixels)


def one_boxed(count: int, padded: int, apart: int) -> Callable[..., None]:
    """The same for one channel; ``count`` is even."""
    return _boxed(count, padded, apart, _add_samples)


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
            across, below = (_polynomials(builder, _CUBIC, t, number) for t in args[4:6])
            _stencil(context, builder, kind, args, across, below, 4, channels)
            return context.get_dummy_value()

        i = types.intp
        return types.void(samples, i, i, i, out.dtype, out.dtype, out.dtype, out, i), generate

    return weighted


def table_stencil(channels: int, padded: int, apart: int) -> Callable[..., None]:
    """The same of six by six pixels, weighed by a table of boxes as `four_boxed` does.

    ``f(samples, here, there, stride, table, along, down, rests, rest, share, out, to)``. Two pixels more are read on
    the right.
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
        rests: Any,
        rest: Any,
        share: Any,
        out: Any,
        to: Any,
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.args
            across, below = _box_weights(context, builder, kind[4:8], args[4:9], padded, apart)
            _stencil(context, builder, kind, args, across, below, 6, channels)
            return context.get_dummy_value()

        i = types.intp
        return types.void(samples, i, i, i, table, i, i, rests, i, out.dtype, out, i), generate

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
