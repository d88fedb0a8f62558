// T⁻¹ by the published iteration, unchanged: a baseline for measurements, not used otherwise.
//
// Haetinger and Gastal ("Fast Iterative Inversion for Non-linear Vector Fields Applied to Images, Videos and
// Volumes", equations 4.3 to 4.6) invert each pixel by itself. Starting at p = q, p changes by μ A⁻¹ b, where
//
//     ξ = T(p) - q,    b = -(Jᵀ + I) ξ,    A = JᵀJ + 2Jᵀ + I,
//
// until |ξ| is below a tenth of a pixel. The Gauss–Newton matrix is (I+J)ᵀ(I+J) = JᵀJ + Jᵀ + J + I instead, as J is not
// symmetric; `corrected` selects it. Each stroke is inverted by itself, the last one first.
#pragma once
#include <math.h>

#include "table.hpp"

namespace supple {

struct Published {
    double mu, tolerance;
    int limit;
    bool corrected;
};

// Invert all strokes at one point q, in physical units; returns |T(p) - q| of the first stroke, in pixels.
template <int D>
double invert_as_published(const Strokes& strokes, const Published& how, double* p, int& count) {
    const Axis* axes = strokes.axes.data();
    double error = 0;
    count = 0;
    for (int k = (int)strokes.table.size() - 1; k >= 0; k--) {
        double q[D];
        for (int d = 0; d < D; d++) q[d] = p[d];
        for (int turn = 0; turn <= how.limit; turn++) {
            auto jet = jet_at<D, D>(p);
            add(strokes.table[k], axes, jet, jet);
            double xi[D], off = 0;
            for (int d = 0; d < D; d++) {
                xi[d] = jet.x[d] - q[d];
                off += (xi[d] / axes[d].spacing) * (xi[d] / axes[d].spacing);
            }
            error = sqrt(off);
            if (error < how.tolerance || turn == how.limit) break;
            double A[D][D], inverse[D][D], b[D];  // A by columns
            auto J = [&](int i, int j) { return jet.t[j][i] - (i == j); };
            for (int i = 0; i < D; i++) {
                b[i] = -xi[i];
                for (int j = 0; j < D; j++) {
                    b[i] -= J(j, i) * xi[j];
                    A[j][i] = (i == j) + (how.corrected ? J(j, i) + J(i, j) : 2 * J(j, i));
                    for (int l = 0; l < D; l++) A[j][i] += J(l, i) * J(l, j);
                }
            }
            invert(A, inverse);
            double step[D];
            bool finite = true;
            for (int d = 0; d < D; d++) {
                step[d] = times<D>(inverse, b, d);
                finite = finite && isfinite(step[d]);
            }
            if (!finite) break;  // A is singular
            for (int d = 0; d < D; d++) p[d] += how.mu * step[d];
            count++;
        }
    }
    return error;
}

}  // namespace supple
