// T⁻¹ in a volume: solved at the nodes of a cubic lattice, interpolated in between, and certified.
//
// A node knows the displacement u = T⁻¹(q) - q and, exactly, the matrix M = ∂p/∂q, all in voxels. Along each axis, at
// a part s of the way h from a node to the next, the line between their values is off by ½ s (1 - s) h (u'₀ - u'₁), up
// to the third order: so only the nodes of a cell are read, and the error falls with h³ at least.
#pragma once
#include "solvers.hpp"
#include "table.hpp"
#include "voxels.hpp"

namespace supple {

constexpr double SOLVED = 0.02;  // the last Newton step but one at a node, in voxels
constexpr double CHECKED = 2.0;  // the ratio of the error to the largest observed one

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

    // True if x lies in any stroke's ball; elsewhere T(x) = x. With a fixed border, x is the nearest point of the
    // domain.
    template <class V>
    INLINE bool reaches(const V* x) const {
        for (const Stroke& k : strokes) {
            V s = V{};
            for (int i = 0; i < 3; i++) {
                V near = x[i];
                if (axes[i].fixed()) near = nearest(near, axes[i]);
                s += (near - k.pivot[i]) * (near - k.pivot[i]);
            }
            if (k.per_reach == 0 || any(s < k.reach * k.reach)) return true;
        }
        return false;
    }

    // T⁻¹ of q from the guess in `found.p`; without it, if it was not good enough for all lanes.
    template <class V>
    INLINE void settle(const V* q, double tolerance, Solution<3, V>& found) const {
        if (!reaches(q)) {
            for (int i = 0; i < 3; i++) {
                found.p[i] = q[i];
                for (int j = 0; j < 3; j++) found.m[j][i] = splat<V>(i == j);
            }
            return;
        }
        newton<3>(chain(), axes.data(), q, tolerance, 10, found);
        if (!any(without(splat<V>(0.0) <= 0.0, found.done))) return;
        V before = found.steps;
        undo<3>(chain(), axes.data(), q, tolerance, found);
        found.steps += before;
    }
};

// The values at a node, or between nodes: u and the columns of M, each padded with a 0.
struct Place {
    Float4 u, m[3];
};
constexpr int NODE = sizeof(Place) / sizeof(float);

// Equivalent wide vectors: u beside ∂p/∂x, and ∂p/∂y beside ∂p/∂z.
typedef float Float8 __attribute__((vector_size(32)));
struct Wide {
    Float8 a, b;
    INLINE static Wide load(const float* at) {
        typedef float Anywhere __attribute__((vector_size(32), aligned(4), may_alias));
        return {*(const Anywhere*)at, *(const Anywhere*)(at + 8)};
    }
};
template <int K>
INLINE Float4 half(Float8 x) {
    return __builtin_shufflevector(x, x, 4 * K, 4 * K + 1, 4 * K + 2, 4 * K + 3);
}

// At `part` of the way h along an axis from x to y.
template <int AXIS>
INLINE Wide bend(float part, float h, Wide x, Wide y) {
    Float8 da = y.a - x.a, db = y.b - x.b, none{}, turn;  // the change of the slope along the axis, beside zeros
    if constexpr (AXIS == 1)
        turn = __builtin_shufflevector(db, none, 0, 1, 2, 3, 8, 9, 10, 11);
    else
        turn = __builtin_shufflevector(AXIS == 0 ? da : db, none, 4, 5, 6, 7, 8, 9, 10, 11);
    return {x.a + part * da - (0.5f * part * (1 - part) * h) * turn, x.b + part * db};
}

struct Lattice {
    float* nodes;
    int64_t nx, ny, nz;
    int step;  // voxels from node to node

    float* node(int64_t k, int64_t j, int64_t i) const { return nodes + ((k * ny + j) * nx + i) * NODE; }

    // Interpolate at q, given in voxels.
    INLINE Place at(Float4 q) const {
        const float h = (float)step;
        Int4 last = {int32_t(nx - 2), int32_t(ny - 2), int32_t(nz - 2), 0};
        q = least(most(q * (1 / h), Float4{}), floats(last + 1));
        Int4 cell = least(whole(q), last);
        Float4 part = q - floats(cell);
        const float* first = node(cell[2], cell[1], cell[0]);
        const int64_t row = nx * NODE, layer = ny * row;
        Wide c[4];
        for (int n = 0; n < 4; n++) {
            const float* at = first + (n & 1) * row + (n >> 1) * layer;
            c[n] = bend<0>(part[0], h, Wide::load(at), Wide::load(at + NODE));
        }
        for (int n = 0; n < 2; n++) c[n] = bend<1>(part[1], h, c[2 * n], c[2 * n + 1]);
        c[0] = bend<2>(part[2], h, c[0], c[1]);
        return {half<0>(c[0].a), {half<1>(c[0].a), half<0>(c[0].b), half<1>(c[0].b)}};
    }

    // Solve the nodes of a layer, each row from the one before. Returns the evaluations of T, and the length scale of
    // the map, in voxels. (Slices may be thicker than that scale; across them, only the observed error counts.)
    std::array<double, 2> solve(const Strokes& s, int64_t k) const {
        double steps = 0;
        Lanes shortest = splat<Lanes>(1e300);
        std::vector<Solution<3, Lanes>> last(nx), before(nx);  // of two rows
        for (int64_t j = 0; j < ny; j++, std::swap(last, before))
            for (int64_t i = 0, e = 0; i < nx; i += LANES, e++) {
                Lanes q[3] = {Lanes{}, splat<Lanes>(j * step * s.axes[1].spacing),
                              splat<Lanes>(k * step * s.axes[2].spacing)};
                for (int l = 0; l < LANES; l++) q[0][l] = least(i + l, nx - 1) * step * s.axes[0].spacing;
                Solution<3, Lanes> found{};
                for (int c = 0; c < 3; c++) {
                    // Extrapolate along the slope ∂p/∂y, and its change since the row before.
                    Lanes slope = splat<Lanes>(c == 1);
                    if (j > 0) slope = before[e].m[1][c];
                    if (j > 1) slope += 0.5 * (slope - last[e].m[1][c]);
                    found.p[c] = j == 0 ? q[c] : Lanes(before[e].p[c] + step * s.axes[1].spacing * slope);
                }
                s.settle(q, SOLVED * s.finest(), found);
                Lanes mixed[3], smooth2[2];
                polish<3>(s.chain(), s.axes.data(), q, SOLVED * s.finest(), found, mixed, smooth2);
                for (int d = 0; d < 2; d++) {
                    double spacing = s.axes[d].spacing;
                    shortest = least(shortest, Lanes(smooth2[d] * (1 / (spacing * spacing))));
                }
                for (int l = 0; l < LANES && i + l < nx; l++) {
                    if (found.steps[l] > 1) steps += found.steps[l];  // except where no stroke reaches
                    write(s, q, found, l, node(k, j, i + l));
                }
                last[e] = found;
            }
        double smooth = 1e300;
        for (int l = 0; l < LANES; l++) smooth = least(smooth, double(shortest[l]));
        return {steps, root(smooth)};
    }

    // The largest observed error, in voxels, in a layer of cells: |M (T(p) - q)| at fifteen points of each.
    double error(const Strokes& s, int64_t k) const {
        // The middle of the cell, of its faces and edges at one corner, and of its eighths.
        static const float seen[16][3] = {{.5, .5, .5},    {.5, .5, 0},     {.5, 0, .5},     {.5, 0, 0},
                                          {0, .5, .5},     {0, .5, 0},      {0, 0, .5},      {.5, .5, .5},
                                          {.25, .25, .25}, {.25, .25, .75}, {.25, .75, .25}, {.25, .75, .75},
                                          {.75, .25, .25}, {.75, .25, .75}, {.75, .75, .25}, {.75, .75, .75}};
        Lanes worst{};
        for (int64_t j = 0; j + 1 < ny; j++)
            for (int64_t i = 0; i + 1 < nx; i++) {
                Float4 corner = {float(i), float(j), float(k), 0};
                const Place middle = at((corner + 0.5f) * float(step));
                for (int first = 0; first < 16; first += LANES) {
                    Lanes q[3], x[3], off2{};
                    for (int l = 0; l < LANES; l++) {
                        const float* part = seen[first + l];
                        Float4 point = (corner + Float4{part[0], part[1], part[2], 0}) * float(step), u = at(point).u;
                        for (int c = 0; c < 3; c++) {
                            q[c][l] = point[c];
                            x[c][l] = (point[c] + double(u[c])) * s.axes[c].spacing;
                        }
                    }
                    apply<3>(s.chain(), s.axes.data(), x);
                    for (int c = 0; c < 3; c++) {
                        Lanes off{};
                        for (int d = 0; d < 3; d++) off += double(middle.m[d][c]) * (x[d] / s.axes[d].spacing - q[d]);
                        off2 += off * off;
                    }
                    worst = most(worst, off2);
                }
            }
        double largest = 0;
        for (int l = 0; l < LANES; l++) largest = most(largest, double(worst[l]));
        return CHECKED * root(largest);
    }

private:
    // One lane's u and M, in voxels.
    static void write(const Strokes& s, const Lanes* q, const Solution<3, Lanes>& found, int l, float* out) {
        Place place{};
        for (int c = 0; c < 3; c++) {
            double over = 1.0 / s.axes[c].spacing;
            place.u[c] = float((found.p[c][l] - q[c][l]) * over);
            for (int d = 0; d < 3; d++) place.m[d][c] = float(found.m[d][c][l] * s.axes[d].spacing * over);
        }
        memcpy(out, &place, sizeof place);
    }
};

}  // namespace supple
