// Colours at source points: linear, cubic, and the residual footprint, of one frame or of a mixture of several.
//
// The footprint (docs/sampling.md). A sample is already an average over one sample. With M = ∂p/∂q, S = MMᵀ and its
// eigenvalues λ±, the remaining average is that of the cubic interpolant over a box of variance Σ,
//
//     12 Σ = ½(α + β) I + (α - β)/(λ₊ - λ₋) (S - ½(λ₊ + λ₋) I),     α, β = g max(λ± - 1, 0),
//
// whose second moments four cubic samples at (±√Σxx, ±√Σyy), weighted (1 ± ρ)/4, have exactly: a `spot`. As products
// along the axes that is one window of 5 × 5. A larger footprint is a row of spots along its major axis, in the pyramid
// level of its minor axis, blended with the next number of spots, and the next level.
#pragma once
#include "plan.hpp"
#include "vectors.hpp"

namespace supple {

enum Filter { NEAREST, LINEAR, CUBIC, AUTO };
enum Rule { EDGE, CONSTANT, REFLECT };

constexpr float KEYS = -0.75f;             // of the cubic in space
constexpr float LOW = 0.05f, RISE = 0.2f;  // of α: no average below, all of it above their sum
constexpr float NARROW = 1.62f, SQUARE = 3.2f;
constexpr float WIDEST_SPOT = 0.4999f;  // its half sides: two points of a spot are less than a sample apart
constexpr float PER_SPOT = 1.7f;
constexpr int MOST_SPOTS = 16;
constexpr int LEVELS = 12;
constexpr int WINDOW = 5, PATCH = 32;  // samples of a window along a side; numbers from one row of a patch to the next

// The index that replaces sample i of n in a boundary mode; -1 for a constant.
INLINE int placed(int i, int n, int rule) {
    if ((unsigned)i < (unsigned)n) return i;
    if (rule == CONSTANT) return -1;
    if (rule == EDGE) return i < 0 ? 0 : n - 1;
    int64_t m = 2 * (int64_t)n, k = ((i % m) + m) % m;
    return (int)(k < n ? k : m - 1 - k);
}

// ---- weights --------------------------------------------------------------------------------------------------------

// Keys' cubic at the four samples around a fraction f is Σ KEYS_POWERS[d][i] f^d.
constexpr float KEYS_POWERS[4][4] = {
    {0, 1, 0, 0}, {KEYS, 0, -KEYS, 0}, {-2 * KEYS, -KEYS - 3, 2 * KEYS + 3, KEYS}, {KEYS, KEYS + 2, -KEYS - 2, -KEYS}};

// The weights of columns, each C times, as many as fit; from column FIRST on, times SCALE.
template <class N, int C, int L>
struct Powers {
    alignas(64) N c[4][L];
    constexpr Powers(int first, N scale) : c{} {
        for (int d = 0; d < 4; d++)
            for (int i = 0; i < L; i++) {
                int tap = i / C - first;
                c[d][i] = tap >= 0 && tap < 4 ? scale * N(KEYS_POWERS[d][tap]) : 0;
            }
    }
    INLINE Pack<N, L> operator()(N f) const {
        return load<N, L>(c[0]) + f * (load<N, L>(c[1]) + f * (load<N, L>(c[2]) + f * load<N, L>(c[3])));
    }
};
template <class N, int C, int L>
inline constexpr Powers<N, C, L> weights{0, 1};
// Halves, since the first and the second column of a spot are added.
template <class N, int C, int L>
inline constexpr Powers<N, C, L> halves[2] = {{0, N(0.5)}, {1, N(0.5)}};

// The positions of a spot's left and right points along x.
template <class N>
struct Across {
    N first, second;  // their fractions
    int shift;        // 1 if the right one is a column further
};

// ---- samples of one place, and kernels over them --------------------------------------------------------------------

template <class T>
struct One {
    const T* p;
    template <class N, int L>
    INLINE Pack<N, L> at(ptrdiff_t o) const {
        return load<N, L>(p + o);
    }
};
template <class N, class T>
struct Two {
    const T *p, *q;
    N a, b;
    template <class, int L>
    INLINE Pack<N, L> at(ptrdiff_t o) const {
        return a * load<N, L>(p + o) + b * load<N, L>(q + o);
    }
};
template <class N, class T>
struct Many {
    const T* const* frames;
    const N* weight;
    int n;
    ptrdiff_t place;
    template <class, int L>
    INLINE Pack<N, L> at(ptrdiff_t o) const {
        Pack<N, L> v = weight[0] * load<N, L>(frames[0] + place + o);
        for (int k = 1; k < n; k++) v += weight[k] * load<N, L>(frames[k] + place + o);
        return v;
    }
};

template <class N, int C, class Taps>
INLINE Pixel<N> linear_at(Taps taps, ptrdiff_t row, N fx, N fy) {
    constexpr int L = lanes_for(2 * C);
    Pack<N, L> u = taps.template at<N, L>(0), v = taps.template at<N, L>(row);
    v = u + fy * (v - u);
    Pixel<N> a = part<N, 0>(v), b;
    if constexpr (C == 4)
        b = part<N, 1>(v);
    else if constexpr (C == 3)
        b = straddle<N, 3>(a, part<N, 1>(v));
    else
        b = straddle<N, C>(a, a);
    return a + fx * (b - a);
}

template <class N, int C, class Taps>
INLINE Pixel<N> cubic_at(Taps taps, ptrdiff_t row, N fx, N fy) {
    constexpr int L = lanes_for(4 * C);
    Pixel<N> w = weights<N, 1, 4>(fy);
    ptrdiff_t o = -row - C;
    Pack<N, L> v = w[0] * taps.template at<N, L>(o);
    for (int j = 1; j < 4; j++) v += w[j] * taps.template at<N, L>(o + j * row);
    return sum_of<N, C, 4>(v * weights<N, C, L>(fx));
}

// left, right: the weights of the window's rows for the spot's left and right points, ES apart.
template <class N, int C, int ES, class Taps>
INLINE Pixel<N> spot_at(Taps taps, ptrdiff_t row, Across<N> x, const N* left, const N* right) {
    constexpr int L = lanes_for(5 * C > 16 ? 16 : 5 * C);
    ptrdiff_t o = -row - C;
    Pack<N, L> r = taps.template at<N, L>(o), a = r * left[0], b = r * right[0];
    for (int j = 1; j < WINDOW; j++) {
        r = taps.template at<N, L>(o + j * row);
        a += r * left[j * ES];
        b += r * right[j * ES];
    }
    Pack<N, L> v = a * halves<N, C, L>[0](x.first) + b * halves<N, C, L>[x.shift](x.second);
    Pixel<N> s = sum_of<N, C, 4>(v);
    if constexpr (C == 4) {  // the fifth column did not fit
        Pixel<N> b4 = right[0] * taps.template at<N, 4>(o + 16);
        for (int j = 1; j < WINDOW; j++) b4 += right[j * ES] * taps.template at<N, 4>(o + 16 + j * row);
        N f = x.second, last = x.shift ? N(0.5) * N(KEYS) * f * f * (1 - f) : 0;
        return s + last * b4;
    } else if constexpr (C == 3)
        return s + part<N, 3>(v);
    else if constexpr (C == 2)
        return s + part<N, 2>(v);
    else
        return s + part<N, 1>(v);
}

// ---- frames, and how they are mixed at a pixel
// ------------------------------------------------------------------------

// Frames of one kind, with C interleaved channels, `row` numbers from one row to the next.
template <class T>
struct Frames {
    const T* const* at;
    int w, h;
    ptrdiff_t row;
    ptrdiff_t limit;  // the numbers that may be read from a frame's first on; after a part of it, there is padding
    int rule;
    const double* fill;

    // Whether n numbers of a row and what follows may be read. It is asked of the whole frame, even if a part of it is
    // held: kernels that may not read beyond the end round differently.
    INLINE bool has(int y, int n, int channels) const { return (ptrdiff_t)y * w * channels + n <= limit; }
};

// Frames `first` to `first + n - 1`, each with a weight; and the weight of the constant beyond a clip's ends.
template <class N>
struct Mix {
    int first, n;
    const N* weight;
    N constant;
};

// Call use(taps, row) with the samples from `place` on, which all lie within the frames.
template <class N, int C, bool SEVERAL, class T, class Use>
INLINE Pixel<N> within(const Frames<T>& f, const Mix<N>& mix, ptrdiff_t place, Use use) {
    if constexpr (!SEVERAL) return use(One<T>{f.at[0] + place}, f.row);
    Pixel<N> v;
    if (mix.n == 2)
        v = use(Two<N, T>{f.at[mix.first] + place, f.at[mix.first + 1] + place, mix.weight[0], mix.weight[1]}, f.row);
    else if (mix.n == 1) {
        v = use(One<T>{f.at[mix.first] + place}, f.row);
        if (mix.constant == 0) return v;
        v = v * mix.weight[0];
    } else
        v = use(Many<N, T>{f.at + mix.first, mix.weight, mix.n, place}, f.row);
    if (mix.constant != 0) {
        N all[4] = {};
        for (int c = 0; c < C; c++) all[c] = mix.constant * (N)f.fill[c];
        v += load<N, 4>(all);
    }
    return v;
}

// Call use(taps, row) with the samples around (x, y): LEFT before it and RIGHT after it on each axis.
template <class N, int C, int LEFT, int RIGHT, bool SEVERAL, class T, class Use>
INLINE Pixel<N> around(const Frames<T>& f, const Mix<N>& mix, int x, int y, Use use) {
    constexpr int reading =
        lanes_for((LEFT + 1 + RIGHT) * C > 16 ? 16 : (LEFT + 1 + RIGHT) * C) + (C == 4 && RIGHT == 3 ? 4 : 0);
    ptrdiff_t place = (ptrdiff_t)y * f.row + (ptrdiff_t)x * C;
    bool inside =
        x >= LEFT && x < f.w - RIGHT && y >= LEFT && y < f.h - RIGHT && f.has(y + RIGHT, (x - LEFT) * C + reading, C);
    if (__builtin_expect(inside && mix.n > 0, 1)) return within<N, C, SEVERAL>(f, mix, place, use);
    N own[PATCH * (WINDOW + 1)] = {};
    gather<N, C>(f, mix, x, y, own);
    return use(One<N>{own + PATCH + C}, (ptrdiff_t)PATCH);
}
// A mixed window of samples, some of which lie beyond the edge.
template <class N, int C, class T>
NOINLINE void gather(const Frames<T>& f, const Mix<N>& mix, int x, int y, N* own) {
    int columns[WINDOW], rows[WINDOW];
    for (int i = 0; i < WINDOW; i++) {
        columns[i] = placed(x - 1 + i, f.w, f.rule);
        rows[i] = placed(y - 1 + i, f.h, f.rule);
    }
    const N one = 1, *weight = mix.n == 1 && mix.constant == 0 ? &one : mix.weight;
    for (int j = 0; j < WINDOW; j++)
        for (int i = 0; i < WINDOW; i++) {
            bool beyond = columns[i] < 0 || rows[j] < 0;
            N sum[C];
            for (int c = 0; c < C; c++) sum[c] = mix.constant * (N)f.fill[c];
            for (int k = 0; k < mix.n; k++) {
                const T* p = f.at[mix.first + k] + rows[j] * f.row + (ptrdiff_t)columns[i] * C;
                for (int c = 0; c < C; c++) sum[c] += weight[k] * (beyond ? (N)f.fill[c] : (N)p[c]);
            }
            for (int c = 0; c < C; c++) own[j * PATCH + i * C + c] = sum[c];
        }
}

// ---- footprints -----------------------------------------------------------------------------------------------------

template <class N>
INLINE N smooth(N f) {
    return f * f * (3 - 2 * f);
}

// The footprints of a row's samples: S, and the spot if one suffices.
struct Prints {
    enum Kind { PLAIN, SPOT, WIDE };
    alignas(64) int kind[STRIDE];
    float xx[STRIDE], xy[STRIDE], yy[STRIDE];
    int x[STRIDE], y[STRIDE], shift[STRIDE];            // a spot's first point, and 1 if the second is a column further
    float first[STRIDE], second[STRIDE];                // their fractions along x
    float left[WINDOW][STRIDE], right[WINDOW][STRIDE];  // weights of rows for the left and the right points
    bool any;

    // Always for a whole row of a root, since loops of other lengths may round differently.
    template <int D>
    void find(const Row<D>& row);

private:
    template <int D>
    void find_spots(const Row<D>& row, int from, int end);
};

template <int D>
inline void Prints::find(const Row<D>& row) {
    constexpr int some = 8;  // computed at once
    int n = row.count;
    any = false;
    for (int from = 0; from < n; from += some) {
        const float *ax = row.across[0] + from, *ay = row.across[1] + from, *dx = row.down[0] + from,
                    *dy = row.down[1] + from;
        int shrinks = 0;
        for (int i = 0; i < some; i++) {
            float sxx = ax[i] * ax[i] + dx[i] * dx[i], sxy = ax[i] * ay[i] + dx[i] * dy[i];
            float syy = ay[i] * ay[i] + dy[i] * dy[i], room = 2 * (1 + LOW) - (sxx + syy), e = sxx - syy;
            xx[from + i] = sxx;
            xy[from + i] = sxy;
            yy[from + i] = syy;
            kind[from + i] = PLAIN;
            // λ₊ > 1 + LOW
            shrinks |= (from + i < n) & ((room < 0) | (e * e + 4 * sxy * sxy > room * room));
        }
        if (shrinks) find_spots(row, from, from + some);
        any |= shrinks;
    }
}
template <int D>
inline void Prints::find_spots(const Row<D>& row, int from, int end) {
    const float *part_x = row.part[0], *part_y = row.part[1];
    const int *whole_x = row.whole[0], *whole_y = row.whole[1];
    for (int i = from; i < end; i++) {
        float h = 0.5f * (xx[i] + yy[i]), e = 0.5f * (xx[i] - yy[i]), d = __builtin_sqrtf(e * e + xy[i] * xy[i]);
        float alpha = h + d - 1, beta = h - d - 1;
        kind[i] = alpha <= LOW ? PLAIN : (alpha < NARROW) & (h - d < SQUARE) ? SPOT : WIDE;
        // 12 Σ with its soft start
        float g = (RISE / (RISE - LOW)) * (alpha - LOW) / (alpha > LOW ? alpha : LOW);
        g = g > 1 ? 1 : g > 0 ? g : 0;
        alpha = g * (alpha > 0 ? alpha : 0);
        beta = g * (beta > 0 ? beta : 0);
        float half = 0.5f * (alpha + beta), f = 0.5f * (alpha - beta) / (d + 1e-12f);
        float var_x = (half + f * e) * (1 / 12.f), var_y = (half - f * e) * (1 / 12.f), cov = f * xy[i] * (1 / 12.f);
        float sx = __builtin_sqrtf(var_x > 0 ? var_x : 0), sy = __builtin_sqrtf(var_y > 0 ? var_y : 0);
        sx = sx < WIDEST_SPOT ? sx : WIDEST_SPOT;
        sy = sy < WIDEST_SPOT ? sy : WIDEST_SPOT;
        float rho = cov / (sx * sy + 1e-12f);
        rho = rho < -1 ? -1 : rho > 1 ? 1 : rho;  // rounding, for a tiny variance
        // Both points lie in a window of 5 × 5 from the first one's.
        float x0 = part_x[i] - sx, x1 = part_x[i] + sx, y0 = part_y[i] - sy, y1 = part_y[i] + sy;
        int before_x = x0 < 0, after_x = x1 >= 1, before_y = y0 < 0, after_y = y1 >= 1;
        x[i] = whole_x[i] - before_x;
        y[i] = whole_y[i] - before_y;
        shift[i] = before_x + after_x;
        first[i] = x0 + (float)before_x;
        second[i] = x1 - (float)after_x;
        float u = y0 + (float)before_y, v = y1 - (float)after_y;
        bool lower = before_y + after_y;
        auto outer = [](float t) { return 0.5f * KEYS * t * (1 - t) * (1 - t); };
        auto inner = [](float t) { return 0.5f + 0.5f * t * t * ((KEYS + 2) * t - (KEYS + 3)); };
        float p0 = outer(u), p1 = inner(u), p2 = inner(1 - u), p3 = outer(1 - u);
        float r0 = outer(v), r1 = inner(v), r2 = inner(1 - v), r3 = outer(1 - v);
        float q0 = lower ? 0 : r0, q1 = lower ? r0 : r1, q2 = lower ? r1 : r2, q3 = lower ? r2 : r3,
              q4 = lower ? r3 : 0;
        // (1 ± ρ)/4: of the upper points (p) and the lower ones (q), as halves, since columns are halves too.
        float same = 1 + rho, other = 1 - rho;
        left[0][i] = same * p0 + other * q0;
        left[1][i] = same * p1 + other * q1;
        left[2][i] = same * p2 + other * q2;
        left[3][i] = same * p3 + other * q3;
        left[4][i] = other * q4;
        right[0][i] = other * p0 + same * q0;
        right[1][i] = other * p1 + same * q1;
        right[2][i] = other * p2 + same * q2;
        right[3][i] = other * p3 + same * q3;
        right[4][i] = same * q4;
    }
}

// Averages of 2 × 2, 4 × 4, … samples, of every frame; an odd edge repeats its last sample.
template <class N>
struct Pyramid {
    int levels = 0;
    Frames<N> level[LEVELS];
};

// A spot of the variance 12 Σ = (xx, xy; xy, yy) at (x, y).
template <class N, int C, bool SEVERAL, class T>
INLINE Pixel<N> spot(const Frames<T>& f, const Mix<N>& mix, N x, N y, N xx, N xy, N yy) {
    N sx = std::min(N(sqrt(xx / 12)), N(WIDEST_SPOT)), sy = std::min(N(sqrt(yy / 12)), N(WIDEST_SPOT));
    N rho = std::clamp(xy / 12 / (sx * sy + N(1e-12)), N(-1), N(1));
    N x0 = floored(x - sx), x1 = floored(x + sx), y0 = floored(y - sy), y1 = floored(y + sy);
    N left[WINDOW] = {}, right[WINDOW] = {};
    for (int point = 0; point < 2; point++) {
        N t = point ? y + sy - y1 : y - sy - y0;
        int lower = point ? (int)(y1 - y0) : 0;
        for (int j = 0; j < 4; j++) {
            N w = N(KEYS_POWERS[0][j]) +
                  t * (N(KEYS_POWERS[1][j]) + t * (N(KEYS_POWERS[2][j]) + t * N(KEYS_POWERS[3][j])));
            left[j + lower] += (point ? 1 - rho : 1 + rho) * w / 2;
            right[j + lower] += (point ? 1 + rho : 1 - rho) * w / 2;
        }
    }
    Across<N> across{x - sx - x0, x + sx - x1, (int)(x1 - x0)};
    return around<N, C, 1, 3, SEVERAL>(f, mix, (int)x0, (int)y0, [&](auto taps, ptrdiff_t row) INLINE_LAMBDA {
        return spot_at<N, C, 1>(taps, row, across, left, right);
    });
}

// n spots along the major axis u of a footprint `length` long and √w2 wide.
template <class N, int C, bool SEVERAL, class T>
NOINLINE Pixel<N> spots(const Frames<T>& f, const Mix<N>& mix, int n, N x, N y, N ux, N uy, N length, N w2) {
    N l2 = std::min(length * length / (n * n), N(3));
    N xx = l2 * ux * ux + w2 * uy * uy, yy = l2 * uy * uy + w2 * ux * ux, xy = (l2 - w2) * ux * uy;
    Pixel<N> sum{};
    for (int i = 0; i < n; i++) {
        N along = length * ((i + N(0.5)) / n - N(0.5));
        sum += spot<N, C, SEVERAL>(f, mix, x + along * ux, y + along * uy, xx, xy, yy);
    }
    return sum * (N(1) / n);
}

// The footprint with the eigenvalues `large` and `small`, in samples of this level.
template <class N, int C, bool SEVERAL, class T>
INLINE Pixel<N> in_level(const Frames<T>& f, const Mix<N>& mix, N x, N y, N ux, N uy, N large, N small) {
    N length = sqrt(std::max(large - 1, N(0))), w2 = std::clamp(small - 1, N(0), N(2.99));
    N v = length / N(PER_SPOT);
    int n = std::min((int)v + 1, MOST_SPOTS);
    Pixel<N> mean = spots<N, C, SEVERAL>(f, mix, n, x, y, ux, uy, length, w2);
    N fade = 4 * (v - (n - 1) - N(0.75));
    if (fade > 0 && n < MOST_SPOTS)
        mean += smooth(fade) * (spots<N, C, SEVERAL>(f, mix, n + 1, x, y, ux, uy, length, w2) - mean);
    return mean;
}

// Any footprint, of S = (xx, xy; xy, yy).
template <class N, int C, bool SEVERAL, class T>
NOINLINE Pixel<N> wide(const Frames<T>& f, const Pyramid<N>& pyramid, const Mix<N>& mix, N x, N y, N xx, N xy, N yy) {
    N h = (xx + yy) / 2, e = (xx - yy) / 2, d = sqrt(e * e + xy * xy) + N(1e-12), large = h + d, small = h - d;
    N cosine = std::clamp(e / d, N(-1), N(1)), ux = sqrt((1 + cosine) / 2), uy = sqrt((1 - cosine) / 2);
    if (xy < 0) uy = -uy;
    N want = std::max(small, large / 400);
    int k = 0;
    while (k < pyramid.levels && want >= 4) want /= 4, k++;
    constexpr int LEVEL_C = C == 1 ? 1 : 4;  // channels of a level
    auto level = [&](int k) {
        if (k == 0) return in_level<N, C, SEVERAL>(f, mix, x, y, ux, uy, large, small);
        N scale = N(1) / (1 << k), area = scale * scale;
        return in_level<N, LEVEL_C, SEVERAL>(pyramid.level[k - 1], mix, (x + N(0.5)) * scale - N(0.5),
                                             (y + N(0.5)) * scale - N(0.5), ux, uy, large * area, small * area);
    };
    Pixel<N> v = level(k);
    N fade = std::min((want - N(3.2)) / N(0.8), N(1));
    if (fade > 0 && k < pyramid.levels) v += smooth(fade) * (level(k + 1) - v);
    return v;
}

}  // namespace supple
