// T⁻¹ in a volume: solved at the nodes of a cubic lattice, interpolated in between, and certified.
//
// A node knows the displacement u = T⁻¹(q) - q and, exactly, the matrix M = ∂p/∂q, all in voxels. Along each axis, at
// a part s of the way h from a node to the next, the line between their values is off by ½ s (1 - s) h (u'₀ - u'₁), up
// to the third order: so only the nodes of a cell are read, and the error falls with h³ at least.
#pragma once
#include <cmath>

#include "newton.hpp"
#include "table.hpp"
#include "voxels.hpp"

namespace supple {

constexpr int NODE = 16;         // floats: u and the columns of M, each followed by a 0
constexpr double SOLVED = 1e-3;  // the last Newton step at a node, in voxels
constexpr double CHECKED = 2.0;  // the error is this times the largest that is seen

// The strokes of a table, all of them, and the domain.
struct Strokes {
    Axes axes;
    std::vector<Stroke> strokes;
    std::vector<int> list;

    Strokes(const Axes& axes, std::vector<Stroke> table) : axes(axes), strokes(std::move(table)) {
        for (size_t i = 0; i < strokes.size(); i++) list.push_back((int)i);
    }
    Chain chain() const { return {strokes.data(), list.data(), (int)list.size()}; }
    double finest() const { return least(axes[0].spacing, least(axes[1].spacing, axes[2].spacing)); }
    double coarsest() const { return most(axes[0].spacing, most(axes[1].spacing, axes[2].spacing)); }

    // |r|² of a stroke at x, which counts as the nearest point of the domain where a border is fixed.
    template <class V>
    INLINE V distance2(const Stroke& k, const V* x) const {
        V s = V{};
        for (int i = 0; i < 3; i++) {
            V near = x[i];
            if (axes[i].fixed()) near = least(most(near, V{}), splat<V>(axes[i].extent));
            s += (near - k.pivot[i]) * (near - k.pivot[i]);
        }
        return s;
    }
    // Does x lie in any stroke's ball? Elsewhere T(x) = x.
    template <class V>
    INLINE bool reaches(const V* x) const {
        for (const Stroke& k : strokes)
            if (k.per_reach == 0 || any(distance2(k, x) < k.reach * k.reach)) return true;
        return false;
    }
};

// T⁻¹ of q from the guess in `found.p`; without it, where it was not good enough for all lanes. Outside every ball, q
// is its own source.
template <class V>
INLINE void settle(const Strokes& s, const V* q, double tolerance, Solution<3, V>& found) {
    if (!s.reaches(q)) {
        for (int i = 0; i < 3; i++) {
            found.p[i] = q[i];
            for (int j = 0; j < 3; j++) found.m[j][i] = splat<V>(i == j);
        }
        return;
    }
    newton<3>(s.chain(), s.axes.data(), q, tolerance, 10, found);
    auto all = splat<V>(0.0) <= 0.0;
    if (!any(without(all, found.done))) return;
    V before = found.steps;
    undo<3>(s.chain(), s.axes.data(), q, tolerance, found);
    found.steps += before;
}

// What a lattice knows at a point: u, and the columns of M.
struct Place {
    Float4 u, m[3];
};

struct Lattice {
    float* nodes;
    int64_t nx, ny, nz;
    int step;  // voxels from node to node

    float* node(int64_t k, int64_t j, int64_t i) const { return nodes + ((k * ny + j) * nx + i) * NODE; }

    // Interpolate at q, given in voxels.
    INLINE Place at(Float4 q) const {
        const float h = (float)step, over = 1.0f / h;
        Int4 last = {int32_t(nx - 2), int32_t(ny - 2), int32_t(nz - 2), 0};
        q = least(most(Float4(q * over), Float4{}), floats(last + 1));
        Int4 cell = whole(q);
        cell = cell < last ? cell : last;
        Float4 part = q - floats(cell), bend = (0.5f * h) * part * (1.0f - part);
        const float* first = node(cell[2], cell[1], cell[0]);
        Float8 a[8], b[8];  // u beside ∂p/∂x, and ∂p/∂y beside ∂p/∂z
        for (int k = 0; k < 8; k++) {
            const float* at = first + ((k >> 2) * ny * nx + (k >> 1 & 1) * nx + (k & 1)) * NODE;
            a[k] = load8(at);
            b[k] = load8(at + 8);
        }
        fold<0, 4>(part[0], bend[0], a, b);
        fold<1, 2>(part[1], bend[1], a, b);
        fold<2, 1>(part[2], bend[2], a, b);
        return {half<0>(a[0]), {half<1>(a[0]), half<0>(b[0]), half<1>(b[0])}};
    }

    // Solve the nodes of a layer, each row from the one before. Returns the evaluations of T, and the least length,
    // in voxels, over which the map varies.
    std::array<double, 2> solve(const Strokes& s, int64_t k) const {
        double steps = 0, smooth = 1e300;
        std::vector<Lanes> last(nx * 12), before(nx * 12);  // of two rows: u and M, in physical units
        for (int64_t j = 0; j < ny; j++, std::swap(last, before))
            for (int64_t i = 0, e = 0; i < nx; i += LANES, e += 12) {
                Lanes q[3] = {Lanes{}, splat<Lanes>(j * step * s.axes[1].spacing),
                              splat<Lanes>(k * step * s.axes[2].spacing)};
                for (int l = 0; l < LANES; l++) q[0][l] = least(i + l, nx - 1) * step * s.axes[0].spacing;
                Solution<3, Lanes> found{};
                const Lanes *up = &before[e], *older = &last[e];  // the two rows above
                for (int c = 0; c < 3; c++) {
                    found.p[c] = q[c];
                    if (j == 0) continue;
                    // Along the slope, and as it has changed since the row before that.
                    Lanes slope = up[6 + c] - double(c == 1);
                    if (j > 1) slope += 0.5 * (up[6 + c] - older[6 + c]);
                    found.p[c] += up[c] + step * s.axes[1].spacing * slope;
                }
                settle(s, q, SOLVED * s.finest(), found);
                smooth = least(smooth, smoothness(s, found));
                for (int c = 0; c < 3; c++) {
                    last[e + c] = found.p[c] - q[c];
                    for (int d = 0; d < 3; d++) last[e + 3 + 3 * d + c] = found.m[d][c];
                }
                for (int l = 0; l < LANES && i + l < nx; l++) {
                    steps += found.steps[l];
                    write(s, &last[e], l, node(k, j, i + l));
                }
            }
        return {steps, smooth};
    }

    // The worst error, in voxels, that is seen in a layer of cells: |M (T(p) - q)| at fifteen points of each.
    double error(const Strokes& s, int64_t k) const {
        // The middle of the cell, of its faces and edges at one corner, and of its eighths.
        static const float seen[16][3] = {{.5, .5, .5},    {.5, .5, 0},     {.5, 0, .5},     {.5, 0, 0},
                                          {0, .5, .5},     {0, .5, 0},      {0, 0, .5},      {.5, .5, .5},
                                          {.25, .25, .25}, {.25, .25, .75}, {.25, .75, .25}, {.25, .75, .75},
                                          {.75, .25, .25}, {.75, .25, .75}, {.75, .75, .25}, {.75, .75, .75}};
        Lanes worst{}, spacing[3];
        for (int c = 0; c < 3; c++) spacing[c] = splat<Lanes>(s.axes[c].spacing);
        for (int64_t j = 0; j + 1 < ny; j++)
            for (int64_t i = 0; i + 1 < nx; i++) {
                Float4 m[3];
                for (int f = 4; f < NODE; f += 4)
                    m[f / 4 - 1] = 0.5f * (load4(node(k, j, i) + f) + load4(node(k + 1, j + 1, i + 1) + f));
                for (int first = 0; first < 16; first += LANES) {
                    Lanes q[3], x[3], e[3];
                    for (int l = 0; l < LANES; l++) {
                        Float4 point{};
                        for (int c = 0; c < 3; c++)
                            point[c] = ((c == 0 ? i : c == 1 ? j : k) + seen[first + l][c]) * step;
                        Float4 u = at(point).u;
                        for (int c = 0; c < 3; c++) {
                            q[c][l] = point[c];
                            x[c][l] = u[c];
                        }
                    }
                    for (int c = 0; c < 3; c++) x[c] = (q[c] + x[c]) * spacing[c];
                    apply<3>(s.chain(), s.axes.data(), x);
                    for (int c = 0; c < 3; c++) e[c] = x[c] / spacing[c] - q[c];
                    Lanes e2{};
                    for (int c = 0; c < 3; c++) {
                        Lanes off = double(m[0][c]) * e[0] + double(m[1][c]) * e[1] + double(m[2][c]) * e[2];
                        e2 += off * off;
                    }
                    worst = most(worst, e2);
                }
            }
        double largest = 0;
        for (int l = 0; l < LANES; l++) largest = most(largest, double(worst[l]));
        return CHECKED * std::sqrt(largest);
    }

private:
    // Between neighbours along an axis: of 2 COUNT, COUNT are left.
    template <int AXIS, int COUNT>
    INLINE static void fold(float part, float bend, Float8* a, Float8* b) {
        for (int k = 0; k < COUNT; k++) {
            Float8 da = a[2 * k + 1] - a[2 * k], db = b[2 * k + 1] - b[2 * k], turn = AXIS == 0 ? da : db, none{};
            a[k] = a[2 * k] + part * da;
            b[k] = b[2 * k] + part * db;
            // The change of the slopes along the axis, beside zeros.
            if constexpr (AXIS == 1)
                turn = __builtin_shufflevector(turn, none, 0, 1, 2, 3, 8, 9, 10, 11);
            else
                turn = __builtin_shufflevector(turn, none, 4, 5, 6, 7, 8, 9, 10, 11);
            a[k] -= bend * turn;
        }
    }

    // How far, in voxels, the map stays as it is at p: a stroke varies over ρ, and its border over 2σ or twice the
    // distance to the face, seen through the derivatives of the stroke's input by x and y of q. (Slices may be thicker
    // than what the map varies over; across them, only the error that is seen counts.)
    static double smoothness(const Strokes& s, const Solution<3, Lanes>& found) {
        Jet<3, 3, false, Lanes> jet;
        Lanes shortest = splat<Lanes>(1e300);
        for (int i = 0; i < 3; i++) {
            jet.x[i] = found.p[i];
            for (int d = 0; d < 3; d++) jet.t[d][i] = found.m[d][i] * s.axes[d].spacing;
        }
        for (const Stroke& k : s.strokes) {
            Lanes longest{};
            for (int d = 0; d < 2; d++) longest = most(longest, dot<3>(jet.t[d], jet.t[d]));
            shortest = least(shortest, Lanes((s.distance2(k, jet.x) + k.radius2[0]) / longest));
            for (int i = 0; i < 3; i++) {
                const Axis& a = s.axes[i];
                if (!(a.sigma > 0) || k.inner) continue;
                Lanes along = magnitude(jet.t[0][i]);
                along = most(along, magnitude(jet.t[1][i]));
                Lanes way = 2.0 * most(splat<Lanes>(a.sigma), least(jet.x[i], Lanes(a.extent - jet.x[i])));
                shortest = least(shortest, Lanes(way * way / most(along * along, splat<Lanes>(1e-24))));
            }
            carry(k, s.axes.data(), jet);
        }
        double smooth = 1e300;
        for (int l = 0; l < LANES; l++) smooth = least(smooth, double(shortest[l]));
        return std::sqrt(smooth);
    }

    // One lane's u and M, in voxels.
    static void write(const Strokes& s, const Lanes* known, int l, float* out) {
        for (int c = 0; c < 3; c++) {
            double over = 1.0 / s.axes[c].spacing;
            out[c] = float(known[c][l] * over);
            for (int d = 0; d < 3; d++) out[4 + 4 * d + c] = float(known[3 + 3 * d + c][l] * s.axes[d].spacing * over);
        }
        for (int f = 3; f < NODE; f += 4) out[f] = 0;
    }
};

}  // namespace supple
