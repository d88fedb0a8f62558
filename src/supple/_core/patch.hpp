// Bicubic patches: T⁻¹ between four nodes, and their errors.
//
// A node has p = T⁻¹(q), the columns of ∂p/∂q and the twist ∂²p/∂x∂y: all that a bicubic Hermite patch needs. A patch
// is checked at nine points: |M (T(p) - q)| is the distance to T⁻¹(q). All lengths are in pixels.
//
// It uses no std::, allocation or exceptions, so that compilers for GPUs accept this file.
#pragma once
#include "composite.hpp"

namespace supple {

// A node of a lattice: T⁻¹ and its derivatives.
template <int D>
struct Node {
    double p[D], m[D][D], mixed[D];
    double smooth[2];  // the length scale of the map along x and y
};

constexpr double RESERVE = 1.75;   // the safety factor for the largest error of a cell, which nine points may miss,
constexpr double ROUGH = 2.5;      // and for splines, whose derivatives jump
constexpr double COARSEST = 0.25;  // the largest tolerance: beyond, the slopes of a patch bound the distance less well
constexpr double RESOLVED = 0.5;   // of the map's length scale: the longest side for which nine points suffice
constexpr double FAR = 4096;       // pixels: the largest distance of a source point that could not be solved
constexpr int SEEN = 9;            // checked points of a cell; the second to the fifth are the centres of its sides
// clang-format off
constexpr double SEEN_X[SEEN] = {.5, .5, .5, 0,  1,  .25, .75, .25, .75};
constexpr double SEEN_Y[SEEN] = {.5, 0,  1,  .5, .5, .25, .25, .75, .75};
// clang-format on

// The powers of the cubic with the values v0, v1 and the slopes d0, d1 at the ends of [0, 1/inverse].
template <class V>
INLINE void hermite(V v0, V d0, V v1, V d1, V inverse, V* c) {
    V rise = (v1 - v0) * inverse;
    c[0] = v0;
    c[1] = d0;
    c[2] = (3 * rise - 2 * d0 - d1) * inverse;
    c[3] = (d0 + d1 - 2 * rise) * inverse * inverse;
}

// The patch Σ c[4j + i] sⁱ tʲ of one coordinate, from its values, derivatives along x and y, and twists at the corners
// (upper left and right, lower left and right).
template <class V>
INLINE void patch_of(const V* value, const V* along_x, const V* along_y, const V* twist, V per_width, V per_height,
                     V* c) {
    V left[4], left_x[4], right[4], right_x[4];
    hermite(value[0], along_y[0], value[2], along_y[2], per_height, left);
    hermite(along_x[0], twist[0], along_x[2], twist[2], per_height, left_x);
    hermite(value[1], along_y[1], value[3], along_y[3], per_height, right);
    hermite(along_x[1], twist[1], along_x[3], twist[3], per_height, right_x);
    for (int j = 0; j < 4; j++) hermite(left[j], left_x[j], right[j], right_x[j], per_width, c + 4 * j);
}

// The value of a patch at (s, t), and its slopes.
template <class V>
INLINE V at(const V* c, V s, V t, V& ds, V& dt) {
    V r[4], rt[4];
    for (int i = 0; i < 4; i++) {
        const V* b = c + i;
        r[i] = b[0] + t * (b[4] + t * (b[8] + t * b[12]));
        rt[i] = b[4] + t * (2 * b[8] + 3 * t * b[12]);
    }
    ds = r[1] + s * (2 * r[2] + 3 * s * r[3]);
    dt = rt[0] + s * (rt[1] + s * (rt[2] + s * rt[3]));
    return r[0] + s * (r[1] + s * (r[2] + s * r[3]));
}

// The Newton step from the point of a patch at (s, t) to T⁻¹(q) of a chain; returns its squared length. q is in pixels,
// and `across_plane` the mean ∂p/∂z of the corners. With D TANGENTS, the longer one of that by the slopes of the patch
// and that by the Jacobian of T: they are far from each other where T⁻¹ is steep at once.
template <int D, int TANGENTS, class V>
INLINE V off_chain(const Chain& chain, const Axis* axes, const V (*c)[16], V s, V t, const V* q, const V* across_plane,
                   V* step) {
    V x[D], ds[D], dt[D], e[D], off2{};
    for (int d = 0; d < D; d++) x[d] = at(c[d], s, t, ds[d], dt[d]) * axes[d].spacing;
    auto jet = jet_at<D, TANGENTS>(x);
    carry(chain, axes, jet);
    for (int d = 0; d < D; d++) e[d] = jet.x[d] / axes[d].spacing - q[d];
    for (int d = 0; d < D; d++) {
        step[d] = ds[d] * e[0] + dt[d] * e[1];
        if constexpr (D == 3) step[d] += across_plane[d] * e[2];
        off2 += step[d] * step[d];
    }
    if constexpr (TANGENTS > 0) {
        V m[D][D], newton2{};
        invert(jet.t, m);
        for (int d = 0; d < D; d++) e[d] *= axes[d].spacing;
        for (int d = 0; d < D; d++) {
            const V newton = times<D>(m, e, d) / axes[d].spacing;
            newton2 += newton * newton;
        }
        off2 = most(off2, newton2);
    }
    return off2;
}
// The step for a composite, from its solution at q.
template <int D, class V>
INLINE V off_composite(const Composite& map, const Axis* axes, const V (*c)[16], V s, V t, const V* q, V* step,
                       V& steps) {
    V ds[D], dt[D], off2{};
    Jet<D, 0, false, V> jet;
    for (int d = 0; d < D; d++) jet.x[d] = q[d] * axes[d].spacing;
    steps += pass<D>(map, true, jet).steps;
    for (int d = 0; d < D; d++) {
        step[d] = at(c[d], s, t, ds[d], dt[d]) - jet.x[d] / axes[d].spacing;
        off2 += step[d] * step[d];
    }
    return off2;
}

// A patch in float32: for each coordinate d, the whole number `anchor[d]` plus the powers c[d].
template <int D>
struct Leaf {
    int x, y, w, h;
    int anchor[D];
    float c[D][16];
    float depth[4];  // ∂p_z/∂z = depth[0] + depth[1] s + depth[2] t + depth[3] st
};

INLINE double within(double x, double low, double high) { return least(most(x, low), high); }

// Round a patch to float32. Returns the largest rounding error at the corners other than the first, where steep powers
// cancel; the last corner is at (w, h).
template <int D>
INLINE double round_patch(const double (*c)[16], double w, double h, Leaf<D>& leaf) {
    double worst = 0;
    for (int d = 0; d < D; d++) {
        leaf.anchor[d] = (int)within(floored(c[d][0]), -1e9, 1e9);
        double down = 3e7;  // limits: no sum overflows, and samples so far away are beyond any edge
        for (int j = 0; j < 4; j++, down /= h + 2) {
            double limit = down;
            for (int i = 4 * j; i < 4 * j + 4; i++, limit /= w + 2)
                leaf.c[d][i] = (float)within(c[d][i] - (i ? 0 : leaf.anchor[d]), -limit, limit);
        }
        for (int n = 1; n < 4; n++) {
            double s = n & 1 ? w : 0, t = n & 2 ? h : 0, ds, dt;
            float fs, ft;
            double off = leaf.anchor[d] + (double)at(leaf.c[d], (float)s, (float)t, fs, ft) - at(c[d], s, t, ds, dt);
            worst = most(worst, magnitude(off));
        }
    }
    return worst;
}

// The coefficients of the bilinear interpolant of values v at the corners of a cell w wide and h high.
INLINE void bilinear_of(const double* v, double w, double h, float* depth) {
    depth[0] = (float)v[0];
    depth[1] = (float)((v[1] - v[0]) / w);
    depth[2] = (float)((v[2] - v[0]) / h);
    depth[3] = (float)((v[3] - v[2] - v[1] + v[0]) / (w * h));
}

}  // namespace supple
