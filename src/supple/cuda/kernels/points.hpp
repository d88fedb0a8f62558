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
    Checks* checks;
    int64_t count;
    double tolerance;  // of the residual, in the units of the map
    int wide, back;    // whether points are doubles; whether to apply T⁻¹
};
static_assert(sizeof(Some) == SOME_BYTES, "the layout of points");

template <int D>
INLINE void move_point(const Some& job) {
    const int64_t i = thread();
    if (i >= job.count) return;
    const Map& map = *job.map;
    const double finest = finest_of<D>(map.axes);
    double from[D], q[D], size = 0;
    for (int d = 0; d < D; d++) {
        const int64_t at = i * D + d;
        from[d] = job.wide ? ((const double*)job.from)[at] : (double)((const float*)job.from)[at];
        q[d] = from[d] * map.axes[d].spacing;
        size = most(size, magnitude(q[d]));
    }
    auto jet = jet_at<D, D>(q);
    auto sent = [&](bool back, auto& jet) {
        if (composed(map)) return pass<D>(*map.composite, back, jet);
        Passed<double> passed{true, true, true, 0};
        pass_strokes<D>(map.chain, map.axes, back, jet, passed);
        passed.done = true;  // for strokes, the residual decides
        return passed;
    };
    const Passed<double> passed = sent(job.back, jet);
    if (job.residual) {
        auto seen = jet_at<D, 0>(jet.x);
        sent(false, seen);  // the residual is only wanted for T⁻¹
        double off2 = 0;
        for (int d = 0; d < D; d++) off2 += (seen.x[d] - q[d]) * (seen.x[d] - q[d]);
        job.residual[i] = root(off2) / finest;
        job.steps[i] = (int64_t)passed.steps;
        job.done[i] = passed.done && job.residual[i] <= most(job.tolerance, 1e-14 * size / finest);
    }
    if (!passed.done) atomicAdd(&job.checks->unsolved, 1);
    if (!passed.upright) atomicAdd(&job.checks->folded, 1);
    if (!passed.within) atomicAdd(&job.checks->outside, 1);
    for (int d = 0; d < D; d++) {
        job.to[i * D + d] =
            jet.x[d] == q[d] ? from[d] : jet.x[d] / map.axes[d].spacing;  // unmoved coordinates keep their bits
        for (int e = 0; job.matrices && e < D; e++)
            job.matrices[(i * D + d) * D + e] = jet.t[e][d] * map.axes[e].spacing / map.axes[d].spacing;
    }
}

}  // namespace supple::cuda
