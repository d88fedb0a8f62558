// The tables of strokes and axes, as Python packs them (`supple.strokes.STROKE_DTYPE`,
// `supple.space.domain.Domain.packed`).
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "frozen.hpp"
#include "newton.hpp"

namespace supple {

constexpr int STROKE_NUMBERS = 39;
static_assert(sizeof(StrokeRow) == 8 * STROKE_NUMBERS);
constexpr int AXIS_NUMBERS = 5;  // first, last, sigma, spacing, profile

typedef std::array<Axis, 3> Axes;

// Read three rows of (first, last, sigma, spacing, profile).
inline Axes load_axes(const double* rows) {
    Axes axes;
    for (int i = 0; i < 3; i++, rows += AXIS_NUMBERS) axes[i] = {rows[0], rows[1], rows[2], rows[3], (int64_t)rows[4]};
    return axes;
}

// True if β = 1 in all of a stroke's ball. Along an axis of sigma 0, β = 0; that has no effect only if K has no such
// component, as in a single plane with the pivot and the force in it.
inline bool is_inner(const Stroke& k, const Axis* axes) {
    for (int i = 0; i < 3; i++) {
        const Axis& a = axes[i];
        const double *row = k.matrix[i], across = fabs(row[(i + 1) % 3]) + fabs(row[(i + 2) % 3]),
                     per = i == 2 ? k.stretch : 1;
        bool flat = a.extent() == 0 && k.pivot[i] == a.first && k.force[i] == 0 && across == 0;
        bool clear = a.sigma > 0 && depth(k.pivot[i], a) - k.reach / per >= a.sigma;
        if (a.fixed() && !flat && !clear) return false;
    }
    return true;
}

// |M| by Frobenius' norm, or |f|; for a twist, the largest factor.
inline double strength_of(const Stroke& k) {
    if (k.turns()) return std::max({k.turn[0], k.turn[1], k.turn[2]});
    double sum = 0;
    for (int i = 0; i < 3; i++) {
        sum += k.force[i] * k.force[i];
        for (double m : k.matrix[i]) sum += m * m;
    }
    return sqrt(sum);
}

// Bounds of |K| and |J| of a stroke in its own, stretched metric, without a border, from samples along the distance r:
// with V = |v| = |f| or |M| r,
//
//     |K| ≤ (|A| + |B| r²) V,    |J| ≤ (|2A'| r + |2B'| r³ + 2 |B| r) V + (|A| + |B| r²) |M|.
//
// and `unlimited`, of |K| without its reach: times the reach's factor m at a distance, it bounds |K| beyond that
// distance. For a twist, |R - I| ≤ 2, too.
struct Bound {
    double value, slope, unlimited;
};
inline Bound bound_of(const Stroke& k) {
    const double end = k.per_reach > 0 ? 1 / k.per_reach : k.reach;
    const double farthest = std::min(end, 8 * sqrt(k.radius2[0])), strength = 1.05 * strength_of(k);
    Stroke free = k;
    free.per_reach = 0;
    Bound most{};
    for (int i = 0; i <= 64; i++) {
        const double r = farthest * i / 64, length = k.power == 3 ? r : 1.0;
        const Radial<double> g = radial<1>(k, r * r);
        const double any = fabs(g.A[0]) + fabs(g.B[0]) * r * r, both = k.turns() ? std::min(any, 2.0) : any;
        const double bend = (fabs(g.A[1]) + fabs(g.B[1]) * r * r + 2 * fabs(g.B[0])) * r * length;
        const Radial<double> u = radial<0>(free, r * r);
        most.value = std::max(most.value, both * length);
        most.unlimited = std::max(most.unlimited, (fabs(u.A[0]) + fabs(u.B[0]) * r * r) * length);
        most.slope = std::max(most.slope, bend + (k.power == 3 ? both : 0));
    }
    return {strength * most.value, strength * most.slope, strength * most.unlimited};
}

// The box around a stroke's ball, which is an ellipsoid where time is stretched.
struct Vicinity {
    double low[3], high[3];
    explicit Vicinity(const Stroke& k) {
        for (int i = 0; i < 3; i++) {
            const double reach = i == 2 ? k.reach / k.stretch : k.reach;
            low[i] = k.pivot[i] - reach;
            high[i] = k.pivot[i] + reach;
        }
    }
};

// True if the freeze mask is 1 in all of a stroke's ball.
inline bool is_free(const Stroke& k, const Frozen* freeze) {
    const Vicinity near(k);
    return !freeze || freeze->is_free(near.low, near.high);
}

// True if neither a border nor a mask changes a twist: one-to-one, whatever its angle.
inline bool is_whole(const Stroke& k) { return k.turns() && k.inner && !k.freeze; }

// The freeze mask of a stroke; it must have one.
inline const Frozen& mask_of(const Stroke& k) { return *static_cast<const Frozen*>(k.freeze); }

// The strokes of a table, in order, and their axes.
struct Strokes {
    Axes axes;
    std::vector<Stroke> table;
    std::vector<int> list;  // all of them

    // Read `count` rows of STROKE_NUMBERS, and derive the other values. The mask must live as long as the strokes; if
    // it stands for several, each row has the number of its mask.
    Strokes(const double* rows, size_t count, const Axes& axes, const Frozen* freeze = nullptr);
    Chain chain() const { return {table.data(), list.data(), (int)list.size()}; }
};
inline Strokes::Strokes(const double* rows, size_t count, const Axes& axes, const Frozen* freeze)
    : axes(axes), table(count), list(count) {
    for (size_t i = 0; i < count; i++) list[i] = (int)i;
    int64_t group = 0;
    for (Stroke& k : table) {
        memcpy(static_cast<StrokeRow*>(&k), rows, sizeof(StrokeRow));
        rows += STROKE_NUMBERS;
        const bool joined = k.group != 0;
        k.group = joined ? group : ++group;
        k.force[2] *= k.stretch;
        k.per_reach = std::isfinite(k.reach) ? 1.0 / (k.flat > 0 ? eased(k, k.reach) : k.reach) : 0.0;
        k.rim = cbrt(0.25 * k.radius2[0] * k.flat);
        k.inner = is_inner(k, axes.data());
        const Frozen* own = freeze && !freeze->masks.empty() ? freeze->masks.at(k.mask) : freeze;
        k.freeze = is_free(k, own) ? nullptr : own;
        k.shared = joined;
        if (joined && &k != table.data()) (&k - 1)->shared = true;
    }
}

}  // namespace supple
