// Where a sampled field folds: the cells of its grid in which the determinant of I + ∂w/∂i may not be above 0, and the
// samples of another grid that what folds may be mapped to.
//
// Within a cell, i + w(i) is a polynomial in Bézier form: of degree 1 or 3 along each axis. It lies in the hull of its
// control points, and its derivatives in that of their differences. So the determinant of a cell is bounded from below
// by the ranges of nine numbers; where that does not suffice, the cell is cut in halves.
#pragma once
#include <algorithm>
#include <functional>
#include <vector>

#include "sampled.hpp"
#include "threads.hpp"

namespace supple {

template <int D, int N>  // N: control points along an axis
struct Patch {
    static constexpr int COUNT = D == 3 ? N * N * N : N * N;
    double c[D][COUNT];
};

// Call f(first) for the first control point of every line along an axis, whose points lie `step` apart.
template <int D, int N, class F>
inline void each_line(int step, F f) {
    for (int outer = 0; outer < Patch<D, N>::COUNT / (step * N); outer++)
        for (int inner = 0; inner < step; inner++) f(outer * step * N + inner);
}

// Whether the determinant is above 0 for all matrices between low and high, as far as this is quickly known; [b][a].
template <int D, class V>
INLINE typename Masked<V>::type surely_above_0(const V (*low)[D], const V (*high)[D]) {
    typedef typename Masked<V>::type M;
    V mid[D][D], off[D][D], size[D][D];
    for (int b = 0; b < D; b++)
        for (int a = 0; a < D; a++) {
            mid[b][a] = 0.5 * (low[b][a] + high[b][a]);
            off[b][a] = 0.5 * (high[b][a] - low[b][a]);
            size[b][a] = magnitude(mid[b][a]);
        }
    M dominant = mid[0][0] == mid[0][0];  // by rows, which is quick, and enough for what bends little
    for (int a = 0; a < D; a++) {
        V own = low[a][a];
        for (int b = 0; b < D; b++)
            if (b != a) own -= size[b][a] + off[b][a];
        dominant = both(dominant, own > 1e-9);
    }
    if (!any(without(mid[0][0] == mid[0][0], dominant))) return dominant;
    // Multilinear in its columns: bound every term that has a deviation.
    auto permanent = [](const V* x, const V* y, const V* z) INLINE_LAMBDA -> V {
        if constexpr (D == 2) return x[0] * y[1] + x[1] * y[0];
        return x[0] * (y[1] * z[2] + y[2] * z[1]) + x[1] * (y[0] * z[2] + y[2] * z[0]) +
               x[2] * (y[0] * z[1] + y[1] * z[0]);
    };
    V bound = determinant_of(mid), scale{};
    for (int set = 0; set < 1 << D; set++) {
        const V* row[3] = {};
        for (int b = 0; b < D; b++) row[b] = set >> b & 1 ? off[b] : size[b];
        if (set == 0)
            scale = permanent(row[0], row[1], row[2]);
        else if (set & (set - 1))
            bound -= permanent(row[0], row[1], row[2]);
        else {  // one deviation: by cofactors
            int b = set == 1 ? 0 : set == 2 ? 1 : 2;
            for (int a = 0; a < D; a++) {
                V cofactor;
                if constexpr (D == 2)
                    cofactor = mid[1 - b][1 - a];
                else {
                    int p = (b + 1) % 3, q = (b + 2) % 3, r = (a + 1) % 3, s = (a + 2) % 3;
                    cofactor = mid[p][r] * mid[q][s] - mid[p][s] * mid[q][r];
                }
                bound -= off[b][a] * magnitude(cofactor);
            }
        }
    }
    return either(dominant, bound > 1e-12 * (1.0 + scale));
}

// Whether the determinant of the derivatives of a patch is above 0 in all of it.
template <int D, int N>
NOINLINE bool surely_upright(const Patch<D, N>& p) {
    double low[D][D], high[D][D];  // [b][a]: ∂a/∂b
    int step = 1;
    for (int b = 0; b < D; b++, step *= N)
        for (int a = 0; a < D; a++) {
            low[b][a] = 1e300;
            high[b][a] = -1e300;
            each_line<D, N>(step, [&](int first) {
                for (int i = 1; i < N; i++) {
                    double v = p.c[a][first + i * step] - p.c[a][first + (i - 1) * step];
                    low[b][a] = std::min(low[b][a], v);
                    high[b][a] = std::max(high[b][a], v);
                }
            });
        }
    // Along an axis, all derivatives are the differences of control points times N - 1.
    return surely_above_0<D, double>(low, high);
}

// The part of a patch in one of the 2^D octants.
template <int D, int N>
NOINLINE Patch<D, N> octant(const Patch<D, N>& whole, int which) {
    Patch<D, N> p = whole;
    int step = 1;
    for (int b = 0; b < D; b++, step *= N)
        for (int a = 0; a < D; a++)
            each_line<D, N>(step, [&](int first) {
                double v[N], *to = p.c[a] + first;
                for (int i = 0; i < N; i++) v[i] = to[i * step];
                if (which >> b & 1)  // the upper half: from the last control point on, backwards
                    for (int r = 0; r < N; r++) {
                        to[(N - 1 - r) * step] = v[N - 1];
                        for (int i = N - 1; i > r; i--) v[i] = 0.5 * (v[i] + v[i - 1]);
                    }
                else
                    for (int r = 0; r < N; r++) {
                        to[r * step] = v[0];
                        for (int i = 0; i < N - 1 - r; i++) v[i] = 0.5 * (v[i] + v[i + 1]);
                    }
            });
    return p;
}

// The patch of the cell at `at`; along an axis, cells -1 and size - 1 are those beyond the first and last index.
template <int D, int N>
NOINLINE Patch<D, N> patch_of(const Sampled& k, const int* at) {
    Patch<D, N> p;
    constexpr int TAPS = N;
    int sample[D][TAPS];
    for (int d = 0; d < D; d++) {
        int cell = std::clamp(at[d], (int)k.first[d], std::max((int)k.last[d] - 1, (int)k.first[d]));
        for (int n = 0; n < TAPS; n++) sample[d][n] = mirrored(cell + n - (TAPS / 2 - 1), k.size[d]);
    }
    auto value = [&](const int* n, int c) {
        size_t offset = D == 3 ? sample[2][n[2]] : 0;
        offset = (offset * k.size[1] + sample[1][n[1]]) * k.size[0] + sample[0][n[0]];
        return k.wide ? ((const double*)k.values)[offset * D + c] : (double)((const float*)k.values)[offset * D + c];
    };
    for (int n = 0; n < Patch<D, N>::COUNT; n++) {
        int tap[3] = {n % N, n / N % N, n / (N * N)};
        double raw[D];
        for (int c = 0; c < D; c++) raw[c] = value(tap, c);
        for (int a = 0; a < D; a++) {
            double w = 0;
            for (int c = 0; c < D; c++) w += k.vectors[a][c] * raw[c];
            p.c[a][n] = w;
        }
    }
    int step = 1;
    for (int b = 0; b < D; b++, step *= N) {
        const bool before = at[b] < k.first[b], after = at[b] >= k.last[b];
        for (int a = 0; a < D; a++)
            each_line<D, N>(step, [&](int first) {
                double* v = p.c[a] + first;
                if constexpr (N == 4) {  // from a spline's coefficients to control points
                    double c0 = v[0], c1 = v[step], c2 = v[2 * step], c3 = v[3 * step];
                    v[0] = (c0 + 4 * c1 + c2) / 6;
                    v[step] = (2 * c1 + c2) / 3;
                    v[2 * step] = (c1 + 2 * c2) / 3;
                    v[3 * step] = (c1 + 4 * c2 + c3) / 6;
                }
                // Beyond the ends, all is as at the end. On an axis of one sample, too.
                if (before)
                    for (int i = 1; i < N; i++) v[i * step] = v[0];
                else if (after && k.size[b] > 1)
                    for (int i = 0; i < N; i++) v[i * step] = v[(N - 1) * step];
            });
        for (int n = 0; n < Patch<D, N>::COUNT; n++) p.c[b][n] += at[b] + (double)(n / step % N) / (N - 1);
    }
    return p;
}

constexpr int CUTS = 3;       // times that a cell is cut, at most
constexpr double FINE = 0.5;  // of a sample: the extent of a part below which it is not cut

// The range of samples of another grid that a part of a folded cell may be mapped to.
template <int D>
struct Spot {
    int low[D], high[D];
};

// Collect what folds of a patch that is not surely upright.
template <int D, int N>
inline void find_folds(const Patch<D, N>& p, const double (*out)[4], double growth, int cuts, const bool* low_end,
                       const bool* high_end, const int* size, std::vector<Spot<D>>& spots) {
    double low[D], high[D], widest = 0;
    for (int a = 0; a < D; a++) {
        low[a] = 1e300;
        high[a] = -1e300;
    }
    for (int n = 0; n < Patch<D, N>::COUNT; n++)
        for (int a = 0; a < D; a++) {
            double v = out[a][3];
            for (int b = 0; b < D; b++) v += out[a][b] * p.c[b][n];
            low[a] = std::min(low[a], v);
            high[a] = std::max(high[a], v);
        }
    for (int a = 0; a < D; a++) widest = std::max(widest, high[a] - low[a]);
    for (int b = 0; b < D; b++)  // an end of the field, whose continuation has no end
        if (low_end[b] || high_end[b])
            for (int a = 0; a < D; a++) {
                double way = out[a][b] * growth * (low_end[b] ? -1 : 1);
                low[a] = std::min(low[a], low[a] + way);
                high[a] = std::max(high[a], high[a] + way);
            }
    Spot<D> spot;
    for (int a = 0; a < D; a++) {
        spot.low[a] = (int)std::clamp(ceil(low[a] - 1e-6), 0.0, (double)size[a]);
        spot.high[a] = (int)std::clamp(floor(high[a] + 1e-6) + 1, 0.0, (double)size[a]);
        if (spot.low[a] >= spot.high[a]) return;  // between the samples, or beyond the result's grid
    }
    if (cuts > 0 && surely_upright(p)) return;
    if (cuts == CUTS || widest <= FINE) {
        spots.push_back(spot);
        return;
    }
    for (int which = 0; which < 1 << D; which++)
        find_folds(octant(p, which), out, growth, cuts + 1, low_end, high_end, size, spots);
}

// Rows of w about a line of cells, kept while y ascends, by which most cells are known not to fold.
template <int D, int N>
class Lines {
public:
    explicit Lines(const Sampled& k)
        : k(k), n(k.size[0]), padded(n + LANES + N), held((size_t)N * DEEP * D * padded), sure(padded) {}

    // For each cell of a line, whether the map is surely upright in all of it: its derivatives lie between the
    // differences of the samples around. Not for cells that depend on samples beyond an end.
    const std::vector<char>& upright(int y, int z) {
        std::fill(sure.begin(), sure.end(), 0);
        const int first[3] = {LEFT, y, z};
        for (int d = 1; d < D; d++)
            if (first[d] < LEFT || first[d] + N - LEFT > k.size[d]) return sure;
        if (n < N) return sure;
        for (int m = 0; m < N; m++)
            if (z != at_z || y - LEFT + m >= next_y || y - LEFT < next_y - N) load(y - LEFT + m, z);
        at_z = z;
        next_y = y - LEFT + N;
        for (int x = LEFT; x + N - LEFT <= n; x += LANES) {
            Lanes low[D][D], high[D][D];
            for (int a = 0; a < D; a++) {
                for (int b = 0; b < D; b++) {
                    low[b][a] = splat<Lanes>(1e300);
                    high[b][a] = splat<Lanes>(-1e300);
                }
                auto widen = [&](int b, Lanes v) INLINE_LAMBDA {
                    low[b][a] = least(low[b][a], v);
                    high[b][a] = most(high[b][a], v);
                };
                Lanes w[DEEP][N][N];
                for (int j = 0; j < DEEP; j++)
                    for (int m = 0; m < N; m++) {
                        const double* row = of(y - LEFT + m, j, a) + x - LEFT;
                        for (int i = 0; i < N; i++) {
                            w[j][m][i] = loaded(row + i);
                            if (i > 0) widen(0, w[j][m][i] - w[j][m][i - 1]);
                            if (m > 0) widen(1, w[j][m][i] - w[j][m - 1][i]);
                            if (j > 0) widen(D - 1, w[j][m][i] - w[j - 1][m][i]);
                        }
                    }
                low[a][a] += 1.0;
                high[a][a] += 1.0;
            }
            const Mask all = surely_above_0<D, Lanes>(low, high);
            for (int l = 0; l < LANES; l++) sure[x + l] = all[l] != 0;
        }
        std::fill(sure.begin() + n - N + LEFT + 1, sure.end(), 0);
        return sure;
    }

private:
    static constexpr int DEEP = D == 3 ? N : 1, LEFT = N / 2 - 1;
    const Sampled& k;
    const int n, padded;
    int at_z = -1, next_y = 0;  // the plane, and the row after the last that is held
    std::vector<double> held;   // [y, as a ring][z][component][x]
    std::vector<char> sure;

    double* of(int y, int j, int a) { return &held[(((size_t)(y % N) * DEEP + j) * D + a) * padded]; }
    template <class T>
    void read(int y, int z) {
        for (int j = 0; j < DEEP; j++) {
            size_t row = D == 3 ? z - LEFT + j : 0;
            const T* from = (const T*)k.values + (row * k.size[1] + y) * n * D;
            for (int a = 0; a < D; a++) {
                double* to = of(y, j, a);
                if (k.diagonal)
                    for (int x = 0; x < n; x++) to[x] = k.vectors[a][a] * from[x * D + a];
                else
                    for (int x = 0; x < n; x++) {
                        double w = 0;
                        for (int c = 0; c < D; c++) w += k.vectors[a][c] * from[x * D + c];
                        to[x] = w;
                    }
            }
        }
    }
    void load(int y, int z) { k.wide ? read<double>(y, z) : read<float>(y, z); }
};

// Visit the cells of a field in which it may fold: visit(cell, patch), with those beyond its ends if `ends`.
template <int D, int N>
void each_bad_cell(const Sampled& k, bool ends, const std::function<void(const int* at, const Patch<D, N>&)>& visit) {
    constexpr int BLOCK = 16;  // lines
    int from[3] = {0, 0, 0}, to[3] = {1, 1, 1};
    for (int d = 0; d < D; d++) {
        from[d] = (int)k.first[d] - ends;
        to[d] = std::max((int)k.last[d], (int)k.first[d] + (k.size[d] == 1)) + ends;
    }
    const int blocks = (to[1] - from[1] + BLOCK - 1) / BLOCK;
    parallel(blocks * (to[2] - from[2]), [&](int item, int) {
        Lines<D, N> lines(k);
        int at[3] = {0, from[1] + item % blocks * BLOCK, from[2] + item / blocks};
        for (int end = std::min(at[1] + BLOCK, to[1]); at[1] < end; at[1]++) {
            const std::vector<char>& sure = lines.upright(at[1], at[2]);
            for (at[0] = from[0]; at[0] < to[0]; at[0]++) {
                if (at[0] >= 0 && at[0] < k.size[0] && sure[at[0]]) continue;
                Patch<D, N> p = patch_of<D, N>(k, at);
                if (!surely_upright(p)) visit(at, p);
            }
        }
    });
}

}  // namespace supple
