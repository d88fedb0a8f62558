"""Samples between voxels, and their slopes, at points given in voxels."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from supple.cpu.kernel import lean
from supple.cpu.vector import data_of, fused, numbers_at, splat


@intrinsic
def _trilinear(typing: Any, samples: Any, at: Any, row: Any, layer: Any, u: Any, v: Any, w: Any) -> Any:
    """The sample at (u, v, w) of the cell whose first voxel is at an index; two voxels side by side."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        data, element = data_of(context, builder, kind, args[0]), context.get_data_type(kind.dtype)
        places = [args[1], builder.add(args[1], args[2])]
        places += [builder.add(place, args[3]) for place in places]
        lines = [numbers_at(builder, kind, data, place, 2, element, ir.FloatType()) for place in places]
        for part in args[5:7]:
            share = splat(builder, part, 2)
            lines = [fused(builder, share, builder.fsub(b, a), a) for a, b in zip(lines[::2], lines[1::2], strict=True)]
        a, b = (builder.extract_element(lines[0], ir.Constant(ir.IntType(32), k)) for k in range(2))
        return fused(builder, args[4], builder.fsub(b, a), a)

    i, f = types.int64, types.float32
    return f(samples, i, i, i, f, f, f), generate


@lean
def sample_at(samples, nx, ny, nz, x, y, z):
    """The trilinear sample at a point, that at the nearest point of the box outside of it."""
    zero = np.float32(0.0)
    x = min(max(np.float32(x), zero), np.float32(nx - 1))
    y = min(max(np.float32(y), zero), np.float32(ny - 1))
    z = min(max(np.float32(z), zero), np.float32(nz - 1))
    i, j, k = min(np.int32(x), np.int32(nx - 2)), min(np.int32(y), np.int32(ny - 2)), min(np.int32(z), np.int32(nz - 2))
    u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
    return _trilinear(samples, (np.int64(k) * ny + j) * nx + i, nx, nx * ny, u, v, w)


@intrinsic
def _inner_slopes(typing: Any, samples: Any, at: Any, row: Any, layer: Any, u: Any, v: Any, w: Any) -> Any:
    """Twice the gradient at (u, v, w) of the cell whose first voxel is at an index, away from the faces.

    Twelve rows of four voxels, summed before their lanes are: a few instructions for each.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        data, element = data_of(context, builder, kind, args[0]), context.get_data_type(kind.dtype)
        number, whole = ir.FloatType(), ir.IntType(64)
        u, v, w = args[4:7]

        def row_at(j: int, k: int) -> Any:
            place = builder.sub(args[1], ir.Constant(whole, 1))
            for count, stride in ((j - 1, args[2]), (k - 1, args[3])):
                place = builder.add(place, builder.mul(stride, ir.Constant(whole, count)))
            return numbers_at(builder, kind, data, place, 4, element, number)

        # Differences come before weights: where all voxels are the same, the slope is 0, and no rounded rest.
        def line(part: Any, a: Any, b: Any) -> Any:
            share = splat(builder, part, 4) if isinstance(a.type, ir.VectorType) else part
            return fused(builder, share, builder.fsub(b, a), a)

        def change(part: Any, four: list[Any]) -> Any:
            return line(part, builder.fsub(four[2], four[0]), builder.fsub(four[3], four[1]))

        def lanes(vector: Any, which: range) -> list[Any]:
            return [builder.extract_element(vector, ir.Constant(ir.IntType(32), lane)) for lane in which]

        rows = {(j, k): row_at(j, k) for j in range(4) for k in range(4) if 0 < j < 3 or 0 < k < 3}
        sides = [line(v, rows[1, k], rows[2, k]) for k in range(4)]
        down = [change(v, [rows[j, k] for j in range(4)]) for k in (1, 2)]
        slopes = (
            change(u, lanes(line(w, sides[1], sides[2]), range(4))),
            line(u, *lanes(line(w, *down), range(1, 3))),
            line(u, *lanes(change(w, sides), range(1, 3))),
        )
        return context.make_tuple(builder, types.UniTuple(types.float32, 3), slopes)

    i, f = types.int64, types.float32
    return types.UniTuple(f, 3)(samples, i, i, i, f, f, f), generate


@lean
def slopes_at(samples, nx, ny, nz, x, y, z):
    """The gradient by central differences, per index: of voxels, and trilinear in between."""
    half, one = np.float32(0.5), np.float32(1.0)
    x, y, z = np.float32(x), np.float32(y), np.float32(z)
    inside = x >= one and y >= one and z >= one
    if inside and x < np.float32(nx - 2) and y < np.float32(ny - 2) and z < np.float32(nz - 2):
        i, j, k = np.int32(x), np.int32(y), np.int32(z)
        at = (np.int64(k) * ny + j) * nx + i
        u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
        gx, gy, gz = _inner_slopes(samples, at, nx, nx * ny, u, v, w)
    else:
        gx = sample_at(samples, nx, ny, nz, x + one, y, z) - sample_at(samples, nx, ny, nz, x - one, y, z)
        gy = sample_at(samples, nx, ny, nz, x, y + one, z) - sample_at(samples, nx, ny, nz, x, y - one, z)
        gz = sample_at(samples, nx, ny, nz, x, y, z + one) - sample_at(samples, nx, ny, nz, x, y, z - one)
    return half * gx, half * gy, half * gz
