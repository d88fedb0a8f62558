// Vectors of floats, and samples between the voxels of a volume with their slopes, at points given in voxels.
#pragma once
#include <type_traits>

#include "simd.hpp"

namespace supple {

typedef float Float4 __attribute__((vector_size(16)));
typedef int32_t Int4 __attribute__((vector_size(16)));
typedef float Float8 __attribute__((vector_size(32)));
typedef double Double2 __attribute__((vector_size(16)));
typedef double Double4 __attribute__((vector_size(32)));

INLINE Int4 whole(Float4 x) { return __builtin_convertvector(x, Int4); }
INLINE Float4 floats(Int4 x) { return __builtin_convertvector(x, Float4); }
INLINE Float4 floats(Double4 x) { return __builtin_convertvector(x, Float4); }
INLINE Double4 doubles(Int4 x) { return __builtin_convertvector(x, Double4); }
INLINE Float4 load4(const float* at) {
    Float4 x;
    memcpy(&x, at, sizeof x);
    return x;
}
INLINE Float8 load8(const float* at) {
    typedef float Anywhere __attribute__((vector_size(32), aligned(4), may_alias));
    return *(const Anywhere*)at;
}
template <int K>
INLINE Float4 half(Float8 x) {
    return __builtin_shufflevector(x, x, 4 * K, 4 * K + 1, 4 * K + 2, 4 * K + 3);
}
INLINE float dot3(Float4 a, Float4 b) {
    Float4 c = a * b;
    return c[0] + c[1] + c[2];
}
// The point at `part` of the way from a to b: exactly a where both are the same.
template <class V, class S>
INLINE V mix(S part, V a, V b) {
    return a + part * (b - a);
}

// Four integers of type T, one after the other in `bits`. Compilers know how, but for GCC.
template <class T, class B>
INLINE Float4 numbers(B bits) {
#if defined(__SSE4_1__)
    __m128i x = sizeof(T) == 1 ? _mm_cvtsi32_si128((int)bits) : _mm_cvtsi64_si128((int64_t)bits);
    if constexpr (sizeof(T) == 1)
        return (Float4)_mm_cvtepi32_ps(std::is_signed_v<T> ? _mm_cvtepi8_epi32(x) : _mm_cvtepu8_epi32(x));
    else
        return (Float4)_mm_cvtepi32_ps(std::is_signed_v<T> ? _mm_cvtepi16_epi32(x) : _mm_cvtepu16_epi32(x));
#else
    typedef T Four __attribute__((vector_size(4 * sizeof(T))));
    Four x;
    memcpy(&x, &bits, sizeof x);
    return __builtin_convertvector(x, Float4);
#endif
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
        Int4 cell = whole(p);
        cell = cell < last ? cell : last;
        Float4 part = p - floats(cell);
        Float4 near, far;
        corners(at(cell), near, far);
        Float4 a = mix(part[2], near, far);
        Float4 b = mix(part[1], a, __builtin_shufflevector(a, a, 2, 3, 2, 3));
        return mix(part[0], b[0], b[1]);
    }

    // The gradient by central differences, per voxel: of voxels, and trilinear in between.
    INLINE Float4 slopes(Float4 p) const {
        Int4 inside = (p >= 1.0f) & (p < floats(last));
        return inside[0] & inside[1] & inside[2] ? 0.5f * changes(p) : outer_slopes(p);
    }

private:
    INLINE const T* at(Int4 cell) const { return data + (cell[2] * layer + cell[1] * row + cell[0]); }

    // Two neighbours along x of a cell's four rows, as the numbers of its near and of its far layer.
    INLINE void corners(const T* a, Float4& near, Float4& far) const {
        typedef std::conditional_t<sizeof(T) == 1, uint16_t, std::conditional_t<sizeof(T) == 2, uint32_t, double>> Pair;
        Pair p[4];
        for (int k = 0; k < 4; k++) memcpy(p + k, a + (k & 1) * row + (k >> 1) * layer, sizeof(Pair));
        if constexpr (sizeof(T) == 4) {
            near = (Float4)Double2{p[0], p[1]};
            far = (Float4)Double2{p[2], p[3]};
        } else if constexpr (sizeof(T) == 2) {
            near = numbers<T>(p[0] | (uint64_t)p[1] << 32);
            far = numbers<T>(p[2] | (uint64_t)p[3] << 32);
        } else {
            near = numbers<T>(p[0] | (uint32_t)p[1] << 16);
            far = numbers<T>(p[2] | (uint32_t)p[3] << 16);
        }
    }

    INLINE static Float4 four(const T* a) {
        if constexpr (sizeof(T) == 4)
            return load4(a);
        else {
            std::conditional_t<sizeof(T) == 1, uint32_t, uint64_t> bits;
            memcpy(&bits, a, sizeof bits);
            return numbers<T>(bits);
        }
    }
    // At `part` between the second and the third, what changes from each one's neighbour before to that after.
    template <class V>
    INLINE static V change(float part, V a, V b, V c, V d) {
        return mix(part, V(c - a), V(d - b));
    }

    // Twice the gradient, away from the faces: twelve rows of four voxels. Differences come before weights, so that
    // it is exactly 0 where all voxels are the same.
    INLINE Float4 changes(Float4 p) const {
        Int4 cell = whole(p);
        Float4 part = p - floats(cell), side[4], down[2];
        float u = part[0], v = part[1], w = part[2];
        const T* a = at(cell) - row - layer - 1;
        for (int k = 0; k < 4; k++, a += layer) {
            Float4 y1 = four(a + row), y2 = four(a + 2 * row);
            side[k] = mix(v, y1, y2);
            if (k == 1 || k == 2) down[k - 1] = change(v, four(a), y1, y2, four(a + 3 * row));
        }
        Float4 x = mix(w, side[1], side[2]), y = mix(w, down[0], down[1]),
               z = change(w, side[0], side[1], side[2], side[3]);
        return Float4{change(u, x[0], x[1], x[2], x[3]), mix(u, y[1], y[2]), mix(u, z[1], z[2]), 0};
    }

    NOINLINE Float4 outer_slopes(Float4 p) const {
        Float4 g{};
        for (int i = 0; i < 3; i++) {
            Float4 e{};
            e[i] = 1;
            g[i] = 0.5f * (sample(p + e) - sample(p - e));
        }
        return g;
    }
};

}  // namespace supple
