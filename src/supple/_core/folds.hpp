// Where a sampled field folds: the cells of its grid in which the determinant of I + ∂w/∂i may not be above 0, and the
// samples of another grid that folded parts may be mapped to.
//
// Within a cell, i + w(i) is a polynomial in Bézier form: of degree 1 or 3 along each axis. It lies in the hull of its
// control points, and its derivatives in that of their differences. So the determinant of a cell is bounded from below
// by the ranges of nine derivatives; if that does not suffice, in a linear cell, by the control points of the
// determinant itself; and at last, the cell is cut in halves.
#pragma once
#include <algorithm>
#include <functional>
#include <vector>

#include "field.hpp"
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

// Whether the determinant is proved to be above 0, by quick tests, for all matrices between low and high; [b][a].
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
    M dominant = mid[0][0] == mid[0][0];  // diagonal dominance, by rows: quick, and enough for fields that bend little
    for (int a = 0; a < D; a++) {
        V own = low[a][a];
        for (int b = 0; b < D; b++)
            if (b != a) own -= size[b][a] + off[b][a];
        dominant = both(dominant, own > 1e-9);
    }
    if (!any(without(mid[0][0] == mid[0][0], dominant))) return dominant;
    // The determinant is multilinear in its columns: bound every term with a deviation.
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

// The sign of the determinant of a linear patch, or 0 if the control points of the determinant, of degree D - 1 along
// each axis, differ in sign.
template <int D>
NOINLINE int sign_of_determinant(const Patch<D, 2>& p) {
    constexpr int SIDES = 1 << (D - 1), COUNT = D == 3 ? 27 : 4;
    double slope[D][SIDES][D];  // ∂/∂b at the corners of the other axes, which the bits of the index select
    for (int b = 0; b < D; b++)
        for (int side = 0; side < SIDES; side++) {
            const int below = side & ((1 << b) - 1), corner = below | (side - below) << 1;
            for (int a = 0; a < D; a++) slope[b][side][a] = p.c[a][corner | 1 << b] - p.c[a][corner];
        }
    double sum[COUNT] = {}, scale = 0;
    if constexpr (D == 2) {
        for (int n = 0; n < COUNT; n++) {
            const double *u = slope[0][n >> 1], *v = slope[1][n & 1];
            sum[n] = u[0] * v[1] - u[1] * v[0];
            scale = std::max(scale, fabs(u[0] * v[1]) + fabs(u[1] * v[0]));
        }
    } else {
        constexpr int PLACE[3] = {1, 3, 9};
        for (int i = 0; i < SIDES; i++)
            for (int j = 0; j < SIDES; j++) {
                const double *u = slope[0][i], *v = slope[1][j];
                const double w[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
                for (int k = 0; k < SIDES; k++) {
                    const double* t = slope[2][k];
                    // The bits along x are those of j and k, along y those of i and k, along z those of i and j.
                    const int x = (j & 1) + (k & 1), y = (i & 1) + (k >> 1), z = (i >> 1) + (j >> 1);
                    sum[x * PLACE[0] + y * PLACE[1] + z * PLACE[2]] += w[0] * t[0] + w[1] * t[1] + w[2] * t[2];
                    scale = std::max(scale, fabs(w[0] * t[0]) + fabs(w[1] * t[1]) + fabs(w[2] * t[2]));
                }
            }
    }
    double low = sum[0], high = sum[0];  // each sum is a control point times a weight of 1, 2, 4 or 8
    for (int n = 1; n < COUNT; n++) {
        low = std::min(low, sum[n]);
        high = std::max(high, sum[n]);
    }
    const double rounding = 1e-11 * (1.0 + scale);
    return low > rounding ? 1 : high < -rounding ? -1 : 0;
}

// The sign of the determinant of the derivatives in all of a patch, or 0 if it is not proved.
template <int D, int N>
NOINLINE int sign_of(const Patch<D, N>& p) {
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
    // All derivatives along an axis are differences of control points, times N - 1.
    if (surely_above_0<D, double>(low, high)) return 1;
    if constexpr (N == 2)
        return sign_of_determinant(p);
    else
        return 0;
}

// Whether the determinant of the derivatives is not above 0 at a corner of a patch: a quick test.
template <int D, int N>
NOINLINE bool turned_at_corner(const Patch<D, N>& p) {
    for (int which = 0; which < 1 << D; which++) {
        int corner = 0, step = 1;
        for (int b = 0; b < D; b++, step *= N) corner += which >> b & 1 ? (N - 1) * step : 0;
        double slope[D][D];
        step = 1;
        for (int b = 0; b < D; b++, step *= N)
            for (int a = 0; a < D; a++)
                slope[b][a] =
                    which >> b & 1 ? p.c[a][corner] - p.c[a][corner - step] : p.c[a][corner + step] - p.c[a][corner];
        if (!(determinant_of(slope) > 0)) return true;
    }
    return false;
}

// The control points of the 2^D parts of a patch that is halved along each axis; neighbours share points.
template <int D, int N>
struct Halves {
    static constexpr int SIDE = 2 * N - 1, COUNT = D == 3 ? SIDE * SIDE * SIDE : SIDE * SIDE;
    double c[D][COUNT];

    // `from` and `to` have whole lines along axes that are not halved yet, and SIDE points along the others.
    explicit Halves(const Patch<D, N>& p) {
        for (int a = 0; a < D; a++) {
            double held[2][COUNT];
            const double* from = p.c[a];
            for (int b = 0, inner = 1; b < D; b++, inner *= SIDE) {
                double* to = b == D - 1 ? c[a] : held[b];
                int outer = 1;
                for (int d = b + 1; d < D; d++) outer *= N;
                for (int o = 0; o < outer; o++)
                    for (int i = 0; i < inner; i++) {
                        double v[N];
                        for (int n = 0; n < N; n++) v[n] = from[(o * N + n) * inner + i];
                        double* line = to + o * SIDE * inner + i;
                        for (int r = 0; r < N; r++) {
                            line[r * inner] = v[0];
                            line[(SIDE - 1 - r) * inner] = v[N - 1 - r];
                            for (int n = 0; n < N - 1 - r; n++) v[n] = 0.5 * (v[n] + v[n + 1]);
                        }
                    }
                from = to;
            }
        }
    }

    // The index of control point n of a part.
    static constexpr int place(int which, int n) {
        int at = 0;
        for (int b = 0, side = 1; b < D; b++, side *= SIDE, n /= N) at += (n % N + (which >> b & 1) * (N - 1)) * side;
        return at;
    }
    Patch<D, N> part(int which) const {
        Patch<D, N> p;
        for (int a = 0; a < D; a++)
            for (int n = 0; n < Patch<D, N>::COUNT; n++) p.c[a][n] = c[a][place(which, n)];
        return p;
    }
};

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
                // Beyond the ends, and along an axis of one sample, everything is constant.
                if (before)
                    for (int i = 1; i < N; i++) v[i * step] = v[0];
                else if (after && k.size[b] > 1)
                    for (int i = 0; i < N; i++) v[i * step] = v[(N - 1) * step];
            });
        for (int n = 0; n < Patch<D, N>::COUNT; n++) p.c[b][n] += at[b] + (double)(n / step % N) / (N - 1);
    }
    return p;
}

constexpr int CUTS = 3;       // the largest number of times that a cell is halved
constexpr double FINE = 0.5;  // samples: a part with a smaller extent is not halved

// The range of samples of another grid that a part of a folded cell may be mapped to; and the extent of its image.
template <int D>
struct Spot {
    int low[D], high[D];
    double extent;
};

// Call mark(spot) for the samples, on a grid of a size, that folded parts may be mapped to; `out` is the affine map to
// that grid. all(spot) says whether all of a spot is marked already.
template <int D, int N, class All, class Mark>
class Folds {
public:
    Folds(const double (*out)[4], const int* size, All all, Mark mark) : out(out), size(size), all(all), mark(mark) {}

    // Mark the images of a patch that is not proved upright; `turned`: it is proved to be reversed. Cells beyond the
    // ends of the field are continued without limit.
    void find(const Patch<D, N>& p, bool turned, const bool* low_end, const bool* high_end) {
        this->low_end = low_end;
        this->high_end = high_end;
        double q[D][Patch<D, N>::COUNT];
        for (int n = 0; n < Patch<D, N>::COUNT; n++) send(p.c, n, q);
        Spot<D> spot;
        if (!spot_of(q, [](int n) { return n; }, spot)) return;
        spot.extent <= FINE ? mark(spot) : cut(p, turned, 1);
    }

private:
    static constexpr double CONTINUED = 1e9;
    const double (*out)[4];
    const int* size;
    All all;
    Mark mark;
    const bool *low_end, *high_end;

    template <int COUNT>
    INLINE void send(const double (&c)[D][COUNT], int n, double (&q)[D][COUNT]) const {
        for (int a = 0; a < D; a++) {
            q[a][n] = out[a][3];
            for (int b = 0; b < D; b++) q[a][n] += out[a][b] * c[b][n];
        }
    }

    // Whether the hull of some points has samples that are still to be marked.
    template <int COUNT, class Place>
    INLINE bool spot_of(const double (&q)[D][COUNT], Place place, Spot<D>& spot) const {
        spot.extent = 0;
        for (int a = 0; a < D; a++) {
            double low = q[a][place(0)], high = low;
            for (int n = 1; n < Patch<D, N>::COUNT; n++) {
                low = std::min(low, q[a][place(n)]);
                high = std::max(high, q[a][place(n)]);
            }
            spot.extent = std::max(spot.extent, high - low);
            for (int b = 0; b < D; b++)
                if (low_end[b] || high_end[b]) {
                    const double way = out[a][b] * CONTINUED * (low_end[b] ? -1 : 1);
                    low = std::min(low, low + way);
                    high = std::max(high, high + way);
                }
            spot.low[a] = (int)std::clamp(ceil(low - 1e-6), 0.0, (double)size[a]);
            spot.high[a] = (int)std::clamp(floor(high + 1e-6) + 1, 0.0, (double)size[a]);
            if (spot.low[a] >= spot.high[a]) return false;  // between samples, or outside of the grid
        }
        return !all(spot);
    }

    void cut(const Patch<D, N>& p, bool turned, int cuts) {
        const Halves<D, N> halves(p);
        double q[D][Halves<D, N>::COUNT];
        for (int n = 0; n < Halves<D, N>::COUNT; n++) send(halves.c, n, q);
        for (int which = 0; which < 1 << D; which++) {
            Spot<D> spot;
            if (!spot_of(q, [which](int n) INLINE_LAMBDA { return Halves<D, N>::place(which, n); }, spot)) continue;
            const Patch<D, N> part = halves.part(which);
            const int sign = turned ? -1 : sign_of(part);
            if (sign > 0) continue;
            cuts == CUTS || spot.extent <= FINE ? mark(spot) : cut(part, sign < 0, cuts + 1);
        }
    }
};

// Cached rows of w around a line of cells, reused as y grows, by which most cells are proved not to fold.
template <int D, int N>
class Lines {
public:
    explicit Lines(const Sampled& k)
        : k(k), n(k.size[0]), padded(n + LANES + N), held((size_t)N * DEEP * D * padded), sure(padded) {}

    // For each cell of a line, whether the map is proved upright in all of it: its derivatives are within the range of
    // the differences of the samples around. Not for cells that depend on samples beyond an end.
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
    int at_z = -1, next_y = 0;  // the plane, and the row after the last cached one
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

// Call visit(cell, patch, reversed) for the cells of a field in which it may fold; `reversed`: all of the cell is
// proved to be. With `ends`, include the cells beyond its ends.
template <int D, int N>
void each_bad_cell(const Sampled& k, bool ends,
                   const std::function<void(const int* at, const Patch<D, N>&, bool turned)>& visit) {
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
                const int sign = sign_of(p);
                if (sign <= 0) visit(at, p, sign < 0);
            }
        }
    });
}

}  // namespace supple
