// Samples of a volume (values, labels or colours) between its voxels, and their gradients, at points in voxels.
#pragma once
#include <limits>
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

// A volume of T, x fastest, with at least two voxels along each axis.
template <class T>
struct Voxels {
    const T* data;
    int64_t row, layer;
    Int4 last;                                             // the last cell along each axis: n - 2
    static constexpr bool COLOURED = false, PLAIN = true;  // has its own colours; has nothing but values

    Voxels(const T* data, int64_t nx, int64_t ny, int64_t nz)
        : data(data), row(nx), layer(nx * ny), last{int32_t(nx - 2), int32_t(ny - 2), int32_t(nz - 2), 0} {}

    // The trilinear sample at p, clamped to the volume.
    INLINE float sample(Float4 p) const {
        p = least(most(p, Float4{}), floats(last + 1));
        Int4 cell = least(whole(p), last);
        Float4 part = p - floats(cell);
        return sample(cell[0], cell[1], cell[2], part[0], part[1], part[2]);
    }
    // The sample at the fractions u, v, w within a cell.
    INLINE float sample(int i, int j, int k, float u, float v, float w) const {
        const T* a = at(i, j, k);
        Float4 near = rows(a), far = rows(a + layer), x = mix(w, near, far);
        Float4 y = mix(v, x, __builtin_shufflevector(x, x, 2, 3, 2, 3));
        return mix(u, y[0], y[1]);
    }

    // The gradient, per voxel, of a cubic B-spline whose coefficients are the voxels. With differences of two voxels,
    // shading would show steps between slices that are far apart.
    INLINE Float4 slopes(Float4 p) const {
        p = least(most(p, Float4{}), floats(last + 1));
        const Int4 cell = least(whole(p), last), inside = (cell >= 1) & (cell < last);
        if (!(inside[0] & inside[1] & inside[2])) return outer_slopes(cell, p - floats(cell));
        const T* first = at(cell) - row - layer - 1;
        return turned(p - floats(cell), [&](int j, int k) { return load<float, 4>(first + k * layer + j * row); });
    }

protected:
    INLINE const T* at(int i, int j, int k) const { return data + (k * layer + j * row + i); }
    INLINE const T* at(Int4 cell) const { return at(cell[0], cell[1], cell[2]); }

private:
    // Two voxels of a row, and two of the next.
    INLINE Float4 rows(const T* a) const {
        T both[4];
        memcpy(both, a, 2 * sizeof(T));
        memcpy(both + 2, a + row, 2 * sizeof(T));
        return load<float, 4>(both);
    }
    // The weights of four voxels at a fraction of the way from the second to the third, and those of their three
    // differences. Differences are taken before weighting, so that the slope of equal voxels is exactly 0.
    INLINE static Float4 weights(float t) {
        const float s = 1 - t;
        return Float4{s * s * s, 4 - 6 * t * t + 3 * t * t * t, 4 - 6 * s * s + 3 * s * s * s, t * t * t} / 6.0f;
    }
    template <class V>
    INLINE static V change(float t, V a, V b, V c, V d) {
        return (0.5f * (1 - t) * (1 - t)) * (b - a) + (0.5f + t - t * t) * (c - b) + (0.5f * t * t) * (d - c);
    }

    // The gradient at the fractions `part` within a cell; `row_at` returns four voxels of each of sixteen rows.
    template <class Row>
    INLINE static Float4 turned(Float4 part, Row&& row_at) {
        const float u = part[0], v = part[1], w = part[2];
        const Float4 across = weights(u), down = weights(v), deep = weights(w);
        Float4 x{}, y{}, side[4];
        for (int k = 0; k < 4; k++) {
            const Float4 a = row_at(0, k), b = row_at(1, k), c = row_at(2, k), d = row_at(3, k);
            side[k] = down[0] * a + down[1] * b + down[2] * c + down[3] * d;
            x += deep[k] * side[k];
            y += deep[k] * change(v, a, b, c, d);
        }
        y *= across;
        const Float4 z = across * change(w, side[0], side[1], side[2], side[3]);
        return Float4{change(u, x[0], x[1], x[2], x[3]), y[0] + y[1] + y[2] + y[3], z[0] + z[1] + z[2] + z[3], 0};
    }

    // The gradient beside the faces of the volume, where the outermost voxels are repeated.
    NOINLINE Float4 outer_slopes(Int4 cell, Float4 part) const {
        auto near = [&](int axis, int k) { return most(least(cell[axis] + k - 1, last[axis] + 1), 0); };
        return turned(part, [&](int j, int k) {
            const T* a = at(0, near(1, j), near(2, k));
            Float4 made;
            for (int i = 0; i < 4; i++) made[i] = float(a[near(0, i)]);
            return made;
        });
    }
};

// The corners of a cell around a point, and their trilinear weights: x fastest.
struct Corners {
    Int4 cell;
    float weights[8];

    INLINE Corners(Float4 p, Int4 last) {
        p = least(most(p, Float4{}), floats(last + 1));
        cell = least(whole(p), last);
        Float4 part = p - floats(cell), rest = 1.0f - part;
        for (int i = 0; i < 8; i++)
            weights[i] = (i & 1 ? part : rest)[0] * (i & 2 ? part : rest)[1] * (i & 4 ? part : rest)[2];
    }
};

// Labels, numbered from 1; 0 is invisible. They are not mixed: a point is visible if the visible voxels of the eight
// around it have more than half of the weight, and gets the label with the largest weight among these.
template <class T>
struct Labels : Voxels<T> {
    using Voxels<T>::Voxels, Voxels<T>::row, Voxels<T>::layer, Voxels<T>::last;
    static constexpr bool PLAIN = false;

    INLINE float sample(Float4 p) const {
        Corners around(p, last);
        const T* a = this->at(around.cell);
        T found[8];
        for (int i = 0; i < 4; i++) memcpy(found + 2 * i, a + (i & 1) * row + (i >> 1) * layer, 2 * sizeof(T));
        bool same = true;
        for (int i = 1; i < 8; i++) same &= found[i] == found[0];
        return same ? found[0] : weightiest(found, around.weights);
    }

    // The gradient, per voxel, of the extent of the label at p, by cubic B-splines, which smooth the steps of voxels;
    // and the label, last. Other visible labels count almost the same, so that no seams show where labels meet.
    INLINE Float4 slopes(Float4 p) const {
        const float own = sample(p);
        p = least(most(p, Float4{}), floats(last + 1));
        Int4 cell = whole(p);
        const int64_t strides[3] = {1, row, layer};
        int64_t at[3][SPLINE];  // offsets of the voxels around, along each axis
        float weights[3][SPLINE], rates[3][SPLINE];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < SPLINE; k++) {
                int32_t voxel = cell[i] + k + 1 - SPLINE / 2;
                at[i][k] = most(least(voxel, last[i] + 1), 0) * strides[i];
                spline((p[i] - float(voxel)) / WIDER, weights[i][k], rates[i][k]);
            }
        Float4 sum{};
        T same[SPLINE];
        for (T& label : same) label = T(own);
        const bool inner = at[0][SPLINE - 1] - at[0][0] == SPLINE - 1;
        for (int k = 0; k < SPLINE; k++)
            for (int j = 0; j < SPLINE; j++) {
                const T* a = this->data + at[2][k] + at[1][j];
                if (inner && memcmp(a + at[0][0], same, sizeof same) == 0) continue;  // most rows of a region
                float across = 0, rise = 0;
                for (int i = 0; i < SPLINE; i++) {
                    const T label = a[at[0][i]];
                    const float off = label == own ? 0.0f : label == 0 ? 1.0f : OTHER;  // 0 in a region, exactly
                    across += weights[0][i] * off;
                    rise += rates[0][i] * off;
                }
                sum -= Float4{weights[1][j] * weights[2][k] * rise, rates[1][j] * weights[2][k] * across,
                              weights[1][j] * rates[2][k] * across, 0};
            }
        sum[3] = own;
        return sum;
    }

private:
    static constexpr int SPLINE = 6;  // the number of voxels under a spline
    static constexpr float WIDER = SPLINE / 4.0f, OTHER = 0.2f;

    NOINLINE static float weightiest(const T* found, const float* weights) {
        float hidden = 0, most_weight = 0, label = 0;
        for (int i = 0; i < 8; i++) hidden += found[i] == 0 ? weights[i] : 0;
        if (hidden >= 0.5f) return 0;
        for (int i = 0; i < 8; i++) {
            float weight = 0;
            for (int j = 0; j < 8; j++) weight += found[j] == found[i] ? weights[j] : 0;
            if (found[i] == 0 || weight < most_weight || (weight == most_weight && found[i] > label)) continue;
            most_weight = weight;
            label = found[i];
        }
        return label;
    }

    // A cubic B-spline at x, and its slope.
    INLINE static void spline(float x, float& weight, float& rate) {
        const float away = __builtin_fabsf(x), rest = most(2 - away, 0.0f);
        weight = away < 1 ? (4 - 3 * away * away * rest) / 6 : rest * rest * rest / 6;
        rate = away < 1 ? x * (1.5f * away - 2) : -0.5f * __builtin_copysignf(rest * rest, x);
    }
};

// Values with their own colours: sRGB and opacity, in the full range of T, four for each voxel.
template <class T>
struct Coloured : Voxels<T> {
    const T* colours;
    static constexpr bool COLOURED = true;

    Coloured(const T* data, const T* colours, int64_t nx, int64_t ny, int64_t nz)
        : Voxels<T>(data, nx, ny, nz), colours(colours) {}

    // The colour at p, in linear light, with the opacity of the transfer function; premultiplied while interpolated.
    INLINE Float4 painted(Float4 p, Float4 colour) const {
        Corners around(p, this->last);
        const T* a = colours + 4 * (this->at(around.cell) - this->data);
        Float4 sum{};
        for (int i = 0; i < 8; i++) {
            Float4 found = load<float, 4>(a + 4 * ((i & 1) + (i >> 1 & 1) * this->row + (i >> 2) * this->layer));
            float weight = around.weights[i] * found[3];
            sum += weight * Float4{found[0], found[1], found[2], 1};
        }
        if (sum[3] > 0) sum *= 1.0f / (sum[3] * float(std::numeric_limits<T>::max()));
        for (int c = 0; c < 3; c++) colour[c] = linear(sum[c]);
        return colour;
    }

private:
    static float linear(float u) { return u <= 0.04045f ? u / 12.92f : __builtin_powf((u + 0.055f) / 1.055f, 2.4f); }
};

}  // namespace supple
