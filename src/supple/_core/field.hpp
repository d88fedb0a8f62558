// Displacement fields that are sampled on a grid: values, derivatives and the inverse.
//
// With i the index of a position x, i = A x + b, a field maps x to x' by i' = i + w(i), where w is interpolated between
// the samples: linearly, or by a cubic B-spline. All of this file is in indices, in which cells are unit cubes.
#pragma once
#include "stroke.hpp"

namespace supple {

struct Sampled {
    const void* values;  // (…, y, x, D), contiguous
    bool wide;           // float64, and not float32
    int order;           // 1: linear; 3: the values are coefficients of a cubic B-spline
    int size[3];         // samples along x, y, z
    // The indices between which w is interpolated; beyond, it is that of the nearest one.
    double first[3], last[3];
    bool zero;              // beyond the grid, there is no displacement
    double margin;          // by which the grid extends beyond `first` and `last`
    double to_index[3][4];  // A and b
    double to_place[3][4];  // the same of its inverse
    double vectors[3][3];   // from a value to a displacement of the index
    bool diagonal;          // whether `vectors` is diagonal
};

// w at an index, its derivatives dw[b][a] = ∂w_a/∂i_b, and its second derivative along two directions.
template <int D, class V>
struct Local {
    V w[D], dw[D][D], second[D];
};

// The index of a sample; beyond the ends of an axis, mirrored about the outermost sample.
inline int mirrored(int k, int n) {
    if (n == 1) return 0;
    while (k < 0 || k >= n) k = k < 0 ? -k : 2 * (n - 1) - k;
    return k;
}

template <int D, int TAPS, int ORDER, class T, class V>
INLINE void sum_samples(const Sampled& k, const V* i, const V* a, const V* b, Local<D, V>& found) {
    constexpr int N = Masked<V>::lanes, LEFT = TAPS / 2 - 1;
    V weight[3][3][TAPS], inside[D];
    ptrdiff_t at[D][TAPS][N], stride = D;  // offsets of samples
    for (int d = 0; d < D; d++) {
        V c = least(most(i[d], splat<V>(k.first[d])), splat<V>(k.last[d])), f{};
        inside[d] = choose(c == i[d], splat<V>(1.0), V{});
        for (int l = 0; l < N; l++) {
            int whole = (int)lane(c, l);  // not below 0
            if (TAPS == 2 && whole > k.size[d] - 2) whole = k.size[d] - 2 > 0 ? k.size[d] - 2 : 0;
            set_lane(f, l, lane(c, l) - whole);
            if (whole >= LEFT && whole + TAPS - LEFT <= k.size[d])
                for (int n = 0; n < TAPS; n++) at[d][n][l] = (whole - LEFT + n) * stride;
            else
                for (int n = 0; n < TAPS; n++) at[d][n][l] = mirrored(whole - LEFT + n, k.size[d]) * stride;
        }
        spline_weights<TAPS>(f, weight[d]);
        stride *= k.size[d];
    }
    auto rows = [&](int m, int j) INLINE_LAMBDA {
        Starts<const T*, N> from;
        for (int l = 0; l < N; l++) {
            from.of[l] = (const T*)k.values + at[1][j][l];
            if constexpr (D == 3) from.of[l] += at[2][m][l];
        }
        return [from, &at](int n, int d) INLINE_LAMBDA {
            V v{};
            for (int l = 0; l < Masked<V>::lanes; l++) set_lane(v, l, from.of[l][at[0][n][l] + d]);
            return v;
        };
    };
    V sums[ORDER + 1][ORDER + 1][ORDER + 1][D] = {}, p[D], q[D], bent[D] = {};
    sum_taps<D, TAPS, ORDER, D>(weight, D == 3 ? TAPS : 1, rows, sums);
    for (int d = 0; ORDER > 1 && d < D; d++) {
        p[d] = inside[d] * a[d];
        q[d] = inside[d] * b[d];
    }
    for (int e = 0; ORDER > 1 && e < D; e++)
        for (int f = 0; f <= e; f++)
            for (int d = 0; d < D; d++) {
                const V second = sums[(e == 2) + (f == 2)][(e == 1) + (f == 1)][(e == 0) + (f == 0)][d];
                bent[d] += e == f ? second * p[e] * q[e] : second * (p[f] * q[e] + p[e] * q[f]);
            }
    for (int r = 0; r < D; r++) {
        found.w[r] = found.second[r] = V{};
        for (int e = 0; e < D; e++) found.dw[e][r] = V{};
        for (int d = 0; d < D; d++) {
            found.w[r] += k.vectors[r][d] * sums[0][0][0][d];
            for (int e = 0; ORDER > 0 && e < D; e++)
                found.dw[e][r] += k.vectors[r][d] * sums[e == 2][e == 1][e == 0][d] * inside[e];
            if (ORDER > 1) found.second[r] += k.vectors[r][d] * bent[d];
        }
    }
}

// w at an index, with ORDER derivatives; for ORDER 2, the second derivative along a and b.
template <int D, int ORDER, class V>
ONCE void sample_field(const Sampled& k, const V* i, const V* a, const V* b, Local<D, V>& found) {
    if (k.order == 1)
        k.wide ? sum_samples<D, 2, ORDER, double>(k, i, a, b, found)
               : sum_samples<D, 2, ORDER, float>(k, i, a, b, found);
    else
        k.wide ? sum_samples<D, 4, ORDER, double>(k, i, a, b, found)
               : sum_samples<D, 4, ORDER, float>(k, i, a, b, found);
}
template <int D, int ORDER, class V>
NOINLINE void field_at(const Sampled& k, const V* i, const V* a, const V* b, Local<D, V>& found) {
    sample_field<D, ORDER>(k, i, a, b, found);
}

// The mask of indices on the grid: of its outer faces, the lower ones belong to it, as in ITK.
template <int D, class V>
INLINE typename Masked<V>::type on_grid(const Sampled& k, const V* i) {
    typename Masked<V>::type in = i[0] == i[0];
    for (int d = 0; d < D; d++) in = both(in, both(i[d] >= k.first[d] - k.margin, i[d] < k.last[d] + k.margin));
    return in;
}

// A solution i of i + w(i) = target.
template <int D, class V>
struct Undone {
    V i[D];
    V m[D][D];      // the columns of (I + ∂w/∂i)⁻¹
    V determinant;  // of I + ∂w/∂i
    V step2;        // |m (i + w(i) - target)|²: the squared distance to the solution, to first order
    V steps;        // evaluations
    typename Masked<V>::type done;
};

template <class V>
INLINE V determinant_of(const V (*t)[2]) {
    return t[0][0] * t[1][1] - t[1][0] * t[0][1];
}
template <class V>
INLINE V determinant_of(const V (*t)[3]) {
    return t[0][0] * (t[1][1] * t[2][2] - t[1][2] * t[2][1]) - t[1][0] * (t[0][1] * t[2][2] - t[0][2] * t[2][1]) +
           t[2][0] * (t[0][1] * t[1][2] - t[0][2] * t[1][1]);
}

// Newton's method in the cells of a linear field, on the polynomial of the cell of the guess `found.i`, and of the
// cells that iterations enter: samples are read once for a cell. A solution inside its cell also solves the field, and
// is proved by Kantorovich's theorem; where there is none, `found` does not change.
//
// With FINISH, the last step is applied, and the residual after it is computed from the polynomial, without another
// evaluation; `found` then has no derivatives, but the determinant before the step.
template <int D, bool FINISH, class T, class V>
NOINLINE void undo_in_cells(const Sampled& k, const V* target, double tolerance, Undone<D, V>& found) {
    typedef typename Masked<V>::type M;
    constexpr int N = Masked<V>::lanes, CORNERS = 1 << D;
    V f[D], whole[D], c[CORNERS][D];  // c: coefficients of the monomials in x, y, z with bits set in the index
    M going = found.i[0] == found.i[0];
    for (int d = 0; d < D; d++) {
        V p = least(most(found.i[d], splat<V>(k.first[d])), splat<V>(k.last[d]));
        going = without(both(going, p == found.i[d]), splat<V>(k.size[d]) < 2.0);
        for (int l = 0; l < N; l++) set_lane(whole[d], l, most(0.0, least((double)(int)lane(p, l), k.size[d] - 2.0)));
        f[d] = p - whole[d];
    }
    V bend{};  // a bound of the second derivatives
    bool moved = true;
    for (int round = 0; round < 12 && any(without(going, found.done)); round++) {
        if (moved) {
            const T* start[N];
            ptrdiff_t stride[D];
            for (int l = 0; l < N; l++) start[l] = (const T*)k.values;
            ptrdiff_t next = D;
            for (int d = 0; d < D; d++) {
                for (int l = 0; l < N; l++) start[l] += (ptrdiff_t)lane(whole[d], l) * next;
                stride[d] = k.size[d] > 1 ? next : 0;
                next *= k.size[d];
            }
            for (int q = 0; q < CORNERS; q++) {
                ptrdiff_t offset = 0;
                for (int d = 0; d < D; d++) offset += q >> d & 1 ? stride[d] : 0;
                V raw[D];
                for (int d = 0; d < D; d++)
                    for (int l = 0; l < N; l++) set_lane(raw[d], l, start[l][offset + d]);
                for (int r = 0; r < D; r++) {
                    c[q][r] = k.vectors[r][r] * raw[r];
                    for (int d = 0; d < D && !k.diagonal; d++)
                        if (d != r) c[q][r] += k.vectors[r][d] * raw[d];
                }
            }
            for (int d = 0; d < D; d++)
                for (int q = 0; q < CORNERS; q++)
                    for (int r = 0; q >> d & 1 && r < D; r++) c[q][r] -= c[q - (1 << d)][r];
            bend = V{};
            for (int q = 3; q < CORNERS; q++)
                for (int r = 0; q != 4 && r < D; r++) bend += (q == 7 ? 6.0 : 2.0) * magnitude(c[q][r]);
            moved = false;
        }
        V e[D], t[D][D], m[D][D], step[D], d2{}, m2{};
        for (int r = 0; r < D; r++) {
            V a = c[0][r] + f[0] * c[1][r], b = c[2][r] + f[0] * c[3][r];
            V w = a + f[1] * b;
            t[0][r] = c[1][r] + f[1] * c[3][r];
            t[1][r] = b;
            if constexpr (D == 3) {
                V g = c[4][r] + f[0] * c[5][r], h = c[6][r] + f[0] * c[7][r];
                t[0][r] += f[2] * (c[5][r] + f[1] * c[7][r]);
                t[1][r] += f[2] * h;
                t[2][r] = g + f[1] * h;
                w += f[2] * t[2][r];
            }
            t[r][r] += 1.0;
            e[r] = f[r] + (whole[r] - target[r]) + w;
        }
        V determinant = determinant_of(t);
        invert(t, m);
        for (int d = 0; d < D; d++) {
            step[d] = -times<D>(m, e, d);
            d2 += step[d] * step[d];
            for (int j = 0; j < D; j++) m2 += m[j][d] * m[j][d];
        }
        V left2 = d2;  // the squared distance to the solution, to first order
        if constexpr (FINISH) {
            left2 = V{};
            V rest[D];
            for (int r = 0; r < D; r++) {
                if constexpr (D == 2) {
                    rest[r] = c[3][r] * (step[0] * step[1]);
                } else {
                    rest[r] = (c[3][r] + f[2] * c[7][r]) * (step[0] * step[1]) +
                              (c[5][r] + f[1] * c[7][r]) * (step[0] * step[2]) +
                              (c[6][r] + f[0] * c[7][r]) * (step[1] * step[2]) +
                              c[7][r] * (step[0] * step[1] * step[2]);
                }
            }
            for (int d = 0; d < D; d++) {
                V v = times<D>(m, rest, d);
                left2 += v * v;
            }
        }
        M active = without(going, found.done), out = d2 < 0.0;
        // By Kantorovich's theorem, there is a solution within 2 |step|, and no other near it.
        M hit = both(active, both(left2 <= tolerance * tolerance, 16.0 * bend * bend * m2 * d2 <= 1.0));
        found.steps += choose(active, splat<V>(1.0), V{});
        for (int d = 0; d < D; d++) {  // the solution must be within the faces of the cell
            V near = least(f[d], V(1.0 - f[d]));
            hit = both(hit, both(near >= 0.0, near * near >= 16.0 * d2));
        }
        for (int d = 0; d < D; d++) {
            found.i[d] = choose(hit, V(whole[d] + (FINISH ? f[d] + step[d] : f[d])), found.i[d]);
            for (int j = 0; j < D && !FINISH; j++) found.m[j][d] = choose(hit, m[j][d], found.m[j][d]);
        }
        found.determinant = choose(hit, determinant, found.determinant);
        found.step2 = choose(hit, left2, found.step2);
        found.done = either(found.done, hit);
        going = both(going, both(determinant > 1e-3, d2 <= 1.0));
        active = without(going, found.done);
        for (int d = 0; d < D; d++) {
            f[d] = choose(active, V(f[d] + step[d]), f[d]);
            out = either(out, both(active, either(f[d] < 0.0, f[d] > 1.0)));
        }
        if (!any(out)) continue;
        moved = true;
        for (int d = 0; d < D; d++) {
            V p = whole[d] + f[d], to = whole[d];
            going = without(going, both(out, either(p<k.first[d], p> k.last[d])));
            for (int l = 0; l < N; l++)
                if (lane(out, l) && lane(going, l)) set_lane(to, l, least(floored(lane(p, l)), k.size[d] - 2.0));
            f[d] = f[d] - (to - whole[d]);
            whole[d] = to;
        }
    }
}

// Newton's method with backtracking from the guess `found.i`, until the distance to the solution is below `tolerance`.
// Beyond the grid, w is continued by that at its edge.
template <int D, class V>
NOINLINE void undo_field(const Sampled& k, const V* target, double tolerance, int limit, Undone<D, V>& found) {
    typedef typename Masked<V>::type M;
    V base[D], step[D], error = splat<V>(1e300), part = splat<V>(1.0);
    M done = found.done;
    for (int d = 0; d < D; d++) {
        base[d] = found.i[d];
        step[d] = V{};
    }
    found.step2 = choose(done, found.step2, splat<V>(1e300));
    for (int round = 0; round < limit; round++) {
        V tried[D], e[D], e2{};
        for (int d = 0; d < D; d++) tried[d] = base[d] + part * step[d];
        Local<D, V> at;
        sample_field<D, 1, V>(k, tried, nullptr, nullptr, at);
        found.steps += choose(done, V{}, splat<V>(1.0));
        for (int d = 0; d < D; d++) {
            e[d] = tried[d] + at.w[d] - target[d];
            e2 += e[d] * e[d];
            at.dw[d][d] += 1.0;
        }
        // Lanes that have given up do not change while others continue.
        M taken = without(both(e2 <= error * (1.0 - 1e-4 * part), part > 0x1p-12), done);
        V determinant = determinant_of(at.dw), m[D][D], d2{};
        invert(at.dw, m);
        V next[D];
        for (int d = 0; d < D; d++) {
            next[d] = -times<D>(m, e, d);
            d2 += next[d] * next[d];
        }
        // Steps are limited in length; where the field folds, or nearly does, they are the negative residual.
        M upright = determinant > 1e-3;
        V far2 = most(V(16.0 * e2), splat<V>(1.0)), shrink = choose(d2 > far2, V(root(V(far2 / d2))), splat<V>(1.0));
        for (int d = 0; d < D; d++) next[d] = choose(upright, V(shrink * next[d]), V(-e[d]));
        for (int d = 0; d < D; d++) {
            base[d] = choose(taken, tried[d], base[d]);
            step[d] = choose(taken, next[d], step[d]);
            for (int j = 0; j < D; j++) found.m[j][d] = choose(taken, m[j][d], found.m[j][d]);
        }
        found.step2 = choose(taken, d2, found.step2);
        found.determinant = choose(taken, determinant, found.determinant);
        error = choose(taken, e2, error);
        part = choose(taken, splat<V>(1.0), V(0.5 * part));
        done = either(done, both(taken, both(d2 <= tolerance * tolerance, e2 <= 1e2 * tolerance * tolerance)));
        if (!any(without(part > 0x1p-12, done))) break;
    }
    for (int d = 0; d < D; d++) found.i[d] = base[d];
    found.done = done;
}

// Solve for one index by following the solution along the straight line from start + w(start) to the target.
template <int D>
NOINLINE bool follow_field(const Sampled& k, const double* target, const double* start, double tolerance,
                           Undone<D, double>& found) {
    Local<D, double> at;
    field_at<D, 0, double>(k, start, nullptr, nullptr, at);
    double from[D], here[D], way = 0, stride = 0.5;
    for (int d = 0; d < D; d++) {
        from[d] = start[d] + at.w[d];
        here[d] = start[d];
    }
    for (int tries = 0; way < 1 && stride > 1e-4 && tries < 200; tries++) {
        double next = least(1.0, way + stride), goal[D];
        Undone<D, double> got{};
        got.steps = found.steps;
        for (int d = 0; d < D; d++) {
            goal[d] = from[d] + next * (target[d] - from[d]);
            got.i[d] = here[d];
        }
        undo_field<D, double>(k, goal, tolerance, 12, got);
        found.steps = got.steps;
        stride *= got.done ? 2 : 0.5;
        if (!got.done) continue;
        for (int d = 0; d < D; d++) here[d] = got.i[d];
        way = next;
        if (way >= 1) found = got;
    }
    return way >= 1;
}

constexpr int RELAXED = 16, RETRIES = 8;

// Solve a batch, with other starts where Newton's method fails from the guess `found.i`. The tolerance within cells of
// a linear field is `in_cells`, as the distance to the solution is proved there; FINISH as in `undo_in_cells`.
template <int D, bool FINISH, class V>
INLINE void undo_field_surely(const Sampled& k, const V* target, double tolerance, double in_cells,
                              Undone<D, V>& found) {
    const auto all = splat<V>(0.0) <= 0.0;
    if (k.order == 1)
        k.wide ? undo_in_cells<D, FINISH, double, V>(k, target, in_cells, found)
               : undo_in_cells<D, FINISH, float, V>(k, target, in_cells, found);
    if (!any(without(all, found.done))) return;
    undo_field<D, V>(k, target, tolerance, 24, found);
    // Steps of half the residual cross folds, which stop Newton's method: take some, and try Newton's method again.
    for (int retry = 0; retry < RETRIES && any(without(all, found.done)); retry++) {
        V x[D];
        for (int d = 0; d < D; d++) x[d] = retry == 0 ? target[d] : found.i[d];
        for (int n = 0; n < RELAXED; n++) {
            Local<D, V> at;
            sample_field<D, 0, V>(k, x, nullptr, nullptr, at);
            for (int d = 0; d < D; d++) x[d] -= 0.5 * (x[d] + at.w[d] - target[d]);
        }
        for (int d = 0; d < D; d++) found.i[d] = choose(found.done, found.i[d], x[d]);
        found.steps += choose(found.done, V{}, splat<V>(RELAXED));
        undo_field<D, V>(k, target, tolerance, 12, found);
    }
    if (!any(without(all, found.done))) return;
    for (int l = 0; l < Masked<V>::lanes; l++) {
        if (lane(found.done, l)) continue;
        double goal[D], start[D];
        Undone<D, double> one{};
        Local<D, double> at;
        for (int d = 0; d < D; d++) start[d] = goal[d] = lane(target[d], l);
        bool known = follow_field<D>(k, goal, start, tolerance, one);
        if (!known) {
            field_at<D, 0, double>(k, goal, nullptr, nullptr, at);
            for (int d = 0; d < D; d++) start[d] = goal[d] - at.w[d];
            known = follow_field<D>(k, goal, start, tolerance, one);
        }
        set_lane(found.steps, l, lane(found.steps, l) + one.steps);
        if (!known) continue;
        for (int d = 0; d < D; d++) {
            set_lane(found.i[d], l, one.i[d]);
            for (int j = 0; j < D; j++) set_lane(found.m[j][d], l, one.m[j][d]);
        }
        set_lane(found.determinant, l, one.determinant);
        set_lane(found.step2, l, one.step2);
        set_lane(found.done, l, true);
    }
}

}  // namespace supple
