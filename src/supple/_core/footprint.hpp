// The residual footprint of a pixel, and the sample points that average it.
//
// The footprint (docs/sampling.md). A sample is already an average over one sample. With M = ∂p/∂q, S = MMᵀ and its
// eigenvalues λ±, the remaining average is that of the cubic interpolant over a box of variance Σ,
//
//     12 Σ = ½(α + β) I + (α - β)/(λ₊ - λ₋) (S - ½(λ₊ + λ₋) I),     α, β = g max(λ± - 1, 0),
//
// whose second moments four cubic samples at (±√Σxx, ±√Σyy), weighted (1 ± ρ)/4, have exactly: a `spot`. As products
// along the axes, these are one window of 5 × 5. A larger footprint is a row of spots along its major axis, in the
// level of a pyramid for its minor axis, blended with the next number of spots and the next level.
//
// Nothing here reads samples: `Levels` do, with a value P for each pixel. It uses no std::, allocation or exceptions,
// so that compilers for GPUs accept this file.
#pragma once
#include "simd.hpp"

namespace supple {

enum Filter { NEAREST, LINEAR, CUBIC, AUTO };
enum Rule { EDGE, CONSTANT, REFLECT };

constexpr float KEYS = -0.75f;            // the parameter a of the cubic in space
constexpr float LOW = 0.1f, RISE = 0.2f;  // of α: no average below LOW, the full one from LOW + RISE on
constexpr float NARROW = 1.62f, SQUARE = 3.2f;
constexpr float WIDEST_SPOT = 0.4999f;  // half its sides: the points of a spot are less than a sample apart
constexpr float PER_SPOT = 1.7f;  // the largest distance of spots; one more spot fades in over the last quarter of it
constexpr float FADES = 0.75f;
constexpr int MOST_SPOTS = 16;
constexpr float THICKEST = 3, FLATTEST = 2.99f;  // 12 Σ of a spot along the major axis, and across it
constexpr float LEVEL = 4;                       // λ₋ from which a coarser level is read, blended from SQUARE on
constexpr float LONG = 400;                      // λ₊ / λ₋ from which the longer side determines the level
constexpr int LEVELS = 12;
constexpr int WINDOW = 5;  // samples along a side

// The index that replaces sample i of n in a boundary mode; -1 for a constant.
INLINE int placed(int i, int n, int rule) {
    if ((unsigned)i < (unsigned)n) return i;
    if (rule == CONSTANT) return -1;
    if (rule == EDGE) return i < 0 ? 0 : n - 1;
    int64_t m = 2 * (int64_t)n, k = ((i % m) + m) % m;
    return (int)(k < n ? k : m - 1 - k);
}

// Keys' cubic at the four samples around a fraction f is Σ KEYS_POWERS[d][i] f^d.
constexpr float KEYS_POWERS[4][4] = {
    {0, 1, 0, 0}, {KEYS, 0, -KEYS, 0}, {-2 * KEYS, -KEYS - 3, 2 * KEYS + 3, KEYS}, {KEYS, KEYS + 2, -KEYS - 2, -KEYS}};

// The weight of the i-th of these samples.
template <class N>
INLINE N keys(int i, N f) {
    return N(KEYS_POWERS[0][i]) + f * (N(KEYS_POWERS[1][i]) + f * (N(KEYS_POWERS[2][i]) + f * N(KEYS_POWERS[3][i])));
}

template <class N>
INLINE N smooth(N f) {
    return f * f * (3 - 2 * f);
}

// The positions of a spot's left and right points along x.
template <class N>
struct Across {
    N first, second;  // their fractions
    int shift;        // 1 if the right one is in the next column
};

// The footprint of a pixel: its kind, and the spot if one suffices.
enum Kinds { PLAIN, SPOT, WIDE };
struct Print {
    int kind;
    int x, y;  // the spot's first point
    Across<float> across;
    float left[WINDOW], right[WINDOW];  // weights of rows for the left and the right points
};

// Whether λ₊ > 1 + LOW, of S = (xx, xy; xy, yy).
INLINE bool shrinks(float xx, float xy, float yy) {
    const float room = 2 * (1 + LOW) - (xx + yy), e = xx - yy;
    return (room < 0) | (e * e + 4 * xy * xy > room * room);
}

// The kind of a footprint with S = (xx, xy; xy, yy); and the standard deviations and the correlation of its average.
INLINE int spread_of(float xx, float xy, float yy, float& sx, float& sy, float& rho) {
    float h = 0.5f * (xx + yy), e = 0.5f * (xx - yy), d = root(e * e + xy * xy);
    float alpha = h + d - 1, beta = h - d - 1;
    const int kind = alpha <= LOW ? PLAIN : ((alpha < NARROW) & (h - d < SQUARE)) ? SPOT : WIDE;
    // 12 Σ, with a soft start
    float g = (RISE / (RISE - LOW)) * (alpha - LOW) / (alpha > LOW ? alpha : LOW);
    g = g > 1 ? 1 : g > 0 ? g : 0;
    alpha = g * (alpha > 0 ? alpha : 0);
    beta = g * (beta > 0 ? beta : 0);
    float half = 0.5f * (alpha + beta), f = 0.5f * (alpha - beta) / (d + 1e-12f);
    float var_x = (half + f * e) * (1 / 12.f), var_y = (half - f * e) * (1 / 12.f), cov = f * xy * (1 / 12.f);
    sx = root(var_x > 0 ? var_x : 0), sy = root(var_y > 0 ? var_y : 0);
    sx = sx < WIDEST_SPOT ? sx : WIDEST_SPOT;
    sy = sy < WIDEST_SPOT ? sy : WIDEST_SPOT;
    rho = cov / (sx * sy + 1e-12f);
    rho = rho < -1 ? -1 : rho > 1 ? 1 : rho;  // rounding, for a tiny variance
    return kind;
}

// The footprint of a pixel at the source point `whole` + `part`.
INLINE Print print_of(int kind, float sx, float sy, float rho, int whole_x, int whole_y, float part_x, float part_y) {
    Print p;
    p.kind = kind;
    // Both points are within a window of 5 × 5 that begins at the first one's.
    float x0 = part_x - sx, x1 = part_x + sx, y0 = part_y - sy, y1 = part_y + sy;
    int before_x = x0 < 0, after_x = x1 >= 1, before_y = y0 < 0, after_y = y1 >= 1;
    p.x = whole_x - before_x;
    p.y = whole_y - before_y;
    p.across.shift = before_x + after_x;
    p.across.first = x0 + (float)before_x;
    p.across.second = x1 - (float)after_x;
    float u = y0 + (float)before_y, v = y1 - (float)after_y;
    bool lower = before_y + after_y;
    auto outer = [](float t) { return 0.5f * KEYS * t * (1 - t) * (1 - t); };
    auto inner = [](float t) { return 0.5f + 0.5f * t * t * ((KEYS + 2) * t - (KEYS + 3)); };
    float p0 = outer(u), p1 = inner(u), p2 = inner(1 - u), p3 = outer(1 - u);
    float r0 = outer(v), r1 = inner(v), r2 = inner(1 - v), r3 = outer(1 - v);
    float q0 = lower ? 0 : r0, q1 = lower ? r0 : r1, q2 = lower ? r1 : r2, q3 = lower ? r2 : r3, q4 = lower ? r3 : 0;
    // (1 ± ρ)/4 for the upper points (p) and the lower ones (q): halves here, as columns have the other half.
    float same = 1 + rho, other = 1 - rho;
    p.left[0] = same * p0 + other * q0;
    p.left[1] = same * p1 + other * q1;
    p.left[2] = same * p2 + other * q2;
    p.left[3] = same * p3 + other * q3;
    p.left[4] = other * q4;
    p.right[0] = other * p0 + same * q0;
    p.right[1] = other * p1 + same * q1;
    p.right[2] = other * p2 + same * q2;
    p.right[3] = other * p3 + same * q3;
    p.right[4] = same * q4;
    return p;
}

// The weights of rows as other numbers, which add up to 1 as exactly as these can: what is constant stays so.
template <class N, class W>
INLINE void widen(const W* weight, int apart, N* wider) {
    N rest = 1;
    for (int j = 0; j < WINDOW; j++) rest -= wider[j] = (N)weight[j * apart];
    if (sizeof(N) > sizeof(W)) wider[2] += rest;
}

// A spot of the variance 12 Σ = (xx, xy; xy, yy) at (x, y) in a level.
template <class P, class N, class Level>
INLINE P spot(const Level& level, N x, N y, N xx, N xy, N yy) {
    N sx = least(root(xx / 12), N(WIDEST_SPOT)), sy = least(root(yy / 12), N(WIDEST_SPOT));
    N rho = least(most(xy / 12 / (sx * sy + N(1e-12)), N(-1)), N(1));
    N x0 = floored(x - sx), x1 = floored(x + sx), y0 = floored(y - sy), y1 = floored(y + sy);
    N left[WINDOW] = {}, right[WINDOW] = {};
    for (int point = 0; point < 2; point++) {
        N t = point ? y + sy - y1 : y - sy - y0;
        int lower = point ? (int)(y1 - y0) : 0;
        for (int j = 0; j < 4; j++) {
            N w = keys(j, t);
            left[j + lower] += (point ? 1 - rho : 1 + rho) * w / 2;
            right[j + lower] += (point ? 1 + rho : 1 - rho) * w / 2;
        }
    }
    return level.spot((int)x0, (int)y0, Across<N>{x - sx - x0, x + sx - x1, (int)(x1 - x0)}, left, right);
}

// n spots along the major axis u of a footprint with the given length, and the width √w2.
template <class P, class N, class Level>
NOINLINE P spots(const Level& level, int n, N x, N y, N ux, N uy, N length, N w2) {
    N l2 = least(length * length / (n * n), N(THICKEST));
    N xx = l2 * ux * ux + w2 * uy * uy, yy = l2 * uy * uy + w2 * ux * ux, xy = (l2 - w2) * ux * uy;
    P sum{};
    for (int i = 0; i < n; i++) {
        N along = length * ((i + N(0.5)) / n - N(0.5));
        sum += spot<P>(level, x + along * ux, y + along * uy, xx, xy, yy);
    }
    return sum * (N(1) / n);
}

// The average over any footprint, S = (xx, xy; xy, yy), at (x, y). There are `levels.count` levels of a pyramid above
// the samples; levels.spots(k, …) are `spots` in the k-th level.
template <class P, class N, class Levels>
NOINLINE P wide(const Levels& levels, N x, N y, N xx, N xy, N yy) {
    N h = (xx + yy) / 2, e = (xx - yy) / 2, d = root(e * e + xy * xy) + N(1e-12), large = h + d, small = h - d;
    N cosine = least(most(e / d, N(-1)), N(1)), ux = root((1 + cosine) / 2), uy = root((1 - cosine) / 2);
    if (xy < 0) uy = -uy;
    N want = most(small, large / N(LONG));
    int k = 0;
    while (k < levels.count && want >= N(LEVEL)) want /= 4, k++;
    auto level = [&](int k) {
        N scale = N(1) / (1 << k), area = scale * scale;
        N u = k ? (x + N(0.5)) * scale - N(0.5) : x, v = k ? (y + N(0.5)) * scale - N(0.5) : y;
        N length = root(most(large * area - 1, N(0))), w2 = least(most(small * area - 1, N(0)), N(FLATTEST));
        N apart = length / N(PER_SPOT);
        int n = (int)apart + 1 < MOST_SPOTS ? (int)apart + 1 : MOST_SPOTS;
        auto mean_of = [&](int n) { return levels.spots(k, n, u, v, ux, uy, length, w2); };
        P mean = mean_of(n);
        N fade = (apart - (n - 1) - N(FADES)) / N(1 - FADES);
        if (fade > 0 && n < MOST_SPOTS) mean += smooth(fade) * (mean_of(n + 1) - mean);
        return mean;
    };
    P v = level(k);
    N fade = least((want - N(SQUARE)) / N(LEVEL - SQUARE), N(1));
    if (fade > 0 && k < levels.count) v += smooth(fade) * (level(k + 1) - v);
    return v;
}

}  // namespace supple
