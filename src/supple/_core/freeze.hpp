// Freeze masks: the factor m(p) of every stroke's displacement, from 0, where nothing moves, to 1.
//
// m is a cubic B-spline (C²): m(p) = Σ c_k Π_i B(u_i - k_i), u = (p - first) / step. Its weights are at least 0 and add
// up to 1, so that m is 0, exactly and with its derivatives, where all coefficients around a point are 0. The outermost
// four along an axis are equal: beyond, m is constant. An axis of one coefficient is one along which m is constant.
//
// It uses no std::, allocation or exceptions, so that compilers for GPUs accept this file.
#pragma once
#include "simd.hpp"

namespace supple {

struct Freeze {
    int size[3];                   // of coefficients along x, y and z: 1, or 8 and more
    double first[3], per_step[3];  // the place of the first, and 1 / step; in physical units
    const float* values;           // (z, y, x)
    const uint8_t* calm;  // for each cell, from coefficient i to i + 1: the distance in cells to one in which m varies
};

// The cell of a coordinate, and the fraction of the way through it.
INLINE int cell_of(const Freeze& f, int axis, double x, double& part) {
    part = 0;
    if (f.size[axis] == 1) return 0;
    const double last = f.size[axis] - 3, u = least(most((x - f.first[axis]) * f.per_step[axis], 1.0), last + 1);
    const int i = (int)least(u, last);
    part = u - i;
    return i;
}

// m at some points, and its derivatives up to ORDER; `smooth`: the length over which m varies, in cells.
template <int D, int ORDER, class V>
struct Freed {
    V m, slope[D], bend[D][D], smooth;
};

// The weights of the TAPS samples of a linear or cubic B-spline, at the fraction f between the two in the middle, and
// their derivatives: [order][tap].
template <int TAPS, class V>
INLINE void spline_weights(V f, V (*w)[TAPS]) {
    V g = 1.0 - f;
    if constexpr (TAPS == 2) {
        w[0][0] = g;
        w[0][1] = f;
        w[1][0] = splat<V>(-1.0);
        w[1][1] = splat<V>(1.0);
        w[2][0] = w[2][1] = V{};
    } else {
        V f2 = f * f, g2 = g * g;
        w[0][0] = g2 * g / 6.0;
        w[0][1] = (4.0 - f2 * (6.0 - 3.0 * f)) / 6.0;
        w[0][2] = (4.0 - g2 * (6.0 - 3.0 * g)) / 6.0;
        w[0][3] = f2 * f / 6.0;
        w[1][0] = -0.5 * g2;
        w[1][1] = f * (1.5 * f - 2.0);
        w[1][2] = g * (2.0 - 1.5 * g);
        w[1][3] = 0.5 * f2;
        w[2][0] = g;
        w[2][1] = 3.0 * f - 2.0;
        w[2][2] = 3.0 * g - 2.0;
        w[2][3] = f;
    }
}

// The first sample of a row, for each lane.
template <class P, int N>
struct Starts {
    P of[N];
};

// Sum C numbers of samples, times their weights along D axes, of which the third has `deep` taps: [p][o][n] of the sums
// is the p-th derivative along z of the o-th along y of the n-th along x, up to ORDER in all. rows(k, j)(i, c) is the
// number c of a sample.
template <int D, int TAPS, int ORDER, int C, class V, class Rows>
INLINE void sum_taps(const V (*w)[3][TAPS], int deep, Rows rows, V (*sums)[ORDER + 1][ORDER + 1][C]) {
    for (int k = 0; k < deep; k++) {
        V plane[ORDER + 1][ORDER + 1][C] = {};
        for (int j = 0; j < TAPS; j++) {
            V row[ORDER + 1][C] = {};
            const auto sample = rows(k, j);
            for (int i = 0; i < TAPS; i++)
                for (int c = 0; c < C; c++) {
                    const V v = sample(i, c);
                    for (int n = 0; n <= ORDER; n++) row[n][c] += w[0][n][i] * v;
                }
            for (int n = 0; n <= ORDER; n++)
                for (int o = 0; o + n <= ORDER; o++)
                    for (int c = 0; c < C; c++) plane[o][n][c] += w[1][o][j] * row[n][c];
        }
        for (int p = 0; p <= (D == 3 ? ORDER : 0); p++)
            for (int o = 0; o + p <= ORDER; o++)
                for (int n = 0; n + o + p <= ORDER; n++)
                    for (int c = 0; c < C; c++)
                        sums[p][o][n][c] += (deep > 1 ? w[D - 1][p][k] : splat<V>(p == 0)) * plane[o][n][c];
    }
}

// m and its derivatives in the cells `at`, at the fractions `part` of the way through them.
template <int D, int ORDER, class V>
NOINLINE void freed_in(const Freeze& f, const int (*at)[D], const V* part, V& m, V* slope, V (*bend)[D]) {
    V w[D][3][4], sums[ORDER + 1][ORDER + 1][ORDER + 1][1] = {};
    for (int d = 0; d < D; d++) {
        spline_weights<4>(part[d], w[d]);
        for (int i = 0; i < 4; i++) {
            w[d][1][i] *= f.per_step[d];
            w[d][2][i] *= f.per_step[d] * f.per_step[d];
        }
    }
    const int step = f.size[0] > 1;
    auto rows = [&](int k, int j) INLINE_LAMBDA {
        Starts<const float*, Masked<V>::lanes> from;
        for (int l = 0; l < Masked<V>::lanes; l++) {
            const int x = step ? at[l][0] - 1 : 0, y = f.size[1] > 1 ? at[l][1] - 1 + j : 0;
            const int z = D == 3 && f.size[2] > 1 ? at[l][D - 1] - 1 + k : 0;
            from.of[l] = f.values + ((int64_t)z * f.size[1] + y) * f.size[0] + x;
        }
        return [from, step](int i, int) INLINE_LAMBDA {
            V v{};
            for (int l = 0; l < Masked<V>::lanes; l++) set_lane(v, l, from.of[l][i * step]);
            return v;
        };
    };
    sum_taps<D, 4, ORDER, 1>(w, D == 3 && f.size[2] > 1 ? 4 : 1, rows, sums);
    m = sums[0][0][0][0];
    for (int d = 0; d < D && ORDER > 0; d++) slope[d] = sums[d == 2][d == 1][d == 0][0];
    for (int d = 0; d < D && ORDER > 1; d++)
        for (int e = 0; e < D; e++) bend[d][e] = sums[(d == 2) + (e == 2)][(d == 1) + (e == 1)][(d == 0) + (e == 0)][0];
}

template <int D, int ORDER, class V>
INLINE Freed<D, ORDER, V> freed(const Freeze& f, const V* x) {
    Freed<D, ORDER, V> found{};
    constexpr int N = Masked<V>::lanes;
    int at[N][D], varying = 0;
    V part[D] = {}, level{}, calm{};
    for (int l = 0; l < N; l++) {
        int64_t cell = 0;
        for (int d = D - 1; d >= 0; d--) {
            double along;
            at[l][d] = cell_of(f, d, lane(x[d], l), along);
            set_lane(part[d], l, along);
            cell = cell * f.size[d] + at[l][d];
        }
        set_lane(calm, l, f.calm[cell]);
        set_lane(level, l, f.values[cell]);
        varying += !f.calm[cell];
    }
    found.smooth = 4.0 + calm;
    if (varying) freed_in<D, ORDER>(f, at, part, found.m, found.slope, found.bend);
    if (varying == N) return found;
    const auto constant = calm > 0.5;
    found.m = choose(constant, level, found.m);
    for (int d = 0; d < D && ORDER > 0; d++) found.slope[d] = choose(constant, V{}, found.slope[d]);
    for (int d = 0; d < D && ORDER > 1; d++)
        for (int e = 0; e < D; e++) found.bend[d][e] = choose(constant, V{}, found.bend[d][e]);
    return found;
}

// True if a point is frozen: m is 0 in all of its cell.
template <int D>
INLINE bool is_frozen(const Freeze& f, const double* x) {
    int64_t cell = 0;
    double part;
    for (int d = D - 1; d >= 0; d--) cell = cell * f.size[d] + cell_of(f, d, x[d], part);
    return f.calm[cell] && f.values[cell] == 0;
}

}  // namespace supple
