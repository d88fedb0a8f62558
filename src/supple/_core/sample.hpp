// Colours at source points: linear, cubic, or averaged over the residual footprint, of one frame or a mixture.
#pragma once
#include "footprint.hpp"
#include "plan.hpp"
#include "vectors.hpp"

namespace supple {

constexpr int SOME = 8;    // pixels whose footprints are computed at once
constexpr int PATCH = 32;  // numbers from one row of a patch of samples to the next

// ---- weights --------------------------------------------------------------------------------------------------------

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
    return sum_of<N, C>(v * weights<N, C, L>(fx));
}

// The sum of a spot; left, right: the weights of rows for its left and right points, ES apart.
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
    Pixel<N> s = sum_of<N, C>(v);
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

// ---- frames, and how they are mixed at a pixel ----------------------------------------------------------------------

// Frames of one kind, with C interleaved channels, `row` numbers from one row to the next.
template <class T>
struct Frames {
    const T* const* at;
    int w, h;
    ptrdiff_t row;
    ptrdiff_t limit;  // numbers that may be read from the start of a frame; a part of a frame has padding after it
    int rule;
    const double* fill;

    // Whether n numbers of a row and of what follows may be read. This refers to the whole frame, even if only a part
    // of it is in memory, as kernels that may not read beyond the end round differently.
    INLINE bool has(int y, int n, int channels) const { return (ptrdiff_t)y * w * channels + n <= limit; }
};

// Frames `first` to `first + n - 1`, each with a weight; and the weight of the constant beyond a clip's ends.
template <class N>
struct Mix {
    int first, n;
    const N* weight;
    N constant;
};

// Call use(taps, row) with the samples from `place` on, all within the frames, and add the constant.
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

// Write a window of mixed samples around (x, y), some of which lie beyond the edge, to `own`.
template <class N, int C, class T>
NOINLINE void gather(const Frames<T>& f, Mix<N> mix, int x, int y, int left, int right, N* own) {
    int columns[WINDOW], rows[WINDOW];
    for (int i = 0; i < WINDOW; i++) {
        columns[i] = placed(x - 1 + i, f.w, f.rule);
        rows[i] = placed(y - 1 + i, f.h, f.rule);
    }
    const N one = 1, *weight = mix.n == 1 && mix.constant == 0 ? &one : mix.weight;
    std::fill_n(own + (1 - left) * PATCH, (1 + left + right) * PATCH, N(0));
    for (int j = 1 - left; j <= 1 + right; j++)
        for (int i = 1 - left; i <= 1 + right; i++) {
            const bool beyond = (columns[i] | rows[j]) < 0;
            N* sum = own + j * PATCH + i * C;
            for (int c = 0; c < C; c++) sum[c] = mix.constant * (N)f.fill[c];
            for (int k = 0; k < mix.n; k++) {
                const T* p = f.at[mix.first + k] + rows[j] * f.row + (ptrdiff_t)columns[i] * C;
                for (int c = 0; c < C; c++) sum[c] += weight[k] * (beyond ? (N)f.fill[c] : (N)p[c]);
            }
        }
}
// The place of the sample at (x, y).
template <int C, class T>
INLINE ptrdiff_t place_of(const Frames<T>& f, int x, int y) {
    return (ptrdiff_t)y * f.row + (ptrdiff_t)x * C;
}
// Whether the samples around (x, y) all lie within the frames: LEFT before it and RIGHT after it on each axis.
template <int C, int LEFT, int RIGHT, class T>
INLINE bool inner(const Frames<T>& f, int x, int y) {
    constexpr int reading =
        lanes_for((LEFT + 1 + RIGHT) * C > 16 ? 16 : (LEFT + 1 + RIGHT) * C) + (C == 4 && RIGHT == 3 ? 4 : 0);
    return x >= LEFT && x < f.w - RIGHT && y >= LEFT && y < f.h - RIGHT &&
           f.has(y + RIGHT, (x - LEFT) * C + reading, C);
}
// Call use(taps, row) with the samples around (x, y): from `place` on if `inside`, or in a gathered window.
template <class N, int C, int LEFT, int RIGHT, bool SEVERAL, class T, class Use>
INLINE Pixel<N> around(const Frames<T>& f, const Mix<N>& mix, int x, int y, bool inside, ptrdiff_t place, Use use) {
    if (__builtin_expect(inside && (!SEVERAL || mix.n > 0), 1)) return within<N, C, SEVERAL>(f, mix, place, use);
    N own[PATCH * (WINDOW + 1)];
    gather<N, C>(f, mix, x, y, LEFT, RIGHT, own);
    return use(One<N>{own + PATCH + C}, (ptrdiff_t)PATCH);
}

// ---- footprints -----------------------------------------------------------------------------------------------------

// The footprints of a row's samples: S, and the spot if one suffices.
struct Prints {
    alignas(64) int kind[STRIDE];
    float xx[STRIDE], xy[STRIDE], yy[STRIDE];
    int x[STRIDE], y[STRIDE], shift[STRIDE];            // a spot's first point; 1 if the second is in the next column
    float first[STRIDE], second[STRIDE];                // their fractions along x
    float left[WINDOW][STRIDE], right[WINDOW][STRIDE];  // weights of rows for the left and the right points
    float sx[STRIDE], sy[STRIDE], rho[STRIDE];          // the deviations of a spot, and their correlation
    bool any;

    // Always for a whole row of a root, since loops of other lengths may round differently.
    template <int D>
    void find(const Row<D>& __restrict row, int filter) __restrict;

private:
    template <int D>
    void find_spots(const Row<D>& __restrict row, int from) __restrict;
};

template <int D>
inline void Prints::find(const Row<D>& __restrict row, int filter) __restrict {
    int n = row.count, shrinking[STRIDE / SOME], count = 0;  // blocks with footprints
    any = false;
    if (filter != AUTO || !row.sloped) return;
    for (int from = 0; from < n; from += SOME) {
        const float *ax = row.across[0] + from, *ay = row.across[1] + from, *dx = row.down[0] + from,
                    *dy = row.down[1] + from;
        int shrink = 0;
        for (int i = 0; i < SOME; i++) {
            float sxx = ax[i] * ax[i] + dx[i] * dx[i], sxy = ax[i] * ay[i] + dx[i] * dy[i];
            float syy = ay[i] * ay[i] + dy[i] * dy[i];
            xx[from + i] = sxx;
            xy[from + i] = sxy;
            yy[from + i] = syy;
            kind[from + i] = PLAIN;
            shrink |= (from + i < n) & shrinks(sxx, sxy, syy);
        }
        if (shrink) shrinking[count++] = from;
    }
    any = count > 0;
    for (int b = 0; b < count; b++)  // quotients and roots wait for each other: those of all blocks together
        for (int i = shrinking[b]; i < shrinking[b] + SOME; i++)
            kind[i] = spread_of(xx[i], xy[i], yy[i], sx[i], sy[i], rho[i]);
    for (int b = 0; b < count; b++) find_spots(row, shrinking[b]);
}
template <int D>
inline void Prints::find_spots(const Row<D>& __restrict row, int from) __restrict {
    for (int i = from; i < from + SOME; i++) {
        const Print p =
            print_of(kind[i], sx[i], sy[i], rho[i], row.whole[0][i], row.whole[1][i], row.part[0][i], row.part[1][i]);
        x[i] = p.x;
        y[i] = p.y;
        shift[i] = p.across.shift;
        first[i] = p.across.first;
        second[i] = p.across.second;
        for (int j = 0; j < WINDOW; j++) {
            left[j][i] = p.left[j];
            right[j][i] = p.right[j];
        }
    }
}

// Averages of 2 × 2, 4 × 4, … samples, of every frame; an odd edge repeats its last sample.
template <class N>
struct Pyramid {
    int levels = 0;
    Frames<N> level[LEVELS];
};

// The samples of a level, as `wide` reads them.
template <class N, int C, bool SEVERAL, class T>
struct Level {
    const Frames<T>& frames;
    const Mix<N>& mix;
    INLINE Pixel<N> spot(int x, int y, Across<N> across, const N* left, const N* right) const {
        const bool inside = inner<C, 1, 3>(frames, x, y);
        return around<N, C, 1, 3, SEVERAL>(
            frames, mix, x, y, inside, place_of<C>(frames, x, y),
            [&](auto taps, ptrdiff_t row) INLINE_LAMBDA { return spot_at<N, C, 1>(taps, row, across, left, right); });
    }
};
template <class N, int C, bool SEVERAL, class T>
NOINLINE Pixel<N> spots_of(const void* frames, const Mix<N>& mix, int n, N x, N y, N ux, N uy, N length, N w2) {
    const Level<N, C, SEVERAL, T> level{*(const Frames<T>*)frames, mix};
    return spots<Pixel<N>>(level, n, x, y, ux, uy, length, w2);
}
// Frames of any type and their pyramid, so that `wide` is compiled once for all.
template <class N>
struct Levels {
    typedef Pixel<N> (*Spots)(const void* frames, const Mix<N>& mix, int n, N x, N y, N ux, N uy, N length, N w2);
    const void* frames;
    const Pyramid<N>& pyramid;
    const Mix<N>& mix;
    Spots of_samples, of_averages;
    int count = pyramid.levels;

    INLINE Pixel<N> spots(int k, int n, N x, N y, N ux, N uy, N length, N w2) const {
        return k == 0 ? of_samples(frames, mix, n, x, y, ux, uy, length, w2)
                      : of_averages(&pyramid.level[k - 1], mix, n, x, y, ux, uy, length, w2);
    }
};

}  // namespace supple
