// The kernel that maps points, forwards or back.
#pragma once
#include "lattice.hpp"

namespace supple::cuda {

// `count` points (x, y[, z]) in pixels, of doubles or of floats.
struct Some {
    const Map* map;
    const void* from;
    double *to, *matrices, *residual;  // (count, D), (count, D, D) or null, (count,) or null
    int64_t* steps;
    uint8_t* done;
    Told* told;
    int64_t count;
    double tolerance;  // of the residual, in the units of the map
    int wide, back;    // whether they are of doubles; whether by T⁻¹
};
static_assert(sizeof(Some) == SOME_BYTES, "the layout of points");

template <int D>
INLINE void move_point(const Some& job) {
    const int64_t i = thread();
    if (i >= job.count) return;
    const Map& map = *job.map;
    Jet<D, D, false, double> jet;
    double q[D], off2 = 0, size = 0, steps = 1;
    for (int d = 0; d < D; d++) {
        const int64_t at = i * D + d;
        q[d] = (job.wide ? ((const double*)job.from)[at] : (double)((const float*)job.from)[at]) * map.axes[d].spacing;
        size = most(size, magnitude(q[d]));
        jet.x[d] = q[d];
        for (int e = 0; e < D; e++) jet.t[e][d] = d == e;
    }
    Passed<double> passed{true, true, true, 0};
    if (composed(map)) {
        passed = pass<D>(*map.composite, job.back, jet);
        steps = passed.steps;
    } else if (job.back) {
        Solution<D, double> found;
        undo<D>(map.chain, map.axes, q, 1e-9 * map.finest(D), found);
        for (int d = 0; d < D; d++) jet.x[d] = found.p[d];
        steps = found.steps;
    } else
        carry(map.chain, map.axes, jet);
    if (job.residual) {
        double seen[D];
        for (int d = 0; d < D; d++) seen[d] = jet.x[d];
        if (composed(map)) {
            Jet<D, 0, false, double> again;
            for (int d = 0; d < D; d++) again.x[d] = seen[d];
            pass<D>(*map.composite, !job.back, again);
            for (int d = 0; d < D; d++) seen[d] = again.x[d];
        } else
            apply<D>(map.chain, map.axes, seen);
        for (int d = 0; d < D; d++) off2 += (seen[d] - q[d]) * (seen[d] - q[d]);
        job.residual[i] = root(off2) / map.finest(D);
        job.steps[i] = (int64_t)steps;
        job.done[i] = passed.done && root(off2) / map.finest(D) <= most(job.tolerance, 1e-14 * size / map.finest(D));
    }
    if (!passed.done) atomicAdd(&job.told->unsolved, 1);
    if (!passed.upright) atomicAdd(&job.told->folded, 1);
    if (!passed.within) atomicAdd(&job.told->outside, 1);
    for (int d = 0; d < D; d++) {
        job.to[i * D + d] = jet.x[d] / map.axes[d].spacing;
        for (int e = 0; job.matrices && e < D; e++)
            job.matrices[(i * D + d) * D + e] = jet.t[e][d] * map.axes[e].spacing / map.axes[d].spacing;
    }
}

}  // namespace supple::cuda
