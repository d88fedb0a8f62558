// The kernels that solve T⁻¹: at the nodes of a lattice of small cells, in certified patches between them,
// and at each pixel of the rough cells, which are not split.
#pragma once
#include "job.hpp"

namespace supple::cuda {

constexpr float ROUNDING = 1.2e-7f;    // of float32, relative
constexpr double CLOSE_ENOUGH = 0.01;  // of the tolerance: the last step of a pixel that is solved

// Solve the node (k, j) of RUN<D> planes in order, each with a guess from the one before. Runs are aligned to all
// planes, so that no bit depends on the first plane of a launch; planes before that are solved, but not written.
template <int D>
INLINE void solve_node(const Job& job) {
    const int64_t i = thread(), each = (int64_t)job.nx * job.ny;
    if (i == 0) job.checks->rough = 0;  // for the next kernel to count
    const int first = (int)(i / each + job.first / RUN<D>)*RUN<D> - job.first;
    const int j = (int)(i % each / job.nx), k = (int)(i % job.nx);
    Solved<D, double> found{};
    double slope[D], bent[D] = {};  // along the planes, and how it changes from one to the next
    for (int plane = first; plane < job.planes && plane < first + RUN<D>; plane++) {
        const Map& map = map_of(job, plane);
        const double at[3] = {(double)job.xs[k], (double)job.ys[j], depth_of(job, plane)};
        double q[D];
        for (int d = 0; d < D; d++) q[d] = at[d] * map.axes[d].spacing;
        if (composed(map)) {
            if (plane < 0 || !map.composite->smooth) continue;  // otherwise, every pixel is solved
            const Passed<double> passed = solve_composite<D, true>(*map.composite, q, found);
            found.at.done = passed.done && passed.within && passed.upright;
        } else {
            const bool known = D == 3 && plane > first && found.at.done;
            for (int d = 0; known && d < D; d++) found.at.p[d] += (slope[d] + bent[d] / 2) * map.axes[2].spacing;
            // Without a guess, strokes are undone one by one; for those that act at once, q does as well.
            const bool once = map.chain.count > 0 && map.chain.end_of(0) == map.chain.count && !map.chain[0].turns();
            for (int d = 0; !known && once && d < D; d++) found.at.p[d] = q[d];
            found = solved<D>(map.chain, map.axes, q, finest_of<D>(map.axes), job.tolerance,
                              known  ? Guess::PATCH
                              : once ? Guess::POINT
                                     : Guess::NONE,
                              found.at);
            for (int d = 0; D == 3 && d < D; d++) {
                const double now = found.at.m[D - 1][d];
                bent[d] = known ? now - slope[d] : 0;
                slope[d] = now;
            }
        }
        if (plane < 0) continue;
        using N = NodeRecord<D>;
        const N node(job.nodes, plane * each + i % each);
        for (int d = 0; d < D; d++) {
            const double per = 1 / map.axes[d].spacing, p = within(found.at.p[d] * per, -1e9, 1e9);
            node.whole(N::WHOLE + d) = (int)floored(p);
            node[N::PART + d] = (float)(p - floored(p));
            node[N::MIXED + d] = (float)(found.mixed[d] * map.axes[0].spacing * map.axes[1].spacing * per);
            for (int e = 0; e < D; e++) node[N::M + e * D + d] = (float)(found.at.m[e][d] * map.axes[e].spacing * per);
        }
        // Beside a node that is not solved, every pixel is.
        for (int a = 0; a < 2; a++)
            node[N::SMOOTH + a] = found.at.done ? (float)(root(found.smooth2[a]) / map.axes[a].spacing) : 0;
    }
}

// STILL if no stroke's ball reaches a box, RIM if some of its points may be outside of all balls, and GOOD otherwise.
template <int D>
INLINE int reached(const Map& map, const double* low, const double* high) {
    if (composed(map) || (!map.limited && !map.freeze)) return GOOD;
    bool touched = !map.limited, covered = !map.limited;
    for (int s = 0; s < map.chain.count; s++) {
        const Stroke& k = map.chain[s];
        double near2 = 0, far2 = 0;
        for (int d = 0; d < D; d++) {
            double a = low[d], b = high[d];
            if (map.axes[d].fixed()) {
                a = nearest(a, map.axes[d]);
                b = nearest(b, map.axes[d]);
            }
            const double longer = d == 2 ? k.stretch : 1;
            const double near = (least(most(k.pivot[d], a), b) - k.pivot[d]) * longer;
            const double far = most(magnitude(a - k.pivot[d]), magnitude(b - k.pivot[d])) * longer;
            near2 += near * near;
            far2 += far * far;
        }
        touched = touched || near2 < k.reach * k.reach;
        covered = covered || far2 < k.reach * k.reach;
    }
    return !touched ? STILL : covered && !map.freeze ? GOOD : RIM;
}

// Whether a pixel is unmoved. A function call, so that the many pixels that do not need it have more registers.
template <int D>
NOINLINE bool unmoved(const Job& job, int plane, int x, int y) {
    const Map& map = map_of(job, plane);
    const double q[3] = {x * map.axes[0].spacing, y * map.axes[1].spacing, depth_of(job, plane) * map.axes[2].spacing};
    return reached<D>(map, q, q) == STILL || (map.freeze && is_frozen<D>(*map.freeze, q));
}

template <int D>
INLINE void check_cell(const Job& job) {
    const int wide = job.nx - 1, tall = job.ny - 1;
    const int64_t i = thread(), each = (int64_t)wide * tall;
    if (i >= each * job.planes) return;
    const int plane = (int)(i / each), j = (int)(i % each / wide), k = (int)(i % wide);
    const Map& map = map_of(job, plane);
    const double x0 = job.xs[k], y0 = job.ys[j], w = job.xs[k + 1] - x0, h = job.ys[j + 1] - y0;
    const double z = depth_of(job, plane);
    auto rough = [&] {
        const int at = atomicAdd(&job.checks->rough, 1);
        job.rough[at] = (int)i;
        job.states[i] = at;
    };
    if (composed(map) && !map.composite->smooth) return rough();
    const double low[3] = {x0 * map.axes[0].spacing, y0 * map.axes[1].spacing, z * map.axes[2].spacing};
    const double high[3] = {(x0 + w) * map.axes[0].spacing, (y0 + h) * map.axes[1].spacing, low[2]};
    const int state = reached<D>(map, low, high);
    job.states[i] = state;
    if (state == STILL) return;
    using N = NodeRecord<D>;
    const int64_t upper = ((int64_t)plane * job.ny + j) * job.nx + k;
    const N corner[4] = {N(job.nodes, upper), N(job.nodes, upper + 1), N(job.nodes, upper + job.nx),
                         N(job.nodes, upper + job.nx + 1)};
    float smooth[2] = {1e30f, 1e30f}, across_plane[D] = {};
    for (int v = 0; v < 4; v++) {
        for (int a = 0; a < 2; a++) smooth[a] = least(smooth[a], corner[v][N::SMOOTH + a]);
        for (int d = 0; D == 3 && d < D; d++) across_plane[d] += 0.25f * corner[v][N::M + (D - 1) * D + d];
    }
    const bool thin[2] = {w <= 1, h <= 1}, single = thin[0] && thin[1];
    bool good = !(least(smooth[0], smooth[1]) <= 0);
    if (!single) good = good && (thin[0] || w <= RESOLVED * smooth[0]) && (thin[1] || h <= RESOLVED * smooth[1]);
    if (!good) return rough();
    int anchor[D];
    float rounding = 0, c[D][16];
    double per[D];
    for (int d = 0; d < D; d++) {
        per[d] = 1 / map.axes[d].spacing;
        anchor[d] = corner[0].whole(N::WHOLE + d);
        float value[4], along_x[4], along_y[4], twist[4], ds, dt;
        for (int v = 0; v < 4; v++) {
            value[v] = (float)(corner[v].whole(N::WHOLE + d) - anchor[d]) + corner[v][N::PART + d];
            along_x[v] = corner[v][N::M + d];
            along_y[v] = corner[v][N::M + D + d];
            twist[v] = corner[v][N::MIXED + d];
        }
        patch_of(value, along_x, along_y, twist, 1 / (float)w, 1 / (float)h, c[d]);
        // The powers of a patch are steep, and cancel at the corners, whose values are rounded, too.
        for (int v = 0; v < 4; v++) {
            const float s = v & 1 ? (float)w : 0, t = v & 2 ? (float)h : 0;
            const float off = magnitude(at(c[d], s, t, ds, dt) - value[v]);
            rounding = most(rounding, off + ROUNDING * most(magnitude(value[v]), 1.0f));
        }
    }
    // The error of a patch is the Newton step from it, or, for a composite, its distance to the solution.
    const double reserve = composed(map) || map.freeze ? ROUGH : RESERVE, most_off = least(job.tolerance, COARSEST);
    double worst = 0;
    for (int n = 0; good && !single && n < SEEN; n++) {
        const float s = thin[0] ? float(SEEN_X[n] > 0.5) : (float)(SEEN_X[n] * w);
        const float t = thin[1] ? float(SEEN_Y[n] > 0.5) : (float)(SEEN_Y[n] * h);
        const double q[3] = {x0 + s, y0 + t, z};
        float ds[D], dt[D], e[D], off2 = 0;
        Jet<D, 0, false, double> jet;
        double p[D];
        for (int d = 0; d < D; d++) p[d] = anchor[d] + (double)at(c[d], s, t, ds[d], dt[d]);
        for (int d = 0; d < D; d++) jet.x[d] = (composed(map) ? q[d] : p[d]) * map.axes[d].spacing;
        if (composed(map))
            pass<D>(*map.composite, true, jet);
        else
            apply<D>(map.chain, map.axes, jet.x);
        for (int d = 0; d < D; d++) e[d] = (float)(jet.x[d] * per[d] - (composed(map) ? p[d] : q[d]));
        for (int d = 0; d < D; d++) {
            float step = e[d];
            if (!composed(map)) step = ds[d] * e[0] + dt[d] * e[1] + (D == 3 ? across_plane[d] * e[D - 1] : 0);
            off2 += step * step;
        }
        const double off = root(off2);
        worst = most(worst, off);
        good = reserve * off <= most_off;  // also for NaN
    }
    if (!good) return rough();
    using L = LeafRecord<D>;
    const L leaf(job.leaves, i);
    for (int d = 0; d < D; d++) {
        leaf.whole(L::ANCHOR + d) = anchor[d];
        for (int n = 0; n < 16; n++) leaf[L::C + 16 * d + n] = c[d][n];
    }
    if constexpr (D == 3) {
        double v[4];
        float depth[4];
        for (int n = 0; n < 4; n++) v[n] = corner[n][N::M + 8];
        bilinear_of(v, w, h, depth);
        for (int n = 0; n < 4; n++) leaf[L::DEPTH + n] = depth[n];
    }
    atomicMax(&job.checks->worst, __float_as_int((float)(most(reserve * worst, (double)rounding) * (1 + 1e-6))));
}

// Solve the source point of a pixel of a rough cell.
template <int D>
NOINLINE void solve_pixel(const Job& job, int plane, int x, int y, Point<D>& point) {
    const Map& map = map_of(job, plane);
    const double at[3] = {(double)x, (double)y, depth_of(job, plane)};
    double q[D];
    for (int d = 0; d < D; d++) q[d] = at[d] * map.axes[d].spacing;
    point.same = !composed(map) && unmoved<D>(job, plane, x, y);
    if (point.same) return;
    Solved<D, double> solution{};
    Solution<D, double>& found = solution.at;
    if (composed(map)) {
        const Passed<double> passed = solve_composite<D, false>(*map.composite, q, solution);
        if (!passed.upright) atomicAdd(&job.checks->folded, 1);
        if (!passed.within) atomicAdd(&job.checks->outside, 1);
    } else {
        const double finest = finest_of<D>(map.axes), close = CLOSE_ENOUGH * least(job.tolerance, 1.0);
        for (int d = 0; d < D; d++) found.p[d] = q[d];
        newton<D>(map.chain, map.axes, q, close * finest, 10, found, STEEP * close * finest);
        if (!found.done) undo<D>(map.chain, map.axes, q, close * finest, found);
        if (job.checks->worst < __float_as_int((float)close))
            atomicMax(&job.checks->worst, __float_as_int((float)close));
    }
    if (!found.done) atomicAdd(&job.checks->unsolved, 1);
    for (int d = 0; d < D; d++) {
        double p = within(found.p[d] / map.axes[d].spacing, -1e9, 1e9);
        if (!found.done) p = within(p, at[d] - FAR, at[d] + FAR);  // unsolved points must not require all frames
        point.whole[d] = (int)floored(p);
        point.part[d] = (float)(p - point.whole[d]);
        for (int e = 0; e < D; e++) found.m[e][d] *= map.axes[e].spacing / map.axes[d].spacing;
    }
    for (int d = 0; d < 2; d++) {
        point.across[d] = (float)found.m[0][d];
        point.down[d] = (float)found.m[1][d];
    }
    point.rate2 = 1;
    if constexpr (D == 3) {
        double sum = 0;
        for (int e = 0; e < D; e++) sum += found.m[e][2] * found.m[e][2];
        point.rate2 = (float)sum;
    }
}

}  // namespace supple::cuda
