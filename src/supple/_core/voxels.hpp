// Samples between the voxels of a volume, and their slopes, at points given in voxels.
#pragma once
#include <type_traits>

#include "vectors.hpp"

namespace supple {

typedef Pack<float, 4> Float4;
typedef int32_t Int4 __attribute__((vector_size(16)));
typedef double Double4 __attribute__((vector_size(32)));

INLINE Int4 whole(Float4 x) { return __builtin_convertvector(x, Int4); }
INLINE Float4 floats(Int4 x) { return __builtin_convertvector(x, Float4); }
INLINE Float4 floats(Double4 x) { return __builtin_convertvector(x, Float4); }
INLINE Double4 doubles(Int4 x) { return __builtin_convertvector(x, Double4); }
INLINE float dot3(Float4 a, Float4 b) {
    Float4 c = a * b;
    return c[0] + c[1] + c[2];
}
// The point at `part` of the way from a to b: exactly a if both are equal.
template <class V, class S>
INLINE V mix(S part, V a, V b) {
    return a + part * (b - a);
}

// A volume of T, x fastest, of two voxels along each axis at least.
template <class T>
struct Voxels {
    const T* data;
    int64_t row, layer;
    Int4 last;  // the last cell along each axis: n - 2

    Voxels(const T* data, int64_t nx, int64_t ny, int64_t nz)
        : data(data), row(nx), layer(nx * ny), last{int32_t(nx - 2), int32_t(ny - 2), int32_t(nz - 2), 0} {}

    // The trilinear sample at p, or at the point of the volume that is nearest to p.
    INLINE float sample(Float4 p) const {
        p = least(most(p, Float4{}), floats(last + 1));
        Int4 cell = least(whole(p), last);
        Float4 part = p - floats(cell);
        const T* a = at(cell);
        Float4 near = rows(a), far = rows(a + layer), x = mix(part[2], near, far);
        Float4 y = mix(part[1], x, __builtin_shufflevector(x, x, 2, 3, 2, 3));
        return mix(part[0], y[0], y[1]);
    }

    // The gradient by central differences, per voxel, of voxels and trilinear in between; and the sample, last.
    INLINE Float4 slopes(Float4 p) const {
        Int4 inside = (p >= 1.0f) & (p < floats(last));
        return inside[0] & inside[1] & inside[2] ? inner_slopes(p) : outer_slopes(p);
    }

private:
    INLINE const T* at(Int4 cell) const { return data + (cell[2] * layer + cell[1] * row + cell[0]); }

    // Two voxels of a row, and two of the next.
    INLINE Float4 rows(const T* a) const {
        T both[4];
        memcpy(both, a, 2 * sizeof(T));
        memcpy(both + 2, a + row, 2 * sizeof(T));
        return load<float, 4>(both);
    }
    // At `part` between the second and the third, half of the difference of each one's neighbours. Differences come
    // before weights, so that the result is exactly 0 if all voxels are equal.
    template <class V>
    INLINE static V change(float part, V a, V b, V c, V d) {
        return 0.5f * mix(part, V(c - a), V(d - b));
    }

    // Away from the faces: twelve rows of four voxels.
    INLINE Float4 inner_slopes(Float4 p) const {
        Int4 cell = whole(p);
        Float4 part = p - floats(cell), side[4], down[2];
        float u = part[0], v = part[1], w = part[2];
        const T* a = at(cell) - row - layer - 1;
        for (int k = 0; k < 4; k++, a += layer) {
            Float4 y1 = load<float, 4>(a + row), y2 = load<float, 4>(a + 2 * row);
            side[k] = mix(v, y1, y2);
            if (k == 1 || k == 2) down[k - 1] = change(v, load<float, 4>(a), y1, y2, load<float, 4>(a + 3 * row));
        }
        Float4 x = mix(w, side[1], side[2]), y = mix(w, down[0], down[1]),
               z = change(w, side[0], side[1], side[2], side[3]);
        return Float4{change(u, x[0], x[1], x[2], x[3]), mix(u, y[1], y[2]), mix(u, z[1], z[2]), mix(u, x[1], x[2])};
    }

    NOINLINE Float4 outer_slopes(Float4 p) const {
        Float4 g{0, 0, 0, sample(p)};
        for (int i = 0; i < 3; i++) {
            Float4 e{};
            e[i] = 1;
            g[i] = 0.5f * (sample(p + e) - sample(p - e));
        }
        return g;
    }
};

}  // namespace supple
